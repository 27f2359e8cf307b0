"""The recipe's section ``dataset``: files for training and measuring, and the splits of a batch.

An image's split (for training, validation or testing) follows from its number and the shares alone: a batch that grows,
or that many machines make in pieces, moves no image from one split to another. Numbers are assigned by the van der
Corput sequence in base 2 (its radical inverse lies in a split's share of [0, 1)), so every stretch of n images has each
split in its share, within 1 + log2(n) images. An image's rank, its number within its split, is counted by dyadic
blocks: in integers, exactly, and without looking at the images before it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from fractions import Fraction
from functools import lru_cache
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from forestgen.recipe.fields import Positive, Section, Text, Whole, each_once, part_name
from forestgen.recipe.registries import DATASET_FORMATS, DEFAULT_FORMATS

View = Literal["filmic", "srgb", "acescct"]
DEFAULT_SPLITS = {"train": 8.0, "val": 1.0, "test": 1.0}
SplitName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_-]{0,31}$")]
_BITS = 64  # of an image's number
NUMBERS_END = 2**_BITS  # no image's number is as large
Format = Annotated[Text, *part_name(DATASET_FORMATS)]


class Licence(Section):
    """The licence of the images, as COCO lists it."""

    name: Text = Field(min_length=1, max_length=200, description="Such as CC BY 4.0.")
    url: Text = Field("", max_length=500, description="Where its text stands.")


class Dataset(Section):
    """Files for training and evaluation, besides the frames' own."""

    formats: Annotated[tuple[Format, ...], AfterValidator(each_once)] = Field(
        DEFAULT_FORMATS, description="What `forestgen models --kind dataset_format` lists, each once."
    )
    view: View = Field(
        "filmic",
        description="View transform of preview.png: filmic bends highlights over, srgb is the plain encoding, acescct "
        "a logarithmic one for grading.",
    )
    description: Text = Field("forestgen dataset", max_length=1000, description="What the data set shows.")
    contributor: Text = Field("", max_length=200, description="Who made it.")
    licence: Licence | None = Field(None, description="Of the images.")
    splits: dict[SplitName, Positive] = Field(
        DEFAULT_SPLITS,
        min_length=1,
        max_length=20,
        description="Parts of a batch and their shares, in any unit: {train: 8, val: 1, test: 1}. No plant community "
        "is in two of them.",
    )
    depth_unit_m: Positive = Field(
        0.01, le=1.0, description="Metres of a step of the 16-bit depth PNG, which reaches 65,534 steps."
    )
    point_stride: Whole = Field(1, ge=1, le=1000, description="n: every n-th pixel of every n-th row is a point.")


def split_of(splits: Mapping[str, float], image: int) -> str:
    """Name of the split of the image of a number below 2^64; `splits` has positive shares in the recipe's order."""
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
def _ends(shares: tuple[tuple[str, float], ...]) -> tuple[int, ...]:
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
