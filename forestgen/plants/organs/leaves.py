"""Leaves: blades from outlines, folded, curled and wavy, on their petioles; compound leaves of such blades.

A blade's area is its flat outline's at the finest detail. Folding and curling at once, pleats and waves stretch a sheet
a little, and coarse levels of detail cut corners: the blade is scaled until its area is right.

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

from typing import Annotated, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from forestgen.geometry import patches
from forestgen.geometry.mesh import Floats, Ints
from forestgen.geometry.patches import Patch
from forestgen.plants.organs.base import Bend, Detail, MaybeSize, OrganForm, OrganPatch, Size
from forestgen.recipe.fields import Section

Sharpness = Annotated[float, Field(ge=0.15, le=3.0)]
Widest = Annotated[float, Field(ge=0.1, le=0.9)]

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


class _Blade(Section):
    """Keys of every blade. Other organs make theirs by `model_construct`: of sizes that no file may ask for."""

    length_m: Size = Field(description="length of the blade without its stalk, metres")
    width_m: Size = Field(description="greatest width, flat, metres")
    fold_deg: Annotated[float, Field(ge=0, lt=85)] = Field(
        0.0, description="rise of each half above the midrib, of each lobe of a palmate leaf about its vein, degrees"
    )
    curl_deg: Bend = Field(0.0, description="bend of the tip below the foot's direction, degrees")

    def sheet(self, detail: int) -> Patch:
        """The blade as large as its keys say, whatever area folds, waves and coarse outlines leave it."""
        raise NotImplementedError

    def flat(self) -> Self:
        """The blade without fold, curl and waves."""
        return self.model_copy(update={"fold_deg": 0.0, "curl_deg": 0.0})

    def blade(self, detail: int) -> Patch:
        """The sheet, its foot in the origin; its area is that of the flat outline, whatever the attitude and detail."""
        shape, flat = self, self.flat()
        sheet = shape.sheet(detail)
        if detail == 2 and shape == flat:
            return sheet
        wanted = patches.area_m2(flat.sheet(2))
        for _ in range(2):  # the bend makes the area not quite quadratic in the size
            factor = np.sqrt(wanted / patches.area_m2(sheet))
            shape = shape.model_copy(update={"length_m": shape.length_m * factor, "width_m": shape.width_m * factor})
            sheet = shape.sheet(detail)
        return sheet

    def _raised(self, flat: Floats, z: Floats, x: Floats, faces: Ints) -> Patch:
        """The (V, 2) flat outline's triangles, moved to x and raised to z, with its curl."""
        low, high = flat[:, 1].min(), flat[:, 1].max()
        half = max(float(np.abs(flat[:, 0]).max()), 1e-12)
        uv = np.column_stack([0.5 + 0.5 * flat[:, 0] / half, (flat[:, 1] - low) / (high - low)])
        points = np.column_stack([x, flat[:, 1], z])
        return Patch(patches.bend(points, self.length_m, np.radians(self.curl_deg)), faces.astype(np.int64), uv)


class _Waved(_Blade):
    waves: Annotated[float, Field(ge=0, le=40)] = Field(0.0, description="number of the margin's waves up and down")
    wave_height: Annotated[float, Field(ge=0, le=1)] = Field(0.1, description="their height, share of half the width")

    def flat(self) -> Self:
        return super().flat().model_copy(update={"waves": 0.0})

    def margin(self, detail: int) -> Margin:
        """Points of the margin at a level of detail."""
        raise NotImplementedError

    def sheet(self, detail: int) -> Patch:
        margin = self.margin(detail)
        right = margin.points * np.array([0.5 * self.width_m, self.length_m])
        midrib, fans = _fans(margin, right, self.length_m, detail)
        inner, outer = right[:-1], right[-1:]
        ribs, count = len(midrib), len(inner)
        # Midrib, right margin, left margin, tip.
        flat = np.concatenate([np.column_stack([np.zeros(ribs), midrib]), inner, inner * [-1.0, 1.0], outer])
        tip = ribs + 2 * count

        def half(offset: int) -> Ints:
            return np.where(fans >= 0, fans, np.where(~fans == count, tip, ribs + offset + ~fans))

        faces = np.concatenate([half(0), half(count)[:, ::-1]])
        fold = np.radians(self.fold_deg)
        away = np.abs(flat[:, 0])
        share = np.clip(flat[:, 1] / self.length_m, 0.0, 1.0)
        phase = 2.0 * np.pi * self.waves * share + np.where(flat[:, 0] > 0.0, 0.0, 0.5 * np.pi)
        wave = (self.wave_height if self.waves else 0.0) * away * np.sin(phase)
        z = away * np.sin(fold) + wave * np.cos(fold)
        return self._raised(flat, z, flat[:, 0] * np.cos(fold), faces)


class SimpleBlade(_Waved):
    """Elliptic, ovate, lanceolate, linear, deltoid, round, heart-shaped: see plants/organs/leaves.py."""

    form: Literal["simple"]
    widest: Widest = Field(0.4, description="where the blade is widest, share of its length from its foot")
    base: Sharpness = Field(0.5, description="sharpness of the base: 0.3 blunt, 0.5 round, 1 wedge, 1.5 drawn out")
    tip: Sharpness = Field(1.0, description="sharpness of the tip, in the same way")
    heart: Annotated[float, Field(ge=0, le=0.3)] = Field(
        0.0, description="depth of a heart-shaped base's lobes behind the petiole's end, share of the length"
    )
    teeth: Annotated[int, Field(ge=0, le=60)] = Field(0, description="teeth on each side; drawn at detail 2")
    tooth_depth: Annotated[float, Field(ge=0, le=0.35)] = Field(0.08, description="height, share of local half-width")
    double_teeth: bool = Field(False, description="a smaller tooth upon each tooth")

    @model_validator(mode="after")
    def _heart_is_blunt(self) -> Self:
        if self.heart > 0.0 and self.base > 1.0:
            raise ValueError(f"a base of at most 1 with a heart-shaped base, got {self.base:g}")
        return self

    def margin(self, detail: int) -> Margin:
        """Points of the margin, enough for its waves; teeth show at detail 2 alone."""
        if detail == 2 and self.teeth:
            t, factor = self._toothed()
        else:
            few = (1 if self.base > 0.7 else 2, 2)
            many = (max(9, round(1.8 * self.waves)), max(11, round(2.2 * self.waves)))
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
        within, height = _DOUBLE_TOOTH if self.double_teeth else _TOOTH
        t = (foot[:-1, None] + np.diff(foot)[:, None] * within).reshape(-1)
        depth = self.tooth_depth * np.clip(np.minimum(t / 0.12, 0.3 + (1.0 - t) / 0.2), 0.0, 1.0)
        return t, 1.0 + depth * np.tile(height, self.teeth)


class LobedBlade(_Waved):
    """Pinnate lobes, as an oak's."""

    form: Literal["lobed"]
    lobes: Annotated[int, Field(ge=1, le=15)] = Field(4, description="on each side, beside the one at the tip")
    sinus: Annotated[float, Field(ge=0, le=0.9)] = Field(0.45, description="depth of the sinuses, share of half-width")
    roundness: Annotated[float, Field(ge=1, le=8)] = Field(2.2, description="1 pointed lobes, 2 round, more: square")
    slant: Annotated[float, Field(ge=0, le=0.45)] = Field(
        0.06, description="rise of the widest lobe's tip above its foot, share of the blade's length"
    )
    widest: Widest = Field(0.6, description="where the blade is widest, share of its length from its foot")
    base: Sharpness = Field(0.9, description="sharpness of the base: 0.5 round, 1 wedge")
    tip: Sharpness = Field(0.75, description="sharpness of the tip, in the same way")

    def margin(self, detail: int) -> Margin:
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


class PalmateBlade(_Blade):
    """Lobes about the petiole's end, as a maple's."""

    form: Literal["palmate"]
    lobes: Literal[3, 5, 7, 9, 11, 13] = Field(5, description="lobes in all")
    sinus: Annotated[float, Field(ge=0, le=0.9)] = Field(0.5, description="depth of the sinuses, share of the lobes")
    spread_deg: Annotated[float, Field(ge=30, le=160)] = Field(125.0, description="middle to outermost lobe, degrees")
    outer: Annotated[float, Field(ge=0.2, le=1)] = Field(0.45, description="the outermost's length over the middle's")
    teeth: Annotated[int, Field(ge=0, le=6)] = Field(2, description="coarse teeth on each side of a lobe, at detail 2")
    tooth_depth: Annotated[float, Field(ge=0, le=0.3)] = Field(0.12, description="their height, share of the lobe")

    @model_validator(mode="after")
    def _turns_less_than_half(self) -> Self:
        widest = 176.0 / (1.0 + 0.62 / ((self.lobes - 1) // 2))
        if self.spread_deg > widest:
            raise ValueError(f"a spread_deg of at most {widest:.0f} for {self.lobes} lobes, which else overlap")
        return self

    def sheet(self, detail: int) -> Patch:
        """A fan about the petiole's end, raised between the lobes' veins; with a ring halfway at detail 2."""
        angle, radius = self.polar(detail)
        angle, radius = np.concatenate([angle, -angle[-2::-1]]), np.concatenate([radius, radius[-2::-1]])
        rim = np.column_stack([np.sin(angle) * radius, np.cos(angle) * radius])
        rim *= [0.5 * self.width_m / np.abs(rim[:, 0]).max(), self.length_m]
        step = np.radians(self.spread_deg) / max((self.lobes - 1) // 2, 1)
        off = np.abs(angle / step - np.round(angle / step)) * step
        count = len(rim)
        k = np.arange(count - 1)
        rise = np.sin(np.radians(self.fold_deg)) * np.sin(off) * np.linalg.norm(rim, axis=1)
        if detail == 2:
            flat = np.concatenate([[[0.0, 0.0]], 0.45 * rim, rim])
            z = np.concatenate([[0.0], 0.45 * rise, rise])
            ring, far = 1 + k, 1 + count + k
            corners = ((0 * k, ring, ring + 1), (ring, far, far + 1), (ring, far + 1, ring + 1))
            faces = np.concatenate([np.column_stack(one) for one in corners])
        else:
            flat, z = np.concatenate([[[0.0, 0.0]], rim]), np.append(0.0, rise)
            faces = np.column_stack([0 * k, 1 + k, 2 + k])
        return self._raised(flat, z, flat[:, 0], faces)

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


def _fans(margin: Margin, right: Floats, length_m: float, detail: int) -> tuple[Floats, Ints]:
    """Heights of the midrib's vertices, and the right half's triangles: of vertices r of the midrib, ~k of the margin.

    A fan about one midrib vertex goes on while the margin turns about it; then the midrib goes on to the height at
    which the side vein of the present margin point starts, which works for any graph over the midrib.
    """
    midrib: list[float] = [0.0]
    faces: list[tuple[int, int, int]] = []
    origin = margin.origin * length_m
    last = len(right) - 1
    for k in range(last):
        own = origin[k]
        if own > midrib[-1] and (
            not _turns(midrib[-1], right[k], right[k + 1]) or origin[k + 1] - midrib[-1] > _STEP[detail] * length_m
        ):
            midrib.append(own)
            here = len(midrib) - 1
            faces.append((here - 1, ~k, here))
        faces.append((len(midrib) - 1, ~k, ~(k + 1)))
    return np.array(midrib), np.array(faces, np.int64)


def _turns(origin_y: float, a: Floats, b: Floats) -> bool:
    """Whether b lies to the left of the ray from the midrib to a, by a safe margin."""
    one, two = a - [0.0, origin_y], b - [0.0, origin_y]
    cross = one[0] * two[1] - one[1] * two[0]
    return bool(cross > _SOUND * np.hypot(*one) * np.hypot(*two))


_FOOT_UV = (0.5, 0.03)  # of the midrib, whose colour petioles have
_STALK_WIDTH = 0.018  # of the blade's length, where the file does not say


class _Leaf(OrganForm, _Blade):
    """A simple leaf: blade and petiole."""

    stalk_m: MaybeSize = Field(0.0, description="length of the petiole, metres; the blade begins at its end")
    stalk_width_m: Size | None = Field(None, description="its width, metres; 1.8% of the blade's length if not given")
    detail: Detail = 1

    def patches(self) -> list[OrganPatch]:
        blade = self.blade(self.detail)
        if self.stalk_m == 0.0:
            return [OrganPatch(self.material, blade)]
        petiole = patches.stalk(self.stalk_m, self.stalk_width_m or _STALK_WIDTH * self.length_m, self.detail)
        petiole = petiole._replace(uv=np.full_like(petiole.uv, _FOOT_UV))
        return [OrganPatch(self.material, patches.lifted(blade, self.stalk_m)), OrganPatch(self.material, petiole)]


class SimpleLeaf(_Leaf, SimpleBlade):
    """A leaf of one undivided blade."""


class LobedLeaf(_Leaf, LobedBlade):
    """A pinnately lobed leaf."""


class PalmateLeaf(_Leaf, PalmateBlade):
    """A palmately lobed leaf."""


Leaflet = Annotated[SimpleBlade | LobedBlade | PalmateBlade, Field(discriminator="form")]


class CompoundLeaf(OrganForm):
    """Leaflets on a rachis, or about the petiole's end."""

    form: Literal["compound"]
    leaflet: Leaflet = Field(description="blade of the largest leaflet: a simple, lobed or palmate form's keys")
    leaflets: Annotated[int, Field(ge=2, le=200)] = Field(5, description="in all; an odd number ends in one")
    arrangement: Literal["pinnate", "palmate"] = Field("pinnate", description="along a rachis, or all from one point")
    rachis_m: MaybeSize = Field(0.0, description="from the lowest pair to the end, metres; pinnate ones need it")
    stalk_m: MaybeSize = Field(0.0, description="petiole, metres")
    stalk_width_m: Size = Field(0.0015, description="width of petiole and rachis, metres")
    angle_deg: Annotated[float, Field(ge=0, le=170)] = Field(
        60.0, description="from the rachis; of palmate ones: from the middle leaflet to the outermost, degrees"
    )
    taper: Annotated[float, Field(ge=0.2, le=1)] = Field(0.8, description="size of the smallest, share of the largest")
    curl_deg: Bend = Field(0.0, description="bend of the whole leaf, degrees")
    detail: Detail = 1

    @model_validator(mode="after")
    def _has_room(self) -> Self:
        if self.arrangement == "pinnate" and self.rachis_m <= 0.0:
            raise ValueError("a pinnate leaf needs rachis_m, the length of the axis that bears its leaflets")
        if self.arrangement == "palmate" and self.rachis_m > 0.0:
            raise ValueError("a palmate leaf has no rachis: leave rachis_m out")
        return self

    def patches(self) -> list[OrganPatch]:
        foot, turn, size = self._places()
        axis_m = self.stalk_m + self.rachis_m
        along = np.column_stack([np.sin(turn), np.cos(turn), np.zeros(self.leaflets)])
        linear = patches.attitude(along, np.tile([0.0, 0.0, 1.0], (self.leaflets, 1))) * size[:, None, None]
        whole = [
            patches.copies(
                self.leaflet.blade(self.detail), linear, patches.on_axis(self.stalk_m + self.rachis_m * foot)
            )
        ]
        if axis_m > 0.0:
            whole.append(patches.stalk(axis_m, self.stalk_width_m, self.detail))
        span_m = max(axis_m + self.leaflet.length_m, 1e-9)
        return [OrganPatch(self.material, patches.bent(patches.join(whole), span_m, np.radians(self.curl_deg), 1.5))]

    def _places(self) -> tuple[Floats, Floats, Floats]:
        """Each leaflet's foot as a share of the rachis, angle from it in radians, and size over the largest's."""
        count, angle = self.leaflets, np.radians(self.angle_deg)
        if self.arrangement == "palmate":
            across = np.linspace(-1.0, 1.0, count)
            return np.zeros(count), angle * across, 1.0 - (1.0 - self.taper) * np.abs(across)
        pairs = count // 2
        place = np.linspace(0.0, 1.0 if count % 2 == 0 else 1.0 - 0.7 / max(pairs, 1), pairs)
        size = 1.0 - (1.0 - self.taper) * np.abs(2.0 * place - 0.8) / 1.2
        foot, turn, size = np.repeat(place, 2), np.tile([angle, -angle], pairs), np.repeat(size, 2)
        if count % 2:
            foot, turn, size = np.append(foot, 1.0), np.append(turn, 0.0), np.append(size, 1.0)
        return foot, turn, size
