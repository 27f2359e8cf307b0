"""Outlines of masks as polygons through the centres of their border pixels, one polygon a plant.

Pixels that touch, at a side or a corner, are a piece. A piece's border is a set of rings from pixel to neighbouring
pixel: an outer one, and one around each hole, all walked with the plant at the right hand. One polygon holds them all:
`bridges.py` joins pieces, and a vertical line through the piece's own pixels joins a hole's ring with the ring above.
A bridge is walked there and back. So all pixels whose centre lies on the polygon or, by the even-odd rule, inside it
are the plant's, but for those of bridges between pieces; and all of the plant's pixels are among them, but for pieces
that cost more than they bring.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.compiled import compiled
from forestgen.dataset.formats.bridges import join_pieces

Corners = NDArray[np.int32]  # (N, 2) x, y: columns and rows of pixels

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
            corner = (box[1].start, box[0].start)
            found[plant] = _polygon(instance[box] == plant) + np.array(corner, dtype=np.int32)
    return found


def _polygon(mask: NDArray[np.bool_]) -> Corners:
    kept, bridges = join_pieces(mask)
    return _without_collinear(_joined(kept, *_rings(kept), bridges))


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
