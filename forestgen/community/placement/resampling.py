"""Means of a picture's values in the cells of another grid over the same ground."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.sparse import csc_array

_ROWS_AT_ONCE = 256


def resample(
    stored: NDArray[Any],
    values_of: Callable[[NDArray[Any]], NDArray[np.float64]],
    shape: tuple[int, int],
    *,
    smooth: bool,
) -> NDArray[np.float64]:
    """Means in the cells of a grid.

    Parameters
    ----------
    stored : (rows, cols) of any type; a block of rows at a time is turned into numbers.
    values_of : the numbers of a block.
    shape : rows and columns of the grid.
    smooth : values run straight between the middles of pixels along an axis that has more cells than pixels; else,
        and without it, they are constant in each pixel.

    Returns
    -------
    (rows, cols) float64, of the same mean as the pixels.
    """
    across = _weights(stored.shape[1], shape[1], smooth).tocsr()
    along = _weights(stored.shape[0], shape[0], smooth)
    out = np.zeros(shape)
    for start in range(0, stored.shape[0], _ROWS_AT_ONCE):
        stop = min(start + _ROWS_AT_ONCE, stored.shape[0])
        block = (across @ values_of(stored[start:stop]).T).T
        share = along[:, start:stop]
        reached = slice(int(share.indices.min()), int(share.indices.max()) + 1)
        out[reached] += share.tocsr()[reached] @ np.ascontiguousarray(block)
    return out


def _weights(pixels: int, cells: int, smooth: bool) -> csc_array:
    """(cells, pixels) sparse: each cell's mean as a weighted sum of pixels, along one axis.

    Between all edges of cells and all edges (or middles) of pixels the function is straight, so that its mean there is
    its value halfway.
    """
    from scipy.sparse import csc_array  # slow to import

    straight = smooth and cells > pixels
    # An edge of both grids is the same float in both: i * pixels / cells is exact where it is whole.
    edges = np.arange(cells + 1) * pixels / cells
    bends = np.arange(pixels) + 0.5 if straight else np.arange(1, pixels, dtype=np.float64)
    ends = np.union1d(edges, bends)
    middle, length = (ends[1:] + ends[:-1]) / 2, np.diff(ends)
    cell = np.searchsorted(edges, middle, side="right") - 1
    share = length * cells / pixels
    if not straight:
        pixel = np.floor(middle).astype(np.int64)
        return csc_array((share, (cell, pixel)), shape=(cells, pixels))
    lower = np.floor(middle - 0.5).astype(np.int64)
    upper_share = (middle - 0.5 - lower) * share
    pairs = np.clip(np.concatenate([lower, lower + 1]), 0, pixels - 1)
    weights = np.concatenate([share - upper_share, upper_share])
    return csc_array((weights, (np.concatenate([cell, cell]), pairs)), shape=(cells, pixels))
