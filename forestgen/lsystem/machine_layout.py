"""Addresses in the tables that `packing` makes and `machine` reads, and the arrays that pass between them."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Codes = NDArray[np.uint16]
Indices = NDArray[np.int64]
Values = NDArray[np.float64]

# t, the program in whole numbers: it begins with addresses in t or in v, the program in real numbers
ARITY: Final = 0  # of the kinds' numbers of parameters
IGNORED: Final = 1  # of a flag for each kind
STACK: Final = 2  # in v
LOCALS: Final = 3  # in v
FUNCTIONS: Final = 4  # how many
FUNCTION_AT: Final = 5  # of (address in v, number of samples) for each function
SPARE: Final = 6  # in v: room for a copy of the local variables
LOCAL_SIZE: Final = 7
HEADER: Final = 8
# A production's record in t. Heads, contexts and plain successors are lists of kinds.
# -1: no condition, no probability
GROUP: Final = 0
CONDITION: Final = 1
PROBABILITY: Final = 2
SUCCESSOR: Final = 3
# address and length
LEFT: Final = 4
LEFTS: Final = 5
HEAD: Final = 6
HEADS: Final = 7
RIGHT: Final = 8  # with brackets; behind them, for each the index of the bracket that encloses it, or -1
RIGHTS: Final = 9
MOST_MODULES: Final = 10
MOST_VALUES: Final = 11
# a successor without parameters that always applies: address and length; -1: not so
PLAIN: Final = 12
PLAINS: Final = 13
RECORD: Final = 14
# m, the machine's state
DRAWS: Final = 0
MODULES: Final = 1
VALUES: Final = 2
FAULT: Final = 3
FAULT_MODULE: Final = 4
NEXT_WORD: Final = 5
NEXT_VALUE: Final = 6
DONE: Final = 7
DONE_VALUES: Final = 8
WORDS: Final = 9
NEXT_ID: Final = 10
WRITTEN: Final = 11
WRITTEN_VALUES: Final = 12
NEED: Final = 13  # what MORE_SPACE asks for
EXPANSIONS: Final = 14  # productions of blocks applied in this call
FOUND: Final = 15  # indices of context modules and brackets, to the end
# Answers in m[NEED]
NEED_OUT: Final = 0  # modules or parameters written
NEED_WORDS: Final = 1
NEED_PILE: Final = 2

MOST_EXPANSIONS: Final = 200_000_000  # of a step's decomposition: seconds of work

CUT: Final = 1  # what % does; 0: nothing
FRAGMENT: Final = 2


class Memory(NamedTuple):
    """The program and the machine's state."""

    t: Indices
    v: Values
    m: Indices


class Rewriting(NamedTuple):
    """What a step does."""

    rules: int  # address in t
    inner: int  # address in t of those that decompose what comes out; -1: none
    group: int
    depth: int  # of the decomposition
    is_strict: bool  # whether a deeper one is an error
    percent: int  # CUT, FRAGMENT or 0
    step: int


class Text(NamedTuple):
    """Modules that are read, as in `Multiset`; the last two only for programs with contexts, else of no length."""

    code: Codes
    parameter: Values
    start: Indices  # (M,) first parameter of each module
    mate: Indices  # (M,) partner of each bracket


class Words(NamedTuple):
    """A list of words, as in `Multiset`."""

    start: NDArray[np.int32]  # (W + 1,) first module
    id: NDArray[np.uint32]
    born: NDArray[np.int32]


class Modules(NamedTuple):
    """Modules that are written."""

    code: Codes
    parameter: Values


class Pile(NamedTuple):
    """Modules that wait for their decomposition."""

    code: Codes
    depth: Indices
    parameter: Values
