"""A folder as a data set's place: names appear whole, and nothing outside is reached."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from forestgen.core.errors import DatasetError, OutputError
from forestgen.runs.remote_storage import storage_of
from forestgen.runs.storage import LocalStorage
from support.error_messages import raises_error


def staged(place: LocalStorage, **files: str) -> Path:
    folder = place.staging() / "frame"
    folder.mkdir()
    for name, text in files.items():
        (folder / name).write_text(text)
    return folder


def test_a_folder_replaces_what_has_its_name(tmp_path: Path) -> None:
    place = LocalStorage(tmp_path)
    place.put_folder(staged(place, a="1", b="2"), "train/x")
    place.put_folder(staged(place, c="3"), "train/x")
    assert {path.name: path.read_text() for path in (tmp_path / "train/x").iterdir()} == {"c": "3"}
    assert place.names("train") == ["x"]
    assert place.size_bytes("train/x/c") == 1
    assert place.size_bytes("train/x") is None


def test_files_are_read_written_and_removed(tmp_path: Path) -> None:
    place = LocalStorage(tmp_path / "new")
    assert place.read("a/b.json") is None
    place.write("a/b.json", b"1")
    place.write("a/b.json", b"22")
    assert place.read("a/b.json") == b"22"
    assert place.exists("a")
    assert place.read("a") is None
    assert place.names("a/b.json") == []
    place.remove("a/b.json")
    place.remove("a/b.json")
    place.remove("a")
    assert not place.exists("a")
    place.clear_staging()
    assert [path for path in (tmp_path / "new").rglob("*") if path.is_file()] == []


@pytest.mark.parametrize("path", ["../x", "/etc/passwd", "a/../../x", "..", "a\\..\\x"])
def test_no_path_leaves_the_folder(tmp_path: Path, path: str) -> None:
    place = LocalStorage(tmp_path / "data")
    (tmp_path / "x").write_text("mine")
    for reach in (place.read, place.remove, place.names, place.exists):
        with raises_error(DatasetError):
            reach(path)
    assert (tmp_path / "x").read_text() == "mine"


def test_a_link_is_removed_and_not_what_it_points_at(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/thesis.tex").write_text("words")
    place = LocalStorage(tmp_path / "data")
    place.write("train/a", b"")
    (tmp_path / "data/train/link").symlink_to(tmp_path / "mine", target_is_directory=True)
    place.remove("train/link")
    assert place.names("train") == ["a"]
    assert (tmp_path / "mine/thesis.tex").exists()


def test_a_file_in_the_way_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    place = LocalStorage(tmp_path / "file")
    with raises_error(OutputError, place="staging"):
        place.write("a", b"")


def test_what_cannot_be_read_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another user's folder: no bug, and not as if nothing were there."""
    place = LocalStorage(tmp_path)
    place.write("a/b", b"1")

    def forbidden(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", forbidden)
    monkeypatch.setattr(Path, "iterdir", forbidden)
    for ask, path in ((place.read, "a/b"), (place.names, "a")):
        with raises_error(OutputError):
            ask(path)


def test_a_target_is_a_folder_or_an_address(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    place = storage_of("outputs/forests")
    assert isinstance(place, LocalStorage)
    assert place.root == tmp_path / "outputs/forests"  # workers may live elsewhere
    assert place.name == "outputs/forests"
    assert storage_of("file://forests") == LocalStorage(tmp_path / "forests", "file://forests")
    assert storage_of(f"file://{tmp_path}") == LocalStorage(tmp_path, f"file://{tmp_path}")
