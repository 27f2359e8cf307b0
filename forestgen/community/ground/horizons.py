"""What a place sees of the ground around it, and so its exposure to wind and sun.

The horizon's angle in a direction is the largest of atan((z(d) - z(0)) / d) over distances d, here from 2 m (or a node
of the raster) to 1000 m; it is signed: negative where the ground falls away all the way. The steepest view down is the
smallest. Foresters sum horizon angles over eight directions as an index of shelter, TOPEX (Pyatt et al. 1969), also
limited in distance and signed, towards the wind (Winstral et al. 2002: Sx). Here the views down count as well, as in
the openness of Yokoyama et al. (2002), so that a crest is as exposed as a hollow of its form is sheltered::

    T = sum over 32 directions of w (up + down) / 2        w = (1 + cos(angle to the prevailing wind)) / 32
    wind = 1 / (1 + exp(T / 5 degrees))

0: deep in a hollow or under a steep lee slope; 0.5: on a plain; 1: on a sharp crest. A slope of 10° has 0.73 facing the
wind and 0.27 in its lee.

Sun is the direct irradiation of inclined, shaded ground over a year, relative to open level ground at its latitude,
without air or clouds: 1 on level, open ground, 0 where the sun never reaches, above 1 on a sunny slope. At 50° north a
slope of 30° has 1.36 facing south and 0.51 facing north. The sun stands at (hour angle H, declination δ, latitude φ;
Duffie and Beckman, section 1.6)::

    east = -cos δ sin H,  north = cos φ sin δ - sin φ cos δ cos H,  up = sin φ sin δ + cos φ cos δ cos H

and ground with the unit normal n receives max(0, n . s) of it where s clears the horizon. It is summed over hour
angles and over the sun's longitude λ, sin δ = sin 23.44° sin λ, in even steps of both. Over a year this is exact in
spite of the orbit's eccentricity: the time spent in a step of λ goes with the distance's square, the irradiance with
its inverse (Kepler's second law; Berger et al. 2010). Sums over the suns of each azimuth above a given height, as
vectors, are made once for a latitude; a place looks up its horizon, or its own surface's if that is higher.

References
----------
D. Pyatt, D. Harrison and A. Ford, Guide to site types in forests of north and mid-Wales, Forestry Commission Forest
Record 69 (1969). A. Winstral, K. Elder and R. Davis, Spatial snow modeling of wind-redistributed snow using
terrain-based parameters, Journal of Hydrometeorology 3 (2002). R. Yokoyama, M. Shirasawa and R. Pike, Visualizing
topography by openness, Photogrammetric Engineering and Remote Sensing 68 (2002).
J. Duffie and W. Beckman, Solar Engineering of Thermal Processes, 4th edition, Wiley 2013, sections 1.6 and 2.20.
A. Berger, M. Loutre and Q. Yin, Total irradiation during any time interval of the year using elliptic integrals,
Quaternary Science Reviews 29 (2010).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import atan, cos, floor, pi, sin

import numpy as np
from numpy.typing import NDArray

from forestgen.community.ground.relief import FAR_M, MARGIN_M, Nodes, Relief, place_among
from forestgen.community.model import Site
from forestgen.core.compiled import compiled

Floats = NDArray[np.float64]

DIRECTIONS = 32  # clockwise from north
_NODES = 128  # along the site's longer side; views change more slowly than heights
_NEAREST_M = 2.0
_FURTHER = 1.15  # each distance that is looked at over the last
_SCALE_DEG = 5.0
OBLIQUITY_RAD = np.radians(23.44)
_LONGITUDES, _HOURS = 180, 720  # steps of a year and of a day
_HEIGHTS = 360  # steps of the sun's height, of a quarter of a degree


@dataclass(frozen=True)
class Views:
    """Steepest views from nodes over the site and its edges."""

    nodes: Nodes
    up_rad: NDArray[np.float32]  # (rows, cols, DIRECTIONS) the horizon's angle, signed
    down_rad: NDArray[np.float32]  # (rows, cols, DIRECTIONS) of the steepest view down, signed


def azimuths_rad() -> Floats:
    """(DIRECTIONS,) clockwise from north."""
    return 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS


def views(near: Relief, far: Relief, site: Site) -> Views:
    """Views over the raster `near` as far as it goes, and over `far` beyond."""
    stride = max(1, round(max(site.size_m) / (_NODES * near.cell_m)))
    # Counted from the middle node, which lies in the site's middle, to the edges or a little beyond.
    steps = [int(np.ceil(side / 2 / (stride * near.cell_m))) for side in site.size_m]
    cols, rows = (n // 2 + stride * np.arange(-m, m + 1) for n, m in zip(near.z_m.shape[::-1], steps, strict=True))
    first_m = max(near.cell_m, _NEAREST_M)
    count = int(np.ceil(np.log(FAR_M / first_m) / np.log(_FURTHER)))
    distance_m = first_m * (FAR_M / first_m) ** (np.arange(count + 1) / count)
    up, down = (np.empty((len(rows), len(cols), DIRECTIONS), dtype=np.float32) for _ in range(2))
    to_m = MARGIN_M - stride * near.cell_m  # nodes stand up to so far beyond the site
    beyond = (far.nodes.x_m[0], far.nodes.y_m[0], far.cell_m)
    nodes = Nodes(near.nodes.x_m[cols], near.nodes.y_m[rows])
    _look(near.z_m, near.cell_m, rows, cols, far.z_m, beyond, nodes.x_m, nodes.y_m, distance_m, to_m, up, down)
    return Views(nodes, up, down)


def exposure(seen: Views, wind_from_deg: float) -> Floats:
    """(rows, cols) exposure to wind at the views' nodes, above 0 and below 1."""
    weight = (1 + np.cos(azimuths_rad() - np.radians(wind_from_deg))) / DIRECTIONS
    shelter_deg = np.degrees((seen.up_rad + seen.down_rad).astype(np.float64) @ weight / 2)
    return np.asarray(1 / (1 + np.exp(shelter_deg / _SCALE_DEG)))


@compiled
def _height(z, place, x, y):  # type: ignore[no-untyped-def]
    """Bilinear between nodes; beyond the last, as there."""
    u = min(max((x - place[0]) / place[2], 0.0), z.shape[1] - 1.000001)
    v = min(max((y - place[1]) / place[2], 0.0), z.shape[0] - 1.000001)
    j, i = int(u), int(v)
    u, v = u - j, v - i
    return (1 - v) * ((1 - u) * z[i, j] + u * z[i, j + 1]) + v * ((1 - u) * z[i + 1, j] + u * z[i + 1, j + 1])


@compiled
def _look(near, cell_m, rows, cols, far, far_place, xs, ys, distance_m, near_to_m, up, down):  # type: ignore[no-untyped-def]
    directions, n = up.shape[2], len(cols)
    highest, lowest = np.empty(n), np.empty(n)
    for i in range(len(rows)):
        for k in range(directions):
            east, north = sin(2 * pi * k / directions), cos(2 * pi * k / directions)
            highest[:], lowest[:] = -1e30, 1e30
            for d in distance_m:
                if d <= near_to_m:
                    # All nodes of the row look at places that lie alike between nodes.
                    u, v = d * east / cell_m, d * north / cell_m
                    a, b = floor(u), rows[i] + floor(v)
                    u, v = u - floor(u), v - floor(v)
                    south, there, here = near[b], near[b + 1], near[rows[i]]
                    for j in range(n):
                        c = cols[j] + a
                        z = (1 - v) * ((1 - u) * south[c] + u * south[c + 1]) + v * (
                            (1 - u) * there[c] + u * there[c + 1]
                        )
                        rise = (z - here[cols[j]]) / d
                        highest[j], lowest[j] = max(highest[j], rise), min(lowest[j], rise)
                else:
                    for j in range(n):
                        z = _height(far, far_place, xs[j] + d * east, ys[i] + d * north)
                        rise = (z - near[rows[i], cols[j]]) / d
                        highest[j], lowest[j] = max(highest[j], rise), min(lowest[j], rise)
            for j in range(n):
                up[i, j, k], down[i, j, k] = atan(highest[j]), atan(lowest[j])


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
    (row, v), (col, u) = place_among(seen.nodes.y_m, nodes.y_m), place_among(seen.nodes.x_m, nodes.x_m)
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
