"""Numbers of the soil model (seeds 002, Eqs. 43 and 44) and of vegetation as a density (Rietkerk et al. 2002).

The defaults are those of Rietkerk et al. 2002, which the seeds' references 67 and 68 share, but for three that neither
gives: both speeds downhill and `half_infiltration_gradient`.

References
----------
Rietkerk, Boerlijst, van Langevelde, HilleRisLambers, van de Koppel, Kumar, Prins and de Roos 2002, Self-organization of
vegetation in arid ecosystems, The American Naturalist 160 (4), 524-530.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields


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

    def __post_init__(self) -> None:
        _refuse_bad(self, positive=("half_uptake_mm", "half_infiltration_g_per_m2", "half_infiltration_gradient"))
        if self.bare_infiltration > 1:
            raise ValueError(f"bare_infiltration: expected a share from 0 to 1, got {self.bare_infiltration!r}")


@dataclass(frozen=True)
class PlantParameters:
    """How plants as a density grow by the water that they take up, die and spread. All are 0 or more."""

    growth_g_per_mm_m2: float = 10.0  # c: of plants for a millimetre of water
    mortality_per_day: float = 0.25  # d
    diffusion_m2_per_day: float = 0.1  # D_P: seeds and runners

    def __post_init__(self) -> None:
        _refuse_bad(self, positive=())


def _refuse_bad(parameters: SoilWaterParameters | PlantParameters, *, positive: tuple[str, ...]) -> None:
    for name in (one.name for one in fields(parameters)):
        value = getattr(parameters, name)
        endless = name == "half_infiltration_gradient" and value == math.inf
        if not (endless or (math.isfinite(value) and value >= 0 and (value > 0 or name not in positive))):
            least = "above 0" if name in positive else "of 0 or more"
            raise ValueError(f"{name}: expected a finite number {least}, got {value!r}")
