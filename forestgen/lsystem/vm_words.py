"""Compiled loops over words: their brackets and contexts, what % does to them, the list of words."""

from __future__ import annotations

import numpy as np

from forestgen.core.compiled import compiled
from forestgen.lsystem import vm_layout as layout
from forestgen.lsystem.multiset import CLOSE, OPEN, PERCENT


@compiled
def pair_brackets(codes, mate):  # type: ignore[no-untyped-def]
    """Set mate[i] of each bracket to the index of its partner."""
    opened = np.empty(len(codes), np.int64)
    depth = 0
    for i in range(len(codes)):
        if codes[i] == OPEN:
            opened[depth] = i
            depth += 1
        elif codes[i] == CLOSE:
            depth -= 1
            mate[i] = opened[depth]
            mate[opened[depth]] = i


@compiled
def left_context(t, m, rule, i, begin, text):  # type: ignore[no-untyped-def]
    """Whether the left context stands before module i; m[FOUND] on gets the modules' indices, in reading order."""
    codes, mate = text.code, text.mate
    cursor = i - 1
    for k in range(t[rule + layout.LEFTS] - 1, -1, -1):
        while True:
            if cursor < begin:
                return False
            if codes[cursor] == CLOSE:
                cursor = mate[cursor] - 1  # past a branch
            elif codes[cursor] == OPEN or t[t[layout.IGNORED] + codes[cursor]]:
                cursor -= 1  # down to what bears this branch
            else:
                break
        if codes[cursor] != t[t[rule + layout.LEFT] + k]:
            return False
        m[layout.FOUND + k] = cursor
        cursor -= 1
    return True


@compiled
def right_context(t, m, rule, i, end, text):  # type: ignore[no-untyped-def]
    """Whether the right context stands from index i on; m[FOUND] as in `left_context`, with brackets.

    A branch of the context takes the first branch of the word that fits it. Where one does not fit, the search goes on
    at the next branch of the same node: the first fit leaves most for what follows, so no other need be tried.
    """
    codes, mate = text.code, text.mate
    cursor, k, n = i, 0, t[rule + layout.RIGHTS]
    right = t[rule + layout.RIGHT]
    enclosing = right + n
    while k < n:
        wanted = t[right + k]
        if wanted == CLOSE:
            cursor = mate[m[layout.FOUND + t[enclosing + k]]]  # past what else the branch holds
        else:
            while cursor < end and codes[cursor] != CLOSE:
                if codes[cursor] == OPEN:
                    if wanted == OPEN:
                        break
                    cursor = mate[cursor] + 1
                elif t[t[layout.IGNORED] + codes[cursor]]:
                    cursor += 1
                else:
                    break
            if cursor >= end or codes[cursor] != wanted:
                k = t[enclosing + k]
                if k < 0:
                    return False
                cursor = mate[m[layout.FOUND + k]] + 1
                continue
        m[layout.FOUND + k] = cursor
        k += 1
        cursor += 1
    return True


@compiled
def take(t, v, m, n, text, slot):  # type: ignore[no-untyped-def]
    """Copy the parameters of n found modules to local variables from `slot` on; the next free one."""
    for k in range(n):
        module = m[layout.FOUND + k]
        first = text.start[module]
        for j in range(t[t[layout.ARITY] + text.code[module]]):
            v[slot] = text.parameter[first + j]
            slot += 1
    return slot


@compiled
def _cut(m, codes, parameters, t):  # type: ignore[no-untyped-def]
    """Remove every % of the word just written and the rest of its branch, in place."""
    out, q, skipping, depth = m[layout.DONE], m[layout.DONE_VALUES], False, 0
    at = q
    for i in range(m[layout.DONE], m[layout.WRITTEN]):
        n = t[t[layout.ARITY] + codes[i]]
        keep = not skipping
        if skipping:
            if codes[i] == OPEN:
                depth += 1
            elif codes[i] == CLOSE:
                if depth == 0:
                    skipping, keep = False, True
                else:
                    depth -= 1
        elif codes[i] == PERCENT:
            skipping, keep, depth = True, False, 0
        if keep:
            codes[out] = codes[i]
            for k in range(n):
                parameters[q + k] = parameters[at + k]
            out += 1
            q += n
        at += n
    m[layout.WRITTEN], m[layout.WRITTEN_VALUES] = out, q


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
        if c == PERCENT:
            current = pieces
            pieces += 1
            piece[i] = -1
        elif c == CLOSE:
            depth -= 1
            current = outer[depth]
            piece[i] = current
        else:
            piece[i] = current
            if c == OPEN:
                outer[depth] = current
                depth += 1
    modules = np.zeros(pieces + 1, np.int64)
    values = np.zeros(pieces + 1, np.int64)
    for i in range(n):
        if piece[i] >= 0:
            modules[piece[i] + 1] += 1
            values[piece[i] + 1] += t[t[layout.ARITY] + codes[begin + i]]
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
        for _ in range(t[t[layout.ARITY] + old_code[i]]):
            parameters[p + values[k]] = old_parameter[at]
            values[k] += 1
            at += 1
    return ends


@compiled
def finish_word(t, m, percent, old, now, out, words):  # type: ignore[no-untyped-def]
    """Cut or fragment the word that was written, and enter what is left of it into the list of words.

    `old` is what it was: its first kind, id and step of birth.
    """
    begin, end, p = m[layout.DONE], m[layout.WRITTEN], m[layout.DONE_VALUES]
    count = 0
    if percent != 0:
        for i in range(begin, end):
            if out.code[i] == PERCENT:
                count += 1
    if m[layout.WORDS] + count + 1 > len(words.id):
        m[layout.NEED] = layout.NEED_WORDS
        return layout.MORE_SPACE
    if count > 0 and percent == layout.FRAGMENT:
        ends = _fragment(out.code, out.parameter, t, begin, end, p)
        first = begin
        for k in range(len(ends)):
            _enter(m, first, begin + ends[k], k, old, now, out.code, words)
            first = begin + ends[k]
        end = first
    else:
        if count > 0:
            _cut(m, out.code, out.parameter, t)
            end = m[layout.WRITTEN]
        _enter(m, begin, end, 0, old, now, out.code, words)
    m[layout.DONE], m[layout.DONE_VALUES] = end, m[layout.WRITTEN_VALUES]
    return layout.OK


@compiled
def _enter(m, begin, end, piece, old, now, codes, words):  # type: ignore[no-untyped-def]
    """Enter one word; an empty one is gone. A word keeps its id while it begins with the same kind."""
    if end <= begin:
        return
    k = m[layout.WORDS]
    words.start[k], words.start[k + 1] = begin, end
    old_kind, word_id, born = old
    if piece == 0 and codes[begin] == old_kind:
        words.id[k], words.born[k] = word_id, born
    else:
        words.id[k], words.born[k] = m[layout.NEXT_ID], now
        m[layout.NEXT_ID] += 1
    m[layout.WORDS] = k + 1
