"""Cameras that move while their shutter is open: labels by row, light over the exposure, and what files say of it."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import partial

import numpy as np
import pytest
from shots import shot

from forestgen.core.progress import Timings
from forestgen.labels.labelled import project
from forestgen.recipe.exposure import Exposure
from forestgen.render.amodal import trace_amodal
from forestgen.render.denoise import open_values
from forestgen.render.identity import SceneTracer
from forestgen.render.identity.surface import SAMPLES, pixel_sums
from forestgen.render.light import sky_map
from forestgen.render.paths.tracer import PathTracer
from forestgen.scene.colour import RGB
from forestgen.scene.motion import row_times_s, still_at
from forestgen.scene.spec import Camera, CameraMotion, SceneSpec
from support.cameras import KINDS, camera_of
from support.scenes import scattered_scene, window_hits
from support.twins import trace_twin

SIZE = (24, 10)
FAST = CameraMotion((6.0, 3.0, -2.0), (0.4, -0.9, 0.5), 0.2)


def moving(kind: str, motion: CameraMotion | None = FAST, **exposure: float) -> Camera:
    size = (2 * SIZE[1], SIZE[1]) if kind == "panorama" else SIZE
    target = (20.0, 20.0, 0.0) if kind == "orthographic" else None
    place = (20.0, 19.0, 30.0) if kind == "orthographic" else (20.0, 2.0, 3.0)
    return camera_of(kind, size, place, target, motion=motion, exposure=Exposure(shutter_s=0.1, **exposure))


def scene(camera: Camera) -> SceneSpec:
    return replace(scattered_scene(60, size_m=40.0, exemplars=4, leaves=300), cameras=(camera,))


@pytest.mark.parametrize("kind", KINDS)
def test_each_row_of_a_rolling_shutter_is_that_of_a_camera_that_stands_still_there(kind):
    camera = moving(kind)
    tracer = SceneTracer(scene(camera), Timings())
    identity, surface = shot(tracer, camera, 4, faces=True)
    for row, time in enumerate(row_times_s(camera)):
        for found, still in zip((identity, surface), shot(tracer, still_at(camera, time), 4, faces=True), strict=True):
            for field in fields(found):
                got, expected = getattr(found, field.name)[row], getattr(still, field.name)[row]
                if field.name == "position_m":
                    np.testing.assert_allclose(got, expected, atol=2e-5)
                else:
                    np.testing.assert_array_equal(got, expected, field.name)
    standing, _ = shot(tracer, replace(camera, motion=None), 4)
    assert (standing.plant_id != identity.plant_id).mean() > 0.01


def test_labels_of_a_rolling_shutter_are_those_of_the_expanded_twin():
    camera = moving("perspective")
    spec = scene(camera)
    identity, surface = shot(SceneTracer(spec, Timings()), camera, 4)
    for row, time in enumerate(row_times_s(camera)):
        twin = trace_twin(spec, still_at(camera, time), 4)
        np.testing.assert_array_equal(identity.plant_id[row], twin.plant_id[row])
        np.testing.assert_array_equal(identity.part[row], twin.part[row])
        np.testing.assert_allclose(surface.depth_m[row], twin.depth_m[row], rtol=2e-5)


def counts(tracer: SceneTracer, camera: Camera, ids: np.ndarray) -> np.ndarray:
    """(M, H, W) samples of each plant alone."""
    found = trace_amodal(tracer, camera, ids, samples=4, timer=Timings(), advance=lambda plants: None)
    images = np.zeros((len(ids), *camera.size_px[::-1]), dtype=int)
    for row, (left, top, width, height) in enumerate(found.window_px):
        images[row, top : top + height, left : left + width] = window_hits(found, row)
    return images


def test_plants_alone_under_a_rolling_shutter_lose_no_sample():
    camera = moving("perspective")
    tracer = SceneTracer(scene(camera), Timings())
    ids = np.setdiff1d(shot(tracer, camera, 4)[0].plant_id, [0]).astype(np.uint32)
    found = counts(tracer, camera, ids)
    stills = [still_at(camera, time) for time in row_times_s(camera)]
    expected = [counts(tracer, still, ids)[:, row] for row, still in enumerate(stills)]
    np.testing.assert_array_equal(found, np.stack(expected, axis=1))


def light(tracer: SceneTracer, camera: Camera, samples: int, seed: int) -> np.ndarray:
    """(H, W, 4) light scattered once, by the sun's on the ground, and share of each pixel that is open."""
    paths = PathTracer(tracer, camera, 2, partial(sky_map, tracer.spec.sky))
    paths.show(RGB)
    image = paths.take(samples, seed)
    return np.concatenate([(image.by_sky + image.by_sun) / 2000.0, image.open[..., None]], axis=-1)


@pytest.mark.parametrize("kind", ["perspective", pytest.param("orthographic", marks=pytest.mark.slow)])
def test_a_blurred_image_is_the_mean_of_still_ones_through_the_shutter(kind):
    camera = moving(kind, CameraMotion((6.0, 3.0, -2.0), (0.4, -1.5, 3.0), 0.0))
    tracer = SceneTracer(scene(camera), Timings())
    times = ((np.arange(16) + 0.5) / 16 - 0.5) * 0.1
    mean = np.mean([light(tracer, still_at(camera, time), 64, k) for k, time in enumerate(times)], axis=0)
    standing = light(tracer, replace(camera, motion=None), 1024, 1)
    apart = np.abs(light(tracer, camera, 1024, 99) - mean).mean()
    assert apart < 0.015
    assert apart < 0.5 * np.abs(standing - mean).mean()
    guide = pixel_sums(tracer, camera, [open_values])[0][0] / SAMPLES
    assert np.abs(guide - mean[..., 3]).mean() < 0.02


def test_points_appear_in_the_row_whose_pose_shows_them_there():
    camera = moving("perspective")
    points = np.random.default_rng(1).random((200, 3)) * [40.0, 30.0, 8.0] + [0.0, 8.0, 0.0]
    found = project(camera, points)
    inside = ((found > 0) & (found < SIZE)).all(axis=1)
    assert inside.sum() > 20
    for point, (x, y) in zip(points[inside], found[inside], strict=True):
        still = still_at(camera, float(row_times_s(camera, np.array(y))))
        np.testing.assert_allclose(project(still, point), (x, y), atol=1e-3)
