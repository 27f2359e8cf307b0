"""Identity in views that are hard for labels: each with its exact truth, or against the expanded twin."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from plain_tracer import trace_plainly
from shots import identity, need_cuda, seen, shot
from ties import assert_ties

from forestgen.community.simulation import final_population
from forestgen.core.parts import Part
from forestgen.core.progress import Silent, Timings
from forestgen.geometry.mesh import Mesh
from forestgen.labels.masks import coverage_ranks, instance_mask
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.recipe.load import load_recipe
from forestgen.render.identity import SceneTracer, sample_offsets
from forestgen.render.variant import CUDA
from forestgen.scene.build import build_scene
from forestgen.scene.plan import make_plan
from forestgen.scene.spec import Camera, Instances, Material, SceneSpec
from support.guides import trace_guides
from support.scenes import camera_at, dyadic_scene, plain_ground, scattered_scene
from support.twins import trace_twin

DOWN = np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]])  # columns: right is east, down is south, forward is down


def organ_plant(mesh: Mesh, part: Part = Part.LEAF) -> Exemplar:
    organ = OrganMesh(part, "leaf", mesh)
    return Exemplar("kind", (organ,), 1.0, 1.0, 1.0, leaf_area_m2=1.0, wood_volume_m3=0.0)


def square(side_m: float) -> Mesh:
    half = side_m / 2
    corners = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]], dtype=np.float32)
    return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32))


def scene_of(
    exemplars: list[Exemplar], which: list[int], place_m: np.ndarray, ids: np.ndarray, camera: Camera
) -> SceneSpec:
    transform = np.tile(np.eye(4)[:3], (len(ids), 1, 1))
    transform[:, :, 3] = place_m
    return replace(
        scattered_scene(1, exemplars=1, leaves=4, terrain=plain_ground(-500, 500)),
        exemplars=tuple(exemplars),
        materials={("kind", "leaf"): Material((0.1, 0.2, 0.1))},
        instances=Instances(np.asarray(which, np.uint32), transform, ids.astype(np.uint32)),
        cameras=(camera,),
    )


@pytest.mark.parametrize(("width", "height"), [(160, 120), pytest.param(640, 480, marks=pytest.mark.slow)])
def test_every_plant_of_a_field_has_its_four_pixels(width, height):
    """Squares of nearly 2 x 2 pixels seen from above; 76,800 of them in the larger image, ids above 65,535 in both."""
    size_m, eye_m = 2.0, 100.0
    camera = Camera("down", (0.0, 0.0, eye_m), DOWN, (width, height), 40.0)
    pixel_m = (eye_m - 1.0) / camera.focal_px  # at the squares' height, above the ground
    x, y = np.meshgrid(np.arange(width // 2) * 2 + 1 - width / 2, np.arange(height // 2) * 2 + 1 - height / 2)
    count = x.size
    place = np.stack([x * pixel_m, -y * pixel_m, np.full(x.shape, 1.0)], axis=-1).reshape(-1, 3)
    ids = np.arange(count) + (1 if count > 70_000 else 65_000)
    spec = scene_of([organ_plant(square(1.9 / 2 * size_m * pixel_m))], [0] * count, place, ids, camera)
    ours = identity(spec, 4)
    expected = np.kron(ids.reshape(height // 2, width // 2), np.ones((2, 2), dtype=np.int64))
    assert expected.max() > 65_535
    np.testing.assert_array_equal(ours.plant_id, np.broadcast_to(expected[..., None], ours.plant_id.shape))


def test_a_plant_of_one_sample_has_that_sample_and_no_pixel():
    camera = Camera("down", (0.0, 0.0, 10.0), DOWN, (20, 10), 40.0)
    pixel_m = 10.0 / camera.focal_px
    column, row, number = 7, 3, 11
    offset = sample_offsets(16)[number]
    x, y = (column + offset[0] - 10) * pixel_m, -(row + offset[1] - 5) * pixel_m
    spec = scene_of([organ_plant(square(0.2 * pixel_m))], [0], np.array([[x, y, 0.01]]), np.array([9]), camera)
    ours = identity(spec, 16)
    assert np.argwhere(ours.plant_id).tolist() == [[row, column, number]]
    ranks = coverage_ranks(ours.plant_id)
    assert (ranks.plant_id[row, column, :2].tolist(), ranks.coverage[row, column, 1]) == ([0, 9], 1 / 16)
    assert not instance_mask(ours.plant_id).any()


def test_a_sapling_behind_a_trunk_shows_what_sticks_out():
    """Both are squares across the view. The sapling is hidden whole, then half; beside the trunk it covers 12 px."""
    camera = camera_at((0.0, -10.0, 2.0), (0.0, 0.0, 2.0), (64, 64), 40.0)
    upright = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], dtype=np.float32)
    wide, narrow = (
        organ_plant(replace(square(side), vertices_m=square(side).vertices_m @ upright.T), part)
        for side, part in ((2.0, Part.TRUNK), (1.2, Part.LEAF))
    )
    focal = camera.focal_px
    for x_m, shown in ((0.0, 0.0), (1.1, 0.0), (1.9, 1.0)):
        place = np.array([[0.0, 0.0, 2.0], [x_m, 2.0, 2.0]])
        ours = identity(scene_of([wide, narrow], [0, 1], place, np.array([5, 6]), camera), 16)
        left, right = ((x_m + side) / 12 * focal for side in (-0.6, 0.6))
        hidden_to = 1.0 / 10 * focal
        height = 1.2 / 12 * focal
        width = max(0.0, right - max(left, hidden_to))
        area = (ours.plant_id == 6).sum() / 16
        assert area == pytest.approx(width * height, abs=(2 * height + 2 * width) / 8 + 1e-9)
        assert (area == 0.0) == (x_m == 0.0)
        whole = (right - left) * height
        assert not shown or area == pytest.approx(whole, rel=0.1)


def test_a_view_of_the_sky_alone_is_empty():
    camera = camera_at((0.0, 0.0, 3.0), (1.0, 1.0, 60.0), (24, 16))
    spec = replace(scattered_scene(3, exemplars=1, leaves=4, terrain=plain_ground(-50, 50)), cameras=(camera,))
    aside = replace(spec.instances, transform=spec.instances.transform + np.array([0, 0, 0, 100.0]))
    ours, surface = seen(replace(spec, instances=aside), 4, faces=True)
    for values in (ours.plant_id, ours.part, ours.exemplar, ours.face, surface.plant_id, surface.part):
        assert not values.any()
    guides = trace_guides(SceneTracer(replace(spec, instances=aside), Timings()), camera)
    np.testing.assert_array_equal(guides.colour, 1.0)
    np.testing.assert_array_equal(guides.normal, 0.0)
    assert np.isinf(surface.depth_m).all()
    ranks = coverage_ranks(ours.plant_id)
    np.testing.assert_array_equal(ranks.coverage.sum(axis=2), 1.0)


def test_no_plants_at_all():
    nobody = Instances(np.zeros(0, np.uint32), np.zeros((0, 3, 4)), np.zeros(0, np.uint32))
    spec = scattered_scene(1, exemplars=1, leaves=4, size_px=(24, 16), terrain=plain_ground(-50, 50))
    ours, surface = seen(replace(spec, instances=nobody), 4)
    assert not ours.plant_id.any()
    assert set(np.unique(surface.part).tolist()) == {Part.NOTHING, Part.GROUND}


def test_from_inside_a_crown_all_samples_equal_the_twins():
    spec = dyadic_scene(60, quarter_turns=4, size_px=(64, 36))
    x, y, _ = spec.instances.transform[7, :, 3]
    tree, scale = spec.exemplars[int(spec.instances.exemplar[7])], spec.instances.transform[7, 2, 2]
    eye = (x + 0.25, y + 0.25, float(np.round(10.4 * tree.height_m * scale) / 16))
    camera = camera_at(eye, (x + 20, y + 9, 3), (64, 36), 90.0)
    spec = replace(spec, cameras=(camera,))
    ours, twin = identity(spec, 16), trace_twin(spec, camera, 16)
    assert (ours.plant_id == spec.instances.plant_id[7]).mean() > 0.03
    assert_ties(spec, ours, twin)


def test_two_cameras_of_one_tracer_see_what_each_sees_alone():
    ground = plain_ground(-64, 128, 24, bumps_m=0.5)
    spec = scattered_scene(150, size_m=60, exemplars=4, leaves=200, size_px=(160, 90), terrain=ground, seed=6)
    cameras = (
        camera_at((30.0, -8.0, 4.0), (30.0, 30.0, 5.0), (160, 90)),
        camera_at((68.0, 60.0, 9.0), (30.0, 30.0, 5.0), (120, 90)),
        camera_at((30.0, 30.0, 48.0), (31.0, 31.0, 0.0), (160, 90)),
    )
    tracer = SceneTracer(replace(spec, cameras=cameras), Timings())
    assert np.linalg.norm(tracer.origin_m - cameras[0].position_m) > 20
    for camera in cameras:
        alone = replace(spec, cameras=(camera,))
        together, surface = shot(tracer, camera, 16)
        apart, surface_apart = seen(alone, 16)
        assert len(np.unique(apart.plant_id)) > 30
        assert_ties(alone, together, apart, tie_px=4e-4, most=1e-4)
        same = (surface.face == surface_apart.face) & (surface.plant_id == surface_apart.plant_id)
        assert same.mean() > 0.999
        np.testing.assert_allclose(surface.position_m[same], surface_apart.position_m[same], atol=1e-3)
        np.testing.assert_allclose(surface.depth_m[same], surface_apart.depth_m[same], rtol=1e-4)


RECIPE = """
forestgen: 1
seed: 12
site: {size_m: [14, 14], terrain: rolling}
species: {fireweed: , poplar: }
community: {model: multiset_lsystem, program: succession, steps: 40}
plants: {exemplars_per_species: 3}
sky: {sun: {elevation_deg: 38, azimuth_deg: 140}}
cameras:
  - {name: south, position_m: [7, -4, 2.2], look_at_m: [7, 7, 2.0], size_px: [96, 54], hfov_deg: 62}
  - {name: far, position_m: [7, -70, 6], look_at_m: [7, 7, 2.0], size_px: [96, 54], hfov_deg: 14}
labels: {samples: 16}
"""


@pytest.mark.slow
def test_real_plants_scaled_and_in_levels_of_detail_equal_their_twins(tmp_path: Path):
    """Exemplars of the pipeline: several of a species by k-means, each scaled to its plants, in levels of detail."""
    path = tmp_path / "stand.yaml"
    path.write_text(RECIPE, encoding="utf-8")
    plan = make_plan(load_recipe(path).draw(0))
    spec = build_scene(plan, final_population(plan.community, Silent()), Silent(), Timings()).spec
    instances = spec.instances
    assert len(instances) >= 30
    assert len(np.unique(np.round(np.linalg.det(instances.transform[:, :, :3]), 4))) > 10
    kinds = [spec.exemplars[k].species for k in np.unique(instances.exemplar)]
    assert max(kinds.count(kind) for kind in kinds) > 2
    for camera in spec.cameras:
        alone = replace(spec, cameras=(camera,))
        ours, surface = seen(alone, 16, faces=True)
        twin = trace_twin(alone, camera, 16)
        differ = (ours.plant_id != twin.plant_id) | (ours.part != twin.part) | (ours.face != twin.face)
        assert differ.mean() < 2e-4
        mask, twin_mask = instance_mask(ours.plant_id), instance_mask(twin.plant_id)
        assert len(np.unique(mask)) > 10
        assert (mask != twin_mask).sum() <= 1
        same = (surface.plant_id == twin.centre.plant_id) & (surface.face == twin.centre.face)
        assert same.mean() > 0.999
        np.testing.assert_allclose(surface.depth_m[same], twin.depth_m[same], rtol=1e-4)
        assert (surface.sun_visible[same] != twin.centre.sun_visible[same]).mean() < 0.01


@pytest.mark.slow
def test_a_tracer_of_other_arithmetic_differs_by_ties_alone():
    """What a GPU may change, shown without one: 3 of 230,400 samples, each proven to lie on an edge."""
    ground = plain_ground(-64, 128, 24, bumps_m=0.5)
    spec = scattered_scene(150, size_m=60, exemplars=4, leaves=200, size_px=(160, 90), terrain=ground, seed=6)
    ours, surface = seen(spec, 16, faces=True)
    theirs, centre = (trace_plainly(spec, spec.cameras[0], samples) for samples in (16, 1))
    assert len(np.unique(theirs.plant_id)) > 100
    assert_ties(spec, ours, theirs)
    assert ours.face is not None
    same = (ours.face == theirs.face) & (ours.plant_id == theirs.plant_id)
    assert same.mean() > 0.9999
    both = (surface.face == centre.face[..., 0]) & (surface.plant_id == centre.plant_id[..., 0])
    assert both.mean() > 0.9999
    np.testing.assert_allclose(surface.distance_m[both], centre.distance_m[..., 0][both], rtol=2e-5)


@pytest.mark.gpu
def test_cuda_and_llvm_differ_by_ties_alone():
    need_cuda()
    ground = plain_ground(-64, 128, 24, bumps_m=0.5)
    spec = scattered_scene(150, size_m=60, exemplars=4, leaves=200, size_px=(160, 90), terrain=ground, seed=6)
    ours, surface = seen(spec, 16, faces=True)
    theirs, their_surface = seen(spec, 16, faces=True, variant=CUDA)
    assert_ties(spec, ours, theirs, tie_px=4e-4, most=1e-4)
    same = (surface.face == their_surface.face) & (surface.plant_id == their_surface.plant_id)
    assert same.mean() > 0.999
    for name in ("depth_m", "distance_m", "normal", "shading_normal", "albedo"):
        np.testing.assert_allclose(
            getattr(surface, name)[same], getattr(their_surface, name)[same], rtol=1e-3, atol=1e-3
        )
    assert (surface.sun_visible[same] == their_surface.sun_visible[same]).mean() > 0.995
