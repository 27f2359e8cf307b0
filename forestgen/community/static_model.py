"""Base classes for community models of other packages; docs/tutorials/plugin.md writes two.

A `StaticModel` says where plants stand (`place`) and how many there are at most (`most_plants`). The class has the rest
of `CommunityModel`: steps, snapshots, resuming, disturbances, memory. A step of Δt years makes every plant older, and
nothing else: plants neither grow, compete, arrive nor die. Only disturbances (`community.disturbances`) add or remove
plants. A `GrowingModel` also says what a step does to plants (`change`).

A model that knows sizes of its trees, or which of them are dead, sets `knows_trees` and returns them as `tree_sizes`
and `dead`, with `dead_form` and `decay_class`. What it does not say follows from a tree's height and neighbours
(`tree_columns`), and from its new height where a step changed that.
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
from forestgen.core.dead_wood import CLASSES, UNKNOWN_CLASS, DeadForm
from forestgen.core.errors import RecipeError
from forestgen.core.randomness import child_rng
from forestgen.recipe.fields import Whole


class StaticParameters(CommunityParameters):
    """Keys of a static model; a model adds its own in a subclass."""

    steps: Whole = Field(0, ge=0, le=100_000, description="number of steps")
    step_yr: float = Field(1.0, gt=0, description="duration of a step, years")


P = TypeVar("P", bound=StaticParameters)
TreeColumns = Mapping[str, Floats]  # name of `tree_columns.COLUMNS` -> (N,), NaN where it is not known
_RANGES = dict(zip(COLUMNS, ("above 0", "above 0", "from 0 to the height", "of at least 0"), strict=True))
_OF_TREES = ("dead", "age_yr", "azimuth_deg", "dead_form", "decay_class")


@dataclass(frozen=True)
class Placement:
    """Plants that a static model places, one row a plant."""

    species: NDArray[np.integer]  # (N,) index of species
    position_m: Floats  # (N, 2) world x and y, on the site
    radius_m: Floats  # (N,) 0 < r <= the species' max_radius_m
    height_m: Floats | None = None  # (N,) None: by the species' allometry
    notes: tuple[str, ...] = ()  # for users, such as that not all plants found a place
    found: Mapping[str, Any] = field(default_factory=dict)  # what the model worked out, as in JSON; keys: `state_keys`
    tree_sizes: TreeColumns = field(default_factory=dict)  # (N,) each of `tree_columns.COLUMNS` that the model knows
    dead: NDArray[np.bool_] | None = None  # (N,) dead trees; None: all live
    age_yr: Floats | None = None  # (N,) None: 0
    azimuth_deg: Floats | None = None  # (N,) turn about the vertical, or where what lies points; NaN: random
    dead_form: NDArray[np.integer] | None = None  # (N,) `core.dead_wood.DeadForm` of the dead; None: they stand
    decay_class: NDArray[np.integer] | None = None  # (N,) 1 to 5 of the dead; None: `UNKNOWN_CLASS`

    def __post_init__(self) -> None:
        object.__setattr__(self, "tree_sizes", {key: np.asarray(one) for key, one in self.tree_sizes.items()})
        for name in ("species", "position_m", "radius_m", "height_m", *_OF_TREES):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, np.asarray(getattr(self, name)))
        n, found = self.species.size, {"position_m": self.position_m, **self.tree_sizes}
        found |= {name: getattr(self, name) for name in ("species", "radius_m", "height_m", *_OF_TREES)}
        for name, one in found.items():
            shape = (n, 2) if name == "position_m" else (n,)
            if one is not None and one.shape != shape:
                problem, expected = "the arrays of a Placement do not fit", f"{name} of shape {shape}, a row a plant"
                raise RecipeError(problem, expected=expected, got=str(one.shape))


@dataclass(frozen=True)
class Change:
    """What a step does to plants; arrays have one row a plant of the population that `change` was given."""

    dead: NDArray[np.bool_] | None = None  # (N,) these are gone; None: all live
    radius_m: Floats | None = None  # (N,) after the step; None: as before
    height_m: Floats | None = None  # (N,) None: as before, or by the species' allometry where radius_m is given
    arrivals: Placement | None = None  # new plants; only `Placement.notes` and `found` of step 0 are kept
    tree_sizes: TreeColumns = field(default_factory=dict)  # (N,) each; others as before where the height is as before


@dataclass(frozen=True)
class Plants(CirclePlants):
    """One row a plant, in order of plant_id."""

    height_m: Floats  # (N,) metres
    azimuth_deg: Floats  # (N,) turn about the vertical, clockwise from above
    first_age_yr: Floats  # (N,) at the step of arrival
    tree_sizes: Floats  # (N, 4) `tree_columns.COLUMNS`, NaN where unknown
    dead_form: NDArray[np.uint8]  # (N,) `core.dead_wood.DeadForm`, 0 of the living
    decay_class: NDArray[np.uint8]  # (N,) 1 to 5; 0 of the living


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


def _plants_of(
    placed: Placement, species: Ecologies, ids: NDArray[np.uint32], azimuth_deg: Floats, step: int
) -> Plants:
    """Plants that arrive in a step; `azimuth_deg`: (N,) of those whose turn the placement does not say."""
    n, height_m = len(ids), placed.height_m
    if height_m is None:
        height_m = heights_m(species, placed.species, placed.radius_m)
    if placed.azimuth_deg is not None:
        azimuth_deg = np.where(np.isnan(placed.azimuth_deg), azimuth_deg, placed.azimuth_deg)
    dead = np.zeros(n, dtype=np.bool_) if placed.dead is None else placed.dead
    form = DeadForm.STANDING if placed.dead_form is None else placed.dead_form
    decay = UNKNOWN_CLASS if placed.decay_class is None else placed.decay_class
    return Plants(
        x_m=np.ascontiguousarray(placed.position_m, dtype=np.float64),
        r_m=np.ascontiguousarray(placed.radius_m, dtype=np.float64),
        height_m=np.ascontiguousarray(height_m, dtype=np.float64),
        sp=np.ascontiguousarray(placed.species, dtype=np.uint16),
        azimuth_deg=azimuth_deg,
        first_age_yr=np.zeros(n) if placed.age_yr is None else placed.age_yr.astype(np.float64),
        tree_sizes=_sizes_of(placed.tree_sizes, unknown_sizes(n)),
        dead_form=np.where(dead, form, 0).astype(np.uint8),
        decay_class=np.where(dead, decay, 0).astype(np.uint8),
        plant_id=ids,
        born=np.full(n, step, dtype=np.int32),
    )


def _sizes_of(given: TreeColumns, others: Floats) -> Floats:
    """(N, 4) sizes as a model gives them, and `others` of the columns that it leaves out."""
    columns = [given.get(name, others[:, index]) for index, name in enumerate(COLUMNS)]
    return np.stack(columns, axis=1).astype(np.float64)


def first_state(parameters: CommunityParameters, site: Site, species: Ecologies, seed: int, placed: Placement) -> State:
    """The state of step 0 of plants that have just been placed, numbered from 1 in the order given."""
    n = len(placed.species)
    azimuth_deg = child_rng(seed, "placement azimuths").uniform(0.0, 360.0, n)
    plants = _plants_of(placed, species, new_ids(1, n), azimuth_deg, 0)
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
            columns |= {"dead_form": plants.dead_form, "decay_class": plants.decay_class}
        snapshot = plants.population(
            state.species, state.step, state.parameters.step_yr, state.next_id, None, columns, plants.height_m
        )
        about = {**snapshot.state, "notes": list(state.notes), **state.found}
        status = np.where(plants.dead_form > 0, np.uint8(Status.DEAD), snapshot.status)
        return replace(snapshot, age_yr=age + snapshot.age_yr, status=status, state=about)

    def resume(self, parameters: P, site: Site, species: Ecologies, seed: int, population: Population) -> State:
        """The state of a snapshot."""
        columns, circles = population.columns, CirclePlants.columns_of(population, parameters.step_yr)
        zeros = np.zeros(len(population), dtype=np.uint8)
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
            dead_form=columns.get("dead_form", zeros),
            decay_class=columns.get("decay_class", zeros),
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
            own |= {"dead_form": Limits("u1", 0, max(DeadForm)), "decay_class": Limits("u1", 0, CLASSES)}
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
        return with_arrivals(state, Placement(planting.species, planting.position_m, planting.radius_m))


def with_arrivals(state: State, placed: Placement) -> State:
    """The state with new plants beside the others, numbered on from theirs."""
    n = len(placed.species)
    ids = new_ids(state.next_id, n)
    azimuth_deg = np.array([azimuth_of(state.seed, int(one)) for one in ids], dtype=np.float64)
    new = _plants_of(placed, state.species, ids, azimuth_deg, state.step)
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
        _check(placed, site, species, name, knows_trees=self.knows_trees)
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
        for what, array in {"radius_m": radius_m, "height_m": height_m, "dead": dead, **change.tree_sizes}.items():
            if np.shape(array) != (len(before),):
                _refuse(name, f"{what} of {len(before)} plants", f"shape {np.shape(array)}")
        if change.radius_m is not None and change.height_m is None:
            height_m = heights_m(state.species, before.sp, radius_m)
        same = np.asarray(height_m == before.height_m)[:, None]
        sizes = _sizes_of(change.tree_sizes, np.where(same, before.tree_sizes, np.nan))
        grown = replace(
            before,
            r_m=np.asarray(radius_m, np.float64),
            height_m=np.asarray(height_m, np.float64),
            tree_sizes=sizes,
        )
        keep = ~np.asarray(dead, dtype=bool)
        alive, given = grown.where(keep), {key: np.asarray(one)[keep] for key, one in change.tree_sizes.items()}
        after = Placement(alive.sp, alive.x_m, alive.r_m, alive.height_m, tree_sizes=given)
        for placed in (after, *([] if change.arrivals is None else [change.arrivals])):
            _check(placed, state.site, state.species, name, knows_trees=self.knows_trees)
        left = replace(older, plants=alive)
        return left if change.arrivals is None else with_arrivals(left, change.arrivals)


def _check(placed: object, site: Site, species: Ecologies, name: str, *, knows_trees: bool) -> None:
    """Raise `RecipeError` for the first plant that no later stage could use; `name`: the method that returned it."""
    if not isinstance(placed, Placement):
        _refuse(name, "a Placement", type(placed).__name__)
    if not knows_trees and (placed.tree_sizes or placed.dead is not None):
        got = ", ".join([*placed.tree_sizes, *(["dead"] if placed.dead is not None else [])])
        _refuse(name, "`knows_trees = True` in the class of a model that says this of its trees", got)
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
    _check_trees(placed, species, name)


def _check_trees(placed: Placement, species: Ecologies, name: str) -> None:
    """Refuse what no tree is, and sizes of plants that are none."""
    height_m = heights_m(species, placed.species, placed.radius_m) if placed.height_m is None else placed.height_m
    is_tree = np.array([one.tree is not None for one in species], dtype=np.bool_)[placed.species]
    for key, values in placed.tree_sizes.items():
        if key not in COLUMNS:
            _refuse(name, f"tree_sizes among {', '.join(COLUMNS)}", key)
        if values.dtype.kind not in "fiu":
            _refuse(name, f"{key} as numbers", str(values.dtype))
        least = values > 0.0 if _RANGES[key] == "above 0" else values >= 0.0
        most = height_m if key == "crown_base_m" else np.inf
        good = np.isnan(values) | (is_tree & least & (values <= most) & np.isfinite(values))
        if not good.all():
            row = int(np.flatnonzero(~good)[0])
            expected = f"{key} {_RANGES[key]}, of trees, whose species have a section `tree`; NaN of others"
            _refuse(name, expected, f"{values[row]:g} of {species[placed.species[row]].name}, {height_m[row]:g} m tall")
    if placed.dead is not None and placed.dead.dtype != np.bool_:
        _refuse(name, "dead as true or false", str(placed.dead.dtype))
    for key, most in (("dead_form", max(DeadForm)), ("decay_class", CLASSES)):
        values, dead = getattr(placed, key), placed.dead
        if values is not None and (dead is None or not np.all((values[dead] >= 1) & (values[dead] <= most))):
            _refuse(name, f"{key} from 1 to {most}, of trees that are dead", "others")
    if placed.age_yr is not None and not np.all(np.isfinite(placed.age_yr) & (placed.age_yr >= 0)):
        _refuse(name, "age_yr of at least 0", f"{np.min(placed.age_yr):g}")
    if placed.azimuth_deg is not None and np.isinf(placed.azimuth_deg).any():
        _refuse(name, "azimuth_deg, or NaN", "infinity")


def _refuse(name: str, expected: str, got: str) -> NoReturn:
    raise RecipeError(f"{name} returned what no later stage can use", expected=expected, got=got)
