"""Frozen dataclasses of NumPy arrays as bytes and back, the same to the last bit.

Layout: length of the header (8 bytes, little-endian); the header, JSON; the arrays, raw, each at a multiple of 64
bytes. No code is stored and none is run when bytes are read. Whoever keeps the bytes checks that they are whole, as
`forestgen.core.cache.DiskCache` does.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.cache import DiskCache

_HEAD = struct.Struct("<Q")
_ALIGNED = 64


class UnreadableError(ValueError):
    """The bytes are cut short, changed, or of another version."""


def pack(value: Any) -> bytes:
    """Bytes of a dataclass; its fields are dataclasses, tuples, lists, mappings, arrays, enums, numbers, text or None.

    Raises `TypeError` for a field of another kind.
    """
    arrays: list[NDArray[Any]] = []
    tree = _tree(value, arrays)
    table, blobs, offset = [], [], 0
    for array in arrays:
        table.append({"dtype": array.dtype.str, "shape": array.shape, "offset": offset})
        gap = -array.nbytes % _ALIGNED
        blobs += [np.ascontiguousarray(array).tobytes(), bytes(gap)]
        offset += array.nbytes + gap
    header = json.dumps({"tree": tree, "arrays": table}).encode()
    header += b" " * (-(len(header) + _HEAD.size) % _ALIGNED)
    return b"".join([_HEAD.pack(len(header)), header, *blobs])


def unpack(data: bytes | bytearray | NDArray[np.uint8], classes: Sequence[type]) -> Any:
    """What `pack` was given, made of these dataclasses and enums. The arrays are views of `data`.

    Raises `UnreadableError` where `data` is cut short, or names classes or fields that no longer exist.
    """
    view = memoryview(data)  # type: ignore[arg-type]  # NumPy's types do not tell that arrays are buffers
    try:
        (length,) = _HEAD.unpack_from(view)
        start = _HEAD.size + length
        header = json.loads(bytes(view[_HEAD.size : start]))
        arrays = [_array(view, start, row) for row in header["arrays"]]
        return _value(header["tree"], arrays, {one.__name__: one for one in classes})
    except (ValueError, KeyError, TypeError, RecursionError, OverflowError, struct.error) as error:
        raise UnreadableError(str(error)) from error


def read_packed(store: DiskCache, key: str, classes: Sequence[type]) -> Any:
    """What is kept under a key, of the first of the classes; None where there is nothing, or no such thing: dropped."""
    data = store.read(key)
    if data is not None:
        with suppress(UnreadableError):
            found = unpack(data, classes)
            if isinstance(found, classes[0]):
                return found
        store.drop(key)
    return None


def _tree(value: Any, arrays: list[NDArray[Any]]) -> Any:
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return {"array": len(arrays) - 1}
    if isinstance(value, Enum):
        return {"enum": type(value).__name__, "name": value.name}
    if is_dataclass(value) and not isinstance(value, type):
        parts = {field.name: _tree(getattr(value, field.name), arrays) for field in fields(value)}
        return {"class": type(value).__name__, "fields": parts}
    if isinstance(value, tuple):
        return [_tree(one, arrays) for one in value]
    if isinstance(value, list):
        return {"list": [_tree(one, arrays) for one in value]}
    if isinstance(value, Mapping):
        if not all(isinstance(key, str) for key in value):
            raise TypeError("a mapping needs keys of text")
        return {"mapping": {key: _tree(one, arrays) for key, one in value.items()}}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"cannot pack {type(value).__name__}")


def _array(view: memoryview, start: int, row: Mapping[str, Any]) -> NDArray[Any]:
    shape = tuple(row["shape"])
    count = int(np.prod(shape))
    array: NDArray[Any] = np.frombuffer(view, dtype=np.dtype(row["dtype"]), count=count, offset=start + row["offset"])
    return array.reshape(shape)


def _value(tree: Any, arrays: Sequence[NDArray[Any]], classes: Mapping[str, type]) -> Any:
    if isinstance(tree, list):
        return tuple(_value(one, arrays, classes) for one in tree)
    if not isinstance(tree, dict):
        return tree
    if "array" in tree:
        return arrays[tree["array"]]
    if "enum" in tree:
        return classes[tree["enum"]][tree["name"]]  # type: ignore[index]
    if "list" in tree:
        return [_value(one, arrays, classes) for one in tree["list"]]
    if "mapping" in tree:
        return {key: _value(one, arrays, classes) for key, one in tree["mapping"].items()}
    return classes[tree["class"]](**{key: _value(one, arrays, classes) for key, one in tree["fields"].items()})
