"""The recipe's section of how wet ground looks."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from forestgen.recipe.fields import Flag, Fraction, Positive, Section


class WetSoil(Section):
    """How the water that a community has in its soil shows in the ground's colour."""

    shown: Annotated[Flag, Field(description="Whether wet ground is darker.")] = True
    depth_m: Annotated[
        Positive | None,
        Field(
            le=100,
            description="Depth of the soil that holds the water, metres: what makes a saturation of mm. Default: 1 "
            "in forest soil, 0.05 in a dryland's, whose rains wet little more than its crust.",
        ),
    ] = None
    porosity: Annotated[Fraction, Field(gt=0, description="Share of the soil that water can fill.")] = 0.4
    pond_mm: Annotated[
        Positive,
        Field(
            le=10_000,
            description="Water on the ground that begins to drown it, mm; twice as much makes it wholly wet. Less is "
            "what runs past in showers, in a month's mean.",
        ),
    ] = 25.0
