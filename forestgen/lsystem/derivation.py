"""Derivation: axiom, steps, interpretation, and answers to queries.

Queries ?P, ?H, ?U, ?L: after each step the turtle gives the module its place or direction. A query of three parameters
gets x, y, z in the plant's frame (positions in metres), one of two x and y. The turtle reads the interpreted words.

Reference: P. Prusinkiewicz, M. James, R. Mech, Synthetic topiary, SIGGRAPH 1994.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import LsystemError, ResourceError
from forestgen.core.randomness import child_root
from forestgen.core.threads import map_ranges
from forestgen.lsystem import vm_layout as layout
from forestgen.lsystem.compiler import Program, RuleSet
from forestgen.lsystem.multiset import PERCENT, QUERIES, Multiset
from forestgen.lsystem.syntax import fail

MOST_MODULES = 50_000_000
_LARGEST_ID = 2**32 - 1
_LARGEST_INDEX = 2**31 - 1  # of a module in its multiset
_SLACK = 1024

_FAULTS = {  # problem, and what is expected
    layout.DIVISION_BY_ZERO: ("division by zero", None),
    layout.OUTSIDE_DOMAIN: (
        "this has no value as a real number",
        "sqrt, log, asin, acos, pow, poisson within their domains",
    ),
    layout.NO_SUCH_ELEMENT: ("the array has no such element", "an index from 0 to its size - 1"),
    layout.NO_SUCH_FUNCTION: ("there is no function of this number", "a number from 1 on, or a function's name"),
    layout.NOT_FINITE: ("a parameter of this module is not a finite number", None),
    layout.BAD_PROBABILITY: ("this probability does not lie between 0 and 1", None),
    layout.PROBABILITIES_OVER_ONE: ("with this one, the probabilities of the productions that apply exceed 1", None),
    layout.TOO_DEEP: ("the decomposition does not end", None),
}


class TooManyModulesError(ResourceError):
    """The words grow beyond the limit of modules."""


@dataclass(frozen=True)
class Derivation:
    """A multiset of words, and all else that its future depends on."""

    multiset: Multiset
    step: int  # derivation steps done
    next_id: int  # of the next new word
    globals: NDArray[np.float64]  # global variables; the first is the current group


def axiom(program: Program, seed: int, *, most_modules: int = MOST_MODULES) -> Derivation:
    """The words before the first step; decomposed, and Start run.

    Raises `LsystemError`, with line and column, where something in the program has no value.
    """
    key = _key(seed, "axiom", 0)
    glob = _run_block(program, program.start, np.zeros(len(program.globals)), None, key, 0)
    codes, parameters = [], []
    for position, (begin, word) in enumerate(zip(program.axiom, program.ast.axiom, strict=True)):
        values = sum(len(module.arguments) for module in word)
        out = layout.Modules(np.empty(len(word), np.uint16), np.empty(values))
        _run(program, begin, glob, key ^ np.uint64(position + 1), out, 0)
        codes.append(out.code)
        parameters.append(out.parameter)
    sizes = [len(one) for one in codes]
    words = Multiset(
        kinds=program.kinds,
        code=np.concatenate([np.zeros(0, np.uint16), *codes]),
        parameter=np.concatenate([np.zeros(0), *parameters]),
        word_start=np.cumsum([0, *sizes]).astype(np.int32),
        word_id=np.arange(1, len(sizes) + 1, dtype=np.uint32),
        born_step=np.zeros(len(sizes), np.int32),
    )
    start = Derivation(words, 0, len(sizes) + 1, glob)
    if program.decomposition.address >= 0 or np.any(words.code == PERCENT):
        start = _rewritten(program, start, program.none, program.decomposition, key, 0, most_modules)
    return start


def derive_step(program: Program, state: Derivation, seed: int, *, most_modules: int = MOST_MODULES) -> Derivation:
    """One derivation step; `state` is left as it was. Queries are not answered here.

    Raises `LsystemError`, with line and column, where something in the program has no value or decomposition does not
    end, and `TooManyModulesError` where the words grow beyond `most_modules`.
    """
    step = state.step + 1
    key = _key(seed, "start each", step)
    glob = _run_block(program, program.start_each, state.globals, state.multiset, key, step)
    if glob[0] not in program.groups:
        expected, got = ", ".join(map(str, sorted(program.groups))), f"useGroup({glob[0]:g}) in derivation step {step}"
        raise LsystemError("there is no such group", where=program.name, expected=expected, got=got)
    state = replace(state, globals=glob)
    key = _key(seed, "step", step)
    after = _rewritten(program, state, program.productions, program.decomposition, key, step, most_modules)
    key = _key(seed, "end each", step)
    glob = _run_block(program, program.end_each, after.globals, after.multiset, key, step)
    return replace(after, step=step, globals=glob)


def derive(program: Program, steps: int, seed: int, *, most_modules: int = MOST_MODULES) -> Iterator[Derivation]:
    """The words after step 0, 1, ..., `steps`, each made when it is asked for; see `derive_step`."""
    state = axiom(program, seed, most_modules=most_modules)
    for step in range(steps + 1):
        if step:
            state = derive_step(program, state, seed, most_modules=most_modules)
        if any(kind.symbol in QUERIES for kind in program.kinds):
            drawn = interpret(program, state, seed, most_modules=most_modules)
            state = replace(state, multiset=_answer_queries(program, state.multiset, drawn))
        yield state


def _answer_queries(program: Program, words: Multiset, drawn: Multiset) -> Multiset:
    """The words with the parameters of their queries set; `drawn` is the same words, interpreted.

    Raises `LsystemError` where the turtle cannot read a word, or the interpretation makes or removes queries.
    """
    from forestgen.lsystem.turtle import (
        options_from,
        query_values,  # late: compiled kernels
    )

    options = options_from(program.ast.turtle, program.ast.dialect, program.name)
    asks = np.array([kind.symbol in QUERIES for kind in program.kinds])
    arity, starts, drawn_starts = words.arity, words.parameter_start(), drawn.parameter_start()
    asked = np.flatnonzero(asks[words.code])
    parameter = words.parameter.copy()
    answers = []
    for begin, end in zip(drawn.word_start[:-1], drawn.word_start[1:], strict=True):
        own = drawn.parameter[drawn_starts[begin] : drawn_starts[end]]
        answers.append(query_values(drawn.code[begin:end], own, drawn.kinds, options)[0])
    values = np.concatenate([np.zeros((0, 3)), *answers])
    if len(values) != len(asked):
        problem, expected = "the interpretation makes or removes queries", f"{len(asked)} queries, as in the words"
        raise LsystemError(problem, where=program.name, expected=expected, got=str(len(values)))
    for axis in range(3):
        wide = arity[words.code[asked]] > axis
        parameter[starts[:-1][asked[wide]] + axis] = values[wide, axis]
    return replace(words, parameter=parameter)


def interpret(program: Program, state: Derivation, seed: int, *, most_modules: int = MOST_MODULES) -> Multiset:
    """The words as the turtle reads them: rewritten by the interpretation, down to its maximum depth."""
    if program.interpretation.address < 0:
        return state.multiset
    key, rules = _key(seed, "interpretation", state.step), (program.none, program.interpretation)
    return _rewritten(program, state, *rules, key, state.step, most_modules).multiset


def _key(seed: int, stage: str, step: int) -> np.uint64:
    return np.uint64(child_root(seed, "lsystem", stage, step))


def _state(program: Program) -> NDArray[np.int64]:
    return np.zeros(layout.FOUND + program.longest_context, np.int64)


def _reals(program: Program, glob: NDArray[np.float64]) -> NDArray[np.float64]:
    real = program.real.copy()
    real[program.globals_at] = glob
    return real


def _run_block(
    program: Program, begin: int, glob: NDArray[np.float64], words: Multiset | None, key: np.uint64, step: int
) -> NDArray[np.float64]:
    """The global variables after a block has run."""
    if begin < 0:
        return glob
    glob = glob.copy()
    for slot, symbol in program.counted:
        glob[slot] = words.count(symbol) if words is not None else 0
    real = _run(program, begin, glob, key, layout.Modules(np.empty(0, np.uint16), np.empty(0)), step)
    return real[program.globals_at]


def _run(
    program: Program, begin: int, glob: NDArray[np.float64], key: np.uint64, out: layout.Modules, step: int
) -> NDArray[np.float64]:
    """The table of real numbers after code has run, which writes modules to `out`."""
    from forestgen.lsystem.vm_expressions import run  # late: compiled kernels

    real, state = _reals(program, glob), _state(program)
    wrong = run(program.whole, real, state, key, begin, *out)
    if wrong != layout.OK:
        _fail(program, wrong, int(state[layout.FAULT]), step, None)
    return real


def _fail(program: Program, wrong: int, address: int, step: int, module: str | None) -> NoReturn:
    problem, expected = _FAULTS[wrong]
    if wrong == layout.TOO_DEEP:
        most = f"{layout.MOST_EXPANSIONS:,} productions"
        expected = f"an end within maximum depth: {program.decomposition_depth}, and within {most}"
    at = f"rewriting {module} in" if module else "at"
    got = f"this {at} derivation step {step}"
    fail(problem, program.name, program.places[address], expected=expected, got=got)


def _rewritten(
    program: Program, state: Derivation, rules: RuleSet, inner: RuleSet, key: np.uint64, step: int, most_modules: int
) -> Derivation:
    """All words rewritten by `rules`, and what comes out by `inner`; ranges of many words on several threads."""
    from forestgen.lsystem import vm, vm_words  # late: compiled kernels

    words, starts, mate = state.multiset, np.zeros(0, np.int64), np.zeros(0, np.int64)
    if program.has_contexts and rules is program.productions:
        starts, mate = words.parameter_start(), np.zeros(len(words.code), np.int64)
        vm_words.pair_brackets(words.code, mate)
    text = layout.Text(words.code, words.parameter, starts, mate)
    is_drawing = inner is program.interpretation
    percent = layout.FRAGMENT if program.ast.is_multiset else layout.CUT  # what % does
    how = layout.Rewriting(
        rules=rules.address,
        inner=inner.address,
        group=int(state.globals[0]),
        depth=program.interpretation_depth if is_drawing else program.decomposition_depth,
        is_strict=not is_drawing,
        percent=0 if is_drawing or program.ast.dialect == "rhover" else percent,
        step=step,
    )

    def rewrite(first: int, end: int) -> tuple[int, NDArray[np.int64], _Space]:
        """The words of a range: what went wrong, the VM's state, what was written."""
        real, m = _reals(program, state.globals), _state(program)
        begin = words.word_start[first]
        m[layout.NEXT_VALUE] = np.bincount(words.code[:begin], minlength=len(program.kinds)) @ words.arity
        m[layout.NEXT_ID] = state.next_id
        space = _Space(program, words.code[begin : words.word_start[end]], end - first, rules, most_modules)
        memory = layout.Memory(program.whole, real, m)
        chosen = layout.Words(words.word_start[first : end + 1], words.word_id[first:end], words.born_step[first:end])
        while True:
            wrong = vm.rewrite(memory, key, how, text, chosen, space.made, space.pile, space.out, space.words)
            if wrong != layout.MORE_SPACE or not space.grow(m):
                return wrong, m, space

    done = map_ranges(len(words), rewrite)
    _check(program, words, [(wrong, m) for wrong, m, _ in done], step, most_modules)
    result, next_id = _joined(program, [(space, m) for _, m, space in done], state.next_id)
    if next_id - 1 > _LARGEST_ID:
        most = f"at most {_LARGEST_ID:,} words in a history"
        raise ResourceError("ids of words are used up", where=program.name, expected=most)
    return Derivation(result, state.step, next_id, state.globals)


def _check(
    program: Program, words: Multiset, done: Sequence[tuple[int, NDArray[np.int64]]], step: int, most_modules: int
) -> None:
    """Raise what went wrong in a step, if something did."""
    for wrong, m in done:
        if wrong == layout.MORE_SPACE:
            raise _too_many(program, most_modules, step)
        if wrong != layout.OK:
            _fail(program, wrong, int(m[layout.FAULT]), step, _around(words, int(m[layout.FAULT_MODULE])))
    if sum(int(m[layout.DONE]) for _, m in done) > min(most_modules, _LARGEST_INDEX):
        raise _too_many(program, most_modules, step)


def _too_many(program: Program, most_modules: int, step: int) -> TooManyModulesError:
    expected, got = f"at most {most_modules:,} modules", f"more of them in derivation step {step}"
    hint = "fewer steps, or a higher limit (`max_modules`)"
    return TooManyModulesError("the words grow too long", where=program.name, expected=expected, got=got, hint=hint)


class _Space:
    """Where the rewriting of some words writes; grown when it does not suffice."""

    def __init__(
        self, program: Program, code: NDArray[np.uint16], n_words: int, rules: RuleSet, most_modules: int
    ) -> None:
        self.most_modules = most_modules
        counts = np.bincount(code, minlength=len(program.kinds))
        # A word may be longer while it is written than when it has been cut.
        self.most_space = min(3 * most_modules, _LARGEST_INDEX - _SLACK)
        modules = min(int(counts @ rules.most_modules), self.most_space) + _SLACK
        values = min(int(counts @ rules.most_values), 64 * modules) + _SLACK
        n = n_words + n_words // 16 + _SLACK
        self.out = layout.Modules(np.empty(modules, np.uint16), np.empty(values))
        self.words = layout.Words(np.empty(n + 1, np.int32), np.empty(n, np.uint32), np.empty(n, np.int32))
        longest, most_values = program.longest_successor
        self.made = layout.Modules(np.empty(longest, np.uint16), np.empty(most_values))
        waiting = _SLACK + longest
        self.pile = layout.Pile(
            np.empty(waiting, np.uint16), np.empty(waiting, np.int64), np.empty(4 * _SLACK + most_values)
        )

    def grow(self, m: NDArray[np.int64]) -> bool:
        """Twice the space of what the VM needs, with what was written; False where that exceeds the limit."""
        need = m[layout.NEED]
        if need == layout.NEED_PILE:
            if len(self.pile.code) > self.most_space:
                return False
            self.pile = layout.Pile(*(_grown(one, 0) for one in self.pile))
        elif need == layout.NEED_WORDS:
            self.words = layout.Words(*(_grown(one, int(m[layout.WORDS])) for one in self.words))
        else:
            if m[layout.DONE] > self.most_modules or len(self.out.code) > self.most_space:
                return False
            code, parameter = self.out
            self.out = layout.Modules(_grown(code, int(m[layout.DONE])), _grown(parameter, int(m[layout.DONE_VALUES])))
        return True

    def written(self, m: NDArray[np.int64]) -> list[NDArray[Any]]:
        """Codes, parameters, starts, ids and steps of birth; they are held here no longer."""
        n = int(m[layout.WORDS])
        if n == 0:
            self.words.start[0] = 0
        sizes = (int(m[layout.DONE]), int(m[layout.DONE_VALUES]), n + 1, n, n)
        arrays: list[NDArray[Any]] = [*self.out, *self.words]
        del self.out, self.words
        return [array[:size] for array, size in zip(arrays, sizes, strict=True)]


def _joined(program: Program, parts: Sequence[tuple[_Space, NDArray[np.int64]]], next_id: int) -> tuple[Multiset, int]:
    """The words of all parts, in order; the new ones numbered on from part to part."""
    pieces: list[list[NDArray[Any]]] = []
    modules, last_id = 0, next_id
    for space, m in parts:
        one = space.written(m)
        if pieces:
            one[2] = one[2][1:] + np.int32(modules)
            one[3][one[3] >= next_id] += np.uint32(last_id - next_id)
        modules += int(m[layout.DONE])
        last_id += int(m[layout.NEXT_ID]) - next_id
        pieces.append(one)
    if len(pieces) == 1:
        return Multiset(program.kinds, *map(_shrunk, pieces[0])), last_id
    joined = []
    for k in range(5):
        joined.append(np.concatenate([piece[k] for piece in pieces]))
        for piece in pieces:
            piece[k] = joined[-1][:0]  # frees what has been joined
    return Multiset(program.kinds, *joined), last_id


def _around(words: Multiset, module: int) -> str:
    kind = words.kinds[words.code[module]]
    first = int(words.parameter_start()[module])
    values = ",".join(f"{value:g}" for value in words.parameter[first : first + kind.arity])
    return f"{kind.symbol}({values})" if values else kind.symbol


def _grown(array: NDArray[Any], used: int) -> NDArray[Any]:
    larger = np.empty(2 * len(array) + _SLACK, array.dtype)
    kept = min(used + 1, len(array))  # of word_start, the end of the last word too
    larger[:kept] = array[:kept]
    return larger


def _shrunk(array: NDArray[Any]) -> NDArray[Any]:
    """The array itself, or a copy where it is a small part of what is held in memory for it."""
    whole = array if array.base is None else array.base
    return array.copy() if array.size < 0.8 * getattr(whole, "size", array.size) else array
