"""Drawn values that go together: a Gaussian copula with given rank correlations.

Standard Gaussians z = L q, with L L^T = R and q independent, have the correlations R; u = Phi(z) is uniform again, so
that each key's own distribution is kept exactly. Spearman's rank correlation rho of two of them needs

    r = 2 sin(pi rho / 6)

(Pearson 1907; Kruskal, W. H. (1958). Ordinal measures of association. JASA 53, 814-861).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
_LEAST_EIGENVALUE = 1e-6  # of a matrix that counts as positive definite
_DECIMALS = 3  # of the nearest value that a message names

Pair = tuple[int, int, float]  # two keys' numbers, and Spearman's rank correlation


class InfeasibleError(ValueError):
    """No values are correlated so; `pair` is the number of a pair that could be changed for the others to hold."""

    def __init__(self, pair: int, nearest: float) -> None:
        super().__init__(f"pair {pair}")
        self.pair = pair
        self.nearest = nearest  # rank correlation that would do


def cholesky_factor(size: int, pairs: Sequence[Pair]) -> Floats:
    """(size, size) lower triangle L of the Gaussians' correlations; pairs that are not named have none.

    Raises
    ------
    InfeasibleError : the matrix is not positive definite.
    """
    matrix = _matrix(size, pairs)
    if not pairs or _least(matrix) >= _LEAST_EIGENVALUE:
        return np.asarray(np.linalg.cholesky(matrix), dtype=np.float64)
    for number in reversed(range(len(pairs))):  # the last pair that alone would mend it
        nearest = _nearest(matrix, pairs[number])
        if nearest is not None:
            raise InfeasibleError(number, nearest)
    number = next(n for n in range(len(pairs)) if _least(_matrix(size, pairs[: n + 1])) < _LEAST_EIGENVALUE)
    raise InfeasibleError(number, _nearest(_matrix(size, pairs[:number]), pairs[number]) or 0.0)


def correlated(points: Floats, factor: Floats) -> Floats:
    """(n,) uniform numbers with the correlations of `factor` from (n,) independent ones in (0, 1)."""
    from scipy.special import ndtr, ndtri

    values: Floats = ndtr(factor @ ndtri(points))
    return np.clip(values, 2.0**-53, 1.0 - 2.0**-53)


def _matrix(size: int, pairs: Sequence[Pair]) -> Floats:
    matrix = np.eye(size)
    for pair in pairs:
        _put(matrix, pair, pair[2])
    return matrix


def _put(matrix: Floats, pair: Pair, rank: float) -> None:
    matrix[pair[0], pair[1]] = matrix[pair[1], pair[0]] = 2.0 * math.sin(math.pi * rank / 6.0)


def _least(matrix: Floats) -> float:
    """Least eigenvalue: a concave function of each entry."""
    return float(np.linalg.eigvalsh(matrix)[0])


def _nearest(matrix: Floats, pair: Pair) -> float | None:
    """The rank correlation of `pair` nearest to what is written that goes with the rest of the matrix, if any does."""
    changed = matrix.copy()

    def least(rank: float) -> float:
        _put(changed, pair, rank)
        return _least(changed)

    good = _highest(least)
    if least(good) < _LEAST_EIGENVALUE:
        return None
    bad = pair[2]
    for _ in range(50):
        middle = 0.5 * (good + bad)
        good, bad = (middle, bad) if least(middle) >= _LEAST_EIGENVALUE else (good, middle)
    step = 10**_DECIMALS
    towards = math.floor if bad > good else math.ceil
    return float(towards(good * step) / step)


def _highest(function: Callable[[float], float]) -> float:
    """Where in [-1, 1] a function with one peak is highest."""
    low, high = -1.0, 1.0
    for _ in range(60):
        one, other = low + (high - low) / 3.0, high - (high - low) / 3.0
        low, high = (one, high) if function(one) < function(other) else (low, other)
    return 0.5 * (low + high)
