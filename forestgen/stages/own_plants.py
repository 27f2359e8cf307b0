"""Plants with branches of their own: what clothes them, how much room they may take, and how their dead look.

The dead stand with the branches that they died with, bare, of grey weathered wood: a species' material `dead_wood`, or
that of the shipped snag. Leaves, flowers and fruits are gone; twigs go with the years, see plants/grown/twigs.py. Fresh
snags are as grey as old ones.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from forestgen.community.capabilities import OwnSkeletons, capability
from forestgen.community.population import Population, Status
from forestgen.core.errors import ErrorList, RecipeError
from forestgen.plants.bark.texture import with_bark_tiles
from forestgen.plants.parameters import PlantParameters
from forestgen.plants.registry import GENERATORS, clothes_modules
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.schema import Plants
from forestgen.recipe.sources import Keys
from forestgen.recipe.species import Material, Plant, Species
from forestgen.scene.own_exemplars import MOST_TRIANGLES

MATERIAL = "dead_wood"
_WEATHERED = Material.model_validate(
    {
        "spectrum": "wood/snag",
        "roughness": 0.9,
        "bark": {"pattern": "fibrous", "tile_m": [0.3, 0.6], "dark": [0.05, 0.045, 0.04], "lichen": 0.06},
    }
)
_TRIANGLES_OF_A_PLANT = 300_000  # of a large one, at a guess


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
        raise RecipeError(
            "the plant has no branches that could be drawn",
            where=drawn.where(*keys, "generator"),
            expected="a section `modules` of the species, by which its branches grow",
            got="none",
            hint="add modules, or choose another generator",
        )
    parameters: PlantParameters = drawn.parse(generator.Parameters, plant.parameters, keys)
    return with_bark_tiles(parameters, species.materials)


def clothing_of(
    drawn: DrawnRecipe, model: object, generators: Mapping[str, PlantParameters]
) -> dict[str, PlantParameters]:
    """What clothes the modules of each species that has something of the kind; empty where the community grows none.

    Parameters
    ----------
    model : the community model.
    generators : parameters of the species' `plant` blocks.

    Raises
    ------
    RecipeError : a `modules_plant` of another generator.
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


def own_triangles(clothing: Mapping[str, PlantParameters], section: Plants) -> int:
    """Triangles of plants with branches of their own and of those that stand for the far ones, before any has grown.

    The stand-ins of the standing dead, bare wood, are not counted.

    How many plants there will be, and how large, nobody knows yet: see `plan.check_own_triangles`.
    """
    if not clothing or section.unique == "none":
        unique = 0
    elif isinstance(section.unique, int):
        unique = min(section.unique * _TRIANGLES_OF_A_PLANT, MOST_TRIANGLES)
    else:
        unique = MOST_TRIANGLES
    return unique + len(clothing) * section.exemplars_per_species * _TRIANGLES_OF_A_PLANT


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
