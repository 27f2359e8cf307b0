"""The machine that rewrites words: compiled loops over a program's tables.

A derivation step reads each word from left to right. The first production that matches (head, contexts, condition)
rewrites; productions with a probability take it from a common unit, and what they leave over falls to the next
production without one, or leaves the module as it is. Modules that no production takes are copied. Where a
program has a decomposition, each module that comes out is decomposed at once, depth first.

Random numbers are a function of (seed, step, id of the word, position of the module in it, how many it drew before):
no order of work can change them.

Time is O(modules read + modules written), with a factor for the productions of a symbol; a context costs the distance
to the module that it finds.
"""

from __future__ import annotations

import math

import numpy as np

from forestgen.core.compiled import borrowed, compiled
from forestgen.lsystem import opcodes as op
from forestgen.lsystem.machine_layout import (
    ARITY,
    CONDITION,
    DONE,
    DONE_VALUES,
    DRAWS,
    EXPANSIONS,
    FAULT,
    FAULT_MODULE,
    FOUND,
    FUNCTION_AT,
    FUNCTIONS,
    GROUP,
    HEAD,
    HEADS,
    IGNORED,
    LEFT,
    LEFTS,
    LOCAL_SIZE,
    LOCALS,
    MODULES,
    MOST_EXPANSIONS,
    MOST_MODULES,
    MOST_VALUES,
    NEED,
    NEED_OUT,
    NEED_PILE,
    NEED_WORDS,
    NEXT_ID,
    NEXT_VALUE,
    NEXT_WORD,
    PLAIN,
    PLAINS,
    PROBABILITY,
    RECORD,
    RIGHT,
    RIGHTS,
    SPARE,
    STACK,
    SUCCESSOR,
    VALUES,
    WORDS,
    WRITTEN,
    WRITTEN_VALUES,
)

_OPEN, _CLOSE, _PERCENT = 0, 1, 2
CUT, FRAGMENT = 1, 2  # what % means; 0: nothing

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1, _MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_S27, _S30, _S31, _S11 = np.uint64(27), np.uint64(30), np.uint64(31), np.uint64(11)
_UNIT = 1.0 / 9007199254740992.0  # 2^-53


@compiled
def _mix(z):  # type: ignore[no-untyped-def]
    """The finalizer of SplitMix64."""
    z = (z ^ (z >> _S30)) * _MIX_1
    z = (z ^ (z >> _S27)) * _MIX_2
    return z ^ (z >> _S31)


@compiled
def _uniform(key, m):  # type: ignore[no-untyped-def]
    """The next number in [0, 1) of a stream; m[DRAWS] counts them."""
    m[DRAWS] += 1
    return np.float64(_mix(key + _GOLDEN * np.uint64(m[DRAWS])) >> _S11) * _UNIT


@compiled
def _normal(key, m):  # type: ignore[no-untyped-def]
    """Box and Muller."""
    u = 1.0 - _uniform(key, m)
    return math.sqrt(-2.0 * math.log(u)) * math.cos(2.0 * math.pi * _uniform(key, m))


@compiled
def _poisson(mean, key, m):  # type: ignore[no-untyped-def]
    """By products of uniforms below 10; above, Hoermann's transformed rejection PTRS (1993)."""
    if mean < 10.0:
        limit, product, k = math.exp(-mean), 1.0, -1
        while True:
            k += 1
            product *= _uniform(key, m)
            if product <= limit:
                return float(k)
    root = math.sqrt(mean)
    b = 0.931 + 2.53 * root
    a = -0.059 + 0.02483 * b
    inverse_alpha = 1.1239 + 1.1328 / (b - 3.4)
    v_r = 0.9277 - 3.6224 / (b - 2.0)
    while True:
        u = _uniform(key, m) - 0.5
        v = 1.0 - _uniform(key, m)
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
    if operation == op.FLOOR:
        return np.floor(x)
    if operation == op.RAN:
        return x * _uniform(key, m)
    if operation == op.POISSON:
        return _poisson(x, key, m) if 0.0 <= x <= 1e15 else math.nan
    if operation == op.SQRT:
        return math.sqrt(x) if x >= 0 else math.nan
    if operation == op.EXP:
        return math.exp(x) if x < 709.78 else math.inf
    if operation == op.LOG:
        return math.log(x) if x > 0 else math.nan
    if operation == op.LOG10:
        return math.log10(x) if x > 0 else math.nan
    if operation == op.ABS:
        return abs(x)
    if operation == op.SIGN:
        return 1.0 if x > 0 else (-1.0 if x < 0 else 0.0)
    if operation == op.CEIL:
        return np.ceil(x)
    if operation == op.TRUNC:
        return np.trunc(x)
    if operation == op.SIN:
        return math.sin(math.radians(x))
    if operation == op.COS:
        return math.cos(math.radians(x))
    if operation == op.TAN:
        return math.tan(math.radians(x))
    if operation == op.ATAN:
        return math.degrees(math.atan(x))
    if not -1.0 <= x <= 1.0:
        return math.nan
    return math.degrees(math.asin(x) if operation == op.ASIN else math.acos(x))


@compiled
def _power(x, y):  # type: ignore[no-untyped-def]
    """nan where it is no real number."""
    if (x < 0 and y != np.floor(y)) or (x == 0 and y < 0):
        return math.nan
    return x**y


@compiled
def run(t, v, m, key, pc, out_code, out_parameter):  # type: ignore[no-untyped-def]
    """Run the code at t[pc]. EMIT writes to `out_*` at m[MODULES], m[VALUES]. A value is left in v[t[STACK]].

    Returns op.OK, or what went wrong; then m[FAULT] is where.
    """
    bottom, arity = t[STACK], t[ARITY]
    sp = bottom - 1
    while True:
        operation, operand = t[pc], t[pc + 1]
        if operation == op.LOAD:
            sp += 1
            v[sp] = v[operand]
        elif operation == op.RETURN:
            return op.OK
        elif operation == op.EMIT:
            n = t[arity + operand]
            sp -= n
            at = m[VALUES]
            for k in range(n):
                value = v[sp + 1 + k]
                if not math.isfinite(value):
                    m[FAULT] = pc
                    return op.NOT_FINITE
                out_parameter[at + k] = value
            m[VALUES] = at + n
            out_code[m[MODULES]] = operand
            m[MODULES] += 1
        elif operation == op.JUMP_IF_ZERO:
            sp -= 1
            if v[sp + 1] == 0.0:
                pc = operand
                continue
        elif operation == op.JUMP:
            pc = operand
            continue
        elif operation == op.STORE:
            v[operand] = v[sp]
            sp -= 1
        elif operation == op.ELEMENT:
            index = np.floor(v[sp])
            first, last = t[operand], t[operand + 1]
            if not 0 <= index < last - first:
                m[FAULT] = pc
                return op.NO_SUCH_ELEMENT
            v[sp] = v[first + np.int64(index)]
        elif operation == op.NOT:
            v[sp] = 1.0 if v[sp] == 0.0 else 0.0
        elif operation == op.TRUTH:
            v[sp] = 0.0 if v[sp] == 0.0 else 1.0
        elif operation == op.NEGATE:
            v[sp] = -v[sp]
        elif operation < op.SIN:
            sp -= 1
            a, b = v[sp], v[sp + 1]
            if operation == op.ADD:
                a += b
            elif operation == op.SUBTRACT:
                a -= b
            elif operation == op.MULTIPLY:
                a *= b
            elif operation == op.DIVIDE or operation == op.REMAINDER:
                if b == 0.0:
                    m[FAULT] = pc
                    return op.DIVISION_BY_ZERO
                a = a / b if operation == op.DIVIDE else np.fmod(a, b)
            elif operation == op.POWER:
                a = _power(a, b)
                if math.isnan(a):
                    m[FAULT] = pc
                    return op.OUTSIDE_DOMAIN
            elif operation == op.EQUAL:
                a = 1.0 if a == b else 0.0
            elif operation == op.UNEQUAL:
                a = 1.0 if a != b else 0.0
            elif operation == op.LESS:
                a = 1.0 if a < b else 0.0
            elif operation == op.LESS_EQUAL:
                a = 1.0 if a <= b else 0.0
            elif operation == op.GREATER:
                a = 1.0 if a > b else 0.0
            else:
                a = 1.0 if a >= b else 0.0
            v[sp] = a
        elif operation < op.MINIMUM:
            v[sp] = _one(operation, v[sp], key, m)
            if math.isnan(v[sp]):
                m[FAULT] = pc
                return op.OUTSIDE_DOMAIN
        else:
            sp -= 1
            a, b = v[sp], v[sp + 1]
            if operation == op.MINIMUM:
                a = min(a, b)
            elif operation == op.MAXIMUM:
                a = max(a, b)
            elif operation == op.NRAN:
                a = a + b * _normal(key, m)
            elif operation == op.ATAN2:
                a = math.degrees(math.atan2(a, b))
            else:
                index = np.floor(a) - 1.0
                if not 0 <= index < t[FUNCTIONS]:
                    m[FAULT] = pc
                    return op.NO_SUCH_FUNCTION
                curve = t[FUNCTION_AT] + 2 * np.int64(index)
                if t[curve + 1] == 0:
                    m[FAULT] = pc
                    return op.NO_SUCH_FUNCTION
                a = _curve(b, v, t[curve], t[curve + 1])
            v[sp] = a
        pc += 2


@compiled
def _left_context(t, m, rule, i, begin, codes, mate):  # type: ignore[no-untyped-def]
    """Whether the left context stands before module i; m[FOUND] on gets the modules' indices, in reading order."""
    cursor = i - 1
    for k in range(t[rule + LEFTS] - 1, -1, -1):
        while True:
            if cursor < begin:
                return False
            if codes[cursor] == _CLOSE:
                cursor = mate[cursor] - 1  # past a branch
            elif codes[cursor] == _OPEN or t[t[IGNORED] + codes[cursor]]:
                cursor -= 1  # down to what bears this branch
            else:
                break
        if codes[cursor] != t[t[rule + LEFT] + k]:
            return False
        m[FOUND + k] = cursor
        cursor -= 1
    return True


@compiled
def _right_context(t, m, rule, i, end, codes, mate):  # type: ignore[no-untyped-def]
    """Whether the right context stands from index i on; m[FOUND] as in `_left_context`, with brackets.

    A branch of the context takes the first branch of the word that fits it. Where one does not fit, the search goes on
    at the next branch of the same node: the first fit leaves most for what follows, so no other need be tried.
    """
    cursor, k, n = i, 0, t[rule + RIGHTS]
    right = t[rule + RIGHT]
    enclosing = right + n
    while k < n:
        wanted = t[right + k]
        if wanted == _CLOSE:
            cursor = mate[m[FOUND + t[enclosing + k]]]  # past what else the branch holds
        else:
            while cursor < end and codes[cursor] != _CLOSE:
                if codes[cursor] == _OPEN:
                    if wanted == _OPEN:
                        break
                    cursor = mate[cursor] + 1
                elif t[t[IGNORED] + codes[cursor]]:
                    cursor += 1
                else:
                    break
            if cursor >= end or codes[cursor] != wanted:
                k = t[enclosing + k]
                if k < 0:
                    return False
                cursor = mate[m[FOUND + k]] + 1
                continue
        m[FOUND + k] = cursor
        k += 1
        cursor += 1
    return True


@compiled
def _take(t, v, m, n, codes, parameters, starts, slot):  # type: ignore[no-untyped-def]
    """Copy the parameters of n found modules to local variables from `slot` on; the next free one."""
    for k in range(n):
        module = m[FOUND + k]
        first = starts[module]
        for j in range(t[t[ARITY] + codes[module]]):
            v[slot] = parameters[first + j]
            slot += 1
    return slot


@compiled
def _select(t, v, m, key, rules, group, i, p, begin, end, codes, parameters, starts, mate):  # type: ignore[no-untyped-def]
    """The production that rewrites module i, whose parameters begin at p; -1: none; below -1: -2 - fault.

    Its local variables are set.
    """
    taken, unit, chosen = 0.0, -1.0, -1
    for rule in range(t[rules + codes[i]], t[rules + codes[i] + 1], RECORD):
        if t[rule + GROUP] != 0 and t[rule + GROUP] != group:
            continue
        if chosen >= 0 and t[rule + PROBABILITY] < 0:
            continue
        n, head = t[rule + HEADS], t[rule + HEAD]
        if i + n > end:
            continue
        matches = True
        for k in range(1, n):
            if codes[i + k] != t[head + k]:
                matches = False
                break
        if not matches:
            continue
        slot = t[LOCALS]
        if t[rule + LEFTS] > 0:
            if not _left_context(t, m, rule, i, begin, codes, mate):
                continue
            slot = _take(t, v, m, t[rule + LEFTS], codes, parameters, starts, slot)
        cursor = p
        for k in range(n):
            for _ in range(t[t[ARITY] + codes[i + k]]):
                v[slot] = parameters[cursor]
                slot += 1
                cursor += 1
        if t[rule + RIGHTS] > 0:
            if not _right_context(t, m, rule, i + n, end, codes, mate):
                continue
            slot = _take(t, v, m, t[rule + RIGHTS], codes, parameters, starts, slot)
        if t[rule + CONDITION] >= 0:
            wrong = run(t, v, m, key, t[rule + CONDITION], codes, parameters)
            if wrong != op.OK:
                return -2 - wrong
            if math.isnan(v[t[STACK]]):
                m[FAULT] = t[rule + CONDITION]
                return -2 - op.OUTSIDE_DOMAIN
            if v[t[STACK]] == 0.0:
                continue
        if t[rule + PROBABILITY] < 0:
            return rule
        wrong = run(t, v, m, key, t[rule + PROBABILITY], codes, parameters)
        if wrong != op.OK:
            return -2 - wrong
        share = v[t[STACK]]
        m[FAULT] = t[rule + PROBABILITY]
        if not 0.0 <= share <= 1.0:
            return -2 - op.BAD_PROBABILITY
        if unit < 0.0:
            unit = _uniform(key, m)
        taken += share
        if taken > 1.0 + 1e-9:
            return -2 - op.PROBABILITIES_OVER_ONE
        if chosen < 0 and unit < taken:
            # The others are looked at all the same: do the probabilities exceed 1?
            chosen = rule
            for k in range(t[LOCAL_SIZE]):
                v[t[SPARE] + k] = v[t[LOCALS] + k]
    if chosen >= 0:
        for k in range(t[LOCAL_SIZE]):
            v[t[LOCALS] + k] = v[t[SPARE] + k]
    return chosen


@compiled
def _decompose(  # type: ignore[no-untyped-def]
    t, v, m, key, rules, group, depth, is_strict, made_code, made_parameter,
               pile_code, pile_depth, pile_parameter, out_code, out_parameter):  # fmt: skip
    """Decompose the modules in `made_*` and append the result to `out_*`.

    m[MODULES], m[VALUES] count what was made; m[WRITTEN], m[WRITTEN_VALUES] what is in `out_*`.
    Returns op.OK, op.MORE_SPACE, or what went wrong.
    """
    none = np.zeros(0, np.int64)
    arities = t[ARITY]
    height, top, level = 0, 0, 0
    while True:
        # Onto the pile, the first module at its top.
        n, q = m[MODULES], m[VALUES]
        if height + n > len(pile_code) or top + q > len(pile_parameter):
            m[NEED] = NEED_PILE
            return op.MORE_SPACE
        for k in range(n - 1, -1, -1):
            arity = t[arities + made_code[k]]
            q -= arity
            for j in range(arity):
                pile_parameter[top + j] = made_parameter[q + j]
            top += arity
            pile_code[height], pile_depth[height] = made_code[k], level
            height += 1
        m[MODULES], m[VALUES] = 0, 0
        while height > 0:
            height -= 1
            kind = pile_code[height]
            arity = t[arities + kind]
            top -= arity
            rule = -1
            if t[rules + kind] < t[rules + kind + 1]:
                rule = _select(
                    t, v, m, key, rules, group, height, top, height, height + 1, pile_code, pile_parameter, none, none
                )
                if rule < -1:
                    return -2 - rule
            if rule >= 0 and pile_depth[height] >= depth:
                if is_strict:
                    m[FAULT] = t[rule + SUCCESSOR]
                    return op.TOO_DEEP
                rule = -1
            if rule >= 0:
                m[EXPANSIONS] += 1
                if m[EXPANSIONS] > MOST_EXPANSIONS:
                    m[FAULT] = t[rule + SUCCESSOR]
                    return op.TOO_DEEP
                wrong = run(t, v, m, key, t[rule + SUCCESSOR], made_code, made_parameter)
                if wrong != op.OK:
                    return wrong
                level = pile_depth[height] + 1
                break
            at, to = m[WRITTEN], m[WRITTEN_VALUES]
            if at >= len(out_code) or to + arity > len(out_parameter):
                return op.MORE_SPACE
            out_code[at] = kind
            for j in range(arity):
                out_parameter[to + j] = pile_parameter[top + j]
            m[WRITTEN], m[WRITTEN_VALUES] = at + 1, to + arity
        if m[MODULES] == 0 and height == 0:
            return op.OK


@compiled
def pair_brackets(codes, mate):  # type: ignore[no-untyped-def]
    """Set mate[i] of each bracket to the index of its partner."""
    opened = np.empty(len(codes), np.int64)
    depth = 0
    for i in range(len(codes)):
        if codes[i] == _OPEN:
            opened[depth] = i
            depth += 1
        elif codes[i] == _CLOSE:
            depth -= 1
            mate[i] = opened[depth]
            mate[opened[depth]] = i


@compiled
def _cut(m, codes, parameters, t):  # type: ignore[no-untyped-def]
    """Remove every % of the word just written and the rest of its branch, in place."""
    out, q, skipping, depth = m[DONE], m[DONE_VALUES], False, 0
    at = q
    for i in range(m[DONE], m[WRITTEN]):
        n = t[t[ARITY] + codes[i]]
        keep = not skipping
        if skipping:
            if codes[i] == _OPEN:
                depth += 1
            elif codes[i] == _CLOSE:
                if depth == 0:
                    skipping, keep = False, True
                else:
                    depth -= 1
        elif codes[i] == _PERCENT:
            skipping, keep, depth = True, False, 0
        if keep:
            codes[out] = codes[i]
            for k in range(n):
                parameters[q + k] = parameters[at + k]
            out += 1
            q += n
        at += n
    m[WRITTEN], m[WRITTEN_VALUES] = out, q


@compiled
def _fragment(codes, parameters, t, begin, end, p):  # type: ignore[no-untyped-def]
    """Sort a word's modules by the piece they belong to, without %; the pieces' ends, in modules.

    The piece that holds the word's begin comes first, then the others in the order of their %. Stable.
    """
    n = end - begin
    piece = np.empty(n, np.int64)
    outer = np.empty(n + 1, np.int64)
    depth, current, pieces = 0, 0, 1
    for i in range(n):
        c = codes[begin + i]
        if c == _PERCENT:
            current = pieces
            pieces += 1
            piece[i] = -1
        elif c == _CLOSE:
            depth -= 1
            current = outer[depth]
            piece[i] = current
        else:
            piece[i] = current
            if c == _OPEN:
                outer[depth] = current
                depth += 1
    modules = np.zeros(pieces + 1, np.int64)
    values = np.zeros(pieces + 1, np.int64)
    for i in range(n):
        if piece[i] >= 0:
            modules[piece[i] + 1] += 1
            values[piece[i] + 1] += t[t[ARITY] + codes[begin + i]]
    for k in range(pieces):
        modules[k + 1] += modules[k]
        values[k + 1] += values[k]
    ends = modules[1:].copy()
    old_code = codes[begin:end].copy()
    total = values[pieces]
    old_parameter = parameters[p : p + total].copy()
    at = 0
    for i in range(n):
        k = piece[i]
        if k < 0:
            continue
        codes[begin + modules[k]] = old_code[i]
        modules[k] += 1
        for _ in range(t[t[ARITY] + old_code[i]]):
            parameters[p + values[k]] = old_parameter[at]
            values[k] += 1
            at += 1
    return ends


@compiled
def rewrite(  # type: ignore[no-untyped-def]
    t, v, m, key, rules, inner, group, inner_depth, is_strict, percent, now,
    codes, parameters, starts, mate, word_start, word_id, born,
    made_code, made_parameter, pile_code, pile_depth, pile_parameter,
    out_code, out_parameter, out_start, out_id, out_born,
):  # fmt: skip
    """One derivation step: rewrite all words by `rules`, and what comes out by `inner` (-1: none) down to a depth.

    m holds the next word, its first parameter, the numbers of modules, parameters and words written, and the next id;
    after op.MORE_SPACE the call can be repeated with larger `out_*` and `pile_*`, and goes on at that word.
    """
    t, v, m, codes, parameters = borrowed(t), borrowed(v), borrowed(m), borrowed(codes), borrowed(parameters)
    starts, mate, made_code, made_parameter = (
        borrowed(starts),
        borrowed(mate),
        borrowed(made_code),
        borrowed(made_parameter),
    )
    pile_code, pile_depth, pile_parameter = borrowed(pile_code), borrowed(pile_depth), borrowed(pile_parameter)
    out_code, out_parameter = borrowed(out_code), borrowed(out_parameter)
    out_start, out_id, out_born = borrowed(out_start), borrowed(out_id), borrowed(out_born)
    arities = t[ARITY]
    m[NEED] = NEED_OUT
    for w in range(m[NEXT_WORD], len(word_id)):
        begin, end = np.int64(word_start[w]), np.int64(word_start[w + 1])  # one type of index: one compilation
        p = m[NEXT_VALUE]
        written, values = m[DONE], m[DONE_VALUES]
        word_key = _mix(key + _GOLDEN * np.uint64(word_id[w]))
        i = begin
        while i < end:
            kind = codes[i]
            rule = t[rules + kind]
            has_rules = rule < t[rules + kind + 1]
            decomposes = inner >= 0 and t[inner + kind] < t[inner + kind + 1]
            if inner < 0 and has_rules and t[rule + PLAIN] >= 0:
                # One symbol into symbols without parameters, whatever stands around it.
                n = t[rule + PLAINS]
                if written + n > len(out_code):
                    return op.MORE_SPACE
                for k in range(n):
                    out_code[written + k] = t[t[rule + PLAIN] + k]
                written += n
                p += t[arities + kind]
                i += 1
                continue
            module_key = word_key
            m[DRAWS] = 0
            if has_rules or decomposes:
                module_key = _mix(word_key + _GOLDEN * np.uint64(i - begin + 1))
            rule = -1
            if has_rules:
                rule = _select(t, v, m, module_key, rules, group, i, p, begin, end, codes, parameters, starts, mate)
                if rule < -1:
                    m[FAULT_MODULE] = i
                    return -2 - rule
            if rule < 0 and not decomposes:
                n = t[arities + kind]
                if written >= len(out_code) or values + n > len(out_parameter):
                    return op.MORE_SPACE
                out_code[written] = kind
                for k in range(n):
                    out_parameter[values + k] = parameters[p + k]
                written += 1
                values += n
                p += n
                i += 1
                continue
            taken = 1
            if rule < 0:
                made_code[0] = kind
                n = t[arities + kind]
                for k in range(n):
                    made_parameter[k] = parameters[p + k]
                m[MODULES], m[VALUES] = 1, n
            else:
                taken = t[rule + HEADS]
                if inner >= 0:
                    m[MODULES], m[VALUES] = 0, 0
                    wrong = run(t, v, m, module_key, t[rule + SUCCESSOR], made_code, made_parameter)
                else:
                    if (
                        written + t[rule + MOST_MODULES] > len(out_code)
                        or values + t[rule + MOST_VALUES] > len(out_parameter)
                    ):  # fmt: skip
                        return op.MORE_SPACE
                    m[MODULES], m[VALUES] = written, values
                    wrong = run(t, v, m, module_key, t[rule + SUCCESSOR], out_code, out_parameter)
                    written, values = m[MODULES], m[VALUES]
                if wrong != op.OK:
                    m[FAULT_MODULE] = i
                    return wrong
            if inner >= 0:
                m[WRITTEN], m[WRITTEN_VALUES] = written, values
                wrong = _decompose(
                    t, v, m, module_key, inner, group, inner_depth, is_strict, made_code, made_parameter,
                    pile_code, pile_depth, pile_parameter, out_code, out_parameter,
                )  # fmt: skip
                if wrong != op.OK:
                    m[FAULT_MODULE] = i
                    return wrong
                written, values = m[WRITTEN], m[WRITTEN_VALUES]
            for k in range(taken):
                p += t[arities + codes[i + k]]
            i += taken
        m[WRITTEN], m[WRITTEN_VALUES] = written, values
        old_kind = codes[begin] if end > begin else _OPEN
        wrong = _finish_word(
            t, m, percent, old_kind, word_id[w], born[w], now, out_code, out_parameter, out_start, out_id, out_born
        )
        if wrong != op.OK:
            return wrong
        m[NEXT_WORD], m[NEXT_VALUE] = w + 1, p
    return op.OK


@compiled
def _finish_word(t, m, percent, old_kind, word_id, born, now, out_code, out_parameter, out_start, out_id, out_born):  # type: ignore[no-untyped-def]
    """Cut or fragment the word that was written, and enter what is left of it into the list of words."""
    begin, end, p = m[DONE], m[WRITTEN], m[DONE_VALUES]
    count = 0
    if percent != 0:
        for i in range(begin, end):
            if out_code[i] == _PERCENT:
                count += 1
    if m[WORDS] + count + 1 > len(out_id):
        m[NEED] = NEED_WORDS
        return op.MORE_SPACE
    if count > 0 and percent == FRAGMENT:
        ends = _fragment(out_code, out_parameter, t, begin, end, p)
        first = begin
        for k in range(len(ends)):
            _enter(m, first, begin + ends[k], k, old_kind, word_id, born, now, out_code, out_start, out_id, out_born)
            first = begin + ends[k]
        end = first
    else:
        if count > 0:
            _cut(m, out_code, out_parameter, t)
            end = m[WRITTEN]
        _enter(m, begin, end, 0, old_kind, word_id, born, now, out_code, out_start, out_id, out_born)
    m[DONE], m[DONE_VALUES] = end, m[WRITTEN_VALUES]
    return op.OK


@compiled
def _enter(m, begin, end, piece, old_kind, word_id, born, now, out_code, out_start, out_id, out_born):  # type: ignore[no-untyped-def]
    """Enter one word; an empty one is gone. A word keeps its id while it begins with the same kind."""
    if end <= begin:
        return
    k = m[WORDS]
    out_start[k], out_start[k + 1] = begin, end
    if piece == 0 and out_code[begin] == old_kind:
        out_id[k], out_born[k] = word_id, born
    else:
        out_id[k], out_born[k] = m[NEXT_ID], now
        m[NEXT_ID] += 1
    m[WORDS] = k + 1
