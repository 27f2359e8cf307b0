"""A grey layer of cloud: the same extinction everywhere between two heights.

Example
-------
    sky: {clouds: {type: grey_layer, base_m: 600, optical_depth: 8}}
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field

from forestgen.atmosphere.clouds.source import CloudRequest, CloudSource
from forestgen.atmosphere.grid import CloudGrid
from forestgen.recipe.fields import Positive
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.sky import Clouds

_SIDE_M, _CELLS = 20_000.0, 64


class GreyLayerKeys(Clouds):
    """Keys of `clouds: {type: grey_layer}`."""

    base_m: Annotated[Positive, Field(description="Height of the base, metres.")] = 600.0
    thickness_m: Annotated[Positive, Field(description="Thickness of the layer, metres.")] = 200.0
    optical_depth: Annotated[Positive, Field(le=200, description="Of the layer, straight up.")] = 8.0


class GreyLayer(CloudSource[GreyLayerKeys]):
    """A grey layer of cloud."""

    Parameters = GreyLayerKeys

    def known_base_m(self, drawn: DrawnRecipe) -> float:
        return self.keys_of(drawn).base_m

    def estimate_bytes(self, drawn: DrawnRecipe, model: object, parameters: Any) -> int:
        return 8 * _CELLS**2 * 60

    def grid(self, request: CloudRequest) -> CloudGrid:
        keys, (x, y) = self.keys_of(request.drawn), request.middle_of_site_m
        extinction = np.full((8, _CELLS, _CELLS), keys.optical_depth / keys.thickness_m, dtype=np.float32)
        low = (x - _SIDE_M / 2, y - _SIDE_M / 2, keys.base_m)
        return CloudGrid(extinction, low, (low[0] + _SIDE_M, low[1] + _SIDE_M, keys.base_m + keys.thickness_m))


SOURCE = GreyLayer()
