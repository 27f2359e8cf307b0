"""Points of [0, 1)^d that fill the space more evenly than independent ones (scipy.stats.qmc), and correlated values.

A point follows from the seed, the split and its number there. Sequences are computed in pieces and Latin hypercubes in
blocks, each from a random stream of its own name; the last few are kept, so that a walk through the images, in order or
nearly so, computes each once.

Correlated values come from a Gaussian copula with given rank correlations. Standard Gaussians z = L q, with L L^T = R
and q independent, have the correlations R; u = Phi(z) is uniform again, so that each key's own distribution is kept
exactly. Spearman's rank correlation rho of two of them needs

    r = 2 sin(pi rho / 6)

(Pearson 1907; Kruskal, W. H. (1958). Ordinal measures of association. JASA 53, 814-861).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from forestgen.core.randomness import child_rng

Method = Literal["independent", "latin_hypercube", "sobol", "halton"]
Floats = NDArray[np.float64]
Pair = tuple[int, int, float]  # two keys' numbers, and Spearman's rank correlation

MOST_KEYS = 1000  # dimensions; a sequence's high ones are no better than independent numbers
# A sequence begins again after so many points, scrambled anew: so a late point does not need all earlier ones.
_PERIOD = 2**16
_PIECE = 2**10
_LEAST_EIGENVALUE = 1e-6  # of a matrix that counts as positive definite
_DECIMALS = 3  # of the nearest value that a message names


def point(method: Method, dimensions: int, block: int, seed: int, split: str, number: int) -> Floats:
    """(d,) coordinates of one point, each in (0, 1), d at most `MOST_KEYS`.

    Parameters
    ----------
    method : any but independent.
    block : points of a Latin hypercube; the sequences have none.
    split, number : of the image: its split's name and its rank there.
    """
    if method == "latin_hypercube":
        points = _latin_hypercube(dimensions, block, seed, split, number // block)
    else:
        block, points = _PIECE, _sequence(method, dimensions, seed, split, number // _PIECE)
    found: Floats = points[number % block]
    return found


def cell_of(cells: int, seed: int, split: str, number: int) -> int:
    """Which of the strata's cells a point lies in: each block of `cells` points has every cell once, shuffled."""
    return int(_shuffled(cells, seed, split, number // cells)[number % cells])


@lru_cache(maxsize=16)
def _shuffled(cells: int, seed: int, split: str, block: int) -> NDArray[np.int64]:
    return child_rng(seed, "sampling", "strata", split, block).permutation(cells)


@lru_cache(maxsize=16)
def _latin_hypercube(dimensions: int, block: int, seed: int, split: str, number: int) -> Floats:
    """(block, d) points of which each coordinate has one in every 1/block of its range."""
    from scipy.stats import qmc  # takes a second to load

    rng = child_rng(seed, "sampling", "latin_hypercube", split, number)
    return _inside(qmc.LatinHypercube(dimensions, rng=rng).random(block))


@lru_cache(maxsize=16)
def _sequence(method: Method, dimensions: int, seed: int, split: str, piece: int) -> Floats:
    """(_PIECE, d) points of a scrambled sequence, from number piece * _PIECE on."""
    from scipy.stats import qmc

    period, skipped = divmod(piece * _PIECE, _PERIOD)
    rng = child_rng(seed, "sampling", method, split, period)
    engine = (qmc.Sobol if method == "sobol" else qmc.Halton)(dimensions, scramble=True, rng=rng)
    if skipped:
        engine.fast_forward(skipped)
    return _inside(engine.random(_PIECE))


def _inside(points: Floats) -> Floats:
    """Away from 0 and 1, where a Gaussian has no finite quantile; a third of a Sobol point's own last digit."""
    points = np.clip(points, 2.0**-32, 1.0 - 2.0**-32)
    points.flags.writeable = False  # it is kept
    return points


class InfeasibleError(ValueError):
    """No values are correlated so; `pair` is the number of a pair that could be changed for the others to hold."""

    def __init__(self, pair: int, nearest: float) -> None:
        super().__init__(f"pair {pair}")
        self.pair = pair
        self.nearest = nearest  # rank correlation that would do


def cholesky_factor(size: int, pairs: Sequence[Pair]) -> Floats:
    """(size, size) lower triangle L of the Gaussians' correlations; pairs that are not named have none.

    Raises `InfeasibleError` where the matrix is not positive definite.
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
    from scipy.optimize import brentq, minimize_scalar

    changed = matrix.copy()

    def room(rank: float) -> float:
        _put(changed, pair, rank)
        return _least(changed) - _LEAST_EIGENVALUE

    good = float(minimize_scalar(lambda rank: -room(rank), bounds=(-1.0, 1.0), method="bounded").x)
    if room(good) < 0.0:
        return None
    towards, step = math.floor if pair[2] > good else math.ceil, 10**_DECIMALS
    return float(towards(brentq(room, good, pair[2]) * step) / step)
