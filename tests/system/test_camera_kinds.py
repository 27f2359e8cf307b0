"""The identity pass of every kind of camera, against brute force along rays of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shots import alpha, shot
from ties import hits_around

from forestgen.core.parts import Part
from forestgen.core.progress import Timings
from forestgen.labels.masks import coverage_ranks, instance_mask
from forestgen.render.amodal import trace_amodal
from forestgen.render.frame import Identity, Surface
from forestgen.render.identity import SceneTracer, sample_offsets
from forestgen.render.identity.tracer import camera_rays
from forestgen.render.variant import mitsuba, using
from forestgen.scene.projection import image_circle, projection_of
from forestgen.scene.spec import Camera, SceneSpec
from support.cameras import KINDS, camera_of
from support.lens_points import lens_points
from support.scenes import dyadic_scene, plain_ground, window_hits
from support.twins import Oracle, trace_twin

WIDTH, HEIGHT, SAMPLES = 20, 14, 4
# Amid the plants: they stand all around, across the seam of a panorama too, and over an upward fisheye.
VIEWS = {kind: camera_of(kind, (WIDTH, HEIGHT), (33.0, 17.0, 3.0), (34.0, 30.0, 5.0)) for kind in KINDS}
VIEWS |= {
    "upward fisheye": camera_of("fisheye", (HEIGHT, HEIGHT), (34.7, 17.2, 0.6), (34.7, 17.201, 9.0)),
    "whole fisheye": camera_of("fisheye", (WIDTH, WIDTH), (33.0, 17.0, 3.0), (33.0, 40.0, 4.0), hfov_deg=360.0),
    "nadir": camera_of("orthographic", (WIDTH, HEIGHT), (33.0, 17.0, 200.0), (33.0, 17.0001, 0.0), width_m=30.0),
    "near lens": camera_of("thin lens", (WIDTH, HEIGHT), (33.0, -1.0, 4.0), (33.0, 17.0, 5.0)),
}


def crowd(plants: int) -> SceneSpec:
    """Within 12 m around the place of most views."""
    made = dyadic_scene(plants, quarter_turns=1, size_px=(WIDTH, HEIGHT))
    transform = made.instances.transform.copy()
    angle, far = 2.4 * np.arange(plants), 2.0 + 6.0 * np.arange(plants) / plants
    transform[:, 0, 3] = np.round(33.0 + far * np.cos(angle))
    transform[:, 1, 3] = np.round(17.0 + far * np.sin(angle))
    return replace(
        made,
        instances=replace(made.instances, transform=transform),
        terrain=plain_ground(-64, 128, 8, bumps_m=0.5),
    )


@pytest.fixture(scope="module")
def spec() -> SceneSpec:
    return crowd(9)


@pytest.fixture(scope="module")
def seen(spec) -> dict[str, tuple[Identity, Surface]]:
    found = {}
    for name, camera in VIEWS.items():
        found[name] = shot(SceneTracer(replace(spec, cameras=(camera,)), Timings()), camera, SAMPLES)
    return found


def grid(camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(H, W, S) image points of the samples, and their numbers."""
    width, height = camera.size_px
    offset = sample_offsets(SAMPLES)
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    x, y = column[..., None] + offset[:, 0], row[..., None] + offset[:, 1]
    return x, y, np.broadcast_to(np.arange(SAMPLES), x.shape)


@pytest.mark.parametrize("name", VIEWS)
def test_samples_are_those_of_brute_force(name, spec, seen):
    camera, (identity, _) = VIEWS[name], seen[name]
    oracle = Oracle(spec, camera)
    hits = oracle.trace(*grid(camera))
    plant, part = (values.reshape(identity.plant_id.shape) for values in (hits.plant_id, hits.part))
    differ = (identity.plant_id != plant) | (identity.part != part)
    assert differ.mean() <= 2e-3
    if camera.lens is None:
        for row, column, sample in np.argwhere(differ):
            x_px, y_px = np.array([column, row]) + sample_offsets(SAMPLES)[sample]
            hit = (int(identity.plant_id[row, column, sample]), int(identity.part[row, column, sample]))
            assert hit in hits_around(oracle, x_px, y_px)
    assert len(np.unique(plant)) > 2
    assert len(np.unique(part)) > 1


@pytest.mark.parametrize("name", VIEWS)
def test_surfaces_are_those_of_brute_force(name, spec, seen):
    camera, (_, surface) = VIEWS[name], seen[name]
    width, height = camera.size_px
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    hits = Oracle(spec, camera).trace(x, y)
    same = (surface.plant_id.ravel() == hits.plant_id) & (surface.face.ravel() == hits.face)
    assert same.mean() > 0.995
    hit = same & np.isfinite(hits.distance_m)
    assert hit.sum() > 5
    np.testing.assert_array_equal(np.isfinite(surface.depth_m).ravel()[same], hit[same])
    distance = surface.distance_m.ravel()[hit]
    np.testing.assert_allclose(distance, hits.distance_m[hit], rtol=2e-5)
    start, direction, _ = Oracle(spec, camera).rays(x.ravel(), y.ravel())
    point = np.asarray(camera.position_m) + start + direction * hits.distance_m[:, None]
    np.testing.assert_allclose(surface.position_m.reshape(-1, 3)[hit], point[hit], atol=3e-3)
    along = direction @ camera.world_from_camera[:, 2]
    depth = hits.distance_m * (1.0 if projection_of(camera).depth_is_distance else along)
    np.testing.assert_allclose(surface.depth_m.ravel()[hit], depth[hit], rtol=2e-5)
    for name_of, expected in (("normal", hits.normal), ("shading_normal", hits.shading_normal)):
        np.testing.assert_allclose(getattr(surface, name_of).reshape(-1, 3)[hit], expected[hit], atol=2e-5)


@pytest.mark.parametrize("name", VIEWS)
def test_the_expanded_twin_is_the_same(name, spec, seen):
    identity, surface = seen[name]
    twin = trace_twin(replace(spec, cameras=(VIEWS[name],)), VIEWS[name], SAMPLES)
    # A ray through an edge may go either way, by the processor: an instance's are rounded in its own frame.
    assert (identity.plant_id != twin.plant_id).sum() <= 1
    assert (identity.part != twin.part).sum() <= 1
    both = np.isfinite(surface.depth_m) & (surface.plant_id == twin.centre.plant_id)
    np.testing.assert_allclose(surface.depth_m[both], twin.depth_m[both], rtol=1e-4)
    assert (surface.sun_visible != twin.centre.sun_visible)[both].mean() < 5e-3


@pytest.mark.parametrize("name", ["fisheye", "upward fisheye", "whole fisheye"])
def test_nothing_is_outside_of_a_fisheyes_circle(name, seen):
    camera, (identity, surface) = VIEWS[name], seen[name]
    x, y, _ = grid(camera)
    width, height = camera.size_px
    outside = (x - width / 2) ** 2 + (y - height / 2) ** 2 > (width / 2) ** 2
    assert 0.05 < outside.mean() < 0.5
    assert (identity.part[outside] == Part.NOTHING).all()
    assert (identity.plant_id[outside] == 0).all()
    dark = ~image_circle(camera)
    assert np.isinf(surface.depth_m[dark]).all()
    assert np.isnan(surface.position_m[dark]).all()
    assert not surface.sun_visible[dark].any()


@pytest.mark.parametrize("name", VIEWS)
def test_amodal_counts_are_brute_forces_of_the_plant_alone(name, spec, seen):
    camera, (identity, _) = VIEWS[name], seen[name]
    ids, count = np.unique(identity.plant_id[identity.plant_id > 0], return_counts=True)
    tracer = SceneTracer(replace(spec, cameras=(camera,)), Timings())
    found = trace_amodal(tracer, camera, ids, samples=SAMPLES, timer=Timings(), advance=lambda done: None)
    mask = instance_mask(identity.plant_id)
    for row, plant in enumerate(ids):
        image = np.zeros(mask.shape, dtype=np.uint16)
        x, y, width, height = found.window_px[row]
        image[y : y + height, x : x + width] = window_hits(found, row)
        assert ((identity.plant_id == plant).sum(axis=2) <= image).all()
        left, top, right, bottom = found.full_box_px[row]
        assert np.floor(left) <= x
        assert np.floor(top) <= y
        assert np.ceil(right) >= x + width
        assert np.ceil(bottom) >= y + height
        if plant in ids[np.argsort(count)[-2:]]:
            lone = only(spec, plant)
            hits = Oracle(lone, camera).trace(*grid(camera))
            expected = (hits.plant_id.reshape(identity.plant_id.shape) == plant).sum(axis=2)
            assert np.abs(image.astype(int) - expected).sum() <= 2


def only(spec: SceneSpec, plant: int) -> SceneSpec:
    """One plant, and ground of one cell far below, where no view reaches."""
    kept = spec.instances.plant_id == plant
    instances = replace(
        spec.instances,
        exemplar=spec.instances.exemplar[kept],
        transform=spec.instances.transform[kept],
        plant_id=spec.instances.plant_id[kept],
    )
    ground = plain_ground(0, 1)
    low = (ground.mesh.vertices_m - np.array([0, 0, 1e6])).astype(np.float32)
    return replace(spec, instances=instances, terrain=replace(ground, mesh=replace(ground.mesh, vertices_m=low)))


def test_lens_rays_are_those_of_the_lens_points_and_meet_in_the_plane_of_focus():
    camera = camera_of("thin lens", (16, 12), (3.0, 4.0, 5.0), (8.0, 20.0, 3.0))
    assert camera.lens is not None
    mi, axes = mitsuba(), camera.world_from_camera
    tracer = SceneTracer(replace(dyadic_scene(1, quarter_turns=1, size_px=(16, 12)), cameras=(camera,)), Timings())
    with using(tracer.variant):
        rays = camera_rays(camera, sample_offsets(16), 0, 12)
        start, direction = np.array(mi.Vector3f(rays.shift_m)).T @ axes, np.array(rays.direction).T @ axes
    column, row = np.meshgrid(np.arange(16), np.arange(12))
    disc = lens_points(column[..., None], row[..., None], np.arange(16)).reshape(-1, 2)
    np.testing.assert_allclose(start[:, :2], disc * camera.lens.aperture_radius_m, atol=2e-7)
    np.testing.assert_allclose(start[:, 2], 0.0, atol=1e-8)
    at_focus = start + direction / direction[:, 2:] * camera.lens.focus_m
    offset = sample_offsets(16)
    x = (column[..., None] + offset[:, 0] - 8).ravel() / camera.focal_px * camera.lens.focus_m
    y = (row[..., None] + offset[:, 1] - 6).ravel() / camera.focal_px * camera.lens.focus_m
    np.testing.assert_allclose(at_focus[:, :2], np.stack([x, y], axis=1), atol=1e-5)


def test_a_lens_blurs_what_is_out_of_focus_and_nothing_else(spec):
    """Focused on the nearest plants; a wide one mixes several plants in a pixel of the distance."""
    sharp = camera_of("perspective", (64, 36), (33.0, -1.0, 4.0), (33.0, 17.0, 5.0))
    lens = camera_of("thin lens", (64, 36), (33.0, -1.0, 4.0), (33.0, 17.0, 5.0))
    assert lens.lens is not None
    pin = replace(lens, lens=replace(lens.lens, aperture_radius_m=1e-6))
    wide = replace(lens, lens=replace(lens.lens, aperture_radius_m=0.5))
    found = {
        name: shot(SceneTracer(replace(spec, cameras=(camera,)), Timings()), camera, 16)
        for name, camera in (("sharp", sharp), ("pin", pin), ("wide", wide))
    }
    assert (found["pin"][0].plant_id != found["sharp"][0].plant_id).mean() < 1e-3
    for field in ("depth_m", "plant_id", "normal"):
        np.testing.assert_array_equal(getattr(found["wide"][1], field), getattr(found["sharp"][1], field))
    mixed = {k: (coverage_ranks(v[0].plant_id).coverage[..., 1] > 0).mean() for k, v in found.items()}
    assert mixed["wide"] > 1.1 * mixed["sharp"]


@pytest.mark.parametrize("name", ["near lens", "orthographic", "fisheye", "panorama"])
def test_coverage_is_the_radiance_passes(name, spec):
    """Shares of rays that meet the scene, of two passes with rays of their own; in blocks of 4 x 4 pixels."""
    view = replace(VIEWS[name], size_px=(40, 28))
    if view.lens is not None:
        view = replace(view, lens=replace(view.lens, aperture_radius_m=0.3))
    scene = replace(spec, cameras=(view,))
    ours = (shot(SceneTracer(scene, Timings()), view, 64)[0].part != Part.NOTHING).mean(axis=2)
    samples = 256
    theirs = alpha(scene, samples)
    inside = np.ones(ours.shape, dtype=bool)
    if view.projection == "fisheye":
        column, row = np.meshgrid(np.arange(40), np.arange(28))
        inside = np.hypot(column + 0.5 - 20, row + 0.5 - 14) < 19
    share = np.where(inside, 0.5 * (ours + theirs), 0.0)
    spread = share * (1 - share) * (1 / 64 + 1 / samples) + 1e-4 * inside
    off, spread = (
        values.reshape(7, 4, 10, 4).sum(axis=(1, 3)) for values in (np.where(inside, ours - theirs, 0), spread)
    )
    score = off / np.sqrt(np.maximum(spread, 1e-12))
    assert (spread > 5e-3).mean() > 0.02, "no edges: the test compares nothing"
    assert np.abs(score).max() < 5
    assert abs(off.sum()) < 4 * np.sqrt(spread.sum())
