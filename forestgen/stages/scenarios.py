"""Recipe -> scenario: the conditions that its weather is simulated from, checked before anything is simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel

from forestgen.atmosphere.presets import PRESETS, Conditions, Layers, wind_towards
from forestgen.atmosphere.simulate import Chapter, Scenario
from forestgen.atmosphere.sounding import Sounding, first_fault
from forestgen.core.errors import AssetError, RecipeError
from forestgen.core.grey_picture import read_grey
from forestgen.recipe import clouds as recipe_clouds
from forestgen.recipe.cloud_keys import SIMULATED
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.map_files import file_sha256
from forestgen.recipe.paths import inside

_CHANGE_S = 1200.0
_ANY = TypeVar("_ANY")
_Keys = tuple[str | int, ...]


def time_of(drawn: DrawnRecipe) -> float:
    """When the picture is taken, seconds after the simulation begins."""
    clouds = drawn.recipe.sky.clouds
    if clouds.time_s is not None:
        return clouds.time_s
    if clouds.story is not None:
        return clouds.story[-1].at_s + PRESETS[clouds.story[-1].type].time_s
    return PRESETS[clouds.type].time_s


def droplet_radius_um_of(drawn: DrawnRecipe, scenario: Scenario, time_s: float) -> float:
    """Effective radius of the droplets at a time: the recipe's, or the type's.

    In a story's later chapters it goes from the radius before to the new type's, linear over change_s.
    """
    from forestgen.atmosphere.extinction import DROPLET_RADIUS_UM

    given = drawn.recipe.sky.clouds.droplet_radius_um
    if given is not None:
        return given

    def radius_um(chapters: Sequence[Chapter], at_s: float) -> float:
        last = chapters[-1]
        own = DROPLET_RADIUS_UM[last.conditions.kind]
        if len(chapters) == 1:
            return own
        before = radius_um(chapters[:-1], last.at_s)
        return before + min((at_s - last.at_s) / last.change_s, 1.0) * (own - before)

    return radius_um([one for one in scenario.chapters if one.at_s <= time_s], time_s)


def scenario_of(drawn: DrawnRecipe) -> Scenario:
    """What a recipe's simulated clouds are simulated from.

    Raises
    ------
    RecipeError : air, ground or a box of air that cannot be.
    """
    clouds = drawn.recipe.sky.clouds
    where = ("sky", "clouds")
    if not clouds.simulated:
        raise RecipeError(
            "the recipe's clouds are not simulated",
            where=drawn.where(*where),
            expected="a type of " + ", ".join(SIMULATED),
            got=clouds.type,
            hint="render the recipe: such clouds come with their community"
            if clouds.type == "community"
            else "set sky.clouds=cumulus",
        )
    if clouds.story is None:
        return Scenario((Chapter(0.0, _conditions(drawn, clouds.type, clouds, where)),))
    return Scenario(
        tuple(
            Chapter(one.at_s, _conditions(drawn, one.type, one, (*where, "story", index)), one.change_s or _CHANGE_S)
            for index, one in enumerate(clouds.story)
        )
    )


def _conditions(drawn: DrawnRecipe, kind: str, keys: recipe_clouds.WeatherKeys, where: _Keys) -> Conditions:
    """The type's values, with those that the recipe gives in their place."""
    preset = PRESETS[kind]
    own = preset.conditions
    from_deg = drawn.recipe.site.wind_from_deg if keys.wind_from_deg is None else keys.wind_from_deg
    measured = keys.sounding is not None and keys.sounding.file is not None
    speed = keys.wind_m_per_s
    if speed is None:
        speed = 0.0 if measured else preset.wind_m_per_s  # a measured sounding has its own
    emission = own.emission if keys.emission is None else _emission(drawn, own.emission, keys.emission, where)
    conditions = replace(
        own,
        emission=emission,
        domain=own.domain if keys.domain is None else _with(own.domain, keys.domain),
        cooling_k_per_h=own.cooling_k_per_h if keys.cooling_k_per_h is None else keys.cooling_k_per_h,
        wind_m_per_s=wind_towards(speed, from_deg) if speed else (0.0, 0.0),
    )
    if keys.sounding is not None:
        conditions = replace(conditions, layers=_layers(drawn, conditions, keys.sounding, where))
    _check_air(drawn, conditions, where)
    _check_box(drawn, conditions, where)
    return conditions


def _with(preset: _ANY, section: BaseModel, skipped: Sequence[str] = ()) -> _ANY:
    """A preset's part with the values that a recipe gives."""
    names = {one.name for one in fields(preset)}  # type: ignore[arg-type]
    given = {name: getattr(section, name) for name in section.model_fields_set if name in names - {*skipped}}
    return replace(preset, **{name: value for name, value in given.items() if value is not None})  # type: ignore[type-var]


def _emission(drawn: DrawnRecipe, own: Any, section: recipe_clouds.EmissionSection, where: _Keys) -> Any:
    from forestgen.atmosphere.sounding import LATENT_HEAT_J_PER_KG

    made = _with(own, section, skipped=("map",))
    if section.vapour_g_per_m2_s is not None:
        made = replace(made, latent_w_per_m2=section.vapour_g_per_m2_s * 1e-3 * LATENT_HEAT_J_PER_KG)
    if section.map is None:
        return made
    place = drawn.where(*where, "emission", "map")
    picture = read_grey(known_file(drawn, section.map, place))
    values = np.asarray(picture.values, dtype=np.float32)[::-1] / np.float32(picture.white)  # row 0 in the south
    if not (np.isfinite(values).all() and values.min() >= 0 and values.mean() > 0):
        expected = "numbers of 0 and more, not all 0"
        raise RecipeError("no map of emission", where=place, expected=expected, got=f"least {values.min():g}")
    return replace(made, map=values)


def _layers(
    drawn: DrawnRecipe, conditions: Conditions, section: recipe_clouds.SoundingSection, where: _Keys
) -> Layers | Sounding:
    if section.file is None:
        assert isinstance(conditions.layers, Layers)
        return _with(conditions.layers, section)
    place = drawn.where(*where, "sounding")
    named = recipe_clouds.NamedFile(file=section.file, sha256=section.sha256)
    path = known_file(drawn, named, place)
    from forestgen.atmosphere.weather_files import read_sounding

    try:
        if section.ground_pressure_hpa is None:
            return read_sounding(path)
        return read_sounding(path, ground_pressure_pa=100.0 * section.ground_pressure_hpa)
    except AssetError as cause:
        raise AssetError(f"{cause.problem}: {path}", where=place, expected=cause.expected, got=cause.got) from cause


def known_file(drawn: DrawnRecipe, named: recipe_clouds.NamedFile, where: str) -> Path:
    """The path of a file that a recipe names, still the one that the recipe was loaded with."""
    path = inside(drawn.folder, named.file, sha256=named.sha256, where=where)
    try:
        found = file_sha256(path, named.file)
    except AssetError as cause:
        raise AssetError(cause.problem, where=where, expected=cause.expected, got=cause.got, hint=cause.hint) from cause
    if named.sha256 is not None and found != named.sha256:
        expected = f"a file whose SHA-256 is {named.sha256[:16]}..."
        raise AssetError("the file has changed since the recipe was loaded", where=where, expected=expected, got=found)
    return path


def _check_air(drawn: DrawnRecipe, conditions: Conditions, where: _Keys) -> None:
    """Refuse air that cannot be: supersaturated, or heavier above than below."""
    place = drawn.where(*where, "sounding")
    expected = "air as there is: cooling of at most 34 K/km, temperatures from -120 to 75 °C"
    try:
        sounding = conditions.sounding()
    except ValueError as cause:
        raise RecipeError("no such air can be", where=place, expected=expected, got=str(cause)) from cause
    fault = first_fault(sounding)
    if fault is not None:
        at = "" if fault.level is None else f" at {sounding.height_m[fault.level]:g} m"
        raise RecipeError(f"no such air can be: {fault.what}{at}", where=place, expected=fault.expected, got=fault.got)


def _check_box(drawn: DrawnRecipe, conditions: Conditions, where: _Keys) -> None:
    """Refuse a box of air smaller than the site, without height, or of too many or too few cells."""
    domain, site = conditions.domain, drawn.recipe.site
    if max(site.size_m) > domain.extent_m:
        raise RecipeError(
            "the site is larger than the box of air in which its weather is simulated",
            where=drawn.where(*where, "domain"),
            expected=f"sky.clouds.domain.extent_m of at least {max(site.size_m):g} m",
            got=f"{domain.extent_m:g} m",
            hint="make the domain larger, or the site smaller",
        )
    if isinstance(conditions.layers, Layers) and conditions.layers.inversion_m >= domain.height_m:
        raise RecipeError(
            "the box of air ends below the inversion",
            where=drawn.where(*where, "domain"),
            expected=f"a height_m of more than {conditions.layers.inversion_m:g} m, the sounding's inversion_m",
            got=f"{domain.height_m:g} m",
            hint="raise domain.height_m, or lower sounding.inversion_m",
        )
    if max(domain.cells) > 2048:
        raise RecipeError(
            "too many cells",
            where=drawn.where(*where, "domain"),
            expected="at most 2048 along a side",
            got=" x ".join(str(one) for one in domain.cells),
            hint="make cell_m and cell_height_m larger",
        )
