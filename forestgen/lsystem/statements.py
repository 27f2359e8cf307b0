"""From a file to statements, and from the text of one statement to syntax, by grammar.lark, which Lark reads (LALR).

A statement begins on its own line and goes on in lines that are indented deeper, in lines within open parentheses or
braces, and after a backslash at a line's end. Comments are ``/* ... */`` and lines that begin with ``//`` (elsewhere
``//`` is the turtle rolling twice).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any, NoReturn

from lark import Lark, Token, Tree
from lark.exceptions import UnexpectedCharacters, UnexpectedEOF, UnexpectedToken

from forestgen.core.arguments import read_text
from forestgen.core.errors import LsystemError
from forestgen.lsystem.syntax import (
    Assign,
    Binary,
    Call,
    Expression,
    If,
    Index,
    Module,
    Name,
    Number,
    Place,
    Production,
    Unary,
    UseGroup,
)
from forestgen.lsystem.syntax import Statement as Instruction

LARGEST_PROGRAM_BYTES = 8_000_000
_STARTS = ["production", "words", "word", "string", "expression", "statements", "arrays", "points"]
_PLAIN = {
    "LPAR": "(", "RPAR": ")", "LBRACE": "{", "RBRACE": "}", "LSQUARE": "[", "RSQUARE": "]", "COMMA": ",", "COLON": ":",
    "ARROW": "-->", "BECOMES": "=", "SEMICOLON": ";", "NAME": "a name", "NUMBER": "a number", "SYMBOL": "a module",
    "STAR": "*", "$END": "the end of the statement", "LESS": "<", "GREATER": ">",
}  # fmt: skip
_OPERATORS = {
    "OR", "AND", "EQUAL", "UNEQUAL", "LESS_EQUAL", "GREATER_EQUAL", "PLUS", "MINUS", "SLASH", "PERCENT", "CARET", "NOT",
}  # fmt: skip
_DEEPEST = 200  # parentheses and operators within one another

_KEYWORDS = re.compile(
    r"""(?ix) \#\s*define\b | \#\s*(?:include|undef|ifdef|ifndef|if|else|endif)\b
    | (?: lsystem | dialect | derivation\s+length | axiom | consider | ignore | maximum\s+depth | group\s+\d+
        | start | starteach | endeach | end | define | productions? | seed ) \s* :
    | (?: angle | step | scale | width (?: \s+ (?: increment | factor ) )? | tip\s+width | tropism
        | elasticity (?: \s+ increment )? | heading | colou?r ) \s* :
    | function\s+\w+\s*:
    | (?: endgroup | endlsystem | decomposition | interpretation | homomorphism ) \b \s* :?
    """
)


@dataclass(frozen=True)
class Statement:
    """A keyword, its text and the place where that begins; a production has the keyword ''."""

    keyword: str  # lower case, one space between words, no colon
    text: str
    place: Place  # of the text
    start: Place  # of the statement


def read_program(path: Path) -> str:
    """The text of a program's file; raises `AssetError` or `LsystemError` where it cannot be read or is no text."""
    return read_text(path, "an L-system program", most_bytes=LARGEST_PROGRAM_BYTES, error=LsystemError)


def statements(text: str, name: str) -> Iterator[Statement]:
    """The statements of a program up to `endlsystem`; `name` is the file's, for messages."""
    for start, raw in _logical_lines(_without_comments(text, name)):
        match = _KEYWORDS.match(raw)
        if match is None:
            yield Statement("", raw, start, start)
            continue
        keyword = " ".join(match.group().rstrip(": \t").lower().replace("#", "# ").split()).replace("# ", "#")
        if keyword == "endlsystem":
            return
        if keyword.startswith("function "):  # its name keeps its capitals
            keyword = "function " + match.group().rstrip(": \t").split()[1]
        yield Statement(keyword, raw[match.end() :], Place(start.line, start.column + match.end()), start)


def _without_comments(text: str, name: str) -> str:
    """The same text with spaces for comments and for backslashes at a line's end that mean: go on."""

    def blank(match: re.Match[str]) -> str:
        return re.sub(r"[^\n]", " ", match.group())

    text = text.replace("\r\n", "\n").replace("\r", "\n")
    text = re.sub(r"(?m)^[ \t]*//.*$", blank, text)
    text = re.sub(r"/\*.*?\*/", blank, text, flags=re.DOTALL)
    opened = text.find("/*")
    if opened >= 0 and "*/" not in text[opened:]:
        line = text.count("\n", 0, opened) + 1
        column = opened - text.rfind("\n", 0, opened)
        raise LsystemError("a comment has no end", where=f"{name}:{line}:{column}", expected="*/", got="the file's end")
    return text


def _logical_lines(text: str) -> Iterator[tuple[Place, str]]:
    """Statements with their places; a continued line keeps its newline, so that places can be counted."""
    current: _Open | None = None
    for number, line in enumerate(text.split("\n"), 1):
        stripped = line.strip()
        if current is not None and (current.forced or current.goes_on(line)):
            current.take(line)
            continue
        if current is not None and stripped:
            yield current.start, "\n".join(current.lines).rstrip()
            current = None
        if stripped:
            indent = len(line) - len(line.lstrip())
            current = _Open(Place(number, indent + 1), indent, is_keyword=bool(_KEYWORDS.match(stripped)))
            current.take(line[indent:])
    if current is not None:
        yield current.start, "\n".join(current.lines).rstrip()


@dataclass
class _Open:
    """A statement that may go on in the next line."""

    start: Place
    indent: int
    is_keyword: bool
    lines: list[str] = field(default_factory=list)
    parentheses: int = 0  # open ones, before the arrow
    braces: int = 0
    has_arrow: bool = False
    has_colon: bool = False
    forced: bool = False  # the last line ended with a backslash

    def take(self, line: str) -> None:
        bare = line.rstrip()
        self.forced = bare.endswith("\\")
        line = bare[:-1] if self.forced else line
        self.lines.append(line)
        if not self.has_arrow:
            head, arrow, _ = line.partition("-->")
            self.parentheses += head.count("(") - head.count(")")
            self.braces += head.count("{") - head.count("}")
            self.has_colon = self.has_colon or ":" in head
            self.has_arrow = bool(arrow)

    def goes_on(self, line: str) -> bool:
        """Whether `line` belongs to the statement."""
        begin = line.lstrip()
        if not begin:
            return True
        if _KEYWORDS.match(begin):
            return False
        unfinished = not self.is_keyword and not self.has_arrow
        if self.parentheses > 0 or (self.braces > 0 and (self.is_keyword or unfinished)):
            return True
        if unfinished and (self.has_colon or begin.startswith(("-->", ":", "{", "<", ">"))):
            return True
        return "-->" not in line and len(line) - len(begin) > self.indent


@lru_cache(maxsize=1)
def _lark() -> Lark:
    grammar = files("forestgen.lsystem").joinpath("grammar.lark").read_text(encoding="utf-8")
    return Lark(grammar, parser="lalr", start=_STARTS, maybe_placeholders=True)


class Reader:
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
            self.unexpected(self.place(error.line, error.column), error.allowed, got, text)
        except UnexpectedEOF as error:
            lines = text.split("\n")
            self.unexpected(self.place(len(lines), len(lines[-1]) + 1), error.expected, "the end", text)
        except UnexpectedToken as error:
            at_end = error.token.type == "$END"
            lines = text.rstrip().split("\n")
            place = self.place(len(lines), len(lines[-1]) + 1) if at_end else self.at(error.token)
            got = "the end of the statement" if at_end else repr(str(error.token))
            self.unexpected(place, error.accepts or error.expected, got, text)

    def unexpected(self, place: Place, expected: Any, got: str, text: str) -> NoReturn:
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
        symbol = tree.children[0]
        assert isinstance(symbol, Token)
        if tree.data == "comma":
            return Module(",", (), self.at(symbol))
        arguments = tree.children[2]
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
            successor=self.modules(successor),
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


def is_tree(tree: Any) -> bool:
    return bool(tree.children) and isinstance(tree.children[0], Tree)


def _refuse_deep(reader: Reader, text: str) -> None:
    depth = 0
    for position, character in enumerate(text):
        depth += (character == "(") - (character == ")")
        if depth > _DEEPEST:
            line = text.count("\n", 0, position) + 1
            place = reader.place(line, position - text.rfind("\n", 0, position))
            reader.fail("parentheses lie too deep within one another", place, expected=f"at most {_DEEPEST}")
