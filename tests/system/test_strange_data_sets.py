"""`fg.Dataset` and the report on data sets whose files anybody may have changed, and on arguments that are none."""

from __future__ import annotations

import json
import shutil
import struct
import sys
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from command_line import run, tree
from hostile import TEXTS as RECIPES
from pack_sets import batch

import forestgen as fg
from support.error_messages import raises_error

FRAME = "000000-camera0"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Nobody changes it."""
    return batch(tmp_path_factory.mktemp("made") / "set")


@pytest.fixture
def root(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "set"))


def read_all(root: Path) -> None:
    """All that Python offers of a data set's first frame."""
    data_set = fg.Dataset(root)
    frame = data_set[0]
    repr(data_set), repr(frame), data_set.classes, data_set.categories
    _ = frame.image, frame.channels, frame.preview, frame.semantic, frame.instance, frame.info
    data_set.as_huggingface()


def test_the_data_set_is_sound(root: Path) -> None:
    read_all(root)
    assert run("report", root).code == 0


def of_size(content: bytes, size_px: tuple[int, int]) -> bytes:
    head = b"IHDR" + struct.pack(">II", *size_px) + content[24:29]
    return content[:12] + head + struct.pack(">I", zlib.crc32(head)) + content[33:]


@pytest.mark.parametrize("size_px", [(60_000, 60_000), (16_000, 12_000), (31, 24), (0, 0), (2**31, 1)])
@pytest.mark.parametrize("name", ["preview", "semantic", "instance"])
def test_a_picture_of_another_size_is_refused_before_it_is_unpacked(
    name: str, size_px: tuple[int, int], root: Path
) -> None:
    path = root / "train" / FRAME / f"{name}.png"
    path.write_bytes(of_size(path.read_bytes(), size_px))
    with raises_error(fg.DatasetError):
        getattr(fg.Dataset(root).frame(FRAME), name)


@pytest.mark.parametrize("seed", range(40))
def test_a_damaged_picture_is_told(seed: int, root: Path) -> None:
    rng = np.random.default_rng(seed)
    for name in ("preview", "semantic", "instance"):
        path = root / "train" / FRAME / f"{name}.png"
        content = bytearray(path.read_bytes())
        for at in rng.integers(8, len(content), 4):
            content[at] = rng.integers(256)
        path.write_bytes(content[: rng.integers(20, len(content))] if seed % 4 == 0 else content)
        try:
            getattr(fg.Dataset(root).frame(FRAME), name)
        except fg.DatasetError as error:
            assert f"{name}.png" in str(error)  # noqa: PT017 - other damages go unseen, as the sums are verify's


def test_classes_are_one_number_a_pixel(root: Path) -> None:
    folder = root / "train" / FRAME
    shutil.copy(folder / "preview.png", folder / "semantic.png")
    with raises_error(fg.DatasetError, place="semantic.png"):
        _ = fg.Dataset(root).frame(FRAME).semantic


LEGENDS: dict[str, dict[str, Any]] = {
    "a gap": {"semantic": {"5": "x"}},
    "a list": {"semantic": ["a", "b"]},
    "a number": {"semantic": 5},
    "no text": {"semantic": {"0": 1}},
    "two spellings": {"semantic": {"0": "a", "00": "b"}},
    "no number": {"categories": {"x": "y"}},
    "another sign": {"categories": {"\u0661": "y"}},
    "a list of categories": {"categories": [1]},
    "no categories": {"categories": None},
}


@pytest.mark.parametrize("kind", LEGENDS)
def test_a_legend_of_another_form_is_told(kind: str, root: Path) -> None:
    path = root / "train" / "classes.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **LEGENDS[kind]}))
    with raises_error(fg.DatasetError, place="classes.json"):
        read_all(root)
    assert run("pack", root, "--format", "webdataset", "--out", root.parent / "pack").code == 6


def test_a_data_set_without_splits_is_told(root: Path) -> None:
    path = root / "dataset.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "splits": {}}))
    for read in (lambda: fg.Dataset(root).classes, lambda: fg.Dataset(root)[0]):
        with raises_error(fg.DatasetError, place="dataset.json"):
            read()


def column(name: str, values: Callable[[int], list[Any]], kind: pa.DataType) -> Callable[[pa.Table], pa.Table]:
    """The index with other values in a column."""

    def change(table: pa.Table) -> pa.Table:
        made = pa.array(values(table.num_rows), kind)
        at = table.column_names.index(name) if name in table.column_names else None
        return table.append_column(name, made) if at is None else table.set_column(at, name, made)

    return change


def every(value: Any) -> Callable[[int], list[Any]]:
    return lambda rows: [value] * rows


COUNTS, TEXTS, MAP = pa.list_(pa.int64()), pa.list_(pa.string()), pa.map_(pa.string(), pa.int64())
UNREADABLE: dict[str, Callable[[pa.Table], pa.Table]] = {
    "no image": lambda table: table.drop_columns(["image"]),
    "null image": column("image", every(None), pa.int64()),
    "no channels": lambda table: table.drop_columns(["channels"]),
    "null channels": column("channels", every(None), TEXTS),
    "empty channels": column("channels", every([]), TEXTS),
    "a null channel": column("channels", every([None]), TEXTS),
    "channels of numbers": column("channels", every([1]), COUNTS),
    "no width": lambda table: table.drop_columns(["width_px"]),
    "a huge side": column("height_px", every(60_000), pa.int32()),
    "a key twice": column("class_pixels", every([("a", 1), ("a", 2)]), MAP),
    "a large count": column("plants", every(2**64 - 1), pa.uint64()),
    "a large draw": column("draw.sky.turbidity", every(2**64 - 1), pa.uint64()),
}
OUT_OF_BOUNDS: dict[str, Callable[[pa.Table], pa.Table]] = {
    "large angles": column(
        "sun_elevation_deg", lambda rows: [1e308, -1e308, *[0.0] * (rows - 2)], pa.float64()
    ),
    "infinite": column("camera_pitch_deg", every(-np.inf), pa.float64()),
    "many counts": column("instance_pixels_histogram", every([0] * 100_000), COUNTS),
    "a null count": column("instance_pixels_histogram", every([1, None]), COUNTS),
    "a negative count": column("instance_pixels_histogram", every([1, -1]), COUNTS),
    "texts as counts": column("instance_pixels_histogram", every(["x"]), TEXTS),
    "negative pixels": column("class_pixels", every([("a", -1)]), MAP),
    "large draws": column("draw.sky.turbidity", lambda rows: [1e308, -1e308, *[0.0] * (rows - 2)], pa.float64()),
    "draws of another type": column("draw.sky.turbidity", every(2**62), pa.timestamp("ms")),
}  # fmt: skip


@pytest.mark.parametrize("kind", [*UNREADABLE, *OUT_OF_BOUNDS])
def test_an_index_that_no_frame_can_be_read_from_is_told(kind: str, root: Path) -> None:
    path = root / "index.parquet"
    pq.write_table({**UNREADABLE, **OUT_OF_BOUNDS}[kind](pq.read_table(path)), path)
    with raises_error(fg.DatasetError, place="index.parquet"):
        read_all(root)
    assert run("report", root).code in ((6,) if kind in OUT_OF_BOUNDS else (0, 6))


def test_a_library_that_is_missing_is_named(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("torch", "datasets"):
        monkeypatch.setitem(sys.modules, name, None)
    data_set = fg.Dataset(made)
    for call in (data_set.as_torch, data_set.as_huggingface):
        with raises_error(fg.ResourceError):
            call()


def test_a_single_text_is_a_single_name(made: Path, tmp_path: Path) -> None:
    data_set = fg.Dataset(made)
    with raises_error(fg.RecipeError, place="channels") as refused:
        data_set.as_torch("semantics")
    assert (refused.value.got, refused.value.hint) == ("'semantics'", "did you mean 'semantic'?")
    packed = data_set.pack(tmp_path / "pack", "webdataset", channels="preview", splits="train", progress=False)
    assert (packed.channels, list(packed.splits)) == (("preview",), ["train"])
    with raises_error(fg.RecipeError, place="at-all"):
        fg.merge("/nowhere/at-all", tmp_path / "merged")


def test_a_frame_is_found_by_its_name(made: Path) -> None:
    data_set = fg.Dataset(made)
    assert data_set[FRAME].name == data_set.frame(FRAME).name == FRAME
    assert data_set[np.int64(1)].name == data_set[1].name
    with raises_error(fg.RecipeError, place="name"):
        _ = data_set["train"]
    for wrong in (1.0, None, (0, 1)):
        with pytest.raises(TypeError, match="by its number, a slice or its name, not by"):
            _ = data_set[wrong]  # type: ignore[call-overload]


def test_a_split_that_is_yet_to_come_is_no_typo(root: Path) -> None:
    path = root / "dataset.json"
    content = json.loads(path.read_text())
    content["recipes"][0]["splits"] = {"train": 8.0, "val": 1.0, "test": 1.0}
    path.write_text(json.dumps(content))
    with raises_error(fg.RecipeError, place="split"):
        fg.Dataset(root).split("test")
    with raises_error(fg.RecipeError, place="split"):
        fg.Dataset(root).split("vall")


def test_a_saved_frame_is_replaced_where_that_is_asked_for(made: Path, tmp_path: Path) -> None:
    first = fg.Dataset(made)[FRAME]
    target = first.save(tmp_path)
    before = tree(target)
    (target / "preview.png").write_bytes(b"other")
    with raises_error(fg.OutputError, place="000000-camera0"):
        first.save(tmp_path)
    assert first.save(tmp_path, overwrite=True) == target
    assert tree(target) == before
    assert [path.name for path in tmp_path.iterdir()] == [FRAME]
    shutil.rmtree(target)
    target.mkdir()
    (target / "letter.txt").write_text("mine")
    with raises_error(fg.OutputError, place="000000-camera0"):
        first.save(tmp_path, overwrite=True)
    assert (target / "letter.txt").read_text() == "mine"


@pytest.mark.parametrize(
    "options",
    [{"workers": 0}, {"workers": -1}, {"workers": True}, {"rerender": -1}, {"rerender": 1.5}, {"seed": "x"},
     {"seed": -1}],
)  # fmt: skip
def test_numbers_of_a_check_are_checked(options: dict[str, Any], made: Path) -> None:
    with raises_error(fg.RecipeError):
        fg.Dataset(made).verify(**options, progress=False)


@pytest.mark.parametrize("seed", [1.5, -1, "x"])
def test_the_seed_of_a_pack_is_a_whole_number(seed: Any, made: Path, tmp_path: Path) -> None:
    with raises_error(fg.RecipeError, place="seed"):
        fg.Dataset(made).pack(tmp_path / "pack", "webdataset", seed=seed, progress=False)
    assert list(tmp_path.iterdir()) == []


def test_a_packs_readme_tells_of_what_it_holds(made: Path, tmp_path: Path) -> None:
    words = {"semantic": "`semantic`", "instance": "`instance`", "annotations": "Categories", "depth": "`depth`"}
    for channels in (["preview"], ["depth", "semantic"], ["instance", "annotations"]):
        out = tmp_path / channels[0]
        fg.Dataset(made).pack(out, "webdataset", channels=channels, progress=False)
        text = (out / "README.md").read_text().partition("## The data set")[0]
        assert {name for name, word in words.items() if f"- {word}" in text} == set(channels) - {"preview"}


@pytest.mark.parametrize("of_a_frame", [False, True])
def test_a_recipe_of_many_aliases_is_named_and_not_followed(of_a_frame: bool, root: Path) -> None:
    path = next(root.glob("**/*/recipe.yaml")) if of_a_frame else root / "recipe.yaml"
    path.write_text(RECIPES["a billion laughs"], encoding="utf-8")
    start = time.perf_counter()
    findings = fg.verify(root, hashes=False, progress=False).findings
    assert any("too many values by aliases" in finding.got for finding in findings)
    assert time.perf_counter() - start < 10


@pytest.mark.parametrize("name", ["set/dataset.json", "set/train/page.html", "recipe.yaml"])
def test_a_report_replaces_nothing_but_a_page(name: str, root: Path, tmp_path: Path) -> None:
    path = tmp_path / name
    if not path.exists():
        path.write_text("mine", encoding="utf-8")
    before = path.read_bytes()
    run("report", root, "-o", path, "--overwrite").refused(4)
    assert path.read_bytes() == before


def test_a_log_that_is_too_large_is_a_damaged_file(root: Path) -> None:
    (root / "run").mkdir(exist_ok=True)
    with (root / "run" / "log.jsonl").open("wb") as stream:
        stream.truncate(2**40)
    with raises_error(fg.DatasetError, place="log.jsonl"):
        fg.Dataset(root).report()


def test_a_frame_is_in_a_data_set_by_its_name(root: Path) -> None:
    assert FRAME in fg.Dataset(root)
    assert "another" not in fg.Dataset(root)


def test_arguments_that_are_none_are_refused_as_such(root: Path, tmp_path: Path) -> None:
    data_set = fg.Dataset(root)
    data_set.pack(tmp_path / "pack", "webdataset", seed=np.int64(1), progress=False)  # NumPy's are numbers as well
    for folder in ("", "\0", 1, b"x", "\ud800", "a\nb", "s3://bucket/x"):
        with pytest.raises(fg.ForestgenError):
            data_set[0].save(folder)
