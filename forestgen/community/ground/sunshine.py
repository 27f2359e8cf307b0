"""Sun: the direct irradiation of inclined, shaded ground over a year, relative to open level ground at its latitude.

The sun stands at (hour angle H, declination δ, latitude φ; Duffie and Beckman, section 1.6)::

    east = -cos δ sin H,  north = cos φ sin δ - sin φ cos δ cos H,  up = sin φ sin δ + cos φ cos δ cos H

and ground with the unit normal n receives max(0, n . s) of it where s clears the horizon. It is summed over hour
angles and over the sun's longitude λ, sin δ = sin 23.44° sin λ, in even steps of both. Over a year this is exact in
spite of the orbit's eccentricity: the time spent in a step of λ goes with the distance's square, the irradiance with
its inverse (Kepler's second law; Berger et al. 2010). There is no air, hence no clouds either: potential irradiation.

1: level, open ground; 0: ground that the sun never reaches; above 1: a sunny slope. At 50° north a slope of 30° has
1.36 facing south and 0.51 facing north.

Sums over the suns of each azimuth that stand higher than a given angle, as vectors, are made once for a latitude; a
place looks up its horizon (of the terrain, or of its own inclined surface if that is higher) in every direction.

References
----------
J. Duffie and W. Beckman, Solar Engineering of Thermal Processes, 4th edition, Wiley 2013, sections 1.6 and 2.20.
A. Berger, M. Loutre and Q. Yin, Total irradiation during any time interval of the year using elliptic integrals,
Quaternary Science Reviews 29 (2010).
"""

from __future__ import annotations

from functools import lru_cache
from math import atan, pi

import numpy as np
from numpy.typing import NDArray

from forestgen.community.ground.horizons import DIRECTIONS, Views, azimuths_rad
from forestgen.community.ground.relief import Nodes
from forestgen.core.compiled import compiled

Floats = NDArray[np.float64]

OBLIQUITY_RAD = np.radians(23.44)
_LONGITUDES, _HOURS = 180, 720  # steps of a year and of a day
_HEIGHTS = 360  # steps of the sun's height, of a quarter of a degree


@lru_cache(maxsize=8)
def sun_sums(latitude_deg: float) -> Floats:
    """(DIRECTIONS, _HEIGHTS + 1, 3): east, north and up of all suns of an azimuth above a height, summed.

    In units of what level ground receives, so that the sum of the last column at height 0 is 1.
    """
    longitude = -np.pi / 2 + (np.arange(_LONGITUDES) + 0.5) * (np.pi / _LONGITUDES)  # the other half year is alike
    hour = -np.pi + (np.arange(_HOURS) + 0.5) * (2 * np.pi / _HOURS)
    sin_d = (np.sin(OBLIQUITY_RAD) * np.sin(longitude))[:, None]
    cos_d, latitude = np.sqrt(1 - sin_d**2), np.radians(latitude_deg)
    east = -cos_d * np.sin(hour)
    north = np.cos(latitude) * sin_d - np.sin(latitude) * cos_d * np.cos(hour)
    up = np.sin(latitude) * sin_d + np.cos(latitude) * cos_d * np.cos(hour)
    day = up > 0
    suns = np.stack([east[day], north[day], up[day]])
    azimuth = np.rint(np.arctan2(suns[0], suns[1]) / (2 * np.pi) * DIRECTIONS).astype(np.int64) % DIRECTIONS
    height = np.minimum((np.arcsin(np.minimum(suns[2], 1.0)) / (np.pi / 2) * _HEIGHTS).astype(np.int64), _HEIGHTS - 1)
    sums = np.zeros((DIRECTIONS, _HEIGHTS + 1, 3))
    for axis in range(3):
        of_step = np.bincount(azimuth * _HEIGHTS + height, suns[axis], DIRECTIONS * _HEIGHTS)
        sums[:, :-1, axis] = of_step.reshape(DIRECTIONS, _HEIGHTS)[:, ::-1].cumsum(axis=1)[:, ::-1]
    return np.asarray(sums / sums[:, 0, 2].sum())


def irradiation(slope_east: Floats, slope_north: Floats, nodes: Nodes, seen: Views, latitude_deg: float) -> Floats:
    """(rows, cols) relative irradiation of surfaces at nodes, with the slopes dz/dx and dz/dy there."""
    sun = np.empty(slope_east.shape)
    directions = np.stack([np.sin(azimuths_rad()), np.cos(azimuths_rad())], axis=1)
    row, v = seen.nodes.rows(nodes.y_m)
    col, u = seen.nodes.columns(nodes.x_m)
    sums = sun_sums(float(latitude_deg))
    _irradiate(slope_east, slope_north, seen.up_rad, row, v, col, u, sums, directions, sun)
    return sun


@compiled
def _irradiate(slope_east, slope_north, up_rad, row, v_of, col, u_of, sums, directions, sun):  # type: ignore[no-untyped-def]
    steps = sums.shape[1] - 1
    for i in range(len(row)):
        r, v = row[i], v_of[i]
        for j in range(len(col)):
            c, u = col[j], u_of[j]
            gx, gy = slope_east[i, j], slope_north[i, j]
            total = 0.0
            for k in range(len(directions)):
                horizon = (1 - v) * ((1 - u) * up_rad[r, c, k] + u * up_rad[r, c + 1, k]) + v * (
                    (1 - u) * up_rad[r + 1, c, k] + u * up_rad[r + 1, c + 1, k]
                )
                own = atan(gx * directions[k, 0] + gy * directions[k, 1])
                at = max(horizon, own, 0.0) / (pi / 2) * steps
                s = min(int(at), steps - 1)
                w = at - s
                received = (
                    (1 - w) * (sums[k, s, 2] - gx * sums[k, s, 0] - gy * sums[k, s, 1])
                    + w * (sums[k, s + 1, 2] - gx * sums[k, s + 1, 0] - gy * sums[k, s + 1, 1])
                )  # fmt: skip
                total += max(received, 0.0)
            sun[i, j] = total / (1 + gx * gx + gy * gy) ** 0.5
