"""From a turtle's drawing to a skeleton that the mesher takes."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forestgen.core.errors import LsystemError
from forestgen.lsystem.compiler import compile_program
from forestgen.lsystem.multiset import RESERVED, Kind
from forestgen.lsystem.parsing import parse_file, parse_text
from forestgen.lsystem.turtle import draw, options_from
from forestgen.plants.generators.turtle import draw_program, skeleton_of
from forestgen.recipe.assets import find_asset
from support.error_messages import raises_error
from support.swept import wood_mesh


def drawing_of(text, dialect="cpfg", **header):
    found = [
        (symbol, [float(x) for x in given.split(",")] if given else [])
        for symbol, given in re.findall(r"(\S)(?:\(([^()]*)\))?", text)
    ]
    kinds = list(dict.fromkeys([*RESERVED, *(Kind(symbol, len(given)) for symbol, given in found)]))
    code = np.array([kinds.index(Kind(symbol, len(given))) for symbol, given in found], dtype=np.uint16)
    parameter = np.array([x for _, given in found for x in given])
    return draw(code, parameter, kinds, options_from({name: (value,) for name, value in header.items()}, dialect))


def grown(listing, steps, seed):
    return skeleton_of(draw_program(compile_program(listing), steps, seed)[0])


def test_axes_become_those_of_the_skeleton():
    drawing = drawing_of("F[+F[&F]F]F", width=0.2)
    skeleton = skeleton_of(drawing)
    np.testing.assert_array_equal(skeleton.parent, drawing.parent)
    np.testing.assert_array_equal(skeleton.axis, drawing.axis)
    np.testing.assert_array_equal(skeleton.order, drawing.order)
    np.testing.assert_allclose(skeleton.position_m, drawing.position, atol=1e-6)
    np.testing.assert_allclose(skeleton.radius_m, 0.1)


def test_a_tapered_segment_widens_at_a_collar():
    skeleton = skeleton_of(drawing_of("FF[>F]F", "rhover"))
    np.testing.assert_allclose(skeleton.position_m[:6, 2], [0, 10, 10.2, 20, 20.2, 30], rtol=1e-6)
    np.testing.assert_allclose(skeleton.radius_m, [1, 0.5, 1, 0.5, 1, 0.5, 0.5])
    np.testing.assert_array_equal(skeleton.parent, [-1, 0, 1, 2, 3, 4, 3])
    np.testing.assert_array_equal(skeleton.axis, [0, 0, 0, 0, 0, 0, 1])


def test_what_begins_with_branches_gets_a_trunk():
    skeleton = skeleton_of(drawing_of("[+F[+F]][-F]"))
    np.testing.assert_array_equal(skeleton.axis, [0, 0, 1, 2])
    np.testing.assert_array_equal(skeleton.order, [0, 0, 1, 0])
    assert wood_mesh(skeleton, trunk=True, flare=0.0).triangles


def test_a_gap_is_a_thread():
    skeleton = skeleton_of(drawing_of("FfF[f&F]F", width=0.2))
    thin = skeleton.radius_m < 1e-5
    np.testing.assert_array_equal(thin, [False, False, True, False, False, True, False])
    np.testing.assert_array_equal(skeleton.axis, [0, 0, 1, 2, 2, 3, 4])
    np.testing.assert_array_equal(skeleton.order, [0, 0, 1, 1, 1, 1, 1])


def test_surfaces_become_organs():
    drawing = drawing_of("F[+F~K(2)]~L[fF~K]")
    leaf, flower = skeleton_of(drawing, {"K": "leaf"}).organs
    assert (leaf.shape, flower.shape) == ("leaf", "L")
    assert leaf.frame.shape == (2, 3, 4)
    skeleton = skeleton_of(drawing)
    np.testing.assert_allclose(skeleton.position_m[leaf.node], leaf.frame[:, :, 3])
    bud = skeleton_of(drawing_of("~K[fF~K]"))
    np.testing.assert_allclose(bud.position_m[bud.organs[0].node], bud.organs[0].frame[:, :, 3])


@pytest.mark.parametrize("text", ["", "f", "~K", "[fF]", "[f[F]F]"])
def test_without_wood_there_is_a_trunk_that_cannot_be_seen(text):
    skeleton = skeleton_of(drawing_of(text))
    assert wood_mesh(skeleton, trunk=True, flare=0.1).triangles
    assert skeleton.radius_m[1] < 1e-5


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.sampled_from(["F", "f", "+", "[", "]", "!(0.3)", "!(0.05)", "~K", "&"]), max_size=40),
    st.sampled_from(["cpfg", "abop", "rhover"]),
)
def test_random_drawings_can_be_meshed(parts, dialect):
    text, depth = "", 0
    for part in parts:
        if part == "]" and depth == 0:
            continue
        depth += (part == "[") - (part == "]")
        text += part
    text = (text + "]" * depth).replace("~K", "~K" if dialect != "rhover" else "K")
    skeleton = skeleton_of(drawing_of(text, dialect))
    chained = np.flatnonzero(np.diff(skeleton.axis) == 0) + 1
    np.testing.assert_array_equal(skeleton.parent[chained], chained - 1)
    assert np.all(np.isin(np.diff(skeleton.axis), [0, 1]))
    assert wood_mesh(skeleton, trunk=True, flare=0.1).triangles
    wood_mesh(skeleton, trunk=False, flare=0.1)
    drawn = drawing_of(text, dialect)
    widths = np.concatenate([drawn.radius, drawn.start_radius]).astype(np.float32)
    assert np.all(np.isin(skeleton.radius_m[skeleton.radius_m > 1e-5], widths))


@pytest.mark.parametrize("steps", [0, 1, 2, 3])
def test_the_age_of_a_plant_is_the_number_of_derivation_steps(steps):
    """Randleff-Rasmussen 2004: the tree of Figure 5.2 has six segments for each segment a step before."""
    skeleton = grown(parse_file(find_asset("lsystems", "fig_5_2")), steps, 1)
    assert np.sum(skeleton.radius_m > 1e-3) >= 6**steps
    trunk = skeleton.position_m[skeleton.order == 0]
    assert trunk[:, 2].max() == pytest.approx(10 * 2**steps, rel=1e-5)
    assert skeleton.order.max() == steps


def test_an_abop_plant_grows_from_its_file():
    skeleton = grown(parse_file(find_asset("lsystems", "weed")), 3, 0)
    assert np.sum(skeleton.parent >= 0) >= 5**3


def test_a_plant_that_dies_out_says_so():
    with raises_error(LsystemError, place="a.lsys"):
        grown(parse_text("axiom: A\nA --> *", "a.lsys"), 1, 0)
