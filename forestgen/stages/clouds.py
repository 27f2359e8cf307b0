"""Recipe -> clouds of the scene: simulated, of noise, or from a file."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from forestgen.atmosphere.extinction import DROPLET_RADIUS_UM
from forestgen.atmosphere.grid import CloudGrid
from forestgen.atmosphere.kept_weather import weather_store
from forestgen.atmosphere.procedural import cumulus_field
from forestgen.atmosphere.simulate import simulate
from forestgen.atmosphere.weather import AirGrid, Weather
from forestgen.community.capabilities import OwnAir, capability, models_with
from forestgen.community.model import CommunityParameters
from forestgen.core.errors import AssetError, RecipeError
from forestgen.core.progress import Progress
from forestgen.core.randomness import child_rng
from forestgen.recipe import clouds as recipe_clouds
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.paths import inside
from forestgen.stages.scenarios import droplet_radius_um_of, known_file, scenario_of, time_of

MOST_OPTICAL_DEPTH = 200.0  # straight up, of noise: small cumulus
_MOST_SIMULATED_DEPTH = 5000.0  # of a thundercloud's core
_WIDEST_M, _HIGHEST_M = 1e6, 1e5  # of a file's box
_SHOWN_BY_TOP, _SHOWN_M = 12.0, (4000.0, 24_000.0)  # how far clouds are shown, by the height of their tops
_MOST_TILES = 7
_BYTES_PER_AIR_CELL = 160  # the state twice, its rates of change, and the pressure's transform
_BYTES_PER_CLOUD_CELL = 60  # of noise, which is made of it
_BYTES_PER_SHOWN_CELL = 32  # extinction with its copies, and the renderer's; exact was measured to take 17


def clouds_of(drawn: DrawnRecipe, ground_m: float, progress: Progress, own: Weather | None = None) -> CloudGrid | None:
    """The clouds of a recipe; None where the sky has none.

    Parameters
    ----------
    ground_m : height of the site's lowest ground, on which simulated weather stands.
    own : the air of the community, where the clouds are of that type.

    Raises
    ------
    RecipeError : weather that cannot be, or a file that cannot be read.
    """
    clouds, site = drawn.recipe.sky.clouds, drawn.recipe.site
    offset = clouds.offset_m or (0.0, 0.0)
    centre = (site.size_m[0] / 2 + offset[0], site.size_m[1] / 2 + offset[1])
    if clouds.type == "none" or (clouds.type == "noise" and clouds.cover == 0):
        return None
    if clouds.type == "noise":
        return _noise(clouds, centre, child_rng(drawn.image_seed, "clouds"))
    if clouds.type == "file":
        return _from_file(drawn, centre, ground_m)
    if clouds.type == "community":
        assert own is not None
        radius_um = clouds.droplet_radius_um or DROPLET_RADIUS_UM["cumulus"]
        return _placed(drawn, own, radius_um, centre, ground_m)
    weather = weather_of(drawn, progress)
    radius_um = droplet_radius_um_of(drawn, scenario_of(drawn), weather.time_s)
    return _placed(drawn, weather, radius_um, centre, ground_m)


def known_base_m(clouds: recipe_clouds.Clouds) -> float | None:
    """Height of the clouds' base where the recipe itself says it; None: nobody knows before they are made."""
    return clouds.base_m if clouds.type == "noise" else None


def weather_of(drawn: DrawnRecipe, progress: Progress) -> Weather:
    """The state of the air at the recipe's time: from the cache, or simulated.

    Raises
    ------
    RecipeError : the recipe's clouds are not simulated, or the simulation fails.
    """
    from forestgen.atmosphere.fluid.parameters import UnstableError

    clouds, recipe = drawn.recipe.sky.clouds, drawn.recipe
    scenario = scenario_of(drawn)
    seed = recipe.seed if clouds.seed is None else clouds.seed
    try:
        return simulate(scenario, seed=seed, until_s=time_of(drawn), progress=progress, kept=weather_store())
    except UnstableError as cause:
        raise RecipeError(
            "the weather cannot be simulated",
            where=drawn.where("sky", "clouds"),
            expected="air that stays slower than any storm",
            got=str(cause),
            hint="lower the emission or the wind, or make the cells of domain larger",
        ) from cause
    except ValueError as cause:  # what no check before has seen
        raise RecipeError(
            "the weather cannot be simulated",
            where=drawn.where("sky", "clouds"),
            expected="air that can be, and a box of it that can be stepped",
            got=str(cause),
            hint="change the sounding, or the cells of domain",
        ) from cause


def _noise(clouds: recipe_clouds.Clouds, centre: tuple[float, float], rng: np.random.Generator) -> CloudGrid:
    assert clouds.extent_m is not None
    assert clouds.base_m is not None
    assert clouds.thickness_m is not None
    assert clouds.cover is not None
    assert clouds.extinction_per_m is not None
    return cumulus_field(
        centre_m=centre,
        extent_m=clouds.extent_m,
        base_m=clouds.base_m,
        thickness_m=clouds.thickness_m,
        cover=clouds.cover,
        extinction_per_m=clouds.extinction_per_m,
        rng=rng,
    )


def _from_file(drawn: DrawnRecipe, centre: tuple[float, float], ground_m: float) -> CloudGrid | None:
    """A state of the air, or a volume of extinction: its middle over the site, its height from the lowest ground."""
    from forestgen.atmosphere.weather_files import read_droplet_radius_um, read_sky

    clouds = drawn.recipe.sky.clouds
    named = clouds.file
    assert named is not None
    where = drawn.where("sky", "clouds", "file")
    path = known_file(drawn, named, where)
    try:
        found = read_sky(path)
        radius_um = clouds.droplet_radius_um
        if radius_um is None and isinstance(found, Weather):
            radius_um = read_droplet_radius_um(path)
    except AssetError as cause:
        raise AssetError(f"{cause.problem}: {path}", where=where, expected=cause.expected, got=cause.got) from cause
    if isinstance(found, CloudGrid):
        _check_keys_of_volumes(drawn)
        _check_box_of_volume(drawn, found)
        _check_depth(drawn, found)
        return _on_the_ground(drawn, _centred(found, centre), ground_m)
    if radius_um is None:
        raise RecipeError(
            "the file does not say how large its droplets are",
            where=where,
            expected="sky.clouds.droplet_radius_um, micrometres: fog 8, cumulus 10, cumulonimbus 15",
            got="none",
            hint="set it, or save the weather again with forestgen weather",
        )
    return _placed(drawn, found, radius_um, centre, ground_m)


def _check_keys_of_volumes(drawn: DrawnRecipe) -> None:
    """A field of extinction has its droplets in it, and need not fit to itself at its sides."""
    clouds = drawn.recipe.sky.clouds
    refused = (("droplet_radius_um", clouds.droplet_radius_um is not None), ("repeat", bool(clouds.repeat)))
    for key, given in refused:
        if given:
            raise RecipeError(
                f"a file of extinction has no {key}",
                where=drawn.where("sky", "clouds", key),
                expected="the file and offset_m alone",
                got=f"{getattr(clouds, key)}",
                hint=f"leave out {key}, or save the state of the air, .nc, instead",
            )


def _check_box_of_volume(drawn: DrawnRecipe, grid: CloudGrid) -> None:
    """Raise `RecipeError` if a field is nowhere near the ground, or as wide as a continent."""
    width_m = max(high - low for low, high in zip(grid.low_m[:2], grid.high_m[:2], strict=True))
    if width_m <= _WIDEST_M and grid.low_m[2] >= -_HIGHEST_M and 0 < grid.high_m[2] <= _HIGHEST_M:
        return
    raise RecipeError(
        "the file's box is not one of clouds",
        where=drawn.where("sky", "clouds", "file"),
        expected=f"metres: at most {_WIDEST_M:g} wide, its top above the ground and at most {_HIGHEST_M:g} high",
        got=f"{width_m:g} wide, from {grid.low_m[2]:g} to {grid.high_m[2]:g} high",
        hint="give the file's box in metres",
    )


def _check_depth(drawn: DrawnRecipe, grid: CloudGrid) -> None:
    """Raise `RecipeError` if light would take for ever through the field."""
    depth = float(grid.extinction_per_m.sum(axis=0, dtype=np.float64).max()) * grid.cell_m[2]
    if depth <= _MOST_SIMULATED_DEPTH:
        return
    raise RecipeError(
        "the clouds are too thick to be traced in reasonable time",
        where=drawn.where("sky", "clouds"),
        expected=f"an optical depth of at most {_MOST_SIMULATED_DEPTH:g}; thunderclouds have hundreds",
        got=f"{depth:.3g} in the thickest column",
        hint="check the file's unit: extinction per metre"
        if drawn.recipe.sky.clouds.type == "file"
        else "raise droplet_radius_um, or let the ground give less vapour",
    )


def _centred(grid: CloudGrid, centre: tuple[float, float]) -> CloudGrid:
    """The field moved sideways, its middle to a place."""
    x, y = (at - (low + high) / 2 for at, low, high in zip(centre, grid.low_m, grid.high_m, strict=False))
    low, high = ((one[0] + x, one[1] + y, one[2]) for one in (grid.low_m, grid.high_m))
    return replace(grid, low_m=low, high_m=high)


def _on_the_ground(drawn: DrawnRecipe, grid: CloudGrid, ground_m: float) -> CloudGrid:
    """The field raised to the site's ground; refused if it is smaller than the site, whose rest had no clouds."""
    site = drawn.recipe.site.size_m
    size = [high - low for low, high in zip(grid.low_m, grid.high_m, strict=True)][:2]
    if any(own < wanted for own, wanted in zip(size, site, strict=True)):
        raise RecipeError(
            "the site is larger than its clouds",
            where=drawn.where("sky", "clouds"),
            expected=f"a field of at least {site[0]:g} x {site[1]:g} m",
            got=f"{size[0]:g} x {size[1]:g} m",
            hint="make the site smaller, or simulate a larger domain",
        )
    low, high = ((*one[:2], one[2] + ground_m) for one in (grid.low_m, grid.high_m))
    return replace(grid, low_m=low, high_m=high)


def _placed(
    drawn: DrawnRecipe, weather: Weather, radius_um: float, centre: tuple[float, float], ground_m: float
) -> CloudGrid | None:
    """The clouds of a state of the air over the site, repeated sideways as far as they are seen."""
    from forestgen.atmosphere.extinction import cloud_grid_of

    clouds = drawn.recipe.sky.clouds
    repeat = weather.grid.periodic and weather.solid is None and clouds.repeat is not False
    grid = cloud_grid_of(
        weather,
        kind=clouds.type,
        centre_m=None if weather.solid is not None else centre,
        droplet_radius_um=radius_um,
        tiles=_tiles(weather) if repeat else 1,
    )
    if grid is None:
        return None
    _check_depth(drawn, grid)
    return _on_the_ground(drawn, grid, ground_m)


def _tiles(weather: Weather) -> int:
    """Copies side by side, an odd number, that reach about as far as clouds of this height are seen."""
    cloudy = np.flatnonzero((weather.cloud + weather.rain).any(axis=(1, 2)))
    top_m = (int(cloudy[-1]) + 1) * weather.grid.cell_m[2] if len(cloudy) else 0.0
    shown_m = float(np.clip(_SHOWN_BY_TOP * top_m, *_SHOWN_M))
    return _tiles_across(shown_m, weather.grid.size_m[0])


def _tiles_across(shown_m: float, extent_m: float) -> int:
    return min(1 + 2 * max(0, round((shown_m / extent_m - 1.0) / 2.0)), _MOST_TILES)


def cloud_bytes(drawn: DrawnRecipe, own: AirGrid | None = None) -> int:
    """Memory that the clouds take at most, by estimate.

    Parameters
    ----------
    own : see `own_air_grid`.
    """
    clouds = drawn.recipe.sky.clouds
    if own is not None:
        return _simulated_bytes(math.prod(own.cells), own.size_m[0], repeated=clouds.repeat is not False)
    if clouds.type == "none":
        return 0
    if clouds.type == "noise":
        assert clouds.extent_m is not None
        assert clouds.thickness_m is not None
        return int((clouds.extent_m / 40) ** 2 * max(8, clouds.thickness_m / 20) * _BYTES_PER_CLOUD_CELL)
    if clouds.type == "file":
        if clouds.file is None:
            return 0
        path = inside(drawn.folder, clouds.file.file, sha256=clouds.file.sha256)
        return _file_bytes(path, repeated=clouds.repeat is not False)
    most = 0
    for chapter in scenario_of(drawn).chapters:
        domain = chapter.conditions.domain
        here = _simulated_bytes(math.prod(domain.cells), domain.extent_m, repeated=clouds.repeat is not False)
        most = max(most, here)
    return most


def _simulated_bytes(cells: int, extent_m: float, *, repeated: bool) -> int:
    """Memory of air in a box of some width, and of what is shown of it."""
    tiles = _tiles_across(_SHOWN_M[1], extent_m) if repeated and extent_m else 1
    return cells * max(_BYTES_PER_AIR_CELL, tiles**2 * _BYTES_PER_SHOWN_CELL)


def _file_bytes(path: Path, *, repeated: bool) -> int:
    """The same of a saved field, by its size and not by the file's, which is compressed."""
    from forestgen.atmosphere.weather_files import size_of

    size = size_of(path)
    if size is None:
        return 0  # whatever is wrong with the file is told where it is read
    cells, extent_m = size
    return _simulated_bytes(cells, extent_m or 0.0, repeated=repeated)


def check_clouds(drawn: DrawnRecipe) -> None:
    """Clouds that can be made and that light can cross, as far as that is known before they are made.

    Raises
    ------
    RecipeError : see `scenario_of`; or too thick.
    """
    clouds = drawn.recipe.sky.clouds
    if clouds.simulated:
        scenario_of(drawn)
    if clouds.type != "noise":
        return
    assert clouds.extinction_per_m is not None
    assert clouds.thickness_m is not None
    depth = clouds.extinction_per_m * clouds.thickness_m
    if depth > MOST_OPTICAL_DEPTH:
        raise RecipeError(
            "the clouds are too thick to be traced in reasonable time",
            where=drawn.where("sky", "clouds"),
            expected=f"extinction_per_m x thickness_m of at most {MOST_OPTICAL_DEPTH:g}; cumulus have tens",
            got=f"{clouds.extinction_per_m:g} x {clouds.thickness_m:g} = {depth:g}",
        )


def own_air_grid(drawn: DrawnRecipe, model: object, parameters: CommunityParameters) -> AirGrid | None:
    """The cells of the community's air, if that makes the clouds.

    Raises
    ------
    RecipeError : the community simulates no air when the picture is taken; with the line of the key.
    """
    if drawn.recipe.sky.clouds.type != "community":
        return None
    air = capability(model, OwnAir)
    if air is None:
        raise RecipeError(
            "this community has no air of its own",
            where=drawn.where("sky", "clouds", "type"),
            expected=f"community.model: {models_with(OwnAir)}, with a section weather",
            got=drawn.recipe.community.model,
            hint="set sky.clouds=cumulus for clouds that know no plants",
        )
    return air.air_grid(drawn, parameters)
