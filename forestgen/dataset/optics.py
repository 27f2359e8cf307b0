"""What a lens does to the light of a raw image: falloff, lateral colour, blur, glare. frame.exr has none of it.

    falloff            1 + k1 r² + k2 r⁴ + k3 r⁶       r: 1 in the image's corners, as the `pa` model of Lensfun
    lateral colour     red and blue are larger than green by the factors 1 + s about the image's middle
    blur               L * exp(-r² / (2 b²)) / (2 pi b²)   b: its standard deviation, by diffraction, aberrations, focus
    veiling glare      (1 - g) L + g (L * G)           G: r0 / (2 pi (r² + r0²)^(3/2)), whose integral is 1

G falls as the third power of the distance, as the widest part of the glare of Spencer, Shirley, Zimmerman and Greenberg
(1995) does; r0 is a tenth of the image's diagonal. Its Fourier transform is exp(-2 pi r0 f). The image goes on beyond
its edges as in a mirror, so its mean is kept. g is about ISO 9358's veiling glare index: 0.01 to 0.05 of most lenses.

References
----------
ISO 9358 (1994). Optics and optical instruments. Veiling glare of image forming systems.
Spencer, G., Shirley, P., Zimmerman, K. and Greenberg, D. P. (1995). Physically-based glare effects for digital images.
SIGGRAPH 95, 325-334.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
_GLARE_SHARE = 0.1  # r0 by the image's diagonal


def falloff(size_px: tuple[int, int], coefficients: Sequence[float]) -> Floats:
    """(H, W) share of light by the distance of a pixel's centre from the middle."""
    width, height = size_px
    x, y = np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2
    square = (x**2 + y[:, None] ** 2) / ((width / 2) ** 2 + (height / 2) ** 2)
    k1, k2, k3 = (*coefficients, 0.0, 0.0, 0.0)[:3]
    return np.maximum(1.0 + square * (k1 + square * (k2 + square * k3)), 0.0)


def through_lens(
    light: Floats, chromatic_aberration: Sequence[float], veiling_glare: float, blur_px: float = 0.0
) -> Floats:
    """(H, W, C) light on the sensor. `chromatic_aberration`: of the first and of the last channel."""
    if any(chromatic_aberration):
        light = light.copy()
        for channel, growth in zip((0, -1), chromatic_aberration, strict=True):
            light[..., channel] = _enlarged(light[..., channel], growth)
    return _spread(light, veiling_glare, blur_px) if veiling_glare or blur_px else light


def _enlarged(image: Floats, growth: float) -> Floats:
    """(H, W) about its middle by 1 + growth, linear between pixels."""
    from scipy.ndimage import map_coordinates

    middle = (np.array(image.shape) - 1) / 2
    rows, columns = ((np.arange(size) - at) / (1 + growth) + at for size, at in zip(image.shape, middle, strict=True))
    return np.asarray(map_coordinates(image, np.meshgrid(rows, columns, indexing="ij"), order=1, mode="nearest"))


def _spread(light: Floats, glare: float, blur_px: float) -> Floats:
    from scipy.fft import dctn, idctn

    height, width = light.shape[:2]
    frequency = np.hypot(np.arange(width) / (2 * width), (np.arange(height) / (2 * height))[:, None])
    transfer = (1 - glare) * np.exp(-2 * (np.pi * blur_px * frequency) ** 2)
    transfer += glare * np.exp(-2 * np.pi * _GLARE_SHARE * np.hypot(width, height) * frequency)
    spread = idctn(dctn(light, axes=(0, 1)) * transfer[..., None], axes=(0, 1))
    return np.asarray(np.maximum(spread, 0.0))
