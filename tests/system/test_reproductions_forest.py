"""What Randleff-Rasmussen 2004 shows of its forest, by the shipped recipes, over ten seeds."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from forestgen.community.simulation import snapshots
from forestgen.core.progress import Silent
from forestgen.recipe.assets import find_asset
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import check_plan

SEEDS = range(10)
pytestmark = pytest.mark.slow


@functools.cache
def counts(recipe: str, *overrides: str) -> NDArray[np.int64]:
    """(10, steps + 1, number of species): plants of each species in each step, by seed."""
    path: Path = find_asset("recipes", f"reproductions/{recipe}")
    made = []
    for seed in SEEDS:
        plan = check_plan(load_recipe(path, [f"seed={seed}", *overrides]), simulate_only=True)
        kinds = len(plan.community.ecologies)
        made.append([np.bincount(one.species, minlength=kinds) for one in snapshots(plan.community, Silent())])
    return np.array(made)


def share_of_the_undisturbed(first: int, last: int) -> NDArray[np.float64]:
    """Plants but the sturdy tree, the third species, in some frames, over those of the run without it; by seed."""
    with_tree, without = (
        counts("domination_test", *overrides)[:, first : last + 1, :2].sum(axis=2).mean(axis=1)
        for overrides in ((), ("community.disturbances=[]",))
    )
    return np.asarray(with_tree / without)


def test_the_sturdy_tree_stands_for_100_frames() -> None:
    sturdy = counts("domination_test")[:, :, 2]
    assert np.all(sturdy[:, :100] == 1)
    assert np.all(sturdy[:, 100:] == 0)


def test_a_sturdy_tree_holds_the_others_down() -> None:
    """Figure 5.7 before frame 100."""
    ratios = share_of_the_undisturbed(50, 99)
    print(f"frames 50 to 99: {ratios.round(3)}, mean {ratios.mean():.3f}")  # noqa: T201
    assert np.all(ratios < 0.7)
    assert ratios.mean() == pytest.approx(0.6, abs=0.04)


def test_the_forest_recovers_when_it_is_felled() -> None:
    """Figure 5.7 after frame 100."""
    ratios = share_of_the_undisturbed(150, 250)
    print(f"frames 150 to 250: {ratios.round(3)}, mean {ratios.mean():.3f}")  # noqa: T201
    np.testing.assert_allclose(ratios, 1, atol=0.05)
    assert ratios.mean() == pytest.approx(1, abs=0.02)


def test_a_population_becomes_stable_early_and_stays_so() -> None:
    """Figure 5.11."""
    plants = counts("stable_population")
    total = plants.sum(axis=2)
    relative = total / total[:, 200:].mean(axis=1, keepdims=True)
    means = relative[:, 100:400].reshape(len(SEEDS), -1, 20).mean(axis=2)
    shares = plants[:, 100:].mean(axis=1) / total[:, 100:].mean(axis=1, keepdims=True)
    print(  # noqa: T201
        f"level {total[:, 200:].mean():.0f}; frames from 40: {relative[:, 40:].min():.3f} to "
        f"{relative[:, 40:].max():.3f}; means of 20: {means.min():.3f} to {means.max():.3f}; "
        f"smallest share of a species {shares.min():.3f}"
    )
    assert np.all(relative[:, 5] < 0.5)
    np.testing.assert_allclose(relative[:, 40:], 1, atol=0.1)
    np.testing.assert_allclose(means, 1, atol=0.05)
    assert shares.min() > 0.08
