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
        input_scale=_exposure(colour),
    )
    return np.asarray(result, dtype=np.float32)


def _exposure(colour: NDArray[np.float32]) -> float:
    """Scale that brings an image to the brightness that the denoiser was trained on.

    The denoiser's own automatic exposure, recomputed: 0.18 over the geometric mean of the luminance of 16 x 16 pixel
    blocks. Its parallel sum depends on the number of threads in the last bits, and so would every denoised pixel.
    """
    luminance = np.nan_to_num(colour.astype(np.float64)) @ [0.212671, 0.715160, 0.072169]
    rows, columns = (np.arange(0, length, 16) for length in luminance.shape)
    block = np.add.reduceat(np.add.reduceat(luminance, rows, axis=0), columns, axis=1)
    size = np.diff([*rows, luminance.shape[0]])[:, None] * np.diff([*columns, luminance.shape[1]])
    mean = block / size
    lit = mean[mean > 1e-8]
    return float(0.18 / np.exp2(np.log2(lit).mean())) if len(lit) else 1.0
