"""Optical depth along rays is the integral of the field that the renderer draws."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

from forestgen.atmosphere.grid import CloudGrid
from forestgen.atmosphere.optical_depth import cloud_opacity, optical_depth
from forestgen.core.frames import look_at

LOW, HIGH = (-30.0, 10.0, 100.0), (50.0, 90.0, 145.0)
SIZES = (5, 7, 8)  # z, y, x


def random_grid(seed: int, sizes: tuple[int, int, int] = SIZES) -> CloudGrid:
    return CloudGrid(np.random.default_rng(seed).random(sizes).astype(np.float32) * 0.1, LOW, HIGH)


def of_field(field: Callable[..., np.ndarray]) -> CloudGrid:
    """The values of field(x, y, z) at the cells' centres."""
    axes = [low + (np.arange(n) + 0.5) / n * (high - low) for low, high, n in zip(LOW, HIGH, SIZES[::-1], strict=True)]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    return CloudGrid(np.ascontiguousarray(field(x, y, z).transpose(2, 1, 0), dtype=np.float32), LOW, HIGH)


def unit(*vector: float) -> np.ndarray:
    return np.array(vector) / np.linalg.norm(vector)


def box_length(origin: np.ndarray, direction: np.ndarray, distance: float) -> float:
    """Of the ray inside the box, in plain steps."""
    t = np.linspace(0.0, min(distance, 1000.0), 200_001)
    inside = np.ones(len(t), dtype=bool)
    for k in range(3):
        place = origin[k] + t * direction[k]
        inside &= (place >= LOW[k]) & (place <= HIGH[k])
    return float(inside.sum() * (t[1] - t[0]))


def brute_force(grid: CloudGrid, origin: np.ndarray, direction: np.ndarray, distance: float, steps: int) -> float:
    """Midpoints of many steps through the box, each interpolated by SciPy between the cells' centres."""
    low, high = np.array(grid.low_m), np.array(grid.high_m)
    with np.errstate(divide="ignore"):
        a, b = (low - origin) / direction, (high - origin) / direction
    first, last = max(0.0, np.minimum(a, b).max()), min(distance, np.maximum(a, b).min())
    if first >= last:
        return 0.0
    t = first + (np.arange(steps) + 0.5) / steps * (last - first)
    points = origin + t[:, None] * direction
    cells = np.array(grid.extinction_per_m.shape[::-1])
    place = (points - low) / (high - low) * cells - 0.5
    values = map_coordinates(grid.extinction_per_m.astype(np.float64), place.T[::-1], order=1, mode="nearest")
    return float(values.mean() * (last - first))


RAYS = [
    ((0, 40, 0), unit(0, 0, 1)),
    ((0, 40, 200), unit(0, 0, -1)),
    ((-100, 40, 120), unit(1, 0, 0)),
    ((0, 300, 120), unit(0, -1, 0)),
    ((0, 40, 120), unit(0, 1, 0)),  # from the inside
    ((0, 40, 120), unit(-1, 2, 0.3)),
    ((-60, 0, 80), unit(3, 2, 1.5)),
    ((20, 50, 0), unit(-1e-9, 1e-9, 1)),
    ((90, 100, 160), unit(-2, -1.5, -0.8)),
    ((-25, 15, 104.5), unit(1, 1, 0)),  # between the border and the first centres
]


@pytest.mark.parametrize(("origin", "direction"), RAYS)
@pytest.mark.parametrize("distance", [np.inf, 60.0])
def test_an_even_cloud_counts_its_length(origin: tuple[float, ...], direction: np.ndarray, distance: float) -> None:
    grid = of_field(lambda x, y, z: np.full_like(x, 0.03))
    depth = optical_depth(grid, np.array(origin, float), direction, np.array(distance))
    length = box_length(np.array(origin, float), direction, distance)
    assert depth == pytest.approx(float(np.float32(0.03)) * length, abs=4e-4)


def test_through_the_middle_of_a_gradient() -> None:
    """Between the first and the last centres a linear field is met exactly; each half cell at the ends is even."""
    grid = of_field(lambda x, y, z: 0.001 * (z - 100.0))
    cell = (HIGH[2] - LOW[2]) / SIZES[0]
    ends = 0.5 * cell * 0.001 * (0.5 * cell + 45.0 - 0.5 * cell)
    middle = 0.001 * ((45.0 - 0.5 * cell) ** 2 - (0.5 * cell) ** 2) / 2
    depth = optical_depth(grid, np.array([3.0, 44.0, -50.0]), np.array([0.0, 0.0, 1.0]), np.array(np.inf))
    assert depth == pytest.approx(ends + middle, rel=1e-6)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_a_linear_field_between_the_centres(seed: int) -> None:
    rng = np.random.default_rng(seed)
    slope = rng.normal(size=3) * 1e-4
    at_rest = 0.05
    grid = of_field(lambda x, y, z: at_rest + slope[0] * x + slope[1] * y + slope[2] * (z - 120))
    half = (np.array(HIGH) - LOW) / SIZES[::-1] / 2
    a, b = (np.array(LOW) + half + rng.random(3) * (np.array(HIGH) - LOW - 2 * half) for _ in range(2))
    length = float(np.linalg.norm(b - a))
    mean = at_rest + slope @ ((a + b) / 2 - [0, 0, 120])
    depth = optical_depth(grid, a, (b - a) / length, np.array(length))
    assert depth == pytest.approx(mean * length, rel=2e-6)


@pytest.mark.parametrize("sizes", [SIZES, (1, 1, 1), (1, 4, 2), (3, 1, 9)])
def test_as_fine_steps_find_it(sizes: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(5)
    grid = random_grid(2, sizes)
    seen = 0
    for _ in range(40):
        origin = np.array([10, 50, 120]) + rng.normal(size=3) * [60, 60, 30]
        direction = unit(*rng.normal(size=3))
        distance = np.inf if rng.random() < 0.5 else rng.random() * 200
        expected = brute_force(grid, origin, direction, distance, 100_000)
        depth = float(optical_depth(grid, origin, direction, np.array(distance)))
        assert depth == pytest.approx(expected, rel=2e-5, abs=1e-7)
        seen += expected > 0
    assert seen > 10


@pytest.mark.parametrize(("origin", "direction"), RAYS)
def test_two_parts_of_a_ray_add_up(origin: tuple[float, ...], direction: np.ndarray) -> None:
    grid = random_grid(4)
    start = np.array(origin, float)
    for cut in (13.7, 61.2, 104.9):
        near = optical_depth(grid, start, direction, np.array(cut))
        far = optical_depth(grid, start + cut * direction, direction, np.array(np.inf))
        assert near + far == pytest.approx(optical_depth(grid, start, direction, np.array(np.inf)), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(("origin", "direction"), RAYS[:4])
def test_there_and_back_is_the_same(origin: tuple[float, ...], direction: np.ndarray) -> None:
    grid = random_grid(6)
    end = np.array(origin) + 1000.0 * direction
    forth = optical_depth(grid, np.array(origin, float), direction, np.array(1000.0))
    back = optical_depth(grid, end, -direction, np.array(1000.0))
    assert forth > 0.5
    assert forth == pytest.approx(float(back), rel=1e-9)


@pytest.mark.parametrize(
    ("origin", "direction", "distance"),
    [
        ((0, 40, 0), unit(0, 0, -1), np.inf),  # away
        ((0, 40, 0), unit(1, 0, 0), np.inf),  # below, level
        ((-30.001, 40, 0), unit(0, 0, 1), np.inf),  # beside
        ((0, 40, 0), unit(0, 0, 1), 99.9),  # short of it
        ((-100, 40, 0), unit(1, 0, 0.1), np.inf),  # past an edge
        ((0, 40, 120), unit(0, 0, 1), 0.0),
    ],
)
def test_a_ray_that_misses_meets_nothing(origin: tuple[float, ...], direction: np.ndarray, distance: float) -> None:
    assert optical_depth(random_grid(1), np.array(origin, float), direction, np.array(distance)) == 0.0


def test_rays_along_faces_and_centres_end() -> None:
    """Rays in the very planes between pieces: each finishes, and within what its neighbours find."""
    grid = random_grid(8)
    cell = (np.array(HIGH) - LOW) / SIZES[::-1]
    for half in range(2 * SIZES[2] + 1):
        x = LOW[0] + half * cell[0] / 2
        on, left, right = (
            float(optical_depth(grid, np.array([x + dx, 40.0, 0.0]), np.array([0.0, 0.0, 1.0]), np.array(np.inf)))
            for dx in (0.0, -1e-7, 1e-7)
        )
        assert any(on == pytest.approx(other, rel=1e-6) for other in (left, right))


PLACE = np.array([10.0, -20.0, 2.0])


def directions(world_from_camera: np.ndarray, focal_px: float, shape: tuple[int, ...]) -> np.ndarray:
    """(H, W, 3) unit, world, of a pinhole camera's rays through the pixels' centres."""
    height, width = shape
    x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    along = np.stack([x, y, np.full(shape, focal_px)], axis=-1)
    return np.asarray(along / np.linalg.norm(along, axis=-1, keepdims=True) @ world_from_camera.T)


def test_rays_may_begin_at_places_of_their_own_and_where_there_is_no_ray_there_is_no_cloud() -> None:
    grid = random_grid(3)
    along = np.broadcast_to(unit(0.2, 0.1, 1.0), (3, 4, 3))
    start = np.random.default_rng(1).uniform(-20, 20, (3, 4, 3))
    distance = np.full((3, 4), np.inf, dtype=np.float32)
    distance[1, 2] = 0.0
    opacity = cloud_opacity(grid, start, along, distance)
    assert opacity[1, 2] == 0.0
    for row, column in ((0, 0), (2, 3), (1, 1)):
        depth = brute_force(grid, start[row, column], along[row, column], np.inf, 100_000)
        assert opacity[row, column] == pytest.approx(1 - np.exp(-depth), abs=1e-5)


def test_opacity_is_that_of_the_pixels_own_rays() -> None:
    grid = random_grid(3)
    world_from_camera = look_at((10, -20, 2), (10, 60, 110))
    distance = np.full((9, 16), np.inf, dtype=np.float32)
    distance[4:6, 3:9] = 12.0
    opacity = cloud_opacity(grid, PLACE, directions(world_from_camera, 14.0, distance.shape), distance)
    assert opacity.dtype == np.float32
    assert opacity.shape == (9, 16)
    assert not opacity[4:6, 3:9].any()
    for row, column in ((0, 0), (2, 11), (8, 15), (3, 3)):
        direction = world_from_camera @ unit((column + 0.5 - 8) / 14, (row + 0.5 - 4.5) / 14, 1)
        depth = brute_force(grid, np.array([10.0, -20.0, 2.0]), direction, np.inf, 100_000)
        assert opacity[row, column] == pytest.approx(1 - np.exp(-depth), abs=1e-5)
    assert opacity.max() > 0.5
    thick = replace(grid, extinction_per_m=grid.extinction_per_m * np.float32(1000))
    assert cloud_opacity(thick, PLACE, directions(world_from_camera, 14.0, distance.shape), distance).max() == 1.0


def test_the_same_with_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    from forestgen.core import threads

    grid = random_grid(7)
    distance = np.full((160, 200), np.inf, dtype=np.float32)
    camera = (PLACE, directions(look_at((10, -20, 2), (10, 60, 110)), 150.0, (160, 200)))
    several = cloud_opacity(grid, *camera, distance)
    monkeypatch.setattr(threads, "cores", lambda: 1)
    assert np.array_equal(several, cloud_opacity(grid, *camera, distance))


@pytest.mark.slow
def test_the_renderer_lets_as_much_light_through() -> None:
    """Light behind the renderer's own medium, made black: what arrives is the transmittance, pixel by pixel."""
    from forestgen.render.capture import sensor_of
    from forestgen.render.variant import SCALAR, mitsuba
    from forestgen.scene.spec import Camera
    from support.cloud_box import cloud_volume

    grid = replace(random_grid(9), albedo=0.0)
    position = (12.0, -45.0, 30.0)
    camera = Camera("up", position, look_at(position, (12, 60, 130)), (16, 9), 60.0)
    samples, finer = 4096, 16
    mi = mitsuba()
    with mi.variant_context(SCALAR):
        volume = cloud_volume(grid, np.array(position))
        scene = mi.load_dict({"type": "scene", "light": {"type": "constant"}, "clouds": volume})
        integrator = mi.load_dict({"type": "volpath", "max_depth": 64, "rr_depth": 64})
        seen = np.array(integrator.render(scene, sensor=sensor_of(camera, samples), seed=1, spp=samples))[..., 0]
    distance = np.full((9 * finer, 16 * finer), np.inf, dtype=np.float32)
    along = directions(camera.world_from_camera, camera.focal_px * finer, distance.shape)
    opacity = cloud_opacity(grid, np.array(position), along, distance)
    through = 1.0 - opacity.astype(np.float64).reshape(9, finer, 16, finer).mean(axis=(1, 3))
    assert through.min() < 0.1 < 0.9 < through.max()
    spread = np.sqrt(np.maximum(through * (1 - through), 1e-4) / samples)  # at most: a photon arrives, or does not
    score = (seen - through) / spread
    assert np.abs(score).max() < 5.0
    assert abs(score.mean()) < 4.0 / np.sqrt(score.size)
