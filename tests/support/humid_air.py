"""Humid air: mixtures, a thermal's temperature and buoyancy, saturation and latent heat (seeds' Eqs. 18 to 31).

| quantity | symbol | unit | value |
|---|---|---|---|
| molar mass of dry air, of water | M_air, M_W | kg/kmol | 28.96, 18.02 (Eqs. 18, 19) |
| isentropic exponent of air, of vapour | gamma | | 1.4, 1.33 |
| gas constant | R | J/(kmol K) | 8314 (the print of Eq. 27 says J/(g K)) |
| latent heat of condensation | L | J/kg | 2.5e6 (Eq. 34's print lacks the exponent) |

All functions take numbers or arrays of one shape. Pressures are Pa, temperatures K, ratios kg/kg.

Mass ratio q (water over dry air), mass fraction Y (water over all) and mole fraction X are kept apart. What was decided
where the print is wrong or unclear:

- Eq. 22, X = q / (q + 1), gives the mass fraction Y (`mass_fraction_of_ratio`). The mole fraction follows from it by
  Eq. 21 (`mole_fraction_of_ratio`).
- Eq. 24 weighs the exponents by mass. Exactly, 1 / (gamma - 1) is weighed by moles; Eq. 24 is within 0.1% of that up to
  20 g/kg, and is what is used.
- Eq. 28 does follow from Eqs. 26 and 27: at one pressure, density goes as M / T, so the ratio is
  (M_air T_th) / (M_th T_air). The air around is dry in the paper; here it may hold vapour, which makes it lighter too.
- Eq. 29 takes degrees Celsius and Pa; here it takes K (`sounding.saturation_ratio`). Its 380.16 Pa is
  0.622 x 611.2 Pa: the vapour pressure itself is Bolton's (`saturation_pressure_pa`).
- Eq. 30 adds the latent heat of all that has condensed to the dry temperature at the end. But heat set free low down
  lifts and cools again. So its differential, c_p dT = R T dp / p - L dq, is integrated along the way (`moist_adiabat`).
  What condenses falls out of the balance: droplets carry no heat and no weight.
"""

from __future__ import annotations

import math

import numpy as np

from forestgen.atmosphere.sounding import (
    AIR_KG_PER_KMOL,
    COLDEST_C,
    GAS_CONSTANT_AIR_J_PER_KG_K,
    GAS_CONSTANT_J_PER_KMOL_K,
    GRAVITY_M_PER_S2,
    LATENT_HEAT_J_PER_KG,
    WATER_KG_PER_KMOL,
    Floats,
)

AIR_GAMMA = 1.4
VAPOUR_GAMMA = 1.33
_MASSES = WATER_KG_PER_KMOL / AIR_KG_PER_KMOL
_LARGEST_STEP = 0.01  # of log pressure along a moist adiabat: 80 m

_Value = Floats | float


def mass_fraction_of_ratio(ratio: _Value) -> Floats:
    """Y = q / (q + 1): water's share of the mass (Eq. 22, of which see the module's page)."""
    return np.asarray(ratio / (1.0 + np.asarray(ratio)))


def mole_fraction_of_ratio(ratio: _Value) -> Floats:
    """X: water's share of the molecules (Eqs. 21 and 22)."""
    moles = np.asarray(ratio) / WATER_KG_PER_KMOL
    return np.asarray(moles / (moles + 1.0 / AIR_KG_PER_KMOL))


def molar_mass(mole_fraction: _Value) -> Floats:
    """kg/kmol of air with a mole fraction X of vapour (Eq. 20)."""
    x = np.asarray(mole_fraction)
    return np.asarray(x * WATER_KG_PER_KMOL + (1.0 - x) * AIR_KG_PER_KMOL)


def isentropic_exponent(mass_fraction: _Value) -> Floats:
    """gamma of air with a mass fraction Y of vapour (Eq. 24)."""
    y = np.asarray(mass_fraction)
    return np.asarray(y * VAPOUR_GAMMA + (1.0 - y) * AIR_GAMMA)


def heat_capacity_j_per_kg_k(vapour: _Value) -> Floats:
    """At constant pressure, of the gas of a mass ratio of vapour (Eq. 31)."""
    gamma = isentropic_exponent(mass_fraction_of_ratio(vapour))
    mass = molar_mass(mole_fraction_of_ratio(vapour))
    return np.asarray(gamma * GAS_CONSTANT_J_PER_KMOL_K / (mass * (gamma - 1.0)))


def density_kg_per_m3(temperature_k: _Value, pressure_pa: _Value, vapour: _Value = 0.0) -> Floats:
    """Of air with a mass ratio of vapour (Eq. 27)."""
    mass = molar_mass(mole_fraction_of_ratio(vapour))
    return np.asarray(np.asarray(pressure_pa) * mass / (GAS_CONSTANT_J_PER_KMOL_K * np.asarray(temperature_k)))


def dry_adiabat(temperature_k: _Value, from_pa: _Value, to_pa: _Value, vapour: _Value = 0.0) -> Floats:
    """Temperature of air that went from one pressure to another without condensation (Eq. 23), K."""
    gamma = isentropic_exponent(mass_fraction_of_ratio(vapour))
    return np.asarray(temperature_k * (np.asarray(to_pa) / from_pa) ** ((gamma - 1.0) / gamma))


def buoyancy_m_per_s2(thermal_k: _Value, thermal_vapour: _Value, air_k: _Value, air_vapour: _Value = 0.0) -> Floats:
    """Acceleration of a thermal by its lift (Eq. 28), positive upwards.

    Parameters
    ----------
    thermal_k, air_k : temperatures of the thermal and of the air around it, at one pressure.
    thermal_vapour, air_vapour : their mass ratios of vapour, kg/kg.
    """
    masses = molar_mass(mole_fraction_of_ratio(air_vapour)) / molar_mass(mole_fraction_of_ratio(thermal_vapour))
    return np.asarray(GRAVITY_M_PER_S2 * (masses * np.asarray(thermal_k) / np.asarray(air_k) - 1.0))


def saturation_pressure_pa(temperature_k: _Value) -> Floats:
    """Partial pressure of vapour over water at which air is saturated (Bolton 1980; within 0.1% from -35 to 35 °C)."""
    celsius = np.maximum(np.asarray(temperature_k) - 273.15, COLDEST_C)
    return np.asarray(611.2 * np.exp(17.67 * celsius / (celsius + 243.5)))


def moist_adiabat(temperature_k: float, from_pa: float, pressures_pa: Floats) -> Floats:
    """Temperatures of air that stays saturated while its pressure falls, its condensate left behind.

    c_p dT = R T dp / p - L dq, with q = 0.622 e / (p - e), by fourth-order Runge-Kutta steps in log p. The exact ratio
    is worth it here: Eq. 29's, without the - e, ends 0.3 K colder at 600 hPa.

    Parameters
    ----------
    temperature_k, from_pa : where the air starts, saturated.
    pressures_pa : (N,) falling, none above `from_pa`.

    Returns
    -------
    (N,) K.
    """
    pressures = np.asarray(pressures_pa, dtype=np.float64)
    if len(pressures) and (pressures[0] > from_pa or np.any(np.diff(pressures) > 0.0)):
        raise ValueError("a moist adiabat is followed upwards: expected pressures that fall from its start")
    out = np.empty(len(pressures))
    warmth, at = float(temperature_k), math.log(from_pa)
    for k, goal in enumerate(np.log(pressures)):
        steps = max(1, math.ceil((at - goal) / _LARGEST_STEP))
        width = (goal - at) / steps
        for _ in range(steps):
            warmth = _runge_kutta(warmth, at, width)
            at += width
        at = float(goal)
        out[k] = warmth
    return out


def _runge_kutta(warmth: float, at: float, width: float) -> float:
    first = _moist_slope(warmth, at)
    second = _moist_slope(warmth + 0.5 * width * first, at + 0.5 * width)
    third = _moist_slope(warmth + 0.5 * width * second, at + 0.5 * width)
    fourth = _moist_slope(warmth + width * third, at + width)
    return warmth + width / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)


def _moist_slope(warmth: float, log_pa: float) -> float:
    """dT / d log p along a moist adiabat. In plain numbers: arrays of one would take ten times as long."""
    celsius = max(warmth - 273.15, COLDEST_C)
    pressure = 611.2 * math.exp(17.67 * celsius / (celsius + 243.5))
    ratio = _MASSES * pressure / (math.exp(log_pa) - pressure)
    growth = 17.67 * 243.5 / (celsius + 243.5) ** 2  # d log e / dT
    heat = LATENT_HEAT_J_PER_KG * ratio * (1.0 + ratio / _MASSES)  # L dq / d log e = -L dq / d log p
    capacity = AIR_GAMMA / (AIR_GAMMA - 1.0) * GAS_CONSTANT_AIR_J_PER_KG_K
    return (GAS_CONSTANT_AIR_J_PER_KG_K * warmth + heat) / (capacity + heat * growth)
