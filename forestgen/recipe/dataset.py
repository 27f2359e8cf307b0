"""The recipe's section ``dataset``: files for those who train and measure, and the splits of a batch."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from forestgen.recipe.fields import Positive, Section, Text, Whole, part_name
from forestgen.recipe.registries import DATASET_FORMATS, DEFAULT_FORMATS, each_once

View = Literal["filmic", "srgb", "acescct"]
DEFAULT_SPLITS = {"train": 8.0, "val": 1.0, "test": 1.0}
SplitName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_-]{0,31}$")]


Format = Annotated[Text, *part_name(DATASET_FORMATS)]


class Licence(Section):
    """The licence of the images, as COCO lists it."""

    name: Text = Field(min_length=1, max_length=200, description="Such as CC BY 4.0.")
    url: Text = Field(default="", max_length=500, description="Where its text stands.")


class Dataset(Section):
    """Files for training and evaluation, besides the frames' own."""

    formats: Annotated[tuple[Format, ...], AfterValidator(each_once)] = Field(
        default=DEFAULT_FORMATS, description="What `forestgen models --kind dataset_format` lists, each once."
    )
    view: View = Field(
        default="filmic",
        description="View transform of preview.png: filmic bends highlights over, srgb is the plain encoding, acescct "
        "a logarithmic one for grading.",
    )
    description: Text = Field(default="forestgen dataset", max_length=1000, description="What the data set shows.")
    contributor: Text = Field(default="", max_length=200, description="Who made it.")
    licence: Licence | None = Field(default=None, description="Of the images.")
    splits: dict[SplitName, Positive] = Field(
        default=DEFAULT_SPLITS,
        min_length=1,
        max_length=20,
        description="Parts of a batch and their shares, in any unit: {train: 8, val: 1, test: 1}. No plant community "
        "is in two of them.",
    )
    depth_unit_m: Positive = Field(
        default=0.01, le=1.0, description="Metres of a step of the 16-bit depth PNG, which reaches 65,534 steps."
    )
    point_stride: Whole = Field(
        default=1, ge=1, le=1000, description="n: every n-th pixel of every n-th row is a point."
    )
