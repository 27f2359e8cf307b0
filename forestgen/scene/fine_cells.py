"""A grid of triangles in which some cells are cut into finer ones, without gaps or corners on edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Floats

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]


def cut_grid(xs_m: Floats, ys_m: Floats, fine: Bools, pieces: int) -> tuple[Floats, NDArray[np.uint32]]:
    """(V, 2) places and (F, 3) faces, counter-clockwise, of a grid.

    A cell beside a fine one is a fan about its middle, with all corners that the fine one has on their edge.

    Parameters
    ----------
    xs_m, ys_m : (C + 1,) and (R + 1,) of its lines.
    fine : (R, C) cells that are cut into `pieces` x `pieces`, an even number.
    """
    columns = len(xs_m) - 1
    width = columns * pieces + 1  # corners of a row, were all cells fine
    beside = np.pad(fine, 1)
    neighbour = {
        "south": beside[:-2, 1:-1],
        "east": beside[1:-1, 2:],
        "north": beside[2:, 1:-1],
        "west": beside[1:-1, :-2],
    }
    fan = ~fine & np.any(list(neighbour.values()), axis=0)
    row, column = np.nonzero(~fine & ~fan)
    faces = [_squares((row * width + column) * pieces, pieces, width)]
    row, column = np.nonzero(fine)
    step = np.arange(pieces)
    small = (row[:, None, None] * pieces + step[:, None]) * width + column[:, None, None] * pieces + step
    faces.append(_squares(small.ravel(), 1, width))
    faces += [_fans(fan & at, fan & ~at, side, pieces, width) for side, at in neighbour.items()]
    corners, index = np.unique(np.concatenate(faces), return_inverse=True)
    places = [
        np.interp(number / pieces, np.arange(len(lines)), lines)
        for number, lines in ((corners % width, xs_m), (corners // width, ys_m))
    ]
    return np.stack(places, axis=1), index.reshape(-1, 3).astype(np.uint32)


def _squares(corner: Ints, length: int, width: int) -> Ints:
    """(2 N, 3) triangles of squares by their south-west corners (N,)."""
    east, north = corner + length, corner + length * width
    lower = np.stack([corner, east, north + length], axis=1)
    return np.concatenate([lower, np.stack([corner, north + length, north], axis=1)])


def _fans(cut: Bools, whole: Bools, side: str, pieces: int, width: int) -> Ints:
    """Triangles between the middle of cells and one of their sides: in pieces, and as a whole."""
    way = {"south": 1, "east": width, "north": -1, "west": -width}[side]
    start = {"south": 0, "east": pieces, "north": pieces * (width + 1), "west": pieces * width}[side]
    found = []
    for cells, steps in ((cut, np.arange(pieces)), (whole, np.array([0]))):
        row, column = np.nonzero(cells)
        corner = (row * width + column) * pieces
        first = (corner[:, None] + start + steps * way).ravel()
        middle = np.repeat(corner + pieces // 2 * (width + 1), len(steps))
        found.append(np.stack([middle, first, first + way * (pieces // len(steps))], axis=1))
    return np.concatenate(found)
