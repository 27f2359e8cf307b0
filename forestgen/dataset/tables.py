"""plants.parquet: one row a plant of the site, visible or not, and of those around it that are in view, by plant_id.

Lengths are metres in the world frame; pixels count from the image's upper left corner, right and down. Null: unknown,
or nothing there. How the image's columns are defined stands in `forestgen.labels.labelled`, the measures in
`forestgen.scene.plant_measures`.

| column | type | meaning | null |
|--------|------|---------|------|
| plant_id | uint32 | the key of all files | |
| species | string | name in the recipe | |
| x_m, y_m, z_m | double | where it stands | |
| height_m | double | the community's height; of a tree that lies, its length | |
| radius_m | double | of the ecological neighbourhood | |
| age_yr | double | | |
| status | uint8 | `forestgen.community.population.Status`; names are in the file's metadata | |
| dead_form | uint8 | a dead tree is 1 standing, 2 uprooted, 3 snapped, 4 a stump | alive, or unknown |
| decay_class | uint8 | of a dead tree, 1 to 5 | alive, or unknown |
| outside | bool | a copy beyond the site's edge that the image shows; all rows but these are the stand | |
| adaptation | double | how well climate and soil water suit it, 0 to 1, in its last step | of models without |
| exemplar | uint32 | which of the modelled plants stands for it | |
| crown_width_m | double | mean of the extents along its own x and y | |
| dbh_m | double | stem diameter at 1.3 m | no living stem there |
| crown_base_m | double | height that 2% of the leaf area lie below | no leaves |
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
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Status
from forestgen.dataset.files import write_bytes
from forestgen.labels.labelled import KEYPOINTS, LabelledFrame

STATUS_NAMES = {int(status): status.name.lower() for status in Status}
_CORNERS = ("left", "top", "right", "bottom")


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
    population, views, visible = labelled.population, labelled.views, labelled.views.visible
    no_mask = np.isnan(views.amodal_area_px)
    adaptation = population.columns.get("adaptation", np.full(len(population), np.nan))
    columns = {
        "plant_id": _column("uint32", population.plant_id),
        "species": _names(population.species_names, population.species),
        **{f"{axis}_m": _numbers(population.position_m[:, i]) for i, axis in enumerate("xyz")},
        **_attributes(population, "height_m", "radius_m", "age_yr"),
        "status": _column("uint8", population.status),
        **{name: _known(population.columns.get(name), len(population)) for name in ("dead_form", "decay_class")},
        "outside": _column("bool", labelled.outside),
        "adaptation": _numbers(np.asarray(adaptation, dtype=np.float64)),
        "exemplar": _column("uint32", labelled.measures.exemplar),
        **_attributes(labelled.measures, "crown_width_m", "dbh_m", "crown_base_m", "leaf_area_m2"),
        **_attributes(views, "distance_m"),
        "visible_pixels": _column("int64", visible.visible_pixels),
        **_attributes(visible, "visible_area_px"),
        **_box("box", visible.box_px, ~visible.has_box),
        "truncated": _column("bool", visible.truncated),
        "stem_pixels": _column("int64", views.stem_pixels),
        "amodal_pixels": _column("int64", views.amodal_pixels, no_mask),
        **_attributes(views, "amodal_area_px"),
        **_box("amodal_box", views.amodal_box_px, views.amodal_pixels == 0),
        **_attributes(views, "visible_fraction"),
        **{f"full_box_{side}": _numbers(views.full_box_px[:, i]) for i, side in enumerate(_CORNERS)},
        **_attributes(views, "truncation"),
    }
    for k, name in enumerate(KEYPOINTS):
        for axis, symbol in enumerate("xy"):
            columns[f"{name}_{symbol}_px"] = _numbers(views.keypoint_px[:, k, axis])
        columns[f"{name}_state"] = _column("uint8", views.keypoint_state[:, k])
    return pa.table(columns, metadata={"forestgen.status": json.dumps(STATUS_NAMES)})


def _known(values: NDArray[np.uint8] | None, count: int) -> Any:
    """A column of small numbers; 0 is null."""
    found = np.zeros(count, dtype=np.uint8) if values is None else values
    return _column("uint8", found, found == 0)


def _attributes(of: Any, *names: str) -> dict[str, Any]:
    """Columns of doubles, each an attribute."""
    return {name: _numbers(getattr(of, name)) for name in names}


def _box(name: str, box_px: NDArray[np.int32], none: NDArray[np.bool_]) -> dict[str, Any]:
    return {f"{name}_{side}": _column("int32", box_px[:, i], none) for i, side in enumerate("xywh")}


def _numbers(values: NDArray[np.float64]) -> Any:
    """A column of doubles; NaN is null."""
    return _column("float64", values, np.isnan(values))


def _column(kind: str, values: NDArray[Any], null: NDArray[np.bool_] | None = None) -> Any:
    """A column of a type's values, null where `null` is true.

    As ``pyarrow.array`` makes it, which would import pandas for it: a second.
    """
    import pyarrow as pa

    content = np.ascontiguousarray(values, dtype=kind)
    bits = content if kind != "bool" else np.packbits(content, bitorder="little")
    known = None if null is None else pa.py_buffer(np.packbits(~null, bitorder="little"))
    return pa.Array.from_buffers(pa.type_for_alias(kind), len(content), [known, pa.py_buffer(bits)])


def _names(names: Sequence[str], index: NDArray[np.unsignedinteger[Any]]) -> Any:
    """A column of strings: the names with the indices (N,)."""
    import pyarrow as pa

    encoded = [name.encode() for name in names]
    length = np.array([len(name) for name in encoded], dtype=np.int64)[index]
    offset = np.concatenate([[0], np.cumsum(length)]).astype(np.int32)
    text = b"".join([encoded[i] for i in index])
    return pa.StringArray.from_buffers(len(index), pa.py_buffer(offset), pa.py_buffer(text))
