"""Files beside a community's history: the modules of its plants, and the maps of its ground.

``modules.parquet`` has one row a module a snapshot, and a row group a snapshot; its columns are in
docs/branch_modules.md. The metadata, JSON under ``forestgen.modules``, has the number of modules of every snapshot and
their checksum.

``maps.nc`` is NetCDF-4. Dimensions ``snapshot``, ``y`` and ``x``; coordinates ``y`` and ``x`` are the cells' middles in
the world, metres, row 0 at the least y; ``step`` and ``time_yr`` identify the snapshots. Values are as they were, in
double precision: a simulation goes on from them to the bit.

The history has the same numbers and checksums: so it refuses files of another simulation, and changed values.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self
from zlib import crc32

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from forestgen.architecture.modules import Modules
from forestgen.community.population import Floats, Population
from forestgen.core.errors import AssetError, ResourceError
from forestgen.core.processes import free_bytes

MODULES_NAME, MAPS_NAME = "modules.parquet", "maps.nc"
_KEY = b"forestgen.modules"
_PLAIN = {
    "number": pa.uint32(), "parent": pa.int32(), "node": pa.int16(), "prototype": pa.uint8(),
    **dict.fromkeys(("age", "age_yr", "vigour", "light", "disused_m2"), pa.float32()),
}  # fmt: skip
_SPLIT = {
    "base_m": ("base_x_m", "base_y_m", "base_z_m"),
    "rotation": ("rotation_w", "rotation_x", "rotation_y", "rotation_z"),
}
_SCHEMA = pa.schema(
    [("step", pa.uint32()), ("plant_id", pa.uint32()), *_PLAIN.items()]
    + [(name, pa.float32()) for names in _SPLIT.values() for name in names]
)
_DAMAGES = (  # what readers of damaged files raise: RuntimeError is h5py's, with RecursionError
    OSError, pa.ArrowException, LookupError, ValueError, TypeError, AttributeError, ArithmeticError, RuntimeError,
)  # fmt: skip
_UNITS = {"_mm": "mm", "_c": "degree_Celsius", "_g_per_m2": "g m-2"}


@contextmanager
def readable(path: Path, problem: str, expected: str, hint: str | None = None) -> Iterator[None]:
    """Raise whatever is wrong with a file as an `AssetError`."""
    try:
        yield
    except _DAMAGES as error:
        got = f"no {error}" if isinstance(error, KeyError) else (str(error).splitlines() or [""])[0]
        got = "no such file" if isinstance(error, FileNotFoundError) else got
        raise AssetError(problem, where=str(path), expected=expected, got=got, hint=hint) from error


def refuse_large(need_bytes: float, what: str) -> None:
    """Raise `ResourceError` for what does not fit into memory: a small file may announce a large table."""
    free = free_bytes()
    if need_bytes > free / 2:
        expected, got = f"at most half of the {free / 1e9:.1f} GB that are free", f"{need_bytes / 1e9:,.1f} GB"
        raise ResourceError(f"the history's {what} do not fit into memory", expected=expected, got=got)


class Writer:
    """Writes something of snapshots as they come; the file appears when it is complete."""

    def __init__(self, path: Path) -> None:
        self.path, self.partial = path, path.with_name(path.name + ".partial")
        self.file: Any = None  # None: there is nothing to write

    def add(self, population: Population) -> None:
        """Write a snapshot."""

    def finish(self) -> None:
        """What is left to write before the file is closed."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if self.file is not None:
                self.finish()
                self.file.close()
            if kind is None and self.file is not None:
                self.partial.replace(self.path)
            elif kind is None:
                self.path.unlink(missing_ok=True)  # of a history that stood here before
        finally:
            self.partial.unlink(missing_ok=True)


class ModuleWriter(Writer):
    """Writes the modules of snapshots."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.marks: list[tuple[int, int]] = []  # modules of each snapshot, and their checksum
        self.file = pq.ParquetWriter(self.partial, _SCHEMA, compression="zstd")

    def add(self, population: Population) -> None:
        modules = population.modules
        if modules is None or not len(modules):
            self.marks.append((0, 0))
            return
        columns: dict[str, Any] = {
            "step": np.full(len(modules), population.step, dtype=np.uint32),
            "plant_id": population.plant_id[modules.plant()],
        }
        columns.update({name: getattr(modules, name) for name in _PLAIN})
        for name, parts in _SPLIT.items():
            values = getattr(modules, name)
            columns.update({part: np.ascontiguousarray(values[:, k]) for k, part in enumerate(parts)})
        table = pa.table({name: pa.array(values) for name, values in columns.items()}, schema=_SCHEMA)
        self.file.write_table(table, row_group_size=len(modules))
        self.marks.append((len(modules), _checksum(table)))

    def finish(self) -> None:
        self.file.add_key_value_metadata({_KEY: json.dumps(self.marks).encode()})


def _checksum(table: Any) -> int:
    """Of the values of all columns, in their order."""
    return _crc32(table.column(name).to_numpy() for name in _SCHEMA.names)


def _crc32(arrays: Iterable[NDArray[Any]]) -> int:
    """CRC-32 of the bytes of arrays, one after the other."""
    found = 0
    for values in arrays:
        found = crc32(np.ascontiguousarray(values).tobytes(), found)
    return found


def read_modules(path: Path, population: Population, marks: Sequence[Sequence[int]], index: int) -> Modules:
    """The modules of the plants of a snapshot, which lacks them.

    `marks` are those of every snapshot of the history (`ModuleWriter.marks`), and `index` is the snapshot's number
    among them. Raises `AssetError` for no such file, a damaged one, or one of another simulation.
    """
    with (
        readable(
            path,
            "the modules of this history cannot be read",
            f"the {MODULES_NAME} that was written with it",
            "simulate again with `set='community.history_modules=true'`",
        ),
        pq.ParquetFile(path) as file,
    ):
        theirs = json.loads((file.metadata.metadata or {})[_KEY])
        if any(isinstance(one, int) for one in [*theirs, *marks]):
            raise ValueError("the table was written by an earlier version of forestgen, without checksums")
        if [tuple(one) for one in theirs] != [tuple(one) for one in marks]:
            raise ValueError("the table is that of another history")
        count, checksum = marks[index]
        group = sum(before > 0 for before, _ in marks[:index])
        table = file.read_row_group(group) if count else _SCHEMA.empty_table()
        if len(table) != count or (count and _checksum(table) != checksum):
            raise ValueError(f"its values of step {population.step} are not those that were written")
        columns = {name: table.column(name).to_numpy() for name in table.column_names}
        ids = columns["plant_id"]
        first = np.append(np.searchsorted(ids, population.plant_id), len(ids)).astype(np.int64)
        owner = np.repeat(np.arange(len(population)), np.diff(first)) if np.all(np.diff(first) >= 0) else np.zeros(0)
        if first[0] != 0 or len(owner) != len(ids) or np.any(population.plant_id[owner] != ids):
            raise ValueError("its plants are not those of the history")
        split = {name: np.stack([columns[part] for part in parts], axis=1) for name, parts in _SPLIT.items()}
        return Modules(first=first, **{name: columns[name] for name in _PLAIN}, **split)


class MapWriter(Writer):
    """Writes the maps of snapshots, if they have any; cells are a metre where `size_m` is None."""

    def __init__(self, path: Path, size_m: tuple[float, float] | None) -> None:
        super().__init__(path)
        self._size_m = size_m
        self.names: list[str] = []
        self.sums: list[int] = []  # of each snapshot's maps

    def add(self, population: Population) -> None:
        if self.sums and list(population.maps) != self.names:
            raise ValueError("all snapshots of a history must have the same maps")
        if population.maps and self.file is None:
            self._begin(population.maps)
        if self.file is not None:
            number = len(self.sums)
            self.file.resize_dimension("snapshot", number + 1)
            self.file.variables["step"][number] = population.step
            self.file.variables["time_yr"][number] = population.time_yr
            for name, values in population.maps.items():
                self.file.variables[name][number] = values
        self.sums.append(_crc32(np.asarray(values, np.float64) for values in population.maps.values()))

    def _begin(self, maps: Mapping[str, Floats]) -> None:
        import h5netcdf

        self.names = list(maps)
        rows, cols = next(iter(maps.values())).shape
        self.file = file = h5netcdf.File(self.partial, "w")
        file.dimensions = {"snapshot": None, "y": rows, "x": cols}
        file.attrs["title"] = "Maps of a plant community, by forestgen"
        for name, count, side in (("y", rows, 1), ("x", cols, 0)):
            length = float(count) if self._size_m is None else self._size_m[side]
            middles = (np.arange(count) + 0.5) / count * length
            file.create_variable(name, (name,), "f8", data=middles).attrs["units"] = "m"
        for name, kind, units in (("step", "i8", "1"), ("time_yr", "f8", "year")):
            file.create_variable(name, ("snapshot",), kind).attrs["units"] = units
        for name, values in maps.items():
            if values.shape != (rows, cols):
                raise ValueError(f"maps of one shape are expected; {name} has {values.shape}, not {(rows, cols)}")
            variable = file.create_variable(
                name, ("snapshot", "y", "x"), "f8", chunks=(1, rows, cols), compression="gzip", compression_opts=1
            )
            variable.attrs["units"] = next((unit for end, unit in _UNITS.items() if name.endswith(end)), "1")


def read_maps(path: Path, step: int, names: Sequence[str], expected_sum: int) -> dict[str, Floats]:
    """The maps of the snapshot of a step.

    Raises `AssetError` for no such file, a damaged one, or one of another simulation; `ResourceError` for large maps.
    """
    import h5py  # h5netcdf's reader leaves a warning on the terminal when a file is damaged

    with (
        readable(
            path,
            "the maps of this history cannot be read",
            f"the {MAPS_NAME} that was written with it",
            "simulate again",
        ),
        h5py.File(path, "r") as file,
    ):
        found = np.flatnonzero(file["step"][:] == step)
        if len(found) != 1:
            raise ValueError(f"it has no map of step {step}")
        refuse_large(sum(8 * file[name].size // max(1, len(file["step"])) for name in names), "maps")
        maps = {name: np.array(file[name][int(found[0])], dtype=np.float64) for name in names}
        if _crc32(maps.values()) != expected_sum:
            raise ValueError("its maps are those of another history, or damaged")
        return maps
