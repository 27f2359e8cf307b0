"""An id that a format cannot hold is told before the light is traced, not after it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from shots import identity

from forestgen.core.errors import OutputError
from forestgen.core.progress import Silent, Timings
from forestgen.dataset.formats import panoptic
from forestgen.dataset.formats.format import check_ids
from forestgen.recipe.load import load_recipe_data
from forestgen.render import rendering
from forestgen.render.identity import SceneTracer
from support.scenes import plain_ground, scattered_scene


class LightTracedError(Exception):
    """In place of the light."""


@pytest.mark.parametrize(
    ("formats", "largest", "outcome"),
    [
        (["panoptic"], panoptic.MOST_PLANT_ID + 1, OutputError),
        (["panoptic"], panoptic.MOST_PLANT_ID, LightTracedError),
        (["coco"], 2**32 - 1, LightTracedError),
    ],
)
def test_ids_beyond_a_format_are_refused_before_the_light(monkeypatch, formats, largest, outcome):
    def light(*_, **__):
        raise LightTracedError

    monkeypatch.setattr(rendering, "render_radiance", light)
    spec = scattered_scene(20, size_m=16, exemplars=2, leaves=40, size_px=(192, 108), terrain=plain_ground(-20, 40, 4))
    seen = identity(spec, 4).plant_id
    numbers, counts = np.unique(seen[seen > 0], return_counts=True)
    ids = np.arange(1, len(spec.instances) + 1, dtype=np.uint32)
    ids[spec.instances.plant_id == numbers[counts.argmax()]] = largest
    spec = replace(spec, instances=replace(spec.instances, plant_id=ids))
    asked = {
        "forestgen": 1,
        "species": {"oak": {"from": "oak"}},
        "community": {"model": "placed", "plants": [{"species": "oak", "position_m": [5, 5]}]},
        "dataset": {"formats": formats},
    }
    recipe = load_recipe_data(asked, "test").draw(0).recipe
    camera = spec.cameras[0]
    check = partial(check_ids, recipe.dataset.formats, camera.name)
    with pytest.raises(outcome) as caught:
        rendering.render_frame(SceneTracer(spec, Timings()), camera, recipe, 1, Silent(), Timings(), check=check)
    if outcome is OutputError:
        assert str(largest) in str(caught.value)
        assert spec.cameras[0].name in str(caught.value)
