"""Packs open in the loaders that they are made for, and hold the data set: nothing else, nothing less."""

from __future__ import annotations

import collections
import hashlib
import io
import json
import os
import shutil
import subprocess
import sys
import tarfile
import tracemalloc
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from command_line import run, tree
from pack_sets import CLASSES, PIXELS, SPLITS, annotations, batch, frames, many
from PIL import Image

from forestgen.core.errors import DatasetError, OutputError
from forestgen.core.progress import Silent
from forestgen.dataset.exr import read_exr
from forestgen.dataset.pack.pack import pack
from support.data_sets import read_instance
from support.error_messages import raises_error

EXAMPLE = Path(__file__).parents[2] / "examples" / "train_segmentation.py"
OPENER = Path(__file__).with_name("open_pack.py")


@pytest.fixture(scope="module")
def data_set(tmp_path_factory):
    return batch(tmp_path_factory.mktemp("packed") / "set")


@pytest.fixture
def copy(data_set, tmp_path):
    """A data set that a test may damage."""
    return shutil.copytree(data_set, tmp_path / "set")


def packed(root, target, form="webdataset", **options):
    return pack(root, target, form, **options, progress=Silent())


def picture(content: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(content)))


# WebDataset


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # the library leaves its files open
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_webdataset_opens_its_shards(data_set, tmp_path):
    import webdataset

    made = packed(data_set, tmp_path / "pack", shard_size=70_000)
    classes = json.loads((data_set / "train" / "classes.json").read_text())["semantic"]
    for split in SPLITS:
        expected = frames(data_set, split)
        urls = [str(tmp_path / "pack" / shard.name) for shard in made.splits[split]]
        assert len(urls) > 1 or split == "val"
        samples = list(
            webdataset.WebDataset(urls, shardshuffle=False).decode(webdataset.handle_extension("png", picture))
        )
        assert sorted(sample["__key__"] for sample in samples) == sorted(expected)
        for sample in samples:
            folder = expected[sample["__key__"]]
            r, g, b = np.moveaxis(sample["instance.png"].astype(np.uint32), -1, 0)
            np.testing.assert_array_equal(r + 256 * g + 65536 * b, read_instance(folder / "instance.png"))
            np.testing.assert_array_equal(sample["semantic.png"], np.asarray(Image.open(folder / "semantic.png")))
            assert sample["depth.png"].dtype == np.uint16
            assert sample["annotations.json"]["annotations"] == annotations(folder)
            about = sample["json"]
            assert about["camera"] == json.loads((folder / "camera.json").read_text())
            assert about["classes"] == classes
            assert about["depth_unit_m"] == 0.01
            assert about["index"]["frame"] == sample["__key__"]
            assert about["index"]["split"] == split
            pixels = sum(about["index"]["class_pixels"].values())
            assert pixels == PIXELS


def test_what_a_command_prints_opens_the_pack(data_set, tmp_path):
    answer = run("pack", data_set, "--format", "webdataset", "--out", tmp_path / "pack", "--shard-size", "60KB")
    assert answer.code == 0, answer.err
    lines = [line.strip() for line in answer.out.split("load it with\n")[1].splitlines()]
    assert len(lines) == 2
    program = "\n".join([*lines, "print(sorted(sample['__key__'] for sample in train))"])
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(sorted(frames(data_set, "train")))


def test_shards_hold_the_files_byte_for_byte_and_each_frame_once(data_set, tmp_path):
    channels = ("preview", "semantic", "instance", "depth", "overlay", "annotations", "plants", "exr")
    made = packed(data_set, tmp_path / "pack", channels=channels, shard_size=200_000)
    for split, shards in made.splits.items():
        seen = collections.Counter()
        for shard in shards:
            with tarfile.open(tmp_path / "pack" / shard.name) as tar:
                for member in tar:
                    frame, _, extension = member.name.partition(".")
                    seen[frame] += 1
                    assert (member.mtime, member.uid, member.uname) == (0, 0, "")
                    file = "frame.exr" if extension == "exr" else extension
                    if extension != "json":
                        assert tar.extractfile(member).read() == (data_set / split / frame / file).read_bytes()
        assert seen == dict.fromkeys(frames(data_set, split), len(channels) + 1)
        listed = json.loads((tmp_path / "pack" / f"{split}.json").read_text())["shardlist"]
        assert [(one["url"], one["nsamples"], one["filesize"]) for one in listed] == [
            (shard.name, shard.frames, (tmp_path / "pack" / shard.name).stat().st_size) for shard in shards
        ]


def test_arrays_are_those_of_the_exr(data_set, tmp_path):
    names = ("depth_m", "normal", "motion")
    packed(data_set, tmp_path / "pack", channels=names)
    with tarfile.open(tmp_path / "pack" / "val-000000.tar") as tar:
        found = {name: np.load(io.BytesIO(tar.extractfile(f"000001-camera0.{name}.npy").read())) for name in names}
    exr = read_exr(data_set / "val" / "000001-camera0" / "frame.exr")
    np.testing.assert_array_equal(found["depth_m"], exr["depth"]["Z"])
    assert np.isinf(found["depth_m"]).any()
    for i, layer in enumerate("XYZ"):
        np.testing.assert_array_equal(found["normal"][..., i], exr["normal"][layer])
    assert found["motion"].shape == (40, 60, 2)
    assert found["motion"].dtype == np.float32


# Hugging Face


@pytest.fixture(scope="module")
def opened(data_set, tmp_path_factory):
    """What Hugging Face's library says of a pack."""
    folder = tmp_path_factory.mktemp("huggingface")
    channels = ("preview", "semantic", "instance", "depth", "annotations", "plants")
    packed(data_set, folder / "pack", "huggingface", shard_size=70_000, channels=channels)
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(folder / "home"), "PYTHONWARNINGS": ""}
    command = [sys.executable, OPENER, folder / "pack", EXAMPLE]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=300)
    assert done.returncode == 0, done.stderr
    return folder / "pack", json.loads(done.stdout)


def test_huggingface_finds_pixels_ids_and_objects(data_set, opened):
    _, answer = opened
    assert set(answer["splits"]) == set(SPLITS)
    for split, rows in answer["splits"].items():
        assert set(rows) == set(frames(data_set, split))
        for name, folder in frames(data_set, split).items():
            row = rows[name]
            for column, file in (
                ("image", "preview"),
                ("semantic", "semantic"),
                ("instance", "instance"),
                ("depth",) * 2,
            ):
                pixels = np.asarray(Image.open(folder / f"{file}.png"))
                digest = hashlib.sha256(pixels.tobytes()).hexdigest()
                assert row[column] == [str(pixels.dtype), list(pixels.shape), digest], (name, column)
            plants, objects = annotations(folder), row["objects"]
            assert objects["plant_id"] == [one["plant_id"] for one in plants]
            assert objects["bbox"] == [one["bbox"] for one in plants]
            assert [one + 1 for one in objects["category"]] == [one["category_id"] for one in plants]
            assert objects["amodal_rle"] == [one["amodal_segmentation"]["counts"] for one in plants]
            assert bytes.fromhex(row["plants_parquet"]) == (folder / "plants.parquet").read_bytes()
            assert json.loads(row["camera_parameters"]) == json.loads((folder / "camera.json").read_text())
            assert (row["image_number"], row["camera"]) == (int(name[:6]), "camera0")
            assert sum(row["class_pixels"].values()) == PIXELS
            assert row["sun_elevation_deg"] == 30 + int(name[:6])
            assert row["instance_pixels_histogram"] == [int(name[:6]), 2]
            assert row["draw.sky.turbidity"] == 2.5
    assert sum(len(row["objects"]["bbox"]) for row in answer["splits"]["train"].values()) > 0


def test_huggingface_types_are_told_alike_in_files_and_readme(opened):
    folder, answer = opened
    assert answer["features"] == answer["card_features"]
    assert answer["builder_agrees"]
    assert answer["streamed"] == answer["order"]["train"]
    text = (folder / "README.md").read_text(encoding="utf-8")
    assert "### Weeds" in text
    assert "license: cc-by-4.0" in text.split("---\n")[1]
    assert "license" not in text.split("---\n")[2]


def test_the_example_reads_a_pack_with_no_code_of_ours(data_set, opened):
    folder, answer = opened
    example = answer["example"]
    assert example["classes"] == list(CLASSES)
    assert example["images"][:2] == ["float32", [len(SPLITS["train"]), 40, 60, 3]]
    assert 0 <= example["images"][2] < example["images"][3] <= 1
    masks = [picture((data_set / "train" / name / "semantic.png").read_bytes()) for name in answer["order"]["train"]]
    assert example["truth"] == hashlib.sha256(np.stack(masks).astype(np.int32).tobytes()).hexdigest()
    legend = json.loads((folder / "classes.json").read_text())
    assert example["palette"] == list(legend["semantic_colours"].values())
    source = EXAMPLE.read_text(encoding="utf-8")
    assert not [line for line in source.splitlines() if line.startswith(("import forestgen", "from forestgen"))]


def test_row_groups_are_bounded(data_set, tmp_path):
    frame = next(iter(frames(data_set, "train").values()))
    root = many(tmp_path / "many", frame, 230)
    made = packed(root, tmp_path / "pack", "huggingface", channels=("semantic",))
    (shard,) = made.splits["train"]
    file = pq.ParquetFile(tmp_path / "pack" / shard.name)
    assert [file.metadata.row_group(i).num_rows for i in range(file.num_row_groups)] == [100, 100, 30]


# Both


@pytest.mark.parametrize("form", ["webdataset", "huggingface"])
def test_no_file_is_larger_than_asked_for(data_set, tmp_path, form):
    for size in (1, 60_000, 150_000, 400_000, 10_000_000):
        made = packed(data_set, tmp_path / str(size), form, shard_size=size, channels=("preview", "exr", "annotations"))
        for split, shards in made.splits.items():
            assert sum(shard.frames for shard in shards) == len(SPLITS[split])
            for shard in shards:
                real = (tmp_path / str(size) / shard.name).stat().st_size
                assert shard.size_bytes == real
                assert real <= size or shard.frames == 1
    assert [len(shards) for shards in made.splits.values()] == [1, 1]


@pytest.mark.parametrize("form", ["webdataset", "huggingface"])
def test_a_pack_has_the_same_bytes_twice_and_its_seed_orders_it(data_set, tmp_path, form):
    first, again = (tmp_path / "a", tmp_path / "deeper" / "b")
    packed(data_set, first, form)
    packed(data_set, again, form)
    assert tree(first) == tree(again)
    assert order_of(first, form) != order_of(packed(data_set, tmp_path / "c", form, seed=5).folder, form)
    by_name = order_of(packed(data_set, tmp_path / "d", form, seed=None).folder, form)
    assert by_name == sorted(by_name)
    assert sorted(order_of(first, form)) == by_name


def order_of(folder: Path, form: str) -> list[str]:
    if form == "huggingface":
        return pq.read_table(folder / "data" / "train-00000-of-00001.parquet")["frame"].to_pylist()
    with tarfile.open(folder / "train-000000.tar") as tar:
        return [name.partition(".")[0] for name in tar.getnames() if name.endswith("preview.png")]


@pytest.mark.parametrize(("form", "few", "most"), [("webdataset", 10, 60), ("huggingface", 110, 230)])
def test_memory_does_not_grow_with_the_data_set(data_set, tmp_path, form, few, most):
    frame = next(iter(frames(data_set, "train").values()))
    peaks = []
    for copies in (few, most):
        folder = many(tmp_path / f"{copies}", frame, copies)
        tracemalloc.start()
        packed(folder, tmp_path / f"pack-{copies}", form, channels=("exr",), shard_size=4_000_000)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0]
    assert most * (frame / "frame.exr").stat().st_size > 1.5 * peaks[1]


def test_a_split_is_no_data_set_of_its_own(data_set, tmp_path):
    answer = run("pack", data_set / "val", "--format", "webdataset", "--out", tmp_path / "pack")
    answer.refused(2)
    assert not (tmp_path / "pack").exists()


def test_one_split_is_packed_alone(data_set, tmp_path):
    made = packed(data_set, tmp_path / "pack", splits=("val",))
    assert list(made.splits) == ["val"]
    assert not list((tmp_path / "pack").glob("train*"))


@pytest.mark.parametrize("form", ["webdataset", "huggingface"])
def test_a_damaged_file_leaves_no_half_a_pack(copy, tmp_path, form):
    mask = copy / "val" / "000004-camera0" / "semantic.png"
    mask.write_bytes(mask.read_bytes()[:-20])
    before = tree(tmp_path)
    with raises_error(DatasetError, place="semantic.png") as caught:
        packed(copy, tmp_path / "pack", form)
    assert caught.value.where == str(mask)
    assert tree(tmp_path) == before


def test_a_missing_file_is_found_before_anything_is_written(copy, tmp_path):
    (copy / "val" / "000004-camera0" / "instance.png").unlink()
    answer = run("pack", copy, "--format", "webdataset", "--out", tmp_path / "pack")
    answer.refused(6)
    assert not (tmp_path / "pack").exists()


@pytest.mark.parametrize("channels", [None, ("preview", "overlay")])
def test_a_channel_that_some_frames_lack_is_an_error_by_frame_and_file(copy, tmp_path, channels):
    """Whichever frame it is: the first must not decide alone, or the whole pack would lack the channel unsaid."""
    for name in ("train/000000-camera0", "val/000004-camera0"):
        file = copy / name / ("depth.png" if channels is None else "overlay.png")
        content = file.read_bytes()
        file.unlink()
        with raises_error(DatasetError) as caught:
            packed(copy, tmp_path / "pack", channels=channels)
        assert caught.value.where == str(file)
        file.write_bytes(content)
    assert not (tmp_path / "pack").exists()


def test_a_channel_that_no_frame_has_is_left_out(copy, tmp_path):
    for file in copy.glob("*/*/depth.png"):
        file.unlink()
    assert packed(copy, tmp_path / "pack").channels == ("preview", "semantic", "instance", "annotations")


def test_refusals_say_what_would_do(copy, tmp_path):
    def ask(*arguments, folder=copy, form="webdataset"):
        return run("pack", folder, "--format", form, "--out", tmp_path / "pack", *arguments)

    ask(form="tfrecord").refused(2)
    ask("--channels", "preview,normals").refused(2)
    ask("--channels", "preview,raw").refused(2)
    ask("--channels", ",").refused(2)
    ask("--split", "test").refused(2)
    for size in ("0MB", "ten", "-5MB", "5XB", "1e9"):
        ask("--shard-size", size).refused(2)
    ask(folder=tmp_path).refused(2)
    ask(folder=tmp_path / "none").refused(2)
    run("pack", copy, "--format", "webdataset", "--out", copy / "pack").refused(4)
    for frame in (*frames(copy, "train").values(), *frames(copy, "val").values()):
        (frame / "depth.png").unlink()
    ask("--channels", "depth").refused(2)
    (copy / ".forestgen" / "jobs").mkdir(parents=True)
    (copy / "index.parquet").write_bytes(b"PAR1 and no more")
    ask().refused(6)
    _refused_by_pack(copy)
    (copy / "dataset.json").rename(copy / "aside.json")
    ask().refused(2)
    (copy / "index.parquet").unlink()
    (copy / "aside.json").rename(copy / "dataset.json")
    ask().refused(6)
    _refused_by_pack(copy)
    assert not (tmp_path / "pack").exists()


def _refused_by_pack(root: Path) -> None:
    """By `pack` itself, which other programs may call."""
    with raises_error(DatasetError, place="index.parquet"):
        packed(root, root.parent / "pack")


def test_only_a_pack_is_replaced(data_set, tmp_path):
    target = tmp_path / "pack"
    target.mkdir()
    (target / "thesis.tex").write_text("years of work")
    arguments = ("pack", data_set, "--format", "webdataset", "--out", target)
    run(*arguments, "--overwrite").refused(4)
    (target / "thesis.tex").unlink()
    assert run(*arguments).code == 0
    before = tree(target)
    run(*arguments, "--by-name").refused(4)
    assert tree(target) == before
    assert run(*arguments, "--by-name", "--overwrite").code == 0
    assert tree(target) != before


def test_a_full_disk_is_seen_before(data_set, tmp_path, monkeypatch):
    usage = collections.namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(10**6, 10**6 - 100, 100))
    with raises_error(OutputError):
        packed(data_set, tmp_path / "pack")
    assert not (tmp_path / "pack").exists()


@pytest.mark.slow
def test_a_batch_is_packed_and_a_network_learns_from_it(tmp_path):
    """The commands of docs/packing.md, with fewer images; needs the example's libraries in uv's cache."""
    uv = shutil.which("uv")
    python = ("run", "--offline", "--no-project", "--script", EXAMPLE)
    if uv is None or subprocess.run([uv, *python, "--help"], capture_output=True).returncode:
        pytest.skip("the example's environment cannot be made without the network")
    recipe = EXAMPLE.with_suffix(".yaml")
    answer = run("batch", recipe, "--count", 4, "--out", tmp_path / "set", "--set", "dataset.splits={train: 1, val: 1}")
    assert answer.code == 0, answer.err
    assert run("pack", tmp_path / "set", "--format", "huggingface", "--out", tmp_path / "pack").code == 0
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path / "home")}
    picture = tmp_path / "learnt.png"
    command = [uv, *python, tmp_path / "pack", "--epochs", "8", "--picture", picture]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=1800)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "the network learns" in done.stdout
    assert Image.open(picture).size == (2 * 3 * 128, 2 * 6 * 96)
