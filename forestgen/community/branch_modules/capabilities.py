"""What models of branch modules offer besides a community: checks of whole recipes, obstacles, own branches."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Mapping, Sequence

from forestgen.architecture.plant_type import PlantType
from forestgen.architecture.prototypes import load_prototypes
from forestgen.architecture.tables import Tables, tables_of
from forestgen.community.branch_modules.changes import check_changes, parameters_at
from forestgen.community.branch_modules.parameters import BranchModulesParameters
from forestgen.community.branch_modules.traits import STAND_IN
from forestgen.community.ecology import SpeciesEcology
from forestgen.community.obstacles import Obstacle
from forestgen.community.population import Population
from forestgen.core.errors import RecipeError, ResourceError
from forestgen.plants.registry import is_built
from forestgen.recipe.load import DrawnRecipe


class ModuleCapabilities:
    """`PlanChecks`, `HasObstacles` and `OwnSkeletons` of `community.capabilities`."""

    def check_recipe(self, drawn: DrawnRecipe, parameters: BranchModulesParameters) -> None:
        """Refuse species, plantings and changes that the recipe's species cannot have."""
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
        _check_prototypes(drawn, types, names)
        stands = {one.species for one in parameters.obstacles}
        for name, one in drawn.species.items():
            if one.modules is None and name not in stands and not is_built(one.plant.generator):
                raise without_modules(name, drawn.where("species", name))
        _check_plantings(drawn, parameters, types)
        check_changes(parameters, types, names, drawn.parse, lambda *keys: drawn.where("community", *keys))

    def obstacles(self, parameters: BranchModulesParameters) -> tuple[Obstacle, ...]:
        """The buildings of the recipe."""
        return parameters.obstacles

    def skeleton_tables(
        self, parameters: BranchModulesParameters, species: Sequence[SpeciesEcology], population: Population
    ) -> Tables:
        """Prototypes and plant types, with the changes up to the population's time."""
        types = {one.name: one.modules for one in species if one.modules is not None}
        parameters, types = parameters_at(parameters, types, population.step)
        of_species = [types.get(name, STAND_IN) for name in population.species_names]
        return tables_of(load_prototypes(), of_species, sphere_scale=parameters.sphere_scale)

    def check_foliage(self, drawn: DrawnRecipe, parameters: BranchModulesParameters, species: Collection[str]) -> None:
        """Refuse standing dead trees of species that are not drawn by their own branches: they would bear leaves."""
        if parameters.standing_dead_yr == 0:
            return
        for name, one in drawn.species.items():
            if one.modules is not None and name not in species:
                raise RecipeError(
                    f"dead trees of {name} cannot be drawn",
                    where=drawn.where("species", name),
                    expected="a section modules_plant, by which its own branches are drawn",
                    got="none",
                    hint="add modules_plant: {generator: branch_modules, ...}, or set community.standing_dead_yr: 0",
                )

    def keeps_skeletons(self, parameters: BranchModulesParameters) -> bool:
        """By the recipe's history_modules."""
        return parameters.history_modules


def without_modules(name: str, where: str) -> RecipeError:
    """The error of a species that neither grows by modules nor stands as an obstacle."""
    return RecipeError(
        f"{name} does not grow by branch modules",
        where=where,
        expected="a section `modules` with life_span_yr, root_vigour_max, growth_rate_per_yr and so on",
        got="none",
        hint="take a species that has one, such as those of scenes/species with `modules:`; or another community.model",
    )


def _check_prototypes(drawn: DrawnRecipe, types: Mapping[str, PlantType], names: Sequence[str]) -> None:
    """Species name prototypes that there are."""
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
