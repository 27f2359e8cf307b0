"""Stretching a grown plant so that its geometry has the height and width that the community asks for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Floats, Mesh
from forestgen.plants.parameters import Fit
from forestgen.plants.skeleton import OrganPlacements, Skeleton

_ROUNDS = 12
_STRETCH = (0.3, 3.0)


def fit(skeleton: Skeleton, templates: Mapping[str, Mesh], how: Fit, height_m: float, width_m: float) -> Skeleton:
    """The plant at the size that the community asks for; `how` as in `PlantParameters.fit`.

    `templates`: organ shapes by name, for the organs' own extents. `height_m`: of the topmost point. `width_m`: mean of
    the extents in x and y; "stretch" alone keeps to it.
    """
    match how:
        case "stretch":
            return _stretch(skeleton, templates, height_m, width_m)
        case "scale":
            return _scale(skeleton, templates, height_m)
        case "scale_all":
            feet, _, high = _extents(skeleton.organs, templates)
            top = max(float(skeleton.position_m[:, 2].max()), float((feet + high)[:, 2].max()))
            return _scaled(skeleton, height_m / max(top, 1e-9), organs_too=True)
        case "none":
            return skeleton


def _scale(skeleton: Skeleton, templates: Mapping[str, Mesh], height_m: float) -> Skeleton:
    """The wood scaled until the topmost point, of wood or organ, is at `height_m`; organs keep their size."""
    feet, _, high = _extents(skeleton.organs, templates)
    nodes = float(skeleton.position_m[:, 2].max())
    factor = height_m / max(nodes, 1e-9)
    for _ in range(_ROUNDS):
        top = max(nodes * factor, float((feet[:, 2] * factor + high[:, 2]).max()))
        factor = float(np.clip(factor + (height_m - top) / max(nodes, 1e-9), 1e-3 * factor, 1e3 * factor))
    return _scaled(skeleton, factor, organs_too=False)


def _scaled(skeleton: Skeleton, factor: float, *, organs_too: bool) -> Skeleton:
    stretch = np.full(3, factor)
    return replace(
        skeleton,
        position_m=(skeleton.position_m * np.float32(factor)).astype(np.float32),
        radius_m=(skeleton.radius_m * np.float32(factor)).astype(np.float32),
        organs=tuple(moved(placement, stretch, factor if organs_too else 1.0) for placement in skeleton.organs),
    )


def _stretch(skeleton: Skeleton, templates: Mapping[str, Mesh], height_m: float, width_m: float) -> Skeleton:
    """Scale node positions and organ feet, horizontally and vertically apart, until the geometry's extents fit.

    Organs keep their size and attitude, wood its thickness. Where leaves alone are wider than `width_m` (a seedling
    is mostly leaf), the organs shrink too.
    """
    organs = skeleton.organs
    feet, low, high = _extents(organs, templates)
    nodes = skeleton.position_m.astype(np.float64)
    top = max(float(nodes[:, 2].max()), 1e-9)
    stretch, organ_size = np.ones(3), 1.0
    for _ in range(_ROUNDS):
        lowest = np.minimum((nodes * stretch).min(axis=0), (feet * stretch + low * organ_size).min(axis=0))
        highest = np.maximum((nodes * stretch).max(axis=0), (feet * stretch + high * organ_size).max(axis=0))
        width = 0.5 * float(np.sum((highest - lowest)[:2]))
        span = 0.5 * float(np.sum(np.ptp(nodes, axis=0)[:2]))
        stretch[:2] = np.clip(stretch[:2] + (width_m - width) / max(span, 0.05 * width_m), *_STRETCH)
        stretch[2] = np.clip(stretch[2] + (height_m - highest[2]) / top, *_STRETCH)
        if stretch[0] in _STRETCH:
            organ_size = float(np.clip(organ_size * width_m / max(width, 1e-9), 0.4, 1.6))
    return replace(
        skeleton,
        position_m=(nodes * stretch).astype(np.float32),
        organs=tuple(moved(placement, stretch, organ_size) for placement in organs),
    )


def _extents(organs: Sequence[OrganPlacements], templates: Mapping[str, Mesh]) -> tuple[Floats, Floats, Floats]:
    """Feet of all organs and the corners of their boxes, relative to them, each (M, 3)."""
    feet, low, high = [np.zeros((1, 3))], [np.zeros((1, 3))], [np.zeros((1, 3))]
    for placement in organs:
        reach = templates[placement.shape].vertices_m @ placement.frame[:, :, :3].transpose(0, 2, 1)
        feet.append(placement.frame[:, :, 3].astype(np.float64))
        low.append(reach.min(axis=1).astype(np.float64))
        high.append(reach.max(axis=1).astype(np.float64))
    return np.concatenate(feet), np.concatenate(low), np.concatenate(high)


def moved(placement: OrganPlacements, stretch: NDArray[np.floating], organ_size: float) -> OrganPlacements:
    """The organs with their feet stretched and their size multiplied."""
    frame = placement.frame.copy()
    frame[:, :, 3] *= stretch.astype(np.float32)
    frame[:, :, :3] *= np.float32(organ_size)
    return replace(placement, frame=frame)
