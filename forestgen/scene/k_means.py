"""k-means: Lloyd's iterations from centres that k-means++ draws.

Centres and labels are, bit by bit, those of ``sklearn.cluster.KMeans(clusters, random_state=seed, n_init=1)`` on one
thread; a test compares them. scikit-learn itself takes two seconds to import, a hundred times as long as the clusters.

Draws, sums and products are therefore made in its order, by the same functions of NumPy and SciPy: rows in blocks of
`_BLOCK_ROWS`, whose squared distances |c|² - 2 x·c come from BLAS.

References
----------
Arthur, D. and Vassilvitskii, S. (2007). k-means++: the advantages of careful seeding. SODA 2007, 1027-1035.
Pedregosa, F. et al. (2011). Scikit-learn: machine learning in Python. JMLR 12, 2825-2830.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dgemm
from threadpoolctl import threadpool_limits

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_MOST_ITERATIONS = 300
_TOLERANCE = 1e-4  # squared movement of all centres at which they stand, by the mean variance of a feature
_BLOCK_ROWS = 256


def k_means(rows: Floats, clusters: int, seed: int) -> tuple[Floats, Ints]:
    """Centres (K, F) and the index of each row's centre (N,). `rows`: (N, F) finite, N >= K. `clusters`: K."""
    rows = np.ascontiguousarray(rows)
    with threadpool_limits(1):  # partial sums must not depend on the number of threads
        tolerance, mean = float(np.mean(np.var(rows, axis=0))) * _TOLERANCE, rows.mean(axis=0)
        centred = rows - mean
        centres, labels = _lloyd(centred, _initial(centred, clusters, seed), tolerance)
        return centres + mean, labels


def _initial(rows: Floats, clusters: int, seed: int) -> Floats:
    """(K, F) rows as first centres: each the best of some drawn by their squared distance to those before it."""
    rng = np.random.RandomState(seed)  # scikit-learn's generator
    weight = np.ones(len(rows))
    candidates = 2 + int(np.log(clusters))
    squared_norms = _squared_norms(rows)
    centres = np.empty((clusters, rows.shape[1]))
    centres[0] = rows[rng.choice(len(rows), p=weight / weight.sum())]
    nearest = _squared_distances(centres[:1], rows, squared_norms)
    total = nearest @ weight
    for k in range(1, clusters):
        drawn = np.searchsorted(np.cumsum(nearest), rng.uniform(size=candidates) * total)
        drawn = np.minimum(drawn, len(rows) - 1)  # the last sum may be less than the total, by rounding
        distances = np.minimum(nearest, _squared_distances(rows[drawn], rows, squared_norms))
        totals = distances @ weight[:, None]
        best = np.argmin(totals)
        total, nearest = totals[best], distances[best]
        centres[k] = rows[drawn[best]]
    return centres


def _squared_distances(some: Floats, rows: Floats, squared_norms: Floats) -> Floats:
    """(S, N) from each of `some` to each row."""
    distances = -2 * (some @ rows.T)
    distances += _squared_norms(some)[:, None]
    distances += squared_norms[None, :]
    return np.maximum(distances, 0)


def _squared_norms(rows: Floats) -> Floats:
    return np.asarray(np.einsum("ij,ij->i", rows, rows))


def _lloyd(rows: Floats, centres: Floats, tolerance: float) -> tuple[Floats, Ints]:
    """Centres that are the means of the rows nearest to them, or nearly, and the nearest centre of each row."""
    before = np.full(len(rows), -1)
    for _ in range(_MOST_ITERATIONS):
        labels = _nearest(rows, centres)
        moved = _means(rows, centres, labels)
        movement = float((_distances(moved, centres) ** 2).sum())
        centres = moved
        if np.array_equal(labels, before):
            return centres, labels
        if movement <= tolerance:
            break
        before = labels
    return centres, _nearest(rows, centres)


def _nearest(rows: Floats, centres: Floats) -> Ints:
    """(N,) index of each row's nearest centre."""
    labels = np.empty(len(rows), dtype=np.int64)
    squared_norms = _squared_norms(centres)
    for first in range(0, len(rows), _BLOCK_ROWS):
        block = rows[first : first + _BLOCK_ROWS]
        norms = np.tile(squared_norms, (len(block), 1)).T
        distances = dgemm(-2.0, centres.T, block.T, beta=1.0, c=norms, trans_a=True, overwrite_c=True)
        labels[first : first + _BLOCK_ROWS] = distances.argmin(axis=0)
    return labels


def _means(rows: Floats, centres: Floats, labels: Ints) -> Floats:
    """(K, F) mean of each centre's rows; a centre without any takes one of the rows that are farthest from theirs."""
    count = np.bincount(labels, minlength=len(centres)).astype(np.float64)
    sums = np.stack([np.bincount(labels, column, minlength=len(centres)) for column in rows.T], axis=1)
    empty = np.flatnonzero(count == 0)
    if len(empty):
        distances = ((rows - centres[labels]) ** 2).sum(axis=1)
        farthest = np.argpartition(distances, -len(empty))[: -len(empty) - 1 : -1]
        for new, row in zip(empty, farthest, strict=True):
            sums[labels[row]] -= rows[row]
            sums[new] = rows[row]
            count[labels[row]] -= 1.0
            count[new] = 1.0
    means = sums * (1.0 / np.maximum(count, 1.0))[:, None]
    largest = int(np.argmax(count))
    for lost in np.flatnonzero(count == 0):  # those before the largest take its sum, not its mean, as in scikit-learn
        means[lost] = (sums if lost < largest else means)[largest]
    return np.asarray(means)


def _distances(some: Floats, others: Floats) -> Floats:
    """(K,) between rows; four squares are added at a time."""
    squares = (some - others) ** 2
    total = np.zeros(len(squares))
    fours = squares.shape[1] // 4 * 4
    for first in range(0, fours, 4):
        total += ((squares[:, first] + squares[:, first + 1]) + squares[:, first + 2]) + squares[:, first + 3]
    for column in range(fours, squares.shape[1]):
        total += squares[:, column]
    return np.sqrt(total)
