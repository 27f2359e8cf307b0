"""Soundings as tables: CSV files of one row a height, from the ground up.

| column | unit | |
|---|---|---|
| height_m | m above the ground, the first 0, rising | needed |
| temperature_c | °C | needed |
| relative_humidity | 0 to 1, over water | one of these three, |
| dewpoint_c | °C | |
| vapour_g_per_kg | g of vapour per kg of dry air | or none: dry |
| wind_from_deg, wind_m_per_s | clockwise from north, where it comes from; speed | both, |
| east_m_per_s, north_m_per_s | where it blows to | or these, or none: calm |

The first line names the columns, in any order. Empty lines and lines that begin with # are passed over.

    height_m,temperature_c,relative_humidity
    0,22,0.46
    1400,8.3,0.98
    2400,1.3,0.6
"""

from __future__ import annotations

import csv
import difflib
import io

import numpy as np

from forestgen.atmosphere.field_checks import FieldError
from forestgen.atmosphere.sounding import Floats, Sounding, first_fault, saturation_ratio

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


def sounding_of_table(data: bytes, ground_pressure_pa: float = 101_325.0) -> Sounding:
    """The sounding of a CSV file's bytes.

    Raises
    ------
    FieldError : with line and column, what was expected, and what was got.
    """
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
    if fault is None:
        return
    place = "" if fault.level is None else f"line {lines[fault.level]}, "
    named = next((name for name in _COLUMN_OF.get(fault.what, ()) if name in columns), None)
    what = fault.what if named is None or fault.what.startswith(named) else f"column {named}: {fault.what}"
    raise FieldError(f"{place}{what}", fault.expected, fault.got)
