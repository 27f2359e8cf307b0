"""Random walks of light through a cloud field, followed backwards from rays that enter it: compiled.

A ray flies by Woodcock's delta tracking over small boxes of the grid, each with a largest extinction of its own
(Szirmay-Kalos et al. 2011). At every scattering the sun is looked for: a point of its disc is drawn and the optical
depth towards it integrated piece by piece, exactly (as atmosphere/optical_depth.py does). Past `_CERTAIN_DEPTH` the
march goes on only as far as a random optical depth, exponentially distributed, and counts e^-depth of the certain part
if the sun is reached before: of the same mean, and short in thick clouds.

A walk ends where it leaves the field: upwards it sees the sky, downwards it is handed back to the caller. After
`_FREE_SCATTERINGS` absorption is by chance; before, by weight.

References
----------
Woodcock, E. et al. (1965): Techniques used in the GEM code for Monte Carlo neutronics calculations. ANL-7050, 557.
Szirmay-Kalos, L., Toth, B., Magdics, M. (2011): Free path sampling in high resolution inhomogeneous participating
media. Computer Graphics Forum 30, 85.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.grid import CloudGrid
from forestgen.atmosphere.optical_depth import (
    advanced,
    clipped,
    corners,
    entered,
    inside,
    largest_in_boxes,
    mixed,
    piece,
)
from forestgen.core.compiled import compiled, unowned_view
from forestgen.core.threads import parallel_for
from forestgen.render.cloud_paths import scrambled

_BOX_CELLS = 4  # along the side of a box with one largest extinction
_CERTAIN_DEPTH = 1.5
_FREE_SCATTERINGS = 64
_MOST_SCATTERINGS = 1_000_000  # a walk in a field that absorbs nothing ends all the same
Floats = NDArray[np.float64]


def disc_parameters(centre_m: Floats, radius_m: float) -> Floats:
    """(13,) an even disc by its centre from the origin, m: it, two radii across, unit normal to the origin, area."""
    normal = -centre_m / np.linalg.norm(centre_m)
    first = np.cross(normal, [1.0, 0.0, 0.0] if abs(normal[0]) < 0.9 else [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    return np.concatenate([centre_m, first * radius_m, second * radius_m, normal, [np.pi * radius_m**2]])


@dataclass(frozen=True)
class Walks:
    """Where walks ended, by ray."""

    sun: Floats  # (N,) radiance from the sun, in units of its own radiance
    leaves_m: Floats  # (N, 3) where the walk left the field, or the ray's origin if it never met it
    direction: Floats  # (N, 3) and where to
    weight: Floats  # (N,) its throughput; 0: it was absorbed


@dataclass(frozen=True)
class WalkField:
    """A cloud field made ready for walks, in a frame that has `origin_m` as its origin."""

    value: NDArray[np.float32]  # (Z, Y, X)
    box_most: NDArray[np.float32]  # (boxes along z, y, x) largest extinction, the interpolated border included
    low_m: Floats  # (3,)
    cell_m: Floats  # (3,)
    optics: Floats  # (4,) albedo, g, g of the second lobe, share of the first

    @classmethod
    def of(cls, clouds: CloudGrid, origin_m: Floats) -> WalkField:
        value = np.ascontiguousarray(clouds.extinction_per_m, dtype=np.float32)
        phase = clouds.phase
        return cls(
            value,
            largest_in_boxes(value, [np.arange(0, n, _BOX_CELLS) for n in value.shape]),
            np.asarray(clouds.low_m) - origin_m,
            np.asarray(clouds.cell_m),
            np.array([clouds.albedo, phase.forward, phase.backward, phase.forward_share]),
        )

    def walk(self, origin_m: Floats, direction: Floats, disc: Floats | None, seed: int) -> Walks:
        """Follow (N, 3) rays, one walk each, under a sun of `disc_parameters`."""
        count = len(origin_m)
        leaves, heading = np.array(origin_m, dtype=np.float64), np.array(direction, dtype=np.float64)
        light, weight = np.zeros(count), np.ones(count)
        sun = np.zeros(13) if disc is None else disc
        given = (self.value, self.box_most, self.low_m, self.cell_m, self.optics, sun, np.uint64(seed % 2**64))
        parallel_for(count, lambda first, end: _walk(*given, first, end, leaves, heading, light, weight))
        return Walks(light, leaves, heading, weight)


@compiled
def _walk(value, most, low, cell, optics, disc, seed, first_ray, end_ray, leaves, heading, light, weight):  # type: ignore[no-untyped-def]
    value, most = unowned_view((value, most))
    albedo, g1, g2, share = optics[0], optics[1], optics[2], optics[3]
    scale_x, scale_y, scale_z = 1.0 / cell[0], 1.0 / cell[1], 1.0 / cell[2]
    state = np.zeros(1, dtype=np.uint64)
    turned = np.zeros(3)
    for ray in range(first_ray, end_ray):
        state[0] = scrambled(
            seed ^ scrambled(np.uint64(ray) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(0x632BE59BD9B4E019))
        )
        # Place and direction in cells; t is in metres.
        x = (leaves[ray, 0] - low[0]) * scale_x
        y = (leaves[ray, 1] - low[1]) * scale_y
        z = (leaves[ray, 2] - low[2]) * scale_z
        dx, dy, dz = heading[ray, 0], heading[ray, 1], heading[ray, 2]
        scatterings = 0
        w, sun = 1.0, 0.0
        met = False
        while True:
            ux, uy, uz = dx * scale_x, dy * scale_y, dz * scale_z
            t, scattered = _flight(value, most, (x, y, z), (ux, uy, uz), state)
            if t < 0.0:
                break
            met = True
            x, y, z = x + t * ux, y + t * uy, z + t * uz
            if not scattered:
                break
            scatterings += 1
            if scatterings <= _FREE_SCATTERINGS:
                w *= albedo
            elif _random(state) >= albedo or scatterings > _MOST_SCATTERINGS:
                w = 0.0
                break
            if disc[12] > 0.0:
                sun += w * _from_sun(value, low, cell, disc, x, y, z, dx, dy, dz, g1, g2, share, state)
            g = g1 if share >= 1.0 or _random(state) < share else g2
            _turn(dx, dy, dz, g, state, turned)
            dx, dy, dz = turned[0], turned[1], turned[2]
        light[ray], weight[ray] = sun, w
        heading[ray, 0], heading[ray, 1], heading[ray, 2] = dx, dy, dz
        if met:
            leaves[ray, 0], leaves[ray, 1] = x * cell[0] + low[0], y * cell[1] + low[1]
            leaves[ray, 2] = z * cell[2] + low[2]


@compiled
def _random(state):  # type: ignore[no-untyped-def]
    """The next number in [0, 1)."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    return np.float64(scrambled(state[0]) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@compiled
def _flight(value, most, start, step, state):  # type: ignore[no-untyped-def]
    """Metres to the next scattering or to the end of the field, and whether it is a scattering; -1: it is missed."""
    layers, rows, columns = value.shape
    boxes = (most.shape[2], most.shape[1], most.shape[0])
    t, end = clipped(start, step, np.inf, 0.0, (columns, rows, layers))
    if not t < end:
        return -1.0, False
    (x, y, z), (ux, uy, uz) = start, step
    box, leaves = entered(start, step, t, 0.0, _BOX_CELLS, 0, boxes)
    depth = -np.log(1.0 - _random(state))
    while True:
        ahead = min(leaves)
        until = min(ahead, end)
        largest = np.float64(most[box[2], box[1], box[0]])
        if largest > 0.0:
            while True:
                way = depth / largest
                if t + way >= until:
                    depth -= max(until - t, 0.0) * largest
                    break
                t += way
                if _random(state) * largest < _lookup(value, x + t * ux - 0.5, y + t * uy - 0.5, z + t * uz - 0.5):
                    return t, True
                depth = -np.log(1.0 - _random(state))
        t = max(t, until)
        if ahead >= end:
            return end, False
        box, leaves = advanced(box, leaves, start, step, 0.0, _BOX_CELLS)
        if not inside(box, 0, boxes):
            return end, False


@compiled
def _lookup(value, x, y, z):  # type: ignore[no-untyped-def]
    """Trilinear; values stand at whole numbers and are held beyond the border."""
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    return mixed(corners(value, i, j, k), x - i, y - j, z - k)


@compiled
def _from_sun(value, low, cell, disc, x, y, z, dx, dy, dz, g1, g2, share, state):  # type: ignore[no-untyped-def]
    """Light of the sun scattered into the ray's way, in units of the disc's radiance."""
    radius, angle = np.sqrt(_random(state)), 2.0 * np.pi * _random(state)
    a, b = radius * np.cos(angle), radius * np.sin(angle)
    tx = disc[0] + a * disc[3] + b * disc[6] - (x * cell[0] + low[0])
    ty = disc[1] + a * disc[4] + b * disc[7] - (y * cell[1] + low[1])
    tz = disc[2] + a * disc[5] + b * disc[8] - (z * cell[2] + low[2])
    squared = tx * tx + ty * ty + tz * tz
    per_length = 1.0 / np.sqrt(squared)
    tx, ty, tz = tx * per_length, ty * per_length, tz * per_length
    facing = -(tx * disc[9] + ty * disc[10] + tz * disc[11])
    if facing <= 0.0:
        return 0.0
    cosine = dx * tx + dy * ty + dz * tz
    phase = share * _henyey(cosine, g1) + ((1.0 - share) * _henyey(cosine, g2) if share < 1.0 else 0.0)
    # In cells from the first one's centre.
    place, step = (x - 0.5, y - 0.5, z - 0.5), (tx / cell[0], ty / cell[1], tz / cell[2])
    through = _through(value, place, step, state)
    return phase * through * facing * disc[12] / squared


@compiled
def _henyey(cosine, g):  # type: ignore[no-untyped-def]
    below = 1.0 + g * g - 2.0 * g * cosine
    return (1.0 - g * g) / (4.0 * np.pi * below * np.sqrt(below))


@compiled
def _turn(dx, dy, dz, g, state, turned):  # type: ignore[no-untyped-def]
    """A direction scattered by Henyey and Greenstein's phase function."""
    first, angle = _random(state), 2.0 * np.pi * _random(state)
    if abs(g) < 1e-3:
        cosine = 1.0 - 2.0 * first
    else:
        part = (1.0 - g * g) / (1.0 - g + 2.0 * g * first)
        cosine = (1.0 + g * g - part * part) / (2.0 * g)
    sine = np.sqrt(max(0.0, 1.0 - cosine * cosine))
    # A frame around the direction (Duff et al. 2017).
    sign = 1.0 if dz >= 0.0 else -1.0
    a = -1.0 / (sign + dz)
    b = dx * dy * a
    p, q = sine * np.cos(angle), sine * np.sin(angle)
    x = p * (1.0 + sign * dx * dx * a) + q * b + cosine * dx
    y = p * sign * b + q * (sign + dy * dy * a) + cosine * dy
    z = -p * sign * dx - q * dy + cosine * dz
    length = 1.0 / np.sqrt(x * x + y * y + z * z)
    turned[0], turned[1], turned[2] = x * length, y * length, z * length


@compiled
def _through(value, start, step, state):  # type: ignore[no-untyped-def]
    """An estimate of the share of light that comes from a place inside the field to its border."""
    layers, rows, columns = value.shape
    pieces = (columns, rows, layers)
    end = min(_border(start[0], step[0], columns), _border(start[1], step[1], rows), _border(start[2], step[2], layers))
    box, leaves = entered(start, step, 0.0, 0.0, 1, -1, pieces)
    total, enough, t = 0.0, np.inf, 0.0
    while True:
        ahead = min(leaves)
        until = min(ahead, end)
        if until > t:
            total += _piece(value, box, start, step, t, until)
            t = until
            if total > _CERTAIN_DEPTH:
                if enough == np.inf:
                    enough = _CERTAIN_DEPTH - np.log(1.0 - _random(state))
                if total > enough:
                    return 0.0
        if ahead >= end:
            break
        box, leaves = advanced(box, leaves, start, step, 0.0, 1)
        if not inside(box, -1, pieces):
            break
    return np.exp(-min(total, _CERTAIN_DEPTH))


@compiled
def _border(start, step, size):  # type: ignore[no-untyped-def]
    if step == 0.0:
        return np.inf
    return max(0.0, ((size - 0.5 if step > 0.0 else -0.5) - start) / step)


@compiled
def _piece(value, box, start, step, first, last):  # type: ignore[no-untyped-def]
    """Integral over [first, last], all of it between the same eight values."""
    corner = corners(value, box[0], box[1], box[2])
    a, b, c, d, e, f, g, h = corner
    if a == 0.0 and b == 0.0 and c == 0.0 and d == 0.0 and e == 0.0 and f == 0.0 and g == 0.0 and h == 0.0:
        return 0.0
    return piece(corner, box, start, step, first, last, 0.5 * (last - first) * 0.5773502691896258)
