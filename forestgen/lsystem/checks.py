"""Checks of a program that do not depend on its run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

from forestgen.lsystem.codegen import fold
from forestgen.lsystem.syntax import Module, Name, Place, Production, ProgramAST, fail

#: The turtle gives these defaults: they may come with and without parameters.
TURTLE_SYMBOLS = frozenset([*"FfGg+-&^\\/|$!#';,_{}.~<>@%", "@v", "@Gs", "@Gc", "@Ge"])
QUERIES = ("?P", "?H", "?U", "?L")


def _fail(ast: ProgramAST, problem: str, place: Place, **about: str | None) -> NoReturn:
    fail(problem, ast.name, place, **about)


def check_heads(production: Production, ast: ProgramAST) -> None:
    """Predecessor and contexts: brackets, balanced, in the right context only; as parameters only names."""
    check_brackets(production.right, ast, percent_turns=False)
    for part, word in (("left context", production.left), ("predecessor", production.predecessor)):
        bracket = next((module for module in word if module.symbol in "[]"), None)
        if bracket is not None:
            problem, expected = f"a bracket stands in a {part}", "modules only: branches may stand in the right context"
            _fail(ast, problem, bracket.place, expected=expected, got=bracket.symbol)
    for module in (*production.left, *production.right, *production.predecessor):
        if module.symbol == "%" and ast.dialect != "rhover":
            _fail(ast, "% cuts or fragments, and cannot be rewritten", module.place)
        for argument in module.arguments:
            if not isinstance(argument, Name):
                expected = f"{module.symbol}(x), with a condition on x where one is needed"
                _fail(ast, "a parameter before the arrow must be a name", argument.place, expected=expected)


def check_brackets(modules: Sequence[Module], ast: ProgramAST, *, percent_turns: bool | None = None) -> None:
    """Brackets of a successor, a right context or an axiom's word are balanced, and take no parameters.

    In a successor or an axiom % may turn the turtle: in rhover's dialect.
    """
    turns = ast.dialect == "rhover" if percent_turns is None else percent_turns
    opened: list[Place] = []
    for module in modules:
        if module.symbol in "[]" and module.arguments:
            _fail(ast, "a bracket has no parameters", module.place)
        if module.symbol == "%" and module.arguments and not turns:
            _fail(ast, "% has no parameters", module.place)
        if module.symbol == "[":
            opened.append(module.place)
        elif module.symbol == "]":
            if not opened:
                _fail(ast, "unbalanced brackets: this ] has no [", module.place)
            opened.pop()
    if opened:
        _fail(ast, "unbalanced brackets: this [ has no ]", opened[-1])


def check_arities(ast: ProgramAST) -> None:
    """A symbol that productions know has a number of parameters that they know; any other has always the same."""
    productions = ast.all_productions
    known: dict[str, set[int]] = {}
    for production in productions:
        for module in production.predecessor:
            known.setdefault(module.symbol, set()).add(len(module.arguments))
    seen: dict[str, Module] = {}
    successors = [production.successor for production in productions]
    contexts = [part for production in productions for part in (production.left, production.right)]
    for module in (module for word in (*ast.axiom, *successors, *contexts) for module in word):
        symbol, arity = module.symbol, len(module.arguments)
        if symbol in QUERIES and arity not in (2, 3):
            _fail(ast, f"{symbol} takes 2 or 3 parameters", module.place, got=str(arity))
        if symbol in TURTLE_SYMBOLS or symbol in QUERIES:
            continue
        first = seen.setdefault(symbol, module)
        wanted = known.get(symbol, {len(first.arguments)})
        if arity not in wanted:
            source = "productions" if symbol in known else f"line {first.place.line}"
            expected = f"{' or '.join(map(str, sorted(wanted)))}, as in {source}"
            problem = f"{symbol} stands here with {arity or 'no'} parameter{'s' * (arity != 1)}"
            _fail(ast, problem, module.place, expected=expected, got=str(arity))


def check_probabilities(productions: Sequence[Production], ast: ProgramAST) -> None:
    """Known probabilities lie in [0, 1], and those of productions with one head and condition sum to at most 1."""
    sums: dict[tuple[object, ...], float] = {}
    for one in productions:
        if one.probability is None:
            continue
        parts = (one.left, one.predecessor, one.right)
        hidden = {
            argument.name for part in parts for m in part for argument in m.arguments if isinstance(argument, Name)
        }
        visible = {name: macro for name, macro in ast.macros.items() if name not in hidden}
        value, place = fold(one.probability, visible, ast.name), one.probability.place
        if value is None:
            continue
        if not 0 <= value <= 1:
            _fail(ast, "a probability must lie between 0 and 1", place, got=f"{value:g}")
        heads = tuple(tuple((m.symbol, len(m.arguments)) for m in part) for part in parts)
        key = (heads, one.condition, one.group)
        sums[key] = sums.get(key, 0.0) + value
        if sums[key] > 1 + 1e-9:
            problem = f"the probabilities of {one.predecessor[0].symbol} sum to more than 1"
            expected = "at most 1; what is missing leaves the module as it is"
            _fail(ast, problem, place, expected=expected, got=f"{sums[key]:g}")
