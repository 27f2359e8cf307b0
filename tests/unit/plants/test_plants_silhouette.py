"""Lane's L-system 6.1: branch mapping, the silhouette, and the skeleton's promises."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plant_species import read
from pydantic import ValidationError

from forestgen.core.errors import RecipeError
from forestgen.core.randomness import child_rng
from forestgen.plants.branching import Shoots, grow, lateral_sites
from forestgen.plants.build import build_exemplar, size_m
from forestgen.plants.foliage import place
from forestgen.plants.generators.silhouette import GENERATOR, Order, Parameters, envelope, silhouette_length
from forestgen.plants.registry import GENERATORS
from forestgen.plants.skeleton import Skeleton
from forestgen.recipe.curves import Formula, Smooth, evaluate
from support.error_messages import raises_error

STILL = Order(
    longest_m=3.0,
    internode_m=((0.0, 0.3), (1.0, 0.1)),
    diameter_m=((0.0, 0.05), (1.0, 0.004)),
    branch_angle_deg=((0.0, 70.0), (1.0, 30.0)),
    branch_length=((0.0, 1.0), (1.0, 0.1)),
)


def shoots(*lengths: float) -> Shoots:
    n = len(lengths)
    up = np.tile([0.0, 0.0, 1.0], (n, 1))
    return Shoots(np.zeros((n, 3)), up, np.array(lengths), np.zeros(n, np.int64))


def test_a_short_branch_is_the_top_of_a_long_one() -> None:
    rng = np.random.default_rng(0)
    long = grow(shoots(3.0), STILL, rng)
    cut = 4
    short = grow(shoots(float(long.remaining_m[cut])), STILL, rng)
    np.testing.assert_allclose(short.remaining_m, long.remaining_m[cut + 1 :], atol=1e-12)
    np.testing.assert_allclose(short.relative, long.relative[cut + 1 :], atol=1e-12)
    shift = long.position_m[cut]
    np.testing.assert_allclose(short.position_m, long.position_m[cut + 1 :] - shift, atol=1e-12)
    angles = [lateral_sites(axis, STILL, np.random.default_rng(1)).angle_rad for axis in (short, long)]
    np.testing.assert_allclose(angles[0], angles[1][cut + 1 :], atol=1e-12)


def test_internodes_follow_int_len_and_add_up() -> None:
    grown = grow(shoots(3.0, 1.7, 0.02), STILL, np.random.default_rng(0))
    for axis, length in enumerate((3.0, 1.7, 0.02)):
        nodes = grown.axis == axis
        step = np.linalg.norm(np.diff(grown.position_m[nodes], axis=0, prepend=np.zeros((1, 3))), axis=1)
        assert step.sum() == pytest.approx(length)
        assert grown.remaining_m[nodes][-1] == 0.0
        start = 3.0 - length + np.cumsum(step) - step
        expected = evaluate(STILL.internode_m, start / 3.0)
        np.testing.assert_allclose(step[:-1], expected[:-1], rtol=1e-9)


def test_phyllotaxis_turns_by_its_angle() -> None:
    grown = grow(shoots(3.0), STILL, np.random.default_rng(0))
    out = lateral_sites(grown, STILL, np.random.default_rng(2)).direction
    turn = np.degrees(np.diff(np.arctan2(out[:, 1], out[:, 0]))) % 360.0
    np.testing.assert_allclose(np.minimum(turn, 360.0 - turn), 137.5, atol=1e-6)


@pytest.mark.parametrize("form", ["ellipsoid", "ovoid", "cone", "column"])
def test_envelope_is_a_share_that_closes_at_the_top(form: Any) -> None:
    u = np.linspace(0, 1, 501)
    values = envelope(form, u)
    assert values.min() >= 0
    assert values.max() == pytest.approx(1.0, abs=0.02)
    assert values[-1] == pytest.approx(0.0, abs=1e-9)
    assert np.all(envelope(form, np.array([-0.1, 1.1])) == 0)


def test_branches_end_on_the_ellipsoid() -> None:
    foot, angle = np.linspace(0.05, 0.95, 30), np.full(30, np.radians(60))
    length = silhouette_length("ellipsoid", foot, angle, 10.0, 4.0)
    r, z = length * np.sin(angle), foot * 10.0 + length * np.cos(angle)
    # a step of the search is 1/64 of half the width, and the slope turns it into more near the poles
    on = (r / 2.0) ** 2 + ((z - 5.0) / 5.0) ** 2
    assert np.all(on <= 1.0 + 1e-9 + 0.1)
    assert np.all(on >= 0.9)


HOURGLASS = ((0.0, 1.0), (0.5, 0.25), (1.0, 0.75))
FORMULA = Formula("0.2 + x * (1 - x)")


@pytest.mark.parametrize("drawn", [HOURGLASS, Smooth(HOURGLASS), FORMULA])
def test_a_drawn_silhouette_is_reached_by_horizontal_branches(drawn: Any) -> None:
    foot = np.linspace(0.0, 1.0, 21)
    length = silhouette_length(drawn, foot, np.full(21, np.pi / 2), 10.0, 4.0)
    greatest = evaluate(drawn, np.linspace(0, 1, 1001)).max()
    np.testing.assert_allclose(length, 2.0 * evaluate(drawn, foot) / greatest, atol=2.0 / 64 + 1e-9)


@pytest.mark.parametrize("drawn", [[[0, 0], [1, 0]], [[0, -1], [1, 1]], [[0, 1]], "hourglas", {"formula": "0 * x"}])
def test_a_silhouette_without_width_is_refused(drawn: Any) -> None:
    raw = read("poplar")[1].model_dump() | {"silhouette": drawn}
    with pytest.raises(ValidationError, match="silhouette"):
        Parameters.model_validate(raw)


def grown_size(name: str, seed: int, height_m: float, **changes: Any) -> tuple[float, float, float, float]:
    """Height and width asked for, height and width of the geometry."""
    traits, parameters = read(name)
    parameters = parameters.model_copy(update=changes)
    radius = (height_m / traits.allometry.height_m.scale) ** (1 / traits.allometry.height_m.exponent)
    exemplar = build_exemplar(name, traits, parameters, radius, child_rng(seed, name))
    return (*size_m(traits, radius), exemplar.height_m, exemplar.crown_width_m)


@pytest.mark.parametrize(
    ("name", "height_m", "changes"),
    [
        ("poplar", 12.0, {}),
        ("poplar", 2.0, {}),
        ("poplar", 9.0, {"silhouette": HOURGLASS}),
        ("poplar", 9.0, {"silhouette": FORMULA}),
        ("spruce", 14.0, {}),
        ("spruce", 1.0, {}),
        ("fireweed", 1.2, {}),
    ],
)
def test_height_and_width_of_the_geometry_are_the_plants(name: str, height_m: float, changes: dict[str, Any]) -> None:
    for seed in (1, 2):
        height, width, grown_height, grown_width = grown_size(name, seed, height_m, **changes)
        assert grown_height == pytest.approx(height, rel=0.03)
        assert grown_width == pytest.approx(width, rel=0.03)


@pytest.mark.parametrize(("longest_m", "internode_m"), [(24.0, 1e-6), (1000.0, 0.01)])
def test_an_endless_axis_is_refused(longest_m: float, internode_m: float) -> None:
    order = Order.model_validate({"longest_m": longest_m, "internode_m": internode_m})
    with raises_error(RecipeError, place="plant"):
        grow(shoots(longest_m), order, np.random.default_rng(0))


@pytest.mark.parametrize("bad", [0, -0.1, [[0, 0.1], [1, 0]], {"formula": "x"}])
def test_internodes_have_a_length(bad: Any) -> None:
    with pytest.raises(ValidationError, match="above 0"):
        Order.model_validate({"longest_m": 1.0, "internode_m": bad})


def test_twelve_orders_are_too_many() -> None:
    raw = read("poplar")[1].model_dump()
    raw["orders"] = raw["orders"] * 3
    with pytest.raises(ValidationError, match="at most 8"):
        Parameters.model_validate(raw)


def test_horizontal_branches_have_the_silhouettes_radius() -> None:
    length = silhouette_length("ellipsoid", np.array([0.5]), np.array([np.pi / 2]), 10.0, 4.0)
    assert length[0] == pytest.approx(2.0)


def check(skeleton: Skeleton) -> None:
    parent = skeleton.parent
    assert parent[0] == -1
    assert np.all(parent[1:] >= 0)
    assert np.all(parent < np.arange(len(parent)))
    for array in (skeleton.position_m, skeleton.radius_m):
        assert np.all(np.isfinite(array))
    assert np.all(skeleton.radius_m > 0)
    same = skeleton.axis[1:] == skeleton.axis[:-1]
    assert np.all(parent[1:][same] == np.arange(len(parent) - 1)[same]), "nodes of an axis are chained"
    assert np.all(np.diff(skeleton.radius_m)[same] <= 1e-7), "an axis thickens towards its tip"
    step = skeleton.order[1:].astype(int) - skeleton.order[parent[1:]]
    assert np.all((step == 0) | (step == 1))
    for organs in skeleton.organs:
        frame = organs.frame.astype(np.float64)
        assert np.all(np.isfinite(frame))
        assert np.all(np.linalg.det(frame[:, :, :3]) > 0)
        start, end = skeleton.position_m[np.maximum(parent[organs.node], 0)], skeleton.position_m[organs.node]
        way = (end - start).astype(np.float64)
        share = np.sum((frame[:, :, 3] - start) * way, axis=1) / np.maximum(np.sum(way**2, axis=1), 1e-18)
        nearest = start + np.clip(share, 0, 1)[:, None] * way
        assert np.linalg.norm(frame[:, :, 3] - nearest, axis=1).max(initial=0.0) < 0.01


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**32), size=st.floats(0.02, 1.0), name=st.sampled_from(["poplar", "spruce", "fireweed"]))
def test_skeleton_is_sound_at_every_size_and_seed(seed: int, size: float, name: str) -> None:
    height = size * {"poplar": 12.0, "spruce": 12.0, "fireweed": 1.6}[name]
    parameters, rng = read(name)[1], np.random.default_rng(seed)
    skeleton = GENERATOR.grow(parameters, height, 0.3 * height, rng)
    rules = [rule for rule in parameters.foliage if rule.suits(height)]
    check(replace(skeleton, organs=tuple(place(rule, skeleton, height, rng) for rule in rules)))


def test_same_seed_same_bytes(species: tuple[str, Any, Parameters]) -> None:
    name, _, parameters = species
    first, again, other = (GENERATOR.grow(parameters, 1.3, 0.4, child_rng(seed, name)) for seed in (7, 7, 8))
    assert first.position_m.tobytes() == again.position_m.tobytes()
    assert first.position_m.tobytes() != other.position_m.tobytes()


def test_a_sapling_has_fewer_orders_and_nodes() -> None:
    _, parameters = read("poplar")
    small = GENERATOR.grow(parameters, 0.5, 0.2, np.random.default_rng(1))
    large = GENERATOR.grow(parameters, 12.0, 3.0, np.random.default_rng(1))
    assert small.order.max() < large.order.max() == len(parameters.orders) - 1
    assert len(small.parent) < 60 < len(large.parent)


def test_parameters_refuse_nonsense() -> None:
    with pytest.raises(ValidationError, match="ascend"):
        Order(longest_m=1.0, internode_m=((0.5, 1.0), (0.1, 1.0)))
    with pytest.raises(ValidationError, match="thicken"):
        Order(longest_m=1.0, internode_m=((0.0, 0.1),), diameter_m=((0.0, 0.01), (1.0, 0.02)))
    with pytest.raises(ValidationError, match="forbidden"):
        Order.model_validate({"longest_m": 1.0, "internode_m": 0.1, "internod_m": 0.1})
    raw = read("poplar")[1].model_dump()
    raw["foliage"][0]["shape"] = "leef"
    with pytest.raises(ValidationError, match="leef"):
        Parameters.model_validate(raw)


def test_registry_knows_the_generator() -> None:
    assert GENERATORS.load("silhouette") is GENERATOR
    with raises_error(RecipeError):
        GENERATORS.load("silhouete")
