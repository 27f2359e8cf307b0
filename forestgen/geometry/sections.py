"""Areas of a mesh's horizontal sections.

A plane cuts each triangle that it crosses in a segment, directed so that the inside lies to its left. The section's
area is that of all points round which the segments wind: where tubes overlap, as at a fork, the wood counts
once. On a line across the section the winding number is known between crossings; lines through the middles of the
strips between neighbouring corners sum up to the area, exactly but where outlines cross within a strip.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from forestgen.core.compiled import compiled
from forestgen.geometry.mesh import Floats, Mesh


def section_area_m2(meshes: Sequence[Mesh], height_m: Floats) -> Floats:
    """(K,) areas of the meshes' common sections at (K,) heights; 0 where nothing is cut.

    Windings are counter-clockwise seen from outside; a surface that is open at a height encloses nothing there. O(faces
    near the heights, times their number).
    """
    if not len(height_m) or not meshes:
        return np.zeros(len(height_m))
    corners = np.concatenate([_near(mesh, height_m) for mesh in meshes])
    return np.array([_union(_cut(corners, float(one))) for one in height_m])


def _near(mesh: Mesh, height_m: Floats) -> Floats:
    """(F, 3, 3) corners of the triangles that lie in the heights' range at least in part."""
    z = mesh.vertices_m[:, 2].astype(np.float64)[mesh.faces]
    chosen = (z.max(axis=1) >= height_m.min()) & (z.min(axis=1) <= height_m.max())
    return np.asarray(mesh.vertices_m.astype(np.float64)[mesh.faces[chosen]])


def _cut(corners: Floats, height_m: float) -> Floats:
    """(S, 4) x, y of both ends of the cuts through the triangles that the plane crosses, their inside to the left."""
    above = corners[:, :, 2] >= height_m  # a corner in the plane counts as above: each outline closes
    crossed = above.any(axis=1) & ~above.all(axis=1)
    corners, above = corners[crossed], above[crossed]
    up = above.sum(axis=1) == 1
    row, alone = np.arange(len(up)), np.argmax(above == up[:, None], axis=1)  # the corner on its own side
    ends = []
    for other in ((alone + np.where(up, 1, 2)) % 3, (alone + np.where(up, 2, 1)) % 3):
        # From the lower to the upper corner, for both triangles of an edge: they agree to the bit.
        low, high = corners[row, np.where(up, other, alone)], corners[row, np.where(up, alone, other)]
        share = (height_m - low[:, 2]) / (high[:, 2] - low[:, 2])
        ends.append(low[:, :2] + share[:, None] * (high[:, :2] - low[:, :2]))
    return np.concatenate(ends, axis=1)


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
