"""A multiset of words in flat arrays, and its written forms."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Kind(NamedTuple):
    """Modules of one symbol and one number of parameters: A, A(x) and A(x, y) are three kinds."""

    symbol: str
    arity: int


#: These kinds have the same codes in every program.
OPEN, CLOSE, PERCENT = 0, 1, 2
RESERVED = (Kind("[", 0), Kind("]", 0), Kind("%", 0))
#: Symbols that ask the turtle.
QUERIES = ("?P", "?H", "?U", "?L")


@dataclass(frozen=True)
class Multiset:
    """M modules in W words; an ordinary L-system has one word.

    A word that is rewritten keeps its id as long as its first module's kind stays; pieces that are cut off, and words
    that begin with another kind than before, are new: they get ids of their own and are born in that step.
    """

    kinds: tuple[Kind, ...]  # code -> kind
    code: NDArray[np.uint16]  # (M,) index into kinds
    parameter: NDArray[np.float64]  # (P,) of all modules, in order
    word_start: NDArray[np.int32]  # (W + 1,) index of each word's first module; ends with M
    word_id: NDArray[np.uint32]  # (W,) never 0, never reused
    born_step: NDArray[np.int32]  # (W,)

    def __len__(self) -> int:
        return len(self.word_id)

    @property
    def arity(self) -> NDArray[np.int64]:
        """(number of kinds,)"""
        return np.array([kind.arity for kind in self.kinds], dtype=np.int64)

    def parameter_start(self) -> NDArray[np.int64]:
        """(M + 1,) index of each module's first parameter; ends with P."""
        return np.concatenate([[0], np.cumsum(self.arity[self.code])]).astype(np.int64, copy=False)

    def count(self, symbol: str) -> int:
        """Number of modules of a symbol, whatever their parameters."""
        return self.counts().get(symbol, 0)

    def counts(self) -> dict[str, int]:
        """Number of modules of each symbol that occurs, most frequent first."""
        per_kind = np.bincount(self.code, minlength=len(self.kinds))
        found: dict[str, int] = {}
        for kind, n in zip(self.kinds, per_kind, strict=True):
            if n:
                found[kind.symbol] = found.get(kind.symbol, 0) + int(n)
        return dict(sorted(found.items(), key=lambda one: -one[1]))


def show_number(value: float) -> str:
    """The shortest form that reads back as the same number: 2, 0.5, 1e+30."""
    return repr(float(value)).removesuffix(".0") if value else "0"


def words_as_text(multiset: Multiset) -> Iterator[str]:
    """Each word written as in a program: ``A(2)[B(0.5)]``."""
    symbols = np.array([kind.symbol for kind in multiset.kinds], dtype=object)
    arity, starts = multiset.arity, multiset.parameter_start()
    for begin, end in zip(multiset.word_start[:-1], multiset.word_start[1:], strict=True):
        codes = multiset.code[begin:end]
        pieces = symbols[codes]
        for i in np.flatnonzero(arity[codes]):
            numbers = multiset.parameter[starts[begin + i] : starts[begin + i + 1]].tolist()
            pieces[i] += f"({','.join(map(show_number, numbers))})"
        yield "".join(pieces)


def words_as_lists(multiset: Multiset) -> list[list[Any]]:
    """Each word as a list of [symbol, parameter, ...]."""
    starts = multiset.parameter_start()
    return [
        [
            [multiset.kinds[multiset.code[i]].symbol, *multiset.parameter[starts[i] : starts[i + 1]].tolist()]
            for i in range(begin, end)
        ]
        for begin, end in zip(multiset.word_start[:-1].tolist(), multiset.word_start[1:].tolist(), strict=True)
    ]
