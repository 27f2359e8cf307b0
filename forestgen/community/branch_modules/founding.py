"""The beginning: obstacles, and the first plants at random places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.prototype import Prototype
from forestgen.community.arrivals import new_ids
from forestgen.community.branch_modules.kinds import kinds_at
from forestgen.community.branch_modules.parameters import BranchModulesParameters, is_blocked
from forestgen.community.branch_modules.seeding import begun
from forestgen.community.branch_modules.state import (
    Plants,
    State,
    appended,
    no_modules,
    no_snags,
    refuse_more_modules,
    without_modules,
)
from forestgen.community.branch_modules.surroundings import boxes_of, ground_at
from forestgen.community.ecology import SpeciesEcology
from forestgen.community.model import Site
from forestgen.core.randomness import child_rng

_ROUNDS = 200  # of draws for places on open ground


def founded(
    parameters: BranchModulesParameters,
    site: Site,
    species: Sequence[SpeciesEcology],
    seed: int,
    prototypes: tuple[Prototype, ...],
) -> State:
    """State of step 0: obstacles come first, then the plants, species by species."""
    plants = _obstacles(site, species)
    modules = without_modules(no_modules(), len(plants))
    state = State(
        parameters, site, tuple(species), seed, 0, 1 + len(plants), prototypes, plants, modules, no_snags(plants)
    )
    growing = [index for index, one in enumerate(species) if one.modules is not None]
    wanted = parameters.counts([species[index].name for index in growing]) if growing else np.zeros(0, np.int64)
    refuse_more_modules(int(wanted.sum()), parameters.most_modules)
    sp = np.repeat(np.array(growing, dtype=np.uint16), wanted)
    place = _open_places(len(sp), parameters, site, child_rng(seed, "community", 0))
    notes = () if len(place) == len(sp) else (f"only {len(place)} of {len(sp)} plants found open ground",)
    new, begun_modules = begun(place, sp[: len(place)], state, kinds_at(state), 0)
    return replace(
        state,
        next_id=state.next_id + len(new),
        plants=plants.and_then(new),
        modules=appended(modules, begun_modules),
        notes=notes,
    )


def _obstacles(site: Site, species: Sequence[SpeciesEcology]) -> Plants:
    names = [one.name for one in species]
    n = len(site.buildings)
    position_m = np.array([one.position_m for one in site.buildings], dtype=np.float64).reshape(n, 2)
    return Plants(
        plant_id=new_ids(1, n),
        species=np.array([names.index(one.kind) for one in site.buildings], dtype=np.uint16),
        position_m=position_m,
        ground_m=ground_at(site, position_m),
        born=np.zeros(n, dtype=np.int32),
        flowering=np.zeros(n, dtype=np.bool_),
        next_number=np.zeros(n, dtype=np.uint32),
        adaptation=np.ones(n, dtype=np.float32),
        tallest_m=np.zeros(n, dtype=np.float32),
    )


def _open_places(
    count: int, parameters: BranchModulesParameters, site: Site, rng: np.random.Generator
) -> NDArray[np.float64]:
    """(N, 2) uniform places, metres, where nothing bars plants; fewer than `count` if hardly any ground is open."""
    blocked, boxes = parameters.blocked_soil(), boxes_of(site)
    found, missing = [np.empty((0, 2))], count
    for _ in range(_ROUNDS):
        if missing == 0:
            break
        place = rng.random((missing, 2)) * site.size_m
        free = ~is_blocked(blocked, place[:, 0], place[:, 1], site.size_m)
        if len(boxes):
            free &= ~boxes.cover(place, site.size_m if parameters.periodic else None)
        found.append(place[free])
        missing -= int(free.sum())
    return np.concatenate(found)
