"""A walker at eye height over the ground, around trunks: NAME-0000, NAME-0001, ... in time."""

from __future__ import annotations

import math
from typing import Self

import numpy as np
from pydantic import Field, model_validator

from forestgen.core.errors import RecipeError
from forestgen.recipe.cameras import DIRECTIONS, MOST_FRAMES, Camera, FramesPerSecond, GroundPoint, RigKeys
from forestgen.recipe.fields import Number, Positive, Whole, violation
from forestgen.scene.rigs.rig import Floats, Poses, Rig, lifted, on_ground
from forestgen.scene.terrain import HeightField
from forestgen.scene.trunks import BlockedError, Trunks, at_lengths, length_m, way_around

_AHEAD_M = 4.0  # a walker looks at a point of the way so far ahead
_HEADROOM_M = 0.3  # trunks count up to so far above the eye


class WalkKeys(RigKeys):
    """At eye height from point to point at an even pace, around the trunks that stand in the way."""

    waypoints_m: tuple[GroundPoint, ...] = Field(
        min_length=2, max_length=1000, description="From the first to the last: [x, y] each, metres."
    )
    frames: Whole = Field(ge=2, le=MOST_FRAMES, description="Images along the way, both ends included.")
    frames_per_s: FramesPerSecond = Field(24.0, description="Images a second: of motion and wind.")
    eye_height_m: Positive = Field(1.7, le=100, description="Above the ground, metres.")
    clearance_m: Number = Field(
        0.5, ge=0.1, le=5, description="Kept from the surface of trunks, metres, where there is room."
    )

    @model_validator(mode="after")
    def _goes_somewhere(self) -> Self:
        for index in range(1, len(self.waypoints_m)):
            if math.dist(self.waypoints_m[index - 1], self.waypoints_m[index]) < 0.01:
                expected, got = "points that differ from the one before", str(list(self.waypoints_m[index]))
                raise violation(expected, problem="the walk stands still", got=got, at=("waypoints_m", index))
        return self


class Walk(Rig[WalkKeys]):
    """A walk at an even pace, looking ahead along the way unless the recipe says where to."""

    name = "walk"
    Parameters = WalkKeys
    decides = ("position_m", "path")

    def frames(self, camera: Camera) -> int:
        return self.keys_of(camera).frames

    def sequence(self, camera: Camera, index: int) -> str | None:
        return camera.name

    def poses(self, camera: Camera, height: HeightField, trunks: Trunks | None) -> Poses:
        rig = self.keys_of(camera)
        way = _way(camera, rig, trunks)
        walked = np.linspace(0.0, length_m(way), rig.frames)
        eye = np.full((rig.frames, 1), rig.eye_height_m)
        position = on_ground(np.hstack([at_lengths(way, walked), eye]), height)
        if camera.look is not None:
            target = position + DIRECTIONS[camera.look]
        elif camera.look_at_m is not None:
            point = lifted(camera, np.array([camera.look_at_m], dtype=np.float64), height)
            target = np.repeat(point, rig.frames, axis=0)
        else:
            target = on_ground(np.hstack([at_lengths(way, walked + _AHEAD_M), eye]), height)
        return Poses(position, target, np.arange(rig.frames) / rig.frames_per_s)


def _way(camera: Camera, rig: WalkKeys, trunks: Trunks | None) -> Floats:
    """(P, 2) polyline."""
    way = np.array(rig.waypoints_m, dtype=np.float64)
    if trunks is None:
        return way
    try:
        return way_around(way, *trunks.circles_m(rig.eye_height_m + _HEADROOM_M), rig.clearance_m)
    except BlockedError as cause:
        first, second = rig.waypoints_m[cause.piece], rig.waypoints_m[cause.piece + 1]
        problem, where = f"trunks block the walk of camera {camera.name}", f"rig.waypoints_m.{cause.piece}"
        expected = "a way between two waypoints, 10 cm from all trunks"
        got, hint = f"none from {list(first)} to {list(second)}", "move these waypoints, or add one in between"
        raise RecipeError(problem, where=where, expected=expected, got=got, hint=hint) from cause


RIG = Walk()
