"""Outlines of masks as polygons on the edges of pixels, exact, one polygon a plant.

A plant's pixels are unit squares; their union's border is a set of loops on the pixel grid: outer ones, around parts
of the plant that touch along edges (pixels that touch at a corner only are apart), and inner ones, around holes, the
other way round. One polygon holds them all: each loop after the first is joined to the nearest corner (in the
Chebyshev distance) of an earlier one by a bridge of no width, walked there and back. So a point lies inside the
polygon, by the even-odd rule as well as by the non-zero one, exactly if its pixel is the plant's: holes and scattered
leaves included.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.compiled import compiled

Corners = NDArray[np.int32]  # (N, 2) x, y: corners of pixels, from (0, 0) to (width, height)

# Sides of a pixel in the order of a walk around it with the pixel at the right hand: top, right, bottom, left.
_STEP_X = np.array([1, 0, -1, 0])
_STEP_Y = np.array([0, 1, 0, -1])
_OUT_X = np.array([0, 1, 0, -1])  # what lies beyond a side
_OUT_Y = np.array([-1, 0, 1, 0])
_START_X = np.array([0, 1, 1, 0])  # where the walk along a side starts, from the pixel's upper left corner
_START_Y = np.array([0, 0, 1, 1])


def polygons(instance: NDArray[np.uint32]) -> dict[int, Corners]:
    """The polygon of every plant of a mask.

    Parameters
    ----------
    instance : (H, W) uint32; 0 is no plant.

    Returns
    -------
    plant_id -> (N, 2) int32 corners x, y, ids rising; the last corner joins the first.
    """
    corners, begin, owner = _loops(np.ascontiguousarray(instance))
    if len(owner) == 0:
        return {}
    order = np.argsort(owner, kind="stable")  # by plant; within one, as rows meet them: outer loops before their holes
    joined, end = _join(corners, begin, order, owner, instance.shape[0], instance.shape[1])
    plants, first = np.unique(owner[order], return_index=True)
    last = np.append(first[1:], len(order)) - 1
    return {
        int(plant): joined[0 if low == 0 else end[low - 1] : end[high]]
        for plant, low, high in zip(plants, first, last, strict=True)
    }


@compiled
def _loops(instance: Any) -> Any:
    """Corners of all loops (K, 2), where each loop begins (L + 1,), and its plant (L,)."""
    height, width = instance.shape
    sides = 0
    for y in range(height):
        for x in range(width):
            if instance[y, x] != 0:
                for side in range(4):
                    sides += _is_border(instance, y, x, side)
    corners = np.empty((sides, 2), np.int32)
    begin = np.empty(sides // 4 + 1, np.int64)
    owner = np.empty(sides // 4, np.uint32)
    done = np.zeros((height, width), np.uint8)
    count, loops = 0, 0
    for y in range(height):
        for x in range(width):
            if instance[y, x] == 0:
                continue
            for side in range(4):
                if done[y, x] >> side & 1 or not _is_border(instance, y, x, side):
                    continue
                begin[loops] = count
                owner[loops] = instance[y, x]
                count = _walk(instance, y, x, side, done, corners, count)
                loops += 1
    begin[loops] = count
    return corners[:count], begin[: loops + 1], owner[:loops]


@compiled
def _is_border(instance: Any, y: int, x: int, side: int) -> bool:
    """Nothing, or another plant, lies beyond a side of a plant's pixel."""
    height, width = instance.shape
    other_y, other_x = y + _OUT_Y[side], x + _OUT_X[side]
    if other_y < 0 or other_x < 0 or other_y >= height or other_x >= width:
        return True
    return bool(instance[other_y, other_x] != instance[y, x])


@compiled
def _walk(instance: Any, y: int, x: int, side: int, done: Any, corners: Any, count: int) -> int:
    """Follow the loop of a side, marking its sides and writing a corner at each turn."""
    while not done[y, x] >> side & 1:
        done[y, x] |= np.uint8(1 << side)
        turn = (side + 1) % 4
        corner_x, corner_y = x + _START_X[turn], y + _START_Y[turn]
        if _is_border(instance, y, x, turn):  # the pixel's own next side
            corners[count, 0], corners[count, 1] = corner_x, corner_y
            count += 1
            side = turn
            continue
        y, x = y + _STEP_Y[side], x + _STEP_X[side]
        if not _is_border(instance, y, x, side):  # the way is barred by the pixel diagonally ahead: turn outwards
            corners[count, 0], corners[count, 1] = corner_x, corner_y
            count += 1
            y, x = y + _OUT_Y[side], x + _OUT_X[side]
            side = (side + 3) % 4
    return count


@compiled
def _join(corners: Any, begin: Any, order: Any, owner: Any, height: int, width: int) -> Any:
    """Corners of joined loops, plant by plant, and the number of them written after each loop's plant so far (L,).

    A plant's loops make a tree: a loop's parent corner is the nearest of all earlier loops' corners to its own first.
    """
    total, loops = corners.shape[0], order.shape[0]
    joined = np.empty((total + 2 * loops, 2), np.int32)
    end = np.zeros(loops, np.int64)
    at = np.full((height + 1, width + 1), -1, np.int64)  # last corner written down at each place of the grid
    loop_of = np.empty(total, np.int64)
    child = np.full(total, -1, np.int64)  # first loop that hangs on a corner
    sibling = np.full(loops, -1, np.int64)  # next loop that hangs on the same corner
    path = np.empty(loops, np.int64)  # loops that are being walked, outermost first
    place = np.empty(loops, np.int64)  # corner reached in each
    count, low = 0, 0
    while low < loops:
        high = low
        while high < loops and owner[order[high]] == owner[order[low]]:
            loop = order[high]
            if high > low:
                parent = _nearest(at, corners, begin[loop], loop_of, owner, owner[loop])
                sibling[loop] = child[parent]
                child[parent] = loop
            for corner in range(begin[loop], begin[loop + 1]):
                at[corners[corner, 1], corners[corner, 0]] = corner
                loop_of[corner] = loop
            high += 1
        count = _write_tree(corners, begin, order[low], child, sibling, path, place, joined, count)
        end[low:high] = count
        low = high
    return joined[:count], end


@compiled
def _nearest(at: Any, corners: Any, corner: int, loop_of: Any, owner: Any, plant: Any) -> int:
    """The nearest written corner of a plant, by growing squares around a corner."""
    rows, columns = at.shape
    x, y = corners[corner, 0], corners[corner, 1]
    for radius in range(max(rows, columns)):
        top, bottom = max(0, y - radius), min(rows - 1, y + radius)
        for row in range(top, bottom + 1):
            whole = row == y - radius or row == y + radius
            step = 1 if whole or radius == 0 else 2 * radius
            for column in range(x - radius, x + radius + 1, step):
                if 0 <= column < columns:
                    found = at[row, column]
                    if found >= 0 and owner[loop_of[found]] == plant:
                        return int(found)
    return -1  # cannot be: an earlier loop of the plant has corners


@compiled
def _write_tree(
    corners: Any, begin: Any, root: int, child: Any, sibling: Any, path: Any, place: Any, joined: Any, count: int
) -> int:
    """Walk a tree of loops from its root: each loop once around, a bridge to each loop that hangs on a corner."""
    depth = 0
    path[0], place[0] = root, begin[root]
    joined[count] = corners[place[0]]
    count += 1
    while True:
        corner = place[depth]
        hanging = child[corner]
        if hanging >= 0:
            child[corner] = sibling[hanging]
            depth += 1
            path[depth], place[depth] = hanging, begin[hanging]
            joined[count] = corners[place[depth]]
            count += 1
        elif corner + 1 < begin[path[depth] + 1]:
            place[depth] = corner + 1
            joined[count] = corners[corner + 1]
            count += 1
        elif depth == 0:
            return count
        else:  # close this loop, and cross the bridge back
            joined[count] = corners[begin[path[depth]]]
            depth -= 1
            joined[count + 1] = corners[place[depth]]
            count += 2
