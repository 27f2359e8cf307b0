"""What a part of the weather is: it changes a finished scene.

It may add media that light goes through (`SceneSpec.fog`), things that fall before a camera (`SceneSpec.falling`), or
change surfaces. Labels come from the scene's geometry, so media and falling things never change them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import RecipeError
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.registries import WEATHER
from forestgen.recipe.weather import Weather
from forestgen.scene.exact_light import chooses_exact, exact_light_error
from forestgen.scene.snow_depth import Circles
from forestgen.scene.spec import Falling, FogLayer, SceneSpec
from forestgen.scene.terrain import HeightField

KeysT = TypeVar("KeysT", bound=Weather)
Place = tuple[str | int, ...]
Floats = NDArray[np.float64]
_DEEP_M = 500.0  # of what falls, above the ground


@dataclass(frozen=True)
class WeatherRequest:
    """What a part may need besides the scene."""

    drawn: DrawnRecipe
    ground: HeightField
    stems: Circles  # standing ones, near the ground
    place: Place  # of its section in the recipe

    @property
    def ground_m(self) -> float:
        """Mean height of the site's ground, world."""
        x, y = np.meshgrid(*[(np.arange(32) + 0.5) / 32 * size for size in self.ground.size_m])
        return float(np.mean(self.ground(x.ravel(), y.ravel())))


class WeatherKind(Generic[KeysT]):
    """A part of the weather, which `weather: [{what: ...}]` names."""

    Parameters: type[KeysT]

    def check(self, keys: KeysT, drawn: DrawnRecipe, place: Place) -> None:
        """Raise `RecipeError`, before the simulation, for what the recipe cannot have."""

    def raised_m(self, keys: KeysT, drawn: DrawnRecipe, place_m: Floats) -> Floats:
        """(N,) by about how much it raises the ground at places (N, 2), metres, before plants are known."""
        return np.zeros(len(place_m))

    def laid_m(self, keys: KeysT, spec: SceneSpec, request: WeatherRequest, place_m: Floats) -> Floats:
        """(N,) by how much it raises the ground of a scene at places (N, 2), metres."""
        return self.raised_m(keys, request.drawn, place_m)

    def is_relief(self, keys: KeysT) -> bool:
        """Whether it has a relief of its own, for which the ground's mesh is finer near cameras."""
        return False

    def on(self, keys: KeysT, spec: SceneSpec, request: WeatherRequest) -> SceneSpec:
        """The scene in this weather."""
        raise NotImplementedError

    def notes(self, keys: KeysT, drawn: DrawnRecipe) -> list[str]:
        """What people should know."""
        return []


@dataclass(frozen=True)
class Shower:
    """Things that fall: n0 exp(-slope D) of them per m3 and mm of diameter D, and the medium that they are together."""

    n0_per_m3_mm: float
    slope_per_mm: float
    least_mm: float  # diameter; smaller ones are left to the medium
    fall: Callable[[Floats], Floats]  # m/s by mm
    extinction_per_m: float
    asymmetry: float

    def on(
        self,
        spec: SceneSpec,
        request: WeatherRequest,
        shutter_s: float,
        seen_mm: Callable[[Floats], Floats] | None = None,
        *,
        is_white: bool = False,
    ) -> SceneSpec:
        """The scene with it; what is left out is as in `Falling`."""
        layer = FogLayer(self.extinction_per_m, request.ground_m + _DEEP_M, 1.0, self.asymmetry)
        number = self.n0_per_m3_mm / self.slope_per_mm * float(np.exp(-self.slope_per_mm * self.least_mm))
        drift = wind_m_per_s(request.drawn)
        falling = Falling(
            number, self.least_mm, 1.0 / self.slope_per_mm, drift, shutter_s, self.fall, seen_mm, is_white
        )
        return replace(spec, fog=(*spec.fog, layer), falling=(*spec.falling, falling))


def wind_m_per_s(drawn: DrawnRecipe) -> tuple[float, float]:
    """Mean wind, eastward and northward."""
    wind, speed = np.radians(drawn.recipe.site.wind_from_deg), drawn.recipe.wind.speed_m_per_s
    return float(-speed * np.sin(wind)), float(-speed * np.cos(wind))


def check_weather(drawn: DrawnRecipe) -> None:
    """Raise `RecipeError` for weather that a recipe cannot have, before anything is simulated."""
    names = [keys.what for keys in drawn.recipe.weather]
    for index, keys in enumerate(drawn.recipe.weather):
        if keys.what in names[:index]:
            problem, where = f"the weather has two parts {keys.what}", drawn.where("weather", index, "what")
            raise RecipeError(problem, where=where, expected="each kind once", got=keys.what, hint="leave one out")
        WEATHER.load(keys.what).check(keys, drawn, ("weather", index))


def in_weather(spec: SceneSpec, drawn: DrawnRecipe, ground: HeightField, stems: Circles) -> SceneSpec:
    """A finished scene in its recipe's weather: parts in the order of their names, so snow covers what rain wetted."""
    for index, keys in sorted(enumerate(drawn.recipe.weather), key=lambda part: part[1].what):
        spec = WEATHER.load(keys.what).on(keys, spec, WeatherRequest(drawn, ground, stems, ("weather", index)))
    return spec


def has_relief(drawn: DrawnRecipe) -> bool:
    """Whether the weather has a relief of its own."""
    return any(WEATHER.load(keys.what).is_relief(keys) for keys in drawn.recipe.weather)


def raised_m(drawn: DrawnRecipe, place_m: Floats) -> Floats:
    """(N,) by about how much the weather raises the ground at places (N, 2), metres, before plants are known."""
    kinds = [(WEATHER.load(keys.what), keys) for keys in drawn.recipe.weather]
    return sum((kind.raised_m(keys, drawn, place_m) for kind, keys in kinds), np.zeros(len(place_m)))


def laid_m(spec: SceneSpec, drawn: DrawnRecipe, ground: HeightField, stems: Circles, place_m: Floats) -> Floats:
    """(N,) by how much the weather raises the ground of a scene at places (N, 2), metres."""
    parts = [
        WEATHER.load(keys.what).laid_m(keys, spec, WeatherRequest(drawn, ground, stems, ("weather", index)), place_m)
        for index, keys in enumerate(drawn.recipe.weather)
    ]
    return sum(parts, np.zeros(len(place_m)))


def weather_notes(drawn: DrawnRecipe) -> list[str]:
    """What people should know of a recipe's weather."""
    return [note for keys in drawn.recipe.weather for note in WEATHER.load(keys.what).notes(keys, drawn)]


def check_followed(drawn: DrawnRecipe, place: Place) -> None:
    """Raise `RecipeError` where light is traced through the clouds' volume, which knows no other medium."""
    if chooses_exact(drawn):
        raise exact_light_error("other weather", drawn.where(*place, "what"), "this weather", chosen=True)
