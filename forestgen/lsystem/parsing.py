"""From text to a `Listing`: the grammar of single statements is in grammar.lark, read by Lark (LALR)."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any, NoReturn

from lark import Lark, Token, Tree
from lark.exceptions import UnexpectedCharacters, UnexpectedEOF, UnexpectedToken

from forestgen.core.errors import LsystemError
from forestgen.lsystem.source import Statement, read_program, statements
from forestgen.lsystem.syntax import (
    Assign,
    Binary,
    Block,
    Call,
    Expression,
    If,
    Index,
    Listing,
    Macro,
    Module,
    Name,
    Number,
    Place,
    Production,
    Unary,
    UseGroup,
)
from forestgen.lsystem.syntax import Statement as Instruction

DIALECTS = ("cpfg", "abop")
_STARTS = ["production", "words", "word", "expression", "statements", "arrays", "points"]
_PLAIN = {
    "LPAR": "(", "RPAR": ")", "LBRACE": "{", "RBRACE": "}", "LSQUARE": "[", "RSQUARE": "]", "COMMA": ",", "COLON": ":",
    "ARROW": "-->", "BECOMES": "=", "SEMICOLON": ";", "NAME": "a name", "NUMBER": "a number", "SYMBOL": "a module",
    "STAR": "*", "$END": "the end of the statement", "LESS": "<", "GREATER": ">",
}  # fmt: skip
_OPERATORS = {
    "OR", "AND", "EQUAL", "UNEQUAL", "LESS_EQUAL", "GREATER_EQUAL", "PLUS", "MINUS", "SLASH", "PERCENT", "CARET", "NOT",
}  # fmt: skip
_DEEPEST = 200  # parentheses and operators within one another


@lru_cache(maxsize=1)
def _lark() -> Lark:
    grammar = files("forestgen.lsystem").joinpath("grammar.lark").read_text(encoding="utf-8")
    return Lark(grammar, parser="lalr", start=_STARTS, maybe_placeholders=True)


class _Reader:
    """Turns Lark's trees of one statement into syntax; knows where the statement lies in the file."""

    def __init__(self, name: str, origin: Place) -> None:
        self.name, self.origin = name, origin

    def place(self, line: int, column: int) -> Place:
        """Place in the file of a place in the statement."""
        return Place(self.origin.line + line - 1, column + (self.origin.column - 1 if line == 1 else 0))

    def at(self, token: Token) -> Place:
        return self.place(token.line or 1, token.column or 1)

    def fail(self, problem: str, place: Place, **about: str | None) -> NoReturn:
        raise LsystemError(problem, where=f"{self.name}:{place.line}:{place.column}", **about)

    def parse(self, text: str, start: str) -> Any:
        _refuse_deep(self, text)
        try:
            return _lark().parse(text, start=start)
        except UnexpectedCharacters as error:
            got = repr(text[error.pos_in_stream or 0])
            self._unexpected(self.place(error.line, error.column), error.allowed, got, text)
        except UnexpectedEOF as error:
            lines = text.split("\n")
            self._unexpected(self.place(len(lines), len(lines[-1]) + 1), error.expected, "the end", text)
        except UnexpectedToken as error:
            at_end = error.token.type == "$END"
            lines = text.rstrip().split("\n")
            place = self.place(len(lines), len(lines[-1]) + 1) if at_end else self.at(error.token)
            got = "the end of the statement" if at_end else repr(str(error.token))
            self._unexpected(place, error.accepts or error.expected, got, text)

    def _unexpected(self, place: Place, expected: Any, got: str, text: str) -> NoReturn:
        names = set(expected or ())
        shown = [_PLAIN[one] for one in _PLAIN if one in names]
        if names & _OPERATORS:
            shown.append("an operator")
        hint = None
        if "-->" not in text and re.search(r"->|→", text):
            hint = "the arrow of a production is -->"
        elif got.strip("'\"") == "=":
            hint = "equality is =="
        self.fail("this is not understood", place, expected=", ".join(shown) or None, got=got, hint=hint)

    def modules(self, tree: Tree[Token] | None) -> tuple[Module, ...]:
        return () if tree is None else tuple(self.module(one) for one in tree.children if isinstance(one, Tree))

    def module(self, tree: Tree[Token]) -> Module:
        symbol, arguments = tree.children[0], tree.children[2]
        assert isinstance(symbol, Token)
        given = arguments.children if isinstance(arguments, Tree) else ()
        return Module(str(symbol), self.expressions(given), self.at(symbol))

    def expressions(self, children: Any) -> tuple[Expression, ...]:
        return tuple(self.expression(one) for one in children if isinstance(one, Tree))

    def expression(self, tree: Any) -> Expression:
        kind, children = tree.data, tree.children
        if kind == "group":
            return self.expression(children[1])
        if kind == "binary":
            left, operator, right = children
            return Binary(str(operator), self.expression(left), self.expression(right), self.at(operator))
        if kind == "unary":
            operand = self.expression(children[1])
            return operand if children[0] == "+" else Unary(str(children[0]), operand, self.at(children[0]))
        first = children[0]
        place = self.at(first)
        if kind == "number":
            return Number(float(first), place)
        if kind == "call":
            given = children[2].children if children[2] is not None else ()
            return Call(str(first), self.expressions(given), place)
        if kind == "index":
            return Index(str(first), self.expression(children[2]), place)
        return Name(str(first), place)

    def instructions(self, trees: Any) -> tuple[Instruction, ...]:
        found = (self.instruction(tree) for tree in trees if isinstance(tree, Tree) and tree.data != "nothing")
        return tuple(found)

    def instruction(self, tree: Tree[Token]) -> Instruction:
        children: Any = tree.children
        place = self.at(children[0])
        if tree.data == "assignment":
            return Assign(str(children[0]), self.expression(children[2]), place)
        if tree.data == "use_group":
            return UseGroup(self.expression(children[2]), place)
        otherwise = children[6] if len(children) > 6 else None
        return If(self.expression(children[2]), self.branch(children[4]), self.branch(otherwise), place)

    def branch(self, tree: Any) -> tuple[Instruction, ...]:
        if tree is None:
            return ()
        inner = tree.children[0]
        return self.instructions(inner.children if inner.data == "block" else [inner])

    def production(self, text: str, group: int) -> Production:
        tree = self.parse(text, "production")
        left, _, pred, _, right, condition, _, successor, _, probability = tree.children
        before, test, after = self.condition(condition)
        return Production(
            left=self.modules(left.children[0]) if left and isinstance(left.children[0], Tree) else (),
            predecessor=self.modules(pred),
            right=self.modules(right.children[0]) if right and isinstance(right.children[0], Tree) else (),
            before=before,
            condition=test,
            after=after,
            successor=self.modules(successor.children[0]) if _is_tree(successor) else (),
            probability=None if probability is None else self.expression(probability),
            place=self.module(pred.children[0]).place,
            group=group,
        )

    def condition(self, tree: Any) -> tuple[tuple[Instruction, ...], Expression | None, tuple[Instruction, ...]]:
        if tree is None:
            return (), None, ()
        before: tuple[Instruction, ...] = ()
        after: tuple[Instruction, ...] = ()
        test = None
        seen_test = False
        for child in tree.children:
            if not isinstance(child, Tree):
                continue
            if child.data == "test":
                seen_test = True
                test = self.expression(child.children[0]) if isinstance(child.children[0], Tree) else None
            elif seen_test:
                after = self.instructions(child.children)
            else:
                before = self.instructions(child.children)
        return before, test, after


def _is_tree(tree: Any) -> bool:
    return bool(tree.children) and isinstance(tree.children[0], Tree)


def _refuse_deep(reader: _Reader, text: str) -> None:
    depth = 0
    for position, character in enumerate(text):
        depth += (character == "(") - (character == ")")
        if depth > _DEEPEST:
            line = text.count("\n", 0, position) + 1
            place = reader.place(line, position - text.rfind("\n", 0, position))
            reader.fail("parentheses lie too deep within one another", place, expected=f"at most {_DEEPEST}")


def parse_word(text: str, name: str) -> tuple[Module, ...]:
    """A string of modules, such as ``A(2)[B(0.5)]``."""
    reader = _Reader(name, Place(1, 1))
    tree = reader.parse(text, "word")
    return reader.modules(tree.children[0]) if _is_tree(tree) else ()


def parse_file(path: Path) -> Listing:
    """The program in a file; see `parse_text`."""
    return parse_text(read_program(path), str(path))


def parse_text(text: str, name: str) -> Listing:
    """The program in a text; `name` stands in messages.

    Raises
    ------
    LsystemError : the text is not understood; with line and column.
    """
    builder = _Builder(name)
    try:
        for statement in statements(text, name):
            builder.take(statement)
    except RecursionError as error:
        raise LsystemError("an expression is too long or too deep", where=name) from error
    return builder.finish(text)


class _Builder:
    """Collects statements into a listing."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.listing = Listing(name)
        self.group = 0
        self.block = "productions"
        self.productions: dict[str, list[Production]] = {"productions": [], "decomposition": [], "interpretation": []}
        self.depths: dict[str, Expression] = {}
        self.places: dict[str, Place] = {}
        self.seen: dict[str, Place] = {}

    def take(self, statement: Statement) -> None:
        reader = _Reader(self.name, statement.place)
        keyword = statement.keyword
        if not keyword:
            self.take_production(reader, statement.text)
            return
        if keyword in _ONCE:
            if keyword in self.seen:
                earlier = self.seen[keyword]
                reader.fail(f"a second {keyword!r}", statement.start, expected=f"only the one in line {earlier.line}")
            self.seen[keyword] = statement.start
        first = keyword.split()[0]
        handler: Callable[[_Reader, Statement], None] | None = _HANDLERS.get(first)
        if handler is None:
            reader.fail(
                f"{keyword} is not supported", statement.start, hint="only #define is known of the preprocessor"
            )
        handler(self, reader, statement)  # type: ignore[call-arg,arg-type]

    def take_production(self, reader: _Reader, text: str) -> None:
        if "-->" not in text:
            reader._unexpected(reader.origin, (), "a statement without an arrow", text) if re.search(
                r"->|→", text
            ) else reader.fail(
                "this is neither a production nor a known statement",
                reader.origin,
                expected="predecessor --> successor, or axiom:, derivation length:, ignore:, ...",
                got=text.strip().split("\n")[0][:60],
            )
        self.productions[self.block].append(reader.production(text, self.group if self.block == "productions" else 0))

    def update(self, **changes: Any) -> None:
        self.listing = replace(self.listing, **changes)

    def header(self, reader: _Reader, statement: Statement) -> None:
        """`lsystem: name` and `production:` say nothing that matters."""

    def dialect(self, reader: _Reader, statement: Statement) -> None:
        word = statement.text.strip().lower()
        if word not in DIALECTS:
            reader.fail("an unknown dialect", statement.start, expected=" or ".join(DIALECTS), got=word or "nothing")
        self.update(dialect=word)

    def length(self, reader: _Reader, statement: Statement) -> None:
        self.update(derivation_length=reader.expression(reader.parse(statement.text, "expression")))

    def axiom(self, reader: _Reader, statement: Statement) -> None:
        text = statement.text
        bare = text.strip()
        if bare.startswith("{"):
            if not bare.endswith("}"):
                before = text[: text.index("{")]
                place = reader.place(before.count("\n") + 1, len(before) - before.rfind("\n"))
                reader.fail("the set of words has no end", place, expected="}", got=bare.split("\n")[-1][-20:])
            opened, closed = text.index("{"), text.rindex("}")
            text = text[:opened] + " " + text[opened + 1 : closed]
            tree = reader.parse(text, "words")
            words = tuple(reader.modules(one.children[0]) for one in tree.children if _is_word(one))
            self.update(axiom=tuple(one for one in words if one), is_multiset=True)
            return
        tree = reader.parse(text, "word")
        self.update(axiom=(reader.modules(tree.children[0]),) if _is_tree(tree) else ())

    def consider(self, reader: _Reader, statement: Statement) -> None:
        found = self.symbols(reader, statement)
        self.update(**({"considered": found} if statement.keyword == "consider" else {"ignored": found}))

    def symbols(self, reader: _Reader, statement: Statement) -> tuple[Module, ...]:
        tree = reader.parse(statement.text, "word")
        return reader.modules(tree.children[0]) if _is_tree(tree) else ()

    def group_begins(self, reader: _Reader, statement: Statement) -> None:
        self.group = int(statement.keyword.split()[1])
        if self.block != "productions":
            reader.fail(f"a group within the block {self.block}", statement.start, expected="groups before all blocks")
        if statement.text.strip():
            self.take_production(reader, statement.text)

    def group_ends(self, reader: _Reader, statement: Statement) -> None:
        if self.group == 0:
            reader.fail("endgroup without a group", statement.start, expected="group 1: before it")
        self.group = 0

    def block_begins(self, reader: _Reader, statement: Statement) -> None:
        self.block = "interpretation" if statement.keyword == "homomorphism" else statement.keyword
        self.places[self.block] = statement.start
        self.group = 0

    def depth(self, reader: _Reader, statement: Statement) -> None:
        if self.block == "productions":
            reader.fail(
                "maximum depth belongs to a block", statement.start, expected="decomposition or interpretation above it"
            )
        self.depths[self.block] = reader.expression(reader.parse(statement.text, "expression"))

    def instructions(self, reader: _Reader, statement: Statement) -> None:
        text, bare = statement.text, statement.text.strip()
        if not (bare.startswith("{") and bare.endswith("}")):
            reader.fail(
                f"{statement.keyword} needs a block", reader.origin, expected="{ ... }", got=bare[:40] or "nothing"
            )
        opened, closed = text.index("{"), text.rindex("}")
        inner = text[:opened] + " " + text[opened + 1 : closed]
        if statement.keyword == "define":
            self.arrays(reader, inner)
            return
        found = reader.instructions(reader.parse(inner, "statements").children)
        key = {"start": "start", "starteach": "start_each", "endeach": "end_each"}.get(statement.keyword)
        if key:  # `end:` runs after the derivation, when nothing is left to be changed
            self.update(**{key: found})

    def arrays(self, reader: _Reader, text: str) -> None:
        known = dict(self.listing.arrays)
        for tree in reader.parse(text, "arrays").children:
            _, name, _, size, _, _, _, numbers, *_ = tree.children
            values = tuple(_signed(one) for one in numbers.children if isinstance(one, Tree)) if numbers else ()
            if size is not None and float(size) != len(values):
                place = reader.at(size)
                reader.fail(
                    f"array {name} is declared with another size", place, expected=str(len(values)), got=str(size)
                )
            self.declare(reader, str(name), reader.at(name))
            known[str(name)] = values
        self.update(arrays=known)

    def declare(self, reader: _Reader, name: str, place: Place) -> None:
        if name in self.seen:
            reader.fail(f"{name} is defined twice", place, got=f"the first in line {self.seen[name].line}")
        self.seen[name] = place

    def function(self, reader: _Reader, statement: Statement) -> None:
        name = statement.keyword.split()[1]
        raw = re.match(r"(?i)function\s+(\w+)", statement.keyword)
        assert raw is not None
        self.declare(reader, f"function {name}", statement.start)
        tree = reader.parse(statement.text, "points")
        points: list[tuple[float, float]] = []
        for point in tree.children:
            x, y = (_signed(one) for one in point.children if isinstance(one, Tree))
            if points and x < points[-1][0]:
                token = next(point.scan_values(lambda one: isinstance(one, Token)))
                reader.fail("a function's control points must ascend in x", reader.at(token), got=f"{x:g}")
            points.append((x, y))
        if len(points) < 2 or points[0][0] == points[-1][0]:
            reader.fail(f"function {name} needs two points of different x", statement.place)
        self.update(functions={**self.listing.functions, name: tuple(points)})

    def turtle(self, reader: _Reader, statement: Statement) -> None:
        name = statement.keyword.replace("color", "colour")
        try:
            numbers = tuple(float(one) for one in statement.text.split())
        except ValueError:
            reader.fail(f"{name} needs numbers", statement.place, got=statement.text.strip())
        if name in self.listing.turtle:
            reader.fail(f"a second {name!r}", statement.start)
        self.update(turtle={**self.listing.turtle, name: numbers})

    def define(self, reader: _Reader, statement: Statement) -> None:
        head = re.match(r"\s*([A-Za-z_]\w*)(\(([^()]*)\))?", statement.text)
        if head is None:
            reader.fail(
                "#define needs a name", statement.place, expected="#define NAME value", got=statement.text.strip()
            )
        name, _, given = head.groups()
        rest = statement.text[head.end() :]
        if not rest.strip():
            reader.fail(f"#define {name} has no value", statement.place, expected=f"#define {name} 1.5")
        self.declare(reader, name, Place(statement.place.line, statement.place.column + head.start(1)))
        padded = " " * head.end() + rest
        body = reader.expression(reader.parse(padded, "expression"))
        parameters = None if given is None else tuple(one.strip() for one in given.split(",") if one.strip())
        self.update(macros={**self.listing.macros, name: Macro(parameters, body, self.seen[name])})

    def finish(self, text: str) -> Listing:
        if "axiom" not in self.seen:
            raise LsystemError(
                "the program has no axiom", where=f"{self.name}:1:1", expected="axiom: and a string of modules"
            )
        blocks = {
            name: Block(tuple(self.productions[name]), self.depths.get(name), self.places.get(name, Place(1, 1)))
            for name in ("decomposition", "interpretation")
        }
        return replace(self.listing, productions=tuple(self.productions["productions"]), **blocks)  # type: ignore[arg-type]


def _is_word(tree: Any) -> bool:
    return isinstance(tree, Tree) and _is_tree(tree)


def _signed(tree: Tree[Token]) -> float:
    sign, number = tree.children
    return -float(str(number)) if sign == "-" else float(str(number))


_ONCE = {
    "lsystem",
    "dialect",
    "derivation length",
    "axiom",
    "consider",
    "ignore",
    "start",
    "starteach",
    "endeach",
    "end",
}
_HANDLERS: dict[str, Any] = {
    "lsystem": _Builder.header,
    "seed": _Builder.header,
    "production": _Builder.header,
    "productions": _Builder.header,
    "dialect": _Builder.dialect,
    "derivation": _Builder.length,
    "axiom": _Builder.axiom,
    "consider": _Builder.consider,
    "ignore": _Builder.consider,
    "group": _Builder.group_begins,
    "endgroup": _Builder.group_ends,
    "decomposition": _Builder.block_begins,
    "interpretation": _Builder.block_begins,
    "homomorphism": _Builder.block_begins,
    "maximum": _Builder.depth,
    "start": _Builder.instructions,
    "starteach": _Builder.instructions,
    "endeach": _Builder.instructions,
    "end": _Builder.instructions,
    "define": _Builder.instructions,
    **dict.fromkeys(
        ("angle", "step", "scale", "width", "tip", "tropism", "elasticity", "heading", "colour", "color"),
        _Builder.turtle,
    ),
    "function": _Builder.function,
    "#define": _Builder.define,
}
