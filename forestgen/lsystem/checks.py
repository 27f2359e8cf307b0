"""What is wrong in a program whatever happens when it runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NoReturn

from forestgen.core.errors import LsystemError
from forestgen.lsystem.codegen import fold
from forestgen.lsystem.syntax import Macro, Module, Name, Place, Production, ProgramAST

#: The turtle gives these defaults: they may come with and without parameters.
TURTLE_SYMBOLS = frozenset([*"FfGg+-&^\\/|$!#';,_{}.~<>@%", "@v", "@Gs", "@Gc", "@Ge"])
QUERIES = ("?P", "?H", "?U", "?L")


def _fail(name: str, problem: str, place: Place, **about: str | None) -> NoReturn:
    raise LsystemError(problem, where=f"{name}:{place.line}:{place.column}", **about)


def check_heads(production: Production, ast: ProgramAST) -> None:
    """Predecessor and contexts: brackets, balanced, in the right context only; as parameters only names."""
    check_brackets(production.right, ast.name)
    for part, word in (("left context", production.left), ("predecessor", production.predecessor)):
        bracket = next((module for module in word if module.symbol in "[]"), None)
        if bracket is not None:
            _fail(
                ast.name,
                f"a bracket stands in a {part}",
                bracket.place,
                expected="modules only: branches may stand in the right context",
                got=bracket.symbol,
            )
    for module in (*production.left, *production.right, *production.predecessor):
        if module.symbol == "%" and ast.dialect != "rhover":
            _fail(ast.name, "% cuts or fragments, and cannot be rewritten", module.place)
        for argument in module.arguments:
            if not isinstance(argument, Name):
                _fail(
                    ast.name,
                    "a parameter before the arrow must be a name",
                    argument.place,
                    expected=f"{module.symbol}(x), with a condition on x where one is needed",
                )


def check_brackets(modules: Sequence[Module], name: str, *, percent_turns: bool = False) -> None:
    """Brackets of a successor, a right context or an axiom's word are balanced, and take no parameters."""
    opened: list[Place] = []
    for module in modules:
        if module.symbol in "[]" and module.arguments:
            _fail(name, "a bracket has no parameters", module.place)
        if module.symbol == "%" and module.arguments and not percent_turns:
            _fail(name, "% has no parameters", module.place)
        if module.symbol == "[":
            opened.append(module.place)
        elif module.symbol == "]":
            if not opened:
                _fail(name, "unbalanced brackets: this ] has no [", module.place)
            opened.pop()
    if opened:
        _fail(name, "unbalanced brackets: this [ has no ]", opened[-1])


def _rewritten(ast: ProgramAST) -> Iterator[Production]:
    yield from ast.productions
    yield from ast.decomposition.productions
    yield from ast.interpretation.productions


def check_arities(ast: ProgramAST) -> None:
    """A symbol that productions know has a number of parameters that they know; any other has always the same."""
    known: dict[str, set[int]] = {}
    for production in _rewritten(ast):
        for module in production.predecessor:
            known.setdefault(module.symbol, set()).add(len(module.arguments))
    seen: dict[str, Module] = {}
    words = [*ast.axiom, *(production.successor for production in _rewritten(ast))]
    heads = [part for production in _rewritten(ast) for part in (production.left, production.right)]
    for word in (*words, *heads):
        for module in word:
            symbol, arity = module.symbol, len(module.arguments)
            if symbol in QUERIES and arity not in (2, 3):
                _fail(ast.name, f"{symbol} takes 2 or 3 parameters", module.place, got=str(arity))
            if symbol in TURTLE_SYMBOLS or symbol in QUERIES:
                continue
            first = seen.setdefault(symbol, module)
            if arity not in known.get(symbol, {len(first.arguments)}):
                wanted = sorted(known.get(symbol, {len(first.arguments)}))
                source = "productions" if symbol in known else f"line {first.place.line}"
                _fail(
                    ast.name,
                    f"{symbol} stands here with {_parameters(arity)}",
                    module.place,
                    expected=f"{' or '.join(map(str, wanted))}, as in {source}",
                    got=str(arity),
                )


def _parameters(count: int) -> str:
    return f"{count or 'no'} parameter{'s' * (count != 1)}"


def _visible(production: Production, ast: ProgramAST) -> dict[str, Macro]:
    """The #defines that no parameter or variable of a production hides."""
    heads = (*production.left, *production.predecessor, *production.right)
    hidden = {argument.name for module in heads for argument in module.arguments if isinstance(argument, Name)}
    return {name: macro for name, macro in ast.macros.items() if name not in hidden}


def check_probabilities(productions: Sequence[Production], ast: ProgramAST) -> None:
    """Known probabilities lie in [0, 1], and those of productions with one head and condition sum to at most 1."""
    sums: dict[tuple[object, ...], float] = {}
    for one in productions:
        if one.probability is None:
            continue
        value = fold(one.probability, _visible(one, ast), ast.name)
        if value is None:
            continue
        place = one.probability.place
        if not 0 <= value <= 1:
            _fail(ast.name, "a probability must lie between 0 and 1", place, got=f"{value:g}")
        heads = tuple(
            tuple((m.symbol, len(m.arguments)) for m in part) for part in (one.left, one.predecessor, one.right)
        )
        key = (heads, one.condition, one.group)
        sums[key] = sums.get(key, 0.0) + value
        if sums[key] > 1 + 1e-9:
            _fail(
                ast.name,
                f"the probabilities of {one.predecessor[0].symbol} sum to more than 1",
                place,
                expected="at most 1; what is missing leaves the module as it is",
                got=f"{sums[key]:g}",
            )
