"""From many plants to few exemplars: k-means of size and traits per species.

Each species' plants fall into at most `exemplars_per_species` clusters. One plant stands for a cluster, or several of
the same size and different seed (variants), which the cluster's plants share among them.

The clusters are of the radius, in its logarithm, so that errors are relative: a sapling's counts as much as a tree's.
A trait, such as the age, is a further dimension. It is standardised among the species' plants (mean 0, standard
deviation 1) and multiplied by `TRAIT_WEIGHT` times the standard deviation of the logarithm of the radius, at least
`LEAST_SPREAD`: a trait counts half as much as the size, since the size is what the geometry follows. Values that are no
numbers count as the mean.

References
----------
Lane, B. (2002). Models of plant communities for image synthesis. MSc thesis, University of Calgary, chapter 6.
Deussen, O. et al. (1998). Realistic modeling and rendering of plant ecosystems. SIGGRAPH 1998, 275-286, section 5.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population
from forestgen.core.errors import RecipeError
from forestgen.core.randomness import child_seed
from forestgen.scene.exemplar_library import Library, plan_from_library
from forestgen.scene.exemplar_plan import ExemplarPlan

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

TRAIT_WEIGHT = 0.5  # of a trait against the radius
LEAST_SPREAD = 0.1  # standard deviation of the radius' logarithm at least, where traits are weighed against it
_OWN_TRAITS = ("age_yr", "height_m")  # columns that every population has, beside the radius


@dataclass(frozen=True)
class SizeError:
    """How far the exemplars' proportions are from the plants' own. Heights are exact: instances are scaled."""

    species: str
    plants: int
    exemplars: int
    radius_rms: float  # root mean square of (exemplar radius / plant radius - 1)
    crown_width_rms: float | None  # of (scaled exemplar's crown width / allometric width - 1); None without a crown


def check_traits(traits: Sequence[str], population: Population, where: str) -> None:
    """Refuse a trait that is no numeric column of the population.

    Raises
    ------
    RecipeError : with the columns that there are.
    """
    known = [*_OWN_TRAITS, *(name for name, column in population.columns.items() if _is_numeric(column))]
    for trait in traits:
        if trait not in known:
            near = difflib.get_close_matches(trait, known, n=1)
            raise RecipeError(
                "the plants have no such trait",
                where=where,
                expected="one of " + ", ".join(known),
                got=repr(trait),
                hint=f"did you mean {near[0]!r}?" if near else None,
            )


def _is_numeric(column: NDArray[np.generic]) -> bool:
    return column.ndim == 1 and np.issubdtype(column.dtype, np.number)


def plan_exemplars(
    population: Population,
    per_species: int,
    seed: int,
    *,
    traits: Sequence[str] = (),
    variants: int = 1,
    given: Mapping[int, ExemplarPlan] | None = None,
    library: Library | None = None,
) -> ExemplarPlan:
    """Cluster each species' plants into at most `per_species` sizes; species without plants get none.

    Parameters
    ----------
    traits : columns of the population that count beside the radius, see `check_traits`.
    variants : exemplars of each size. A plant's is its own, whatever else grows.
    given : plans of species that have one, by their index, see scene/own_exemplars.py; `exemplar_of_plant` of those
        has a species' plants alone.
    library : sizes and variants are those that all images share, instead of clusters; `variants` of each.
    """
    columns = [np.asarray(_column(population, trait), dtype=np.float64) for trait in traits]
    own = np.array([child_seed(seed, "variant", int(i)) % variants for i in population.plant_id], dtype=np.int64)
    parts: list[ExemplarPlan] = []
    for index, name in enumerate(population.species_names):
        rows = np.flatnonzero(population.species == index)
        if not len(rows):
            continue
        if given is not None and index in given:
            parts.append(given[index])
            continue
        if library is not None:
            part, variant = plan_from_library(
                index, name, population.radius_m[rows], own[rows], library, per_species, seed
            )
            parts.append(_split(part, variant, "variant"))
            continue
        features = _features(population.radius_m[rows], [column[rows] for column in columns])
        centres, labels = cluster(features, per_species, child_seed(seed, "k-means", name))
        part = ExemplarPlan(
            species=np.full(len(centres), index, dtype=np.uint16),
            radius_m=np.exp(centres[:, 0]),
            rank=np.arange(len(centres)),
            variant=np.zeros(len(centres), dtype=np.int64),
            level=np.zeros(len(centres), dtype=np.int64),
            exemplar_of_plant=labels.astype(np.uint32),
            plant=np.full(len(centres), -1, dtype=np.int64),
            is_unique=np.zeros(len(centres), dtype=np.bool_),
        )
        parts.append(_split(part, own[rows], "variant"))
    return _joined(parts, population.species)


def with_levels(plan: ExemplarPlan, level_of_plant: Ints) -> ExemplarPlan:
    """The plan with an exemplar for each level of detail at which plants see it.

    Parameters
    ----------
    level_of_plant : (N,) index of the level of detail of each plant.
    """
    return _split(plan, level_of_plant, "level")


def _split(plan: ExemplarPlan, value_of_plant: Ints, field: Literal["variant", "level"]) -> ExemplarPlan:
    """An exemplar for each pair of exemplar and value that some plant has, in the order of both."""
    pairs = np.stack([plan.exemplar_of_plant.astype(np.int64), value_of_plant], axis=1)
    used, chosen = np.unique(pairs, axis=0, return_inverse=True)
    origin = used[:, 0]
    return ExemplarPlan(
        species=plan.species[origin],
        radius_m=plan.radius_m[origin],
        rank=plan.rank[origin],
        variant=used[:, 1] if field == "variant" else plan.variant[origin],
        level=used[:, 1] if field == "level" else plan.level[origin],
        exemplar_of_plant=chosen.reshape(-1).astype(np.uint32),
        plant=plan.plant[origin],
        is_unique=plan.is_unique[origin],
    )


def _joined(parts: Sequence[ExemplarPlan], species: NDArray[np.uint16]) -> ExemplarPlan:
    """One plan of each species' own, which are in the order of the species."""
    assignment = np.zeros(len(species), dtype=np.uint32)
    before = 0
    for part in parts:
        assignment[species == part.species[0]] = before + part.exemplar_of_plant
        before += len(part)
    empty_whole, empty = np.zeros(0, dtype=np.int64), np.zeros(0)
    return ExemplarPlan(
        species=np.concatenate([empty_whole, *(part.species for part in parts)]).astype(np.uint16),
        radius_m=np.concatenate([empty, *(part.radius_m for part in parts)]),
        rank=np.concatenate([empty_whole, *(part.rank for part in parts)]),
        variant=np.concatenate([empty_whole, *(part.variant for part in parts)]),
        level=np.concatenate([empty_whole, *(part.level for part in parts)]),
        exemplar_of_plant=assignment,
        plant=np.concatenate([empty_whole, *(part.plant for part in parts)]),
        is_unique=np.concatenate([empty_whole, *(part.is_unique for part in parts)]).astype(np.bool_),
    )


def _column(population: Population, trait: str) -> NDArray[np.generic]:
    column: NDArray[np.generic] = (
        getattr(population, trait) if trait in _OWN_TRAITS else np.asarray(population.columns[trait])
    )
    return column


def _features(radius_m: Floats, traits: Sequence[Floats]) -> Floats:
    """(n, 1 + traits) the logarithm of the radius, and each trait by its weight."""
    size = np.log(radius_m)
    weight = TRAIT_WEIGHT * max(float(size.std()), LEAST_SPREAD)
    columns = [size]
    for trait in traits:
        known = np.isfinite(trait)
        mean, spread = (float(f(trait[known])) if known.any() else 0.0 for f in (np.mean, np.std))
        columns.append(np.where(known, weight * (trait - mean) / spread, 0.0) if spread > 0.0 else np.zeros_like(size))
    return np.stack(columns, axis=1)


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
    plant_width_m : (N,) crown width that each plant should have by its species' allometry; NaN where it has no crown.
    """
    errors = []
    for index, name in enumerate(population.species_names):
        rows = population.species == index
        if not rows.any():
            continue
        mine = plan.exemplar_of_plant[rows]
        scale = population.height_m[rows] / exemplar_height_m[mine]
        width = exemplar_width_m[mine] * scale / plant_width_m[rows] - 1
        has_crown = not np.isnan(plant_width_m[rows]).any()
        radius = plan.radius_m[mine] / population.radius_m[rows] - 1
        errors.append(
            SizeError(
                species=name,
                plants=int(rows.sum()),
                exemplars=len(np.unique(mine)),
                radius_rms=float(np.sqrt(np.mean(radius**2))),
                crown_width_rms=float(np.sqrt(np.mean(width**2))) if has_crown else None,
            )
        )
    return errors
