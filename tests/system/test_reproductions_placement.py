"""What Lane 2002, chapter 5, shows, by the shipped recipes, over twenty seeds: `pytest -m slow -s` prints it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from forestgen.community.placement.densities import species_density
from forestgen.community.point_patterns import hopkins_index
from forestgen.community.population import Population, count_by_species
from forestgen.community.simulation import final_population
from forestgen.core.progress import Silent
from forestgen.recipe.assets import find_asset
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import Plan, check_plan

SEEDS = range(20)
BINS = 4  # 8 m wide, of Figure 5.6: the kernels reach less than 2 m
INVITING = "community.kernels={curve: [[0, 0], [0.6, 0], [1.3, 1.6], [4, 1]]}"


def placed(recipe: str, seed: int, *settings: str) -> tuple[Plan, Population]:
    path: Path = find_asset("recipes", f"reproductions/{recipe}")
    plan = check_plan(load_recipe(path, [f"seed={seed}", *settings]), simulate_only=True)
    return plan, final_population(plan.community, Silent())


def hopkins(points_m: NDArray[np.float64], size_m: tuple[float, float]) -> float:
    return hopkins_index(points_m, size_m, np.random.default_rng(0))


def show(name: str, values: NDArray[np.float64]) -> None:
    mean, spread = np.atleast_1d(values.mean(axis=0)), np.atleast_1d(values.std(axis=0, ddof=1))
    print(f"{name}: " + ", ".join(f"{m:.3g} +- {s:.2g}" for m, s in zip(mean, spread, strict=True)))  # noqa: T201


def panels(seed: int) -> list[float]:
    """Hopkins indices of the four patterns of Figure 5.4."""
    _, population = placed("kernels_fig5_4", seed)
    points_m = [population.position_m[population.species == k, :2] - [10.0 * k, 0.0] for k in range(4)]
    assert [len(one) for one in points_m] == [100] * 4
    return [hopkins(one, (10.0, 10.0)) for one in points_m]


def follows(plan: Plan, population: Population) -> float:
    """p-value of Pearson's chi-square of counts in coarse bins against the recipe's map."""
    density = species_density(plan.community.parameters, plan.community.site, "fireweed", (40 * BINS, 40 * BINS))  # type: ignore[arg-type]
    expected = density.reshape(BINS, 40, BINS, 40).sum(axis=(1, 3))
    window = [(0.0, side) for side in plan.community.site.size_m]
    found, _, _ = np.histogram2d(*population.position_m[:, :2].T, bins=BINS, range=window)
    expected *= len(population) / expected.sum()
    return float(stats.chisquare(found.T.ravel(), expected.ravel()).pvalue)


@pytest.mark.slow
def test_kernels_of_figure_5_4() -> None:
    values = np.array([panels(seed) for seed in SEEDS])
    show("Hopkins index of Figure 5.4 (a) to (d) (thesis: 0.4, 1.0, 1.2, 2.4)", values)
    a, b, c, d = values.mean(axis=0)
    assert a == pytest.approx(0.4, abs=0.1)
    assert b == pytest.approx(1.0, abs=0.1)
    assert c == pytest.approx(1.2, abs=0.1)
    assert d == pytest.approx(2.4, abs=0.4)


@pytest.mark.slow
@pytest.mark.parametrize(("letter", "h", "within"), [("a", 0.4, 0.1), ("b", 1.2, 0.1), ("c", 2.4, 0.4)])
def test_daisies_of_figure_5_5(letter: str, h: float, within: float) -> None:
    values = []
    for seed in SEEDS:
        plan, population = placed(f"daisies_fig5_5{letter}", seed, "community.plants.grass.count=0")
        assert count_by_species(population)["daisy"] == 100
        values.append(hopkins(population.position_m[population.species == 0, :2], plan.community.site.size_m))
    show(f"Hopkins index of Figure 5.5 ({letter}) (thesis: {h})", np.array(values))
    assert np.mean(values) == pytest.approx(h, abs=within)


@pytest.mark.slow
@pytest.mark.parametrize(("letter", "h", "within"), [("b", 1.2, 0.1), ("c", 1.9, 0.2)])
def test_map_of_figure_5_6(letter: str, h: float, within: float) -> None:
    values, p = [], []
    for seed in SEEDS:
        plan, population = placed(f"map_fig5_6{letter}", seed)
        values.append(hopkins(population.position_m[:, :2], plan.community.site.size_m))
        p.append(follows(plan, population))
    show(f"Hopkins index of Figure 5.6 ({letter}) (thesis: {h})", np.array(values))
    print(f"p of chi-square against the map: {np.sort(p).round(4).tolist()}")  # noqa: T201
    assert np.mean(values) == pytest.approx(h, abs=within)
    assert min(p) >= 0.001
    assert 0.1 < np.median(p) < 0.9


def test_a_seed_of_each() -> None:
    """The same within wider bounds, for every day; and that a kernel which only invites leaves the map."""
    a, _, _, d = np.mean([panels(seed) for seed in range(2)], axis=0)
    assert a == pytest.approx(0.46, abs=0.03)
    assert 1.4 < d < 3.4
    plan, population = placed("map_fig5_6c", 1)
    assert hopkins(population.position_m[:, :2], plan.community.site.size_m) == pytest.approx(1.9, abs=0.2)
    assert follows(plan, population) > 0.001
    plan, population = placed("map_fig5_6c", 1, INVITING)
    assert len(population) == 1000
    assert follows(plan, population) < 1e-6


def test_bracken_of_figure_5_8_stands_about_birches() -> None:
    _, population = placed("two_species_fig5_8", 0)
    birch, bracken = (population.species == k for k in range(2))
    apart = np.abs(population.position_m[bracken, None, :2] - population.position_m[None, birch, :2])
    nearest = np.hypot(*np.minimum(apart, 40.0 - apart).transpose(2, 0, 1)) / population.radius_m[birch]
    ground = np.random.default_rng(0).uniform(0, 40, (20_000, 1, 2))
    away = np.abs(ground - population.position_m[None, birch, :2])
    anywhere = np.hypot(*np.minimum(away, 40.0 - away).transpose(2, 0, 1)) / population.radius_m[birch]
    about = [np.mean((one.min(axis=1) > 0.15) & (one.min(axis=1) < 1.5)) for one in (nearest, anywhere)]
    print(f"within 0.15 to 1.5 radii of a birch: bracken {about[0]:.2f}, ground {about[1]:.2f}")  # noqa: T201
    assert about[0] > 1.25 * about[1]
    assert np.mean(nearest.min(axis=1) < 0.1) < 0.002


def test_forest_of_figure_5_9() -> None:
    plan, population = placed("forest_fig5_9", 0)
    assert len(population) == 1599
    assert plan.drawn.recipe.plants.exemplars_per_species * len(plan.drawn.species) == 36
    assert count_by_species(population) == {"spruce": 420, "birch": 380, "bracken": 799}
