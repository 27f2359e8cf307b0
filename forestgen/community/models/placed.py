"""Plants at given positions, such as those of a figure.

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

Decisions
---------
- plant_id counts from 1 in the order of `plants`. Long lists, and trees with measured diameters, are for `inventory`.
- azimuth_deg turns the plant's geometry about the vertical, clockwise from above: at 0 its own x axis points east. It
  is the column azimuth_deg of the population; a plant that does not say has one of its own, drawn from the seed.
- Plants do not dominate one another: those of the largest radius are mature, the others growing.
- Several plants may stand on one spot. A plant beyond the site is refused, as is a size that its species cannot have.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

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


class PlacedParameters(StaticParameters):
    """What a recipe says about the model besides its species."""

    is_random: ClassVar[bool] = False
    memory_hint: ClassVar[str] = "place fewer plants"

    plants: Annotated[tuple[PlacedPlant, ...], none_is(())] = Field((), description="the plants")

    def for_trial(self) -> Self:
        """Without plants, which may stand anywhere on the whole site."""
        return self.model_copy(update={"plants": ()})

    def named_species(self) -> Iterator[tuple[Keys, str]]:
        yield from super().named_species()
        yield from ((("plants", index, "species"), plant.species) for index, plant in enumerate(self.plants))


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
        everyone = parameters.plants
        n = len(everyone)
        sizes = np.empty((n, 2))
        for i, plant in enumerate(everyone):
            where = f"community.plants.{i}"
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
            dead_form=np.zeros(n, dtype=np.uint8),
            decay_class=np.zeros(n, dtype=np.uint8),
            plant_id=ids,
            born=np.zeros(n, dtype=np.int32),
        )
        return State(parameters, site, tuple(species), seed, 0, 1 + n, plants)

    def expected_plants(self, parameters: PlacedParameters, site: Site, species: Ecologies) -> float:
        """Plants that are placed, and those that disturbances plant."""
        return float(len(parameters.plants) + planted(parameters.disturbances))

    def empty_reason(self, parameters: PlacedParameters, site: Site, species: Ecologies) -> str | None:
        if self.expected_plants(parameters, site, species) > 0:
            return None
        return "no plant is placed: community.plants is empty"

    def estimate_bytes(self, parameters: PlacedParameters, site: Site, species: Ecologies) -> int:
        """Bytes for all plants at once; a plan asks this first, so that every plant is checked here."""
        known = {one.name for one in species}
        if all(plant.species in known for plant in parameters.plants):
            self.init(parameters, site, species, 0)
        return _BYTES_AT_LEAST + math.ceil(self.expected_plants(parameters, site, species) * _BYTES_PER_PLANT)


MODEL = Placed()
