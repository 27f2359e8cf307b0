"""Forked stems: two alike above the fork, with the branches, leaves and cross-section of one."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.core.randomness import child_rng
from forestgen.core.stem_form import stem_radius_m
from forestgen.plants.crown_twigs import is_second_stem, middle_of_stems
from forestgen.plants.forks import FORKED, forked
from forestgen.plants.skeleton import OrganPlacements, Skeleton
from forestgen.plants.tree_fit import with_taper
from forestgen.recipe.wood import Forks, Wood

ALWAYS = Wood(forks=Forks(share=1.0, between=(0.2, 0.6)))
TOP_M, NODES, BRANCHES = 20.0, 21, 60


def tree() -> Skeleton:
    """A stem that leans, with branches of two nodes all around, each with a leaf at its tip."""
    rng = np.random.default_rng(2)
    z_m = np.linspace(0.0, TOP_M, NODES)
    stem = np.stack([0.05 * z_m, 0.0 * z_m, z_m], axis=1)
    foot, azimuth = rng.integers(4, NODES, BRANCHES), rng.uniform(0.0, 2.0 * np.pi, BRANCHES)
    way = np.stack([np.cos(azimuth), np.sin(azimuth), 0.5 + 0.0 * azimuth], axis=1)
    tips = np.stack([stem[foot] + way, stem[foot] + 2.0 * way], axis=1).reshape(-1, 3)
    own = NODES + np.arange(2 * BRANCHES)
    parent = np.concatenate([np.arange(-1, NODES - 1), np.stack([foot, own[::2]], axis=1).ravel()])
    order = np.repeat([0, 1], [NODES, 2 * BRANCHES])
    axis = np.concatenate([np.zeros(NODES), np.repeat(1 + np.arange(BRANCHES), 2)])
    radius = np.concatenate([stem_radius_m(z_m, TOP_M, 0.3), np.full(2 * BRANCHES, 0.01)])
    frame = np.zeros((BRANCHES, 3, 4), dtype=np.float32)
    frame[:, :, :3] = np.eye(3)
    frame[:, :, 3] = tips[1::2]
    leaves = OrganPlacements("leaf", frame, own[1::2].astype(np.int32))
    return Skeleton.of(parent, np.concatenate([stem, tips]), radius, order, axis, organs=(leaves,))


@pytest.fixture(scope="module")
def made() -> list[Skeleton]:
    return [forked(tree(), ALWAYS, child_rng(seed, "fork")) for seed in range(20)]


def test_as_many_trees_fork_as_the_law_says() -> None:
    law, whole = Wood(forks=Forks(share=0.3)), tree()
    share = np.mean([forked(whole, law, child_rng(seed, "fork")) is not whole for seed in range(400)])
    assert share == pytest.approx(0.3, abs=0.08)


def test_two_stems_part_within_the_laws_heights_and_both_reach_the_top(made: list[Skeleton]) -> None:
    for one in made:
        second = np.flatnonzero(is_second_stem(one))
        fork = one.parent[second[0]]
        assert 0.2 * TOP_M <= one.position_m[fork, 2] <= 0.6 * TOP_M
        tops = one.position_m[one.order == 0][:, 2]
        assert np.sum(np.isclose(tops, TOP_M)) == 2
        first = np.flatnonzero((one.order == 0) & ~is_second_stem(one))
        apart = np.linalg.norm(one.position_m[first[-1], :2] - one.position_m[second[-1], :2])
        assert 0.5 < apart < 8.0


def test_branches_and_leaves_are_as_many_and_stay_together(made: list[Skeleton]) -> None:
    counts = [np.sum(np.diff(one.axis, prepend=-1) != 0) - 2 for one in made]
    assert np.mean(counts) == pytest.approx(BRANCHES, rel=0.1)
    for one, count in zip(made, counts, strict=True):
        [leaves] = one.organs
        assert len(leaves.node) == count
        np.testing.assert_allclose(leaves.frame[:, :, 3], one.position_m[leaves.node], atol=1e-4)
        np.testing.assert_allclose(np.abs(np.linalg.det(leaves.frame[:, :, :3])), 1.0, atol=1e-5)
        length = np.linalg.norm(one.position_m[1:] - one.position_m[one.parent[1:]], axis=1)
        assert length.max() < 3.0  # nothing is joined across the tree


def test_both_stems_have_one_taper(made: list[Skeleton]) -> None:
    for one in made:
        fitted = with_taper(one, TOP_M, 0.3)
        second = is_second_stem(fitted)
        z_m = fitted.position_m[:, 2].astype(np.float64)
        fork_m = z_m[fitted.parent[np.argmax(second)]]
        above = (fitted.order == 0) & (z_m > fork_m) & (z_m < 0.9 * TOP_M)
        below = (fitted.order == 0) & (z_m <= fork_m)
        np.testing.assert_allclose(fitted.radius_m[above], FORKED * stem_radius_m(z_m[above], TOP_M, 0.3), rtol=1e-4)
        np.testing.assert_allclose(fitted.radius_m[below], stem_radius_m(z_m[below], TOP_M, 0.3), rtol=1e-4)
        assert np.sum(above & second) > 3


def test_the_middle_of_two_stems_is_where_the_one_would_be(made: list[Skeleton]) -> None:
    for one in made:
        middle = middle_of_stems(one)
        fork_m = one.position_m[one.parent[np.argmax(is_second_stem(one))], 2]
        straight = np.interp(fork_m, [0.0, TOP_M], [0.0, 0.05 * TOP_M])  # the second one leans the other way
        above = middle[:, 2] > fork_m + 0.1
        np.testing.assert_allclose(middle[above, 0], straight, atol=0.02)
        np.testing.assert_allclose(middle[above, 1], 0.0, atol=0.02)
