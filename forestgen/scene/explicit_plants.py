"""Plants that grew branches of their own: which are meshed as themselves, from what, and how their dead look.

The dead stand with the branches that they died with, bare, of grey weathered wood: a species' material `dead_wood`, or
that of the shipped snag. Leaves, flowers and fruits are gone; twigs go with the years, see plants/grown/twigs.py. Fresh
snags are as grey as old ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.tables import Tables
from forestgen.community.capabilities import OwnSkeletons, capability
from forestgen.community.population import Population, Status
from forestgen.core.randomness import child_rng
from forestgen.plants.bark.texture import with_bark_tiles
from forestgen.plants.cache import ExemplarRequest
from forestgen.plants.grown.build import estimate_triangles
from forestgen.plants.grown.wood import woods_of
from forestgen.plants.levels import level_of_index
from forestgen.plants.parameters import PlantParameters
from forestgen.recipe.species import Material, Species
from forestgen.scene.exemplar_plan import ExemplarPlan
from forestgen.scene.own_exemplars import plan_own, unique_plants
from forestgen.scene.plan import Plan, check_own_triangles

Floats = NDArray[np.float64]

MATERIAL = "dead_wood"
_WEATHERED = Material.model_validate(
    {
        "spectrum": "wood/snag",
        "roughness": 0.9,
        "bark": {"pattern": "fibrous", "tile_m": [0.3, 0.6], "dark": [0.05, 0.045, 0.04], "lichen": 0.06},
    }
)


def with_dead_wood(species: Species) -> Species:
    """The species with a material for its dead trees."""
    if MATERIAL in species.materials:
        return species
    return species.model_copy(update={"materials": {**species.materials, MATERIAL: _WEATHERED}})


def species_seen(species: Mapping[str, Species], population: Population) -> dict[str, Species]:
    """The species, those with dead trees among their plants with a material for them."""
    dead = np.unique(population.species[population.status == Status.DEAD])
    names = {population.species_names[index] for index in dead.tolist()}
    return {name: with_dead_wood(one) if name in names else one for name, one in species.items()}


def dead_clothing(parameters: PlantParameters, species: Species) -> PlantParameters:
    """What clothes the wood of a dead tree, of a species that has dead wood."""
    wood = parameters.wood.model_copy(update={"material": MATERIAL, "branch_material": None, "dead": True})
    return with_bark_tiles(parameters.model_copy(update={"wood": wood, "foliage": ()}), species.materials)


def has_own(plan: Plan, population: Population) -> bool:
    """Whether some plants have modules that their species clothes, or are no plants but obstacles."""
    return bool(plan.community.obstacles.entries or _own(plan, population).any())


def plan_own_plants(plan: Plan, population: Population, pixel_m: Floats) -> dict[int, ExemplarPlan]:
    """Plans of the species that are clothed by modules, and of obstacles, by their index in the population.

    Parameters
    ----------
    pixel_m : (N,) what a pixel covers of each plant where it is seen largest.

    Raises
    ------
    ResourceError : the recipe asks for more plants as themselves than the memory holds.
    """
    own = _own(plan, population)
    built = _plan_obstacles(plan, population)
    if not own.any():
        return built
    section, seed = plan.drawn.recipe.plants, plan.drawn.image_seed
    triangles = cache(lambda: _triangles(plan, population, own))
    is_unique = unique_plants(population, own, pixel_m, triangles, section.unique)
    if section.unique != "auto" and is_unique.any():  # auto keeps to a number of triangles
        check_own_triangles(plan, float(triangles()[is_unique].sum()))
    return built | {
        int(index): plan_own(population, int(index), is_unique, section.exemplars_per_species, seed)
        for index in np.unique(population.species[own])
    }


def _plan_obstacles(plan: Plan, population: Population) -> dict[int, ExemplarPlan]:
    """One exemplar for each size of the obstacles of a species."""
    obstacles = plan.community.obstacles.rows_of(population)
    plans = {}
    for index in np.unique(population.species[list(obstacles)]) if obstacles else ():
        rows = np.flatnonzero(population.species == index)
        sizes = np.array([obstacles[int(row)].size_m for row in rows])
        _, first, label = np.unique(sizes, axis=0, return_index=True, return_inverse=True)
        plans[int(index)] = ExemplarPlan(
            species=np.full(len(first), index, dtype=np.uint16),
            radius_m=population.radius_m[rows[first]],
            rank=np.arange(len(first)),
            variant=np.zeros(len(first), dtype=np.int64),
            level=np.zeros(len(first), dtype=np.int64),
            exemplar_of_plant=label.reshape(-1).astype(np.uint32),
            plant=rows[first],
            is_unique=np.zeros(len(first), dtype=np.bool_),
        )
    return plans


def own_requests(plan: Plan, exemplar_plan: ExemplarPlan, population: Population) -> dict[int, ExemplarRequest]:
    """What to grow of the exemplars that have a plant's own branches, by their index.

    A plant's randomness belongs to the plant: its twigs are the same in every image.
    """
    chosen = np.flatnonzero(exemplar_plan.plant >= 0)
    if not len(chosen):
        return {}
    obstacles = plan.community.obstacles.rows_of(population)
    rows = np.setdiff1d(exemplar_plan.plant[chosen], list(obstacles))
    grown = woods_of(population, tables_at(plan, population), rows) if len(rows) else []
    woods = dict(zip(rows.tolist(), grown, strict=True))
    names = population.species_names
    requests = {}
    for index in chosen.tolist():
        row = int(exemplar_plan.plant[index])
        name = names[population.species[row]]
        box_m = obstacles[row].size_m if row in obstacles else None
        species = plan.drawn.species[name]
        parameters = plan.plants.generators[name] if box_m else plan.plants.foliage[name]
        if population.status[row] == Status.DEAD:
            species = with_dead_wood(species)
            parameters = dead_clothing(parameters, species)
        requests[index] = ExemplarRequest(
            species_name=name,
            species=species,
            parameters=parameters,
            radius_m=float(population.radius_m[row]),
            seed=plan.drawn.image_seed,
            identity=("own", int(population.plant_id[row])),
            level=level_of_index(int(exemplar_plan.level[index])),
            wood=woods.get(row),
            box_m=box_m,
            is_kept=not bool(exemplar_plan.is_unique[index]),
        )
    return requests


def tables_at(plan: Plan, population: Population) -> Tables:
    """Shapes and sizes of a population's modules at its time."""
    skeletons = capability(plan.community.model, OwnSkeletons)
    assert skeletons is not None  # the population has modules
    return skeletons.skeleton_tables(plan.community.parameters, plan.community.ecologies, population)


def _own(plan: Plan, population: Population) -> NDArray[np.bool_]:
    """(N,) plants of species that are clothed by modules, and have some."""
    if population.modules is None:
        return np.zeros(len(population), dtype=np.bool_)
    clothed = np.array([name in plan.plants.foliage for name in population.species_names], dtype=np.bool_)
    return np.asarray(clothed[population.species] & (np.diff(population.modules.first) > 0), dtype=np.bool_)


def _triangles(plan: Plan, population: Population, own: NDArray[np.bool_]) -> Floats:
    """(N,) of each plant, estimated by its modules, from a large plant of its species that lives or is dead as it."""
    assert population.modules is not None
    modules = np.diff(population.modules.first)
    estimate = np.zeros(len(population))
    tables = tables_at(plan, population)
    dead = population.status == Status.DEAD
    for index, is_dead in product(np.unique(population.species[own]), (False, True)):
        rows = np.flatnonzero(own & (population.species == index) & (dead == is_dead))
        if not len(rows):
            continue
        largest = rows[np.argmax(modules[rows])]
        parameters: Any = plan.plants.foliage[population.species_names[index]]
        if is_dead:
            parameters = parameters.model_copy(update={"foliage": ()})
        [wood] = woods_of(population, tables, np.array([largest]))
        rng = child_rng(plan.drawn.image_seed, "triangles", int(population.plant_id[largest]))
        estimate[rows] = estimate_triangles(parameters, wood, rng) * modules[rows] / modules[largest]
    return estimate
