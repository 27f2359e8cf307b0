"""One pattern for all species: which of its places are taken, and by whom.

Places are chosen without replacement, each with a probability in proportion to its weight, and exactly as many as are
asked for. Then species are dealt out: place i goes to species s with probability

    q_is = c_s w_is / Σ_t c_t w_it,        c_s so that Σ_i q_is is the number of plants of species s,

and what chance leaves over or short is exchanged, so that each species has its number to the plant. No species comes
to a place where its weight is 0.

References
----------
Madow 1949, Ann. Math. Stat. 20 (systematic sampling); Deming and Stephan 1940, Ann. Math. Stat. 11 (factors c_s).
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from forestgen.community.placement.model import Wanted

_CERTAIN = 1.0 - 1e-9
_MOST_ODDS = 1e9
_FACTOR_ROUNDS = 50  # of fitting c_s: what is left after them is exchanged


def inclusion(weight: NDArray[np.float64], n: int) -> NDArray[np.float64]:
    """(N,) probability with which each place is among `n` chosen: min(1, c weight), of sum n.

    Where fewer than n weights are positive, all of them are 1.
    """
    probability = np.zeros(len(weight))
    positive = weight > 0
    if n >= int(positive.sum()):
        probability[positive] = 1.0
        return probability
    full = np.zeros(len(weight), dtype=np.bool_)
    while n:
        rest = np.where(full, 0.0, weight)
        probability = np.where(full, 1.0, rest * ((n - int(full.sum())) / rest.sum()))
        over = (probability > 1.0) & ~full
        if not over.any():
            break
        full |= over
    return probability


def choose(weight: NDArray[np.float64], n: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """(n,) different places in random order, place i with the probability `inclusion`; fewer if fewer have a weight.

    Parameters
    ----------
    weight : (N,) >= 0.
    """
    probability = inclusion(weight, n)
    certain = np.flatnonzero(probability >= _CERTAIN)
    open_ = np.flatnonzero((probability > 0.0) & (probability < _CERTAIN))
    order = rng.permutation(open_)
    missing = min(n - len(certain), len(order))
    sums = np.cumsum(probability[order])
    marks = (np.arange(missing) + rng.random()) * (sums[-1] / missing if missing else 1.0)
    # Steps of the sums are below the marks' distance, so no place is met twice.
    picked = order[np.minimum(np.searchsorted(sums, marks, side="right"), len(order) - 1)] if missing else order[:0]
    return rng.permutation(np.concatenate([certain, picked]))


def label(weight: NDArray[np.float64], counts: NDArray[np.integer], rng: np.random.Generator) -> NDArray[np.int64]:
    """(N,) species of each place, -1 for none.

    Parameters
    ----------
    weight : (S, N) >= 0; what a species has at a place. Only species of which there are any have some.
    counts : (S,) how many places each species takes; their sum is N, or less.
    """
    labels = np.full(weight.shape[1], -1, dtype=np.int64)
    weight = np.where(np.asarray(counts)[:, None] > 0, weight, 0.0)
    some = np.flatnonzero(weight.sum(axis=0) > 0)
    if len(some) == 0:
        return labels
    share = _fitted(weight[:, some], np.asarray(counts, dtype=np.float64))
    below = np.cumsum(share, axis=0)
    labels[some] = np.argmax(below > rng.random(len(some)) * below[-1], axis=0)
    mine = labels[some]
    _exchange(mine, share, np.asarray(counts), rng)
    labels[some] = mine
    return labels


def _fitted(weight: NDArray[np.float64], counts: NDArray[np.float64]) -> NDArray[np.float64]:
    """(S, N) q_is."""
    share = weight / weight.sum(axis=0)
    for _ in range(_FACTOR_ROUNDS):
        numbers = share.sum(axis=1)
        factor = np.divide(counts, numbers, out=np.ones(len(counts)), where=numbers > 0)
        if np.all(np.abs(factor - 1.0) < 1e-6):
            break
        share = share * np.clip(factor, 1e-9, 1e9)[:, None]
        share /= share.sum(axis=0)
    return np.asarray(share)


def _exchange(
    labels: NDArray[np.int64], share: NDArray[np.float64], counts: NDArray[np.integer], rng: np.random.Generator
) -> None:
    """Relabel places until each species has its number, in place; places that no species can take get -1.

    A species with too many gives places to one with too few, where that can be only by way of others.
    """
    species = len(counts)
    while True:
        surplus = np.bincount(labels[labels >= 0], minlength=species) - counts
        gives = np.array([np.any(share[:, labels == a] > 0, axis=1) for a in range(species)])
        path = _path(np.flatnonzero(surplus > 0), surplus < 0, gives)
        if not path:
            break
        moves = []
        for a, b in pairwise(path):
            able = np.flatnonzero((labels == a) & (share[b] > 0))
            moves.append((able, np.minimum(share[b, able] / share[a, able], _MOST_ODDS)))
        k = min(int(surplus[path[0]]), -int(surplus[path[-1]]), *(len(able) for able, _ in moves))
        for (able, odds), b in zip(moves, path[1:], strict=True):
            labels[able[choose(odds, k, rng)]] = b
    for over in np.flatnonzero(surplus > 0):
        labels[rng.choice(np.flatnonzero(labels == over), int(surplus[over]), replace=False)] = -1


def _path(sources: NDArray[np.intp], targets: NDArray[np.bool_], gives: NDArray[np.bool_]) -> list[int]:
    """Shortest way from a species that has too many to one that has too few; empty: there is none."""
    came: dict[int, int] = {int(a): -1 for a in sources}
    queue = list(came)
    for a in queue:
        if targets[a]:
            path = [a]
            while came[path[0]] >= 0:
                path.insert(0, came[path[0]])
            return path
        for b in np.flatnonzero(gives[a]):
            if int(b) not in came:
                came[int(b)] = a
                queue.append(int(b))
    return []


def deal(
    wanted: Wanted, position_m: NDArray[np.float64], labels: NDArray[np.int64], rng: np.random.Generator
) -> NDArray[np.float64]:
    """(N, 2) place of each plant: those of its species in random order, the largest plant first; nan for none."""
    places = np.full((len(wanted.sp), 2), np.nan)
    for one in np.unique(wanted.sp):
        plants = np.flatnonzero(wanted.sp == one)
        mine = rng.permutation(np.flatnonzero(labels == one))[: len(plants)]
        places[plants[: len(mine)]] = position_m[mine]
    return places
