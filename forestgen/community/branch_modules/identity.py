"""Random numbers and attitudes of modules by who they are: the same whatever else grows, and in whatever order."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def _mixed(bits: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """The finaliser of SplitMix64 (Steele et al. 2014)."""
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(bits ^ (bits >> np.uint64(31)))


def uniform(seed: int, plant_id: NDArray[Any], number: NDArray[Any]) -> NDArray[np.float64]:
    """(N,) in [0, 1): one random number of each module, by its plant's id and its own number."""
    bits = np.full(len(plant_id), seed % 2**64, dtype=np.uint64)
    for identity in (plant_id, number):
        bits = _mixed(bits + np.uint64(0x9E3779B97F4A7C15) + identity.astype(np.uint64))
    return (bits >> np.uint64(11)).astype(np.float64) * 2.0**-53


def along(direction: NDArray[Any], roll_rad: NDArray[np.float64]) -> NDArray[np.float32]:
    """(N, 4) unit quaternions w, x, y, z that take z to unit vectors (N, 3), rolled about z by these angles before."""
    x, y, z = direction.astype(np.float64).T
    # The least rotation from z, of axis (-y, x, 0); straight down any axis will do.
    down = z < -1 + 1e-9
    w = np.sqrt(np.maximum(0.5 * (1.0 + z), 0.0))
    scale = 0.5 / np.where(down, 1.0, w)
    a, b = np.where(down, 1.0, -y * scale), np.where(down, 0.0, x * scale)
    w = np.where(down, 0.0, w)
    cosine, sine = np.cos(0.5 * roll_rad), np.sin(0.5 * roll_rad)
    turned = np.stack([w * cosine, a * cosine + b * sine, b * cosine - a * sine, w * sine], axis=-1)
    return np.asarray(turned / np.linalg.norm(turned, axis=-1, keepdims=True), dtype=np.float32)
