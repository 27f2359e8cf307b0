"""Branch modules: what only a whole recipe can tell to be wrong, and the obstacles for the scene."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from forestgen.architecture.plant_type import PlantType
from forestgen.architecture.prototypes import load_prototypes
from forestgen.community.branch_modules.changes import check_changes
from forestgen.community.branch_modules.parameters import BranchModulesParameters, Obstacle
from forestgen.community.model import CommunityParameters
from forestgen.community.obstacles import NO_OBSTACLES, Obstacles, Outline
from forestgen.community.population import Population
from forestgen.core.errors import RecipeError, ResourceError
from forestgen.plants.build import built
from forestgen.plants.exemplar import Exemplar
from forestgen.plants.parameters import PlantParameters
from forestgen.plants.registry import GENERATORS
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.species import Species
from forestgen.stages.views import check_outside_of_houses


def check_branch_modules(drawn: DrawnRecipe, parameters: CommunityParameters) -> None:
    """Refuse plants at the start, obstacles and changes that the recipe's species and site cannot have.

    Raises
    ------
    RecipeError, ResourceError : with the line of the key.
    """
    if not isinstance(parameters, BranchModulesParameters):
        return
    types = {name: one.modules for name, one in drawn.species.items() if one.modules is not None}
    for name in parameters.counted_species():
        if name not in types:
            raise RecipeError(
                f"{name} does not grow by branch modules",
                where=drawn.where("community", "initial_plants", name),
                expected="one of " + (", ".join(types) or "none: no species has a section modules"),
                got=name,
            )
    names = [prototype.name for prototype in load_prototypes()]
    for name, kind in types.items():
        for index, wanted in enumerate(kind.prototypes):
            if wanted not in names:
                near = difflib.get_close_matches(wanted, names, n=1)
                raise RecipeError(
                    "no such prototype of a module",
                    where=drawn.where("species", name, "modules", "prototypes", index),
                    expected="one of " + ", ".join(names),
                    got=wanted,
                    hint=f"did you mean {near[0]!r}?" if near else None,
                )
    for index, one in enumerate(parameters.obstacles):
        _check_obstacle(drawn, index, one)
    _check_all_grow(drawn, parameters)
    notes_on_houses(drawn, parameters)
    _check_plantings(drawn, parameters, types)
    check_changes(parameters, types, names, drawn.parse, lambda *keys: drawn.where("community", *keys))


def notes_on_houses(drawn: DrawnRecipe, parameters: CommunityParameters) -> list[str]:
    """Notes on cameras inside of the community's houses; refused where an entry's `obstructed` is an error.

    Raises
    ------
    RecipeError : with the camera's line.
    """
    if not isinstance(parameters, BranchModulesParameters):
        return []
    return check_outside_of_houses(drawn, parameters.obstacles)


def _check_all_grow(drawn: DrawnRecipe, parameters: BranchModulesParameters) -> None:
    """Every species grows by branch modules, or is that of an obstacle."""
    stands = {one.species for one in parameters.obstacles}
    for name, one in drawn.species.items():
        if one.modules is not None or name in stands:
            continue
        if is_built(one):
            raise RecipeError(
                f"{name} is no plant, and none stands anywhere",
                where=drawn.where("species", name),
                expected="an obstacle of this species, or no such species",
                got="no obstacle" if not parameters.obstacles else "obstacles of " + ", ".join(sorted(stands)),
                hint=f"community.obstacles: [{{species: {name}, position_m: [...]}}], or leave {name} out",
            )
        raise RecipeError(
            f"{name} does not grow by branch modules",
            where=drawn.where("species", name),
            expected="a section `modules` with life_span_yr, root_vigour_max, growth_rate_per_yr and so on",
            got="none",
            hint="take a species that has one, such as those of scenes/species with `modules:`; or another "
            "community.model",
        )


def _check_plantings(drawn: DrawnRecipe, parameters: BranchModulesParameters, types: Mapping[str, PlantType]) -> None:
    """Plantings are of species that grow, and not of more plants than there may be modules; each begins as one."""
    for index, one in enumerate(parameters.disturbances):
        if one.plant is not None and one.plant.number > parameters.most_modules:
            key = "count" if one.plant.positions_m is None else "positions_m"
            raise ResourceError(
                "more plants than there may be branch modules",
                where=drawn.where("community", "disturbances", index, "plant", key),
                expected=f"at most community.most_modules = {parameters.most_modules:,}",
                got=f"{one.plant.number:,}",
                hint="plant fewer, or raise most_modules",
            )
        if one.plant is not None and one.plant.species not in types:
            raise RecipeError(
                "this species does not grow by branch modules",
                where=drawn.where("community", "disturbances", index, "plant", "species"),
                expected="one of " + (", ".join(types) or "none: no species has a section modules"),
                got=one.plant.species,
            )


def check_dead_are_drawn(
    drawn: DrawnRecipe, parameters: CommunityParameters, clothing: Mapping[str, PlantParameters]
) -> None:
    """Refuse standing dead trees of species whose plants are not drawn by their own branches: they would bear leaves.

    Raises
    ------
    RecipeError : with the line of the species.
    """
    if not isinstance(parameters, BranchModulesParameters) or parameters.standing_dead_yr == 0:
        return
    for name, one in drawn.species.items():
        if one.modules is not None and name not in clothing:
            raise RecipeError(
                f"dead trees of {name} cannot be drawn",
                where=drawn.where("species", name),
                expected="a section modules_plant, by which its own branches are drawn",
                got="none",
                hint="add modules_plant: {generator: branch_modules, ...}, or set community.standing_dead_yr: 0",
            )


def _check_obstacle(drawn: DrawnRecipe, index: int, obstacle: Obstacle) -> None:
    """A species that is built, and a ground plan on the site."""
    keys = ("community", "obstacles", index)
    if not is_built(drawn.species[obstacle.species]):
        buildings = [name for name, one in drawn.species.items() if is_built(one)]
        raise RecipeError(
            "this species is a plant, and no obstacle",
            where=drawn.where(*keys, "species"),
            expected="one of " + (", ".join(buildings) or "the recipe's species with plant.generator: house"),
            got=obstacle.species,
            hint="species: {house: }" if not buildings else None,
        )
    width, depth = drawn.recipe.site.size_m
    corners = obstacle.corners_m()
    if np.any(corners < 0) or np.any(corners > (width, depth)):
        x, y = obstacle.position_m
        raise RecipeError(
            "this obstacle does not lie on the site",
            where=drawn.where(*keys, "position_m"),
            expected=f"all of its ground plan within x from 0 to {width:g} and y from 0 to {depth:g} metres",
            got=f"[{x:g}, {y:g}], from [{_point(corners.min(axis=0))}] to [{_point(corners.max(axis=0))}]",
        )


def is_built(species: Species) -> bool:
    """Whether a species is no plant but a building, of the size that an obstacle gives it."""
    generator = species.plant.generator
    return generator in GENERATORS and hasattr(GENERATORS.load(generator), "build")


def _point(xy_m: np.ndarray[tuple[int], np.dtype[np.float64]]) -> str:
    return ", ".join(f"{one:.1f}" for one in xy_m)


def obstacles_of(parameters: CommunityParameters, population: Population) -> dict[int, Obstacle]:
    """Row of the population -> the obstacle that stands there; the community numbers them first, in their order."""
    if not isinstance(parameters, BranchModulesParameters):
        return {}
    rows = np.searchsorted(population.plant_id, np.arange(1, len(parameters.obstacles) + 1))
    return {int(row): one for row, one in zip(rows, parameters.obstacles, strict=True)}


def ground_plans(parameters: CommunityParameters, species: Mapping[str, Species]) -> Obstacles:
    """The obstacles of a recipe as a map shows them."""
    if not isinstance(parameters, BranchModulesParameters):
        return NO_OBSTACLES
    outlines = tuple(Outline(one.species, one.corners_m()) for one in parameters.obstacles)
    return Obstacles(outlines, frozenset(name for name, one in species.items() if is_built(one)))


def turned_obstacles(parameters: CommunityParameters, population: Population) -> Population:
    """The population with its obstacles' azimuths in the column `azimuth_deg`, which the scene places plants by."""
    obstacles = obstacles_of(parameters, population)
    if not obstacles:
        return population
    azimuth_deg = population.columns.get("azimuth_deg", np.full(len(population), np.nan)).astype(np.float64)
    for row, one in obstacles.items():
        azimuth_deg[row] = one.azimuth_deg
    return replace(population, columns={**population.columns, "azimuth_deg": azimuth_deg})


def obstacle_exemplar(
    obstacle: Obstacle, species: Mapping[str, Species], generators: Mapping[str, PlantParameters]
) -> Exemplar:
    """The geometry of an obstacle at its own size; it is to stand turned by its azimuth, and not scaled."""
    name = obstacle.species
    radius_m = 0.5 * float(np.hypot(*obstacle.size_m[:2]))
    return built(name, species[name], generators[name], obstacle.size_m, radius_m)
