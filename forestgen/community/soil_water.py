"""The soil model (Makowski 2023, section 4.5.6): water on the surface and in the soil, over a month or any other time.

    dO/dt = R - f O                           + D_O ΔO - div(v_O O)
    dW/dt =     f O - g W / (W + k1) B - r W  + D_W ΔW - div(v_W W)
    f = α (B + k2 W0) / (B + k2) / (1 + |grad z| / s)
    v_W = -V_W grad z                           v_O = -V_O grad z / sqrt(|grad z|)

O and W are surface and soil water, mm; R rain, mm/d; B plants, g/m2; z the ground's height. Two misprints of Eqs. 43
and 44 are put right: infiltration saturates with plants, as in the works that they cite, not with soil water, whose
unit does not fit; and what runs downhill leaves one cell and enters the next (a divergence). The last factor of f is
section 4.7.2.1's "infiltration is diminishing with the steepness of slopes". The source leaves both v open: soil water
follows Darcy's law, surface water Manning's, in which speed goes with the root of the slope.

A time is cut into equal sub-steps of at most `substep_days`: half an `exchange` within the cells, `Transport` between
them, the other half (Strang: second order where the ground is a plane). Any length is stable, keeps all water and makes
nothing negative. At half a day, the default, the two waters of a pattern of 40 m are right to 1%.

Defaults are those of Rietkerk et al. 2002, but for both speeds downhill and `half_infiltration_gradient`.

Transport is by finite volumes: a cell gives each neighbour a rate of what it holds, D / dx^2 by diffusion, and the
speed downhill / dx where that neighbour lies lower (upwind).

- On a plane the rates are the same everywhere, so the system is diagonal in Fourier's basis, or in that of cosines
  between closed edges: its exponential moves any field over any time exactly. What moves little takes one step of
  Euler's instead, at a tenth of the cost.
- Over heights the downhill part takes one implicit step of Euler's. Water only ever runs to a lower cell, so the cells
  are solved one after another from the highest. Any step is stable; long ones smear the way downhill.

Both have a matrix without negative elements whose columns sum to 1: nothing is lost or made but by rounding, and
results do not depend on the number of threads. Diffusion's error is of second order in the cells' width, that of
running downhill of first order.

References
----------
Rietkerk, Boerlijst, van Langevelde, HilleRisLambers, van de Koppel, Kumar, Prins and de Roos 2002, Self-organization of
vegetation in arid ecosystems, The American Naturalist 160 (4), 524-530.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Site
from forestgen.core.compiled import compiled
from forestgen.core.threads import cores, parallel_for

Floats = NDArray[np.float64]
Map = NDArray[np.floating] | float
_MANNING = 0.5  # power of the gradient
_LITTLE = 0.25  # the share of a cell that leaves it: up to here one explicit step will do
_SMALL = 100_000  # cells, below which a transform is done before other threads have begun


@dataclass(frozen=True)
class Ground:
    """Cells over [0, W] x [0, H], row 0 at y = 0, and how the ground lies there.

    Edges are closed: nothing passes them, and water slips along them. Or they are joined (`periodic`): heights then
    should meet there, since a jump is a cliff that water runs down. An endless hillside is a torus with a `gradient`.
    """

    size_m: tuple[float, float]  # W, H
    shape: tuple[int, int]  # rows, cols
    periodic: bool = False
    height_m: Floats | None = None  # (rows, cols) in the middles of the cells; None: a plane
    gradient: tuple[float, float] = (0.0, 0.0)  # of the plane to east and north, metres a metre; periodic grounds only

    @classmethod
    def of_site(cls, site: Site, cell_m: float, *, periodic: bool) -> Ground:
        """The ground of a community's site, in cells as near to a width as fit it."""
        cols, rows = (max(1, round(side / cell_m)) for side in site.size_m)
        if site.height is None:
            return cls(site.size_m, (rows, cols), periodic)
        x, y = ((np.arange(n) + 0.5) / n * side for n, side in zip((cols, rows), site.size_m, strict=True))
        height_m = np.broadcast_to(site.height(*np.meshgrid(x, y)), (rows, cols))
        return cls(site.size_m, (rows, cols), periodic, np.array(height_m, dtype=np.float64))

    @property
    def cell_m(self) -> tuple[float, float]:
        """Width and depth of a cell."""
        return self.size_m[0] / self.shape[1], self.size_m[1] / self.shape[0]

    def steepness(self) -> Floats:
        """(rows, cols) size of the ground's gradient, metres a metre: centred differences."""
        if self.height_m is None:
            return np.full(self.shape, math.hypot(*self.gradient))
        wide = np.pad(self.height_m, 1, mode="wrap" if self.periodic else "edge")
        east = wide[1:-1, 2:] - wide[1:-1, :-2]
        north = wide[2:, 1:-1] - wide[:-2, 1:-1]
        apart_x, apart_y = np.full(self.shape[1], 2 * self.cell_m[0]), np.full(self.shape[0], 2 * self.cell_m[1])
        if not self.periodic:  # at an edge, the difference to the one neighbour
            for apart in (apart_x, apart_y):
                apart[[0, -1]] *= 0.5 if len(apart) > 1 else 1.0
        return np.asarray(np.hypot(east / apart_x, north / apart_y[:, None]))


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

        parallel_for(rows * cols, work)
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


@dataclass(frozen=True)
class SoilWaterParameters:
    """How water enters the soil, moves and leaves it. All are 0 or more, and those that begin with half above 0."""

    uptake_mm_m2_per_g_day: float = 0.05  # g_max: the most water that a gram of plants takes up
    half_uptake_mm: float = 5.0  # k1: soil water at which uptake is half its most
    infiltration_per_day: float = 0.2  # α: the most, as a rate of surface water, among dense plants
    half_infiltration_g_per_m2: float = 5.0  # k2: of plants
    bare_infiltration: float = 0.2  # W0: share of the most that bare ground has, 0 to 1
    loss_per_day: float = 0.2  # r_w: evaporation and drainage, as a rate of soil water
    soil_diffusion_m2_per_day: float = 0.1  # D_W
    surface_diffusion_m2_per_day: float = 100.0  # D_O
    soil_speed_m_per_day: float = 1.0  # of soil water on a gradient of 1: saturated sandy loam conducts so much
    surface_speed_m_per_day: float = 140.0  # of surface water on a gradient of 1: 10 m/d on a hillside of 0.5%
    half_infiltration_gradient: float = 1.0  # of the ground, at which infiltration is halved; inf: no effect


class Fields(NamedTuple):
    """Water and what changes it, (rows, cols) each."""

    soil: Floats  # mm
    surface: Floats  # mm
    plants: Floats  # g/m2
    rain: Floats  # mm/d
    uptake: Floats  # mm, summed
    loss: Floats  # mm, summed


@compiled
def exchange(fields, sinks, rates, days, first, end):  # type: ignore[no-untyped-def]
    """What happens to water within cells [first, end) of flat fields, in place.

    Surface water O decays exactly: dO/dt = R - f O, with f the rate of infiltration at the plants that stand there.
    Soil water W decays by the rate g B / (W + k1) + r, which is held at its value in the middle of the time (an
    exponential midpoint rule: second order, exact without plants, and at rest where the equations are). What leaves is
    what was there and came, less what is left: so water balances, and no time is too long.

    `sinks` is f, 1/d; `rates` are g_max, k1 and r_w.
    """
    soil, surface, plants, rain, uptake, loss = fields
    most, half, lost = rates
    for i in range(first, end):
        falls = rain[i] * days
        there = surface[i] + falls
        stays, mean = _decay(sinks[i] * days)
        left = surface[i] * stays + falls * mean
        left = left if left < there else there
        surface[i] = left
        comes, before = there - left, soil[i]
        drink = most * plants[i] / (before + half)
        middle = (before + 0.5 * comes) / (1.0 + 0.5 * days * (drink + lost))
        drink = most * plants[i] / (middle + half)
        rate = drink + lost
        there = before + comes
        stays, mean = _decay(rate * days)
        left = before * stays + comes * mean
        left = left if left < there else there
        soil[i] = left
        goes = there - left
        drunk = goes * (drink / rate) if rate > 0.0 else 0.0
        uptake[i] += drunk
        loss[i] += goes - drunk


@compiled
def _decay(x):  # type: ignore[no-untyped-def]
    """What is left after x of what was there, exp(-x), and on the mean of what comes meanwhile, (1 - exp(-x)) / x."""
    stays = math.exp(-x)
    if x < 1e-3:  # where the difference would be rounding
        return stays, 1.0 - x * (0.5 - x * (1.0 / 6.0 - x / 24.0))
    return stays, (1.0 - stays) / x


@dataclass(frozen=True)
class Water:
    """What there is of water, (rows, cols) each, mm."""

    soil_mm: Floats  # W: above the wilting point, in reach of roots
    surface_mm: Floats  # O


@dataclass(frozen=True)
class WaterBudget:
    """Where the water of a time came from and went, means over the ground, mm: rain = stored + uptake + loss."""

    start_mm: float  # on the surface and in the soil
    rain_mm: float = 0.0
    uptake_mm: float = 0.0
    loss_mm: float = 0.0  # evaporated from the ground, and drained

    def and_then(self, later: WaterBudget) -> WaterBudget:
        """The budget of this time and of the one after it."""
        rain, uptake, loss = later.rain_mm, later.uptake_mm, later.loss_mm
        return WaterBudget(self.start_mm, self.rain_mm + rain, self.uptake_mm + uptake, self.loss_mm + loss)


@dataclass(frozen=True)
class Passed:
    """What a time brought."""

    water: Water  # at its end
    uptake_mm: Floats  # (rows, cols) by plants
    loss_mm: Floats  # (rows, cols) evaporated from the ground, and drained
    budget: WaterBudget


class SoilWater:
    """The soil of one ground. It holds what follows from the ground and the parameters, and no state."""

    def __init__(self, ground: Ground, parameters: SoilWaterParameters | None = None) -> None:
        self.ground = ground
        self.parameters = p = parameters or SoilWaterParameters()
        self._surface = Transport(ground, p.surface_diffusion_m2_per_day, p.surface_speed_m_per_day, _MANNING)
        self._soil = Transport(ground, p.soil_diffusion_m2_per_day, p.soil_speed_m_per_day)
        self._level = 1.0 / (1.0 + ground.steepness() / p.half_infiltration_gradient)

    def advance(
        self, water: Water, days: float, *, plants_g_per_m2: Map, rain_mm_per_day: Map, substep_days: float = 0.5
    ) -> Passed:
        """The water after a time in which plants and rain, maps or one number each, stay as they are."""
        shape = self.ground.shape
        maps = (water.soil_mm, water.surface_mm, plants_g_per_m2, rain_mm_per_day)
        soil, surface, plants, rain = (np.array(np.broadcast_to(one, shape), dtype=np.float64) for one in maps)
        start_mm = _mean(soil) + _mean(surface)
        uptake, loss = np.zeros(shape), np.zeros(shape)
        count = math.ceil(days / substep_days * (1 - 1e-12))
        fields = Fields(soil, surface, plants, rain, uptake, loss)
        soil, surface = self.substeps(fields, days / count, count)
        budget = WaterBudget(start_mm, _mean(rain) * days, _mean(uptake), _mean(loss))
        return Passed(Water(soil, surface), uptake, loss, budget)

    def substeps(self, fields: Fields, days: float, count: int) -> tuple[Floats, Floats]:
        """Soil and surface water after so many sub-steps of so many days; nothing is checked.

        The arrays that are given hold anything afterwards, but for plants and rain.
        """
        p, plants, half = self.parameters, fields.plants, self.parameters.half_infiltration_g_per_m2
        sinks = p.infiltration_per_day * self._level * (plants + half * p.bare_infiltration) / (plants + half)
        self._exchange(fields, sinks, 0.5 * days)
        for number in range(count):
            soil, surface = self._soil.over(fields.soil, days), self._surface.over(fields.surface, days)
            fields = fields._replace(soil=soil, surface=surface)
            self._exchange(fields, sinks, days if number + 1 < count else 0.5 * days)
        return fields.soil, fields.surface

    def _exchange(self, fields: Fields, sinks: Floats, days: float) -> None:
        p = self.parameters
        flat, flat_sinks = Fields(*(one.reshape(-1, copy=False) for one in fields)), sinks.reshape(-1, copy=False)
        rates = (p.uptake_mm_m2_per_g_day, p.half_uptake_mm, p.loss_per_day)
        parallel_for(sinks.size, lambda first, end: exchange(flat, flat_sinks, rates, days, first, end))


def _mean(field: Floats) -> float:
    return float(np.add.reduce(field, axis=None)) / field.size
