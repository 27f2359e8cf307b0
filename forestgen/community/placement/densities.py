"""What a recipe says about the plants to be placed, and what follows: densities on a grid, numbers, radii, heights."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator
from scipy.special import ndtr, ndtri

from forestgen.community.ground.living_conditions import Conditions, suitability
from forestgen.community.model import none_is
from forestgen.community.placement.density_map import LEAST, DensityMap, MapSection
from forestgen.community.population import Ecologies, Floats, Site, SpeciesEcology
from forestgen.community.static_model import StaticParameters
from forestgen.core.errors import RecipeError
from forestgen.recipe.fields import Flag, Name, NonNegative, Positive, Section, Whole, violation
from forestgen.recipe.sources import Keys

MOST_PLANTS = 20_000_000
MOST_CELLS = 2**25  # of all fields that a model makes by itself, 268 MB
MOST_ALONG = 16384  # along the site's longer side
COUNTING_CELLS = 512  # along the site's longer side: numbers of plants must not depend on a model's own grid


class Sizes(Section):
    """A log-normal hierarchy of radii, cut off at the species' largest."""

    median: Positive = Field(le=100, description="Half of the plants would be smaller, were none cut off; metres.")
    sigma: NonNegative = Field(0.4, le=3, description="Standard deviation of the natural logarithm; 0: all are alike.")


def one_size(value: Any) -> Any:
    return {"median": value, "sigma": 0.0} if isinstance(value, int | float) and not isinstance(value, bool) else value


class Stand(Section):
    """The plants of one species."""

    count: Whole | None = Field(None, ge=0, le=MOST_PLANTS, description="How many; or, instead, plants_per_ha.")
    plants_per_ha: NonNegative | None = Field(
        None, le=1e8, description="How many per hectare (10,000 m²) where map and conditions are 1; the sum is rounded."
    )
    map: DensityMap | None = Field(None, description="Relative density over the site, such as a painted picture.")
    conditions: Conditions = Field(Conditions(), description="What the species asks of the ground.")
    radius_m: Annotated[Sizes | None, BeforeValidator(one_size)] = Field(
        None, description="Radii: a number, or {median, sigma} of a log-normal; null: median half of the largest."
    )
    height_sigma: NonNegative = Field(
        0.0, le=1, description="Scatter of heights about the species' allometry: deviation of the natural logarithm."
    )

    @model_validator(mode="after")
    def _one_number(self) -> Self:
        if (self.count is None) == (self.plants_per_ha is None):
            problem = "how many plants?" if self.count is None else "two numbers of plants"
            got = None if self.count is None else f"count {self.count} and plants_per_ha {self.plants_per_ha:g}"
            raise violation("count or plants_per_ha", problem=problem, got=got)
        return self


class PlacementParameters(StaticParameters):
    """What every placement model's recipe says."""

    memory_hint: ClassVar[str] = "ask for fewer plants in community.plants"

    plants: Annotated[dict[Name, Stand], none_is({})] = Field({}, description="the plants of each species")
    keep_out: DensityMap | None = Field(
        None, description="where no plant of any species may stand: any value above 0 of this map bars"
    )
    periodic: Flag = Field(True, description="the site is a torus, without edges; false: a bounded site")

    plants_key: ClassVar[str] = "plants"  # for messages

    def for_trial(self) -> Self:
        """Without plants: their numbers are those of the whole site, and all have the same columns."""
        return self.model_copy(update={"plants": {}})

    def named_species(self) -> Iterator[tuple[Keys, str]]:
        yield from super().named_species()
        yield from ((("plants", name), name) for name in self.plants)


def grid_shape(site: Site, cells: int) -> tuple[int, int]:
    """Rows and columns of nearly square cells over the site, `cells` of them along its longer side."""
    width, height = site.size_m
    cell_m = max(width, height) / cells
    return max(1, round(height / cell_m)), max(1, round(width / cell_m))


def cells_for(site: Site, length_m: float, *, per_length: float, at_least: int, fields: int) -> int:
    """Cells along the site's longer side so that `per_length` of them span a length, such as a radius.

    No more than memory allows for so many `fields`.
    """
    longest = max(site.size_m)
    most = math.isqrt(int(MOST_CELLS / max(1, fields) / (min(site.size_m) / longest)))
    return max(16, min(most, MOST_ALONG, max(at_least, math.ceil(per_length * longest / length_m))))


def species_density(parameters: PlacementParameters, site: Site, name: str, shape: tuple[int, int]) -> Floats:
    """(rows, cols) relative density of a species: its map times its conditions, 0 where the recipe keeps plants out.

    Row 0 lies at y = 0. A species that the recipe does not place has none.
    """
    stand = parameters.plants.get(name)
    if stand is None:
        return np.zeros(shape)
    return relative_density(stand.conditions, stand.map, parameters.keep_out, site, shape)


def relative_density(
    conditions: Conditions, painted: MapSection | None, keep_out: MapSection | None, site: Site, shape: tuple[int, int]
) -> Floats:
    """(rows, cols) of a map times the response to conditions, 0 where plants are kept out; row 0 at y = 0."""
    density = suitability(conditions, site, shape)
    if painted is not None:
        density = density * painted.on_grid(shape)
    if keep_out is not None:
        density = np.where(keep_out.any_above_zero(shape), 0.0, density)
    return np.ascontiguousarray(np.where(density < LEAST, 0.0, density))


def tree_density(painted: MapSection | None, keep_out: MapSection | None, site: Site, shape: tuple[int, int]) -> Floats:
    """(rows, cols) relative density of trees, 1 at most; row 0 at y = 0. Raises `RecipeError` where none may stand."""
    density = relative_density(Conditions(), painted, keep_out, site, shape)
    if not density.any():
        problem, expected = "no tree may stand anywhere", "a map and keep_out that leave some ground"
        where = "community.map" if keep_out is None else "community.keep_out"
        raise RecipeError(problem, where=where, expected=expected, got="0 on the whole site")
    return np.asarray(density / density.max())


def plant_counts(parameters: PlacementParameters, site: Site, species: Ecologies) -> NDArray[np.int64]:
    """(S,) how many plants of each species are asked for, the same for every model.

    A `count` is placed wherever the density lets it. `plants_per_ha` is multiplied by the density: barred ground has no
    plants, and the rest has no more than without it.
    """
    shape = grid_shape(site, COUNTING_CELLS)
    counts = np.zeros(len(species), dtype=np.int64)
    for index, one in enumerate(species):
        stand = parameters.plants.get(one.name)
        if stand is None:
            continue
        if stand.count is not None:
            counts[index] = stand.count
        elif stand.plants_per_ha:
            mean = float(species_density(parameters, site, one.name, shape).mean())
            asked = stand.plants_per_ha * site.area_ha * mean + 0.5
            if asked >= MOST_PLANTS + 1:
                where = f"community.{parameters.plants_key}.{one.name}.plants_per_ha"
                expected = f"at most {MOST_PLANTS:,} on the whole site"
                got = f"{asked:,.0f}" if asked < 1e15 else f"{asked:.3g}"
                hint = "plants_per_ha is multiplied by the map's values: a map of 0 to 1 leaves it as it is"
                raise RecipeError(f"too many plants of {one.name}", where=where, expected=expected, got=got, hint=hint)
            counts[index] = math.floor(asked)
    return counts


def check_sizes(parameters: PlacementParameters, species: Ecologies) -> None:
    """Raise `RecipeError` for a median radius above the species' largest."""
    for one in species:
        stand = parameters.plants.get(one.name)
        if stand is not None and stand.radius_m is not None and stand.radius_m.median > one.max_radius_m:
            problem, where = f"no {one.name} is so large", f"community.{parameters.plants_key}.{one.name}.radius_m"
            expected = f"a radius of at most ecology.max_radius_m = {one.max_radius_m:g} m"
            raise RecipeError(problem, where=where, expected=expected, got=f"{stand.radius_m.median:g} m")


def sizes_of(sizes: Sizes | None, species: SpeciesEcology) -> Sizes:
    """A stand's sizes, or those of a stand that says nothing of them."""
    return sizes or Sizes(median=species.max_radius_m / 2, sigma=0.4)


def draw_radii(sizes: Sizes | None, species: SpeciesEcology, n: int, rng: np.random.Generator) -> Floats:
    """(n,) radii in metres: log-normal, cut off at the species' largest.

    By inverse transformation: u, uniform in [0, 1), times the distribution's value at the largest radius R, is the
    value at the radius drawn. So a plant's radius depends on its own u alone, and the part below R keeps its shape.
    """
    return radii_at(sizes, species, rng.random(n))


def radii_at(sizes: Sizes | None, species: SpeciesEcology, uniform: Floats) -> Floats:
    """(n,) radii of `draw_radii` for (n,) numbers in [0, 1)."""
    chosen = sizes_of(sizes, species)
    if chosen.sigma == 0:
        return np.full(len(uniform), min(chosen.median, species.max_radius_m))
    most = ndtr(math.log(species.max_radius_m / chosen.median) / chosen.sigma)
    radii = chosen.median * np.exp(chosen.sigma * ndtri(np.maximum(uniform, 1e-12) * most))
    return np.asarray(np.minimum(radii, species.max_radius_m))


def heights_asked_m(parameters: PlacementParameters, species: Ecologies) -> dict[str, tuple[float, float]]:
    """Least and greatest height, metres, of nearly all plants of each species: 98% of the radii."""
    found = {}
    for one in species:
        stand = parameters.plants.get(one.name)
        if stand is not None:
            radii = radii_at(stand.radius_m, one, np.array([0.01, 0.99]))
            scatter = np.exp(2.0 * stand.height_sigma * np.array([-1.0, 1.0]))
            low, high = (one.height_scale * radii**one.height_exponent * scatter).tolist()
            found[one.name] = (low, high)
    return found


def draw_heights(stand: Stand | None, species: SpeciesEcology, radius_m: Floats, rng: np.random.Generator) -> Floats:
    """(n,) heights in metres by the species' allometry, with the stand's scatter."""
    heights = species.height_scale * radius_m**species.height_exponent
    sigma = stand.height_sigma if stand else 0.0
    return np.asarray(heights * np.exp(sigma * rng.standard_normal(len(radius_m))))
