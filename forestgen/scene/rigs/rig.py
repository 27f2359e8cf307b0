"""What a rig is: several images of one entry of a recipe's cameras, and where each of them is taken from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from pydantic_core import PydanticCustomError

from forestgen.recipe.cameras import DIRECTIONS, Camera, RigKeys
from forestgen.scene.terrain import HeightField
from forestgen.scene.trunks import Trunks

Floats = NDArray[np.float64]
KeysT = TypeVar("KeysT", bound=RigKeys)


@dataclass(frozen=True)
class Poses:
    """Cameras of one entry, world."""

    position_m: Floats  # (F, 3)
    target_m: Floats  # (F, 3) in each image's middle
    time_s: Floats  # (F,)
    right_m: Floats | None = None  # (F,) how far each stands to the right of its position, seen along its axis


class Rig(Generic[KeysT]):
    """A rig. It has no state; `camera` is always the entry that has the rig."""

    name: str  # that recipes use: the registry's
    Parameters: type[KeysT]  # keys of `rig`
    keeps_view: bool = False  # the camera stands and looks as it would without the rig
    decides: tuple[str, ...] = ()  # keys of the camera that may not stand beside the rig

    def keys_of(self, camera: Camera) -> KeysT:
        """The section `rig`."""
        return cast(KeysT, camera.rig)

    def with_defaults(self, keys: Mapping[str, Any], size_m: tuple[float, float]) -> Mapping[str, Any]:
        """The rig's keys with those that follow from the site's size; nothing has been checked yet."""
        return keys

    def check(self, camera: Camera) -> PydanticCustomError | None:
        """What is wrong with the rig beside the camera's other keys, as `forestgen.recipe.fields.violation`."""
        return None

    def frames(self, camera: Camera) -> int:
        """How many images it makes of one scene."""
        raise NotImplementedError

    def frame_names(self, camera: Camera) -> list[str]:
        """Names of the images, in the order of their poses."""
        return [f"{camera.name}-{index:04d}" for index in range(self.frames(camera))]

    def sequence(self, camera: Camera, index: int) -> str | None:
        """Name of the images that follow each other in time, to which image `index` belongs; None for a still."""
        return None

    def poses(self, camera: Camera, height: HeightField, trunks: Trunks | None) -> Poses:
        """Where the images are taken from.

        `trunks`: that the camera may have to go around; None: not known yet.

        Raises `RecipeError`: there is no way; its `where` is a key below the camera.
        """
        raise NotImplementedError


def path_poses(camera: Camera, height: HeightField) -> Poses:
    """Along the camera's path, or where it stands."""
    position = lifted(camera, np.array(camera.positions_m, dtype=np.float64), height)
    pace = 0.0 if camera.path is None else 1.0 / camera.path.frames_per_s
    if camera.look is not None:
        target = position + DIRECTIONS[camera.look]
    else:
        target = lifted(camera, np.array(camera.looks_at_m, dtype=np.float64), height)
    return Poses(position, target, np.arange(len(position), dtype=np.float64) * pace)


def lifted(camera: Camera, points_m: Floats, height: HeightField) -> Floats:
    """(F, 3) world points of those of a camera, whose heights may count from the ground."""
    return on_ground(points_m, height) if camera.height_above_ground else points_m


def on_ground(points_m: Floats, height: HeightField) -> Floats:
    """(F, 3) world points of those whose heights count from the ground."""
    return np.column_stack([points_m[:, :2], points_m[:, 2] + height(points_m[:, 0], points_m[:, 1])])
