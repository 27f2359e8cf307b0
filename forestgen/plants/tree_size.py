"""What a tree measures."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TreeSize:
    """What a tree's geometry is made to measure."""

    height_m: float
    crown_width_m: float  # mean of the extents in x and y
    dbh_m: float  # outside bark at 1.3 m; NaN below that height
    crown_base_m: float
    leaf_area_m2: float  # one side
