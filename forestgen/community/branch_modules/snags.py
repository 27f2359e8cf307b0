"""Standing dead trees (snags), and when a tree that dies back is dead.

A tree in want sheds its modules over years, the top of its stem too, and would be a stub before it dies of the last
one. `dieback_share` calls it dead once it has died back to less than this share of its greatest height. What stands
then is the wood that it had before the step's shedding: a stem with the branches that were left to it.

A snag takes no light, water or place, casts no shade and bears no seeds: nothing that lives knows of it. It falls
after years t of its own, drawn by its identity, of median `standing_dead_yr` and survival

    S(t) = 2^-(t / standing_dead_yr)^2

so that few fall at first and more later, as Keen (1955) found of pines. The form is ours: he gives no equation.

Reference: Keen, F. P. (1955). The rate of natural falling of beetle-killed ponderosa pine snags. J. Forestry 53.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.modules import Modules
from forestgen.architecture.sizes import plant_sizes
from forestgen.community.branch_modules.identity import uniform
from forestgen.community.branch_modules.kinds import Kinds
from forestgen.community.branch_modules.state import Plants, Snags, State, appended, rows_of_plants
from forestgen.core.frames import BREAST_HEIGHT_M

_NO_MODULE = 2**32 - 1  # number of the draw: no plant has so many modules


def died_back(plants: Plants, modules: Modules, kinds: Kinds) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """(P,) which plants are dead of having died back, and (P,) the greatest height of each so far, metres.

    Nobody, and the heights as they were, where no dieback is asked for. Plants that never were over 1.3 m sprout again.
    """
    share = kinds.parameters.dieback_share
    if share == 0:
        return np.zeros(len(plants), dtype=np.bool_), plants.tallest_m
    height_m = plant_sizes(kinds.tables, modules, plants.species).height_m
    tallest_m = np.maximum(plants.tallest_m, height_m)
    return (tallest_m > BREAST_HEIGHT_M) & (height_m < np.float32(share) * tallest_m), tallest_m


def snags_after(state: State, kinds: Kinds, plants: Plants, wood: Modules, alive: NDArray[np.bool_]) -> Snags:
    """The snags one step later: those of before and the dead over 1.3 m, without those that have fallen.

    Parameters
    ----------
    plants, wood : all that lived, and their modules before the step's shedding.
    alive : (P,) who still does.
    """
    parameters, snags, step = kinds.parameters, state.snags, state.step + 1
    if parameters.standing_dead_yr == 0:
        return snags
    if not alive.all():
        dead, remains = plants.where(~alive), rows_of_plants(wood, ~alive)
        tall = plant_sizes(kinds.tables, remains, dead.species).height_m > BREAST_HEIGHT_M
        snags = Snags(
            plants=snags.plants.and_then(dead.where(tall)),
            modules=appended(snags.modules, rows_of_plants(remains, tall)),
            died=np.concatenate([snags.died, np.full(tall.sum(), step, dtype=np.int32)]),
        )
    dead_yr = (step - snags.died) * parameters.step_yr
    return snags.where(dead_yr < stands_yr(state.seed, snags.plants.plant_id, parameters.standing_dead_yr))


def stands_yr(seed: int, plant_id: NDArray[np.uint32], median_yr: float) -> NDArray[np.float64]:
    """(N,) years after its death in which each snag falls."""
    share = uniform(seed, plant_id, np.full(len(plant_id), _NO_MODULE, dtype=np.uint64))
    return np.asarray(median_yr * np.sqrt(-np.log2(1.0 - share)))
