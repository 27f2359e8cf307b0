"""Which species of a recipe are clothed by branch modules, and how much room their plants may take."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from forestgen.core.errors import RecipeError
from forestgen.plants.parameters import PlantParameters
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.plants import Plants
from forestgen.recipe.species import Plant, Species
from forestgen.scene.own_exemplars import MOST_TRIANGLES

GENERATOR = "branch_modules"
MODELS = ("branch_modules", "ecoclimate")
_TRIANGLES_OF_A_PLANT = 300_000  # of a large one, at a guess

Parse = Callable[[DrawnRecipe, Species, Plant, tuple[str, ...]], PlantParameters]


def clothing_of(
    drawn: DrawnRecipe, generators: Mapping[str, PlantParameters], parse: Parse
) -> dict[str, PlantParameters]:
    """What clothes the modules of each species that has something of the kind; empty where the community grows none.

    Parameters
    ----------
    generators : parameters of the species' `plant` blocks.
    parse : checks a block against its generator's own keys.

    Raises
    ------
    RecipeError : a `modules_plant` of another generator; or a community without modules for species that need them.
    """
    found, grows = {}, drawn.recipe.community.model in MODELS
    for name, species in drawn.species.items():
        if species.modules_plant is not None:
            keys = ("species", name, "modules_plant")
            if species.modules_plant.generator != GENERATOR:
                where, got = drawn.where(*keys, "generator"), repr(species.modules_plant.generator)
                raise RecipeError("this generator clothes no modules", where=where, expected=GENERATOR, got=got)
            found[name] = parse(drawn, species, species.modules_plant, keys)
        elif species.plant.generator == GENERATOR:
            found[name] = generators[name]
            if not grows:
                raise RecipeError(
                    "plants of branch modules grow in a community of that model alone",
                    where=drawn.where("species", name, "plant", "generator"),
                    expected=f"community: {{model: {MODELS[0]}}}, or {', '.join(MODELS[1:])}",
                    got=drawn.recipe.community.model,
                    hint="give the species another generator under plant, and move this block to modules_plant",
                )
    return found if grows else {}


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
