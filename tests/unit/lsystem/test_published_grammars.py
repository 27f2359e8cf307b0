"""Grammars whose words are published."""

from __future__ import annotations

import pytest

from forestgen.lsystem.compiler import compile_program
from forestgen.lsystem.derivation import derive
from forestgen.lsystem.multiset import words_as_text
from forestgen.lsystem.parsing import parse_file, parse_text
from forestgen.recipe.assets import find_asset, list_assets


def words(program: str, steps: int, seed: int = 0) -> list[str]:
    """Words of a shipped program, or of a text."""
    text = "\n" in program
    listing = parse_text(program, "test.lsys") if text else parse_file(find_asset("lsystems", program))
    *_, last = derive(compile_program(listing), steps, seed)
    return list(words_as_text(last.multiset))


def word(program: str, steps: int, seed: int = 0) -> str:
    (only,) = words(program, steps, seed)
    return only


def test_koch() -> None:
    assert word("koch", 1) == "F-F++F-F++F-F++F-F++F-F++F-F"


def test_fibonacci() -> None:
    assert word("axiom: ab\na --> ab\nb --> a", 5) == "abaababaabaababaababa"
    lengths = [len(word("fibonacci", n)) for n in range(20)]
    assert lengths[:2] == [1, 2]
    assert all(c == a + b for a, b, c in zip(lengths, lengths[1:], lengths[2:], strict=False))


def test_sierpinski() -> None:
    assert word("sierpinski", 2) == "A+B+A-B-A-B-A+B+A"


@pytest.mark.parametrize(
    ("program", "steps", "length", "edges"),
    [
        ("quadratic_koch", 3, 3803, 2048),
        ("weed", 5, 7811, 3125),
        ("dragon", 10, 3070, 1024),
        ("gosper", 4, 5601, 2401),
    ],
)
def test_lengths(program: str, steps: int, length: int, edges: int) -> None:
    found = word(program, steps)
    assert len(found) == length
    assert sum(found.count(symbol) for symbol in "Flr") == edges


def test_context_sees_through_branches() -> None:
    rules = "\nA < B > C --> Z"
    assert word("axiom: A[X]BC" + rules, 1) == "A[X]ZC"
    assert word("axiom: ABD" + rules, 1) == "ABD"
    assert word("axiom: A[BC]" + rules, 1) == "A[ZC]"  # the left context is what bears the branch
    assert word("axiom: A[BX]C" + rules, 1) == "A[BX]C"  # a branch ends where it ends
    assert word("axiom: AB[X[Y]Z][V]C" + rules, 1) == "AZ[X[Y]Z][V]C"
    assert word("axiom: [AX]BC" + rules, 1) == "[AX]BC"  # a branch is no context of what follows it


def test_abop_signal_examples() -> None:
    """ABOP section 1.8: an acropetal and a basipetal signal with bracketed contexts."""
    up = "ignore: +-\naxiom: J[+I]I[-I]I[+I]I\nJ < I --> J\n"
    assert word(up, 1) == "J[+J]J[-I]I[+I]I"
    assert word(up, 2) == "J[+J]J[-J]J[+I]I"
    down = "ignore: +-\naxiom: I[+I]I[-I]I[+I]J\nI > J --> J\n"
    assert word(down, 1) == "I[+I]I[-I]J[+I]J"


def test_table_4_1() -> None:
    """Lane 2002, L-system 4.3, Table 4.1."""
    assert words("fragmentation", 0) == ["A", "B"]
    assert words("fragmentation", 1) == ["I[B]A", "B", "A"]
    assert words("fragmentation", 2) == ["I[B]I[B]A", "A", "B", "A", "I[B]A"]


def test_lane_4_1_and_4_2() -> None:
    assert word("axiom: IB\nB --> [IB]IB", 2) == "I[I[IB]IB]I[IB]IB"
    assert [word("buds", n) for n in range(4)] == ["IB(1)", "IIB(2)", "IIL", "IIL"]


def test_abop_parametric_example() -> None:
    """ABOP section 1.10.1, Figure 1.34."""
    program = "axiom: B(2)A(4,4)\nA(x,y) : y <= 3 --> A(x*2,x+y)\nA(x,y) : y > 3 --> B(x)A(x/y,0)\n"
    program += "B(x) : x < 1 --> C\nB(x) : x >= 1 --> B(x-1)\n"
    assert [word(program, n) for n in range(5)] == [
        "B(2)A(4,4)",
        "B(1)B(4)A(1,0)",
        "B(0)B(3)A(2,1)",
        "CB(2)A(4,3)",
        "CB(1)A(8,7)",
    ]


def test_anabaena_with_pseudo_l_system_predecessors() -> None:
    """Prusinkiewicz 1986: several modules as predecessor; here pairs swap, and a lone module stays."""
    assert word("axiom: ABABA\nAB --> BA\n", 1) == "BABAA"


@pytest.mark.parametrize("name", list_assets("lsystems"))
def test_shipped_programs_run(name: str) -> None:
    program = compile_program(parse_file(find_asset("lsystems", name)))
    *_, last = derive(program, 2, 1)
    assert len(last.multiset.code) > 0
