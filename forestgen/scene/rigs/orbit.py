"""A circle of cameras around look_at_m: NAME-0000, NAME-0001, ..."""

from __future__ import annotations

import numpy as np
from pydantic import Field
from pydantic_core import PydanticCustomError

from forestgen.recipe.cameras import MOST_FRAMES, Camera, FramesPerSecond, RigKeys
from forestgen.recipe.fields import Coordinate, Number, Positive, Whole, violation
from forestgen.scene.rigs.rig import Poses, Rig, lifted
from forestgen.scene.terrain import HeightField
from forestgen.scene.trunks import Trunks


class OrbitKeys(RigKeys):
    """Cameras on a level circle around look_at_m, clockwise seen from above, all looking at it."""

    radius_m: Positive = Field(le=1e5, description="From look_at_m, level, metres.")
    height_m: Coordinate = Field(
        description="Of the cameras, metres; above the ground below each, as height_above_ground."
    )
    count: Whole = Field(ge=1, le=MOST_FRAMES, description="Cameras, evenly around.")
    first_deg: Number = Field(
        180.0, ge=-360, le=360, description="Where the first stands, degrees from north: 180 is in the south."
    )
    frames_per_s: FramesPerSecond | None = Field(
        None, description="Images a second of one camera going around. Default: all at one time, a camera each."
    )


class Orbit(Rig[OrbitKeys]):
    """A circle of cameras."""

    name = "orbit"
    Parameters = OrbitKeys
    decides = ("position_m", "look", "path")

    def check(self, camera: Camera) -> PydanticCustomError | None:
        if camera.look_at_m is None:
            return violation("the circle's middle", problem="an orbit needs look_at_m", got="no look_at_m", at=("rig",))
        return None

    def frames(self, camera: Camera) -> int:
        return self.keys_of(camera).count

    def sequence(self, camera: Camera, index: int) -> str | None:
        return None if self.keys_of(camera).frames_per_s is None else camera.name

    def poses(self, camera: Camera, height: HeightField, trunks: Trunks | None) -> Poses:
        rig = self.keys_of(camera)
        angle = np.radians(rig.first_deg) + np.arange(rig.count) / rig.count * 2 * np.pi  # clockwise from north
        target = np.repeat(lifted(camera, np.array([camera.look_at_m], dtype=np.float64), height), rig.count, axis=0)
        position = target + rig.radius_m * np.column_stack([np.sin(angle), np.cos(angle), np.zeros(rig.count)])
        position[:, 2] = rig.height_m
        pace = 0.0 if rig.frames_per_s is None else 1.0 / rig.frames_per_s
        return Poses(lifted(camera, position, height), target, np.arange(rig.count, dtype=np.float64) * pace)


RIG = Orbit()
