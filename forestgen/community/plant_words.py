"""Plants as words of a multiset L-system: ``T(x, y, r, sp, ...)?E(c, ...)``.

A word with a T is a plant, and holds nothing else: place, radius and species in metres, metres and 0, 1, ..., then what
else the program gives it; and the module by which the environment answers. All other words are the program's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import LsystemError
from forestgen.lsystem.multiset import Kind, Multiset, words_as_text
from forestgen.lsystem.program import Program

X, Y, RADIUS, SPECIES, OWN = 0, 1, 2, 3, 4  # parameters of T
ORDER = "word"  # the column with the order of the words
_MOST_OTHERS = 64  # words that are no plants, for which it pays to look where they lie


@dataclass(frozen=True)
class Form:
    """The form of a program's plants."""

    plant: int  # code of T
    query: int  # code of ?E
    arity: int  # of T
    answers: int  # parameters of ?E
    names: tuple[str, ...]  # of the parameters of T after the species, then of ?E

    @property
    def values(self) -> int:
        return self.arity + self.answers


def form_of(program: Program) -> Form:
    """How a program writes its plants.

    Raises
    ------
    LsystemError : it has no plants, or of several forms.
    """
    plants = [i for i, kind in enumerate(program.kinds) if kind.symbol == "T"]
    queries = [i for i, kind in enumerate(program.kinds) if kind.symbol == "?E"]
    if len(plants) != 1 or len(queries) != 1:
        raise LsystemError(
            "this program writes no plants",
            where=program.name,
            expected="plants as T(x, y, r, sp)?E(c), all with the same number of parameters",
            got=", ".join(f"{symbol}({arity})" for symbol, arity in program.kinds if symbol in ("T", "?E")) or "no T",
        )
    arity, answers = program.kinds[plants[0]].arity, program.kinds[queries[0]].arity
    if arity < OWN or answers < 1:
        raise LsystemError(
            "plants have too few parameters",
            where=program.name,
            expected="T(x, y, r, sp)?E(c), or more parameters",
            got=f"T with {arity}, ?E with {answers}",
        )
    return Form(plants[0], queries[0], arity, answers, _names(program, arity, answers))


def _names(program: Program, arity: int, answers: int) -> tuple[str, ...]:
    """The names that the first productions give the parameters."""
    names: dict[Kind, list[str]] = {}
    for production in program.ast.productions:
        for module in production.predecessor:
            found = [getattr(argument, "name", "") for argument in module.arguments]
            names.setdefault(Kind(module.symbol, len(found)), found)
    of_plant = names.get(Kind("T", arity), [f"parameter_{i}" for i in range(arity)])[OWN:]
    of_query = names.get(Kind("?E", answers), [f"answer_{i}" for i in range(answers)])
    both = tuple(f"{name}_parameter" if name == ORDER else name for name in (*of_plant, *of_query))
    return both if len(set(both)) == len(both) else tuple(f"parameter_{i}" for i in range(len(both)))


@dataclass(frozen=True)
class Plants:
    """The plants among the words: N of them, in the words' order."""

    word: NDArray[np.intp]  # (N,) index of each plant's word
    values: NDArray[
        np.float64
    ]  # (N, values) parameters of T, then of ?E; a view of the multiset's where that is possible
    first: NDArray[np.int64] | slice  # where they lie among the multiset's parameters: (N,) or one piece

    def __len__(self) -> int:
        return len(self.word)


def plants_of(multiset: Multiset, form: Form, name: str) -> Plants:
    """The plants among the words of a program's multiset.

    Raises
    ------
    LsystemError : a word holds a T, but is no plant.
    """
    starts, code = multiset.word_start, multiset.code
    length = np.diff(starts)
    is_plant = length == 2
    is_plant[is_plant] = (code[starts[:-1][is_plant]] == form.plant) & (code[starts[:-1][is_plant] + 1] == form.query)
    word = np.flatnonzero(is_plant)
    if np.count_nonzero(code == form.plant) != len(word):
        _refuse(multiset, form, is_plant, name)
    piece = _one_piece(multiset, word, is_plant)
    if piece is not None:
        return Plants(word, multiset.parameter[piece].reshape(len(word), form.values), piece)
    first = multiset.parameter_start()[starts[:-1][word]]
    return Plants(word, multiset.parameter[first[:, None] + np.arange(form.values)], first)


def _one_piece(multiset: Multiset, word: NDArray[np.intp], is_plant: NDArray[np.bool_]) -> slice | None:
    """Where the plants' parameters lie, if no other word's lie between them."""
    if not len(word):
        return slice(0, 0)
    others = np.flatnonzero(~is_plant)
    if len(others) > _MOST_OTHERS:
        return None
    before = after = 0
    for index in others.tolist():
        codes = multiset.code[multiset.word_start[index] : multiset.word_start[index + 1]]
        count = int(multiset.arity[codes].sum())
        before += count * (index < word[0])
        after += count * (index > word[-1])
        if count and word[0] < index < word[-1]:
            return None
    return slice(before, len(multiset.parameter) - after)


def _refuse(multiset: Multiset, form: Form, is_plant: NDArray[np.bool_], name: str) -> None:
    for index in np.flatnonzero(~is_plant):
        begin, end = multiset.word_start[index : index + 2]
        if np.any(multiset.code[begin:end] == form.plant):
            lone = take_words(multiset, np.arange(len(multiset)) == index)
            raise LsystemError(
                "a word holds a plant and more, or only a part of one",
                where=name,
                expected="T(...)?E(...) alone; % before each new plant cuts it off",
                got=f"{next(words_as_text(lone)):.80}",
            )


def take_words(multiset: Multiset, keep: NDArray[np.bool_]) -> Multiset:
    """The multiset of some of the words."""
    length = np.diff(multiset.word_start)
    modules = np.repeat(keep, length)
    arity = multiset.arity[multiset.code]
    return Multiset(
        multiset.kinds,
        multiset.code[modules],
        multiset.parameter[np.repeat(modules, arity)],
        np.concatenate([[0], np.cumsum(length[keep])]).astype(np.int32),
        multiset.word_id[keep],
        multiset.born_step[keep],
    )


def join_words(kinds: tuple[Kind, ...], parts: Sequence[Multiset]) -> Multiset:
    """The words of all parts, which know the same kinds."""
    lengths = [np.diff(part.word_start) for part in parts]
    return Multiset(
        kinds,
        np.concatenate([part.code for part in parts]),
        np.concatenate([part.parameter for part in parts]),
        np.concatenate([[0], np.cumsum(np.concatenate(lengths))]).astype(np.int32),
        np.concatenate([part.word_id for part in parts]),
        np.concatenate([part.born_step for part in parts]),
    )


def plant_words(
    form: Form,
    kinds: tuple[Kind, ...],
    values: NDArray[np.float64],
    plant_id: NDArray[np.uint32],
    born_step: NDArray[np.int32],
) -> Multiset:
    """Words of plants; `values` (N, values) as in `Plants`."""
    n = len(values)
    code = np.empty(2 * n, np.uint16)
    code[0::2], code[1::2] = form.plant, form.query
    return Multiset(kinds, code, values.reshape(-1), np.arange(0, 2 * n + 1, 2, dtype=np.int32), plant_id, born_step)


def reorder_words(multiset: Multiset, order: NDArray[np.intp]) -> Multiset:
    """The words in another order."""
    starts, length = multiset.word_start[:-1][order].astype(np.int64), np.diff(multiset.word_start)[order]
    modules = _ranges(starts, length)
    values = multiset.parameter_start()
    arity = multiset.arity[multiset.code]
    return Multiset(
        multiset.kinds,
        multiset.code[modules],
        multiset.parameter[_ranges(values[:-1][modules], arity[modules])],
        np.concatenate([[0], np.cumsum(length)]).astype(np.int32),
        multiset.word_id[order],
        multiset.born_step[order],
    )


def _ranges(start: NDArray[np.int64], length: NDArray[np.integer]) -> NDArray[np.int64]:
    """start[0], start[0] + 1, ... (length[0] of them), start[1], ..."""
    before = np.cumsum(length) - length
    found: NDArray[np.int64] = np.repeat(start - before, length) + np.arange(int(length.sum()))
    return found


def word_of(program: Program, modules: Sequence[Sequence[str | float]]) -> Multiset:
    """The multiset of one word from the list that `words_as_lists` makes of it."""
    values = [float(value) for module in modules for value in module[1:]]
    return Multiset(
        program.kinds,
        np.array([program.kinds.index(Kind(str(one[0]), len(one) - 1)) for one in modules], np.uint16),
        np.array(values, dtype=np.float64),
        np.array([0, len(modules)], np.int32),
        np.ones(1, np.uint32),
        np.zeros(1, np.int32),
    )
