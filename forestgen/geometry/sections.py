"""Areas of a mesh's horizontal sections.

A plane cuts each triangle that it crosses in a segment, directed so that the inside lies to its left. The section's
area is that of all points round which the segments wind: where tubes overlap, as at a fork, the wood counts
once. On a line across the section the winding number is known between crossings; lines through the middles of the
strips between neighbouring corners sum up to the area, exactly but where outlines cross within a strip.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from forestgen.core.compiled import compiled
from forestgen.geometry.mesh import Mesh


def section_area_m2(meshes: Sequence[Mesh], height_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """(K,) areas of the meshes' common sections at (K,) heights; 0 where nothing is cut.

    Windings are counter-clockwise seen from outside; a surface that is open at a height encloses nothing there. O(faces
    near the heights, times their number).
    """
    area = np.zeros(len(height_m))
    if not len(height_m) or not meshes:
        return area
    corner = np.concatenate([_near(mesh, height_m) for mesh in meshes])
    _sections(corner, np.ascontiguousarray(height_m, dtype=np.float64), area)
    return area


def _near(mesh: Mesh, height_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """(F, 3, 3) corners of the triangles that lie in the heights' range at least in part."""
    z = mesh.vertices_m[:, 2].astype(np.float64)[mesh.faces]
    chosen = (z.max(axis=1) >= height_m.min()) & (z.min(axis=1) <= height_m.max())
    return np.asarray(mesh.vertices_m.astype(np.float64)[mesh.faces[chosen]])


@compiled
def _sections(corner, height_m, area):  # type: ignore[no-untyped-def]
    segments = np.empty((len(corner), 4))
    for k in range(len(height_m)):
        count = 0
        for triangle in range(len(corner)):
            if _cut(corner[triangle], height_m[k], segments[count]):
                count += 1
        area[k] = _union(segments[:count])


@compiled
def _cut(corner, height_m, segment):  # type: ignore[no-untyped-def]
    """x, y of both ends of the cut through a triangle, its inside to the left; False if the plane misses it."""
    above = 0
    for i in range(3):
        above += corner[i, 2] >= height_m  # a corner in the plane counts as above: each outline closes
    if above == 0 or above == 3:
        return False
    alone = 0  # the corner on its own side
    for i in range(3):
        if (corner[i, 2] >= height_m) == (above == 1):
            alone = i
    after, before = (alone + 1) % 3, (alone + 2) % 3
    if above == 2:
        after, before = before, after
    for end, other in enumerate((after, before)):
        # From the lower to the upper corner, for both triangles of an edge: they agree to the bit.
        low, high = (other, alone) if above == 1 else (alone, other)
        share = (height_m - corner[low, 2]) / (corner[high, 2] - corner[low, 2])
        for axis in range(2):
            segment[2 * end + axis] = corner[low, axis] + share * (corner[high, axis] - corner[low, axis])
    return True


@compiled
def _union(segments):  # type: ignore[no-untyped-def]
    """Area of the points of winding number other than 0."""
    count = len(segments)
    level = np.empty(2 * count)
    for s in range(count):
        level[2 * s], level[2 * s + 1] = segments[s, 1], segments[s, 3]
    level = np.sort(level)
    crossing, turn = np.empty(count), np.empty(count)
    area = 0.0
    for strip in range(2 * count - 1):
        thickness = level[strip + 1] - level[strip]
        if thickness <= 0.0:
            continue
        y = level[strip] + 0.5 * thickness
        found = 0
        for s in range(count):
            y0, y1 = segments[s, 1], segments[s, 3]
            if (y0 <= y) != (y1 <= y):
                crossing[found] = segments[s, 0] + (y - y0) / (y1 - y0) * (segments[s, 2] - segments[s, 0])
                turn[found] = 1.0 if y1 > y0 else -1.0
                found += 1
        order = np.argsort(crossing[:found])
        winding = 0.0
        for i in range(found - 1):
            winding += turn[order[i]]
            if winding != 0.0:
                area += thickness * (crossing[order[i + 1]] - crossing[order[i]])
    return area
