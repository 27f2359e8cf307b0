"""Bad programs: each is refused with the place and the reason."""

from __future__ import annotations

from pathlib import Path

import pytest

from forestgen.core.errors import AssetError, ForestgenError, LsystemError, ResourceError
from forestgen.lsystem.compiler import compile_program, with_values
from forestgen.lsystem.derivation import derive
from forestgen.lsystem.parsing import parse_file, parse_text


def run(text: str, steps: int = 3, most_modules: int = 200_000) -> int:
    """Number of modules after some steps."""
    *_, last = derive(compile_program(parse_text(text, "bad.lsys")), steps, 0, most_modules=most_modules)
    return len(last.multiset.code)


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("axiom: A(1)\nA(x) --> B(1)B(1,2)", "2:14", ["B", "2 parameters", "line 2"]),
        ("axiom: A(1,2)\nA(x) --> B", "1:8", ["A", "2 parameters", "1, as in productions"]),
        ("axiom: A(1)\nA(x) : x > 0 --> A(x/0)", "2:21", ["division by zero"]),
        ("axiom: A(3)\nA(x) --> A(1/(x-1))A(x-1)", "2:13", ["division by zero", "A(1)", "step 3"]),
        ("axiom: A(3)\nA(x) : 1 % (x-3) > 0 --> A(x)", "2:10", ["division by zero"]),
        ("axiom: A\nA --> B : 0.7\nA --> C : 0.4", "3:11", ["sum to more than 1", "1.1"]),
        ("axiom: A\nA --> B : 1.5", "2:11", ["between 0 and 1", "1.5"]),
        ("axiom: A(2)\nA(x) --> B : x", "2:14", ["between 0 and 1"]),
        ("axiom: A(1)\nA(x) --> B : x/2\nA(x) --> C : x*0.75", "3:14", ["exceed 1"]),
        ("axiom: A[B\nA --> B", "1:9", ["unbalanced", "has no ]"]),
        ("axiom: AB\nA --> B]C", "2:8", ["unbalanced", "has no ["]),
        ("axiom: A[B]\nA < [ --> C", "2:5", ["bracket"]),
        ("axiom: A[B]\nA > [B --> C", "2:5", ["unbalanced", "has no ]"]),
        ("axiom: A[B]\nA > B] --> C", "2:6", ["unbalanced", "has no ["]),
        ("axiom: A[B]\nA > [(1)B] --> C", "2:5", ["no parameters"]),
        ("axiom: A[B]\n[B] < A --> C", "2:1", ["bracket", "left context", "right context"]),
        ("axiom: A[B]\nA[B] --> C", "2:2", ["bracket", "predecessor"]),
        ("axiom: A(1)\nA(x) --> A(foo(x))", "2:12", ["foo", "not known", "sin"]),
        ("axiom: A(1)\nA(x) --> A(sin(x,2))", "2:12", ["sin takes 1 argument"]),
        ("axiom: A(1)\nA(x) --> A(y)", "2:12", ["y has no value", "x"]),
        ("axiom: A(1)\nA(1) --> A(2)", "2:3", ["must be a name"]),
        ("axiom: A(1)\nA(x) --> A(sqrt(0-x))", "2:12", ["no value as a real number"]),
        ("axiom: A(1)\nA(x) --> A(exp(1000*x))", "2:10", ["not a finite number"]),
        ("axiom: A(1)\nA(x) --> A(func(3,x))", "2:17", ["no function 3"]),
        ("axiom: A(7)\ndefine: { array r = {1,2}; }\nA(x) --> A(r[x])", "3:12", ["no such element"]),
        ("axiom: A(7)\nA(x) --> A(r[x])", "2:12", ["no array r"]),
        ("axiom: A\nA -> B", "2:1", ["-->"]),
        ("axiom: A(1)\nA(x) : x = 1 --> B", "2:10", ["=="]),
        ("axiom: A\nA --> B\naxiom: C", "3:1", ["second 'axiom'"]),
        ("A --> B", "1:1", ["no axiom"]),
        ("axiom: A\nA", "2:1", ["neither a production"]),
        ("axiom: A\nA --> B /* to do", "2:9", ["comment has no end"]),
        ("axiom: A\n#include <x>\nA --> B", "2:1", ["#include"]),
        ("axiom: { A, B\nA --> B", "1:8", ["has no end"]),
        ("dialect: latin\naxiom: A", "1:1", ["unknown dialect", "cpfg"]),
        ("#define A B\n#define B A\naxiom: X(A)", "2:11", ["made of itself"]),
        ("axiom: A\nmaximum depth: 3\nA --> B", "2:1", ["belongs to a block"]),
        ("axiom: A\nA --> B\ndecomposition\nB --> BC", "4:7", ["does not end", "100000"]),
        ("axiom: A\nA --> B\ndecomposition\nmaximum depth: 4\nB --> CB", "5:7", ["does not end", "depth: 4"]),
        ("axiom: A\nA --> B\ndecomposition\nA < B --> C", "4:5", ["context-free"]),
        ("derivation length: -1\naxiom: A", "1:20", ["whole number"]),
        ("axiom: A(" + "(" * 500 + "1" + ")" * 500 + ")", "1:2", ["too deep"]),
        ("axiom: A(1)\nA(x) < B(x) --> C", "2:10", ["x stands twice"]),
        ("axiom: A\nA --> B%\nB% --> C", "3:2", ["cannot be rewritten"]),
        ("axiom: A\nstart: {useGroup(7);}\ngroup 1:\nA --> B\nendgroup", "2:9", ["no such group", "0, 1", "7"]),
        ("axiom: A\nend: {x = nosuch(3);}", "2:11", ["nosuch", "not known"]),
        ("seed: 5\naxiom: A", "1:1", ["`seed`"]),
        ("axoim: F\nF --> FF", "1:1", ["axoim", "did you mean axiom"]),
        ("axiom: A\nA --> B 0.7", "2:9", ["number", "probability", ": 0.7"]),
        ("axiom: A(1)\nA(x) --> A(min(1)+1)", "2:12", ["min takes 2 arguments"]),
        ("axiom: A\nA --> B : sin(1,2)", "2:11", ["sin takes 1 argument"]),
        ("axiom: A\nA --> B : min(1,2,0)", "2:11", ["min takes 2 arguments"]),
        ("derivation length: 1e999\naxiom: A", "1:20", ["whole number"]),
        ("axiom: A\ngroup 99999999999999999999:\nA --> B", "2:1", ["number for a group"]),
        ("start: {n = 1;}\nstarteach: {useGroup(exp(1000*n));}\naxiom: A", "", ["no such group", "step 1"]),
        ("axiom: A(1)\nA(x) --> A(" + "+".join(["x"] * 3000) + ")", "", ["too long or too deep"]),
        ("axiom: A\nA --> B%(1)C", "2:8", ["% has no parameters"]),
        ("axiom: A(1)\nA(x) : exp(1e9*x)-exp(1e9*x) --> B", "2:12", ["no value as a real number"]),
        ("#define r(1) 2\naxiom: A", "1:8", ["bad parameters"]),
        ("#define r(a,a) a\naxiom: A", "1:8", ["bad parameters"]),
        ("starteach: {n=count(AB);}\naxiom: A", "1:21", ["one character"]),
        ("function 1: (0,0) (1e999,1)\naxiom: A", "1:12", ["finite"]),
        ("angle: nan\naxiom: A", "1:7", ["numbers"]),
        ("axiom: A\ngroup 0:\nA --> B", "2:1", ["group 0", "from 1 on"]),
        ("function f: (1,0)\naxiom: A", "1:12", ["two points"]),
        ("function f: (1,0) (0,2) (3,3)\naxiom: A", "1:12", ["ascend"]),
        ("start: {n = 1;}\naxiom: A\nA : {n = 2;} 1 --> B", "3:6", ["global variable n"]),
    ],
)
def test_refused_with_its_place(text: str, place: str, words: list[str]) -> None:
    with pytest.raises(LsystemError) as caught:
        run(text)
    message = str(caught.value)
    assert message.startswith(f"bad.lsys:{place}" if place else "bad.lsys"), message
    for word in words:
        assert word in message, message


def test_an_explosion_stops_at_the_limit() -> None:
    with pytest.raises(ResourceError, match=r"(?s)grow too long.*10,000.*step 9"):
        run("axiom: F\nF --> FFF", steps=100, most_modules=10_000)
    with pytest.raises(ResourceError, match="grow too long"):
        run("axiom: A\nA --> B(9)\ndecomposition\nB(n) : n > 0 --> B(n-0.0001)C\n", most_modules=1000)


def test_a_program_that_fits_the_limit_runs() -> None:
    assert run("axiom: F\nF --> FFF", steps=8, most_modules=3**8) == 3**8


def test_files_that_are_no_programs(tmp_path: Path) -> None:
    binary = tmp_path / "binary.lsys"
    binary.write_bytes(b"axiom: A\nA --> \xff\xfe")
    zeros = tmp_path / "zeros.lsys"
    zeros.write_bytes(b"axiom: A\n\x00\x00")
    large = tmp_path / "large.lsys"
    with large.open("wb") as file:
        file.truncate(100_000_000)
    cases: list[tuple[Path, type[ForestgenError], str]] = [
        (binary, LsystemError, r"binary.lsys:2:7: this is not a text file"),
        (zeros, LsystemError, r"zeros.lsys:2:1: this is not a text file"),
        (large, LsystemError, r"(?s)too large.*8 MB.*100 MB"),
        (tmp_path, LsystemError, "folder"),
        (tmp_path / "none.lsys", AssetError, "no such file"),
    ]
    for path, error, pattern in cases:
        with pytest.raises(error, match=pattern):
            parse_file(path)


def test_values_that_cannot_be_set() -> None:
    listing = parse_text("#define n 3\ndefine: { array r = {1, 2}; }\naxiom: A(n, r[0])", "bad.lsys")
    for values, pattern in (
        ({"m": 1.0}, r"(?s)defines no m.*n, r"),
        ({"n": [1.0]}, r"(?s)n cannot be set so.*a number"),
        ({"r": 1.0}, r"(?s)r cannot be set so.*a list"),
    ):
        with pytest.raises(LsystemError, match=pattern):
            with_values(listing, values)  # type: ignore[arg-type]
