"""The columns of an index, however many of them there are: what lacks is unknown, not an error."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from forestgen.core.errors import DatasetError
from forestgen.dataset.index import open_table

_NEEDED = ("frame", "split", "image")
_NUMERIC = (pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean)


class Frames:
    """The rows of a data set's index, a frame each, read by column."""

    def __init__(self, table: pa.Table) -> None:
        self._table = table

    def __len__(self) -> int:
        return int(self._table.num_rows)

    @property
    def names(self) -> list[str]:
        """Of the columns."""
        return [str(name) for name in self._table.column_names]

    def is_number(self, name: str) -> bool:
        """Whether a column holds numbers, or true and false."""
        return name in self.names and any(test(self._table.column(name).type) for test in _NUMERIC)

    def numbers(self, name: str) -> NDArray[np.float64]:
        """(N,) of a column; NaN where a frame has none."""
        if not self.is_number(name):
            return np.full(len(self), np.nan)
        column = self._table.column(name).cast(pa.float64(), safe=False).combine_chunks()
        return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)

    def texts(self, name: str) -> list[str]:
        """(N,) of a column; "" where a frame has none."""
        return ["" if one is None else str(one) for one in self.values(name)]

    def values(self, name: str) -> list[Any]:
        """(N,) of a column as Python has them; None where a frame has none."""
        if name not in self.names:
            return [None] * len(self)
        return list(self._table.column(name).to_pylist())

    def counts(self, name: str) -> list[dict[str, int] | None]:
        """(N,) of a column of maps: name -> count."""
        found = (None if one is None else dict(one) for one in self.values(name))
        return [None if one is None else {k: int(v) for k, v in one.items() if v is not None} for one in found]

    @cached_property
    def split(self) -> list[str]:
        """(N,) of each frame."""
        return self.texts("split")

    @property
    def images(self) -> int:
        """How many different images the frames are of."""
        return len(set(self.values("image")))


def read_frames(path: Path) -> Frames:
    """Read an index.

    Raises
    ------
    DatasetError : it cannot be read, or is no index of ours.
    """
    try:
        frames = Frames(open_table(path, _NEEDED))
    except DatasetError as error:
        hint = "the command that made the data set, with `resume=True`, writes it again"
        raise DatasetError(
            error.problem, where=error.where, expected=error.expected, got=error.got, hint=hint
        ) from error
    return frames


def frames_of(rows: Sequence[dict[str, Any]]) -> Frames:
    """Rows in memory, with equal keys in all; a dict as value is a map."""
    columns: dict[str, Any] = {name: pa.array([], pa.string()) for name in _NEEDED}
    for name in rows[0] if rows else ():
        values = [row[name] for row in rows]
        is_map = any(isinstance(one, dict) for one in values)
        listed = [None if one is None else list(one.items()) for one in values] if is_map else values
        columns[name] = pa.array(listed, pa.map_(pa.string(), pa.int64()) if is_map else None)
    return Frames(pa.table(columns))
