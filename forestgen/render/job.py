"""What to render, until when, and what renders it pass after pass."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from forestgen.render.wavelengths import Mode
from forestgen.scene.colour import Channels
from forestgen.scene.spec import Camera, SceneSpec

CloudTransport = Literal["farfield", "exact"]
Timer = Callable[[str], AbstractContextManager[Any]]


@dataclass(frozen=True)
class StoppingCriterion:
    """When an image is done. Samples are light paths a pixel, over all passes."""

    samples: int  # exactly; with a target or a time budget the first ones, from which the noise is judged
    target_error: float | None = None  # relative error
    target_error_p95: float | None = None  # its 95th percentile
    time_budget_s: float | None = None
    most_samples: int = 65536  # with a target or a time budget

    @property
    def open_ended(self) -> bool:
        return not (self.target_error is None and self.target_error_p95 is None and self.time_budget_s is None)


@dataclass(frozen=True)
class RenderJob:
    """What to render, and how well."""

    spec: SceneSpec
    camera: Camera
    until: StoppingCriterion
    seed: int  # of the frame
    mode: Mode = "rgb"  # a camera with bands is rendered at wavelengths whatever it says
    max_depth: int = 64  # longest path through the canopy; clouds have their own
    cloud_transport: CloudTransport = "farfield"
    position_m: NDArray[np.float32] | None = None  # (H, W, 3) world, of what pixels show, NaN sky; None: near the site

    @property
    def is_exact(self) -> bool:
        """Whether light is traced through the clouds' volume and the scene together."""
        return self.spec.clouds is not None and self.cloud_transport == "exact"


class View(Protocol):
    """A scene, ready to be captured."""

    def take(self, channels: Channels, samples: int, number: tuple[int, int]) -> NDArray[np.float64]:
        """(H, W, 3) radiance in three channels, by independent paths for each `number` of replicate and pass."""
