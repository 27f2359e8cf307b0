"""Rigs: one entry of a recipe's cameras that becomes several images.

| rig | images | names |
|---|---|---|
| stereo | two cameras side by side, axes parallel | NAME-left, NAME-right |
| orbit | a circle of cameras around look_at_m | NAME-0000, NAME-0001, ... |
| walk | at eye height over the ground, around trunks | NAME-0000, NAME-0001, ... in time |
| drone_grid | straight down in lines over an area, overlapping | NAME-0000, NAME-0001, ... |

How many images a rig makes follows from the recipe alone.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from forestgen.recipe.fields import Coordinate, Number, Positive, Section, Whole, mistake

MOST_FRAMES = 1000  # of all cameras together
GroundPoint = tuple[Coordinate, Coordinate]
FramesPerSecond = Annotated[Number, Field(ge=0.001, le=1000)]


class Stereo(Section):
    """Two cameras side by side, each half the baseline from position_m; with a path, both go along it."""

    kind: Annotated[Literal["stereo"], Field(description="The rig.")]
    baseline_m: Annotated[Positive, Field(le=1000, description="Distance of the two cameras, metres.")]


class Orbit(Section):
    """Cameras on a level circle around look_at_m, clockwise seen from above, all looking at it."""

    kind: Annotated[Literal["orbit"], Field(description="The rig.")]
    radius_m: Annotated[Positive, Field(le=1e5, description="From look_at_m, level, metres.")]
    height_m: Annotated[
        Coordinate, Field(description="Of the cameras, metres; above the ground below each, as height_above_ground.")
    ]
    count: Annotated[Whole, Field(ge=1, le=MOST_FRAMES, description="Cameras, evenly around.")]
    first_deg: Annotated[
        Number, Field(ge=-360, le=360, description="Where the first stands, degrees from north: 180 is in the south.")
    ] = 180.0
    frames_per_s: Annotated[
        FramesPerSecond | None,
        Field(description="Images a second of one camera going around. Default: all at one time, a camera each."),
    ] = None


class Walk(Section):
    """At eye height from point to point at an even pace, around the trunks that stand in the way."""

    kind: Annotated[Literal["walk"], Field(description="The rig.")]
    waypoints_m: Annotated[
        tuple[GroundPoint, ...],
        Field(min_length=2, max_length=1000, description="From the first to the last: [x, y] each, metres."),
    ]
    frames: Annotated[Whole, Field(ge=2, le=MOST_FRAMES, description="Images along the way, both ends included.")]
    frames_per_s: Annotated[FramesPerSecond, Field(description="Images a second: of motion and wind.")] = 24.0
    eye_height_m: Annotated[Positive, Field(le=100, description="Above the ground, metres.")] = 1.7
    clearance_m: Annotated[
        Number, Field(ge=0.1, le=5, description="Kept from the surface of trunks, metres, where there is room.")
    ] = 0.5

    @model_validator(mode="after")
    def _goes_somewhere(self) -> Self:
        for index in range(1, len(self.waypoints_m)):
            if math.dist(self.waypoints_m[index - 1], self.waypoints_m[index]) < 0.01:
                raise mistake(
                    "points that differ from the one before",
                    problem="the walk stands still",
                    got=str(list(self.waypoints_m[index])),
                    at=("waypoints_m", index),
                )
        return self


class DroneGrid(Section):
    """Straight down, north at the top, in lines from south to north and back, the first in the west."""

    kind: Annotated[Literal["drone_grid"], Field(description="The rig.")]
    altitude_m: Annotated[Positive, Field(le=10_000, description="Above the ground below, metres.")]
    forward_overlap: Annotated[
        Number, Field(ge=0, le=0.98, description="Share of an image's height that the next one in its line shows too.")
    ] = 0.8
    side_overlap: Annotated[
        Number, Field(ge=0, le=0.98, description="Share of an image's width that the next line shows too.")
    ] = 0.7
    area_m: Annotated[
        tuple[GroundPoint, GroundPoint] | None,
        Field(description="South-western and north-eastern corner of what is seen: [x, y], metres. Default: the site."),
    ] = None

    @model_validator(mode="after")
    def _area_is_one(self) -> Self:
        if self.area_m is not None and not all(b > a for a, b in zip(*self.area_m, strict=True)):
            raise mistake(
                "a south-western corner, then a north-eastern one",
                problem="the area is empty",
                got=str([list(corner) for corner in self.area_m]),
                at=("area_m",),
            )
        return self

    def lines(self, footprint_m: tuple[float, float]) -> tuple[int, int]:
        """Lines, and images in each, for images that show so many metres of level ground across and along."""
        assert self.area_m is not None
        sides = (self.area_m[1][axis] - self.area_m[0][axis] for axis in (0, 1))
        across, along = (
            _steps(side, seen, overlap)
            for side, seen, overlap in zip(sides, footprint_m, (self.side_overlap, self.forward_overlap), strict=True)
        )
        return across, along

    def middles_m(self, footprint_m: tuple[float, float]) -> list[GroundPoint]:
        """Where the images have their middles, in the order of the flight; together they show the area to its edges."""
        assert self.area_m is not None
        (west, south), (east, north) = self.area_m
        lines, images = self.lines(footprint_m)
        there = _spread(south, north, footprint_m[1], images)
        return [
            (x, y)
            for line, x in enumerate(_spread(west, east, footprint_m[0], lines))
            for y in (reversed(there) if line % 2 else there)
        ]


Rig = Annotated[Stereo | Orbit | Walk | DroneGrid, Field(discriminator="kind")]


def _steps(side_m: float, seen_m: float, overlap: float) -> int:
    """How many images side by side show a side with at least the overlap."""
    return 1 + max(0, math.ceil((side_m - seen_m) / (seen_m * (1 - overlap)) - 1e-9))


def _spread(low_m: float, high_m: float, seen_m: float, count: int) -> list[float]:
    if count == 1:
        return [(low_m + high_m) / 2]
    first, last = low_m + seen_m / 2, high_m - seen_m / 2
    return [first + (last - first) * index / (count - 1) for index in range(count)]
