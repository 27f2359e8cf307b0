"""The instructions of the machine: pairs (operation, operand) of a stack machine on double-precision numbers."""

from __future__ import annotations

from typing import Final

# Control
RETURN: Final = 0  # ends the code; a value, if any, lies at the stack's bottom
JUMP: Final = 1  # to the operand
JUMP_IF_ZERO: Final = 2  # takes a value
# Values
LOAD: Final = 3  # what lies at the operand's address
STORE: Final = 4  # takes a value to that address
ELEMENT: Final = 8  # of array `operand`; takes the index
EMIT: Final = 9  # a module of kind `operand`; takes its parameters
# Operators
ADD: Final = 10
SUBTRACT: Final = 11
MULTIPLY: Final = 12
DIVIDE: Final = 13
REMAINDER: Final = 14
POWER: Final = 15
NEGATE: Final = 16
NOT: Final = 17
EQUAL: Final = 18
UNEQUAL: Final = 19
LESS: Final = 20
LESS_EQUAL: Final = 21
GREATER: Final = 22
GREATER_EQUAL: Final = 23
TRUTH: Final = 24  # 0 stays 0, all else is 1
# Functions of one value
SIN: Final = 30
COS: Final = 31
TAN: Final = 32
ASIN: Final = 33
ACOS: Final = 34
ATAN: Final = 35
EXP: Final = 36
LOG: Final = 37
SQRT: Final = 38
FLOOR: Final = 39
CEIL: Final = 40
TRUNC: Final = 41
ABS: Final = 42
SIGN: Final = 43
RAN: Final = 44
POISSON: Final = 45
LOG10: Final = 46
# Functions of two values
MINIMUM: Final = 50
MAXIMUM: Final = 51
ATAN2: Final = 52
NRAN: Final = 53
FUNC: Final = 54

#: Functions of programs: name -> (operation, number of arguments). Angles are in degrees.
FUNCTIONS: Final = {
    "sin": (SIN, 1),
    "cos": (COS, 1),
    "tan": (TAN, 1),
    "asin": (ASIN, 1),
    "acos": (ACOS, 1),
    "atan": (ATAN, 1),
    "atan2": (ATAN2, 2),
    "exp": (EXP, 1),
    "log": (LOG, 1),
    "log10": (LOG10, 1),
    "sqrt": (SQRT, 1),
    "pow": (POWER, 2),
    "floor": (FLOOR, 1),
    "ceil": (CEIL, 1),
    "trunc": (TRUNC, 1),
    "abs": (ABS, 1),
    "fabs": (ABS, 1),
    "sign": (SIGN, 1),
    "min": (MINIMUM, 2),
    "max": (MAXIMUM, 2),
    "ran": (RAN, 1),  # uniform in [0, x)
    "nran": (NRAN, 2),  # normal: mean, standard deviation
    "poisson": (POISSON, 1),  # Poisson number of a mean
    "func": (FUNC, 2),  # a user's function: its number or name, x
}

#: Operators of two values; && and || jump.
OPERATORS: Final = {
    "+": ADD, "-": SUBTRACT, "*": MULTIPLY, "/": DIVIDE, "%": REMAINDER, "^": POWER, "==": EQUAL, "!=": UNEQUAL,
    "<": LESS, "<=": LESS_EQUAL, ">": GREATER, ">=": GREATER_EQUAL,
}  # fmt: skip

# What may go wrong while code runs
OK: Final = 0
DIVISION_BY_ZERO: Final = 1
OUTSIDE_DOMAIN: Final = 2
NO_SUCH_ELEMENT: Final = 3
NO_SUCH_FUNCTION: Final = 4
NOT_FINITE: Final = 5
BAD_PROBABILITY: Final = 6
PROBABILITIES_OVER_ONE: Final = 7
TOO_DEEP: Final = 8
# What the caller has to do
MORE_SPACE: Final = 20
