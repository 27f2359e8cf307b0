"""The recipe's section ``dataset``: files for those who train and measure, and the splits of a batch."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from forestgen.recipe.fields import Positive, Section, Text, Whole, mistake, part_name
from forestgen.recipe.registries import DATASET_FORMATS, DEFAULT_FORMATS

View = Literal["filmic", "srgb", "acescct"]
DEFAULT_SPLITS = {"train": 8.0, "val": 1.0, "test": 1.0}
SplitName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_-]{0,31}$")]


Format = Annotated[Text, *part_name(DATASET_FORMATS)]


class Licence(Section):
    """The licence of the images, as COCO lists it."""

    name: Annotated[Text, Field(min_length=1, max_length=200, description="Such as CC BY 4.0.")]
    url: Annotated[Text, Field(max_length=500, description="Where its text stands.")] = ""


class Dataset(Section):
    """Files for training and evaluation, besides the frames' own."""

    formats: Annotated[
        tuple[Format, ...],
        Field(description="What `forestgen models --kind dataset_format` lists, each once."),
    ] = DEFAULT_FORMATS
    view: Annotated[
        View,
        Field(
            description="View transform of preview.png: filmic bends highlights over, srgb is the plain encoding, "
            "acescct a logarithmic one for grading."
        ),
    ] = "filmic"
    description: Annotated[Text, Field(max_length=1000, description="What the data set shows.")] = "forestgen dataset"
    contributor: Annotated[Text, Field(max_length=200, description="Who made it.")] = ""
    licence: Annotated[Licence | None, Field(description="Of the images.")] = None
    splits: Annotated[
        dict[SplitName, Positive],
        Field(
            min_length=1,
            max_length=20,
            description="Parts of a batch and their shares, in any unit: {train: 8, val: 1, test: 1}. No plant "
            "community is in two of them.",
        ),
    ] = DEFAULT_SPLITS
    depth_unit_m: Annotated[
        Positive, Field(le=1.0, description="Metres of a step of the 16-bit depth PNG, which reaches 65,534 steps.")
    ] = 0.01
    point_stride: Annotated[
        Whole, Field(ge=1, le=1000, description="n: every n-th pixel of every n-th row is a point.")
    ] = 1

    @field_validator("formats")
    @classmethod
    def _each_once(cls, value: tuple[Format, ...]) -> tuple[Format, ...]:
        for index, name in enumerate(value):
            if name in value[:index]:
                raise mistake("each format once", problem="a format named twice", got=name, at=(index,))
        return value
