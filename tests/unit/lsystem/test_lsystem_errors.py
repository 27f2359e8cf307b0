"""Bad programs: each is refused with the place and the reason."""

from __future__ import annotations

from pathlib import Path

import pytest

from forestgen.core.errors import AssetError, ForestgenError, LsystemError, ResourceError
from forestgen.lsystem.compiler import compile_program, with_values
from forestgen.lsystem.derivation import derive
from forestgen.lsystem.parsing import parse_file, parse_text
from support.error_messages import raises_error


def run(text: str, steps: int = 3, most_modules: int = 200_000) -> int:
    """Number of modules after some steps."""
    *_, last = derive(compile_program(parse_text(text, "bad.lsys")), steps, 0, most_modules=most_modules)
    return len(last.multiset.code)


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("axiom: A(1)\nA(x) --> B(1)B(1,2)", "2:14"),
        ("axiom: A(1,2)\nA(x) --> B", "1:8"),
        ("axiom: A(1)\nA(x) : x > 0 --> A(x/0)", "2:21"),
        ("axiom: A(3)\nA(x) --> A(1/(x-1))A(x-1)", "2:13"),
        ("axiom: A(3)\nA(x) : 1 % (x-3) > 0 --> A(x)", "2:10"),
        ("axiom: A\nA --> B : 0.7\nA --> C : 0.4", "3:11"),
        ("axiom: A\nA --> B : 1.5", "2:11"),
        ("axiom: A(2)\nA(x) --> B : x", "2:14"),
        ("axiom: A(1)\nA(x) --> B : x/2\nA(x) --> C : x*0.75", "3:14"),
        ("axiom: A[B\nA --> B", "1:9"),
        ("axiom: AB\nA --> B]C", "2:8"),
        ("axiom: A[B]\nA < [ --> C", "2:5"),
        ("axiom: A[B]\nA > [B --> C", "2:5"),
        ("axiom: A[B]\nA > B] --> C", "2:6"),
        ("axiom: A[B]\nA > [(1)B] --> C", "2:5"),
        ("axiom: A[B]\n[B] < A --> C", "2:1"),
        ("axiom: A[B]\nA[B] --> C", "2:2"),
        ("axiom: A(1)\nA(x) --> A(foo(x))", "2:12"),
        ("axiom: A(1)\nA(x) --> A(sin(x,2))", "2:12"),
        ("axiom: A(1)\nA(x) --> A(y)", "2:12"),
        ("axiom: A(1)\nA(1) --> A(2)", "2:3"),
        ("axiom: A(1)\nA(x) --> A(sqrt(0-x))", "2:12"),
        ("axiom: A(1)\nA(x) --> A(exp(1000*x))", "2:10"),
        ("axiom: A(1)\nA(x) --> A(func(3,x))", "2:17"),
        ("axiom: A(7)\ndefine: { array r = {1,2}; }\nA(x) --> A(r[x])", "3:12"),
        ("axiom: A(7)\nA(x) --> A(r[x])", "2:12"),
        ("axiom: A\nA -> B", "2:1"),
        ("axiom: A(1)\nA(x) : x = 1 --> B", "2:10"),
        ("axiom: A\nA --> B\naxiom: C", "3:1"),
        ("A --> B", "1:1"),
        ("axiom: A\nA", "2:1"),
        ("axiom: A\nA --> B /* to do", "2:9"),
        ("axiom: A\n#include <x>\nA --> B", "2:1"),
        ("axiom: { A, B\nA --> B", "1:8"),
        ("dialect: latin\naxiom: A", "1:1"),
        ("#define A B\n#define B A\naxiom: X(A)", "2:11"),
        ("axiom: A\nmaximum depth: 3\nA --> B", "2:1"),
        ("axiom: A\nA --> B\ndecomposition\nB --> BC", "4:7"),
        ("axiom: A\nA --> B\ndecomposition\nmaximum depth: 4\nB --> CB", "5:7"),
        ("axiom: A\nA --> B\ndecomposition\nA < B --> C", "4:5"),
        ("derivation length: -1\naxiom: A", "1:20"),
        ("axiom: A(" + "(" * 500 + "1" + ")" * 500 + ")", "1:209"),
        ("axiom: A(1)\nA(x) < B(x) --> C", "2:10"),
        ("axiom: A\nA --> B%\nB% --> C", "3:2"),
        ("axiom: A\nstart: {useGroup(7);}\ngroup 1:\nA --> B\nendgroup", "2:9"),
        ("axiom: A\nend: {x = nosuch(3);}", "2:11"),
        ("seed: 5\naxiom: A", "1:1"),
        ("axoim: F\nF --> FF", "1:1"),
        ("axiom: A\nA --> B 0.7", "2:9"),
        ("axiom: A(1)\nA(x) --> A(min(1)+1)", "2:12"),
        ("axiom: A\nA --> B : sin(1,2)", "2:11"),
        ("axiom: A\nA --> B : min(1,2,0)", "2:11"),
        ("derivation length: 1e999\naxiom: A", "1:20"),
        ("axiom: A\ngroup 99999999999999999999:\nA --> B", "2:1"),
        ("start: {n = 1;}\nstarteach: {useGroup(exp(1000*n));}\naxiom: A", ""),
        ("axiom: A(1)\nA(x) --> A(" + "+".join(["x"] * 3000) + ")", ""),
        ("axiom: A\nA --> B%(1)C", "2:8"),
        ("axiom: A(1)\nA(x) : exp(1e9*x)-exp(1e9*x) --> B", "2:12"),
        ("#define r(1) 2\naxiom: A", "1:8"),
        ("#define r(a,a) a\naxiom: A", "1:8"),
        ("starteach: {n=count(AB);}\naxiom: A", "1:21"),
        ("function 1: (0,0) (1e999,1)\naxiom: A", "1:12"),
        ("angle: nan\naxiom: A", "1:7"),
        ("axiom: A\ngroup 0:\nA --> B", "2:1"),
        ("function f: (1,0)\naxiom: A", "1:12"),
        ("function f: (1,0) (0,2) (3,3)\naxiom: A", "1:12"),
        ("start: {n = 1;}\naxiom: A\nA : {n = 2;} 1 --> B", "3:6"),
    ],
)
def test_refused_with_its_place(text: str, place: str) -> None:
    with raises_error(LsystemError, place=f"bad.lsys:{place}" if place else "bad.lsys"):
        run(text)


def test_an_explosion_stops_at_the_limit() -> None:
    with raises_error(ResourceError, place="bad.lsys"):
        run("axiom: F\nF --> FFF", steps=100, most_modules=10_000)
    with raises_error(ResourceError, place="bad.lsys"):
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
    for values in (
        {"m": 1.0},
        {"n": [1.0]},
        {"r": 1.0},
    ):
        with raises_error(LsystemError, place="bad.lsys"):
            with_values(listing, values)  # type: ignore[arg-type]
