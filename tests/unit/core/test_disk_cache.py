"""A folder of results that can be made again."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from forestgen.core import cache as disk_cache
from forestgen.core.cache import ENVIRONMENT, DiskCache, cache_root

HEAD_BYTES = 64


def test_what_was_written_is_read(tmp_path: Path) -> None:
    cache = DiskCache(tmp_path / "deep" / "folder", 10**6)
    assert cache.read("a") is None
    assert cache.write("a", b"first")
    assert cache.write("a", b"second")
    found = cache.read("a")
    assert found is not None
    assert found.tobytes() == b"second"
    assert cache.size_bytes() == (1, HEAD_BYTES + 6)
    cache.drop("a")
    assert cache.read("a") is None
    cache.drop("a")


def test_the_entries_used_longest_ago_go_first(tmp_path: Path) -> None:
    cache = DiskCache(tmp_path, 5000)
    now = time.time()
    for number in range(8):
        cache.write(str(number), bytes(1000 - HEAD_BYTES))
        os.utime(tmp_path / f"{number}.entry", (now - 100 + number, now - 100 + number))
    assert cache.read("0") is not None  # now the one used last
    cache.trim()
    kept = {name for name in "01234567" if (tmp_path / f"{name}.entry").exists()}
    assert kept == {"0", "5", "6", "7"}  # 90% of 5000 bytes hold four
    cache.trim()
    assert cache.size_bytes() == (4, 4000)


def test_what_a_dead_process_left_goes_and_what_is_being_written_stays(tmp_path: Path) -> None:
    old, fresh = tmp_path / "x.partial", tmp_path / "y.partial"
    old.write_bytes(b"0")
    fresh.write_bytes(b"0")
    os.utime(old, (1.0, 1.0))
    DiskCache(tmp_path, 10).trim()
    assert not old.exists()
    assert fresh.exists()


def test_a_folder_that_cannot_be_used_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "file"
    file.write_text("not a folder")
    cache = DiskCache(file / "exemplars", 100)
    assert not cache.write("a", b"1")
    assert cache.read("a") is None
    cache.trim()
    assert cache.size_bytes() == (0, 0)
    full = DiskCache(tmp_path / "full", 100)
    monkeypatch.setattr(disk_cache, "_LEAST_FREE_BYTES", 10**18)
    assert not full.write("a", b"1")
    assert full.read("a") is None


CONTENT = np.random.default_rng(3).integers(0, 256, 300, dtype=np.uint8).tobytes()


def test_any_flipped_bit_and_any_cut_is_a_miss_and_is_removed(tmp_path: Path) -> None:
    cache, path = DiskCache(tmp_path, 10**6), tmp_path / "a.entry"
    assert cache.write("a", CONTENT)
    whole = path.read_bytes()
    flipped = (
        whole[:at] + bytes([whole[at] ^ 1 << at % 8]) + whole[at + 1 :] for at in range(len(whole)) if not 52 <= at < 64
    )  # 52 to 63 is padding, checked as well
    cut, more = (whole[:size] for size in range(len(whole))), (whole + b"x", whole[:64] + b"x" + whole[64:])
    padded = whole[:60] + b"x" + whole[61:]
    for damaged in (*flipped, *cut, *more, padded, bytes(len(whole)), CONTENT):
        path.write_bytes(damaged)
        assert cache.read("a") is None
        assert not path.exists()
    path.write_bytes(whole)
    found = cache.read("a")
    assert found is not None
    assert found.tobytes() == CONTENT


def test_an_entry_under_anothers_name_is_a_miss(tmp_path: Path) -> None:
    cache = DiskCache(tmp_path, 10**6)
    cache.write("oak", CONTENT)
    (tmp_path / "oak.entry").rename(tmp_path / "elm.entry")
    assert cache.read("elm") is None


def test_an_entry_of_nothing_is_an_entry(tmp_path: Path) -> None:
    cache = DiskCache(tmp_path, 10**6)
    assert cache.write("a", b"")
    found = cache.read("a")
    assert found is not None
    assert found.tobytes() == b""


def test_what_is_read_is_aligned_and_ones_own(tmp_path: Path) -> None:
    cache = DiskCache(tmp_path, 10**6)
    cache.write("a", CONTENT)
    found = cache.read("a")
    assert found is not None
    found[:] = 0  # may be written to
    again = cache.read("a")
    assert again is not None
    assert again.tobytes() == CONTENT
    assert again[:296].view(np.float64).flags.aligned


@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo, lambda path: path.symlink_to("nowhere")])
def test_something_else_in_an_entrys_place_is_a_miss_and_never_waited_for(
    make: Callable[[Path], None], tmp_path: Path
) -> None:
    cache = DiskCache(tmp_path, 10**6)
    make(tmp_path / "a.entry")
    assert cache.read("a") is None
    cache.write("a", CONTENT)  # a folder stays in the way
    found = cache.read("a")
    assert found is None or found.tobytes() == CONTENT
    cache.drop("a")
    cache.trim()
    assert not list(tmp_path.glob("*.partial"))


def test_a_folder_of_someone_else_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    cache = DiskCache(tmp_path, 10)
    assert cache.write("a", CONTENT)
    for name in ("utime", "unlink", "rename", "replace"):  # whatever the operating system is asked to change
        monkeypatch.setattr(disk_cache.os, name, refused)
    monkeypatch.setattr(disk_cache.tempfile, "mkstemp", refused)
    assert not cache.write("b", CONTENT)
    found = cache.read("a")
    assert found is not None  # it may be read
    assert found.tobytes() == CONTENT
    cache.trim()
    cache.drop("a")
    assert cache.size_bytes()[0] == 1
    monkeypatch.setattr(disk_cache.os, "open", refused)
    monkeypatch.setattr(disk_cache.os, "scandir", refused)
    assert cache.read("a") is None
    cache.trim()


def test_a_write_that_fails_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(self: Path, target: Path) -> Path:
        raise OSError(28, "No space left on device")

    cache = DiskCache(tmp_path, 100)
    monkeypatch.setattr(Path, "replace", broken)
    assert not cache.write("a", b"1")
    assert list(tmp_path.iterdir()) == []


def test_readers_never_see_half_an_entry(tmp_path: Path) -> None:
    cache = DiskCache(tmp_path, 10**8)
    versions = [bytes([k]) * 200_000 for k in range(4)]

    def work(number: int) -> bool:
        if number % 2:
            return cache.write("a", versions[number % 4])
        found = cache.read("a")
        return found is None or found.tobytes() in versions

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(work, range(400)))
    assert [path.name for path in tmp_path.iterdir()] == ["a.entry"]


def test_the_environment_names_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(ENVIRONMENT, str(tmp_path))
    assert cache_root() == tmp_path
    monkeypatch.setenv(ENVIRONMENT, "")
    assert cache_root() is None
    monkeypatch.delenv(ENVIRONMENT)
    monkeypatch.setattr(disk_cache.sys, "platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert cache_root() == tmp_path / "xdg" / "forestgen"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")  # the specification: to be ignored
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_root() == tmp_path / ".cache" / "forestgen"
