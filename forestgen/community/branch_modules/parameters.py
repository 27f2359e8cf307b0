"""What a recipe says about the model of branch modules besides its species (Makowski 2023, section 2.6).

Some values may change on the way::

    community:
      changes:
        - {at_yr: 50, set: {temperature_c: 9, species.pine.shade_tolerance: 0.2}}

A change is made at the end of the step that reaches its time, as a disturbance is: what happens from then on goes by
the new values. So the step from k to k + 1 goes by `parameters_at(parameters, types, k)`, which depends on k alone: a
simulation that resumes there goes by the same. Changes of one step are made in the order of the list.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    Field,
    TypeAdapter,
    ValidationError,
    WithJsonSchema,
    model_validator,
)

from forestgen.community.disturbance import KINDS
from forestgen.community.model import CommunityParameters
from forestgen.community.placement.density_map import DensityMap
from forestgen.recipe.biome import COLDEST_C, DRIEST_MM, WARMEST_C, WETTEST_MM
from forestgen.recipe.fields import Flag, Fraction, NonNegative, Number, Positive, Section, Text, Whole, violation
from forestgen.recipe.messages import show
from forestgen.recipe.sources import Keys
from forestgen.recipe.species import PlantType
from forestgen.recipe.suggestions import nearest

BLOCKED_ABOVE = 0.5  # a soil map's values above this bar plants
MOST_PLANTS = 1_000_000  # at the start
#: Keys of the section that a simulation starts with, and cannot change on its way.
FIXED = (
    "steps", "step_yr", "periodic", "disturbances", "initial_plants", "biome", "soil", "changes",
    "standing_dead_yr", "dieback_share", "most_modules", "history_modules",
)  # fmt: skip


class Change(Section):
    """Other values of some parameters."""

    at_yr: NonNegative = Field(le=1e6, description="Time from which they hold, years.")
    set: dict[str, Any] = Field(
        min_length=1, description="New values by key: of this section, or species.NAME.KEY of a species' modules."
    )

    @model_validator(mode="before")
    @classmethod
    def _is_no_disturbance(cls, data: Any) -> Any:
        for key in data if isinstance(data, Mapping) else ():
            kind = None if key in cls.model_fields else nearest(str(key), KINDS)
            if kind is not None:
                hint = f"a change sets numbers; write disturbances: [{{at_yr: ..., {kind}: ...}}] beside changes"
                raise violation("at_yr and set", problem=f"unknown key {str(key)!r}", hint=hint, at=(str(key),))
        return data

    @model_validator(mode="after")
    def _can_be_changed(self) -> Self:
        for key in self.set:
            if key in FIXED:
                expected, got = "a key that may change with time", show(self.set[key])
                raise violation(expected, problem=f"{key} holds for the whole simulation", got=got, at=("set", key))
            if key.startswith("species") and species_key(key) is None:
                expected = "species.NAME.KEY, such as species.pine.shade_tolerance"
                raise violation(expected, problem="this names no key of a species", got=repr(key), at=("set", key))
        return self

    def step(self, step_yr: float) -> int:
        """The step at whose end it is made."""
        # Whole numbers of steps, such as 0.3 years in steps of 0.1, must not be missed by a rounding error.
        return math.ceil(self.at_yr / step_yr * (1 - 1e-9))

    def split(self) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """The new values of the section, and those of each species' modules."""
        own: dict[str, Any] = {}
        of_species: dict[str, dict[str, Any]] = {}
        for key, value in self.set.items():
            parts = species_key(key)
            if parts is None:
                own[key] = value
            else:
                of_species.setdefault(parts[0], {})[parts[1]] = value
        return own, of_species


def species_key(key: str) -> tuple[str, str] | None:
    """Name and key of ``species.NAME.KEY``; None: a key of the section itself."""
    parts = key.split(".")
    return (parts[1], parts[2]) if len(parts) == 3 and parts[0] == "species" else None


def _within(low: float, high: float, unit: str) -> AfterValidator:
    def check(value: float) -> float:
        if not low <= value <= high:
            raise violation(f"{low:g} to {high:g} {unit}", problem="no such climate", got=f"{value:g} {unit}")
        return value

    return AfterValidator(check)


_WARMTH = Field(json_schema_extra={"minimum": COLDEST_C, "maximum": WARMEST_C})
_RAIN = Field(json_schema_extra={"minimum": DRIEST_MM, "maximum": WETTEST_MM})
Temperature = Annotated[Number, _within(COLDEST_C, WARMEST_C, "deg C"), _WARMTH]
Precipitation = Annotated[Number, _within(DRIEST_MM, WETTEST_MM, "mm a year"), _RAIN]
_CLIMATE = {"temperature_c": TypeAdapter(Temperature), "precipitation_mm_per_yr": TypeAdapter(Precipitation)}


class Biome(Section):
    """What the climate was chosen by: two numbers, or a place with known normals."""

    temperature_c: Temperature | None = Field(None, description="Mean temperature, deg C, -10 to 33.")
    precipitation_mm_per_yr: Precipitation | None = Field(None, description="Precipitation, mm/year, 10 to 4300.")
    place: Text | None = Field(
        None,
        description="A station of the climate normals that come with forestgen. Where a number stands beside it, that "
        "number goes before the place's.",
    )


def _number_or_by_species(value: Any) -> Any:
    """One number as it is; what is neither that nor a mapping is refused here, with both forms named."""
    if isinstance(value, Mapping):
        if _ALL in value and len(value) > 1:
            raise violation("numbers by species, or one number for all", got=", ".join(map(str, value)))
        return value
    whole = isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= MOST_PLANTS
    if not whole or value != int(value):
        raise violation(f"a whole number from 0 to {MOST_PLANTS}, or such numbers by species")
    return {_ALL: int(value)}


_ALL = "*"  # no species has this name
_Count = Annotated[Whole, Field(ge=0, le=MOST_PLANTS)]
_NUMBER_SCHEMA = {"type": "integer", "minimum": 0, "maximum": MOST_PLANTS}
_SCHEMA = {"anyOf": [_NUMBER_SCHEMA, {"type": "object", "additionalProperties": _NUMBER_SCHEMA}], "default": 100}
InitialPlants = Annotated[dict[str, _Count], BeforeValidator(_number_or_by_species), WithJsonSchema(_SCHEMA)]


class BranchModulesParameters(CommunityParameters):
    """What a recipe says about the model besides its species."""

    timed_keys: ClassVar[Mapping[str, type[Any]]] = {**CommunityParameters.timed_keys, "changes": Change}
    free_keys: ClassVar[tuple[str, ...]] = (*CommunityParameters.free_keys, "history_modules")
    memory_hint: ClassVar[str] = "make the site smaller, or lower community.most_modules"

    steps: Whole = Field(200, ge=0, le=100_000, description="number of steps")
    step_yr: float = Field(1.0, ge=1e-3, le=10, description="duration of a step, years")
    periodic: bool = Field(False, description="the site is a torus, without edges; false: a bounded site")
    initial_plants: InitialPlants = Field(
        100,
        validate_default=True,
        description="plants at the start, at random places: one number, shared evenly by the species that grow; or "
        "numbers by species, where those not named have none. Where a biome chooses the species, 0.2 a square metre if "
        "not given, 2000 at most; these, or any one number, are then shared by how well the climate suits each species",
    )
    temperature_c: Temperature | None = Field(
        None, description="mean temperature at z = 0, deg C, -10 to 33; null: what each species likes best"
    )
    precipitation_mm_per_yr: Precipitation | None = Field(
        None, description="precipitation, mm/year, 10 to 4300; null: what each species likes best"
    )
    biome: Biome | None = Field(
        None,
        description="instead of the two: the same numbers, or a place, beside which a number given goes before the "
        "place's; species then need not be named, and are chosen by climate. temperature_c and "
        "precipitation_mm_per_yr of this section, where given, go before the biome's for growth, not for that choice",
    )
    lapse_rate_k_per_km: Number = Field(
        -6.5, ge=-20, le=0, description="change of temperature with elevation above z = 0, K/km, not above 0"
    )
    adaptation_min: Fraction = Field(0.05, description="no seed germinates where the climate suits it less than this")
    soil: DensityMap | None = Field(
        None, description="where nothing grows, such as streets and water: values above 0.5 of this map bar plants"
    )
    changes: tuple[Change, ...] = Field(
        (),
        max_length=10_000,
        description="other values of this section's keys, or of `species.NAME.KEY` of a species' modules, from some "
        "year on",
    )
    crowding: NonNegative = Field(
        4.0, le=100, description="what a sphere's overlap with others, by its own volume, counts against its light"
    )
    sphere_scale: Positive = Field(1.0, ge=0.1, le=3, description="factor on the radius of the modules' spheres")
    orient: Flag = Field(True, description="whether modules are turned away from others and to their tropism's angle")
    orientation_steps: Whole = Field(3, ge=0, le=50, description="turns of a new module")
    turning_steps: Whole = Field(
        1, ge=0, le=50, description="further turns a step of a module that grows and bears no other"
    )
    turn_rad: Positive = Field(0.2, le=1.6, description="angle of a turn [alpha of Eq. 5], radians")
    global_shade: Flag = Field(True, description="whether plants shade what stands below them (section 2.6.2)")
    cell_m: Positive = Field(2.0, ge=0.25, le=50, description="side of a cell of the grid of shadows, metres")
    senescence_yr: Positive = Field(
        20.0, le=10_000, description="years after its life span in which a plant's greatest vigour falls to 0"
    )
    seedling_spacing_m: NonNegative = Field(
        0.8, le=100, description="no seed germinates nearer than this to a plant's foot, metres"
    )
    standing_dead_yr: NonNegative = Field(
        0.0, le=10_000, description="years after which half of the dead trees over 1.3 m have fallen; 0: none stands"
    )
    dieback_share: Fraction = Field(
        0.0,
        description="a plant over 1.3 m that has died back to less than this share of its greatest height is dead; 0: "
        "only one that has lost all of its modules is",
    )
    most_modules: Whole = Field(
        10_000_000, ge=1, le=200_000_000, description="stop with a message where the community has more modules"
    )
    history_modules: Flag = Field(
        False, description="whether a history keeps each plant's modules too, from which a simulation can be resumed"
    )

    @model_validator(mode="before")
    @classmethod
    def _buildings_are_the_sites(cls, data: Any) -> Any:
        if isinstance(data, Mapping) and "obstacles" in data:
            expected, got = "site.buildings: [{position_m: [...], size_m: [...]}]", show(data["obstacles"])
            raise violation(expected, problem="obstacles are buildings of the site", got=got, at=("obstacles",))
        return data

    @model_validator(mode="before")
    @classmethod
    def _numbers_of_the_biome(cls, data: Any) -> Any:
        """A biome by two numbers is a climate; one by place was looked up before the model sees it."""
        biome = data.get("biome") if isinstance(data, Mapping) else None
        if not isinstance(biome, Mapping | Biome):
            return data
        numbers = biome if isinstance(biome, Mapping) else biome.model_dump()
        taken = {}
        for key, kind in _CLIMATE.items():
            try:
                taken[key] = kind.validate_python(numbers[key]) if data.get(key) is None else data[key]
            except (KeyError, ValidationError):
                continue  # the biome's own check says what is wrong
        return {**data, **taken}

    @model_validator(mode="after")
    def _whole_climate(self) -> Self:
        missing = [key for key in _CLIMATE if getattr(self, key) is None]
        if len(missing) == 1:
            given = next(key for key in _CLIMATE if key not in missing)
            raise violation(missing[0], problem="half a climate", got=f"{given} alone", at=(given,))
        if missing and self.biome is not None:
            expected = "temperature_c and precipitation_mm_per_yr, or a place"
            raise violation(expected, problem="a biome without a climate", at=("biome",))
        return self

    @model_validator(mode="after")
    def _some_ground_is_open(self) -> Self:
        blocked = self.blocked_soil()
        if blocked is not None and blocked.all():
            expected = f"a value of at most {BLOCKED_ABOVE:g}, where plants may grow"
            got = f"values from {self.soil.values().min():g}" if self.soil is not None else None
            hint = "1 is blocked and 0 is open: invert: true turns a map round"
            raise violation(expected, problem="the soil map bars the whole site", got=got, hint=hint, at=("soil",))
        return self

    def blocked_soil(self) -> NDArray[np.bool_] | None:
        """(rows, cols) whether the soil map bars each of its pixels, row 0 at y = 0; None: no map, all is open."""
        return None if self.soil is None else self.soil.values() > BLOCKED_ABOVE

    def counts(self, names: Sequence[str]) -> NDArray[np.int64]:
        """(T,) plants of each of the species that grow at the start; what a number leaves over goes to the first."""
        if _ALL not in self.initial_plants:
            return np.array([self.initial_plants.get(name, 0) for name in names], dtype=np.int64)
        total, kinds = self.initial_plants[_ALL], max(1, len(names))
        return np.array([total // kinds + (index < total % kinds) for index in range(len(names))], dtype=np.int64)

    def named_species(self) -> Iterator[tuple[Keys, str]]:
        yield from super().named_species()
        yield from ((("initial_plants", name), name) for name in self.initial_plants if name != _ALL)
        for index, change in enumerate(self.changes):
            for key in change.set:
                if (parts := species_key(key)) is not None:
                    yield ("changes", index, "set", key), parts[0]


def is_blocked(
    blocked: NDArray[np.bool_] | None, position_m: NDArray[np.float64], size_m: tuple[float, float]
) -> NDArray[np.bool_]:
    """(N,) whether the soil at (N, 2) points on the site is barred; `blocked` is that of `blocked_soil`."""
    if blocked is None:
        return np.zeros(len(position_m), dtype=bool)
    return np.asarray(blocked[cells_at(position_m, size_m, blocked.shape)])


def cells_at(
    position_m: NDArray[np.float64], size_m: tuple[float, float], shape: tuple[int, ...]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns, (N,) each, of the cells of a grid over the site in which (N, 2) points lie."""
    (width, height), (rows, cols) = size_m, shape
    row = np.clip((position_m[:, 1] / height * rows).astype(np.int64), 0, rows - 1)
    col = np.clip((position_m[:, 0] / width * cols).astype(np.int64), 0, cols - 1)
    return row, col


def parameters_at(
    parameters: BranchModulesParameters, types: Mapping[str, PlantType], step: int
) -> tuple[BranchModulesParameters, dict[str, PlantType]]:
    """The parameters, and the plant types by the names of the species that grow, with all changes up to a step."""
    changed, kinds = parameters, dict(types)
    for _, one in changes_in_order(parameters):
        if one.step(parameters.step_yr) > step:
            break
        own, of_species = one.split()
        if own:
            changed = type(parameters).model_validate({**values_of(changed), **own})
        for name, values in of_species.items():
            kinds[name] = PlantType.model_validate({**values_of(kinds[name]), **values})
    return changed, kinds


def changes_in_order(parameters: BranchModulesParameters) -> list[tuple[int, Change]]:
    """The changes in the order in which they are made, each with its place in the list."""
    return sorted(enumerate(parameters.changes), key=lambda one: one[1].step(parameters.step_yr))


def values_of(model: BaseModel) -> dict[str, Any]:
    """A model's values as they are: maps stay read."""
    return {name: getattr(model, name) for name in type(model).model_fields}


def values_in_time(parameters: BranchModulesParameters, key: str) -> list[tuple[str, Any]]:
    """Place and value of a key at the start and in every change."""
    changed = [
        (f"changes.{index}.set.{key}", one.set[key]) for index, one in enumerate(parameters.changes) if key in one.set
    ]
    return [(key, getattr(parameters, key)), *changed]


def numbers_in_time(parameters: BranchModulesParameters, key: str) -> list[float]:
    """The values alone of a key whose values are numbers."""
    return [float(value) for _, value in values_in_time(parameters, key)]
