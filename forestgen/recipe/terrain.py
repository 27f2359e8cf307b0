"""The recipe's section of the ground's shape: its kind, which has all other keys. A kind is a part: scene/terrains."""

from __future__ import annotations

from typing import Any

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from forestgen.recipe.fields import PartSection, Text
from forestgen.recipe.registries import TERRAINS


class Terrain(PartSection):
    """The ground's shape."""

    registry = TERRAINS
    selector = "kind"

    kind: Text = Field(default="flat", description="Shape of the ground.")

    @model_serializer(mode="wrap")
    def _as_given(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {key: value for key, value in handler(self).items() if value is not None}
