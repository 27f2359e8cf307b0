"""Places for all species together: a lattice of cells, which of the places are taken, and by whom.

The part of a lattice's cell in which a plant may stand is a box around the cell's middle, `jitter` times as wide and
high. Densities are integrated over that box, and places are drawn from them in it: so nothing stands on barred ground,
and the density of all places together is that of the species wherever the cells are not full.

Places are chosen without replacement, each with a probability in proportion to its weight, and exactly as many as are
asked for. Then species are dealt out: place i goes to species s with probability

    q_is = c_s w_is / Σ_t c_t w_it,        c_s so that Σ_i q_is is the number of plants of species s,

and what chance leaves over or short is exchanged, so that each species has its number to the plant. No species comes
to a place where its weight is 0.

Reference: Madow 1949, Ann. Math. Stat. 20 (systematic sampling); Deming and Stephan 1940, Ann. Math. Stat. 11 (factors
c_s).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from forestgen.community.placement.densities import COUNTING_CELLS, PlacementParameters, species_density
from forestgen.community.placement.model import PlantingTargets
from forestgen.community.population import Ecologies, Floats, Site

_CERTAIN = 1.0 - 1e-9
_MOST_ODDS = 1e9
_FACTOR_ROUNDS = 50  # of fitting c_s: what is left after them is exchanged


def lattice_shape(n: int, size_m: tuple[float, float]) -> tuple[int, int]:
    """Rows and columns of at least n cells, as near to squares as can be."""
    width, height = size_m
    free = math.sqrt(n * width / height)
    shapes = [(math.ceil(n / cols), cols) for cols in {max(1, math.floor(free)), max(1, math.ceil(free))}]
    return min(shapes, key=lambda shape: (abs(math.log(width * shape[0] / (height * shape[1]))), shape[0] * shape[1]))


@dataclass(frozen=True)
class Lattice:
    """The cells of a site and what each species has in their boxes. Cell k is row k // cols, column k % cols."""

    shape: tuple[int, int]  # rows, cols
    size_m: tuple[float, float]  # of the site
    part: Floats  # (P,) share of each of a cell's P parts, along an axis, that lies in the box
    first: Floats  # (P,) where in the cell, 0 to 1, that share begins
    last: Floats  # (P,) and where it ends
    density: Floats  # (S, rows P, cols P) of each species in the parts of all cells

    @property
    def weight(self) -> Floats:
        """(S, cells) the density summed over the boxes."""
        (rows, cols), parts = self.shape, len(self.part)
        blocks = self.density.reshape(-1, rows, parts, cols, parts)
        sums = np.einsum("srpcq,p,q->src", blocks, self.part, self.part, optimize=True)
        return np.asarray(sums.reshape(len(blocks), rows * cols))

    def draw(self, cell: NDArray[np.integer], species: NDArray[np.integer], uniform: Floats) -> Floats:
        """(N, 2) places in the boxes of (N,) cells, metres, by the density of (N,) species; `uniform` is (N, 3)."""
        (rows, cols), parts = self.shape, len(self.part)
        row, col = np.asarray(cell) // cols, np.asarray(cell) % cols
        inside = np.arange(parts)
        own = self.density[
            np.asarray(species)[:, None, None],
            (row[:, None] * parts + inside)[:, :, None],
            (col[:, None] * parts + inside)[:, None, :],
        ]
        below = np.cumsum((own * self.part[:, None] * self.part).reshape(len(row), parts * parts), axis=1)
        chosen = np.argmax(below > uniform[:, :1] * below[:, -1:], axis=1)
        up, along = chosen // parts, chosen % parts
        x = col + self.first[along] + (self.last - self.first)[along] * uniform[:, 1]
        y = row + self.first[up] + (self.last - self.first)[up] * uniform[:, 2]
        return np.stack([x * (self.size_m[0] / cols), y * (self.size_m[1] / rows)], axis=1)


def lattice(
    parameters: PlacementParameters, site: Site, species: Ecologies, shape: tuple[int, int], jitter: float
) -> Lattice:
    """The lattice of rows and columns whose boxes are `jitter` (0 to 1) of a cell wide.

    A cell has an odd number of parts along an axis, so that its middle is in the middle of a part, and so many that
    densities are read on about as fine a grid as plants are counted on.
    """
    parts = math.ceil(COUNTING_CELLS / max(shape))
    parts += 1 - parts % 2
    at = np.arange(parts, dtype=np.float64)
    middle, half = parts / 2, jitter * parts / 2
    first, last = np.clip(middle - half, at, at + 1), np.clip(middle + half, at, at + 1)
    part = last - first if jitter > 0 else (at == parts // 2).astype(np.float64)
    fine = (shape[0] * parts, shape[1] * parts)
    density = np.array([species_density(parameters, site, one.name, fine) for one in species])
    return Lattice(shape, site.size_m, part, first / parts, last / parts, density.reshape(len(species), *fine))


def inclusion(weight: Floats, n: int) -> Floats:
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


def choose(weight: Floats, n: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """(n,) different places in random order, place i with the probability `inclusion`; fewer if fewer have a weight."""
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


def label(weight: Floats, counts: NDArray[np.integer], rng: np.random.Generator) -> NDArray[np.int64]:
    """(N,) species of each place, -1 for none.

    `weight` (S, N) >= 0 is what a species has at a place, `counts` (S,) how many places each takes: N in all, or less.
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


def _fitted(weight: Floats, counts: Floats) -> Floats:
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


def _exchange(labels: NDArray[np.int64], share: Floats, counts: NDArray[np.integer], rng: np.random.Generator) -> None:
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


def assign(wanted: PlantingTargets, position_m: Floats, labels: NDArray[np.int64], rng: np.random.Generator) -> Floats:
    """(N, 2) place of each plant: those of its species in random order, the largest plant first; nan for none."""
    places = np.full((len(wanted.sp), 2), np.nan)
    for one in np.unique(wanted.sp):
        plants = np.flatnonzero(wanted.sp == one)
        mine = rng.permutation(np.flatnonzero(labels == one))[: len(plants)]
        places[plants[: len(mine)]] = position_m[mine]
    return places
