"""Clouds from a file: a saved state of the air, or a field of extinction.

A state of the air (.nc) is what `forestgen weather RECIPE -o sky.nc` writes; it is made to clouds as simulated weather
is. A field of extinction per metre (.vol, or .nc of other programs) has its droplets in it, and is not repeated. The
middle of either lies over the site's, and its height counts from the site's lowest ground.

Example
-------
    sky: {clouds: {type: file, file: sky.nc, droplet_radius_um: 10}}

Parameters: see below.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Self

from pydantic import Field, model_validator

from forestgen.atmosphere.clouds import source
from forestgen.atmosphere.grid import CloudGrid, Weather
from forestgen.core.errors import RecipeError
from forestgen.recipe.assets import inside
from forestgen.recipe.fields import shorthand, violation
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.map_files import known_file
from forestgen.recipe.sky import NamedFile

_WIDEST_M, _HIGHEST_M = 1e6, 1e5  # of a file's box


class SavedKeys(source.PlacedKeys):
    """Keys of `clouds: {type: file}`."""

    file: Annotated[NamedFile | None, *shorthand("file")] = Field(
        None, description="Of type file: a saved state of the air (.nc), or a volume of extinction per metre (.vol)."
    )

    @model_validator(mode="after")
    def _is_a_sky(self) -> Self:
        if self.file is None:
            raise violation("file: sky.nc", problem="no file is named", got="type: file", at=("type",))
        if not self.file.file.lower().endswith((".nc", ".vol")):
            expected = "a state of the air, NAME.nc, or a volume of extinction, NAME.vol"
            hint = "forestgen weather RECIPE -o sky.nc writes one"
            raise violation(expected, problem="this file holds no sky", got=self.file.file, hint=hint, at=("file",))
        return self


class SavedClouds(source.CloudSource[SavedKeys]):
    """A saved state of the air, or a field of extinction."""

    Parameters = SavedKeys

    def estimate_bytes(self, drawn: DrawnRecipe, model: object, parameters: object) -> int:
        """By the size of the field, not by that of the file, which is compressed."""
        from forestgen.atmosphere.weather_files import size_of

        keys = self.keys_of(drawn)
        assert keys.file is not None
        size = size_of(inside(drawn.folder, keys.file.file, sha256=keys.file.sha256))
        if size is None:
            return 0  # what is wrong with the file is reported where it is read
        cells, extent_m = size
        return source.simulated_bytes(keys, cells, extent_m or 0.0)

    def grid(self, request: source.CloudRequest) -> CloudGrid | None:
        from forestgen.atmosphere.weather_files import read_droplet_radius_um, read_sky

        drawn, keys = request.drawn, self.keys_of(request.drawn)
        assert keys.file is not None
        where = drawn.where("sky", "clouds", "file")
        path = known_file(drawn.folder, keys.file.file, keys.file.sha256, where)
        with source.naming_the_file(path, where):
            found = read_sky(path)
            radius_um = keys.droplet_radius_um
            if radius_um is None and isinstance(found, Weather):
                radius_um = read_droplet_radius_um(path)
        centre = keys.centre_m(request)
        if isinstance(found, CloudGrid):
            _check_keys_of_volumes(drawn, keys)
            _check_box_of_volume(drawn, found)
            source.check_depth(drawn, found, "check the file's unit: extinction per metre")
            return source.on_the_ground(request, _centred(found, centre))
        if radius_um is None:
            problem = "the file does not say how large its droplets are"
            expected = "sky.clouds.droplet_radius_um, micrometres: fog 8, cumulus 10, cumulonimbus 15"
            hint = "set it, or save the weather again with forestgen weather"
            raise RecipeError(problem, where=where, expected=expected, got="none", hint=hint)
        return source.clouds_of_air(request, keys, found, radius_um, centre)


def _check_keys_of_volumes(drawn: DrawnRecipe, clouds: SavedKeys) -> None:
    """A field of extinction has its droplets in it, and need not fit to itself at its sides."""
    refused = (("droplet_radius_um", clouds.droplet_radius_um is not None), ("repeat", bool(clouds.repeat)))
    for key, given in refused:
        if given:
            problem, expected = f"a file of extinction has no {key}", "the file and offset_m alone"
            got, hint = f"{getattr(clouds, key)}", f"leave out {key}, or save the state of the air, .nc, instead"
            raise RecipeError(problem, where=drawn.where("sky", "clouds", key), expected=expected, got=got, hint=hint)


def _check_box_of_volume(drawn: DrawnRecipe, grid: CloudGrid) -> None:
    """Raise `RecipeError` if a field is nowhere near the ground, or as wide as a continent."""
    width_m = max(high - low for low, high in zip(grid.low_m[:2], grid.high_m[:2], strict=True))
    if width_m <= _WIDEST_M and grid.low_m[2] >= -_HIGHEST_M and 0 < grid.high_m[2] <= _HIGHEST_M:
        return
    problem, where = "the file's box is not one of clouds", drawn.where("sky", "clouds", "file")
    expected = f"metres: at most {_WIDEST_M:g} wide, its top above the ground and at most {_HIGHEST_M:g} high"
    got = f"{width_m:g} wide, from {grid.low_m[2]:g} to {grid.high_m[2]:g} high"
    raise RecipeError(problem, where=where, expected=expected, got=got, hint="give the file's box in metres")


def _centred(grid: CloudGrid, centre: tuple[float, float]) -> CloudGrid:
    """The field moved sideways, its middle to a place."""
    x, y = (at - (low + high) / 2 for at, low, high in zip(centre, grid.low_m, grid.high_m, strict=False))
    low, high = ((one[0] + x, one[1] + y, one[2]) for one in (grid.low_m, grid.high_m))
    return replace(grid, low_m=low, high_m=high)


SOURCE = SavedClouds()
