"""A forest of footprints: saplings at random places, the more vigorous of two that meet dominates.

Reference: K. Randleff-Rasmussen, Forest Growth Simulation Using L-Systems, BSc (Hons) thesis, Rhodes University, 2004,
sections 3.3, 4.1 and 5.2.

A plant is a circle, its footprint, of radius r around a place that never changes, with a vigour v that never changes
and a health h between 0 and 1. Two footprints that intersect compete, and the plant of less vigour is dominated; of
equal vigour, the later born. A step of Δt years is

1.  health: of a dominated plant h falls by ``loss (1 - shade) Δt``, of any other it rises by ``gain Δt``, to 1 at most;
2.  death: of a plant whose health is used up; and of a plant of the largest radius R with probability 1 - oldage;
3.  growth: r becomes ``min(R, r + grow h^γ Δt)``: a dominated plant is stunted before it dies;
4.  saplings: a Poisson number of each species, at uniform random places, of health 1 and of uniform random vigour in
    [0, 1];
5.  competition: the footprints that intersect, saplings included.

The age of the thesis, the number of derivation steps of a plant's own L-system, is the column ``derivation_steps``:
the integer part of ``m r / R``, between 0 and the maximum size m of the species.

Parameters: see below; loss is health_loss_per_yr, gain is health_gain_per_yr, γ is growth_exponent, m
is derivation_steps, of some species derivation_steps_of. Of each species' ecology: grow is growth_m_per_yr, R is
max_radius_m, shade is shade_tolerance, oldage is old_age_survival (a probability a step); seedlings_per_ha_per_yr is
the mean number over area and Δt, seedling_radius_m the mean radius; heights are ``A_H r^c_H`` with the scale and
exponent of height_m.

Recipe::

    community: {model: forest_footprints, steps: 200, health_loss_per_yr: 0.3, derivation_steps_of: {poplar: 10}}

Decided where the thesis is silent:

- It says that growth is a function of health, that domination lowers health, and that this ends in stunted growth or
  in death; the functions are ours, the simplest that do so. Health recovers in plants that are not dominated:
  otherwise all plants around a removed tree would stay stunted, against section 5.2.2. Constant rates need one number
  each.
- shade is read as the share of the loss that a species is spared: 1 is a species that domination never harms. So the
  species that come with forestgen keep their order, though their numbers were chosen for another model.
- "Removal of the old plants" is death at the largest radius, for the age is computed from the radius; by chance, or a
  cohort would die in one step. A plant that is both too old and dominated dies of whichever comes first.
- A dominated plant still competes with plants of less vigour than its own. Touching is intersecting.
- Vigour is uniform and the same for all species; the thesis draws it from its sequence of random numbers. It has
  nothing to do with size: a vigorous sapling beneath a large tree of little vigour brings that tree down. Only a
  planting (`community.disturbances`) sets it: a sturdy tree has a vigour above 1.
- The number of saplings a step is Poisson; places are uniform, as in the thesis. Radii are uniform between 0.5 and 1.5
  times seedling_radius_m. A planted plant has health 1.
- The initial cohort, none by default, has round(n x area) plants, each of any species with equal probability.
- The site is a torus by default; the thesis has a bounded one. A frame of the thesis is a step.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.community.arrivals import (
    CirclePlants,
    new_ids,
    of_species,
    refuse_overflow,
    seedlings,
    seedlings_per_step,
    upper_number,
)
from forestgen.community.competition.domination import dominated
from forestgen.community.disturbance import Planting, planted
from forestgen.community.model import CommunityParameters
from forestgen.community.population import Ecologies, Floats, Population, Site, SpeciesEcology, Status
from forestgen.community.snapshot_checks import Limits, arrival_limits, check_columns, check_radii
from forestgen.core.randomness import child_rng
from forestgen.recipe.fields import Name, NonNegative, Number, Whole
from forestgen.recipe.sources import Keys

# Peak bytes a plant: a state, its successor, the tables between them, the grid, and a snapshot.
_BYTES_PER_PLANT = 480
_BYTES_AT_LEAST = 256 * 1024


class FootprintParameters(CommunityParameters):
    """What a recipe says about the model besides its species."""

    planting_columns: ClassVar[tuple[str, ...]] = ("vigour",)

    step_yr: float = Field(1.0, gt=0, description="duration of a step, years")
    initial_plants_per_ha: NonNegative = Field(0.0, description="saplings on the site from the beginning, per hectare")
    health_loss_per_yr: NonNegative = Field(
        0.25, description="health that a dominated plant of no shade tolerance loses in a year; a sapling has 1"
    )
    health_gain_per_yr: NonNegative = Field(0.1, description="health that any other plant regains in a year")
    growth_exponent: Number = Field(1.0, ge=0, le=100, description="growth falls with health to this power")
    derivation_steps: Whole = Field(
        8, ge=0, le=10_000, description="derivation steps of a plant of the largest radius, its species' maximum size"
    )
    derivation_steps_of: dict[Name, Whole] = Field(
        default_factory=dict, description="species -> the same number, where it differs"
    )

    def named_species(self) -> Iterator[tuple[Keys, str]]:
        yield from super().named_species()
        yield from ((("derivation_steps_of", name), name) for name in self.derivation_steps_of)


@dataclass(frozen=True)
class Plants(CirclePlants):
    """One row a plant."""

    vigour: Floats  # (N,)
    health: Floats  # (N,) 0 to 1
    dominated: NDArray[np.bool_]  # (N,)


@dataclass(frozen=True)
class State:
    """Everything that the future of a simulation depends on."""

    parameters: FootprintParameters
    site: Site
    species: tuple[SpeciesEcology, ...]
    seed: int
    step: int
    next_id: int  # the id of the next plant to arrive
    plants: Plants


def _new(x_m: Floats, r_m: Floats, sp: NDArray[np.uint16], vigour: Floats, first_id: int, born: int) -> Plants:
    """Plants of full health, numbered from `first_id`."""
    n = len(sp)
    free = np.zeros(n, dtype=np.bool_)
    return Plants(x_m, r_m, sp, new_ids(first_id, n), np.full(n, born, dtype=np.int32), vigour, np.ones(n), free)


def _saplings(state: State, sp: NDArray[np.uint16], rng: np.random.Generator) -> Plants:
    """Saplings of given species at random places, of random small radii and vigour, that arrive in the state's step."""
    x_m, r_m = seedlings(sp, state.site, state.species, rng)
    return _new(x_m, r_m, sp, rng.random(len(sp)), state.next_id, state.step)


def _competing(state: State, plants: Plants) -> State:
    """`state` with these plants and who of them is dominated; those that are new are counted."""
    next_id = max(state.next_id, int(plants.plant_id[-1]) + 1 if len(plants) else 1)
    beaten = dominated(
        plants.x_m, plants.r_m, plants.plant_id, state.site.size_m,
        periodic=state.parameters.periodic, strength=plants.vigour,
    )  # fmt: skip
    return replace(state, next_id=next_id, plants=replace(plants, dominated=beaten))


def survivors(state: State, u: Floats) -> Plants:
    """Steps 1 to 3: the plants that live on, with their new health and radius; `u` is random(1) of each plant."""
    plants, species, parameters = state.plants, state.species, state.parameters
    loss = parameters.health_loss_per_yr * (1 - of_species(species, "shade_tolerance")[plants.sp])
    change = np.where(plants.dominated, -loss, parameters.health_gain_per_yr) * parameters.step_yr
    health = np.minimum(plants.health + change, 1.0)
    largest = of_species(species, "max_radius_m")[plants.sp]
    old = (plants.r_m >= largest) & (u >= of_species(species, "old_age_survival")[plants.sp])
    alive = (health > 1e-12) & ~old  # what rounding leaves of a health that is used up is no health
    speed = of_species(species, "growth_m_per_yr")[plants.sp] * np.maximum(health, 0.0) ** parameters.growth_exponent
    r_m = np.minimum(plants.r_m + speed * parameters.step_yr, largest)
    return replace(plants, health=health, r_m=r_m).where(alive)


class ForestFootprints:
    Parameters = FootprintParameters

    def init(self, parameters: FootprintParameters, site: Site, species: Ecologies, seed: int) -> State:
        """The initial cohort, by default a bare site."""
        n = _cohort_size(parameters, site) if species else 0
        refuse_overflow(1, n)
        rng = child_rng(seed, "community", 0)
        sp = rng.integers(0, max(1, len(species)), size=n, dtype=np.uint16)
        none = _new(np.zeros((0, 2)), np.zeros(0), sp[:0], np.zeros(0), 1, 0)
        bare = State(parameters, site, tuple(species), seed, 0, 1, none)
        return _competing(bare, _saplings(bare, sp, rng))

    def step(self, state: State) -> State:
        """Health, death, growth, saplings, competition."""
        rng = child_rng(state.seed, "community", state.step + 1)
        old = survivors(state, rng.random(len(state.plants)))
        mean = seedlings_per_step(state.species, state.site, state.parameters.step_yr)
        refuse_overflow(state.next_id, float(mean.sum()))
        sp = np.repeat(np.arange(len(state.species), dtype=np.uint16), rng.poisson(mean))
        after = replace(state, step=state.step + 1)
        return _competing(after, old.and_then(_saplings(after, sp, rng)))

    def population(self, state: State) -> Population:
        plants, species, parameters = state.plants, state.species, state.parameters
        largest = of_species(species, "max_radius_m")[plants.sp]
        size = [parameters.derivation_steps_of.get(one.name, parameters.derivation_steps) for one in species]
        steps = np.floor(np.array(size, dtype=np.float64)[plants.sp] * (plants.r_m / largest)).astype(np.int32)
        columns: dict[str, NDArray[Any]] = {"vigour": plants.vigour, "health": plants.health, "derivation_steps": steps}
        return plants.population(species, state.step, parameters.step_yr, state.next_id, plants.dominated, columns)

    def resume(
        self, parameters: FootprintParameters, site: Site, species: Ecologies, seed: int, population: Population
    ) -> State:
        """The state of a snapshot: who is dominated is in the status."""
        plants = Plants(
            **Plants.columns_of(population, parameters.step_yr),
            vigour=population.columns["vigour"],
            health=population.columns["health"],
            dominated=population.status == Status.DOMINATED,
        )
        next_id = int(population.state["next_id"])
        return State(parameters, site, tuple(species), seed, population.step, next_id, plants)

    def check_snapshot(
        self, parameters: FootprintParameters, site: Site, species: Ecologies, population: Population
    ) -> None:
        """Refuse ages, sizes, vigour and health that no plant of a snapshot has."""
        check_radii(population, species)
        own = {"vigour": Limits("f8"), "health": Limits("f8", 0, 1)}
        check_columns(population, {**arrival_limits(population, parameters.step_yr), **own})

    def remove(self, state: State, plant_id: NDArray[np.uint32]) -> State:
        """The forest without these plants; those that they dominated are free."""
        return _competing(state, state.plants.where(~np.isin(state.plants.plant_id, plant_id)))

    def plant(self, state: State, planting: Planting) -> State:
        """The forest with new plants of full health; a vigour that is not given is random."""
        rng = child_rng(state.seed, "planted vigour", state.next_id)
        vigour = planting.columns.get("vigour", rng.random(len(planting)))
        place = planting.position_m, planting.radius_m, planting.species
        return _competing(state, state.plants.and_then(_new(*place, vigour, state.next_id, state.step)))

    def expected_plants(self, parameters: FootprintParameters, site: Site, species: Ecologies) -> float:
        """Upper bound: who is there from the beginning or planted, and arrivals a step times the steps of a life."""
        total = float(_cohort_size(parameters, site) + planted(parameters.disturbances))
        for one, arrivals in zip(species, seedlings_per_step(species, site, parameters.step_yr), strict=True):
            total += min(float(arrivals), 1e30) * min(_longest_life(parameters, one), parameters.steps)
        return total

    def empty_reason(self, parameters: FootprintParameters, site: Site, species: Ecologies) -> str | None:
        if self.expected_plants(parameters, site, species) > 0:
            return None
        if parameters.steps == 0:
            return "no plant can grow: community.steps is 0, and the forest begins on bare ground"
        return "no plant can grow: ecology.seedlings_per_ha_per_yr is 0 for every species"

    def estimate_bytes(self, parameters: FootprintParameters, site: Site, species: Ecologies) -> int:
        """Bytes for the bound of the mean number of plants and six standard deviations of a Poisson number more."""
        plants = upper_number(self.expected_plants(parameters, site, species))
        return _BYTES_AT_LEAST + math.ceil(plants * _BYTES_PER_PLANT)


def _cohort_size(parameters: FootprintParameters, site: Site) -> int:
    return round(min(parameters.initial_plants_per_ha * site.area_ha, 1e30))


def _longest_life(parameters: FootprintParameters, one: SpeciesEcology) -> float:
    """Upper bound of the mean number of steps of a life.

    In every step in which no plant dominates it, a plant has a health of at least min(1, gain Δt) and grows
    accordingly, so there are few such steps before it is mature; domination takes all the health that they and birth
    gave, so there are few of its steps too; and a mature plant lives 1 / (1 - oldage) steps in the mean.
    """
    gain = parameters.health_gain_per_yr * parameters.step_yr
    loss = parameters.health_loss_per_yr * (1 - one.shade_tolerance) * parameters.step_yr
    slowest = one.growth_m_per_yr * parameters.step_yr * min(1.0, gain) ** parameters.growth_exponent
    free = one.max_radius_m / slowest + 1 if slowest > 0 else math.inf
    regained = gain * free if gain > 0 else 0.0
    dominated = (1 + regained) / loss + 1 if loss > 0 else math.inf
    mature = 1 / (1 - one.old_age_survival) if one.old_age_survival < 1 else math.inf
    return free + dominated + mature


MODEL = ForestFootprints()
