"""Air at rest: temperature, pressure, density, vapour and wind by height (seeds' Eqs. 14 to 17, any number of layers).

| quantity | symbol | unit | value |
|---|---|---|---|
| standard gravity | g | m/s2 | 9.80665; the paper rounds it to 9.81 |
| gas constant | R | J/(kmol K) | 8314 |
| molar mass of dry air | M | kg/kmol | 28.96 (Eq. 18) |
| molar mass of water | M_W | kg/kmol | 18.02 (Eq. 19) |
| latent heat of condensation | L | J/kg | 2.5e6 (Eq. 34's print lacks the exponent) |
| lapse rate | dT/dz | K/m | negative where it cools upwards; ISA's troposphere: -0.0065 |

What was decided where the print is wrong or silent:

- Eq. 16 with its minus sign takes the magnitude of the lapse rate. Here a lapse rate is dT/dz, with its sign.
- The first half of Eq. 17's second line keeps the lower layer's rate; its second half is right, and is used.
- Gravity falls with height, 0.35% over 11 km, which would cost the pressure there 0.3%. So temperature is linear in
  geopotential height, `geopotential_m`, which is how the International Standard Atmosphere (ISO 2533) is defined, and
  the hydrostatic equation is then integrated exactly in every layer. ISA's values come out to 0.02%.
- Saturation is over water, at all temperatures (Eq. 29), by the approximation q = 0.622 e / p. The exact ratio divides
  by p - e: 2% more at 18 °C, 4% more at 30 °C.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

GRAVITY_M_PER_S2 = 9.80665
GAS_CONSTANT_J_PER_KMOL_K = 8314.0
AIR_KG_PER_KMOL = 28.96
WATER_KG_PER_KMOL = 18.02
LATENT_HEAT_J_PER_KG = 2.5e6  # of evaporation and condensation
GAS_CONSTANT_AIR_J_PER_KG_K = GAS_CONSTANT_J_PER_KMOL_K / AIR_KG_PER_KMOL
AIR_EXPONENT = 0.4 / 1.4  # (gamma - 1) / gamma
COLDEST_C = -200.0  # saturation is that of here if it is colder: the formula has a pole at -243.5
REFERENCE_PA = 100_000.0  # of potential temperature
EARTH_RADIUS_M = 6_356_766.0  # of ISO 2533: what makes its gravity fall with height
AUTOCONVECTION_K_PER_M = -GRAVITY_M_PER_S2 / GAS_CONSTANT_AIR_J_PER_KG_K  # dT/dz at which density no longer falls

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Sounding:
    """A column of air in hydrostatic balance. Temperature, vapour and wind are linear between the heights.

    Nothing is checked here: see `check_sounding`.
    """

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

        Rates are by metre of geopotential height; above `top_m` the temperature stays as it is.
        """
        height = np.array([0.0, inversion_m, max(top_m, inversion_m + 1.0)])
        rates = np.array([lapse_rate_k_per_m, lapse_rate_above_k_per_m])
        steps = rates * np.diff(geopotential_m(height))
        temperature = ground_temperature_k + np.concatenate([[0.0], np.cumsum(steps)])
        fine = np.unique(np.concatenate([np.linspace(0.0, height[-1], 401), height]))
        warmth = np.interp(geopotential_m(fine), geopotential_m(height), temperature)
        dry = cls(fine, warmth, 0 * fine, np.zeros((len(fine), 2)), ground_pressure_pa)
        vapour = relative_humidity * saturation_ratio(dry.temperature_k, dry.pressure_at(fine))
        return replace(dry, vapour=vapour, wind_m_per_s=np.tile(np.asarray(wind_m_per_s, dtype=float), (len(fine), 1)))

    @classmethod
    def standard(cls) -> Sounding:
        """ISA's troposphere and the isothermal layer over it: dry, 15 °C at the ground, -6.5 K/km up to 11 km."""
        top = EARTH_RADIUS_M * 11_000.0 / (EARTH_RADIUS_M - 11_000.0)  # 11 km of geopotential height
        return cls.of_lapse_rates(
            ground_temperature_k=288.15, lapse_rate_k_per_m=-0.0065, inversion_m=top, lapse_rate_above_k_per_m=0.0
        )

    def temperature_at(self, height_m: Floats | float) -> Floats:
        """K."""
        return np.asarray(np.interp(geopotential_m(height_m), geopotential_m(self.height_m), self.temperature_k))

    def pressure_at(self, height_m: Floats | float) -> Floats:
        """Pa: the hydrostatic equation, exact in each layer (Eq. 16)."""
        z = np.asarray(height_m, dtype=np.float64)
        levels = _fall(self.temperature_k[:-1], self.temperature_k[1:], np.diff(geopotential_m(self.height_m)))
        log_p = np.concatenate([[0.0], np.cumsum(levels)])
        layer = np.clip(np.searchsorted(self.height_m, z, side="right") - 1, 0, len(self.height_m) - 1)
        above = geopotential_m(z) - geopotential_m(self.height_m[layer])
        own = _fall(self.temperature_k[layer], self.temperature_at(z), above)
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

    def relative_humidity_at(self, height_m: Floats | float) -> Floats:
        """Vapour over its mass ratio at saturation, 0 to 1."""
        return self.vapour_at(height_m) / saturation_ratio(self.temperature_at(height_m), self.pressure_at(height_m))

    def wind_at(self, height_m: Floats | float) -> Floats:
        """(..., 2) m/s."""
        return np.stack([np.interp(height_m, self.height_m, self.wind_m_per_s[:, k]) for k in range(2)], axis=-1)


def geopotential_m(height_m: Floats | float) -> Floats:
    """Height in a field of constant gravity with the same potential energy (ISO 2533), m."""
    z = np.asarray(height_m, dtype=np.float64)
    return np.asarray(EARTH_RADIUS_M * z / (EARTH_RADIUS_M + z))


def _fall(low_k: Floats, high_k: Floats, thickness_m: Floats) -> Floats:
    """log(p_high / p_low) of a layer whose temperature is linear: -g thickness / (R x logarithmic mean of T)."""
    ratio = high_k / low_k - 1.0
    small = np.abs(ratio) < 1e-6
    mean = low_k * np.where(small, 1.0 + ratio / 2, ratio / np.where(small, 1.0, np.log1p(np.where(small, 1.0, ratio))))
    return np.asarray(-GRAVITY_M_PER_S2 * thickness_m / (GAS_CONSTANT_AIR_J_PER_KG_K * mean))


def saturation_ratio(temperature_k: Floats | float, pressure_pa: Floats | float) -> Floats:
    """Mass ratio of vapour at which air is saturated over water, kg/kg (Eq. 29; Bolton 1980)."""
    celsius = np.maximum(np.asarray(temperature_k) - 273.15, COLDEST_C)
    return np.asarray(380.16 / np.asarray(pressure_pa) * np.exp(17.67 * celsius / (celsius + 243.5)))


@dataclass(frozen=True)
class SoundingFault:
    """What is wrong with a sounding, in words, and at which level."""

    what: str  # the quantity, in a recipe's or a table's words
    expected: str
    got: str
    level: int | None = None  # index of the height; None: the sounding as a whole


def check_sounding(sounding: Sounding) -> None:
    """Refuse air that cannot be.

    Raises
    ------
    ValueError : heights that do not rise from 0, values that are no numbers or out of all weather, air that holds more
        vapour than it can, or is heavier above than below. The message says where, what was expected, what was got.
    """
    fault = first_fault(sounding)
    if fault is not None:
        where = "" if fault.level is None else f" at {sounding.height_m[fault.level]:g} m"
        raise ValueError(f"the sounding{where}: {fault.what}: expected {fault.expected}, got {fault.got}")


def first_fault(sounding: Sounding) -> SoundingFault | None:
    """The first thing that is wrong with a sounding, from the form of the table to the physics; None: nothing."""
    return _fault_of_form(sounding) or _fault_of_values(sounding) or _fault_of_physics(sounding)


def _fault_of_form(sounding: Sounding) -> SoundingFault | None:
    n = len(sounding.height_m)
    if n < 2:
        return SoundingFault("levels", "at least two heights", str(n))
    wanted = {"temperature_k": (n,), "vapour": (n,), "wind_m_per_s": (n, 2)}
    for name, shape in wanted.items():
        if np.shape(getattr(sounding, name)) != shape:
            return SoundingFault(name, f"an array of {shape}", f"{np.shape(getattr(sounding, name))}")
    if not 30_000.0 <= sounding.ground_pressure_pa <= 120_000.0:
        expected = "300 to 1200 hPa"
        return SoundingFault("pressure at the ground", expected, f"{sounding.ground_pressure_pa / 100:g} hPa")
    return None


def _fault_of_values(sounding: Sounding) -> SoundingFault | None:
    speed = np.hypot(*sounding.wind_m_per_s.T)
    ranges = (
        ("height", sounding.height_m, 0.0, 100_000.0, "m"),
        ("temperature", sounding.temperature_k, 150.0, 350.0, "K"),
        ("vapour", sounding.vapour, 0.0, 0.2, "kg/kg"),
        ("wind", speed, 0.0, 150.0, "m/s"),
    )
    for name, values, low, high, unit in ranges:
        # not (inside): a NaN is outside of every range.
        if (bad := _first(~((values >= low) & (values <= high)))) is not None:
            return SoundingFault(name, f"{low:g} to {high:g} {unit}", f"{values[bad]:g} {unit}", bad)
    if sounding.height_m[0] != 0.0:
        return SoundingFault("first height", "0 m, the ground", f"{sounding.height_m[0]:g} m", 0)
    if (bad := _first(np.diff(sounding.height_m) <= 0.0)) is not None:
        above = f"more than the {sounding.height_m[bad]:g} m of the level before"
        return SoundingFault("height", above, f"{sounding.height_m[bad + 1]:g} m", bad + 1)
    return None


def _fault_of_physics(sounding: Sounding) -> SoundingFault | None:
    humidity = sounding.relative_humidity_at(sounding.height_m)
    if (bad := _first(humidity > 1.0 + 1e-6)) is not None:
        return SoundingFault("relative humidity", "at most 1", f"{humidity[bad]:.4g}: supersaturated", bad)
    lapse = np.diff(sounding.temperature_k) / np.diff(geopotential_m(sounding.height_m))
    if (bad := _first(lapse < AUTOCONVECTION_K_PER_M)) is not None:
        expected = f"at least {1000 * AUTOCONVECTION_K_PER_M:.1f} K/km (steeper, air is heavier above than below)"
        return SoundingFault("lapse rate dT/dz up to the next level", expected, f"{1000 * lapse[bad]:.4g} K/km", bad)
    return None


def _first(bad: NDArray[np.bool_]) -> int | None:
    """Index of the first True."""
    return int(np.argmax(bad)) if bad.any() else None
