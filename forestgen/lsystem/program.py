"""A compiled L-system: one table of whole numbers and one of real numbers, laid out as `vm` reads them; its queries.

Queries ?P, ?H, ?U, ?L: after each step the turtle gives the module its place or direction. A query of three parameters
gets x, y, z in the plant's frame (positions in metres), one of two x and y. The turtle reads the interpreted words.

Reference: P. Prusinkiewicz, M. James, R. Mech, Synthetic topiary, SIGGRAPH 1994.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import LsystemError
from forestgen.lsystem.multiset import QUERIES, Kind, Multiset
from forestgen.lsystem.syntax import Place, ProgramAST


@dataclass(frozen=True)
class RuleSet:
    """A set of productions: where the VM finds it, and how much it writes."""

    address: int  # in the table of whole numbers: for each kind, where its productions begin; -1: there are none
    most_modules: NDArray[np.int64]  # (number of kinds,) written for a module of a kind, at most
    most_values: NDArray[np.int64]  # (number of kinds,) parameters of these


@dataclass(frozen=True)
class Program:
    """An L-system, ready to run."""

    ast: ProgramAST
    kinds: tuple[Kind, ...]
    whole: NDArray[np.int64]  # code, productions, arities: see vm.py
    real: NDArray[np.float64]  # constants, global and local variables, arrays, functions, stack
    productions: RuleSet
    decomposition: RuleSet
    interpretation: RuleSet
    none: RuleSet  # without productions
    decomposition_depth: int
    interpretation_depth: int
    has_contexts: bool
    longest_successor: tuple[int, int]  # modules and parameters
    longest_context: int
    axiom: tuple[int, ...]  # where each word's code begins
    axiom_size: tuple[tuple[int, int], ...]  # modules and parameters of each word
    start: int  # where code begins that runs before the derivation; -1: none
    start_each: int  # before each step
    end_each: int  # after each step
    globals_at: NDArray[np.int64]  # (number of globals,) addresses in `real`
    globals: tuple[str, ...]  # names; the first is the current group
    groups: frozenset[int]
    counted: tuple[tuple[int, str], ...]  # globals that hold the number of modules of a symbol
    places: dict[int, Place]  # in the text, of each instruction by its address in `whole`
    derivation_length: int | None

    @property
    def name(self) -> str:
        return self.ast.name


def has_queries(program: Program) -> bool:
    """Whether the program has modules that ask the turtle."""
    return any(kind.symbol in QUERIES for kind in program.kinds)


def answer_queries(program: Program, words: Multiset, drawn: Multiset) -> Multiset:
    """The words with the parameters of their queries set; `drawn` is the same words, interpreted.

    Raises `LsystemError` where the turtle cannot read a word, or the interpretation makes or removes queries.
    """
    from forestgen.lsystem.turtle import options_from, query_values  # late: compiled kernels

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
