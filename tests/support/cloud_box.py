"""A cloud field as the renderer's own medium, one in all: what the product's transports are compared with."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.grid import CloudGrid
from forestgen.render.sky import phase_function
from forestgen.render.variant import mitsuba

Floats = NDArray[np.float64]


def cloud_volume(clouds: CloudGrid, origin_m: Floats) -> dict[str, Any]:
    """The cloud field as a heterogeneous medium inside a box."""
    mi = mitsuba()
    low, high = np.asarray(clouds.low_m) - origin_m, np.asarray(clouds.high_m) - origin_m
    box = mi.ScalarTransform4f().translate(low.tolist()).scale((high - low).tolist())
    grid = mi.VolumeGrid(np.ascontiguousarray(clouds.extinction_per_m[..., None]))
    return {
        "type": "cube",
        "to_world": box @ mi.ScalarTransform4f().translate([0.5] * 3).scale([0.5] * 3),
        "bsdf": {"type": "null"},
        "interior": {
            "type": "heterogeneous",
            "albedo": clouds.albedo,
            "sigma_t": {"type": "gridvolume", "grid": grid, "filter_type": "trilinear", "to_world": box},
            "phase": phase_function(clouds.phase),
        },
    }
