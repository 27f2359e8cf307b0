"""Points of [0, 1)^d that fill the space more evenly than independent ones: scipy.stats.qmc, by number.

A point follows from the seed, the split and its number there. Sequences are computed in pieces and Latin hypercubes in
blocks, each from a random stream of its own name; the last few are kept, so that a walk through the images, in order or
nearly so, computes each once.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from forestgen.core.randomness import child_rng

Method = Literal["independent", "latin_hypercube", "sobol", "halton"]
Points = NDArray[np.float64]

MOST_KEYS = 1000  # dimensions; a sequence's high ones are no better than independent numbers
# A sequence begins again after so many points, scrambled anew: a point far out need not wait for all before it.
_PERIOD = 2**16
_PIECE = 2**10


def point(method: Method, dimensions: int, block: int, seed: int, split: str, number: int) -> Points:
    """One point.

    Parameters
    ----------
    method : any but independent.
    dimensions : d, at most `MOST_KEYS`.
    block : points of a Latin hypercube; the sequences have none.
    seed : root seed of the recipe.
    split, number : of the image: its split's name and its rank there.

    Returns
    -------
    (d,) array, each coordinate in (0, 1).
    """
    if method == "latin_hypercube":
        points = _latin_hypercube(dimensions, block, seed, split, number // block)
    else:
        block, points = _PIECE, _sequence(method, dimensions, seed, split, number // _PIECE)
    found: Points = points[number % block]
    return found


def cell_of(cells: int, seed: int, split: str, number: int) -> int:
    """Which of the strata's cells a point lies in: each block of `cells` points has every cell once, shuffled."""
    return int(_shuffled(cells, seed, split, number // cells)[number % cells])


@lru_cache(maxsize=16)
def _shuffled(cells: int, seed: int, split: str, block: int) -> NDArray[np.int64]:
    return child_rng(seed, "sampling", "strata", split, block).permutation(cells)


@lru_cache(maxsize=16)
def _latin_hypercube(dimensions: int, block: int, seed: int, split: str, number: int) -> Points:
    """(block, d) points of which each coordinate has one in every 1/block of its range."""
    from scipy.stats import qmc  # takes a second to load

    rng = child_rng(seed, "sampling", "latin_hypercube", split, number)
    return _inside(qmc.LatinHypercube(dimensions, rng=rng).random(block))


@lru_cache(maxsize=16)
def _sequence(method: Method, dimensions: int, seed: int, split: str, piece: int) -> Points:
    """(_PIECE, d) points of a scrambled sequence, from number piece * _PIECE on."""
    from scipy.stats import qmc

    period, skipped = divmod(piece * _PIECE, _PERIOD)
    rng = child_rng(seed, "sampling", method, split, period)
    engine = (qmc.Sobol if method == "sobol" else qmc.Halton)(dimensions, scramble=True, rng=rng)
    if skipped:
        engine.fast_forward(skipped)
    return _inside(engine.random(_PIECE))


def _inside(points: Points) -> Points:
    """Away from 0 and 1, where a Gaussian has no finite quantile; a third of a Sobol point's own last digit."""
    points = np.clip(points, 2.0**-32, 1.0 - 2.0**-32)
    points.flags.writeable = False  # it is kept
    return points
