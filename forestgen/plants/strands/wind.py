"""Wind in a strand tree: a pose at one time, and a sequence of poses.

Formulas and decisions are in `generators/strands.py`.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from forestgen.geometry.mesh import unit
from forestgen.plants.strands.kernel import Branching, Pose, stand

Floats = NDArray[np.float64]


class Wind(BaseModel):
    """The wind that a plant stands in."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    speed_directed: float = Field(default=0.0, ge=0, le=10, description="w_g: greatest bend of one segment, degrees")
    speed_undirected: float = Field(
        default=0.0, ge=0, le=10, description="w_s: sway of what a segment of 1 m bears, without stiffness, degrees"
    )
    axis: tuple[float, float, float] = Field(
        default=(0.0, 1.0, 0.0),
        description="w: the axis that segments turn about, plant frame; [0, 1, 0] is a wind towards +x, [-1, 0, 0] "
        "one towards +y, [0, 0, 1] turns without bending",
    )
    bends: Literal["thin", "thick"] = Field(
        default="thin", description="alpha_w = (1 - S_0/S) w_g: twigs give way; or as printed, alpha_w = S_0/S w_g"
    )
    time_s: float = Field(
        default=0.0, ge=-1e6, le=1e6, description="t: time of the pose, seconds; a sway takes 2 pi seconds"
    )

    @model_validator(mode="after")
    def _has_axis(self) -> Wind:
        if not np.linalg.norm(self.axis) > 1e-9:
            raise ValueError("the wind's axis must not be zero")
        return self


def pose(branching: Branching, wind: Wind, stiffness: float, phases_rad: Floats) -> Pose:
    """The branching in a wind.

    Parameters
    ----------
    stiffness : k_f, 0 to 1.
    phases_rad : (N, 2) R_x and R_z of each segment.
    """
    bearer = np.maximum(branching.parent, 0)
    amplitude = np.radians(wind.speed_undirected) * (1.0 - stiffness) * branching.length_m[bearer]
    sway = np.sin(wind.time_s + phases_rad) * amplitude[:, None]
    share = branching.strands[bearer] / branching.strands[0]
    bend = np.radians(wind.speed_directed) * (share if wind.bends == "thick" else 1.0 - share)
    axis = unit(np.array(wind.axis, dtype=np.float64))
    return stand(branching, sway, bend, axis)
