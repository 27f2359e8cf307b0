"""A small recipe as a mapping: places at random, which take no time."""

from __future__ import annotations

from typing import Any

STAND: dict[str, Any] = {
    "forestgen": 1,
    "seed": 3,
    "images": 2,
    "site": {"size_m": [30, 20], "terrain": "flat", "ground": "soil_wet"},
    "species": {"spruce": "spruce", "fireweed": "fireweed"},
    "community": {
        "model": "uniform",
        "plants": {"spruce": {"count": 12, "radius_m": 0.4}, "fireweed": {"count": 30, "radius_m": 0.1}},
    },
    "cameras": [{"position_m": [3, -3, 1.5], "look_at_m": [3, 3, 0.5], "size_px": [48, 27]}],
}
