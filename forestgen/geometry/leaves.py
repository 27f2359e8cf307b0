"""Leaves: blades from outlines, folded, curled and wavy, on their petioles; compound leaves of such blades.

A blade's area is its flat outline's at the finest detail. Folding or curling alone does not stretch the sheet;
both at once, pleats and waves would stretch it a little, and coarse levels of detail cut corners: the blade is scaled
until its area is right.

Outlines
--------
An outline is the right half of a blade's margin, as points from the foot to the tip.

Entire leaves. With t from 0 at the foot to 1 at the tip, and the widest place at t = a, the half-width is

    w(t) = (1 - u^2)^b with u = (a - t) / a below,   w(t) = (1 - u^2)^c with u = (t - a) / (1 - a) above

of half the greatest width. b and c are the sharpness of base and tip: 0.5 a round end (half an ellipse), 1 a pointed
one (a parabola), more than 1 drawn out, less than 0.5 blunt. The area is W L (a I(b) + (1 - a) I(c)) with
I(q) = sqrt(pi) Gamma(q + 1) / (2 Gamma(q + 3/2)).

Lobes and teeth multiply w(t). Everything is a graph over t, so that the outline cannot cross itself; side veins and
the lobes of a heart-shaped base then shear it, which keeps it simple.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.patches import Patch, area_m2, attitude, bend, copies, join, on_axis, placed, stalk

Floats = NDArray[np.float64]
_Vertex = tuple[str, int]  # "r" and a number on the midrib, or "m" and one on the margin

_USUAL_ASPECT = 0.35  # half-width over length of a leaf, where only the spread of teeth depends on it
_SINUS = 0.07  # half the gap between lobes, share of their step
_TOOTH = (np.array([0.0, 0.8]), np.array([-1.0, 1.0]))  # places within a tooth, and heights
_DOUBLE_TOOTH = (np.array([0.0, 0.4, 0.52, 0.86]), np.array([-1.0, 0.15, -0.4, 1.0]))
_STEP = {0: 1.0, 1: 0.4, 2: 0.14}  # longest stretch of the midrib without a vertex, share of the length
_SOUND = 0.02  # a triangle that sees its margin at a flatter sine than this would be a sliver


class Margin(NamedTuple):
    """Right half of an outline, in shares: x of half the greatest width, y of the length."""

    points: Floats  # (K, 2) from the first point after the foot (0, 0) to the tip (0, 1), both at x = 0
    origin: Floats  # (K,) y of the place on the midrib that a point's side vein starts from, never descending


@dataclass(frozen=True)
class Entire:
    """Outline without lobes; see this module's page."""

    widest: float = 0.4  # share of the length from the foot
    base: float = 0.5  # sharpness
    tip: float = 1.0  # sharpness
    heart: float = 0.0  # depth of a heart-shaped base's lobes behind the foot, share of the length; needs base <= 1
    teeth: int = 0  # on each side
    tooth_depth: float = 0.08  # share of the local half-width
    double: bool = False  # teeth upon the teeth

    def margin(self, detail: int, waves: float = 0.0) -> Margin:
        """Points of the margin at a level of detail, enough for its waves; teeth show at 2 alone."""
        if detail == 2 and self.teeth:
            t, factor = self._toothed()
        else:
            few = (1 if self.base > 0.7 else 2, 2)
            many = (max(9, round(1.8 * waves)), max(11, round(2.2 * waves)))
            t = _stations(self.widest, {0: few, 1: (3, 4), 2: many}[detail])
            factor = np.ones(len(t))
        width = half_width(t, self.widest, self.base, self.tip)
        y = t - self.heart * 4.0 * width * (1.0 - width) * (t < self.widest)
        # Behind the foot, teeth stand out from it: the blade stays star-shaped about it.
        points = np.column_stack([width * factor, np.where(y < 0.0, y * factor, y)])
        return Margin(np.concatenate([points, [[0.0, 1.0]]]), np.append(np.maximum(np.minimum(t, y), 0.0), 1.0))

    def _toothed(self) -> tuple[Floats, Floats]:
        """Places and factors on the half-width: each tooth rises slowly, falls steeply, and points to the tip.

        Teeth stand at even steps along the margin; they are small next to foot and tip.
        """
        fine = np.linspace(0.0, 1.0, 513)
        outline = half_width(fine, self.widest, self.base, self.tip) * _USUAL_ASPECT
        way = np.append(0.0, np.cumsum(np.hypot(np.diff(outline), np.diff(fine))))
        foot = np.interp(np.linspace(0.03, 1.0, self.teeth + 1) * way[-1], way, fine)
        within, height = _DOUBLE_TOOTH if self.double else _TOOTH
        t = (foot[:-1, None] + np.diff(foot)[:, None] * within).reshape(-1)
        depth = self.tooth_depth * np.clip(np.minimum(t / 0.12, 0.3 + (1.0 - t) / 0.2), 0.0, 1.0)
        return t, 1.0 + depth * np.tile(height, self.teeth)


@dataclass(frozen=True)
class Lobed:
    """Pinnate lobes, as an oak's: rounded, with narrow sinuses between them."""

    lobes: int = 4  # on each side, beside the lobe at the tip
    sinus: float = 0.45  # depth of the sinuses, share of the local half-width
    roundness: float = 2.2  # 1: pointed lobes, 2: round, more: square
    slant: float = 0.06  # rise of the widest lobe's tip above its foot, share of the blade's length; below 0.5
    widest: float = 0.6
    base: float = 0.9
    tip: float = 0.75

    def margin(self, detail: int, waves: float = 0.0) -> Margin:
        """Points of the margin, which are enough for waves as they are; at detail 0 the lobes' envelope."""
        if detail == 0:
            t = _stations(self.widest, (2, 2))
            width = half_width(t, self.widest, self.base, self.tip) * (1.0 - 0.35 * self.sinus)
        else:
            t, width = self._lobes(detail)
        lift = self.slant * width * np.minimum(1.0, 2.0 * (1.0 - t))
        points = np.column_stack([width, t + lift])
        return Margin(np.concatenate([points, [[0.0, 1.0]]]), np.append(t, 1.0))

    def _lobes(self, detail: int) -> tuple[Floats, Floats]:
        """t and half-width: the lobes' steps grow towards the widest place and shrink towards the tip."""
        place = np.linspace(0.0, 1.0, self.lobes + 2) ** 0.9
        inner = np.array([0.2, 0.75]) if detail == 1 else np.array([0.07, 0.14, 0.30, 0.52, 0.74, 0.89])
        end = np.array([0.3, 0.7]) if detail == 1 else np.array([0.07, 0.14, 0.30, 0.50, 0.7, 0.87, 0.97])
        t, depth = [], []
        for k in range(self.lobes + 1):
            last = k == self.lobes
            within = end if last else inner
            t.append(place[k] + (place[k + 1] - place[k]) * within)
            # Lobes stand apart by a seventh of their step; the one at the tip is rounded off by the envelope alone.
            across = np.abs(np.clip((within - _SINUS) / (0.5 - _SINUS), 0.0, 1.0 if last else 2.0) - 1.0)
            depth.append(1.0 - (1.0 - np.minimum(across, 1.0) ** self.roundness) ** 0.5)
            if not last:
                t.append(place[k + 1 : k + 2])
                depth.append(np.ones(1))
        at = np.concatenate(t)
        shallow = np.clip(at / 0.3, 0.4, 1.0)  # the lowest sinuses are the shallowest
        width = half_width(at, self.widest, self.base, self.tip) * (1.0 - self.sinus * shallow * np.concatenate(depth))
        return at, width


@dataclass(frozen=True)
class Palmate:
    """Lobes that radiate from the petiole's end, as a maple's; star-shaped about it."""

    lobes: int = 5  # odd
    sinus: float = 0.5  # depth of the sinuses, share of the lobes' length
    spread_deg: float = 125.0  # angle of the outermost lobes from the middle one
    outer: float = 0.45  # length of the outermost lobes as a share of the middle one
    teeth: int = 2  # coarse teeth on each side of a lobe
    tooth_depth: float = 0.12

    def polar(self, detail: int) -> tuple[Floats, Floats]:
        """Angle from the middle lobe, falling, and radius as a share of the length, of the right half's margin."""
        side = (self.lobes - 1) // 2
        spread = np.radians(self.spread_deg)
        vein = spread * np.arange(side, -1, -1) / max(side, 1)
        reach = 1.0 - (1.0 - self.outer) * (vein / max(spread, 1e-9)) ** 1.5
        step = spread / max(side, 1)
        angle, radius = [vein[0] + 0.62 * step], [0.36 * reach[0]]
        for k in range(side + 1):
            rising, falling = self._flank(detail)
            if k < side:
                notch = (1.0 - self.sinus) * 0.5 * (reach[k] + reach[k + 1])
            low = radius[-1] if k == 0 else (1.0 - self.sinus) * 0.5 * (reach[k] + reach[k - 1])
            width = 0.5 * step if k else 0.62 * step
            angle += [vein[k] + width * (1.0 - w) for w, _ in rising]
            radius += [low + (reach[k] - low) * r for _, r in rising]
            angle.append(vein[k])
            radius.append(reach[k])
            if k < side:
                angle += [vein[k] - 0.5 * step * (1.0 - w) for w, _ in falling]
                radius += [notch + (reach[k] - notch) * r for _, r in falling]
                angle.append(vein[k] - 0.5 * step)
                radius.append(notch)
        return np.array(angle), np.array(radius)

    def _flank(self, detail: int) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
        """Points between a sinus and a lobe's tip, (share of the way in angle, in radius), and the way back."""
        if detail == 0:
            return [], []
        if detail == 1 or self.teeth == 0:
            flank = [(0.42, 0.38)]
        else:
            flank = []
            for k in range(self.teeth):
                at = 0.22 + 0.55 * k / self.teeth
                radius = 0.36 + 0.5 * k / self.teeth
                flank += [(at, radius + self.tooth_depth), (at + 0.3 / self.teeth, radius + 0.4 * self.tooth_depth)]
        return flank, flank[::-1]


Outline = Entire | Lobed | Palmate


def half_width(t: Floats, widest: float, base: float, tip: float) -> Floats:
    """Half-width of an entire leaf at the shares t of its length, of half the greatest width."""
    below = np.clip((widest - t) / widest, 0.0, 1.0)
    above = np.clip((t - widest) / (1.0 - widest), 0.0, 1.0)
    return np.asarray(np.where(t < widest, (1.0 - below**2) ** base, (1.0 - above**2) ** tip), dtype=np.float64)


def _stations(widest: float, counts: tuple[int, int]) -> Floats:
    """Places of margin points between foot and tip, closer where a round end turns; the widest place among them."""
    below, above = counts
    low = widest * (1.0 - np.cos(0.5 * np.pi * np.arange(1, below + 1) / below))
    high = widest + (1.0 - widest) * np.sin(0.5 * np.pi * np.arange(1, above) / above)
    return np.concatenate([low, high])


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
    whole = [copies(sheet, linear, on_axis(stalk_m + rachis_m * foot))]
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


def _fans(margin: Margin, right: Floats, length_m: float, detail: int) -> tuple[Floats, list[tuple[_Vertex, ...]]]:
    """Heights of the midrib's vertices, and the right half's triangles.

    A fan about one midrib vertex goes on while the margin turns about it; then the midrib goes on to the height at
    which the side vein of the present margin point starts, which works for any graph over the midrib.
    """
    midrib: list[float] = [0.0]
    faces: list[tuple[_Vertex, ...]] = []
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


def _folded(shape: Blade, right: Floats, midrib: Floats, fans: list[tuple[_Vertex, ...]]) -> Patch:
    """Both halves, folded, waved and curled."""
    inner, outer = right[:-1], right[-1:]
    ribs, count = len(midrib), len(inner)
    # Midrib, right margin, left margin, tip.
    flat = np.concatenate([np.column_stack([np.zeros(ribs), midrib]), inner, inner * [-1.0, 1.0], outer])
    tip = ribs + 2 * count

    def at(vertex: _Vertex, side: int) -> int:
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
        corners = ((0 * k, ring, ring + 1), (ring, far, far + 1), (ring, far + 1, ring + 1))
        faces = np.concatenate([np.column_stack(one) for one in corners])
    else:
        flat, z = np.concatenate([[[0.0, 0.0]], rim]), np.append(0.0, rise)
        faces = np.column_stack([0 * k, 1 + k, 2 + k])
    points = bend(np.column_stack([flat, z]), shape.length_m, np.radians(shape.curl_deg))
    return Patch(points, faces.astype(np.int64), _uv(flat, shape))
