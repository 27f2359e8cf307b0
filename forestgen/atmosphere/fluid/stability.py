"""How long a step may be, and whether the air can be stepped on at all.

Limits: the air crosses at most a share of a cell (Courant), also while buoyancy speeds it up; diffusion by eddies
reaches no further than a cell; a gravity wave's step times its frequency stays under 2 (the staggered steps of heat
and wind are a leapfrog).
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.fluid.background import Background
from forestgen.atmosphere.fluid.boundaries import Velocity
from forestgen.atmosphere.fluid.parameters import Physics, UnstableError
from forestgen.atmosphere.weather import AirGrid
from forestgen.core.compiled import borrowed, unchecked
from forestgen.core.threads import at_once, over_slabs

Field = NDArray[np.float32]
WAVE_LIMIT = 1.8  # of step x frequency; 2 is the leapfrog's


def crossing_per_s(velocity: Velocity, cell_m: tuple[float, float, float]) -> float:
    """Largest rate at which air leaves a cell through its faces, in cells a second.

    Parameters
    ----------
    velocity : east, north, up (Z + 4, Y + 4, X + 4), ghosts filled.
    """
    layers, rows, columns = velocity[0].shape
    most = np.zeros(layers - 4, np.float64)
    per_m = tuple(np.float32(1 / side) for side in cell_m)
    over_slabs(layers - 4, (rows - 4) * (columns - 4), lambda a, b: _crossing(most, *velocity, *per_m, a, b))
    return float(most.max())


@unchecked
def _crossing(most, u, v, w, x_per_m, y_per_m, z_per_m, first, end):  # type: ignore[no-untyped-def]
    u, v, w = borrowed(u), borrowed(v), borrowed(w)
    rows, columns = u.shape[1], u.shape[2]
    rate = np.zeros(columns, np.float32)
    for layer in range(first, end):
        k = layer + 2
        largest = np.zeros(columns, np.float32)
        for j in range(2, rows - 2):
            _out(rate, u[k, j], u[k, j, 1:], x_per_m, np.float32(0))
            _out(rate, v[k, j], v[k, j + 1], y_per_m, np.float32(1))
            _out(rate, w[k, j], w[k + 1, j], z_per_m, np.float32(1))
            for i in range(2, columns - 2):
                largest[i] = rate[i] if rate[i] > largest[i] else largest[i]
        most[layer] = largest.max()


@unchecked
def _out(rate, low, high, per_m, keep):  # type: ignore[no-untyped-def]
    zero = np.float32(0)
    for i in range(min(high.size, rate.size)):
        outwards = (high[i] if high[i] > zero else zero) - (low[i] if low[i] < zero else zero)
        rate[i] = keep * rate[i] + outwards * per_m


def wave_per_s(air: Background, thickness_m: float) -> float:
    """Frequency of the fastest gravity wave of the air at rest (Brunt and Vaisala's)."""
    rise = air.lift_per_k[1:-1] * np.diff(air.potential_temperature_k) / thickness_m
    return math.sqrt(max(0.0, float(rise.max(initial=0.0))))


def fixed_limit_s(grid: AirGrid, air: Background, physics: Physics) -> float:
    """What the air at rest and the constants allow, whatever the wind."""
    limit = physics.largest_step_s
    eddies = max(physics.viscosity_m2_per_s, physics.diffusivity_m2_per_s)
    if eddies > 0:
        limit = min(limit, 0.25 / (eddies * sum(1 / side**2 for side in grid.cell_m)))
    wave = wave_per_s(air, grid.cell_m[2])
    return min(limit, 1.0 / wave) if wave > 0 else limit


def moving_limit_s(crossing_per_s: float, lift_m_per_s2: float, thickness_m: float, courant: float) -> float:
    """The step after which Courant's number reaches `courant`, with buoyancy speeding the air up meanwhile."""
    speeding = lift_m_per_s2 / thickness_m  # cells / s2
    if speeding <= 0:
        return courant / crossing_per_s if crossing_per_s > 0 else math.inf
    # crossing t + speeding t^2 / 2 = courant, written so that nothing cancels
    root = math.sqrt(crossing_per_s**2 + 2 * speeding * courant)
    return 2 * courant / (crossing_per_s + root)


def check_fields(fields: dict[str, Field]) -> None:
    """Raises UnstableError where a field is not finite."""
    sums = at_once([partial(np.add.reduce, field, axis=None) for field in fields.values()])
    for (name, field), total in zip(fields.items(), sums, strict=True):
        if np.isfinite(total):
            continue
        bad = np.argwhere(~np.isfinite(field))
        if len(bad):  # else the sum alone is too large
            layer, row, column = (int(n) for n in bad[0])
            raise UnstableError(
                f"{name} is {field[layer, row, column]} in layer {layer}, row {row}, column {column}"
                f" and in {len(bad) - 1} other places; expected finite numbers"
            )
