"""Simulated weather: five types of clouds by one set of parameters, alone or as the phases of a story.

The air in a box around the site is simulated (`forestgen.atmosphere.simulate`) from air at rest, what the ground gives
off, and wind; `forestgen.atmosphere.conditions` says how these are described. Each type is a set of values; keys of
the recipe take their place one by one. One simulation is made for all images with the same seed, and kept.

What makes the types (Figs. 23, 24 and section 3.2.2.6)
    fog             A moist layer below an inversion at the ground, cooled through: it condenses where it stands.
    stratus         The same higher up: a grey layer that the ground's heat has lifted and the inversion holds.
    stratocumulus   A mixed layer whose uppermost 200 m below the inversion are saturated, stirred from below.
    cumulus         Dry thermals of a heated ground; what they carry condenses over the mixed layer, and warmer air
                    stops it 1 km higher.
    cumulonimbus    The same in air that cools quickly up to the inversion at 8 km: released heat carries the clouds
                    there, where they spread into an anvil.

Effective radius of the droplets, of which simulated air has none
    fog             8 um: 4 to 11, more over the sea (Hess, Koepke and Schult 1998: 10.7)
    stratus         8 um: continental 7.3, maritime 11.3 (Hess et al. 1998); 5.4 and 9.6 (Miles et al. 2000)
    stratocumulus  10 um: 8 to 12 (Martin, Johnson and Spice 1994, maritime)
    cumulus        10 um: 5.8 continental, 12.7 maritime (Hess et al. 1998)
    cumulonimbus   15 um: 10 at the base to 20 and more aloft (Rosenfeld and Lensky 1998)

Example
-------
    sky: {clouds: {type: cumulus, sounding: {inversion_m: 2000}, emission: {heat_w_per_m2: 200}}}

Parameters: see below, and the values at the end of this module.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import ClassVar, Self, TypeVar

import numpy as np
from pydantic import BaseModel, Field, model_validator

from forestgen.atmosphere.clouds import source
from forestgen.atmosphere.clouds.weather_keys import EmissionSection, Phase, SoundingSection, WeatherKeys
from forestgen.atmosphere.conditions import Conditions, Domain, Emission, Layers, wind_towards
from forestgen.atmosphere.fluid.parameters import UnstableError
from forestgen.atmosphere.grid import CloudGrid
from forestgen.atmosphere.simulate import Scenario, WeatherPhase, simulate, weather_store
from forestgen.atmosphere.sounding import LATENT_HEAT_J_PER_KG, Sounding, first_fault
from forestgen.core.errors import RecipeError
from forestgen.core.progress import Progress
from forestgen.core.raster import read_raster
from forestgen.recipe.fields import NonNegative, Whole, violation
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.map_files import known_file
from forestgen.recipe.registries import CLOUD_SOURCES

_CHANGE_S = 1200.0
_MOST_CELLS = 2048  # along a side of the box of air
_SHAPE = "set its base and top by its sounding, how much there is by its emission, how wide it is by domain"
_ANY = TypeVar("_ANY")
_Keys = tuple[str | int, ...]


class SimulatedKeys(WeatherKeys, source.PlacedKeys):
    """Keys of the simulated types."""

    instead: ClassVar = {
        **dict.fromkeys(("cover", "base_m", "thickness_m", "extinction_per_m", "extent_m"), _SHAPE),
        **{key: f"set domain.{key}" for key in ("cell_m", "cell_height_m")},
    }

    time_s: NonNegative | None = Field(
        None,
        le=1e6,
        description="When the picture is taken, seconds after the simulation begins. Default: the type's; of type "
        "community the end of the day's simulated hours.",
    )
    seed: Whole | None = Field(
        None,
        ge=0,
        lt=2**63,
        description="Of the simulation. Default: the recipe's, so that all images have one sky, simulated once.",
    )
    story: tuple[Phase, ...] | None = Field(
        None,
        min_length=1,
        max_length=50,
        description="Phases of weather one after another, instead of one type; the type above is then left out "
        "or that of the first.",
    )

    @model_validator(mode="after")
    def _story_in_order(self) -> Self:
        if self.story is None:
            return self
        twice = [key for key in WeatherKeys.model_fields if getattr(self, key) is not None]
        if twice:
            hint = f"move {twice[0]} into the phases"
            problem = "the weather is given twice, beside the story and in it"
            raise violation("a story, or its keys", problem=problem, got=", ".join(twice), hint=hint, at=(twice[0],))
        if self.type != self.story[0].type:
            problem = "the story begins with another type"
            raise violation(self.story[0].type, problem=problem, got=self.type, hint="leave out type", at=("type",))
        if self.story[0].at_s != 0:
            raise violation("at_s: 0", problem="the story begins late", got=f"{self.story[0].at_s:g}", at=("story", 0))
        for index, (one, other) in enumerate(pairwise(self.story), start=1):
            if other.at_s <= one.at_s:
                expected = f"more than {one.at_s:g} s, when the phase before it begins"
                place = ("story", index, "at_s")
                raise violation(expected, problem="phases out of order", got=f"{other.at_s:g}", at=place)
        return self


@dataclass(frozen=True, eq=False)
class SimulatedClouds(source.CloudSource[SimulatedKeys]):
    """Weather of a type, by values of the keys that a recipe leaves out."""

    Parameters = SimulatedKeys

    kind: str
    layers: Layers
    emission: Emission
    domain: Domain
    cooling_k_per_h: float
    time_s: float  # at which the clouds are such as the type's name says
    wind_m_per_s: float  # aloft
    droplet_radius_um: float  # effective

    @property
    def conditions(self) -> Conditions:
        return Conditions(self.kind, self.layers, self.emission, self.domain, self.cooling_k_per_h)

    def check(self, drawn: DrawnRecipe) -> None:
        self.scenario(drawn)

    def estimate_bytes(self, drawn: DrawnRecipe, model: object, parameters: object) -> int:
        keys = self.keys_of(drawn)
        domains = [phase.conditions.domain for phase in self.scenario(drawn).phases]
        return max(source.simulated_bytes(keys, math.prod(one.cells), one.extent_m) for one in domains)

    def grid(self, request: source.CloudRequest) -> CloudGrid | None:
        keys, air = self.keys_of(request.drawn), self.air(request.drawn, request.progress)
        return source.clouds_of_air(request, keys, air.weather, air.droplet_radius_um, keys.centre_m(request))

    def air(self, drawn: DrawnRecipe, progress: Progress) -> source.WeatherReport:
        """The air at the recipe's time, kept or simulated. `RecipeError`: as `scenario`, or the simulation fails."""
        keys, scenario, time_s = self.keys_of(drawn), self.scenario(drawn), self.time_of(drawn)
        seed = drawn.recipe.seed if keys.seed is None else keys.seed
        try:
            weather = simulate(scenario, seed=seed, until_s=time_s, progress=progress, kept=weather_store())
        except ValueError as cause:
            expected, hint = "air, and a box of it, that can be stepped", "change the sounding, or the cells of domain"
            if isinstance(cause, UnstableError):  # any other: what no check before has seen
                expected = "air that stays slower than any storm"
                hint = "lower the emission or the wind, or make the cells of domain larger"
            where = drawn.where("sky", "clouds")
            problem = "the weather cannot be simulated"
            raise RecipeError(problem, where=where, expected=expected, got=str(cause), hint=hint) from cause
        return source.WeatherReport(weather, scenario.at(time_s).kind, self.droplet_radius_um_at(drawn, time_s))

    def time_of(self, drawn: DrawnRecipe) -> float:
        """When the picture is taken, seconds after the simulation begins."""
        keys = self.keys_of(drawn)
        if keys.time_s is not None:
            return keys.time_s
        if keys.story is not None:
            last: SimulatedClouds = CLOUD_SOURCES.load(keys.story[-1].type)
            return keys.story[-1].at_s + last.time_s
        return self.time_s

    def droplet_radius_um_at(self, drawn: DrawnRecipe, time_s: float) -> float:
        """Effective radius: the recipe's or the type's, to which a story's phase goes, linear over change_s."""
        given = self.keys_of(drawn).droplet_radius_um
        if given is not None:
            return given

        def radius_um(phases: Sequence[WeatherPhase], at_s: float) -> float:
            last = phases[-1]
            own: float = CLOUD_SOURCES.load(last.conditions.kind).droplet_radius_um
            if len(phases) == 1:
                return own
            before = radius_um(phases[:-1], last.at_s)
            return before + min((at_s - last.at_s) / last.change_s, 1.0) * (own - before)

        return radius_um([one for one in self.scenario(drawn).phases if one.at_s <= time_s], time_s)

    def scenario(self, drawn: DrawnRecipe) -> Scenario:
        """What a recipe's clouds are simulated from. `RecipeError`: air, ground or a box of air that cannot be."""
        keys, where = self.keys_of(drawn), ("sky", "clouds")
        if keys.story is None:
            return Scenario((WeatherPhase(0.0, _conditions(drawn, keys.type, keys, where)),))
        conditions = [_conditions(drawn, one.type, one, (*where, "story", n)) for n, one in enumerate(keys.story)]
        phases = zip(keys.story, conditions, strict=True)
        return Scenario(tuple(WeatherPhase(one.at_s, own, one.change_s or _CHANGE_S) for one, own in phases))


def _conditions(drawn: DrawnRecipe, kind: str, keys: WeatherKeys, where: _Keys) -> Conditions:
    """The type's values, with those that the recipe gives in their place."""
    preset: SimulatedClouds = CLOUD_SOURCES.load(kind)
    own = preset.conditions
    from_deg = drawn.recipe.site.wind_from_deg if keys.wind_from_deg is None else keys.wind_from_deg
    measured = keys.sounding is not None and keys.sounding.file is not None
    speed = keys.wind_m_per_s
    if speed is None:
        speed = 0.0 if measured else preset.wind_m_per_s  # a measured sounding has its own
    conditions = replace(
        own,
        emission=own.emission if keys.emission is None else _emission(drawn, own.emission, keys.emission, where),
        domain=own.domain if keys.domain is None else _with(own.domain, keys.domain),
        cooling_k_per_h=own.cooling_k_per_h if keys.cooling_k_per_h is None else keys.cooling_k_per_h,
        wind_m_per_s=wind_towards(speed, from_deg) if speed else (0.0, 0.0),
    )
    if keys.sounding is not None:
        conditions = replace(conditions, layers=_layers(drawn, conditions, keys.sounding, where))
    _check_air(drawn, conditions, where)
    _check_box(drawn, conditions, where)
    return conditions


def _with(preset: _ANY, section: BaseModel) -> _ANY:
    """A preset's part with the values that a recipe gives, but for maps."""
    names = {one.name for one in fields(preset)} - {"map"}  # type: ignore[arg-type]
    given = {name: getattr(section, name) for name in section.model_fields_set & names}
    return replace(preset, **{name: value for name, value in given.items() if value is not None})  # type: ignore[type-var]


def _emission(drawn: DrawnRecipe, own: Emission, section: EmissionSection, where: _Keys) -> Emission:
    made = _with(own, section)
    if section.vapour_g_per_m2_s is not None:
        made = replace(made, latent_w_per_m2=section.vapour_g_per_m2_s * 1e-3 * LATENT_HEAT_J_PER_KG)
    if section.map is None:
        return made
    place = drawn.where(*where, "emission", "map")
    picture = read_raster(known_file(drawn.folder, section.map.file, section.map.sha256, place))
    values = np.asarray(picture.values, dtype=np.float32)[::-1] / np.float32(picture.white)  # row 0 in the south
    if not (np.isfinite(values).all() and values.min() >= 0 and values.mean() > 0):
        expected = "numbers of 0 and more, not all 0"
        raise RecipeError("no map of emission", where=place, expected=expected, got=f"least {values.min():g}")
    return replace(made, map=values)


def _layers(drawn: DrawnRecipe, conditions: Conditions, section: SoundingSection, where: _Keys) -> Layers | Sounding:
    if section.file is None:
        assert isinstance(conditions.layers, Layers)
        return _with(conditions.layers, section)
    from forestgen.atmosphere.weather_files import read_sounding

    place = drawn.where(*where, "sounding")
    path = known_file(drawn.folder, section.file, section.sha256, place)
    with source.naming_the_file(path, place):
        return read_sounding(path, ground_pressure_pa=100.0 * (section.ground_pressure_hpa or 1013.25))


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
    """Refuse a box of air smaller than the site, below the inversion, or of too many cells."""
    domain, widest_m = conditions.domain, max(drawn.recipe.site.size_m)
    inversion_m = conditions.layers.inversion_m if isinstance(conditions.layers, Layers) else 0.0
    if widest_m > domain.extent_m:
        problem = "the site is larger than the box of air in which its weather is simulated"
        expected, got = f"sky.clouds.domain.extent_m of at least {widest_m:g} m", f"{domain.extent_m:g} m"
        hint = "make the domain larger, or the site smaller"
    elif inversion_m >= domain.height_m:
        problem = "the box of air ends below the inversion"
        expected = f"a height_m of more than {inversion_m:g} m, the sounding's inversion_m"
        got, hint = f"{domain.height_m:g} m", "raise domain.height_m, or lower sounding.inversion_m"
    elif max(domain.cells) > _MOST_CELLS:
        problem, expected = "too many cells", f"at most {_MOST_CELLS} along a side"
        got, hint = " x ".join(map(str, domain.cells)), "make cell_m and cell_height_m larger"
    else:
        return
    raise RecipeError(problem, where=drawn.where(*where, "domain"), expected=expected, got=got, hint=hint)


FOG = SimulatedClouds(
    "fog",
    Layers(6.0, 0.0, 0.0, 60.0, 3.0, -5.0, 0.99, 0.985, 0.75),
    Emission(5.0, 15.0, 250.0, 0.5),
    Domain(1200.0, 160.0, 16.0, 5.0),
    cooling_k_per_h=1.5, time_s=1800.0, wind_m_per_s=1.0, droplet_radius_um=8.0,
)  # fmt: skip
STRATUS = SimulatedClouds(
    "stratus",
    Layers(9.0, 550.0, 6.0, 600.0, 5.0, 2.0, 0.83, 0.97, 0.5),
    Emission(20.0, 60.0, 500.0, 0.3),
    Domain(4000.0, 1000.0, 62.5, 25.0),
    cooling_k_per_h=0.6, time_s=2400.0, wind_m_per_s=4.0, droplet_radius_um=8.0,
)  # fmt: skip
STRATOCUMULUS = SimulatedClouds(
    "stratocumulus",
    Layers(17.0, 1900.0, 6.0, 1950.0, 6.0, 3.0, 0.385, 0.98, 0.35),
    Emission(80.0, 110.0, 900.0, 0.4),
    Domain(8000.0, 2600.0, 100.0, 50.0),
    cooling_k_per_h=0.3, time_s=3000.0, wind_m_per_s=5.0, droplet_radius_um=10.0,
)  # fmt: skip
CUMULUS = SimulatedClouds(
    "cumulus",
    Layers(22.0, 1400.0, 6.8, 2250.0, 4.0, 4.0, 0.465, 0.5, 0.3),
    Emission(150.0, 180.0, 1200.0, 0.5),
    Domain(7200.0, 3000.0, 75.0, 62.5),
    cooling_k_per_h=0.0, time_s=2100.0, wind_m_per_s=4.0, droplet_radius_um=10.0,
)  # fmt: skip
CUMULONIMBUS = SimulatedClouds(
    "cumulonimbus",
    Layers(27.0, 1400.0, 7.2, 7600.0, 1.0, -8.0, 0.5, 0.45, 0.3),
    Emission(120.0, 200.0, 6000.0, 2.0),
    Domain(24000.0, 12000.0, 375.0, 200.0),
    cooling_k_per_h=0.0, time_s=4200.0, wind_m_per_s=4.0, droplet_radius_um=15.0,
)  # fmt: skip
