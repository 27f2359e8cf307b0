"""Plants at given positions: an inventory, a figure, a measured stand.

A step of Δt years only increases the plants' age: they neither grow, compete, arrive nor die. Only disturbances
(`community.disturbances`) add or remove plants.

A plant is given by its species, its place and one of two sizes: the radius r of its neighbourhood, or its height, from
which r follows by the species' allometry: ``r = (H / A_H)^(1 / c_H)``. Without either it has the species' largest
radius.

Parameters: see below; r is radius_m, H is height_m. A species has R, its max_radius_m, which r never
exceeds, and A_H and c_H, the scale and exponent of its height_m.

Recipe::

    community:
      model: placed
      plants:
        - {species: spruce, position_m: [4, 5.5], height_m: 17}
        - {species: poplar, position_m: [9, 2], radius_m: 1.2, azimuth_deg: 90}

    community:
      model: placed
      table: |                          # an inventory: a line of names, then a plant a line
        species, x_m, y_m, height_m
        spruce,  4,   5.5, 17
        poplar,  9,   2,   11.3

Decisions
---------
- `plants` come first, then the rows of `table`; plant_id counts from 1 in that order. A table's columns may also be
  radius_m, age_yr and azimuth_deg; an empty cell is a value that is not given. Decimals have a point.
- The table is written into the recipe, so that the recipe alone says what is drawn.
- azimuth_deg turns the plant's geometry about the vertical, clockwise from above: at 0 its own x axis points east. It
  is the column azimuth_deg of the population; a plant that does not say has one of its own, drawn from the seed.
- Plants do not dominate one another: those of the largest radius are mature, the others growing.
- Several plants may stand on one spot. A plant beyond the site is refused, as is a size that its species cannot have.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import Field, ValidationError, field_validator, model_validator

from forestgen.community.arrivals import new_ids
from forestgen.community.disturbance import Ground, PointOnGround, planted
from forestgen.community.model import none_is
from forestgen.community.population import Ecologies, Site, SpeciesEcology
from forestgen.community.static_model import FixedPopulation, Plants, State, StaticParameters, azimuth_of, unknown_sizes
from forestgen.core.errors import RecipeError
from forestgen.recipe.fields import Name, NonNegative, Number, Positive, Section, violation
from forestgen.recipe.sources import Keys

_NUMBERS = ("x_m", "y_m", "height_m", "radius_m", "age_yr", "azimuth_deg")
_BYTES_PER_PLANT = 1200  # the parameters' own objects, a state, its successor, a snapshot
_BYTES_AT_LEAST = 256 * 1024


class PlacedPlant(Section):
    """One plant."""

    species: Name = Field(description="Its species, as the recipe names it.")
    position_m: PointOnGround = Field(description="Where it stands: x, y, metres; on the site.")
    radius_m: Positive | None = Field(
        None, description="Its radius, metres; null: by height_m, or the species' largest."
    )
    height_m: Positive | None = Field(None, description="Its height, metres; instead of radius_m.")
    age_yr: NonNegative = Field(0.0, description="Its age at the beginning, years.")
    azimuth_deg: Number | None = Field(
        None, ge=-360, le=360, description="Turn about the vertical, degrees clockwise from above; null: random."
    )

    @model_validator(mode="after")
    def _one_size(self) -> Self:
        if self.radius_m is not None and self.height_m is not None:
            raise violation("radius_m or height_m, not both", problem="the allometry gives one from the other")
        return self


def _rows(table: str) -> list[PlacedPlant]:
    """The plants of a table, or a mistake that names the row."""
    lines = [line for line in table.splitlines() if line.strip()]
    if len(lines) < 2:
        expected = "a line of names (species, x_m, y_m, height_m) and a line for each plant"
        problem = "not a table of plants"
        raise violation(expected, problem=problem, got=repr(table[:60]), hint="paste the file's text below `table: |`")
    names = [name.strip() for name in next(csv.reader(lines[:1]))]
    unknown = set(names) - {*_NUMBERS, "species"}
    missing = {"species", "x_m", "y_m"} - set(names)
    if unknown or missing or len(set(names)) < len(names):
        expected = "the names species, x_m, y_m, and any of height_m, radius_m, age_yr, azimuth_deg, each once"
        problem = "the table's first line does not name its columns"
        raise violation(expected, problem=problem, got=lines[0].strip()[:100])
    return [_plant(names, cells, number) for number, cells in enumerate(csv.reader(lines[1:]), start=1)]


def _plant(names: Sequence[str], cells: Sequence[str], number: int) -> PlacedPlant:
    got = ", ".join(cells)[:100]
    if len(cells) != len(names):
        problem = f"row {number} of the table has another number of values"
        raise violation(f"{len(names)} values: {', '.join(names)}", problem=problem, got=got)
    given: dict[str, Any] = {}
    for name, cell in zip(names, (cell.strip() for cell in cells), strict=True):
        if not cell:
            continue
        try:
            given[name] = float(cell) if name in _NUMBERS else cell
        except ValueError:
            raise violation(
                "a number", problem=f"bad {name} in row {number} of the table", got=repr(cell[:40])
            ) from None
    try:
        position_m = given.pop("x_m", None), given.pop("y_m", None)
        return PlacedPlant.model_validate({**given, "position_m": position_m})
    except ValidationError as error:
        first = error.errors()[0]
        where = " of ".join(str(part) for part in reversed(first["loc"]))
        problem = f"row {number} of the table is no plant ({f'{where}: ' if where else ''}{first['msg']})"
        raise violation(f"{', '.join(names)} of a plant", problem=problem, got=got) from None


class PlacedParameters(StaticParameters):
    """What a recipe says about the model besides its species."""

    is_random: ClassVar[bool] = False
    memory_hint: ClassVar[str] = "place fewer plants"

    plants: Annotated[tuple[PlacedPlant, ...], none_is(())] = Field((), description="the plants")
    table: str | None = Field(None, description="more plants, as lines of comma-separated values below their names")

    @field_validator("table", mode="after")
    @classmethod
    def _is_a_table(cls, value: str | None) -> str | None:
        if value is not None:
            _rows(value)
        return value

    @property
    def everyone(self) -> tuple[PlacedPlant, ...]:
        """The plants of the list and of the table, in order."""
        return self.plants if self.table is None else (*self.plants, *_rows(self.table))

    def for_trial(self) -> Self:
        """Without plants, which may stand anywhere on the whole site."""
        return self.model_copy(update={"plants": (), "table": None})

    def named_species(self) -> Iterator[tuple[Keys, str]]:
        yield from super().named_species()
        yield from ((("plants", index, "species"), plant.species) for index, plant in enumerate(self.plants))
        yield from ((("table",), plant.species) for plant in self.everyone[len(self.plants) :])


def _size(plant: PlacedPlant, species: SpeciesEcology, where: str) -> tuple[float, float]:
    """Radius and height, metres."""
    largest, scale, exponent = species.max_radius_m, species.height_scale, species.height_exponent
    if plant.height_m is None:
        radius = largest if plant.radius_m is None else plant.radius_m
        if radius > largest:
            expected = f"a radius_m of at most ecology.max_radius_m = {largest:g} m"
            raise RecipeError(f"no {species.name} is so large", where=where, expected=expected, got=f"{radius:g} m")
        return radius, scale * radius**exponent
    tallest = scale * largest**exponent
    if exponent == 0.0:
        shortest = tallest * (1 - 1e-9)
        radius = largest
    else:
        shortest = 0.0
        radius = math.exp(min((math.log(plant.height_m) - math.log(scale)) / exponent, 700.0))
    if not shortest <= plant.height_m <= tallest * (1 + 1e-9) or radius <= 0.0:
        problem = f"no {species.name} is so {'tall' if plant.height_m > tallest else 'short'}"
        expected = f"a height_m of {'at most' if exponent else 'exactly'} {tallest:g} m, which its largest plant has"
        hint = "set the species' height_m, its mature height"
        raise RecipeError(problem, where=where, expected=expected, got=f"{plant.height_m:g} m", hint=hint)
    return min(radius, largest), plant.height_m


class Placed(FixedPopulation[PlacedParameters]):
    Parameters = PlacedParameters

    def init(self, parameters: PlacedParameters, site: Site, species: Ecologies, seed: int) -> State:
        """The plants at their places; `RecipeError` for one beyond the site, or of a size that its species lacks."""
        ground = Ground(site.size_m, periodic=False)
        index = {one.name: i for i, one in enumerate(species)}
        everyone = parameters.everyone
        n, listed = len(everyone), len(parameters.plants)
        sizes = np.empty((n, 2))
        for i, plant in enumerate(everyone):
            where = f"community.plants.{i}" if i < listed else f"community.table, row {i - listed + 1}"
            if not ground.holds(*plant.position_m):
                width, depth = site.size_m
                problem = "this plant does not stand on the site"
                expected = f"x from 0 to {width:g} and y from 0 to {depth:g} metres"
                got = f"[{plant.position_m[0]:g}, {plant.position_m[1]:g}]"
                hint = "move the plant, or enlarge site.size_m"
                raise RecipeError(problem, where=where, expected=expected, got=got, hint=hint)
            sizes[i] = _size(plant, species[index[plant.species]], where)
        ids = new_ids(1, n)
        azimuth = [
            azimuth_of(seed, int(one)) if plant.azimuth_deg is None else plant.azimuth_deg
            for one, plant in zip(ids, everyone, strict=True)
        ]
        plants = Plants(
            x_m=np.array([plant.position_m for plant in everyone], dtype=np.float64).reshape(n, 2),
            r_m=sizes[:, 0].copy(),
            height_m=sizes[:, 1].copy(),
            sp=np.array([index[plant.species] for plant in everyone], dtype=np.uint16),
            azimuth_deg=np.array(azimuth, dtype=np.float64),
            first_age_yr=np.array([plant.age_yr for plant in everyone], dtype=np.float64),
            tree_sizes=unknown_sizes(n),
            dead=np.zeros(n, dtype=np.bool_),
            plant_id=ids,
            born=np.zeros(n, dtype=np.int32),
        )
        return State(parameters, site, tuple(species), seed, 0, 1 + n, plants)

    def expected_plants(self, parameters: PlacedParameters, site: Site, species: Ecologies) -> float:
        """Plants that are placed, and those that disturbances plant."""
        return float(len(parameters.everyone) + planted(parameters.disturbances))

    def empty_reason(self, parameters: PlacedParameters, site: Site, species: Ecologies) -> str | None:
        if self.expected_plants(parameters, site, species) > 0:
            return None
        return "no plant is placed: community.plants is empty, and there is no community.table"

    def estimate_bytes(self, parameters: PlacedParameters, site: Site, species: Ecologies) -> int:
        """Bytes for all plants at once; a plan asks this first, so that every plant is checked here."""
        known = {one.name for one in species}
        if all(plant.species in known for plant in parameters.everyone):
            self.init(parameters, site, species, 0)
        return _BYTES_AT_LEAST + math.ceil(self.expected_plants(parameters, site, species) * _BYTES_PER_PLANT)


MODEL = Placed()
