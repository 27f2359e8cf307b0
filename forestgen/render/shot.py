"""What to render, and what renders it pass after pass."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from forestgen.render.noise import Until
from forestgen.render.wavelengths import Mode
from forestgen.scene.channels import Channels
from forestgen.scene.spec import Camera, SceneSpec

CloudTransport = Literal["farfield", "exact"]
Timer = Callable[[str], AbstractContextManager[Any]]


@dataclass(frozen=True)
class Shot:
    """What to render, and how well."""

    spec: SceneSpec
    camera: Camera
    until: Until
    seed: int  # of the frame
    mode: Mode = "rgb"  # a camera with bands is rendered at wavelengths whatever it says
    max_depth: int = 64  # longest path through the canopy; clouds have their own
    cloud_transport: CloudTransport = "farfield"
    position_m: NDArray[np.float32] | None = None  # (H, W, 3) world, of what pixels show, NaN sky; None: near the site


class View(Protocol):
    """A scene, ready to be captured."""

    def take(self, channels: Channels, samples: int, number: tuple[int, int]) -> NDArray[np.float64]:
        """(H, W, 3) radiance in three channels, by independent paths for each `number` of replicate and pass."""


def is_exact(shot: Shot) -> bool:
    """Whether light is traced through the clouds' volume and the scene together."""
    return shot.spec.clouds is not None and shot.cloud_transport == "exact"
