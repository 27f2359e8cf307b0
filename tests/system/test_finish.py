"""The files over all images: the same bytes from the same records, and nothing that no record vouches for."""

from __future__ import annotations

import errno
import json
import os
import random
import shutil
import subprocess
import tracemalloc
from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from batch_pieces import copied, finished, jobs_of, recipe, shown
from ruamel.yaml import YAML

from forestgen.core.errors import OutputError
from forestgen.dataset.check.run import check_dataset
from forestgen.dataset.manifest import is_run_folder
from forestgen.dataset.settings import DatasetSettings, data_set_of
from forestgen.recipe.load import load_recipe
from forestgen.recipe.map_files import recipe_hash
from forestgen.runs import record_index
from forestgen.runs.contract import Job, JobRecord
from forestgen.runs.finish import finish
from forestgen.runs.records import record_bytes, record_path, records_of
from forestgen.runs.storage import LocalStorage
from support.error_messages import raises_error


@pytest.fixture
def loaded(whole):
    return load_recipe(whole.parent / "fireweed.yaml")


def known_jobs(root: Path, loaded) -> list[Job]:
    """The jobs of the records that are there."""
    return [Job(one.image, one.image, one.split, one.key) for one in records_of(LocalStorage(root))]


def test_twice_is_once_in_any_order_of_records(whole, loaded, tmp_path):
    expected = shown(whole)
    root = copied(whole, tmp_path / "again")
    jobs, records = known_jobs(root, loaded), list(records_of(LocalStorage(root)))
    random.Random(1).shuffle(records)
    done = finished(loaded, jobs[::-1], root, records)
    assert (done.frames, done.missing, done.notes) == (8, (), ())
    assert done.bytes == sum(len(content) for name, content in expected.items() if name != "SHA256SUMS")
    assert shown(root) == expected
    assert not list((root / ".forestgen" / "staging").iterdir())


def test_sums_are_those_of_all_files(whole):
    answer = subprocess.run(["sha256sum", "--check", "--strict", "--quiet", "SHA256SUMS"], cwd=whole, check=False)
    assert answer.returncode == 0
    listed = {line[66:] for line in (whole / "SHA256SUMS").read_text().splitlines()}
    assert listed == set(shown(whole)) - {"SHA256SUMS"}


def test_each_split_is_a_data_set(whole):
    assert is_run_folder(whole / "train")
    report = check_dataset(whole / "train", jobs=1)
    assert report.findings == ()
    assert report.frames == 4
    manifest = json.loads((whole / "train" / "manifest.json").read_text())
    assert not {"timings_s", "peak_memory_bytes"} & set(manifest)
    assert "coco.json" in manifest["files"]
    assert [one["image"] for one in manifest["run"]["images"]] == [0, 2]


def test_the_kept_recipe_draws_the_same_images(whole):
    again = load_recipe(whole / "recipe.yaml")
    assert again.images == 4
    for record in records_of(LocalStorage(whole)):
        assert recipe_hash(again.draw(record.image).data) == record.recipe_hash


def test_the_index_counts_what_coco_counts(whole):
    table = pq.read_table(whole / "index.parquet").to_pylist()
    assert [row["frame"] for row in table] == sorted(row["frame"] for row in table)
    for split in ("train", "val"):
        coco = json.loads((whole / split / "coco.json").read_text())
        rows = {row["frame"]: row for row in table if row["split"] == split}
        assert len(rows) == len(coco["images"]) == 4
        for image in coco["images"]:
            row = rows[image["file_name"].partition("/")[0]]
            own = [one for one in coco["annotations"] if one["image_id"] == image["id"]]
            assert (row["width_px"], row["height_px"]) == (image["width"], image["height"])
            assert row["plants_in_view"] == len(own)
            assert dict(row["species_pixels"]).get("fireweed", 0) == sum(one["area"] for one in own)
            assert sum(dict(row["class_pixels"]).values()) == image["width"] * image["height"]
    assert len({row["draw.sky.sun.elevation_deg"] for row in table}) == 4
    assert all(row["draw.sky.sun.elevation_deg"] == row["sun_elevation_deg"] for row in table)


def test_merged_pictures_are_links(whole):
    """On a file system with links, no picture is there twice."""
    placed = whole / "train/yolo/boxes/images/000000-near.png"
    assert placed.stat().st_ino == (whole / "train/000000-near/preview.png").stat().st_ino


def test_trainers_find_each_split_in_one_file(whole, loaded, tmp_path):
    for task in ("boxes", "segmentation"):
        read = YAML(typ="safe").load(whole / f"yolo_{task}.yaml")
        own = YAML(typ="safe").load(whole / f"train/yolo/{task}/data.yaml")
        assert read["names"] == own["names"]
        frames = {}
        for split in ("train", "val"):
            images = sorted((whole / read[split]).glob("*.png"))
            frames[split] = {path.stem for path in images}
            assert frames[split] == {path.parent.name for path in whole.glob(f"{split}/*/preview.png")}
            labels = [path.parent.parent / "labels" / f"{path.stem}.txt" for path in images]
            assert all(path.is_file() for path in labels)
        assert frames["train"]
        assert frames["val"]
        assert not frames["train"] & frames["val"]
    # A recipe that asks for no YOLO any more leaves none behind.
    root = copied(whole, tmp_path / "set")
    settings = data_set_of(loaded.draw(0))
    bare = replace(settings, formats=("coco",))
    finish(LocalStorage(root), loaded, bare, known_jobs(root, loaded), list(records_of(LocalStorage(root))))
    assert not list(root.glob("yolo*"))


def test_what_no_record_vouches_for_goes(whole, loaded, tmp_path):
    root = copied(whole, tmp_path / "set")
    expected = shown(root)
    shutil.copytree(root / "train/000000-near", root / "train/000009-near")
    shutil.copytree(root / "train/yolo", root / "holdout/yolo")
    (root / "train/000000-near/extra.txt").write_text("mine")
    (root / "train/yolo/boxes/labels/000009-near.txt").write_text("")
    (root / "thumbnails/000009-near.jpg").write_bytes(b"")
    (root / "val/000777-near").mkdir()
    (root / "notes.txt").write_text("a user's own, beside the splits")
    finished(loaded, known_jobs(root, loaded), root)
    assert set(shown(root)) - set(expected) == {"notes.txt"} | {
        name for name in shown(root) if name.startswith("holdout/")
    }
    assert {name: content for name, content in shown(root).items() if name in expected} == expected
    assert not (root / "val/000777-near").exists()


def test_fewer_images_and_a_split_less(whole, loaded, tmp_path):
    """A smaller count leaves the data set that the smaller count makes, and no record without its frames."""
    root = copied(whole, tmp_path / "set")
    jobs = [job for job in known_jobs(root, loaded) if job.image in (0, 2)]
    done = finished(loaded, jobs, root)
    alone = copied(whole, tmp_path / "alone", [0, 2])
    assert finished(loaded, jobs, alone) == done
    assert shown(root) == shown(alone)
    assert not (root / "val").exists()
    assert [one.image for one in records_of(LocalStorage(root))] == [0, 2]


def test_an_image_that_lost_a_file_counts_as_missing(whole, loaded, tmp_path):
    root = copied(whole, tmp_path / "set")
    jobs = known_jobs(root, loaded)
    path = root / "val/000001-near/plants.parquet"
    path.write_bytes(path.read_bytes()[:-1])
    done = finished(loaded, jobs, root)
    assert done.missing == (1,)
    assert "val/000001-near/plants.parquet" in done.notes[0]
    assert [one.image for one in records_of(LocalStorage(root))] == [0, 2, 3]
    assert not list(root.glob("*/000001-*"))
    said = json.loads((root / "dataset.json").read_text())
    assert said["recipes"][0]["missing"] == [[1, 1]]
    assert said["splits"]["val"] == {"images": 1, "frames": 2}
    assert "1 images" in (root / "README.md").read_text()


def test_a_damaged_share_is_named_and_nothing_changes(whole, loaded, tmp_path):
    root = copied(whole, tmp_path / "set")
    path = root / "train/000002-near/annotations.json"
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2].ljust(len(content)))
    before = shown(root)
    with raises_error(OutputError, place="annotations.json"):
        finished(loaded, known_jobs(root, loaded), root)
    assert shown(root) == before
    assert not list((root / ".forestgen" / "staging").iterdir())


def test_a_disk_that_fills_meanwhile_is_told(whole, loaded, tmp_path, monkeypatch):
    root = copied(whole, tmp_path / "set")
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "/tmp/SHA256SUMS", None, str(root / "SHA256SUMS"))

    def write_sums(path, sums):
        raise full

    with monkeypatch.context() as patched:
        patched.setattr("forestgen.runs.finish.write_sums", write_sums)
        with raises_error(OutputError, place="SHA256SUMS"):
            finished(loaded, known_jobs(root, loaded), root)
    assert not (root / "dataset.json").exists() or shown(root) == shown(whole)
    finished(loaded, known_jobs(root, loaded), root)
    assert shown(root) == shown(whole)


def test_a_full_temporary_folder_is_told(whole, loaded, tmp_path, monkeypatch):
    """By the table of all files, which SQLite keeps there."""
    monkeypatch.setattr("forestgen.runs.record_index._TABLES", record_index._TABLES + "PRAGMA max_page_count = 12;")
    with raises_error(OutputError, place="forestgen-records"):
        finished(loaded, known_jobs(whole, loaded), copied(whole, tmp_path / "set"))


def test_no_images_at_all(loaded, tmp_path):
    done = finished(loaded, jobs_of(loaded, range(2)), tmp_path / "none", [])
    assert (done.frames, done.missing) == (0, (0, 1))
    assert sorted(path.name for path in (tmp_path / "none").iterdir() if not path.name.startswith(".")) == [
        "README.md",
        "SHA256SUMS",
        "dataset.json",
        "index.parquet",
        "recipe.yaml",
    ]


def test_a_recipe_with_a_map_is_kept_with_it(tmp_path):
    """Moved elsewhere, the recipe of the data set draws what it drew."""
    import numpy as np

    from forestgen.dataset.png import write_png

    home = tmp_path / "recipe"
    home.mkdir()
    write_png(home / "hill.png", np.arange(30, dtype=np.uint8).reshape(5, 6))
    loaded = recipe(home, ("terrain: flat", "terrain: {kind: map, map: hill.png, lowest_m: 0, highest_m: 1}"))
    finished(loaded, jobs_of(loaded, range(1)), tmp_path / "set", [])
    (home / "hill.png").unlink()
    again = load_recipe(tmp_path / "set" / "recipe.yaml")
    assert recipe_hash(again.draw(0).data) == recipe_hash(loaded.draw(0).data)
    listed = (tmp_path / "set" / "SHA256SUMS").read_text()
    assert "  maps/" in listed


def write_synthetic(root: Path, images: int) -> None:
    """Records of made-up images, a file each."""
    for image in range(images):
        frame = f"{image:06d}-eye"
        path = root / "train" / frame / "data.bin"
        path.parent.mkdir(parents=True)
        path.write_bytes(b"x")
        row = {"frame": frame, "folder": f"train/{frame}", "split": "train", "image": image, "notes": ["a note " * 200]}
        said = {"bytes": 1, "sha256": "2d711642b726b04401627ca9fbac32f5c8530fb1903cc4db02258717921a4881"}
        key = f"{image:06d}-{image:040x}"
        record = JobRecord(key, image, "train", image, "0" * 64, (row,), {f"train/{frame}/data.bin": said}, {})
        (root / record_path(key)).parent.mkdir(parents=True, exist_ok=True)
        (root / record_path(key)).write_bytes(record_bytes(record))


def peak_bytes(loaded, root: Path, images: int) -> int:
    jobs = [Job(image, image, "train", f"{image:06d}-{image:040x}") for image in range(images)]
    settings = DatasetSettings(("fireweed",), ("nothing", "ground", "fireweed"), ("fireweed",), (0,), formats=())
    write_synthetic(root, images)
    place = LocalStorage(root)
    tracemalloc.start()
    done = finish(place, loaded, settings, jobs, records_of(place))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert done.frames == images
    return peak


def test_memory_does_not_grow_with_the_records(loaded, tmp_path):
    """A record takes 3 kB in its file: of hundreds more, less than 1 kB each stays: names, sums, and their tables."""
    peak_bytes(loaded, tmp_path / "first", 10)  # libraries
    few, many = peak_bytes(loaded, tmp_path / "few", 300), peak_bytes(loaded, tmp_path / "many", 700)
    assert many - few < 400 * 1000


class Store:
    """An object store's place, as `finish` knows it by what it offers, in a folder: no root, and staging elsewhere."""

    def __init__(self, home: Path, elsewhere: Path) -> None:
        self._home, self._elsewhere, self._local = home, elsewhere, LocalStorage(home)
        for name in ("write", "read", "names", "remove"):
            setattr(self, name, getattr(self._local, name))
        self.name = "store://bucket"
        self.fetched: list[str] = []

    def staging(self) -> Path:
        self._elsewhere.mkdir()
        return self._elsewhere

    def discard(self, staging: Path) -> None:
        shutil.rmtree(staging)

    def put_file(self, source: Path, target: str) -> None:
        self._local.write(target, source.read_bytes())

    def found(self, folder: str) -> list[tuple[str, int, int]]:
        paths = [path for path in (self._home / folder).rglob("*") if path.is_file()]
        return [(path.relative_to(self._home).as_posix(), path.stat().st_size, 0) for path in paths]

    def fetch(self, paths, folder: Path) -> None:
        for path in paths:
            self.fetched.append(path)
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(self._home / path, folder / path)

    def upload(self, folder: Path, target: str) -> None:
        for path in (one for one in folder.rglob("*") if one.is_file()):
            self.put_file(path, f"{target}/{path.relative_to(folder).as_posix()}")

    def link(self, pairs) -> None:
        for source, target in pairs:
            self._local.write(target, (self._home / source).read_bytes())


def test_an_object_store_gets_the_same_bytes(whole, loaded, tmp_path):
    """What lies there unasked goes; no picture and no EXR passes through this machine."""
    home = copied(whole, tmp_path / "store", range(4))
    (home / "train/yolo/boxes/labels").mkdir(parents=True)
    (home / "train/yolo/boxes/labels/000009-near.txt").write_text("left over")
    store = Store(home, tmp_path / "staging")
    done = finish(store, loaded, data_set_of(loaded.draw(0)), known_jobs(home, loaded), records_of(LocalStorage(home)))
    assert (done.frames, done.missing) == (8, ())
    assert shown(home) == shown(whole)
    assert {Path(path).suffix for path in store.fetched} == {".json", ".txt"}
