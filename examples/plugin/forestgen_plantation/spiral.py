"""A rig: cameras that climb around a point, all looking at it: NAME-0000, NAME-0001, ...

Example
-------
    cameras: [{look_at_m: [12, 12, 3], rig: {kind: spiral, radius_m: 15, count: 12, top_m: 20}}]
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from forestgen.recipe.cameras import Camera, RigKeys
from forestgen.scene.rigs.rig import Poses, Rig, lifted
from forestgen.scene.terrain import HeightField
from forestgen.scene.trunks import Trunks


class SpiralKeys(RigKeys):
    """Keys of `rig: {kind: spiral}`."""

    radius_m: float = Field(gt=0, description="distance of the cameras from look_at_m, level")
    count: int = Field(ge=2, le=1000, description="how many cameras there are")
    top_m: float = Field(gt=0, description="height of the last one; the first stands at half a metre")


class Spiral(Rig[SpiralKeys]):
    """Cameras on a spiral."""

    name = "spiral"
    Parameters = SpiralKeys
    decides = ("position_m", "look", "path")

    def frames(self, camera: Camera) -> int:
        return self.keys_of(camera).count

    def poses(self, camera: Camera, height: HeightField, trunks: Trunks | None) -> Poses:
        keys = self.keys_of(camera)
        angle, up_m = np.linspace(0, 4 * np.pi, keys.count), np.linspace(0.5, keys.top_m, keys.count)
        middle = np.tile(np.array(camera.look_at_m, dtype=np.float64), (keys.count, 1))
        around = keys.radius_m * np.stack([np.sin(angle), np.cos(angle)], axis=1)
        position = np.column_stack([middle[:, :2] + around, up_m])
        return Poses(lifted(camera, position, height), lifted(camera, middle, height), np.zeros(keys.count))


RIG = Spiral()
