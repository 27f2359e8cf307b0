"""Denoising with Intel Open Image Denoise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.render.variant import mitsuba


def denoise(
    colour: NDArray[np.float32], albedo: NDArray[np.float32] | None = None, normal: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """(H, W, 3) radiance, guided by albedo (1 where the sky is: 0 there biases clouds by -2.8%) and world normals."""
    mitsuba()  # the denoiser shares Dr.Jit's thread pool: load it first
    import mitsuba_oidn

    result = mitsuba_oidn.denoise(
        np.ascontiguousarray(colour),
        albedo=None if albedo is None else np.ascontiguousarray(albedo),
        normal=None if normal is None else np.ascontiguousarray(normal),
        hdr=True,
    )
    return np.asarray(result, dtype=np.float32)
