"""Which plants of a stand are how far in the season; recipe/phenology.py has the dates.

Exemplars are shared by many plants, so the plants of a species fall into `plants.phenology_classes` classes of equal
probability, from early to late, whose days have the species' standard deviation. Classes whose leaves are the same are
one: in summer and winter there is one alone. A plant's class is its own, whatever else grows, in spring and autumn.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population, Status
from forestgen.core.randomness import child_rng
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.phenology import BARE, LeafState, Phenology, TimeOfYear, leaf_state

_TOLERANT = 0.5  # of `ecology.shade_tolerance`, from which on a species is tolerant of shade; ours


def class_days(classes: int) -> NDArray[np.float64]:
    """(classes,) days of each class after its species, for a standard deviation of 1 day: the quantiles, rescaled."""
    quantiles = np.array([NormalDist().inv_cdf((one + 0.5) / classes) for one in range(classes)])
    return quantiles / max(float(quantiles.std()), 1e-9)


def leaf_states(drawn: DrawnRecipe) -> dict[str, tuple[LeafState, ...]]:
    """By species, the different leaves that its classes have, from early to late."""
    return {name: tuple(dict.fromkeys(_by_class(drawn, name)[1])) for name in drawn.species}


def leaf_class_of_plant(drawn: DrawnRecipe, population: Population) -> NDArray[np.int64]:
    """(N,) which of its species' `leaf_states` each plant has; the dead, and buildings, the first."""
    chosen = np.zeros(len(population), dtype=np.int64)
    for index, name in enumerate(population.species_names):
        phase, states = _by_class(drawn, name) if name in drawn.species else ("", [])
        different = list(dict.fromkeys(states))
        if len(different) < 2:
            continue
        rows = np.flatnonzero((population.species == index) & (population.status != Status.DEAD))
        ids = population.plant_id[rows].tolist()
        own = np.array([child_rng(drawn.image_seed, "phenology", phase, one).random() for one in ids])
        of_class = np.array([different.index(state) for state in states])
        chosen[rows] = of_class[(own * len(states)).astype(np.int64)]
    return chosen


def colour_stages(drawn: DrawnRecipe) -> dict[str, Callable[[float], tuple[float, ...]]]:
    """By species, shares of `SEASONS` in the leaves of a plant that is some standard deviations late in autumn.

    Of species whose plants are in one class, and whose materials have no season of their own; in more classes plants
    are early or late.
    """
    if drawn.recipe.plants.phenology_classes > 1:
        return {}
    return {
        name: partial(_colours, one.phenology, drawn.recipe.time_of_year)
        for name, one in drawn.species.items()
        if one.phenology is not None and all(leaf.season is None for leaf in one.materials.values())
    }


def inside_first(drawn: DrawnRecipe) -> frozenset[str]:
    """Species whose crowns turn from the inside in autumn: those that are not tolerant of shade."""
    return frozenset(name for name, one in drawn.species.items() if one.ecology.shade_tolerance < _TOLERANT)


def _colours(phenology: Phenology, time: TimeOfYear, late: float) -> tuple[float, ...]:
    state = leaf_state(phenology, time, autumn_days=late * phenology.autumn_sd_days)
    return (0.0, 0.0, 0.0, 1.0) if state == BARE else state.spectra


def _by_class(drawn: DrawnRecipe, name: str) -> tuple[str, list[LeafState]]:
    """The time of the year that tells a species' classes apart, and the leaves of each."""
    phenology, time = drawn.species[name].phenology, drawn.recipe.time_of_year
    if phenology is None:
        return "", [leaf_state(None, time)]
    days = class_days(drawn.recipe.plants.phenology_classes).tolist()
    spring = [leaf_state(phenology, time, spring_days=one * phenology.spring_sd_days) for one in days]
    if len(set(spring)) > 1:
        return "spring", spring
    return "autumn", [leaf_state(phenology, time, autumn_days=one * phenology.autumn_sd_days) for one in days]
