"""Obstacles on a site, which are no plants: a recipe's entry, its checks, and what it changes about a population."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.community.disturbance import PointOnGround
from forestgen.community.population import Population
from forestgen.core.errors import RecipeError
from forestgen.plants.registry import is_built
from forestgen.recipe.fields import Name, Number, Positive, Section
from forestgen.recipe.load import DrawnRecipe

_Side = Annotated[Positive, Field(ge=0.5, le=200)]


class Obstacle(Section):
    """A building: plants neither grow into it nor get light through it."""

    species: Name = Field(description="Its species, whose generator shows it: house.")
    position_m: PointOnGround = Field(description="Middle of its ground plan: x, y, metres; on the site.")
    azimuth_deg: Number = Field(
        0.0, ge=-360, le=360, description="Turn of its width from east, clockwise from above, degrees."
    )
    size_m: tuple[_Side, _Side, _Side] = Field(
        (10.0, 8.0, 7.0), description="Width along its ridge, depth, and height to the ridge, metres."
    )

    @property
    def turn_rad(self) -> float:
        """The same anticlockwise, as world axes turn, radians."""
        return -math.radians(self.azimuth_deg)

    def corners_m(self) -> NDArray[np.float64]:
        """(4, 2) world x and y of its ground plan's corners."""
        x, y = 0.5 * self.size_m[0], 0.5 * self.size_m[1]
        cos, sin = math.cos(self.turn_rad), math.sin(self.turn_rad)
        plan = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
        return np.asarray(plan @ np.array([[cos, sin], [-sin, cos]]) + self.position_m)


@dataclass(frozen=True)
class Obstacles:
    """The obstacles of a site, and the species that only obstacles have."""

    entries: tuple[Obstacle, ...] = ()  # a population has them in its first rows by plant_id, in this order
    species: frozenset[str] = frozenset()

    @cached_property
    def counts(self) -> dict[str, int]:
        """How many there are of each species that has some."""
        names = [one.species for one in self.entries]
        return {name: names.count(name) for name in dict.fromkeys(names)}

    def rows_of(self, population: Population) -> dict[int, Obstacle]:
        """Row of the population -> the obstacle that stands there."""
        rows = np.searchsorted(population.plant_id, np.arange(1, len(self.entries) + 1))
        return {int(row): one for row, one in zip(rows, self.entries, strict=True)}

    def left_out_of(self, population: Population) -> Population:
        """The plants of a snapshot: no row is an obstacle, and no species' name; modules are left out, too."""
        if not self.species:
            return population
        names = population.species_names
        stays = np.array([name not in self.species for name in names], dtype=np.bool_)
        number = np.cumsum(stays) - 1  # of each species among those that stay
        rows = stays[population.species]
        arrays = ("plant_id", "position_m", "radius_m", "height_m", "age_yr", "status")
        return replace(
            population,
            species_names=tuple(name for name in names if name not in self.species),
            species=number[population.species[rows]].astype(np.uint16),
            columns={name: values[rows] for name, values in population.columns.items()},
            modules=None,
            **{name: getattr(population, name)[rows] for name in arrays},
        )

    def turned(self, population: Population) -> Population:
        """The population with obstacles' azimuths in the column `azimuth_deg`, which the scene places plants by."""
        if not self.entries:
            return population
        azimuth_deg = population.columns.get("azimuth_deg", np.full(len(population), np.nan)).astype(np.float64)
        for row, one in self.rows_of(population).items():
            azimuth_deg[row] = one.azimuth_deg
        return replace(population, columns={**population.columns, "azimuth_deg": azimuth_deg})


NO_OBSTACLES = Obstacles()


def check_obstacles(drawn: DrawnRecipe, obstacles: Obstacles) -> None:
    """Raise `RecipeError` for obstacles that are plants or stand beyond the site, and buildings that stand nowhere."""
    for index, one in enumerate(obstacles.entries):
        _check_obstacle(drawn, index, one)
    for name in sorted(obstacles.species - obstacles.counts.keys()):
        raise RecipeError(
            f"{name} is no plant, and none stands anywhere",
            where=drawn.where("species", name),
            expected="an obstacle of this species, or no such species",
            got="obstacles of " + ", ".join(sorted(obstacles.counts)) if obstacles.counts else "no obstacle",
            hint=f"community.obstacles: [{{species: {name}, position_m: [...]}}], or leave {name} out",
        )


def _check_obstacle(drawn: DrawnRecipe, index: int, obstacle: Obstacle) -> None:
    """A species that is built, and a ground plan on the site."""
    keys = ("community", "obstacles", index)
    if not is_built(drawn.species[obstacle.species].plant.generator):
        buildings = [name for name, one in drawn.species.items() if is_built(one.plant.generator)]
        raise RecipeError(
            "this species is a plant, and no obstacle",
            where=drawn.where(*keys, "species"),
            expected="one of " + (", ".join(buildings) or "the recipe's species with plant.generator: house"),
            got=obstacle.species,
            hint="species: {house: }" if not buildings else None,
        )
    width, depth = drawn.recipe.site.size_m
    corners = obstacle.corners_m()
    if np.any(corners < 0) or np.any(corners > (width, depth)):
        (x, y), (west, south), (east, north) = obstacle.position_m, corners.min(axis=0), corners.max(axis=0)
        raise RecipeError(
            "this obstacle does not lie on the site",
            where=drawn.where(*keys, "position_m"),
            expected=f"all of its ground plan within x from 0 to {width:g} and y from 0 to {depth:g} metres",
            got=f"[{x:g}, {y:g}], from [{west:.1f}, {south:.1f}] to [{east:.1f}, {north:.1f}]",
        )
