"""From a file to statements, and from the text of one statement to syntax, by grammar.lark, which Lark reads (LALR).

A statement begins on its own line and goes on in lines that are indented deeper, in lines within open parentheses or
braces, and after a backslash at a line's end. Comments are ``/* ... */`` and lines that begin with ``//`` (elsewhere
``//`` is the turtle rolling twice).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.resources import files
from typing import Any, NamedTuple, NoReturn

from lark import Lark, Token, v_args
from lark.exceptions import UnexpectedCharacters, UnexpectedToken
from lark.visitors import Transformer_NonRecursive

from forestgen.lsystem import syntax
from forestgen.lsystem.syntax import Place, fail, place_in

_STARTS = ["production", "words", "word", "string", "expression", "statements", "arrays", "points", "sys_string"]
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


class Array(NamedTuple):
    """``array name[size] = {values}``"""

    name: str
    size: syntax.Number | None  # as written
    values: tuple[float, ...]
    place: Place


def statements(text: str, name: str) -> Iterator[Statement]:
    """The statements of a program up to `endlsystem`; `name` is the file's, for messages."""
    for start, raw in _logical_lines(_without_comments(text, name)):
        match = _KEYWORDS.match(raw)
        if match is None:
            yield Statement(name, "", raw, start, start)
            continue
        keyword = " ".join(match.group().rstrip(": \t").lower().replace("#", "# ").split()).replace("# ", "#")
        if keyword == "endlsystem":
            return
        if keyword.startswith("function "):  # its name keeps its capitals
            keyword = "function " + match.group().rstrip(": \t").split()[1]
        yield Statement(name, keyword, raw[match.end() :], Place(start.line, start.column + match.end()), start)


def _without_comments(text: str, name: str) -> str:
    """The same text with spaces for comments and for backslashes at a line's end that mean: go on."""

    def blank(match: re.Match[str]) -> str:
        return re.sub(r"[^\n]", " ", match.group())

    text = text.replace("\r\n", "\n").replace("\r", "\n")
    text = re.sub(r"(?m)^[ \t]*//.*$", blank, text)
    text = re.sub(r"/\*.*?\*/", blank, text, flags=re.DOTALL)
    opened = text.find("/*")
    if opened >= 0:  # comments that end are blank by now
        fail("a comment has no end", name, place_in(text, opened), expected="*/", got="the file's end")
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


#: What the rules of tokens with places make, of their parts (a missing one is empty) and the first token's place.
_MAKERS: dict[str, Callable[..., Any]] = {
    "name": syntax.Name,
    "call": syntax.Call,
    "index": syntax.Index,
    "binary": syntax.Binary,
    "module": syntax.Module,
    "comma": lambda comma, place: syntax.Module(comma, (), place),
    "assignment": syntax.Assign,
    "use_group": lambda keyword, group, place: syntax.UseGroup(group, place),
    "conditional": lambda keyword, condition, then, otherwise, place: syntax.If(condition, then, otherwise, place),
}


@v_args(inline=True)
class _Syntax(Transformer_NonRecursive[Token, Any]):
    """Makes syntax of Lark's trees; `at` is a token's place in the file. Rules that are not named make tuples."""

    def __init__(self, at: Callable[[Token], Place]) -> None:
        super().__init__()
        self.at = at

    def __default__(self, data: Any, children: list[Any], meta: Any) -> Any:
        if data not in _MAKERS:
            return tuple(one for one in children if one is not None)
        first = next(one for one in children if isinstance(one, Token))
        parts = (() if one is None else str(one) if isinstance(one, Token) else one for one in children)
        return _MAKERS[data](*parts, self.at(first))

    def number(self, token: Token) -> syntax.Number:
        return syntax.Number(float(token), self.at(token))

    def signed(self, sign: Token | None, token: Token) -> syntax.Number:
        return syntax.Number(-float(token) if sign == "-" else float(token), self.at(token))

    def unary(self, operator: Token, operand: syntax.Expression) -> syntax.Expression:
        return operand if operator == "+" else syntax.Unary(str(operator), operand, self.at(operator))

    def nothing(self) -> None:
        return None

    def array(self, name: Token, size: syntax.Number | None, values: tuple[syntax.Number, ...] | None) -> Array:
        return Array(str(name), size, tuple(one.value for one in values or ()), self.at(name))

    def point(self, x: syntax.Number, y: syntax.Number) -> tuple[float, float]:
        return x.value, y.value

    def tested(self, test: syntax.Expression | None, after: Any) -> tuple[Any, ...]:
        return (), test, after or ()

    def prepared(self, before: Any, test: syntax.Expression | None, after: Any) -> tuple[Any, ...]:
        return before, test, after or ()

    def production(
        self, left: Any, predecessor: Any, right: Any, condition: Any, successor: Any, probability: Any
    ) -> syntax.Production:
        heads, place = (left or (), right or ()), predecessor[0].place
        return syntax.Production(predecessor, successor, probability, place, *heads, *(condition or ()))


@dataclass(frozen=True)
class Statement:
    """A keyword, its text and the place where that begins; a production has the keyword ''."""

    name: str  # of the file
    keyword: str  # lower case, one space between words, no colon
    text: str
    place: Place  # of the text
    start: Place  # of the statement

    def at(self, position: int) -> Place:
        """Place in the file of an index into the text."""
        return self._in_file(*place_in(self.text, position))

    def _in_file(self, line: int, column: int) -> Place:
        return Place(self.place.line + line - 1, column + (self.place.column - 1 if line == 1 else 0))

    def fail(self, problem: str, place: Place | None = None, **about: str | None) -> NoReturn:
        """Raise `LsystemError` for a place in the file; None: where the statement begins."""
        fail(problem, self.name, place or self.start, **about)

    def parse(self, rule: str) -> Any:
        """The syntax of the text, by a rule of the grammar."""
        self._refuse_deep()
        try:
            tree = _lark().parse(self.text, start=rule)
        except UnexpectedCharacters as error:
            got = repr(self.text[error.pos_in_stream or 0])
            self.unexpected(self._in_file(error.line, error.column), error.allowed, got)
        except UnexpectedToken as error:
            at_end = error.token.type == "$END"
            place = self.at(len(self.text.rstrip())) if at_end else self._in_file(error.line, error.column)
            got = "the end of the statement" if at_end else repr(str(error.token))
            self.unexpected(place, error.accepts or error.expected, got)
        return _Syntax(lambda token: self._in_file(token.line or 1, token.column or 1)).transform(tree)

    def unexpected(self, place: Place, expected: Any, got: str) -> NoReturn:
        names = set(expected or ())
        shown = [_PLAIN[one] for one in _PLAIN if one in names]
        if names & _OPERATORS:
            shown.append("an operator")
        hint = None
        if "-->" not in self.text and re.search(r"->|→", self.text):
            hint = "the arrow of a production is -->"
        elif got.strip("'\"") == "=":
            hint = "equality is =="
        self.fail("this is not understood", place, expected=", ".join(shown) or None, got=got, hint=hint)

    def _refuse_deep(self) -> None:
        depth = 0
        for position, character in enumerate(self.text):
            depth += (character == "(") - (character == ")")
            if depth > _DEEPEST:
                expected = f"at most {_DEEPEST}"
                self.fail("parentheses lie too deep within one another", self.at(position), expected=expected)
