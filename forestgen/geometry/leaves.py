"""Leaves: blades from outlines, folded, curled and wavy, on their petioles; compound leaves of such blades.

A blade's area is its flat outline's at the finest detail. Folding or curling alone does not stretch the sheet;
both at once, pleats and waves would stretch it a little, and coarse levels of detail cut corners: the blade is scaled
until its area is right.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.outlines import Margin, Outline, Palmate
from forestgen.geometry.patches import Patch, area_m2, attitude, bend, copies, join, placed, stalk

Floats = NDArray[np.float64]

_STEP = {0: 1.0, 1: 0.4, 2: 0.14}  # longest stretch of the midrib without a vertex, share of the length
_SOUND = 0.02  # a triangle that sees its margin at a flatter sine than this would be a sliver


@dataclass(frozen=True)
class Blade:
    """A leaf blade's outline, size and attitude."""

    outline: Outline
    length_m: float
    width_m: float
    fold_deg: float = 0.0  # rise of each half about the midrib; of a palmate leaf: about each lobe's vein
    curl_deg: float = 0.0  # bend of the tip below the foot's direction
    waves: float = 0.0  # number of the margin's waves
    wave_height: float = 0.0  # of the margin's waves, share of half the width
    detail: int = 1


def blade(shape: Blade) -> Patch:
    """The sheet, its foot in the origin; its area is that of the flat outline, whatever the attitude and detail."""
    sheet = _sheet(shape)
    flat = replace(shape, fold_deg=0.0, curl_deg=0.0, waves=0.0, wave_height=0.0, detail=2)
    if shape == flat:
        return sheet
    wanted = area_m2(_sheet(flat))
    for _ in range(2):  # the bend makes the area not quite quadratic in the size
        factor = np.sqrt(wanted / area_m2(sheet))
        shape = replace(shape, length_m=shape.length_m * factor, width_m=shape.width_m * factor)
        sheet = _sheet(shape)
    return sheet


def leaf(shape: Blade, stalk_m: float, stalk_width_m: float) -> Patch:
    """A simple leaf: the blade on its petiole, whose foot is in the origin."""
    sheet = blade(shape)
    if stalk_m == 0.0:
        return sheet
    sheet = placed(sheet, np.eye(3), np.array([0.0, stalk_m, 0.0]))
    return join([sheet, stalk(stalk_m, stalk_width_m, shape.detail)])


def compound_leaf(
    leaflet: Blade,
    leaflets: int,
    *,
    palmate: bool,
    rachis_m: float,
    stalk_m: float,
    stalk_width_m: float,
    angle_deg: float,
    taper: float,
    curl_deg: float,
) -> Patch:
    """Leaflets on a rachis in pairs with one at its end, or all about the petiole's end.

    Parameters
    ----------
    leaflets : odd numbers end in a leaflet.
    rachis_m : from the lowest pair to the end; palmate leaves have none.
    angle_deg : between the rachis and the lateral leaflets; palmate: of the outermost from the middle one.
    taper : size of the outermost leaflets as a share of the largest.
    curl_deg : bend of the rachis and all on it.
    """
    sheet = blade(leaflet)
    if palmate:
        turn = np.radians(angle_deg) * np.linspace(-1.0, 1.0, leaflets)
        foot = np.zeros(leaflets)
        size = 1.0 - (1.0 - taper) * np.abs(np.linspace(-1.0, 1.0, leaflets))
        rachis_m = 0.0
    else:
        pairs = leaflets // 2
        place = np.linspace(0.0, 1.0 if leaflets % 2 == 0 else 1.0 - 0.7 / max(pairs, 1), pairs)
        size = 1.0 - (1.0 - taper) * np.abs(2.0 * place - 0.8) / 1.2
        foot, turn, size = np.repeat(place, 2), np.tile(np.radians([angle_deg, -angle_deg]), pairs), np.repeat(size, 2)
        if leaflets % 2:
            foot, turn, size = np.append(foot, 1.0), np.append(turn, 0.0), np.append(size, 1.0)
    along = np.column_stack([np.sin(turn), np.cos(turn), np.zeros(leaflets)])
    linear = attitude(along, np.tile([0.0, 0.0, 1.0], (leaflets, 1))) * size[:, None, None]
    feet = np.column_stack([np.zeros(leaflets), stalk_m + rachis_m * foot, np.zeros(leaflets)])
    whole = [copies(sheet, linear, feet)]
    if stalk_m + rachis_m > 0.0:
        whole.append(stalk(stalk_m + rachis_m, stalk_width_m, leaflet.detail))
    patch = join(whole)
    span = max(stalk_m + rachis_m + leaflet.length_m, 1e-9)
    return patch._replace(points=bend(patch.points, span, np.radians(curl_deg), 1.5))


def _sheet(shape: Blade) -> Patch:
    if isinstance(shape.outline, Palmate):
        return _palmate_sheet(shape, shape.outline)
    margin = shape.outline.margin(shape.detail, shape.waves)
    size = np.array([0.5 * shape.width_m, shape.length_m])
    right = margin.points * size
    midrib, fans = _fans(margin, right, shape.length_m, shape.detail)
    return _folded(shape, right, midrib, fans)


def _fans(
    margin: Margin, right: Floats, length_m: float, detail: int
) -> tuple[Floats, list[tuple[tuple[str, int], tuple[str, int], tuple[str, int]]]]:
    """Heights of the midrib's vertices, and the right half's triangles over ("r", midrib) and ("m", margin) vertices.

    A fan about one midrib vertex goes on while the margin turns about it; then the midrib goes on to the height at
    which the side vein of the present margin point starts, which is sound for any graph over the midrib.
    """
    midrib, faces = [0.0], []
    origin = margin.origin * length_m
    last = len(right) - 1
    for k in range(last):
        own = origin[k]
        if own > midrib[-1] and (
            not _turns(midrib[-1], right[k], right[k + 1]) or origin[k + 1] - midrib[-1] > _STEP[detail] * length_m
        ):
            midrib.append(own)
            here = len(midrib) - 1
            faces.append((("r", here - 1), ("m", k), ("r", here)))
        faces.append((("r", len(midrib) - 1), ("m", k), ("m", k + 1)))
    return np.array(midrib), faces


def _turns(origin_y: float, a: Floats, b: Floats) -> bool:
    """Whether b lies to the left of the ray from the midrib to a, by a safe margin."""
    one, two = a - [0.0, origin_y], b - [0.0, origin_y]
    cross = one[0] * two[1] - one[1] * two[0]
    return bool(cross > _SOUND * np.hypot(*one) * np.hypot(*two))


def _folded(
    shape: Blade,
    right: Floats,
    midrib: Floats,
    fans: list[tuple[tuple[str, int], tuple[str, int], tuple[str, int]]],
) -> Patch:
    """Both halves, folded, waved and curled."""
    inner, outer = right[:-1], right[-1:]
    ribs, count = len(midrib), len(inner)
    flat = np.concatenate(
        [np.column_stack([np.zeros(ribs), midrib]), inner, inner * [-1.0, 1.0], outer]
    )  # midrib, right margin, left margin, tip
    tip = ribs + 2 * count

    def at(vertex: tuple[str, int], side: int) -> int:
        kind, k = vertex
        if kind == "r":
            return k
        return tip if k == count else ribs + side * count + k

    faces = [tuple(at(vertex, 0) for vertex in fan) for fan in fans]
    faces += [tuple(at(vertex, 1) for vertex in fan[::-1]) for fan in fans]
    index = np.array(faces, np.int64)
    fold = np.radians(shape.fold_deg)
    away = np.abs(flat[:, 0])
    share = np.clip(flat[:, 1] / shape.length_m, 0.0, 1.0)
    phase = 2.0 * np.pi * shape.waves * share + np.where(flat[:, 0] > 0.0, 0.0, 0.5 * np.pi)
    wave = shape.wave_height * away * np.sin(phase)
    z = away * np.sin(fold) + wave * np.cos(fold)
    points = np.column_stack([flat[:, 0] * np.cos(fold), flat[:, 1], z])
    return Patch(bend(points, shape.length_m, np.radians(shape.curl_deg)), index, _uv(flat, shape))


def _uv(flat: Floats, shape: Blade) -> Floats:
    low, high = flat[:, 1].min(), flat[:, 1].max()
    half = max(float(np.abs(flat[:, 0]).max()), 1e-12)
    return np.column_stack([0.5 + 0.5 * flat[:, 0] / half, (flat[:, 1] - low) / (high - low)])


def _palmate_sheet(shape: Blade, outline: Palmate) -> Patch:
    """A fan about the petiole's end, with a ring of vertices halfway at detail 2, raised between the lobes' veins."""
    angle, radius = outline.polar(shape.detail)
    angle, radius = np.concatenate([angle, -angle[-2::-1]]), np.concatenate([radius, radius[-2::-1]])
    rim = np.column_stack([np.sin(angle) * radius, np.cos(angle) * radius])
    rim *= [0.5 * shape.width_m / np.abs(rim[:, 0]).max(), shape.length_m]
    step = np.radians(outline.spread_deg) / max((outline.lobes - 1) // 2, 1)
    off = np.abs(angle / step - np.round(angle / step)) * step
    count = len(rim)
    k = np.arange(count - 1)
    rise = np.sin(np.radians(shape.fold_deg)) * np.sin(off) * np.linalg.norm(rim, axis=1)
    if shape.detail == 2:
        flat = np.concatenate([[[0.0, 0.0]], 0.45 * rim, rim])
        z = np.concatenate([[0.0], 0.45 * rise, rise])
        ring, far = 1 + k, 1 + count + k
        faces = np.concatenate(
            [
                np.column_stack([0 * k, ring, ring + 1]),
                np.column_stack([ring, far, far + 1]),
                np.column_stack([ring, far + 1, ring + 1]),
            ]
        )
    else:
        flat, z = np.concatenate([[[0.0, 0.0]], rim]), np.append(0.0, rise)
        faces = np.column_stack([0 * k, 1 + k, 2 + k])
    points = bend(np.column_stack([flat, z]), shape.length_m, np.radians(shape.curl_deg))
    return Patch(points, faces.astype(np.int64), _uv(flat, shape))
