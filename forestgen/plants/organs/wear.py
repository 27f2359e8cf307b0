"""Leaves that insects and wind have worn: bites out of the margin, and holes.

About every sixth leaf of a broad-leaved tree near a camera (our estimate) has lost about a tenth of its area; in all
that is some 2%, where a temperate broad-leaved forest loses 7% in a year (Coley and Barone 1996, Annual Review of
Ecology and Systematics 27, 305-335; from memory). The leaf area of a plant is what is left: the others make up for it.
"""

from __future__ import annotations

import numpy as np

from forestgen.geometry.mesh import Floats
from forestgen.geometry.patches import Patch

_BITES = (1, 4)  # from, below
_BITE = (0.2, 0.45)  # radius over the leaf's half-width
_HOLE = (0.1, 0.2)
_HOLES = 2
_PLACE = (0.35, 0.95)  # of bites along the leaf


def worn(patch: Patch, rng: np.random.Generator, larger: float = 1.0) -> Patch:
    """A leaf along y with pieces missing, which may be larger than those of a living one.

    Each triangle is cut into 4, of a leaf of fewer than 40 triangles into 16; those of the pieces are left out.
    """
    fine = _quartered(_quartered(patch)) if len(patch.faces) < 40 else _quartered(patch)
    flat = fine.points[:, :2]
    half_m = float(np.abs(flat[:, 0]).max())
    middle = flat[fine.faces].mean(axis=1)
    gone = np.zeros(len(fine.faces), dtype=np.bool_)
    low, high = float(flat[:, 1].min()), float(flat[:, 1].max())
    for number in range(int(rng.integers(*_BITES)) + _HOLES):
        is_hole = number < _HOLES
        y = low + rng.uniform(*_PLACE) * (high - low)
        side = rng.choice([-1.0, 1.0])
        x = side * (rng.uniform(0.2, 0.6) * half_m if is_hole else _margin(flat, y, side))
        radius = rng.uniform(*(_HOLE if is_hole else _BITE)) * larger * half_m
        away = np.hypot(middle[:, 0] - x, middle[:, 1] - y)
        gone |= (away < radius) & (np.abs(middle[:, 0]) > 0.08 * half_m)  # the midrib stays
    return fine._replace(faces=fine.faces[~gone])


def piece(patch: Patch, rng: np.random.Generator) -> Patch:
    """A piece of a dead leaf along y: what lies on one side of a ragged tear across it, more than a third."""
    fine = _quartered(patch)
    middle = fine.points[fine.faces][:, :, :2].mean(axis=1)
    turn = rng.uniform(-0.7, 0.7)
    along = middle[:, 1] * np.cos(turn) + middle[:, 0] * np.sin(turn)
    along = along + 0.02 * np.ptp(middle[:, 1]) * rng.normal(size=len(along))
    is_tip = rng.random() < 0.5
    edge = float(np.quantile(along, rng.uniform(0.35, 0.75)))
    return fine._replace(faces=fine.faces[(along > edge) == is_tip])


def _margin(flat: Floats, y: float, side: float) -> float:
    """Half-width of the leaf on one side about a height."""
    near = np.argsort(np.abs(flat[:, 1] - y))[: max(len(flat) // 8, 3)]
    return float(np.max(side * flat[near, 0]))


def _quartered(patch: Patch) -> Patch:
    """Each triangle as four, of half the side."""
    edges = np.sort(np.concatenate([patch.faces[:, [0, 1]], patch.faces[:, [1, 2]], patch.faces[:, [2, 0]]]), axis=1)
    edge, of_edge = np.unique(edges, axis=0, return_inverse=True)
    start, count = len(patch.points), len(patch.faces)
    ab, bc, ca = (start + of_edge.reshape(-1)[k * count : (k + 1) * count] for k in range(3))
    a, b, c = patch.faces.T
    faces = np.concatenate([np.column_stack(one) for one in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    points, uv = (np.concatenate([one, one[edge].mean(axis=1)]) for one in (patch.points, patch.uv))
    return Patch(points, faces.astype(np.int64), uv)
