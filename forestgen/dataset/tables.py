"""plants.parquet: one row a plant of the population, seen or not."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from forestgen.community.population import Population, Status
from forestgen.dataset.files import write_bytes
from forestgen.labels.plants_table import VisiblePlants

STATUS_NAMES = {int(status): status.name.lower() for status in Status}


def write_plants(path: Path, population: Population, visible: VisiblePlants) -> None:
    """Write what the community knows of each plant beside what the camera sees of it.

    Lengths are metres in the world frame, boxes are pixels and null where the plant wins no pixel. `status` holds the
    numbers of `forestgen.community.population.Status`; the file's metadata names them. Rows are sorted by plant_id.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not np.array_equal(population.plant_id, visible.plant_id):
        raise ValueError("population and visible plants must be the same plants in the same order")
    table = pa.table(_columns(population, visible), metadata={"forestgen.status": json.dumps(STATUS_NAMES)})
    buffer = io.BytesIO()
    pq.write_table(table, buffer, compression="zstd")
    write_bytes(path, buffer.getvalue())


def _columns(population: Population, visible: VisiblePlants) -> dict[str, Any]:
    import pyarrow as pa

    names = np.array([*population.species_names, ""], dtype=object)  # the last only keeps an empty list an array
    unseen = ~visible.has_box
    box = {
        f"box_{side}": pa.array(visible.box_px[:, i], type=pa.int32(), mask=unseen)
        for i, side in enumerate(("x", "y", "w", "h"))
    }
    return {
        "plant_id": pa.array(population.plant_id, type=pa.uint32()),
        "species": pa.array(names[population.species], type=pa.string()),
        **{f"{axis}_m": pa.array(population.position_m[:, i], type=pa.float64()) for i, axis in enumerate("xyz")},
        "height_m": pa.array(population.height_m, type=pa.float64()),
        "radius_m": pa.array(population.radius_m, type=pa.float64()),
        "age_yr": pa.array(population.age_yr, type=pa.float64()),
        "status": pa.array(population.status, type=pa.uint8()),
        "visible_pixels": pa.array(visible.visible_pixels, type=pa.int64()),
        "visible_area_px": pa.array(visible.visible_area_px, type=pa.float64()),
        **box,
        "truncated": pa.array(visible.truncated, type=pa.bool_()),
    }
