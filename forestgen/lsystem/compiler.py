"""From a `ProgramAST` to a `Program`: checked, made into code, and laid out in the VM's two tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from forestgen.core.errors import LsystemError
from forestgen.lsystem import vm_layout as layout
from forestgen.lsystem.checks import check_arities, check_brackets, check_heads, check_probabilities
from forestgen.lsystem.codegen import CodeGenerator, Scope, fold, formals
from forestgen.lsystem.multiset import CLOSE, OPEN, RESERVED
from forestgen.lsystem.program import Program, RuleSet
from forestgen.lsystem.syntax import (
    FIRST,
    Expression,
    Macro,
    Module,
    Number,
    Production,
    ProgramAST,
    Statement,
    points_problem,
)

DEEPEST = 100_000  # decomposition, where the program states no maximum depth

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


class _Compiler:
    def __init__(self, ast: ProgramAST) -> None:
        self.ast, self.e = ast, CodeGenerator(ast)
        for kind in RESERVED:
            self.e.kind(*kind)

    def program(self) -> Program:
        one, code = self.ast, self.e
        self.check()
        axiom = tuple(self.word(word) for word in one.axiom)
        sets = (one.productions, one.decomposition.productions, one.interpretation.productions)
        records = [[self.production(production) for production in rules] for rules in sets]
        start, start_each, end_each = (self.block(block) for block in (one.start, one.start_each, one.end_each))
        self.block(one.end)  # nothing is left for it to change, but it must be right
        arity = [kind.arity for kind in code.kinds]
        code.whole[layout.ARITY], code.whole[layout.IGNORED] = code.append(arity), code.append(self.ignored())
        code.whole[layout.STACK] = code.append_reals([0.0] * (code.stack_size + 1))
        productions, decomposition, interpretation = (_rule_set(code, rules, arity) for rules in records)
        every_record, length = [record for rules in records for record in rules], one.derivation_length

        def most(*columns: int) -> int:
            return max([1, *(record[column] for record in every_record for column in columns)])

        return Program(
            ast=one,
            kinds=tuple(code.kinds),
            whole=np.array(code.whole, dtype=np.int64),
            real=np.array(code.real, dtype=np.float64),
            productions=productions,
            decomposition=decomposition,
            interpretation=interpretation,
            none=_rule_set(code, (), arity),
            decomposition_depth=self.number(one.decomposition.maximum_depth, DEEPEST, "maximum depth"),
            interpretation_depth=self.number(one.interpretation.maximum_depth, 1, "maximum depth"),
            has_contexts=any(record[layout.LEFTS] or record[layout.RIGHTS] for record in records[0]),
            longest_successor=(most(layout.MOST_MODULES), max(most(layout.MOST_VALUES), *arity)),
            longest_context=most(layout.LEFTS, layout.RIGHTS),
            axiom=axiom,
            axiom_size=tuple((len(word), sum(len(m.arguments) for m in word)) for word in one.axiom),
            start=start,
            start_each=start_each,
            end_each=end_each,
            globals_at=np.array(list(code.globals.values()), dtype=np.int64),
            globals=tuple(code.globals),
            groups=frozenset(code.groups),
            counted=tuple(code.counted),
            places=code.places,
            derivation_length=None if length is None else self.number(length, 0, "derivation length"),
        )

    def check(self) -> None:
        """What is wrong with productions and words as a whole."""
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
        for rules in (one.productions, one.decomposition.productions, one.interpretation.productions):
            check_probabilities(rules, one)

    def word(self, modules: tuple[Module, ...]) -> int:
        scope = Scope(self.e)
        begin = scope.begin()
        scope.modules(modules)
        scope.returns(modules[-1].place if modules else FIRST)
        return begin

    def block(self, statements: tuple[Statement, ...]) -> int:
        if not statements:
            return -1
        scope = Scope(self.e, is_global=True)
        begin = scope.begin()
        scope.statements(statements)
        scope.returns(statements[-1].place)
        return begin

    def production(self, one: Production) -> list[int]:
        """Its record, as vm_layout.py says; its code and its lists of kinds are laid out."""
        left, head, right = (
            [self.e.kind(module.symbol, len(module.arguments)) for module in part]
            for part in (one.left, one.predecessor, one.right)
        )
        scope = Scope(self.e, formals(one))
        condition = probability = -1
        if one.condition is not None or one.before:
            condition = scope.begin()
            scope.statements(one.before)
            scope.expression(one.condition or Number(1.0, one.place))
            scope.returns(one.place)
        if one.probability is not None:
            probability = scope.begin()
            scope.expression(one.probability)
            scope.returns(one.probability.place)
        successor = scope.begin()
        scope.statements(one.after)
        scope.modules(one.successor)
        scope.returns(one.place)
        arguments = sum(len(module.arguments) for module in one.successor)
        is_plain = condition < 0 and probability < 0 and not (left or right or one.group or one.after or arguments)
        plain = [self.e.kind(one.symbol, 0) for one in one.successor] if is_plain and len(head) == 1 else None
        add = self.e.append
        return [
            one.group, condition, probability, successor, add(left), len(left), add(head), len(head),
            add(_with_branches(right)), len(right), len(one.successor), arguments,
            -1 if plain is None else add(plain), len(plain or ()),
        ]  # fmt: skip

    def ignored(self) -> list[int]:
        """For each kind, whether contexts see through it."""
        considered = self.ast.considered
        hidden = {module.symbol for module in self.ast.ignored}
        seen = None if considered is None else {module.symbol for module in considered}
        return [kind.symbol in hidden or (seen is not None and kind.symbol not in seen) for kind in self.e.kinds]

    def number(self, expression: Expression | None, default: int, what: str) -> int:
        if expression is None:
            return default
        value = fold(expression, self.ast.macros, self.ast.name)
        if value is None or value != int(value) or not 0 <= value < 2**31:
            self.e.fail(f"{what} must be a whole number", expression.place, got=None if value is None else f"{value:g}")
        return int(value)


def _rule_set(code: CodeGenerator, records: Sequence[list[int]], arity: Sequence[int]) -> RuleSet:
    """Lay out records of productions, sorted by the first kind of their predecessors and else in their own order."""
    modules, values = np.ones(len(arity), np.int64), np.array(arity, dtype=np.int64)
    heads = [code.whole[one[layout.HEAD] : one[layout.HEAD] + one[layout.HEADS]] for one in records]
    for record, (kind, *rest) in zip(records, heads, strict=True):  # the rest have their own share
        modules[kind] = max(modules[kind], record[layout.MOST_MODULES] - len(rest))
        values[kind] = max(values[kind], record[layout.MOST_VALUES] - sum(arity[one] for one in rest))
    if not records:
        return RuleSet(-1, modules, values)
    kinds = np.array([kind for kind, *_ in heads])
    begin = len(code.whole)
    for index in np.argsort(kinds, kind="stable"):
        code.append(records[index])
    counts = np.bincount(kinds, minlength=len(arity))
    first = begin + layout.RECORD * np.concatenate([[0], np.cumsum(counts)])
    return RuleSet(code.append(first.tolist()), modules, values)


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
