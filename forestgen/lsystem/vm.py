"""The virtual machine (VM) that rewrites words: compiled loops over a program's tables.

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

from forestgen.core.compiled import compiled, unowned_view
from forestgen.core.randomness import SPLIT_MIX_STEP
from forestgen.lsystem import vm_layout as layout
from forestgen.lsystem.multiset import OPEN
from forestgen.lsystem.vm_expressions import mix, run, uniform
from forestgen.lsystem.vm_words import finish_word, left_context, right_context, take


@compiled
def _select(t, v, m, key, rules, group, i, p, begin, end, text):  # type: ignore[no-untyped-def]
    """The production that rewrites module i, whose parameters begin at p; -1: none; below -1: -2 - fault.

    Its local variables are set.
    """
    codes, parameters = text.code, text.parameter
    taken, unit, chosen = 0.0, -1.0, -1
    for rule in range(t[rules + codes[i]], t[rules + codes[i] + 1], layout.RECORD):
        if t[rule + layout.GROUP] != 0 and t[rule + layout.GROUP] != group:
            continue
        if chosen >= 0 and t[rule + layout.PROBABILITY] < 0:
            continue
        n, head = t[rule + layout.HEADS], t[rule + layout.HEAD]
        if i + n > end:
            continue
        matches = True
        for k in range(1, n):
            if codes[i + k] != t[head + k]:
                matches = False
                break
        if not matches:
            continue
        slot = 0
        if t[rule + layout.LEFTS] > 0:
            if not left_context(t, m, rule, i, begin, text):
                continue
            slot = take(t, v, m, t[rule + layout.LEFTS], text, slot)
        cursor = p
        for k in range(n):
            for _ in range(t[t[layout.ARITY] + codes[i + k]]):
                v[slot] = parameters[cursor]
                slot += 1
                cursor += 1
        if t[rule + layout.RIGHTS] > 0:
            if not right_context(t, m, rule, i + n, end, text):
                continue
            slot = take(t, v, m, t[rule + layout.RIGHTS], text, slot)
        if t[rule + layout.CONDITION] >= 0:
            wrong = run(t, v, m, key, t[rule + layout.CONDITION], codes, parameters)
            if wrong != layout.OK:
                return -2 - wrong
            if math.isnan(v[t[layout.STACK]]):
                m[layout.FAULT] = t[rule + layout.CONDITION]
                return -2 - layout.OUTSIDE_DOMAIN
            if v[t[layout.STACK]] == 0.0:
                continue
        if t[rule + layout.PROBABILITY] < 0:
            return rule
        wrong = run(t, v, m, key, t[rule + layout.PROBABILITY], codes, parameters)
        if wrong != layout.OK:
            return -2 - wrong
        share = v[t[layout.STACK]]
        m[layout.FAULT] = t[rule + layout.PROBABILITY]
        if not 0.0 <= share <= 1.0:
            return -2 - layout.BAD_PROBABILITY
        if unit < 0.0:
            unit = uniform(key, m)
        taken += share
        if taken > 1.0 + 1e-9:
            return -2 - layout.PROBABILITIES_OVER_ONE
        if chosen < 0 and unit < taken:
            # The other productions are still looked at: the probabilities must not exceed 1.
            chosen = rule
            for k in range(t[layout.LOCAL_SIZE]):
                v[t[layout.LOCAL_SIZE] + k] = v[k]
    if chosen >= 0:
        for k in range(t[layout.LOCAL_SIZE]):
            v[k] = v[t[layout.LOCAL_SIZE] + k]
    return chosen


@compiled
def _decompose(t, v, m, key, how, made, pile, out):  # type: ignore[no-untyped-def]
    """Decompose the modules in `made` and append the result to `out`.

    m[MODULES], m[VALUES] count what was made; m[WRITTEN], m[WRITTEN_VALUES] what is in `out`.
    Returns layout.OK, layout.MORE_SPACE, or what went wrong.
    """
    none = np.zeros(0, np.int64)
    waiting = layout.Text(pile.code, pile.parameter, none, none)
    arities, rules = t[layout.ARITY], how.inner
    height, top, level = 0, 0, 0
    while True:
        # Onto the pile, the first module at its top.
        n, q = m[layout.MODULES], m[layout.VALUES]
        if height + n > len(pile.code) or top + q > len(pile.parameter):
            m[layout.NEED] = layout.NEED_PILE
            return layout.MORE_SPACE
        for k in range(n - 1, -1, -1):
            arity = t[arities + made.code[k]]
            q -= arity
            for j in range(arity):
                pile.parameter[top + j] = made.parameter[q + j]
            top += arity
            pile.code[height], pile.depth[height] = made.code[k], level
            height += 1
        m[layout.MODULES], m[layout.VALUES] = 0, 0
        while height > 0:
            height -= 1
            kind = pile.code[height]
            arity = t[arities + kind]
            top -= arity
            rule = -1
            if t[rules + kind] < t[rules + kind + 1]:
                rule = _select(t, v, m, key, rules, how.group, height, top, height, height + 1, waiting)
                if rule < -1:
                    return -2 - rule
            if rule >= 0 and pile.depth[height] >= how.depth:
                if how.is_strict:
                    m[layout.FAULT] = t[rule + layout.SUCCESSOR]
                    return layout.TOO_DEEP
                rule = -1
            if rule >= 0:
                m[layout.EXPANSIONS] += 1
                if m[layout.EXPANSIONS] > layout.MOST_EXPANSIONS:
                    m[layout.FAULT] = t[rule + layout.SUCCESSOR]
                    return layout.TOO_DEEP
                wrong = run(t, v, m, key, t[rule + layout.SUCCESSOR], made.code, made.parameter)
                if wrong != layout.OK:
                    return wrong
                level = pile.depth[height] + 1
                break
            at, to = m[layout.WRITTEN], m[layout.WRITTEN_VALUES]
            if at >= len(out.code) or to + arity > len(out.parameter):
                return layout.MORE_SPACE
            out.code[at] = kind
            for j in range(arity):
                out.parameter[to + j] = pile.parameter[top + j]
            m[layout.WRITTEN], m[layout.WRITTEN_VALUES] = at + 1, to + arity
        if m[layout.MODULES] == 0 and height == 0:
            return layout.OK


@compiled
def rewrite(memory, key, how, text, words, made, pile, out, out_words):  # type: ignore[no-untyped-def]
    """One derivation step: rewrite all words by `how.rules`, and what comes out by `how.inner` down to a depth.

    m holds the next word, its first parameter, the numbers of modules, parameters and words written, and the next id;
    after MORE_SPACE the call can be repeated with larger `out`, `out_words` and `pile`, and goes on at that word.
    The tuples are those of `vm_layout`.
    """
    t, v, m = unowned_view(memory)
    text, words, made, pile = unowned_view(text), unowned_view(words), unowned_view(made), unowned_view(pile)
    out, out_words = unowned_view(out), unowned_view(out_words)
    codes, parameters = text.code, text.parameter
    out_code, out_parameter = out
    rules, inner = how.rules, how.inner
    arities = t[layout.ARITY]
    m[layout.NEED] = layout.NEED_OUT
    for w in range(m[layout.NEXT_WORD], len(words.id)):
        begin, end = np.int64(words.start[w]), np.int64(words.start[w + 1])  # one type of index: one compilation
        p = m[layout.NEXT_VALUE]
        written, values = m[layout.DONE], m[layout.DONE_VALUES]
        word_key = mix(key + SPLIT_MIX_STEP * np.uint64(words.id[w]))
        i = begin
        while i < end:
            kind = codes[i]
            rule = t[rules + kind] if rules >= 0 else -1
            has_rules = rules >= 0 and rule < t[rules + kind + 1]
            decomposes = inner >= 0 and t[inner + kind] < t[inner + kind + 1]
            if inner < 0 and has_rules and t[rule + layout.PLAIN] >= 0:
                # One symbol into symbols without parameters, whatever stands around it.
                n = t[rule + layout.PLAINS]
                if written + n > len(out_code):
                    return layout.MORE_SPACE
                for k in range(n):
                    out_code[written + k] = t[t[rule + layout.PLAIN] + k]
                written += n
                p += t[arities + kind]
                i += 1
                continue
            module_key = word_key
            m[layout.DRAWS] = 0
            if has_rules or decomposes:
                module_key = mix(word_key + SPLIT_MIX_STEP * np.uint64(i - begin + 1))
            rule = -1
            if has_rules:
                rule = _select(t, v, m, module_key, rules, how.group, i, p, begin, end, text)
                if rule < -1:
                    m[layout.FAULT_MODULE] = i
                    return -2 - rule
            if rule < 0 and not decomposes:
                n = t[arities + kind]
                if written >= len(out_code) or values + n > len(out_parameter):
                    return layout.MORE_SPACE
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
                made.code[0] = kind
                n = t[arities + kind]
                for k in range(n):
                    made.parameter[k] = parameters[p + k]
                m[layout.MODULES], m[layout.VALUES] = 1, n
            else:
                taken = t[rule + layout.HEADS]
                if inner >= 0:
                    m[layout.MODULES], m[layout.VALUES] = 0, 0
                    wrong = run(t, v, m, module_key, t[rule + layout.SUCCESSOR], made.code, made.parameter)
                else:
                    if (
                        written + t[rule + layout.MOST_MODULES] > len(out_code)
                        or values + t[rule + layout.MOST_VALUES] > len(out_parameter)
                    ):  # fmt: skip
                        return layout.MORE_SPACE
                    m[layout.MODULES], m[layout.VALUES] = written, values
                    wrong = run(t, v, m, module_key, t[rule + layout.SUCCESSOR], out_code, out_parameter)
                    written, values = m[layout.MODULES], m[layout.VALUES]
                if wrong != layout.OK:
                    m[layout.FAULT_MODULE] = i
                    return wrong
            if inner >= 0:
                m[layout.WRITTEN], m[layout.WRITTEN_VALUES] = written, values
                wrong = _decompose(t, v, m, module_key, how, made, pile, out)
                if wrong != layout.OK:
                    m[layout.FAULT_MODULE] = i
                    return wrong
                written, values = m[layout.WRITTEN], m[layout.WRITTEN_VALUES]
            for k in range(taken):
                p += t[arities + codes[i + k]]
            i += taken
        m[layout.WRITTEN], m[layout.WRITTEN_VALUES] = written, values
        old_kind = codes[begin] if end > begin else OPEN
        wrong = finish_word(t, m, how.percent, (old_kind, words.id[w], words.born[w]), how.step, out, out_words)
        if wrong != layout.OK:
            return wrong
        m[layout.NEXT_WORD], m[layout.NEXT_VALUE] = w + 1, p
    return layout.OK
