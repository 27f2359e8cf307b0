"""What a cloud source is; how the air that a source has is put over the site; and the numbers that describe its clouds.

A source is one object named in `forestgen.recipe.registries`. `grid` makes the clouds of an image; the other methods
describe them before anything is simulated.

In statistics a cell is cloudy where its droplets' mass ratio is at least `CLOUDY`. A column's base is the bottom of its
lowest cloudy cell, its top the top of its highest.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

import numpy as np
from pydantic import Field

from forestgen.atmosphere.extinction import cloud_grid_of
from forestgen.atmosphere.grid import CloudGrid, Weather
from forestgen.core.errors import AssetError, RecipeError
from forestgen.core.progress import Progress
from forestgen.recipe.fields import Flag, Number, Positive
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.registries import CLOUD_SOURCES
from forestgen.recipe.sky import Clouds, CloudsBelowCirrus

CLOUDY = 1e-5  # kg/kg
_LOW_PERCENT, _HIGH_PERCENT = 10.0, 99.0
_WATER_KG_PER_M3 = 1000.0
KeysT = TypeVar("KeysT", bound=Clouds)
# Clouds so far above the scene may be traced from afar: metres, a share of the site's diagonal (render/cloud_shadow.py)
LEAST_GAP_M, GAP_OF_SITE = 100.0, 0.5
_MOST_OPTICAL_DEPTH = 5000.0  # of a thundercloud's core
_SHOWN_BY_TOP, _SHOWN_M = 12.0, (4000.0, 24_000.0)  # how far clouds are shown, by the height of their tops
_MOST_TILES = 7
DETAILED_FROM_M = 40.0  # largest side of a cell
_BYTES_PER_AIR_CELL = 160  # the state twice, its rates of change, and the pressure's transform
_BYTES_PER_DETAILED_CELL = 400  # where a tenth of the cells are at an edge, as in cumulus
_BYTES_PER_SHOWN_CELL = 32  # extinction with its copies, and the renderer's; exact was measured to take 17


@dataclass(frozen=True)
class CloudStatistics:
    """Of one snapshot. Heights are above the datum; None where there is no cloud."""

    time_s: float
    cover: float  # share of columns with a cloudy cell
    base_m: float | None  # that a tenth of the cloudy columns' bases lie below
    top_m: float | None  # that a hundredth of the cloudy columns' tops lie above
    mean_base_m: float | None  # over cloudy columns
    mean_top_m: float | None
    cloud_kg_per_m2: float  # liquid water path of droplets, over all columns: mm
    rain_kg_per_m2: float  # the same of falling drops
    fallen_kg_per_m2: float  # rain on the ground since the beginning, mean: mm
    optical_depth: float  # of droplets straight up, mean over cloudy columns, at the radius given
    updraught_m_per_s: float  # largest upward speed


def cloud_statistics(weather: Weather, *, droplet_radius_um: float = 10.0) -> CloudStatistics:
    """Base, top, cover and water of the clouds in a snapshot."""
    cloudy = weather.cloud >= CLOUDY
    columns = cloudy.any(axis=0)
    low_m, side_m = weather.grid.low_m[2], weather.grid.cell_m[2]
    base_m, top_m, mean_base_m, mean_top_m = (None,) * 4
    if columns.any():
        first = np.argmax(cloudy, axis=0)[columns]
        last = len(cloudy) - np.argmax(cloudy[::-1], axis=0)[columns]
        layers = np.percentile(first, _LOW_PERCENT), np.percentile(last, _HIGH_PERCENT), first.mean(), last.mean()
        base_m, top_m, mean_base_m, mean_top_m = (low_m + side_m * float(one) for one in layers)
    path = weather.cloud_water_kg_per_m3.sum(axis=0, dtype=np.float64) * side_m
    depth = 1.5 * path / (_WATER_KG_PER_M3 * droplet_radius_um * 1e-6)
    return CloudStatistics(
        weather.time_s,
        float(columns.mean()),
        base_m,
        top_m,
        mean_base_m,
        mean_top_m,
        cloud_kg_per_m2=float(path.mean()),
        rain_kg_per_m2=float(weather.rain_water_kg_per_m3.sum(axis=0, dtype=np.float64).mean() * side_m),
        fallen_kg_per_m2=float(weather.fallen_kg_per_m2.mean()),
        optical_depth=float(depth[columns].mean()) if columns.any() else 0.0,
        updraught_m_per_s=float(weather.up_m_per_s.max()),
    )


class AirKeys(CloudsBelowCirrus):
    """Keys of sources whose clouds are those of a state of the air."""

    droplet_radius_um: Positive | None = Field(
        None, le=100, description="Effective radius of the cloud's droplets, micrometres. Default: the type's."
    )
    repeat: Flag | None = Field(
        None, description="Whether the clouds go on beyond the box, over and over, to the horizon. Default: they do."
    )
    detail: Flag | None = Field(
        None,
        description="Whether clouds have sharp edges and billows within the cells of the air, down to some metres, of "
        "the same water. Default: they have where cells are wider than 40 m; never with render.clouds: exact, and over "
        "terrain of the air's own.",
    )


class PlacedKeys(AirKeys):
    """The same, where the clouds can be moved."""

    offset_m: tuple[Number, Number] | None = Field(
        None, description="Where the middle of the clouds lies from the site's, metres east and north. Default 0, 0."
    )

    def centre_m(self, request: CloudRequest) -> tuple[float, float]:
        """World x and y of the clouds' middle."""
        (x, y), (east, north) = request.middle_of_site_m, self.offset_m or (0.0, 0.0)
        return x + east, y + north


@dataclass(frozen=True)
class CloudRequest:
    """What clouds are made for."""

    drawn: DrawnRecipe
    ground_m: float  # height of the site's lowest ground, on which weather stands
    progress: Progress
    plan: Any = None  # forestgen.community.simulation.CommunityPlan
    population: Any = None  # forestgen.community.population.Population: the community as it stands in the image

    @property
    def middle_of_site_m(self) -> tuple[float, float]:
        """World x and y."""
        width, depth = self.drawn.recipe.site.size_m
        return width / 2, depth / 2


@dataclass(frozen=True)
class WeatherReport:
    """The weather of one image."""

    weather: Weather
    kind: str  # type of the conditions at that time
    droplet_radius_um: float

    @cached_property
    def statistics(self) -> CloudStatistics:
        return cloud_statistics(self.weather, droplet_radius_um=self.droplet_radius_um)


class CloudSource(Generic[KeysT]):
    """Clouds of one kind: its keys, checks, estimates and fields."""

    Parameters: type[KeysT]  # keys of `sky.clouds`

    def keys_of(self, drawn: DrawnRecipe) -> KeysT:
        """The section `sky.clouds`, of a recipe that names this source."""
        return cast(KeysT, drawn.recipe.sky.clouds)

    def check(self, drawn: DrawnRecipe) -> None:
        """Raise `RecipeError` for clouds that cannot be, or that light cannot cross."""

    def check_community(self, drawn: DrawnRecipe, model: object, parameters: Any) -> None:
        """Raise `RecipeError` for clouds that a community model of such `CommunityParameters` cannot have."""

    def known_base_m(self, drawn: DrawnRecipe) -> float | None:
        """Height of the clouds' base where the recipe itself says it; None: unknown before they are made."""
        return None

    def estimate_bytes(self, drawn: DrawnRecipe, model: object, parameters: Any) -> int:
        """Memory that making the clouds takes at most; `model` and `parameters` as in `check_community`."""
        raise NotImplementedError

    def grid(self, request: CloudRequest) -> CloudGrid | None:
        """The clouds of an image, world; None: there are none. `RecipeError`: impossible weather or a bad file."""
        raise NotImplementedError

    def air(self, drawn: DrawnRecipe, progress: Progress) -> WeatherReport:
        """The state of the air that the clouds are of, without the community. `RecipeError`: these clouds have none."""
        simulated = [name for name, one in CLOUD_SOURCES.parts() if type(one).air is not CloudSource.air]
        problem, where = "the recipe's clouds are not simulated", drawn.where("sky", "clouds")
        expected = "a type of " + ", ".join(simulated)
        hint = "set sky.clouds to one of these; clouds that come with their community are seen in its images"
        raise RecipeError(problem, where=where, expected=expected, got=drawn.recipe.sky.clouds.type, hint=hint)


def cloud_source_of(drawn: DrawnRecipe) -> CloudSource[Any]:
    """The source that a recipe names."""
    source: CloudSource[Any] = CLOUD_SOURCES.load(drawn.recipe.sky.clouds.type)
    return source


def clouds_of_air(
    request: CloudRequest, keys: AirKeys, weather: Weather, radius_um: float, centre: tuple[float, float]
) -> CloudGrid | None:
    """The clouds of a state of the air over the site, repeated sideways as far as they are seen.

    `radius_um` is the droplets' effective radius, `centre` the world x and y of the field's middle. Raises
    `RecipeError` as `check_depth` and `on_the_ground` do.
    """
    repeat = weather.grid.periodic and weather.solid is None and keys.repeat is not False
    wanted = max(weather.grid.cell_m) > DETAILED_FROM_M if keys.detail is None else keys.detail
    seen = weather.solid is None and request.drawn.recipe.render.clouds != "exact"  # which traces the cells' means
    grid = cloud_grid_of(
        weather,
        centre_m=None if weather.solid is not None else centre,
        droplet_radius_um=radius_um,
        tiles=_tiles(weather) if repeat else 1,
        detailed=wanted and seen,
    )
    if grid is None:
        return None
    check_depth(request.drawn, grid, "raise droplet_radius_um, or let the ground give less vapour")
    return on_the_ground(request, grid)


def check_depth(drawn: DrawnRecipe, grid: CloudGrid, hint: str) -> None:
    """Raise `RecipeError` if the field is too thick to be traced."""
    depth = float(grid.extinction_per_m.sum(axis=0, dtype=np.float64).max()) * grid.cell_m[2]
    if depth > _MOST_OPTICAL_DEPTH:
        problem, where = "the clouds are too thick to be traced in reasonable time", drawn.where("sky", "clouds")
        expected = f"an optical depth of at most {_MOST_OPTICAL_DEPTH:g}; thunderclouds have hundreds"
        raise RecipeError(problem, where=where, expected=expected, got=f"{depth:.3g} in the thickest column", hint=hint)


@contextmanager
def naming_the_file(path: Path, where: str | None) -> Iterator[None]:
    """Errors of a file's content name the file and the key that names it."""
    try:
        yield
    except AssetError as cause:
        raise AssetError(f"{cause.problem}: {path}", where=where, expected=cause.expected, got=cause.got) from cause


def on_the_ground(request: CloudRequest, grid: CloudGrid) -> CloudGrid:
    """The field raised to the site's ground; refused if it is smaller than the site."""
    site = request.drawn.recipe.site.size_m
    size = [high - low for low, high in zip(grid.low_m, grid.high_m, strict=True)][:2]
    if any(own < wanted for own, wanted in zip(size, site, strict=True)):
        problem, expected = "the site is larger than its clouds", f"a field of at least {site[0]:g} x {site[1]:g} m"
        got, hint = f"{size[0]:g} x {size[1]:g} m", "make the site smaller, or simulate a larger domain"
        raise RecipeError(problem, where=request.drawn.where("sky", "clouds"), expected=expected, got=got, hint=hint)
    low, high = ((*one[:2], one[2] + request.ground_m) for one in (grid.low_m, grid.high_m))
    return replace(grid, low_m=low, high_m=high)


def _tiles(weather: Weather) -> int:
    """Copies side by side, an odd number, that reach about as far as clouds of this height are seen."""
    cloudy = np.flatnonzero((weather.cloud + weather.rain).any(axis=(1, 2)))
    top_m = (int(cloudy[-1]) + 1) * weather.grid.cell_m[2] if len(cloudy) else 0.0
    shown_m = float(np.clip(_SHOWN_BY_TOP * top_m, *_SHOWN_M))
    return _tiles_across(shown_m, weather.grid.size_m[0])


def _tiles_across(shown_m: float, extent_m: float) -> int:
    return min(1 + 2 * max(0, round((shown_m / extent_m - 1.0) / 2.0)), _MOST_TILES)


def simulated_bytes(keys: AirKeys, cells: int, extent_m: float) -> int:
    """Estimated memory of air in a box of some width, and of what is shown of it."""
    tiles = _tiles_across(_SHOWN_M[1], extent_m) if keys.repeat is not False and extent_m else 1
    detail = 0 if keys.detail is False else _BYTES_PER_DETAILED_CELL
    return cells * (max(_BYTES_PER_AIR_CELL, tiles**2 * _BYTES_PER_SHOWN_CELL) + detail)
