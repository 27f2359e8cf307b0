"""Base classes for community models of other packages; docs/tutorials/plugin.md writes two.

A `StaticModel` says where plants stand (`place`) and how many there are at most (`most_plants`). The class has the rest
of `CommunityModel`: steps, snapshots, resuming, disturbances, memory. A step of Δt years makes every plant older, and
nothing else: plants neither grow, compete, arrive nor die. Only disturbances (`community.disturbances`) add or remove
plants. A `GrowingModel` also says what a step does to plants (`change`).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Generic, NoReturn, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.community.arrivals import CirclePlants, heights_m, new_ids, of_species
from forestgen.community.disturbance import Planting, planted
from forestgen.community.model import CommunityParameters
from forestgen.community.population import Ecologies, Floats, Population, Site, SpeciesEcology, Status
from forestgen.community.snapshot_checks import ImpossibleValueError, Limits, check_columns, check_finite
from forestgen.community.tree_columns import COLUMNS
from forestgen.core.errors import RecipeError
from forestgen.core.randomness import child_rng
from forestgen.recipe.fields import Whole


class StaticParameters(CommunityParameters):
    """Keys of a static model; a model adds its own in a subclass."""

    steps: Whole = Field(0, ge=0, le=100_000, description="number of steps")
    step_yr: float = Field(1.0, gt=0, description="duration of a step, years")


P = TypeVar("P", bound=StaticParameters)


@dataclass(frozen=True)
class Placement:
    """Plants that a static model places, one row a plant."""

    species: NDArray[np.integer]  # (N,) index of species
    position_m: Floats  # (N, 2) world x and y, on the site
    radius_m: Floats  # (N,) 0 < r <= the species' max_radius_m
    height_m: Floats | None = None  # (N,) None: by the species' allometry
    notes: tuple[str, ...] = ()  # for users, such as that not all plants found a place
    found: Mapping[str, Any] = field(default_factory=dict)  # what the model worked out, as in JSON; keys: `state_keys`
    tree_sizes: Floats | None = None  # (N, 4) `tree_columns.COLUMNS`, NaN where the model does not say
    dead: NDArray[np.bool_] | None = None  # (N,) standing dead trees; None: all live
    age_yr: Floats | None = None  # (N,) None: 0
    azimuth_deg: Floats | None = None  # (N,) turn about the vertical; NaN: random

    def __post_init__(self) -> None:
        for name in ("species", "position_m", "radius_m", "height_m", "tree_sizes", "dead", "age_yr", "azimuth_deg"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, np.asarray(getattr(self, name)))
        n = self.species.size
        heights = (n,) if self.height_m is None else self.height_m.shape
        found = (self.species.shape, self.position_m.shape, self.radius_m.shape, heights)
        if found != ((n,), (n, 2), (n,), (n,)):
            expected = f"species, radius_m and height_m of shape ({n},), position_m of ({n}, 2)"
            raise RecipeError("the arrays of a Placement do not fit", expected=expected, got=str(found))


@dataclass(frozen=True)
class Change:
    """What a step does to plants; arrays have one row a plant of the population that `change` was given."""

    dead: NDArray[np.bool_] | None = None  # (N,) these are gone; None: all live
    radius_m: Floats | None = None  # (N,) after the step; None: as before
    height_m: Floats | None = None  # (N,) None: as before, or by the species' allometry where radius_m is given
    arrivals: Placement | None = None  # new plants; only `Placement.notes` and `found` of step 0 are kept


@dataclass(frozen=True)
class Plants(CirclePlants):
    """One row a plant, in order of plant_id."""

    height_m: Floats  # (N,) metres
    azimuth_deg: Floats  # (N,) turn about the vertical, clockwise from above
    first_age_yr: Floats  # (N,) at the step of arrival
    tree_sizes: Floats  # (N, 4) `tree_columns.COLUMNS`, NaN where unknown
    dead: NDArray[np.bool_]  # (N,)


@dataclass(frozen=True)
class State:
    """Everything that the future of a simulation depends on."""

    parameters: CommunityParameters
    site: Site
    species: tuple[SpeciesEcology, ...]
    seed: int
    step: int
    next_id: int  # the id of the next plant to arrive
    plants: Plants
    notes: tuple[str, ...] = ()  # for users, such as that not all plants found a place
    found: Mapping[str, Any] = field(default_factory=dict)  # what `init` worked out for itself, plain as in JSON


def unknown_sizes(n: int) -> Floats:
    """Sizes of n trees of which a model says none."""
    return np.full((n, len(COLUMNS)), np.nan)


def azimuth_of(seed: int, plant_id: int) -> float:
    """A plant's own turn about the vertical, degrees."""
    return float(child_rng(seed, "placed azimuth", plant_id).uniform(0.0, 360.0))


def first_state(parameters: CommunityParameters, site: Site, species: Ecologies, seed: int, placed: Placement) -> State:
    """The state of step 0 of plants that have just been placed, numbered from 1 in the order given."""
    n, height_m = len(placed.species), placed.height_m
    azimuth_deg = child_rng(seed, "placement azimuths").uniform(0.0, 360.0, n)
    if placed.azimuth_deg is not None:
        azimuth_deg = np.where(np.isnan(placed.azimuth_deg), azimuth_deg, placed.azimuth_deg)
    plants = Plants(
        x_m=np.ascontiguousarray(placed.position_m, dtype=np.float64),
        r_m=np.ascontiguousarray(placed.radius_m, dtype=np.float64),
        height_m=np.ascontiguousarray(
            heights_m(species, placed.species, placed.radius_m) if height_m is None else height_m, dtype=np.float64
        ),
        sp=np.ascontiguousarray(placed.species, dtype=np.uint16),
        azimuth_deg=azimuth_deg,
        first_age_yr=np.zeros(n) if placed.age_yr is None else placed.age_yr,
        tree_sizes=unknown_sizes(n) if placed.tree_sizes is None else placed.tree_sizes,
        dead=np.zeros(n, dtype=np.bool_) if placed.dead is None else placed.dead,
        plant_id=new_ids(1, n),
        born=np.zeros(n, dtype=np.int32),
    )
    return State(parameters, site, tuple(species), seed, 0, 1 + n, plants, placed.notes, dict(placed.found))


class FixedPopulation(Generic[P]):
    """The part of a `CommunityModel` that follows `init`, for models that place all plants there."""

    Parameters: type[P]
    state_keys: ClassVar[tuple[str, ...]] = ()  # what a snapshot's state may have of `State.found`
    knows_trees: ClassVar[bool] = False  # whether its snapshots have `tree_columns.COLUMNS`, and dead trees

    def step(self, state: State) -> State:
        """All plants older by a step."""
        return replace(state, step=state.step + 1)

    def population(self, state: State) -> Population:
        """Snapshot; z is 0. A plant of its species' largest radius is mature, any other is growing."""
        plants = state.plants
        turn, age = plants.azimuth_deg, plants.first_age_yr
        columns: dict[str, NDArray[Any]] = {"azimuth_deg": turn, "first_age_yr": age, "first_step": plants.born}
        if self.knows_trees:
            columns |= dict(zip(COLUMNS, np.ascontiguousarray(plants.tree_sizes.T), strict=True))
        snapshot = plants.population(
            state.species, state.step, state.parameters.step_yr, state.next_id, None, columns, plants.height_m
        )
        about = {**snapshot.state, "notes": list(state.notes), **state.found}
        status = np.where(plants.dead, np.uint8(Status.DEAD), snapshot.status)
        return replace(snapshot, age_yr=age + snapshot.age_yr, status=status, state=about)

    def resume(self, parameters: P, site: Site, species: Ecologies, seed: int, population: Population) -> State:
        """The state of a snapshot."""
        columns, circles = population.columns, CirclePlants.columns_of(population, parameters.step_yr)
        plants = Plants(
            **{**circles, "born": columns["first_step"]},
            height_m=population.height_m,
            azimuth_deg=columns["azimuth_deg"],
            first_age_yr=columns["first_age_yr"],
            tree_sizes=(
                np.stack([columns[name] for name in COLUMNS], axis=1)
                if self.knows_trees
                else unknown_sizes(len(population))
            ),
            dead=population.status == Status.DEAD,
        )
        found = dict(population.state)
        next_id, notes = int(found.pop("next_id")), tuple(found.pop("notes", ()))
        return State(parameters, site, tuple(species), seed, population.step, next_id, plants, notes, found)

    def check_snapshot(self, parameters: P, site: Site, species: Ecologies, population: Population) -> None:
        """Refuse turns, ages and arrivals that no plant of a snapshot has, and numbers that JSON does not know."""
        own = {
            "azimuth_deg": Limits("f8"),
            "first_age_yr": Limits("f8", 0),
            "first_step": Limits("i4", 0, population.step),
            "status": Limits("u1", 0, Status.DEAD if self.knows_trees else Status.MATURE),
        }
        if self.knows_trees:
            own |= {name: Limits("f8", 0, nan=True) for name in COLUMNS}
        check_columns(population, own)
        known = ("next_id", "notes", *self.state_keys)
        for key, value in population.state.items():
            if key not in known:
                raise ImpossibleValueError(key, f"one of {', '.join(known)}", "this key")
            check_finite(value, key)

    def remove(self, state: State, plant_id: NDArray[np.uint32]) -> State:
        """The state without these plants."""
        return replace(state, plants=state.plants.where(~np.isin(state.plants.plant_id, plant_id)))

    def plant(self, state: State, planting: Planting) -> State:
        """The state with new plants beside the others."""
        n = len(planting)
        ids = new_ids(state.next_id, n)
        new = Plants(
            x_m=planting.position_m,
            r_m=planting.radius_m,
            height_m=heights_m(state.species, planting.species, planting.radius_m),
            sp=planting.species,
            azimuth_deg=np.array([azimuth_of(state.seed, int(one)) for one in ids], dtype=np.float64),
            first_age_yr=np.zeros(n),
            tree_sizes=unknown_sizes(n),
            dead=np.zeros(n, dtype=np.bool_),
            plant_id=ids,
            born=np.full(n, state.step, dtype=np.int32),
        )
        return replace(state, next_id=state.next_id + n, plants=state.plants.and_then(new))


class StaticModel(FixedPopulation[P], ABC):
    """A `CommunityModel` whose plants are placed in step 0.

    A subclass sets `Parameters` and has the methods `place` and `most_plants`.
    """

    @abstractmethod
    def place(self, parameters: P, site: Site, species: Ecologies, rng: np.random.Generator) -> Placement:
        """The plants of step 0. All randomness comes from `rng`, which the recipe's seed decides."""

    @abstractmethod
    def most_plants(self, parameters: P, site: Site, species: Ecologies) -> float:
        """Upper bound of the mean number of plants at any step, without disturbances; 0: none. It places nothing."""

    def init(self, parameters: P, site: Site, species: Ecologies, seed: int) -> State:
        """The plants at their places. Raises `RecipeError`: `place` returned what no later stage could use."""
        placed = self.place(parameters, site, species, child_rng(seed, "community", 0))
        name = f"{type(self).__name__}.place"
        _check(placed, site, species, name)
        undeclared = sorted({*placed.found} - {*self.state_keys})
        if undeclared:
            _refuse(name, f"keys of `found` among {type(self).__name__}.state_keys", ", ".join(undeclared))
        return first_state(parameters, site, species, seed, placed)

    def expected_plants(self, parameters: P, site: Site, species: Ecologies) -> float:
        """Plants that are placed, and those that disturbances plant."""
        return float(self.most_plants(parameters, site, species) + planted(parameters.disturbances))

    def empty_reason(self, parameters: P, site: Site, species: Ecologies) -> str | None:
        """Why no plant will ever stand there, or None if some may."""
        return None if self.expected_plants(parameters, site, species) > 0 else "the model places no plant"

    def estimate_bytes(self, parameters: P, site: Site, species: Ecologies) -> int:
        """Bytes for all plants at once: a state, its successor, a snapshot, what a placement holds meanwhile."""
        return 4 * 1024 * 1024 + math.ceil(self.expected_plants(parameters, site, species) * 400)


class GrowingModel(StaticModel[P]):
    """A `CommunityModel` whose plants grow, arrive and die as the method `change` says.

    A subclass sets `Parameters` and has the methods `place`, `most_plants` and `change`.
    """

    @abstractmethod
    def change(
        self, parameters: P, site: Site, species: Ecologies, population: Population, rng: np.random.Generator
    ) -> Change:
        """What happens to the plants in the step that ends at `population.step`.

        `population` holds the plants of the step before, already a step older. All randomness comes from `rng`.
        """

    def step(self, state: State) -> State:
        """The state one step later. Raises `RecipeError`: `change` returned what no later stage could use."""
        older = super().step(state)
        before, name = older.plants, f"{type(self).__name__}.change"
        rng = child_rng(state.seed, "community", older.step)
        change = self.change(state.parameters, state.site, state.species, self.population(older), rng)  # type: ignore[arg-type]
        if not isinstance(change, Change):
            _refuse(name, "a Change", type(change).__name__)
        radius_m = before.r_m if change.radius_m is None else change.radius_m
        height_m = before.height_m if change.height_m is None else change.height_m
        dead = np.zeros(len(before), dtype=bool) if change.dead is None else change.dead
        for array, what in ((radius_m, "radius_m"), (height_m, "height_m"), (dead, "dead")):
            if np.shape(array) != (len(before),):
                _refuse(name, f"{what} of {len(before)} plants", f"shape {np.shape(array)}")
        if change.radius_m is not None and change.height_m is None:
            height_m = heights_m(state.species, before.sp, radius_m)
        grown = replace(before, r_m=np.asarray(radius_m, np.float64), height_m=np.asarray(height_m, np.float64))
        alive = grown.where(~np.asarray(dead, dtype=bool))
        _check(Placement(alive.sp, alive.x_m, alive.r_m, alive.height_m), state.site, state.species, name)
        after, new = replace(older, plants=alive), change.arrivals
        if new is None:
            return after
        _check(new, state.site, state.species, name)
        after = self.plant(after, Planting(new.species.astype(np.uint16), new.position_m, new.radius_m))
        if new.height_m is None:
            return after
        return replace(after, plants=replace(after.plants, height_m=np.concatenate([alive.height_m, new.height_m])))


def _check(placed: object, site: Site, species: Ecologies, name: str) -> None:
    """Raise `RecipeError` for the first plant that no later stage could use; `name`: the method that returned it."""
    if not isinstance(placed, Placement):
        _refuse(name, "a Placement", type(placed).__name__)
    if not len(placed.species):
        return
    if not np.all((placed.species >= 0) & (placed.species < len(species))):
        _refuse(name, f"species as indices below {len(species)}", str(placed.species.max()))
    beyond = ~np.all((placed.position_m >= 0) & (placed.position_m <= np.asarray(site.size_m)), axis=1)
    if beyond.any():
        _refuse(name, "position_m on the site", str(placed.position_m[beyond][0]))
    largest = of_species(species, "max_radius_m")[placed.species]
    sized = (placed.radius_m > 0) & (placed.radius_m <= largest)
    if not sized.all():
        worst = int(np.flatnonzero(~sized)[0])
        _refuse(name, f"radius_m in (0, {largest[worst]:g}]", f"{placed.radius_m[worst]:g}")
    if placed.height_m is not None and not np.all(np.isfinite(placed.height_m) & (placed.height_m > 0)):
        _refuse(name, "positive height_m", f"{np.min(placed.height_m):g}")


def _refuse(name: str, expected: str, got: str) -> NoReturn:
    raise RecipeError(f"{name} returned what no later stage can use", expected=expected, got=got)
