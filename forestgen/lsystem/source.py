"""From a file to statements: what is text, what is comment, where a statement begins and ends.

A statement begins on its own line and goes on in lines that are indented deeper, in lines within open parentheses or
braces, and after a backslash at a line's end. Comments are ``/* ... */`` and lines that begin with ``//`` (elsewhere
``//`` is the turtle rolling twice).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from forestgen.core.errors import LsystemError
from forestgen.core.text_file import read_text
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
    current: list[str] = []
    start, indent, forced = Place(1, 1), 0, False
    for number, line in enumerate(text.split("\n"), 1):
        stripped = line.strip()
        if current and (forced or _goes_on(current, line, indent)):
            forced = line.rstrip().endswith("\\")
            current.append(_no_backslash(line))
            continue
        if current and stripped:
            yield start, "\n".join(current).rstrip()
            current = []
        if stripped:
            indent = len(line) - len(line.lstrip())
            start = Place(number, indent + 1)
            forced = line.rstrip().endswith("\\")
            current = [_no_backslash(line)[indent:]]
    if current:
        yield start, "\n".join(current).rstrip()


def _no_backslash(line: str) -> str:
    bare = line.rstrip()
    return bare[:-1] if bare.endswith("\\") else line


def _goes_on(current: list[str], line: str, indent: int) -> bool:
    """Whether `line` continues the statement whose lines are `current`."""
    if not line.strip():
        return True
    if _KEYWORDS.match(line.lstrip()):
        return False
    whole = "\n".join(current)
    keyword = _KEYWORDS.match(whole)
    unfinished_production = keyword is None and "-->" not in whole
    head = whole.partition("-->")[0]
    if head.count("(") > head.count(")") or ((keyword or unfinished_production) and head.count("{") > head.count("}")):
        return True
    if unfinished_production and (":" in whole or line.lstrip().startswith(("-->", ":", "{", "<", ">"))):
        return True
    return "-->" not in line and len(line) - len(line.lstrip()) > indent
