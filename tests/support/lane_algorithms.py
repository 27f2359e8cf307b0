"""Algorithms 5.1 and 5.2 of Lane 2002, plainly: what the fast field is compared with, and measured against.

Settled where the print leaves it open or cannot be meant so:

- Sample f_ij is the density of cell (i, j), which covers [j, j + 1] x [i, i + 1] and has its middle at (j + ½, i + ½);
  distances are measured to the middle. R_k is the sum of the rows up to row k, and R_{-1} = 0.
- The print finds k with R_k <= u < R_{k+1} and y between k and k + 1. That has no place for u < R_0, and lays the mass
  of row k + 1 half a cell to the south of its samples. Here R_{k-1} <= u < R_k, and y lies in row k.
- The print draws y from the sums of the rows alone, but x from rows k and k + 1 mixed in the proportion of y. The two
  do not belong to one density: plants come to stand in cells of density 0 wherever the neighbouring row has some.
  Here x follows row k, which makes the density of a place exactly f. `mixed_rows` draws as printed, to show it.
- ΔR is summed over the rows from the top of the kernel down, once: row i takes the changes of the rows up to i.
- A kernel reaches as far as it says, not one radius; a cell is deformed once, at its least distance if the site is
  periodic; the kernel is read from its table.

References
----------
Lane 2002, section 5.2, Algorithms 5.1 and 5.2.
"""

from __future__ import annotations

from math import ceil, floor, sqrt

import numpy as np
from numpy.typing import NDArray

from forestgen.community.placement.kernels import KernelTable
from forestgen.core.compiled import compiled


def algorithm_5_1(
    field: NDArray[np.float64],
    size_m: tuple[float, float],
    radius_m: NDArray[np.float64],
    kernel: KernelTable,
    uniform: NDArray[np.float64],
    *,
    periodic: bool,
    mixed_rows: bool = False,
) -> NDArray[np.float64]:
    """Places of plants, (N, 2) metres; all sums are taken anew for each plant.

    Parameters
    ----------
    field : (rows, cols) float64, deformed in place.
    size_m : W, H, metres.
    radius_m : (N,) metres.
    uniform : (N, 2) in [0, 1): the first chooses y, the second x.
    mixed_rows : draw x from two rows mixed, as printed.
    """
    return _run(field, size_m, radius_m, kernel, uniform, periodic, mixed_rows, anew=True)


def algorithm_5_2(
    field: NDArray[np.float64],
    size_m: tuple[float, float],
    radius_m: NDArray[np.float64],
    kernel: KernelTable,
    uniform: NDArray[np.float64],
    *,
    periodic: bool,
    mixed_rows: bool = False,
) -> NDArray[np.float64]:
    """As `algorithm_5_1`; the sums of the rows are kept up to date by differences."""
    return _run(field, size_m, radius_m, kernel, uniform, periodic, mixed_rows, anew=False)


def _run(  # type: ignore[no-untyped-def]
    field, size_m, radius_m, kernel, uniform, periodic, mixed_rows, *, anew
) -> NDArray[np.float64]:
    if kernel.balanced:
        raise ValueError("the printed algorithms know no balanced kernels")
    rows, cols = field.shape
    reach_m = np.asarray(kernel.reach_m(radius_m), dtype=np.float64)
    places = _place(
        field, size_m[0] / cols, size_m[1] / rows, reach_m, kernel.values, uniform, periodic, mixed_rows, anew
    )
    return np.asarray(places * (size_m[0] / cols, size_m[1] / rows))


@compiled
def _place(field, width_m, height_m, reach_m, values, uniform, periodic, mixed_rows, anew):  # type: ignore[no-untyped-def]
    rows, cols = field.shape
    places = np.full((len(uniform), 2), np.nan)
    below = np.zeros(rows + 1)  # below[i + 1] is R_i
    left = np.zeros(cols + 1)  # left[j + 1] is C_j
    _sum_rows(field, below)
    for t in range(len(uniform)):
        if anew:
            _sum_rows(field, below)
        if not below[rows] > 0.0:
            continue
        u = uniform[t, 0] * below[rows]
        row = _find(below, u)
        y = row + (u - below[row]) / (below[row + 1] - below[row])
        if mixed_rows:
            after = min(row + 1, rows - 1)
            for j in range(cols):
                left[j + 1] = left[j] + ((y - row) * field[after, j] + ((row + 1) - y) * field[row, j])
        else:
            for j in range(cols):
                left[j + 1] = left[j] + field[row, j]
        v = uniform[t, 1] * left[cols]
        col = _find(left, v)
        x = col + (v - left[col]) / (left[col + 1] - left[col])
        _deform(field, below, x, y, width_m, height_m, reach_m[t], values, periodic)
        places[t, 0], places[t, 1] = x, y
    return places


@compiled
def _sum_rows(field, below):  # type: ignore[no-untyped-def]
    rows, cols = field.shape
    for i in range(rows):
        total = below[i]
        for j in range(cols):
            total += field[i, j]
        below[i + 1] = total


@compiled
def _find(sums, u):  # type: ignore[no-untyped-def]
    """The k with sums[k] <= u < sums[k + 1]; should rounding leave none, the last k with any mass."""
    low, high = 0, len(sums) - 1
    while high - low > 1:
        middle = (low + high) // 2
        if sums[middle] <= u:
            low = middle
        else:
            high = middle
    while low > 0 and not sums[low + 1] > sums[low]:
        low -= 1
    return low


@compiled
def _deform(field, below, x, y, width_m, height_m, reach_m, values, periodic):  # type: ignore[no-untyped-def]
    if not reach_m > 0.0:
        return
    rows, cols = field.shape
    first, last = _window(y, reach_m / height_m, rows, periodic)
    left, right = _window(x, reach_m / width_m, cols, periodic)
    samples = len(values) - 1
    change = 0.0
    for a in range(first, last + 1):
        i = a + rows if a < 0 else (a - rows if a >= rows else a)
        dy = abs(i + 0.5 - y)
        if periodic:
            dy = min(dy, rows - dy)
        in_row = 0.0
        for b in range(left, right + 1):
            j = b + cols if b < 0 else (b - cols if b >= cols else b)
            dx = abs(j + 0.5 - x)
            if periodic:
                dx = min(dx, cols - dx)
            d = sqrt((dx * width_m) ** 2 + (dy * height_m) ** 2) * (samples / reach_m)
            if d <= samples:
                k = min(int(d), samples - 1)
                new = field[i, j] * (values[k] + (d - k) * (values[k + 1] - values[k]))
                in_row += new - field[i, j]
                field[i, j] = new
        if a == i:
            change += in_row
            below[i + 1] += change
        else:  # beyond an edge: row i lies before or after the rows of this loop
            for k in range(i, rows):
                below[k + 1] += in_row
    for i in range(max(min(last, rows - 1) + 1, 0), rows):
        below[i + 1] += change


@compiled
def _window(at, reach, cells, periodic):  # type: ignore[no-untyped-def]
    """First and last cell that a kernel may reach, along one axis; beyond the edges if the site is periodic."""
    first, last = floor(at - reach), ceil(at + reach)
    if not periodic:
        return max(first, 0), min(last, cells - 1)
    if last - first + 1 >= cells:
        return 0, cells - 1
    return first, last
