"""The maps of a community's history as NetCDF-4, beside the plants' history: such as the water of its soil.

Dimensions ``snapshot``, ``y`` and ``x``; coordinates ``y`` and ``x`` are the cells' middles in the world, metres, row 0
at the least y; ``step`` and ``time_yr`` tell the snapshots. Values are as they were, in double precision: a simulation
goes on from them to the bit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population
from forestgen.core.errors import AssetError

NAME = "maps.nc"
_UNITS = {"_mm": "mm", "_c": "degree_Celsius", "_g_per_m2": "g m-2"}
Maps = Mapping[str, NDArray[np.float64]]


class MapWriter:
    """Writes the maps of snapshots as they come; the file appears when it is complete, and only if there are any."""

    def __init__(self, path: Path, size_m: tuple[float, float] | None) -> None:
        self.path, self._size_m = path, size_m
        self.names: list[str] = []
        self._partial = path.with_name(path.name + ".partial")
        self._file: Any = None
        self._count = 0

    def add(self, population: Population) -> None:
        """Write a snapshot's maps."""
        if self._count and list(population.maps) != self.names:
            raise ValueError("all snapshots of a history must have the same maps")
        if population.maps and self._file is None:
            self._begin(population.maps)
        if self._file is not None:
            self._file.resize_dimension("snapshot", self._count + 1)
            self._file.variables["step"][self._count] = population.step
            self._file.variables["time_yr"][self._count] = population.time_yr
            for name, values in population.maps.items():
                self._file.variables[name][self._count] = values
        self._count += 1

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


def read_maps(path: Path, step: int, names: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """The maps of the snapshot of a step.

    Raises
    ------
    AssetError : no such file, damaged, or of another simulation.
    """
    import h5py  # h5netcdf's reader leaves a warning on the terminal when a file is damaged

    try:
        with h5py.File(path, "r") as file:
            found = np.flatnonzero(file["step"][:] == step)
            if len(found) != 1:
                raise ValueError(f"it has no map of step {step}")
            return {name: np.array(file[name][int(found[0])], dtype=np.float64) for name in names}
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise AssetError(
            "the maps of this history cannot be read",
            where=str(path),
            expected=f"the {NAME} that was written with it",
            got="no such file" if isinstance(error, FileNotFoundError) else str(error).splitlines()[0],
            hint="simulate again",
        ) from error
