"""The contract between renderer and labels: what one camera saw. Imports no renderer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.scene.spec import Camera


@dataclass(frozen=True)
class Identity:
    """What each sample of the identity pass hit, traced on the radiance pass' own geometry."""

    plant_id: NDArray[np.uint32]  # (H, W, S); 0 where no plant is hit
    part: NDArray[np.uint8]  # (H, W, S) forestgen.core.parts.Part; NOTHING is sky
    depth_m: NDArray[np.float32]  # (H, W) along the camera's z at the pixel centre; inf where nothing is hit
    position_m: NDArray[np.float32]  # (H, W, 3) world position at the pixel centre; NaN where nothing is hit
    normal: NDArray[np.float32]  # (H, W, 3) world, unit, geometric, towards the camera; 0 where nothing is hit
    albedo: NDArray[np.float32]  # (H, W, 3) mean of the samples' reflectance + transmittance, for the denoiser; sky 1
    mean_normal: NDArray[np.float32]  # (H, W, 3) mean of the samples' normals, for the denoiser


@dataclass(frozen=True)
class Radiance:
    """Linear Rec. 709 radiance."""

    mean: NDArray[np.float32]  # (H, W, 3)
    variance: NDArray[np.float32]  # (H, W, 3) of the mean
    denoised: NDArray[np.float32] | None  # (H, W, 3)
    samples: int


@dataclass(frozen=True)
class Frame:
    """One camera's view of one drawn recipe."""

    camera: Camera
    radiance: Radiance
    identity: Identity
