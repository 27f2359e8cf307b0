"""The ground's height on a raster of nodes, and what follows from it: moisture, exposure to wind, and sun.

Moisture is the topographic wetness index ln(a / tan β) (Beven and Kirkby 1979; a, the area upslope by width of contour,
metres; tan β, the gradient) in a form that is also right on a crest and on level ground::

    W = (a + a0) / (tan β + t0)        a0 = 20 m, t0 = 0.1
    moisture = W / (W + W0)            W0 = a0 / t0, W on a plain

- 0.5: as wet as level ground that drinks its own rain alone. 0.8: four times the plain's W. Towards 1: hollows and
  valley floors. Towards 0: steep ground below nothing, as on crests and spurs.
- Water runs by the D∞ method (Tarboton 1997): downhill along the steepest of eight triangular facets, shared between
  the two neighbours that its direction lies between. A node with no lower neighbour is a pit, and keeps its water,
  unless there is lower ground within five nodes: gaps of the raster in a narrow valley are no pits.
- Water moves slowly, and most is drunk on its way (Barling et al. 1994). By Darcy's law it moves in proportion to the
  gradient, so the share that arrives after a way s is exp(-s / (ℓ tan β)), ℓ = 1000 m.
- a and tan β (its root mean square) are smoothed by a Gaussian with σ = 5 m, which roots and soil even out in nature;
  so moisture hardly depends on the raster's cells.
- Water that crosses a raster at an angle ϑ to its rows or columns is counted by cells that are narrower than their
  side, by cos ϑ + sin ϑ ϑ/(π/4): on a plane a is the way to the divide, in any direction.

Wind and sun follow from what a place sees of the ground around it. The horizon's angle in a direction is the largest of
atan((z(d) - z(0)) / d) over distances d, here from 2 m (or a node of the raster) to 1000 m; it is signed: negative
where the ground falls away all the way. The steepest view down is the smallest. Foresters sum horizon angles over eight
directions as an index of shelter, TOPEX (Pyatt et al. 1969), also limited in distance and signed, towards the wind
(Winstral et al. 2002: Sx). Here the views down count as well, as in the openness of Yokoyama et al. (2002), so that a
crest is as exposed as a hollow of its form is sheltered::

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
K. Beven and M. Kirkby, A physically based, variable contributing area model of basin hydrology, Hydrological Sciences
Bulletin 24 (1979). D. Tarboton, A new method for the determination of flow directions and upslope areas in grid digital
elevation models, Water Resources Research 33 (1997), Table 1 and equations 1 to 4. R. Barling, I. Moore and R. Grayson,
A quasi-dynamic wetness index, Water Resources Research 30 (1994).
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
from functools import cached_property, lru_cache
from math import atan, atan2, cos, exp, floor, pi, sin

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import GroundHeight, Site
from forestgen.core.compiled import compiled

Floats = NDArray[np.float64]

MARGIN_M = 200.0  # of ground around the site whose water and whose crests count at full detail
FAR_M = 1000.0  # crests up to here count
UPSLOPE_M = 20.0  # a0
GRADIENT = 0.1  # t0
WAY_M = 1000.0  # ℓ: how far most water gets at a gradient of 1
SMOOTHED_M = 5.0  # standard deviation
_BREACH = 5  # nodes
# Facets: cardinal and diagonal neighbour as (row, column) steps.
_CARDINAL = np.array([(0, 1), (1, 0), (1, 0), (0, -1), (0, -1), (-1, 0), (-1, 0), (0, 1)], dtype=np.int64)
_DIAGONAL = np.array([(1, 1), (1, 1), (1, -1), (1, -1), (-1, -1), (-1, -1), (-1, 1), (-1, 1)], dtype=np.int64)
DIRECTIONS = 32  # clockwise from north
_VIEW_NODES = 128  # along the site's longer side; views change more slowly than heights
_NEAREST_M = 2.0
_FURTHER = 1.15  # each distance that is looked at over the last
_SCALE_DEG = 5.0
OBLIQUITY_RAD = np.radians(23.44)
_LONGITUDES, _HOURS = 180, 720  # steps of a year and of a day
_HEIGHTS = 360  # steps of the sun's height, of a quarter of a degree
_NODES = 480  # across the site and its margin, unless their distance would exceed the coarsest
_COARSEST_M = 4.0
_FAR_CELL_M = MARGIN_M / 8  # no coarser than the steps of a view at that distance


@dataclass(frozen=True)
class Nodes:
    """Where evenly spaced nodes stand."""

    x_m: Floats  # (cols,) world, ascending
    y_m: Floats  # (rows,) world, ascending

    def between(self, values: Floats, x_m: Floats, y_m: Floats) -> Floats:
        """(len(y_m), len(x_m)) values, (rows, cols) at the nodes, at other places: linear in x and in y."""
        (row, v), (col, u) = place_among(self.y_m, y_m), place_among(self.x_m, x_m)
        rows = values[row] * (1 - v[:, None]) + values[row + 1] * v[:, None]
        return np.asarray(rows[:, col] * (1 - u) + rows[:, col + 1] * u)


def place_among(nodes_m: Floats, at_m: Floats) -> tuple[NDArray[np.int64], Floats]:
    """The node before each place, and the share of the way to the next."""
    place = (at_m - nodes_m[0]) / (nodes_m[1] - nodes_m[0])
    index = np.clip(place.astype(np.int64), 0, len(nodes_m) - 2)
    return index, np.clip(place - index, 0.0, 1.0)


@dataclass(frozen=True)
class Relief:
    """Heights at the nodes of a square raster."""

    nodes: Nodes
    cell_m: float  # between nodes, in x and in y
    z_m: Floats  # (rows, cols)

    @cached_property
    def slopes(self) -> tuple[Floats, Floats]:
        """dz/dx and dz/dy, (rows, cols) each: centred differences between the neighbouring nodes."""
        along_y, along_x = np.gradient(self.z_m, self.cell_m)
        return np.asarray(along_x), np.asarray(along_y)

    def over(self, site: Site) -> tuple[slice, slice]:
        """Rows and columns of the nodes that values between nodes depend on anywhere on the site."""
        x, y = (
            slice(int(np.searchsorted(at, 0.0, "right")) - 1, int(np.searchsorted(at, side, "left")) + 1)
            for at, side in zip((self.nodes.x_m, self.nodes.y_m), site.size_m, strict=True)
        )
        return y, x


def near_relief(height: GroundHeight, site: Site) -> Relief:
    """The ground of the site and `MARGIN_M` around it; the middle node lies in the site's middle."""
    span_m = max(site.size_m) + 2 * MARGIN_M
    return _relief(height, site, MARGIN_M, min(span_m / _NODES, _COARSEST_M))


def far_relief(height: GroundHeight, site: Site) -> Relief:
    """The ground up to `FAR_M` from the site, coarse."""
    return _relief(height, site, FAR_M, _FAR_CELL_M)


def _relief(height: GroundHeight, site: Site, margin_m: float, cell_m: float) -> Relief:
    half = [int(np.ceil((side / 2 + margin_m) / cell_m)) + 1 for side in site.size_m]
    xs, ys = (
        np.asarray(side / 2 + cell_m * np.arange(-n, n + 1), dtype=np.float64)
        for side, n in zip(site.size_m, half, strict=True)
    )
    z = np.broadcast_to(height(*np.meshgrid(xs, ys)), (len(ys), len(xs)))
    if not np.isfinite(z).all():
        row, col = np.argwhere(~np.isfinite(z))[0]
        raise ValueError(f"the ground's height must be finite; at x {xs[col]:g}, y {ys[row]:g} it is {z[row, col]}")
    return Relief(Nodes(xs, ys), cell_m, np.ascontiguousarray(z, dtype=np.float64))


@dataclass(frozen=True)
class Flow:
    """Water by D∞: where what falls on each node of a raster goes. Nodes are numbered row by row."""

    area_m2: NDArray[np.float64]  # (nodes,) drained by a node, its own cell included, less what was lost on the way
    contour_m: NDArray[np.float64]  # (nodes,) width of contour that the water of a node crosses
    receiver: NDArray[np.int64]  # (nodes, 2) nodes downhill; -1: none
    share: NDArray[np.float64]  # (nodes, 2) of the node's water; both 0: it stays, or leaves the raster
    lost_m2: float  # what was drunk on the way


def moisture(relief: Relief) -> NDArray[np.float64]:
    """(rows, cols) moisture at the nodes, above 0 and below 1."""
    from scipy.ndimage import gaussian_filter

    along_x, along_y = relief.slopes
    sigma = SMOOTHED_M / relief.cell_m
    gradient = np.sqrt(gaussian_filter(along_x**2 + along_y**2, sigma, mode="nearest"))
    flow = route(relief, gradient)
    upslope_m = (flow.area_m2 - relief.cell_m**2) / flow.contour_m
    upslope_m = gaussian_filter(upslope_m.reshape(relief.z_m.shape), sigma, mode="nearest")
    wetness = (1 + np.maximum(upslope_m, 0.0) / UPSLOPE_M) / (1 + gradient / GRADIENT)
    return np.asarray(wetness / (1 + wetness))


def route(relief: Relief, gradient: NDArray[np.float64] | None = None) -> Flow:
    """Let it rain on every node, and the water run; on its way it is drunk by the `gradient` (None: it is not)."""
    z = np.array(relief.z_m)  # never read-only, which would be a second kernel
    downhill_first = np.argsort(-z, axis=None, kind="stable")
    n = z.size
    receiver, share = np.full((n, 2), -1, dtype=np.int64), np.zeros((n, 2))
    contour_m = np.full(n, relief.cell_m)
    area_m2 = np.full(n, relief.cell_m**2)
    kept = np.full(z.shape, np.inf) if gradient is None else WAY_M * gradient
    _directions(z, relief.cell_m, _CARDINAL, _DIAGONAL, receiver, share, contour_m)
    lost_m2 = _run(downhill_first, receiver, share, contour_m, kept.ravel(), relief.cell_m, area_m2)
    return Flow(area_m2, contour_m, receiver, share, lost_m2)


@compiled
def _directions(z, cell_m, cardinal, diagonal, receiver, share, contour_m):  # type: ignore[no-untyped-def]
    rows, cols = z.shape
    for i in range(1, rows - 1):
        for j in range(1, cols - 1):
            steepest, chosen, angle = 0.0, -1, 0.0
            for f in range(8):
                e1 = z[i + cardinal[f, 0], j + cardinal[f, 1]]
                e2 = z[i + diagonal[f, 0], j + diagonal[f, 1]]
                s1, s2 = z[i, j] - e1, e1 - e2
                if s2 < 0.0:  # steepest along the facet's side
                    r, s = 0.0, s1
                elif s2 > s1:  # or along its diagonal
                    r, s = pi / 4, (s1 + s2) / 2**0.5
                else:
                    r, s = 0.5, (s1 * s1 + s2 * s2) ** 0.5
                if s > steepest:
                    steepest, chosen = s, f
                    angle = atan2(s2, s1) if r == 0.5 else r
            node = i * cols + j
            if chosen >= 0:
                along = angle / (pi / 4)
                receiver[node, 0] = node + cardinal[chosen, 0] * cols + cardinal[chosen, 1]
                receiver[node, 1] = node + diagonal[chosen, 0] * cols + diagonal[chosen, 1]
                share[node, 0], share[node, 1] = 1.0 - along, along
                contour_m[node] = cell_m / (cos(angle) + along * sin(angle))
            else:
                _breach(z, i, j, receiver, share)


@compiled
def _breach(z, i, j, receiver, share):  # type: ignore[no-untyped-def]
    """All water of a node without a lower neighbour goes to the nearest lower node, the lowest of those alike."""
    rows, cols = z.shape
    nearest = 2 * _BREACH * _BREACH + 1
    lowest = z[i, j]
    for k in range(max(0, i - _BREACH), min(rows, i + _BREACH + 1)):
        for m in range(max(0, j - _BREACH), min(cols, j + _BREACH + 1)):
            away = (k - i) ** 2 + (m - j) ** 2
            if z[k, m] < z[i, j] and (away < nearest or (away == nearest and z[k, m] < lowest)):
                nearest, lowest = away, z[k, m]
                receiver[i * cols + j, 0] = k * cols + m
                share[i * cols + j, 0] = 1.0


@compiled
def _run(downhill_first, receiver, share, contour_m, way_m, cell_m, area_m2):  # type: ignore[no-untyped-def]
    lost_m2 = 0.0
    for node in downhill_first:
        for side in range(2):
            if share[node, side] > 0.0:
                step_m = cell_m * cell_m / contour_m[node]
                arriving = exp(-step_m / way_m[node]) if way_m[node] > 0.0 else 0.0
                water = share[node, side] * area_m2[node]
                area_m2[receiver[node, side]] += arriving * water
                lost_m2 += (1.0 - arriving) * water
    return lost_m2


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
    stride = max(1, round(max(site.size_m) / (_VIEW_NODES * near.cell_m)))
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
