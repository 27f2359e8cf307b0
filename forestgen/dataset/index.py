"""index.parquet: a row a frame, for those who choose, weigh and count images without opening them.

Metres, degrees, pixels; the world's axes are x east, y north, z up. Shares are 0 to 1. Null: unknown, or nothing there.

| column | type | meaning |
|--------|------|---------|
| frame | string | name of the frame's folder |
| folder | string | its path below the data set's folder: SPLIT/FRAME |
| split, image, camera | string, int64, string | |
| sequence, time_s | string, double | of a camera that moves: its path, and the time on it |
| image_seed | int64 | root of the image's randomness |
| recipe_hash | string | SHA-256 of the drawn recipe |
| width_px, height_px | int32 | |
| camera_kind | string | perspective, fisheye, orthographic, panorama |
| hfov_deg | double | across the width; null: orthographic, panorama |
| camera_x_m, camera_y_m, camera_z_m | double | where it stands |
| camera_height_m | double | above the ground below it |
| camera_pitch_deg, camera_azimuth_deg | double | of its axis: above the horizon, clockwise from north |
| sky_kind, clouds | string, string | clear or overcast; the recipe's sky.clouds.type |
| cloud_cover | double | the recipe's, of clouds of type noise |
| cloud_share | double | mean opacity of the clouds over the sky's pixels |
| sun_elevation_deg, sun_azimuth_deg | double | |
| moon_elevation_deg, moon_azimuth_deg | double | null: no moon |
| turbidity, visibility_m | double, double | null: no haze between camera and scene |
| season, wind_m_per_s | string, double | |
| channels | list of string | of radiance: R, G, B or the bands |
| samples, stopped_by | int64, string | of the rendering |
| relative_error, relative_error_p95 | double | its noise: standard error over value, mean and 95th percentile |
| sky_share | double | of the pixels, those whose centre sees the sky |
| sunlit_share | double | of the other pixels, those whose centre the sun shines on, or by night the moon |
| depth_min_m, depth_median_m, depth_max_m | double | without the sky |
| plants | int64 | of the whole stand |
| stems_per_ha, basal_area_m2_per_ha | double | of the image's stand: living stems from 7 cm at 1.3 m on |
| quadratic_mean_diameter_cm, mean_height_m, slenderness | double | of these stems; height over diameter, median |
| dominant_height_m | double | mean of the 100 thickest stems a hectare |
| stem_volume_m3_per_ha, biomass_t_per_ha | double | trunks of these stems; dry, of all plants |
| leaf_area_index, canopy_cover | double | of all plants; share of vertical rays that meet one above 1.3 m |
| plants_in_view, plants_truncated | int64 | those that win a pixel; of these, those that touch the border |
| visible_fraction_median | double | of the plants in view; needs amodal labels |
| instance_pixels_median | double | of the plants in view |
| instance_pixels_histogram | list of int64 | how many plants in view win 1, 2-3, 4-7, 8-15, ... pixels |
| class_pixels | map | pixels by name of the semantic class |
| part_pixels | map | pixels by part of the plant |
| category_instances | map | plants in view by category, as in coco.json |
| species_instances, species_pixels | map | plants in view, and the pixels that they win, by species |
| notes | list of string | what people should know of the frame |
| draw.KEY | as drawn | what the recipe's distribution at KEY gave, such as draw.sky.turbidity |

Maps leave out what is not there. A draw's column has one type in all rows: where draws are both numbers and texts,
JSON.

Anybody may have written an index. Within these bounds all that is computed from its values is finite:

| column | bound |
|---|---|
| image, image_seed, and whole numbers of columns that the index does not know | int64 |
| other numbers | below 1e12 in size; of columns that the index does not know, such as draws, 1e100 |
| instance_pixels_histogram | at most 64 counts, each 0 to 1e12 and known |
| maps | counts of 0 to 1e12 |

Of frames that are to be read besides: neither name nor size is null, a side is 1 to 16,384 pixels, and there are
channels.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from forestgen.core.errors import DatasetError, writing
from forestgen.dataset.files import make_folder
from forestgen.dataset.safe_path import SafePath, check_cells, is_frame, is_split, one_line
from forestgen.dataset.settings import DRAW

INDEX_NAME = "index.parquet"
_TEXT, _WHOLE, _SMALL, _NUMBER = "string", "int64", "int32", "double"
_TEXTS, _COUNTS, _BY_NAME, _JSON = "list of string", "list of int64", "map", "JSON"
COLUMNS: dict[str, str] = {
    **dict.fromkeys(("frame", "folder", "split"), _TEXT), "image": _WHOLE,
    **dict.fromkeys(("camera", "sequence"), _TEXT), "time_s": _NUMBER, "image_seed": _WHOLE, "recipe_hash": _TEXT,
    **dict.fromkeys(("width_px", "height_px"), _SMALL), "camera_kind": _TEXT,
    **dict.fromkeys(("hfov_deg", "camera_x_m", "camera_y_m", "camera_z_m"), _NUMBER),
    **dict.fromkeys(("camera_height_m", "camera_pitch_deg", "camera_azimuth_deg"), _NUMBER),
    **dict.fromkeys(("sky_kind", "clouds"), _TEXT),
    **dict.fromkeys(("cloud_cover", "cloud_share", "sun_elevation_deg", "sun_azimuth_deg"), _NUMBER),
    **dict.fromkeys(("moon_elevation_deg", "moon_azimuth_deg"), _NUMBER),
    **dict.fromkeys(("turbidity", "visibility_m"), _NUMBER), "season": _TEXT, "wind_m_per_s": _NUMBER,
    "channels": _TEXTS, "samples": _WHOLE,
    **dict.fromkeys(("relative_error", "relative_error_p95"), _NUMBER), "stopped_by": _TEXT,
    **dict.fromkeys(("sky_share", "sunlit_share", "depth_min_m", "depth_median_m", "depth_max_m"), _NUMBER),
    **dict.fromkeys(("plants", "plants_in_view", "plants_truncated"), _WHOLE),
    **dict.fromkeys(("stems_per_ha", "basal_area_m2_per_ha", "quadratic_mean_diameter_cm", "mean_height_m"), _NUMBER),
    **dict.fromkeys(("dominant_height_m", "slenderness", "stem_volume_m3_per_ha", "biomass_t_per_ha"), _NUMBER),
    **dict.fromkeys(("leaf_area_index", "canopy_cover"), _NUMBER),
    **dict.fromkeys(("visible_fraction_median", "instance_pixels_median"), _NUMBER),
    "instance_pixels_histogram": _COUNTS,
    **dict.fromkeys(("class_pixels", "part_pixels"), _BY_NAME),
    **dict.fromkeys(("category_instances", "species_instances", "species_pixels"), _BY_NAME),
    "notes": _TEXTS,
}  # fmt: skip
_ROWS_A_GROUP = 500
# What a frame cannot be without.
_FRAME_COLUMNS = ("frame", "split", "image", "channels", "width_px", "height_px", "plants_in_view")
_LARGEST, _LARGEST_OF_OTHERS = 1e12, 1e100
_LONG = ("image", "image_seed")
_MOST_COUNTS = 64
_MOST_SIDE_PX = 16_384


class DrawTypes:
    """Types of the draws' columns, gathered row by row: no schema is known before all rows are."""

    def __init__(self) -> None:
        self._kinds: dict[str, set[str]] = {}

    def add(self, row: Mapping[str, Any]) -> None:
        """Take a row of `frame_row` into account."""
        for name, value in row.items():
            if name.startswith(DRAW):
                self._kinds.setdefault(name, set()).add(_kind(value))

    @property
    def columns(self) -> dict[str, str]:
        """Column -> type, by name: boolean, int64, double, string or JSON."""
        kinds = {name: self._kinds[name] - {"null"} for name in sorted(self._kinds)}
        several = {name: _NUMBER if own == {_WHOLE, _NUMBER} else _JSON for name, own in kinds.items()}
        return {name: min(own) if len(own) == 1 else several[name] for name, own in kinds.items()}


def _kind(value: Any) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "boolean"
    if isinstance(value, int | float):
        return _WHOLE if _is_whole(value) else _NUMBER
    return _TEXT if isinstance(value, str) else _JSON


def write_index(path: Path, rows: Iterable[Mapping[str, Any]], draws: Mapping[str, str]) -> None:
    """Write the rows of `frame_row`, in that order, a few hundred in memory at a time; its folder is made if missing.

    Parameters
    ----------
    draws : `DrawTypes.columns` of all rows.

    Raises
    ------
    OutputError : the file cannot be written.
    ValueError : a row has a column that the index does not know.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = {**COLUMNS, **draws}
    schema = pa.schema([(name, _arrow_type(kind)) for name, kind in columns.items()])
    make_folder(path.parent)
    with writing(path), pq.ParquetWriter(path, schema, compression="zstd") as writer:
        remaining = iter(rows)
        while group := list(islice(remaining, _ROWS_A_GROUP)):
            strangers = {name for row in group for name in row} - set(columns)
            if strangers:
                raise ValueError(f"the index has no columns {sorted(strangers)}")
            cells = [
                pa.array([_cell(row.get(name), kind) for row in group], _arrow_type(kind))
                for name, kind in columns.items()
            ]
            writer.write_table(pa.Table.from_arrays(cells, schema=schema))
            del group, cells  # before the next group is read


def read_index(path: Path) -> Iterator[dict[str, Any]]:
    """Rows as `frame_row` made them, but for draws of other rows, which are None; a group in memory at a time.

    A file that is missing, or no index, raises `DatasetError`.
    """
    with open_index(path, ("frame", "folder", "split", "image")) as file:
        for number in range(file.num_row_groups):
            yield from plain_rows(file.read_row_group(number), path)


@contextmanager
def open_index(path: Path, needed: Sequence[str]) -> Iterator[Any]:
    """The index as a pyarrow.parquet.ParquetFile, whose known columns are of their types; `needed` ones must be there.

    A file that is missing, no index, or cannot be read in this block, raises `DatasetError`.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with SafePath(path.parent, path.name).open() as stream, pq.ParquetFile(stream) as file:
            names = file.schema_arrow.names
            if missing := [name for name in needed if name not in names]:
                raise _wrong("this is no index of forestgen", path, expected=f"columns {', '.join(missing)}")
            check_cells(file.metadata.num_rows, len(names))
            strange = [field.name for field in file.schema_arrow if not _is_of_its_type(field, needed)]
            if strange or len(set(names)) < len(names):
                raise _wrong("a column of the index is not of its type", path, got=", ".join(strange))
            yield file
    except FileNotFoundError as error:
        raise _wrong("there is no index", path) from error
    except (OSError, ValueError, pa.ArrowException) as error:  # ValueError: texts that are no UTF-8
        raise _wrong("the index cannot be read", path, got=one_line(error)) from error


def _wrong(problem: str, path: Path, **texts: str) -> DatasetError:
    """The error of an index; `texts`: `expected` and `got`."""
    hint = "the command that made the data set, with `resume=True`, writes it again"
    return DatasetError(problem, where=str(path), hint=hint, **texts)


def open_table(path: Path, needed: Sequence[str]) -> Any:
    """The index as a `pyarrow.Table`; a value beyond this module's bounds raises `DatasetError`, see `open_index`."""
    with open_index(path, needed) as file:
        table = file.read()
        table.validate(full=True)  # texts are UTF-8
    for field in table.schema:
        if not all(_is_bounded(field, chunk) for chunk in table[field.name].chunks):
            raise _wrong("a value of the index is out of all bounds", path, got=ascii(field.name)[:80])
    return table


def whole_index(path: Path) -> Any:
    """The index as a `pyarrow.Table`, whose rows name folders of frames below the data set's folder.

    A row that is no frame's, or a frame with two rows, raises `DatasetError`, see `open_table`.
    """
    index = open_table(path, _FRAME_COLUMNS)
    if index.num_rows and (wrong := _wrong_column(index)) is not None:
        expected = f"a value of {wrong} in each row, as forestgen writes it"
        raise _wrong("a row of the index is not a frame's", path, expected=expected)
    names = list(zip(index["split"].to_pylist(), index["frame"].to_pylist(), strict=True))
    for split, frame in names:
        if not is_split(split) or not is_frame(frame):
            expected, got = "names such as train and 000000-camera0", ascii((split, frame))[:160]
            raise _wrong("a row of the index names no frame", path, expected=expected, got=got)
    if len({frame for _, frame in names}) < len(names):
        raise _wrong("a frame has two rows of the index", path)
    return index


def plain_rows(table: Any, path: Path) -> list[dict[str, Any]]:
    """The rows of an index as plain values, maps as dicts; what Python has no such value for raises `DatasetError`."""
    import pyarrow as pa

    try:
        return list(table.to_pylist(maps_as_pydicts="strict"))
    except (ValueError, KeyError, TypeError, OverflowError, pa.ArrowException) as error:
        raise _wrong("a row of the index cannot be read", path, got=one_line(error)) from error


def _wrong_column(index: Any) -> str | None:
    """A column whose values are no frames'; None: there is none."""
    import pyarrow.compute as pc

    wrong = next((name for name in _FRAME_COLUMNS if index[name].null_count), None)
    if wrong is not None:
        return wrong
    is_listed = pc.greater(pc.list_value_length(index["channels"]), 0)
    if pc.list_flatten(index["channels"]).null_count or not pc.all(is_listed).as_py():
        return "channels"
    for name in ("width_px", "height_px"):
        sides = index[name].to_numpy()
        if ((sides < 1) | (sides > _MOST_SIDE_PX)).any():
            return name
    return None


def _is_bounded(field: Any, chunk: Any) -> bool:
    """Whether a column's array keeps within this module's bounds."""
    import pyarrow.compute as pc
    from pyarrow import types

    most = _LARGEST if field.name in COLUMNS and field.name not in _LONG else _LARGEST_OF_OTHERS
    if types.is_list(field.type) and COLUMNS.get(field.name) == _COUNTS:
        values, lengths = chunk.flatten(), pc.list_value_length(chunk).drop_null().to_numpy()
        return bool((lengths <= _MOST_COUNTS).all()) and not values.null_count and _are_within(values, 0.0, most)
    if types.is_map(field.type) and field.name in COLUMNS:
        return _are_within(chunk.items, 0.0, most)
    return _are_within(chunk, -most, most)


def _are_within(values: Any, low: float, high: float) -> bool:
    """Whether an array's numbers are; nulls, NaN and what is no number are. Whole numbers fit int64 besides."""
    from pyarrow import types

    if not (types.is_integer(values.type) or types.is_floating(values.type)):
        return True
    known = values.drop_null().to_numpy(zero_copy_only=False)
    if known.dtype.kind == "u" and (known > np.iinfo(np.int64).max).any():
        return False
    return not ((known < low) | (known > high)).any()


def _is_of_its_type(field: Any, needed: Sequence[str]) -> bool:
    """Whether a column is of the kind that its name stands for; of unknown names any, and null where none is needed."""
    from pyarrow import types

    wanted, kind = COLUMNS.get(field.name), field.type
    if types.is_null(kind):
        return field.name not in needed
    if wanted == _BY_NAME:
        return bool(types.is_map(kind) and types.is_string(kind.key_type) and types.is_integer(kind.item_type))
    if wanted in (_TEXTS, _COUNTS):
        is_item = types.is_string if wanted == _TEXTS else types.is_integer
        return bool(types.is_list(kind) and (is_item(kind.value_type) or types.is_null(kind.value_type)))
    texts, whole, numbers = (types.is_string, types.is_large_string), (types.is_integer,), (types.is_floating,)
    tests = {_TEXT: texts, _WHOLE: whole, _SMALL: whole, _NUMBER: (*numbers, *whole)}
    plain = tests.get(wanted or "", (types.is_boolean, *whole, *numbers, *texts))  # the latter of draws
    return any(test(kind) for test in plain) or (wanted is None and not field.name.startswith(DRAW))


def check_row(row: Mapping[str, Any]) -> None:
    """Refuse a row that `write_index` cannot take, with a `ValueError`."""
    for name, value in row.items():
        kind = COLUMNS.get(name)
        if kind is None and not name.startswith(DRAW):
            raise ValueError(f"{name!r:.60} is no column of the index")
        if kind is not None and value is not None and not _FITS[kind](value):
            raise ValueError(f"{name} is {value!r:.60}")
    if not {"frame", "split", "image"} <= row.keys():
        raise ValueError("a row lacks frame, split or image")


def _is_whole(value: Any, bits: int = 64) -> bool:
    return type(value) is int and -(2 ** (bits - 1)) <= value < 2 ** (bits - 1)


_FITS: dict[str, Callable[[Any], bool]] = {
    _TEXT: lambda value: isinstance(value, str),
    _WHOLE: _is_whole,
    _SMALL: lambda value: _is_whole(value, 32),
    _NUMBER: lambda value: isinstance(value, float) or _is_whole(value),
    _TEXTS: lambda value: isinstance(value, list) and all(isinstance(one, str) for one in value),
    _COUNTS: lambda value: isinstance(value, list) and all(map(_is_whole, value)),
    _BY_NAME: lambda value: isinstance(value, dict) and all(map(_is_whole, value.values())),
}


def _arrow_type(kind: str) -> Any:
    import pyarrow as pa

    if kind == _BY_NAME:
        return pa.map_(pa.string(), pa.int64())
    if kind in (_TEXTS, _COUNTS):
        return pa.list_(pa.string() if kind == _TEXTS else pa.int64())
    return pa.type_for_alias({_JSON: "string", "boolean": "bool"}.get(kind, kind))


def _cell(value: Any, kind: str) -> Any:
    if value is None:
        return None
    if kind == _JSON:
        return json.dumps(value, sort_keys=True)
    if kind == _BY_NAME:
        return list(value.items())
    return float(value) if kind == _NUMBER else value
