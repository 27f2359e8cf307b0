"""The modules of a community's history as a Parquet table: one row a module a snapshot, beside the plants' history.

Columns: ``step``, ``plant_id`` and those of `Modules`; ``base_m`` as ``base_x_m``, ``base_y_m``, ``base_z_m``, and
``rotation`` as ``rotation_w`` to ``rotation_z``. `parent` is the row of the module that bears it, counted from its
plant's first row. A snapshot is one row group. The metadata, JSON under ``forestgen.modules``, has the number of
modules of every snapshot and the checksum of their columns: a history has the same numbers, which tells that the two
files are of one simulation, and that nobody has changed a value.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from zlib import crc32

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from forestgen.architecture.modules import Modules
from forestgen.community.population import Population
from forestgen.core.errors import AssetError

NAME = "modules.parquet"
_KEY = b"forestgen.modules"
_PLAIN = {
    "number": pa.uint32(),
    "parent": pa.int32(),
    "node": pa.int16(),
    "prototype": pa.uint8(),
    "age": pa.float32(),
    "age_yr": pa.float32(),
    "vigour": pa.float32(),
    "light": pa.float32(),
    "disused_m2": pa.float32(),
}
_SPLIT = {
    "base_m": ("base_x_m", "base_y_m", "base_z_m"),
    "rotation": ("rotation_w", "rotation_x", "rotation_y", "rotation_z"),
}
_SCHEMA = pa.schema(
    [("step", pa.uint32()), ("plant_id", pa.uint32()), *_PLAIN.items()]
    + [(name, pa.float32()) for names in _SPLIT.values() for name in names]
)


class ModuleWriter:
    """Writes the modules of snapshots as they come; the file appears when it is complete."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.marks: list[tuple[int, int]] = []  # modules of each snapshot, and their checksum
        self._partial = path.with_name(path.name + ".partial")
        self._writer = pq.ParquetWriter(self._partial, _SCHEMA, compression="zstd")

    def add(self, population: Population) -> None:
        """Write a snapshot's modules."""
        modules = population.modules
        count = 0 if modules is None else len(modules)
        if modules is None or not count:
            self.marks.append((0, 0))
            return
        table = _table(population, modules)
        self._writer.write_table(table, row_group_size=count)
        self.marks.append((count, _checksum(table)))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, _: BaseException | None, __: TracebackType | None) -> None:
        try:
            self._writer.add_key_value_metadata({_KEY: json.dumps(self.marks).encode()})
            self._writer.close()
            if kind is None:
                self._partial.replace(self.path)
        finally:
            self._partial.unlink(missing_ok=True)


def _table(population: Population, modules: Modules) -> Any:
    columns: dict[str, Any] = {
        "step": np.full(len(modules), population.step, dtype=np.uint32),
        "plant_id": population.plant_id[modules.plant()],
    }
    columns.update({name: getattr(modules, name) for name in _PLAIN})
    for name, parts in _SPLIT.items():
        values = getattr(modules, name)
        columns.update({part: np.ascontiguousarray(values[:, k]) for k, part in enumerate(parts)})
    return pa.table({name: pa.array(values) for name, values in columns.items()}, schema=_SCHEMA)


def _checksum(table: Any) -> int:
    """Of the values of all columns, in their order."""
    found = 0
    for name in _SCHEMA.names:
        found = crc32(np.ascontiguousarray(table.column(name).to_numpy()).tobytes(), found)
    return found


def read_modules(path: Path, population: Population, marks: Sequence[Sequence[int]], index: int) -> Modules:
    """The modules of a snapshot's plants.

    Parameters
    ----------
    path : of the modules' table.
    population : the snapshot, without modules.
    marks, index : of every snapshot of the history, and the snapshot's number among them; see `ModuleWriter`.

    Raises
    ------
    AssetError : no such file, damaged, or of another simulation.
    """
    try:
        with pq.ParquetFile(path) as file:
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
            return _modules(table, population)
    except (OSError, pa.ArrowException, LookupError, ValueError, TypeError, AttributeError, ArithmeticError) as error:
        raise AssetError(
            "the modules of this history cannot be read",
            where=str(path),
            expected=f"the {NAME} that was written with it",
            got="no such file" if isinstance(error, FileNotFoundError) else str(error),
            hint="simulate again with `set='community.history_modules=true'`",
        ) from error


def _modules(table: Any, population: Population) -> Modules:
    columns = {name: table.column(name).to_numpy() for name in table.column_names}
    ids = columns["plant_id"]
    first = np.append(np.searchsorted(ids, population.plant_id), len(ids)).astype(np.int64)
    owner = np.repeat(np.arange(len(population)), np.diff(first)) if np.all(np.diff(first) >= 0) else np.zeros(0)
    if first[0] != 0 or len(owner) != len(ids) or np.any(population.plant_id[owner] != ids):
        raise ValueError("its plants are not those of the history")
    split = {name: np.stack([columns[part] for part in parts], axis=1) for name, parts in _SPLIT.items()}
    return Modules(first=first, **{name: columns[name] for name in _PLAIN}, **split)
