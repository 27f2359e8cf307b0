"""A data set that is replaced: gone when another has taken its place, back when none has."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from forestgen.core.errors import OutputError, RecipeError
from forestgen.dataset import folder as hidden
from forestgen.recipe.assets import recipes_dir
from forestgen.recipe.load import load_recipe
from forestgen.runs import start
from forestgen.runs.folder import BATCH, settle_batch
from forestgen.runs.places import LocalPlace
from forestgen.runs.records import JOBS
from forestgen.runs.replace import previous_beside, replacing, restore_previous
from forestgen.runs.strays import strays
from forestgen.runs.summary import RunSummary
from forestgen.runs.verify import open_data_set
from support.displays import RecordingDisplay

KEY = "000000-" + "0" * 40


def data_set(root: Path, text: str = "old") -> LocalPlace:
    place = LocalPlace(root)
    root.mkdir(exist_ok=True)
    settle_batch(place, ["train"], "")
    (root / "dataset.json").write_text(text)
    return place


def fails(root: Path, error: type[BaseException], *, done: bool = False) -> None:
    """A run that breaks off, before or after its first image."""
    data_set(root, "new")
    if done:
        (root / JOBS).mkdir()
        (root / JOBS / f"{KEY}.json").write_text("{}")
    raise error


def test_a_new_data_set_takes_the_place_of_the_old_one(tmp_path: Path) -> None:
    place = data_set(tmp_path / "set")
    (tmp_path / "set/.git").mkdir()
    (tmp_path / "set/.git/HEAD").write_text("main")
    with replacing(place, ["train"]):
        assert not (tmp_path / "set").exists()
        data_set(tmp_path / "set", "new")
    assert (tmp_path / "set/dataset.json").read_text() == "new"
    assert (tmp_path / "set/.git/HEAD").read_text() == "main"  # of another tool
    assert [one.name for one in tmp_path.iterdir()] == ["set"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_the_old_one_comes_back_if_no_image_is_finished(tmp_path: Path, error: type[BaseException]) -> None:
    place = data_set(tmp_path / "set")
    with pytest.raises(error), replacing(place, ["train"]):
        fails(tmp_path / "set", error)
    assert (tmp_path / "set/dataset.json").read_text() == "old"
    assert [one.name for one in tmp_path.iterdir()] == ["set"]


def test_a_finished_image_stays(tmp_path: Path) -> None:
    place = data_set(tmp_path / "set")
    with pytest.raises(KeyboardInterrupt), replacing(place, ["train"]):
        fails(tmp_path / "set", KeyboardInterrupt, done=True)
    assert (tmp_path / "set/dataset.json").read_text() == "new"
    assert [one.name for one in tmp_path.iterdir()] == ["set"]


def test_nothing_else_is_ever_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "holiday"
    folder.mkdir()
    (folder / "photo.jpg").write_text("me")
    with pytest.raises(OutputError, match="not empty"), replacing(LocalPlace(folder), ["train"]):
        raise AssertionError("the block must not run")
    assert (folder / "photo.jpg").exists()
    with replacing(LocalPlace(tmp_path / "absent"), ["train"]):
        data_set(tmp_path / "absent")
    assert (tmp_path / "absent" / BATCH).exists()


OWN = ("notes.txt", "train/mine/w.pt", "train/extra.json", "run/training.log", ".git/HEAD", "train/labels.cache")


def put(root: Path, *paths: str) -> None:
    for path in paths:
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text("own")


@pytest.mark.parametrize("finished", [False, True])
def test_files_of_others_move_into_the_new_data_set(tmp_path: Path, finished: bool) -> None:
    root = tmp_path / "set"
    place, said = data_set(root), list[str]()
    put(root, *OWN, "train/000000-near/.DS_Store", "run/log.jsonl")
    (root / ".git/refs").mkdir()  # an empty folder, without which it is no repository
    names = ["train/000000-near/frame.exr", "train/coco.json", "train/yolo/boxes/images/x.png", "dataset.json"]
    if finished:
        put(root, *names[:-1])
        (root / "SHA256SUMS").write_text("".join(f"{'0' * 64}  {name}\n" for name in names))
    with replacing(place, ["train"], said.append):
        data_set(root, "new")
        (root / "train").mkdir()
    assert [(root / path).read_text() for path in OWN] == ["own"] * len(OWN)
    assert (root / ".git/refs").is_dir()
    assert not (root / "train/coco.json").exists()
    assert not list(root.glob("**/000000-near")) + list(root.glob("run/log.jsonl"))
    assert "notes.txt, run/training.log, train/extra.json, train/labels.cache, train/mine" in said[0]
    assert [one.name for one in tmp_path.iterdir()] == ["set"]


@pytest.mark.parametrize("path", ["train/000000-near/mine.txt", "train/coco.json", "val", "val/coco.json", "maps"])
def test_files_in_the_way_of_the_new_data_set_are_refused_before_it(tmp_path: Path, path: str) -> None:
    root = tmp_path / "set"
    place = data_set(root)
    put(root, "train/000000-near/frame.exr", path)
    (root / "SHA256SUMS").write_text(f"{'0' * 64}  train/000000-near/frame.exr\n{'0' * 64}  dataset.json\n")
    assert path.split("/")[0] in strays(root) or path in strays(root)
    with pytest.raises(OutputError, match="files that forestgen has not written"), replacing(place, ["train", "val"]):
        raise AssertionError("the block must not run")
    assert (root / path).read_text() == "own"
    assert (root / "dataset.json").read_text() == "old"


def test_names_of_any_depth_and_letters_are_kept(tmp_path: Path) -> None:
    root = tmp_path / "set"
    place, deep, odd = data_set(root), "/".join(["d"] * 100), os.fsdecode(b"mine-\xff.txt")
    put(root, f"{deep}/frame.exr", f"{deep}/own.txt", odd)
    (root / "SHA256SUMS").write_text(f"{'0' * 64}  {deep}/frame.exr\n{'0' * 64}  dataset.json\n")
    said: list[str] = []
    with replacing(place, ["train"], said.append):
        data_set(root, "new")
    assert (root / deep / "own.txt").read_text() == (root / odd).read_text() == "own"
    assert not (root / deep / "frame.exr").exists()


def test_files_that_meet_others_of_their_name_are_kept_beside_them(tmp_path: Path) -> None:
    root = tmp_path / "set"
    place = data_set(root)
    put(root, "mine/a", "mine/b", ".DS_Store")
    with replacing(place, ["train"]):
        data_set(root, "new")
        put(root, "mine/a", ".DS_Store")
    assert sorted(path.name for path in (root / "mine").iterdir()) == ["a", "a.previous-1", "b"]
    assert not (root / ".DS_Store.previous-1").exists()


@pytest.mark.parametrize("done", [None, False, True])
@pytest.mark.parametrize("own_id", [False, True])
def test_what_a_killed_run_has_left_is_found(
    tmp_path: Path, done: bool | None, own_id: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The new data set: not begun, without an image, with one. A process may have the id of a dead one."""
    root = tmp_path / "set"
    place, said = data_set(root), list[str]()
    put(root, ".git/HEAD")
    with monkeypatch.context() as patched:
        patched.setattr(hidden, "_started", lambda pid: "1")
        if not own_id:
            patched.setattr(hidden.os, "getpid", lambda: 2**22 + 1)
        root.rename(tmp_path / hidden.hidden_name(root, "previous"))
    if done is not None:
        with pytest.raises(KeyboardInterrupt):
            fails(root, KeyboardInterrupt, done=done)
    put(root, "train/000000-near/frame.exr") if done is not None else None
    assert previous_beside(root) is not None
    restore_previous(place, said.append)
    assert (root / "dataset.json").read_text() == ("new" if done else "old")
    assert (root / ".git/HEAD").read_text() == "own"
    assert [one.name for one in tmp_path.iterdir()] == ["set"]
    assert len(said) == 1


def test_a_folder_of_something_else_is_not_replaced_by_what_was_left(tmp_path: Path) -> None:
    root = tmp_path / "set"
    place = data_set(root)
    left = tmp_path / hidden.hidden_name(root, "previous").replace(f"-{hidden._started(hidden.os.getpid())}-", "-1-")
    root.rename(left)
    put(root, "photo.jpg")
    restore_previous(place, print)
    assert (root / "photo.jpg").exists()
    assert (left / "dataset.json").exists()


@pytest.mark.parametrize("begin", [start.render, start.batch])
def test_every_run_finds_what_a_killed_one_has_left(tmp_path: Path, begin: Callable[..., RunSummary]) -> None:
    root, told = tmp_path / "set", RecordingDisplay()
    data_set(root)
    left = tmp_path / hidden.hidden_name(root, "previous").replace(f"-{hidden._started(hidden.os.getpid())}-", "-1-")
    root.rename(left)
    with pytest.raises(RecipeError, match="no such folder") as refused:
        open_data_set(root)
    assert str(left) in str(refused.value.hint)
    settle_batch(LocalPlace(root), ["train"], "")
    with pytest.raises(RecipeError, match="not finished") as refused:
        open_data_set(root)
    assert str(left) in str(refused.value.hint)
    with pytest.raises(OutputError, match="already holds a forestgen data set"):
        begin(load_recipe(recipes_dir() / "quickstart.yaml"), str(root), start.RunOptions(), told)
    assert (root / "dataset.json").read_text() == "old"
    assert "the previous data set is back" in told.said[0]
    assert not left.exists()
