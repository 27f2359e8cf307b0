"""Populations of states, and states of populations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.geometry import plant_sizes
from forestgen.architecture.modules import Modules
from forestgen.community.arrivals import on_the_ground
from forestgen.community.branch_modules.parameters import BranchModulesParameters
from forestgen.community.branch_modules.state import Plants, Snags, State, ground_at, step_parameters
from forestgen.community.model import Ecologies, Site
from forestgen.community.population import Floats, Floats32, Population, Status
from forestgen.community.snapshot_checks import ImpossibleValueError, Limits, arrival_limits, check_columns, place_of
from forestgen.core.errors import RecipeError

LEAST_SIZE_M = 0.01  # of a seed, which has no length yet
_ALIVE = np.iinfo(np.int32).max  # step of death of living plants
DOMINATED_BELOW = 0.5  # mean light of a plant's modules


def population_of(state: State) -> Population:
    """Snapshot, the standing dead among the living; z is 0."""
    plants, modules, died = _with_snags(state)
    tables, step_yr = step_parameters(state).tables, state.parameters.step_yr
    dead = died <= state.step
    sizes = plant_sizes(tables, modules, plants.species)
    light, vigour = np.where(dead, 0.0, _mean(modules, modules.light)), np.zeros(len(plants))
    rooted = (np.diff(modules.first) > 0) & ~dead
    vigour[rooted] = modules.vigour[modules.first[:-1][rooted]]
    age_yr = (np.minimum(state.step, died) - plants.born) * step_yr
    status = np.where(plants.flowering, np.uint8(Status.MATURE), np.uint8(Status.GROWING))
    status[rooted & (light < DOMINATED_BELOW) & (age_yr > 0)] = Status.DOMINATED
    status[dead] = Status.DEAD
    radius_m, height_m = (one.astype(np.float64) for one in (sizes.crown_radius_m, sizes.height_m))
    for row, obstacle in enumerate(state.site.buildings):  # they are the first plants of all
        radius_m[row], height_m[row] = 0.5 * float(np.hypot(*obstacle.size_m[:2])), obstacle.size_m[2]
    on_request = {}
    if state.parameters.standing_dead_yr > 0:
        on_request["dead_yr"] = (np.maximum(state.step - died.astype(np.int64), 0) * step_yr).astype(np.float32)
    if state.parameters.dieback_share > 0:
        on_request["tallest_m"] = plants.tallest_m
    return Population(
        time_yr=state.step * step_yr,
        species_names=tuple(one.name for one in state.species),
        plant_id=plants.plant_id,
        species=plants.species,
        position_m=on_the_ground(plants.position_m),
        radius_m=np.maximum(radius_m, LEAST_SIZE_M),
        height_m=np.maximum(height_m, LEAST_SIZE_M),
        age_yr=age_yr.astype(np.float64),
        status=status,
        columns={
            "modules": sizes.modules.astype(np.int32),
            "trunk_diameter_m": sizes.trunk_diameter_m.astype(np.float32),
            "foot_diameter_m": sizes.foot_diameter_m.astype(np.float32),
            "wood_volume_m3": sizes.wood_volume_m3.astype(np.float32),
            "leaf_area_m2": np.where(dead, 0.0, sizes.leaf_area_m2).astype(np.float32),
            "vigour": vigour.astype(np.float32),
            "light": light.astype(np.float32),
            "flowering": plants.flowering.astype(np.uint8),
            "next_module": plants.next_number,
            "adaptation": plants.adaptation,
            **on_request,
        },
        step=state.step,
        state={"next_id": state.next_id, **({"notes": list(state.notes)} if state.notes else {})},
        modules=modules,
    )


def _with_snags(state: State) -> tuple[Plants, Modules, NDArray[np.int32]]:
    """All plants in order of plant_id with their modules, and (N,) the step in which each died."""
    snags, died = state.snags, np.full(len(state.plants), _ALIVE, dtype=np.int32)
    if not len(snags.died):
        return state.plants, state.modules, died
    plants, died = state.plants.and_then(snags.plants), np.concatenate([died, snags.died])
    order = np.argsort(plants.plant_id).astype(np.int64)
    return plants.where(order), state.modules.and_then(snags.modules).of_plants(order), died[order]


def _mean(modules: Modules, values: Floats32) -> Floats:
    """(P,) mean of a number of each module; 0 for plants that have none."""
    sums = np.concatenate([[0.0], np.cumsum(values, dtype=np.float64)])
    count = np.diff(modules.first)
    return np.asarray((sums[modules.first[1:]] - sums[modules.first[:-1]]) / np.maximum(count, 1))


def _steps(years: NDArray[np.floating], parameters: BranchModulesParameters) -> NDArray[np.int32]:
    return np.asarray(np.rint(years / parameters.step_yr), dtype=np.int32)


def state_of(
    parameters: BranchModulesParameters, site: Site, species: Ecologies, seed: int, population: Population
) -> State:
    """The state that a snapshot was made of."""
    if population.modules is None:
        problem, expected = "a snapshot without its modules cannot go on", "a history that keeps each plant's modules"
        hint = "set history_modules: true and simulate again"
        raise RecipeError(problem, where="community.history_modules", expected=expected, hint=hint)
    n, columns = len(population), population.columns
    zeros = np.zeros(n, dtype=np.float32)
    position_m = np.ascontiguousarray(population.position_m[:, :2])
    dead = population.status == Status.DEAD
    died = np.int32(population.step) - _steps(columns.get("dead_yr", zeros), parameters)
    plants = Plants(
        plant_id=population.plant_id,
        species=population.species,
        position_m=position_m,
        ground_m=ground_at(site, position_m),
        born=died - _steps(population.age_yr, parameters),
        flowering=columns["flowering"] != 0,
        next_number=columns["next_module"],
        adaptation=columns.get("adaptation", np.ones(len(population), dtype=np.float32)),
        tallest_m=columns.get("tallest_m", zeros),
    )
    modules, notes, next_id = population.modules, tuple(population.notes), int(population.state["next_id"])
    snags = Snags(plants.where(dead), modules.of_plants(dead), died[dead])
    living = plants.where(~dead), modules.of_plants(~dead)
    return State(parameters, site, tuple(species), seed, population.step, next_id, *living, snags, notes)


def check_resumable(
    parameters: BranchModulesParameters, site: Site, species: Ecologies, population: Population
) -> None:
    """Raise `ImpossibleValueError` unless `state_of` can make a state of a snapshot with its modules."""
    keeps_dead = parameters.standing_dead_yr > 0
    limits = {
        **arrival_limits(population, parameters.step_yr, dead=keeps_dead),
        "flowering": Limits("u1", 0, 1),
        "next_module": Limits("u4", 0),
        "adaptation": Limits("f4", 0, 1),
    }
    if keeps_dead:
        limits["dead_yr"] = Limits("f4", 0, limits["age_yr"].most)
    if parameters.dieback_share > 0:
        limits["tallest_m"] = Limits("f4", 0)
    check_columns(population, limits)
    _check_obstacles(site, species, population)
    if population.modules is not None:
        _check_module_numbers(population.modules, population)


def _check_obstacles(site: Site, species: Ecologies, population: Population) -> None:
    """The recipe's buildings are the first rows, stand, and no other row is of a species that does not grow."""
    names = [one.name for one in species]
    wanted, row = [names.index(one.kind) for one in site.buildings], 0
    expected = f"the {len(wanted)} buildings of the recipe first"
    for row, sp in enumerate(wanted):
        if row >= len(population) or population.plant_id[row] != row + 1:
            raise ImpossibleValueError("column plant_id", expected, f"no plant {row + 1}")
        if population.species[row] != sp:
            raise ImpossibleValueError(place_of("species", population, row), expected, names[population.species[row]])
        if population.status[row] == Status.DEAD:
            raise ImpossibleValueError(place_of("status", population, row), "a building, which cannot die", "dead")
    grows = np.array([one.modules is not None for one in species], dtype=np.bool_)
    wrong = np.flatnonzero(~grows[population.species[len(wanted) :]]) + len(wanted)
    if len(wrong):
        row = int(wrong[0])
        got = names[population.species[row]]
        raise ImpossibleValueError(place_of("species", population, row), "a species that grows by branch modules", got)


def _check_module_numbers(modules: Modules, population: Population) -> None:
    """The next module of each plant has a number above all that it has."""
    plant = modules.plant()
    wrong = np.flatnonzero(population.columns["next_module"][plant] <= modules.number)
    if len(wrong):
        row = int(plant[wrong[0]])
        expected = f"more than {modules.number[wrong[0]]}, the number of one of its modules"
        got = str(population.columns["next_module"][row])
        raise ImpossibleValueError(place_of("model.next_module", population, row), expected, got)
