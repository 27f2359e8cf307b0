"""Soundings by lapse rates, the standard atmosphere, and a check that air can be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from forestgen.atmosphere.sounding import EARTH_RADIUS_M, Sounding, first_fault, geopotential_m, saturation_ratio


def sounding_of_lapse_rates(
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

    Rates are by metre of geopotential height; above `top_m` the temperature stays as it is.
    """
    height = np.array([0.0, inversion_m, max(top_m, inversion_m + 1.0)])
    rates = np.array([lapse_rate_k_per_m, lapse_rate_above_k_per_m])
    steps = rates * np.diff(geopotential_m(height))
    temperature = ground_temperature_k + np.concatenate([[0.0], np.cumsum(steps)])
    fine = np.unique(np.concatenate([np.linspace(0.0, height[-1], 401), height]))
    warmth = np.interp(geopotential_m(fine), geopotential_m(height), temperature)
    dry = Sounding(fine, warmth, 0 * fine, np.zeros((len(fine), 2)), ground_pressure_pa)
    vapour = relative_humidity * saturation_ratio(dry.temperature_k, dry.pressure_at(fine))
    return replace(dry, vapour=vapour, wind_m_per_s=np.tile(np.asarray(wind_m_per_s, dtype=float), (len(fine), 1)))


def standard_sounding() -> Sounding:
    """ISA's troposphere and the isothermal layer over it: dry, 15 °C at the ground, -6.5 K/km up to 11 km."""
    top = EARTH_RADIUS_M * 11_000.0 / (EARTH_RADIUS_M - 11_000.0)  # 11 km of geopotential height
    return sounding_of_lapse_rates(
        ground_temperature_k=288.15, lapse_rate_k_per_m=-0.0065, inversion_m=top, lapse_rate_above_k_per_m=0.0
    )


def check_sounding(sounding: Sounding) -> None:
    """Raise ValueError for air that cannot be; the message says where, what was expected, what was got."""
    fault = first_fault(sounding)
    if fault is not None:
        where = "" if fault.level is None else f" at {sounding.height_m[fault.level]:g} m"
        raise ValueError(f"the sounding{where}: {fault.what}: expected {fault.expected}, got {fault.got}")
