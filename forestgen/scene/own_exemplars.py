"""Exemplars of plants that their community grew branch by branch: near plants as themselves, far ones by a few.

Near plants are unique: each is meshed with its own branches, and stands as it grew. The others of a species are grouped
by k-means over the logarithms of height, crown radius, number of modules and trunk diameter, and the plant nearest to a
cluster's centre stands for it, scaled to each plant's height and turned by each plant's own angle. The dead are grouped
by themselves.

Which plants are unique is decided by their size in pixels, the largest first: those at least `LEAST_PIXELS` high, as
long as `MOST_TRIANGLES` allow. Both are fixed, so that images do not depend on the machine.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population, Status
from forestgen.core.randomness import child_seed
from forestgen.scene.exemplars import ExemplarPlan, cluster

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

LEAST_PIXELS = 24.0  # height of a unique plant in the image that shows it largest
MOST_TRIANGLES = 10_000_000  # of all unique plants
_WEIGHTS = {"height_m": 1.0, "radius_m": 0.7, "modules": 0.5, "trunk_diameter_m": 0.5}
_LEAST = 1e-3  # metres, below which a size's logarithm tells nothing


def unique_plants(
    population: Population, species: Bools, pixel_m: Floats, triangles: Callable[[], Floats], wanted: str | int
) -> Bools:
    """(N,) which plants are meshed as themselves.

    Parameters
    ----------
    species : (N,) plants of species that are clothed by modules.
    pixel_m : (N,) what a pixel covers of each plant, see `scene.assemble.pixel_size_m`.
    triangles : (N,) of each plant, estimated; asked for where it matters.
    wanted : auto, all, none, or the number of plants.
    """
    chosen = np.zeros(len(population), dtype=np.bool_)
    if wanted == "all":
        return species.copy()
    pixels = population.height_m / np.maximum(pixel_m, 1e-9)
    rows = np.flatnonzero(species)
    rows = rows[np.argsort(-pixels[rows], kind="stable")]
    if isinstance(wanted, int):
        chosen[rows[:wanted]] = True
    elif wanted == "auto":
        rows = rows[pixels[rows] >= LEAST_PIXELS]
        if len(rows):
            chosen[rows[np.cumsum(triangles()[rows]) <= MOST_TRIANGLES]] = True
    return chosen


def plan_own(population: Population, index: int, is_unique: Bools, per_species: int, seed: int) -> ExemplarPlan:
    """The plan of one species whose plants have branches of their own.

    Parameters
    ----------
    index : of the species.
    is_unique : (N,) see `unique_plants`.
    per_species : exemplars of the plants that are not unique, at most; of the dead among them as many again.
    """
    rows = np.flatnonzero(population.species == index)
    unique, others = rows[is_unique[rows]], rows[~is_unique[rows]]
    dead = population.status[others] == Status.DEAD
    stand_in, label = _stand_ins(population, others[~dead], per_species, child_seed(seed, "k-means", "own", index))
    if dead.any():
        theirs = _stand_ins(population, others[dead], per_species, child_seed(seed, "k-means", "dead", index))
        living, label = label, np.empty(len(others), dtype=np.int64)
        label[~dead], label[dead] = living, len(stand_in) + theirs[1]
        stand_in = np.concatenate([stand_in, theirs[0]])
    plant = np.concatenate([unique, stand_in])
    of_plant = np.empty(len(rows), dtype=np.uint32)
    of_plant[is_unique[rows]] = np.arange(len(unique))
    of_plant[~is_unique[rows]] = len(unique) + label
    return ExemplarPlan.of_species(
        index, population.radius_m[plant], of_plant, plant=plant.astype(np.int64), unique=len(unique)
    )


def _stand_ins(population: Population, rows: Ints, clusters: int, seed: int) -> tuple[Ints, Ints]:
    """The plants that stand for others, and (R,) which of them stands for each row."""
    if not len(rows):
        return rows, rows
    columns = {"height_m": population.height_m, "radius_m": population.radius_m, **population.columns}
    features = np.stack(
        [
            weight * np.log(np.maximum(np.asarray(columns[name], dtype=np.float64)[rows], _LEAST))
            for name, weight in _WEIGHTS.items()
            if name in columns
        ],
        axis=1,
    )
    centres, label = cluster(features, clusters, seed)
    away = np.sum((features - centres[label]) ** 2, axis=1)
    order = np.lexsort((rows, away, label))
    nearest = order[np.unique(label[order], return_index=True)[1]]
    return rows[nearest], np.unique(label, return_inverse=True)[1].reshape(-1)
