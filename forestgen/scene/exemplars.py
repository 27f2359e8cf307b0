"""From many plants to few exemplars: k-means of size per species (Lane 2002, chapter 6; Deussen et al. 1998)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population
from forestgen.core.randomness import child_seed


@dataclass(frozen=True)
class ExemplarPlan:
    """Which exemplars to grow, and which plant uses which."""

    species: NDArray[np.uint16]  # (E,) index into the population's species_names
    radius_m: NDArray[np.float64]  # (E,) size of each exemplar
    exemplar_of_plant: NDArray[np.uint32]  # (N,) index into the exemplars


@dataclass(frozen=True)
class SizeError:
    """How far the exemplars' proportions are from the plants' own. Heights are exact: instances are scaled."""

    species: str
    plants: int
    exemplars: int
    radius_rms: float  # root mean square of (exemplar radius / plant radius - 1)
    crown_width_rms: float  # of (scaled exemplar's crown width / the plant's own allometric width - 1)


def plan_exemplars(population: Population, per_species: int, seed: int) -> ExemplarPlan:
    """Cluster each species' radii into at most `per_species` sizes; species without plants get none.

    k-means runs on the logarithm of the radius, so that errors are relative: a sapling's counts as much as a tree's.
    """
    species: list[int] = []
    radii: list[float] = []
    assignment = np.zeros(len(population), dtype=np.uint32)
    for index, name in enumerate(population.species_names):
        rows = np.flatnonzero(population.species == index)
        if not len(rows):
            continue
        centres, labels = _cluster(np.log(population.radius_m[rows]), per_species, child_seed(seed, "k-means", name))
        assignment[rows] = len(species) + labels
        species += [index] * len(centres)
        radii += list(np.exp(centres))
    return ExemplarPlan(np.asarray(species, dtype=np.uint16), np.asarray(radii), assignment)


def _cluster(values: NDArray[np.float64], clusters: int, seed: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Sorted centres and each value's centre."""
    distinct = np.unique(values)
    if len(distinct) <= clusters:
        return distinct, np.searchsorted(distinct, values)
    from sklearn.cluster import KMeans
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):  # partial sums must not depend on the number of threads
        model = KMeans(n_clusters=clusters, random_state=seed, n_init=1).fit(values[:, None])
    order = np.argsort(model.cluster_centers_[:, 0])
    rank = np.empty(clusters, dtype=np.int64)
    rank[order] = np.arange(clusters)
    return model.cluster_centers_[order, 0].astype(np.float64), rank[model.labels_]


def size_errors(
    population: Population,
    plan: ExemplarPlan,
    exemplar_height_m: NDArray[np.float64],
    exemplar_width_m: NDArray[np.float64],
    plant_width_m: NDArray[np.float64],
) -> list[SizeError]:
    """Error of the approximation for each species that has plants.

    Parameters
    ----------
    exemplar_height_m, exemplar_width_m : (E,) measured on the geometry.
    plant_width_m : (N,) crown width that each plant should have by its species' allometry.
    """
    errors = []
    for index, name in enumerate(population.species_names):
        rows = population.species == index
        if not rows.any():
            continue
        mine = plan.exemplar_of_plant[rows]
        scale = population.height_m[rows] / exemplar_height_m[mine]
        width = exemplar_width_m[mine] * scale / plant_width_m[rows] - 1
        radius = plan.radius_m[mine] / population.radius_m[rows] - 1
        errors.append(
            SizeError(
                species=name,
                plants=int(rows.sum()),
                exemplars=len(np.unique(mine)),
                radius_rms=float(np.sqrt(np.mean(radius**2))),
                crown_width_rms=float(np.sqrt(np.mean(width**2))),
            )
        )
    return errors
