"""From a `ProgramAST` to a `Program`: checked, made into code, and laid out in the VM's two tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import LsystemError
from forestgen.lsystem import syntax
from forestgen.lsystem import vm_layout as layout
from forestgen.lsystem.codegen import CodeGenerator, Scope, fold, formals
from forestgen.lsystem.multiset import CLOSE, OPEN, QUERIES, RESERVED, Kind
from forestgen.lsystem.syntax import FIRST, Place, fail, points_problem

#: The turtle gives these defaults: they may come with and without parameters.
TURTLE_SYMBOLS = frozenset([*"FfGg+-&^\\/|$!#';,_{}.~<>@%", "@v", "@Gs", "@Gc", "@Ge"])
DEEPEST = 100_000  # decomposition, where the program states no maximum depth

#: What a caller may set: a #define's or an array's value, or a function's control points.
Value = float | Sequence[float] | Sequence[tuple[float, float]]


@dataclass(frozen=True)
class RuleSet:
    """A set of productions: where the VM finds it, and how much it writes."""

    address: int  # in the table of whole numbers: for each kind, where its productions begin; -1: there are none
    most_modules: NDArray[np.int64]  # (number of kinds,) written for a module of a kind, at most
    most_values: NDArray[np.int64]  # (number of kinds,) parameters of these


@dataclass(frozen=True)
class Program:
    """An L-system, ready to run."""

    ast: syntax.ProgramAST
    kinds: tuple[Kind, ...]
    whole: NDArray[np.int64]  # code, productions, arities: see vm.py
    real: NDArray[np.float64]  # constants, global and local variables, arrays, functions, stack
    productions: RuleSet
    decomposition: RuleSet
    interpretation: RuleSet
    none: RuleSet  # without productions
    decomposition_depth: int
    interpretation_depth: int
    has_contexts: bool
    longest_successor: tuple[int, int]  # modules and parameters
    longest_context: int
    axiom: tuple[int, ...]  # where each word's code begins
    start: int  # where code begins that runs before the derivation; -1: none
    start_each: int  # before each step
    end_each: int  # after each step
    globals_at: NDArray[np.int64]  # (number of globals,) addresses in `real`
    globals: tuple[str, ...]  # names; the first is the current group
    groups: frozenset[int]
    counted: tuple[tuple[int, str], ...]  # globals that hold the number of modules of a symbol
    places: dict[int, Place]  # in the text, of each instruction by its address in `whole`
    derivation_length: int | None

    @property
    def name(self) -> str:
        return self.ast.name


def with_values(ast: syntax.ProgramAST, values: Mapping[str, Value]) -> syntax.ProgramAST:
    """The program with other values of its #defines, arrays and functions.

    Raises `LsystemError` for a name that it does not define, or a value of the wrong sort.
    """
    macros, arrays, functions = dict(ast.macros), dict(ast.arrays), dict(ast.functions)
    value: Any  # checked here
    for name, value in values.items():
        is_number = isinstance(value, int | float)
        numbers = 0 if is_number else sum(isinstance(one, int | float) for one in value)
        if name in macros and macros[name].parameters is None and is_number:
            macros[name] = syntax.Macro(None, syntax.Number(float(value), macros[name].place), macros[name].place)
        elif name in arrays and not is_number and numbers == len(value):
            arrays[name] = tuple(float(one) for one in value)
        elif name in functions and not is_number and not numbers:
            points = tuple((float(x), float(y)) for x, y in value)
            problem = points_problem(points)
            if problem:
                raise LsystemError(f"function {name} is wrong", where=ast.name, expected=problem, got=repr(points))
            functions[name] = points
        elif name in macros or name in arrays or name in functions:
            sort = "a list of numbers" if name in arrays else "[x, y] points" if name in functions else "a number"
            raise LsystemError(f"{name} cannot be set so", where=ast.name, expected=sort, got=repr(value))
        else:
            known = ", ".join(settable(ast)) or "it defines nothing that can be set"
            raise LsystemError(f"the program defines no {name}", where=ast.name, expected=known, got=name)
    return replace(ast, macros=macros, arrays=arrays, functions=functions)


def settable(ast: syntax.ProgramAST) -> list[str]:
    """Names of the values that `with_values` can change."""
    plain = [name for name, macro in ast.macros.items() if macro.parameters is None]
    return [*plain, *ast.arrays, *ast.functions]


def compile_program(ast: syntax.ProgramAST) -> Program:
    """Check a program and compile it; raises `LsystemError`, with line and column, where it is wrong."""
    try:
        return _Compiler(ast).program()
    except RecursionError as error:
        raise LsystemError("an expression is too long or too deep", where=ast.name) from error


class _Compiler:
    def __init__(self, ast: syntax.ProgramAST) -> None:
        self.ast, self.e = ast, CodeGenerator(ast)
        for kind in RESERVED:
            self.e.kind(*kind)

    def program(self) -> Program:
        one, code = self.ast, self.e
        self.check()
        axiom = tuple(self.code(word) for word in one.axiom)
        sets = (one.productions, one.decomposition.productions, one.interpretation.productions)
        records = [[self.production(production) for production in rules] for rules in sets]
        blocks = (one.start, one.start_each, one.end_each, one.end)  # the last has nothing to change, but must be right
        start, start_each, end_each, _ = (self.code(block=block) if block else -1 for block in blocks)
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
            _check_heads(production, one)
            _check_brackets(production.successor, one)
        for production in (*one.decomposition.productions, *one.interpretation.productions):
            if production.left or production.right or len(production.predecessor) > 1:
                problem = "a production of a block must be context-free"
                self.e.fail(problem, production.place, expected="one module before the arrow")
        for word in one.axiom:
            _check_brackets(word, one)
        _check_arities(one)
        for rules in (one.productions, one.decomposition.productions, one.interpretation.productions):
            _check_probabilities(rules, one)

    def code(self, word: Sequence[syntax.Module] = (), block: Sequence[syntax.Statement] = ()) -> int:
        """The address of code that emits a word's modules, or runs a block's statements."""
        scope = Scope(self.e, is_global=bool(block))
        begin = scope.begin()
        scope.statements(block)
        scope.modules(word)
        scope.returns([FIRST, *(one.place for one in (*word, *block))][-1])
        return begin

    def production(self, one: syntax.Production) -> list[int]:
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
            scope.expression(one.condition or syntax.Number(1.0, one.place))
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

    def number(self, expression: syntax.Expression | None, default: int, what: str) -> int:
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


def _check_heads(production: syntax.Production, ast: syntax.ProgramAST) -> None:
    """Predecessor and contexts: brackets, balanced, in the right context only; as parameters only names."""
    _check_brackets(production.right, ast, percent_turns=False)
    for part, word in (("left context", production.left), ("predecessor", production.predecessor)):
        bracket = next((module for module in word if module.symbol in "[]"), None)
        if bracket is not None:
            problem, expected = f"a bracket stands in a {part}", "modules only: branches may stand in the right context"
            fail(problem, ast.name, bracket.place, expected=expected, got=bracket.symbol)
    for module in (*production.left, *production.right, *production.predecessor):
        if module.symbol == "%" and ast.dialect != "rhover":
            fail("% cuts or fragments, and cannot be rewritten", ast.name, module.place)
        for argument in module.arguments:
            if not isinstance(argument, syntax.Name):
                expected = f"{module.symbol}(x), with a condition on x where one is needed"
                fail("a parameter before the arrow must be a name", ast.name, argument.place, expected=expected)


def _check_brackets(
    modules: Sequence[syntax.Module], ast: syntax.ProgramAST, *, percent_turns: bool | None = None
) -> None:
    """Brackets of a successor, a right context or an axiom's word are balanced, and take no parameters.

    In a successor or an axiom % may turn the turtle: in rhover's dialect.
    """
    turns = ast.dialect == "rhover" if percent_turns is None else percent_turns
    opened: list[Place] = []
    for module in modules:
        if module.symbol in "[]" and module.arguments:
            fail("a bracket has no parameters", ast.name, module.place)
        if module.symbol == "%" and module.arguments and not turns:
            fail("% has no parameters", ast.name, module.place)
        if module.symbol == "[":
            opened.append(module.place)
        elif module.symbol == "]":
            if not opened:
                fail("unbalanced brackets: this ] has no [", ast.name, module.place)
            opened.pop()
    if opened:
        fail("unbalanced brackets: this [ has no ]", ast.name, opened[-1])


def _check_arities(ast: syntax.ProgramAST) -> None:
    """A symbol that productions know has a number of parameters that they know; any other has always the same."""
    productions = ast.all_productions
    known: dict[str, set[int]] = {}
    for production in productions:
        for module in production.predecessor:
            known.setdefault(module.symbol, set()).add(len(module.arguments))
    seen: dict[str, syntax.Module] = {}
    successors = [production.successor for production in productions]
    contexts = [part for production in productions for part in (production.left, production.right)]
    for module in (module for word in (*ast.axiom, *successors, *contexts) for module in word):
        symbol, arity = module.symbol, len(module.arguments)
        if symbol in QUERIES and arity not in (2, 3):
            fail(f"{symbol} takes 2 or 3 parameters", ast.name, module.place, got=str(arity))
        if symbol in TURTLE_SYMBOLS or symbol in QUERIES:
            continue
        first = seen.setdefault(symbol, module)
        wanted = known.get(symbol, {len(first.arguments)})
        if arity not in wanted:
            source = "productions" if symbol in known else f"line {first.place.line}"
            expected = f"{' or '.join(map(str, sorted(wanted)))}, as in {source}"
            problem = f"{symbol} stands here with {arity or 'no'} parameter{'s' * (arity != 1)}"
            fail(problem, ast.name, module.place, expected=expected, got=str(arity))


def _check_probabilities(productions: Sequence[syntax.Production], ast: syntax.ProgramAST) -> None:
    """Known probabilities lie in [0, 1], and those of productions with one head and condition sum to at most 1."""
    sums: dict[tuple[object, ...], float] = {}
    for one in productions:
        if one.probability is None:
            continue
        parts = (one.left, one.predecessor, one.right)
        hidden = {name for name, _ in formals(one)}
        visible = {name: macro for name, macro in ast.macros.items() if name not in hidden}
        value, place = fold(one.probability, visible, ast.name), one.probability.place
        if value is None:
            continue
        if not 0 <= value <= 1:
            fail("a probability must lie between 0 and 1", ast.name, place, got=f"{value:g}")
        heads = tuple(tuple((m.symbol, len(m.arguments)) for m in part) for part in parts)
        key = (heads, one.condition, one.group)
        sums[key] = sums.get(key, 0.0) + value
        if sums[key] > 1 + 1e-9:
            problem = f"the probabilities of {one.predecessor[0].symbol} sum to more than 1"
            expected = "at most 1; what is missing leaves the module as it is"
            fail(problem, ast.name, place, expected=expected, got=f"{sums[key]:g}")
