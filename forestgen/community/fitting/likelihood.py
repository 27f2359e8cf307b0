"""Likelihood of plants that were placed one by one, and its derivatives: what each part of a kernel would change.

Plant k is drawn from the field that the plants before it have deformed,

    p(x_k | x_1 ... x_k-1) = f_k(x_k) / sum of f_k over the window,     f_k(x) = product over j < k of κ(|x - x_j|)

so the likelihood of a stand in a given order is a product of known numbers, and log κ at the knots enters it linearly
but for the sums, which makes the logarithm concave: there is one best kernel. The sums are kept over a grid and mended
where a plant changes them, so that a stand costs N times the cells within reach of a plant.

References
----------
Lane 2002, section 5.1, for the model. The likelihood is ours.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.core.compiled import compiled

_MEND_EVERY = 64  # plants: sums that are mended gather rounding errors, so they are taken afresh now and then


class Score(NamedTuple):
    """Log-likelihood of a stand in its order, and its derivatives by log κ at the knots."""

    log_likelihood: float  # of the places against uniform ones
    gradient: NDArray[np.float64]  # (P, M)


def score(
    position_m: NDArray[np.float64],
    species: NDArray[np.int64],
    kernel_of: NDArray[np.int64],
    knots_m: NDArray[np.float64],
    core_m: NDArray[np.float64],
    log_kappa: NDArray[np.float64],
    size_m: tuple[float, float],
    shape: tuple[int, int],
) -> Score:
    """Of plants in the order in which they were placed.

    Parameters
    ----------
    position_m, species : (N, 2) metres, in [0, W] x [0, H]; (N,) of S species.
    kernel_of : (S, S) kernel by which species j (second) deforms the field of species i (first).
    knots_m : (P, M + 1) ascending distances of each of P kernels; log κ is linear between them, constant below the
        first and 0 from the last on, the reach.
    core_m : (P,) distance below which κ is 0, at most the first knot.
    log_kappa : (P, M).
    shape : rows and columns of the grid over which the field is summed.
    """
    ended = np.concatenate([log_kappa, np.zeros((len(log_kappa), 1))], axis=1)
    value, gradient = _score(
        np.ascontiguousarray(position_m), species, kernel_of, knots_m, core_m, ended, size_m[0], size_m[1], *shape
    )
    return Score(float(value), gradient)


@compiled
def _lower_knot(distance, knots, kernel):  # type: ignore[no-untyped-def]
    """The last knot that is no farther than a distance within reach; the first if none is."""
    low, high = 0, knots.shape[1] - 1
    while high - low > 1:
        middle = (low + high) // 2
        if knots[kernel, middle] <= distance:
            low = middle
        else:
            high = middle
    return low


@compiled
def _deform(x, y, mine, field, kernel, knots, core, log_kappa, weight, feature, sums, dx, dy):  # type: ignore[no-untyped-def]
    """Multiply a field by the kernel of a plant, and mend its sums: [0] of f, [1 + k] of f times feature k."""
    rows, cols, features = weight.shape[1], weight.shape[2], feature.shape[3]
    parts = knots.shape[1] - 1
    reach = knots[kernel, parts]
    first_row, last_row = max(0, int((y - reach) / dy)), min(rows, int((y + reach) / dy) + 1)
    first_col, last_col = max(0, int((x - reach) / dx)), min(cols, int((x + reach) / dx) + 1)
    for row in range(first_row, last_row):
        for col in range(first_col, last_col):
            distance = math.sqrt(((col + 0.5) * dx - x) ** 2 + ((row + 0.5) * dy - y) ** 2)
            before = weight[field, row, col]
            if distance >= reach or before == 0.0:
                continue
            low, on, after = 0, 0.0, 0.0
            if distance >= core[kernel]:
                low = _lower_knot(distance, knots, kernel)
                start, end = knots[kernel, low], knots[kernel, low + 1]
                on = max(0.0, (distance - start) / (end - start))
                after = before * math.exp((1 - on) * log_kappa[kernel, low] + on * log_kappa[kernel, low + 1])
            weight[field, row, col] = after
            change = after - before
            sums[field, 0] += change
            for k in range(features):
                sums[field, 1 + k] += change * feature[field, row, col, k]
            at = mine * parts + low
            feature[field, row, col, at] += 1 - on
            sums[field, 1 + at] += after * (1 - on)
            if low + 1 < parts:
                feature[field, row, col, at + 1] += on
                sums[field, 2 + at] += after * on


@compiled
def _sum_afresh(field, weight, feature, sums):  # type: ignore[no-untyped-def]
    sums[field] = 0.0
    for row in range(weight.shape[1]):
        for col in range(weight.shape[2]):
            sums[field, 0] += weight[field, row, col]
            for k in range(feature.shape[3]):
                sums[field, 1 + k] += weight[field, row, col] * feature[field, row, col, k]


@compiled
def _score(position, species, kernel_of, knots, core, log_kappa, width, height, rows, cols):  # type: ignore[no-untyped-def]
    n, kinds, parts = len(position), len(kernel_of), log_kappa.shape[1] - 1
    weight = np.ones((kinds, rows, cols))
    feature = np.zeros((kinds, rows, cols, kinds * parts))  # of a cell: by the species that deformed it, by knot
    sums = np.zeros((kinds, 1 + kinds * parts))
    sums[:, 0] = rows * cols
    value, gradient = 0.0, np.zeros((len(knots), parts))
    for k in range(n):
        x, y, mine = position[k, 0], position[k, 1], species[k]
        for j in range(k):
            kernel = kernel_of[mine, species[j]]
            distance = math.sqrt((position[j, 0] - x) ** 2 + (position[j, 1] - y) ** 2)
            if distance < knots[kernel, parts]:
                low = _lower_knot(distance, knots, kernel)
                on = max(0.0, (distance - knots[kernel, low]) / (knots[kernel, low + 1] - knots[kernel, low]))
                value += (1 - on) * log_kappa[kernel, low] + on * log_kappa[kernel, low + 1]
                gradient[kernel, low] += 1 - on
                if low + 1 < parts:
                    gradient[kernel, low + 1] += on
        total = max(sums[mine, 0], 1e-300)  # nothing left: rounding must not make it negative
        value -= math.log(total / (rows * cols))
        for other in range(kinds):
            for part in range(parts):
                gradient[kernel_of[mine, other], part] -= sums[mine, 1 + other * parts + part] / total
        for field in range(kinds):
            kernel = kernel_of[field, mine]
            _deform(
                x, y, mine, field, kernel, knots, core, log_kappa, weight, feature, sums, width / cols, height / rows
            )
            if k % _MEND_EVERY == _MEND_EVERY - 1:
                _sum_afresh(field, weight, feature, sums)
    return value, gradient
