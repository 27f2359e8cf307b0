"""The section of a camera's rig: its kind, which has all other keys. A rig is a part: scene/rigs."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from forestgen.recipe.fields import Coordinate, Number, PartSection, Text
from forestgen.recipe.registries import RIGS

MOST_FRAMES = 1000  # of all cameras together
GroundPoint = tuple[Coordinate, Coordinate]
FramesPerSecond = Annotated[Number, Field(ge=0.001, le=1000)]


class RigKeys(PartSection):
    """Several images of one entry of a recipe's cameras. How many follows from the recipe alone."""

    registry = RIGS
    selector = "kind"

    kind: Annotated[Text, Field(description="The rig.")]
