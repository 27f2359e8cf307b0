"""Which plants of a stand are how far in the season; recipe/phenology.py has the dates.

Exemplars are shared by many plants, so the plants of a species fall into `CLASSES` of equal probability by their own
normal draws: early, mean and late. Classes whose leaves are the same are one: in summer and winter there is one alone.
A plant's draws belong to the plant: spring and autumn apart, and whatever else grows.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population, Status
from forestgen.core.randomness import child_rng
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.phenology import LeafState, Phenology, TimeOfYear, leaf_state

CLASSES = 0.0, -math.sqrt(1.5), math.sqrt(1.5)  # mean 0, standard deviation 1; the first is the species' mean
_THIRD = 0.43073  # of a normal distribution lies within so many standard deviations


def leaf_states(drawn: DrawnRecipe) -> dict[str, tuple[LeafState, ...]]:
    """By species, the different leaves that its classes have; the first are those of a mean plant."""
    time = drawn.recipe.time_of_year
    return {name: tuple(dict.fromkeys(_by_class(one.phenology, time)[1])) for name, one in drawn.species.items()}


def leaf_class_of_plant(drawn: DrawnRecipe, population: Population) -> NDArray[np.int64]:
    """(N,) which of its species' `leaf_states` each plant has; the dead, and buildings, the first."""
    chosen, time = np.zeros(len(population), dtype=np.int64), drawn.recipe.time_of_year
    for index, name in enumerate(population.species_names):
        if name not in drawn.species:
            continue
        phase, states = _by_class(drawn.species[name].phenology, time)
        different = list(dict.fromkeys(states))
        if len(different) == 1:
            continue
        of_class = np.array([different.index(state) for state in states])
        rows = np.flatnonzero((population.species == index) & (population.status != Status.DEAD))
        ids = population.plant_id[rows].tolist()
        drawn_of = np.array([child_rng(drawn.image_seed, "phenology", phase, one).normal() for one in ids])
        chosen[rows] = of_class[np.where(np.abs(drawn_of) < _THIRD, 0, np.where(drawn_of < 0, 1, 2))]
    return chosen


def _by_class(phenology: Phenology | None, time: TimeOfYear) -> tuple[str, list[LeafState]]:
    """The time of the year that tells classes apart, and the leaves of each."""
    if phenology is None:
        return "spring", [leaf_state(None, time)]
    spring = [leaf_state(phenology, time, spring_days=one * phenology.spring_sd_days) for one in CLASSES]
    if len(set(spring)) > 1:
        return "spring", spring
    return "autumn", [leaf_state(phenology, time, autumn_days=one * phenology.autumn_sd_days) for one in CLASSES]
