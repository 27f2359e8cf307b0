"""Which part of a skeleton each triangle of its mesh belongs to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Mesh
from forestgen.geometry.sweep import Polylines

Ints = NDArray[np.int64]


def tube_marks(
    mesh: Mesh, vertex_start: Ints, lines: Polylines, mark: NDArray[np.uint32], tile_m: float
) -> NDArray[np.uint32]:
    """(F,) marks of the triangles of swept tubes: of the segment beside which each lies.

    A tube's texture runs along it by arc length, which tells the segment; caps have a texture of their own, and are
    their ends'.

    Parameters
    ----------
    mesh : tubes, see `geometry.sweep.sweep_tubes`.
    vertex_start : (A + 1,) where each tube's vertices begin.
    lines : the A polylines that the tubes follow; they may be finer, and go on beyond the ends.
    mark : (P,) of the segment that each point of `lines` ends; a line's first is that of its second.
    tile_m : metres along a tube for which the texture runs from 0 to 1.
    """
    if not mesh.triangles or mesh.uv is None:
        return np.zeros(mesh.triangles, dtype=np.uint32)
    tube = np.searchsorted(vertex_start, mesh.faces[:, 0].astype(np.int64), side="right") - 1
    step = np.linalg.norm(np.diff(lines.points_m, axis=0, prepend=lines.points_m[:1]), axis=1)
    step[lines.offset[:-1]] = 0.0
    total = np.cumsum(step)
    begin, end = total[lines.offset[:-1]], total[lines.offset[1:] - 1]
    along = mesh.uv[:, 1].astype(np.float64)[mesh.faces].mean(axis=1) * tile_m
    place = np.clip(begin[tube] + along, begin[tube], end[tube])
    first, last = lines.offset[:-1][tube] + 1, lines.offset[1:][tube] - 1
    point = np.clip(np.searchsorted(total, place, side="left"), first, last)
    centre = mesh.vertices_m.astype(np.float64)[mesh.faces].mean(axis=1)
    share = (total[point] - place) / np.maximum(step[point], 1e-12)
    beside = lines.points_m[point] + np.clip(share, 0.0, 1.0)[:, None] * (
        lines.points_m[point - 1] - lines.points_m[point]
    )
    at_end = np.linalg.norm(centre - lines.points_m[last], axis=1) < np.linalg.norm(centre - beside, axis=1)
    return np.asarray(mark[np.where(at_end, last, point)], dtype=np.uint32)
