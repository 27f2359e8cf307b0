"""What a recipe's plants are grown from: the checked parameters of their generators."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from forestgen.community.capabilities import OwnSkeletons, capability
from forestgen.core.errors import ErrorList, RecipeError
from forestgen.plants.bark.texture import with_bark_tiles
from forestgen.plants.parameters import PlantParameters
from forestgen.plants.registry import GENERATORS, clothes_modules
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.sources import Keys
from forestgen.recipe.species import Plant, Species


@dataclass(frozen=True)
class PlantPlan:
    """A drawn recipe's species with the parameters of their generators."""

    drawn: DrawnRecipe
    generators: Mapping[str, PlantParameters]  # of the species' `plant` blocks, by species
    foliage: Mapping[str, PlantParameters] = field(default_factory=dict)  # on modules of plants that grow such


def plan_plants(drawn: DrawnRecipe) -> PlantPlan:
    """The plan of single plants, without a community.

    Raises `RecipeError`, `RecipeErrors`: an unknown generator, or parameters that it rejects; with file, line and key.
    """
    errors = ErrorList(drawn.sources.place(()).origin)
    generators = generator_parameters(drawn, errors)
    errors.raise_all()
    return PlantPlan(drawn, generators)


def generator_parameters(drawn: DrawnRecipe, errors: ErrorList) -> dict[str, PlantParameters]:
    """Parameters of the generators of the species' `plant` blocks, of those without an error."""
    found = {}
    for name, species in drawn.species.items():
        parameters = errors.attempt(_parameters, drawn, species, species.plant, ("species", name, "plant"))
        if parameters is not None:
            found[name] = parameters
    return found


def _parameters(drawn: DrawnRecipe, species: Species, plant: Plant, keys: Keys) -> PlantParameters:
    generator = GENERATORS.load(plant.generator, where=drawn.where(*keys, "generator"))
    if clothes_modules(plant.generator) and species.modules is None:
        where, hint = drawn.where(*keys, "generator"), "add modules, or choose another generator"
        expected = "a section `modules` of the species, by which its branches grow"
        problem = "the plant has no branches that could be drawn"
        raise RecipeError(problem, where=where, expected=expected, got="none", hint=hint)
    parameters: PlantParameters = drawn.parse(generator.Parameters, plant.parameters, keys)
    if parameters.pointed is not None and (species.wood is None or species.wood.sweep is None):
        problem, hint = "the outline is about a stem with a sweep", "add wood: {sweep: {}}, or take `pointed` away"
        expected = "a `sweep` in the species' section `wood`"
        raise RecipeError(problem, where=drawn.where(*keys, "pointed"), expected=expected, got="none", hint=hint)
    if species.wood is not None:
        parameters = parameters.model_copy(update={"wood": parameters.wood.model_copy(update={"years": species.wood})})
    return with_bark_tiles(parameters, species.materials)


def foliage_of(
    drawn: DrawnRecipe, model: object, generators: Mapping[str, PlantParameters]
) -> dict[str, PlantParameters]:
    """What grows on the modules of each species that has something of the kind; empty where the model grows none.

    Raises `RecipeError`: a `modules_plant` of another generator.
    """
    found = {}
    for name, species in drawn.species.items():
        if species.modules_plant is not None:
            keys = ("species", name, "modules_plant")
            if not clothes_modules(species.modules_plant.generator):
                where, got = drawn.where(*keys, "generator"), repr(species.modules_plant.generator)
                expected = " or ".join(filter(clothes_modules, GENERATORS.ids()))
                raise RecipeError("this generator clothes no modules", where=where, expected=expected, got=got)
            found[name] = _parameters(drawn, species, species.modules_plant, keys)
        elif clothes_modules(species.plant.generator):
            found[name] = generators[name]
    return {} if capability(model, OwnSkeletons) is None else found
