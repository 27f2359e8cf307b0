"""Disturbances of a simulation with any model: fellings, fires and plantings.

A climax community lasts until something destroys a part of it; then succession begins anew (Lane 2002, section 2.1).
Planting a large tree and felling it later is the domination test of Randleff-Rasmussen 2004, section 5.2.2. In a
recipe::

    disturbances:
      - {at_yr: 60, fell: {circle: {center_m: [60, 60], radius_m: 15}, species: [spruce], min_radius_m: 1}}
      - {at_step: 0, plant: {species: oak, positions_m: [[50, 50]], radius_m: 8, vigour: 100}}

A disturbance is applied at the end of the step that reaches its time, before that step's snapshot is taken; several of
one step are applied in the order of the list. Random numbers of the k-th in the list (from 0) come from
``child_rng(seed, "disturbance", k)``. A plant is inside a region if its position is. On a periodic site a circle
continues at the opposite edge.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from forestgen.community.population import Ecologies, Floats, Population, Status
from forestgen.core.errors import RecipeError
from forestgen.recipe.fields import Coordinate, Fraction, Name, NonNegative, Number, Positive, Section, Whole, violation
from forestgen.recipe.sources import Keys

PointOnGround = tuple[Coordinate, Coordinate]
_MOST_DRAWS = 100_000_000


@dataclass(frozen=True)
class Ground:
    """The rectangle [0, W] x [0, H], metres; or the torus made of it."""

    size_m: tuple[float, float]
    periodic: bool

    def holds(self, x_m: float, y_m: float) -> bool:
        return 0 <= x_m <= self.size_m[0] and 0 <= y_m <= self.size_m[1]


@dataclass(frozen=True)
class Planting:
    """New plants, in the order in which they are numbered."""

    species: NDArray[np.uint16]  # (N,) index of species
    position_m: Floats  # (N, 2) metres, world x and y
    radius_m: Floats  # (N,) metres
    columns: Mapping[str, Floats] = field(default_factory=dict)  # (N,) a model's own, those that are given

    def __len__(self) -> int:
        return len(self.species)


class Circle(Section):
    """A disc."""

    center_m: PointOnGround = Field(description="Its middle: x, y, metres; on the site.")
    radius_m: Positive = Field(description="Its radius, metres.")

    def corners(self) -> Sequence[PointOnGround]:
        return [self.center_m]

    def inside(self, xy_m: Floats, ground: Ground) -> NDArray[np.bool_]:
        away = np.abs(xy_m - self.center_m)
        if ground.periodic:
            away = np.minimum(away, np.abs(np.array(ground.size_m) - away))
        return np.asarray(np.sum(away**2, axis=1) <= self.radius_m**2)


class Rectangle(Section):
    """A rectangle along the axes."""

    min_m: PointOnGround = Field(description="Its south-western corner: x, y, metres.")
    max_m: PointOnGround = Field(description="Its north-eastern corner: x, y, metres.")

    @model_validator(mode="after")
    def _has_an_area(self) -> Self:
        if not (self.min_m[0] < self.max_m[0] and self.min_m[1] < self.max_m[1]):
            raise violation("max_m north-east of min_m", problem="a rectangle without area", got=str(list(self.max_m)))
        return self

    def corners(self) -> Sequence[PointOnGround]:
        return [self.min_m, self.max_m]

    def inside(self, xy_m: Floats, ground: Ground) -> NDArray[np.bool_]:
        return np.asarray(np.all((xy_m >= self.min_m) & (xy_m <= self.max_m), axis=1))


class Polygon(Section):
    """A polygon; where its edges cross, what they go around an odd number of times."""

    corners_m: tuple[PointOnGround, ...] = Field(
        min_length=3,
        max_length=10_000,
        description="Its corners in order: [x, y], metres; the last is joined to the first.",
    )

    @model_validator(mode="after")
    def _has_an_area(self) -> Self:
        x, y = np.array(self.corners_m).T
        twice = abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))
        # Random places would never be found inside a narrower sliver.
        if twice <= 2e-6 * float(np.ptp(x) * np.ptp(y)) or twice == 0:
            raise violation("corners that go around an area", problem="a polygon without area", at=("corners_m",))
        return self

    def corners(self) -> Sequence[PointOnGround]:
        return self.corners_m

    def inside(self, xy_m: Floats, ground: Ground) -> NDArray[np.bool_]:
        odd = np.zeros(len(xy_m), dtype=np.bool_)
        x, y = xy_m.T
        for k, (x1, y1) in enumerate(self.corners_m):
            x0, y0 = self.corners_m[k - 1]
            if y0 != y1:
                odd ^= ((y0 > y) != (y1 > y)) & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
        return odd


class Region(Section):
    """Where: the whole site, a circle, a rectangle or a polygon."""

    circle: Circle | None = Field(None, description="Only inside this circle.")
    rectangle: Rectangle | None = Field(None, description="Only inside this rectangle.")
    polygon: Polygon | None = Field(None, description="Only inside this polygon.")

    @model_validator(mode="after")
    def _one_shape(self) -> Self:
        if len(self.shapes()) > 1:
            expected, got = "at most one of circle, rectangle, polygon", ", ".join(self.shapes())
            raise violation(expected, problem="more than one region", got=got, hint="write two disturbances")
        return self

    def shapes(self) -> dict[str, Circle | Rectangle | Polygon]:
        """The region's shape by its key; empty: the whole site."""
        return {key: one for key in ("circle", "rectangle", "polygon") if (one := getattr(self, key)) is not None}

    def inside(self, xy_m: Floats, ground: Ground) -> NDArray[np.bool_]:
        """Which of (N, 2) positions, metres, lie in the region."""
        for shape in self.shapes().values():
            return shape.inside(xy_m, ground)
        return np.ones(len(xy_m), dtype=np.bool_)

    def off_site(self, ground: Ground) -> Iterator[tuple[Keys, PointOnGround]]:
        """Key path of a shape, and a corner of it that lies beyond the site."""
        for key, shape in self.shapes().items():
            yield from (((key,), point) for point in shape.corners() if not ground.holds(*point))

    def random_places(self, count: int, ground: Ground, rng: np.random.Generator) -> Floats:
        """(count, 2) positions, metres, uniform in the region and on the site."""
        low, high = self._box(ground)
        found, drawn = [np.empty((0, 2))], 0
        while (missing := count - sum(map(len, found))) > 0:
            if drawn > _MOST_DRAWS:
                raise RecipeError("no room for a planting", expected="a wider region", got=f"{count} plants")
            xy = low + rng.random((2 * missing + 16, 2)) * (high - low)
            if ground.periodic:
                xy = np.mod(xy, ground.size_m)
            found.append(xy[self.inside(xy, ground)][:missing])
            drawn += len(xy)
        return np.concatenate(found)

    def _box(self, ground: Ground) -> tuple[Floats, Floats]:
        """South-western and north-eastern corner of a box to draw places from."""
        size = np.array(ground.size_m)
        for shape in self.shapes().values():
            corners, margin_m = np.array(shape.corners()), self.circle.radius_m if self.circle else 0.0
            low, high = corners.min(axis=0) - margin_m, corners.max(axis=0) + margin_m
            if self.circle is None or not ground.periodic:
                return np.maximum(low, 0.0), np.minimum(high, size)
            if np.all(high - low <= size):  # else it overlaps itself around the torus
                return low, high
        return np.zeros(2), size


class Selection(Region):
    """Which plants: those of a region, of some species, of some sizes."""

    species: tuple[Name, ...] | None = Field(None, description="Only these species; null: all.")
    min_radius_m: NonNegative = Field(0.0, description="Only plants of at least this radius, metres.")
    max_radius_m: Positive | None = Field(None, description="Only plants of at most this radius, metres.")

    @model_validator(mode="after")
    def _sizes_in_order(self) -> Self:
        if self.max_radius_m is not None and self.max_radius_m < self.min_radius_m:
            expected, got = f"at least min_radius_m = {self.min_radius_m:g}", f"{self.max_radius_m:g}"
            raise violation(expected, problem="no plant is that large and that small", got=got, at=("max_radius_m",))
        return self

    def chosen(self, population: Population, ground: Ground) -> NDArray[np.uint32]:
        """Ids, sorted, of the living plants that meet all conditions."""
        keep = self.inside(population.position_m[:, :2], ground) & (population.status != Status.DEAD)
        keep &= population.radius_m >= self.min_radius_m
        if self.max_radius_m is not None:
            keep &= population.radius_m <= self.max_radius_m
        if self.species is not None:
            keep &= np.isin(population.species, [population.species_names.index(name) for name in self.species])
        return np.asarray(population.plant_id[keep])


class Fell(Selection):
    """Plants are cut and carried away."""

    share: Fraction = Field(1.0, description="Share of the chosen plants that is felled, which ones at random.")


class Burn(Selection):
    """A fire kills each chosen plant with one probability; another by size is a second burn in the same step."""

    survival: Fraction = Field(0.0, description="Probability that a chosen plant survives the fire.")
    survival_of: dict[Name, Fraction] = Field(
        default_factory=dict, description="Species -> the same probability, where it differs."
    )


class Plant(Region):
    """New plants, at given places or at random ones of the region."""

    species: Name = Field(description="Their species, as the recipe names it.")
    positions_m: tuple[PointOnGround, ...] | None = Field(None, description="Where they stand: [x, y] each, metres.")
    count: Annotated[Whole, Field(ge=1, le=10**8)] | None = Field(
        None, description="How many, at uniformly random places of the region; instead of positions_m."
    )
    radius_m: Positive | None = Field(
        None, description="Their radius, metres; null: that of the species' mean seedling."
    )
    vigour: Number | None = Field(None, description="Their vigour, for models that have it; null: the model's choice.")

    @model_validator(mode="after")
    def _places_or_a_number(self) -> Self:
        if (self.positions_m is None) == (self.count is None):
            raise violation("either positions_m or count", problem="it must be clear where and how many to plant")
        if self.positions_m is not None and self.shapes():
            raise violation("a region with count only", problem="positions_m already say where to plant")
        return self

    @property
    def number(self) -> int:
        """How many plants there will be."""
        return len(self.positions_m) if self.positions_m is not None else int(self.count or 0)

    def planting(self, ground: Ground, species: Ecologies, rng: np.random.Generator) -> Planting:
        """The plants, with their places drawn."""
        index = [one.name for one in species].index(self.species)
        n = self.number
        if self.positions_m is None:
            position_m = self.random_places(n, ground, rng)
        else:
            position_m = np.array(self.positions_m, dtype=np.float64).reshape(-1, 2)
        radius_m = species[index].seedling_radius_m if self.radius_m is None else self.radius_m
        radius_m = min(radius_m, species[index].max_radius_m)
        columns = {} if self.vigour is None else {"vigour": np.full(n, self.vigour)}
        return Planting(np.full(n, index, dtype=np.uint16), position_m, np.full(n, radius_m), columns)


KINDS = ("fell", "burn", "plant")


class Disturbance(Section):
    """Something that happens to a community at one time."""

    at_yr: NonNegative | None = Field(None, description="When, years: at the end of the step that reaches this time.")
    at_step: Annotated[Whole, Field(ge=0)] | None = Field(None, description="When: the step; instead of at_yr.")
    fell: Fell | None = Field(None, description="Cut plants.")
    burn: Burn | None = Field(None, description="Burn plants.")
    plant: Plant | None = Field(None, description="Add plants.")

    @model_validator(mode="after")
    def _one_time_one_kind(self) -> Self:
        if (self.at_yr is None) == (self.at_step is None):
            raise violation("either at_yr or at_step", problem="it must be clear when this happens")
        kinds = [key for key in KINDS if getattr(self, key) is not None]
        if len(kinds) != 1:
            got = ", ".join(kinds) or "none"
            raise violation(f"one of {', '.join(KINDS)}", problem="one thing happens at a time", got=got)
        return self

    def step(self, step_yr: float) -> int:
        """The step after which it is applied; rounding of years does not put it off by a step."""
        if self.at_step is not None:
            return self.at_step
        assert self.at_yr is not None
        return math.ceil(self.at_yr / step_yr * (1 - 1e-9))

    @property
    def kind(self) -> str:
        return "fell" if self.fell else "burn" if self.burn else "plant"

    @property
    def region(self) -> Region:
        """Where it happens, and to what."""
        region: Region = getattr(self, self.kind)
        return region

    def affected_plants(self, population: Population, ground: Ground, rng: np.random.Generator) -> NDArray[np.uint32]:
        """Ids, sorted, of the plants that a felling or a fire removes."""
        if self.fell is not None:
            chosen = self.fell.chosen(population, ground)
            if self.fell.share == 1:
                return chosen
            return np.sort(rng.choice(chosen, size=round(self.fell.share * len(chosen)), replace=False))
        assert self.burn is not None
        chosen = self.burn.chosen(population, ground)
        survival = np.array([self.burn.survival_of.get(name, self.burn.survival) for name in population.species_names])
        species = population.species[np.searchsorted(population.plant_id, chosen)]
        return chosen[rng.random(len(chosen)) >= survival[species]]

    def named_species(self) -> Iterator[tuple[Keys, str]]:
        """Key path and name of every species that is named."""
        if self.plant is not None:
            yield ("plant", "species"), self.plant.species
        for kind, one in (("fell", self.fell), ("burn", self.burn)):
            yield from (((kind, "species", index), name) for index, name in enumerate((one and one.species) or ()))
        yield from ((("burn", "survival_of", name), name) for name in (self.burn.survival_of if self.burn else ()))

    def off_site(self, ground: Ground) -> Iterator[tuple[Keys, PointOnGround]]:
        """Key path and position of everything that lies beyond the site."""
        yield from (((self.kind, *keys), point) for keys, point in self.region.off_site(ground))
        for index, point in enumerate((self.plant and self.plant.positions_m) or ()):
            if not ground.holds(*point):
                yield ("plant", "positions_m", index), point


def planted(disturbances: Sequence[Disturbance]) -> int:
    """How many plants the disturbances plant in all."""
    return sum(one.plant.number for one in disturbances if one.plant is not None)
