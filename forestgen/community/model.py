"""What every community model offers, and what it gets: parameters, the site, the species' ecology."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from forestgen.community.disturbance import Disturbance, Ground, Plant, Planting
from forestgen.community.population import Floats, Population
from forestgen.core.randomness import child_rng
from forestgen.recipe.fields import Whole, violation
from forestgen.recipe.messages import show
from forestgen.recipe.sources import Keys
from forestgen.recipe.species import Building, PlantType, Species

GroundHeight = Callable[[Floats, Floats], Floats]


@dataclass(frozen=True)
class Site:
    """The ground of a community: the rectangle [0, W] x [0, H] in world x and y, metres."""

    size_m: tuple[float, float]
    height: GroundHeight | None = None  # of the ground at x and y of any shape, metres; None: flat
    altitude_m: float = 0.0  # of z = 0 above sea level
    latitude_deg: float = 50.0  # north is positive
    wind_from_deg: float = 270.0  # where the prevailing wind comes from, clockwise from north
    buildings: tuple[Building, ...] = field(default=(), hash=False)

    def __post_init__(self) -> None:
        if len(self.size_m) != 2 or not all(math.isfinite(side) and side > 0 for side in self.size_m):
            raise ValueError(f"size_m must be two positive lengths in metres, got {self.size_m!r}")

    @property
    def area_m2(self) -> float:
        return self.size_m[0] * self.size_m[1]

    @property
    def area_ha(self) -> float:
        return self.area_m2 / 1e4


@dataclass(frozen=True)
class SpeciesEcology:
    """How a species lives, as far as a community model cares; the recipe's section checks the numbers.

    References
    ----------
    B. Lane, Models of Plant Communities for Image Synthesis, University of Calgary, 2002, chapters 4 and 6.
    """

    name: str  # as in the recipe
    growth_m_per_yr: float  # radial growth of an undominated plant, m/yr, >= 0
    max_radius_m: float  # R, m, > 0: a plant that reaches it is mature
    shade_tolerance: float  # shaded[sp]: probability in [0, 1] that a dominated plant survives a step
    old_age_survival: float  # oldage[sp]: probability in [0, 1] that a mature plant survives a step
    seedlings_per_ha_per_yr: float  # mean number of seedlings that arrive, 1/(ha yr), >= 0
    seedling_radius_m: float  # mean radius of an arriving seedling, m, > 0
    height_scale: float  # A_H of H = A_H r^c_H, metres of height at r = 1 m, > 0
    height_exponent: float  # c_H of H = A_H r^c_H, >= 0
    modules: PlantType | None = None  # how it grows as a graph of branch modules; None: not at all


Ecologies = Sequence[SpeciesEcology]  # the recipe's species, in its order: a species index counts them


def ecology_of(name: str, species: Species) -> SpeciesEcology:
    """The ecology of a recipe's species."""
    law, own = species.allometry.height_m, species.ecology.model_dump()
    return SpeciesEcology(name, height_scale=law.scale, height_exponent=law.exponent, modules=species.modules, **own)


def none_is(empty: object) -> BeforeValidator:
    """Validator of a list or mapping whose key stands there without a value."""
    return BeforeValidator(lambda value: empty if value is None else value)


class CommunityParameters(BaseModel):
    """What a recipe's community section says besides the model's name; each model adds its own keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    planting_columns: ClassVar[tuple[str, ...]] = ()  # a model's own columns that a planting may set
    timed_keys: ClassVar[Mapping[str, type[Any]]] = {"disturbances": Disturbance}  # lists of entries with a `step`
    free_keys: ClassVar[tuple[str, ...]] = ("steps",)  # that no step depends on
    is_random: ClassVar[bool] = True  # whether another seed gives other plants
    memory_hint: ClassVar[str] = "make the site smaller, or lower species' seedlings_per_ha_per_yr"

    steps: Whole = Field(300, ge=0, le=100_000, description="number of steps")
    step_yr: float = Field(0.5, gt=0, description="duration of a step, years")
    periodic: bool = Field(True, description="the site is a torus, without edges; false: a bounded site")
    disturbances: Annotated[tuple[Disturbance, ...], none_is(())] = Field(
        (), description="fellings, fires and plantings, in the order in which those of one step are applied"
    )

    @model_validator(mode="before")
    @classmethod
    def _no_keys_of_another_model(cls, data: Any) -> Any:
        """Refuse another model's key as such: a similar key of this one would mean something else."""
        for key in map(str, data) if isinstance(data, Mapping) else ():
            if key not in cls.model_fields and (owners := _models_with(key)):
                expected, problem = f"one of {', '.join(cls.model_fields)}", f"another model's key, {key!r}"
                hint = f"{key} is a key of {', '.join(owners)}: choose that as community.model, or leave the key out"
                raise violation(expected, problem=problem, got=show(data[key]), hint=hint, at=(key,))
        return data

    @model_validator(mode="after")
    def _plantings_have_known_columns(self) -> Self:
        for index, one in enumerate(self.disturbances):
            if one.plant is not None and one.plant.vigour is not None and "vigour" not in self.planting_columns:
                expected, problem = "a planting without vigour", "plants of this model have no vigour"
                got = f"{one.plant.vigour:g}"
                raise violation(expected, problem=problem, got=got, at=("disturbances", index, "plant", "vigour"))
        return self

    def for_trial(self) -> Self:
        """The parameters of a trial on a small site, which shows what columns the plants have."""
        return self

    def named_species(self) -> Iterator[tuple[Keys, str]]:
        """Key path and name of every species that the parameters name."""
        for index, one in enumerate(self.disturbances):
            yield from ((("disturbances", index, *keys), name) for keys, name in one.named_species())


def _models_with(key: str) -> list[str]:
    """Names of the community models whose parameters have this key."""
    from forestgen.community.registry import COMMUNITY_MODELS  # imports all models: only for a violation

    return sorted(name for name, one in COMMUNITY_MODELS.parts() if key in one.Parameters.model_fields)


P = TypeVar("P", bound=CommunityParameters)
S = TypeVar("S")


class CommunityModel(Protocol[P, S]):
    """A family of interchangeable models. A model has no state of its own: everything is in `S`.

    Randomness of step k comes from ``child_rng(seed, "community", k)`` (k = 0: `init`), and `population` holds
    everything that the future depends on: a simulation resumes from any snapshot to the same future, to the bit.
    """

    Parameters: type[P]

    def init(self, parameters: P, site: Site, species: Ecologies, seed: int) -> S:
        """State of step 0."""

    def step(self, state: S) -> S:
        """State one step later; `state` itself is left as it was."""

    def population(self, state: S) -> Population:
        """Snapshot of a state; its `state` has `next_id`, the id of the next plant to arrive."""

    def resume(self, parameters: P, site: Site, species: Ecologies, seed: int, population: Population) -> S:
        """The state that a snapshot was made of; the inverse of `population`."""

    def check_snapshot(self, parameters: P, site: Site, species: Ecologies, population: Population) -> None:
        """Raise `ImpossibleValueError` for a model's own columns or state that no snapshot of it has.

        Of a snapshot from a file, before `resume`; `snapshot_checks.check_snapshot` has been through it.
        """

    def remove(self, state: S, plant_id: NDArray[np.uint32]) -> S:
        """A disturbance: the state without these plants, in the same step; ids of no plant are ignored."""

    def plant(self, state: S, planting: Planting) -> S:
        """A disturbance: the state in which new plants stand there, in the same step, numbered as they are given."""

    def expected_plants(self, parameters: P, site: Site, species: Ecologies) -> float:
        """Upper bound of the mean number of plants at any step; 0: no plant can ever grow."""

    def empty_reason(self, parameters: P, site: Site, species: Ecologies) -> str | None:
        """Why no plant can ever grow, or None if one may."""

    def estimate_bytes(self, parameters: P, site: Site, species: Ecologies) -> int:
        """Upper estimate of the peak memory of one simulation, one snapshot included; cheap, simulates nothing.

        A caller that keeps a history holds its snapshots on top of this.
        """


def simulate(
    model: CommunityModel[P, S],
    parameters: P,
    site: Site,
    species: Ecologies,
    seed: int,
    *,
    steps: int,
    start: Population | None = None,
) -> Iterator[Population]:
    """The population at step 0, 1, ..., `steps`, each made when it is asked for, with the disturbances applied.

    From `start`, a snapshot of the same simulation, it goes on instead: `start` itself comes first.
    """
    ground = Ground(site.size_m, parameters.periodic)

    def disturbed(state: S, step: int) -> S:
        """The state after the disturbances of its step, in their order."""
        for index, one in enumerate(parameters.disturbances):
            if one.step(parameters.step_yr) != step:
                continue
            rng = child_rng(seed, "disturbance", index)
            if one.plant is not None:
                state = model.plant(state, planting_of(one.plant, ground, species, rng))
            else:
                state = model.remove(state, one.affected_plants(model.population(state), ground, rng))
        return state

    if start is None:
        first, state = 0, disturbed(model.init(parameters, site, species, seed), 0)
    else:  # a snapshot is made after its step's disturbances
        first, state = start.step, model.resume(parameters, site, species, seed, start)
    yield model.population(state)
    for step in range(first + 1, steps + 1):
        state = disturbed(model.step(state), step)
        yield model.population(state)


def planting_of(plant: Plant, ground: Ground, species: Ecologies, rng: np.random.Generator) -> Planting:
    """The plants that a disturbance adds, with their places drawn."""
    index, n = [one.name for one in species].index(plant.species), plant.number
    if plant.positions_m is None:
        position_m = plant.random_places(n, ground, rng)
    else:
        position_m = np.array(plant.positions_m, dtype=np.float64).reshape(-1, 2)
    radius_m = species[index].seedling_radius_m if plant.radius_m is None else plant.radius_m
    radius_m = min(radius_m, species[index].max_radius_m)
    columns = {} if plant.vigour is None else {"vigour": np.full(n, plant.vigour)}
    return Planting(np.full(n, index, dtype=np.uint16), position_m, np.full(n, radius_m), columns)
