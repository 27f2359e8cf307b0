"""The VM's instructions, the layout of its tables, and the arrays that pass between its loops.

An instruction is a pair (operation, operand) of a stack machine on double-precision numbers. `compiler` writes the
tables, `vm` reads them.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Codes = NDArray[np.uint16]
Indices = NDArray[np.int64]
Values = NDArray[np.float64]

# Control: the code's end (a value, if any, lies at the stack's bottom); jumps to the operand, the second takes a value.
RETURN, JUMP, JUMP_IF_ZERO = 0, 1, 2
# Values: what lies at the operand's address; takes a value to that address.
LOAD, STORE = 3, 4
# An element of array `operand`, takes the index; emits a module of kind `operand`, takes its parameters.
ELEMENT, EMIT = 8, 9
# Operators. TRUTH: 0 stays 0, all else is 1.
ADD, SUBTRACT, MULTIPLY, DIVIDE, REMAINDER, POWER, NEGATE, NOT = 10, 11, 12, 13, 14, 15, 16, 17
EQUAL, UNEQUAL, LESS, LESS_EQUAL, GREATER, GREATER_EQUAL, TRUTH = 18, 19, 20, 21, 22, 23, 24
# Functions of one value, then of two.
SIN, COS, TAN, ASIN, ACOS, ATAN, EXP, LOG, SQRT = 30, 31, 32, 33, 34, 35, 36, 37, 38
FLOOR, CEIL, TRUNC, ABS, SIGN, RAN, POISSON, LOG10 = 39, 40, 41, 42, 43, 44, 45, 46
MINIMUM, MAXIMUM, ATAN2, NRAN, FUNC = 50, 51, 52, 53, 54

#: Functions of programs: name -> (operation, number of arguments). Angles are in degrees. ran(x) is uniform in [0, x),
#: nran(mean, sd) normal, poisson(mean) a Poisson number; func(name or number, x) calls a user's function.
BUILTINS: Final = {
    "sin": (SIN, 1), "cos": (COS, 1), "tan": (TAN, 1), "asin": (ASIN, 1), "acos": (ACOS, 1), "atan": (ATAN, 1),
    "atan2": (ATAN2, 2), "exp": (EXP, 1), "log": (LOG, 1), "log10": (LOG10, 1), "sqrt": (SQRT, 1), "pow": (POWER, 2),
    "floor": (FLOOR, 1), "ceil": (CEIL, 1), "trunc": (TRUNC, 1), "abs": (ABS, 1), "fabs": (ABS, 1), "sign": (SIGN, 1),
    "min": (MINIMUM, 2), "max": (MAXIMUM, 2), "ran": (RAN, 1), "nran": (NRAN, 2), "poisson": (POISSON, 1),
    "func": (FUNC, 2),
}  # fmt: skip

#: Operators of two values; && and || jump.
OPERATORS: Final = {
    "+": ADD, "-": SUBTRACT, "*": MULTIPLY, "/": DIVIDE, "%": REMAINDER, "^": POWER, "==": EQUAL, "!=": UNEQUAL,
    "<": LESS, "<=": LESS_EQUAL, ">": GREATER, ">=": GREATER_EQUAL,
}  # fmt: skip

# What may go wrong while code runs, and what the caller has to do.
OK, DIVISION_BY_ZERO, OUTSIDE_DOMAIN, NO_SUCH_ELEMENT, NO_SUCH_FUNCTION, NOT_FINITE = 0, 1, 2, 3, 4, 5
BAD_PROBABILITY, PROBABILITIES_OVER_ONE, TOO_DEEP, MORE_SPACE = 6, 7, 8, 20

# v, the program in real numbers, begins with the local variables and room for a copy of them.
# t, the program in whole numbers, begins with addresses in t or in v: of the kinds' numbers of parameters and of a flag
# for each kind in t, of the stack in v; then how many local variables and functions there are, and the address in t of
# (address in v, number of samples) for each function.
ARITY, IGNORED, STACK, LOCAL_SIZE, FUNCTIONS, FUNCTION_AT, HEADER = 0, 1, 2, 3, 4, 5, 6
# A production's record in t. Heads, contexts and plain successors are lists of kinds. -1: no condition, no probability.
GROUP, CONDITION, PROBABILITY, SUCCESSOR = 0, 1, 2, 3
# Address and length. The right context has brackets; behind them, for each the index of the enclosing bracket, or -1.
LEFT, LEFTS, HEAD, HEADS, RIGHT, RIGHTS, MOST_MODULES, MOST_VALUES = 4, 5, 6, 7, 8, 9, 10, 11
# A successor without parameters that always applies: address and length; -1: there is none.
PLAIN, PLAINS, RECORD = 12, 13, 14
# m, the VM's state: NEED is what MORE_SPACE asks for, EXPANSIONS counts productions of blocks in this call, and
# from FOUND on lie the indices of context modules and brackets.
DRAWS, MODULES, VALUES, FAULT, FAULT_MODULE, NEXT_WORD, NEXT_VALUE, DONE, DONE_VALUES = 0, 1, 2, 3, 4, 5, 6, 7, 8
WORDS, NEXT_ID, WRITTEN, WRITTEN_VALUES, NEED, EXPANSIONS, FOUND = 9, 10, 11, 12, 13, 14, 15
# m[NEED]: modules or parameters written, words, the pile.
NEED_OUT, NEED_WORDS, NEED_PILE = 0, 1, 2

MOST_EXPANSIONS: Final = 200_000_000  # of a step's decomposition: seconds of work

CUT, FRAGMENT = 1, 2  # what % does; 0: nothing


class Memory(NamedTuple):
    """The program and the VM's state."""

    t: Indices
    v: Values
    m: Indices


class Rewriting(NamedTuple):
    """What a step does."""

    rules: int  # address in t; -1: none
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
