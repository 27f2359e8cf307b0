"""What the years make of a tree's wood: a species' section `wood`. Trees of given sizes alone have it."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from forestgen.recipe.fields import Name, NonNegative, Number, Positive, Section

Degrees = Annotated[Number, Field(ge=-90, le=180)]


class DeadBranches(Section):
    """Branches below the living crown, which shade has killed; see plants/dead_branches.py."""

    material: Name = Field("dead_branch", description="One of the species' materials.")
    keeps_m: Positive = Field(
        le=100, description="Depth below the living crown at which 1/e of a branch is left, metres."
    )
    gone_m: Positive = Field(
        le=200, description="Depth at which 1/e of the branches are left; the stem has closed over the others, metres."
    )
    whorl_m: Positive = Field(0.4, le=5, description="Distance of whorls, metres.")
    per_whorl: NonNegative = Field(le=20, description="Branches of a whorl.")
    between_per_m: NonNegative = Field(
        0.0, le=50, description="Branches beside the whorls, half as long, on a metre of the stem."
    )
    longest: Positive = Field(
        le=1.5, description="Length of the uppermost when they died, over the radius of the crown."
    )
    thickness: Positive = Field(0.012, le=0.1, description="Diameter at the foot over the length when they died.")
    angle_deg: Degrees = Field(90.0, description="Between a branch and the stem above it, degrees.")
    droop_deg_per_m: Number = Field(0.0, ge=-90, le=90, description="Turn to the ground along a branch, degrees.")
    twigs_per_m: NonNegative = Field(
        0.0, le=50, description="Twigs on a metre of the uppermost branches; further down they are gone."
    )


class Wood(Section):
    """What the years make of a tree's wood."""

    dead_branches: DeadBranches | None = Field(None, description="Dead branches below the crown; null: none.")
