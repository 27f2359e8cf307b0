"""From a program's text to a `ProgramAST`: in cpfg's conventions, or in RhoVeR's.

The `.sys` files of RhoVeR's forest are L-systems whose rules are fired with given probabilities::

    LSYSTEM
    1
    F
    F F [%>F]F[<&F][<&F][%F] 1

The header; the number r of rules; the axiom; r rules "A R p", where R replaces the symbol A with probability p. R may
contain spaces, or be empty. With what its rules leave of 1, a symbol stays. Modules may have numbers as parameters,
F(10, 2, 1); a rule for A replaces A with any parameters.

The turtle's symbols are those of the dialect `rhover`; see `turtle`.

References
----------
Forest growth simulation using L-systems (Rhodes University), section 4.2 and Fig. 5.2.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from forestgen.core.errors import LsystemError
from forestgen.lsystem import syntax
from forestgen.lsystem.statements import Reader, Statement, read_program, statements
from forestgen.lsystem.syntax import FIRST, Place, fail, points_problem

DIALECTS = ("cpfg", "abop")
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
    if path.suffix == ".sys":
        return parse_sys_text(read_program(path), str(path))
    return parse_text(read_program(path), str(path))


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

    def take(self, statement: Statement) -> None:
        reader = Reader(self.name, statement.place)
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
        handler: Callable[[Reader, Statement], None] | None = _HANDLERS.get(first)
        if handler is None:
            hint = "the seed is `seed`, or the recipe's" if first == "seed" else "of a preprocessor, only #define is"
            reader.fail(f"{keyword} is not supported", statement.start, hint=hint)
        handler(self, reader, statement)  # type: ignore[call-arg,arg-type]

    def take_production(self, reader: Reader, text: str) -> None:
        if "-->" not in text:
            if re.search(r"->|→", text):
                reader.unexpected(reader.origin, (), "a statement without an arrow", text)
            problem, got = "this is neither a production nor a known statement", text.strip().split("\n")[0][:60]
            expected = "predecessor --> successor, or axiom:, derivation length:, ignore:, ..."
            reader.fail(problem, reader.origin, expected=expected, got=got)
        self.refuse_slips(reader, text)
        group = self.group if self.block == "productions" else 0
        self.productions[self.block].append(replace(reader.parse(text, "production"), group=group))

    def refuse_slips(self, reader: Reader, text: str) -> None:
        """Slips that would be read as something else, far from what was meant."""
        head = re.match(r"([A-Za-z][A-Za-z ]{2,30}?)\s*:", text)
        near = difflib.get_close_matches(head[1].lower(), _STATEMENTS, n=1, cutoff=0.7) if head else []
        if head and near:
            reader.fail(f"there is no statement {head[1]}:", reader.origin, hint=f"did you mean {near[0]}: ?")
        number = re.search(r"\s(\d*\.\d+)\s*$", text)
        if number and ":" not in text.partition("-->")[2]:
            hint = f"a probability is written : {number[1]}"
            reader.fail("a number among the modules", reader.at(text, number.start(1)), got=number[1], hint=hint)

    def update(self, **changes: Any) -> None:
        self.ast = replace(self.ast, **changes)

    def header(self, reader: Reader, statement: Statement) -> None:
        """`lsystem: name` has no effect."""

    def productions_begin(self, reader: Reader, statement: Statement) -> None:
        """`production:`, which may also end a block."""
        self.block = "productions"
        if statement.text.strip():
            self.take_production(reader, statement.text)

    def dialect(self, reader: Reader, statement: Statement) -> None:
        word = statement.text.strip().lower()
        if word not in DIALECTS:
            reader.fail("an unknown dialect", statement.start, expected=" or ".join(DIALECTS), got=word or "nothing")
        self.update(dialect=word)

    def length(self, reader: Reader, statement: Statement) -> None:
        self.update(derivation_length=reader.parse(statement.text, "expression"))

    def axiom(self, reader: Reader, statement: Statement) -> None:
        text, bare = statement.text, statement.text.strip()
        if not bare.startswith("{"):
            word = reader.parse(text, "string")
            self.update(axiom=(word,) if word else ())
            return
        if not bare.endswith("}"):
            place = reader.at(text, text.index("{"))
            reader.fail("the set of words has no end", place, expected="}", got=bare.split("\n")[-1][-20:])
        words = reader.parse(_within_braces(text), "words")
        self.update(axiom=tuple(word for word in words if word), is_multiset=True)

    def consider(self, reader: Reader, statement: Statement) -> None:
        key = "considered" if statement.keyword == "consider" else "ignored"
        self.update(**{key: reader.parse(statement.text, "word")})

    def group_begins(self, reader: Reader, statement: Statement) -> None:
        self.group = int(statement.keyword.split()[1])
        if self.group == 0:
            reader.fail("a group 0", statement.start, expected="a number from 1 on; what is in no group is in all")
        if self.group > _MOST_GROUPS:
            reader.fail("no number for a group", statement.start, expected=f"at most {_MOST_GROUPS:,}")
        if self.block != "productions":
            reader.fail(f"a group within the block {self.block}", statement.start, expected="groups before all blocks")
        if statement.text.strip():
            self.take_production(reader, statement.text)

    def group_ends(self, reader: Reader, statement: Statement) -> None:
        if self.group == 0:
            reader.fail("endgroup without a group", statement.start, expected="group 1: before it")
        self.group = 0

    def block_begins(self, reader: Reader, statement: Statement) -> None:
        self.block = "interpretation" if statement.keyword == "homomorphism" else statement.keyword
        self.places[self.block] = statement.start
        self.group = 0

    def depth(self, reader: Reader, statement: Statement) -> None:
        if self.block == "productions":
            expected = "decomposition or interpretation above it"
            reader.fail("maximum depth belongs to a block", statement.start, expected=expected)
        self.depths[self.block] = reader.parse(statement.text, "expression")

    def instructions(self, reader: Reader, statement: Statement) -> None:
        bare = statement.text.strip()
        if not (bare.startswith("{") and bare.endswith("}")):
            got = bare[:40] or "nothing"
            reader.fail(f"{statement.keyword} needs a block", reader.origin, expected="{ ... }", got=got)
        inner = _within_braces(statement.text)
        if statement.keyword == "define":
            self.arrays(reader, inner)
            return
        key = {"starteach": "start_each", "endeach": "end_each"}.get(statement.keyword, statement.keyword)
        self.update(**{key: reader.parse(inner, "statements")})

    def arrays(self, reader: Reader, text: str) -> None:
        known = dict(self.ast.arrays)
        for one in reader.parse(text, "arrays"):
            if one.size is not None and one.size.value != len(one.values):
                problem, expected = f"array {one.name} is declared with another size", str(len(one.values))
                reader.fail(problem, one.size.place, expected=expected, got=f"{one.size.value:g}")
            self.declare(reader, one.name, one.place)
            known[one.name] = one.values
        self.update(arrays=known)

    def declare(self, reader: Reader, name: str, place: Place) -> None:
        if name in self.seen:
            reader.fail(f"{name} is defined twice", place, got=f"the first in line {self.seen[name].line}")
        self.seen[name] = place

    def function(self, reader: Reader, statement: Statement) -> None:
        name = statement.keyword.split()[1]
        if name.isdigit() and not 1 <= int(name) <= _MOST_FUNCTIONS:
            expected = f"1 to {_MOST_FUNCTIONS}, or a name"
            reader.fail("no number for a function", statement.start, expected=expected, got=name)
        self.declare(reader, f"function {name}", statement.start)
        points = reader.parse(statement.text, "points")
        problem = points_problem(points)
        if problem:
            reader.fail(f"function {name} is wrong", statement.place, expected=problem)
        self.update(functions={**self.ast.functions, name: points})

    def turtle(self, reader: Reader, statement: Statement) -> None:
        name = statement.keyword.replace("color", "colour")
        try:
            numbers = tuple(float(one) for one in statement.text.split())
            if not all(map(math.isfinite, numbers)):
                raise ValueError
        except ValueError:
            reader.fail(f"{name} needs numbers", statement.place, got=statement.text.strip())
        if name in self.ast.turtle:
            reader.fail(f"a second {name!r}", statement.start)
        self.update(turtle={**self.ast.turtle, name: numbers})

    def define(self, reader: Reader, statement: Statement) -> None:
        head = re.match(r"\s*([A-Za-z_]\w*)(\(([^()]*)\))?", statement.text)
        if head is None:
            got = statement.text.strip()
            reader.fail("#define needs a name", statement.place, expected="#define NAME value", got=got)
        name, _, given = head.groups()
        rest = statement.text[head.end() :]
        if not rest.strip():
            reader.fail(f"#define {name} has no value", statement.place, expected=f"#define {name} 1.5")
        self.declare(reader, name, Place(statement.place.line, statement.place.column + head.start(1)))
        body = reader.parse(" " * head.end() + rest, "expression")
        parameters = None if given is None else tuple(one.strip() for one in given.split(",") if one.strip())
        if parameters and not (all(map(str.isidentifier, parameters)) and len(set(parameters)) == len(parameters)):
            reader.fail(f"#define {name} has bad parameters", statement.place, expected="different names", got=given)
        self.update(macros={**self.ast.macros, name: syntax.Macro(parameters, body, self.seen[name])})

    def finish(self) -> syntax.ProgramAST:
        if "axiom" not in self.seen:
            fail("the program has no axiom", self.name, FIRST, expected="axiom: and a string of modules")
        blocks = {
            name: syntax.Block(tuple(self.productions[name]), self.depths.get(name), self.places.get(name, FIRST))
            for name in ("decomposition", "interpretation")
        }
        return replace(self.ast, productions=tuple(self.productions["productions"]), **blocks)  # type: ignore[arg-type]


def _within_braces(text: str) -> str:
    """The text with blanks for its outer braces: places stay as they are."""
    opened, closed = text.index("{"), text.rindex("}")
    return text[:opened] + " " + text[opened + 1 : closed]


_ONCE = {
    "lsystem", "dialect", "derivation length", "axiom", "consider", "ignore", "start", "starteach", "endeach", "end",
}  # fmt: skip
_STATEMENTS = [
    "lsystem", "dialect", "derivation length", "axiom", "consider", "ignore", "maximum depth", "group", "start",
    "starteach", "endeach", "define", "production", "function", "angle", "step", "width", "tropism", "heading",
]  # fmt: skip
_TURTLE = ("angle", "step", "scale", "width", "tip", "tropism", "elasticity", "heading", "colour", "color")
_HANDLERS: dict[str, Any] = {  # by a statement's first word
    "lsystem": _Builder.header,
    "dialect": _Builder.dialect,
    "derivation": _Builder.length,
    "axiom": _Builder.axiom,
    "group": _Builder.group_begins,
    "endgroup": _Builder.group_ends,
    "maximum": _Builder.depth,
    "function": _Builder.function,
    "#define": _Builder.define,
    **dict.fromkeys(("production", "productions"), _Builder.productions_begin),
    **dict.fromkeys(("consider", "ignore"), _Builder.consider),
    **dict.fromkeys(("decomposition", "interpretation", "homomorphism"), _Builder.block_begins),
    **dict.fromkeys(("start", "starteach", "endeach", "end", "define"), _Builder.instructions),
    **dict.fromkeys(_TURTLE, _Builder.turtle),
}


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
    modules: tuple[syntax.Module, ...] = Reader(name, start).parse(text, "sys_string")
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
