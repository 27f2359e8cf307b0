"""Dataclasses of arrays as bytes and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from forestgen.core.array_serialization import UnreadableError, pack, unpack


class Kind(Enum):
    ONE = 1
    OTHER = 2


@dataclass(frozen=True)
class Inner:
    values: NDArray[Any]
    kind: Kind


@dataclass(frozen=True)
class Outer:
    name: str
    parts: tuple[Inner, ...]
    number: float
    none: None
    table: Mapping[str, NDArray[Any]]


CLASSES = (Inner, Outer, Kind)


def example() -> Outer:
    rng = np.random.default_rng(1)
    inner = tuple(
        Inner(values, kind)
        for values, kind in (
            (rng.normal(size=(7, 3)).astype(np.float32), Kind.ONE),
            (np.array([[np.nan, -0.0, np.inf]]), Kind.OTHER),
            (np.zeros((0, 3), np.uint32), Kind.ONE),
            (rng.integers(0, 9, (5, 4))[:, ::2], Kind.ONE),  # not contiguous
        )
    )
    return Outer("spruce “a”", inner, 0.1 + 0.2, None, {"b": np.arange(3)})


def test_what_comes_back_is_the_same_to_the_last_bit() -> None:
    one = example()
    back = unpack(pack(one), CLASSES)
    assert (back.name, back.number, back.none) == (one.name, one.number, None)
    for mine, theirs in zip(one.parts, back.parts, strict=True):
        assert mine.kind is theirs.kind
        assert (mine.values.dtype, mine.values.shape) == (theirs.values.dtype, theirs.values.shape)
        assert mine.values.tobytes() == theirs.values.tobytes()
    assert list(back.table["b"]) == [0, 1, 2]
    assert pack(back) == pack(one)


def test_bytes_that_are_cut_short_are_unreadable() -> None:
    data = pack(example())
    for length in (0, 5, 19, 20, len(data) // 2, len(data) - 100):
        with pytest.raises(UnreadableError):
            unpack(data[:length], CLASSES)


def test_a_class_that_is_no_more_is_unreadable_and_an_unknown_value_cannot_be_packed() -> None:
    with pytest.raises(UnreadableError):
        unpack(pack(example()), (Inner, Kind))
    with pytest.raises(TypeError, match="object"):
        pack(Outer("a", (), 0.0, None, {"b": object()}))  # type: ignore[dict-item]
