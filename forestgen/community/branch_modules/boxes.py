"""Boxes: obstacles, such as houses, that branch modules run into and that keep the light from them.

A sphere's volume within a box is the integral of disc and rectangle's common area (exact) over height, by Gauss and
Legendre's rule with 12 points on each of the parts between the heights at which the disc begins or ceases to reach a
side or corner. Its error is below 1e-5 of the sphere's volume (measured in the tests).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import asin, cos, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from forestgen.core.compiled import compiled

Floats = NDArray[np.float64]

_NODE, _WEIGHT = np.polynomial.legendre.leggauss(12)


@dataclass(frozen=True)
class Boxes:
    """Upright boxes, one row each."""

    base_m: Floats  # (B, 3) centre of the lower face, metres, world frame
    size_m: Floats  # (B, 3) width, depth, height; width along world x where the azimuth is 0
    azimuth_rad: Floats  # (B,) anticlockwise, seen from above

    def __len__(self) -> int:
        return len(self.azimuth_rad)

    @property
    def rows(self) -> Floats:
        """(B, 8) for kernels: centre x, y, z; half the width, depth, height, metres; cosine and sine of the azimuth."""
        centre = self.base_m + np.array([0.0, 0.0, 0.5]) * self.size_m[:, 2:]
        turn = np.stack([np.cos(self.azimuth_rad), np.sin(self.azimuth_rad)], axis=1)
        return np.ascontiguousarray(np.hstack([centre, 0.5 * self.size_m, turn]), dtype=np.float64)

    def cover(self, position_m: Floats, period_m: tuple[float, float] | None = None) -> NDArray[np.bool_]:
        """(N,) whether points of (N, 2) world x and y lie on a box's ground."""
        inside = np.zeros(len(position_m), dtype=np.bool_)
        for row in self.rows:
            offset = position_m[:, :2] - row[:2]
            if period_m is not None:
                offset -= np.round(offset / period_m) * period_m
            along = offset[:, 0] * row[6] + offset[:, 1] * row[7]
            across = offset[:, 1] * row[6] - offset[:, 0] * row[7]
            inside |= (np.abs(along) <= row[3]) & (np.abs(across) <= row[4])
        return inside


NO_BOXES = Boxes(np.empty((0, 3)), np.empty((0, 3)), np.empty(0))


@compiled
def _half_disc(t, rho):  # type: ignore[no-untyped-def]
    """Integral of sqrt(rho^2 - s^2) over s from 0 to t."""
    return 0.5 * (t * sqrt(max(rho * rho - t * t, 0.0)) + rho * rho * asin(min(max(t / rho, -1.0), 1.0)))


@compiled
def _corner(x, y, rho):  # type: ignore[no-untyped-def]
    """Area of the part of a disc about the origin with coordinates below x and y."""
    x, y = min(max(x, -rho), rho), min(max(y, -rho), rho)
    a = sqrt(max(rho * rho - y * y, 0.0))
    m = min(max(x, -a), a)
    cap = _half_disc(m, rho) + _half_disc(a, rho)
    if y >= 0.0:
        return 2.0 * _half_disc(x, rho) + 0.5 * pi * rho * rho - (cap - y * (m + a))
    return cap + y * (m + a)


@compiled
def _disc_and_rectangle(x, y, half_x, half_y, rho):  # type: ignore[no-untyped-def]
    """Common area of a disc of radius rho at x, y and the rectangle |x| <= half_x, |y| <= half_y."""
    if rho <= 0.0:
        return 0.0
    return (
        _corner(half_x - x, half_y - y, rho)
        - _corner(-half_x - x, half_y - y, rho)
        - _corner(half_x - x, -half_y - y, rho)
        + _corner(-half_x - x, -half_y - y, rho)
    )


@compiled
def _kinks(x, y, half_x, half_y, r, low, high, cut):  # type: ignore[no-untyped-def]
    """Put into `cut` the heights from `low` to `high` at which the disc begins to reach a side or corner, in order."""
    cut[0], cut[1], count = low, high, 2
    for k in range(8):  # four corners, then four sides
        px = half_x - x if k % 2 else -half_x - x
        py = half_y - y if (k // 2) % 2 else -half_y - y
        d2 = px * px + py * py
        if k >= 4:
            d2 = px * px if k < 6 else (half_y + (y if k % 2 else -y)) ** 2
        if d2 < r * r:
            z = sqrt(r * r - d2)
            for at in (-z, z):
                if low < at < high:
                    place = count
                    while cut[place - 1] > at:
                        cut[place] = cut[place - 1]
                        place -= 1
                    cut[place] = at
                    count += 1
    return count


@compiled
def _in_upright(x, y, z, r, half_x, half_y, half_z):  # type: ignore[no-untyped-def]
    """Volume of a sphere at x, y, z within the box about the origin."""
    low, high = max(-half_z - z, -r), min(half_z - z, r)
    if low >= high or abs(x) >= half_x + r or abs(y) >= half_y + r:
        return 0.0
    cut = np.empty(20)
    count = _kinks(x, y, half_x, half_y, r, low, high, cut)
    volume = 0.0
    for part in range(count - 1):
        middle, half = 0.5 * (cut[part] + cut[part + 1]), 0.5 * (cut[part + 1] - cut[part])
        for k in range(len(_NODE)):
            # The square roots at both ends of a part become smooth: height = middle + half * sin.
            angle = 0.5 * pi * _NODE[k]
            height = middle + half * sin(angle)
            area = _disc_and_rectangle(x, y, half_x, half_y, sqrt(max(r * r - height * height, 0.0)))
            volume += _WEIGHT[k] * 0.5 * pi * cos(angle) * half * area
    return volume


@compiled
def volume_in_boxes(x, y, z, r, boxes, width, height):  # type: ignore[no-untyped-def]
    """Volume of a sphere within boxes, rows of `Boxes.rows`; a torus of `width` and `height` where width > 0."""
    volume = 0.0
    for b in range(len(boxes)):
        dx, dy, dz = x - boxes[b, 0], y - boxes[b, 1], z - boxes[b, 2]
        if width > 0.0:
            dx -= width * round(dx / width)
            dy -= height * round(dy / height)
        if abs(dz) >= r + boxes[b, 5] or dx * dx + dy * dy >= (boxes[b, 3] + boxes[b, 4] + r) ** 2:
            continue
        along, across = dx * boxes[b, 6] + dy * boxes[b, 7], dy * boxes[b, 6] - dx * boxes[b, 7]
        volume += _in_upright(along, across, dz, r, boxes[b, 3], boxes[b, 4], boxes[b, 5])
    return volume
