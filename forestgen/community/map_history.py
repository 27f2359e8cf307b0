"""The maps of a community's history as NetCDF-4, beside the plants' history: such as the water of its soil.

Dimensions ``snapshot``, ``y`` and ``x``; coordinates ``y`` and ``x`` are the cells' middles in the world, metres, row 0
at the least y; ``step`` and ``time_yr`` tell the snapshots. Values are as they were, in double precision: a simulation
goes on from them to the bit. The history has a sum of the bytes of every snapshot's maps, which tells that the two
files are of one simulation.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population
from forestgen.core.errors import AssetError, ResourceError
from forestgen.core.processes import free_bytes

NAME = "maps.nc"
_UNITS = {"_mm": "mm", "_c": "degree_Celsius", "_g_per_m2": "g m-2"}
Maps = Mapping[str, NDArray[np.float64]]


class MapWriter:
    """Writes the maps of snapshots as they come; the file appears when it is complete, and only if there are any."""

    def __init__(self, path: Path, size_m: tuple[float, float] | None) -> None:
        self.path, self._size_m = path, size_m
        self.names: list[str] = []
        self.sums: list[int] = []  # of each snapshot's maps
        self._partial = path.with_name(path.name + ".partial")
        self._file: Any = None

    def add(self, population: Population) -> None:
        """Write a snapshot's maps."""
        if self.sums and list(population.maps) != self.names:
            raise ValueError("all snapshots of a history must have the same maps")
        if population.maps and self._file is None:
            self._begin(population.maps)
        if self._file is not None:
            number = len(self.sums)
            self._file.resize_dimension("snapshot", number + 1)
            self._file.variables["step"][number] = population.step
            self._file.variables["time_yr"][number] = population.time_yr
            for name, values in population.maps.items():
                self._file.variables[name][number] = values
        self.sums.append(_sum(population.maps))

    def _begin(self, maps: Maps) -> None:
        import h5netcdf

        self.names = list(maps)
        rows, cols = next(iter(maps.values())).shape
        self._file = h5netcdf.File(self._partial, "w")
        self._file.dimensions = {"snapshot": None, "y": rows, "x": cols}
        self._file.attrs["title"] = "Maps of a plant community, by forestgen"
        for name, count, side in (("y", rows, 1), ("x", cols, 0)):
            length = float(count) if self._size_m is None else self._size_m[side]
            middles = (np.arange(count) + 0.5) / count * length
            self._file.create_variable(name, (name,), "f8", data=middles).attrs["units"] = "m"
        for name, kind, units in (("step", "i8", "1"), ("time_yr", "f8", "year")):
            self._file.create_variable(name, ("snapshot",), kind).attrs["units"] = units
        for name, values in maps.items():
            if values.shape != (rows, cols):
                raise ValueError(f"maps of one shape are expected; {name} has {values.shape}, not {(rows, cols)}")
            variable = self._file.create_variable(
                name, ("snapshot", "y", "x"), "f8", chunks=(1, rows, cols), compression="gzip", compression_opts=1
            )
            variable.attrs["units"] = next((unit for end, unit in _UNITS.items() if name.endswith(end)), "1")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, _: BaseException | None, __: TracebackType | None) -> None:
        try:
            if self._file is not None:
                self._file.close()
            if kind is None and self._file is not None:
                self._partial.replace(self.path)
            elif kind is None:
                self.path.unlink(missing_ok=True)  # of a history that stood here before
        finally:
            self._partial.unlink(missing_ok=True)


def _sum(maps: Maps) -> int:
    """CRC-32 of the bytes of maps, one after the other."""
    total = 0
    for values in maps.values():
        total = zlib.crc32(np.asarray(values, dtype=np.float64).tobytes(), total)
    return total


def read_maps(path: Path, step: int, names: Sequence[str], expected_sum: int) -> dict[str, NDArray[np.float64]]:
    """The maps of the snapshot of a step.

    Raises
    ------
    AssetError : no such file, damaged, or of another simulation.
    ResourceError : a map does not fit into memory: a few bytes may tell of a large one.
    """
    import h5py  # h5netcdf's reader leaves a warning on the terminal when a file is damaged

    try:
        with h5py.File(path, "r") as file:
            found = np.flatnonzero(file["step"][:] == step)
            if len(found) != 1:
                raise ValueError(f"it has no map of step {step}")
            _check_size(sum(8 * file[name].size // max(1, len(file["step"])) for name in names))
            maps = {name: np.array(file[name][int(found[0])], dtype=np.float64) for name in names}
            if _sum(maps) != expected_sum:
                raise ValueError("its maps are those of another history, or damaged")
            return maps
    except (OSError, RuntimeError, LookupError, ValueError, TypeError, AttributeError) as error:
        raise AssetError(
            "the maps of this history cannot be read",
            where=str(path),
            expected=f"the {NAME} that was written with it",
            got="no such file" if isinstance(error, FileNotFoundError) else str(error).splitlines()[0],
            hint="simulate again",
        ) from error


def _check_size(need: int) -> None:
    free = free_bytes()
    if need > free / 2:
        raise ResourceError(
            "the history's maps do not fit into memory",
            expected=f"at most half of the {free / 1e9:.1f} GB that are free",
            got=f"{need / 1e9:,.1f} GB",
        )
