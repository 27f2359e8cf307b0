"""Numbers by which a new stand is compared with the measured one: pairs by distance, distances to nearest plants.

Stand and new stands share their window, so counts need no correction for its edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from forestgen.community.fitting.stand import MeasuredStand

_PAIR_RADII, _NEAR_RADII = 50, 32
_PAIRS_WORTH, _RINGS_WORTH, _NEAR_WORTH = 0.5, 1.0, 0.5  # of a number, against the smoothness of kernels
_PER_RING = 5  # radii; rings tell of g what circles, which add up, do not
_NEAR_BEYOND = 1.2  # of the farthest nearest neighbour


@dataclass(frozen=True)
class Summaries:
    """What is counted; Q pairs of species, of which the first may be the second."""

    pairs: tuple[tuple[int, int], ...]  # (Q,)
    pair_radii_m: NDArray[np.float64]  # (R,) metres
    near: tuple[tuple[int, int], ...]  # of a plant of the first species, the nearest of the second
    near_radii_m: NDArray[np.float64]  # (len(near), G) metres

    def of(self, position_m: NDArray[np.float64], species: NDArray[np.int64]) -> NDArray[np.float64]:
        """(Q * (R + R / 5) + len(near) * G,) roots of the numbers of pairs within each radius and in each ring of five
        radii; shares of plants that have a nearest one within each radius."""
        trees = [cKDTree(position_m[species == one]) for one in range(max(max(pair) for pair in self.near) + 1)]
        parts = []
        for one, other in self.pairs:
            counts = np.asarray(trees[one].count_neighbors(trees[other], self.pair_radii_m), dtype=np.float64)
            within = (counts - trees[one].n) / 2 if one == other else counts
            parts += [np.sqrt(within), np.sqrt(np.diff(within[_PER_RING - 1 :: _PER_RING], prepend=0.0))]
        for (one, other), radii in zip(self.near, self.near_radii_m, strict=True):
            parts.append(shares_within(nearest_m(trees[one], trees[other]), radii))
        return np.concatenate(parts)

    def nearest(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The part of (A,) numbers, or of their differences, that tells of nearest neighbours."""
        return np.asarray(values[-self.near_radii_m.size :])

    @property
    def worth(self) -> NDArray[np.float64]:
        """Weight of each number against the others and the expectation that kernels are smooth."""
        radii = len(self.pair_radii_m)
        pairs = np.concatenate([np.full(radii, _PAIRS_WORTH), np.full(radii // _PER_RING, _RINGS_WORTH)])
        return np.concatenate([np.tile(pairs, len(self.pairs)), np.full(self.near_radii_m.size, _NEAR_WORTH)])

    def scales(self, stand: MeasuredStand, spread: NDArray[np.float64]) -> NDArray[np.float64]:
        """What counts as one step of difference: the new stands' own scatter, and no less than half a pair or plant."""
        radii = len(self.pair_radii_m)
        least = [np.full(radii + radii // _PER_RING, 0.3)] * len(self.pairs)
        least += [np.full(self.near_radii_m.shape[1], 1.0 / len(stand.of(one))) for one, _ in self.near]
        return np.asarray(np.maximum(spread, np.concatenate(least)))


def nearest_m(points: cKDTree, others: cKDTree) -> NDArray[np.float64]:
    """(N,) distance of each point to the nearest of the others, which may be the same points; inf where none is."""
    if points is others:
        return np.asarray(points.query(points.data, k=[2])[0])[:, 0]
    return np.asarray(others.query(points.data, k=[1])[0])[:, 0]


def shares_within(distance_m: NDArray[np.float64], radii_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """(R,) share of distances that are no greater than each radius; G(r) of distances to nearest neighbours."""
    if not len(distance_m):
        return np.zeros(len(radii_m))
    return np.asarray(np.searchsorted(np.sort(distance_m), radii_m, side="right") / len(distance_m))


def summaries_for(stand: MeasuredStand, reach_m: float) -> Summaries:
    """Pairs up to a quarter of the window's shorter side, or the reach; nearest plants up to the farthest one."""
    kinds = range(len(stand.names))
    pairs = tuple((i, j) for i in kinds for j in kinds if i <= j)
    near = tuple((i, j) for i in kinds for j in kinds)
    most = max(reach_m, min(stand.size_m) / 4)
    trees = [cKDTree(stand.of(one)) for one in kinds]
    farthest = np.array([nearest_m(trees[i], trees[j]).max() for i, j in near])
    return Summaries(
        pairs=pairs,
        pair_radii_m=most * np.arange(1, _PAIR_RADII + 1) / _PAIR_RADII,
        near=near,
        near_radii_m=_NEAR_BEYOND * farthest[:, None] * np.arange(1, _NEAR_RADII + 1) / _NEAR_RADII,
    )
