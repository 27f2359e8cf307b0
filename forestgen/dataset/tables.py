"""plants.parquet: one row a plant of the population, seen or not, by rising plant_id.

Lengths are metres in the world frame; pixels count from the image's upper left corner, right and down. Null: unknown,
or nothing there. How the image's columns are defined stands in `forestgen.labels.plants_table`, the measures in
`forestgen.scene.plant_measures`.

| column | type | meaning | null |
|--------|------|---------|------|
| plant_id | uint32 | the key of all files | |
| species | string | name in the recipe | |
| x_m, y_m, z_m | double | where it stands | |
| height_m, radius_m | double | the community's height and radius of the ecological neighbourhood | |
| age_yr | double | | |
| status | uint8 | `forestgen.community.population.Status`; names are in the file's metadata | |
| adaptation | double | how well climate and soil water suit it, 0 to 1, as felt in its last step | of models without |
| exemplar | uint32 | which of the modelled plants stands for it | |
| crown_width_m | double | mean of the extents along its own x and y | |
| dbh_m | double | stem diameter at 1.3 m | no living stem there |
| leaf_area_m2 | double | one side of all blades | |
| distance_m | double | from the camera to the stem base | |
| visible_pixels | int64 | pixels won in the instance mask | |
| visible_area_px | double | sum of coverage | |
| box_x, box_y, box_w, box_h | int32 | of the pixels won | none won |
| truncated | bool | a won pixel touches the image's border | |
| stem_pixels | int64 | pixels won with its trunk | |
| amodal_pixels | int64 | pixels of the amodal mask | no amodal mask |
| amodal_area_px | double | sum of coverage of the plant alone | no amodal mask |
| amodal_box_x, ..._y, ..._w, ..._h | int32 | of the amodal mask | no amodal mask, or an empty one |
| visible_fraction | double | visible over amodal area, 0 to 1 | no amodal mask, or an empty one |
| full_box_left, ..._top, ..._right, ..._bottom | double | of its projection, to 16 image sizes away | no amodal mask |
| truncation | double | share of the full box outside the image, 0 to 1 | no amodal mask |
| stem_base_x_px, stem_base_y_px | double | projected stem base | behind the camera |
| stem_base_state | uint8 | 0 outside the image, 1 hidden, 2 the plant wins its pixel | |
| tip_..., crown_centre_... | | the same of the highest point and of the crown's centre | |

Plants that the identity pass did not see have no amodal mask; none has where the recipe's labels.channels leave amodal
out.
"""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population, Status
from forestgen.dataset.files import write_bytes
from forestgen.labels.labelled import LabelledFrame
from forestgen.labels.plants_table import KEYPOINTS, PlantViews
from forestgen.scene.plant_measures import PlantMeasures

STATUS_NAMES = {int(status): status.name.lower() for status in Status}
_SIDES = ("x", "y", "w", "h")


def write_plants(path: Path, labelled: LabelledFrame) -> None:
    """Write what is known of each plant: the table above."""
    import pyarrow.parquet as pq

    buffer = io.BytesIO()
    pq.write_table(plants_table(labelled), buffer, compression="zstd")
    write_bytes(path, buffer.getvalue())


def plants_table(labelled: LabelledFrame) -> Any:
    """The table above, a `pyarrow.Table`."""
    import pyarrow as pa

    if not np.array_equal(labelled.population.plant_id, labelled.views.visible.plant_id):
        raise ValueError("population and views must be of the same plants in the same order")
    columns = {
        **_community(labelled.population),
        **_measures(labelled.measures),
        **_views(labelled.views),
        **_amodal(labelled.views),
        **_keypoints(labelled.views),
    }
    return pa.table(columns, metadata={"forestgen.status": json.dumps(STATUS_NAMES)})


def _community(population: Population) -> dict[str, Any]:
    import pyarrow as pa

    unknown = np.full(len(population), np.nan)
    names = np.array([*population.species_names, ""], dtype=object)  # the last only keeps an empty list an array
    return {
        "plant_id": pa.array(population.plant_id, type=pa.uint32()),
        "species": pa.array(names[population.species], type=pa.string()),
        **{f"{axis}_m": _numbers(population.position_m[:, i]) for i, axis in enumerate("xyz")},
        "height_m": _numbers(population.height_m),
        "radius_m": _numbers(population.radius_m),
        "age_yr": _numbers(population.age_yr),
        "status": pa.array(population.status, type=pa.uint8()),
        "adaptation": _numbers(np.asarray(population.columns.get("adaptation", unknown), dtype=np.float64)),
    }


def _measures(measures: PlantMeasures) -> dict[str, Any]:
    import pyarrow as pa

    return {
        "exemplar": pa.array(measures.exemplar, type=pa.uint32()),
        "crown_width_m": _numbers(measures.crown_width_m),
        "dbh_m": _numbers(measures.dbh_m),
        "leaf_area_m2": _numbers(measures.leaf_area_m2),
    }


def _views(views: PlantViews) -> dict[str, Any]:
    import pyarrow as pa

    visible = views.visible
    return {
        "distance_m": _numbers(views.distance_m),
        "visible_pixels": pa.array(visible.visible_pixels, type=pa.int64()),
        "visible_area_px": _numbers(visible.visible_area_px),
        **_box("box", visible.box_px, ~visible.has_box),
        "truncated": pa.array(visible.truncated, type=pa.bool_()),
        "stem_pixels": pa.array(views.stem_pixels, type=pa.int64()),
    }


def _amodal(views: PlantViews) -> dict[str, Any]:
    import pyarrow as pa

    unknown = np.isnan(views.amodal_area_px)
    sides = ("left", "top", "right", "bottom")
    return {
        "amodal_pixels": pa.array(views.amodal_pixels, type=pa.int64(), mask=unknown),
        "amodal_area_px": _numbers(views.amodal_area_px),
        **_box("amodal_box", views.amodal_box_px, views.amodal_pixels == 0),
        "visible_fraction": _numbers(views.visible_fraction),
        **{f"full_box_{side}": _numbers(views.full_box_px[:, i]) for i, side in enumerate(sides)},
        "truncation": _numbers(views.truncation),
    }


def _keypoints(views: PlantViews) -> dict[str, Any]:
    import pyarrow as pa

    columns: dict[str, Any] = {}
    for k, name in enumerate(KEYPOINTS):
        for axis, symbol in enumerate("xy"):
            columns[f"{name}_{symbol}_px"] = _numbers(views.keypoint_px[:, k, axis])
        columns[f"{name}_state"] = pa.array(views.keypoint_state[:, k], type=pa.uint8())
    return columns


def _box(name: str, box_px: NDArray[np.int32], none: NDArray[np.bool_]) -> dict[str, Any]:
    import pyarrow as pa

    return {f"{name}_{side}": pa.array(box_px[:, i], type=pa.int32(), mask=none) for i, side in enumerate(_SIDES)}


def _numbers(values: NDArray[np.float64]) -> Any:
    """A column of doubles; NaN is null."""
    import pyarrow as pa

    return pa.array(np.ascontiguousarray(values), type=pa.float64(), mask=np.isnan(values))
