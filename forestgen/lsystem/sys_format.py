"""The `.sys` files of RhoVeR's forest: an L-system whose rules are fired with given probabilities.

::

    LSYSTEM
    1
    F
    F F [%>F]F[<&F][<&F][%F] 1

The header; the number r of rules; the axiom; r rules "A R p", where R replaces the symbol A with probability p. R may
contain spaces, or be empty. With what its rules leave of 1, a symbol stays. Modules may have numbers as parameters,
F(10, 2, 1); a rule for A replaces A with any parameters.

The turtle's symbols, dialect `rhover` (see `turtle`):

=============  ==========================================  =========
module         meaning                                     default
=============  ==========================================  =========
F(l, w, t)     a tapered segment of length l, width w at   10, 2, 1
               its base and t at its tip
``<(a) >(a)``  turn right, left about the z axis           45 degrees
``&(a) @(a)``  roll right, left about the y axis           45 degrees
``%(a) #(a)``  pitch down, up about the x axis             45 degrees
``|``          turn by 180 degrees about the z axis
``[ ]``        a branch
=============  ==========================================  =========

References
----------
Forest growth simulation using L-systems (Rhodes University), section 4.2 and Fig. 5.2.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import replace
from typing import NoReturn

from forestgen.core.errors import LsystemError
from forestgen.lsystem.syntax import Module, Name, Number, Place, Production, ProgramAST

_MOST_PARAMETERS = {"F": 3, "<": 1, ">": 1, "&": 1, "@": 1, "%": 1, "#": 1, "|": 0, "[": 0, "]": 0}
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_SHAPE = "symbol, replacement and probability, such as: F F[>F]F 1"
_ROUNDING = 1e-9


def parse_sys_text(text: str, name: str) -> ProgramAST:
    """The program in a `.sys` file's text, dialect `rhover`; raises `LsystemError`, with line and column."""
    lines = [_Line(name, number, raw) for number, raw in enumerate(text.splitlines(), 1) if raw.strip()]
    first, end = lines[0] if lines else _Line(name, 1, ""), _Line(name, text.count("\n") + 1, "")
    if first.text.strip() != "LSYSTEM":
        first.fail(first.indent, "no .sys file", "LSYSTEM in its first line", first.text.strip()[:60] or None)
    if len(lines) < 3:
        what = "the number of rules" if len(lines) == 1 else "the axiom"
        end.fail(0, f"the file ends before {what}", what)
    count, rules = lines[1].whole_number(), lines[3:]
    expected = f"{count}, as line {lines[1].number} says"
    if len(rules) < count:
        end.fail(0, "too few rules", expected, str(len(rules)))
    if len(rules) > count:
        more = rules[count]
        more.fail(more.indent, "more rules than announced", expected, more.text.strip()[:60])
    parsed = [line.rule() for line in rules]
    _check_sums(name, parsed)
    axiom = lines[2].modules(0, len(lines[2].text))
    arities: dict[str, set[int]] = {}
    for module in [*axiom, *(module for rule in parsed for module in rule.successor)]:
        arities.setdefault(module.symbol, set()).add(len(module.arguments))
    productions = tuple(one for rule in parsed for one in _for_each_arity(rule, arities))
    return ProgramAST(name, dialect="rhover", axiom=(axiom,), productions=productions)


def _for_each_arity(rule: Production, arities: dict[str, set[int]]) -> Iterable[Production]:
    """The rule for its symbol with no, one, two, ... parameters, as far as the program has them."""
    (head,) = rule.predecessor
    for count in sorted(arities.get(head.symbol, {0})):
        formal = tuple(Name(f"p{k}", head.place) for k in range(1, count + 1))
        yield replace(rule, predecessor=(Module(head.symbol, formal, head.place),))


def _check_sums(name: str, rules: Iterable[Production]) -> None:
    total: dict[str, float] = {}
    for rule in rules:
        symbol = rule.predecessor[0].symbol
        assert isinstance(rule.probability, Number)
        total[symbol] = total.get(symbol, 0.0) + rule.probability.value
        if total[symbol] > 1.0 + _ROUNDING:
            place, problem = rule.probability.place, f"the probabilities of the rules for {symbol} exceed 1"
            where, got = f"{name}:{place.line}:{place.column}", f"{total[symbol]:g}"
            raise LsystemError(problem, where=where, expected="a sum of at most 1", got=got)


class _Line:
    """A line of the file that is not blank."""

    def __init__(self, name: str, number: int, text: str) -> None:
        self.name, self.number, self.text = name, number, text

    @property
    def indent(self) -> int:
        return len(self.text) - len(self.text.lstrip())

    def at(self, index: int) -> Place:
        return Place(self.number, index + 1)

    def fail(self, index: int, problem: str, expected: str, got: str | None = None) -> NoReturn:
        raise LsystemError(problem, where=f"{self.name}:{self.number}:{index + 1}", expected=expected, got=got)

    def whole_number(self) -> int:
        word = self.text.strip()
        if not re.fullmatch(r"[0-9]{1,6}", word):
            self.fail(self.indent, "the number of rules is not understood", "a whole number", word)
        return int(word)

    def rule(self) -> Production:
        words = list(re.finditer(r"\S+", self.text))
        symbol, last = words[0], words[-1]
        if len(symbol.group()) > 1:
            self.fail(symbol.start(), "a rule replaces one symbol", _SHAPE, symbol.group())
        if symbol.group() in "[](),":
            self.fail(symbol.start(), "this symbol cannot be replaced", _SHAPE, symbol.group())
        if len(words) == 1 or not _NUMBER.fullmatch(last.group()):
            self.fail(last.start(), "a rule without probability", _SHAPE, last.group())
        probability = float(last.group())
        if not 0.0 <= probability <= 1.0:
            self.fail(last.start(), "this cannot be a probability", "a number from 0 to 1", last.group())
        place = self.at(symbol.start())
        return Production(
            predecessor=(Module(symbol.group(), (), place),),
            successor=self.modules(symbol.end(), last.start()),
            probability=Number(probability, self.at(last.start())),
            place=place,
        )

    def modules(self, start: int, end: int) -> tuple[Module, ...]:
        """The modules between two indices; spaces mean nothing."""
        found: list[Module] = []
        opened: list[int] = []
        index = start
        while index < end:
            symbol = self.text[index]
            if symbol.isspace():
                index += 1
                continue
            if symbol in "(),":
                self.fail(index, "this is not a module", "a symbol, or its parameters in parentheses", symbol)
            here = index
            index, arguments = self.arguments(index + 1, end)
            most = _MOST_PARAMETERS.get(symbol, len(arguments))
            if len(arguments) > most:
                expected = f"at most {most}" if most else "none"
                self.fail(here, f"too many parameters of {symbol}", expected, str(len(arguments)))
            if symbol == "[":
                opened.append(here)
            elif symbol == "]":
                if not opened:
                    self.fail(here, "no bracket is open that this could close", "[ before ]", "]")
                opened.pop()
            found.append(Module(symbol, arguments, self.at(here)))
        if opened:
            self.fail(opened[-1], "this bracket is never closed", "as many ] as [", "[")
        return tuple(found)

    def arguments(self, index: int, end: int) -> tuple[int, tuple[Number, ...]]:
        """Parameters in parentheses, if any begin at an index, and the index behind them."""
        opens = index
        while opens < end and self.text[opens].isspace():
            opens += 1
        if opens == end or self.text[opens] != "(":
            return index, ()
        closes = self.text.find(")", opens, end)
        if closes < 0:
            self.fail(opens, "these parentheses are never closed", ")", self.text[opens:end].strip()[:40])
        numbers, at = [], opens + 1
        for piece in self.text[opens + 1 : closes].split(","):
            where = at + len(piece) - len(piece.lstrip())
            word = piece.strip()
            if not _NUMBER.fullmatch(word) or not math.isfinite(float(word)):
                self.fail(where, "a parameter is not understood", "a number", word or "nothing")
            numbers.append(Number(float(word), self.at(where)))
            at += len(piece) + 1
        return closes + 1, tuple(numbers)
