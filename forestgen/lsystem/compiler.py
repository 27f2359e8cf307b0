"""From a `ProgramAST` to a `Program`: checked, made into code, and laid out in the VM's two tables.

User-defined functions are curves by control points, as cpfg's function editor makes them: those of a clamped cubic
B-spline (of lower degree where there are fewer than four). The curve begins at the first, ends at the last, and its
value at x is where it crosses x. Outside, the end values hold.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import LsystemError
from forestgen.lsystem import vm_layout as layout
from forestgen.lsystem.checks import check_arities, check_brackets, check_heads, check_probabilities
from forestgen.lsystem.codegen import CodeGenerator, Region, Scope, assigned, fold
from forestgen.lsystem.multiset import CLOSE, OPEN, RESERVED
from forestgen.lsystem.program import Program, RuleSet
from forestgen.lsystem.syntax import (
    Expression,
    Macro,
    Module,
    Name,
    Number,
    Place,
    Production,
    ProgramAST,
    Statement,
    points_problem,
)

DEEPEST = 100_000  # decomposition, where the program states no maximum depth
_SAMPLES_A_SPAN = 64

#: What a caller may set: a #define's or an array's value, or a function's control points.
Value = float | Sequence[float] | Sequence[tuple[float, float]]


def with_values(ast: ProgramAST, values: Mapping[str, Value]) -> ProgramAST:
    """The program with other values of its #defines, arrays and functions.

    Raises `LsystemError` for a name that it does not define, or a value of the wrong sort.
    """
    macros, arrays, functions = dict(ast.macros), dict(ast.arrays), dict(ast.functions)
    for name, value in values.items():
        if name in macros and macros[name].parameters is None and isinstance(value, int | float):
            macros[name] = Macro(None, Number(float(value), macros[name].place), macros[name].place)
        elif name in arrays and _is_flat(value):
            arrays[name] = tuple(float(one) for one in value)  # type: ignore[union-attr,arg-type]
        elif name in functions and _is_points(value):
            points = tuple((float(x), float(y)) for x, y in value)  # type: ignore[union-attr,misc]
            problem = points_problem(points)
            if problem:
                raise LsystemError(f"function {name} is wrong", where=ast.name, expected=problem, got=repr(points))
            functions[name] = points
        else:
            sort = "a list of numbers" if name in arrays else "[x, y] points" if name in functions else "a number"
            known = name in macros or name in arrays or name in functions
            raise LsystemError(
                f"{name} cannot be set so" if known else f"the program defines no {name}",
                where=ast.name,
                expected=sort if known else ", ".join(settable(ast)) or "it defines nothing that can be set",
                got=repr(value) if known else name,
            )
    return replace(ast, macros=macros, arrays=arrays, functions=functions)


def _is_flat(value: Value) -> bool:
    return not isinstance(value, int | float) and all(isinstance(one, int | float) for one in value)


def _is_points(value: Value) -> bool:
    return not isinstance(value, int | float) and not any(isinstance(one, int | float) for one in value)


def settable(ast: ProgramAST) -> list[str]:
    """Names of the values that `with_values` can change."""
    plain = [name for name, macro in ast.macros.items() if macro.parameters is None]
    return [*plain, *ast.arrays, *ast.functions]


def compile_program(ast: ProgramAST) -> Program:
    """Check a program and compile it; raises `LsystemError`, with line and column, where it is wrong."""
    try:
        return _Compiler(ast).program()
    except RecursionError as error:
        raise LsystemError("an expression is too long or too deep", where=ast.name) from error


@dataclass(frozen=True)
class Rule:
    """A production: kinds, and where its code begins in the generated code (-1: it has none)."""

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


class _Compiler:
    def __init__(self, ast: ProgramAST) -> None:
        self.ast = ast
        blocks = (ast.start, ast.start_each, ast.end_each, ast.end)
        names = dict.fromkeys(name for block in blocks for statement in block for name in assigned(statement))
        self.e = CodeGenerator(ast.name, ast.macros, list(ast.arrays), list(ast.functions), ["", *names])
        self.e.groups |= {production.group for production in ast.productions}
        for kind in RESERVED:
            self.e.kind(*kind)

    def program(self) -> Program:
        one = self.ast
        for production in one.all_productions:
            check_heads(production, one)
            check_brackets(production.successor, one)
        for production in (*one.decomposition.productions, *one.interpretation.productions):
            if production.left or production.right or len(production.predecessor) > 1:
                problem = "a production of a block must be context-free"
                self.e.fail(problem, production.place, expected="one module before the arrow")
        for word in one.axiom:
            check_brackets(word, one)
        check_arities(one)
        groups = (one.productions, one.decomposition.productions, one.interpretation.productions)
        for rules in groups:
            check_probabilities(rules, one)
        axiom = [self.word(word) for word in one.axiom]
        sets = [[self.production(production) for production in rules] for rules in groups]
        blocks = [self.block(block) for block in (one.start, one.start_each, one.end_each)]
        self.block(one.end)  # nothing is left for it to change, but it must be right
        whole, real, packed, bases = _tables(self.e, one, sets, self.ignored())
        code_at = bases[Region.CODE]
        addresses = [begin if begin < 0 else code_at + 2 * begin for begin in (*axiom, *blocks)]
        every_rule = [rule for group in sets for rule in group]
        length = one.derivation_length
        return Program(
            ast=one,
            kinds=tuple(self.e.kinds),
            whole=whole,
            real=real,
            productions=packed[0],
            decomposition=packed[1],
            interpretation=packed[2],
            decomposition_depth=self.whole(one.decomposition.maximum_depth, DEEPEST, "maximum depth"),
            interpretation_depth=self.whole(one.interpretation.maximum_depth, 1, "maximum depth"),
            has_contexts=any(rule.left or rule.right for rule in sets[0]),
            longest_successor=(
                max([1, *(rule.most_modules for rule in every_rule)]),
                max([1, *(rule.most_values for rule in every_rule), *(kind.arity for kind in self.e.kinds)]),
            ),
            longest_context=max([1, *(max(len(rule.left), len(rule.right)) for rule in every_rule)]),
            axiom=tuple(addresses[: len(axiom)]),
            axiom_size=tuple((len(word), sum(len(m.arguments) for m in word)) for word in one.axiom),
            start=addresses[-3],
            start_each=addresses[-2],
            end_each=addresses[-1],
            globals_at=bases[Region.GLOBAL],
            globals=tuple(self.e.globals),
            groups=frozenset(self.e.groups),
            counted=tuple((slot, symbol) for symbol, slot in self.e.counted.items()),
            code_at=code_at,
            places=tuple(instruction.place for instruction in self.e.code),
            derivation_length=None if length is None else self.whole(length, 0, "derivation length"),
        )

    def word(self, modules: tuple[Module, ...]) -> int:
        scope = Scope(self.e)
        begin = scope.begin()
        scope.modules(modules)
        scope.returns(modules[-1].place if modules else Place(1, 1))
        return begin

    def block(self, statements: tuple[Statement, ...]) -> int:
        if not statements:
            return -1
        scope = Scope(self.e, is_global=True)
        begin = scope.begin()
        scope.statements(statements)
        scope.returns(statements[-1].place)
        return begin

    def production(self, one: Production) -> Rule:
        heads = (one.left, one.predecessor, one.right)
        left, predecessor, right = (
            tuple(self.e.kind(module.symbol, len(module.arguments)) for module in part) for part in heads
        )
        formals = [(a.name, a.place) for part in heads for m in part for a in m.arguments if isinstance(a, Name)]
        scope = Scope(self.e, formals)
        condition = -1
        if one.condition is not None or one.before:
            condition = scope.begin()
            scope.statements(one.before)
            scope.expression(one.condition or Number(1.0, one.place))
            scope.returns(one.place)
        probability = -1
        if one.probability is not None:
            probability = scope.begin()
            scope.expression(one.probability)
            scope.returns(one.probability.place)
        successor = scope.begin()
        scope.statements(one.after)
        scope.modules(one.successor)
        scope.returns(one.place)
        is_plain = (
            condition < 0 and probability < 0 and not left and not right and len(predecessor) == 1
            and one.group == 0 and not one.after and not any(module.arguments for module in one.successor)
        )  # fmt: skip
        return Rule(
            group=one.group,
            left=left,
            predecessor=predecessor,
            right=right,
            condition=condition,
            probability=probability,
            successor=successor,
            most_modules=len(one.successor),
            most_values=sum(len(module.arguments) for module in one.successor),
            plain=tuple(self.e.kind(module.symbol, 0) for module in one.successor) if is_plain else None,
        )

    def ignored(self) -> list[bool]:
        """For each kind, whether contexts see through it."""
        considered = self.ast.considered
        hidden = {module.symbol for module in self.ast.ignored}
        seen = None if considered is None else {module.symbol for module in considered}
        return [kind.symbol in hidden or (seen is not None and kind.symbol not in seen) for kind in self.e.kinds]

    def whole(self, expression: Expression | None, default: int, what: str) -> int:
        if expression is None:
            return default
        value = fold(expression, self.ast.macros, self.ast.name)
        if value is None or value != int(value) or not 0 <= value < 2**31:
            self.e.fail(f"{what} must be a whole number", expression.place, got=None if value is None else f"{value:g}")
        return int(value)


def _tables(
    code: CodeGenerator, ast: ProgramAST, sets: Sequence[Sequence[Rule]], ignored: Sequence[bool]
) -> tuple[NDArray[np.int64], NDArray[np.float64], tuple[RuleSet, ...], dict[Region, int]]:
    """Code, productions and values as vm_layout.py says, and where each region begins."""
    real, bases, stack, array_at, function_at = _reals(code, ast)
    whole = [0] * layout.HEADER
    arity = [kind.arity for kind in code.kinds]
    whole[layout.ARITY] = _append(whole, arity)
    whole[layout.IGNORED] = _append(whole, [int(one) for one in ignored])
    numbers = list(code.functions.values())
    by_number = dict(zip(numbers, function_at, strict=True))
    most = max(numbers, default=0)
    pairs = [by_number.get(number, (0, 0)) for number in range(1, most + 1)]  # no samples: there is no such function
    whole[layout.FUNCTION_AT] = _append(whole, [one for pair in pairs for one in pair])
    whole[layout.FUNCTIONS] = most
    whole[layout.STACK], whole[layout.LOCALS] = stack, bases[Region.LOCAL]
    whole[layout.SPARE], whole[layout.LOCAL_SIZE] = bases[Region.LOCAL] + code.local_size, code.local_size
    bases[Region.ARRAY] = _append(whole, [one for pair in array_at for one in pair])
    bases[Region.CODE] = code_at = len(whole)
    for one in code.code:
        size = 2 if one.region in (Region.CODE, Region.ARRAY) else 1
        whole += [one.operation, bases[one.region] + size * one.operand]
    packed = tuple(_pack_rules(whole, rules, code_at, arity) for rules in sets)
    return np.array(whole, dtype=np.int64), real, packed, bases


def _append(whole: list[int], values: Sequence[int]) -> int:
    """The address where the values begin."""
    whole += values
    return len(whole) - len(values)


def _reals(
    code: CodeGenerator, ast: ProgramAST
) -> tuple[NDArray[np.float64], dict[Region, int], int, list[tuple[int, int]], list[tuple[int, int]]]:
    """The table of real numbers; its regions, the stack, arrays (first, last) and functions (first, samples)."""
    constants, global_size = len(code.constants), len(code.globals)
    bases = {Region.NOTHING: 0, Region.CONSTANT: 0, Region.GLOBAL: constants, Region.LOCAL: constants + global_size}
    parts = [np.array(list(code.constants), dtype=np.float64), np.zeros(global_size + 2 * code.local_size)]
    at = constants + len(parts[-1])
    array_at, function_at = [], []
    for values in ast.arrays.values():
        parts.append(np.array(values, dtype=np.float64))
        array_at.append((at, at + len(values)))
        at += len(values)
    for points in ast.functions.values():
        x, y = _sampled(points)
        parts += [x, y]
        function_at.append((at, len(x)))
        at += 2 * len(x)
    parts.append(np.zeros(code.stack_size + 1))
    return np.concatenate(parts), bases, at, array_at, function_at


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
        begins = (rule.condition, rule.probability, rule.successor)
        code = [-1 if begin < 0 else code_at + 2 * begin for begin in begins]
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


def _sampled(points: Sequence[tuple[float, float]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The curve as a fine polyline: x ascending, and y."""
    control = np.array(points, dtype=np.float64)
    degree = min(3, len(control) - 1)
    if degree == 1:
        return control[:, 0].copy(), control[:, 1].copy()
    from scipy.interpolate import BSpline  # late: most programs have no functions

    spans = len(control) - degree
    knots = np.concatenate([np.zeros(degree), np.linspace(0, 1, spans + 1), np.ones(degree)])
    curve = BSpline(knots, control, degree)(np.linspace(0, 1, spans * _SAMPLES_A_SPAN + 1))
    return np.maximum.accumulate(curve[:, 0]), np.ascontiguousarray(curve[:, 1])
