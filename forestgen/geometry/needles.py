"""Needles: bundles of a few, and twigs set with many.

A needle covers 0.8 of its length times its width, whatever the number of its triangles. A twig's shape may draw fewer
needles than it bears: each one drawn then stands for several, longer by the power 0.4 of their number and wider by the
power 0.6, so that the area stays.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.patches import Patch, attitude, bend, copies, join, tube

Floats = NDArray[np.float64]

COVER = 0.8  # area of a needle over its length times its width
_GOLDEN_RAD = np.pi * (3.0 - np.sqrt(5.0))
_LENGTH_POWER = 0.4
_LONGEST = 3.2  # a needle that stands for many is at most so many times as long


def needle(length_m: float, width_m: float, curve_rad: float, triangles: int) -> Patch:
    """One needle along y: 1 triangle, 2 (a diamond, broadest at a third) or 4 (two pieces and a point), bent down."""
    half = 0.5 * width_m * COVER
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
    outward = np.column_stack([np.cos(turn), np.zeros(needles), np.sin(turn)])
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
    """Needles all around a twig, or parted to its sides; the twig itself is `twig`.

    Parameters
    ----------
    needles, drawn : how many it bears, and how many are drawn for them.
    angle_deg : between twig and needle at its base; a third less at its tip.
    parting : 0 all around, 1 all in the plane of the twig.
    """
    stands_for = max(needles / drawn, 1.0)
    longer = min(stands_for**_LENGTH_POWER, _LONGEST)
    one = needle(
        needle_length_m * longer, needle_width_m * stands_for / longer, np.radians(curve_deg), (1, 2, 5)[detail]
    )
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
    feet = np.column_stack([np.zeros(drawn), share * length_m, np.zeros(drawn)])
    return copies(one, attitude(along, upper) * size[:, None, None], feet)


def twig(length_m: float, diameter_m: float, detail: int) -> Patch:
    """The twig that bears needles: three sides, tapering to a point; a single slim triangle pair at detail 0."""
    stops = 2 if detail == 0 else 3
    path = np.column_stack([np.zeros(stops), np.linspace(0.0, length_m, stops), np.zeros(stops)])
    radius = 0.5 * diameter_m * np.linspace(1.0, 0.4, stops)
    radius[-1] = 0.0
    return join([tube(path, radius, 3)])


def _even(k: NDArray[np.int64], step: float) -> Floats:
    """Numbers in 0..1 that fill it evenly: additive recurrence."""
    return np.asarray((0.5 + k * step) % 1.0, dtype=np.float64)
