"""Files that other tools leave in a data set's folder are no damage: they are named, kept, and not merged."""

from __future__ import annotations

from pathlib import Path

import pytest
from batch_pieces import copied, shown
from batch_runs import SerialEngine
from command_line import run

from forestgen.dataset.check.run import check_dataset
from forestgen.dataset.settings import data_set_of
from forestgen.recipe.load import load_recipe
from forestgen.runs.contract import Job, Outcome, RunOptions, Work
from forestgen.runs.finish import finish
from forestgen.runs.folder import tool_of
from forestgen.runs.records import records_of
from forestgen.runs.run import run_batch
from forestgen.runs.storage import LocalStorage
from forestgen.runs.verify import verify

FOREIGN = {
    "train/yolo/boxes/labels.cache": "Ultralytics",
    "val/yolo/segmentation/labels.cache": "Ultralytics",
    ".cache/huggingface/x.json": "Hugging Face",
    ".huggingface/token": "Hugging Face",
    "train/fiftyone.yml": "FiftyOne",
    ".DS_Store": "macOS",
    "train/000000-near/.DS_Store": "macOS",
    "thumbnails/Thumbs.db": "Windows",
    "desktop.ini": "Windows",
    "train/.ipynb_checkpoints/a-checkpoint.png": "Jupyter",
    "train/yolo/__pycache__/x.pyc": "Python",
    ".git/config": "Git",
    ".gitattributes": "Git",
    "train.dvc": "DVC",
    ".dvc/config": "DVC",
    "train/yolo/boxes/labels/.nfs000000000001": "a network file system",
    "train/yolo/boxes/labels/000000-near.txt~": "an editor",
    "train/.coco.json.swp": "an editor",
}


@pytest.fixture
def used(whole: Path, tmp_path: Path) -> Path:
    """A data set that other tools have worked with."""
    root = copied(whole, tmp_path / "used")
    for path in FOREIGN:
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text("of another tool")
    (root / "train/.ipynb_checkpoints/empty").mkdir()
    return root


@pytest.mark.parametrize(("path", "tool"), FOREIGN.items())
def test_the_tool_is_named(path: str, tool: str) -> None:
    assert tool_of(path) == tool


@pytest.mark.parametrize("path", ["train/coco.json", "notes.txt", "train/000000-near/frame.exr", "a.cached", "git"])
def test_other_files_are_of_no_tool(path: str) -> None:
    assert tool_of(path) is None


def test_no_file_of_a_data_set_looks_foreign(whole: Path) -> None:
    assert [path for path in shown(whole) if tool_of(path) is not None] == []


def test_verify_names_them_in_a_note(used: Path) -> None:
    report = verify(used, workers=1)
    assert report.findings == ()
    (note,) = report.notes
    assert all(f"{path} ({tool})" in note for path, tool in FOREIGN.items())
    (used / "train/yolo/boxes/labels.txt").touch()
    assert [one.file for one in verify(used, labels=False, workers=1).findings] == ["train/yolo/boxes/labels.txt"]
    assert check_dataset(used / "train", jobs=1).findings == ()


def refuse_to_make(work: Work, job: Job, attempt: int) -> Outcome:
    raise AssertionError(f"image {job.image} is made again")


def test_resume_keeps_them(whole: Path, used: Path) -> None:
    loaded = load_recipe(whole.parent / "fireweed.yaml")
    summary = run_batch(
        loaded, str(used), RunOptions(count=4, resume=True), lambda work, _: SerialEngine(work, refuse_to_make)
    )
    assert summary.missing == ()
    assert {path: (used / path).read_text() for path in FOREIGN} == dict.fromkeys(FOREIGN, "of another tool")
    own = {path: content for path, content in shown(used).items() if path not in FOREIGN}
    assert own == shown(whole)


def test_a_frame_that_goes_takes_them_with_it(whole: Path, used: Path) -> None:
    """A folder of a frame that is none would be taken for a damaged one."""
    (used / "train/000009-near").mkdir()
    (used / "train/000009-near/.DS_Store").touch()
    place = LocalStorage(used)
    loaded = load_recipe(whole.parent / "fireweed.yaml")
    jobs = [Job(one.image, one.image, one.split, one.key) for one in records_of(place)]
    finish(place, loaded, data_set_of(loaded.draw(0)), jobs, records_of(place))
    assert not (used / "train/000009-near").exists()
    assert (used / "train/000000-near/.DS_Store").exists()


def test_merge_leaves_them_out(whole: Path, used: Path, tmp_path: Path) -> None:
    answer = run("merge", used, "-o", tmp_path / "merged")
    assert answer.code == 0, answer.err
    assert not any((tmp_path / "merged" / path).exists() for path in FOREIGN)
    assert verify(tmp_path / "merged", labels=False, workers=1).notes == ()
    assert set(shown(tmp_path / "merged")) == set(shown(whole))
