"""The recipe's buildings: where each stands, how large it is, and its kind, which has all other keys.

A kind is a part: scene/buildings.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.recipe.fields import Coordinate, GivenSection, Name, Number, PartSection, Positive, Text
from forestgen.recipe.registries import BUILDINGS, DEFAULT_BUILDING
from forestgen.recipe.species import Material

_Side = Annotated[Positive, Field(ge=0.5, le=200)]


class Building(PartSection, GivenSection):
    """A building: plants neither grow into it nor get light through it."""

    registry = BUILDINGS
    selector = "kind"

    kind: Text = Field(DEFAULT_BUILDING, description="What it is, also the name of its class in labels.")
    position_m: tuple[Coordinate, Coordinate] = Field(
        description="Middle of its ground plan: x, y, metres; on the site."
    )
    azimuth_deg: Number = Field(
        0.0, ge=-360, le=360, description="Turn of its width from east, clockwise from above, degrees."
    )
    size_m: tuple[_Side, _Side, _Side] = Field(
        (10.0, 8.0, 7.0), description="Width along its ridge, depth, and height to the ridge, metres."
    )
    materials: dict[Name, Material] = Field(
        default_factory=dict, description="Materials in place of the kind's own, by part."
    )

    @property
    def turn_rad(self) -> float:
        """The same anticlockwise, as world axes turn, radians."""
        return -math.radians(self.azimuth_deg)

    def corners_m(self) -> NDArray[np.float64]:
        """(4, 2) world x and y of its ground plan's corners."""
        x, y = 0.5 * self.size_m[0], 0.5 * self.size_m[1]
        cos, sin = math.cos(self.turn_rad), math.sin(self.turn_rad)
        plan = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
        return np.asarray(plan @ np.array([[cos, sin], [-sin, cos]]) + self.position_m)
