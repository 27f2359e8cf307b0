"""Denoising with Intel Open Image Denoise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.render.variant import mitsuba


def denoise(
    colour: NDArray[np.float32], guide: NDArray[np.float32] | None = None, normal: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """(H, W, 3) radiance, guided by noise-free colours (1 where the sky is: 0 biases clouds by -2.8%) and normals."""
    mitsuba()  # the denoiser shares Dr.Jit's thread pool: load it first
    import mitsuba_oidn

    result = mitsuba_oidn.denoise(
        np.ascontiguousarray(colour),
        albedo=None if guide is None else np.ascontiguousarray(guide),
        normal=None if normal is None else np.ascontiguousarray(normal),
        hdr=True,
        clean_aux=guide is not None,
        input_scale=_exposure(colour),
    )
    return np.asarray(result, dtype=np.float32)


def denoise_bands(
    image: NDArray[np.float32], guide: NDArray[np.float32] | None = None, normal: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """(H, W, C) of any number of bands: three at a time, each group brought to one brightness and back."""
    bands = image.shape[2]
    level = np.maximum(np.nan_to_num(image).mean(axis=(0, 1), dtype=np.float64), 1e-30)
    result = np.empty_like(image)
    for first in range(0, bands, 3):
        own = np.minimum(np.arange(first, first + 3), bands - 1)  # the last group repeats its last band
        clean = denoise((image[..., own] / level[own]).astype(np.float32), guide, normal)
        kept = min(3, bands - first)
        result[..., first : first + kept] = clean[..., :kept] * level[own[:kept]]
    return result


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
