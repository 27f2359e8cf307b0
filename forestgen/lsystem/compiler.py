"""From a `Listing` to a `Program`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NoReturn

from forestgen.core.errors import LsystemError
from forestgen.lsystem.checks import check_arities, check_brackets, check_heads, check_probabilities
from forestgen.lsystem.emitter import Emitter, Scope, assigned
from forestgen.lsystem.folding import fold
from forestgen.lsystem.functions import points_problem
from forestgen.lsystem.multiset import RESERVED
from forestgen.lsystem.packing import Rule, pack
from forestgen.lsystem.program import Program
from forestgen.lsystem.syntax import Expression, Listing, Macro, Module, Name, Number, Place, Production, Statement

DEEPEST = 100_000  # decomposition, where the program states no maximum depth

#: What a caller may set: a #define's or an array's value, or a function's control points.
Value = float | Sequence[float] | Sequence[tuple[float, float]]


def with_values(listing: Listing, values: Mapping[str, Value]) -> Listing:
    """The listing with other values of its #defines, arrays and functions.

    Raises
    ------
    LsystemError : a name that the program does not define, or a value of the wrong sort.
    """
    macros, arrays, functions = dict(listing.macros), dict(listing.arrays), dict(listing.functions)
    for name, value in values.items():
        if name in macros and macros[name].parameters is None and isinstance(value, int | float):
            macros[name] = Macro(None, Number(float(value), macros[name].place), macros[name].place)
        elif name in arrays and _is_flat(value):
            arrays[name] = tuple(float(one) for one in value)  # type: ignore[union-attr,arg-type]
        elif name in functions and _is_points(value):
            points = tuple((float(x), float(y)) for x, y in value)  # type: ignore[union-attr,misc]
            problem = points_problem(points)
            if problem:
                raise LsystemError(f"function {name} is wrong", where=listing.name, expected=problem, got=repr(points))
            functions[name] = points
        else:
            sort = "a list of numbers" if name in arrays else "[x, y] points" if name in functions else "a number"
            known = name in macros or name in arrays or name in functions
            raise LsystemError(
                f"{name} cannot be set so" if known else f"the program defines no {name}",
                where=listing.name,
                expected=sort if known else ", ".join(settable(listing)) or "it defines nothing that can be set",
                got=repr(value) if known else name,
            )
    return replace(listing, macros=macros, arrays=arrays, functions=functions)


def _is_flat(value: Value) -> bool:
    return not isinstance(value, int | float) and all(isinstance(one, int | float) for one in value)


def _is_points(value: Value) -> bool:
    return not isinstance(value, int | float) and not any(isinstance(one, int | float) for one in value)


def settable(listing: Listing) -> list[str]:
    """Names of the values that `with_values` can change."""
    plain = [name for name, macro in listing.macros.items() if macro.parameters is None]
    return [*plain, *listing.arrays, *listing.functions]


def compile_listing(listing: Listing) -> Program:
    """Check a listing and make it a program.

    Raises
    ------
    LsystemError : it is wrong; with line and column.
    """
    try:
        return _Compiler(listing).program()
    except RecursionError as error:
        raise LsystemError("an expression is too long or too deep", where=listing.name) from error


class _Compiler:
    def __init__(self, listing: Listing) -> None:
        self.listing = listing
        blocks = (listing.start, listing.start_each, listing.end_each, listing.end)
        names = dict.fromkeys(name for block in blocks for statement in block for name in assigned(statement))
        self.e = Emitter(listing.name, listing.macros, list(listing.arrays), list(listing.functions), ["", *names])
        self.e.groups |= {production.group for production in listing.productions}
        for kind in RESERVED:
            self.e.kind(*kind)

    def fail(self, problem: str, place: Place, **about: str | None) -> NoReturn:
        self.e.fail(problem, place, **about)

    def program(self) -> Program:
        one = self.listing
        every = (*one.productions, *one.decomposition.productions, *one.interpretation.productions)
        for production in every:
            check_heads(production, one)
            check_brackets(production.successor, one.name, percent_turns=one.dialect == "rhover")
        for block in (one.decomposition, one.interpretation):
            self.refuse_contexts(block.productions)
        for word in one.axiom:
            check_brackets(word, one.name, percent_turns=one.dialect == "rhover")
        check_arities(one)
        for rules in (one.productions, one.decomposition.productions, one.interpretation.productions):
            check_probabilities(rules, one)
        axiom = [self.word(word) for word in one.axiom]
        sets = [
            [self.production(production) for production in rules]
            for rules in (one.productions, one.decomposition.productions, one.interpretation.productions)
        ]
        blocks = [self.block(block) for block in (one.start, one.start_each, one.end_each)]
        self.block(one.end)  # nothing is left for it to change, but it must be right
        packed = pack(self.e, sets, self.ignored(), list(one.arrays.values()), list(one.functions.values()))
        addresses = [packed.code_address(begin) for begin in (*axiom, *blocks)]
        every_rule = [rule for group in sets for rule in group]
        return Program(
            listing=one,
            kinds=tuple(self.e.kinds),
            whole=packed.whole,
            real=packed.real,
            productions=packed.sets[0],
            decomposition=packed.sets[1],
            interpretation=packed.sets[2],
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
            globals_at=packed.globals_at,
            globals=tuple(self.e.globals),
            groups=frozenset(self.e.groups),
            counted=tuple((slot, symbol) for symbol, slot in self.e.counted.items()),
            code_at=packed.code_address(0),
            places=tuple(instruction.place for instruction in self.e.code),
            derivation_length=self.length(),
        )

    def refuse_contexts(self, productions: Sequence[Production]) -> None:
        for one in productions:
            if one.left or one.right or len(one.predecessor) > 1:
                self.fail(
                    "a production of a block must be context-free", one.place, expected="one module before the arrow"
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
        considered = self.listing.considered
        hidden = {module.symbol for module in self.listing.ignored}
        seen = None if considered is None else {module.symbol for module in considered}
        return [kind.symbol in hidden or (seen is not None and kind.symbol not in seen) for kind in self.e.kinds]

    def whole(self, expression: Expression | None, default: int, what: str) -> int:
        if expression is None:
            return default
        value = fold(expression, self.listing.macros, self.listing.name)
        if value is None or value != int(value) or not 0 <= value < 2**31:
            self.fail(f"{what} must be a whole number", expression.place, got=None if value is None else f"{value:g}")
        return int(value)

    def length(self) -> int | None:
        given = self.listing.derivation_length
        return None if given is None else self.whole(given, 0, "derivation length")
