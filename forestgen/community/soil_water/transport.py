"""How something on a grid spreads and runs downhill: finite volumes, exact for any time, never below 0.

A cell gives each neighbour a rate of what it holds: D / dx^2 by diffusion, and the speed downhill / dx where that
neighbour lies lower (upwind). All else follows from these rates:

- On a plane the rates are the same everywhere, so the system is diagonal in Fourier's basis, or in that of cosines
  between closed edges: its exponential moves any field over any time, exactly as the rates say. What moves little in
  the time takes one step of Euler's instead, at a tenth of the cost.
- Over heights the downhill part takes one implicit step of Euler's. Water only ever runs to a lower cell, so the cells
  are solved one after another from the highest: each is a linear reservoir that the ones above fill. No step is too
  long for it; long ones smear the way downhill, as a chain of reservoirs does.

Both have a matrix without negative elements whose columns sum to 1. So nothing is lost or made but by rounding, nothing
turns negative, and results do not depend on the number of threads. Diffusion's error is of second order in the cells'
width, that of running downhill of first order.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.community.soil_water.ground import Ground
from forestgen.core.compiled import compiled
from forestgen.core.threads import cores, over_ranges

Floats = NDArray[np.float64]
_LITTLE = 0.25  # the share of a cell that leaves it: up to here one explicit step will do
_SMALL = 100_000  # cells, below which a transform is done before other threads have begun


class Transport:
    """One thing's way over a ground: its diffusion, and its speed downhill, speed x |gradient| ^ exponent."""

    def __init__(
        self, ground: Ground, diffusion_m2_per_day: float, speed_m_per_day: float = 0.0, exponent: float = 1.0
    ) -> None:
        self.ground = ground
        dx, dy = ground.cell_m
        steep = math.hypot(*ground.gradient)  # 0 over heights
        pace = speed_m_per_day * steep ** (exponent - 1.0) if steep > 0 else 0.0
        east, north = (-pace * one for one in ground.gradient)
        self._rates = (
            diffusion_m2_per_day / dx**2 + max(east, 0.0) / dx,
            diffusion_m2_per_day / dx**2 + max(-east, 0.0) / dx,
            diffusion_m2_per_day / dy**2 + max(north, 0.0) / dy,
            diffusion_m2_per_day / dy**2 + max(-north, 0.0) / dy,
        )  # 1/day to the neighbours in the east, west, north and south
        self._ways: tuple[NDArray[Any], ...] | None = None
        if ground.height_m is not None and speed_m_per_day > 0:
            order = np.argsort(-ground.height_m, axis=None, kind="stable")
            to, rates = _ways_down(ground.height_m, order, dx, dy, speed_m_per_day, exponent, ground.periodic)
            self._ways = order, to, rates
        self._factors: tuple[float, Any] = (-1.0, None)  # of the last time asked for

    def over(self, field: Floats, days: float) -> Floats:
        """(rows, cols) the field after a time: `field` itself where nothing moves, else a new array."""
        leaving = sum(self._rates) * days
        moved = field
        if leaving > _LITTLE:
            moved = self._transformed(field, days)
        elif leaving > 0:
            moved = self._stepped(field, days)
        if self._ways is not None:
            moved = field.copy() if moved is field else moved
            _run_downhill(moved.reshape(-1, copy=False), *self._ways, days)
        return moved

    def _stepped(self, field: Floats, days: float) -> Floats:
        out, shares = np.empty_like(field), tuple(rate * days for rate in self._rates)
        rows, cols = field.shape

        def work(first: int, end: int) -> None:
            _step(field, out, *shares, self.ground.periodic, -(-first // cols), -(-end // cols))

        over_ranges(rows * cols, work)
        return out

    def _transformed(self, field: Floats, days: float) -> Floats:
        from scipy import fft  # late: half of the imports' time

        n = cores() if field.size > _SMALL else 1
        if self._factors[0] != days:
            self._factors = days, np.exp(days * self._growth_per_day())
        factors = self._factors[1]
        if self.ground.periodic:
            spectrum: Any = fft.rfft2(field, workers=n)
            spectrum *= factors
            moved: Floats = fft.irfft2(spectrum, s=field.shape, workers=n, overwrite_x=True)
        else:
            spectrum = fft.dctn(field, workers=n)
            spectrum *= factors
            moved = fft.idctn(spectrum, workers=n, overwrite_x=True)
        return np.maximum(moved, 0.0, out=moved)  # rounding alone makes it negative

    def _growth_per_day(self) -> NDArray[Any]:
        """Rates at which waves grow: eigenvalues of the rates' matrix, of no positive real part."""
        rows, cols = self.ground.shape
        east, west, north, south = self._rates
        if not self.ground.periodic:
            along_x, along_y = (2.0 * np.cos(np.pi * np.arange(n) / n) - 2.0 for n in (cols, rows))
            return np.asarray(east * along_x + north * along_y[:, None])
        wave_x, wave_y = (np.exp(-2j * np.pi * np.arange(m) / n) for m, n in ((cols // 2 + 1, cols), (rows, rows)))
        along_x = east * (wave_x - 1.0) + west * (wave_x.conj() - 1.0)
        along_y = north * (wave_y - 1.0) + south * (wave_y.conj() - 1.0)
        both = along_x + along_y[:, None]
        return np.asarray(both.real if east == west and north == south else both)


@compiled
def _step(field, out, east, west, north, south, periodic, first, end):  # type: ignore[no-untyped-def]
    """One explicit step of rows [first, end); what passes a face is computed alike on both of its sides.

    Beyond a closed edge lies the cell itself: as the rates there and back are the same, nothing passes.
    """
    rows, cols = field.shape
    before, after = (cols - 1, 0) if periodic else (0, cols - 1)
    for r in range(first, end):
        below = r - 1 if r > 0 else (rows - 1 if periodic else 0)
        above = r + 1 if r + 1 < rows else (0 if periodic else rows - 1)
        for c in range(cols):
            left = c - 1 if c > 0 else before
            right = c + 1 if c + 1 < cols else after
            here = field[r, c]
            gain = (east * field[r, left] - west * here) - (east * here - west * field[r, right])
            gain += (north * field[below, c] - south * here) - (north * here - south * field[above, c])
            out[r, c] = here + gain


@compiled
def _ways_down(z, order, dx, dy, speed, exponent, periodic):  # type: ignore[no-untyped-def]
    """Of cells in an order, flat indices (N,): their neighbours (N, 4), and the rates to each, 1/day.

    The gradient is that of the steeper fall in x and of the steeper in y; a crest sheds to both sides.
    """
    rows, cols = z.shape
    to, rates = np.zeros((z.size, 4), np.int32), np.zeros((z.size, 4))
    fall = np.empty(4)
    for k in range(z.size):
        r, c = order[k] // cols, order[k] % cols
        for way in range(4):
            rr = r + (way == 2) - (way == 3)
            cc = c + (way == 0) - (way == 1)
            if periodic:
                rr, cc = rr % rows, cc % cols
            else:
                rr, cc = min(max(rr, 0), rows - 1), min(max(cc, 0), cols - 1)
            to[k, way] = rr * cols + cc
            fall[way] = max(z[r, c] - z[rr, cc], 0.0) / (dx if way < 2 else dy)
        steep = math.hypot(max(fall[0], fall[1]), max(fall[2], fall[3]))
        for way in range(4):
            if fall[way] > 0.0:
                rates[k, way] = speed * steep ** (exponent - 1.0) * fall[way] / (dx if way < 2 else dy)
    return to, rates


@compiled
def _run_downhill(field, order, to, rates, days):  # type: ignore[no-untyped-def]
    """One implicit step in place: from the highest cell down, what has come is shared between staying and each way."""
    for k in range(order.size):
        leaving = days * (rates[k, 0] + rates[k, 1] + rates[k, 2] + rates[k, 3])
        if leaving > 0.0:
            stays = field[order[k]] / (1.0 + leaving)
            field[order[k]] = stays
            for way in range(4):
                if rates[k, way] > 0.0:
                    field[to[k, way]] += days * rates[k, way] * stays
