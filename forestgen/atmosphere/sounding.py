"""Air at rest: temperature, pressure, density, vapour and wind by height (seeds' Eqs. 14 to 17, any number of layers).

| quantity | symbol | unit | value |
|---|---|---|---|
| standard gravity | g | m/s2 | 9.80665; the paper rounds it to 9.81 |
| gas constant | R | J/(kmol K) | 8314 |
| molar mass of dry air, of water | M, M_W | kg/kmol | 28.96 (Eq. 18), 18.02 (Eq. 19) |
| latent heat of condensation | L | J/kg | 2.5e6 (Eq. 34's print lacks the exponent) |
| lapse rate | dT/dz | K/m | negative where it cools upwards; ISA's troposphere: -0.0065 |

What was decided where the print is wrong or silent:

- Eq. 16 with its minus sign takes the magnitude of the lapse rate. Here a lapse rate is dT/dz, with its sign.
- The first half of Eq. 17's second line keeps the lower layer's rate; its second half is right, and is used.
- Gravity falls with height, 0.35% over 11 km, which would cost the pressure there 0.3%. So temperature is linear in
  geopotential height, `geopotential_m`, as in the International Standard Atmosphere (ISO 2533), and the hydrostatic
  equation is integrated exactly in every layer. ISA's values come out to 0.02%.
- Saturation is over water, at all temperatures (Eq. 29), by the approximation q = 0.622 e / p. The exact ratio divides
  by p - e: 2% more at 18 °C, 4% more at 30 °C.

Tables
------
CSV files of one row a height, from the ground up; the first line names the columns, in any order. Empty lines and lines
that begin with # are passed over.

| column | unit | |
|---|---|---|
| height_m | m above the ground, the first 0, rising | needed |
| temperature_c | °C | needed |
| relative_humidity | 0 to 1, over water | one of these three, |
| dewpoint_c | °C | |
| vapour_g_per_kg | g of vapour per kg of dry air | or none: dry |
| wind_from_deg, wind_m_per_s | clockwise from north, where it comes from; speed | both, |
| east_m_per_s, north_m_per_s | where it blows to | or these, or none: calm |

    height_m,temperature_c,relative_humidity
    0,22,0.46
    1400,8.3,0.98
    2400,1.3,0.6
"""

from __future__ import annotations

import csv
import difflib
import io
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.grid import FieldError

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
_NEEDED = ("height_m", "temperature_c")
_HUMIDITY = ("relative_humidity", "dewpoint_c", "vapour_g_per_kg")
_WINDS = (("wind_from_deg", "wind_m_per_s"), ("east_m_per_s", "north_m_per_s"))
_COLUMNS = (*_NEEDED, *_HUMIDITY, *_WINDS[0], *_WINDS[1])
MOST_BYTES, _MOST_ROWS = 10_000_000, 100_000
# what a fault of a sounding is called -> the columns that it may be in
_COLUMN_OF = {
    "height": ("height_m",),
    "first height": ("height_m",),
    "temperature": ("temperature_c",),
    "lapse rate dT/dz up to the next level": ("temperature_c",),
    "relative humidity": _HUMIDITY,
    "vapour": _HUMIDITY,
    "wind": (*_WINDS[0], *_WINDS[1]),
}


@dataclass(frozen=True)
class Sounding:
    """A column of air in hydrostatic balance, linear between its heights; `first_fault` checks it."""

    height_m: Floats  # (N,) above the ground, rising, the first 0; constant beyond the last
    temperature_k: Floats  # (N,)
    vapour: Floats  # (N,) kg/kg
    wind_m_per_s: Floats  # (N, 2) east, north
    ground_pressure_pa: float = 101_325.0

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


def first_fault(sounding: Sounding) -> FieldError | None:
    """The first thing that is wrong with a sounding, from the form of the table to the physics; None: nothing."""
    if len(sounding.height_m) < 2:
        return FieldError("levels", "at least two heights", str(len(sounding.height_m)))
    if not 30_000.0 <= sounding.ground_pressure_pa <= 120_000.0:
        return FieldError("pressure at the ground", "300 to 1200 hPa", f"{sounding.ground_pressure_pa / 100:g} hPa")
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
            return FieldError(name, f"{low:g} to {high:g} {unit}", f"{values[bad]:g} {unit}", bad)
    if sounding.height_m[0] != 0.0:
        return FieldError("first height", "0 m, the ground", f"{sounding.height_m[0]:g} m", 0)
    if (bad := _first(np.diff(sounding.height_m) <= 0.0)) is not None:
        above = f"more than the {sounding.height_m[bad]:g} m of the level before"
        return FieldError("height", above, f"{sounding.height_m[bad + 1]:g} m", bad + 1)
    humidity = sounding.relative_humidity_at(sounding.height_m)
    if (bad := _first(humidity > 1.0 + 1e-6)) is not None:
        return FieldError("relative humidity", "at most 1", f"{humidity[bad]:.4g}: supersaturated", bad)
    lapse = np.diff(sounding.temperature_k) / np.diff(geopotential_m(sounding.height_m))
    if (bad := _first(lapse < AUTOCONVECTION_K_PER_M)) is not None:
        expected = f"at least {1000 * AUTOCONVECTION_K_PER_M:.1f} K/km (steeper, air is heavier above than below)"
        return FieldError("lapse rate dT/dz up to the next level", expected, f"{1000 * lapse[bad]:.4g} K/km", bad)
    return None


def _first(bad: NDArray[np.bool_]) -> int | None:
    """Index of the first True."""
    return int(np.argmax(bad)) if bad.any() else None


def sounding_of_table(data: bytes, ground_pressure_pa: float = 101_325.0) -> Sounding:
    """The sounding of a CSV file's bytes. `FieldError`: with line and column, what was expected, and what was got."""
    lines, columns = _columns(data)
    height, warmth = columns["height_m"], columns["temperature_c"] + 273.15
    still = np.zeros((len(height), 2))
    # Vapour needs the pressure, which the temperatures give: so these must be sound first.
    dry = Sounding(height, warmth, np.zeros_like(height), still, ground_pressure_pa)
    _check(dry, lines, columns)
    whole = Sounding(height, warmth, _vapour(dry, columns), _wind(columns, still), ground_pressure_pa)
    _check(whole, lines, columns)
    return whole


def _columns(data: bytes) -> tuple[list[int], dict[str, Floats]]:
    """The rows' lines, counted from 1, and each column's numbers."""
    if len(data) > MOST_BYTES:
        raise FieldError("the file", f"a table of at most {MOST_BYTES / 1e6:g} MB", "more")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as cause:
        raise FieldError("the file", "a table in UTF-8", f"other bytes at {cause.start}") from cause
    reader = csv.reader(io.StringIO(text))
    try:
        rows = [(reader.line_num, row) for row in reader if any(map(str.strip, row)) and not row[0].startswith("#")]
    except csv.Error as cause:
        raise FieldError(f"line {reader.line_num}", "a row of numbers with commas between", str(cause)) from cause
    if not rows:
        raise FieldError("the file", f"a first line of columns, such as {','.join(_NEEDED)}", "no line")
    names = [name.strip() for name in rows[0][1]]
    _check_names(names, rows[0][0])
    if not 2 <= len(rows) - 1 <= _MOST_ROWS:
        raise FieldError("the file", f"2 to {_MOST_ROWS:,} rows of numbers", f"{len(rows) - 1:,}")
    table = np.array([_numbers(line, row, names) for line, row in rows[1:]])
    return [line for line, _ in rows[1:]], dict(zip(names, table.T, strict=True))


def _check_names(names: list[str], line: int) -> None:
    for name in names:
        if name not in _COLUMNS:
            near = difflib.get_close_matches(name, _COLUMNS, n=1)
            meant = f"; do you mean {near[0]}?" if near else ""
            raise FieldError(f"line {line}, a column's name", f"one of {', '.join(_COLUMNS)}", f"{name!r}{meant}")
        if names.count(name) > 1:
            raise FieldError(f"line {line}, column {name}", "it once", f"{names.count(name)} times")
    for name in _NEEDED:
        if name not in names:
            raise FieldError(f"line {line}", f"a column {name}", ", ".join(names))
    humidity = [name for name in _HUMIDITY if name in names]
    if len(humidity) > 1:
        raise FieldError(f"line {line}", "one column of humidity", " and ".join(humidity))
    winds = [pair for pair in _WINDS if any(name in names for name in pair)]
    if len(winds) > 1 or any(name not in names for pair in winds for name in pair):
        got = ", ".join(name for pair in winds for name in pair if name in names)
        raise FieldError(f"line {line}", f"the wind as {' and '.join(_WINDS[0])}, or as {' and '.join(_WINDS[1])}", got)


def _numbers(line: int, row: list[str], names: list[str]) -> list[float]:
    if len(row) != len(names):
        raise FieldError(f"line {line}", f"{len(names)} numbers, one a column", f"{len(row)}")
    out = []
    for name, text in zip(names, row, strict=True):
        try:
            number = float(text)
        except ValueError:
            number = np.nan
        if not np.isfinite(number):
            raise FieldError(f"line {line}, column {name}", "a number", repr(text.strip()))
        out.append(number)
    return out


def _vapour(dry: Sounding, columns: dict[str, Floats]) -> Floats:
    pressure = dry.pressure_at(dry.height_m)
    if "relative_humidity" in columns:
        return np.asarray(columns["relative_humidity"] * saturation_ratio(dry.temperature_k, pressure))
    if "dewpoint_c" in columns:
        return saturation_ratio(np.maximum(columns["dewpoint_c"] + 273.15, 100.0), pressure)
    if "vapour_g_per_kg" in columns:
        return np.asarray(columns["vapour_g_per_kg"] / 1000.0)
    return dry.vapour


def _wind(columns: dict[str, Floats], still: Floats) -> Floats:
    if "wind_from_deg" in columns:
        angle = np.radians(columns["wind_from_deg"])
        towards = -np.stack([np.sin(angle), np.cos(angle)], axis=-1)
        return np.asarray(columns["wind_m_per_s"][:, None] * towards)
    if "east_m_per_s" in columns:
        return np.stack([columns["east_m_per_s"], columns["north_m_per_s"]], axis=-1)
    return still


def _check(sounding: Sounding, lines: list[int], columns: dict[str, Floats]) -> None:
    fault = first_fault(sounding)
    if fault is not None:
        place = "" if fault.level is None else f"line {lines[fault.level]}, "
        named = next((name for name in _COLUMN_OF.get(fault.what, ()) if name in columns), None)
        what = fault.what if named is None or fault.what.startswith(named) else f"column {named}: {fault.what}"
        raise FieldError(f"{place}{what}", fault.expected, fault.got)
