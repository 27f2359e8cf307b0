"""Twigs that fill a tree's crown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.distance import cdist

from forestgen.api.plant_requests import plan_of, request_of
from forestgen.plants import build, crown_twigs
from forestgen.plants.crown_twigs import TWIG_ORDER, CrownTwigs, Leaves, _gathered
from forestgen.plants.generators.strands import StrandGenerator
from forestgen.plants.growing import grow_exemplar
from forestgen.plants.skeleton import Skeleton
from forestgen.plants.tree_fit import fit_tree
from forestgen.recipe.tree_sizes import Grown

BROAD = ("beech", "birch", "maple", "oak", "poplar")


def stem(height_m: float = 10.0, nodes: int = 21) -> Skeleton:
    position = np.zeros((nodes, 3))
    position[:, 2] = np.linspace(0.0, height_m, nodes)
    own = np.zeros(nodes, dtype=np.int64)
    return Skeleton.of(np.arange(nodes) - 1, position, np.full(nodes, 0.02), own, own)


def grown(
    name: str, height_m: float, monkeypatch: pytest.MonkeyPatch, seed: int = 1, where: Grown = "stand"
) -> Skeleton:
    """The skeleton that an exemplar is meshed from."""
    found: list[Skeleton] = []

    def kept(*arguments: object) -> object:
        fitted = fit_tree(*arguments)  # type: ignore[arg-type]
        found.append(fitted.skeleton)
        return fitted

    monkeypatch.setattr(build, "fit_tree", kept)
    grow_exemplar(request_of(plan_of(name, 0), name, height_m, seed, where))
    return found[-1]


def seats(tree: Skeleton) -> list[float]:
    """Greatest distance of an organ's foot from the segment that bears it, metres, by rule."""
    found = []
    for one in tree.organs:
        start = tree.position_m[tree.parent[one.node]].astype(np.float64)
        foot, way = one.frame[:, :, 3] - start, tree.position_m[one.node] - start
        along = np.clip(np.sum(foot * way, axis=1) / np.sum(way * way, axis=1), 0.0, 1.0)
        found.append(float(np.linalg.norm(foot - along[:, None] * way, axis=1).max()))
    return found


def test_without_other_costs_the_twigs_are_the_shortest_tree(monkeypatch: pytest.MonkeyPatch) -> None:
    """The sum of all ways is that of SciPy's minimum spanning tree, the wood's own ways left out."""
    tips = np.random.default_rng(3).uniform([-3, -3, 3], [3, 3, 10], (150, 3))
    wood = stem()
    for name in ("TURN_COST", "PATH_COST", "THICK_COST"):
        monkeypatch.setattr(crown_twigs, name, 0.0)
    monkeypatch.setattr(crown_twigs, "_NEAREST", len(wood.parent))
    # Compiled kernels keep the constants that they were compiled with.
    monkeypatch.setattr(crown_twigs, "_way_cost", crown_twigs._way_cost.py_func)
    monkeypatch.setattr(crown_twigs, "_span", crown_twigs._span.py_func)
    order, bearer = crown_twigs._spanned(wood, tips, CrownTwigs(replaces_below_m=0.01, leaves_each=5))
    points = np.concatenate([wood.position_m.astype(np.float64), order])
    made = np.linalg.norm(order - points[bearer], axis=1).sum()
    length = cdist(points, points)
    own = len(wood.parent)
    length[:own, :own] = 1e-6  # the wood is one piece already; less would count as no way at all
    assert made == pytest.approx(minimum_spanning_tree(length).sum(), rel=1e-5)
    assert np.all(bearer < own + np.arange(len(order)))  # bearers come first


def test_twigs_that_rather_grow_level_do() -> None:
    """The mean steepness of ways falls; the same tips are reached."""
    tips, wood = np.random.default_rng(3).uniform([-3, -3, 3], [3, 3, 10], (400, 3)), stem()
    steep = []
    for level in (0.0, 1.5):
        order, bearer = crown_twigs._spanned(wood, tips, CrownTwigs(replaces_below_m=0.01, leaves_each=5, level=level))
        assert sorted(order.tolist()) == sorted(tips.tolist())
        way = order - np.concatenate([wood.position_m.astype(np.float64), order])[bearer]
        steep.append(np.mean(np.abs(way[:, 2]) / np.linalg.norm(way, axis=1)))
    assert steep[1] < 0.75 * steep[0]


def test_points_thin_out_where_others_shade_them() -> None:
    """In a cylinder, leaf area over depth is ln(1 + (exp(k L) - 1) v) / k; without shade, and across, it is even."""
    hull = crown_twigs._Hull(2.0, 12.0, np.full((48, 24), 3.0))
    for leaf_area_index in (0.0, 2.0, 6.0):
        extinct = crown_twigs.EXTINCTION * leaf_area_index
        points, _ = hull.spread(6000, extinct * np.pi * 3.0**2, np.random.default_rng(1))
        depth = (12.0 - points[:, 2]) / 10.0
        for v in (0.25, 0.5, 0.75):
            expected = v if extinct == 0.0 else np.log1p(np.expm1(extinct) * v) / extinct
            assert np.mean(depth < v) == pytest.approx(expected, abs=0.01)
        away = np.hypot(points[:, 0], points[:, 1])
        assert np.mean(away < 3.0 / np.sqrt(2.0)) == pytest.approx(0.5, abs=0.02)
        assert np.hypot(*points[:, :2].mean(axis=0)) < 0.05


@pytest.mark.parametrize(("radius_m", "extinct_m2"), [(1e-3, 20.0), (1e-3, 0.0), (3.0, 1e6)])
def test_points_of_strange_crowns_lie_in_them(radius_m: float, extinct_m2: float) -> None:
    hull = crown_twigs._Hull(1.0, 5.0, np.full((72, 48), radius_m))
    points, _ = hull.spread(500, extinct_m2, np.random.default_rng(1))
    assert np.all((points[:, 2] >= 1.0) & (points[:, 2] <= 5.0))
    assert np.all(np.hypot(points[:, 0], points[:, 1]) < radius_m + 2.0)


def test_points_are_more_even_than_chance() -> None:
    """Clark and Evans' ratio in space: mean distance to the nearest over that of random points, 0.554 n^(-1/3)."""
    hull = crown_twigs._Hull(0.0, 10.0, np.full((48, 24), 4.0))
    points, apart_m = hull.spread(1500, 0.0, np.random.default_rng(2))
    near = np.sort(cdist(points, points), axis=1)[:, 1].mean()
    assert apart_m == pytest.approx((np.pi * 16.0 * 10.0 / 1500) ** (1 / 3), rel=1e-6)
    assert near / (0.554 * apart_m) > 1.05


def test_points_of_shaded_crowns_stand_in_no_layers() -> None:
    """Seen from a side, the sparse lower half has no layers: no wave along the height is above 25 times chance.

    Of random points |sum exp(i k x)|^2 / n is 1 in the mean and above 25 in one case of 10^11.
    """
    hull = crown_twigs._Hull(5.0, 19.0, np.full((72, 48), 3.3))
    points, _ = hull.spread(15_000, 4.0 * np.pi * 3.3**2, np.random.default_rng(1))
    side = np.abs(np.arctan2(points[:, 1], points[:, 0]) + np.pi / 2) < np.pi / 4
    seen = points[side & (points[:, 2] < 12.0)]
    worst = 0.0
    for layer_m in np.geomspace(0.3, 1.0, 30):
        for lean_x in np.linspace(-0.2, 0.2, 9):
            for lean_y in np.linspace(-0.2, 0.2, 9):
                wave = np.exp(2j * np.pi / layer_m * (seen @ np.array([lean_x, lean_y, 1.0])))
                worst = max(worst, float(np.abs(wave.sum()) ** 2 / len(seen)))
    assert worst < 25.0


@pytest.mark.parametrize("name", BROAD)
def test_every_leaf_sits_on_a_twig(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """No leaf's foot is further than 2 cm from its twig: the petiole is part of the leaf."""
    tree = grown(name, 12.0, monkeypatch)
    twig = tree.order == TWIG_ORDER
    assert twig.sum() > 200
    assert np.all(tree.radius_m[twig] <= tree.radius_m[tree.parent[twig]] + 1e-9)  # none is thicker than its bearer
    assert all(np.all(tree.order[one.node] == TWIG_ORDER) for one in tree.organs)
    assert max(seats(tree)) < 0.02


@pytest.mark.parametrize("name", BROAD)
def test_crowns_are_filled(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaf area is spread over more cells of a metre than the generator spreads it over: twigs gather in sprays, whose
    gaps are smaller than that.
    """

    def cells(tree: Skeleton) -> float:
        """Number of cells that would hold all leaves, were they as many in each."""
        leaf = np.concatenate([one.frame[:, :, 3] for one in tree.organs])
        area = np.concatenate([np.linalg.norm(one.frame[:, :, 1], axis=1) ** 2 for one in tree.organs])
        _, cell = np.unique(np.floor(leaf).astype(np.int64), axis=0, return_inverse=True)
        return float(area.sum() ** 2 / np.sum(np.bincount(cell.ravel(), area) ** 2))

    filled = cells(grown(name, 12.0, monkeypatch))
    monkeypatch.setattr("forestgen.plants.tree_fit.rules_of_twigs", lambda *_: [])
    assert filled > 1.05 * cells(grown(name, 12.0, monkeypatch))


def test_lower_trees_keep_the_generator_s_twigs(monkeypatch: pytest.MonkeyPatch) -> None:
    assert np.all(grown("oak", 4.9, monkeypatch).order != TWIG_ORDER)
    assert np.any(grown("oak", 5.1, monkeypatch).order == TWIG_ORDER)


def test_a_crown_as_narrow_as_inventories_may_have_is_built() -> None:
    asked = request_of(plan_of("oak", 0), "oak", 5.3, 1, "stand")
    assert asked.tree is not None
    narrow = grow_exemplar(replace(asked, tree=replace(asked.tree, crown_width_m=0.25)))
    assert narrow.height_m == pytest.approx(5.3, rel=1e-3)


def test_the_stem_stays_however_thick_the_twigs_begin(monkeypatch: pytest.MonkeyPatch) -> None:
    tree = grown("beech", 12.0, monkeypatch)
    assert np.any(tree.order == 0)
    twigs = CrownTwigs(replaces_below_m=0.5, leaves_each=6)
    wood, node = crown_twigs._branches(tree, twigs.replaces_below_m)
    np.testing.assert_array_equal(node, np.flatnonzero(crown_twigs.first_stem(tree.axis)))
    assert np.all(wood.parent[1:] == np.arange(len(node) - 1))


def test_twigs_and_leaves_go_with_their_branch_in_the_wind() -> None:
    """Segments keep their length, leaves their twig, frames their faces."""
    plan = plan_of("beech", 0)
    tree = request_of(plan, "beech", 10.0, 1, "stand").tree
    generator, parameters = StrandGenerator(), plan.generators["beech"]
    windy = generator.in_wind(parameters)
    poses = list(generator.poses(windy, 10.0, 5.0, np.random.default_rng(3), [0.0, 1.3], tree))
    still, moved = poses
    assert np.any(still.order == TWIG_ORDER)
    assert np.abs(still.position_m - moved.position_m).max() > 0.05

    def lengths(one: Skeleton) -> np.ndarray:
        own = one.order == TWIG_ORDER
        inner = own & own[np.maximum(one.parent, 0)]
        return np.linalg.norm(one.position_m[inner] - one.position_m[one.parent[inner]], axis=1)

    np.testing.assert_allclose(lengths(moved), lengths(still), atol=1e-4)
    for one in poses:
        assert max(seats(one)) < 0.02
    frames = list(build.sway(plan, "beech", 3.0, 5, 2, 12.0, tree))
    for a, b in zip(frames[0].organs, frames[1].organs, strict=True):
        np.testing.assert_array_equal(a.mesh.faces, b.mesh.faces)
        assert a.mesh.vertices_m.shape == b.mesh.vertices_m.shape


def test_branch_ends_bear_twigs(monkeypatch: pytest.MonkeyPatch) -> None:
    tree = grown("beech", 10.0, monkeypatch)
    ends = np.setdiff1d(np.arange(len(tree.parent)), tree.parent)
    assert np.all(tree.order[ends] == TWIG_ORDER)


def test_the_hull_of_a_ball_is_a_ball() -> None:
    """Volume and widest place of the hull of leaves on a sphere of 3 m: within 12% of it."""
    direction = np.random.default_rng(4).normal(size=(20_000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    hull = crown_twigs._hull(Leaves(3.0 * direction + [0.0, 0.0, 8.0], np.ones(len(direction))))
    area = np.pi * np.mean(hull.radius_m**2, axis=1)
    volume = float(area.mean()) * (hull.high_m - hull.low_m)
    assert volume == pytest.approx(4 / 3 * np.pi * 27.0, rel=0.12)
    assert hull.low_m + (np.argmax(area) + 0.5) / len(area) * (hull.high_m - hull.low_m) == pytest.approx(8.0, abs=0.6)


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_leaves_stand_around_the_top_of_a_leaning_stem(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their mean is off the stem by less than 0.4 of their median distance: 0.5 to 1 where all lean to one side."""
    tree = grown("beech", 14.0, monkeypatch, seed, "open")
    leaf = np.concatenate([one.frame[:, :, 3] for one in tree.organs]).astype(np.float64)
    leaf = leaf[leaf[:, 2] > 0.85 * leaf[:, 2].max()]
    aside = (leaf - crown_twigs._stem_at(tree, leaf[:, 2]))[:, :2]
    assert np.linalg.norm(aside.mean(axis=0)) < 0.4 * np.median(np.hypot(*aside.T))


def test_the_same_seed_gives_the_same_twigs(monkeypatch: pytest.MonkeyPatch) -> None:
    one, same, other = (grown("oak", 9.0, monkeypatch, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.position_m, same.position_m)
    assert one.position_m.shape != other.position_m.shape or not np.array_equal(one.position_m, other.position_m)
    assert replace(one, organs=()).volume_m3() == replace(same, organs=()).volume_m3()


def test_more_leaves_than_a_crown_has_leave_the_other_sizes() -> None:
    asked = request_of(plan_of("beech", 0), "beech", 8.0, 1, "stand")
    assert asked.tree is not None
    for width_m, leaf_area_m2 in ((0.3, 2000.0), (3.0, 1e5)):
        built = grow_exemplar(
            replace(asked, tree=replace(asked.tree, crown_width_m=width_m, leaf_area_m2=leaf_area_m2))
        )
        assert built.height_m == pytest.approx(8.0, rel=0.01)
        assert built.crown_width_m < width_m + 0.5


@pytest.mark.parametrize("leaves", [{"orders": [1]}, {}], ids=["no twigs", "no leaves"])
def test_twigs_and_their_leaves_go_together(leaves: dict[str, object]) -> None:
    plant = {
        "generator": "strands",
        "wood": {"material": "bark"},
        "shapes": {"leaf": {"form": "simple", "material": "leaf", "length_m": 0.1, "width_m": 0.07}},
    }
    rule = {"shape": "leaf", "orders": [100], "spacing_m": 0.1, **leaves}
    twigs = {"crown_twigs": {"replaces_below_m": 0.01, "leaves_each": 5}} if leaves else {}
    with pytest.raises(ValueError, match="order 100"):
        StrandGenerator.Parameters.model_validate({**plant, **twigs, "foliage": [rule]})


def test_gathered_points_lie_in_groups_and_keep_their_middle():
    tips = np.random.default_rng(2).random((800, 3)) * [4.0, 4.0, 6.0]
    gathered = _gathered(tips, 0.8, 2.5)
    assert np.abs(gathered.mean(axis=0) - tips.mean(axis=0)).max() < 0.05
    apart = [np.abs(np.diff(np.sort(one[:, 2]))).max() for one in (tips, gathered)]
    assert apart[1] > 1.5 * apart[0]  # tiers, with gaps between
    hanging = _gathered(tips, 1.0, 0.3)
    assert len(np.unique(hanging[:, :2].round(9), axis=0)) == len(tips) // 8  # below one another
    assert len(np.unique(hanging[:, 2].round(9))) == len(tips)
    np.testing.assert_array_equal(_gathered(tips, 0.0, 2.5), tips)
