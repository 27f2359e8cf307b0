"""The state of an ecoclimate: its forest, its water, and what the year behind was like."""

from __future__ import annotations

from dataclasses import dataclass

from forestgen.community.branch_modules.kinds import kinds_at
from forestgen.community.branch_modules.state import State
from forestgen.community.ecoclimate.parameters import EcoclimateParameters
from forestgen.community.soil_water.ground import Floats
from forestgen.community.soil_water.model import Water


@dataclass(frozen=True)
class Books:
    """Where the water went since the beginning, means over the ground, mm: rain = stored + uptake + loss."""

    start_mm: float  # on the surface and in the soil
    rain_mm: float = 0.0
    uptake_mm: float = 0.0
    loss_mm: float = 0.0

    def error_mm(self, stored_mm: float) -> float:
        """What was made of nothing, with so much on the surface and in the soil now."""
        return stored_mm + self.uptake_mm + self.loss_mm - self.rain_mm - self.start_mm


@dataclass(frozen=True)
class Ecoclimate:
    """Everything that the future of a simulation depends on."""

    forest: State
    water: Water
    soil_mean_mm: Floats  # (rows, cols) soil water over the memory of plants
    temperature_mean_c: float  # the same of the region's temperature at z = 0
    warmth_mean_k: Floats  # (rows, cols) the same of the place's own warmth
    vapour_mm_per_day: Floats  # (rows, cols) what the ground gave to the air in the last month
    wetness: Floats  # (rows, cols) last month's rain over the region's
    books: Books

    @property
    def parameters(self) -> EcoclimateParameters:
        """What the next step goes by: with the recipe's changes up to now."""
        return parameters_of(self.forest)

    @property
    def stored_mm(self) -> float:
        """Mean water on the surface and in the soil."""
        return float(self.water.soil_mm.mean() + self.water.surface_mm.mean())


def parameters_of(forest: State) -> EcoclimateParameters:
    """The parameters at a forest's step, with the recipe's changes up to it."""
    parameters = kinds_at(forest).parameters
    assert isinstance(parameters, EcoclimateParameters)
    return parameters
