"""Plants of branch modules: the wood as it grew, twigs where it is thin, marks on every triangle."""

from __future__ import annotations

from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
from grown_wood import parameters, wood
from pydantic import ValidationError

from forestgen.core.errors import RecipeError
from forestgen.core.parts import Part
from forestgen.plants.build import build_exemplar, estimate_triangles
from forestgen.plants.generators.branch_modules import (
    FIRST_TWIG_ORDER,
    GENERATOR,
    _flat_topped,
    _rank_on_axis,
    _straightened,
)
from forestgen.plants.grown import ModuleWood, wood_key, wood_skeleton
from support.error_messages import raises_error

SPECIES = SimpleNamespace(materials={"bark": 0, "twig": 0, "leaf": 0})


def grown(graph=None, pixel_m=0.0, seed=3, **changes):
    rng = np.random.default_rng(seed)
    graph = graph or wood()
    return build_exemplar("oak", SPECIES, parameters(**changes), 1.0, rng, pixel_m=pixel_m, wood=graph)


def bare(graph, *, smooth=True, crook=0.05):
    none = np.zeros(len(graph), dtype=bool)
    return wood_skeleton(graph, none, 1.0, smooth=smooth, crook=crook, rng=np.random.default_rng(0))


@pytest.mark.parametrize("smooth", [True, False])
def test_the_wood_runs_through_the_graphs_nodes_with_their_diameters(smooth):
    graph, made = wood(), bare(wood(), smooth=smooth).skeleton
    for row in range(1, len(graph) - 1):
        away = np.linalg.norm(made.position_m - graph.position_m[row], axis=1)
        nearest = int(np.argmin(away))
        assert away[nearest] < 1e-6
        assert 2 * made.radius_m[nearest] == pytest.approx(graph.diameter_m[row], rel=1e-6)
        assert made.mark[nearest] == graph.mark[row]


def test_phyllotaxis_counts_the_nodes_that_bear_along_each_axis():
    np.testing.assert_array_equal(_rank_on_axis(np.array([0, 0, 0, 1, 2, 2, 1])), [0, 1, 2, 0, 0, 1, 1])
    assert len(_rank_on_axis(np.empty(0, dtype=np.int64))) == 0


def test_axes_are_chains_that_follow_the_main_branches():
    made = bare(wood()).skeleton
    chained = np.diff(made.axis) == 0
    np.testing.assert_array_equal(made.parent[1:][chained], np.arange(len(made.parent) - 1)[chained])
    ends = [set(made.mark[made.axis == axis].tolist()) - {64} for axis in range(int(made.axis.max()) + 1)]
    assert ends == [{65, 66, 68}, {67, 70}, {69}, {71}]
    assert [int(made.order[made.axis == axis][0]) for axis in range(4)] == [0, 1, 1, 2]


def test_a_stem_goes_on_in_the_thick_branch_where_its_own_end_is_a_twig():
    graph = wood()
    thin = np.where(np.isin(np.arange(9), [2, 4, 8]), 0.04, graph.diameter_m)  # the fork's other branch has 0.1
    made = bare(replace(graph, diameter_m=thin)).skeleton
    assert set(made.mark[made.axis == 0].tolist()) - {64} == {65, 67, 70}


def test_a_curve_leaves_no_corner_and_stays_near_the_graph():
    graph, made = wood(), bare(wood(), crook=0.0).skeleton
    way = made.position_m[1:] - made.position_m[:-1]
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    same = (made.axis[2:] == made.axis[1:-1]) & (made.axis[1:-1] == made.axis[:-2])
    bend = np.degrees(np.arccos(np.clip(np.sum(way[1:] * way[:-1], axis=1), -1, 1)))[same]
    assert bend.max() < 16
    straight = np.degrees(np.arccos(np.clip(np.dot([0.1, 0, 2], [0.2, 0.2, 1.5]) / 2.0025 / 1.5264, -1, 1)))
    assert straight > 7  # the graph itself bends
    assert made.volume_m3() == pytest.approx(bare(graph, smooth=False, crook=0.0).skeleton.volume_m3(), rel=0.05)


def test_twigs_stand_on_thin_wood_alone_and_go_on_from_free_terminals():
    graph = wood()
    made = GENERATOR.clothe(parameters(), graph, graph.height_m, np.random.default_rng(1))
    first = np.flatnonzero(np.diff(made.axis, prepend=-1))
    twigs = first[made.order[first] == FIRST_TWIG_ORDER]
    bearer = made.parent[twigs]
    assert len(twigs) > 15
    assert set(made.mark[bearer].tolist()) == {68, 69, 70, 71}
    assert np.all(2 * made.radius_m[bearer] < 0.14)
    for row in (4, 5, 6, 7):  # free terminals
        at = np.linalg.norm(made.position_m[bearer] - graph.position_m[row], axis=1)
        assert np.sum(at < 1e-6) == 1
    assert np.all(made.radius_m[twigs] <= 0.7 * made.radius_m[bearer] + 1e-7)
    sides = first[made.order[first] == FIRST_TWIG_ORDER + 1]
    assert np.all(made.order[made.parent[sides]] == FIRST_TWIG_ORDER)


def test_a_dead_plant_loses_its_twigs_with_the_years_and_keeps_those_that_are_left():
    def twigs(dead_yr):
        skeleton = GENERATOR.clothe(parameters(), replace(wood(), dead_yr=dead_yr), 5.0, np.random.default_rng(0))
        twig = skeleton.order == FIRST_TWIG_ORDER
        feet = twig & ~twig[skeleton.parent]
        return {tuple(place) for place in skeleton.position_m[skeleton.parent[feet]].tolist()}, len(skeleton.parent)

    living, nodes = twigs(None)
    fresh, after_four, after_forty = twigs(0.0), twigs(4.0), twigs(40.0)
    assert fresh == (living, nodes)
    assert 0.3 * len(living) < len(after_four[0]) < 0.7 * len(living)
    assert after_forty[0] < after_four[0] < living
    assert after_forty[1] < after_four[1] < nodes


def test_young_segments_bear_shorter_twigs():
    def reach(share):
        graph = replace(wood(), age_share=np.full(9, share))
        made = GENERATOR.clothe(parameters(foliage=[]), graph, 5.0, np.random.default_rng(1))
        way = made.position_m - made.position_m[np.maximum(made.parent, 0)]
        return float(np.linalg.norm(way, axis=1)[made.order >= FIRST_TWIG_ORDER].sum())

    lengths = [reach(share) for share in (0.0, 0.35, 1.0)]
    assert lengths[0] < 0.6 * lengths[2]
    assert lengths == sorted(lengths)


def test_every_triangle_of_the_wood_lies_at_the_segment_of_its_mark():
    graph = wood()
    plant = grown(graph, foliage=[], twigs=[], crook=0.02)
    tested = 0
    for organ in plant.organs:
        centre = organ.mesh.vertices_m[organ.mesh.faces].mean(axis=1).astype(np.float64)
        row = organ.mark.astype(int) - 64
        a, b = graph.position_m[graph.parent[row]], graph.position_m[row]
        share = np.clip(np.sum((centre - a) * (b - a), axis=1) / np.sum((b - a) ** 2, axis=1), 0, 1)
        away = np.linalg.norm(centre - a - share[:, None] * (b - a), axis=1)
        thick = np.maximum(graph.diameter_m[graph.parent[row]], graph.diameter_m[row])
        assert np.all(away[centre[:, 2] > 0] < 1.1 * thick[centre[:, 2] > 0])  # a root flare is wide
        gaps = np.linalg.norm(centre[:, None] - graph.position_m, axis=2)
        clear = (gaps.min(axis=1) > 0.25) & (centre[:, 2] > 0)  # of forks, where tubes lie within one another
        nearest = np.array([_nearest_row(graph, point) for point in centre[clear]])
        np.testing.assert_array_equal(nearest, row[clear])
        tested += int(clear.sum())
    assert tested > 100


def _nearest_row(graph, point):
    a, b = graph.position_m[graph.parent[1:8]], graph.position_m[1:8]
    share = np.clip(np.sum((point - a) * (b - a), axis=1) / np.sum((b - a) ** 2, axis=1), 0, 1)
    gap = np.linalg.norm(point - a - share[:, None] * (b - a), axis=1) - 0.5 * graph.diameter_m[1:8]
    return 1 + int(np.argmin(gap))


@pytest.mark.parametrize("pixel_m", [0.0, 0.2, 0.4])
def test_leaves_carry_the_mark_of_the_segment_that_their_twig_stands_on(pixel_m):
    plant = grown(pixel_m=pixel_m)
    marks = plant.marks()
    assert len(marks) == plant.triangles
    assert set(np.unique(marks).tolist()) <= set(range(64, 72))
    [leaves] = [organ for organ in plant.organs if organ.part == Part.LEAF]
    assert set(np.unique(leaves.mark).tolist()) == {68, 69, 70, 71}
    centre = leaves.mesh.vertices_m[leaves.mesh.faces].mean(axis=1)
    graph = wood()
    for mark in (68, 69, 70, 71):
        row = mark - 64
        low = np.minimum(graph.position_m[row], graph.position_m[graph.parent[row]]) - 0.9
        high = np.maximum(graph.position_m[row], graph.position_m[graph.parent[row]]) + 0.9
        assert np.all((centre[leaves.mark == mark] > low) & (centre[leaves.mark == mark] < high))


def test_the_same_plant_gives_the_same_bytes_and_other_twigs_to_another():
    one, again, other = grown(), grown(), grown(seed=4)
    for a, b in zip(one.organs, again.organs, strict=True):
        np.testing.assert_array_equal(a.mesh.vertices_m, b.mesh.vertices_m)
    assert not np.array_equal(one.organs[-1].mesh.vertices_m[:9], other.organs[-1].mesh.vertices_m[:9])


def test_a_seedling_of_a_few_centimetres_and_one_without_length_have_leaves():
    for scale in (0.02, 0.0):
        plant = grown(wood(scale))
        assert plant.triangles
        assert any(organ.part == Part.LEAF for organ in plant.organs)
        assert plant.height_m < 0.3


def test_a_segment_without_length_hands_its_children_to_its_parent():
    graph = wood()
    place = graph.position_m.copy()
    place[3] = place[1]  # its two branches begin at node 1 then
    made = bare(replace(graph, position_m=place)).skeleton
    assert set(np.unique(made.mark).tolist()) == {64, 65, 66, 68, 69, 70, 71}
    ends = made.position_m[[np.flatnonzero(made.mark == mark)[0] for mark in (70, 71)]]
    starts = made.position_m[made.parent[[np.flatnonzero(made.mark == mark)[0] for mark in (70, 71)]]]
    np.testing.assert_allclose(starts, np.repeat(place[1:2], 2, axis=0), atol=1e-6)
    assert len(ends) == 2


def test_triangles_are_estimated_within_a_third():
    plant = grown()
    assert estimate_triangles(parameters(), wood(), np.random.default_rng(9)) == pytest.approx(
        plant.triangles, rel=0.34
    )


def test_the_key_of_a_plant_knows_all_of_its_wood():
    keys = {wood_key(wood())}
    for field in fields(wood()):
        value = getattr(wood(), field.name)
        if value is None:
            value = 3.0
        else:
            value = value.copy()
            value[-1] = not value[-1] if value.dtype == bool else value[-1] + 1
        keys.add(wood_key(replace(wood(), **{field.name: value})))
    assert len(keys) == 1 + len(fields(wood()))


def test_alone_the_generator_says_that_it_needs_a_community():
    with raises_error(RecipeError, place="plant.generator"):
        GENERATOR.grow(parameters(), 5.0, 3.0, np.random.default_rng(0))


def test_plants_with_branches_of_their_own_do_not_vary():
    with pytest.raises(ValidationError, match="variation"):
        parameters(variation={})


def test_angular_wood_is_straight_between_forks_and_umbrellas_keep_their_top() -> None:
    parent = np.array([-1, 0, 1, 2, 3, 3, 4, 4])
    place = np.array(
        [[0, 0, 0], [0.3, 0, 1], [-0.2, 0.1, 2], [0.3, 0, 3], [0, 0, 4], [1, 1, 3.4], [1, 0, 5], [-1, 0, 4.8]],
        dtype=float,
    )
    thick = np.array([0.3, 0.3, 0.3, 0.3, 0.3, 0.02, 0.2, 0.2])
    ones = np.ones(8)
    zigzag = ModuleWood(parent, place, thick, ones, ones, ones, ones > 0, np.arange(8, dtype=np.uint32))
    straight = _straightened(zigzag, 1.0).position_m
    assert np.allclose(straight[[0, 4, 5, 6, 7]], place[[0, 4, 5, 6, 7]])  # forks and ends stay
    assert np.allclose(straight[1:4, :2], 0.0)
    assert (np.diff(straight[:5, 2]) > 0.0).all()
    flat = _flat_topped(zigzag, 2.0).position_m[:, 2]
    assert flat.max() == place[:, 2].max()
    assert (flat >= place[:, 2]).all()
    assert (np.argsort(flat) == np.argsort(place[:, 2])).all()
