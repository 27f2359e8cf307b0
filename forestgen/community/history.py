"""The history of a community as a Parquet table: one row a plant a snapshot, in the snapshots' order.

Columns: ``time_yr``, ``step`` and those of `Population` (position as ``x_m``, ``y_m``, ``z_m``), with ``species_name``
beside the index ``species``, as text with a dictionary; a model's own columns follow, with ``model.`` before their
name. The file's metadata, JSON under ``forestgen.community``, names the species, each snapshot's time, number of plants
(a snapshot without plants has no rows), step and state, and the origin: what the simulation was started with, so that
`forestgen.community.resume` can tell whether a recipe continues it. A snapshot is one row group, and is read alone. The
same snapshots give the same bytes.

Maps of the ground, where a model has any, lie beside it (`community.history_tables`); the metadata then names them.

Of plants that grow by branch modules, the modules may lie in a second table beside it; the metadata then has their
number in every snapshot, and null where they were left out.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from forestgen.community import history_tables as tables
from forestgen.community.population import Population
from forestgen.core.errors import writing

_OWN = "model."
_KEY = b"forestgen.community"
_VERSION = 2
_COLUMNS = {
    "time_yr": pa.float64(), "step": pa.uint32(), "plant_id": pa.uint32(), "species": pa.uint16(),
    "species_name": pa.dictionary(pa.uint16(), pa.string()),
    "x_m": pa.float64(), "y_m": pa.float64(), "z_m": pa.float64(), "radius_m": pa.float64(), "height_m": pa.float64(),
    "age_yr": pa.float64(), "status": pa.uint8(),
}  # fmt: skip
_FOR_PEOPLE = ("step", "species_name")  # a snapshot has them from elsewhere; older files lack them
_SAME = ("plant_id", "species", "radius_m", "height_m", "age_yr", "status")  # arrays of a population by these names


def _table(population: Population) -> Any:
    columns: dict[str, Any] = {name: getattr(population, name) for name in _SAME}
    columns["time_yr"] = np.full(len(population), population.time_yr)
    columns["step"] = np.full(len(population), population.step)
    columns["species_name"] = pa.DictionaryArray.from_arrays(
        pa.array(population.species, type=pa.uint16()), pa.array(population.species_names, type=pa.string())
    )
    for axis, name in enumerate(("x_m", "y_m", "z_m")):
        columns[name] = population.position_m[:, axis].copy()
    own = {_OWN + name: pa.array(values) for name, values in population.columns.items()}
    shared = {
        name: one if isinstance(one := columns[name], pa.Array) else pa.array(one, type=kind)
        for name, kind in _COLUMNS.items()
    }
    return pa.table(shared | own)


class _PlantWriter(tables.Writer):
    """Writes the plants of snapshots; the metadata says what `modules` and `maps` wrote beside them."""

    def __init__(
        self, path: Path, origin: Mapping[str, Any], modules: tables.ModuleWriter | None, maps: tables.MapWriter
    ) -> None:
        super().__init__(path)
        self.about: dict[str, Any] = {"version": _VERSION, "species_names": (), "snapshots": [], "origin": dict(origin)}
        self.modules, self.maps, self.has_modules = modules, maps, False

    def add(self, population: Population) -> None:
        table = _table(population)
        if self.file is None:
            self.about["species_names"] = population.species_names
            self.file = pq.ParquetWriter(self.partial, table.schema, compression="zstd")
        if population.species_names != self.about["species_names"] or table.schema != self.file.schema:
            raise ValueError("all snapshots of a history must have the same species and columns")
        if len(population):
            self.file.write_table(table, row_group_size=len(population))
        one = [population.time_yr, len(population), population.step, dict(population.state)]
        self.about["snapshots"].append(one)
        self.has_modules = self.has_modules or population.modules is not None

    def finish(self) -> None:
        if self.has_modules:
            self.about["modules"] = None if self.modules is None else self.modules.marks
        if self.maps.names:
            self.about["maps"], self.about["map_sums"] = self.maps.names, self.maps.sums
        self.file.add_key_value_metadata({_KEY: json.dumps(self.about).encode()})


def write_history(
    path: Path,
    populations: Iterable[Population],
    origin: Mapping[str, Any] | None = None,
    *,
    modules: bool = False,
    size_m: tuple[float, float] | None = None,
) -> None:
    """Write snapshots as they come; only one is held in memory. The file appears when it is complete.

    `origin` is what the simulation was started with, plain as in JSON. With `modules` the plants' modules go into a
    table beside it. `size_m` is the site's, for the places of maps; None: a cell is a metre. Raises `OutputError` where
    the file cannot be written, `ValueError` for no snapshot, or snapshots of different species or columns.
    """
    problem = "the community's history cannot be written"
    with writing(path, problem, "another folder or disk"), ExitStack() as stack:
        map_writer = tables.MapWriter(path.with_name(tables.MAPS_NAME), size_m)
        module_writer = tables.ModuleWriter(path.with_name(tables.MODULES_NAME)) if modules else None
        writer = _PlantWriter(path, origin or {}, module_writer, map_writer)
        # The history itself appears last.
        writers = [stack.enter_context(one) for one in (writer, map_writer, module_writer) if one is not None]
        for population in populations:
            for one in writers:
                one.add(population)
        if writer.file is None:
            raise ValueError("a history needs at least one snapshot")


@dataclass(frozen=True)
class History:
    """A history's file, of which a snapshot is read when it is asked for."""

    path: Path
    species_names: tuple[str, ...]
    origin: Mapping[str, Any]  # what the simulation was started with
    _snapshots: Sequence[tuple[float, int, int, Mapping[str, Any]]]  # time_yr, plants, step, state
    grows_by_modules: bool = False  # whether its plants had modules, which may have been left out
    _modules: Sequence[Sequence[int]] | None = None  # of each snapshot; None: there are none, or they were left out
    maps: Sequence[str] = ()  # names of the maps that were written with it
    _map_sums: Sequence[int] = ()  # of every snapshot's

    @property
    def steps(self) -> list[int]:
        """The step of every snapshot, in their order."""
        return [step for _, _, step, _ in self._snapshots]

    def snapshot(self, step: int) -> Population:
        """The snapshot of a step of `steps`; raises `AssetError` where the file has changed, or is damaged."""
        return next(self._read([self.steps.index(step)]))

    @property
    def has_modules(self) -> bool:
        """Whether the plants' modules were written too."""
        return self._modules is not None

    def whole(self, step: int) -> Population:
        """The snapshot of a step of `steps` with its plants' modules and its maps, as far as they were written.

        Raises `AssetError` where the modules' table or the maps are missing, or not of this history.
        """
        population, index = self.snapshot(step), self.steps.index(step)
        if self._modules is not None:
            modules = tables.read_modules(self.path.with_name(tables.MODULES_NAME), population, self._modules, index)
            population = replace(population, modules=modules)
        if self.maps:
            maps = tables.read_maps(self.path.with_name(tables.MAPS_NAME), step, self.maps, self._map_sums[index])
            population = replace(population, maps=maps)
        return population

    def __iter__(self) -> Iterator[Population]:
        return self._read(range(len(self._snapshots)))

    def _read(self, indices: Iterable[int]) -> Iterator[Population]:
        plants = [n for _, n, _, _ in self._snapshots]
        group = list(accumulate((n > 0 for n in plants), initial=0))  # snapshots without plants have none
        with _opened(self.path) as file:
            needed = [name for name in file.schema_arrow.names if name not in _FOR_PEOPLE]
            empty = file.schema_arrow.empty_table().select(needed)
            for index in indices:
                _check_rows(file, group[index], plants[index])
                table = file.read_row_group(group[index], columns=needed) if plants[index] else empty
                yield self._population(table, index)

    def _population(self, table: Any, index: int) -> Population:
        time_yr, _, step, state = self._snapshots[index]
        columns: dict[str, Any] = {name: _values(table, name, step) for name in table.column_names}
        return Population(
            time_yr=time_yr,
            species_names=self.species_names,
            position_m=np.stack([columns["x_m"], columns["y_m"], columns["z_m"]], axis=1),
            columns={name.removeprefix(_OWN): values for name, values in columns.items() if name.startswith(_OWN)},
            step=step,
            state=state,
            **{name: columns[name] for name in _SAME},
        )


def _values(table: Any, name: str, step: int) -> NDArray[Any]:
    """A column of a snapshot, of its type and without gaps."""
    column = table.column(name)
    expected = _COLUMNS.get(name, column.type)
    if column.type != expected:
        raise ValueError(f"column {name} of step {step} is of type {column.type}, not {expected}")
    if column.null_count:
        raise ValueError(f"column {name} of step {step} lacks values: {column.null_count:,} are empty")
    values: NDArray[Any] = column.to_numpy()
    return values


def _check_rows(file: Any, group: int, plants: int) -> None:
    """Raise `ValueError` for other numbers of rows and plants, `ResourceError` for more than memory holds."""
    if not plants:
        return
    rows = file.metadata.row_group(group).num_rows if 0 <= group < file.metadata.num_row_groups else 0
    if rows != plants:
        raise ValueError(f"{rows:,} rows where the history has {plants:,} plants")
    tables.refuse_large(16 * rows * file.metadata.num_columns, "plants")  # of 8 bytes at most, twice


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """The Parquet file; whatever is wrong with it is an `AssetError`."""
    expected = "a history.parquet written by this version of forestgen"
    with tables.readable(path, "not a readable history of a community", expected), pq.ParquetFile(path) as file:
        yield file


def open_history(path: Path) -> History:
    """A file that `write_history` wrote; raises `AssetError` for no such file, or for one that is no history."""
    with _opened(path) as file:
        about = json.loads((file.metadata.metadata or {})[_KEY])
        if about["version"] != _VERSION:
            raise ValueError(f"version {about['version']} of the format, not {_VERSION}")
        snapshots = [(float(time_yr), int(n), int(step), state) for time_yr, n, step, state in about["snapshots"]]
        names, modules = tuple(about["species_names"]), about.get("modules")
        maps, sums = tuple(about.get("maps", ())), tuple(about["map_sums"] if "maps" in about else ())
        history = History(path, names, about["origin"], snapshots, "modules" in about, modules, maps, sums)
        _check_metadata(history)
        return history


def _check_metadata(history: History) -> None:
    """Raise `ValueError` unless what a file's metadata says of its snapshots fits together."""
    snapshots, steps = history._snapshots, history.steps
    if not snapshots or steps[0] < 0 or any(one >= other for one, other in pairwise(steps)):
        raise ValueError("its steps do not rise from 0 or more")
    if not all(math.isfinite(time_yr) and n >= 0 for time_yr, n, _, _ in snapshots):
        raise ValueError("a snapshot's time or number of plants is impossible")
    if not all(isinstance(one, dict) for one in [history.origin, *(state for *_, state in snapshots)]):
        raise ValueError("its origin, or the state of a snapshot, is no table")
    if not all(isinstance(name, str) for name in (*history.species_names, *history.maps)):
        raise ValueError("names of species and maps must be texts")
    expected = len(snapshots)
    marks = expected if history._modules is None else len(history._modules)
    if marks != expected or len(history._map_sums) != (expected if history.maps else 0):
        raise ValueError("modules or maps are those of another number of snapshots")
