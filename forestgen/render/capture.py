"""Images taken with a camera of any kind."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.render.assembled import LEAST_SAMPLES, assemble
from forestgen.render.sensors import FilmWindow, is_assembled, sensor_of
from forestgen.render.tracing import interruptible
from forestgen.scene.spec import Camera


def least_samples(camera: Camera) -> int:
    """Samples a pixel of one capture, to which fewer are raised."""
    if not is_assembled(camera):
        return 1
    return LEAST_SAMPLES


def capture(
    integrator: Any, scene: Any, camera: Camera, *, samples: int, seed: int, window: FilmWindow | None = None
) -> NDArray[np.float64]:
    """(H, W, 4) three channels and alpha of any camera; of a window only that part.

    Samples are a pixel; Ctrl-C stops it. Outside of a fisheye's circle everything is 0.
    """
    if is_assembled(camera):
        return assemble(integrator, scene, camera, samples=samples, seed=seed, window=window)
    image = interruptible(integrator, scene, sensor_of(camera, samples, window), seed, samples)
    return image.astype(np.float64)
