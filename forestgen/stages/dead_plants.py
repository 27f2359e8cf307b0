"""How standing dead trees look: the branches that they died with, bare, of grey weathered wood.

The wood is a species' material `dead_wood`; of a species that has none, that of the shipped snag. Leaves, flowers and
fruits are gone; twigs go with the years, see plants/grown/twigs.py. Fresh snags are as grey as old ones.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from forestgen.community.population import Population, Status
from forestgen.plants.bark.texture import with_bark_tiles
from forestgen.plants.parameters import PlantParameters
from forestgen.recipe.species import Material, Species

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
