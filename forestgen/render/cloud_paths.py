"""Light paths through clouds over a plain and nothing else: compiled, many times as efficient as in a whole scene.

A path starts at a point below, in or above the clouds and flies by delta tracking (Woodcock et al. 1965): the grid is
cut into bricks of 8 x 8 x 8 cells, each with the largest value that can occur in it, and a walk from brick to brick
draws collisions at that rate, of which the share sigma / largest is real. The field between the cells' centres is
that of atmosphere/optical_depth.py and of the renderer. At a collision the light of the sun is gathered through the
clouds by ratio tracking (Novak et al. 2014) from a random point of its disc, and the path goes on in a direction drawn
from the phase function. Where it leaves the clouds upwards it takes the sky's radiance of that direction; downwards it
meets a level Lambertian plain without end, which stands for the land around.

Clouds are grey, so one path serves all channels. Of the sun a path yields its share, to be multiplied by the sun's
light in any channels. Light is kept apart by how often the plain has reflected it, never, once, or more often, as from
a white plain: radiance is a polynomial of the plain's albedo, so the plain can have any colour afterwards.

Decisions
---------
- No largest depth. Paths whose weight has fallen below a tenth end by chance, and from 1024 scatterings on one path in
  a thousand does at each; both keep the mean. Cutting off at 64 loses 1% of a cumulus' light.
- Of the paths that meet the plain a share goes on that is about its albedo, at least 0.3. A third and later reflection
  has the plain's mean albedo in all channels.
- Random numbers belong to a ray's number and the number of its path (SplitMix64 from a hash of both), so results
  do not depend on threads.

References
----------
Woodcock, E., Murphy, T., Hemmings, P., Longworth, S. (1965): Techniques used in the GEM code for Monte Carlo
neutronics calculations in reactors and other systems of complex geometry. ANL-7050.
Novak, J., Selle, A., Jarosz, W. (2014): Residual ratio tracking for estimating attenuation in participating media.
ACM Trans. Graph. 33, 179.
Steele, G., Lea, D., Flood, C. (2014): Fast splittable pseudorandom number generators. OOPSLA 2014.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.cloud_detail import EMPTY, NO_DETAIL, Detail, share_inside
from forestgen.atmosphere.grid import CloudGrid
from forestgen.atmosphere.optical_depth import advanced, clipped, entered, inside, largest_in_boxes
from forestgen.core.compiled import compiled, inlined, inlined_exactly, unowned_view
from forestgen.core.randomness import SPLIT_MIX_STEP, mixed
from forestgen.core.threads import parallel_for

BRICK, DETAIL_BRICK = 8, 2  # cells along its side, and where clouds have detail
_FAINT = 0.1  # weight below which a path may end by chance
_LONG, _STAYS = 1024, 0.999  # scatterings from which on it may too, and the chance that it does not
_DIM = 0.25  # transmittance below which a ray to the sun may end by chance
scrambled = inlined_exactly(mixed)
_GOES_ON = 0.3  # least share of the paths that go on from the plain
ORDERS = 3  # none, one and more reflections on the plain
_CALL_PATHS = 400_000  # in one call of the kernel: Ctrl-C stops the work between calls
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CloudField:
    """A grid, made ready."""

    value: NDArray[np.float32]  # (Z + 2, Y + 2, X + 2) extinction, 1/m, the border's values repeated
    most: NDArray[np.float32]  # (ceil(Z / 8), ...) largest extinction that a point of each brick can have
    low_m: Floats  # (3,) world
    per_m: Floats  # (3,) cells a metre along x, y, z
    scattering: Floats  # (4,) albedo, and the phase function's forward, backward, forward_share
    detail: Detail = NO_DETAIL  # with detail `value` is the extinction of the clouds' inside, and bricks are small
    above: CloudField | None = None  # a higher layer

    @property
    def layers(self) -> tuple[CloudField, ...]:
        """This one and those above."""
        return (self,) if self.above is None else (self, *self.above.layers)


@dataclass(frozen=True, eq=False)
class CloudLight:
    """What shines on the clouds and the plain."""

    to_sun: Floats  # (3,) unit, world
    sun_radius_deg: float
    sky: NDArray[np.float32]  # (C, R, W) radiance by direction, C channels; see `sky_radiance.map_directions`
    ground_albedo: float  # mean over the channels: the plain's, from the third reflection on
    ground_m: float  # world height of the plain


class Gathered(NamedTuple):
    """Radiance at the rays' origins, means over their paths, by reflections on the plain: none, one, more."""

    of_sky: Floats  # (N, 3, C) in the units of the sky's map
    of_sun: Floats  # (N, 3) 1/sr: times the sun's irradiance on a plane that faces it
    of_aloft: Floats  # (N, 3, L) what of it each layer of clouds has scattered last, and not the plain, or nothing

    def radiance(self, albedo: Floats, sun: Floats, aloft: Floats | None = None) -> Floats:
        """(N, C) over a plain of (C,) albedo, under a sun of (C,) irradiance, and those of the layers (L, C)."""
        power = albedo ** np.arange(ORDERS)[:, None]
        light = self.of_sky + self.of_sun[..., None] * sun
        if aloft is not None:
            light = light + np.einsum("nol,lc->noc", self.of_aloft, aloft - sun)
        return np.asarray(np.einsum("noc,oc->nc", light, power))


def field_of(clouds: CloudGrid) -> CloudField:
    """The grid with its border repeated and the largest value of each brick."""
    grid, detail = np.asarray(clouds.inside_per_m, dtype=np.float32), clouds.detail
    value = np.pad(grid, 1, mode="edge")
    if detail.brick.size:
        most = largest_in_boxes(grid, [np.arange(n) for n in grid.shape])
        most = np.where(detail.brick == EMPTY, np.float32(0), most)
        for axis, count in enumerate(grid.shape):
            most = np.maximum.reduceat(most, np.arange(0, count, DETAIL_BRICK), axis=axis)
        most = np.ascontiguousarray(most)
    else:
        most = largest_in_boxes(grid, [np.arange(0, n, BRICK) for n in grid.shape])
    low, high = np.asarray(clouds.low_m, dtype=np.float64), np.asarray(clouds.high_m, dtype=np.float64)
    phase = clouds.phase
    scattering = np.array([clouds.albedo, phase.forward, phase.backward, phase.forward_share])
    per_m = np.array(grid.shape[::-1]) / (high - low)
    above = None if clouds.above is None else field_of(clouds.above)
    return CloudField(np.ascontiguousarray(value), most, low, per_m, scattering, detail, above)


def gather(
    field: CloudField,
    light: CloudLight,
    origin_m: Floats,
    direction: Floats,
    *,
    seed: int,
    samples: int = 1,
    disc: bool = True,
) -> Gathered:
    """Radiance that arrives at (3,) or (N, 3) origins, world, from (N, 3) unit directions, by `samples` paths of each.

    With `disc`, rays that point at the sun see its disc; without, they still see the light around it.
    """
    count, channels = len(direction), len(light.sky)
    start = np.empty((count, 3))  # never read-only, which would be a second kernel
    start[:] = np.asarray(origin_m) - field.low_m
    way = np.ascontiguousarray(direction, dtype=np.float64)
    out = np.zeros((count, ORDERS, channels + 1 + len(field.layers)))
    sky = np.ascontiguousarray(np.moveaxis(light.sky, 0, -1), dtype=np.float32)
    sun = np.array([*light.to_sun, np.cos(np.radians(light.sun_radius_deg))], dtype=np.float64)
    goes_on = max(light.ground_albedo, _GOES_ON)
    ground = np.array([light.ground_albedo, light.ground_m - field.low_m[2], goes_on])
    rays = max(1, _CALL_PATHS // samples)
    volumes = tuple(_volume_of(one, field.low_m) for one in field.layers)
    given = (volumes, sky, sun, ground, start, way, np.uint64(seed))
    for begin in range(0, count, rays):
        here = min(rays, count - begin)

        def work(first: int, end: int, begin: int = begin) -> None:  # in paths, so that few rays of many paths spread
            first, end = begin - (-first // samples), begin - (-end // samples)
            _gather(*given, samples, disc, first, end, out)

        parallel_for(here * samples, work)
    out /= samples
    return Gathered(out[..., :channels], out[..., channels], out[..., channels + 1 :])


def _volume_of(field: CloudField, origin_m: Floats) -> tuple[Any, ...]:
    """A layer as kernels have it; lengths are from a place in the world."""
    side = DETAIL_BRICK if field.detail.brick.size else BRICK
    low, per_m, scattering = (tuple(one.tolist()) for one in (field.low_m - origin_m, field.per_m, field.scattering))
    return field.value, field.most, field.detail, side, low, per_m, scattering


@compiled
def _gather(volumes, sky, sun, ground, start, way, seed, samples, disc, first, end, out):  # type: ignore[no-untyped-def]
    """Add the light of rays `first` to `end` to `out` (N, 3, C + 1 + L); lengths are from the first low corner."""
    volumes = unowned_view(volumes)
    sun_x, sun_y, sun_z, sun_cos = sun
    ground_albedo, ground_m, goes_on = ground

    facing_sr = np.pi * (1.0 - sun_cos * sun_cos)
    channels = sky.shape[2]
    for ray in range(first, end):
        for sample in range(samples):
            state = _begun(seed, np.uint64(ray), np.uint64(sample))
            x, y, z = start[ray, 0], start[ray, 1], start[ray, 2]
            dx, dy, dz = way[ray, 0], way[ray, 1], way[ray, 2]
            weight, order, reflections = 1.0, 0, 0
            while True:
                # Layers are independent: the first collision with any of them is the next.
                t, layer = np.inf, 0
                for n in range(len(volumes)):
                    own, _, state = _flight(volumes[n], x, y, z, dx, dy, dz, False, state)
                    if own < t:
                        t, layer = own, n
                albedo, forward, backward, share = volumes[layer][6]
                met = t < np.inf
                if met:
                    weight *= albedo
                elif dz < 0.0:
                    t = (ground_m - z) / dz
                    reflections += 1
                    if reflections >= ORDERS:
                        weight *= ground_albedo
                    state, u = _draw(state)
                    if u >= goes_on:
                        break
                    weight /= goes_on
                else:
                    _add_sky(sky, dx, dy, dz, weight, channels, out[ray, min(reflections, ORDERS - 1)])
                    if disc and order == 0 and dx * sun_x + dy * sun_y + dz * sun_z >= sun_cos:
                        out[ray, min(reflections, ORDERS - 1), channels] += weight / facing_sr
                    break
                if weight <= 0.0:
                    break
                x, y, z = x + t * dx, y + t * dy, z + t * dz
                state, u = _draw(state)
                state, v = _draw(state)
                sx, sy, sz = _turned(sun_x, sun_y, sun_z, 1.0 - u * (1.0 - sun_cos), v)
                if sz > 0.0:
                    toward = _phase(dx * sx + dy * sy + dz * sz, forward, backward, share) if met else sz / np.pi
                    seen = 1.0
                    for n in range(len(volumes)):
                        if seen > 0.0:
                            _, own, state = _flight(volumes[n], x, y, z, sx, sy, sz, True, state)
                            seen *= own
                    out[ray, min(reflections, ORDERS - 1), channels] += weight * toward * seen
                    if met:
                        out[ray, min(reflections, ORDERS - 1), channels + 1 + layer] += weight * toward * seen
                state, u = _draw(state)
                state, v = _draw(state)
                if met:
                    state, which = _draw(state)
                    cosine = _scattered(forward if which < share else backward, u)
                    dx, dy, dz = _turned(dx, dy, dz, cosine, v)
                else:
                    dz = np.sqrt(u)
                    across = np.sqrt(1.0 - u)
                    dx, dy = across * np.cos(2.0 * np.pi * v), across * np.sin(2.0 * np.pi * v)
                order += 1
                if weight < _FAINT:
                    state, u = _draw(state)
                    if u * _FAINT >= weight:
                        break
                    weight = _FAINT
                if order >= _LONG:
                    state, u = _draw(state)
                    if u >= _STAYS:
                        break
                    weight /= _STAYS


@compiled
def _flight(volume, x, y, z, dx, dy, dz, ratio, state):  # type: ignore[no-untyped-def]
    """Distance to the next collision, inf for none; or, by `ratio`, an estimate of the transmittance of all the way."""
    value, most, detail, side, (low_x, low_y, low_z), (per_x, per_y, per_z), _ = volume
    x, y, z = x - low_x, y - low_y, z - low_z
    x, y, z = x * per_x - 0.5, y * per_y - 0.5, z * per_z - 0.5  # in cells, from the first one's centre
    dx, dy, dz = dx * per_x, dy * per_y, dz * per_z
    start, step = (x, y, z), (dx, dy, dz)
    t, end = clipped(start, step, np.inf, -0.5, (value.shape[2] - 2.5, value.shape[1] - 2.5, value.shape[0] - 2.5))
    through = 1.0
    if not t < end:
        return np.inf, through, state
    bricks = (most.shape[2], most.shape[1], most.shape[0])
    box, leaves = entered(start, step, t, -0.5, side, 0, bricks)
    state, u = _draw(state)
    left = -np.log(u)  # optical depth, at the bricks' largest extinctions, to the next collision
    while True:
        rate = np.float64(most[box[2], box[1], box[0]])
        ahead = min(leaves)
        until = min(ahead, end)
        while rate > 0.0:
            if rate * (until - t) <= left:
                left -= rate * max(until - t, 0.0)
                break
            t += left / rate
            here = _value(value, x + t * dx, y + t * dy, z + t * dz)
            here *= share_inside(detail, x + t * dx, y + t * dy, z + t * dz)
            if ratio:
                through *= max(1.0 - here / rate, 0.0)
                if through < _DIM:
                    state, u = _draw(state)
                    if u * _DIM >= through:
                        return np.inf, 0.0, state
                    through = _DIM
            else:
                state, u = _draw(state)
                if u * rate < here:
                    return t, through, state
            state, u = _draw(state)
            left = -np.log(u)
        t = until
        if ahead >= end:
            return np.inf, through, state
        box, leaves = advanced(box, leaves, start, step, -0.5, side)
        if not inside(box, 0, bricks):
            return np.inf, through, state


@inlined
def _value(value, x, y, z):  # type: ignore[no-untyped-def]
    """Trilinear between cells' centres; the array's border is one cell outside of the grid."""
    i = min(max(int(np.floor(x)) + 1, 0), value.shape[2] - 2)
    j = min(max(int(np.floor(y)) + 1, 0), value.shape[1] - 2)
    k = min(max(int(np.floor(z)) + 1, 0), value.shape[0] - 2)
    u, v, w = x + 1.0 - i, y + 1.0 - j, z + 1.0 - k
    a, b = value[k, j, i], value[k, j, i + 1]
    c, d = value[k, j + 1, i], value[k, j + 1, i + 1]
    e, f = value[k + 1, j, i], value[k + 1, j, i + 1]
    g, h = value[k + 1, j + 1, i], value[k + 1, j + 1, i + 1]
    below = (a * (1.0 - u) + b * u) * (1.0 - v) + (c * (1.0 - u) + d * u) * v
    above = (e * (1.0 - u) + f * u) * (1.0 - v) + (g * (1.0 - u) + h * u) * v
    return below * (1.0 - w) + above * w


@inlined
def _phase(cosine, forward, backward, share):  # type: ignore[no-untyped-def]
    """Share of the scattered light in a direction, 1/sr."""
    result = share * _henyey_greenstein(cosine, forward)
    if share < 1.0:
        result += (1.0 - share) * _henyey_greenstein(cosine, backward)
    return result


@inlined
def _henyey_greenstein(cosine, g):  # type: ignore[no-untyped-def]
    base = 1.0 + g * g - 2.0 * g * cosine
    return (1.0 - g * g) / (4.0 * np.pi * base * np.sqrt(base))


@inlined
def _scattered(g, u):  # type: ignore[no-untyped-def]
    """Cosine of a scattering angle, of a uniform number."""
    if abs(g) < 1e-3:
        return 1.0 - 2.0 * u
    part = (1.0 - g * g) / (1.0 - g + 2.0 * g * u)
    return min(max((1.0 + g * g - part * part) / (2.0 * g), -1.0), 1.0)


@inlined
def _turned(x, y, z, cosine, turn):  # type: ignore[no-untyped-def]
    """A unit vector at an angle from another, around which it is turned by a share of the circle.

    The two vectors across are those of Duff et al. (2017): Building an orthonormal basis, revisited. JCGT 6(1).
    """
    sine = np.sqrt(max(1.0 - cosine * cosine, 0.0))
    p, q = sine * np.cos(2.0 * np.pi * turn), sine * np.sin(2.0 * np.pi * turn)
    sign = 1.0 if z >= 0.0 else -1.0
    a = -1.0 / (sign + z)
    b = x * y * a
    tx = p * (1.0 + sign * x * x * a) + q * b + cosine * x
    ty = p * sign * b + q * (sign + y * y * a) + cosine * y
    tz = -p * sign * x - q * y + cosine * z
    scale = 1.0 / np.sqrt(tx * tx + ty * ty + tz * tz)
    return tx * scale, ty * scale, tz * scale


@inlined
def _add_sky(sky, dx, dy, dz, weight, channels, out):  # type: ignore[no-untyped-def]
    """Add the sky's radiance in a direction, bilinear in its map, to the first channels."""
    rows, columns = sky.shape[0], sky.shape[1]
    row = np.arccos(min(dz, 1.0)) * ((rows - 1) / np.pi)
    column = np.arctan2(dy, dx) * (columns / (2.0 * np.pi)) - 0.5
    r, c = min(int(row), rows - 2), int(np.floor(column))
    u, v = column - c, row - r
    left, right = c % columns, (c + 1) % columns
    for channel in range(channels):
        upper = sky[r, left, channel] * (1.0 - u) + sky[r, right, channel] * u
        lower = sky[r + 1, left, channel] * (1.0 - u) + sky[r + 1, right, channel] * u
        out[channel] += weight * (upper * (1.0 - v) + lower * v)


@inlined
def _begun(seed, ray, sample):  # type: ignore[no-untyped-def]
    """The random stream of one path."""
    step = SPLIT_MIX_STEP
    return scrambled(scrambled(scrambled(seed + step) ^ (ray + step)) ^ (sample + step))


@inlined
def _draw(state):  # type: ignore[no-untyped-def]
    """The stream's next state, and a number in (0, 1)."""
    state = state + SPLIT_MIX_STEP
    return state, (np.float64(scrambled(state) >> np.uint64(11)) + 0.5) * (1.0 / 9007199254740992.0)
