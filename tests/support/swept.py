"""Tubes without what the mesher wants besides, and their volumes by a formula."""

from __future__ import annotations

from typing import Any

import numpy as np

from forestgen.geometry.mesh import Mesh, concatenate
from forestgen.geometry.sweep import Polylines, sweep_tubes
from forestgen.plants.meshing import wood_meshes


def sweep(*arguments: Any, **options: Any) -> Mesh:
    """The mesh of `sweep_tubes`."""
    return sweep_tubes(*arguments, **options)[0]


def wood_mesh(*arguments: Any, **options: Any) -> Mesh:
    """The tubes of `wood_meshes` as one mesh."""
    none = sweep(Polylines(np.zeros((0, 3)), np.zeros(0), np.zeros(1, np.int64)), np.zeros(0, np.int64))
    return concatenate([none, *(mesh for mesh, _ in wood_meshes(*arguments, **options))])


def volume_m3(lines: Polylines) -> float:
    """Sum of the frusta between consecutive points."""
    inner = np.ones(len(lines.radius_m), dtype=bool)
    inner[lines.offset[1:] - 1] = False
    i = np.flatnonzero(inner)
    length = np.linalg.norm(lines.points_m[i + 1] - lines.points_m[i], axis=1)
    a, b = lines.radius_m[i], lines.radius_m[i + 1]
    return float(np.sum(length * (a * a + a * b + b * b)) * np.pi / 3.0)
