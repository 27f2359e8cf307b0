"""Values of an index that anybody may have written: within these bounds all that is computed from them is finite.

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

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from forestgen.core.errors import DatasetError

# What a frame cannot be without.
FRAME_COLUMNS = ("frame", "split", "image", "channels", "width_px", "height_px", "plants_in_view")
_LARGEST, _LARGEST_OF_OTHERS = 1e12, 1e100
_LONG = ("image", "image_seed")
_MOST_COUNTS = 64
_MOST_SIDE_PX = 16_384


def check_values(table: Any, kinds: Mapping[str, str], path: Path) -> None:
    """Refuse values beyond this module's bounds.

    Parameters
    ----------
    table : a `pyarrow.Table` whose columns are of their types.
    kinds : column -> kind, of those that the index knows.

    Raises
    ------
    DatasetError
    """
    from pyarrow import types

    for field in table.schema:
        chunks = table[field.name].chunks
        most = _LARGEST if field.name in kinds and field.name not in _LONG else _LARGEST_OF_OTHERS
        if types.is_list(field.type) and kinds.get(field.name) == "list of int64":
            good = all(_are_counts(chunk) for chunk in chunks)
        elif types.is_map(field.type) and field.name in kinds:
            good = all(_are_within(chunk.items, 0.0, most) for chunk in chunks)
        else:
            good = all(_are_within(chunk, -most, most) for chunk in chunks)
        if not good:
            raise DatasetError("a value of the index is out of all bounds", where=str(path), got=ascii(field.name)[:80])


def check_frames(table: Any, path: Path) -> None:
    """Refuse rows of which no frame can be read; see the module. Raises `DatasetError`."""
    import pyarrow.compute as pc

    wrong = next((name for name in FRAME_COLUMNS if table[name].null_count), None)
    lengths = pc.list_value_length(table["channels"])
    if wrong is None and (pc.list_flatten(table["channels"]).null_count or not pc.all(pc.greater(lengths, 0)).as_py()):
        wrong = "channels"
    for name in ("width_px", "height_px"):
        sides = table[name].to_numpy() if wrong is None else np.empty(0)
        if ((sides < 1) | (sides > _MOST_SIDE_PX)).any():
            wrong = name
    if table.num_rows and wrong is not None:
        expected = f"a value of {wrong} in each row, as forestgen writes it"
        raise DatasetError("a row of the index is not a frame's", where=str(path), expected=expected)


def plain_rows(table: Any, path: Path) -> list[dict[str, Any]]:
    """The rows as plain values, maps as dicts.

    Raises
    ------
    DatasetError : a map has a key twice, a text is no UTF-8, or Python has no such value.
    """
    import pyarrow as pa

    try:
        return list(table.to_pylist(maps_as_pydicts="strict"))
    except (ValueError, KeyError, TypeError, OverflowError, pa.ArrowException) as error:
        got = " ".join(str(error).split())[:200]
        raise DatasetError("a row of the index cannot be read", where=str(path), got=got) from error


def _are_counts(lists: Any) -> bool:
    import pyarrow.compute as pc

    lengths = pc.list_value_length(lists).drop_null().to_numpy()
    values = lists.flatten()
    return bool((lengths <= _MOST_COUNTS).all()) and not values.null_count and _are_within(values, 0.0, _LARGEST)


def _are_within(values: Any, low: float, high: float) -> bool:
    """Whether an array's numbers are; nulls, NaN and what is no number are. Whole numbers fit int64 besides."""
    from pyarrow import types

    if not (types.is_integer(values.type) or types.is_floating(values.type)):
        return True
    known = values.drop_null().to_numpy(zero_copy_only=False)
    if known.dtype.kind == "u" and (known > np.iinfo(np.int64).max).any():
        return False
    return not ((known < low) | (known > high)).any()
