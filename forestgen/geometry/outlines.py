"""Margins of leaf blades: the right half as points from the foot to the tip.

Entire leaves. With t from 0 at the foot to 1 at the tip, and the widest place at t = a, the half-width is

    w(t) = (1 - u^2)^b with u = (a - t) / a below,   w(t) = (1 - u^2)^c with u = (t - a) / (1 - a) above

of half the greatest width. b and c are the sharpness of base and tip: 0.5 a round end (half an ellipse), 1 a pointed
one (a parabola), more than 1 drawn out, less than 0.5 blunt. The area is W L (a I(b) + (1 - a) I(c)) with
I(q) = sqrt(pi) Gamma(q + 1) / (2 Gamma(q + 3/2)).

Lobes and teeth multiply w(t). Everything is a graph over t, so that the outline cannot cross itself; side veins and
the lobes of a heart-shaped base then shear it, which keeps it simple.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


_USUAL_ASPECT = 0.35  # half-width over length of a leaf, where only the spread of teeth depends on it
_SINUS = 0.07  # half the gap between lobes, share of their step
_TOOTH = (np.array([0.0, 0.8]), np.array([-1.0, 1.0]))  # places within a tooth, and heights
_DOUBLE_TOOTH = (np.array([0.0, 0.4, 0.52, 0.86]), np.array([-1.0, 0.15, -0.4, 1.0]))


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
