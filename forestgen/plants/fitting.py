"""Stretching a grown plant so that its geometry has the height and width that the community asks for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Mesh
from forestgen.plants.skeleton import OrganPlacements, Skeleton

Floats = NDArray[np.float64]

_ROUNDS = 12
_STRETCH = (0.3, 3.0)


def fit(
    skeleton: Skeleton,
    organs: Sequence[OrganPlacements],
    templates: Mapping[str, Mesh],
    height_m: float,
    width_m: float,
) -> Skeleton:
    """Scale node positions and organ feet, horizontally and vertically apart, until the geometry's extents fit.

    Organs keep their size and attitude, wood its thickness. Where leaves alone are wider than `width_m` (a seedling
    is mostly leaf), the organs shrink too.

    Parameters
    ----------
    templates : organ shapes by name, for the organs' own extents.
    height_m : of the topmost point.
    width_m : mean of the extents in x and y.
    """
    feet, low, high = _extents(organs, templates)
    nodes = skeleton.position_m.astype(np.float64)
    stretch, organ_size = np.ones(3), 1.0
    for _ in range(_ROUNDS):
        lowest = np.minimum((nodes * stretch).min(axis=0), (feet * stretch + low * organ_size).min(axis=0))
        highest = np.maximum((nodes * stretch).max(axis=0), (feet * stretch + high * organ_size).max(axis=0))
        width = 0.5 * float(np.sum((highest - lowest)[:2]))
        span = 0.5 * float(np.sum(np.ptp(nodes, axis=0)[:2]))
        stretch[:2] = np.clip(stretch[:2] + (width_m - width) / max(span, 0.05 * width_m), *_STRETCH)
        stretch[2] = np.clip(stretch[2] + (height_m - highest[2]) / nodes[:, 2].max(), *_STRETCH)
        if stretch[0] in _STRETCH:
            organ_size = float(np.clip(organ_size * width_m / width, 0.4, 1.6))
    return replace(
        skeleton,
        position_m=(nodes * stretch).astype(np.float32),
        organs=tuple(_moved(placement, stretch, organ_size) for placement in organs),
    )


def _extents(organs: Sequence[OrganPlacements], templates: Mapping[str, Mesh]) -> tuple[Floats, Floats, Floats]:
    """Feet of all organs and the corners of their boxes relative to them, each (M, 3)."""
    feet, low, high = [np.zeros((1, 3))], [np.zeros((1, 3))], [np.zeros((1, 3))]
    for placement in organs:
        reach = templates[placement.shape].vertices_m @ placement.frame[:, :, :3].transpose(0, 2, 1)
        feet.append(placement.frame[:, :, 3].astype(np.float64))
        low.append(reach.min(axis=1).astype(np.float64))
        high.append(reach.max(axis=1).astype(np.float64))
    return np.concatenate(feet), np.concatenate(low), np.concatenate(high)


def _moved(placement: OrganPlacements, stretch: Floats, organ_size: float) -> OrganPlacements:
    frame = placement.frame.copy()
    frame[:, :, 3] *= stretch.astype(np.float32)
    frame[:, :, :3] *= np.float32(organ_size)
    return replace(placement, frame=frame)
