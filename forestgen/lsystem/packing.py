"""Gives everything of a program its address in the machine's two tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.lsystem import machine_layout as layout
from forestgen.lsystem.emitter import Emitter, Region
from forestgen.lsystem.functions import sample_function
from forestgen.lsystem.multiset import CLOSE, OPEN
from forestgen.lsystem.program import RuleSet


@dataclass(frozen=True)
class Rule:
    """A production: kinds, and where its code begins in the emitter (-1: it has none)."""

    group: int
    left: tuple[int, ...]
    predecessor: tuple[int, ...]
    right: tuple[int, ...]  # with the brackets of its branches
    condition: int
    probability: int
    successor: int
    most_modules: int
    most_values: int
    plain: tuple[int, ...] | None  # the successor's kinds where it always applies and has no parameters


@dataclass(frozen=True)
class Packed:
    """The two tables, and addresses in them."""

    whole: NDArray[np.int64]
    real: NDArray[np.float64]
    sets: tuple[RuleSet, ...]
    globals_at: int
    code_at: int

    def code_address(self, index: int) -> int:
        return index if index < 0 else self.code_at + 2 * index


def pack(
    emitter: Emitter,
    sets: Sequence[Sequence[Rule]],
    ignored: Sequence[bool],
    arrays: Sequence[Sequence[float]],
    functions: Sequence[Sequence[tuple[float, float]]],
) -> Packed:
    """Lay out code, productions and values as machine_layout.py says."""
    real, bases, array_at, function_at = _reals(emitter, arrays, functions)
    whole = [0] * layout.HEADER
    arity = [kind.arity for kind in emitter.kinds]
    whole[layout.ARITY] = _append(whole, arity)
    whole[layout.IGNORED] = _append(whole, [int(one) for one in ignored])
    numbers = list(emitter.functions.values())
    by_number = dict(zip(numbers, function_at, strict=True))
    most = max(numbers, default=0)
    pairs = [by_number.get(number, (0, 0)) for number in range(1, most + 1)]  # no samples: there is no such function
    whole[layout.FUNCTION_AT] = _append(whole, [one for pair in pairs for one in pair])
    whole[layout.FUNCTIONS] = most
    whole[layout.STACK], whole[layout.LOCALS] = bases["stack"], bases["locals"]
    whole[layout.SPARE], whole[layout.LOCAL_SIZE] = bases["spare"], emitter.local_size
    bases["arrays"] = _append(whole, [one for pair in array_at for one in pair])
    code_at = len(whole)
    for one in emitter.code:
        whole += [one.operation, _address(one.operand, one.region, bases, code_at)]
    packed = tuple(_pack_rules(whole, rules, code_at, arity) for rules in sets)
    return Packed(np.array(whole, dtype=np.int64), real, packed, bases["globals"], code_at)


def _append(whole: list[int], values: Sequence[int]) -> int:
    """The address where the values begin."""
    whole += values
    return len(whole) - len(values)


def _reals(
    emitter: Emitter, arrays: Sequence[Sequence[float]], functions: Sequence[Sequence[tuple[float, float]]]
) -> tuple[NDArray[np.float64], dict[str, int], list[tuple[int, int]], list[tuple[int, int]]]:
    """The table of real numbers; its regions, arrays (first, last) and functions (first, samples)."""
    parts = [np.array(list(emitter.constants), dtype=np.float64)]
    at = len(emitter.constants)
    bases = {"constants": 0, "globals": at, "locals": at + len(emitter.globals)}
    bases["spare"] = bases["locals"] + emitter.local_size
    parts.append(np.zeros(len(emitter.globals) + 2 * emitter.local_size))
    at += len(parts[-1])
    array_at, function_at = [], []
    for values in arrays:
        parts.append(np.array(values, dtype=np.float64))
        array_at.append((at, at + len(values)))
        at += len(values)
    for points in functions:
        x, y = sample_function(points)
        parts += [x, y]
        function_at.append((at, len(x)))
        at += 2 * len(x)
    bases["stack"] = at
    parts.append(np.zeros(emitter.stack_size + 1))
    return np.concatenate(parts), bases, array_at, function_at


def _address(operand: int, region: Region, bases: dict[str, int], code_at: int) -> int:
    if region is Region.CODE:
        return code_at + 2 * operand
    if region is Region.ARRAY:
        return bases["arrays"] + 2 * operand
    base = {Region.CONSTANT: "constants", Region.GLOBAL: "globals", Region.LOCAL: "locals"}.get(region)
    return operand if base is None else bases[base] + operand


def _pack_rules(whole: list[int], rules: Sequence[Rule], code_at: int, arity: Sequence[int]) -> RuleSet:
    """Records of the productions, sorted by the first kind of their predecessors and else in their own order."""
    modules, values = np.ones(len(arity), np.int64), np.array(arity, dtype=np.int64)
    for rule in rules:
        kind = rule.predecessor[0]
        # The other modules of the predecessor have their own share.
        rest = rule.predecessor[1:]
        modules[kind] = max(modules[kind], rule.most_modules - len(rest))
        values[kind] = max(values[kind], rule.most_values - sum(arity[one] for one in rest))
    if not rules:
        return RuleSet(-1, modules, values)
    ordered = sorted(rules, key=lambda rule: rule.predecessor[0])  # stable
    lists = [
        [_append(whole, kinds) for kinds in (rule.left, rule.predecessor, _with_branches(rule.right), rule.plain or ())]
        for rule in ordered
    ]
    records = len(whole)
    for rule, (left, head, right, plain) in zip(ordered, lists, strict=True):
        code = [
            -1 if begin < 0 else code_at + 2 * begin for begin in (rule.condition, rule.probability, rule.successor)
        ]
        whole += [
            rule.group, *code, left, len(rule.left), head, len(rule.predecessor), right, len(rule.right),
            rule.most_modules, rule.most_values, -1 if rule.plain is None else plain, len(rule.plain or ()),
        ]  # fmt: skip
    counts = np.bincount([rule.predecessor[0] for rule in ordered], minlength=len(arity))
    first = records + layout.RECORD * np.concatenate([[0], np.cumsum(counts)])
    return RuleSet(_append(whole, first.tolist()), modules, values)


def _with_branches(right: Sequence[int]) -> list[int]:
    """The kinds of a right context and, behind them, the index of the ``[`` around each; -1: there is none.

    A ``]`` has the index of its own ``[``.
    """
    enclosing: list[int] = []
    opened = [-1]
    for k, kind in enumerate(right):
        enclosing.append(opened[-1])
        if kind == OPEN:
            opened.append(k)
        elif kind == CLOSE:
            opened.pop()
    return [*right, *enclosing]
