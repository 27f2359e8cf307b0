"""Two cameras side by side, axes parallel: NAME-left and NAME-right."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from forestgen.recipe.cameras import Camera, RigKeys
from forestgen.recipe.fields import Positive
from forestgen.scene.rigs.rig import Poses, Rig, path_poses
from forestgen.scene.terrain import HeightField
from forestgen.scene.trunks import Trunks

_SIDES = ("left", "right")


class StereoKeys(RigKeys):
    """Two cameras side by side, each half the baseline from position_m; with a path, both go along it."""

    baseline_m: Positive = Field(le=1000, description="Distance of the two cameras, metres.")


class Stereo(Rig[StereoKeys]):
    """Two cameras side by side."""

    name = "stereo"
    Parameters = StereoKeys
    keeps_view = True

    def frames(self, camera: Camera) -> int:
        return 2 * camera.steps

    def frame_names(self, camera: Camera) -> list[str]:
        names = [f"{camera.name}-{side}" for side in _SIDES]
        if camera.path is None:
            return names
        return [f"{name}-{step:04d}" for step in range(camera.steps) for name in names]

    def sequence(self, camera: Camera, index: int) -> str | None:
        return None if camera.path is None else f"{camera.name}-{_SIDES[index % 2]}"

    def poses(self, camera: Camera, height: HeightField, trunks: Trunks | None) -> Poses:
        middle, half_m = path_poses(camera, height), self.keys_of(camera).baseline_m / 2
        position, target, time_s = (
            np.repeat(one, 2, axis=0) for one in (middle.position_m, middle.target_m, middle.time_s)
        )
        return Poses(position, target, time_s, np.tile([-half_m, half_m], len(middle.time_s)))


RIG = Stereo()
