"""A sky without clouds.

Keys of other sources are allowed, and unused: a recipe that draws its type may say how clouds are where there are some.
"""

from __future__ import annotations

from typing import ClassVar

from pydantic import ConfigDict

from forestgen.atmosphere.clouds.source import CloudRequest, CloudSource
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.sky import Clouds


class NoCloudsKeys(Clouds):
    """A sky without clouds."""

    model_config = ConfigDict(extra="allow")
    has_clouds: ClassVar[bool] = False


class NoClouds(CloudSource[NoCloudsKeys]):
    """A sky without clouds."""

    Parameters = NoCloudsKeys

    def grid(self, request: CloudRequest) -> None:
        return None

    def estimate_bytes(self, drawn: DrawnRecipe, model: object, parameters: object) -> int:
        return 0


SOURCE = NoClouds()
