"""The `.sys` format of 003, section 4.2, and its Fig. 5.2."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from turtle_oracle import Oracle, encode

from forestgen.core.errors import LsystemError
from forestgen.lsystem.compiler import compile_program
from forestgen.lsystem.parsing import parse_file, parse_sys_text
from forestgen.lsystem.turtle import draw, options_from
from support.error_messages import raises_error

EXAMPLE = "LSYSTEM\n1\nF\nF F [%>F]F[<&F][<&F][%F] 1\n"
RULE = "F[%>F]F[<&F][<&F][%F]"
SHIPPED = Path(__file__).parents[3] / "scenes" / "lsystems" / "fig_5_2.sys"
RHOVER = options_from({}, "rhover")


def spell(modules):
    pieces = []
    for module in modules:
        numbers = ",".join(f"{argument.value:g}" for argument in module.arguments)
        pieces.append(module.symbol + (f"({numbers})" if numbers else ""))
    return "".join(pieces)


def tree(n):
    text = "F"
    for _ in range(n):
        text = text.replace("F", RULE)
    return text


def test_the_example_of_section_4_2():
    listing = parse_sys_text(EXAMPLE, "tree.sys")
    assert listing.dialect == "rhover"
    assert not listing.is_multiset
    assert [spell(word) for word in listing.axiom] == ["F"]
    (rule,) = listing.productions
    assert spell(rule.predecessor) == "F"
    assert spell(rule.successor) == RULE
    assert rule.probability.value == 1
    assert (rule.place, rule.probability.place) == ((4, 1), (4, 26))
    assert [module.place.column for module in rule.successor[:4]] == [3, 5, 6, 7]


def test_the_shipped_file_is_the_example():
    assert parse_file(SHIPPED).productions[0].successor == parse_sys_text(EXAMPLE, "x").productions[0].successor


@pytest.mark.parametrize("n", range(5))
def test_fig_5_2_has_the_branches_that_its_rule_says(n):
    drawing = draw(*encode(tree(n)), RHOVER)
    drawn = drawing.is_drawn
    assert drawn.sum() == 6**n  # six F in the rule
    assert drawing.order.max() == n
    # Of the six, two go on along the axis and four branch: orders are binomial.
    expected = [2 ** (n - k) * 4**k * [1, n, n * (n - 1) // 2, n * (n - 1) * (n - 2) // 6, 1][k] for k in range(n + 1)]
    np.testing.assert_array_equal(np.bincount(drawing.order[drawn]), expected)
    np.testing.assert_array_equal(np.bincount(drawing.axis[drawn])[0], 2**n)
    step = drawing.position[drawn] - drawing.position[drawing.parent[drawn]]
    np.testing.assert_allclose(np.linalg.norm(step, axis=1), 10)
    np.testing.assert_array_equal(drawing.start_radius[drawn], 1.0)
    np.testing.assert_array_equal(drawing.radius[drawn], 0.5)
    np.testing.assert_allclose(drawing.position[drawing.axis == 0][-1], [0, 0, 10 * 2**n])


def test_fig_5_2_branches_point_where_the_symbols_say():
    """At n = 1 two branches leave the first joint's end, and three the second's; 45 degrees each."""
    drawing = draw(*encode(tree(1)), RHOVER)
    drawn = np.flatnonzero(drawing.is_drawn)
    drawn = drawn[np.argsort(drawing.module[drawn])]
    step = (drawing.position[drawn] - drawing.position[drawing.parent[drawn]]) / 10
    r = np.sqrt(0.5)
    # x is right of the trunk, -y above the turtle's back; % pitches down, towards +y.
    expected = [[0, 0, 1], [-r, 0.5, 0.5], [0, 0, 1], [r, 0, r], [r, 0, r], [0, r, r]]
    np.testing.assert_allclose(step, expected, atol=1e-12)
    foot = drawing.position[drawing.parent[drawn], 2]
    np.testing.assert_allclose(foot, [0, 10, 10, 20, 20, 20])


def test_fig_5_2_as_the_slow_turtle_draws_it():
    text = tree(3)
    drawing, slow = draw(*encode(text), RHOVER), Oracle(text, RHOVER)
    drawn = np.flatnonzero(drawing.is_drawn)
    drawn = drawn[np.argsort(drawing.module[drawn])]
    np.testing.assert_allclose(drawing.position[drawn], [end for _, end, _, _ in slow.segments], atol=1e-9)


def test_the_engine_derives_the_example():
    compiler = pytest.importorskip("forestgen.lsystem.compiler")
    derivation = pytest.importorskip("forestgen.lsystem.derivation")
    from forestgen.lsystem.multiset import words_as_text
    from forestgen.lsystem.turtle import draw_word

    program = compiler.compile_program(parse_sys_text(EXAMPLE, "tree.sys"))
    for n in range(4):
        derived = list(derivation.derive(program, n, 0))[-1].multiset
        assert list(words_as_text(derived)) == [tree(n)]
        expected = draw(*encode(tree(n)), RHOVER)
        np.testing.assert_array_equal(draw_word(derived, 0, RHOVER).position, expected.position)


def test_parameters_spaces_blank_lines_and_empty_replacements():
    text = "\r\nLSYSTEM\r\n 3 \r\n\r\nA F(10, 2, 1.5) >( -3e1 )\r\nA [ > (20) A ] A .25\r\nA .5\r\nF F(5) 1.0\r\n\r\n"
    listing = parse_sys_text(text, "x.sys")
    assert spell(listing.axiom[0]) == "AF(10,2,1.5)>(-30)"
    first, second, *others = listing.productions
    assert (spell(first.successor), first.probability.value) == ("[>(20)A]A", 0.25)
    assert (second.successor, second.probability.value) == ((), 0.5)
    # A rule for F is for each number of parameters that F has here, F(5) and F(10, 2, 1.5).
    assert [[argument.name for argument in one.predecessor[0].arguments] for one in others] == [
        ["p1"],
        ["p1", "p2", "p3"],
    ]
    assert {spell(one.successor) for one in others} == {"F(5)"}


def test_probabilities_of_one_symbol_may_reach_one():
    text = "LSYSTEM\n3\nA\nA B 0.1\nA C 0.7\nA AA 0.2\n"
    assert len(parse_sys_text(text, "x.sys").productions) == 3


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("", "1:1"),
        ("lsystem\n1\nF\nF FF 1\n", "1:1"),
        ("Lsystem: 1\n", "1:1"),
        ("LSYSTEM\n", "2:1"),
        ("LSYSTEM\n1\n", "3:1"),
        ("LSYSTEM\none\nF\n", "2:1"),
        ("LSYSTEM\n 1.5\nF\n", "2:2"),
        ("LSYSTEM\n2\nF\nF FF 1\n", "5:1"),
        ("LSYSTEM\n1\nF\nF FF .5\n F F .5\n", "5:2"),
        ("LSYSTEM\n1\nF\nF FF\n", "4:1"),
        ("LSYSTEM\n1\nF\nF\n", "4:1"),
        ("LSYSTEM\n1\nF\nF FF 1.5\n", "4:6"),
        ("LSYSTEM\n1\nF\nF FF -1\n", "4:6"),
        ("LSYSTEM\n1\nF\nF FF nan\n", "4:1"),
        ("LSYSTEM\n1\nF\nFF FF 1\n", "4:1"),
        ("LSYSTEM\n1\nF\n[ FF 1\n", "4:1"),
        ("LSYSTEM\n2\nF\nF FF 0.6\nF F 0.5\n", "5:5"),
        ("LSYSTEM\n1\nF\nF F[F 1\n", "4:4"),
        ("LSYSTEM\n1\nF\nF F]F[ 1\n", "4:4"),
        ("LSYSTEM\n0\nF[\n", "3:2"),
        ("LSYSTEM\n1\nF\nF F(1,2,3,4) 1\n", "4:3"),
        ("LSYSTEM\n0\nF>(1,2)\n", "3:2"),
        ("LSYSTEM\n0\nF|(1)\n", "3:2"),
        ("LSYSTEM\n0\nF(x)\n", "3:3"),
        ("LSYSTEM\n0\nF(1,)\n", "3:5"),
        ("LSYSTEM\n0\nF(1\n", "3:4"),
        ("LSYSTEM\n0\nF)\n", "3:2"),
    ],
)
def test_errors_name_their_place(text, where):
    with raises_error(LsystemError, place=f"tree.sys:{where}"):
        compile_program(parse_sys_text(text, "tree.sys"))


def test_what_is_not_text(tmp_path):
    path = tmp_path / "tree.sys"
    path.write_bytes(b"LSYSTEM\n1\n\xff\n")
    with raises_error(LsystemError, place="tree.sys:3:1"):
        parse_file(path)
