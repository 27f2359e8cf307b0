"""Clouds of the air that the community simulates over itself: a day of the month that comes after the snapshot.

Example
-------
    community: {model: ecoclimate, weather: {}}
    sky: {clouds: {type: community, day: 3}}

Parameters: see below; all else is that of `community.weather`.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

from pydantic import Field

from forestgen.atmosphere.clouds.source import AirKeys, CloudRequest, CloudSource, clouds_of_air, simulated_bytes
from forestgen.atmosphere.clouds.weather_keys import WeatherKeys
from forestgen.atmosphere.grid import CloudGrid
from forestgen.community.capabilities import OwnAir, capability, models_with
from forestgen.core.errors import RecipeError
from forestgen.recipe.fields import NonNegative, Positive, Whole
from forestgen.recipe.load import DrawnRecipe

_DROPLET_RADIUS_UM = 10.0  # of cumulus: see forestgen.atmosphere.clouds.simulated


class CommunityKeys(AirKeys):
    """Keys of `clouds: {type: community}`."""

    instead: ClassVar = dict.fromkeys(
        (*WeatherKeys.model_fields, "seed", "story"), "the air is that of community.weather: leave it out"
    )

    time_s: NonNegative | None = Field(
        None,
        le=1e6,
        description="When the picture is taken, seconds after the day's simulated hours begin. Default: their end.",
    )
    day: Whole | None = Field(
        None,
        ge=0,
        le=30,
        description="Of type community: which day of the month after the snapshot; the simulation sees those below "
        "its days_per_month. Default 0.",
    )
    cell_m: Positive | None = Field(
        None,
        ge=5,
        le=1000,
        description="Of type community: width of the air's cells, metres; other cells make another draw of the "
        "same air. Default: community.weather's.",
    )
    cell_height_m: Positive | None = Field(
        None, ge=5, le=500, description="Of type community: their height, metres. Default: as above."
    )


class CommunityClouds(CloudSource[CommunityKeys]):
    """The air that the community simulates over itself."""

    Parameters = CommunityKeys

    def check_community(self, drawn: DrawnRecipe, model: object, parameters: Any) -> None:
        _air_of(drawn, model).air_grid(drawn, parameters)

    def estimate_bytes(self, drawn: DrawnRecipe, model: object, parameters: Any) -> int:
        grid = _air_of(drawn, model).air_grid(drawn, parameters)
        return simulated_bytes(self.keys_of(drawn), math.prod(grid.cells), grid.size_m[0])

    def grid(self, request: CloudRequest) -> CloudGrid | None:
        keys, air = self.keys_of(request.drawn), _air_of(request.drawn, request.plan.model)
        weather = air.air(request.plan, request.population, request.progress)
        radius_um = keys.droplet_radius_um or _DROPLET_RADIUS_UM
        return clouds_of_air(request, keys, weather, radius_um, request.middle_of_site_m)


def _air_of(drawn: DrawnRecipe, model: object) -> OwnAir:
    air = capability(model, OwnAir)
    if air is None:
        problem, where = "this community has no air of its own", drawn.where("sky", "clouds", "type")
        expected = f"community.model: {models_with(OwnAir)}, with a section weather"
        hint = "set sky.clouds=cumulus for clouds that know no plants"
        raise RecipeError(problem, where=where, expected=expected, got=drawn.recipe.community.model, hint=hint)
    return air


SOURCE = CommunityClouds()
