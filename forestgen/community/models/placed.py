"""Plants at given positions: an inventory, a figure, a measured stand.

A step of Δt years only increases the plants' age: they neither grow, compete, arrive nor die. Only disturbances
(`community.disturbances`) add or remove plants.

A plant is given by its species, its place and one of two sizes: the radius r of its neighbourhood, or its height, from
which r follows by the species' allometry: ``r = (H / A_H)^(1 / c_H)``. Without either it has the species' largest
radius.

========================  ============  ==========  ============  ==========
parameter                 symbol        unit        range         default
========================  ============  ==========  ============  ==========
steps                                               0 to 100000   0
step_yr                   Δt            yr          0 < Δt        1
plants: species
plants: position_m        x, y          m           on the site
plants: radius_m          r             m           0 < r <= R    R
plants: height_m          H             m           0 < H         by r
plants: age_yr                          yr          0 <=          0
plants: azimuth_deg                     degree      -360 to 360   random
table                                                             none
max_radius_m              R             m           0 < R         of species
height_m scale, exponent  A_H, c_H      m, 1                      of species
========================  ============  ==========  ============  ==========

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

import math
from collections.abc import Iterator, Sequence
from typing import ClassVar, Self

import numpy as np
from pydantic import Field, field_validator

from forestgen.community.arrivals import new_ids
from forestgen.community.disturbance import Ground, planted
from forestgen.community.ecology import SpeciesEcology
from forestgen.community.inventory import PlacedPlant, rows
from forestgen.community.model import CommunityParameters, Site
from forestgen.community.standing import FixedPopulation, Plants, State, azimuth_of
from forestgen.core.errors import RecipeError
from forestgen.recipe.fields import Whole
from forestgen.recipe.sources import Keys

_BYTES_PER_PLANT = 1200  # the parameters' own objects, a state, its successor, a snapshot
_BYTES_AT_LEAST = 256 * 1024


class PlacedParameters(CommunityParameters):
    """What a recipe says about the model besides its species."""

    is_random: ClassVar[bool] = False
    memory_hint: ClassVar[str] = "place fewer plants"

    steps: Whole = Field(0, ge=0, le=100_000, description="number of steps, in which plants only age")
    step_yr: float = Field(1.0, gt=0, description="duration of a step, years")
    plants: tuple[PlacedPlant, ...] = Field((), description="the plants")
    table: str | None = Field(None, description="more plants, as lines of comma-separated values below their names")

    @field_validator("plants", mode="before")
    @classmethod
    def _no_plants_is_an_empty_list(cls, value: object) -> object:
        return () if value is None else value

    @field_validator("table", mode="after")
    @classmethod
    def _is_a_table(cls, value: str | None) -> str | None:
        if value is not None:
            rows(value)
        return value

    @property
    def everyone(self) -> tuple[PlacedPlant, ...]:
        """The plants of the list and of the table, in order."""
        return self.plants if self.table is None else (*self.plants, *rows(self.table))

    def for_trial(self) -> Self:
        """Without plants, which may stand anywhere on the whole site."""
        return self.model_copy(update={"plants": (), "table": None})

    def named_species(self) -> Iterator[tuple[Keys, str]]:
        yield from super().named_species()
        yield from ((("plants", index, "species"), plant.species) for index, plant in enumerate(self.plants))
        if self.table is not None:
            yield from ((("table",), plant.species) for plant in rows(self.table))


def _place(
    plants: Sequence[PlacedPlant],
    parameters: PlacedParameters,
    site: Site,
    species: Sequence[SpeciesEcology],
    seed: int,
) -> Plants:
    """The plants that the recipe gives.

    Raises
    ------
    RecipeError : one that stands beyond the site, or that no plant of its species is like.
    """
    ground = Ground(site.size_m, periodic=False)
    index = {one.name: i for i, one in enumerate(species)}
    n = len(plants)
    sizes = np.empty((n, 2))
    for i, plant in enumerate(plants):
        listed = i < len(parameters.plants)
        where = f"community.plants.{i}" if listed else f"community.table, row {i - len(parameters.plants) + 1}"
        if not ground.holds(*plant.position_m):
            width, depth = site.size_m
            raise RecipeError(
                "this plant does not stand on the site",
                where=where,
                expected=f"x from 0 to {width:g} and y from 0 to {depth:g} metres",
                got=f"[{plant.position_m[0]:g}, {plant.position_m[1]:g}]",
                hint="move the plant, or enlarge site.size_m",
            )
        sizes[i] = _size(plant, species[index[plant.species]], where)
    ids = new_ids(1, n)
    azimuth = [
        azimuth_of(seed, int(one)) if plant.azimuth_deg is None else plant.azimuth_deg
        for one, plant in zip(ids, plants, strict=True)
    ]
    return Plants(
        x_m=np.array([plant.position_m for plant in plants], dtype=np.float64).reshape(n, 2),
        r_m=sizes[:, 0].copy(),
        height_m=sizes[:, 1].copy(),
        sp=np.array([index[plant.species] for plant in plants], dtype=np.uint16),
        azimuth_deg=np.array(azimuth, dtype=np.float64),
        first_age_yr=np.array([plant.age_yr for plant in plants], dtype=np.float64),
        plant_id=ids,
        first_step=np.zeros(n, dtype=np.int32),
    )


def _size(plant: PlacedPlant, species: SpeciesEcology, where: str) -> tuple[float, float]:
    """Radius and height, metres."""
    largest, scale, exponent = species.max_radius_m, species.height_scale, species.height_exponent
    if plant.height_m is None:
        radius = largest if plant.radius_m is None else plant.radius_m
        if radius > largest:
            raise RecipeError(
                f"no {species.name} is so large",
                where=where,
                expected=f"a radius_m of at most ecology.max_radius_m = {largest:g} m",
                got=f"{radius:g} m",
            )
        return radius, scale * radius**exponent
    tallest = scale * largest**exponent
    if exponent == 0.0:
        shortest = tallest * (1 - 1e-9)
        radius = largest
    else:
        shortest = 0.0
        radius = math.exp(min((math.log(plant.height_m) - math.log(scale)) / exponent, 700.0))
    if not shortest <= plant.height_m <= tallest * (1 + 1e-9) or radius <= 0.0:
        raise RecipeError(
            f"no {species.name} is so {'tall' if plant.height_m > tallest else 'short'}",
            where=where,
            expected=f"a height_m of {'at most' if exponent else 'exactly'} {tallest:g} m, which its largest plant has",
            got=f"{plant.height_m:g} m",
            hint="set the species' height_m, its mature height",
        )
    return min(radius, largest), plant.height_m


class Placed(FixedPopulation):
    """The model; see the module's page."""

    Parameters = PlacedParameters

    def init(self, parameters: PlacedParameters, site: Site, species: Sequence[SpeciesEcology], seed: int) -> State:
        """The plants at their places."""
        plants = _place(parameters.everyone, parameters, site, species, seed)
        return State(parameters, tuple(species), seed, 0, 1 + len(plants), plants)

    def expected_plants(self, parameters: PlacedParameters, site: Site, species: Sequence[SpeciesEcology]) -> float:
        """Who is placed, and who will be planted."""
        return float(len(parameters.everyone) + planted(parameters.disturbances))

    def empty_reason(self, parameters: PlacedParameters, site: Site, species: Sequence[SpeciesEcology]) -> str | None:
        """Why no plant will ever stand there, or None if some will."""
        if self.expected_plants(parameters, site, species) > 0:
            return None
        return "no plant is placed: community.plants is empty, and there is no community.table"

    def estimate_bytes(self, parameters: PlacedParameters, site: Site, species: Sequence[SpeciesEcology]) -> int:
        """Bytes for all plants at once.

        It is what a plan asks first, so it also looks at every plant: what is wrong is said before anything is built.
        """
        known = {one.name for one in species}
        if all(plant.species in known for plant in parameters.everyone):
            _place(parameters.everyone, parameters, site, species, 0)
        return _BYTES_AT_LEAST + math.ceil(self.expected_plants(parameters, site, species) * _BYTES_PER_PLANT)


MODEL = Placed()
