"""What models of branch modules offer besides a community: checks of whole recipes, obstacles, own branches."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, TypeVar

from pydantic import BaseModel

from forestgen.architecture.prototypes import Tables, load_prototypes, tables_of
from forestgen.community.branch_modules.parameters import (
    BranchModulesParameters,
    changes_in_order,
    parameters_at,
    values_of,
)
from forestgen.community.branch_modules.state import STAND_IN, no_prototype
from forestgen.community.population import Population, SpeciesEcology
from forestgen.core.errors import RecipeError, ResourceError
from forestgen.plants.parameters import Lifeless
from forestgen.plants.registry import GENERATORS
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.species import PlantType

M = TypeVar("M", bound=BaseModel)


class ModuleCapabilities:
    """`PlanChecks`, `HasObstacles` and `OwnSkeletons` of `community.capabilities`."""

    has_obstacles = True

    def check_recipe(self, drawn: DrawnRecipe, parameters: BranchModulesParameters) -> None:
        """Refuse species, plantings and changes that the recipe's species cannot have."""
        types = {name: one.modules for name, one in drawn.species.items() if one.modules is not None}
        names = [prototype.name for prototype in load_prototypes()]
        for name, kind in types.items():
            for index, wanted in enumerate(kind.prototypes):
                if wanted not in names:
                    where = drawn.where("species", name, "modules", "prototypes", index)
                    raise no_prototype(wanted, names, where)
        for name, one in drawn.species.items():
            if one.modules is None:
                where = drawn.where("species", name)
                raise without_modules(name, where, GENERATORS.load(one.plant.generator))
        _check_plantings(drawn, parameters)
        check_changes(drawn, parameters, types, names)

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
                problem = f"dead trees of {name} cannot be drawn"
                expected = "a section modules_plant, by which its own branches are drawn"
                hint = "add modules_plant: {generator: branch_modules, ...}, or set community.standing_dead_yr: 0"
                raise RecipeError(problem, where=drawn.where("species", name), expected=expected, got="none", hint=hint)

    def keeps_skeletons(self, parameters: BranchModulesParameters) -> bool:
        """By the recipe's history_modules."""
        return parameters.history_modules


def without_modules(name: str, where: str, generator: object = None) -> RecipeError:
    """The error of a species that does not grow by modules; `generator` is that of its `plant`."""
    if isinstance(generator, Lifeless):
        problem, expected = f"{name} is no living plant", "species of living plants"
        return RecipeError(problem, where=where, expected=expected, got=name, hint=generator.instead)
    expected = "a section `modules` with life_span_yr, root_vigour_max, growth_rate_per_yr and so on"
    hint = "write one (scenes/species/fireweed.yaml has one of a herb); or another community.model"
    return RecipeError(f"{name} does not grow by branch modules", where=where, expected=expected, got="none", hint=hint)


def _check_plantings(drawn: DrawnRecipe, parameters: BranchModulesParameters) -> None:
    """Plantings are not of more plants than there may be modules; each begins as one."""
    for index, one in enumerate(parameters.disturbances):
        if one.plant is not None and one.plant.number > parameters.most_modules:
            key = "count" if one.plant.positions_m is None else "positions_m"
            problem = "more plants than there may be branch modules"
            where = drawn.where("community", "disturbances", index, "plant", key)
            expected = f"at most community.most_modules = {parameters.most_modules:,}"
            hint = "plant fewer, or raise most_modules"
            raise ResourceError(problem, where=where, expected=expected, got=f"{one.plant.number:,}", hint=hint)


def _not_growing(name: str, growing: Collection[str], where: str) -> RecipeError:
    """The error of a species that is named among those that grow by branch modules."""
    expected = "one of " + (", ".join(growing) or "none: no species has a section modules")
    return RecipeError(f"{name} does not grow by branch modules", where=where, expected=expected, got=name)


def check_changes(
    drawn: DrawnRecipe, parameters: BranchModulesParameters, types: Mapping[str, PlantType], prototypes: Sequence[str]
) -> None:
    """Refuse, before anything is simulated, changes that could not be made.

    Errors are worded as if the value stood in the recipe itself, at the change's place.
    """
    changed, kinds = parameters, dict(types)
    for index, one in changes_in_order(parameters):
        place = ("community", "changes", index, "set")
        own, of_species = one.split()
        if own:
            places = {key: drawn.where(*place, key) for key in own}
            changed = _parsed(drawn, type(parameters), {**values_of(changed), **own}, places)
            for keys, name in changed.named_species():
                if keys[0] in own and name not in kinds:
                    raise _not_growing(name, kinds, places[str(keys[0])])
        for name, values in of_species.items():
            places = {key: drawn.where(*place, f"species.{name}.{key}") for key in values}
            if name not in kinds:
                raise _not_growing(name, kinds, next(iter(places.values())))
            kinds[name] = _parsed(drawn, PlantType, {**values_of(kinds[name]), **values}, places)
            unknown = [one for one in kinds[name].prototypes if one not in prototypes]
            if "prototypes" in values and unknown:
                raise no_prototype(unknown[0], prototypes, places["prototypes"])


def _parsed(drawn: DrawnRecipe, model: type[M], data: dict[str, Any], places: Mapping[str, str]) -> M:
    """The model of the values; an error names the place of the new value that caused it."""
    try:
        return drawn.parse(model, data, ())
    except RecipeError as cause:
        # The parser names the key in the recipe's own section, whose value may be right.
        own = [place for key, place in places.items() if (cause.where or "").endswith(key)]
        problem, where = cause.problem, (own or list(places.values()))[0]
        raise RecipeError(problem, where=where, expected=cause.expected, got=cause.got, hint=cause.hint) from cause
