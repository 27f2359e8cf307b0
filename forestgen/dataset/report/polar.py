"""Where the sun stood: the sky from below, in cells of equal steps in azimuth and elevation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SIZE = 320.0
CENTRE, RADIUS = SIZE / 2, 122.0
AZIMUTH_STEP_DEG, ELEVATION_STEP_DEG = 15, 10
_MOST_DOTS = 300  # single suns are drawn up to so many


@dataclass(frozen=True)
class Wedge:
    """A cell of the sky."""

    path: str
    strength: float  # share of the fullest cell's count, 0 to 1
    title: str


@dataclass(frozen=True)
class Polar:
    """The plot: north is up, east right; the zenith in the middle, the horizon the outer ring."""

    title: str
    summary: str
    wedges: tuple[Wedge, ...]
    dots: tuple[tuple[float, float], ...]  # x, y of each sun
    rings: tuple[tuple[float, str], ...]  # radius and what it stands for
    note: str = ""


def sun_plot(azimuth_deg: NDArray[np.float64], elevation_deg: NDArray[np.float64]) -> Polar | None:
    """Suns above the horizon, counted by cell.

    Parameters
    ----------
    azimuth_deg : (N,) clockwise from north; NaN where a frame has no sun.
    elevation_deg : (N,) above the horizon.

    Returns
    -------
    Polar : None if no sun is known.
    """
    known = np.isfinite(azimuth_deg) & np.isfinite(elevation_deg)
    if not known.any():
        return None
    azimuth, elevation = azimuth_deg[known] % 360.0, elevation_deg[known]
    up = elevation >= 0
    column = (azimuth[up] // AZIMUTH_STEP_DEG).astype(int) % (360 // AZIMUTH_STEP_DEG)
    row = np.minimum(elevation[up] // ELEVATION_STEP_DEG, 90 // ELEVATION_STEP_DEG - 1).astype(int)
    counts = np.zeros((90 // ELEVATION_STEP_DEG, 360 // AZIMUTH_STEP_DEG), dtype=np.int64)
    np.add.at(counts, (row, column), 1)
    wedges = tuple(_wedge(i, j, counts) for i, j in np.argwhere(counts))
    dots = tuple(map(_spot, azimuth[up], elevation[up])) if up.sum() <= _MOST_DOTS else ()
    rings = tuple((_radius(degrees), f"{degrees}°") for degrees in (0, 30, 60))
    below = int((~up).sum())
    note = f"{below:,} below the horizon, not shown. " if below else ""
    summary = (
        f"The sun's place in the sky in {int(up.sum()):,} frames: elevations from {elevation.min():.0f} to "
        f"{elevation.max():.0f} degrees, {len(wedges)} of {counts.size} cells of the sky have one"
    )
    note += (
        f"Cells of {AZIMUTH_STEP_DEG}° of azimuth by {ELEVATION_STEP_DEG}° of elevation; the stronger, the more frames."
    )
    return Polar("Where the sun stands", summary, wedges, dots, rings, note)


def _radius(elevation_deg: float) -> float:
    return RADIUS * (90.0 - elevation_deg) / 90.0


def _spot(azimuth_deg: float, elevation_deg: float) -> tuple[float, float]:
    """x and y of a direction; x grows eastward, y downward."""
    angle, radius = math.radians(azimuth_deg), _radius(elevation_deg)
    return round(CENTRE + radius * math.sin(angle), 1), round(CENTRE - radius * math.cos(angle), 1)


def _wedge(row: int, column: int, counts: NDArray[np.int64]) -> Wedge:
    low, high = row * ELEVATION_STEP_DEG, (row + 1) * ELEVATION_STEP_DEG
    left, right = column * AZIMUTH_STEP_DEG, (column + 1) * AZIMUTH_STEP_DEG
    corners = [_spot(left, low), _spot(right, low), _spot(right, high), _spot(left, high)]
    (a, b), (c, d), (e, f), (g, h) = corners
    outer, inner = round(_radius(low), 1), round(_radius(high), 1)
    path = f"M{a} {b}A{outer} {outer} 0 0 1 {c} {d}L{e} {f}A{inner} {inner} 0 0 0 {g} {h}Z"
    count = int(counts[row, column])
    title = f"azimuth {left}° to {right}°, elevation {low}° to {high}°: {count:,}"
    return Wedge(path, round(count / int(counts.max()), 3), title)
