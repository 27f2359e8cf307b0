"""Eight cells at once: the innermost operations of the probability field as vector instructions.

Numba compiles loops over eight numbers into single steps where it cannot know that arrays do not overlap. These
operations say it: eight numbers are loaded into a register, worked on, and stored.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel import models
from numba.extending import intrinsic, register_model

from forestgen.community.placement.field_layout import LANES, SMALLEST

_VECTOR = ir.VectorType(ir.DoubleType(), LANES)
_WHOLE = ir.VectorType(ir.IntType(32), LANES)
_INDEX = ir.IntType(32)


class Eight(types.Type):
    """Eight numbers in a register."""

    def __init__(self) -> None:
        super().__init__(name="Eight")


@register_model(Eight)
class _EightModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _VECTOR)


EIGHT = Eight()


@intrinsic
def pointer(typing_context, array):  # type: ignore[no-untyped-def]
    """The memory of an array, which the caller keeps alive: nobody counts references to it."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return context.make_array(signature.args[0])(context, builder, arguments[0]).data

    return types.CPointer(array.dtype)(array), code  # type: ignore[attr-defined]


@intrinsic
def load(typing_context, memory, index):  # type: ignore[no-untyped-def]
    """One number."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(builder.gep(arguments[0], [arguments[1]]))

    return memory.dtype(memory, types.int64), code


@intrinsic
def store(typing_context, memory, index, value):  # type: ignore[no-untyped-def]
    """Write one number."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.store(arguments[2], builder.gep(arguments[0], [arguments[1]]))
        return context.get_dummy_value()

    return types.void(memory, types.int64, memory.dtype), code


@intrinsic
def ask_for(typing_context, memory, index):  # type: ignore[no-untyped-def]
    """Have a line of memory brought near, and go on meanwhile."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        number = ir.IntType(32)
        kinds = ir.FunctionType(ir.VoidType(), [cgutils.voidptr_t, number, number, number])
        place = builder.bitcast(builder.gep(arguments[0], [arguments[1]]), cgutils.voidptr_t)
        call = cgutils.get_or_insert_function(builder.module, kinds, "llvm.prefetch.p0")
        builder.call(call, [place, number(1), number(3), number(1)])
        return context.get_dummy_value()

    return types.void(memory, types.int64), code


@intrinsic
def load_line(typing_context, memory, index):  # type: ignore[no-untyped-def]
    """Eight numbers."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(_line(builder, arguments), align=8)

    return EIGHT(memory, types.int64), code


@intrinsic
def store_line(typing_context, memory, index, eight):  # type: ignore[no-untyped-def]
    """Write eight numbers."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.store(arguments[2], _line(builder, arguments), align=8)
        return context.get_dummy_value()

    return types.void(memory, types.int64, EIGHT), code


@intrinsic
def sum_of(typing_context, eight):  # type: ignore[no-untyped-def]
    """Sum of eight numbers."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vector = arguments[0]
        for half in (4, 2, 1):
            low, high = _shuffled(builder, vector, range(half)), _shuffled(builder, vector, range(half, 2 * half))
            vector = builder.fadd(low, high)
        return builder.extract_element(vector, _INDEX(0))

    return types.float64(EIGHT), code


@intrinsic
def plus(typing_context, eight, other):  # type: ignore[no-untyped-def]
    """Eight numbers and eight others, one by one."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fadd(arguments[0], arguments[1])

    return EIGHT(EIGHT, EIGHT), code


@intrinsic
def load_across(typing_context, memory, index, count):  # type: ignore[no-untyped-def]
    """The same number of eight lines that follow one another; 0 for lines from `count` on, whatever is there."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        memory, index, count = arguments
        eight = ir.Constant(_VECTOR, ir.Undefined)
        first = builder.gep(memory, [index])
        for lane in range(LANES):
            number = builder.load(builder.gep(first, [_INDEX(lane * LANES)]))
            eight = builder.insert_element(eight, number, _INDEX(lane))
        there = builder.icmp_signed("<", _WHOLE(list(range(LANES))), _all(builder, builder.trunc(count, _INDEX)))
        return builder.select(there, eight, _all(builder, 0.0))

    return EIGHT(memory, types.int64, types.int64), code


@intrinsic
def passed(typing_context, eight, u):  # type: ignore[no-untyped-def]
    """How many of the first seven partial sums are at most u, and what the numbers before leave of u."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        k, before = _passed(builder, *arguments)
        left = builder.fsub(arguments[1], builder.extract_element(before, k))
        return context.make_tuple(builder, signature.return_type, [k, left])

    return types.Tuple((types.int64, types.float64))(EIGHT, types.float64), code  # type: ignore[attr-defined]


@intrinsic
def passed_as_guessed(typing_context, eight, u, guess):  # type: ignore[no-untyped-def]
    """Whether `passed` finds k to be `guess`, and what the numbers before leave of u if so.

    Which numbers are before is known without u: steps that follow one another need not wait to choose.
    """

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        eight, u, guess = arguments
        k, before = _passed(builder, eight, u)
        left = builder.fsub(u, builder.extract_element(before, guess))
        return context.make_tuple(builder, signature.return_type, [builder.icmp_signed("==", k, guess), left])

    pair = types.Tuple((types.boolean, types.float64))  # type: ignore[attr-defined]
    return pair(EIGHT, types.float64, types.int64), code


@intrinsic
def with_number(typing_context, eight, k, value):  # type: ignore[no-untyped-def]
    """Eight numbers, of which number k has become `value`."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        eight, k, value = arguments
        chosen = builder.icmp_signed("==", _all(builder, builder.trunc(k, _INDEX)), _WHOLE(list(range(LANES))))
        return builder.select(chosen, _all(builder, value), eight)

    return EIGHT(EIGHT, types.int64, types.float64), code


@intrinsic
def distances(typing_context, b, x, width, first, last):  # type: ignore[no-untyped-def]
    """((j + 0.5 - x) width)² of the columns j = 8 b .. 8 b + 7; infinite outside first .. last."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        b, x, width, first, last = arguments
        kind = ir.VectorType(ir.IntType(64), LANES)
        start = _all(builder, builder.mul(b, ir.IntType(64)(LANES)))
        j = builder.add(start, kind(list(range(LANES))))
        dx = builder.fsub(builder.fadd(builder.sitofp(j, _VECTOR), _all(builder, 0.5)), _all(builder, x))
        dx = builder.fmul(dx, _all(builder, width))
        inside = builder.and_(
            builder.icmp_signed(">=", j, _all(builder, first)), builder.icmp_signed("<=", j, _all(builder, last))
        )
        square = _rounded(builder, builder.fmul(dx, dx))
        return builder.select(inside, square, _all(builder, float("inf")))

    whole, number = types.int64, types.float64
    return EIGHT(whole, number, number, whole, whole), code


@intrinsic
def only_near(typing_context, eight, squares, dy2, r2):  # type: ignore[no-untyped-def]
    """Those of eight cells whose `squares` + dy2 is at most r2, and 0.0 for others."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        eight, squares, dy2, r2 = arguments
        _, near = _near(builder, squares, dy2, r2)
        return builder.select(near, eight, _all(builder, 0.0))

    number = types.float64
    return EIGHT(EIGHT, EIGHT, number, number), code


@intrinsic
def times(typing_context, eight, squares, dy2, r2, factor):  # type: ignore[no-untyped-def]
    """Multiply those of eight cells whose `squares` + dy2 is at most r2 by one factor."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        eight, squares, dy2, r2, factor = arguments
        _, near = _near(builder, squares, dy2, r2)
        return _multiply(builder, eight, near, _all(builder, factor))

    number = types.float64
    return EIGHT(EIGHT, EIGHT, number, number, number), code


@intrinsic
def times_table(typing_context, eight, squares, dy2, r2, scale, last, table):  # type: ignore[no-untyped-def]
    """Multiply those of eight cells whose d2 = `squares` + dy2 is at most r2 by a table.

    The factor is linear between the table's values at the whole numbers about sqrt(d2) scale, which is at most `last`.
    """

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        eight, squares, dy2, r2, scale, last, table = arguments
        d2, near = _near(builder, squares, dy2, r2)
        kinds = ir.FunctionType(_VECTOR, [_VECTOR])
        root = cgutils.get_or_insert_function(builder.module, kinds, "llvm.sqrt.v8f64")
        at = builder.fmul(builder.call(root, [d2]), _all(builder, scale))
        most = _all(builder, last)
        at = builder.select(builder.fcmp_ordered("<", at, most), at, most)
        whole = builder.fptosi(at, _WHOLE)
        low, high = ir.Constant(_VECTOR, ir.Undefined), ir.Constant(_VECTOR, ir.Undefined)
        for lane in range(LANES):
            number = builder.sext(builder.extract_element(whole, _INDEX(lane)), ir.IntType(64))
            here = builder.gep(table, [number])
            low = builder.insert_element(low, builder.load(here), _INDEX(lane))
            high = builder.insert_element(high, builder.load(builder.gep(here, [_INDEX(1)])), _INDEX(lane))
        part = builder.fsub(at, builder.sitofp(whole, _VECTOR))
        factor = builder.fadd(low, builder.fmul(part, builder.fsub(high, low)))
        return _multiply(builder, eight, near, factor)

    number = types.float64
    return EIGHT(EIGHT, EIGHT, number, number, number, number, table), code


def _passed(builder: Any, sums: Any, u: Any) -> tuple[Any, Any]:
    """How many of the first seven partial sums are at most u, and what the numbers before each leave of u."""
    zero = ir.Constant(_VECTOR, [0.0] * LANES)
    for lanes in ([8, 0, 8, 2, 8, 4, 8, 6], [8, 8, 1, 1, 8, 8, 5, 5], [8, 8, 8, 8, 3, 3, 3, 3]):
        chosen = ir.Constant(ir.VectorType(_INDEX, LANES), lanes)
        sums = builder.fadd(sums, builder.shuffle_vector(sums, zero, chosen))
    below = builder.fcmp_ordered("<=", sums, _all(builder, u))
    bits = builder.and_(builder.bitcast(below, ir.IntType(8)), ir.IntType(8)(127))
    chosen = ir.Constant(ir.VectorType(_INDEX, LANES), [8, 0, 1, 2, 3, 4, 5, 6])
    before = builder.shuffle_vector(sums, zero, chosen)
    return builder.zext(builder.ctpop(bits), ir.IntType(64)), before


def _line(builder: Any, arguments: Any) -> Any:
    return builder.bitcast(builder.gep(arguments[0], [arguments[1]]), _VECTOR.as_pointer())


def _rounded(builder: Any, vector: Any) -> Any:
    """The same, never contracted with a later sum."""
    kinds = ir.FunctionType(_VECTOR, [_VECTOR])
    return builder.call(cgutils.get_or_insert_function(builder.module, kinds, "llvm.arithmetic.fence.v8f64"), [vector])


def _all(builder: Any, value: Any) -> Any:
    """A vector of one number."""
    if isinstance(value, float):
        return ir.Constant(_VECTOR, [value] * LANES)
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
