"""What the placement models have in common: who is to be placed, and what a recipe may be told before it is done."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.community.disturbance import planted
from forestgen.community.ecology import SpeciesEcology
from forestgen.community.ground.living_conditions import why_barred
from forestgen.community.model import Site
from forestgen.community.placement.asked_and_placed import Densities, asked_densities
from forestgen.community.placement.densities import (
    COUNTING_CELLS,
    check_sizes,
    draw_heights,
    draw_radii,
    grid_shape,
    plant_counts,
    species_density,
)
from forestgen.community.placement.stands import PlacementParameters
from forestgen.community.population import Population
from forestgen.community.standing import FixedPopulation, State, first_state
from forestgen.core.randomness import child_rng

_BYTES_PER_PLANT = 400  # a state, its successor, a snapshot, what a placement holds meanwhile
_BYTES_AT_LEAST = 4 * 1024 * 1024


@dataclass(frozen=True)
class Wanted:
    """The plants to be placed, largest first; of one size, in the order of species."""

    sp: NDArray[np.uint16]  # (N,) index of species
    r_m: NDArray[np.float64]  # (N,) metres
    height_m: NDArray[np.float64]  # (N,) metres


def wanted_plants(
    parameters: PlacementParameters, site: Site, species: Sequence[SpeciesEcology], rng: np.random.Generator
) -> Wanted:
    """Species, radii and heights of the plants that a recipe asks for.

    Each species has a stream of numbers of its own, by its name: another species beside it leaves its sizes alone.

    Raises
    ------
    RecipeError : a radius that the species cannot have.
    """
    check_sizes(parameters, species)
    counts = plant_counts(parameters, site, species)
    sp = [np.zeros(0, dtype=np.uint16)]
    r_m, height_m = [np.zeros(0)], [np.zeros(0)]
    for index, (one, count) in enumerate(zip(species, counts, strict=True)):
        stream = _stream(rng, "sizes", one.name)
        stand = parameters.plants.get(one.name)
        radii = draw_radii(stand.radius_m if stand else None, one, int(count), stream)
        sp.append(np.full(count, index, dtype=np.uint16))
        r_m.append(radii)
        height_m.append(draw_heights(stand, one, radii, stream))
    radius = np.concatenate(r_m)
    order = np.argsort(-radius, kind="stable")
    return Wanted(np.concatenate(sp)[order], radius[order], np.concatenate(height_m)[order])


def chances(wanted: Wanted, species: Sequence[SpeciesEcology], rng: np.random.Generator) -> NDArray[np.float64]:
    """(N, 2) numbers in [0, 1) that place the plants: a species' k-th largest has the k-th pair of its own stream.

    So a species that affects no other one leaves the others where they were.
    """
    uniform = np.empty((len(wanted.sp), 2))
    for index, one in enumerate(species):
        mine = wanted.sp == index
        uniform[mine] = _stream(rng, "places", one.name).random((int(mine.sum()), 2))
    return uniform


def _stream(rng: np.random.Generator, *identity: str) -> np.random.Generator:
    """The generator of a part of what `rng` is for, whatever has been drawn from it."""
    root = rng.bit_generator.seed_seq
    assert isinstance(root, np.random.SeedSequence)
    key = int.from_bytes(hashlib.blake2b(repr(identity).encode(), digest_size=8).digest(), "little")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(root.entropy, spawn_key=(*root.spawn_key, key))))


def placed_state(
    parameters: PlacementParameters,
    site: Site,
    species: Sequence[SpeciesEcology],
    seed: int,
    wanted: Wanted,
    position_m: NDArray[np.float64],
    why: str | Mapping[str, str],
    notes: Sequence[str] = (),
    found: Mapping[str, Any] | None = None,
) -> State:
    """The state of step 0; plants whose (N, 2) position is nan found no place, and a note says how many and `why`.

    Parameters
    ----------
    why : the reason; or one by species. Conditions that bar a species on the whole site are told instead.
    notes : what else a user should know.
    found : what the model worked out for itself, plain as in JSON; it is kept with every snapshot.
    """
    placed = ~np.isnan(position_m[:, 0])
    asked = np.bincount(wanted.sp, minlength=len(species))
    standing = np.bincount(wanted.sp[placed], minlength=len(species))
    reasons = dict.fromkeys((one.name for one in species), why) if isinstance(why, str) else why
    missing = []
    for i, one in enumerate(species):
        if standing[i] < asked[i]:
            bars = None if standing[i] else _bars(parameters, site, one.name)
            missing.append(
                f"{standing[i]:,} of {asked[i]:,} plants of {one.name} were placed: {bars or reasons[one.name]}"
            )
    return first_state(
        parameters,
        species,
        seed,
        sp=wanted.sp[placed],
        x_m=position_m[placed],
        r_m=wanted.r_m[placed],
        height_m=wanted.height_m[placed],
        notes=[*missing, *notes],
        found=found,
    )


def _bars(parameters: PlacementParameters, site: Site, name: str) -> str | None:
    """What bars a species on the whole site; None: nothing does."""
    shape, keep_out = grid_shape(site, COUNTING_CELLS), parameters.keep_out
    if species_density(parameters, site, name, shape).any():
        return None
    if keep_out is not None and np.all(keep_out.values() > 0):
        return "keep_out bars the whole site"
    conditions = why_barred(parameters.plants[name].conditions, site, shape)
    return conditions or "the map, the conditions and keep_out bar the whole site"


class PlacementModel(FixedPopulation):
    """A `CommunityModel` but for its Parameters and `init`, which draws from `placement_rng`."""

    def expected_plants(self, parameters: PlacementParameters, site: Site, species: Sequence[SpeciesEcology]) -> float:
        """Who is to be placed, and who will be planted."""
        return float(plant_counts(parameters, site, species).sum() + planted(parameters.disturbances))

    def empty_reason(
        self, parameters: PlacementParameters, site: Site, species: Sequence[SpeciesEcology]
    ) -> str | None:
        """Why no plant will ever stand there, or None if some may."""
        if planted(parameters.disturbances) > 0:
            return None
        if not parameters.plants:
            return "no plant is placed: community.plants is empty"
        reasons = []
        for name, stand in parameters.plants.items():
            if stand.count or stand.plants_per_ha:
                bars = _bars(parameters, site, name)
                if bars is None and self.expected_plants(parameters, site, species) > 0:
                    return None
                reasons += [f"no plant is placed: of {name}, {bars}"] if bars else []
        return reasons[0] if reasons else "no plant is placed: every number in community.plants is 0, or rounded to 0"

    def estimate_bytes(self, parameters: PlacementParameters, site: Site, species: Sequence[SpeciesEcology]) -> int:
        """Bytes for all plants at once.

        It is what a plan asks first, so it also looks at the sizes: what is wrong is said before anything is built.
        """
        check_sizes(parameters, species)
        return _BYTES_AT_LEAST + math.ceil(self.expected_plants(parameters, site, species) * _BYTES_PER_PLANT)

    def densities(
        self, parameters: PlacementParameters, site: Site, species: Sequence[SpeciesEcology], placed: Population
    ) -> Densities:
        """What the recipe asks for, for pictures and statistics of the plants `placed` in step 0."""
        return asked_densities(parameters, site, species)


def placement_rng(seed: int) -> np.random.Generator:
    """The stream of random numbers of step 0."""
    return child_rng(seed, "community", 0)
