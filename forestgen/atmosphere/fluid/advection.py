"""Advection of heat and water: one step, in flux form, monotone, of third order along each axis and second in all.

The flux through a face is that of Leonard (1991, "ULTIMATE QUICKEST"): exact for quadratic profiles, and limited so
that the value that leaves lies between its neighbours, and what stays in the cell does too. The axes are swept one
after another, x/2 y/2 z y/2 x/2 (Strang 1968). A single sweep squeezes air: each cell's share of air (1 before the
first sweep and after the last) is carried along, and ratios are masses over it (Easter 1993). So an even ratio stays
even, no value passes those of the neighbourhood, none becomes negative, and mass is conserved to rounding, as long as
less air leaves a cell in a step than is in it.

All fields have two ghost cells on each side (see `momentum`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.fluid.momentum import fill_sides
from forestgen.atmosphere.fluid.parameters import Velocity
from forestgen.core.compiled import assign, unchecked, unowned_view
from forestgen.core.threads import over_slabs

Field = NDArray[np.float32]
_ZERO, _ONE, _TWO = np.float32(0), np.float32(1), np.float32(2)
_HALF, _SIXTH = np.float32(0.5), np.float32(1 / 6)


class Transport:
    """Carries ratios by a velocity for a step, in (Z, Y, X) cells; `openness` as of `momentum.Pressure`."""

    def __init__(self, shape: tuple[int, int, int], openness: Velocity | None) -> None:
        self.shape, self.openness = shape, openness
        padded = tuple(n + 4 for n in shape)
        self._between = np.zeros(padded, np.float32)
        self._squeeze = np.zeros((2, *padded), np.float32)  # air that half a sweep along x, and along y too, takes away
        self._velocity: Velocity
        self._per_m: tuple[np.float32, ...]

    def prepare(self, velocity: Velocity, step_s: float, cell_m: tuple[float, float, float]) -> None:
        """Sets velocity (m/s, at the faces, ghosts filled) and step."""
        self._velocity = velocity
        self._per_m = tuple(np.float32(step_s / side) for side in cell_m)
        (u, v, _), (x, y, _), inner = velocity, self._per_m, (slice(2, -2),) * 3
        along_x, along_both = (part[inner] for part in self._squeeze)
        along_x[:] = (_HALF * x) * np.diff(u[2:-2, 2:-2, 2:-1], axis=2)
        along_both[:] = along_x + (_HALF * y) * np.diff(v[2:-2, 2:-1, 2:-2], axis=1)
        for part in self._squeeze:
            fill_sides(part[2:-2])

    def carry(self, ratio: Field, *, least: float = 0.0) -> None:
        """Replaces the inner values of a ratio (Z + 4, Y + 4, X + 4) by those after the step, at least `least`.

        The limit only takes care of rounding: the scheme makes no value below it.
        """
        low = np.float32(least)
        fill_sides(ratio[2:-2])
        z, y, x = self.shape
        u, v, w = self._velocity
        cx, cy, cz = self._per_m
        between, squeeze, opened = self._between, self._squeeze, self.openness
        flat = (u, v, squeeze, cx, cy, opened, low)
        over_slabs(z, y * x, lambda a, b: _sweep_flat(ratio, between, True, *flat, a + 2, b + 2))
        over_slabs(y, z * x, lambda a, b: _along_z(between, w, squeeze, cz, opened, low, a + 2, b + 2))
        fill_sides(between[2:-2])
        over_slabs(z, y * x, lambda a, b: _sweep_flat(between, ratio, False, *flat, a + 2, b + 2))


@unchecked
def _sweep_flat(ratio, out, x_first, u, v, squeeze, cx, cy, opened, least, first, end):  # type: ignore[no-untyped-def]
    """Half a step along x and then y, or along y and then x."""
    ratio, out, u, v, squeeze = unowned_view((ratio, out, u, v, squeeze))
    rows = ratio.shape[1]
    plane, work = np.empty(ratio.shape[1:], np.float32), np.empty((6, ratio.shape[2]), np.float32)
    x, y = _HALF * cx, _HALF * cy
    for k in range(first, end):
        _copy(plane, ratio[k])
        opened_x = None if opened is None else opened[0][k]
        opened_y = None if opened is None else opened[1][k]
        by_x, by_both = squeeze[0, k], squeeze[1, k]
        if x_first:
            _sweep_x(plane, u[k], squeeze[:, k], _ZERO, -_ONE, x, opened_x, least, 0, rows, work)
            _sweep_rows(plane, v[k], by_x, -_ONE, by_both, -_ONE, y, opened_y, least, work)
        else:
            _sweep_rows(plane, v[k], by_both, _ONE, by_x, _ONE, y, opened_y, least, work)
            _sweep_x(plane, u[k], squeeze[:, k], _ONE, _ZERO, x, opened_x, least, 2, rows - 2, work)
        _copy(out[k, 2:-2, 2:-2], plane[2:-2, 2:-2])


@unchecked
def _sweep_x(plane, u, squeeze, before, after, per_m, opened, least, first, end, work):  # type: ignore[no-untyped-def]
    """Rows of a plane, each along itself. A cell's air is 1 + before x squeeze, and then 1 + after x squeeze."""
    plane, u, squeeze = unowned_view((plane, u, squeeze))
    m = plane.shape[1]
    courant, rest, flux, air = work[0], work[1], work[2], work[3]
    for j in range(first, end):
        row, lost = plane[j], squeeze[0, j]
        _scaled(courant, u[j], per_m)
        _air(air, lost, before)
        _remains(rest[: m - 1], air, courant, courant[1:])
        to, one, two, three = flux[2 : m - 1], courant[2 : m - 1], rest[1 : m - 2], rest[2 : m - 1]
        a, b, c, d = row[: m - 3], row[1 : m - 2], row[2 : m - 1], row[3:]
        if opened is None:
            _fluxes(to, one, a, b, c, d, two, three)
        else:
            _fluxes_by_terrain(to, one, a, b, c, d, two, three, opened[j, 1 : m - 2], opened[j, 3:])
        _settle(row[2 : m - 2], air[2 : m - 2], flux[2 : m - 2], flux[3 : m - 1], lost[2 : m - 2], after, least)


@unchecked
def _sweep_rows(plane, v, squeeze, sign, squeeze_after, sign_after, per_m, opened, least, work):  # type: ignore[no-untyped-def]
    """Columns of a plane, all at once, row by row. A cell's air is 1 + sign x squeeze, before and after."""
    plane, v, squeeze, squeeze_after = unowned_view((plane, v, squeeze, squeeze_after))
    rows = plane.shape[0]
    before, air = np.empty_like(plane), np.empty_like(plane)
    south, north = work[0], work[1]
    rest_south, rest_north = work[2], work[3]
    low, high = work[4], work[5]
    _copy(before, plane)
    for j in range(1, rows - 1):
        _air(air[j], squeeze[j], sign)
        _scaled(low, v[j], per_m)
        _scaled(high, v[j + 1], per_m)
        _remains(rest_north, air[j], low, high)
        if j >= 2:
            a, b, c, d = before[j - 2], before[j - 1], before[j], before[j + 1]
            if opened is None:
                _fluxes(north, low, a, b, c, d, rest_south, rest_north)
            else:
                _fluxes_by_terrain(north, low, a, b, c, d, rest_south, rest_north, opened[j - 1], opened[j + 1])
        if j >= 3:
            _settle(plane[j - 1], air[j - 1], south, north, squeeze_after[j - 1], sign_after, least)
        south, north = north, south
        rest_south, rest_north = rest_north, rest_south


@unchecked
def _along_z(field, w, squeeze, per_m, opened, least, first, end):  # type: ignore[no-untyped-def]
    """Columns upwards, for rows [first, end). Nothing passes the ground or the ceiling."""
    field, w, squeeze = unowned_view((field, w, squeeze))
    layers, m = field.shape[0], field.shape[2]
    plane, work = np.zeros((layers, m), np.float32), np.empty((6, m), np.float32)
    for j in range(first, end):
        _copy(plane[2:-2], field[2:-2, j])
        plane[1], plane[-2] = plane[2], plane[-3]  # no slope is seen beyond ground and ceiling
        opened_z = None if opened is None else opened[2][:, j]
        lost = squeeze[1, :, j]
        _sweep_rows(plane, w[:, j], lost, -_ONE, lost, _ONE, per_m, opened_z, least, work)
        _copy(field[2:-2, j], plane[2:-2])


@unchecked
def _copy(to, values):  # type: ignore[no-untyped-def]
    for j in range(len(to)):
        assign(to[j], values[j])


@unchecked
def _scaled(out, velocity, per_m):  # type: ignore[no-untyped-def]
    for i in range(out.size):
        out[i] = velocity[i] * per_m


@unchecked
def _air(out, squeeze, sign):  # type: ignore[no-untyped-def]
    for i in range(out.size):
        out[i] = _ONE + sign * squeeze[i]


@unchecked
def _remains(out, air, low, high):  # type: ignore[no-untyped-def]
    """Air that does not leave a cell through its two faces."""
    for i in range(out.size):
        backward = low[i] if low[i] < _ZERO else _ZERO
        forward = high[i] if high[i] > _ZERO else _ZERO
        left = air[i] + backward - forward
        out[i] = left if left > _ZERO else _ZERO


@unchecked
def _fluxes(out, courant, a, b, c, d, rest_b, rest_c):  # type: ignore[no-untyped-def]
    """What passes from b to c; a and d lie behind them; `rest` is the air that stays in each."""
    for i in range(out.size):
        out[i] = _flux(courant[i], b[i] - a[i], b[i], c[i], d[i] - c[i], rest_b[i], rest_c[i])


@unchecked
def _fluxes_by_terrain(out, courant, a, b, c, d, rest_b, rest_c, open_b, open_c):  # type: ignore[no-untyped-def]
    """The same; where terrain lies between a and b or c and d, there is no slope to be seen there."""
    for i in range(out.size):
        behind, ahead = (b[i] - a[i]) * open_b[i], (d[i] - c[i]) * open_c[i]
        out[i] = _flux(courant[i], behind, b[i], c[i], ahead, rest_b[i], rest_c[i])


@unchecked
def _flux(courant, slope_b, b, c, slope_c, rest_b, rest_c):  # type: ignore[no-untyped-def]
    forward = courant > _ZERO
    share = courant if forward else -courant
    up = b if forward else c
    ahead = c - b if forward else b - c
    behind = slope_b if forward else -slope_c
    rest = rest_b if forward else rest_c
    want = share * (_ONE - share) * ((_TWO - share) * ahead + (_ONE + share) * behind) * _SIXTH
    size, most, stays = abs(want), share * abs(ahead), rest * abs(behind)
    size = most if most < size else size
    size = stays if stays < size else size
    size = size if ahead * behind > _ZERO else _ZERO
    beyond = size if ahead > _ZERO else -size
    return share * up + beyond if forward else -(share * up + beyond)


@unchecked
def _settle(ratio, air, flux_in, flux_out, squeeze, sign, least):  # type: ignore[no-untyped-def]
    """The new ratio: what was there and came and went, over the air that is there now."""
    for i in range(ratio.size):
        value = (air[i] * ratio[i] - (flux_out[i] - flux_in[i])) / (_ONE + sign * squeeze[i])
        ratio[i] = value if value > least else least
