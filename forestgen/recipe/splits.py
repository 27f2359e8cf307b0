"""Which images of a batch are for training, which for validation, which for testing.

An image's split follows from its number and the shares alone: a batch that grows, or that many machines make in pieces,
moves no image from one split to another. Numbers are dealt by the van der Corput sequence in base 2 (its radical
inverse lies in a split's share of [0, 1)), so every stretch of n images has each split in its share, give or take
1 + log2(n) images. An image's rank, its number within its split, is counted by dyadic blocks: in integers, exactly,
and without looking at the images before it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from fractions import Fraction
from functools import lru_cache

_BITS = 64  # of an image's number
NUMBERS_END = 2**_BITS  # no image's number is as large
_Shares = tuple[tuple[str, float], ...]


def split_of(splits: Mapping[str, float], image: int) -> str:
    """Name of an image's split.

    Parameters
    ----------
    splits : name -> share, in any unit, in the recipe's order; all positive.
    image : number of the image, as in its frames' names; below 2^64.
    """
    return place_in_splits(splits, image)[0]


def place_in_splits(splits: Mapping[str, float], image: int) -> tuple[str, int]:
    """Name of an image's split, and its rank there: how many images of a lower number the split has."""
    position = _mirrored(image)
    low = 0
    for name, high in zip(splits, _ends(tuple(splits.items())), strict=True):
        if position < high:
            return name, _below(image, high) - _below(image, low)
        low = high
    raise AssertionError("the last share ends at 1")


def used_splits(splits: Mapping[str, float], images: range) -> list[str]:
    """Names of the splits that some of these images are in, in the order of the images."""
    used: list[str] = []
    for image in images:
        if (split := split_of(splits, image)) not in used:
            used.append(split)
            if len(used) == len(splits):
                break
    return used


@lru_cache(maxsize=64)
def _ends(shares: _Shares) -> tuple[int, ...]:
    """Where each split's share of [0, 2^64) ends; exactly, so that positions and counts agree."""
    parts = [Fraction(share) for _, share in shares]
    total = sum(parts)
    return tuple(math.ceil(sum(parts[: n + 1]) / total * 2**_BITS) for n in range(len(parts)))


def _mirrored(number: int) -> int:
    """The binary digits of `number` in reverse, as the first of 64: its radical inverse times 2^64."""
    return int(f"{number:0{_BITS}b}"[::-1], 2)


def _below(count: int, end: int) -> int:
    """How many of the numbers 0 to count - 1 have a radical inverse below end / 2^64.

    They fall into blocks of 2^m numbers that differ in their last m digits only: their inverses lie 2^(64-m) apart.
    """
    found, start = 0, 0
    for m in reversed(range(count.bit_length())):
        if count >> m & 1:
            step = 1 << (_BITS - m)
            offset = _mirrored(start)  # of the block's first number; below `step`
            found += min(max(-((offset - end) // step), 0), 1 << m)
            start += 1 << m
    return found
