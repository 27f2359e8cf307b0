"""Which pieces of a plant's mask one outline joins, and by which bridges.

An outline is one closed line, so what it fills is connected; a crown behind leaves is many pieces. A bridge between two
pieces fills pixels that are not the plant's. How many depends on the rasteriser, dx columns and dy rows apart:

- OpenCV's fillPoly draws the lines there and back: max(|dx|, |dy|) - 1 pixels.
- Pillow fills the crossings of rows alone: |dy| - 1 pixels. But where two edges meet at their upper end and leave it
  to the same side by more than a pixel a row, it fills what they span there. So a flat bridge, of |dx| >= 2 |dy|, comes
  back to the pixel beside its upper end. That is free if the pixel is the plant's, as is usual, else it costs one.
  Within a row, a bridge of four columns or more bends to the row above or below, for Pillow fills horizontal edges.

A bridge costs a third of the first number and two thirds of the second: few pixels for Pillow's way cost few for
OpenCV's, not the other way round. Of the minimum spanning tree of the pieces, an outline holds the subtree with the
largest piece that has the greatest intersection over union with the mask,

    I / (M + C),

with the pixels I of the subtree's pieces, the mask's M, and the cost of the subtree's bridges C.

References
----------
Mehlhorn 1988, Information Processing Letters 27: spanning trees from Voronoi cells. Dinkelbach 1967, Management Science
13: greatest ratios. Pillow 12, src/libImaging/Draw.c, polygon_generic. OpenCV 4, modules/imgproc/src/drawing.cpp.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.core.compiled import compiled

Pixels = NDArray[np.int64]  # (..., 2) x, y; -1 for none

_NEIGHBOURS = np.ones((3, 3), dtype=np.int8)  # pixels that touch at a corner are one piece
_SIXTHS = 6  # costs are whole numbers of them


class Bridges(NamedTuple):
    """Ways between pieces, an element each, walked there and back."""

    start: Pixels  # (E, 2)
    end: Pixels  # (E, 2)
    there: Pixels  # (E, 2) passed from start to end
    back: Pixels  # (E, 3, 2) passed from end to start


class _Edges(NamedTuple):
    """Bridges between pieces, an element each."""

    one: NDArray[np.int64]  # piece, from 0
    other: NDArray[np.int64]
    cost: NDArray[np.int64]  # sixths of a pixel
    ends: NDArray[np.int64]  # (E, 4) x, y of the first pixel, x, y of the last one


def join_pieces(mask: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], Bridges]:
    """The pieces of a mask (H, W) that its outline holds, as a mask, and the bridges that join them."""
    from scipy.ndimage import label

    pieces, number = label(mask, _NEIGHBOURS)
    if number == 1:
        return mask, _ways(mask, np.empty((0, 4), dtype=np.int64))
    area = np.bincount(pieces.ravel())[1:].astype(np.int64)
    total, largest = int(area.sum()), int(area.max())
    # A tree that costs more has a lower ratio than the largest piece alone, whatever it joins.
    most_cost_px = (total - largest) * total // largest
    edges = _spanning_tree(_candidates(pieces.astype(np.int32), 3 * most_cost_px + 2), number)
    kept, used = _best_subtree(area, edges.one, edges.other, edges.cost, int(area.argmax()))
    joined = np.concatenate([[False], kept])[pieces]
    return joined, _ways(joined, edges.ends[used])


def _is_flat(dx: NDArray[np.int64], dy: NDArray[np.int64], height: int) -> NDArray[np.bool_]:
    """Whether a bridge comes back another way."""
    within_row = (np.abs(dx) >= 4) & (height > 1)
    return np.where(dy == 0, within_row, np.abs(dx) >= 2 * np.abs(dy))


def _owned(mask: NDArray[np.bool_], x: NDArray[np.int64], y: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether pixels are the mask's; x may lie a column outside."""
    return np.asarray(np.pad(mask, ((0, 0), (1, 1)))[y, x + 1])


def _ways(mask: NDArray[np.bool_], ends: NDArray[np.int64]) -> Bridges:
    """Bridges between pixels (E, 4) of a mask."""
    x0, y0, x1, y1 = ends.T
    side = np.sign(x1 - x0)
    before, behind = _owned(mask, x0 - side, y0), _owned(mask, x1 + side, y1)
    by_start = np.stack([np.where(before, x0 - side, x0 + side), y0], axis=1)
    by_end = np.stack([np.where(behind, x1 + side, x1 - side), y1], axis=1)
    height = len(mask)
    flat, within_row = _is_flat(x1 - x0, y1 - y0, height), y0 == y1
    # Below the row both ends are upper ends; above it only the bend is one.
    below = within_row & (before | behind | (y0 == 0)) & (y0 + 1 < height)
    bend = np.stack([(x0 + x1) // 2, np.where(below, y0 + 1, y0 - 1)], axis=1)
    bend_back = bend + np.stack([~below, np.zeros_like(below)], axis=1)
    back = np.stack(
        [
            np.where((flat & ((y1 < y0) | below))[:, None], by_end, -1),
            np.where((flat & within_row)[:, None], bend_back, -1),
            np.where((flat & ((y0 < y1) | below))[:, None], by_start, -1),
        ],
        axis=1,
    )
    return Bridges(ends[:, :2], ends[:, 2:], np.where((flat & within_row)[:, None], bend, -1), back)


def _costs(pieces: NDArray[np.int32], ends: NDArray[np.int64]) -> NDArray[np.int64]:
    """(E,) sixths of a pixel: see above. A flat bridge's ways part by half a pixel a row in the mean."""
    x0, y0, x1, y1 = ends.T
    side, across, down = np.sign(x1 - x0), np.abs(x1 - x0), np.abs(y1 - y0)
    lone_start, lone_end = ~_owned(pieces != 0, x0 - side, y0), ~_owned(pieces != 0, x1 + side, y1)
    upper = np.where(y0 < y1, lone_start, lone_end)
    beside = np.where(down == 0, np.minimum(2, 1 + lone_start.astype(np.int64) + lone_end), upper)
    flat = _is_flat(x1 - x0, y1 - y0, len(pieces))
    lines2 = 2 * (np.maximum(across, down) - 1) + np.where(flat, down, 0)
    straight = np.where(down == 0, across - 1, down - 1)
    rows2 = np.where(flat, 3 * np.maximum(down - 1, 0) + 2 * beside, 2 * straight)
    return np.asarray(lines2 + 2 * rows2, dtype=np.int64)


def _candidates(pieces: NDArray[np.int32], reach: int) -> _Edges:
    """For each two pieces whose Voronoi cells touch, the cheapest bridge found there."""
    width = pieces.shape[1]
    first, last = _meetings(pieces, _voronoi(pieces, reach))
    one, other = pieces.ravel()[first].astype(np.int64) - 1, pieces.ravel()[last].astype(np.int64) - 1
    swap = one > other
    first, last = np.where(swap, last, first), np.where(swap, first, last)
    one, other = np.minimum(one, other), np.maximum(one, other)
    ends = np.stack([first % width, first // width, last % width, last // width], axis=1)
    cost = _costs(pieces, ends)
    order = np.lexsort((last, first, cost, other, one))
    new = np.ones(len(order), dtype=bool)
    new[1:] = (np.diff(one[order]) != 0) | (np.diff(other[order]) != 0)
    best = order[new]
    return _Edges(one[best], other[best], cost[best], ends[best])


def _spanning_tree(edges: _Edges, number: int) -> _Edges:
    """The edges of the minimum spanning forest."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import minimum_spanning_tree

    # Edges weigh their rank by cost, from 1: no two weigh the same, and a weight names its edge.
    by_cost = np.argsort(edges.cost, kind="stable")
    weight = np.empty(len(by_cost))
    weight[by_cost] = np.arange(1, len(by_cost) + 1)
    graph = coo_array((weight, (edges.one, edges.other)), shape=(number, number)).tocsr()
    kept = np.sort(by_cost[minimum_spanning_tree(graph).data.astype(np.int64) - 1])
    return _Edges(edges.one[kept], edges.other[kept], edges.cost[kept], edges.ends[kept])


@compiled
def _voronoi(pieces: Any, reach: int) -> Any:
    """(H, W) the nearest pixel of any piece, y * W + x, by max(|dx|, |dy|) + |dy|; -1 beyond `reach`."""
    height, width = pieces.shape
    far = 2 * (height + width)
    distance = np.full((height, width), far, np.int32)
    nearest = np.full((height, width), -1, np.int64)
    queue = np.empty((3, height * width), np.int64)  # cells by distance modulo 3: a step costs 1 or 2
    waiting = np.zeros(3, np.int64)
    for y in range(height):
        for x in range(width):
            if pieces[y, x] != 0:
                distance[y, x], nearest[y, x] = 0, y * width + x
                queue[0, waiting[0]] = y * width + x
                waiting[0] += 1
    level = 0
    while level <= reach and waiting.any():
        now = level % 3
        for k in range(waiting[now]):
            y, x = queue[now, k] // width, queue[now, k] % width
            if distance[y, x] != level:
                continue
            for step in range(9):
                dy, dx = step // 3 - 1, step % 3 - 1
                longer = level + (1 if dy == 0 else 2)
                if 0 <= y + dy < height and 0 <= x + dx < width and longer < distance[y + dy, x + dx]:
                    distance[y + dy, x + dx], nearest[y + dy, x + dx] = longer, nearest[y, x]
                    then = longer % 3
                    queue[then, waiting[then]] = (y + dy) * width + x + dx
                    waiting[then] += 1
        waiting[now] = 0
        level += 1
    return nearest


@compiled
def _meetings(pieces: Any, nearest: Any) -> Any:
    """Pairs of pixels, (C,) and (C,), to which two neighbouring cells of two pieces are nearest."""
    height, width = pieces.shape
    flat = pieces.ravel()
    pairs = np.empty((2, 4 * height * width), np.int64)
    count = 0
    for y in range(height):
        for x in range(width):
            for step in range(4):  # right, and the three below
                y2, x2 = (y, x + 1) if step == 3 else (y + 1, x + step - 1)
                if y2 >= height or x2 < 0 or x2 >= width:
                    continue
                one, other = nearest[y, x], nearest[y2, x2]
                if one >= 0 and other >= 0 and flat[one] != flat[other]:
                    pairs[0, count], pairs[1, count] = one, other
                    count += 1
    return pairs[0, :count].copy(), pairs[1, :count].copy()


@compiled
def _best_subtree(area: Any, one: Any, other: Any, cost: Any, root: int) -> Any:
    """Pieces (P,) and edges (E,) of the subtree of a forest, with the root, of the greatest I / (M + C).

    Dinkelbach: the subtree that gains most at a ratio, then that subtree's ratio, until nothing gains. Whole numbers.
    """
    order, parent, above = _from_root(one, other, len(area), root)
    total = _SIXTHS * area.sum()
    top, bottom = _SIXTHS * area[root], total
    kept, used = np.zeros(len(area), np.bool_), np.zeros(len(one), np.bool_)
    while True:
        gain = _SIXTHS * area * bottom  # of a piece with what hangs on it, times the ratio's denominator
        for k in range(len(order) - 1, 0, -1):
            piece = order[k]
            gain[piece] -= top * cost[above[piece]]
            if gain[piece] > 0:
                gain[parent[piece]] += gain[piece]
        kept[:], used[:] = False, False
        kept[root] = True
        for k in range(1, len(order)):
            piece = order[k]
            if gain[piece] > 0 and kept[parent[piece]]:
                kept[piece], used[above[piece]] = True, True
        new_top, new_bottom = _SIXTHS * area[kept].sum(), total + cost[used].sum()
        if new_top * bottom <= top * new_bottom:
            return kept, used
        top, bottom = new_top, new_bottom


@compiled
def _from_root(one: Any, other: Any, number: int, root: int) -> Any:
    """Pieces that a forest joins with the root, root first and parents before children; each one's parent and edge."""
    begin = np.zeros(number + 1, np.int64)
    for k in range(len(one)):
        begin[one[k] + 1] += 1
        begin[other[k] + 1] += 1
    begin = np.cumsum(begin)
    edge, free = np.empty(2 * len(one), np.int64), begin[:-1].copy()
    for k in range(len(one)):
        for piece in (one[k], other[k]):
            edge[free[piece]] = k
            free[piece] += 1
    parent, above = np.full(number, -1, np.int64), np.full(number, -1, np.int64)
    order = np.empty(number, np.int64)
    order[0], count, k = root, 1, 0
    while k < count:
        piece = order[k]
        for at in range(begin[piece], begin[piece + 1]):
            if edge[at] != above[piece]:
                child = one[edge[at]] + other[edge[at]] - piece
                parent[child], above[child] = piece, edge[at]
                order[count] = child
                count += 1
        k += 1
    return order[:count], parent, above
