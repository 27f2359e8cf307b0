"""Strand trees in the wind: one plant, many poses; and the leaves that it carries."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from forestgen.core.errors import RecipeError
from forestgen.geometry.mesh import surface_area_m2
from forestgen.plants.generators.strands import GENERATOR, Parameters, branching_of
from forestgen.plants.skeleton import OrganPlacements, Skeleton
from support.error_messages import raises_error

WINDY = {"speed_directed": 2.0, "speed_undirected": 5.0}


def parameters(**keys: Any) -> Parameters:
    plant = {
        "generator": "strands",
        "fit": "none",
        "wood": {"material": "bark"},
        "shapes": {"leaf": {"form": "simple", "material": "leaf", "length_m": 0.1, "width_m": 0.07}},
        "strands": 120,
        "stiffness": 0.2,
        "angle_jitter_deg": 5,
    }
    return Parameters.model_validate({**plant, **keys})


def frames(plant: Parameters, *times_s: float, seed: int = 4) -> list[Skeleton]:
    return list(GENERATOR.poses(plant, 12.0, 6.0, np.random.default_rng(seed), times_s))


def segment_lengths(skeleton: Skeleton) -> Any:
    way = skeleton.position_m[1:] - skeleton.position_m[skeleton.parent[1:]]
    return np.linalg.norm(way, axis=1)


def test_the_wind_moves_the_plant_and_keeps_its_segments() -> None:
    plant = parameters(wind=WINDY)
    still, *moving = frames(parameters(), 0.0) + frames(plant, 0.0, 1.0, 2.5)
    for one in moving:
        for name in ("parent", "axis", "order", "radius_m"):
            np.testing.assert_array_equal(getattr(one, name), getattr(still, name))
        np.testing.assert_allclose(segment_lengths(one), segment_lengths(still), atol=1e-5)
        assert np.abs(one.position_m - still.position_m).max() > 0.2
    assert np.abs(moving[0].position_m - moving[1].position_m).max() > 0.05


def test_a_short_time_moves_it_a_short_way() -> None:
    """The phases belong to the branches, so frames follow one another: speed is bounded as time steps shrink."""
    plant = parameters(wind=WINDY, leaves={"shape": "leaf"})

    def moved(dt: float) -> tuple[float, float]:
        a, b = frames(plant, 1.0, 1.0 + dt)
        leaf = np.abs(a.organs[0].frame - b.organs[0].frame)
        return float(np.abs(a.position_m - b.position_m).max()), float(leaf.max())

    far, near = moved(0.1), moved(0.01)
    for k in (0, 1):
        assert near[k] == pytest.approx(0.1 * far[k], rel=0.2)


def test_without_wind_or_with_full_stiffness_nothing_sways() -> None:
    for plant in (parameters(), parameters(wind={"speed_undirected": 5.0}, stiffness=1.0)):
        a, b = frames(plant, 0.0, 1.7)
        np.testing.assert_array_equal(a.position_m, b.position_m)


def test_a_sway_comes_round_after_two_pi_seconds() -> None:
    a, b, c = frames(parameters(wind=WINDY), 0.3, 0.3 + 2.0 * np.pi, 0.3 + np.pi)
    np.testing.assert_allclose(a.position_m, b.position_m, atol=1e-5)
    assert np.abs(a.position_m - c.position_m).max() > 0.05


def test_directed_wind_blows_the_crown_its_own_way() -> None:
    def top(**wind: Any) -> Any:
        (one,) = frames(parameters(wind=wind, angle_jitter_deg=0), 0.0)
        return one.position_m.astype(float).mean(axis=0)

    calm = top()
    assert (top(speed_directed=6.0) - calm)[0] > 0.3
    assert (top(speed_directed=6.0, axis=[-1, 0, 0]) - calm)[1] > 0.3
    assert top(speed_directed=6.0, axis=[0, 0, 1])[2] == pytest.approx(calm[2], abs=1e-4)
    thick = top(speed_directed=6.0, bends="thick") - calm
    assert thick[0] > 0.0


def test_thin_branches_bend_more_and_as_printed_thick_ones() -> None:
    b = branching_of(parameters(), 12.0, np.random.default_rng(0))
    first = np.flatnonzero(b.parent == 1)  # borne by the trunk's base, of all strands
    for bends, bent in (("thin", False), ("thick", True)):
        plant = parameters(wind={"speed_directed": 4.0, "bends": bends})
        still, blown = frames(parameters(), 0.0)[0], frames(plant, 0.0)[0]
        assert (np.abs(still.position_m[first] - blown.position_m[first]).max() > 1e-3) == bent


def test_the_pose_is_the_plant_that_the_generator_grows() -> None:
    plant = parameters(wind={**WINDY, "time_s": 1.3}, leaves={"shape": "leaf"}, fit="none")
    (one,) = frames(plant, 1.3, seed=9)
    wood_rng, *_ = np.random.default_rng(9).spawn(2)
    grown = GENERATOR.grow(plant, 12.0, 6.0, wood_rng)
    np.testing.assert_array_equal(one.position_m, grown.position_m)
    np.testing.assert_allclose(one.organs[0].frame, grown.organs[0].frame, atol=1e-6)


@pytest.mark.parametrize("how", ["stretch", "scale", "scale_all"])
def test_the_fit_is_that_of_the_plant_at_rest(how: Any) -> None:
    rule = {"shape": "leaf", "orders": [1, 2], "spacing_m": 0.2, "within_m": 1.0}
    keys = {"fit": how, "leaves": {"shape": "leaf"}, "foliage": [rule]}
    (rest,) = frames(parameters(**keys), 0.0)
    blown = frames(parameters(**keys, wind=WINDY), 0.0, 1.0)
    assert len(rest.organs) == 2
    assert rest.position_m[:, 2].max() == pytest.approx(12.0, abs=0.25)
    for one in blown:
        np.testing.assert_array_equal(one.radius_m, rest.radius_m)
        np.testing.assert_allclose(one.position_m[1], rest.position_m[1], atol=1e-5)  # the wind leaves the base alone
        for placed, at_rest in zip(one.organs, rest.organs, strict=True):
            size = np.cbrt(np.linalg.det(placed.frame[:, :, :3].astype(float)))
            np.testing.assert_allclose(size, np.cbrt(np.linalg.det(at_rest.frame[:, :, :3].astype(float))), rtol=1e-4)


def leaves_of(plant: Parameters) -> tuple[OrganPlacements, Skeleton]:
    skeleton = GENERATOR.grow(plant, 12.0, 6.0, np.random.default_rng(1))
    return skeleton.organs[0], skeleton


@pytest.mark.parametrize("arrangement", ["spiral", "stacked", "staggered", "bunched", "coniferous"])
def test_leaves_sit_on_branches_of_one_strand(arrangement: str) -> None:
    plant = parameters(leaves={"shape": "leaf", "arrangement": arrangement, "density": 6, "size_m": 0.25})
    placed, skeleton = leaves_of(plant)
    ends = np.setdiff1d(np.arange(1, len(skeleton.parent)), skeleton.parent)
    np.testing.assert_array_equal(np.unique(placed.node, return_counts=True), [ends, np.full(120, 6)])
    template = plant.shapes["leaf"].template()
    length = np.linalg.norm(placed.frame[:, :, 1], axis=1) * np.ptp(template.vertices_m[:, 1])
    np.testing.assert_allclose(length, 0.25, rtol=1e-4)
    tip, base = skeleton.position_m[placed.node], skeleton.position_m[skeleton.parent[placed.node]]
    along = np.linalg.norm(placed.frame[:, :, 3] - base, axis=1) + np.linalg.norm(placed.frame[:, :, 3] - tip, axis=1)
    np.testing.assert_allclose(along, np.linalg.norm(tip - base, axis=1), atol=1e-4)


def test_arrangements_differ_as_they_are_described() -> None:
    def of_one_branch(arrangement: str) -> tuple[Any, Any]:
        keys = {"shape": "leaf", "arrangement": arrangement, "density": 6, "angle_deg": 60}
        placed, skeleton = leaves_of(parameters(leaves=keys, angle_jitter_deg=0))
        node = placed.node[0]
        way = skeleton.position_m[node] - skeleton.position_m[skeleton.parent[node]]
        way = way / np.linalg.norm(way)
        return placed.frame[:6, :, 1].astype(float), (placed.frame[:6, :, 3] - skeleton.position_m[node]) @ way

    along, place = of_one_branch("stacked")
    np.testing.assert_allclose(place[::2], place[1::2], atol=1e-6)
    np.testing.assert_allclose(along[::2], along[[0, 0, 0]], atol=1e-5)
    assert np.abs(along[0] - along[1]).max() > 0.5
    along, place = of_one_branch("staggered")
    assert np.all(np.diff(place) > 0)
    np.testing.assert_allclose(along[::2], along[[0, 0, 0]], atol=1e-5)
    along, place = of_one_branch("bunched")
    np.testing.assert_allclose(place, 0.0, atol=1e-5)
    along, _ = of_one_branch("spiral")
    assert np.linalg.matrix_rank(along[:3] - along[1], tol=0.05) == 2
    assert min(np.linalg.norm(along[i] - along[j]) for i in range(6) for j in range(i)) > 0.3


def test_a_level_of_detail_keeps_the_leaf_area() -> None:
    def area(lod: int) -> float:
        plant = parameters(lod=lod, leaves={"shape": "leaf", "density": 5})
        placed, _ = leaves_of(plant)
        scale = np.linalg.det(placed.frame[:, :, :3].astype(float)) ** (2.0 / 3.0)
        return float(scale.sum()) * surface_area_m2(plant.shapes["leaf"].template())

    assert area(0) == pytest.approx(area(9), rel=1e-4)


def test_too_many_leaves_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("forestgen.plants.skeleton.free_bytes", lambda: 20_000_000)
    plant = parameters(leaves={"shape": "leaf", "density": 200})
    with raises_error(RecipeError, place="plant"):
        GENERATOR.grow(plant, 12.0, 6.0, np.random.default_rng(0))


def test_a_plant_with_a_variation_has_no_poses() -> None:
    with raises_error(RecipeError, place="plant.variation"):
        frames(parameters(variation={}), 0.0)
