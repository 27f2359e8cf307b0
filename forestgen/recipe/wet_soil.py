"""The recipe's section of how wet ground looks."""

from __future__ import annotations

from pydantic import Field

from forestgen.recipe.fields import Flag, Fraction, Positive, Section


class WetSoil(Section):
    """How the water that a community has in its soil shows in the ground's colour."""

    shown: Flag = Field(default=True, description="Whether wet ground is darker.")
    depth_m: Positive | None = Field(
        default=None,
        le=100,
        description="Depth of the soil that holds the water, metres: what makes a saturation of mm. Default: 1 in "
        "forest soil, 0.05 in a dryland's, whose rains wet little more than its crust.",
    )
    porosity: Fraction = Field(default=0.4, gt=0, description="Share of the soil that water can fill.")
    pond_mm: Positive = Field(
        default=25.0,
        le=10_000,
        description="Water on the ground that begins to drown it, mm; twice as much makes it wholly wet. Less is what "
        "runs past in showers, in a month's mean.",
    )
