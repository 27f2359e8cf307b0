"""The history of a community as a Parquet table: one row a plant a snapshot, in the snapshots' order.

Columns: ``time_yr``, ``step`` and those of `Population` (position as ``x_m``, ``y_m``, ``z_m``), with ``species_name``
beside the index ``species``, as text with a dictionary; a model's own columns follow, with ``model.`` before their
name. The file's metadata, JSON under ``forestgen.community``, names the species, each snapshot's time, number of plants
(a snapshot without plants has no rows), step and state, and the origin: what the simulation was started with, so that
`forestgen.community.resume` can tell whether a recipe continues it. A snapshot is one row group, and is read alone. The
same snapshots give the same bytes.

Maps of the ground, where a model has any, lie beside it (`community.map_history`); the metadata then names them.

Of plants that grow by branch modules, the modules may lie in a second table beside it (`community.module_history`); the
metadata then has their number in every snapshot, and null where they were left out.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from forestgen.community.map_history import NAME as MAPS
from forestgen.community.map_history import MapWriter, read_maps
from forestgen.community.module_history import NAME, ModuleWriter, read_modules
from forestgen.community.population import Population
from forestgen.core.errors import AssetError, OutputError, ResourceError
from forestgen.core.memory import free_bytes

_OWN = "model."
_KEY = b"forestgen.community"
_VERSION = 2
_COLUMNS = {
    "time_yr": pa.float64(),
    "step": pa.uint32(),
    "plant_id": pa.uint32(),
    "species": pa.uint16(),
    "species_name": pa.dictionary(pa.uint16(), pa.string()),
    "x_m": pa.float64(),
    "y_m": pa.float64(),
    "z_m": pa.float64(),
    "radius_m": pa.float64(),
    "height_m": pa.float64(),
    "age_yr": pa.float64(),
    "status": pa.uint8(),
}


_FOR_PEOPLE = ("step", "species_name")  # a snapshot has them from elsewhere; older files lack them


def _table(population: Population) -> Any:
    names = pa.DictionaryArray.from_arrays(
        pa.array(population.species, type=pa.uint16()), pa.array(population.species_names, type=pa.string())
    )
    columns = {
        "time_yr": np.full(len(population), population.time_yr),
        "step": np.full(len(population), population.step),
        "plant_id": population.plant_id,
        "species": population.species,
        "species_name": names,
        "x_m": population.position_m[:, 0].copy(),
        "y_m": population.position_m[:, 1].copy(),
        "z_m": population.position_m[:, 2].copy(),
        "radius_m": population.radius_m,
        "height_m": population.height_m,
        "age_yr": population.age_yr,
        "status": population.status,
    }
    columns.update({_OWN + name: values for name, values in population.columns.items()})
    return pa.table(
        {
            name: values if values is names else pa.array(values, type=_COLUMNS.get(name))
            for name, values in columns.items()
        }
    )


def _write(
    path: Path,
    populations: Iterable[Population],
    origin: Mapping[str, Any],
    modules: ModuleWriter | None,
    maps: MapWriter,
) -> None:
    writer, names, snapshots, has_modules = None, None, [], False
    try:
        for population in populations:
            table = _table(population)
            if writer is None:
                names = population.species_names
                writer = pq.ParquetWriter(path, table.schema, compression="zstd")
            if population.species_names != names or table.schema != writer.schema:
                raise ValueError("all snapshots of a history must have the same species and columns")
            if len(population):
                writer.write_table(table, row_group_size=len(population))
            snapshots.append([population.time_yr, len(population), population.step, dict(population.state)])
            has_modules = has_modules or population.modules is not None
            if modules is not None:
                modules.add(population)
            maps.add(population)
        if writer is None:
            raise ValueError("a history needs at least one snapshot")
        about: dict[str, Any] = {
            "version": _VERSION,
            "species_names": names,
            "snapshots": snapshots,
            "origin": dict(origin),
        }
        if has_modules:
            about["modules"] = None if modules is None else modules.marks
        if maps.names:
            about["maps"], about["map_sums"] = maps.names, maps.sums
        writer.add_key_value_metadata({_KEY: json.dumps(about).encode()})
    finally:
        if writer is not None:
            writer.close()


def write_history(
    path: Path,
    populations: Iterable[Population],
    origin: Mapping[str, Any] | None = None,
    *,
    modules: bool = False,
    size_m: tuple[float, float] | None = None,
) -> None:
    """Write snapshots as they come; only one is held in memory. The file appears when it is complete.

    Parameters
    ----------
    origin : what the simulation was started with, plain as in JSON.
    modules : whether the plants' modules are written too, into a table beside it.
    size_m : of the site, for the places of maps; None: a cell is a metre.

    Raises
    ------
    OutputError : the file cannot be written.
    ValueError : no snapshot, or snapshots of different species or columns.
    """
    partial = path.with_name(path.name + ".partial")
    try:
        with (
            ModuleWriter(path.with_name(NAME)) if modules else nullcontext() as writer,
            MapWriter(path.with_name(MAPS), size_m) as maps,
        ):
            _write(partial, populations, origin or {}, writer, maps)
        partial.replace(path)
    except OSError as error:
        raise OutputError(
            "the community's history cannot be written", where=str(path), got=str(error), hint="another folder or disk"
        ) from error
    finally:
        partial.unlink(missing_ok=True)


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
        """The snapshot of a step of `steps`.

        Raises
        ------
        AssetError : the file has changed, or is damaged.
        """
        return next(self._read([self.steps.index(step)]))

    @property
    def has_modules(self) -> bool:
        """Whether the plants' modules were written too."""
        return self._modules is not None

    def whole(self, step: int) -> Population:
        """The snapshot of a step of `steps` with its plants' modules and its maps, as far as they were written.

        Raises
        ------
        AssetError : the modules' table or the maps are not there, or not of this history.
        """
        population, index = self.snapshot(step), self.steps.index(step)
        if self._modules is not None:
            modules = read_modules(self.path.with_name(NAME), population, self._modules, index)
            population = replace(population, modules=modules)
        if self.maps:
            maps = read_maps(self.path.with_name(MAPS), step, self.maps, self._map_sums[index])
            population = replace(population, maps=maps)
        return population

    def __iter__(self) -> Iterator[Population]:
        return self._read(range(len(self._snapshots)))

    def _read(self, indices: Iterable[int]) -> Iterator[Population]:
        plants = [n for _, n, _, _ in self._snapshots]
        group = list(accumulate((n > 0 for n in plants), initial=0))  # snapshots without plants have none
        with _readable(self.path) as file:
            needed = [name for name in file.schema_arrow.names if name not in _FOR_PEOPLE]
            nobody = file.schema_arrow.empty_table().select(needed)
            for index in indices:
                _check_rows(file, group[index], plants[index])
                table = file.read_row_group(group[index], columns=needed) if plants[index] else nobody
                yield self._population(table, index)

    def _population(self, table: Any, index: int) -> Population:
        time_yr, _, step, state = self._snapshots[index]
        columns = {name: _values(table, name, step) for name in table.column_names}
        return Population(
            time_yr=time_yr,
            species_names=self.species_names,
            plant_id=columns["plant_id"],
            species=columns["species"],
            position_m=np.stack([columns["x_m"], columns["y_m"], columns["z_m"]], axis=1),
            radius_m=columns["radius_m"],
            height_m=columns["height_m"],
            age_yr=columns["age_yr"],
            status=columns["status"],
            columns={name.removeprefix(_OWN): values for name, values in columns.items() if name.startswith(_OWN)},
            step=step,
            state=state,
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
    """Refuse a group that has not as many rows as the history tells, or more than memory holds: a few bytes may say so.

    Raises
    ------
    ValueError : it has another number of rows.
    ResourceError : they do not fit into memory.
    """
    if not plants:
        return
    rows = file.metadata.row_group(group).num_rows if 0 <= group < file.metadata.num_row_groups else 0
    if rows != plants:
        raise ValueError(f"{rows:,} rows where the history tells of {plants:,} plants")
    need, free = 16 * rows * file.metadata.num_columns, free_bytes()  # of 8 bytes at most, twice
    if need > free / 2:
        raise ResourceError(
            "the history's plants do not fit into memory",
            expected=f"at most half of the {free / 1e9:.1f} GB that are free",
            got=f"{need / 1e9:,.1f} GB",
        )


@contextmanager
def _readable(path: Path) -> Iterator[Any]:
    """The Parquet file; whatever is wrong with it is an `AssetError`."""
    try:
        with pq.ParquetFile(path) as file:
            yield file
    except (
        OSError,
        pa.ArrowException,
        LookupError,
        ValueError,
        TypeError,
        AttributeError,
        ArithmeticError,
        RecursionError,
    ) as error:
        raise AssetError(
            "not a readable history of a community",
            where=str(path),
            expected="a history.parquet written by this version of forestgen",
            got=f"no {error}" if isinstance(error, KeyError) else str(error),
        ) from error


def open_history(path: Path) -> History:
    """A file that `write_history` wrote.

    Raises
    ------
    AssetError : no such file, or not a history.
    """
    with _readable(path) as file:
        about = json.loads((file.metadata.metadata or {})[_KEY])
        if about["version"] != _VERSION:
            raise ValueError(f"version {about['version']} of the format, not {_VERSION}")
        snapshots = [(float(time_yr), int(n), int(step), state) for time_yr, n, step, state in about["snapshots"]]
        names, modules = tuple(about["species_names"]), about.get("modules")
        maps, sums = tuple(about.get("maps", ())), tuple(about["map_sums"] if "maps" in about else ())
        history = History(path, names, about["origin"], snapshots, "modules" in about, modules, maps, sums)
        _check_told(history)
        return history


def _check_told(history: History) -> None:
    """Raise `ValueError` unless what a file's metadata tells of its snapshots fits together."""
    snapshots, steps = history._snapshots, history.steps
    if not snapshots or steps[0] < 0 or any(one >= other for one, other in pairwise(steps)):
        raise ValueError("its steps do not rise from 0 or more")
    if not all(math.isfinite(time_yr) and n >= 0 for time_yr, n, _, _ in snapshots):
        raise ValueError("a snapshot's time or number of plants is impossible")
    if not all(isinstance(one, dict) for one in [history.origin, *(state for *_, state in snapshots)]):
        raise ValueError("its origin, or the state of a snapshot, is no table")
    if not all(isinstance(name, str) for name in (*history.species_names, *history.maps)):
        raise ValueError("names of species and maps must be texts")
    told = len(snapshots)
    marks = told if history._modules is None else len(history._modules)
    if marks != told or len(history._map_sums) != (told if history.maps else 0):
        raise ValueError("modules or maps are told of another number of snapshots")


def read_history(path: Path) -> list[Population]:
    """The snapshots of a file that `write_history` wrote, all in memory.

    Raises
    ------
    AssetError : no such file, or not a history.
    """
    return list(open_history(path))
