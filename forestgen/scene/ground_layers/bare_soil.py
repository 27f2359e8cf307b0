"""Patches where nothing lies: sand, soil or rock shows. They hide the layers before them in the list.

Example
-------
    site: {ground: {kind: needle_litter, layers: [{what: bare_soil, of: sand, cover: 0.1, patch_m: 1.5}]}}
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from forestgen.recipe import fields
from forestgen.recipe.ground import DENSEST, GroundLayer
from forestgen.recipe.registries import GROUND_COVERS
from forestgen.scene.ground_layers.layer import GroundLayerKind, Layer, Request, opaque
from forestgen.scene.ground_paint import LONGEST_PATCH_M


class BareSoilKeys(GroundLayer):
    """Bare patches."""

    has_things: ClassVar[bool] = False

    cover: fields.Number = Field(0.1, gt=0, le=DENSEST, description="Share of the ground that is bare.")
    patch_m: fields.Positive = Field(1.5, ge=0.5, le=LONGEST_PATCH_M, description="Size of the patches, metres.")
    on: Literal["ground"] = Field("ground", description="Everywhere but in water and on paths.")
    of: Annotated[fields.Text, *fields.part_name(GROUND_COVERS), Field(description="What shows.")]


class BareSoil(GroundLayerKind[BareSoilKeys]):
    """Bare patches, painted."""

    Parameters = BareSoilKeys
    most_triangles = 0

    def layers(self, keys: BareSoilKeys, request: Request, rng: np.random.Generator) -> Sequence[Layer]:
        surface = opaque(GROUND_COVERS.load(keys.of).reflectance())
        return [Layer("bare_soil", (), {}, keys.cover, surface, 0.0)]


LAYER = BareSoil()
