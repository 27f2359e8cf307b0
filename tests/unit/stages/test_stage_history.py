"""Snapshots kept for the curves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from forestgen.community.history import read_history
from forestgen.community.population import Population
from forestgen.core.errors import RecipeError
from forestgen.core.progress import Silent
from forestgen.recipe.load import load_recipe
from forestgen.stages.community import snapshots
from forestgen.stages.history import Thinned, check_map_steps, write_community
from forestgen.stages.plan import check_plan

QUICKSTART = Path(__file__).parents[3] / "recipes" / "quickstart.yaml"


def snapshot(step: int, plants: int) -> Population:
    zeros = np.zeros(plants)
    return Population(
        time_yr=float(step),
        species_names=("a",),
        plant_id=np.arange(1, plants + 1, dtype=np.uint32),
        species=np.zeros(plants, dtype=np.uint16),
        position_m=np.zeros((plants, 3)),
        radius_m=zeros,
        height_m=zeros,
        age_yr=zeros,
        status=np.zeros(plants, dtype=np.uint8),
    )


def kept(last_step: int, plants: int = 1, **limits: int) -> list[float]:
    thinned = Thinned(last_step, **limits)
    for step in range(last_step + 1):
        thinned.add(step, snapshot(step, plants))
    return [one.time_yr for one in thinned.snapshots()]


@pytest.mark.parametrize("last_step", [0, 1, 2, 399, 400, 401, 799, 5000])
def test_first_and_last_are_kept_and_the_number_is_bounded(last_step: int) -> None:
    steps = kept(last_step)
    assert steps[0] == 0
    assert steps[-1] == last_step
    assert len(steps) <= 402
    assert steps == sorted(set(steps))


def test_few_steps_are_all_kept() -> None:
    assert kept(300) == list(range(301))


def test_memory_bounds_the_snapshots_and_they_stay_even() -> None:
    steps = kept(100, plants=1000, most_bytes=10 * 70_000)
    assert 5 <= len(steps) <= 11
    assert len(set(np.diff(steps[:-1]))) == 1
    assert steps[-1] == 100


def test_snapshots_too_large_for_any_budget_leave_the_ends() -> None:
    steps = kept(100, plants=1000, most_bytes=1)
    assert len(steps) == 2
    assert steps[-1] == 100


def test_a_community_in_files(tmp_path: Path) -> None:
    plan = check_plan(load_recipe(QUICKSTART, ["community.steps=6", "site.size_m=[20,20]"]), simulate_only=True)
    last = write_community(tmp_path, plan, snapshots(plan, Silent()), [2, 2, 5])
    assert {path.name for path in tmp_path.iterdir()} == {
        "history.parquet",
        "map-000002.png",
        "map-000005.png",
        "curves.png",
    }
    history = read_history(tmp_path / "history.parquet")
    assert len(history) == 7
    assert np.array_equal(history[-1].plant_id, last.plant_id)


def test_steps_that_are_never_reached_are_refused() -> None:
    plan = check_plan(load_recipe(QUICKSTART, ["community.steps=6"]), simulate_only=True)
    check_map_steps(plan, [0, 6])
    for step in (-1, 7):
        with pytest.raises(RecipeError, match=rf"--map-step[\s\S]*0 to 6[\s\S]*{step}"):
            check_map_steps(plan, [step])
