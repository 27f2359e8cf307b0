"""recipes/ecoclimates/dying.yaml as it is: who dies in its drought, when, and that its snags survive resuming."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from forestgen.community.model import simulate
from forestgen.community.population import Population, Status
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import Plan, check_plan

RECIPE = Path(__file__).resolve().parents[2] / "recipes" / "ecoclimates" / "dying.yaml"
DRIER_YR = 40  # from then on
TALL_M = 1.3


def run(plan: Plan, start: Population | None = None) -> list[Population]:
    asked = (
        plan.community.model,
        plan.community.parameters,
        plan.community.site,
        plan.community.ecologies,
        plan.drawn.image_seed,
    )
    return list(simulate(*asked, steps=plan.community.steps, start=start))


def counts(one: Population, name: str) -> tuple[int, int]:
    """Tall plants of a species that live, and its standing dead."""
    of, dead = one.species == one.species_names.index(name), one.status == Status.DEAD
    return int((of & ~dead & (one.height_m > TALL_M)).sum()), int((of & dead).sum())


@pytest.mark.slow
def test_the_drought_thins_crowns_and_kills_birches_before_pines() -> None:
    plan = check_plan(load_recipe(RECIPE), simulate_only=True)
    stand = run(plan)
    wet, end = stand[DRIER_YR], stand[-1]
    birch, pine = (counts(wet, name) for name in ("birch", "pine"))
    birches, pines = (counts(end, name) for name in ("birch", "pine"))
    assert birch[1] > 0  # for want of light
    assert birches[0] < 0.6 * birch[0]
    assert pines[1] - pine[1] >= 5
    assert birches[0] / birch[0] < pines[0] / pine[0]
    # Crowns of trees that lived through it.
    alive = np.intersect1d(wet.plant_id[wet.height_m > 5], end.plant_id[end.status != Status.DEAD])
    leaves = [one.columns["leaf_area_m2"][np.searchsorted(one.plant_id, alive)] for one in (wet, end)]
    assert len(alive) >= 10
    assert np.median(leaves[1] / leaves[0]) < 0.9
    # The dead stay dead, without leaves, until they fall.
    dead = end.plant_id[end.status == Status.DEAD]
    assert not end.columns["leaf_area_m2"][end.status == Status.DEAD].any()
    before = stand[-2]
    assert np.isin(before.plant_id[before.status == Status.DEAD], end.plant_id).mean() > 0.8
    assert len(dead) == birches[1] + pines[1]
    # From the middle of the dying on, the same again.
    again = run(plan, stand[47])[-1]
    assert np.array_equal(again.plant_id, end.plant_id)
    assert np.array_equal(again.status, end.status)
    for name, values in end.columns.items():
        assert np.array_equal(again.columns[name], values), name
    for name, values in end.maps.items():
        assert np.array_equal(again.maps[name], values), name
