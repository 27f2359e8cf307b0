"""A run that resumes finds damage first: it makes damaged images again at once, and says what is missing at its end."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from batch_pieces import copied
from batch_pieces import recipe as recipe_of_pieces
from batch_pieces import shown as shown_pieces
from batch_runs import SerialEngine, assert_records_hold, faults_folder, recipe, serial, shown
from command_line import run
from pretend_jobs import FAULTS, begun, make

from forestgen.core.errors import DatasetError, OutputError
from forestgen.dataset.png import write_png
from forestgen.recipe.load import load_recipe
from forestgen.runs.contract import Job, JobRecord, Outcome, RunOptions, Work
from forestgen.runs.records import record_bytes, record_path
from forestgen.runs.run import run_batch
from forestgen.runs.stale_outputs import damaged_images
from forestgen.runs.start import _check_complete
from forestgen.runs.storage import LocalStorage
from forestgen.runs.work import make_job
from support.error_messages import raises_error

Harm = Callable[[Path], object]


@pytest.fixture
def faults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(FAULTS, "")
    return faults_folder(tmp_path)


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.unlink()  # it may be a link
    path.write_bytes(content)


def to_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def to_link(path: Path) -> None:
    elsewhere = path.parents[3] / "elsewhere.bin"
    shutil.move(path, elsewhere)
    path.symlink_to(elsewhere)


HARMS: dict[str, tuple[Harm, str]] = {
    "a bit": (flip, "has other content"),
    "cut": (lambda path: path.write_bytes(path.read_bytes()[:-1]), "bytes instead of"),
    "empty": (lambda path: path.write_bytes(b""), "has 0 bytes"),
    "removed": (Path.unlink, "is missing"),
    "a folder": (to_folder, "is no regular file"),
    "a link": (to_link, "is no regular file"),
    "a frame removed": (lambda path: shutil.rmtree(path.parent), "is missing"),
    "a fifo": (lambda path: (path.unlink(), os.mkfifo(path)), "is no regular file"),
}


@pytest.mark.parametrize("name", HARMS)
def test_a_damaged_image_is_made_again_in_the_same_run(name: str, tmp_path: Path, faults: Path) -> None:
    harm, problem = HARMS[name]
    path, target = recipe(tmp_path), tmp_path / "data"
    serial(path, target, 6, make)
    whole, before = shown(target), len(begun(faults))
    (harmed,) = target.glob("*/000003-left/mask.bin")
    where = harmed.relative_to(target).as_posix()
    harm(harmed)
    summary = serial(path, target, 6, make, resume=True)
    assert (summary.already, summary.made, summary.missing) == (5, 1, ())
    assert begun(faults)[before:] == [3]
    assert shown(target) == whole
    events = [json.loads(line) for line in (target / "run/log.jsonl").read_text().splitlines()]
    (event,) = [event for event in events if event["event"] == "image_damaged"]
    assert event["image"] == 3
    assert event["message"].startswith(f"{where} {problem}") or problem in event["message"]


def test_every_image_may_be_damaged(tmp_path: Path, faults: Path) -> None:
    path, target = recipe(tmp_path), tmp_path / "data"
    serial(path, target, 24, make)
    whole = shown(target)
    for preview in target.glob("*/*-right/preview.bin"):
        flip(preview)
    assert serial(path, target, 24, make, resume=True).made == 24
    assert shown(target) == whole
    assert len(assert_records_hold(target)) == 24


def test_an_image_lost_while_the_run_works_is_an_error(tmp_path: Path, faults: Path) -> None:
    """No job has failed, and yet the data set is not whole: exit code 6."""
    path, target = recipe(tmp_path), tmp_path / "data"
    serial(path, target, 3, make)

    def make_and_harm(work: Work, job: Job, attempt: int) -> Outcome:
        outcome = make(work, job, attempt)
        next(target.glob("*/000001-left/mask.bin")).write_bytes(b"cut")
        return outcome

    summary = serial(path, target, 4, make_and_harm, resume=True)
    assert (summary.failed, summary.missing) == ((), (1,))
    with raises_error(DatasetError, place="data"):
        _check_complete(summary)
    assert serial(path, target, 4, make, resume=True).missing == ()


def test_a_file_that_must_not_be_read_stops_the_run(tmp_path: Path, faults: Path, monkeypatch) -> None:
    """It may be whole: nothing is thrown away."""
    path, target = recipe(tmp_path), tmp_path / "data"
    serial(path, target, 2, make)
    before = shown(target)

    def refuse(path: Path) -> str:
        raise PermissionError(13, "Permission denied", str(path))

    with monkeypatch.context() as patched:
        patched.setattr("forestgen.runs.stale_outputs.file_sum", refuse)
        with raises_error(OutputError, place="mask.bin"):
            serial(path, target, 2, make, resume=True)
    assert shown(target) == before


def refuse_to_make(work: Work, job: Job, attempt: int) -> Outcome:
    raise AssertionError(f"image {job.image} is made again")


def resumed(whole: Path, root: Path, make_one: Callable[[Work, Job, int], Outcome]):
    loaded = load_recipe(whole.parent / "fireweed.yaml")
    return run_batch(loaded, str(root), RunOptions(count=4, resume=True), lambda work, _: SerialEngine(work, make_one))


@pytest.mark.slow
def test_files_over_all_images_are_written_again(whole: Path, tmp_path: Path) -> None:
    """All of them at once, and no image is rendered for it."""
    root = copied(whole, tmp_path / "set")
    merged = [path for path in root.glob("*/*") if path.is_file()] + [path for path in root.iterdir() if path.is_file()]
    placed = [path for path in root.glob("*/yolo/**/*") if path.is_file()]
    assert {"coco.json", "classes.json", "manifest.json", "index.parquet", "SHA256SUMS", "dataset.json"} <= {
        path.name for path in merged
    }
    for number, path in enumerate([*merged, *placed]):
        if number % 3 == 0:
            path.unlink()
        elif number % 3 == 1:
            flip(path)
        else:
            path.unlink()
            path.write_bytes(b"")
    (root / "train/strange.json").write_text("{}")
    summary = resumed(whole, root, refuse_to_make)
    assert (summary.made, summary.missing) == (0, ())
    assert shown_pieces(root) == shown_pieces(whole)
    shutil.rmtree(root / "thumbnails")
    assert resumed(whole, root, refuse_to_make).made == 0
    assert shown_pieces(root) == shown_pieces(whole)


@pytest.mark.slow
def test_a_damaged_share_of_a_merged_format_is_rendered_again(whole: Path, tmp_path: Path) -> None:
    """Of the same size as before, it would end up in coco.json."""
    root = copied(whole, tmp_path / "set")
    path = root / "train/000002-near/annotations.json"
    path.write_text(path.read_text().replace('"area":', '"Area":'))
    assert resumed(whole, root, make_job).made == 1
    assert shown_pieces(root) == shown_pieces(whole)


def test_a_damaged_map_is_restored_from_the_recipe(tmp_path: Path) -> None:
    """Thousands of images may share it, and none is rendered again for it."""
    home = tmp_path / "recipe"
    home.mkdir()
    write_png(home / "hill.png", np.arange(30, dtype=np.uint8).reshape(5, 6))
    loaded = recipe_of_pieces(home, ("terrain: flat", "terrain: {kind: map, map: hill.png, lowest_m: 0, highest_m: 1}"))
    content = (home / "hill.png").read_bytes()
    place, path = LocalStorage(tmp_path / "set"), "train/maps/0123456789abcdef.png"
    listed = {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
    for image in (0, 1):
        key = f"{image:06d}-{'0' * 40}"
        record = JobRecord(key, image, "train", 0, "0" * 64, (), {path: listed}, {})
        place.write(record_path(key), record_bytes(record))
    for damage in (None, b"", content[:-1] + b"x"):
        if damage is not None:
            place.write(path, damage)
        assert damaged_images(place, loaded, range(2), (), print) == {}
        assert place.read(path) == content
        place.remove(path)
    other = recipe_of_pieces(tmp_path / "other")
    place.write(path, content[:-1] + b"x")
    assert set(damaged_images(place, other, range(2), (), print)) == {0, 1}
    assert place.read(path) is None  # a worker leaves a map of the right size as it is


@pytest.mark.slow
def test_the_command_makes_damaged_images_again(whole: Path, tmp_path: Path) -> None:
    root = copied(whole, tmp_path / "set")
    flip(root / "val/000003-high/semantic.png")
    answer = run(
        *("batch", whole.parent / "fireweed.yaml", "--count", "4", "--out", root, "--resume", "--workers", "1")
    )
    assert answer.code == 0, answer.err
    assert "image 3 is made again: val/000003-high/semantic.png has other content" in answer.err
    assert "4 of 4 images done, 3 of them before" in answer.out
    assert shown_pieces(root) == shown_pieces(whole)
