"""Identity is exact: the instanced scene against its expanded twin and against brute force in double precision.

Where baking an instance rounds nothing (whole turns and half turns, power-of-two scales, short binary fractions), all
samples and depths of the two are equal to the last bit; with quarter turns the ids still are, but depths may differ in
their last bits because sums run in another order. Under general transforms a few samples in a million lie within
rounding error of an edge (measured: 1, 3 and 0 of 331,776 for three seeds); each must be proven a tie.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shots import alpha, identity, radiance, seen
from ties import assert_ties

from forestgen.core.parts import Part
from forestgen.labels.masks import instance_mask, part_mask
from forestgen.render.identity import sample_offsets
from forestgen.scene.spec import SceneSpec
from support.scenes import camera_at, dyadic_scene, plain_ground, scattered_scene, shifted
from support.tiers import few
from support.twins import Oracle, trace_twin

SIZE_PX = (192, 108)
SAMPLES = 16


def general_scene(seed: int) -> SceneSpec:
    ground = plain_ground(-64, 128, 24, bumps_m=0.5)
    return scattered_scene(200, size_m=60, exemplars=5, leaves=300, size_px=SIZE_PX, terrain=ground, seed=seed)


@pytest.mark.parametrize("quarter_turns", few([1, 2, 4]))
def test_every_sample_equals_the_expanded_twin_where_nothing_rounds(quarter_turns):
    spec = dyadic_scene(200, quarter_turns=quarter_turns, size_px=SIZE_PX)
    (ours, surface), twin = seen(spec, SAMPLES, faces=True), trace_twin(spec, spec.cameras[0], SAMPLES)
    assert len(np.unique(ours.plant_id)) > 100
    for name in ("plant_id", "part", "exemplar", "face"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(twin, name))
        np.testing.assert_array_equal(getattr(surface, name), getattr(twin.centre, name))
    if quarter_turns > 1:
        np.testing.assert_array_equal(surface.depth_m, twin.depth_m)
    else:
        np.testing.assert_allclose(surface.depth_m, twin.depth_m, rtol=3e-6)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)])
def test_masks_equal_the_expanded_twins_and_other_samples_are_ties(seed):
    spec = general_scene(seed)
    ours, twin = identity(spec, SAMPLES), trace_twin(spec, spec.cameras[0], SAMPLES)
    mask, twin_mask = instance_mask(ours.plant_id), instance_mask(twin.plant_id)
    assert len(np.unique(mask)) > 70
    np.testing.assert_array_equal(mask, twin_mask)
    np.testing.assert_array_equal(
        part_mask(ours.plant_id, ours.part, mask), part_mask(twin.plant_id, twin.part, twin_mask)
    )
    assert_ties(spec, ours, twin)


@pytest.fixture(scope="module")
def small():
    """An asymmetric view of 30 plants, its identity pass and the oracle's rays through the same points."""
    ground = plain_ground(-20, 40, 4, bumps_m=0.5)
    spec = scattered_scene(30, size_m=16, exemplars=3, leaves=40, terrain=ground, seed=5)
    camera = camera_at((3.0, -6.0, 2.5), (9.0, 7.0, 3.0), (32, 18))
    spec = replace(spec, cameras=(camera,))
    return spec, seen(spec, 4, faces=True), Oracle(spec, camera)


def test_samples_equal_brute_force_in_double_precision(small):
    _, (ours, _), oracle = small
    column, row = np.meshgrid(np.arange(32), np.arange(18))
    offset = sample_offsets(4)
    hits = oracle.trace(column[..., None] + offset[:, 0], row[..., None] + offset[:, 1])
    assert len(np.unique(hits.plant_id)) > 15
    for name in ("plant_id", "part", "exemplar", "face"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(hits, name).reshape(18, 32, 4))


def test_depth_normal_and_position_are_those_of_pixel_centres(small):
    spec, (_, ours), oracle = small
    column, row = np.meshgrid(np.arange(32) + 0.5, np.arange(18) + 0.5)
    hits = oracle.trace(column, row)
    _, direction, _ = oracle.rays(column.ravel(), row.ravel())
    camera = spec.cameras[0]
    hit = np.isfinite(hits.distance_m).reshape(18, 32)
    assert 0.3 < hit.mean() < 0.98
    depth = (hits.distance_m * (direction @ camera.world_from_camera[:, 2])).reshape(18, 32)
    np.testing.assert_allclose(ours.depth_m[hit], depth[hit], rtol=1e-5)
    assert np.isinf(ours.depth_m[~hit]).all()
    np.testing.assert_allclose(ours.normal, hits.normal.reshape(18, 32, 3), atol=2e-5)
    where = hit.ravel()
    position = direction[where] * hits.distance_m[where, None] + camera.position_m
    np.testing.assert_allclose(ours.position_m[hit], position, atol=1e-4)
    assert np.isnan(ours.position_m[~hit]).all()


def test_x_is_right_and_y_is_down(small):
    """By hand, without the oracle: what a point east of and above the view's axis means for its pixel."""
    spec, _, _ = small
    camera = camera_at((8.0, -10.0, 2.0), (8.0, 8.0, 2.0), (64, 36), hfov_deg=60)
    _, surface = seen(replace(spec, cameras=(camera,)), 1)
    row, column = np.nonzero(np.isfinite(surface.depth_m))
    point = surface.position_m[row, column].astype(np.float64) - camera.position_m
    focal_px = 32 / np.tan(np.radians(30))
    np.testing.assert_allclose(32 + focal_px * point[:, 0] / point[:, 1], column + 0.5, atol=1e-3)
    np.testing.assert_allclose(18 - focal_px * point[:, 2] / point[:, 1], row + 0.5, atol=1e-3)
    np.testing.assert_allclose(surface.depth_m[row, column], point[:, 1], rtol=1e-5)
    assert np.isinf(surface.depth_m[0]).any()
    assert np.isfinite(surface.depth_m[-1]).all(), "the ground is below"


def test_ids_of_32_bits_survive(small):
    spec, (ours, _), _ = small
    large = (np.uint64(2**32) - np.arange(1, 31, dtype=np.uint64)[::-1]).astype(np.uint32)
    many = identity(replace(spec, instances=replace(spec.instances, plant_id=large)), 4)
    expected = np.where(ours.plant_id > 0, large[np.maximum(ours.plant_id, 1) - 1], 0)
    np.testing.assert_array_equal(many.plant_id, expected)
    assert int(instance_mask(many.plant_id).max()) > 2**32 - 30
    last = replace(spec, instances=replace(spec.instances, plant_id=np.full(30, 2**32 - 1, dtype=np.uint32)))
    np.testing.assert_array_equal(identity(last, 4).plant_id > 0, ours.plant_id > 0)
    assert identity(last, 4).plant_id.max() == 2**32 - 1


def test_radiance_sees_the_same_sky_as_identity():
    """The share of sky, by the light paths at random points and by identity's regular samples."""
    spec = scattered_scene(
        60, size_m=30, exemplars=3, leaves=300, size_px=(48, 27), terrain=plain_ground(-60, 90), seed=8
    )
    open_sky = (identity(spec, 256).part == Part.NOTHING).mean(axis=2)
    traced = 1.0 - alpha(spec, samples=256)
    partial = (open_sky > 0.02) & (open_sky < 0.98)
    assert partial.sum() > 50
    np.testing.assert_array_equal(traced[open_sky == 1.0] > 0.9, True)
    # Both are stratified: independent samples would scatter by sqrt(p (1 - p) / n); ours stay well below.
    error = traced - open_sky
    bound = np.sqrt(np.maximum(open_sky * (1 - open_sky), 0.01) / 256)
    assert np.abs(error / bound).max() < 5
    assert abs(error[partial].sum()) < 4 * np.sqrt(np.sum(bound[partial] ** 2))


def test_identity_does_not_depend_on_the_place():
    spec = general_scene(4)
    here, here_m = seen(spec, 4)
    there, there_m = seen(shifted(spec, (1000.0, -1000.0, 300.0)), 4)
    # The terrain's float32 vertices round to 3e-5 m at 1 km: a few edges move by that.
    assert (here.plant_id != there.plant_id).mean() < 2e-4
    same = np.isfinite(here_m.depth_m) & (here_m.plant_id == there_m.plant_id)
    assert np.mean(np.abs(here_m.depth_m[same] / there_m.depth_m[same] - 1) < 1e-4) > 0.999


@pytest.mark.parametrize("far_m", [1000.0, 8000.0])
def test_radiance_does_not_depend_on_the_place(far_m):
    """The renderer lifts rays' origins by a distance that grows with the coordinates.

    A scene that is not re-centred on its camera comes out 2 to 3% too bright at 1 km and 21% at 8 km, 24 standard
    errors.
    """
    ground = plain_ground(-40, 80, albedo=0.1)
    spec = scattered_scene(60, size_m=16, exemplars=3, leaves=6000, size_px=(48, 27), terrain=ground, seed=9)
    here, there = radiance(spec, 64, seed=1), radiance(shifted(spec, (far_m, far_m, 0.0)), 64, seed=2)
    plants = (identity(spec, 16).part > Part.GROUND).mean(axis=2) > 0.5
    assert plants.sum() > 150
    difference = (here.mean - there.mean)[plants].mean(axis=0)
    error = np.sqrt((here.variance + there.variance)[plants].sum(axis=0)) / plants.sum()
    brightness = here.mean[plants].mean(axis=0)
    assert np.all(error < 0.018 * brightness), "too noisy"
    assert np.all(np.abs(difference) < 4 * error)
