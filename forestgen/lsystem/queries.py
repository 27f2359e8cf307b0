"""Queries ?P, ?H, ?U, ?L: the turtle tells a module where it stands after each step.

A query of three parameters gets x, y, z in the plant's frame (positions in metres), one of two gets x and y. What the
interpretation makes of the other modules counts: the turtle reads the interpreted words.

Reference: P. Prusinkiewicz, M. James, R. Mech, Synthetic topiary, SIGGRAPH 1994.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from forestgen.core.errors import LsystemError
from forestgen.lsystem.checks import QUERIES
from forestgen.lsystem.multiset import Multiset
from forestgen.lsystem.program import Program


def has_queries(program: Program) -> bool:
    """Whether the program has modules that ask the turtle."""
    return any(kind.symbol in QUERIES for kind in program.kinds)


def answer_queries(program: Program, words: Multiset, drawn: Multiset) -> Multiset:
    """The words with the parameters of their queries set.

    Parameters
    ----------
    drawn : the same words, interpreted; with the same queries in the same order.

    Raises
    ------
    LsystemError : the turtle cannot read a word, or the interpretation makes queries of its own.
    """
    from forestgen.lsystem.turtle import options_from, query_values  # late: compiled kernels

    options = options_from(program.listing.turtle, program.listing.dialect, program.name)
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
        raise LsystemError(
            "the interpretation makes or removes queries",
            where=program.name,
            expected=f"{len(asked)} queries, as in the words",
            got=str(len(values)),
        )
    for axis in range(3):
        wide = arity[words.code[asked]] > axis
        parameter[starts[:-1][asked[wide]] + axis] = values[wide, axis]
    return replace(words, parameter=parameter)
