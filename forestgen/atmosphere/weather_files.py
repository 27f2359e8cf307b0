"""Weather and cloud fields as files: what a simulation resumes from, and what other programs read and write.

| file | holds | of |
|---|---|---|
| `.nc` | NetCDF-4 with CF's names and units, compressed (`netcdf_file`) | a snapshot, or an extinction field |
| `.vol` | Mitsuba's grid volume (`vol_file`) | an extinction field |
| `.vdb` | OpenVDB, written only (`vdb_file`, which says why) | an extinction field |
| `.csv` | a table of heights, read only (`sounding_file`) | a sounding |

A snapshot comes back to the last bit, so a simulation that resumes goes on as if it had not stopped. A `.vol` and a
`.vdb` hold no albedo and no phase function, and the corners of a `.vol` are rounded to float32.

Files are written beside their place and then renamed, so that no half a file ever has the name. The same values make
the same bytes. Nothing is stored or read in half precision.

What is read is checked: sizes that agree and fit into memory, numbers that are numbers, nothing negative that is none.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TypeVar

from forestgen.atmosphere.field_checks import FieldError, check_clouds, check_weather
from forestgen.atmosphere.grid import CloudGrid
from forestgen.atmosphere.netcdf_file import droplet_radius_of, netcdf_size, read_netcdf, write_netcdf
from forestgen.atmosphere.sounding import Sounding
from forestgen.atmosphere.sounding_file import MOST_BYTES, sounding_of_table
from forestgen.atmosphere.vdb_file import write_vdb
from forestgen.atmosphere.vol_file import read_vol, write_vol
from forestgen.atmosphere.weather import Weather
from forestgen.core.errors import AssetError, ForestgenError, OutputError

_READERS: dict[str, Callable[[Path], Weather | CloudGrid]] = {".nc": read_netcdf, ".vol": read_vol}
_WRITERS: dict[str, Callable[[Path, CloudGrid], None]] = {
    ".nc": write_netcdf,
    ".vol": write_vol,
    ".vdb": write_vdb,
}
SUFFIXES = tuple(_READERS)

T = TypeVar("T")


def read_sounding(path: Path, *, ground_pressure_pa: float = 101_325.0) -> Sounding:
    """Air at rest, of a table; its columns are in `sounding_file`.

    Raises
    ------
    AssetError : there is no such file, or its table is not air that can be; with line and column.
    """
    with _explained(path, AssetError, "the file cannot be used as a sounding"), path.open("rb") as file:
        return sounding_of_table(file.read(MOST_BYTES + 1), ground_pressure_pa)


def write_weather(path: Path, weather: Weather, *, droplet_radius_um: float | None = None) -> None:
    """Write a snapshot as NetCDF-4.

    Parameters
    ----------
    droplet_radius_um : effective radius of its droplets, which water alone does not tell; None: nobody knows.

    Raises
    ------
    OutputError : the name does not end in .nc, the snapshot is none, or the file cannot be written.
    """
    with _explained(path, OutputError, "the snapshot cannot be written"):
        if path.suffix.lower() != ".nc":
            raise FieldError("the name", "one that ends in .nc: a snapshot is a NetCDF file", path.name)
        check_weather(weather)
        _write(path, partial(write_netcdf, droplet_radius_um=droplet_radius_um), weather)


def write_clouds(path: Path, grid: CloudGrid) -> None:
    """Write an extinction field, as what the name's end says.

    Raises
    ------
    OutputError : the name ends otherwise, the field is none, or the file cannot be written.
    """
    with _explained(path, OutputError, "the clouds cannot be written"):
        write = _by_suffix(path, _WRITERS)
        check_clouds(grid)
        _write(path, write, grid)


def read_sky(path: Path) -> Weather | CloudGrid:
    """Whatever a file holds: a snapshot or an extinction field.

    Raises
    ------
    AssetError : there is no such file, or its content can be neither.
    ResourceError : it does not fit into memory.
    """
    with _explained(path, AssetError, "the file cannot be used as weather"):
        read = _by_suffix(path, _READERS)
        if not path.is_file():
            raise FieldError("the file", "an existing file", "a folder" if path.is_dir() else "none")
        content = read(path)
        if isinstance(content, Weather):
            check_weather(content)
        else:
            check_clouds(content)
    return content


def size_of(path: Path) -> tuple[int, float | None] | None:
    """Cells of a file's field, and how wide a state of the air that is periodic is, m; None: it cannot be read.

    Nothing but the head of the file is read.
    """
    try:
        if path.suffix.lower() == ".nc":
            return netcdf_size(path)
        return (path.stat().st_size // 4, None) if path.is_file() else None
    except (OSError, ValueError, KeyError, IndexError, TypeError):
        return None


def read_droplet_radius_um(path: Path) -> float | None:
    """Effective radius of a snapshot's droplets; None if the file does not say.

    Raises
    ------
    AssetError : it is no number above 0.
    """
    with _explained(path, AssetError, "the file cannot be used as weather"):
        return droplet_radius_of(path)


def read_weather(path: Path) -> Weather:
    """A snapshot, as it was saved. Raises as `read_sky` does, and AssetError if the file holds an extinction field."""
    content = read_sky(path)
    if not isinstance(content, Weather):
        raise _other(path, "a snapshot of weather", "an extinction field")
    return content


def read_clouds(path: Path) -> CloudGrid:
    """An extinction field. Raises as `read_sky` does, and AssetError if the file holds a snapshot of weather."""
    content = read_sky(path)
    if not isinstance(content, CloudGrid):
        raise _other(path, "an extinction field", "a snapshot of weather")
    return content


def _other(path: Path, expected: str, got: str) -> AssetError:
    return AssetError("the file holds something else", where=str(path), expected=expected, got=got)


def _by_suffix(path: Path, table: Mapping[str, T]) -> T:
    if path.suffix.lower() not in table:
        raise FieldError("the name", f"one that ends in {', '.join(table)}", path.name)
    return table[path.suffix.lower()]


def _write(path: Path, write: Callable[[Path, T], None], content: T) -> None:
    """Write beside the place, then rename."""
    beside = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        write(beside, content)
        beside.replace(path)
    except BaseException:
        with suppress(OSError):
            beside.unlink(missing_ok=True)
        raise


@contextmanager
def _explained(path: Path, error: type[ForestgenError], problem: str) -> Iterator[None]:
    """Say of which file a fault is."""
    try:
        yield
    except FieldError as cause:
        raise error(f"{problem}: {cause.what}", where=str(path), expected=cause.expected, got=cause.got) from cause
    except (OSError, ValueError) as cause:  # ValueError: a name that no file system takes
        reason = cause.strerror if isinstance(cause, OSError) and cause.strerror else str(cause).splitlines()[0]
        raise error(problem, where=str(path), got=reason) from cause
