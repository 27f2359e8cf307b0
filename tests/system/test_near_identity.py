"""Labels of plants whose leaves are drawn at true size."""

from __future__ import annotations

from typing import Any

import numpy as np
from shots import seen

from forestgen.community.simulation import final_population
from forestgen.core.parts import Part
from forestgen.core.progress import Silent, Timings
from forestgen.labels.masks import instance_mask
from forestgen.recipe.load import load_recipe_data
from forestgen.scene.build import build_scene
from forestgen.scene.plan import make_plan
from support.twins import trace_twin

TREES = "species, x_m, y_m, dbh_cm, height_m\noak, 4, 6, 7, 6\nspruce, 6, 6, 7, 6\npine, 5, 8, 7, 6\n"
RECIPE: dict[str, Any] = {
    "forestgen": 1,
    "seed": 1,
    "site": {"size_m": [10, 10]},
    "species": {"oak": None, "spruce": None, "pine": None},
    "community": {"model": "inventory", "table": TREES},
    "sky": {"clouds": "none"},
    "cameras": [{"position_m": [5, 3, 2.6], "look_at_m": [5, 8, 3], "size_px": [160, 120], "obstructed": "note"}],
}


def test_identity_equals_the_expanded_twins():
    plan = make_plan(load_recipe_data(RECIPE, "near").draw(0))
    spec = build_scene(plan, final_population(plan.community, Silent()), Silent(), Timings()).spec
    assert len(spec.exemplars) > 3  # with leaves of true size
    (ours, _), twin = seen(spec, 4, faces=True), trace_twin(spec, spec.cameras[0], 4)
    differ = (ours.plant_id != twin.plant_id) | (ours.part != twin.part) | (ours.face != twin.face)
    assert differ.mean() < 2e-4
    assert (instance_mask(ours.plant_id) != instance_mask(twin.plant_id)).sum() <= 1
    assert set(np.unique(ours.plant_id)) == {0, 1, 2, 3}
    assert {int(Part.LEAF), int(Part.BRANCH), int(Part.TRUNK)} <= set(np.unique(ours.part).tolist())
