"""Advection and viscosity of the velocity: fluxes of third order, biased upwind, unlimited (Wicker & Skamarock 2002).

Each component stands on its own faces; the fluxes through the faces between these carry it, with the mean of the two
velocities at either side. What leaves one cell enters the next, so momentum is conserved, and an even wind stays even.

All arrays have two ghost cells on each side (see `boundaries`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from forestgen.core.compiled import borrowed, unchecked
from forestgen.core.threads import over_slabs

Field = NDArray[np.float32]
_TWO, _THREE, _SEVEN = np.float32(2), np.float32(3), np.float32(7)


def advance_velocity(
    base: Sequence[Field],
    carrier: Sequence[Field],
    out: Sequence[Field],
    step_s: float,
    cell_m: tuple[float, float, float],
    viscosity_m2_per_s: float,
) -> None:
    """out = base + step x (advection and viscosity of the carrier), for the components east, north, up.

    Parameters
    ----------
    base, carrier, out : (3,) fields (Z + 4, Y + 4, X + 4), m/s. The carrier is free of divergence. `out` may be `base`.
    """
    layers, rows, columns = carrier[0].shape
    step = np.float32(step_s)
    per_m = tuple(np.float32(1.0 / (24.0 * side)) for side in cell_m)
    smooth = tuple(np.float32(viscosity_m2_per_s / side**2) for side in cell_m)
    for axis, back in enumerate(((0, 0, 1), (0, 1, 0), (1, 0, 0))):

        def work(first: int, end: int, axis: int = axis, back: tuple[int, int, int] = back) -> None:
            _advance(carrier[axis], base[axis], out[axis], *carrier, back, step, per_m, smooth, first + 2, end + 2)

        over_slabs(layers - 4, (rows - 4) * (columns - 4), work)


@unchecked
def _advance(q, base, out, u, v, w, back, step, per_m, smooth, first, end):  # type: ignore[no-untyped-def]
    """One component in layers [first, end). `back` points from a face to the one before it along the component."""
    q, base, out, u, v, w = borrowed(q), borrowed(base), borrowed(out), borrowed(u), borrowed(v), borrowed(w)
    rows, columns = q.shape[1], q.shape[2]
    n = columns - 4
    below, above = np.empty((rows, n), np.float32), np.empty((rows, n), np.float32)
    south, north, east = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n + 1, np.float32)
    viscous = smooth[0] > 0.0
    for j in range(2, rows - 2):
        _up_flux(below[j], q, w, back, per_m[2], first, j)
    for k in range(first, end):
        _north_flux(south, q, v, back, per_m[1], k, 2)
        for j in range(2, rows - 2):
            _east_flux(east, q, u, back, per_m[0], k, j)
            _north_flux(north, q, v, back, per_m[1], k, j + 1)
            _up_flux(above[j], q, w, back, per_m[2], k + 1, j)
            to = out[k, j, 2 : n + 2]
            _gather(to, base[k, j, 2 : n + 2], step, east, south, north, below[j], above[j])
            if viscous:
                _smooth_along(to, q[k, j, 1 : n + 1], q[k, j, 2 : n + 2], q[k, j, 3 : n + 3], step * smooth[0])
                here = q[k, j, 2 : n + 2]
                _smooth_along(to, q[k, j - 1, 2 : n + 2], here, q[k, j + 1, 2 : n + 2], step * smooth[1])
                if k == 2 and back[0] == 0:
                    _brake(to, here, q[k + 1, j, 2 : n + 2], step * smooth[2])
                else:
                    _smooth_along(to, q[k - 1, j, 2 : n + 2], here, q[k + 1, j, 2 : n + 2], step * smooth[2])
            south, north = north, south
        below, above = above, below


@unchecked
def _east_flux(out, q, u, back, per_m, k, j):  # type: ignore[no-untyped-def]
    n = out.size
    a, b, c = k - back[0], j - back[1], 2 - back[2]
    row = q[k, j]
    _flux(out, u[k, j, 2 : n + 2], u[a, b, c : c + n], row[0:n], row[1 : n + 1], row[2 : n + 2], row[3 : n + 3], per_m)


@unchecked
def _north_flux(out, q, v, back, per_m, k, j):  # type: ignore[no-untyped-def]
    n = out.size
    a, b, c = k - back[0], j - back[1], 2 - back[2]
    one, two = v[k, j, 2 : n + 2], v[a, b, c : c + n]
    at = q[k]
    _flux(out, one, two, at[j - 2, 2 : n + 2], at[j - 1, 2 : n + 2], at[j, 2 : n + 2], at[j + 1, 2 : n + 2], per_m)


@unchecked
def _up_flux(out, q, w, back, per_m, k, j):  # type: ignore[no-untyped-def]
    n = out.size
    a, b, c = k - back[0], j - back[1], 2 - back[2]
    one, two = w[k, j, 2 : n + 2], w[a, b, c : c + n]
    _flux(
        out, one, two, q[k - 2, j, 2 : n + 2], q[k - 1, j, 2 : n + 2], q[k, j, 2 : n + 2], q[k + 1, j, 2 : n + 2], per_m
    )


@unchecked
def _flux(out, one, two, a, b, c, d, per_m):  # type: ignore[no-untyped-def]
    """Flux of a quantity whose values along the axis are a, b | c, d; the velocity is the mean of `one` and `two`."""
    for i in range(out.size):
        speed = (one[i] + two[i]) * per_m
        even, odd = _SEVEN * (b[i] + c[i]) - (a[i] + d[i]), (d[i] - a[i]) - _THREE * (c[i] - b[i])
        out[i] = speed * even + abs(speed) * odd


@unchecked
def _gather(out, base, step, east, south, north, below, above):  # type: ignore[no-untyped-def]
    for i in range(out.size):
        out[i] = base[i] + step * ((east[i] - east[i + 1]) + (south[i] - north[i]) + (below[i] - above[i]))


@unchecked
def _smooth_along(out, before, here, after, weight):  # type: ignore[no-untyped-def]
    for i in range(out.size):
        out[i] += weight * ((before[i] + after[i]) - _TWO * here[i])


@unchecked
def _brake(out, here, above, weight):  # type: ignore[no-untyped-def]
    """The same in the lowest layer: below it is its own wind with the sign turned, so that the ground's is 0."""
    for i in range(out.size):
        out[i] += weight * (above[i] - _THREE * here[i])
