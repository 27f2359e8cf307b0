"""From a file to statements: what is text, what is comment, where a statement begins and ends.

A statement begins on its own line and goes on in lines that are indented deeper, in lines within open parentheses or
braces, and after a backslash at a line's end. Comments are ``/* ... */`` and lines that begin with ``//`` (elsewhere
``//`` is the turtle rolling twice).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from forestgen.core.arguments import read_text
from forestgen.core.errors import LsystemError
from forestgen.lsystem.syntax import Place

LARGEST_PROGRAM_BYTES = 8_000_000

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
    """The text of a program's file.

    Raises
    ------
    AssetError : no such file, or it cannot be read.
    LsystemError : it is too large, or no text.
    """
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
