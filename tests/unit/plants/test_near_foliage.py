"""Leaves and needles of true size near a camera."""

from __future__ import annotations

from collections import defaultdict
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from silhouette_area import drawn

from forestgen.api.plant_requests import plan_of, request_of
from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh, surface_area_m2
from forestgen.geometry.patches import area_m2
from forestgen.plants.build import leaf_area_m2
from forestgen.plants.exemplar import Exemplar
from forestgen.plants.growing import ExemplarRequest, grow_exemplar
from forestgen.plants.near_foliage import (
    LEAF_PX,
    VEINED,
    NearOrgans,
    largest_pixel_m,
    near_organs,
    organ_sizes,
    with_near_foliage,
)
from forestgen.plants.organs.sprays import LeafKind, Needles, level_share, needle_spray, true_leaf
from forestgen.plants.organs.wear import worn

NAMES = ("spruce", "pine", "oak", "beech", "birch")
PIXELS_M = (0.0005, 0.004, 0.04)


@cache
def grown(name: str) -> tuple[ExemplarRequest, Exemplar]:
    request = request_of(plan_of(name, 0), name, 5.0, 0, "stand")
    return request, grow_exemplar(request)


def planned(name: str, pixel_m: float) -> tuple[NearOrgans | None, ...]:
    request, exemplar = grown(name)
    shapes, true_m = request.parameters.shapes, request.species.tissue.leaf_length_m
    return tuple(
        near_organs(shapes[one.shape], true_m, organ_sizes(one.frame), np.full(len(one.node), pixel_m))
        for one in exemplar.foliage
    )


def near(name: str, pixel_m: float) -> Exemplar:
    request, exemplar = grown(name)
    leaf_m = request.species.tissue.leaf_length_m
    return with_near_foliage(exemplar, request.parameters.shapes, leaf_m, planned(name, pixel_m))


def sheets_m2(exemplar: Exemplar) -> np.ndarray[Any, Any]:
    """Areas of the triangles of leaves."""
    corners = [one.mesh.vertices_m.astype(float)[one.mesh.faces] for one in exemplar.organs if one.part == Part.LEAF]
    a, b, c = np.concatenate(corners).transpose(1, 0, 2)
    return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("pixel_m", PIXELS_M)
def test_the_leaf_area_stays(name: str, pixel_m: float) -> None:
    request, exemplar = grown(name)
    shapes = request.parameters.shapes
    wanted = leaf_area_m2(exemplar.organs, shapes)
    assert leaf_area_m2(near(name, pixel_m).organs, shapes) == pytest.approx(wanted, rel=0.001)


@pytest.mark.parametrize("name", ["oak", "beech", "birch"])
def test_a_leaf_has_true_size_where_it_is_two_pixels_wide(name: str) -> None:
    request, exemplar = grown(name)
    leaf_m, [placed] = request.species.tissue.leaf_length_m, exemplar.foliage
    form = request.parameters.shapes[placed.shape]
    corners = true_leaf(form, leaf_m, 2)
    a, b, c = corners.points[corners.faces].transpose(1, 0, 2)
    true_m2 = float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
    limit_m = np.sqrt(true_m2) / LEAF_PX
    for factor, merged in ((0.5, 1), (0.99, 1), (1.38, 1), (1.42, 2), (2.05, 4)):  # powers of 2, rounded down
        pixel_m = np.full(1, factor * limit_m)
        one = near_organs(form, leaf_m, np.full(1, 3.0), pixel_m)
        assert one is not None
        assert one.merged == [merged]
        each_m2 = 9.0 * (exemplar_leaf_m2(form)) / float(one.number[0])
        assert each_m2 == pytest.approx(merged * true_m2, rel=0.2)
        assert merged == 1 or each_m2 < 1.2 * (LEAF_PX * float(pixel_m[0])) ** 2


def exemplar_leaf_m2(form: Any) -> float:
    mesh = form.template()
    a, b, c = mesh.vertices_m.astype(float)[mesh.faces].transpose(1, 0, 2)
    return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


@pytest.mark.parametrize("name", ["spruce", "pine"])
def test_no_needle_is_a_plate_near_a_camera(name: str) -> None:
    request, exemplar = grown(name)
    [form] = {request.parameters.shapes[one.shape] for one in exemplar.foliage}
    true_m2 = 0.8 * (request.species.tissue.leaf_length_m or form.needle_length_m) * form.needle_width_m
    assert np.median(sheets_m2(exemplar)) > 6.0 * true_m2
    assert sheets_m2(near(name, 0.0005)).max() < 2.0 * true_m2
    assert sheets_m2(near(name, 0.004)).max() < 2.0 * max(true_m2, (LEAF_PX * 0.004) ** 2)


def test_a_large_leaf_gives_way_to_many_of_the_species_length() -> None:
    request, exemplar = grown("oak")
    assert sum(int(one.number.sum()) for one in planned("oak", 0.003) if one is not None) >= sum(
        len(one.node) for one in exemplar.foliage
    )
    form, leaf_m = request.parameters.shapes["leaf"], request.species.tissue.leaf_length_m
    tall = near_organs(form, leaf_m, np.ones(1), np.full(1, 0.003))
    assert tall is not None
    assert tall.number == [6]  # 25 cm by 10.5 cm
    assert tall.detail == [2]


def along(mesh: Mesh) -> np.ndarray[Any, Any]:
    """(N, 3) directions of needles of one triangle each, from the middle of the base to the tip."""
    base, tip, other = mesh.vertices_m.astype(float)[mesh.faces].transpose(1, 0, 2)
    way = tip - 0.5 * (base + other)
    return np.asarray(way / np.linalg.norm(way, axis=1, keepdims=True))


def test_a_pines_needles_stand_all_around_its_shoots() -> None:
    form = grown("pine")[0].parameters.shapes["tuft"]
    spray = needle_spray(form, Needles(0.055, 120, 1, 0), 0.6, 0)  # so long that it has no side shoots
    way = along(spray.leaves)
    turn = np.arctan2(way[:, 2], way[:, 0])
    assert abs(np.mean(np.exp(1j * turn))) < 0.1
    assert abs(np.mean(np.exp(2j * turn))) < 0.1
    count = np.histogram(turn, bins=6, range=(-np.pi, np.pi))[0]
    assert count.min() > 0.6 * len(turn) / 6
    lean = np.degrees(np.arccos(way[:, 1]))
    assert 25.0 < np.median(lean) < 70.0
    foot = spray.leaves.vertices_m.astype(float)[spray.leaves.faces[:, [0, 2]]].mean(axis=1)
    assert np.hypot(foot[:, 0], foot[:, 2]).max() < 0.002  # on the shoot
    assert len(np.unique(np.round(foot[:, 1], 5))) == pytest.approx(60, abs=3)  # in pairs


def test_a_pines_shoots_shade_themselves_as_measured() -> None:
    """Silhouette over all of the needles' surface, mean of directions: 0.146, 0.079 to 0.308 (Stenberg et al. 1994)."""
    form = grown("pine")[0].parameters.shapes["tuft"]
    number = round(form.per_m * form.length_m)
    near = needle_spray(form, Needles(form.needle_length_m, number, 1, 0), form.length_m, 0).leaves
    ratio = []
    for mesh in (form.template(), near):
        shoot = SimpleNamespace(organs=[SimpleNamespace(mesh=mesh)], bounds_m=lambda: np.zeros((2, 3)))
        height = 1.0 - (2.0 * np.arange(12) + 1.0) / 12.0  # even over the sphere
        ways = np.stack([np.sqrt(1.0 - height**2), 0.0 * height, height], axis=1)
        turned = [(np.cos(2.4 * k) * x, np.sin(2.4 * k) * x, z) for k, (x, _, z) in enumerate(ways)]
        covered_m2 = np.mean([drawn(shoot, way, 0.001).sum() for way in turned]) * 0.001**2  # type: ignore[arg-type]
        ratio.append(covered_m2 / (2.0 * surface_area_m2(mesh)))
    far, close = ratio
    assert close == pytest.approx(0.146, rel=0.15)
    assert 0.146 < far < 0.2  # fewer and longer needles


@pytest.mark.parametrize(("name", "shape", "needle_m"), [("spruce", "young_shoot", 0.016), ("pine", "tuft", 0.055)])
def test_needles_are_as_level_as_those_of_the_coarse_shoot(name: str, shape: str, needle_m: float) -> None:
    form = grown(name)[0].parameters.shapes[shape]
    assert not form.crossed
    spray = needle_spray(form, Needles(needle_m, 1500, 1, 0), 0.3, 1)
    a, b, c = spray.leaves.vertices_m.astype(float)[spray.leaves.faces].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    assert np.sum(normal[:, 2] ** 2 / area) / area.sum() == pytest.approx(level_share(form), abs=0.03)


@pytest.mark.parametrize("name", ["spruce", "oak"])
def test_the_same_plant_is_made_again(name: str) -> None:
    one, two = near(name, 0.002), near(name, 0.002)
    assert [organ.material for organ in one.organs] == [organ.material for organ in two.organs]
    for first, second in zip(one.organs, two.organs, strict=True):
        np.testing.assert_array_equal(first.mesh.vertices_m, second.mesh.vertices_m)
        np.testing.assert_array_equal(first.mesh.faces, second.mesh.faces)


@pytest.mark.parametrize("name", ["spruce", "birch"])
def test_only_organs_that_a_camera_sees_change(name: str) -> None:
    request, exemplar = grown(name)
    shapes, leaf_m = request.parameters.shapes, request.species.tissue.leaf_length_m
    *leader, placed = exemplar.foliage
    pixel_m = np.full(len(placed.node), np.inf)
    assert not near_organs(shapes[placed.shape], leaf_m, organ_sizes(placed.frame), pixel_m).drawn.any()  # type: ignore[union-attr]
    high = placed.frame[:, 2, 3] > 3.5
    pixel_m[high] = 0.002
    one = near_organs(shapes[placed.shape], leaf_m, organ_sizes(placed.frame), pixel_m)
    assert one is not None
    np.testing.assert_array_equal(one.drawn, high)
    made = with_near_foliage(exemplar, shapes, leaf_m, (*[None] * len(leader), one))
    assert {organ.part for organ in made.organs} == {organ.part for organ in exemplar.organs}
    materials = {organ.material.removesuffix(VEINED) for organ in made.organs}
    assert materials == {organ.material for organ in exemplar.organs}
    low = next(organ.mesh.vertices_m for organ in exemplar.organs if organ.part == Part.LEAF)
    kept = next(organ.mesh.vertices_m for organ in made.organs if organ.organ is not None)
    assert {tuple(row) for row in kept.tolist()} <= {tuple(row) for row in low.tolist()}


@pytest.mark.parametrize("name", NAMES)
def test_far_away_no_organ_changes(name: str) -> None:
    request, exemplar = grown(name)
    limit_m = largest_pixel_m(request.parameters.shapes, exemplar.foliage)
    assert 0.001 < limit_m < 0.3
    assert not any(one is not None and one.drawn.any() for one in planned(name, 1.01 * limit_m))


def test_a_spruces_needles_stand_along_the_twigs_that_bear_its_shoots() -> None:
    _, exemplar = grown("spruce")
    placed = exemplar.foliage[-1]
    assert placed.twigs is not None
    low, high = placed.twigs.ends_m.astype(float).transpose(1, 0, 2)
    foot = placed.frame[:, :, 3].astype(float)
    # The uppermost piece of each shoot's twig ends below the shoot.
    nearest = np.full(len(foot), np.inf)
    np.minimum.at(nearest, placed.twigs.organ, np.linalg.norm(high - foot[placed.twigs.organ], axis=1))
    has = np.isfinite(nearest)
    assert has.mean() > 0.7
    assert np.median(nearest[has]) < 0.008
    made = near("spruce", 0.0005)
    needles = next(organ.mesh for organ in made.organs if organ.part == Part.LEAF)
    way = high - low
    long = np.linalg.norm(way, axis=1) > 0.05
    middle = 0.5 * (low + high)[long]
    corners = needles.vertices_m.astype(float)
    close = [np.sum(np.linalg.norm(corners - one, axis=1) < 0.02) for one in middle[:40]]
    assert np.mean(np.array(close) > 5) > 0.9


def test_worn_leaves_lack_pieces_and_no_more() -> None:
    request, _ = grown("beech")
    leaf = true_leaf(request.parameters.shapes["leaf"], 0.075, 2)
    for number in range(8):
        made = worn(leaf, np.random.default_rng(number))
        assert 0.6 < area_m2(made) / area_m2(leaf) < 1.0
        assert np.all(np.abs(made.points) <= np.abs(leaf.points).max(axis=0))


def test_single_leaves_are_of_their_kinds_in_their_shares() -> None:
    """In the mean of four seeds: of one, the share of area has a standard deviation of 0.0075 (32 seeds)."""
    request, exemplar = grown("birch")
    leaf = next(organ.material for organ in exemplar.organs if organ.part == Part.LEAF)
    kinds = {leaf: [LeafKind("dry", 0.1), LeafKind("summer", 0.9)]}
    leaf_m, drawn = request.species.tissue.leaf_length_m, planned("birch", 0.002)
    area: dict[str, float] = defaultdict(float)
    for seed in range(4):
        made = with_near_foliage(exemplar, request.parameters.shapes, leaf_m, drawn, kinds, seed=seed)
        for organ in made.organs:
            if organ.part == Part.LEAF:
                assert organ.mesh.uv is not None or not organ.material.endswith(VEINED)
                area[organ.material.removesuffix(VEINED)] += surface_area_m2(organ.mesh)
    assert set(area) == {f"{leaf} [dry]", f"{leaf} [summer]"}
    assert area[f"{leaf} [dry]"] / sum(area.values()) == pytest.approx(0.1, abs=0.02)


@pytest.mark.parametrize("name", ["spruce", "pine"])
def test_this_years_needles_have_their_share_at_the_tips(name: str) -> None:
    request, exemplar = grown(name)
    kinds = [LeafKind("dry", 0.05), LeafKind("new", 0.2, at_tip=True), LeafKind("summer", 0.75)]
    shapes, needle_m = request.parameters.shapes, request.species.tissue.leaf_length_m
    made = with_near_foliage(exemplar, shapes, needle_m, planned(name, 0.004), {"needle": kinds}, seed=3)
    area = {organ.material: surface_area_m2(organ.mesh) for organ in made.organs if "[" in organ.material}
    assert area["needle [new]"] / sum(area.values()) == pytest.approx(0.2, abs=0.01)
