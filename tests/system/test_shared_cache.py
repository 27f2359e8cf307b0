"""One cache folder, several processes that write, read, trim and damage it: every read is right, or a miss."""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import random
import time
from contextlib import suppress
from pathlib import Path

import pytest

from forestgen.core.cache import DiskCache

KEYS = 12
WRITERS = 4
MOST_BYTES = 250_000  # less than all keys take: trims have work


def content(key: int) -> bytes:
    """What belongs to a key: 1 to 60 kB that no other key has."""
    seed = hashlib.blake2b(str(key).encode()).digest()
    return (seed * 1000)[: 1000 + 5000 * key]


def work(folder: Path, number: int, seconds: float) -> tuple[int, int]:
    """Write, read, trim and damage at random; hits and misses. An entry that is wrong raises."""
    chance, cache, hits, misses = random.Random(number), DiskCache(folder, MOST_BYTES), 0, 0
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        key = chance.randrange(KEYS)
        found = cache.read(f"key{key}")
        if found is None:
            misses += 1
            assert cache.write(f"key{key}", content(key))
        else:
            hits += 1
            if found.tobytes() != content(key):
                raise AssertionError(f"key {key} has other bytes")
        what = chance.random()
        if what < 0.05:
            cache.trim()
        elif what < 0.15:
            damage(folder / f"key{key}.entry", chance)
    return hits, misses


def damage(path: Path, chance: random.Random) -> None:
    """Cut the file, flip one of its bits, or take another's content, as a broken disk or a careless person would."""
    with suppress(OSError), path.open("r+b") as file:
        size = os.fstat(file.fileno()).st_size
        if size == 0:  # another writer cut it to nothing
            return
        if chance.random() < 0.5:
            file.truncate(chance.randrange(size))
        else:
            at = chance.randrange(size)
            file.seek(at)
            byte = file.read(1)
            if byte:  # else another cut the file here since
                file.seek(at)
                file.write(bytes([byte[0] ^ 1 << chance.randrange(8)]))


def run(folder: Path, seconds: float) -> list[tuple[int, int]]:
    with multiprocessing.get_context("spawn").Pool(WRITERS) as pool:
        return pool.starmap(work, [(folder, number, seconds) for number in range(WRITERS)])


@pytest.mark.parametrize("seconds", [0.5, pytest.param(20.0, marks=pytest.mark.slow)])
def test_every_read_is_right_or_a_miss(seconds: float, tmp_path: Path) -> None:
    told = run(tmp_path / "cache", seconds)
    assert all(hits and misses for hits, misses in told), told
    cache = DiskCache(tmp_path / "cache", MOST_BYTES)
    assert not list((tmp_path / "cache").glob("*.partial"))
    cache.trim()
    assert cache.size_bytes()[1] <= MOST_BYTES
    for key in range(KEYS):
        found = cache.read(f"key{key}")
        assert found is None or found.tobytes() == content(key)
