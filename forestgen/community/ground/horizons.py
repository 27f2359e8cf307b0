"""What a place sees of the ground around it: the steepest view up and down in every direction, and so its exposure.

The horizon's angle in a direction is the largest of atan((z(d) - z(0)) / d) over distances d, here from 2 m (or a node
of the raster) to 1000 m; it is signed: negative where the ground falls away all the way. The steepest view down is the
smallest. Foresters sum horizon angles over eight directions as an index of shelter, TOPEX (Pyatt et al. 1969), also
limited in distance and signed, towards the wind (Winstral et al. 2002: Sx). Here the views down count as well, as in
the openness of Yokoyama et al. (2002), so that a crest is as exposed as a hollow of its form is sheltered::

    T = sum over 32 directions of w (up + down) / 2        w = (1 + cos(angle to the prevailing wind)) / 32
    wind = 1 / (1 + exp(T / 5 degrees))

0: deep in a hollow or under a steep lee slope; 0.5: on a plain; 1: on a sharp crest. Half of the weight is even over
all directions, half looks towards the wind: a slope of 10° has 0.73 facing the wind and 0.27 in its lee.

References
----------
D. Pyatt, D. Harrison and A. Ford, Guide to site types in forests of north and mid-Wales, Forestry Commission Forest
Record 69 (1969). A. Winstral, K. Elder and R. Davis, Spatial snow modeling of wind-redistributed snow using
terrain-based parameters, Journal of Hydrometeorology 3 (2002). R. Yokoyama, M. Shirasawa and R. Pike, Visualizing
topography by openness, Photogrammetric Engineering and Remote Sensing 68 (2002).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan, cos, floor, pi, sin

import numpy as np
from numpy.typing import NDArray

from forestgen.community.ground.relief import FAR_M, MARGIN_M, Nodes, Relief
from forestgen.community.model import Site
from forestgen.core.compiled import compiled

Floats = NDArray[np.float64]

DIRECTIONS = 32  # clockwise from north
_NODES = 128  # along the site's longer side; views change more slowly than heights
_NEAREST_M = 2.0
_FURTHER = 1.15  # each distance that is looked at over the last
_SCALE_DEG = 5.0


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
