"""A data set that is replaced: gone when another has taken its place, back when none has."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import pytest

from forestgen.core.errors import OutputError, RecipeError
from forestgen.recipe.assets import recipes_dir
from forestgen.recipe.load import load_recipe
from forestgen.runs import replace, start, storage
from forestgen.runs.contract import Engine, Notice, Work
from forestgen.runs.folder import BATCH, BEGUN, PREVIOUS, note_written, settle_batch
from forestgen.runs.records import JOBS
from forestgen.runs.replace import foreign_files, previous_note, recover, replacing
from forestgen.runs.run import run_batch
from forestgen.runs.storage import LocalStorage
from forestgen.runs.summary import RunSummary
from forestgen.runs.verify import open_data_set
from support.displays import RecordingDisplay
from support.error_messages import raises_error

KEY = "000000-" + "0" * 40
QUICKSTART = recipes_dir() / "quickstart.yaml"


def ignore(_: str) -> None:
    """Takes what a run says."""


def data_set(root: Path, text: str = "old") -> LocalStorage:
    place = LocalStorage(root)
    root.mkdir(exist_ok=True)
    settle_batch(place, ["train"], "")
    (root / "dataset.json").write_text(text)
    return place


def finish_image(root: Path) -> None:
    (root / JOBS).mkdir(parents=True)
    (root / JOBS / f"{KEY}.json").write_text("{}")


def put(root: Path, *paths: str) -> None:
    for path in paths:
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text("own")


@contextmanager
def replaced(place: LocalStorage, say: Callable[[str], None] = ignore, *splits: str) -> Iterator[None]:
    """A run with `overwrite`."""
    with place.lock(), replacing(place, splits or ("train",), say, overwrite=True, keep_begun=True):
        yield


@contextmanager
def begun(place: LocalStorage, *, keep: bool = False) -> Iterator[None]:
    """A run without `overwrite`."""
    with place.lock(), replacing(place, ["train"], ignore, overwrite=False, keep_begun=keep):
        yield


def stopped(run: AbstractContextManager[None], work: Callable[[], object], error: type[BaseException]) -> None:
    """A run that breaks off."""
    with run:
        work()
        raise error


def new_one(root: Path, *paths: str, images: int = 0) -> Callable[[], object]:
    """What a run makes: a data set, files in it, finished images."""

    def make() -> None:
        data_set(root, "new")
        put(root, *paths)
        if images:
            finish_image(root)

    return make


def left_by_a_killed_run(root: Path) -> Path:
    """Move the data set to where a run that was killed while it replaced it has left it."""
    left = root.parent / "left"
    root.rename(left)
    (root / PREVIOUS).parent.mkdir(parents=True)
    return left.rename(root / PREVIOUS)


def hidden(root: Path) -> list[str]:
    """What lies in the hidden folder, but for the lock and the records."""
    known = ("lock", "batch.json", "jobs", "staging", "written.json")
    return [one.name for one in (root / ".forestgen").iterdir() if one.name not in known]


def test_a_new_data_set_takes_the_place_of_the_old_one(tmp_path: Path) -> None:
    root, said = tmp_path / "set", list[str]()
    place = data_set(root)
    put(root, ".git/HEAD")
    with replaced(place, said.append):
        assert not (root / "dataset.json").exists()
        data_set(root, "new")
        finish_image(root)
    assert (root / "dataset.json").read_text() == "new"
    assert (root / ".git/HEAD").read_text() == "own"  # of another tool
    assert [one.name for one in tmp_path.iterdir()] == ["set"]
    assert not hidden(root)
    assert len(said) == 1
    assert ".git" in said[0]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, None])
def test_the_old_one_comes_back_if_no_image_is_finished(tmp_path: Path, error: type[BaseException] | None) -> None:
    root = tmp_path / "set"
    place, work = data_set(root), new_one(root, "train/000001-near/frame.exr", "run/log.jsonl", "mine.txt")
    put(root, "train/000000-near/frame.exr")
    if error is None:  # all images have failed
        with replaced(place):
            work()
    else:
        with pytest.raises(error):
            stopped(replaced(place), work, error)
    assert (root / "dataset.json").read_text() == "old"
    assert (root / "mine.txt").read_text() == "own"  # that a user has put there meanwhile
    assert [path.name for path in (root / "train").iterdir()] == ["000000-near"]
    assert not (root / "run").exists()
    assert not hidden(root)


def test_a_finished_image_stays(tmp_path: Path) -> None:
    root = tmp_path / "set"
    place = data_set(root)
    with pytest.raises(KeyboardInterrupt):
        stopped(replaced(place), new_one(root, images=1), KeyboardInterrupt)
    assert (root / "dataset.json").read_text() == "new"
    assert not hidden(root)


def test_the_folder_may_be_a_link(tmp_path: Path) -> None:
    root, link = tmp_path / "set", tmp_path / "link"
    data_set(root)
    link.symlink_to(root)
    with replaced(LocalStorage(link)):
        data_set(link, "new")
        finish_image(link)
    assert link.is_symlink()
    assert (root / "dataset.json").read_text() == "new"


def test_an_absent_folder_has_nothing_to_replace(tmp_path: Path) -> None:
    place = LocalStorage(tmp_path / "absent")
    with replaced(place):
        data_set(place.root)
        finish_image(place.root)
    assert (place.root / BATCH).exists()
    assert not hidden(place.root)


def test_no_other_run_gets_in_between(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another run tries to begin before each thing that is moved: it is refused, and touches nothing."""
    root, tries, rename = tmp_path / "set", list[Path](), Path.rename
    place = data_set(root)
    put(root, "notes.txt", "train/mine/w.pt")

    def renamed(path: Path, target: Path) -> Path:
        with raises_error(OutputError, place="set"), LocalStorage(root).lock():
            raise AssertionError("two runs hold the lock")
        tries.append(path)
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", renamed)
    with pytest.raises(RuntimeError):
        stopped(replaced(place), new_one(root), RuntimeError)
    assert len(tries) > 6
    assert (root / "dataset.json").read_text() == "old"
    assert (root / "train/mine/w.pt").read_text() == "own"


class KilledError(BaseException):
    """The process is gone: nothing that it does afterwards has an effect."""


def killed_at(monkeypatch: pytest.MonkeyPatch, moment: int) -> list[int]:
    """Let the process die before its n-th folder is moved or removed; a list that counts them."""
    counted, changes = [0], (Path.rename, storage.shutil.rmtree)

    def dying(change: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            if counted[0] >= moment:
                raise KilledError
            counted[0] += 1
            return change(*arguments, **named)

        return call

    monkeypatch.setattr(Path, "rename", dying(changes[0]))
    monkeypatch.setattr(storage.shutil, "rmtree", dying(changes[1]))
    return counted


@pytest.mark.parametrize("images", [0, 1])
@pytest.mark.parametrize("has_records", [False, True])
def test_whenever_a_run_is_killed_nothing_is_lost(
    tmp_path: Path, images: int, has_records: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next run, which may be killed as well, finds the old data set or a finished image, and all users' files."""
    for moment, second in itertools.product(range(40), (2, 1000)):
        root, is_made = tmp_path / f"{moment}-{second}", False
        place = data_set(root)
        put(root, "train/000000-near/frame.exr", "train/mine/w.pt", "notes.txt", "run/log.jsonl")
        if has_records:
            finish_image(root)
        with monkeypatch.context() as patched:
            counted = killed_at(patched, moment)
            try:
                with replaced(place):
                    new_one(root, "train/000005-near/frame.exr", "since.txt", images=images)()
                    is_made = True
            except KilledError:
                counted = []
        for moments in (second, 1000):
            with monkeypatch.context() as patched:
                killed_at(patched, moments)
                try:
                    with place.lock():
                        recover(place, ignore)
                except KilledError:
                    pass
        assert (root / "train/mine/w.pt").read_text() == (root / "notes.txt").read_text() == "own"
        is_new = (root / "dataset.json").read_text() == "new"
        assert images or not is_new
        frame = "000005-near" if is_new else "000000-near"
        assert (root / "train" / frame / "frame.exr").exists()
        assert (root / JOBS / f"{KEY}.json").exists() == (has_records or is_new)
        assert (root / "since.txt").exists() == is_made
        assert not hidden(root)
        if counted:
            return
    raise AssertionError("the run was killed at all moments")


def test_the_old_one_comes_back_even_if_files_of_the_new_one_cannot_be_sorted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root, said = tmp_path / "set", list[str]()
    place = data_set(root)

    def failing(*_: Path) -> list[str]:
        raise RecursionError("too deep")

    with monkeypatch.context() as patched:
        patched.setattr(replace, "move_foreign", failing)
        with pytest.raises(RuntimeError):
            stopped(replaced(place, said.append), new_one(root, "mine.txt"), RuntimeError)
    assert (root / "dataset.json").read_text() == "old"
    assert f"{root / BEGUN} stays: too deep" in said[-1]
    assert (root / BEGUN / "mine.txt").exists()
    with place.lock():
        recover(place, ignore)
    assert (root / "mine.txt").read_text() == "own"
    assert not hidden(root)


OWN = ("notes.txt", "train/mine/w.pt", "train/extra.json", "run/training.log", ".git/HEAD", "train/labels.cache")


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
    with replaced(place, said.append):
        data_set(root, "new")
        finish_image(root)
        (root / "train").mkdir()
    assert [(root / path).read_text() for path in OWN] == ["own"] * len(OWN)
    assert (root / ".git/refs").is_dir()
    assert not (root / "train/coco.json").exists()
    assert not list(root.glob("**/000000-near")) + list(root.glob("run/log.jsonl"))
    assert "notes.txt, run/training.log, train/extra.json, train/labels.cache, train/mine" in said[0]
    assert [one.name for one in tmp_path.iterdir()] == ["set"]


def test_files_of_any_format_are_known_while_a_finished_data_set_is_resumed(tmp_path: Path) -> None:
    """A run that resumes removes SHA256SUMS first."""
    root = tmp_path / "set"
    place = data_set(root)
    note_written(place, ["sizes.txt", "train/sizes.json", "train/voc"])
    put(root, "sizes.txt", "train/sizes.json", "train/voc/a/b.xml", "train/vocal.txt", "sizes.txt.bak")
    assert foreign_files(root) == ["sizes.txt.bak", "train/vocal.txt"]


@pytest.mark.parametrize(
    "path", ["train/000000-near/mine.txt", "train/classes.json", "val", "val/manifest.json", "maps"]
)
def test_files_in_the_way_of_the_new_data_set_are_refused_before_it(tmp_path: Path, path: str) -> None:
    root = tmp_path / "set"
    place = data_set(root)
    put(root, "train/000000-near/frame.exr", path)
    (root / "SHA256SUMS").write_text(f"{'0' * 64}  train/000000-near/frame.exr\n{'0' * 64}  dataset.json\n")
    assert path.split("/")[0] in foreign_files(root) or path in foreign_files(root)
    with (
        raises_error(OutputError, place="set"),
        replaced(place, ignore, "train", "val"),
    ):
        raise AssertionError("the block must not run")
    assert (root / path).read_text() == "own"
    assert (root / "dataset.json").read_text() == "old"
    assert not hidden(root)


def test_a_dry_run_refuses_them_before_it_measures(tmp_path: Path) -> None:
    root = tmp_path / "set"
    data_set(root)
    put(root, "train/classes.json")
    (root / "SHA256SUMS").write_text(f"{'0' * 64}  dataset.json\n")
    told = RecordingDisplay()
    with raises_error(OutputError, place="set"):
        start.dry_run(load_recipe(QUICKSTART), str(root), start.RunOptions(overwrite=True), told)
    assert not told.said


def test_names_of_any_depth_and_letters_are_kept(tmp_path: Path) -> None:
    root = tmp_path / "set"
    place, deep, odd = data_set(root), "/".join(["d"] * 100), os.fsdecode(b"mine-\xff.txt")
    put(root, f"{deep}/frame.exr", f"{deep}/own.txt", odd)
    (root / "SHA256SUMS").write_text(f"{'0' * 64}  {deep}/frame.exr\n{'0' * 64}  dataset.json\n")
    with replaced(place):
        data_set(root, "new")
        finish_image(root)
    assert (root / deep / "own.txt").read_text() == (root / odd).read_text() == "own"
    assert not (root / deep / "frame.exr").exists()


def test_files_that_meet_others_of_their_name_are_kept_beside_them(tmp_path: Path) -> None:
    root = tmp_path / "set"
    place = data_set(root)
    put(root, "mine/a", "mine/b", ".DS_Store", "train/coco.json")
    with replaced(place):
        data_set(root, "new")
        finish_image(root)
        put(root, "mine/a", ".DS_Store", "train/coco.json")  # the last of a format that the old one had not
    assert sorted(path.name for path in (root / "mine").iterdir()) == ["a", "a.previous-1", "b"]
    assert not (root / ".DS_Store.previous-1").exists()
    assert (root / "train/coco.json.previous-1").read_text() == "own"


def test_a_data_set_that_could_not_be_removed_is_not_overwritten(tmp_path: Path) -> None:
    root = tmp_path / "set"
    data_set(root)
    previous = left_by_a_killed_run(root)
    place = data_set(root, "new")
    with raises_error(OutputError, place="previous"), replaced(place):
        raise AssertionError("the block must not run")
    assert (root / "dataset.json").read_text() == "old"  # without an image, the new one makes room
    assert not previous.exists()


def nobody(work: Work, notice: Notice) -> Engine:
    raise AssertionError("no work is done")


def dies(work: Work, left: int) -> Work:
    assert left == 1
    raise KilledError


@pytest.mark.parametrize("begin", [start.render, start.batch])
@pytest.mark.parametrize("images", [0, 1])
def test_what_a_killed_run_has_left_is_named_and_kept_until_a_run_may_go_on(
    tmp_path: Path, begin: Callable[..., RunSummary], images: int
) -> None:
    root, told, loaded = tmp_path / "set", RecordingDisplay(), load_recipe(QUICKSTART)
    data_set(root)
    previous = left_by_a_killed_run(root)
    put(root, "photo.jpg")
    if images:
        finish_image(root)
    with raises_error(RecipeError, place="set"):
        open_data_set(root)
    with raises_error(OutputError, place="set"):
        begin(loaded, str(root), start.RunOptions(), told)
    assert (previous / "dataset.json").read_text() == "old"  # a run that is refused removes nothing
    with pytest.raises(KilledError):  # when it is known how many images are left
        run_batch(loaded, str(root), start.RunOptions(count=1, overwrite=True), nobody, dies, display=told)
    assert (root / "dataset.json").exists() != bool(images)
    assert (root / "photo.jpg").exists()
    assert ("is removed" if images else "is back") in told.said[-1]
    assert previous_note(root) is None


def log_of(place: LocalStorage) -> None:
    """What a run leaves whose first image has failed."""
    place.write(BATCH, b"{}")
    place.write("run/log.jsonl", b"{}")
    place.clear_staging()


def test_a_run_that_made_nothing_leaves_no_folder(tmp_path: Path) -> None:
    place = LocalStorage(tmp_path / "a" / "b" / "out")
    with pytest.raises(KeyboardInterrupt):
        stopped(begun(place), lambda: log_of(place), KeyboardInterrupt)
    assert not list(tmp_path.iterdir())


def test_a_folder_that_was_there_stays_empty(tmp_path: Path) -> None:
    place = LocalStorage(tmp_path / "out")
    place.root.mkdir()
    with pytest.raises(ZeroDivisionError):
        stopped(begun(place), lambda: log_of(place), ZeroDivisionError)
    assert list(tmp_path.rglob("*")) == [place.root]


def test_files_that_a_user_adds_meanwhile_stay(tmp_path: Path) -> None:
    place = LocalStorage(tmp_path / "out")
    own = ("notes/mine.txt", "train/mine.txt")
    with pytest.raises(KeyboardInterrupt):
        stopped(begun(place), new_one(place.root, *own, "train/000000-near/frame.exr"), KeyboardInterrupt)
    left = sorted(path.relative_to(place.root).as_posix() for path in place.root.rglob("*") if path.is_file())
    assert left == list(own)


@pytest.mark.parametrize(("images", "keep", "before"), [(1, False, False), (0, True, False), (0, False, True)])
def test_finished_images_and_what_was_there_stay(tmp_path: Path, images: int, keep: bool, before: bool) -> None:
    place = LocalStorage(tmp_path / "out")
    if before:
        log_of(place)

    def work() -> None:
        log_of(place)
        if images:
            finish_image(place.root)

    with pytest.raises(ZeroDivisionError):
        stopped(begun(place, keep=keep), work, ZeroDivisionError)
    assert place.exists("run/log.jsonl")


def test_a_run_that_is_refused_leaves_nothing_but_what_was_there(tmp_path: Path) -> None:
    place = LocalStorage(tmp_path / "a" / "out")
    with place.lock(), raises_error(OutputError, place="out"), LocalStorage(place.root).lock():
        raise AssertionError("two runs hold the lock")
    assert not list(tmp_path.iterdir())
