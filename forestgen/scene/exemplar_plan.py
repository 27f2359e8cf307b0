"""Which exemplars to grow, and which plant uses which; and what sizes are put together by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

TREE_SIZES = 5  # see `plants.tree_fit.TreeSize`
SIZE_STEP = 1.25  # of the sizes of a library: a plant is at most 12% from its rung


@dataclass(frozen=True)
class ExemplarPlan:
    """Which exemplars to grow, and which plant uses which. Every exemplar has plants."""

    species: NDArray[np.uint16]  # (E,) index into the population's species_names
    radius_m: Floats  # (E,) size of each exemplar
    tree: Floats  # (E, 5) sizes of each tree in the order of `TreeSize`; NaN of plants that go by the radius
    rank: Ints  # (E,) of its cluster among the species', by radius: 0, 1, ...; of a library, its rung
    variant: Ints  # (E,) which of the plants of that size
    level: Ints  # (E,) index of its level of detail, see plants/levels.py: 0 is all detail
    dead: Ints  # (E,) form and decay class, see `core.dead_wood.dead_codes`; 0: it lives
    leaves: Ints  # (E,) index of its leaves among the species' `phenology.leaf_states`
    exemplar_of_plant: NDArray[np.uint32]  # (N,) index into the exemplars
    plant: Ints  # (E,) row of the plant whose own branches it has; -1: its species' generator grows it by its radius
    is_unique: NDArray[np.bool_]  # (E,) of that plant alone, which keeps its place, size and attitude

    def __len__(self) -> int:
        return len(self.radius_m)

    @classmethod
    def of_species(
        cls,
        index: int,
        radius_m: Floats,
        exemplar_of_plant: NDArray[np.integer],
        *,
        rank: Ints | None = None,
        plant: Ints | None = None,
        tree: Floats | None = None,
        dead: Ints | None = None,
        unique: int = 0,
    ) -> ExemplarPlan:
        """Exemplars of one species, variant 0 with all detail; the first `unique` are of one plant alone."""
        count = len(radius_m)
        zeros = np.zeros(count, dtype=np.int64)
        return cls(
            species=np.full(count, index, dtype=np.uint16),
            radius_m=radius_m,
            tree=np.full((count, TREE_SIZES), np.nan) if tree is None else tree,
            rank=np.arange(count) if rank is None else rank,
            variant=zeros,
            level=zeros,
            dead=zeros if dead is None else dead,
            leaves=zeros,
            exemplar_of_plant=exemplar_of_plant.astype(np.uint32),
            plant=zeros - 1 if plant is None else plant,
            is_unique=np.arange(count) < unique,
        )

    def stands_for(self, size: Floats) -> Floats:
        """(E,) size of the plant whose own branches each exemplar has, of (N,) of the plants; NaN: of none."""
        own, found = self.plant >= 0, np.full(len(self), np.nan)
        found[own] = size[self.plant[own]]
        return found

    def first_plant(self, plant_id: NDArray[np.integer]) -> Ints:
        """(E,) lowest id of the plants that each exemplar, or one of other detail or leaves, stands for.

        `plant_id`: (N,) of the plants.
        """
        own = np.stack([self.species, self.rank, self.variant, self.plant], axis=1).astype(np.int64)
        same = np.unique(own, axis=0, return_inverse=True)[1].reshape(-1)
        first = np.full(len(self), np.iinfo(np.int64).max)
        np.minimum.at(first, same[self.exemplar_of_plant], plant_id.astype(np.int64))
        return np.asarray(first[same])

    def split(self, field: Literal["variant", "level", "leaves"], value_of_plant: Ints) -> ExemplarPlan:
        """An exemplar for each pair of exemplar and value that some plant has, in the order of both."""
        pairs = np.stack([self.exemplar_of_plant.astype(np.int64), value_of_plant], axis=1)
        used, chosen = np.unique(pairs, axis=0, return_inverse=True)
        columns = {name: getattr(self, name)[used[:, 0]] for name in OF_EXEMPLARS} | {field: used[:, 1]}
        return ExemplarPlan(**columns, exemplar_of_plant=chosen.reshape(-1).astype(np.uint32))


OF_EXEMPLARS = ("species", "radius_m", "tree", "rank", "variant", "level", "dead", "leaves", "plant", "is_unique")


def cluster(features: Floats, clusters: int, seed: int) -> tuple[Floats, Ints]:
    """Centres, sorted by their first feature and then the next, and each row's centre."""
    distinct, rank = np.unique(features, axis=0, return_inverse=True)
    if len(distinct) <= clusters:
        return distinct, rank.reshape(-1)
    from forestgen.scene.k_means import k_means  # brings SciPy's BLAS

    centres, labels = k_means(features, clusters, seed)
    order = np.lexsort(centres.T[::-1])
    place = np.empty(clusters, dtype=np.int64)
    place[order] = np.arange(clusters)
    return centres[order], place[labels]


def cluster_groups(features: Floats, group: Ints, clusters: int, seed: int) -> Ints:
    """(n,) the cluster of each row, in the order of the groups, then as in `cluster`; none has rows of two groups.

    Each group has one at least. The others go one by one to the group whose spread (the root of its sum of squares),
    over the clusters that it has, is largest.
    """
    rows = [np.flatnonzero(group == one) for one in np.unique(group)]
    spread = np.array([np.sqrt(len(one) * features[one].var(axis=0).sum()) for one in rows])
    most = np.array([len(np.unique(features[one], axis=0)) for one in rows])
    count = np.ones(len(rows), dtype=np.int64)
    while count.sum() < min(clusters, most.sum()):
        count[np.argmax(np.where(count < most, spread / count, -1.0))] += 1
    label = np.empty(len(group), dtype=np.int64)
    for one, first, own in zip(rows, np.cumsum(count) - count, count.tolist(), strict=True):
        label[one] = first + cluster(features[one], own, seed)[1]
    return np.unique(label, return_inverse=True)[1].reshape(-1)


def rung_of(value: float, step: float) -> int:
    """The nearest rung of a ladder that has one at 1."""
    return round(float(np.log(value) / np.log(step)))


def rungs_of(radius_m: Floats, most: int) -> Ints:
    """(N,) rung that stands for each plant: its own, or where there are more than `most`, one of those evenly between.

    `radius_m`: (N,) of a species' plants, at least one.
    """
    own: Ints = np.rint(np.log(radius_m) / np.log(SIZE_STEP)).astype(np.int64)
    if len(np.unique(own)) <= most:
        return own
    low, high = int(own.min()), int(own.max())
    count = min(most, high - low + 1)
    chosen = np.rint(low - 0.5 + (np.arange(count) + 0.5) * (high - low + 1) / count).astype(np.int64)
    place = np.searchsorted((chosen[:-1] + chosen[1:]) / 2, own)
    return np.asarray(chosen[place], dtype=np.int64)
