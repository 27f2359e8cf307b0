"""The history of a community as a Parquet table: one row a plant a snapshot, in the snapshots' order.

Columns: ``time_yr`` and those of `Population` (position as ``x_m``, ``y_m``, ``z_m``); a model's own columns follow,
with ``model.`` before their name. The file's metadata names the species, and each snapshot's time and number of plants,
for a snapshot without plants has no rows. The same snapshots give the same bytes.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from forestgen.community.population import Population
from forestgen.core.errors import AssetError, OutputError

_OWN = "model."
_KEY = b"forestgen.community"
_COLUMNS = {
    "time_yr": pa.float64(),
    "plant_id": pa.uint32(),
    "species": pa.uint16(),
    "x_m": pa.float64(),
    "y_m": pa.float64(),
    "z_m": pa.float64(),
    "radius_m": pa.float64(),
    "height_m": pa.float64(),
    "age_yr": pa.float64(),
    "status": pa.uint8(),
}


def _table(population: Population) -> Any:
    columns = {
        "time_yr": np.full(len(population), population.time_yr),
        "plant_id": population.plant_id,
        "species": population.species,
        "x_m": population.position_m[:, 0].copy(),
        "y_m": population.position_m[:, 1].copy(),
        "z_m": population.position_m[:, 2].copy(),
        "radius_m": population.radius_m,
        "height_m": population.height_m,
        "age_yr": population.age_yr,
        "status": population.status,
    }
    columns.update({_OWN + name: values for name, values in population.columns.items()})
    return pa.table({name: pa.array(values, type=_COLUMNS.get(name)) for name, values in columns.items()})


def _write(path: Path, populations: Iterable[Population]) -> None:
    writer, names, snapshots = None, None, []
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
            snapshots.append([population.time_yr, len(population)])
        if writer is None:
            raise ValueError("a history needs at least one snapshot")
        about = {"version": 1, "species_names": names, "snapshots": snapshots}
        writer.add_key_value_metadata({_KEY: json.dumps(about).encode()})
    finally:
        if writer is not None:
            writer.close()


def write_history(path: Path, populations: Iterable[Population]) -> None:
    """Write snapshots as they come; only one is held in memory. The file appears when it is complete.

    Raises
    ------
    OutputError : the file cannot be written.
    ValueError : no snapshot, or snapshots of different species or columns.
    """
    partial = path.with_name(path.name + ".partial")
    try:
        _write(partial, populations)
        partial.replace(path)
    except OSError as error:
        raise OutputError(
            "the community's history cannot be written", where=str(path), got=str(error), hint="another folder or disk"
        ) from error
    finally:
        partial.unlink(missing_ok=True)


def _population(table: Any, time_yr: float, species_names: tuple[str, ...]) -> Population:
    columns = {name: table.column(name).to_numpy() for name in table.column_names}
    return Population(
        time_yr=time_yr,
        species_names=species_names,
        plant_id=columns["plant_id"],
        species=columns["species"],
        position_m=np.stack([columns["x_m"], columns["y_m"], columns["z_m"]], axis=1),
        radius_m=columns["radius_m"],
        height_m=columns["height_m"],
        age_yr=columns["age_yr"],
        status=columns["status"],
        columns={name.removeprefix(_OWN): values for name, values in columns.items() if name.startswith(_OWN)},
    )


def read_history(path: Path) -> list[Population]:
    """The snapshots of a file that `write_history` wrote, all in memory.

    Raises
    ------
    AssetError : no such file, or not a history.
    """
    try:
        with pq.ParquetFile(path) as file:
            about = json.loads((file.metadata.metadata or {})[_KEY])
            table = file.read()
    except (OSError, pa.ArrowException, KeyError, ValueError) as error:
        raise AssetError(
            "not a readable history of a community",
            where=str(path),
            expected="a Parquet file written by forestgen",
            got=str(error),
        ) from error
    populations, first = [], 0
    for time_yr, count in about["snapshots"]:
        populations.append(_population(table.slice(first, count), time_yr, tuple(about["species_names"])))
        first += count
    return populations
