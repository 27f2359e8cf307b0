"""Clouds traced with the scene: bricks let through what the field lets through, fog, furnaces, and the parted way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.atmosphere.grid import CloudGrid, PhaseFunction
from forestgen.atmosphere.optical_depth import optical_depth
from forestgen.core.errors import RenderError
from forestgen.core.progress import Timings
from forestgen.render import exact_view
from forestgen.render.build import load, origin_of, scene_dict
from forestgen.render.capture import capture
from forestgen.render.cloud_bricks import Bricks, brick_shapes, camera_shell, divide
from forestgen.render.exact_view import ExactView, clear_air_m, endless_tracer
from forestgen.render.frame import RenderJob, StoppingCriterion
from forestgen.render.light import along, emitters_of, sky_light, sky_map
from forestgen.render.surfaces import SpectralBsdfs
from forestgen.render.variant import SCALAR, path_tracer, using
from forestgen.render.volume_random_walk import WalkField
from forestgen.scene.colour import RGB, Channels
from forestgen.scene.spec import SceneSpec, Sky
from support.cloud_box import cloud_volume
from support.error_messages import raises_error
from support.radiometry import radiance
from support.scenes import camera_at, plain_ground, scattered_scene


def field(seed: int = 1, low_m=(-500.0, -500.0, 100.0), high_m=(500.0, 500.0, 300.0), most: float = 0.05) -> CloudGrid:
    """A lumpy field with clear air between, dense up to its border."""
    from scipy.ndimage import gaussian_filter

    lumps = gaussian_filter(np.random.default_rng(seed).normal(size=(14, 26, 30)), 1.5)
    value = np.clip(lumps / lumps.std() - 0.3, 0, None)
    return CloudGrid((most * value / value.max()).astype(np.float32), low_m, high_m)


def uniform_fog(sigma: float, half_m: float = 200.0, albedo: float = 0.0) -> CloudGrid:
    value = np.full((10, 20, 20), sigma, dtype=np.float32)
    return CloudGrid(value, (-half_m, -half_m, -10.0), (half_m, half_m, 90.0), albedo=albedo, phase=PhaseFunction(0.5))


def rays_up(count: int, least_deg: float = 8.0) -> np.ndarray:
    rng = np.random.default_rng(2)
    up, around = np.radians(rng.uniform(least_deg, 89.0, count)), rng.uniform(0, 2 * np.pi, count)
    return np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], axis=1)


WHITE = {"type": "constant", "radiance": 1.0}


@pytest.mark.parametrize("shift_m", [0.0, 4000.0])
def test_bricks_let_through_what_the_field_lets_through(shift_m):
    """Against the exact integral, to 0.3% of what the field lets through, also from kilometres away."""
    clouds = field(low_m=(shift_m - 500.0, -500.0, 100.0), high_m=(shift_m + 500.0, 500.0, 300.0), most=0.1)
    direction = rays_up(16000, 25.0)
    start = np.array([shift_m, 0.0, 0.0]) + np.zeros((len(direction), 3))
    expected = np.exp(-optical_depth(clouds, start, direction, np.full(len(direction), np.inf)))
    with using(SCALAR):
        bricks = divide(clouds, np.zeros(3), 4)
        shapes, _ = brick_shapes(clouds, bricks, np.zeros(3), albedo=0.0)
        seen = radiance(load({**shapes, "sky": WHITE}), path_tracer("volpath", -1, rr_depth=10**6), start, direction, 1)
    off = seen[:, 0] - expected
    assert bricks.count > 60
    assert abs(off.mean()) < 0.003 * expected.mean() + 3.5 * off.std() / np.sqrt(len(off))
    assert 0.2 < expected.mean() < 0.9
    assert off.std() / np.sqrt(len(off)) < 0.008 * expected.mean()


def test_clouds_that_absorb_nothing_stay_white():
    clouds = replace(field(), albedo=1.0)
    start = np.zeros((300, 3))
    with using(SCALAR):
        shapes, _ = brick_shapes(clouds, divide(clouds, start[0], 4), np.zeros(3))
        world = load({**shapes, "sky": WHITE | {"sampling_weight": 0.0}, "lamp": {"type": "point", "intensity": 0.0}})
        direction = rays_up(300)
        seen = radiance(world, path_tracer("volpath", -1, rr_depth=10**6), start, direction, 1)
    assert abs(seen.mean() - 1.0) < 0.002
    walks = WalkField.of(clouds, np.zeros(3)).walk(start, direction, None, 3)
    assert np.all(walks.weight == 1.0)


def test_bricks_leave_out_clear_air_and_keep_the_place_away_from_faces():
    clouds = field()
    bricks = divide(clouds, np.array([0.0, 0.0, 200.0]), 4)
    assert 0 < bricks.count < bricks.number.size
    cell = (np.array([0.0, 0.0, 200.0]) - clouds.low_m) / clouds.cell_m
    for cuts, one in zip(bricks.cuts, cell, strict=True):
        assert np.abs(cuts[1:-1] - one).min() >= 1.0


def test_a_walk_that_meets_nothing_is_as_likely_as_the_field_is_clear():
    clouds = field()
    direction = rays_up(40000)
    start = np.zeros_like(direction)
    walks = WalkField.of(clouds, np.zeros(3)).walk(start, direction, None, 5)
    passed = np.all(walks.direction == direction, axis=1) & (walks.weight == 1.0)
    expected = np.exp(-optical_depth(clouds, start, direction, np.full(len(direction), np.inf)))
    off = passed - expected
    assert abs(off.mean()) < 3.5 * off.std() / np.sqrt(len(off))
    again = WalkField.of(clouds, np.zeros(3)).walk(start, direction, None, 5)
    assert np.array_equal(again.leaves_m, walks.leaves_m)


def test_the_sky_is_looked_up_as_the_renderer_does():
    sky = Sky(38.0, 140.0, 3.0)
    direction = np.random.default_rng(0).normal(size=(2000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    with using(SCALAR):
        seen = radiance(load({"sky": sky_light(sky, RGB)}), path_tracer("path", 2), 0 * direction, direction, 1)
        ours = along(sky_map(sky, RGB), direction)
    assert np.abs(ours - seen).max() < 1e-4 * seen.max()


def in_fog(spec: SceneSpec, samples: int, channels: Channels = RGB) -> np.ndarray:
    with using(SCALAR):
        view = ExactView(RenderJob(spec, spec.cameras[0], StoppingCriterion(samples), 3), Timings())
        return view.take(channels, samples, (0, 0))


def small_forest(clouds: CloudGrid | None, size_px=(24, 16)) -> SceneSpec:
    ground = plain_ground(-3000, 3000, albedo=0.3)
    spec = scattered_scene(30, size_m=20, exemplars=2, leaves=300, terrain=ground, clouds=clouds)
    return replace(spec, cameras=(camera_at((10, -8, 3), (10, 10, 4), size_px),))


def test_a_camera_in_fog_sees_less_by_beers_law():
    """Black fog around a camera that looks up at an even sky: exp(-sigma d), d to the fog's top."""
    clouds = uniform_fog(0.01)
    camera = camera_at((0, 0, 20), (0.0, 1e-3, 80), (8, 8), hfov_deg=4.0)
    with using(SCALAR):
        origin = origin_of(camera)
        bricks = divide(clouds, origin, 4)
        shapes, media = brick_shapes(clouds, bricks, origin)
        shell = camera_shell(clouds, bricks, media, camera)
        assert shell
        image = capture(
            path_tracer("volpath", -1, rr_depth=10**6),
            load({**shapes, **shell, "sky": WHITE}), camera, samples=400, seed=1,
        )  # fmt: skip
    assert image[..., 0].mean() == pytest.approx(np.exp(-0.01 * 70.0), rel=0.015)


@pytest.mark.slow
@pytest.mark.parametrize("inside", [True, False])
def test_plants_in_fog_are_those_of_one_box(inside):
    """Bricks against one box with one majorant, plants and camera inside: the means agree within their noise."""
    clouds = replace(uniform_fog(0.02, albedo=0.99))
    spec = small_forest(clouds)
    if not inside:
        spec = replace(spec, cameras=(camera_at((10, -8, 120), (10, 12, 0), (24, 16)),))
    camera, origin = spec.cameras[0], origin_of(spec.cameras[0])
    with using(SCALAR) as mi:
        surfaces = scene_dict(spec, origin, SpectralBsdfs())
        lights = {name: mi.load_dict(make(RGB)) for name, make in emitters_of(spec.sky).items()}
        box = cloud_volume(clouds, origin)
        shell = {}
        if inside:
            medium = mi.load_dict(box["interior"])
            box["interior"] = medium
            null = {"type": "null"}
            shell = {"shell": {"type": "sphere", "radius": 0.01, "bsdf": null, "exterior": medium}}
        plain = load({**surfaces, "box": box, **shell, **lights})
        tracer = path_tracer("volpath", 256, rr_depth=64)
        view = ExactView(RenderJob(spec, camera, StoppingCriterion(4), 3), Timings())
        ours = np.array([view.take(RGB, 8, (k, 0)).mean(axis=(0, 1)) for k in range(8)])
        theirs = [capture(tracer, plain, camera, samples=8, seed=50 + k)[..., :3].mean(axis=(0, 1)) for k in range(8)]
    error = np.hypot(np.std(ours, axis=0, ddof=1), np.std(theirs, axis=0, ddof=1)) / np.sqrt(8)
    difference = np.abs(ours.mean(axis=0) - np.mean(theirs, axis=0))
    assert np.all(difference < 3.5 * error)
    assert np.all(error < 0.05 * ours.mean(axis=0))


@pytest.mark.parametrize("depth", [20.0, 100.0])
def test_thick_clouds_that_absorb_nothing_are_white_under_a_white_sky(depth):
    """Through an optical depth of 100 light scatters hundreds of times: no path may be cut short, nor ended early."""
    value = np.full((10, 20, 20), depth / 400.0, np.float32)
    clouds = CloudGrid(value, (-2000.0, -2000.0, 100.0), (2000.0, 2000.0, 500.0), albedo=1.0, phase=PhaseFunction(0.85))
    start, direction = np.zeros((1500, 3)), np.repeat(np.array([[0.2, 0.1, 0.975]]), 1500, axis=0)
    with using(SCALAR):
        shapes, _ = brick_shapes(clouds, divide(clouds, np.zeros(3)), np.zeros(3))
        world = load({**shapes, "sky": WHITE | {"sampling_weight": 0.0}, "lamp": {"type": "point", "intensity": 0.0}})
        seen = radiance(world, endless_tracer(), start, direction, 1)[:, 0]
    assert abs(seen.mean() - 1.0) < 0.005
    assert seen.std() < 0.2


class Unlucky:
    """A tracer some of whose paths end in no number."""

    def __init__(self, values) -> None:
        self.values = list(values)

    def sample(self, scene, sampler, ray):
        return ([self.values.pop(0) if self.values else 1.0] * 3,)


def test_paths_that_end_in_no_number_are_drawn_once_more_and_many_are_refused(monkeypatch):
    """Of the parts that are followed and of the image alike: none becomes black, and none stays without a number."""
    spec = small_forest(field(), (4, 3))
    place, way = np.zeros((5, 3)), np.tile([0.0, 0.0, 1.0], (5, 1))
    shot = RenderJob(spec, spec.cameras[0], StoppingCriterion(4), 3)
    with using(SCALAR):
        view = ExactView(shot, Timings())
        view._tracer = Unlucky([np.nan, 1.0, np.inf])
        assert np.array_equal(view.followed(place, way, 1), np.ones((5, 3)))
        view._tracer = Unlucky([np.nan] * 100)
        with raises_error(RenderError):
            view.followed(place, way, 1)
    broken = [2]

    def captured(tracer, scene, camera, *, samples, seed, window=None):
        image = np.ones((3, 4, 4) if window is None else (1, 1, 4))
        if broken[0]:
            broken[0] -= 1
            image[0, 0, 1] = np.nan
        return image

    monkeypatch.setattr(exact_view, "capture", captured)
    assert np.array_equal(exact_view._captured(None, None, shot, 4, ("whole",)), np.ones((3, 4, 3)))
    broken[0] = 10**6
    with raises_error(RenderError):
        exact_view._captured(None, None, shot, 4, ("whole",))


def test_the_rays_of_an_orthographic_camera_decide_which_way_it_goes():
    """Its middle is below the clouds, its upper rays start in the height of the clouds, beside them."""
    spec = small_forest(field())
    level = camera_at((10, -800, 60), (10, 800, 60), (8, 8))
    flat = replace(level, projection="orthographic", width_m=200.0)
    for camera, parted in ((level, True), (flat, False), (replace(flat, width_m=20.0), True)):
        with using(SCALAR):
            assert (ExactView(RenderJob(spec, camera, StoppingCriterion(4), 3), Timings())._parts is not None) is parted


@pytest.mark.slow
@pytest.mark.parametrize("effort", [1, pytest.param(12, marks=pytest.mark.slow)])
def test_the_parted_way_has_the_mean_of_the_whole(effort):
    """Low clouds over a bright ground, so that light goes to and fro: both ways against one box, by the z-test."""
    spec = small_forest(field(most=0.08, low_m=(-300.0, -300.0, 30.0), high_m=(300.0, 300.0, 150.0)))
    ground = plain_ground(-3000, 3000, albedo=0.8)
    spec = replace(spec, terrain=ground, cameras=(camera_at((10, -8, 3), (10, 10, 8), (32, 20)),))
    camera, origin = spec.cameras[0], origin_of(spec.cameras[0])
    count = 8
    with using(SCALAR) as mi:
        view = ExactView(RenderJob(spec, camera, StoppingCriterion(4), 3), Timings())
        assert view._parts is not None
        lights = {name: mi.load_dict(make(RGB)) for name, make in emitters_of(spec.sky).items()}
        plain = load({**scene_dict(spec, origin, SpectralBsdfs()), "box": cloud_volume(spec.clouds, origin), **lights})
        tracer = path_tracer("volpath", 512, rr_depth=256)
        ours = np.array([view.take(RGB, 8 * effort, (k, 0)) for k in range(count)])
        # One path in a million of the renderer's ends in no number, in one box too: it is drawn once more.
        shot = RenderJob(spec, camera, StoppingCriterion(4), 7)
        theirs = np.array([exact_view._captured(tracer, plain, shot, 8 * effort, ("box", k)) for k in range(count)])
    for rows in (slice(0, 7), slice(7, 14), slice(14, 20), slice(None)):
        one, other = (images[:, rows].mean(axis=(1, 2)) for images in (ours, theirs))
        error = np.hypot(one.std(axis=0, ddof=1), other.std(axis=0, ddof=1)) / np.sqrt(count)
        difference = np.abs(one.mean(axis=0) - other.mean(axis=0))
        assert np.all(difference < 3.5 * error), rows
        assert np.all(error < 0.02 / np.sqrt(effort) * other.mean(axis=0)), rows


def test_which_way_a_scene_goes():
    low, high = field(low_m=(-50.0, -50.0, 0.0), high_m=(50.0, 50.0, 40.0)), field()
    assert clear_air_m(small_forest(low), 3.0) is None
    found = clear_air_m(small_forest(high), 3.0)
    assert found is not None
    assert 3.0 <= found[0] < found[1]
    assert clear_air_m(small_forest(high), 200.0) is None


def test_channels_change_in_place_and_images_repeat():
    spec, channels = small_forest(field()), Channels((450.0, 550.0, 865.0))
    first = in_fog(spec, 4, channels)
    with using(SCALAR):
        view = ExactView(RenderJob(spec, spec.cameras[0], StoppingCriterion(4), 3), Timings())
        view.take(RGB, 2, (5, 0))
        assert np.array_equal(view.take(channels, 4, (0, 0)), first)
    assert np.all(np.isfinite(first))
    assert first.mean() > 0


def test_an_orthographic_camera_inside_clouds_is_refused():
    clouds = uniform_fog(0.01)
    camera = replace(camera_at((0, 0, 20), (0, 1, 20), (8, 8)), projection="orthographic", width_m=10.0)
    with using(SCALAR), raises_error(RenderError):
        camera_shell(clouds, Bricks(tuple(np.array([0, 10]) for _ in range(3)), np.zeros((1, 1, 1), int)), [], camera)
