"""A folder of results that can be made again."""

from __future__ import annotations

import os
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from forestgen.core import disk_cache
from forestgen.core.disk_cache import ENVIRONMENT, DiskCache, cache_root


def test_what_was_written_is_read(tmp_path: Path) -> None:
    cache = DiskCache(tmp_path / "deep" / "folder", 10**6)
    assert cache.read("a") is None
    assert cache.write("a", b"first")
    assert cache.write("a", b"second")
    found = cache.read("a")
    assert found is not None
    assert found.tobytes() == b"second"
    assert cache.size_bytes() == (1, 6)
    cache.drop("a")
    assert cache.read("a") is None
    cache.drop("a")


def test_the_entries_used_longest_ago_go_first(tmp_path: Path) -> None:
    cache = DiskCache(tmp_path, 500)
    now = time.time()
    for number in range(8):
        cache.write(str(number), bytes(100))
        os.utime(tmp_path / f"{number}.entry", (now - 100 + number, now - 100 + number))
    assert cache.read("0") is not None  # now the one used last
    cache.trim()
    kept = {name for name in "01234567" if (tmp_path / f"{name}.entry").exists()}
    assert kept == {"0", "5", "6", "7"}  # 90% of 500 bytes hold four
    cache.trim()
    assert cache.size_bytes() == (4, 400)


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
