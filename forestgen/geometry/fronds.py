"""Fronds of palms and ferns, blades of grass and their seed heads; needles, in bundles and on twigs.

A needle covers 0.8 of its length times its width, whatever the number of its triangles. A twig's shape may draw fewer
needles than it bears: each one drawn then stands for several, longer by the power 0.4 of their number and wider by the
power 0.6, so that the area stays.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.leaves import Blade, Entire, Lobed, blade
from forestgen.geometry.patches import (
    Patch,
    area_m2,
    attitude,
    bend,
    bent,
    copies,
    join,
    on_axis,
    outwards,
    placed,
    revolve,
    strip,
    tube,
)  # fmt: skip

Floats = NDArray[np.float64]

_UP = np.array([0.0, 0.0, 1.0])
_ALONG = np.array([0.0, 1.0, 0.0])
_PALM_LEAFLET = 0.68  # area of a leaflet over its length times its width
_COVER = 0.8  # area of a needle over its length times its width
_GOLDEN_RAD = np.pi * (3.0 - np.sqrt(5.0))
_LENGTH_POWER = 0.4
_LONGEST = 3.2  # a needle that stands for many is at most so many times as long


def _sideways(angle_rad: Floats, lift_rad: Floats | float, side: Floats) -> Floats:
    """(N, 3, 3) attitudes of leaflets at an angle from a rachis along y, lifted out of its plane; side is +1 or -1."""
    lift = np.broadcast_to(lift_rad, angle_rad.shape)
    out = np.column_stack([side * np.cos(lift), np.zeros(len(side)), np.sin(lift)])
    along = np.cos(angle_rad)[:, None] * _ALONG + np.sin(angle_rad)[:, None] * out
    upper = np.column_stack([-side * np.sin(lift), np.zeros(len(side)), np.cos(lift)])
    return attitude(along, upper)


def rachis(length_m: float, diameter_m: float, detail: int) -> Patch:
    """The axis of a frond along y, tapering to a point: 3 or 5 sides."""
    stops = (4, 8, 16)[detail]
    share = np.linspace(0.0, 1.0, stops)
    return tube(on_axis(share * length_m), 0.5 * diameter_m * (1.0 - share) ** 0.7, (3, 3, 5)[detail])


def _of_area(made: Callable[[float], Patch], wanted_m2: float) -> Patch:
    """What `made` gives of a factor on its blades' width, such that the area is `wanted_m2`."""
    broad = 1.0
    for _ in range(3):
        patch = made(broad)
        broad *= wanted_m2 / area_m2(patch)
    return made(broad)


def palm_frond(
    length_m: float,
    stalk_m: float,
    leaflets: int,
    leaflet_length_m: float,
    leaflet_width_m: float,
    *,
    arch_deg: float,
    lift_deg: float,
    droop_deg: float,
    detail: int,
) -> Patch:
    """Leaflets of a feather palm, before the rachis is bent (see `arched`).

    Parameters
    ----------
    length_m, stalk_m : of the whole frond, and of its bare foot.
    leaflets : on each side.
    lift_deg : of the leaflets above the rachis' plane, so that the frond is V-shaped.
    droop_deg : bend of each leaflet.
    """
    profiles = ([1.0, 0.0], [0.5, 1.0, 0.75, 0.0], [0.3, 0.9, 1.0, 0.85, 0.5, 0.0])
    widths = leaflet_width_m * np.array(profiles[detail])
    share = (np.arange(leaflets) + 0.5) / leaflets
    place = stalk_m + (length_m - stalk_m) * share**0.95
    size = np.clip(0.45 + 2.2 * share, 0.0, 1.0) * (1.0 - 0.62 * np.clip((share - 0.45) / 0.55, 0.0, 1.0) ** 2)
    angle = np.radians(72.0 - 48.0 * share**1.3)
    jitter = 0.12 * np.sin(12.9898 * np.arange(2 * leaflets))

    def made(broad: float) -> Patch:
        leaflet = strip(leaflet_length_m, broad * widths, keel_rad=np.radians(25.0), folded=detail == 2)
        leaflet = bent(leaflet, leaflet_length_m, np.radians(droop_deg), 1.3)
        parts = []
        for side, wobble in ((1.0, jitter[::2]), (-1.0, jitter[1::2])):
            turn = _sideways(angle + wobble, np.radians(lift_deg) + 1.3 * wobble, np.full(leaflets, side))
            parts.append(copies(leaflet, turn * size[:, None, None], on_axis(place)))
        return bent(join(parts), length_m, np.radians(arch_deg), 1.6)

    return _of_area(made, 2.0 * float(np.sum(size**2)) * _PALM_LEAFLET * leaflet_length_m * leaflet_width_m)


def fan_frond(
    radius_m: float, stalk_m: float, segments: int, *, spread_deg: float, split: float, droop_deg: float, detail: int
) -> Patch:
    """The pleated blade of a fan palm at the end of its stalk: folded segments, the outermost `spread_deg` apart.

    `split` is the share of the radius over which the segments are separate.
    """
    edge = np.radians(spread_deg) * (np.arange(segments + 1) / segments - 0.5)
    middle = 0.5 * (edge[1:] + edge[:-1])
    half = 0.5 * (edge[1] - edge[0])
    inner = radius_m * (1.0 - split)
    width = 2.0 * inner * np.tan(half)
    reach = radius_m * (1.0 - 0.25 * (np.abs(middle) / max(np.abs(edge[0]), 1e-9)) ** 2)
    if detail == 0:
        profile, at = width * np.array([0.0, 1.0, 0.0]), np.array([0.0, 1.0 - split, 1.0])
    else:
        profile, at = width * np.array([0.0, 1.0, 0.8, 0.5, 0.0]), np.array([0.0, 1.0, 1.3, 1.7, 2.0])
        at = np.where(at <= 1.0, at * (1.0 - split), 1.0 - split + (at - 1.0) * split)
    keel = np.radians(22.0)
    ray = _ray(at * radius_m, profile, keel, folded=detail > 0)
    ray = bent(ray, radius_m, np.radians(droop_deg), 2.5)
    along = np.column_stack([np.sin(middle), np.cos(middle), np.zeros(segments)])
    linear = attitude(along, np.tile(_UP, (segments, 1))) * (reach / radius_m)[:, None, None]
    return copies(ray, linear, np.tile([0.0, stalk_m, 0.0], (segments, 1)))


def _ray(y: Floats, width: Floats, keel_rad: float, *, folded: bool) -> Patch:
    """A ribbon pointed at both ends, of widths at uneven steps."""
    body = strip(1.0, width[1:], keel_rad=keel_rad, folded=folded)
    rows = np.repeat(y[1:-1], 3 if folded else 2)
    points = body.points.copy()
    points[:, 1] = np.append(rows, y[-1])
    points = np.concatenate([points, [[0.0, y[0], 0.0]]])
    foot, columns = len(points) - 1, 3 if folded else 2
    ends = [(foot, k, k + 1) for k in range(columns - 1)]
    uv = np.concatenate([body.uv, [[0.5, 0.0]]])
    uv[:, 1] = points[:, 1] / y[-1]
    return Patch(points, np.concatenate([body.faces, np.array(ends, np.int64)]), uv)


def fern_frond(length_m: float, width_m: float, pinnae: int, *, divisions: int, arch_deg: float, detail: int) -> Patch:
    """The blade of a fern: pairs of pinnae along the rachis, longest at its foot.

    The longest pinna has so many divisions, pinnules, on each side; each is drawn from detail 1 on.
    """
    target = area_m2(_fern_blade(length_m, width_m, pinnae, divisions, 2, 1.0))

    def made(broad: float) -> Patch:
        sheet = _fern_blade(length_m, width_m, pinnae, divisions, detail, broad)
        return bent(sheet, length_m, np.radians(arch_deg), 1.4)

    return made(1.0) if detail == 2 else _of_area(made, target)


def _fern_blade(length_m: float, width_m: float, pinnae: int, divisions: int, detail: int, broad: float) -> Patch:
    share = (np.arange(pinnae) + 0.35) / pinnae
    place = length_m * (1.0 - (1.0 - share) ** 1.25)
    reach = 0.5 * width_m * (1.0 - share) ** 1.05 + 0.004 * length_m
    parts = []
    for k in range(pinnae):
        gap = (place[min(k + 1, pinnae - 1)] - place[max(k - 1, 0)]) / (2.0 if 0 < k < pinnae - 1 else 1.0)
        breadth = 1.12 * max(gap, 0.02 * length_m * (1 - share[k]) + 1e-4)
        pinna = _pinna(reach[k], breadth, max(2, round(divisions * reach[k] / reach[0])), detail, broad)
        angle = np.array([np.radians(68.0 - 22.0 * share[k])] * 2)
        side = np.array([1.0, -1.0])
        shift = 0.12 * gap * side
        feet = on_axis(np.maximum(place[k] + shift, 0.0))
        parts.append(copies(pinna, _sideways(angle, 0.10 + 0.05 * np.sin(3.0 * k), side), feet))
    return join(parts)


def _pinna(length_m: float, breadth_m: float, pinnules: int, detail: int, broad: float) -> Patch:
    """One pinna along y with its pinnules; at detail 0 a plain blade."""
    if detail == 0:
        return bent(strip(length_m, broad * breadth_m * np.array([0.75, 0.7, 0.0]), folded=False), length_m, 0.3, 1.5)
    share = (np.arange(pinnules) + 0.4) / pinnules
    size = 0.72 * breadth_m * (1.0 - share**1.6 * 0.85)
    step = length_m / pinnules
    if detail == 1:
        one = strip(1.0, np.array([0.5, 0.0]), folded=False)
        one = Patch(one.points * [broad, 1.0, 1.0], one.faces, one.uv)
    else:
        one = _pinnule()
    parts = []
    for side in (1.0, -1.0):
        turn = _sideways(np.radians(66.0 - 20.0 * share), 0.05, np.full(pinnules, side))
        linear = turn * size[:, None, None]
        linear[:, :, 0] *= np.clip(1.9 * step / np.maximum(size, 1e-9), 0.3, 1.3)[:, None]
        parts.append(copies(one, linear, on_axis(share * length_m)))
    tip = strip(1.6 * step, np.array([0.5 * step * broad, 0.0]), folded=False)
    parts.append(placed(tip, np.eye(3), np.array([0.0, length_m - 1.2 * step, 0.0])))
    axis = strip(length_m, np.array([0.05 * breadth_m, 0.0]), folded=False)
    parts.append(placed(axis, np.eye(3), np.array([0.0, 0.0, 0.0003])))
    return bent(join(parts), length_m, 0.35, 1.5)


@lru_cache(maxsize=1)
def _pinnule() -> Patch:
    """A lobed pinnule of length 1."""
    form = Lobed(lobes=3, sinus=0.5, roundness=2.2, slant=0.2, widest=0.25, base=0.4, tip=0.9)
    return blade(Blade(form, 1.0, 0.40, fold_deg=6.0, curl_deg=18.0, detail=1))


def grass_blade(
    length_m: float, width_m: float, *, arch_deg: float, keel_deg: float, twist_deg: float, detail: int
) -> Patch:
    """A long blade that tapers, keeled at its foot, arching over more and more towards its tip."""
    stops = (3, 6, 12)[detail]
    share = np.linspace(0.0, 1.0, stops)
    width = _grass_width(share)
    turn = np.radians(twist_deg)

    def made(broad: float) -> Patch:
        ribbon = strip(length_m, broad * width_m * width, keel_rad=np.radians(keel_deg), folded=detail == 2)
        x, y, z = ribbon.points.T
        c, s = np.cos(turn * (y / length_m) ** 2), np.sin(turn * (y / length_m) ** 2)
        twisted = ribbon._replace(points=np.column_stack([x * c + z * s, y, z * c - x * s]))
        return bent(twisted, length_m, np.radians(arch_deg), 2.2)

    fine = np.linspace(0.0, 1.0, 401)
    return _of_area(made, length_m * width_m * float(np.trapezoid(_grass_width(fine), fine)))


def _grass_width(share: Floats) -> Floats:
    """Width of a grass leaf along its length, share of the greatest: even, then a long taper to a point."""
    even = 0.72 + 0.28 * np.sin(np.pi * np.minimum(share / 0.7, 1.0))
    return np.asarray(even * np.clip((1.0 - share) / 0.6, 0.0, 1.0) ** 0.75, dtype=np.float64)


def grass_panicle(
    length_m: float, width_m: float, branches: int, spikelets: int, spikelet_m: float, *, nod_deg: float, detail: int
) -> tuple[Patch, Patch]:
    """Axis with its branches, and so many spikelets on each branch: two patches. A width of 0 makes a spike."""
    share = (np.arange(branches) + 0.5) / branches
    turn = np.arange(branches) * np.pi * (3.0 - np.sqrt(5.0))
    reach = np.maximum(0.5 * width_m * np.sin(np.pi * (0.2 + 0.8 * share)) ** 0.8, 0.4 * spikelet_m)
    angle = np.radians(62.0 - 35.0 * share)
    outward = outwards(turn)
    along = np.sin(angle)[:, None] * outward + np.cos(angle)[:, None] * _ALONG
    feet = on_axis(share * length_m)
    wire = strip(1.0, np.array([0.012 * length_m, 0.0]), folded=False)
    linear = attitude(along, outward * np.cos(angle)[:, None] - np.sin(angle)[:, None] * _ALONG)
    stems = [copies(wire, linear * np.stack([np.ones(branches), reach, np.ones(branches)], 1)[:, None, :], feet)]
    stops = (3, 4, 8)[detail]
    path = on_axis(np.linspace(0.0, length_m, stops))
    stems.append(tube(path, 0.006 * length_m * np.append(np.linspace(1.0, 0.4, stops - 1), 0.0), 3))
    grain = _spikelet(spikelet_m, detail)
    place = (np.arange(spikelets) + 1.0) / spikelets
    feet = (feet[:, None] + (reach[:, None] * place)[:, :, None] * along[:, None]).reshape(-1, 3)
    lean = np.repeat(along, spikelets, axis=0)
    roll = np.arange(len(lean)) * 2.4
    side = outwards(roll)
    grains = copies(grain, attitude(lean + 0.35 * side, side), feet)
    nod = np.radians(nod_deg)
    return bent(join(stems), length_m, nod, 1.3), bent(grains, length_m, nod, 1.3)


def _spikelet(length_m: float, detail: int) -> Patch:
    if detail == 0:
        return strip(length_m, length_m * np.array([0.5, 0.0]), folded=False)
    if detail == 1:
        return blade(Blade(Entire(0.4, 1.0, 1.2), length_m, 0.3 * length_m, fold_deg=30.0, detail=0))
    profile = np.array([[0.0, 0.0], [0.13, 0.3], [0.11, 0.6], [0.0, 1.0]]) * length_m
    return revolve(profile, 4)


def frond_axis(stipe_m: float, length_m: float, diameter_m: float, arch_deg: float, detail: int) -> Patch:
    """Stipe and rachis of a fern: straight below the blade, bent with it above."""
    stops = (3, 6, 12)[detail]
    upper = on_axis(np.linspace(0.0, length_m, stops))
    upper = bend(upper, length_m, np.radians(arch_deg), 1.4) + np.array([0.0, stipe_m, 0.0])
    radius = 0.5 * diameter_m * (1.0 - np.linspace(0.0, 1.0, stops)) ** 0.8
    if stipe_m > 0.0:
        upper, radius = np.concatenate([[[0.0, 0.0, 0.0]], upper]), np.append(0.5 * diameter_m, radius)
    return tube(upper, radius, (3, 3, 5)[detail])


def needle(length_m: float, width_m: float, curve_rad: float, triangles: int) -> Patch:
    """One needle along y: 1 triangle, 2 (a diamond, broadest at a third) or 4 (two pieces and a point), bent down."""
    half = 0.5 * width_m * _COVER
    match triangles:
        case 1:
            flat = np.array([[2.0 * half, 0.0], [0.0, 1.0], [-2.0 * half, 0.0]])
            faces = [(0, 1, 2)]
        case 2:
            flat = np.array([[0.0, 0.0], [2.0 * half, 0.3], [0.0, 1.0], [-2.0 * half, 0.3]])
            faces = [(0, 1, 3), (1, 2, 3)]  # the short diagonal: the needle may curve
        case _:
            side = half / 0.8
            flat = np.array([[side, 0.0], [-side, 0.0], [side, 0.35], [-side, 0.35], [side * 0.9, 0.7]])
            flat = np.concatenate([flat, [[-side * 0.9, 0.7], [0.0, 1.0]]])
            flat[:, 0] *= 0.8 / (0.35 + 0.3325 + 0.135)  # the pieces' widths together
            faces = [(0, 2, 1), (1, 2, 3), (2, 4, 3), (3, 4, 5), (4, 6, 5)]
    points = np.column_stack([flat[:, 0], flat[:, 1] * length_m, np.zeros(len(flat))])
    uv = np.column_stack([0.5 + 0.5 * flat[:, 0] / np.abs(flat[:, 0]).max(), flat[:, 1]])
    return Patch(bend(points, length_m, curve_rad), np.array(faces, np.int64), uv)


def fascicle(
    needles: int, length_m: float, width_m: float, spread_deg: float, curve_deg: float, *, detail: int
) -> Patch:
    """A bundle of needles from one foot, as a pine's: each leans out by about half of `spread_deg`."""
    one = needle(length_m, width_m, np.radians(curve_deg), (1, 2, 5)[detail])
    k = np.arange(needles)
    turn = 2.0 * np.pi * (k + 0.25) / needles
    lean = 0.5 * np.radians(spread_deg) * (0.8 + 0.4 * _even(k, 0.7549))
    outward = outwards(turn)
    along = np.cos(lean)[:, None] * [0.0, 1.0, 0.0] + np.sin(lean)[:, None] * outward
    size = 0.94 + 0.12 * _even(k, 0.5698)
    size /= np.sqrt(np.mean(size**2))  # the area stays
    return copies(one, attitude(along, -outward) * size[:, None, None], 0.3 * width_m * outward)


def needle_twig(
    length_m: float,
    needles: int,
    drawn: int,
    needle_length_m: float,
    needle_width_m: float,
    *,
    angle_deg: float,
    parting: float,
    curve_deg: float,
    detail: int,
) -> Patch:
    """Needles around a twig, all around (parting 0) or in its plane (1); the twig itself is `twig`.

    Of the needles that it bears, `drawn` are drawn. `angle_deg` is between twig and needle at the twig's base, and a
    third less at its tip.
    """
    stands_for = max(needles / drawn, 1.0)
    longer = min(stands_for**_LENGTH_POWER, _LONGEST)
    width_m = needle_width_m * stands_for / longer
    one = needle(needle_length_m * longer, width_m, np.radians(curve_deg), (1, 2, 5)[detail])
    k = np.arange(drawn)
    share = (k + 0.5) / drawn
    turn = k * _GOLDEN_RAD
    side, rise = np.cos(turn), np.sin(turn)
    # Parted needles of the upper and lower side sweep to the right and left.
    side = side + parting * (np.sign(side) * np.sqrt(1.0 - rise**2 * 0.2) - side)
    rise = rise * (1.0 - parting) + 0.15 * parting
    outward = np.column_stack([side, np.zeros(drawn), rise])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    angle = np.radians(angle_deg) * (1.0 - 0.33 * share**2) * (0.85 + 0.3 * _even(k, 0.7549))
    last = share > 1.0 - 0.5 * needle_length_m / length_m
    angle = np.where(last, angle * 0.6, angle)
    along = np.sin(angle)[:, None] * outward + np.cos(angle)[:, None] * [0.0, 1.0, 0.0]
    # The flat side looks up, more or less: needles turn about themselves.
    upper = outward * np.cos(angle)[:, None] * -1.0 + np.sin(angle)[:, None] * [0.0, 1.0, 0.0]
    roll = 2.0 * np.pi * _even(k, 0.5698)
    upper = np.cos(roll)[:, None] * upper + np.sin(roll)[:, None] * np.cross(along, upper)
    upper = np.where(upper[:, 2:] < 0.0, -upper, upper)
    size = (0.9 + 0.2 * _even(k, 0.618)) * np.where(share < 0.06, 0.75, 1.0)
    size /= np.sqrt(np.mean(size**2))  # the area stays
    return copies(one, attitude(along, upper) * size[:, None, None], on_axis(share * length_m))


def twig(length_m: float, diameter_m: float, detail: int) -> Patch:
    """The twig that bears needles: three sides, tapering to a point; a single slim triangle pair at detail 0."""
    stops = 2 if detail == 0 else 3
    path = on_axis(np.linspace(0.0, length_m, stops))
    radius = 0.5 * diameter_m * np.linspace(1.0, 0.4, stops)
    radius[-1] = 0.0
    return join([tube(path, radius, 3)])


def _even(k: NDArray[np.int64], step: float) -> Floats:
    """Numbers in 0..1 that fill it evenly: additive recurrence."""
    return np.asarray((0.5 + k * step) % 1.0, dtype=np.float64)
