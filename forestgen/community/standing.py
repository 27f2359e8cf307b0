"""Plants that stand where they were put: what the placement models share after their first step.

A step of Δt years makes every plant older, and nothing else: plants neither grow, compete, arrive nor die. Only
disturbances (`community.disturbances`) change who is there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.community.arrivals import Rows, heights_m, new_ids, of_species, on_the_ground, refuse_overflow
from forestgen.community.disturbance import Planting
from forestgen.community.ecology import SpeciesEcology
from forestgen.community.model import CommunityParameters, Site
from forestgen.community.population import Population, Status
from forestgen.community.snapshot_checks import ImpossibleValueError, Limits, check_columns, check_finite
from forestgen.core.randomness import child_rng

_FOUND = ("clustering",)  # keys of what a placement works out for itself


@dataclass(frozen=True)
class Plants(Rows):
    """One row a plant, in order of plant_id."""

    x_m: NDArray[np.float64]  # (N, 2) metres, world x and y
    r_m: NDArray[np.float64]  # (N,) metres
    height_m: NDArray[np.float64]  # (N,) metres
    sp: NDArray[np.uint16]  # (N,) index of species
    azimuth_deg: NDArray[np.float64]  # (N,) turn about the vertical, clockwise from above
    first_age_yr: NDArray[np.float64]  # (N,) at the step of arrival
    plant_id: NDArray[np.uint32]  # (N,)
    first_step: NDArray[np.int32]  # (N,) step of arrival


@dataclass(frozen=True)
class State:
    """Everything that the future of a simulation depends on."""

    parameters: CommunityParameters
    species: tuple[SpeciesEcology, ...]
    seed: int
    step: int
    next_id: int  # the id of the next plant to arrive
    plants: Plants
    notes: tuple[str, ...] = ()  # what its users should know, as that not all plants found a place
    found: Mapping[str, Any] = field(default_factory=dict)  # what `init` worked out for itself, plain as in JSON


def azimuth_of(seed: int, plant_id: int) -> float:
    """A plant's own turn about the vertical, degrees."""
    return float(child_rng(seed, "placed azimuth", plant_id).uniform(0.0, 360.0))


def azimuths(seed: int, plant_id: NDArray[np.uint32]) -> NDArray[np.float64]:
    """(N,) turns of a whole placement's plants, degrees; plant k has the k-th number of one stream."""
    return child_rng(seed, "placement azimuths").uniform(0.0, 360.0, len(plant_id))


def first_state(
    parameters: CommunityParameters,
    species: Sequence[SpeciesEcology],
    seed: int,
    *,
    sp: NDArray[np.uint16],
    x_m: NDArray[np.float64],
    r_m: NDArray[np.float64],
    height_m: NDArray[np.float64],
    notes: Sequence[str] = (),
    found: Mapping[str, Any] | None = None,
) -> State:
    """The state of step 0 of plants that have just been placed, numbered from 1 in the order given."""
    n = len(sp)
    ids = new_ids(1, n)
    plants = Plants(
        x_m=np.ascontiguousarray(x_m, dtype=np.float64).reshape(n, 2),
        r_m=np.ascontiguousarray(r_m, dtype=np.float64),
        height_m=np.ascontiguousarray(height_m, dtype=np.float64),
        sp=np.ascontiguousarray(sp, dtype=np.uint16),
        azimuth_deg=azimuths(seed, ids),
        first_age_yr=np.zeros(n),
        plant_id=ids,
        first_step=np.zeros(n, dtype=np.int32),
    )
    return State(parameters, tuple(species), seed, 0, 1 + n, plants, tuple(notes), dict(found or {}))


class FixedPopulation:
    """The part of `CommunityModel` that follows `init`."""

    def step(self, state: State) -> State:
        """Time passes."""
        return replace(state, step=state.step + 1)

    def population(self, state: State) -> Population:
        """Snapshot; z is 0. A plant of its species' largest radius is mature, any other is growing."""
        plants, species = state.plants, state.species
        mature = plants.r_m >= of_species(species, "max_radius_m")[plants.sp] if len(species) else plants.r_m < 0
        age_yr = plants.first_age_yr + (state.step - plants.first_step) * state.parameters.step_yr
        return Population(
            time_yr=state.step * state.parameters.step_yr,
            species_names=tuple(one.name for one in species),
            plant_id=plants.plant_id,
            species=plants.sp,
            position_m=on_the_ground(plants.x_m),
            radius_m=plants.r_m,
            height_m=plants.height_m,
            age_yr=age_yr,
            status=np.where(mature, np.uint8(Status.MATURE), np.uint8(Status.GROWING)),
            columns={
                "azimuth_deg": plants.azimuth_deg,
                "first_age_yr": plants.first_age_yr,
                "first_step": plants.first_step,
            },
            step=state.step,
            state={"next_id": state.next_id, "notes": list(state.notes), **state.found},
        )

    def resume(
        self,
        parameters: CommunityParameters,
        site: Site,
        species: Sequence[SpeciesEcology],
        seed: int,
        population: Population,
    ) -> State:
        """The state of a snapshot."""
        plants = Plants(
            x_m=np.ascontiguousarray(population.position_m[:, :2]),
            r_m=population.radius_m,
            height_m=population.height_m,
            sp=population.species,
            azimuth_deg=population.columns["azimuth_deg"],
            first_age_yr=population.columns["first_age_yr"],
            plant_id=population.plant_id,
            first_step=population.columns["first_step"],
        )
        next_id, notes = int(population.state["next_id"]), tuple(population.state.get("notes", ()))
        found = {key: value for key, value in population.state.items() if key not in ("next_id", "notes")}
        return State(parameters, tuple(species), seed, population.step, next_id, plants, notes, found)

    def check_snapshot(
        self, parameters: CommunityParameters, site: Site, species: Sequence[SpeciesEcology], population: Population
    ) -> None:
        """Refuse turns, ages and arrivals that no plant of a snapshot has, and numbers that JSON does not know."""
        own = {
            "azimuth_deg": Limits("f8"),
            "first_age_yr": Limits("f8", 0),
            "first_step": Limits("i4", 0, population.step),
            "status": Limits("u1", 0, Status.MATURE),
        }
        check_columns(population, own)
        for key, value in population.state.items():
            if key not in ("next_id", "notes", *_FOUND):
                raise ImpossibleValueError(key, f"one of next_id, notes, {', '.join(_FOUND)}", "this key")
            check_finite(value, key)

    def remove(self, state: State, plant_id: NDArray[np.uint32]) -> State:
        """The others."""
        return replace(state, plants=state.plants.where(~np.isin(state.plants.plant_id, plant_id)))

    def plant(self, state: State, planting: Planting) -> State:
        """New plants beside those that are there."""
        n = len(planting)
        refuse_overflow(state.next_id, n)
        ids = new_ids(state.next_id, n)
        new = Plants(
            x_m=planting.position_m,
            r_m=planting.radius_m,
            height_m=heights_m(state.species, planting.species, planting.radius_m),
            sp=planting.species,
            azimuth_deg=np.array([azimuth_of(state.seed, int(one)) for one in ids], dtype=np.float64),
            first_age_yr=np.zeros(n),
            plant_id=ids,
            first_step=np.full(n, state.step, dtype=np.int32),
        )
        return replace(state, next_id=state.next_id + n, plants=state.plants.and_then(new))
