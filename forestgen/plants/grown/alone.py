"""A plant of branch modules without a community of such: the branches that it grows among plants like itself.

It grows as in community model branch_modules, in the climate that it likes best, on a torus as wide as the crown that
its species' allometry gives it: its neighbours are its own copies, so it has the form of a tree in a closed stand. Its
wood is taken when it is as high as the allometry has it, and scaled to that height. A plant that never becomes so high
is shown at its greatest. Its crown is as wide as it grew.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from forestgen.community.ecology import ecology_of
from forestgen.community.model import Site, simulate
from forestgen.community.models.branch_modules import MODEL
from forestgen.community.population import Population
from forestgen.plants.grown.wood import ModuleWood, woods_of
from forestgen.recipe.species import Species

_LEAST_SIDE_M = 1.0  # of the torus: modules of seedlings would fill a smaller one
_NO_TALLER_YR = 60  # after which a plant that has not become taller is as tall as it gets


def wood_alone(species_name: str, species: Species, size_m: tuple[float, float], seed: int) -> ModuleWood:
    """The wood of a plant of a height and width, metres; another seed is another plant."""
    assert species.modules is not None  # see plants.plan
    lone = replace(ecology_of(species_name, species), modules=species.modules.model_copy(update={"seeds_per_yr": 0.0}))
    parameters = MODEL.Parameters.model_validate({"initial_plants": 1, "steps": 100_000, "periodic": True})
    height_m, side_m = size_m[0], max(size_m[1], _LEAST_SIDE_M)
    best: Population | None = None
    for population in simulate(MODEL, parameters, Site((side_m, side_m)), [lone], seed, steps=parameters.steps):
        if not len(population):
            break
        if best is None or population.height_m[0] > best.height_m[0]:
            best = population
        if best.height_m[0] >= height_m or population.step - best.step >= _NO_TALLER_YR:
            break
    assert best is not None  # it stands in step 0
    [wood] = woods_of(best, MODEL.skeleton_tables(parameters, [lone], best), np.array([0]))
    scale = height_m / max(wood.height_m, 0.01)
    return replace(wood, position_m=wood.position_m * scale, diameter_m=wood.diameter_m * scale)
