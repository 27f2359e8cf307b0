"""Data sets from Python: `render` and `batch` make the same bytes, and a frame is the same made, read or saved."""

from __future__ import annotations

import pickle
import shutil
import subprocess
import sys
import types
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from batch_pieces import RECIPE, shown
from command_line import tree
from PIL import Image

import forestgen as fg
from forestgen.api.datasets import Run
from forestgen.runs.contract import HIDDEN
from forestgen.runs.summary import RunSummary
from support.error_messages import raises_error
from support.tiers import slow_but

IMAGES = 3
# A path of two frames beside a camera that stands, all channels that plants without modules have, and the denoiser.
VARIED = (
    ("  - {name: high, position_m: [3, 2, 6], look_at_m: [3, 2.5, 0], size_px: [16, 16]}\n",
     "  - {name: high, position_m: [3, 2, 6], look_at_m: [3, 2.5, 0], size_px: [16, 16],\n"
     "     path: {frames: 2, position_m: [[3.2, 2, 5.5]]}}\n"),
    ("denoise: false", "denoise: true"),
    ("labels: {samples: 1}", "labels: {samples: 4, channels: [coverage, surface, albedo, sun, cloud, motion, "
     "boundaries, amodal]}"),
)  # fmt: skip


def written(folder: Path, *swaps: tuple[str, str]) -> Path:
    """The recipe's file, with texts replaced."""
    text = RECIPE
    for old, new in swaps:
        assert old in text
        text = text.replace(old, new)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "fireweed.yaml").write_text(text, encoding="utf-8")
    return folder / "fireweed.yaml"


@pytest.fixture(scope="module")
def recipe(tmp_path_factory: pytest.TempPathFactory) -> fg.Recipe:
    return fg.load(written(tmp_path_factory.mktemp("recipe"), *VARIED))


@pytest.fixture(scope="module")
def data_set(recipe: fg.Recipe, tmp_path_factory: pytest.TempPathFactory) -> fg.Dataset:
    """Three images of three frames, in two splits; nobody changes it."""
    out = tmp_path_factory.mktemp("rendered") / "set"
    return recipe.render(out, count=IMAGES, progress=False).dataset


def assert_same_files(one: Path, other: Path) -> None:
    """All but run/, report.html and .forestgen."""
    first, second = shown(one), shown(other)
    assert sorted(first) == sorted(second)
    assert [name for name in first if first[name] != second[name]] == []


@pytest.mark.slow
def test_render_and_batch_make_the_same_bytes(recipe: fg.Recipe, data_set: fg.Dataset, tmp_path: Path) -> None:
    run = recipe.batch(tmp_path / "set", IMAGES, workers=2, progress=False)
    assert (run.summary.made, run.summary.failed, run.summary.missing) == (IMAGES, (), ())
    assert run.summary.frames == len(run.dataset) == len(data_set) == 3 * IMAGES
    assert_same_files(data_set.folder, tmp_path / "set")


def same(one: Any, other: Any) -> bool:
    """Whether arrays agree in type, shape and every value, NaN included."""
    return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=one.dtype.kind == "f")


def test_frames_in_memory_are_those_of_the_data_set(recipe: fg.Recipe, data_set: fg.Dataset) -> None:
    names = []
    for frame in recipe.frames(IMAGES, progress=False):
        stored = data_set.frame(frame.name)
        names.append(frame.name)
        assert list(frame.parts) == list(stored.parts)
        for part, channels in frame.parts.items():
            assert sorted(channels) == sorted(stored.parts[part])
            wrong = [name for name, values in channels.items() if not same(values, stored.parts[part][name])]
            assert wrong == [], part
        assert frame.plants.equals(stored.plants)
        assert frame.plants.schema.equals(stored.plants.schema)
        assert frame.camera == stored.camera
        assert same(frame.preview, stored.preview)
        assert same(frame.overlay, stored.overlay)
        assert dict(frame.info) == dict(stored.info)
        assert (frame.classes, frame.channels) == (stored.classes, stored.channels)
        assert (frame.split, frame.image, frame.recipe) == (stored.split, stored.image, stored.recipe)
    assert sorted(names) == [frame.name for frame in data_set]
    assert {frame.split for frame in data_set} == {"train", "val"}


ARRAYS = {
    "radiance": (3, np.float32), "variance": (3, np.float32), "denoised": (3, np.float32), "instance": (0, np.uint32),
    "semantic": (0, np.uint8), "part": (0, np.uint8), "depth": (0, np.float32), "distance": (0, np.float32),
    "position": (3, np.float32), "normal": (3, np.float32), "albedo": (3, np.float32), "motion": (2, np.float32),
    "sun": (0, np.bool_), "cloud": (0, np.float32), "boundary": (0, np.bool_), "preview": (3, np.uint8),
    "overlay": (3, np.uint8),
}  # fmt: skip


def test_the_arrays_are_those_of_the_files(data_set: fg.Dataset) -> None:
    frame = data_set.frame("000000-high-0000")
    for name, (depth, dtype) in ARRAYS.items():
        array = getattr(frame, name)
        assert (array.shape, array.dtype) == ((16, 16, depth) if depth else (16, 16), dtype), name
    assert np.array_equal(frame.radiance[..., 1], frame.channel("radiance", "G"))
    assert np.array_equal(frame.position[..., 2], frame.channel("position", "Z"))
    assert np.isfinite(frame.motion).any()
    folder = data_set.folder / "train" / frame.name
    for name in ("preview", "overlay", "semantic"):
        assert np.array_equal(getattr(frame, name), np.asarray(Image.open(folder / f"{name}.png"))), name
    assert set(np.unique(frame.instance)) - {0} <= set(frame.plants["plant_id"].to_pylist())
    with raises_error(fg.RecipeError, place="000000-high-0000"):
        frame.channel("radiance", "X")
    with raises_error(fg.ForestgenError, place="000000-high-0000"):
        frame.channel(["radiance"], "R")  # type: ignore[arg-type]


def test_a_data_set_is_a_sequence_of_its_frames(data_set: fg.Dataset) -> None:
    names = [frame.name for frame in data_set]
    assert len(data_set) == len(names) == 3 * IMAGES
    assert names == sorted(names)
    assert (data_set[0].name, data_set[-1].name, data_set[-len(names)].name) == (names[0], names[-1], names[0])
    assert [frame.name for frame in data_set[2:-1:2]] == names[2:-1:2]
    assert [frame.name for frame in reversed(data_set)] == names[::-1]
    for outside in (len(names), -len(names) - 1):
        with pytest.raises(IndexError, match=f"{len(names)} frames"):
            data_set[outside]
    assert data_set.frame(names[4]).name == names[4]
    with raises_error(fg.RecipeError, place="name"):
        data_set.frame("000009-near")
    assert names[4] in [frame.name for frame in iter(data_set)]
    assert not isinstance(data_set, Sequence)  # whose method `index` is another thing than this table
    assert data_set.index.column("frame").to_pylist() == names
    assert data_set.classes[data_set[0].semantic.max()] in ("ground", "fireweed")
    assert data_set.categories == {1: "fireweed"}


def test_a_split_is_its_frames_alone(data_set: fg.Dataset, tmp_path: Path) -> None:
    assert data_set.splits == ("train", "val")
    parts = {name: data_set.split(name) for name in data_set.splits}
    assert {name: len(part) for name, part in parts.items()} == {"train": 6, "val": 3}
    assert all(frame.split == name for name, part in parts.items() for frame in part)
    assert sorted(frame.name for part in parts.values() for frame in part) == [frame.name for frame in data_set]
    assert fg.Dataset(data_set.folder, "val")[0].name == parts["val"][0].name
    with raises_error(fg.RecipeError, place="split") as refused:
        data_set.split("test")
    assert refused.value.parameter == "split"
    for wrong in (["train"], 3):
        with raises_error(fg.RecipeError, place="split"):
            fg.Dataset(data_set.folder, split=wrong)  # type: ignore[arg-type]
        with raises_error(fg.RecipeError, place="name"):
            data_set.frame(wrong)  # type: ignore[arg-type]
    with raises_error(fg.RecipeError, place="name"):
        parts["val"].frame(parts["train"][0].name)
    packed = parts["val"].pack(tmp_path / "val", "webdataset", progress=False)
    assert {name: sum(one.frames for one in shards) for name, shards in packed.splits.items()} == {"val": 3}
    with raises_error(fg.RecipeError, place="splits"):
        parts["val"].pack(tmp_path / "train", "webdataset", splits="train", progress=False)


def test_a_run_into_an_object_store_says_that_its_frames_are_elsewhere() -> None:
    run = Run(RunSummary("s3://bucket/set", 1, 0, 1, (), (), 1, 1, None, 1.0))
    with raises_error(fg.RecipeError, place="set"):
        _ = run.dataset


def test_what_is_no_finished_data_set_is_refused(data_set: fg.Dataset, tmp_path: Path) -> None:
    copy = shutil.copytree(data_set.folder, tmp_path / "set")
    frame = fg.Dataset(copy)[0]
    (copy / frame.info["folder"] / "plants.parquet").unlink()
    with raises_error(fg.DatasetError, place="plants.parquet"):
        _ = frame.plants
    (copy / frame.info["folder"] / "preview.png").write_bytes(b"GIF89a")
    with raises_error(fg.DatasetError, place="preview.png"):
        _ = frame.preview
    (copy / "index.parquet").write_bytes(b"PAR1")
    with raises_error(fg.DatasetError, place="index.parquet"):
        fg.Dataset(copy)
    (copy / "dataset.json").unlink()
    with raises_error(fg.RecipeError, place="none"):
        fg.Dataset(tmp_path / "none")
    for folder in (copy, tmp_path):
        if folder == tmp_path:
            (copy / "dataset.json").write_text("{}")
        with raises_error(fg.RecipeError):
            fg.Dataset(folder)


@pytest.mark.parametrize("stored", [False, True])
def test_a_saved_frame_has_the_bytes_of_the_data_set(
    stored: bool, recipe: fg.Recipe, data_set: fg.Dataset, tmp_path: Path
) -> None:
    frames = list(data_set[:3]) if stored else list(recipe.frames(1, progress=False))
    for frame in frames:
        assert frame.save(tmp_path / "saved") == tmp_path / "saved" / frame.name
        assert tree(tmp_path / "saved" / frame.name) == tree(data_set.folder / frame.split / frame.name)
    assert len(list((tmp_path / "saved").iterdir())) == 3
    with raises_error(fg.OutputError):
        frames[0].save(tmp_path / "saved")


def test_a_saved_frame_of_a_painted_recipe_takes_its_maps_along(tmp_path: Path) -> None:
    """Made just now and read from a file; the stored recipe then makes the same frame again."""
    density = np.zeros((20, 30), np.uint8)
    density[:, 15:] = 200
    path = written(
        tmp_path / "recipe",
        ("{model: multiset_lsystem, program: succession, steps: 12}",
         "{model: deformation_kernel, plants: {fireweed: {count: 9, map: {file: meadow.png, fit: stretch}}}}"),
        ("splits: {train: 1, val: 1}", "splits: {train: 1}"),
    )  # fmt: skip
    Image.fromarray(density).save(path.with_name("meadow.png"))
    recipe = fg.load(path)
    split = recipe.render(tmp_path / "set", count=1, progress=False).dataset.folder / "train"
    maps = tree(split / "maps")
    assert list(maps.values()) == [path.with_name("meadow.png").read_bytes()]
    for name, frames in (("made", recipe.frames(1, progress=False)), ("read", fg.Dataset(tmp_path / "set"))):
        for frame in frames:
            frame.save(tmp_path / name)
            assert fg.load(frame).hash == fg.load(split / frame.name / "recipe.yaml").hash
            assert tree(tmp_path / name / frame.name) == tree(split / frame.name)
        assert tree(tmp_path / name / "maps") == maps
    shutil.rmtree(path.parent)
    again = fg.load(tmp_path / "made" / "000000-near" / "recipe.yaml")
    (frame, _) = again.frames(progress=False)
    assert same(frame.radiance, fg.Dataset(tmp_path / "set").frame("000000-near").radiance)


def test_hugging_face_opens_the_pictures_and_the_index(data_set: fg.Dataset, tmp_path: Path) -> None:
    pytest.importorskip("datasets")
    opened = data_set.as_huggingface()
    assert {name: len(split) for name, split in opened.items()} == {"train": 6, "val": 3}
    for split in opened.values():
        for row in split:
            frame = data_set.frame(row["frame"])
            for name in ("preview", "semantic"):
                assert np.array_equal(np.asarray(row[name]), getattr(frame, name)), name
            red, green, blue = np.moveaxis(np.asarray(row["instance"]).astype(np.uint32), -1, 0)
            assert np.array_equal(red + 256 * green + 65536 * blue, frame.instance)
            plain = {name: value for name, value in row.items() if name not in ("preview", "semantic", "instance")}
            assert plain == {name: frame.info[name] for name in plain}
            assert {"image", "camera", "sun_elevation_deg", "draw.sky.turbidity"} <= set(plain)
    assert list(data_set.split("val").as_huggingface()) == ["val"]
    copy = shutil.copytree(data_set.folder, tmp_path / "set")
    mask = copy / data_set[0].info["folder"] / "semantic.png"
    mask.rename(tmp_path / "outside.png")
    mask.symlink_to(tmp_path / "outside.png")
    with raises_error(fg.DatasetError, place="semantic.png"):
        fg.Dataset(copy).as_huggingface()


class Tensor:
    """In place of PyTorch's: what `from_numpy` was given, and refuses."""

    def __init__(self, array: np.ndarray) -> None:
        # PyTorch 2 has no other types; it warns of memory that must not be written to, and refuses negative strides.
        assert array.dtype in (np.bool_, np.uint8, np.int64, np.float32)
        assert array.flags.writeable
        assert array.flags.c_contiguous
        self.array = array


@pytest.fixture
def torch(monkeypatch: pytest.MonkeyPatch) -> types.ModuleType:
    """PyTorch is no dependency of the tests: as much of it as is used."""
    names = ("torch", "torch.utils", "torch.utils.data")
    package, utils, data = (types.ModuleType(name) for name in names)
    package.from_numpy, package.utils, utils.data = Tensor, utils, data  # type: ignore[attr-defined]
    data.Dataset = type("Dataset", (), {})  # type: ignore[attr-defined]
    for name, module in zip(names, (package, utils, data), strict=True):
        monkeypatch.setitem(sys.modules, name, module)
    return package


def doubled(item: dict[str, Any]) -> dict[str, Any]:
    return {name: 2 * tensor.array for name, tensor in item.items()}


def test_pytorch_gets_tensors(data_set: fg.Dataset, torch: types.ModuleType) -> None:
    names = [name for name in ARRAYS if name != "motion"]  # which a camera that stands has not
    frames = data_set.as_torch(names)
    assert isinstance(frames, torch.utils.data.Dataset)
    assert len(frames) == len(data_set)
    for number, frame in enumerate(data_set):
        item = {name: tensor.array for name, tensor in frames[number].items()}
        assert list(item) == names
        for name, array in item.items():
            own = getattr(frame, name)
            assert array.shape == (own.shape if own.ndim == 2 else (own.shape[2], *own.shape[:2])), name
            assert array.dtype == (np.int64 if own.dtype == np.uint32 else own.dtype), name
            moved = own if own.ndim == 2 else np.moveaxis(own, -1, 0)
            assert np.array_equal(array, moved, equal_nan=own.dtype.kind == "f"), name
    assert data_set.as_torch(["motion"])[0]["motion"].array.shape == (2, 16, 16)
    with raises_error(fg.RecipeError, place="channels") as refused:
        data_set.as_torch(["motion"])[2]
    assert (data_set[2].name, refused.value.got) == ("000000-near", "motion")
    assert list(data_set.as_torch()[0]) == ["preview", "semantic", "instance"]
    copy = pickle.loads(pickle.dumps(data_set.as_torch(["depth"], doubled)))  # as loaders send it to their processes
    assert np.array_equal(copy[-1]["depth"], 2 * data_set[-1].depth)
    for wrong in (["depths"], ["camera"], ["preview", "plants"]):
        with raises_error(fg.RecipeError, place="channels"):
            data_set.as_torch(wrong)


class Interrupts:
    """Follows the stages, and presses Ctrl-C in the n-th that has a title."""

    def __init__(self, title: str, number: int) -> None:
        self._title, self._left = title, number

    @contextmanager
    def stage(self, title: str, total: int) -> Iterator[Callable[[int], None]]:
        self._left -= title == self._title
        if title == self._title and not self._left:
            raise KeyboardInterrupt
        yield lambda steps: None


@pytest.mark.parametrize("number", slow_but([1, 5], 1))
def test_an_interrupted_render_goes_on(number: int, recipe: fg.Recipe, data_set: fg.Dataset, tmp_path: Path) -> None:
    """In the first image, so that nothing was made, not even a folder; and in the second frame of the second one."""
    target, done = tmp_path / "set", (number - 1) // 3
    with pytest.raises(KeyboardInterrupt):
        recipe.render(target, count=IMAGES, progress=Interrupts("radiance", number))
    assert target.exists() == bool(done)
    assert len(list(target.glob("*/*/frame.exr"))) == 3 * done
    assert not list((target / HIDDEN / "staging").glob("*"))
    with raises_error(fg.RecipeError, place="set"):
        fg.Dataset(target)
    run = recipe.render(target, count=IMAGES, resume=True, progress=False)
    assert (run.summary.already, run.summary.made) == (done, IMAGES - done)
    assert_same_files(target, data_set.folder)


SCRIPT = """\
import forestgen as fg

run = fg.load({recipe!r}).batch({out!r}, 3, workers=2, progress=False)
report = run.dataset.verify(workers=2, progress=False)
print(run.summary.made, len(run.dataset), report.ok, report.frames)
"""


@pytest.mark.slow
@pytest.mark.parametrize("way", ["a script", "standard input", "an argument"])
def test_workers_need_nothing_of_the_script_that_starts_them(way: str, tmp_path: Path) -> None:
    """No ``__main__`` guard, and no file either: they neither run it again nor look for it."""
    path = written(tmp_path, ("splits: {train: 1, val: 1}", "splits: {train: 1}"))  # six frames: enough for processes
    text = SCRIPT.format(recipe=str(path), out=str(tmp_path / "set"))
    (tmp_path / "script.py").write_text(text, encoding="utf-8")
    command = {"a script": [str(tmp_path / "script.py")], "standard input": ["-"], "an argument": ["-c", text]}[way]
    done = subprocess.run(
        [sys.executable, *command],
        input=text if way == "standard input" else "",
        capture_output=True,
        text=True,
        timeout=300,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "3 6 True 6\n"
