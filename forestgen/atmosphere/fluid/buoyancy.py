"""Buoyancy, and the background's part in the transport of heat.

Eq. 28 is g (M_air/M_th T_th/T_air - 1): the ratio of the two virtual temperatures. At one pressure T_th/T_air is the
ratio of the potential temperatures; where the surroundings are moist too, theirs is also lighter; M_air/M of air with
vapour q_v is 1 + 0.607 q_v. To first order, with the weight of drops and droplets, which Eq. 28 leaves out,

    b = g [theta'/theta_0 + 0.607 q_v' - q_c - q_r],

with primes for differences from the air at rest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.fluid.background import VAPOUR_LIGHTNESS, Background
from forestgen.atmosphere.sounding import GRAVITY_M_PER_S2
from forestgen.core.compiled import borrowed, unchecked
from forestgen.core.threads import over_slabs

Field = NDArray[np.float32]
_HALF = np.float32(0.5)


def lift(out: Field, heat: Field, vapour: Field, cloud: Field, rain: Field, air: Background, share: float) -> None:
    """out = share x buoyancy + (1 - share) x out, at the faces between layers (Z + 1, Y, X), m/s2; the ends stay 0.

    Parameters
    ----------
    heat : (Z + 4, Y + 4, X + 4) potential temperature less that at rest, K. The other fields: kg/kg.
    """
    per_k = air.lift_per_k.astype(np.float32)
    still = air.vapour.astype(np.float32)
    rest = still[1:] + still[:-1]  # of just such numbers as the fields hold: air at rest has no buoyancy at all
    layers, rows, columns = out.shape
    light, gravity = np.float32(VAPOUR_LIGHTNESS), np.float32(0.5 * GRAVITY_M_PER_S2)
    new, old = np.float32(share), np.float32(1 - share)

    def work(first: int, end: int) -> None:
        _lift(out, heat, vapour, cloud, rain, per_k, rest, light, gravity, new, old, first + 1, end + 1)

    over_slabs(layers - 2, rows * columns, work)


@unchecked
def _lift(out, heat, vapour, cloud, rain, per_k, rest, light, gravity, new, old, first, end):  # type: ignore[no-untyped-def]
    out, heat, vapour, cloud, rain = borrowed(out), borrowed(heat), borrowed(vapour), borrowed(cloud), borrowed(rain)
    rows, columns = out.shape[1], out.shape[2]
    water = np.empty(columns, np.float32)
    for k in range(first, end):
        for j in range(rows):
            _weight(water, cloud[k + 1, j + 2], rain[k + 1, j + 2], cloud[k + 2, j + 2], rain[k + 2, j + 2])
            h, q = heat[k + 1 : k + 3, j + 2], vapour[k + 1 : k + 3, j + 2]
            scale = _HALF * per_k[k]
            to = out[k, j]
            low, high, damp, wet = h[0], h[1], q[0], q[1]
            for i in range(columns):
                moist = light * ((damp[i + 2] + wet[i + 2]) - rest[k - 1]) - water[i]
                to[i] = new * (scale * (low[i + 2] + high[i + 2]) + gravity * moist) + old * to[i]


@unchecked
def _weight(out, a, b, c, d):  # type: ignore[no-untyped-def]
    for i in range(out.size):
        out[i] = (a[i + 2] + b[i + 2]) + (c[i + 2] + d[i + 2])


def carry_rest(heat: Field, up: Field, air: Background, step_s: float, thickness_m: float) -> None:
    """Adds what the vertical wind carries of the air at rest: heat -= step x w d(theta_0)/dz, conserving its sum.

    Parameters
    ----------
    heat : (Z + 4, Y + 4, X + 4) potential temperature less that at rest.
    up : the vertical velocity at the faces, likewise.
    """
    jump = np.zeros(len(air.potential_temperature_k) + 1)
    jump[1:-1] = np.diff(air.potential_temperature_k)
    slope = (0.5 * step_s / thickness_m * jump).astype(np.float32)
    layers, rows, columns = heat.shape
    size = (rows - 4) * (columns - 4)
    over_slabs(layers - 4, size, lambda a, b: _carry_rest(heat, up, slope, a + 2, b + 2))


@unchecked
def _carry_rest(heat, up, slope, first, end):  # type: ignore[no-untyped-def]
    heat, up = borrowed(heat), borrowed(up)
    rows, columns = heat.shape[1], heat.shape[2]
    for k in range(first, end):
        below, above = slope[k - 2], slope[k - 1]
        for j in range(2, rows - 2):
            row, low, high = heat[k, j], up[k, j], up[k + 1, j]
            for i in range(2, columns - 2):
                row[i] -= below * low[i] + above * high[i]
