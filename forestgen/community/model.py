"""What every community model offers: parameters, methods and what they promise; and a simulation, step by step."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from forestgen.community.disturbance import Disturbance, Ground, Planting
from forestgen.community.population import Ecologies, Population, Site
from forestgen.core.randomness import child_rng
from forestgen.recipe.fields import Whole, violation
from forestgen.recipe.messages import show
from forestgen.recipe.sources import Keys


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
                state = model.plant(state, one.plant.planting(ground, species, rng))
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
