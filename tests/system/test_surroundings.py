"""A stand that goes on beyond the site's edge, as cameras see it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from shots import shot

from forestgen.community.population import Population
from forestgen.core.errors import RecipeError
from forestgen.core.parts import Part
from forestgen.core.progress import Silent, Timings
from forestgen.dataset.tables import plants_table
from forestgen.labels.gap_fraction import gap_fraction_of
from forestgen.pipeline import assemble_image, image_frames
from forestgen.recipe.load import load_recipe_data
from forestgen.render.identity import SceneTracer
from forestgen.scene.blocks import CLEAR, Stands
from forestgen.scene.plan import check_plan
from forestgen.scene.spec import Instances
from forestgen.scene.surroundings import SurroundedStand, layers_around, surrounded
from forestgen.scene.terrain import HeightField
from support.cameras import camera_of
from support.error_messages import raises_error
from support.scenes import plain_ground, scattered_scene

SIDE_M, TREES = 40.0, 160


def stand_at(shift_m, rings: int | None):
    """A stand of trees moved over the edge and in again on the other side; whole copies all around, or `rings` None."""
    spec = scattered_scene(TREES, size_m=SIDE_M, exemplars=6, leaves=1500, terrain=plain_ground(-2000, 2000))
    transform = spec.instances.transform.copy()
    transform[:, :2, 3] = (transform[:, :2, 3] + shift_m) % SIDE_M
    top = np.array([one.height_m for one in spec.exemplars])[spec.instances.exemplar] * transform[:, 2, 2]
    plain = np.zeros(TREES)
    ids, kinds = spec.instances.plant_id, np.zeros(TREES, np.uint16)
    plants = Population(0.0, ("a",), ids, kinds, transform[:, :, 3], plain + 1, top, plain, kinds.astype(np.uint8))
    instances = replace(spec.instances, transform=transform)
    site = SurroundedStand.of(plants, instances, spec.exemplars, spec.materials)
    if rings is None:
        height = HeightField((SIDE_M, SIDE_M))
        found = surrounded(site, layers_around(plants, np.arange(TREES), height, None), height, 1, True)
        return replace(spec, exemplars=found.exemplars, materials=found.materials, instances=found.instances)
    turns = [(i, j) for i in range(-rings, rings + 1) for j in range(-rings, rings + 1)]
    copies = np.concatenate([transform + _moved(i, j) for i, j in turns])
    exemplar = np.tile(instances.exemplar, len(turns))
    return replace(spec, instances=Instances(exemplar, copies, np.arange(1, len(exemplar) + 1, dtype=np.uint32)))


def _moved(i: int, j: int) -> np.ndarray:
    move = np.zeros((3, 4))
    move[:2, 3] = i * SIDE_M, j * SIDE_M
    return move


def test_far_stands_are_of_several_heights_with_clearings_between():
    """The share of clearings is that of a normal variable; near the site all is as on it."""
    cleared, heights = [], []
    for seed in range(20):
        stands = Stands.drawn(np.random.default_rng(seed))
        x, y = np.random.default_rng(seed).uniform(-5000, 5000, (2, 4000))
        tall = stands.relative_height(x, y, np.full(len(x), 1000.0))
        cleared.append((tall == 0).mean())
        heights.append(tall[tall > 0].std())
        np.testing.assert_array_equal(stands.relative_height(x, y, np.full(len(x), 100.0)), 1.0)
    assert np.mean(cleared) == pytest.approx(0.5 * math.erfc(CLEAR / math.sqrt(2)), abs=0.01)
    assert 0.1 < np.mean(heights) < 0.3


def gaps(spec, place_m):
    x, y = place_m
    up = camera_of("fisheye", (128, 128), (x, y, 0.5), (x, y + 1e-6, 9.0))
    spec = replace(spec, cameras=(up,))
    return gap_fraction_of(up, shot(SceneTracer(spec, Timings()), up, 4)[0])


def test_a_fisheye_at_the_edge_sees_what_it_would_see_in_the_middle():
    """The same plants stand around it: the site begins elsewhere in the same endless stand."""
    edge, middle = np.array([0.5, 3.0]), np.array([SIDE_M / 2, SIDE_M / 2])
    seen = gaps(stand_at((0.0, 0.0), None), edge)
    other = gaps(stand_at(middle - edge, None), middle)
    endless = gaps(stand_at((0.0, 0.0), 3), edge)
    for one in (other, endless):
        assert seen.effective_lai == pytest.approx(one.effective_lai, rel=0.03)
        assert seen.hinge_lai == pytest.approx(one.hinge_lai, rel=0.03)
        np.testing.assert_allclose(seen.gap_fraction[:15], one.gap_fraction[:15], atol=0.03)
        assert seen.openness == pytest.approx(one.openness, abs=0.01)
    alone = gaps(stand_at((0.0, 0.0), 0), edge)
    assert alone.effective_lai < 0.8 * seen.effective_lai


RECIPE = {
    "forestgen": 1,
    "seed": 2,
    "site": {"size_m": [24, 24]},
    "species": {"shrub": {"from": "shrub"}},
    "community": {"model": "uniform", "plants": {"shrub": {"count": 60}}},
    "plants": {"exemplars_per_species": 2},
    "cameras": [
        {"name": "above", "kind": "orthographic", "position_m": [12, 12, 30], "look": "down", "width_m": 8,
         "size_px": [64, 64]},
        {"name": "out", "position_m": [12, 12, 12], "look_at_m": [40, 12, 0], "size_px": [96, 64], "hfov_deg": 70},
    ],
    "render": {"samples": 1},
    "labels": {"samples": 4},
}  # fmt: skip


def scene_with(surroundings):
    recipe = {**RECIPE, "site": {**RECIPE["site"], "surroundings": surroundings}}
    return assemble_image(check_plan(load_recipe_data(recipe, "test")), Silent(), Timings())


def shots_of(surroundings):
    """What each camera sees: of the samples, and at the pixels' centres."""
    scene = scene_with(surroundings)
    tracer = SceneTracer(scene.spec, Timings())
    return scene, {camera.name: shot(tracer, camera, 4) for camera in scene.spec.cameras}


def test_ids_tell_the_site_from_what_is_around_it():
    alone, by_itself = shots_of("open")
    scene, labelled = shots_of("repeat")
    _, unlabelled = shots_of({"kind": "repeat", "labelled": False})
    for name in ("plant_id", "species", "position_m", "height_m"):
        np.testing.assert_array_equal(getattr(scene.population, name), getattr(alone.population, name))
    for found in (labelled, unlabelled):  # nothing outside is in view from above
        for name in ("plant_id", "part"):
            np.testing.assert_array_equal(getattr(found["above"][0], name), getattr(by_itself["above"][0], name))
        np.testing.assert_array_equal(found["above"][1].depth_m, by_itself["above"][1].depth_m)
    outside = scene.labelled.plant_id[scene.labelled.columns["outside"]]
    (seen, centre), (left_out, other_centre) = labelled["out"], unlabelled["out"]
    is_copy = np.isin(seen.plant_id, outside)
    assert is_copy.mean() > 0.05
    np.testing.assert_array_equal(left_out.plant_id, np.where(is_copy, 0, seen.plant_id))
    np.testing.assert_array_equal(left_out.part, np.where(is_copy, Part.SURROUNDINGS, seen.part))
    np.testing.assert_array_equal(centre.depth_m, other_centre.depth_m)
    assert (centre.depth_m < by_itself["out"][1].depth_m).mean() > 0.05


@pytest.mark.slow
def test_files_mark_what_is_outside_and_count_the_site():
    frames = image_frames(scene_with("repeat"), Silent(), Timings())
    found = {one.labelled.frame.camera.name: one for one in frames}
    above, out = (found[name].labelled for name in ("above", "out"))
    assert not above.outside.any()
    assert out.views.visible.visible_pixels[out.outside].sum() > 100
    assert (out.views.visible.visible_area_px[out.outside] > 0).all()  # the table has no copy that is out of view
    x, y, _ = out.population.position_m[out.outside].T
    assert (HeightField((24.0, 24.0)).distance_m(x, y) > 0).all()
    assert sum(plants_table(out).to_pydict()["outside"]) == out.outside.sum()
    assert found["out"].row["plants"] == 60


def test_an_unknown_kind_is_refused():
    with raises_error(RecipeError, place="site.surroundings.kind"):
        scene_with("hills")
