"""Compiled code of expressions, and the random numbers in them."""

from __future__ import annotations

import math

import numpy as np

from forestgen.core.compiled import compiled, inlined_exactly
from forestgen.core.randomness import SPLIT_MIX_STEP, mixed
from forestgen.lsystem import vm_layout as layout

_S11 = np.uint64(11)
_UNIT = 1.0 / 9007199254740992.0  # 2^-53
mix = inlined_exactly(mixed)


@compiled
def uniform(key, m):  # type: ignore[no-untyped-def]
    """The next number in [0, 1) of a stream; m[DRAWS] counts them."""
    m[layout.DRAWS] += 1
    return np.float64(mix(key + SPLIT_MIX_STEP * np.uint64(m[layout.DRAWS])) >> _S11) * _UNIT


@compiled
def _normal(key, m):  # type: ignore[no-untyped-def]
    """Box and Muller."""
    u = 1.0 - uniform(key, m)
    return math.sqrt(-2.0 * math.log(u)) * math.cos(2.0 * math.pi * uniform(key, m))


@compiled
def _poisson(mean, key, m):  # type: ignore[no-untyped-def]
    """By products of uniforms below 10; above, Hoermann's transformed rejection PTRS (1993)."""
    if mean < 10.0:
        limit, product, k = math.exp(-mean), 1.0, -1
        while True:
            k += 1
            product *= uniform(key, m)
            if product <= limit:
                return float(k)
    root = math.sqrt(mean)
    b = 0.931 + 2.53 * root
    a = -0.059 + 0.02483 * b
    inverse_alpha = 1.1239 + 1.1328 / (b - 3.4)
    v_r = 0.9277 - 3.6224 / (b - 2.0)
    while True:
        u = uniform(key, m) - 0.5
        v = 1.0 - uniform(key, m)
        us = 0.5 - abs(u)
        if us <= 0.0:
            continue
        k = np.floor((2.0 * a / us + b) * u + mean + 0.43)
        if us >= 0.07 and v <= v_r:
            return k
        if k < 0 or (us < 0.013 and v > us):
            continue
        if math.log(v) + math.log(inverse_alpha) - math.log(a / (us * us) + b) <= (
            -mean + k * math.log(mean) - math.lgamma(k + 1.0)
        ):
            return k


@compiled
def _curve(x, v, first, n):  # type: ignore[no-untyped-def]
    """Linear between n samples, constant beyond them; v holds their x from `first` on, then their y."""
    if x <= v[first]:
        return v[first + n]
    if x >= v[first + n - 1]:
        return v[first + 2 * n - 1]
    low, high = first, first + n - 1
    while high - low > 1:
        middle = (low + high) // 2
        if v[middle] <= x:
            low = middle
        else:
            high = middle
    width = v[high] - v[low]
    return v[low + n] if width <= 0 else v[low + n] + (v[high + n] - v[low + n]) * (x - v[low]) / width


@compiled
def _one(operation, x, key, m):  # type: ignore[no-untyped-def]
    """Value of a function of one value; nan outside its domain."""
    if operation == layout.FLOOR:
        return np.floor(x)
    if operation == layout.RAN:
        return x * uniform(key, m)
    if operation == layout.POISSON:
        return _poisson(x, key, m) if 0.0 <= x <= 1e15 else math.nan
    if operation == layout.SQRT:
        return math.sqrt(x) if x >= 0 else math.nan
    if operation == layout.EXP:
        return math.exp(x) if x < 709.78 else math.inf
    if operation == layout.LOG:
        return math.log(x) if x > 0 else math.nan
    if operation == layout.LOG10:
        return math.log10(x) if x > 0 else math.nan
    if operation == layout.ABS:
        return abs(x)
    if operation == layout.SIGN:
        return 1.0 if x > 0 else (-1.0 if x < 0 else 0.0)
    if operation == layout.CEIL:
        return np.ceil(x)
    if operation == layout.TRUNC:
        return np.trunc(x)
    if operation == layout.SIN:
        return math.sin(math.radians(x))
    if operation == layout.COS:
        return math.cos(math.radians(x))
    if operation == layout.TAN:
        return math.tan(math.radians(x))
    if operation == layout.ATAN:
        return math.degrees(math.atan(x))
    if not -1.0 <= x <= 1.0:
        return math.nan
    return math.degrees(math.asin(x) if operation == layout.ASIN else math.acos(x))


@compiled
def _power(x, y):  # type: ignore[no-untyped-def]
    """nan where it is no real number."""
    if (x < 0 and y != np.floor(y)) or (x == 0 and y < 0):
        return math.nan
    return x**y


@compiled
def run(t, v, m, key, pc, out_code, out_parameter):  # type: ignore[no-untyped-def]
    """Run the code at t[pc]. EMIT writes to `out_*` at m[MODULES], m[VALUES]. A value is left in v[t[STACK]].

    Returns layout.OK, or what went wrong; then m[FAULT] is where.
    """
    bottom, arity = t[layout.STACK], t[layout.ARITY]
    sp = bottom - 1
    while True:
        operation, operand = t[pc], t[pc + 1]
        if operation == layout.LOAD:
            sp += 1
            v[sp] = v[operand]
        elif operation == layout.RETURN:
            return layout.OK
        elif operation == layout.EMIT:
            n = t[arity + operand]
            sp -= n
            at = m[layout.VALUES]
            for k in range(n):
                value = v[sp + 1 + k]
                if not math.isfinite(value):
                    m[layout.FAULT] = pc
                    return layout.NOT_FINITE
                out_parameter[at + k] = value
            m[layout.VALUES] = at + n
            out_code[m[layout.MODULES]] = operand
            m[layout.MODULES] += 1
        elif operation == layout.JUMP_IF_ZERO:
            sp -= 1
            if v[sp + 1] == 0.0:
                pc = operand
                continue
        elif operation == layout.JUMP:
            pc = operand
            continue
        elif operation == layout.STORE:
            v[operand] = v[sp]
            sp -= 1
        elif operation == layout.ELEMENT:
            index = np.floor(v[sp])
            first, last = t[operand], t[operand + 1]
            if not 0 <= index < last - first:
                m[layout.FAULT] = pc
                return layout.NO_SUCH_ELEMENT
            v[sp] = v[first + np.int64(index)]
        elif operation == layout.NOT:
            v[sp] = 1.0 if v[sp] == 0.0 else 0.0
        elif operation == layout.TRUTH:
            v[sp] = 0.0 if v[sp] == 0.0 else 1.0
        elif operation == layout.NEGATE:
            v[sp] = -v[sp]
        elif operation < layout.SIN:
            sp -= 1
            a, b = v[sp], v[sp + 1]
            if operation == layout.ADD:
                a += b
            elif operation == layout.SUBTRACT:
                a -= b
            elif operation == layout.MULTIPLY:
                a *= b
            elif operation == layout.DIVIDE or operation == layout.REMAINDER:
                if b == 0.0:
                    m[layout.FAULT] = pc
                    return layout.DIVISION_BY_ZERO
                a = a / b if operation == layout.DIVIDE else np.fmod(a, b)
            elif operation == layout.POWER:
                a = _power(a, b)
                if math.isnan(a):
                    m[layout.FAULT] = pc
                    return layout.OUTSIDE_DOMAIN
            elif operation == layout.EQUAL:
                a = 1.0 if a == b else 0.0
            elif operation == layout.UNEQUAL:
                a = 1.0 if a != b else 0.0
            elif operation == layout.LESS:
                a = 1.0 if a < b else 0.0
            elif operation == layout.LESS_EQUAL:
                a = 1.0 if a <= b else 0.0
            elif operation == layout.GREATER:
                a = 1.0 if a > b else 0.0
            else:
                a = 1.0 if a >= b else 0.0
            v[sp] = a
        elif operation < layout.MINIMUM:
            v[sp] = _one(operation, v[sp], key, m)
            if math.isnan(v[sp]):
                m[layout.FAULT] = pc
                return layout.OUTSIDE_DOMAIN
        else:
            sp -= 1
            a, b = v[sp], v[sp + 1]
            if operation == layout.MINIMUM:
                a = min(a, b)
            elif operation == layout.MAXIMUM:
                a = max(a, b)
            elif operation == layout.NRAN:
                a = a + b * _normal(key, m)
            elif operation == layout.ATAN2:
                a = math.degrees(math.atan2(a, b))
            else:
                index = np.floor(a) - 1.0
                if not 0 <= index < t[layout.FUNCTIONS]:
                    m[layout.FAULT] = pc
                    return layout.NO_SUCH_FUNCTION
                curve = t[layout.FUNCTION_AT] + 2 * np.int64(index)
                if t[curve + 1] == 0:
                    m[layout.FAULT] = pc
                    return layout.NO_SUCH_FUNCTION
                a = _curve(b, v, t[curve], t[curve + 1])
            v[sp] = a
        pc += 2
