"""From many plants to few exemplars: k-means of size and traits per species.

Each species' plants fall into at most `exemplars_per_species` clusters. One plant stands for a cluster, or several of
the same size and different seed (variants), which the cluster's plants share among them.

The clusters are of the radius, in its logarithm, so that errors are relative: a sapling's counts as much as a tree's.
Of trees see `tree_exemplars`.
A trait, such as the age, is a further dimension. It is standardised among the species' plants (mean 0, standard
deviation 1) and multiplied by `TRAIT_WEIGHT` times the standard deviation of the logarithm of the radius, at least
`LEAST_SPREAD`: a trait counts half as much as the size, since the size is what the geometry follows. Values that are no
numbers count as the mean.

Clusters fit one image's plants best, and no other image asks for the same sizes. A library's sizes, which many images
share, are the rungs of a ladder instead, each `SIZE_STEP` times the one below; plants are scaled to their own height.
So a data set of any length grows as many plants as its ladder has rungs and each rung variants. A library's plant
depends on the recipe's own seed, the split, its species and size, and not on the image. No split shows a plant of
another one's, so that validation and testing see plants that training never saw.

Plants that their community grew branch by branch
-------------------------------------------------
Near plants are unique: each is meshed with its own branches, and stands as it grew. The others of a species are grouped
by k-means over the logarithms of height, crown radius, number of modules and trunk diameter, and the plant nearest to a
cluster's centre stands for it, scaled to each plant's height and turned by each plant's own angle. The dead are grouped
by themselves.

Which plants are unique is decided by their size in pixels, the largest first: those at least `LEAST_PIXELS` high, as
long as `MOST_TRIANGLES` allow. Both are fixed, so that images do not depend on the machine.

References
----------
Lane, B. (2002). Models of plant communities for image synthesis. MSc thesis, University of Calgary, chapter 6.
Deussen, O. et al. (1998). Realistic modeling and rendering of plant ecosystems. SIGGRAPH 1998, 275-286, section 5.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population, Status
from forestgen.core.errors import RecipeError
from forestgen.core.randomness import child_rng, child_seed
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.species import Species
from forestgen.recipe.suggestions import did_you_mean
from forestgen.scene.exemplar_plan import OF_EXEMPLARS, SIZE_STEP, ExemplarPlan, cluster, rung_of, rungs_of
from forestgen.scene.lying import dead_codes_of
from forestgen.scene.tree_exemplars import (
    LibraryTree,
    instance_dbh_m,
    instance_scales,
    plan_library_trees,
    plan_trees,
    tree_sizes_of,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


TRAIT_WEIGHT = 0.5  # of a trait against the radius
LEAST_SPREAD = 0.1  # standard deviation of the radius' logarithm at least, where traits are weighed against it
SLENDERNESS_STEP = 1.15  # of the scale of the heights' allometry, which a recipe may draw for each image
LEAST_PIXELS = 24.0  # height of a unique plant in the image that shows it largest
MOST_TRIANGLES = 10_000_000  # of all unique plants
_WEIGHTS = {"height_m": 1.0, "radius_m": 0.7, "modules": 0.5, "trunk_diameter_m": 0.5}
_LEAST = 1e-3  # metres, below which a size's logarithm tells nothing
_OWN_TRAITS = ("age_yr", "height_m")  # columns that every population has, beside the radius


@dataclass(frozen=True)
class SizeError:
    """How far the exemplars' proportions are from the plants' own. Heights are exact: instances are scaled."""

    species: str
    plants: int
    exemplars: int
    radius_rms: float | None  # root mean square of (exemplar radius / plant radius - 1); None: trees, built to sizes
    crown_width_rms: float | None  # of (scaled exemplar's crown width / allometric width - 1); None without a crown
    dbh_rms: float | None = None  # of (scaled exemplar's diameter / tree's - 1); None: no trees


def check_traits(traits: Sequence[str], population: Population, where: str) -> None:
    """Refuse a trait that is no numeric column of the population.

    Raises `RecipeError`: with the columns that there are.
    """
    numeric = (
        name for name, one in population.columns.items() if one.ndim == 1 and np.issubdtype(one.dtype, np.number)
    )
    known = [*_OWN_TRAITS, *numeric]
    for trait in traits:
        if trait not in known:
            problem, hint = "the plants have no such trait", did_you_mean(trait, known)
            raise RecipeError(problem, where=where, expected="one of " + ", ".join(known), got=repr(trait), hint=hint)


def plan_exemplars(
    population: Population,
    per_species: int,
    seed: int,
    *,
    traits: Sequence[str] = (),
    variants: int = 1,
    given: Mapping[int, ExemplarPlan] | None = None,
    library: int | None = None,
    library_tree: LibraryTree | None = None,
) -> ExemplarPlan:
    """Cluster each species' plants into at most `per_species` sizes; species without plants get none.

    Parameters
    ----------
    traits : columns of the population that count beside the radius, see `check_traits`.
    variants : exemplars of each size. A plant's is its own, whatever else grows.
    given : plans of species that have one, by their index, see `plan_own`; `exemplar_of_plant` of those
        has a species' plants alone.
    library : variants of each size that all images share, instead of clusters; `variants` of these are shown.
    library_tree : of these, the sizes of a species' tree by its rung of height and its variant.
    """
    columns = [
        np.asarray(getattr(population, trait) if trait in _OWN_TRAITS else population.columns[trait], dtype=np.float64)
        for trait in traits
    ]
    sizes, radius_m, dead = tree_sizes_of(population), population.radius_m, dead_codes_of(population)
    own = np.array([child_seed(seed, "variant", int(i)) % variants for i in population.plant_id], dtype=np.int64)
    parts: list[ExemplarPlan] = []
    for index, name in enumerate(population.species_names):
        rows = np.flatnonzero(population.species == index)
        if not len(rows):
            continue
        if given is not None and index in given:
            part = given[index]
        elif library is not None and library_tree is not None and np.isfinite(sizes[rows, 0]).all():
            shown_of = library, variants
            part = plan_library_trees(index, name, sizes[rows], dead[rows], per_species, seed, shown_of, library_tree)
        elif np.isfinite(sizes[rows, 0]).all():
            own_traits = _features(radius_m[rows], [column[rows] for column in columns])[:, 1:]
            trees = sizes[rows], radius_m[rows], own_traits
            part = plan_trees(index, *trees, dead[rows], per_species, child_seed(seed, "k-means", name))
            part = part.split("variant", own[rows])
        elif library is not None:
            rungs, label = np.unique(rungs_of(population.radius_m[rows], per_species), return_inverse=True)
            # By rung, the variants of a size that the image has, of as many as the library has.
            shown = np.array([child_rng(seed, "library", name, int(rung)).permutation(library) for rung in rungs])
            radius = SIZE_STEP ** rungs.astype(np.float64)
            part = ExemplarPlan.of_species(index, radius, label.reshape(-1), rank=rungs)
            part = part.split("variant", shown[label.reshape(-1), own[rows]])
        else:
            features = _features(population.radius_m[rows], [column[rows] for column in columns])
            centres, labels = cluster(features, per_species, child_seed(seed, "k-means", name))
            part = ExemplarPlan.of_species(index, np.exp(centres[:, 0]), labels).split("variant", own[rows])
        parts.append(part)
    return _joined(parts, population.species)


def _joined(parts: Sequence[ExemplarPlan], species: NDArray[np.uint16]) -> ExemplarPlan:
    """One plan of each species' own, which are in the order of the species."""
    assignment = np.zeros(len(species), dtype=np.uint32)
    before = 0
    for part in parts:
        assignment[species == part.species[0]] = before + part.exemplar_of_plant
        before += len(part)
    none = ExemplarPlan.of_species(0, np.zeros(0), assignment)
    columns = {name: np.concatenate([getattr(part, name) for part in (none, *parts)]) for name in OF_EXEMPLARS}
    return ExemplarPlan(**columns, exemplar_of_plant=assignment)


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


def size_errors(
    population: Population,
    plan: ExemplarPlan,
    exemplar_height_m: NDArray[np.float64],
    exemplar_width_m: NDArray[np.float64],
    plant_width_m: NDArray[np.float64],
) -> list[SizeError]:
    """Error of the approximation for each species that has plants: of those that live.

    `exemplar_height_m`, `exemplar_width_m`: (E,) measured on the geometry. `plant_width_m`: (N,) crown width that each
    plant should have by its species' allometry; NaN where it has no crown.
    """
    errors, sizes, lives = [], tree_sizes_of(population), dead_codes_of(population) == 0

    def rms(ratio: Floats) -> float:
        return float(np.sqrt(np.mean((ratio - 1.0) ** 2)))

    for index, name in enumerate(population.species_names):
        rows = population.species == index
        if not rows.any():
            continue
        mine = plan.exemplar_of_plant[rows]
        built = np.where(np.isnan(plan.tree[:, 1]), exemplar_width_m, plan.tree[:, 1])  # in leaf
        across = instance_scales(sizes[rows], population.height_m[rows], mine, exemplar_height_m, plan.tree)[1]
        width = built[mine] * across / plant_width_m[rows]
        dbh_m = instance_dbh_m(population.height_m[rows], mine, across, plan.tree)
        trees = np.isfinite(sizes[rows, 0]) & (plan.plant[mine] < 0)
        crowned = lives[rows]
        thick = crowned & trees & np.isfinite(sizes[rows, 2]) & np.isfinite(plan.tree[mine, 2])
        no_crown = np.isnan(plant_width_m[rows]).any() or not crowned.any()
        errors.append(
            SizeError(
                species=name,
                plants=int(rows.sum()),
                exemplars=len(np.unique(mine)),
                radius_rms=None if trees.any() else rms(plan.radius_m[mine] / population.radius_m[rows]),
                crown_width_rms=None if no_crown else rms(width[crowned]),
                dbh_rms=rms((dbh_m / sizes[rows, 2])[thick]) if thick.any() else None,
            )
        )
    return errors


def modelled_species(drawn: DrawnRecipe, name: str) -> Species:
    """The species as its exemplars grow: with a library, its heights' scale is on a ladder too.

    A recipe may draw `height_m` for each image; without the ladder no two images would ask for the same plant.
    """
    species = drawn.species[name]
    if drawn.recipe.plants.library is None:
        return species
    law = species.allometry.height_m
    scale = SLENDERNESS_STEP ** rung_of(law.scale, SLENDERNESS_STEP)
    allometry = species.allometry.model_copy(update={"height_m": law.model_copy(update={"scale": scale})})
    return species.model_copy(update={"allometry": allometry})


def origin_of(drawn: DrawnRecipe, name: str, rank: int, variant: int) -> tuple[int, tuple[str | int, ...]]:
    """Root seed and identity of an exemplar's randomness."""
    if drawn.recipe.plants.library is None:
        return drawn.image_seed, ("exemplar", name, rank, variant) if variant else ("exemplar", name, rank)
    slenderness = rung_of(drawn.species[name].allometry.height_m.scale, SLENDERNESS_STEP)
    return drawn.recipe.seed, ("library", drawn.split, name, slenderness, rank, variant)


def unique_plants(
    population: Population, species: Bools, pixel_m: Floats, triangles: Callable[[], Floats], wanted: str | int
) -> Bools:
    """(N,) which plants are meshed as themselves.

    Parameters
    ----------
    species : (N,) plants of species that are clothed by modules.
    pixel_m : (N,) what a pixel covers of each plant, see `scene.growth.pixel_size_m`.
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

    `index`: of the species. `is_unique`: (N,) see `unique_plants`. `per_species`: exemplars of the plants that are not
    unique, at most; of the dead among them as many again.
    """
    rows = np.flatnonzero(population.species == index)
    unique, others = rows[is_unique[rows]], rows[~is_unique[rows]]
    dead = population.status[others] == Status.DEAD
    plant, of_plant = unique, np.empty(len(rows), dtype=np.uint32)
    of_plant[is_unique[rows]] = np.arange(len(unique))
    for those, key in ((~dead, "own"), (dead, "dead")):
        stand_in, label = _stand_ins(population, others[those], per_species, child_seed(seed, "k-means", key, index))
        of_plant[np.flatnonzero(~is_unique[rows])[those]] = len(plant) + label
        plant = np.concatenate([plant, stand_in])
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
