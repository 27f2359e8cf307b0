"""Spectra by name: reflectances and transmittances of leaves, bark and ground, and the responses of sensors.

A spectrum's file is a table of comma-separated values. Lines that begin with ``#`` tell where it comes from; then
come a header, whose first column is ``wavelength_nm``, and one row a wavelength, rising::

    # source: measured at the nursery's gate, beech, upper side
    # licence: CC0
    wavelength_nm,reflectance,transmittance
    400,0.0412,0.0005
    ...

Surfaces have columns ``reflectance`` and, if light passes, ``transmittance``; with ``_spring``, ``_summer``,
``_autumn`` or ``_dry`` behind them they hold for that season alone, and a plant's phenology mixes them. Sensors have
one column a band, of any name and scale. Names are those of files under ``scenes/spectra`` (``leaves/birch``) or paths
from the recipe's folder.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Literal, NoReturn

import numpy as np
from numpy.typing import NDArray

from forestgen.core.arguments import read_text
from forestgen.core.errors import AssetError
from forestgen.core.spectrum import Band, Spectrum
from forestgen.recipe.assets import find_asset, list_assets
from forestgen.recipe.suggestions import did_you_mean

Season = Literal["spring", "summer", "autumn", "dry"]
SEASONS: tuple[Season, ...] = ("spring", "summer", "autumn", "dry")
KIND = "spectra"
WAVELENGTH = "wavelength_nm"
VISIBLE_NM = (400.0, 700.0)  # what a surface's table must cover
RENDERED_NM = (300.0, 2500.0)  # what a band may answer to
MOST_BYTES = 4_000_000
MOST_ROWS = 20_000
MOST_COLUMNS = 64
_SENSORS = "responses/"
_BAND_NAME = re.compile(r"^[\w+()-][\w +()-]{0,39}$")  # of files and of channels: no slashes, no dots
_RESPONSES = (1e-12, 1e12)  # greatest of a band, in any scale: their squares are computed
_TOLERANCE = 1e-6  # of reflectance + transmittance: tables are rounded

Columns = dict[str, Spectrum]


def load_spectra(name: str) -> Columns:
    """The columns of a shipped table of a surface, such as ``leaves/birch``: see `surface_columns`."""
    path = find_asset(KIND, name)
    return surface_columns(table_text(path), str(path))


def load_bands(name: str, *, folder: Path | None = None, where: str | None = None) -> tuple[Band, ...]:
    """The bands of a sensor, in the order of its file.

    The name is a shipped sensor's without its folder (``sentinel2a`` is ``responses/sentinel2a``), or a path from
    `folder` (the recipe's; None: the working directory). `where` names the place in the recipe for messages.

    Raises
    ------
    AssetError : no such table, or one that no sensor can have; file, line, what was expected and found.
    """
    path = sensor_file(name, folder, where)
    return bands_of(table_text(path), str(path), where)


def sensor_file(name: str, folder: Path | None, where: str | None) -> Path:
    """The file of a sensor's table; a sensor's name does without its folder."""
    sensors = sensor_names()
    if name in sensors:
        name = f"{_SENSORS}{name}"
    elif "/" not in name and not name.endswith(".csv"):
        expected = f"one of {', '.join(sensors)}, or a path such as ./{name or 'name'}.csv"
        hint = did_you_mean(name, sensors)
        raise AssetError("no sensor has this name", where=where, expected=expected, got=repr(name), hint=hint)
    return find_asset(KIND, name, folder=folder, where=where)


def sensor_names() -> list[str]:
    """Names of the shipped sensors."""
    return [name.removeprefix(_SENSORS) for name in list_assets(KIND) if name.startswith(_SENSORS)]


def load_table(name: str) -> Columns:
    """The columns of any shipped table, such as ``standards/d65``."""
    path = find_asset(KIND, name)
    return _Table(table_text(path), str(path), None).spectra()


def of_season(columns: Columns, season: Season) -> tuple[Spectrum, Spectrum | None] | None:
    """(reflectance, transmittance or None) of a season, by its own columns or those of all seasons; None: neither."""
    for suffix in (f"_{season}", ""):
        if f"reflectance{suffix}" in columns:
            return columns[f"reflectance{suffix}"], columns.get(f"transmittance{suffix}")
    return None


def mixed(columns: Columns, weights: Sequence[float]) -> tuple[Spectrum, Spectrum | None]:
    """(reflectance, transmittance or None) of leaves of several seasons beside each other.

    `weights`: (4,) shares of `SEASONS`, of sum 1. A season that the table lacks counts as its first.
    """
    wanted = [(season, weight) for season, weight in zip(SEASONS, weights, strict=True) if weight > 0]
    parts = [(of_season(columns, season) or of_season(columns, seasons_of(columns)[0]), w) for season, w in wanted]
    found = [(*one, weight) for one, weight in parts if one is not None]
    if len(found) == 1:
        return found[0][:2]
    grid = found[0][0].wavelength_nm  # of the whole table
    reflectance = Spectrum(grid, np.asarray(sum(weight * r.value for r, _, weight in found)))
    if all(t is None for _, t, _ in found):
        return reflectance, None
    return reflectance, Spectrum(grid, np.asarray(sum(w * t.value for _, t, w in found if t is not None)))


def seasons_of(columns: Columns) -> list[Season]:
    """Seasons that a table serves."""
    return [season for season in SEASONS if of_season(columns, season) is not None]


def table_text(path: Path) -> str:
    """A table's text, if it can be one."""
    return read_text(path, "a table of spectra", most_bytes=MOST_BYTES, error=AssetError)


_SUFFIXES = ("", *(f"_{season}" for season in SEASONS))


@lru_cache(maxsize=256)
def surface_columns(text: str, file: str, where: str | None = None) -> Columns:
    """Columns of a surface's table from its text: reflectance, transmittance, perhaps by season; fractions of 1.

    `file` names it in messages, `where` the place in the recipe. Raises `AssetError`: no surface can have it; file,
    line, what was expected and found.
    """
    table = _Table(text, file, where)
    names = {f"{what}{suffix}" for what in ("reflectance", "transmittance") for suffix in _SUFFIXES}
    line = table.header_line
    for name in table.names:
        partner = name.replace("transmittance", "reflectance")
        if name not in names:
            expected = "reflectance and transmittance, or with _spring, _summer, _autumn, _dry behind them"
            table.fail(f"a surface has no column {name!r}", line=line, expected=expected)
        if partner not in table.names:
            table.fail(f"{name} without {partner}", line=line, expected=f"a column {partner}")
    nm, low, high = table.wavelength_nm, *VISIBLE_NM
    if nm[0] > low or nm[-1] < high:
        expected, got = f"from {low:g} nm or less to {high:g} nm or more", f"{nm[0]:g} to {nm[-1]:g} nm"
        table.fail_at(0 if nm[0] > low else -1, "the table leaves out visible light", expected=expected, got=got)
    _check_fractions(table)
    return table.spectra()


def _check_fractions(table: _Table) -> None:
    """Every value lies in [0, 1], and no more light leaves a surface than arrives, at every wavelength."""
    bad = np.argwhere((table.values < 0) | (table.values > 1))
    if len(bad):
        (row, column), columns = bad[0].tolist(), table.values
        value, name = columns[row, column], table.names[column]
        percent = value > 1 and columns.max() <= 100 and float(np.median(columns[:, column])) > 1
        got, hint = f"{value:g} at {table.wavelength_nm[row]:g} nm", "divide by 100: these look like percent"
        problem, expected = f"{name} outside of 0 to 1", "a fraction, 0 to 1"
        table.fail_at(row, problem, expected=expected, got=got, hint=hint if percent else None)
    for suffix in _SUFFIXES:
        names = f"reflectance{suffix}", f"transmittance{suffix}"
        if not set(names) <= set(table.names):
            continue
        r, t = (table.values[:, table.names.index(name)] for name in names)
        for row in np.flatnonzero(r + t > 1 + _TOLERANCE)[:1].tolist():
            got = f"{r[row]:g} + {t[row]:g} at {table.wavelength_nm[row]:g} nm"
            expected = f"{' + '.join(names)} of at most 1"
            table.fail_at(row, "more light leaves than arrives", expected=expected, got=got)


@lru_cache(maxsize=64)
def bands_of(text: str, file: str, where: str | None = None) -> tuple[Band, ...]:
    """The bands of a sensor's table from its text; `file` names it in messages."""
    table = _Table(text, file, where)
    if any(name.startswith(("reflectance", "transmittance")) for name in table.names):
        got = ", ".join(table.names[:4])
        table.fail("a surface's table, no sensor's", line=table.header_line, expected="one column a band", got=got)
    for index, name in enumerate(table.names):
        if not _BAND_NAME.match(name):
            expected = "1 to 40 letters, digits, spaces or any of _-+()"
            table.fail("bad name of a band", line=table.header_line, expected=expected, got=f"{name!r:.80}")
        if name.casefold() in (other.casefold() for other in table.names[:index]):
            problem = "two bands of one name, but for case"
            table.fail(problem, line=table.header_line, expected="different names", got=name)
    return tuple(_band(table, name, table.values[:, column]) for column, name in enumerate(table.names))


def _band(table: _Table, name: str, response: NDArray[np.float64]) -> Band:
    """A column as a band, with the zeros beside its response."""
    (low, high), most, least = _RESPONSES, float(response.max()), float(response.min())
    if 0 < most < low or most > high:
        expected, got = f"a greatest response from {low:g} to {high:g}", f"{most:g} in {name}"
        table.fail_at(int(response.argmax()), "the responses' scale is out of range", expected=expected, got=got)
    if least < 0:
        got = f"{least:g} in {name}"
        table.fail_at(int(response.argmin()), "a response below 0", expected="0 or more", got=got)
    seen = np.flatnonzero(response)
    if not len(seen):
        table.fail(f"band {name} answers to nothing", line=table.header_line, expected="a response above 0")
    first, last = table.wavelength_nm[seen[[0, -1]]]
    if first < RENDERED_NM[0] or last > RENDERED_NM[1]:
        row = int(seen[0] if first < RENDERED_NM[0] else seen[-1])
        expected = f"responses from {RENDERED_NM[0]:g} to {RENDERED_NM[1]:g} nm"
        problem, got = f"band {name} reaches out of what is rendered", f"{table.wavelength_nm[row]:g} nm"
        table.fail_at(row, problem, expected=expected, got=got)
    rows = slice(max(seen[0] - 1, 0), seen[-1] + 2)
    return Band(name, Spectrum(table.wavelength_nm[rows], response[rows]))


class _Table:
    """Numbers of a table, checked as far as all tables are alike; `fail` raises the error with its place."""

    def __init__(self, text: str, file: str, where: str | None) -> None:
        self.file, self.where = file, where
        lines = [
            (number, line.strip())
            for number, line in enumerate(text.splitlines(), 1)
            if line.strip() and not line.lstrip().startswith("#")
        ]
        if not lines:
            self.fail("the table is empty", line=1, expected=f"a header: {WAVELENGTH},reflectance,...")
        self.header_line, header = lines[0]
        if len(lines) - 1 > MOST_ROWS:
            self.fail("too many rows", line=lines[-1][0], expected=f"at most {MOST_ROWS:,}", got=f"{len(lines) - 1:,}")
        self.names = self._header(header)
        self._lines = [number for number, _ in lines[1:]]
        if len(self._lines) < 2:
            self.fail("too few rows", line=lines[-1][0], expected="at least two wavelengths", got=str(len(self._lines)))
        rows = np.array([self._row(number, line) for number, line in lines[1:]], dtype=np.float64)
        self.wavelength_nm: NDArray[np.float64] = rows[:, 0].copy()
        self.values: NDArray[np.float64] = rows[:, 1:].copy()
        self._check_wavelengths()

    def fail(self, problem: str, *, line: int, **about: str | None) -> NoReturn:
        """Raise `AssetError` for a line of the file; `about` is expected, got, and hint."""
        place = f"{self.file}:{line}" + (f" (named by {self.where})" if self.where else "")
        raise AssetError(problem, where=place, **about)

    def fail_at(self, row: int, problem: str, **about: str | None) -> NoReturn:
        """Raise `AssetError` for a row of the table."""
        self.fail(problem, line=self._lines[row], **about)

    def spectra(self) -> Columns:
        """One spectrum a column."""
        return {name: Spectrum(self.wavelength_nm, self.values[:, k].copy()) for k, name in enumerate(self.names)}

    def _header(self, text: str) -> tuple[str, ...]:
        names = [name.strip().strip('"') for name in text.split(",")]
        expected = f"{WAVELENGTH} and at least one more column, with commas between them"
        if names[0] != WAVELENGTH or len(names) < 2 or not all(names):
            self.fail("not a table of spectra", line=self.header_line, expected=expected, got=f"{text:.80}")
        if len(set(names)) < len(names) or len(names) > MOST_COLUMNS:
            expected = f"at most {MOST_COLUMNS} columns of different names"
            self.fail("bad header", line=self.header_line, expected=expected, got=f"{text:.80}")
        return tuple(names[1:])

    def _row(self, line: int, text: str) -> list[float]:
        cells = text.split(",")
        if len(cells) != len(self.names) + 1:
            expected = f"{len(self.names) + 1} numbers with commas between them"
            self.fail("a row of another length than the header", line=line, expected=expected, got=f"{text:.80}")
        numbers = []
        for cell in cells:
            try:
                number = float(cell)
            except ValueError:
                number = math.nan
            if not math.isfinite(number):
                self.fail("not a number", line=line, expected="a finite number", got=f"{cell.strip():.40}" or "nothing")
            numbers.append(number)
        return numbers

    def _check_wavelengths(self) -> None:
        wavelength = self.wavelength_nm
        falls = np.flatnonzero(np.diff(wavelength) <= 0)
        if len(falls):
            row = int(falls[0]) + 1
            got = f"{wavelength[row]:g} after {wavelength[row - 1]:g}"
            hint = "sort the rows by wavelength" if wavelength[row] != wavelength[row - 1] else "keep one of the two"
            self.fail_at(row, "wavelengths do not rise", expected="each above the one before", got=got, hint=hint)
        low, high = float(wavelength[0]), float(wavelength[-1])
        for unit, least, most, hint in _UNITS:
            if least <= low and high < most:
                got = f"{low:g} to {high:g}, which looks like {unit}"
                self.fail_at(0, "wavelengths are not in nm", expected="nm: 400 to 700 is visible", got=got, hint=hint)


_UNITS = (  # name, least and most (exclusive) wavelength of a table that looks like it, how to mend it
    ("metres", 0.0, 1e-3, "multiply by 1e9"),
    ("micrometres", 0.05, 50.0, "multiply by 1000"),
    ("ångström", 2900.0, 30000.0, "divide by 10"),
)
