"""A data set that is replaced: gone when another has taken its place, back when none has."""

from __future__ import annotations

from pathlib import Path

import pytest

from forestgen.core.errors import OutputError
from forestgen.runs.folder import BATCH, settle_batch
from forestgen.runs.places import LocalPlace
from forestgen.runs.records import JOBS
from forestgen.runs.replace import replacing

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
    with replacing(place):
        assert not (tmp_path / "set").exists()
        data_set(tmp_path / "set", "new")
    assert (tmp_path / "set/dataset.json").read_text() == "new"
    assert (tmp_path / "set/.git/HEAD").read_text() == "main"  # of another tool
    assert [one.name for one in tmp_path.iterdir()] == ["set"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_the_old_one_comes_back_if_no_image_is_finished(tmp_path: Path, error: type[BaseException]) -> None:
    place = data_set(tmp_path / "set")
    with pytest.raises(error), replacing(place):
        fails(tmp_path / "set", error)
    assert (tmp_path / "set/dataset.json").read_text() == "old"
    assert [one.name for one in tmp_path.iterdir()] == ["set"]


def test_a_finished_image_stays(tmp_path: Path) -> None:
    place = data_set(tmp_path / "set")
    with pytest.raises(KeyboardInterrupt), replacing(place):
        fails(tmp_path / "set", KeyboardInterrupt, done=True)
    assert (tmp_path / "set/dataset.json").read_text() == "new"
    assert [one.name for one in tmp_path.iterdir()] == ["set"]


def test_nothing_else_is_ever_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "holiday"
    folder.mkdir()
    (folder / "photo.jpg").write_text("me")
    with pytest.raises(OutputError, match="not empty"), replacing(LocalPlace(folder)):
        raise AssertionError("the block must not run")
    assert (folder / "photo.jpg").exists()
    with replacing(LocalPlace(tmp_path / "absent")):
        data_set(tmp_path / "absent")
    assert (tmp_path / "absent" / BATCH).exists()
