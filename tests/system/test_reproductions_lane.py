"""What Lane 2002 shows of its communities, by the shipped recipes, over ten seeds: `pytest -m slow -s` prints it."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from forestgen.community.point_patterns import hopkins_index
from forestgen.community.population import Population, cover_by_species
from forestgen.community.simulation import snapshots
from forestgen.community.trajectory import self_thinning_slope
from forestgen.core.progress import Silent
from forestgen.recipe.assets import find_asset
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import Plan, check_plan

SEEDS = range(10)


def plan_of(recipe: str, seed: int) -> Plan:
    path: Path = find_asset("recipes", f"reproductions/{recipe}")
    return check_plan(load_recipe(path, [f"seed={seed}"]), simulate_only=True)


@functools.cache
def stages(recipe: str, steps: Sequence[int]) -> list[list[Population]]:
    """Snapshots at some steps, by seed."""
    made = []
    for seed in SEEDS:
        history = snapshots(plan_of(recipe, seed).community, Silent())
        made.append([one for one in history if one.step in steps])
    return made


def hopkins(population: Population, size_m: tuple[float, float], species: int | None = None) -> float:
    keep = np.ones(len(population), bool) if species is None else population.species == species
    return hopkins_index(population.position_m[keep, :2], size_m, np.random.default_rng(0))


def thinning_slope(history: Sequence[Population]) -> float:
    """As `forestgen simulate` measures it."""
    density = np.array([len(one) for one in history], float)
    fit = self_thinning_slope(density, np.array([np.mean(one.radius_m**3) for one in history]))
    assert fit is not None
    return fit.value


def show(name: str, values: NDArray[np.float64]) -> None:
    mean, spread = values.mean(axis=0), values.std(axis=0, ddof=1)
    print(f"{name}: " + ", ".join(f"{m:.4g} +- {s:.2g}" for m, s in zip(mean, spread, strict=True)))  # noqa: T201


@pytest.mark.slow
def test_self_thinning() -> None:
    """Figures 4.3 and 4.4."""
    steps = (10, 45, 95)
    slopes, indices = [], []
    for seed in SEEDS:
        history = list(snapshots(plan_of("self_thinning", seed).community, Silent()))
        slopes.append([thinning_slope(history)])
        indices.append([hopkins(history[step], (100.0, 100.0)) for step in steps])
    show("self-thinning slope", np.array(slopes))
    show("Hopkins index at steps 10, 45, 95 (thesis: 0.8, 0.4, 0.4)", np.array(indices))
    assert np.mean(slopes) == pytest.approx(-1.5, abs=0.1)
    np.testing.assert_allclose(np.mean(indices, axis=0), [0.8, 0.54, 0.54], atol=0.05)


@pytest.mark.slow
def test_succession() -> None:
    """Figure 4.5 and Table 7.1."""
    steps = (20, 150, 300, 1000)
    plan = plan_of("succession", 0)
    runs = stages("succession", steps)
    counts = np.array([[len(one) for one in run] for run in runs], float)
    indices = np.array([[hopkins(one, (105.0, 105.0)) for one in run] for run in runs])
    cover = np.array(
        [[list(cover_by_species(one, plan.community.site.area_m2).values()) for one in run] for run in runs]
    )
    show("plants at steps 20, 150, 300, 1000 (thesis: 2688, 1593, 1409, 834)", counts)
    show("Hopkins index (thesis: 0.6, 0.7, 0.7, 0.6)", indices)
    for step, rows in zip(steps, cover.transpose(1, 0, 2), strict=True):
        show(f"cover of fireweed, poplar, spruce at step {step}", rows)
    mean = cover.mean(axis=0)
    assert mean[0].argmax() == 0
    assert mean[1].argmax() == 1
    assert mean[3].argmax() == 2
    assert np.all(np.diff(mean[:, 0]) < 0)  # fireweed only loses
    assert np.all(np.diff(mean[:, 2]) > 0)  # spruce only gains
    np.testing.assert_allclose(counts.mean(axis=0)[:3], [2688, 1593, 1409], rtol=0.15)
    assert counts.mean(axis=0)[3] == pytest.approx(1340, rel=0.1)
    np.testing.assert_allclose(indices.mean(axis=0), [0.6, 0.7, 0.7, 0.73], atol=0.1)


@pytest.mark.slow
def test_propagation() -> None:
    """Figure 4.6 and Table 7.1."""
    steps = (20, 500, 1000)
    runs = stages("propagation", steps)
    counts = np.array([[len(one) for one in run] for run in runs], float)
    indices = np.array([[hopkins(one, (105.0, 105.0), 0) for one in run] for run in runs])
    show("plants at steps 20, 500, 1000 (thesis: 5584, 5526, 3427)", counts)
    show("Hopkins index of species 1 (thesis: 1.1, 4.2, 11)", indices)
    print("by seed:", indices.round(2).tolist())  # noqa: T201
    h = indices.mean(axis=0)
    assert h[0] == pytest.approx(1.1, abs=0.1)
    assert h[1] == pytest.approx(4.2, abs=1.3)
    assert h[2] == pytest.approx(11, abs=2.5)
    np.testing.assert_allclose(counts.mean(axis=0)[:2], [5584, 5526], rtol=0.2)
    assert counts.mean(axis=0)[2] == pytest.approx(4650, rel=0.1)


@pytest.mark.slow
def test_size_hierarchy() -> None:
    """Figure 2.2."""
    distances, values = [], []
    for (last,) in stages("size_hierarchy", (30,)):
        z = stats.zscore(3 * np.log(last.radius_m))
        distances.append([stats.kstest(z, "norm").statistic])
        values.append(stats.shapiro(z).pvalue)
    show("Kolmogorov's distance of log mass from a normal distribution", np.array(distances))
    print(f"Shapiro's p above 0.01: {np.sum(np.array(values) > 0.01)} of {len(values)}")  # noqa: T201
    assert np.max(distances) < 0.04
    assert np.sum(np.array(values) > 0.01) >= 7


def test_one_seed_of_each() -> None:
    """The same within wider bounds, for every day."""
    thinning = list(snapshots(plan_of("self_thinning", 3).community, Silent()))
    assert thinning_slope(thinning) == pytest.approx(-1.5, abs=0.12)
    assert hopkins(thinning[45], (100.0, 100.0)) == pytest.approx(0.54, abs=0.06)
    plan = plan_of("succession", 3)
    young = {one.step: one for one in islice(snapshots(plan.community, Silent()), 151) if one.step in (20, 150)}
    assert len(young[20]) == pytest.approx(2688, rel=0.2)
    assert len(young[150]) == pytest.approx(1593, rel=0.2)
    assert np.argmax(list(cover_by_species(young[20], plan.community.site.area_m2).values())) == 0
    assert np.argmax(list(cover_by_species(young[150], plan.community.site.area_m2).values())) == 1
    (early,) = [one for one in islice(snapshots(plan_of("propagation", 3).community, Silent()), 21) if one.step == 20]
    assert hopkins(early, (105.0, 105.0), 0) == pytest.approx(1.1, abs=0.15)
    *_, last = snapshots(plan_of("size_hierarchy", 3).community, Silent())
    assert stats.kstest(stats.zscore(np.log(last.radius_m)), "norm").statistic < 0.04
