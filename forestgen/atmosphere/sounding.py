"""Air at rest: temperature, pressure, density and vapour by height (seeds' Eqs. 14 to 17, for any number of layers)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

GRAVITY_M_PER_S2 = 9.81
GAS_CONSTANT_J_PER_KMOL_K = 8314.0
AIR_KG_PER_KMOL = 28.96
GAS_CONSTANT_AIR_J_PER_KG_K = GAS_CONSTANT_J_PER_KMOL_K / AIR_KG_PER_KMOL
AIR_EXPONENT = 0.4 / 1.4  # (gamma - 1) / gamma
REFERENCE_PA = 100_000.0  # of potential temperature

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Sounding:
    """A column of air in hydrostatic balance. Temperature, vapour and wind are linear between the heights."""

    height_m: Floats  # (N,) above the ground, rising, the first 0; constant beyond the last
    temperature_k: Floats  # (N,)
    vapour: Floats  # (N,) kg/kg
    wind_m_per_s: Floats  # (N, 2) east, north
    ground_pressure_pa: float = 101_325.0

    @classmethod
    def of_lapse_rates(
        cls,
        *,
        ground_temperature_k: float,
        lapse_rate_k_per_m: float,
        inversion_m: float,
        lapse_rate_above_k_per_m: float,
        top_m: float = 20_000.0,
        relative_humidity: float = 0.0,
        ground_pressure_pa: float = 101_325.0,
        wind_m_per_s: tuple[float, float] = (0.0, 0.0),
    ) -> Sounding:
        """Two lapse rates dT/dz (negative: it cools upwards), below and above an inversion's height (Eq. 17).

        The print of Eq. 16 takes the lapse rate's magnitude, and Eq. 17's second line lacks the change of rate: see
        `pressure_at` and the temperatures below for what was meant.
        """
        height = np.array([0.0, inversion_m, max(top_m, inversion_m + 1.0)])
        rates = np.array([lapse_rate_k_per_m, lapse_rate_above_k_per_m])
        temperature = ground_temperature_k + np.concatenate([[0.0], np.cumsum(rates * np.diff(height))])
        fine = np.unique(np.concatenate([np.linspace(0.0, height[-1], 401), height]))
        dry = cls(fine, np.interp(fine, height, temperature), 0 * fine, np.zeros((len(fine), 2)), ground_pressure_pa)
        vapour = relative_humidity * saturation_ratio(dry.temperature_k, dry.pressure_at(fine))
        return replace(dry, vapour=vapour, wind_m_per_s=np.tile(np.asarray(wind_m_per_s, dtype=float), (len(fine), 1)))

    def temperature_at(self, height_m: Floats | float) -> Floats:
        """K."""
        return np.asarray(np.interp(height_m, self.height_m, self.temperature_k))

    def pressure_at(self, height_m: Floats | float) -> Floats:
        """Pa: the hydrostatic equation, exact in each layer (Eq. 16)."""
        z = np.asarray(height_m, dtype=np.float64)
        levels = _fall(self.temperature_k[:-1], self.temperature_k[1:], np.diff(self.height_m))
        log_p = np.concatenate([[0.0], np.cumsum(levels)])
        layer = np.clip(np.searchsorted(self.height_m, z, side="right") - 1, 0, len(self.height_m) - 1)
        own = _fall(self.temperature_k[layer], self.temperature_at(z), z - self.height_m[layer])
        return np.asarray(self.ground_pressure_pa * np.exp(log_p[layer] + own))

    def density_at(self, height_m: Floats | float) -> Floats:
        """kg/m3 of dry air."""
        return self.pressure_at(height_m) / (GAS_CONSTANT_AIR_J_PER_KG_K * self.temperature_at(height_m))

    def temperature_ratio_at(self, height_m: Floats | float) -> Floats:
        """T over potential temperature: Exner's function, (p / 100 000 Pa)^(R / c_p)."""
        return np.asarray((self.pressure_at(height_m) / REFERENCE_PA) ** AIR_EXPONENT)

    def potential_temperature_at(self, height_m: Floats | float) -> Floats:
        """K."""
        return self.temperature_at(height_m) / self.temperature_ratio_at(height_m)

    def vapour_at(self, height_m: Floats | float) -> Floats:
        """kg/kg."""
        return np.asarray(np.interp(height_m, self.height_m, self.vapour))

    def wind_at(self, height_m: Floats | float) -> Floats:
        """(..., 2) m/s."""
        return np.stack([np.interp(height_m, self.height_m, self.wind_m_per_s[:, k]) for k in range(2)], axis=-1)


def _fall(low_k: Floats, high_k: Floats, thickness_m: Floats) -> Floats:
    """log(p_high / p_low) of a layer whose temperature is linear: -g thickness / (R x logarithmic mean of T)."""
    ratio = high_k / low_k - 1.0
    small = np.abs(ratio) < 1e-6
    mean = low_k * np.where(small, 1.0 + ratio / 2, ratio / np.where(small, 1.0, np.log1p(np.where(small, 1.0, ratio))))
    return np.asarray(-GRAVITY_M_PER_S2 * thickness_m / (GAS_CONSTANT_AIR_J_PER_KG_K * mean))


def saturation_ratio(temperature_k: Floats, pressure_pa: Floats) -> Floats:
    """Mass ratio of vapour at which air is saturated over water, kg/kg (Eq. 29; Bolton 1980)."""
    celsius = np.asarray(temperature_k) - 273.15
    return np.asarray(380.16 / np.asarray(pressure_pa) * np.exp(17.67 * celsius / (celsius + 243.5)))
