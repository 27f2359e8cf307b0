"""Figures whose coordinates are known, and the turtle's frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from turtle_oracle import UNIT, frame, picture

from forestgen.lsystem.turtle import TurtleOptions, options_from


def rewrite(axiom, rules, steps):
    for _ in range(steps):
        axiom = "".join(rules.get(symbol, symbol) for symbol in axiom)
    return axiom


def path(text, options=UNIT):
    """Integer points of a figure of single steps, in the picture's plane: x to the right, z upwards."""
    points = picture(text, options).position[:, [0, 2]]
    np.testing.assert_allclose(points, np.round(points), atol=1e-9)
    return np.round(points).astype(int)


# --- the frame


def test_the_turtle_starts_upright_in_a_right_handed_frame():
    h, left, up = frame("")
    np.testing.assert_array_equal([h, left, up], [[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    np.testing.assert_array_equal(np.cross(up, h), left)


@pytest.mark.parametrize(
    "heading", [(1.0, 0.0, 0.0), (0.3, -2.0, 0.4), (0.0, 0.0, -3.0), (0.0, 0.0, 2.0), (1e-9, 0, -1)]
)
def test_any_heading_has_a_right_handed_frame(heading):
    h, left, up = frame("", TurtleOptions(heading=heading))
    np.testing.assert_allclose(h, np.array(heading) / np.linalg.norm(heading), atol=1e-12)
    np.testing.assert_allclose(np.array([h, left, up]) @ np.array([h, left, up]).T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.cross(h, left), up, atol=1e-12)


# Where H, L, U go in a turn of 90 degrees, by the words: left is L, down is -U; rolling left lowers L (abop), while
# cpfg's program, whose U points the other way, raises it.
QUARTERS = {
    "cpfg": {"+": "L -H U", "-": "-L H U", "&": "-U L H", "^": "U L -H", "\\": "H U -L", "/": "H -U L", "|": "-H -L U"},
    "abop": {"+": "L -H U", "-": "-L H U", "&": "-U L H", "^": "U L -H", "\\": "H -U L", "/": "H U -L", "|": "-H -L U"},
    "rhover": {
        "<": "-L H U",
        ">": "L -H U",
        "&": "H -U L",
        "@": "H U -L",
        "%": "-U L H",
        "#": "U L -H",
        "|": "-H -L U",
    },
}


@pytest.mark.parametrize(("dialect", "symbol"), [(d, s) for d, table in QUARTERS.items() for s in table])
def test_quarter_turns(dialect, symbol):
    options = options_from({"angle": (90.0,)}, dialect)
    before = dict(zip("HLU", frame("", options), strict=True))
    before |= {"-" + name: -vector for name, vector in before.items()}
    expected = [before[name] for name in QUARTERS[dialect][symbol].split()]
    np.testing.assert_array_equal(frame(symbol, options), expected)


def test_abop_matrices_read_by_rows():
    """ABOP p. 19: the rows of R_U, R_L and R_H act on H, L, U."""
    c, s = np.cos(0.3), np.sin(0.3)
    matrices = {
        "+": [[c, s, 0], [-s, c, 0], [0, 0, 1]],
        "&": [[c, 0, -s], [0, 1, 0], [s, 0, c]],
        "\\": [[1, 0, 0], [0, c, -s], [0, s, c]],
    }
    options = options_from({}, "abop")
    for symbol, matrix in matrices.items():
        turned = frame(f"{symbol}({np.degrees(0.3)})", options)
        np.testing.assert_allclose(turned, np.array(matrix) @ frame("", options), atol=1e-15)


def test_the_frame_stays_orthonormal():
    rng = np.random.default_rng(1)
    turns = [
        f"{'+-&^/|'[k]}" if k == 5 else f"{'+-&^/'[k]}({a})"
        for k, a in zip(rng.integers(0, 6, 100_000), rng.uniform(-400, 400, 100_000), strict=True)
    ]
    end = frame("".join(turns))
    np.testing.assert_allclose(end @ end.T, np.eye(3), atol=1e-13)
    np.testing.assert_allclose(np.cross(end[0], end[1]), end[2], atol=1e-13)


@given(st.floats(-1e4, 1e4), st.sampled_from(["+-", "&^", "\\/"]), st.sampled_from(["cpfg", "abop"]))
def test_a_turn_and_its_inverse(angle, pair, dialect):
    options = options_from({}, dialect)
    start = "+(20)&(30)/(40)"
    there_and_back = f"{start}{pair[0]}({angle}){pair[1]}({angle})"
    np.testing.assert_allclose(frame(there_and_back, options), frame(start, options), atol=1e-12)
    np.testing.assert_allclose(
        frame(f"{start}{pair[0]}({-angle})", options), frame(f"{start}{pair[1]}({angle})", options), atol=1e-12
    )


def test_levelling_makes_left_horizontal_and_keeps_the_heading():
    before, after = frame("+(20)&(70)/(33)"), frame("+(20)&(70)/(33)$")
    np.testing.assert_allclose(after[0], before[0], atol=1e-15)
    assert abs(after[1][2]) < 1e-15
    assert after[2][2] > 0
    np.testing.assert_allclose(after[1], np.cross([0, 0, 1], after[0]) / np.hypot(*after[0][:2]), atol=1e-12)
    np.testing.assert_array_equal(frame("/(33)$"), frame("/(33)"))  # heading up: no level there


# --- figures


def test_quadratic_koch_island():
    """ABOP Fig. 1.6: a closed curve that keeps the area of the square it grew from, in its own unit."""
    for n in range(4):
        points = path(rewrite("F-F-F-F", {"F": "F-F+F+FF-F-F+F"}, n))
        assert len(points) == 4 * 8**n + 1
        np.testing.assert_array_equal(points[0], points[-1])
        x, z = points.T
        assert abs(np.sum(x[:-1] * z[1:] - x[1:] * z[:-1])) / 2 == 16**n


def test_koch_curve_end():
    options = replace(UNIT, angle_deg=60.0)
    drawing = picture(rewrite("F", {"F": "F+F--F+F"}, 6), options)
    np.testing.assert_allclose(drawing.position[-1], [0, 0, 3**6], atol=1e-9)
    height = -drawing.position[:, 0].min()  # + is to the left
    np.testing.assert_allclose(height, 3**6 * np.sqrt(3) / 6, rtol=1e-12)


@pytest.mark.parametrize("n", range(13))
def test_dragon(n):
    """The dragon of 2^n steps is (-1 + i)^n or its mirror image, up to quarter turns; it crosses no edge twice."""
    points = path(rewrite("FX", {"X": "X+YF+", "Y": "-FX-Y"}, n))
    assert np.sum((points[-1] - points[0]) ** 2) == 2**n
    edges = {tuple(sorted(map(tuple, edge))) for edge in np.stack([points[:-1], points[1:]], axis=1).tolist()}
    assert len(edges) == 2**n


def test_plane_hilbert_curve():
    points = path(rewrite("L", {"L": "+RF-LFL-FR+", "R": "-LF+RFR+FL-"}, 5))
    span = points.max(axis=0) - points.min(axis=0)
    np.testing.assert_array_equal(span, [31, 31])
    assert len({tuple(p) for p in points.tolist()}) == 32 * 32 == len(points)


@pytest.mark.parametrize("dialect", ["cpfg", "abop"])
@pytest.mark.parametrize("n", [1, 2, 3])
def test_hilbert_curve_fills_a_cube(n, dialect):
    """ABOP Fig. 1.19; with the roll of either dialect, each lattice point once."""
    rules = {
        "A": "B-F+CFC+F-D&F^D-F+&&CFC+F+B//",
        "B": "A&F^CFB^F^D^^-F-D^|F^B|FC^F^A//",
        "C": "|D^|F^B-F+C^F^A&&FA&F^C+F+B^F^D//",
        "D": "|CFB-F+B|FA&F^A&&FB-F+B|FC//",
    }
    drawing = picture(rewrite("A", rules, n), options_from({"angle": (90.0,)}, dialect))
    points = np.round(drawing.position).astype(int)
    np.testing.assert_allclose(drawing.position, points, atol=1e-9)
    assert len({tuple(p) for p in points.tolist()}) == 8**n == len(points)
    np.testing.assert_array_equal(points.max(axis=0) - points.min(axis=0), [2**n - 1] * 3)
