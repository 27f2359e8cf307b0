"""A plant of branch modules, meshed as itself."""

from __future__ import annotations

import numpy as np

from forestgen.plants.build import finished
from forestgen.plants.exemplar import Exemplar
from forestgen.plants.generators.branch_modules import Parameters
from forestgen.plants.grown.twigs import clothed
from forestgen.plants.grown.wood import ModuleWood
from forestgen.plants.levels import FULL, Level
from forestgen.recipe.species import Species

_TRIANGLES_PER_NODE = 10  # of wood: twigs have three to five sides, stems more


def build_grown(
    species_name: str,
    species: Species,
    parameters: Parameters,
    wood: ModuleWood,
    radius_m: float,
    rng: np.random.Generator,
    *,
    level: Level = FULL,
) -> Exemplar:
    """Clothe and mesh the wood of one plant, whose height is its highest module's.

    Parameters
    ----------
    radius_m : community radius.
    level : how much detail; the plant is the same one at every level.

    Raises
    ------
    RecipeError : a plant too large for memory, or a material that the species does not have.
    """
    clothing_rng, level_rng = rng.spawn(2)
    height_m = max(wood.height_m, 0.01)
    skeleton = clothed(parameters, wood, height_m, clothing_rng)
    width_m = float(np.ptp(wood.position_m[:, :2], axis=0).max())
    return finished(species_name, species, parameters, skeleton, (radius_m, height_m, width_m), level_rng, level=level)


def estimate_triangles(parameters: Parameters, wood: ModuleWood, rng: np.random.Generator) -> int:
    """About how many triangles the plant will have, without meshing it."""
    skeleton = clothed(parameters, wood, max(wood.height_m, 0.01), rng)
    leaves = sum(len(one.node) * parameters.shapes[one.shape].template().triangles for one in skeleton.organs)
    return int(leaves + _TRIANGLES_PER_NODE * len(skeleton.parent))
