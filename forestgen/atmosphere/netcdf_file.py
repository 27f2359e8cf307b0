"""Snapshots and extinction fields as NetCDF-4: CF-1.11's names and units, deflated, with a checksum behind the data.

Dimensions z, y, x are the cells' centres, in metres of the world frame; z_face, y_face and x_face the walls between
them, where the velocity stands. Every value comes back to the last bit, the grid's numbers included, which are kept as
attributes beside the coordinates that are made of them.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.grid import (
    FIELDS,
    AirGrid,
    CloudGrid,
    FieldError,
    PhaseFunction,
    Weather,
    check_air_grid,
    check_room,
)

WEATHER, CLOUDS = "forestgen weather 1", "forestgen clouds 1"
_CELLS = ("z", "y", "x")
_SEALED, _SEAL = b"forestgen seal 1", struct.Struct("<16sI")  # its name, and CRC-32 of all before it
_RADIUS = "droplet_effective_radius_um"
_DEFLATE_LEVEL = 2  # higher levels take several times as long for a few per cent
_CF_UNITS = {"m/s": "m s-1", "K": "K", "kg/kg": "kg kg-1", "kg/m2": "kg m-2", "kg/m3": "kg m-3", "1/m": "m-1", "": "1"}
_POSITIVE_UP = {"standard_name": "height", "positive": "up"}


def write_netcdf(path: Path, content: Weather | CloudGrid, *, droplet_radius_um: float | None = None) -> None:
    """Write a snapshot, with the effective radius of its droplets if it is known, or an extinction field."""
    import h5netcdf

    with h5netcdf.File(path, "w") as file:
        if isinstance(content, Weather):
            _put_weather(file, content)
            if droplet_radius_um is not None:
                file.attrs[_RADIUS] = np.float64(droplet_radius_um)
        else:
            _put_clouds(file, content)
    _seal(path)


def read_netcdf(path: Path) -> Weather | CloudGrid:
    """What `write_netcdf` wrote. `FieldError`: no such file, or a damaged one; `ResourceError`: memory is too small."""
    import h5py  # h5netcdf's reader leaves a warning on the terminal when a file is damaged

    with path.open("rb") as stream:
        head = stream.read(8)
    if not head.startswith(b"\x89HDF"):
        got = f"one that begins with {head!r}" if head else "0 bytes"
        raise FieldError("the file", "a NetCDF-4 file", "NetCDF of version 3" if head[:3] == b"CDF" else got)
    _check_seal(path)
    try:
        with h5py.File(path, "r") as file:
            what = file.attrs.get("content")
            readers: dict[str, Callable[[Any, str], Weather | CloudGrid]] = {WEATHER: _weather_of, CLOUDS: _clouds_of}
            if not isinstance(what, str) or what not in readers:
                got = repr(what) if isinstance(what, str) else "None"
                raise FieldError("the attribute content", " or ".join(map(repr, readers)), got)
            return readers[what](file, str(path))
    except FieldError:
        raise
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as cause:  # HDF5's, of a damaged file
        line = (str(cause).splitlines() or [type(cause).__name__])[0][:120]
        raise FieldError("the file", "a whole NetCDF-4 file", f"a damaged one ({line})") from cause


def netcdf_size(path: Path) -> tuple[int, float | None]:
    """Cells, and width of a periodic snapshot, m. OSError, KeyError, ValueError: `read_netcdf` takes no such file."""
    import h5py

    with h5py.File(path, "r") as file:
        x, y, z = (len(_variable(file, name, "f8", 1)) for name in "xyz")
        wide_m = x * _three(file, "cell_m")[0] if file.attrs.get("periodic") else None
    return x * y * z, wide_m


def droplet_radius_of(path: Path) -> float | None:
    """Effective radius, µm, of a file that `read_netcdf` takes, or None. `FieldError`: no number above 0."""
    import h5py

    with h5py.File(path, "r") as file:
        if _RADIUS not in file.attrs:
            return None
        radius_um = _numbers(file, _RADIUS, 1)[0]
    if not 0.0 < radius_um < np.inf:
        raise FieldError(f"the attribute {_RADIUS}", "micrometres, above 0", f"{radius_um:g}")
    return radius_um


def _put_weather(file: Any, weather: Weather) -> None:
    grid = weather.grid
    _put_head(file, WEATHER, "State of the air in a simulation of clouds", grid, faces=True)
    file.attrs["cell_m"], file.attrs["low_m"] = np.array(grid.cell_m, "f8"), np.array(grid.low_m, "f8")
    file.attrs["periodic"] = np.int8(grid.periodic)
    time = file.create_variable("time", (), "f8", data=np.float64(weather.time_s))
    time.attrs.update({"long_name": "time since the simulation began", "units": "s"})
    for name, (axes, _, _, unit, title) in FIELDS.items():
        _put(file, name, axes, getattr(weather, name), title, unit)
    if weather.solid is not None:
        _put(file, "solid", _CELLS, weather.solid.astype(np.int8), "0 air, 1 inside the terrain", "")


def _weather_of(file: Any, where: str) -> Weather:
    x, y, z = (len(_variable(file, name, "f8", 1)) for name in "xyz")
    grid = AirGrid((x, y, z), _three(file, "cell_m"), _three(file, "low_m"), bool(_numbers(file, "periodic", 1)[0]))
    check_air_grid(grid)
    ranks = {name: len(axes) for name, (axes, *_) in FIELDS.items()}
    variables = {name: _variable(file, name, "f4" if rank == 3 else "f8", rank) for name, rank in ranks.items()}
    if "solid" in file:
        variables["solid"] = _variable(file, "solid", "i1", 3)
    check_room(sum(one.size * one.dtype.itemsize for one in variables.values()), where)
    fields = {name: np.ascontiguousarray(one[...]) for name, one in variables.items()}
    solid = fields.pop("solid", None)
    time_s = float(_variable(file, "time", "f8", 0)[()])
    return Weather(grid=grid, time_s=time_s, **fields, solid=None if solid is None else solid != 0)


def _put_clouds(file: Any, grid: CloudGrid) -> None:
    _put_head(file, CLOUDS, "Clouds as a field of extinction", grid, faces=False)
    file.attrs["low_m"], file.attrs["high_m"] = np.array(grid.low_m, "f8"), np.array(grid.high_m, "f8")
    file.attrs["albedo"] = np.float64(grid.albedo)
    phase = grid.phase
    file.attrs["phase"] = np.array([phase.forward, phase.backward, phase.forward_share], "f8")
    _put(file, "extinction_per_m", _CELLS, grid.extinction_per_m, "extinction of light by droplets", "1/m")


def _clouds_of(file: Any, where: str) -> CloudGrid:
    field = _variable(file, "extinction_per_m", "f4", 3)
    check_room(field.size * field.dtype.itemsize, where)
    forward, backward, share = _three(file, "phase")
    low, high, albedo = _three(file, "low_m"), _three(file, "high_m"), _numbers(file, "albedo", 1)[0]
    return CloudGrid(np.ascontiguousarray(field[...]), low, high, albedo, PhaseFunction(forward, backward, share))


def _put_head(file: Any, content: str, title: str, grid: AirGrid | CloudGrid, *, faces: bool) -> None:
    file.attrs.update({"Conventions": "CF-1.11", "title": title, "source": "forestgen", "content": content})
    cells = grid.cells if isinstance(grid, AirGrid) else grid.extinction_per_m.shape[::-1]
    for axis, count, side, low in zip("xyz", cells, grid.cell_m, grid.low_m, strict=True):
        more = {f"{axis}_face": low + np.arange(count + 1) * side} if faces else {}
        for name, places in {axis: low + (np.arange(count) + 0.5) * side, **more}.items():
            file.dimensions[name] = len(places)
            variable = file.create_variable(name, (name,), "f8", data=places)
            attributes = {"units": "m", "long_name": f"{axis}, world frame" + (", cell walls" if "_" in name else "")}
            up = _POSITIVE_UP if axis == "z" else {}
            variable.attrs.update({**attributes, **up, **({"axis": axis.upper()} if name == axis else {})})


def _put(file: Any, name: str, axes: tuple[str, ...], values: NDArray[Any], title: str, unit: str) -> None:
    packed = {"compression": "gzip", "compression_opts": _DEFLATE_LEVEL, "shuffle": True}
    # One block a layer, or a row where there are no layers.
    blocks = values.shape if values.ndim < 3 else (1, *values.shape[1:])
    variable = file.create_variable(name, axes, values.dtype.str[1:], data=values, chunks=blocks, **packed)
    kind = "long_name" if " " in title else "standard_name"
    variable.attrs.update({kind: title, "units": _CF_UNITS[unit]})


def _numbers(file: Any, name: str, count: int) -> list[float]:
    if name not in file.attrs:
        raise FieldError(f"the attribute {name}", "it in the file", "none")
    numbers = np.atleast_1d(file.attrs[name])
    if numbers.shape != (count,) or numbers.dtype.kind not in "fi":
        raise FieldError(f"the attribute {name}", "three numbers" if count == 3 else "one number", str(numbers))
    return [float(one) for one in numbers]


def _three(file: Any, name: str) -> tuple[float, float, float]:
    first, second, third = _numbers(file, name, 3)
    return first, second, third


def _variable(file: Any, name: str, kind: str, rank: int) -> Any:
    """A variable, not yet read, of a type and a number of dimensions; `check_weather` judges its size."""
    import h5py

    # A link, an external or a virtual data set would read another file of whoever opens this one.
    is_own = isinstance(file.get(name, getlink=True), h5py.HardLink)
    variable = file[name] if is_own else None
    if not isinstance(variable, h5py.Dataset):
        raise FieldError(f"the variable {name}", "it in the file", "none")
    if variable.is_virtual or variable.external:
        raise FieldError(f"the variable {name}", "its values in the file itself", "a reference to another file")
    if variable.dtype != np.dtype(kind):
        raise FieldError(name, f"{np.dtype(kind)} numbers", str(variable.dtype))
    if len(variable.shape) != rank:
        raise FieldError(name, f"{rank} dimensions", str(variable.shape))
    return variable


def _seal(path: Path) -> None:
    """Put the checksum of all that is in the file behind it, where HDF5 does not look."""
    total = _crc32(path, path.stat().st_size)
    with path.open("ab") as file:
        file.write(_SEAL.pack(_SEALED, total))


def _check_seal(path: Path) -> None:
    """Refuse a file that has changed since it was sealed; one without a seal is another program's, and accepted.

    HDF5's own checksums leave out some tables: a flipped bit there makes other values, or an endless loop.
    """
    size = path.stat().st_size - _SEAL.size
    if size <= 0:
        return
    with path.open("rb") as file:
        file.seek(size)
        name, total = _SEAL.unpack(file.read(_SEAL.size))
    if name == _SEALED and total != _crc32(path, size):
        raise FieldError("the file", "a file as it was written", "a damaged one: its checksum differs")


def _crc32(path: Path, size: int) -> int:
    """Of the first bytes of a file."""
    total = 0
    with path.open("rb") as file:
        while block := file.read(min(size, 1 << 20)):
            total, size = zlib.crc32(block, total), size - len(block)
    return total
