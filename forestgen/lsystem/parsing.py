"""From a program's text to a `ProgramAST`: in cpfg's conventions, or in RhoVeR's.

A `.sys` file of RhoVeR's forest has a header, the number r of rules, the axiom, and r rules "A R p", where R, which may
contain spaces or be empty, replaces the symbol A with probability p; with what its rules leave of 1, a symbol stays.
Modules may have numbers as parameters; a rule for A replaces A with any. See docs/lsystem.md.

References
----------
Forest growth simulation using L-systems (Rhodes University), section 4.2 and Fig. 5.2.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from forestgen.core.arguments import read_text
from forestgen.core.errors import LsystemError
from forestgen.lsystem import syntax
from forestgen.lsystem.statements import Statement, statements
from forestgen.lsystem.syntax import FIRST, Place, fail, points_problem

DIALECTS = ("cpfg", "abop")
_LARGEST_PROGRAM_BYTES = 8_000_000
_MOST_FUNCTIONS = 1000
_MOST_GROUPS = 1_000_000
_MOST_PARAMETERS = {"F": 3, "<": 1, ">": 1, "&": 1, "@": 1, "%": 1, "#": 1, "|": 0, "[": 0, "]": 0}
_RULE = re.compile(
    r"\s*(?P<symbol>\S)\s+(?P<successor>|.*\s)(?P<probability>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*"
)


def parse_file(path: Path) -> syntax.ProgramAST:
    """The program in a file: .sys as in Randleff-Rasmussen 2004, else in cpfg's conventions.

    Raises `AssetError` where it cannot be read, and `LsystemError`, with line and column, where it is not understood.
    """
    text = read_text(path, "an L-system program", most_bytes=_LARGEST_PROGRAM_BYTES, error=LsystemError)
    return (parse_sys_text if path.suffix == ".sys" else parse_text)(text, str(path))


def parse_text(text: str, name: str) -> syntax.ProgramAST:
    """The program in a text, which messages call `name`; raises `LsystemError`, with line and column."""
    builder = _Builder(name)
    try:
        for statement in statements(text, name):
            builder.take(statement)
    except RecursionError as error:
        raise LsystemError("an expression is too long or too deep", where=name) from error
    return builder.finish()


class _Builder:
    """Collects statements into a `ProgramAST`."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.ast = syntax.ProgramAST(name)
        self.group = 0
        self.block = "productions"
        kinds = ("productions", "decomposition", "interpretation")
        self.productions = {one: list[syntax.Production]() for one in kinds}
        self.depths: dict[str, syntax.Expression] = {}
        self.places: dict[str, Place] = {}
        self.seen: dict[str, Place] = {}

    def update(self, **changes: Any) -> None:
        self.ast = replace(self.ast, **changes)

    def take(self, one: Statement) -> None:
        keyword, kind = one.keyword, one.keyword.partition(" ")[0]
        if keyword in _ONCE:
            if keyword in self.seen:
                one.fail(f"a second {keyword!r}", expected=f"only the one in line {self.seen[keyword].line}")
            self.seen[keyword] = one.start
        match kind:
            case "lsystem":  # a name, which has no effect
                pass
            case "dialect":
                word = one.text.strip().lower()
                if word not in DIALECTS:
                    one.fail("an unknown dialect", expected=" or ".join(DIALECTS), got=word or "nothing")
                self.update(dialect=word)
            case "derivation":
                self.update(derivation_length=one.parse("expression"))
            case "axiom":
                self.axiom(one)
            case "consider":
                self.update(considered=one.parse("word"))
            case "ignore":
                self.update(ignored=one.parse("word"))
            case "" | "production" | "productions" | "group" | "endgroup":
                self.rules(one, kind)
            case "decomposition" | "interpretation" | "homomorphism":
                self.block, self.group = "interpretation" if kind == "homomorphism" else kind, 0
                self.places[self.block] = one.start
            case "maximum":
                if self.block == "productions":
                    expected = "decomposition or interpretation above it"
                    one.fail("maximum depth belongs to a block", expected=expected)
                self.depths[self.block] = one.parse("expression")
            case "define" | "start" | "starteach" | "endeach" | "end":
                self.instructions(one)
            case "function":
                self.function(one)
            case "#define":
                self.define(one)
            case _ if kind in _TURTLE:
                self.turtle(one)
            case _:
                hint = "the seed is `seed`, or the recipe's" if kind == "seed" else "of a preprocessor, only #define is"
                one.fail(f"{keyword} is not supported", hint=hint)

    def rules(self, one: Statement, kind: str) -> None:
        """A production, or a keyword that may stand before one; ``production:`` may also end a block."""
        if kind.startswith("production"):
            self.block = "productions"
        elif kind == "endgroup":
            if self.group == 0:
                one.fail("endgroup without a group", expected="group 1: before it")
            self.group = 0
            return
        elif kind == "group":
            self.group = int(one.keyword.split()[1])
            if self.group == 0:
                one.fail("a group 0", expected="a number from 1 on; what is in no group is in all")
            if self.group > _MOST_GROUPS:
                one.fail("no number for a group", expected=f"at most {_MOST_GROUPS:,}")
            if self.block != "productions":
                one.fail(f"a group within the block {self.block}", expected="groups before all blocks")
        if one.text.strip():
            _refuse_slips(one)
            group = self.group if self.block == "productions" else 0
            self.productions[self.block].append(replace(one.parse("production"), group=group))

    def axiom(self, one: Statement) -> None:
        bare = one.text.strip()
        if not bare.startswith("{"):
            word = one.parse("string")
            self.update(axiom=(word,) if word else ())
            return
        if not bare.endswith("}"):
            place, got = one.at(one.text.index("{")), bare.split("\n")[-1][-20:]
            one.fail("the set of words has no end", place, expected="}", got=got)
        words = _within_braces(one).parse("words")
        self.update(axiom=tuple(word for word in words if word), is_multiset=True)

    def instructions(self, one: Statement) -> None:
        bare = one.text.strip()
        if not (bare.startswith("{") and bare.endswith("}")):
            one.fail(f"{one.keyword} needs a block", one.place, expected="{ ... }", got=bare[:40] or "nothing")
        inner = _within_braces(one)
        if one.keyword == "define":
            self.arrays(inner)
            return
        key = {"starteach": "start_each", "endeach": "end_each"}.get(one.keyword, one.keyword)
        self.update(**{key: inner.parse("statements")})

    def arrays(self, one: Statement) -> None:
        known = dict(self.ast.arrays)
        for array in one.parse("arrays"):
            if array.size is not None and array.size.value != len(array.values):
                problem, expected = f"array {array.name} is declared with another size", str(len(array.values))
                one.fail(problem, array.size.place, expected=expected, got=f"{array.size.value:g}")
            self.declare(one, array.name, array.place)
            known[array.name] = array.values
        self.update(arrays=known)

    def declare(self, one: Statement, name: str, place: Place) -> None:
        if name in self.seen:
            one.fail(f"{name} is defined twice", place, got=f"the first in line {self.seen[name].line}")
        self.seen[name] = place

    def function(self, one: Statement) -> None:
        name = one.keyword.split()[1]
        if name.isdigit() and not 1 <= int(name) <= _MOST_FUNCTIONS:
            one.fail("no number for a function", expected=f"1 to {_MOST_FUNCTIONS}, or a name", got=name)
        self.declare(one, f"function {name}", one.start)
        points = one.parse("points")
        problem = points_problem(points)
        if problem:
            one.fail(f"function {name} is wrong", one.place, expected=problem)
        self.update(functions={**self.ast.functions, name: points})

    def turtle(self, one: Statement) -> None:
        name = one.keyword.replace("color", "colour")
        try:
            numbers = tuple(float(number) for number in one.text.split())
        except ValueError:
            numbers = (math.nan,)
        if not all(map(math.isfinite, numbers)):
            one.fail(f"{name} needs numbers", one.place, got=one.text.strip())
        if name in self.ast.turtle:
            one.fail(f"a second {name!r}")
        self.update(turtle={**self.ast.turtle, name: numbers})

    def define(self, one: Statement) -> None:
        head = re.match(r"\s*([A-Za-z_]\w*)(\(([^()]*)\))?", one.text)
        if head is None:
            one.fail("#define needs a name", one.place, expected="#define NAME value", got=one.text.strip())
        name, _, given = head.groups()
        rest = one.text[head.end() :]
        if not rest.strip():
            one.fail(f"#define {name} has no value", one.place, expected=f"#define {name} 1.5")
        self.declare(one, name, one.at(head.start(1)))
        body = replace(one, text=" " * head.end() + rest).parse("expression")
        parameters = None if given is None else tuple(each.strip() for each in given.split(",") if each.strip())
        if parameters and not (all(map(str.isidentifier, parameters)) and len(set(parameters)) == len(parameters)):
            one.fail(f"#define {name} has bad parameters", one.place, expected="different names", got=given)
        self.update(macros={**self.ast.macros, name: syntax.Macro(parameters, body, self.seen[name])})

    def finish(self) -> syntax.ProgramAST:
        if "axiom" not in self.seen:
            fail("the program has no axiom", self.name, FIRST, expected="axiom: and a string of modules")
        blocks = {
            name: syntax.Block(tuple(self.productions[name]), self.depths.get(name), self.places.get(name, FIRST))
            for name in ("decomposition", "interpretation")
        }
        return replace(self.ast, productions=tuple(self.productions["productions"]), **blocks)  # type: ignore[arg-type]


def _refuse_slips(one: Statement) -> None:
    """What is no production, and slips that would be read as something else, far from what was meant."""
    if "-->" not in one.text:
        if re.search(r"->|→", one.text):
            one.unexpected(one.place, (), "a statement without an arrow")
        problem, got = "this is neither a production nor a known statement", one.text.strip().split("\n")[0][:60]
        expected = "predecessor --> successor, or axiom:, derivation length:, ignore:, ..."
        one.fail(problem, one.place, expected=expected, got=got)
    head = re.match(r"([A-Za-z][A-Za-z ]{2,30}?)\s*:", one.text)
    near = difflib.get_close_matches(head[1].lower(), _STATEMENTS, n=1, cutoff=0.7) if head else []
    if head and near:
        one.fail(f"there is no statement {head[1]}:", one.place, hint=f"did you mean {near[0]}: ?")
    number = re.search(r"\s(\d*\.\d+)\s*$", one.text)
    if number and ":" not in one.text.partition("-->")[2]:
        hint = f"a probability is written : {number[1]}"
        one.fail("a number among the modules", one.at(number.start(1)), got=number[1], hint=hint)


def _within_braces(one: Statement) -> Statement:
    """The statement with blanks for its text's outer braces: places stay as they are."""
    opened, closed = one.text.index("{"), one.text.rindex("}")
    return replace(one, text=one.text[:opened] + " " + one.text[opened + 1 : closed])


_ONCE = {
    "lsystem", "dialect", "derivation length", "axiom", "consider", "ignore", "start", "starteach", "endeach", "end",
}  # fmt: skip
_STATEMENTS = [
    "lsystem", "dialect", "derivation length", "axiom", "consider", "ignore", "maximum depth", "group", "start",
    "starteach", "endeach", "define", "production", "function", "angle", "step", "width", "tropism", "heading",
]  # fmt: skip
_TURTLE = ("angle", "step", "scale", "width", "tip", "tropism", "elasticity", "heading", "colour", "color")


def parse_sys_text(text: str, name: str) -> syntax.ProgramAST:
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
    return syntax.ProgramAST(name, dialect="rhover", axiom=(axiom,), productions=productions)


def _rule(line: str, name: str, start: Place) -> syntax.Production:
    """A rule that begins at a place; its probability and brackets are checked where the program is compiled."""
    found = _RULE.fullmatch(line)
    if found is None or found["symbol"] in "[](),":
        expected = "one symbol, its replacement and a probability, such as: F F[>F]F 1"
        fail("this is no rule", name, start, expected=expected, got=line[:60])
    successor, probability = (start._replace(column=start.column + found.start(k)) for k in (2, 3))
    head = syntax.Module(found["symbol"], (), start)
    value = syntax.Number(float(found["probability"]), probability)
    return syntax.Production((head,), _modules(found["successor"], name, successor), value, start)


def _modules(text: str, name: str, start: Place) -> tuple[syntax.Module, ...]:
    """The modules of a text that begins at a place."""
    modules: tuple[syntax.Module, ...] = Statement(name, "", text, start, start).parse("sys_string")
    for one in modules:
        given = len(one.arguments)
        most = _MOST_PARAMETERS.get(one.symbol, given)
        if given > most:
            expected = f"at most {most}" if most else "none"
            fail(f"too many parameters of {one.symbol}", name, one.place, expected=expected, got=str(given))
    return modules


def _for_each_arity(rule: syntax.Production, arities: dict[str, set[int]]) -> Iterable[syntax.Production]:
    """The rule for its symbol with no, one, two, ... parameters, as far as the program has them."""
    (head,) = rule.predecessor
    for count in sorted(arities.get(head.symbol, {0})):
        formal = tuple(syntax.Name(f"p{k}", head.place) for k in range(1, count + 1))
        yield replace(rule, predecessor=(syntax.Module(head.symbol, formal, head.place),))
