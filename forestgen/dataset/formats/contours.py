"""Outlines of masks as polygons through the centres of their border pixels, one polygon a plant.

Pixels that touch, at a side or a corner, are a piece. A piece's border is a set of rings from pixel to neighbouring
pixel: an outer one, and one around each hole, all walked with the plant at the right hand. One polygon holds them all:
Bridges join pieces, and a vertical line through the piece's own pixels joins a hole's ring with the ring above.
A bridge is walked there and back. So all pixels whose centre lies on the polygon or, by the even-odd rule, inside it
are the plant's, but for those of bridges between pieces; and all of the plant's pixels are among them, but for pieces
that cost more than they bring.

**Bridges.** An outline is one closed line, so what it fills is connected; a crown behind leaves is many pieces. A
bridge between two pieces fills pixels that are not the plant's. How many depends on the rasteriser, dx columns and dy
rows apart:

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

Corners = NDArray[np.int32]  # (N, 2) x, y: columns and rows of pixels
Pixels = NDArray[np.int64]  # (..., 2) x, y; -1 for none

_NEIGHBOURS = np.ones((3, 3), dtype=np.int8)  # pixels that touch at a corner are one piece
_SIXTHS = 6  # costs are whole numbers of them
# Sides of a pixel in the order of a walk around it with the pixel at the right hand: top, right, bottom, left.
_OUT_X = np.array([0, 1, 0, -1])  # what lies beyond a side
_OUT_Y = np.array([-1, 0, 1, 0])
_TOP = 0


def polygons(instance: NDArray[np.uint32]) -> dict[int, Corners]:
    """plant_id -> (N, 2) pixels x, y of its polygon, of a mask (H, W); ids rise, and the last pixel joins the first.

    A plant of one or two pixels has one or two corners.
    """
    from scipy.ndimage import find_objects

    ids, index = np.unique(instance, return_inverse=True)
    boxes = find_objects(index.reshape(instance.shape) + 1)
    found = {}
    for plant, box in zip(ids.tolist(), boxes, strict=True):
        if plant:
            kept, bridges = join_pieces(instance[box] == plant)
            corner = np.array((box[1].start, box[0].start), dtype=np.int32)
            found[plant] = _without_collinear(_joined(kept, *_rings(kept), bridges)) + corner
    return found


def _without_collinear(ring: NDArray[np.int64]) -> Corners:
    """The ring without repeated pixels, and without those within a run along a row, a column or a diagonal."""
    ring = ring[(ring != np.roll(ring, 1, axis=0)).any(axis=1)] if (ring != ring[0]).any() else ring[:1]
    step = np.roll(ring, -1, axis=0) - ring
    is_run = (step == 0).any(axis=1) | (np.abs(step[:, 0]) == np.abs(step[:, 1]))
    way = np.sign(step)
    goes_on = is_run & np.roll(is_run, 1) & (way == np.roll(way, 1, axis=0)).all(axis=1)
    return (ring[~goes_on] if len(ring) > 1 else ring).astype(np.int32)


@compiled
def _rings(mask: Any) -> Any:
    """Pixels x, y of all rings (K, 2) and where each begins (L + 1,); (H, W) a place in it of each border pixel.

    The last array (H, W) is the place of the walk along the pixel's top. A ring that begins there is an outer one, all
    others are around holes, and begin at the bottom of a pixel.
    """
    height, width = mask.shape
    sides = 0
    for y in range(height):
        for x in range(width):
            for side in range(4):
                sides += mask[y, x] and not _is_plant(mask, y + _OUT_Y[side], x + _OUT_X[side])
    pixels = np.empty((sides, 2), np.int64)
    begin = np.zeros(sides // 4 + 1, np.int64)
    at, top = np.full((height, width), -1, np.int64), np.full((height, width), -1, np.int64)
    done = np.zeros((height, width), np.uint8)
    rings = 0
    for y in range(height):
        for x in range(width):
            for side in range(4):
                border = mask[y, x] and not _is_plant(mask, y + _OUT_Y[side], x + _OUT_X[side])
                if border and not done[y, x] >> side & 1:
                    begin[rings + 1] = _walk(mask, y, x, side, done, pixels, begin[rings], at, top)
                    rings += 1
    return pixels[: begin[rings]], begin[: rings + 1], at, top


@compiled
def _is_plant(mask: Any, y: int, x: int) -> bool:
    return bool(0 <= y < mask.shape[0] and 0 <= x < mask.shape[1] and mask[y, x])


@compiled
def _walk(mask: Any, y: int, x: int, side: int, done: Any, pixels: Any, count: int, at: Any, top: Any) -> int:
    """Follow the ring of a side, marking sides and writing each pixel that is entered."""
    pixels[count, 0], pixels[count, 1] = x, y
    count += 1
    while True:
        done[y, x] |= np.uint8(1 << side)
        at[y, x] = count - 1
        if side == _TOP:
            top[y, x] = count - 1
        turn = (side + 1) % 4
        next_y, next_x = y + _OUT_Y[turn], x + _OUT_X[turn]
        beyond_y, beyond_x = next_y + _OUT_Y[side], next_x + _OUT_X[side]
        if _is_plant(mask, beyond_y, beyond_x):
            next_y, next_x, side = beyond_y, beyond_x, (side + 3) % 4
        elif not _is_plant(mask, next_y, next_x):
            next_y, next_x, side = y, x, turn
        if done[next_y, next_x] >> side & 1:
            return count
        if next_y != y or next_x != x:
            pixels[count, 0], pixels[count, 1] = next_x, next_y
            count += 1
        y, x = next_y, next_x


@compiled
def _joined(mask: Any, pixels: Any, begin: Any, at: Any, top: Any, bridges: Any) -> Any:
    """(N, 2) the rings of a mask as one, from its first one on."""
    rings, most = len(begin) - 1, 2 * (len(bridges.start) + len(begin))
    links = np.empty((most, 2), np.int64)  # the place where each begins, and the next link there
    there, back = np.full((most, 2), -1, np.int64), np.full((most, 3, 2), -1, np.int64)
    ring_of = np.empty(len(pixels), np.int64)
    count = 0
    for k in range(len(bridges.start)):
        links[count, 0] = at[bridges.start[k, 1], bridges.start[k, 0]]
        links[count + 1, 0] = at[bridges.end[k, 1], bridges.end[k, 0]]
        there[count], there[count + 1] = bridges.there[k], bridges.there[k]
        back[count], back[count + 1] = bridges.back[k], bridges.back[k, ::-1]
        count += 2
    for ring in range(rings):
        ring_of[begin[ring] : begin[ring + 1]] = ring
        x, y = pixels[begin[ring]]
        if top[y, x] != begin[ring]:  # a hole's: up to the ring above
            while _is_plant(mask, y - 1, x):
                y -= 1
            links[count, 0], links[count + 1, 0] = begin[ring], top[y, x]
            count += 2
    first = np.full(len(pixels), -1, np.int64)
    for link in range(count):
        links[link, 1] = first[links[link, 0]]
        first[links[link, 0]] = link
    return _write(pixels, begin, ring_of, first, links, there, back)


@compiled
def _write(pixels: Any, begin: Any, ring_of: Any, first: Any, links: Any, there: Any, back: Any) -> Any:
    """Walk a tree of rings: each ring once around, and from each place the links there, there and back.

    Links k and k ^ 1 are the two directions of one.
    """
    rings = len(begin) - 1
    out = np.empty((len(pixels) + 6 * rings, 2), np.int64)
    entry, place = np.zeros(rings, np.int64), np.zeros(rings, np.int64)
    link, taken = np.full(rings, -1, np.int64), np.full(rings, -1, np.int64)  # next to take; the one that led here
    link[0], out[0] = first[0], pixels[0]
    count, depth = 1, 0
    while True:
        here = link[depth]
        if here >= 0:
            link[depth] = links[here, 1]
            if here ^ 1 == taken[depth]:
                continue
            count = _put(out, count, there[here])
            depth += 1
            taken[depth] = here
            place[depth] = entry[depth] = links[here ^ 1, 0]
        else:
            ring = ring_of[place[depth]]
            following = place[depth] + 1 if place[depth] + 1 < begin[ring + 1] else begin[ring]
            if following == entry[depth]:  # close this ring, and cross the bridge back
                if depth == 0:
                    return out[:count]
                count = _put(out, count, pixels[entry[depth]])
                for pixel in back[taken[depth]]:
                    count = _put(out, count, pixel)
                depth -= 1
                count = _put(out, count, pixels[place[depth]])
                continue
            place[depth] = following
        link[depth] = first[place[depth]]
        count = _put(out, count, pixels[place[depth]])


@compiled
def _put(out: Any, count: int, pixel: Any) -> int:
    if pixel[0] < 0:
        return count
    out[count] = pixel
    return count + 1


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
    candidates = _candidates(pieces.astype(np.int32), 3 * most_cost_px + 2)
    edges, order, parent = _spanning_tree(candidates, number, int(area.argmax()))
    above = np.full(number, -1, dtype=np.int64)  # edge of each piece to its parent
    above[np.where(parent[edges.other] == edges.one, edges.other, edges.one)] = np.arange(len(edges.one))
    kept, used = _best_subtree(area, edges.cost, order, parent, above)
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
    start, end = (np.ascontiguousarray(one) for one in (ends[:, :2], ends[:, 2:]))
    return Bridges(start, end, np.where((flat & within_row)[:, None], bend, -1), back)


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


def _spanning_tree(edges: _Edges, number: int, root: int) -> tuple[_Edges, NDArray[np.int32], NDArray[np.int32]]:
    """The edges of the minimum spanning forest; the pieces that it joins with the root, root first; (P,) parents."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

    # Edges weigh their rank by cost, from 1: no two weigh the same, and a weight names its edge.
    by_cost = np.argsort(edges.cost, kind="stable")
    weight = np.empty(len(by_cost))
    weight[by_cost] = np.arange(1, len(by_cost) + 1)
    graph = coo_array((weight, (edges.one, edges.other)), shape=(number, number)).tocsr()
    tree = minimum_spanning_tree(graph)
    kept = np.sort(by_cost[tree.data.astype(np.int64) - 1])
    order, parent = breadth_first_order(tree, root, directed=False)
    return _Edges(edges.one[kept], edges.other[kept], edges.cost[kept], edges.ends[kept]), order, parent


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
def _best_subtree(area: Any, cost: Any, order: Any, parent: Any, above: Any) -> Any:
    """Pieces (P,) and edges (E,) of the subtree of a forest, with the root, of the greatest I / (M + C).

    Dinkelbach: the subtree that gains most at a ratio, then that subtree's ratio, until nothing gains. Whole numbers.
    """
    root, total = order[0], _SIXTHS * area.sum()
    top, bottom = _SIXTHS * area[root], total
    kept, used = np.zeros(len(area), np.bool_), np.zeros(len(cost), np.bool_)
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
