"""The soil model (seeds 002, section 4.5.6): water on the surface and in the soil, over a month or any other time.

    dO/dt = R - f O                           + D_O ΔO - div(v_O O)
    dW/dt =     f O - g W / (W + k1) B - r W  + D_W ΔW - div(v_W W)
    f = α (B + k2 W0) / (B + k2) / (1 + |grad z| / s)
    v_W = -V_W grad z                           v_O = -V_O grad z / sqrt(|grad z|)

O and W are surface and soil water, mm; R rain, mm/d; B plants, g/m2; z the ground's height. Two misprints of Eqs. 43
and 44 are put right: infiltration saturates with plants, as in the works that they cite, not with soil water, whose
unit does not fit; and what runs downhill leaves one cell and enters the next (a divergence). The last factor of f is
section 4.7.2.1's "infiltration is diminishing with the steepness of slopes". The seeds leave both v open: soil water
follows Darcy's law, surface water Manning's, in which speed goes with the root of the slope.

A time is cut into equal sub-steps of at most `substep_days`. In each, half an `exchange` within the cells, then
`Transport` between them, then the other half (Strang: second order where the ground is a plane). Sub-steps serve
accuracy alone: any length is stable, keeps all water and makes nothing negative. At the default of half a day the two
waters of a pattern of 40 m are right to 1%, and those of longer waves better.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.community.soil_water.ground import Floats, Ground, checked_map
from forestgen.community.soil_water.parameters import SoilWaterParameters
from forestgen.community.soil_water.transport import Transport
from forestgen.core.compiled import compiled
from forestgen.core.threads import over_ranges

Map = NDArray[np.floating] | float
SUBSTEP_DAYS = 0.5
_MANNING = 0.5  # power of the gradient


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
class Budget:
    """Where the water of a time came from and went, means over the ground, mm."""

    before_mm: float  # on the surface and in the soil
    rain_mm: float
    uptake_mm: float
    loss_mm: float  # evaporated from the ground, and drained
    after_mm: float

    @property
    def error_mm(self) -> float:
        """What was made of nothing: rounding."""
        return math.fsum((self.after_mm, self.uptake_mm, self.loss_mm, -self.before_mm, -self.rain_mm))


@dataclass(frozen=True)
class Passed:
    """What a time brought."""

    water: Water  # at its end
    uptake_mm: Floats  # (rows, cols) by plants
    loss_mm: Floats  # (rows, cols) evaporated from the ground, and drained
    budget: Budget


class SoilWater:
    """The soil of one ground. It holds what follows from the ground and the parameters, and no state."""

    def __init__(self, ground: Ground, parameters: SoilWaterParameters | None = None) -> None:
        self.ground = ground
        self.parameters = p = parameters or SoilWaterParameters()
        self._surface = Transport(ground, p.surface_diffusion_m2_per_day, p.surface_speed_m_per_day, _MANNING)
        self._soil = Transport(ground, p.soil_diffusion_m2_per_day, p.soil_speed_m_per_day)
        self._level = 1.0 / (1.0 + ground.steepness() / p.half_infiltration_gradient)

    def dry(self) -> Water:
        """No water anywhere."""
        return Water(np.zeros(self.ground.shape), np.zeros(self.ground.shape))

    def advance(
        self,
        water: Water,
        days: float,
        *,
        plants_g_per_m2: Map,
        rain_mm_per_day: Map,
        substep_days: float = SUBSTEP_DAYS,
    ) -> Passed:
        """The water after a time in which plants and rain stay as they are.

        Raises
        ------
        ValueError : a map of another shape, or with a value that is negative or not finite; a time that is not above 0.
        """
        for name, value in (("days", days), ("substep_days", substep_days)):
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name}: expected a finite number above 0, got {value!r}")
        shape = self.ground.shape
        soil = checked_map("soil_mm", water.soil_mm, shape)
        surface = checked_map("surface_mm", water.surface_mm, shape)
        plants = checked_map("plants_g_per_m2", plants_g_per_m2, shape)
        rain = checked_map("rain_mm_per_day", rain_mm_per_day, shape)
        before_mm = _mean(soil) + _mean(surface)
        uptake, loss = np.zeros(shape), np.zeros(shape)
        count = math.ceil(days / substep_days * (1 - 1e-12))
        fields = Fields(soil, surface, plants, rain, uptake, loss)
        soil, surface = self.substeps(fields, days / count, count)
        after_mm = _mean(soil) + _mean(surface)
        budget = Budget(before_mm, _mean(rain) * days, _mean(uptake), _mean(loss), after_mm)
        return Passed(Water(soil, surface), uptake, loss, budget)

    def substeps(self, fields: Fields, days: float, count: int) -> tuple[Floats, Floats]:
        """Soil and surface water after so many sub-steps of so many days; nothing is checked.

        The arrays that are given hold anything afterwards, but for plants and rain.
        """
        sinks = self._infiltration_per_day(fields.plants)
        self._exchange(fields, sinks, 0.5 * days)
        for number in range(count):
            soil, surface = self._soil.over(fields.soil, days), self._surface.over(fields.surface, days)
            fields = fields._replace(soil=soil, surface=surface)
            self._exchange(fields, sinks, days if number + 1 < count else 0.5 * days)
        return fields.soil, fields.surface

    def _infiltration_per_day(self, plants: Floats) -> Floats:
        p = self.parameters
        half = p.half_infiltration_g_per_m2
        return np.asarray(
            p.infiltration_per_day * self._level * (plants + half * p.bare_infiltration) / (plants + half)
        )

    def _exchange(self, fields: Fields, sinks: Floats, days: float) -> None:
        p = self.parameters
        flat, flat_sinks = Fields(*(one.reshape(-1, copy=False) for one in fields)), sinks.reshape(-1, copy=False)
        rates = (p.uptake_mm_m2_per_g_day, p.half_uptake_mm, p.loss_per_day)
        over_ranges(sinks.size, lambda first, end: exchange(flat, flat_sinks, rates, days, first, end))


def _mean(field: Floats) -> float:
    return float(np.add.reduce(field, axis=None)) / field.size
