"""The air at rest, by layer: what the moving air is compared with.

Pressure, density and Exner's function come from the sounding and stay (Boussinesq). The flow has one density, that of
the lowest layer: so heat and vapour from the ground and rain on it are what they are in nature.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.sounding import (
    AIR_EXPONENT,
    AIR_KG_PER_KMOL,
    GAS_CONSTANT_AIR_J_PER_KG_K,
    REFERENCE_PA,
    WATER_KG_PER_KMOL,
    Sounding,
)
from forestgen.atmosphere.weather import AirGrid

HEAT_CAPACITY_J_PER_KG_K = GAS_CONSTANT_AIR_J_PER_KG_K / AIR_EXPONENT  # of dry air at constant pressure
VAPOUR_LIGHTNESS = AIR_KG_PER_KMOL / WATER_KG_PER_KMOL - 1  # 0.607: what a unit of vapour adds to virtual temperature

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Background:
    """Values of the layers' centres; `rise` at the faces between them."""

    potential_temperature_k: Floats  # (Z,)
    vapour: Floats  # (Z,) kg/kg
    wind_m_per_s: Floats  # (Z, 2)
    temperature_ratio: Floats  # (Z,) Exner's function
    density_kg_per_m3: Floats  # (Z,)
    pressure_pa: Floats  # (Z,)
    lift_per_k: Floats  # (Z + 1,) m/s2 of buoyancy per kelvin at the faces: g over potential temperature; 0 at the ends

    @property
    def flow_density_kg_per_m3(self) -> float:
        return float(self.density_kg_per_m3[0])


def background(grid: AirGrid, sounding: Sounding) -> Background:
    """The sounding in the grid's layers."""
    height = grid.layer_heights_m
    ratio = sounding.temperature_ratio_at(height)
    # g / theta at a face is c_p times the fall of Exner's function across it (hydrostatic balance): with this very
    # value the work of buoyancy and the change of enthalpy balance in the discrete equations too.
    lift = np.zeros(len(height) + 1)
    lift[1:-1] = HEAT_CAPACITY_J_PER_KG_K * -np.diff(ratio) / grid.cell_m[2]
    return Background(
        sounding.potential_temperature_at(height),
        sounding.vapour_at(height),
        sounding.wind_at(height),
        ratio,
        sounding.density_at(height),
        REFERENCE_PA * ratio ** (1 / AIR_EXPONENT),
        lift,
    )
