"""A simulation's files, and the steps that they tell of."""

from __future__ import annotations

import json
import weakref
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from forestgen.community.history import open_history
from forestgen.community.history_files import check_map_steps, evenly, write_community
from forestgen.community.population import Population
from forestgen.community.simulation import snapshots
from forestgen.core.errors import RecipeError
from forestgen.core.progress import Silent
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import Plan, check_plan
from support.error_messages import raises_error

QUICKSTART = Path(__file__).parents[3] / "recipes" / "quickstart.yaml"
ALWAYS = {"history.parquet", "curves.png", "thinning.png", "sizes.png", "animation.gif", "statistics.json"}


def plan_of(*overrides: str) -> Plan:
    return check_plan(load_recipe(QUICKSTART, ["site.size_m=[20,20]", *overrides]), simulate_only=True)


@pytest.mark.parametrize("most", [2, 40, 400])
@pytest.mark.parametrize("first", [0, 17])
@pytest.mark.parametrize("length", [0, 1, 2, 38, 39, 40, 41, 399, 400, 401, 799, 5000])
def test_steps_are_even_few_and_hold_both_ends(most: int, first: int, length: int) -> None:
    wanted = evenly(first, first + length, most)
    steps = [step for step in range(first, first + length + 1) if wanted(step)]
    assert steps[0] == first
    assert steps[-1] == first + length
    assert len(steps) <= most
    assert len(steps) >= min(length + 1, most // 2)
    assert len(set(np.diff(steps[:-1]))) <= 1


def test_a_community_in_files(tmp_path: Path) -> None:
    plan = plan_of("community.steps=90")
    last = write_community(tmp_path, plan.community, snapshots(plan.community, Silent()), [2, 2, 5])
    assert {path.name for path in tmp_path.iterdir()} == ALWAYS | {"map-000002.png", "map-000005.png"}
    history = list(open_history(tmp_path / "history.parquet"))
    assert len(history) == 91
    assert np.array_equal(history[-1].plant_id, last.plant_id)

    told = json.loads((tmp_path / "statistics.json").read_text())
    assert told["species"] == list(last.species_names)
    assert len(told["steps"]) <= 40
    assert [one["step"] for one in told["steps"]][::30] == [0, 90]
    for one in told["steps"]:
        assert one["n"] == len(history[one["step"]]) == sum(one["counts"].values())
        assert one["density_per_m2"] == one["n"] / 400
        assert sum(one["shares"].values()) == pytest.approx(1.0 if one["n"] else 0.0)
    assert told["self_thinning"] is None
    with Image.open(tmp_path / "animation.gif") as film:
        assert film.n_frames <= 60
        assert max(film.size) <= 480
    assert (tmp_path / "animation.gif").stat().st_size < 3_000_000


@pytest.mark.slow
def test_the_same_plan_makes_the_same_bytes(tmp_path: Path) -> None:
    plan = plan_of("community.steps=12")
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_community(tmp_path / name, plan.community, snapshots(plan.community, Silent()), [])
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes(), path.name


def thinning(plan: Plan, steps: int) -> Iterator[Population]:
    """Equal plants of one sowing on the self-thinning line: their number goes as radius^-2."""
    rng = np.random.default_rng(0)
    for step in range(steps + 1):
        radius = 0.1 + 0.05 * step
        n = round(20 / radius**2)
        yield Population(
            time_yr=float(step),
            species_names=tuple(plan.drawn.species),
            plant_id=np.arange(1, n + 1, dtype=np.uint32),
            species=np.zeros(n, np.uint16),
            position_m=np.concatenate([rng.random((n, 2)) * 20, np.zeros((n, 1))], axis=1),
            radius_m=np.full(n, radius),
            height_m=np.ones(n),
            age_yr=np.full(n, float(step)),
            status=np.zeros(n, np.uint8),
            step=step,
        )


def test_a_decline_of_one_age_has_its_slope(tmp_path: Path) -> None:
    plan = plan_of("community.steps=30")
    write_community(tmp_path, plan.community, thinning(plan, 30), [])
    told = json.loads((tmp_path / "statistics.json").read_text())["self_thinning"]
    assert told["slope_log_mean_mass_on_log_density"]["value"] == pytest.approx(-1.5, abs=0.02)
    assert told["slope_log_density_on_log_diameter"]["value"] == pytest.approx(-2.0, abs=0.03)
    assert told["to_time_yr"] == 30


@pytest.mark.slow
def test_a_resumed_simulation_tells_of_its_own_steps(tmp_path: Path) -> None:
    plan = plan_of("community.steps=30")
    write_community(tmp_path, plan.community, (one for one in thinning(plan, 30) if one.step >= 25), [25])
    assert (tmp_path / "map-000025.png").exists()
    told = json.loads((tmp_path / "statistics.json").read_text())
    assert [one["step"] for one in told["steps"]] == [25, 26, 27, 28, 29, 30]


@pytest.mark.slow
def test_no_snapshot_is_held_but_the_current_one(tmp_path: Path) -> None:
    plan = plan_of("community.steps=45")
    alive: list[weakref.ref[Population]] = []
    most = [0]

    def watched() -> Iterator[Population]:
        for one in thinning(plan, 45):
            alive.append(weakref.ref(one))
            most[0] = max(most[0], sum(held() is not None for held in alive))
            yield one

    write_community(tmp_path, plan.community, watched(), [0, 20])
    assert most[0] <= 3


def test_steps_that_are_never_reached_are_refused() -> None:
    plan = plan_of("community.steps=6")
    check_map_steps(plan.community, [0, 6])
    for step in (-1, 7):
        with raises_error(RecipeError, place="map_steps"):
            check_map_steps(plan.community, [step])
    with raises_error(RecipeError, place="map_steps"):
        check_map_steps(plan.community, [2], first=3)
