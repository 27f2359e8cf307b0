"""Vegetation as a density that grows by the water it takes up, on the soil model alone (Rietkerk et al. 2002).

    dP/dt = c g W / (W + k1) P - d P + D_P ΔP

No tree and no weather: the yardstick for the coupled model, and its fastest experiment. Uniform states, exactly:

- bare:  P = 0, W = R / r, O = R / (α W0)
- grown: W* = k1 / (c g / d - 1), P* = c (R - r W*) / d, which is above 0 where R > r W*

A step is one sub-step of the soil's with the plants of its beginning; what they take up in it makes them grow, over an
exact decay. The split is of first order in the step, but a state at rest is one of the equations', whatever the step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from forestgen.community.soil_water import (
    Fields,
    Floats,
    Ground,
    Map,
    SoilWater,
    SoilWaterParameters,
    Transport,
    Water,
)

_NONE_G_PER_M2 = 1e-30


@dataclass(frozen=True)
class PlantParameters:
    """How plants as a density grow by the water that they take up, die and spread. All are 0 or more."""

    growth_g_per_mm_m2: float = 10.0  # c: of plants for a millimetre of water
    mortality_per_day: float = 0.25  # d
    diffusion_m2_per_day: float = 0.1  # D_P: seeds and runners


@dataclass(frozen=True)
class Vegetation:
    """Plants and water of one moment."""

    plants_g_per_m2: Floats  # (rows, cols)
    water: Water


@dataclass(frozen=True)
class UniformState:
    """The same everywhere, and at rest."""

    plants_g_per_m2: float
    soil_mm: float
    surface_mm: float


def bare_state(soil: SoilWaterParameters, rain_mm_per_day: float) -> UniformState:
    """Without plants, on level ground."""
    surface_mm = rain_mm_per_day / (soil.infiltration_per_day * soil.bare_infiltration)
    return UniformState(0.0, rain_mm_per_day / soil.loss_per_day, surface_mm)


def grown_state(soil: SoilWaterParameters, plants: PlantParameters, rain_mm_per_day: float) -> UniformState | None:
    """With plants, on level ground; None: there is not rain enough for them everywhere."""
    best = plants.growth_g_per_mm_m2 * soil.uptake_mm_m2_per_g_day
    if best <= plants.mortality_per_day or plants.mortality_per_day == 0:
        return None
    soil_mm = soil.half_uptake_mm / (best / plants.mortality_per_day - 1.0)
    density = plants.growth_g_per_mm_m2 * (rain_mm_per_day - soil.loss_per_day * soil_mm) / plants.mortality_per_day
    if density <= 0:
        return None
    half = soil.half_infiltration_g_per_m2
    share = (density + half * soil.bare_infiltration) / (density + half)
    return UniformState(density, soil_mm, rain_mm_per_day / (soil.infiltration_per_day * share))


class VegetationWater:
    """Plants and water on one ground; it holds no state."""

    def __init__(
        self, ground: Ground, soil: SoilWaterParameters | None = None, plants: PlantParameters | None = None
    ) -> None:
        self.soil = SoilWater(ground, soil)
        self.plants = plants or PlantParameters()
        self._spread = Transport(ground, self.plants.diffusion_m2_per_day)

    @property
    def ground(self) -> Ground:
        return self.soil.ground

    def of(self, state: UniformState) -> Vegetation:
        """A uniform state on this ground."""
        maps = (np.full(self.ground.shape, one) for one in (state.plants_g_per_m2, state.soil_mm, state.surface_mm))
        density, soil_mm, surface_mm = maps
        return Vegetation(density, Water(soil_mm, surface_mm))

    def sown(self, rng: np.random.Generator, rain_mm_per_day: float, *, share: float, g_per_m2: float) -> Vegetation:
        """Bare ground at rest, on which a share of the cells, chosen at random, has so many plants."""
        bare = self.of(bare_state(self.soil.parameters, rain_mm_per_day))
        return Vegetation(np.where(rng.random(self.ground.shape) < share, g_per_m2, 0.0), bare.water)

    def advance(self, state: Vegetation, days: float, *, rain_mm_per_day: Map, step_days: float = 0.5) -> Vegetation:
        """The state after a time of steady rain, in equal steps of at most `step_days`."""
        shape, p = self.ground.shape, self.plants
        maps = (state.plants_g_per_m2, state.water.soil_mm, state.water.surface_mm, rain_mm_per_day)
        density, soil, surface, rain = (np.array(np.broadcast_to(one, shape), dtype=np.float64) for one in maps)
        count = math.ceil(days / step_days * (1 - 1e-12))
        step = days / count
        dies = p.mortality_per_day * step
        stays = math.exp(-dies)
        grows = p.growth_g_per_mm_m2 * (-math.expm1(-dies) / dies if dies > 0 else 1.0)
        uptake, loss = np.empty(shape), np.zeros(shape)
        for _ in range(count):
            uptake[:] = 0.0
            soil, surface = self.soil.substeps(Fields(soil, surface, density, rain, uptake, loss), step, 1)
            density = self._spread.over(stays * density + grows * uptake, step)
            density[density < _NONE_G_PER_M2] = 0.0  # numbers that small are slow, and come from nothing that lives
        return Vegetation(density, Water(soil, surface))
