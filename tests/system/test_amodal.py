"""A plant's amodal counts are those of the plant alone: by brute force, by the identity pass of a scene that holds
nothing else, and bit by bit in crowded scenes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from shots import identity, shot

from forestgen.core.progress import Timings
from forestgen.geometry.mesh import Mesh
from forestgen.labels.masks import amodal_masks, instance_mask
from forestgen.render.amodal import alone_rays, alone_scene, frames_of_plants, trace_amodal
from forestgen.render.frame import Amodal
from forestgen.render.identity import SceneTracer, sample_offsets
from forestgen.render.variant import drjit, mitsuba
from forestgen.scene.spec import Camera, SceneSpec
from support.scenes import camera_at, dyadic_scene, plain_ground, scattered_scene, window_hits
from support.twins import Oracle

UNHEARD: dict[str, Any] = {"timer": Timings(), "advance": lambda rows: None}


def amodal(spec: SceneSpec, samples: int, ids: np.ndarray | None = None, camera: Camera | None = None) -> Amodal:
    """Of all plants of the scene by default, for its first camera."""
    asked = spec.instances.plant_id if ids is None else ids
    view = spec.cameras[0] if camera is None else camera
    tracer = SceneTracer(spec, Timings())
    done: list[int] = []
    result = trace_amodal(tracer, view, asked, samples=samples, timer=Timings(), advance=done.append)
    assert sum(done) == len(np.unique(asked))
    return result


def image_of(found: Amodal, row: int, camera: Camera) -> np.ndarray:
    """(H, W) counts of one plant; the window is tight."""
    image = np.zeros(camera.size_px[::-1], dtype=np.uint16)
    x, y, width, height = found.window_px[row]
    hits = window_hits(found, row)
    image[y : y + height, x : x + width] = hits
    if width:
        assert hits[0].any()
        assert hits[-1].any()
        assert hits[:, 0].any()
        assert hits[:, -1].any()
    return image


def counts_of(tracer: SceneTracer, camera: Camera, samples: int) -> np.ndarray:
    """(H, W) samples of the identity pass that hit any plant."""
    width, height = camera.size_px
    with mitsuba().variant_context(tracer.variant):
        hits = tracer.trace(camera, sample_offsets(samples), 0, height)
        return (np.array(hits.instance) * np.array(hits.valid) > 0).reshape(height, width, samples).sum(axis=2)


def only(spec: SceneSpec, rows: np.ndarray | list[int]) -> SceneSpec:
    """Some of the plants and no ground: its one triangle lies far outside of any view."""
    kept = np.asarray(rows, dtype=np.intp)
    instances = replace(
        spec.instances,
        exemplar=spec.instances.exemplar[kept],
        transform=spec.instances.transform[kept],
        plant_id=spec.instances.plant_id[kept],
    )
    corners = np.array([[0, 0, -1e6], [1, 0, -1e6], [0, 1, -1e6]], dtype=np.float32)
    mesh = Mesh(corners, np.array([[0, 1, 2]], dtype=np.uint32), uv=corners[:, :2].copy())
    ground = replace(spec.terrain, mesh=mesh, far_share=np.zeros(3, dtype=np.float32))
    return replace(spec, instances=instances, terrain=ground)


def crowded(seed: int = 1, plants: int = 200, size_px: tuple[int, int] = (160, 90)) -> SceneSpec:
    """General turns and scales, and some plants that lean."""
    ground = plain_ground(-64, 128, 8, bumps_m=0.5)
    spec = scattered_scene(plants, size_m=40, exemplars=4, leaves=200, size_px=size_px, terrain=ground, seed=seed)
    lean = spec.instances.transform.copy()
    lean[::2, :2, :3] += np.random.default_rng(seed).normal(size=(len(lean[::2]), 2, 3)) * 0.1
    return replace(spec, instances=replace(spec.instances, transform=lean))


def test_counts_equal_brute_force_in_double_precision():
    width, height = 32, 18
    spec = dyadic_scene(40, quarter_turns=1, size_px=(width, height))
    camera, samples = spec.cameras[0], 4
    seen = identity(spec, 16).plant_id
    ids = np.unique(seen[seen > 0])[:5]
    found = amodal(spec, samples, ids)
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    offset = sample_offsets(samples)
    for number, plant in enumerate(ids):
        lone = only(spec, np.flatnonzero(spec.instances.plant_id == plant))
        hits = Oracle(lone, camera).trace(column[..., None] + offset[:, 0], row[..., None] + offset[:, 1])
        expected = (hits.plant_id.reshape(height, width, samples) == plant).sum(axis=2)
        np.testing.assert_array_equal(image_of(found, number, camera), expected)
    assert len(ids) == 5


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)])
def test_the_two_passes_hit_the_same_point_to_the_last_bit(seed):
    """Distance and barycentric coordinates of every visible sample, not only whether it hits."""
    spec, samples = crowded(seed), 16
    spec = replace(spec, cameras=(*spec.cameras, camera_at((7.3, 11.9, 3.1), (30.0, 17.0, 4.0), (160, 90))))
    tracer = SceneTracer(spec, Timings())
    mi, offsets = mitsuba(), sample_offsets(samples)
    compared = 0
    with mi.variant_context(tracer.variant):
        scenes = [alone_scene(exemplar) for exemplar in spec.exemplars]
        frames = frames_of_plants(spec.instances.transform, tracer.origin_m)
        for camera in spec.cameras:
            width, height = camera.size_px
            hits = tracer.trace(camera, offsets, 0, height)
            truth = np.stack([np.array(x) for x in (hits.distance_m, hits.uv.x, hits.uv.y)])
            instance = np.array(hits.instance) * np.array(hits.valid)
            for entry in np.unique(instance[instance > 0]):
                mine = np.flatnonzero(instance == entry)
                pixel = np.unique(mine // samples)
                frame = mi.Float(frames[entry - 1])
                column, row = (pixel % width).astype(np.uint32), (pixel // width).astype(np.uint32)
                rays, _ = alone_rays(tracer, camera, offsets, frame, np.zeros_like(row), column, row)
                scene = scenes[spec.instances.exemplar[entry - 1]]
                hit = scene.ray_intersect_preliminary(rays, coherent=True)
                ours = np.stack([np.array(x) for x in (hit.t, hit.prim_uv.x, hit.prim_uv.y)])
                where = np.searchsorted(pixel, mine // samples) * samples + mine % samples
                nearest = ours[:, where]
                assert np.isfinite(nearest[0]).all()
                np.testing.assert_array_equal(nearest, truth[:, mine])
                compared += len(mine)
    assert compared > 50_000


@pytest.mark.parametrize("samples", [1, 16, 64])
def test_visible_samples_are_within_amodal_samples(samples):
    spec = crowded(4)
    camera, seen = spec.cameras[0], identity(spec, samples).plant_id
    ids = np.unique(seen[seen > 0])
    found = amodal(spec, samples, ids)
    assert len(ids) > 50
    hidden = 0
    for row, plant in enumerate(ids):
        visible, alone = (seen == plant).sum(axis=2), image_of(found, row, camera)
        assert (visible <= alone).all()
        hidden += int((alone > visible).sum())
    assert hidden > 30 * samples, "nothing is hidden: the test compares nothing"
    instance = instance_mask(seen)
    masks = amodal_masks(found, seen, instance)
    for row, plant in enumerate(ids):
        x, y, width, height = masks.box_px[row]
        inside = np.zeros_like(instance, dtype=bool)
        inside[y : y + height, x : x + width] = masks.mask_of(row)
        assert inside[instance == plant].all()


def test_what_stands_in_front_does_not_matter():
    spec = crowded(5)
    few = only(spec, np.arange(0, 200, 4))
    ids = few.instances.plant_id
    among_many, among_few = amodal(spec, 16, ids), amodal(few, 16, ids)
    for name in ("plant_id", "window_px", "first", "hits", "full_box_px"):
        np.testing.assert_array_equal(getattr(among_many, name), getattr(among_few, name))
    assert among_many.hits.sum() > 10_000


# Of six plants in two rows; a wide view from inside the crown of the second has others behind it and beside it.
VIEWS = {
    "whole": camera_at((20.0, -8.0, 4.0), (20.0, 20.0, 5.0), (48, 27)),
    "partly outside the image": camera_at((20.0, 4.0, 3.0), (21.0, 15.0, 5.0), (48, 27), hfov_deg=25),
    "inside a crown": camera_at((20.0, 15.0, 6.0), (24.0, 30.0, 5.0), (48, 27), hfov_deg=100),
    "from above": camera_at((20.0, 20.0, 40.0), (20.1, 20.0, 0.0), (48, 27)),
}


def test_counts_are_those_of_a_scene_that_holds_nothing_else():
    samples, plants = 16, 6
    spec = crowded(6, plants=plants)
    transform = spec.instances.transform.copy()
    transform[:, 0, 3], transform[:, 1, 3] = 16 + np.arange(plants) % 3 * 4, 15 + np.arange(plants) // 3 * 5
    spec = replace(spec, instances=replace(spec.instances, transform=transform))
    spec = replace(spec, cameras=tuple(VIEWS.values()))
    together, shown = SceneTracer(spec, Timings()), dict.fromkeys(VIEWS, 0)
    for row in range(plants):
        lone = SceneTracer(only(spec, [row]), Timings())
        for name, camera in VIEWS.items():
            expected = counts_of(lone, camera, samples)
            found = trace_amodal(together, camera, spec.instances.plant_id[[row]], samples=samples, **UNHEARD)
            np.testing.assert_array_equal(image_of(found, 0, camera), expected)
            shown[name] += bool(expected.any())
    assert min(shown.values()) >= 3, shown


def test_a_plant_of_one_sample_and_ids_of_32_bits():
    spec = crowded(7)
    large = (np.uint64(2**32) - np.arange(1, 201, dtype=np.uint64)).astype(np.uint32)
    spec = replace(spec, instances=replace(spec.instances, plant_id=large))
    assert int(large[0]) == 2**32 - 1
    small = spec.instances.transform.copy()
    small[:, :, :3] *= 0.05
    spec = replace(spec, instances=replace(spec.instances, transform=small))
    ids, count = np.unique(identity(only(spec, np.arange(200)), 4).plant_id, return_counts=True)
    least = ids[1:][count[1:] == 1][:3]
    assert len(least)
    found = amodal(spec, 4, np.append(least, large[0]))
    assert found.plant_id[-1] == 2**32 - 1
    for row, plant in enumerate(found.plant_id):
        lone = SceneTracer(only(spec, np.flatnonzero(large == plant)), Timings())
        expected = counts_of(lone, spec.cameras[0], 4)
        np.testing.assert_array_equal(image_of(found, row, spec.cameras[0]), expected)


def test_order_of_plants_and_size_of_blocks_do_not_matter(monkeypatch):
    spec = crowded(8)
    ids = spec.instances.plant_id
    once = amodal(spec, 16, ids)
    monkeypatch.setattr("forestgen.render.amodal._RAYS_AT_ONCE", 1000)
    monkeypatch.setattr("forestgen.render.amodal._PIXELS_AT_ONCE", 300)
    again = amodal(spec, 16, np.random.default_rng(0).permutation(ids)[:60])
    assert (np.diff(again.plant_id.astype(np.int64)) > 0).all()
    for row, plant in enumerate(again.plant_id):
        other = int(np.searchsorted(once.plant_id, plant))
        np.testing.assert_array_equal(again.window_px[row], once.window_px[other])
        np.testing.assert_array_equal(window_hits(again, row), window_hits(once, other))


def test_two_cameras_share_one_tracer():
    spec = crowded(9, plants=60)
    spec = replace(spec, cameras=(*spec.cameras, camera_at((3.0, 45.0, 7.0), (20.0, 20.0, 3.0), (64, 36))))
    tracer = SceneTracer(spec, Timings())
    for camera in spec.cameras:
        seen, _ = shot(tracer, camera, 4)
        ids = np.unique(seen.plant_id[seen.plant_id > 0])
        found = trace_amodal(tracer, camera, ids, samples=4, **UNHEARD)
        for row, plant in enumerate(ids):
            assert ((seen.plant_id == plant).sum(axis=2) <= image_of(found, row, camera)).all()


def test_no_plant_is_asked_for():
    found = amodal(crowded(plants=5), 16, np.zeros(0, dtype=np.uint32))
    assert found.plant_id.shape == (0,)
    assert found.window_px.shape == found.full_box_px.shape == (0, 4)
    assert found.first.tolist() == [0]
    assert amodal_masks(found, *(np.ones((90, 160, *more), dtype=np.uint32) for more in ((16,), ()))).pixels.shape == (
        0,
    )


def test_unknown_plants_and_impossible_samples_are_refused():
    spec = crowded(plants=5)
    tracer = SceneTracer(spec, Timings())
    for ids in ([0], [6], [1, 2**32 - 1]):
        with pytest.raises(ValueError, match="no instance"):
            trace_amodal(tracer, spec.cameras[0], np.array(ids, dtype=np.uint32), samples=16, **UNHEARD)
    for samples in (0, 2, 1025, 1089):
        with pytest.raises(ValueError, match="samples must be"):
            trace_amodal(tracer, spec.cameras[0], spec.instances.plant_id, samples=samples, **UNHEARD)


def test_one_kernel_serves_all_exemplars_and_all_numbers_of_plants():
    spec, dr = crowded(3, plants=40), drjit()
    tracer, ids = SceneTracer(spec, Timings()), spec.instances.plant_id
    trace_amodal(tracer, spec.cameras[0], ids[:30], samples=16, **UNHEARD)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        trace_amodal(tracer, spec.cameras[0], ids, samples=16, **UNHEARD)
        launched = [kernel for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT]
    assert len(launched) == len(np.unique(spec.instances.exemplar)) == 4
    assert len({kernel["hash"] for kernel in launched}) == 1
    assert all(kernel["cache_hit"] for kernel in launched)
