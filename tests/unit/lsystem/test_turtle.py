"""What the turtle draws, against invariants and a slow turtle in plain Python."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from turtle_oracle import UNIT, Oracle, encode, frame, picture, queries, segments

from forestgen.core.errors import LsystemError
from forestgen.lsystem.multiset import Multiset
from forestgen.lsystem.turtle import TurtleOptions, draw, draw_word, options_from, query_values
from support.error_messages import raises_error

DIALECTS = [options_from({}, name) for name in ("cpfg", "abop", "rhover")]


# --- what is drawn


def test_axes_lie_together_and_brackets_restore():
    drawing = picture("F[+F[+F]F][-F]F")
    np.testing.assert_array_equal(drawing.axis, [0, 0, 0, 1, 1, 2, 3])
    np.testing.assert_array_equal(drawing.order, [0, 0, 0, 1, 1, 2, 1])
    np.testing.assert_array_equal(drawing.parent, [-1, 0, 1, 1, 3, 3, 1])
    np.testing.assert_array_equal(drawing.module, [-1, 0, 14, 3, 8, 6, 12])
    np.testing.assert_array_equal(
        drawing.position[:, [0, 2]], [[0, 0], [0, 1], [0, 2], [-1, 1], [-2, 1], [-1, 0], [1, 1]]
    )


def test_a_move_ends_an_axis():
    drawing = picture("FfF[fF]")
    np.testing.assert_array_equal(drawing.is_drawn, [False, True, False, True, False, True])
    np.testing.assert_array_equal(drawing.axis, [0, 0, 1, 1, 2, 2])
    np.testing.assert_array_equal(drawing.order, [0, 0, 0, 0, 1, 1])
    assert len(picture("f(3)F").parent) == 2  # moves before all drawing only move the root
    np.testing.assert_array_equal(picture("f(3)F").position[0], [0, 0, 3])
    np.testing.assert_array_equal(picture("[f(3)F]F").position[0], [0, 0, 0])


def test_segments_without_length_are_not_drawn():
    assert len(picture("F(0)F(0)").parent) == 1
    assert len(picture("").parent) == 1


def test_widths_by_dialect():
    cpfg = options_from({"width": (1.0,), "width increment": (0.25,)}, "cpfg")
    np.testing.assert_allclose(segments(picture("F!F", cpfg))[:, 6:], [[1, 0.75], [0.75, 0.75]])
    np.testing.assert_allclose(
        segments(picture("F[!F]F#F", cpfg))[:, 6:], [[1, 1], [0.75, 0.75], [1, 1.25], [1.25, 1.25]]
    )
    np.testing.assert_allclose(segments(picture("F!!!!!!F", cpfg))[:, 6:], [[1, 0], [0, 0]])
    abop = options_from({"width": (1.0,), "width factor": (0.5,)}, "abop")
    np.testing.assert_allclose(segments(picture("F!F!(3)F", abop))[:, 6:], [[1, 1], [0.5, 0.5], [3, 3]])
    rhover = options_from({}, "rhover")
    np.testing.assert_allclose(
        segments(picture("FF(5)F(5,4)F(5,4,3)", rhover))[:, 6:], [[2, 1], [2, 1], [4, 1], [4, 3]]
    )
    assert picture("FF(5)", rhover).position[-1, 2] == 15


def test_colours():
    np.testing.assert_array_equal(picture("F;F;(7)F,F").colour, [0, 0, 1, 7, 6])
    np.testing.assert_array_equal(picture("F'F", options_from({}, "abop")).colour, [0, 0, 1])


def test_scale_is_metres_a_unit():
    text = "!(2)F(3)[+~K(2)]?P{F+F+F}"
    big, small = picture(text), picture(text, replace(UNIT, scale=0.1))
    for name in ("position", "radius", "start_radius"):
        np.testing.assert_allclose(getattr(small, name), 0.1 * getattr(big, name))
    np.testing.assert_allclose(small.surfaces.frame, 0.1 * big.surfaces.frame)
    np.testing.assert_allclose(small.polygons.vertex, 0.1 * big.polygons.vertex)
    np.testing.assert_allclose(queries("F(3)?P", replace(UNIT, scale=0.1)), [[0, 0, 0.3]])


def test_surfaces():
    drawing = picture("F[+F~K(2)]~L~M(1,2,3)F", surfaces=["K", "L", "M"])
    placed = drawing.surfaces
    assert placed.symbol.tolist() == ["K", "L", "M"]
    np.testing.assert_array_equal(drawing.position[placed.node], placed.frame[:, :, 3])
    x, y, z = np.array([1, 0, 0]), np.array([0, 0, 1]), np.array([0, -1, 0])  # -L, H, U
    np.testing.assert_allclose(placed.frame[1, :, :3], np.stack([x, y, z], axis=1))
    np.testing.assert_allclose(placed.frame[2, :, :3], np.stack([1 * x, 2 * y, 3 * z], axis=1))
    np.testing.assert_allclose(placed.frame[0, :, :3], 2 * np.stack([y, -x, z], axis=1))
    np.testing.assert_allclose(np.linalg.det(placed.frame[:, :, :3]), [8, 1, 6])
    two = picture("~K(2,5)").surfaces.frame[0, :, :3]
    np.testing.assert_allclose(np.linalg.norm(two, axis=0), 2)  # two parameters: the first scales all
    assert len(picture("~F").parent) == 1  # a surface's own name draws nothing


def test_polygons_of_both_kinds():
    by_moves = picture("{F+F+F+F}").polygons
    by_dots = picture("{.G+.G+.G+.G}").polygons
    assert by_moves.offset.tolist() == by_dots.offset.tolist() == [0, 4]
    np.testing.assert_allclose(np.roll(by_dots.vertex, -1, axis=0), by_moves.vertex, atol=1e-15)
    assert not picture("{F+F+F+F}").is_drawn.any()
    assert picture("{.G+.G+.G+.G}").is_drawn.sum() == 4
    nested = picture("F{.f.{.+f.[-f.]}f.}").polygons
    assert np.diff(nested.offset).tolist() == [5, 5]
    assert nested.node.tolist() == [1, 1]
    assert picture("{;{...};...}").polygons.colour.tolist() == [2, 1]  # as the turtle's at }
    assert picture("{..}").polygons.offset.tolist() == [0]


def test_a_generalized_cylinder_is_smooth():
    drawing = picture("!(2)@GsF(3)+(60)F(3)!(1)@Gc(40)+(60)F(3)@Ge(40)")
    assert len(drawing.parent) == 81
    assert set(drawing.axis) == {0}
    assert drawing.is_drawn[1:].all()
    steps = np.diff(drawing.position, axis=0)
    bends = np.einsum("ij,ij->i", steps[1:], steps[:-1]) / np.prod(
        np.linalg.norm(np.stack([steps[1:], steps[:-1]]), axis=2), axis=0
    )
    assert np.degrees(np.arccos(bends.min())) < 10
    np.testing.assert_allclose(drawing.position[40], queries("F(3)+(60)F(3)?P")[0])
    np.testing.assert_allclose(drawing.position[80], queries("F(3)+(60)F(3)+(60)F(3)?P")[0])
    np.testing.assert_allclose(2 * drawing.radius[[0, 20, 40, 80]], [2, 1.5, 1, 1])
    straight = picture("@GsF(3)@Ge")
    np.testing.assert_allclose(straight.position[:, :2], 0)
    assert (np.diff(straight.position[:, 2]) > 0).all()


# --- tropism


@given(st.floats(-180, 180), st.floats(-180, 180), st.floats(0.01, 1.0))
def test_tropism_turns_towards_its_vector_by_the_equation(turn, pitch, elasticity):
    options = options_from({"tropism": (0.3, -0.4, 0.5, elasticity)}, "abop")
    target = np.array(options.tropism)
    before, after = queries(f"+({turn})&({pitch})?HF?H", options)
    torque = np.linalg.norm(np.cross(before, target))
    angle = np.arctan2(np.linalg.norm(np.cross(before, after)), before @ after)
    assert angle == pytest.approx(elasticity * torque, abs=1e-9)
    assert after @ target >= before @ target - 1e-12
    still = options_from({"tropism": (0.3, -0.4, 0.5, 0.0)}, "abop")
    np.testing.assert_array_equal(*queries(f"+({turn})&({pitch})?HF?H", still))


def test_tropism_bends_a_shoot_down_and_acts_on_moves_in_cpfg_only():
    options = options_from({"tropism": (0.0, 0.0, -1.0, 0.2)}, "cpfg")
    headings = queries("+(10)" + "F?H" * 60, options)
    assert (np.diff(headings[:, 2]) <= 0).all()
    np.testing.assert_allclose(headings[-1], [0, 0, -1], atol=1e-2)
    assert frame("+f", options)[0, 2] < frame("+", options)[0, 2]
    abop = replace(options, dialect="abop")
    np.testing.assert_array_equal(frame("+f", abop), frame("+", abop))
    np.testing.assert_array_equal(frame("+_(0)F", options), frame("+", options))


# --- queries, random words


def test_queries_give_the_positions_of_nodes():
    text = "?PF?P[+F?P[&F?P]]/F?P"
    values, module = query_values(*encode(text), UNIT)
    drawing = picture(text)
    assert module.tolist() == [i for i, s in enumerate("?F?[+F?[&F?]]/F?") if s == "?"]
    for value, asked in zip(values[1:], module[1:], strict=True):
        np.testing.assert_array_equal(value, drawing.position[drawing.module == asked - 1][0])
    bare = picture(text.replace("?P", ""))
    np.testing.assert_array_equal(bare.position, drawing.position)


NUMBERS = st.floats(-200, 200).map(lambda x: round(x, 3))
LENGTHS = st.floats(0, 9).map(lambda x: round(x, 3))
PIECES = st.one_of(
    st.sampled_from(
        ["F", "f", "G", "+", "-", "&", "^", "\\", "/", "|", "$", "!", "<", ">", "@", "%", "#", ".", "X", "X(2,3)"]
    ),
    st.sampled_from(["?P", "?H", "?L", "?U"]),
    st.builds("{}({})".format, st.sampled_from(list("+-&^\\/<>@%#")), NUMBERS),
    st.builds("{}({})".format, st.sampled_from(["F", "f", "G", "!"]), LENGTHS),
    st.sampled_from(["_(0.3)", "_(1)", "_(0)", "_(-0.2)"]),  # above 1, bends overshoot and amplify roundings
    st.builds("F({},{},{})".format, LENGTHS, LENGTHS, LENGTHS),
)
WORDS = st.recursive(
    PIECES,
    lambda inner: st.builds(
        lambda parts, pair: pair[0] + "".join(parts) + pair[1],
        st.lists(inner, max_size=8),
        st.sampled_from(["[]", "{}", ("", "")]),
    ),
    max_leaves=60,
)


A_WORD = given(st.lists(WORDS, max_size=8).map("".join), st.sampled_from(DIALECTS))


@settings(max_examples=50, deadline=None)
@A_WORD
def test_random_words_as_the_slow_turtle_draws_them(text, options):
    as_the_slow_turtle(text, options)


@pytest.mark.slow
@settings(max_examples=800, deadline=None)
@A_WORD
def test_many_random_words_as_the_slow_turtle_draws_them(text, options):
    as_the_slow_turtle(text, options)


def as_the_slow_turtle(text, options):
    if options.dialect == "cpfg":
        text = text.replace("#", "X")  # the slow turtle knows one width symbol
    if options.dialect == "rhover":
        text = text.replace("{", "X").replace("}", "X").replace("_", "X").replace("$", "X").replace("!", "X")
    drawing, slow = picture(text, options), Oracle(text, options)
    near = {"rtol": 1e-9, "atol": 1e-8}
    expected = np.array([[*a, *b, c, d] for a, b, c, d in slow.segments]).reshape(-1, 8)
    np.testing.assert_allclose(segments(drawing), expected, **near)
    np.testing.assert_allclose(queries(text, options), np.array(slow.queries).reshape(-1, 3), **near)
    kept = [np.array(polygon) for polygon in slow.polygons if len(polygon) > 2]
    assert np.diff(drawing.polygons.offset).tolist() == [len(polygon) for polygon in kept]
    np.testing.assert_allclose(drawing.polygons.vertex, np.concatenate([np.zeros((0, 3)), *kept]), **near)
    check_tree(drawing)


def check_tree(drawing):
    """What a skeleton asks for."""
    n = len(drawing.parent)
    assert drawing.parent[0] == -1
    assert np.all(drawing.parent[1:] >= 0)
    assert np.all(drawing.parent < np.arange(n))
    assert np.all(np.isin(np.diff(drawing.axis), [0, 1]))
    chained = np.flatnonzero(np.diff(drawing.axis) == 0) + 1
    np.testing.assert_array_equal(drawing.parent[chained], chained - 1)


@given(st.lists(st.one_of(LENGTHS, st.sampled_from(["[", "+(33)", "&(21)"])), max_size=40))
def test_the_total_length_is_the_sum_of_the_parameters(parts):
    text = "".join(part if isinstance(part, str) else f"F({part})" for part in parts) + "]" * parts.count("[")
    drawn = segments(picture(text))
    total = np.linalg.norm(drawn[:, 3:6] - drawn[:, :3], axis=1).sum()
    assert total == pytest.approx(sum(part for part in parts if not isinstance(part, str)), abs=1e-9)


# --- errors


@pytest.mark.parametrize(
    "text",
    [
        "FF]F",
        "F[F",
        "[[]F[]",
        "F{[}]{",
        "F!(-1)F",
        "FF(nan)",
        "F(2)+(1)+(inf)",
        "F~",
        "[F~]",
        "F~Q(2)",
        "F@Gc",
        "@Gs[F@Ge]",
        "@GsF@Ge(0)",
        "{(1)}",
        "F(1e5)F(1e6)",
    ],
)
def test_errors_name_the_module(text):
    with raises_error(LsystemError):
        picture(text, surfaces=["K", "L"])


@pytest.mark.parametrize(
    "header",
    [
        {"angel": (1.0,)},
        {"angle": (1.0, 2.0)},
        {"tropism": (1.0,)},
        {"width": (-1.0,)},
        {"scale": (0.0,)},
        {"step": (float("nan"),)},
        {"heading": (0.0, 0.0, 0.0)},
        {"colour": (0.5,)},
        {"width factor": (0.5,), "width increment": (0.5,)},
    ],
)
def test_errors_of_options(header):
    with raises_error(LsystemError, place="weed.lsys"):
        options_from(header, "cpfg", where="weed.lsys")


def test_options_and_their_defaults():
    assert options_from({}, "cpfg") == TurtleOptions()
    found = options_from(
        {"angle": (22.5,), "tropism": (0, 0, -1, 0.2), "colour": (3.0,), "width increment": (0.1,)}, "abop"
    )
    assert (found.angle_deg, found.tropism, found.elasticity, found.colour) == (22.5, (0, 0, -1), 0.2, 3)
    assert (found.width_factor, found.width_increment) == (None, 0.1)
    with raises_error(LsystemError):
        options_from({}, "logo")


def test_a_word_among_others_and_arrays_that_cannot_be_written():
    code, parameter, kinds = encode("F(2)[+(30)F(1)]F(3)+(20)F(4)~K(2,3,4)")
    ends = np.array([0, 5, len(code)], dtype=np.int32)
    for array in (code, parameter):
        array.flags.writeable = False
    words = Multiset(kinds, code, parameter, ends, np.array([1, 2], np.uint32), np.zeros(2, np.int32))
    second = draw_word(words, 1, UNIT)
    expected = picture("F(3)+(20)F(4)~K(2,3,4)")
    np.testing.assert_array_equal(second.position, expected.position)
    np.testing.assert_array_equal(second.surfaces.frame, expected.surfaces.frame)
    np.testing.assert_array_equal(draw_word(words, 0, UNIT).position, picture("F(2)[+(30)F(1)]").position)
    assert len(draw(code, parameter, kinds, UNIT).parent) == 5
