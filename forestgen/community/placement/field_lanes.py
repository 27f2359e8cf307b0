"""Eight cells at once: the innermost operations of the probability field as vector instructions.

Numba compiles loops over eight numbers into single steps where it cannot know that arrays do not overlap. These
operations say it: eight numbers are loaded into a register, worked on, and stored.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel import models
from numba.extending import intrinsic, register_model

LANES = 8  # cells of a strip: a line of the processor's memory
SMALLEST = 1e-290  # a cell below is 0: products stay clear of the slow numbers near the smallest
LARGE_PAGE = 2**18  # numbers: what the processor finds the place of at once, where the system gives it

_EIGHT = ir.VectorType(ir.DoubleType(), LANES)
_WHOLE = ir.VectorType(ir.IntType(32), LANES)
_INDEX, _LONG = ir.IntType(32), ir.IntType(64)
_NONE = ir.Constant(_EIGHT, ir.Undefined)


class SimdVector(types.Type):
    """Eight numbers in a register."""

    def __init__(self) -> None:
        super().__init__(name="SimdVector")


@register_model(SimdVector)
class _SimdVectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _EIGHT)


_VECTOR, _NUMBER, _INTEGER, _BOOLEAN = SimdVector(), types.float64, types.int64, types.boolean
_MEMORY, _ELEMENT = "a pointer", "what the first argument, a pointer, leads to"


def _instruction(returns: Any, *takes: Any) -> Callable[[Callable[..., Any]], Any]:
    """An operation for kernels of the decorated function, which takes LLVM's builder and values and gives a value.

    `returns` and `takes` are Numba's types, `_MEMORY` or `_ELEMENT`; a tuple of types for a tuple of values.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        @wraps(function)
        def typed(typing_context: Any, *given: Any) -> Any:
            def resolve(kind: Any, own: Any = None) -> Any:
                if isinstance(kind, tuple):
                    return types.Tuple(kind)  # type: ignore[attr-defined]
                return own if kind is _MEMORY else given[0].dtype if kind is _ELEMENT else kind

            def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
                value = function(builder, *values)
                if isinstance(value, tuple):
                    return context.make_tuple(builder, signature.return_type, value)
                return context.get_dummy_value() if value is None else value

            return resolve(returns)(*map(resolve, takes, given)), code

        parameters = list(inspect.signature(function).parameters.values())
        typed.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        return intrinsic(typed)

    return decorate


@intrinsic
def pointer(typing_context, array):  # type: ignore[no-untyped-def]
    """The memory of an array, without a reference: the caller keeps it alive."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return context.make_array(signature.args[0])(context, builder, arguments[0]).data

    return types.CPointer(array.dtype)(array), code  # type: ignore[attr-defined]


@_instruction(_ELEMENT, _MEMORY, _INTEGER)
def load(builder: Any, memory: Any, index: Any) -> Any:
    """One number."""
    return builder.load(builder.gep(memory, [index]))


@_instruction(types.void, _MEMORY, _INTEGER, _ELEMENT)
def store(builder: Any, memory: Any, index: Any, value: Any) -> None:
    """Write one number."""
    builder.store(value, builder.gep(memory, [index]))


@_instruction(types.void, _MEMORY, _INTEGER)
def ask_for(builder: Any, memory: Any, index: Any) -> None:
    """Have a line of memory brought near, and go on meanwhile."""
    kinds = ir.FunctionType(ir.VoidType(), [cgutils.voidptr_t, _INDEX, _INDEX, _INDEX])
    place = builder.bitcast(builder.gep(memory, [index]), cgutils.voidptr_t)
    call = cgutils.get_or_insert_function(builder.module, kinds, "llvm.prefetch.p0")
    builder.call(call, [place, _INDEX(1), _INDEX(3), _INDEX(1)])


@_instruction(_VECTOR, _MEMORY, _INTEGER)
def load_line(builder: Any, memory: Any, index: Any) -> Any:
    """Eight numbers."""
    return builder.load(builder.bitcast(builder.gep(memory, [index]), _EIGHT.as_pointer()), align=8)


@_instruction(types.void, _MEMORY, _INTEGER, _VECTOR)
def store_line(builder: Any, memory: Any, index: Any, eight: Any) -> None:
    """Write eight numbers."""
    builder.store(eight, builder.bitcast(builder.gep(memory, [index]), _EIGHT.as_pointer()), align=8)


@_instruction(_NUMBER, _VECTOR)
def sum_of(builder: Any, eight: Any) -> Any:
    """Sum of eight numbers."""
    for half in (4, 2, 1):
        low, high = _shuffled(builder, eight, range(half)), _shuffled(builder, eight, range(half, 2 * half))
        eight = builder.fadd(low, high)
    return builder.extract_element(eight, _INDEX(0))


@_instruction(_VECTOR, _VECTOR, _VECTOR)
def plus(builder: Any, eight: Any, other: Any) -> Any:
    """Eight numbers and eight others, one by one."""
    return builder.fadd(eight, other)


@_instruction(_VECTOR, _MEMORY, _INTEGER, _INTEGER)
def load_across(builder: Any, memory: Any, index: Any, count: Any) -> Any:
    """The same number of eight lines that follow one another; 0 for lines from `count` on, whatever is there."""
    eight, first = _NONE, builder.gep(memory, [index])
    for lane in range(LANES):
        number = builder.load(builder.gep(first, [_INDEX(lane * LANES)]))
        eight = builder.insert_element(eight, number, _INDEX(lane))
    there = builder.icmp_signed("<", _WHOLE(list(range(LANES))), _all(builder, builder.trunc(count, _INDEX)))
    return builder.select(there, eight, _all(builder, 0.0))


@_instruction((_INTEGER, _NUMBER), _VECTOR, _NUMBER)
def passed(builder: Any, eight: Any, u: Any) -> Any:
    """How many of the first seven partial sums are at most u, and what the numbers before leave of u."""
    k, before = _passed(builder, eight, u)
    return k, builder.fsub(u, builder.extract_element(before, k))


@_instruction((_BOOLEAN, _NUMBER), _VECTOR, _NUMBER, _INTEGER)
def passed_as_guessed(builder: Any, eight: Any, u: Any, guess: Any) -> Any:
    """Whether `passed` finds k to be `guess`, and what the numbers before leave of u if so.

    Which numbers are before is known without u: steps that follow one another need not wait to choose.
    """
    k, before = _passed(builder, eight, u)
    return builder.icmp_signed("==", k, guess), builder.fsub(u, builder.extract_element(before, guess))


@_instruction(_VECTOR, _VECTOR, _INTEGER, _NUMBER)
def with_number(builder: Any, eight: Any, k: Any, value: Any) -> Any:
    """Eight numbers, of which number k has become `value`."""
    chosen = builder.icmp_signed("==", _all(builder, builder.trunc(k, _INDEX)), _WHOLE(list(range(LANES))))
    return builder.select(chosen, _all(builder, value), eight)


@_instruction(_VECTOR, _INTEGER, _NUMBER, _NUMBER, _INTEGER, _INTEGER)
def distances(builder: Any, b: Any, x: Any, width: Any, first: Any, last: Any) -> Any:
    """((j + 0.5 - x) width)² of the columns j = 8 b .. 8 b + 7; infinite outside first .. last."""
    start = _all(builder, builder.mul(b, _LONG(LANES)))
    j = builder.add(start, ir.VectorType(_LONG, LANES)(list(range(LANES))))
    dx = builder.fsub(builder.fadd(builder.sitofp(j, _EIGHT), _all(builder, 0.5)), _all(builder, x))
    dx = builder.fmul(dx, _all(builder, width))
    inside = builder.and_(
        builder.icmp_signed(">=", j, _all(builder, first)), builder.icmp_signed("<=", j, _all(builder, last))
    )
    # The square is rounded, never contracted with a later sum.
    square = _of_vector(builder, "llvm.arithmetic.fence.v8f64", builder.fmul(dx, dx))
    return builder.select(inside, square, _all(builder, float("inf")))


@_instruction(_VECTOR, _VECTOR, _VECTOR, _NUMBER, _NUMBER)
def only_near(builder: Any, eight: Any, squares: Any, dy2: Any, r2: Any) -> Any:
    """Those of eight cells whose `squares` + dy2 is at most r2, and 0.0 for others."""
    _, near = _near(builder, squares, dy2, r2)
    return builder.select(near, eight, _all(builder, 0.0))


@_instruction(_VECTOR, _VECTOR, _VECTOR, _NUMBER, _NUMBER, _NUMBER)
def times(builder: Any, eight: Any, squares: Any, dy2: Any, r2: Any, factor: Any) -> Any:
    """Multiply those of eight cells whose `squares` + dy2 is at most r2 by one factor."""
    _, near = _near(builder, squares, dy2, r2)
    return _multiply(builder, eight, near, _all(builder, factor))


@_instruction(_VECTOR, _VECTOR, _VECTOR, _NUMBER, _NUMBER, _NUMBER, _NUMBER, _MEMORY)
def times_table(builder: Any, eight: Any, squares: Any, dy2: Any, r2: Any, scale: Any, last: Any, table: Any) -> Any:
    """Multiply those of eight cells whose d2 = `squares` + dy2 is at most r2 by a table.

    The factor is linear between the table's values at the whole numbers about sqrt(d2) scale, which is at most `last`.
    """
    d2, near = _near(builder, squares, dy2, r2)
    at = builder.fmul(_of_vector(builder, "llvm.sqrt.v8f64", d2), _all(builder, scale))
    most = _all(builder, last)
    at = builder.select(builder.fcmp_ordered("<", at, most), at, most)
    whole = builder.fptosi(at, _WHOLE)
    low, high = _NONE, _NONE
    for lane in range(LANES):
        number = builder.sext(builder.extract_element(whole, _INDEX(lane)), _LONG)
        here = builder.gep(table, [number])
        low = builder.insert_element(low, builder.load(here), _INDEX(lane))
        high = builder.insert_element(high, builder.load(builder.gep(here, [_INDEX(1)])), _INDEX(lane))
    part = builder.fsub(at, builder.sitofp(whole, _EIGHT))
    factor = builder.fadd(low, builder.fmul(part, builder.fsub(high, low)))
    return _multiply(builder, eight, near, factor)


def _passed(builder: Any, sums: Any, u: Any) -> tuple[Any, Any]:
    """How many of the first seven partial sums are at most u, and what the numbers before each leave of u."""
    zero = ir.Constant(_EIGHT, [0.0] * LANES)
    for lanes in ([8, 0, 8, 2, 8, 4, 8, 6], [8, 8, 1, 1, 8, 8, 5, 5], [8, 8, 8, 8, 3, 3, 3, 3]):
        sums = builder.fadd(sums, builder.shuffle_vector(sums, zero, ir.Constant(_WHOLE, lanes)))
    below = builder.fcmp_ordered("<=", sums, _all(builder, u))
    bits = builder.and_(builder.bitcast(below, ir.IntType(8)), ir.IntType(8)(127))
    before = builder.shuffle_vector(sums, zero, ir.Constant(_WHOLE, [8, 0, 1, 2, 3, 4, 5, 6]))
    return builder.zext(builder.ctpop(bits), _LONG), before


def _of_vector(builder: Any, name: str, vector: Any) -> Any:
    """One of LLVM's functions of eight numbers."""
    function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(_EIGHT, [_EIGHT]), name)
    return builder.call(function, [vector])


def _all(builder: Any, value: Any) -> Any:
    """A vector of one number."""
    if isinstance(value, float):
        return ir.Constant(_EIGHT, [value] * LANES)
    kind = ir.VectorType(value.type, LANES)
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), value, _INDEX(0))
    return _shuffled(builder, one, [0] * LANES)


def _shuffled(builder: Any, vector: Any, lanes: Sequence[int]) -> Any:
    chosen = ir.Constant(ir.VectorType(_INDEX, len(lanes)), list(lanes))
    return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), chosen)


def _near(builder: Any, squares: Any, dy2: Any, r2: Any) -> tuple[Any, Any]:
    d2 = builder.fadd(squares, _all(builder, dy2))
    return d2, builder.fcmp_ordered("<=", d2, _all(builder, r2))


def _multiply(builder: Any, eight: Any, near: Any, factor: Any) -> Any:
    product = builder.fmul(eight, builder.select(near, factor, _all(builder, 1.0)))
    enough = builder.fcmp_ordered(">=", product, _all(builder, SMALLEST))
    return builder.select(enough, product, _all(builder, 0.0))
