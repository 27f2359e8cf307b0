"""Which keys of clouds belong to which types, and what is said of a key in the wrong place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, get_args

Simulated = Literal["fog", "stratus", "stratocumulus", "cumulus", "cumulonimbus"]
SIMULATED: tuple[str, ...] = get_args(Simulated)
NOISE: Mapping[str, float] = {
    "cover": 0.35,
    "base_m": 900.0,
    "thickness_m": 350.0,
    "extinction_per_m": 0.05,
    "extent_m": 8000.0,
}
OF_FILES = ("file", "droplet_radius_um", "offset_m", "repeat")
_CELLS = ("cell_m", "cell_height_m")
OF_COMMUNITY = ("day", *_CELLS, "time_s", "droplet_radius_um", "repeat")


def whose(key: str, got: str) -> str:
    """Where a key belongs."""
    if key in NOISE:
        shape = "set its base and top by its sounding, how much there is by its emission, how wide it is by domain"
        return f"it is a key of type noise; {shape}" if got in SIMULATED else "it is a key of type noise"
    if key == "file":
        return "set type: file"
    if key == "day" or key in _CELLS:
        return "it is a key of type community" + (f"; set domain.{key}" if key in _CELLS and got in SIMULATED else "")
    if got == "community" and key != "offset_m":
        return "the air is that of community.weather: leave it out"
    return "it is a key of the simulated types: " + ", ".join(SIMULATED)
