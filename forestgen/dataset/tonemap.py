"""From linear radiance to a picture for people: exposure, a filmic curve, sRGB. Pure NumPy, deterministic.

Exposure brings the picture's key to middle grey (0.18). The key is the geometric mean of luminance clipped at
its 5th and 95th percentile: black gaps and the sun's disc hardly count. Each channel then follows

    y = x^n (1 + (c/w)^n) / (x^n + c^n),        n = 1.25

which is steep around middle grey, bends highlights over as film does and reaches 1 at w, the exposed luminance of
the 99.7th percentile (at least 4: a dull picture is not stretched). c is such that middle grey maps to itself.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MIDDLE_GREY = 0.18
KEY_PERCENTILES = (5.0, 95.0)
WHITE_PERCENTILE = 99.7
LEAST_WHITE = 4.0
CONTRAST = 1.25
_RED, _GREEN, _BLUE = np.float32(0.2126), np.float32(0.7152), np.float32(0.0722)  # ITU-R BT.709-6, item 3.2
_DARKEST, _INFINITE = 1e-20, 1e30


def tone_map(radiance: NDArray[np.float32], exposure: float | None = None) -> NDArray[np.uint8]:
    """sRGB picture of linear Rec. 709 radiance.

    Parameters
    ----------
    radiance : (H, W, 3) float32. NaN and negative values count as 0, infinite ones as white.
    exposure : factor on radiance, for pictures that are compared; by default the one that the picture's key asks for.

    Returns
    -------
    (H, W, 3) uint8, sRGB.
    """
    light = np.nan_to_num(radiance, nan=0.0, posinf=_INFINITE, neginf=0.0).clip(0.0)
    red, green, blue = np.moveaxis(light, -1, 0)
    luminance = _RED * red + _GREEN * green + _BLUE * blue
    if exposure is not None:
        return _encode(_curve(light * np.float32(exposure), LEAST_WHITE))
    metered, white = _exposure(luminance)
    return _encode(_curve(light * metered, white))


def _exposure(luminance: NDArray[np.float32]) -> tuple[np.float32, float]:
    """Factor that brings the key to middle grey, and the exposed luminance that becomes white."""
    lit = luminance[luminance > _DARKEST]
    if lit.size == 0:
        return np.float32(1.0), LEAST_WHITE
    low, high, top = np.percentile(lit, [*KEY_PERCENTILES, WHITE_PERCENTILE])
    key = float(np.exp(np.mean(np.log(lit.clip(low, high)), dtype=np.float64)))
    exposure = MIDDLE_GREY / key
    return np.float32(exposure), max(LEAST_WHITE, float(top) * exposure)


def _curve(x: NDArray[np.float32], white: float) -> NDArray[np.float32]:
    n = CONTRAST
    # Middle grey g maps to itself: g (g^n + c^n) = g^n (1 + c^n / w^n), solved for c^n.
    grey = MIDDLE_GREY**n
    c_n = grey * (1.0 - MIDDLE_GREY) / (MIDDLE_GREY - grey / white**n)
    power = np.minimum(x, np.float32(white)) ** np.float32(n)
    scale = np.float32(1.0 + c_n / white**n)
    return np.asarray(power * scale / (power + np.float32(c_n)), dtype=np.float32)


def _encode(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    """IEC 61966-2-1, through a table of 4096 steps of the square root: exact to under one step of 255."""
    steps = 1 << 12
    grid = (np.arange(steps) / (steps - 1)) ** 2
    srgb = np.where(grid <= 0.0031308, 12.92 * grid, 1.055 * grid ** (1 / 2.4) - 0.055)
    table = np.floor(srgb * 255.0 + 0.5).astype(np.uint8)
    step = np.sqrt(linear.clip(0.0, 1.0)) * np.float32(steps - 1) + np.float32(0.5)
    return np.asarray(table[step.astype(np.uint16)], dtype=np.uint8)
