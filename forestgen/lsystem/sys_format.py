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

import re
from collections.abc import Iterable
from dataclasses import replace

from forestgen.lsystem.statements import Reader
from forestgen.lsystem.syntax import Module, Name, Number, Place, Production, ProgramAST, fail

_MOST_PARAMETERS = {"F": 3, "<": 1, ">": 1, "&": 1, "@": 1, "%": 1, "#": 1, "|": 0, "[": 0, "]": 0}
_RULE = re.compile(
    r"\s*(?P<symbol>\S)\s+(?P<successor>|.*\s)(?P<probability>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*"
)


def parse_sys_text(text: str, name: str) -> ProgramAST:
    """The program in a `.sys` file's text, dialect `rhover`; raises `LsystemError`, with line and column."""
    lines = [
        (Place(number, len(raw) - len(raw.lstrip()) + 1), raw.strip())
        for number, raw in enumerate(text.splitlines(), 1)
        if raw.strip()
    ]
    place, first = lines[0] if lines else (Place(1, 1), "")
    if first != "LSYSTEM":
        fail("no .sys file", name, place, expected="LSYSTEM in its first line", got=first[:60] or None)
    end = Place(text.count("\n") + 1, 1)
    if len(lines) < 3:
        what = "the number of rules" if len(lines) == 1 else "the axiom"
        fail(f"the file ends before {what}", name, end, expected=what)
    (place, announced), (start, axiom_text), *rules = lines[1:]
    if not re.fullmatch(r"[0-9]{1,6}", announced):
        fail("the number of rules is not understood", name, place, expected="a whole number", got=announced)
    count, expected = int(announced), f"{announced}, as line {place.line} says"
    if len(rules) < count:
        fail("too few rules", name, end, expected=expected, got=str(len(rules)))
    if len(rules) > count:
        fail("more rules than announced", name, rules[count][0], expected=expected, got=rules[count][1][:60])
    axiom, parsed = _modules(axiom_text, name, start), [_rule(line, name, begin) for begin, line in rules]
    arities: dict[str, set[int]] = {}
    for module in [*axiom, *(module for rule in parsed for module in rule.successor)]:
        arities.setdefault(module.symbol, set()).add(len(module.arguments))
    productions = tuple(one for rule in parsed for one in _for_each_arity(rule, arities))
    return ProgramAST(name, dialect="rhover", axiom=(axiom,), productions=productions)


def _rule(line: str, name: str, start: Place) -> Production:
    """A rule that begins at a place; its probability and brackets are checked where the program is compiled."""
    found = _RULE.fullmatch(line)
    if found is None or found["symbol"] in "[](),":
        expected = "one symbol, its replacement and a probability, such as: F F[>F]F 1"
        fail("this is no rule", name, start, expected=expected, got=line[:60])
    successor, probability = (start._replace(column=start.column + found.start(k)) for k in (2, 3))
    head = Module(found["symbol"], (), start)
    value = Number(float(found["probability"]), probability)
    return Production((head,), _modules(found["successor"], name, successor), value, start)


def _modules(text: str, name: str, start: Place) -> tuple[Module, ...]:
    """The modules of a text that begins at a place."""
    modules: tuple[Module, ...] = Reader(name, start).parse(text, "sys_string")
    for one in modules:
        given = len(one.arguments)
        most = _MOST_PARAMETERS.get(one.symbol, given)
        if given > most:
            expected = f"at most {most}" if most else "none"
            fail(f"too many parameters of {one.symbol}", name, one.place, expected=expected, got=str(given))
    return modules


def _for_each_arity(rule: Production, arities: dict[str, set[int]]) -> Iterable[Production]:
    """The rule for its symbol with no, one, two, ... parameters, as far as the program has them."""
    (head,) = rule.predecessor
    for count in sorted(arities.get(head.symbol, {0})):
        formal = tuple(Name(f"p{k}", head.place) for k in range(1, count + 1))
        yield replace(rule, predecessor=(Module(head.symbol, formal, head.place),))
