"""Straight down in lines over an area, overlapping: NAME-0000, NAME-0001, ..."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Self

import numpy as np
from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from forestgen.recipe.cameras import DIRECTIONS, Camera, GroundPoint, RigKeys
from forestgen.recipe.fields import Number, Positive, violation
from forestgen.recipe.registries import PROJECTIONS
from forestgen.scene.rigs.rig import Poses, Rig, lifted
from forestgen.scene.terrain import HeightField
from forestgen.scene.trunks import Trunks


class DroneGridKeys(RigKeys):
    """Straight down, north at the top, in lines from south to north and back, the first in the west."""

    altitude_m: Positive = Field(le=10_000, description="Above the ground below, metres.")
    forward_overlap: Number = Field(
        0.8, ge=0, le=0.98, description="Share of an image's height that the next one in its line shows too."
    )
    side_overlap: Number = Field(
        0.7, ge=0, le=0.98, description="Share of an image's width that the next line shows too."
    )
    area_m: tuple[GroundPoint, GroundPoint] | None = Field(
        None, description="South-western and north-eastern corner of what is seen: [x, y], metres. Default: the site."
    )

    @model_validator(mode="after")
    def _area_is_one(self) -> Self:
        if self.area_m is not None and not all(b > a for a, b in zip(*self.area_m, strict=True)):
            expected = "a south-western corner, then a north-eastern one"
            got = str([list(corner) for corner in self.area_m])
            raise violation(expected, problem="the area is empty", got=got, at=("area_m",))
        return self


class DroneGrid(Rig[DroneGridKeys]):
    """Lines of images straight down."""

    name = "drone_grid"
    Parameters = DroneGridKeys
    decides = ("position_m", "look_at_m", "look", "path")

    def with_defaults(self, keys: Mapping[str, Any], size_m: tuple[float, float]) -> Mapping[str, Any]:
        return {**keys, "area_m": [[0.0, 0.0], list(size_m)]} if keys.get("area_m") is None else keys

    def check(self, camera: Camera) -> PydanticCustomError | None:
        if not camera.covers_ground:
            expected = " or ".join(name for name, part in PROJECTIONS.parts() if part.Parameters.covers_ground)
            return violation(expected, problem="no camera for a grid", got=camera.kind, at=("kind",))
        if self.keys_of(camera).area_m is None:
            return violation("two corners", problem="the grid needs an area_m", got="none", at=("rig",))
        return None

    def frames(self, camera: Camera) -> int:
        return math.prod(_counts(self.keys_of(camera), camera.footprint_m(self.keys_of(camera).altitude_m)))

    def poses(self, camera: Camera, height: HeightField, trunks: Trunks | None) -> Poses:
        rig = self.keys_of(camera)
        there = np.array(_middles_m(rig, camera.footprint_m(rig.altitude_m)))
        position = lifted(camera, np.column_stack([there, np.full(len(there), rig.altitude_m)]), height)
        return Poses(position, position + DIRECTIONS["down"], np.zeros(len(there)))


def _counts(rig: DroneGridKeys, footprint_m: tuple[float, float]) -> tuple[int, int]:
    """Lines, and images in each, for images that show so many metres of level ground across and along."""
    assert rig.area_m is not None
    across, along = (
        1 + max(0, math.ceil((high - low - seen) / (seen * (1 - overlap)) - 1e-9))
        for low, high, seen, overlap in zip(
            *rig.area_m, footprint_m, (rig.side_overlap, rig.forward_overlap), strict=True
        )
    )
    return across, along


def _middles_m(rig: DroneGridKeys, footprint_m: tuple[float, float]) -> list[GroundPoint]:
    """Where the images have their middles, in the order of the flight; together they show the area to its edges."""
    assert rig.area_m is not None
    (west, south), (east, north) = rig.area_m
    lines, images = _counts(rig, footprint_m)
    there = _spread(south, north, footprint_m[1], images)
    return [
        (x, y)
        for line, x in enumerate(_spread(west, east, footprint_m[0], lines))
        for y in (reversed(there) if line % 2 else there)
    ]


def _spread(low_m: float, high_m: float, seen_m: float, count: int) -> list[float]:
    if count == 1:
        return [(low_m + high_m) / 2]
    first, last = low_m + seen_m / 2, high_m - seen_m / 2
    return [first + (last - first) * index / (count - 1) for index in range(count)]


RIG = DroneGrid()
