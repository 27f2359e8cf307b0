"""Frames of reference, and the height at which stems are measured.

World: metres, right-handed, x east, y north, z up; the site is [0, W] x [0, H]. Camera: OpenCV's, x right, y down,
z forward; pixel centres at +0.5.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

BREAST_HEIGHT_M = 1.3  # at which stems are measured; a plant that does not reach it has none


def look_at(position_m: Sequence[float], target_m: Sequence[float]) -> NDArray[np.float64]:
    """(3, 3) rotation whose columns are the camera's right, down and forward axes in the world, the horizon level."""
    forward = np.subtract(target_m, position_m).astype(np.float64)
    length = float(np.linalg.norm(forward))
    if length < 1e-9:
        raise ValueError("a camera cannot look at its own position")
    forward /= length
    # Straight up or down there is no horizon: north is then the top of the image.
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 1.0 - 1e-9 else np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward], axis=1)
