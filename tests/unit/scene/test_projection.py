"""Rays and projections of all kinds of cameras undo each other, and do what their definitions say."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from forestgen.scene.projection import (
    Projection,
    centre_rays,
    image_circle,
    project,
    projection_of,
    rays,
    world_rays,
)
from forestgen.scene.projections.distorted import DistortedCamera
from forestgen.scene.spec import Camera
from support.cameras import DISTORTION, KINDS, camera_of
from support.lens_points import lens_points, pixel_hash

POSITION_M = (120.0, -35.0, 4.0)


def random_points(camera: Camera, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Image points that have a ray."""
    x, y = rng.random((2, 4 * count)) * np.array(camera.size_px)[:, None]
    kept = np.flatnonzero(rays(camera, x, y).valid)[:count]
    assert len(kept) == count
    return x[kept], y[kept]


@pytest.mark.parametrize("kind", KINDS)
def test_points_along_rays_project_to_where_the_rays_come_from(kind):
    camera, rng = camera_of(kind, (640, 480), POSITION_M), np.random.default_rng(1)
    x, y = random_points(camera, 20_000, rng)
    found = rays(camera, x, y)
    distance = 10 ** rng.uniform(-3, 4, len(x))
    at = project(camera, found.origin_m + found.direction * distance[:, None])
    np.testing.assert_allclose(np.linalg.norm(found.direction, axis=1), 1.0, rtol=1e-14)
    assert at.in_front.all()
    np.testing.assert_allclose(at.x_px, x, atol=1e-9)
    np.testing.assert_allclose(at.y_px, y, atol=1e-9)
    expected = distance if projection_of(camera).depth_is_distance else distance * found.direction[:, 2]
    np.testing.assert_allclose(at.depth_m, expected, rtol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_rays_to_projected_points_go_through_them(kind):
    camera, rng = camera_of(kind, (640, 480), POSITION_M), np.random.default_rng(2)
    point = rng.normal(size=(20_000, 3)) * 10
    at = project(camera, point)
    assert at.in_front.sum() > 0
    there, seen = point[at.in_front], rays(camera, at.x_px[at.in_front], at.y_px[at.in_front])
    away = there - seen.origin_m
    reach = np.einsum("nk,nk->n", away, seen.direction)
    assert (reach > 0).all()
    off = np.linalg.norm(away - reach[:, None] * seen.direction, axis=1)
    assert (off < 1e-12 * np.linalg.norm(there, axis=1)).all()


@pytest.mark.parametrize("kind", KINDS)
def test_the_axis_is_the_images_middle_and_x_runs_right_and_y_down(kind):
    camera = camera_of(kind, (64, 48), POSITION_M)
    at = project(camera, np.array([[0.0, 0.0, 5.0], [0.01, 0.0, 5.0], [0.0, 0.01, 5.0]]))
    np.testing.assert_allclose([at.x_px[0], at.y_px[0]], [32, 24], atol=1e-12)
    assert at.x_px[1] > 32
    assert at.y_px[1] == pytest.approx(24)
    assert at.y_px[2] > 24
    assert at.x_px[2] == pytest.approx(32)


@pytest.mark.parametrize("kind", KINDS)
def test_the_cameras_own_place_is_seen_nowhere(kind):
    at = project(camera_of(kind, (64, 48), POSITION_M), np.zeros((1, 3)))
    assert not at.in_front[0]
    assert np.isfinite([at.x_px[0], at.y_px[0], at.depth_m[0]]).all()


@pytest.mark.parametrize("kind", ["perspective", "orthographic", "thin lens"])
def test_what_is_behind_flat_cameras_is_not_seen(kind):
    at = project(camera_of(kind, (64, 48), POSITION_M), np.array([[0.0, 0.0, -1.0], [3.0, 1.0, 0.0], [3.0, 1.0, 1e-6]]))
    assert at.in_front.tolist() == [False, False, True]


def test_a_fisheye_is_equidistant_and_ends_at_its_circle():
    camera = camera_of("fisheye", (200, 100), POSITION_M, hfov_deg=180.0)
    theta = np.radians([0, 30, 60, 89.999, 90.001, 180])
    at = project(camera, np.stack([np.sin(theta), np.zeros(6), np.cos(theta)], axis=1))
    np.testing.assert_allclose(at.x_px - 100, [0, 100 / 3, 200 / 3, 89.999 / 0.9, 90.001 / 0.9, 200], rtol=1e-12)
    assert at.in_front.tolist() == [True] * 4 + [False] * 2
    assert rays(camera, np.array([0.0, 200.0, -1e-9]), np.full(3, 50.0)).valid.tolist() == [True, True, False]


def test_straight_behind_a_whole_fisheye_lies_on_its_circle():
    camera = camera_of("fisheye", (200, 200), POSITION_M, hfov_deg=360.0)
    at = project(camera, np.array([0.0, 0.0, -3.0]))
    assert (at.x_px, at.y_px, at.depth_m, at.in_front) == (200.0, 100.0, 3.0, True)
    near = np.array([[1e-9, 2e-9, -1.0], [-2e-9, 0.0, -1.0]])
    at = project(camera, near)
    np.testing.assert_allclose(np.hypot(at.x_px - 100, at.y_px - 100), 100.0, rtol=1e-8)
    np.testing.assert_allclose(np.arctan2(at.y_px - 100, at.x_px - 100), [np.arctan2(2, 1), np.pi], atol=1e-12)


def test_a_panorama_holds_the_sphere_and_tears_at_seam_and_poles():
    camera = camera_of("panorama", (360, 180), POSITION_M)
    points = np.array([[1, 0, 0], [-1, 0, 0], [1e-12, 0, -1], [-1e-12, 0, -1], [0, -1, 0], [0, 1, 0], [0, 1, 1.0]])
    at = project(camera, points)
    np.testing.assert_allclose(at.x_px, [270, 90, 360, 0, 180, 180, 180], atol=1e-9)
    np.testing.assert_allclose(at.y_px, [90, 90, 90, 90, 0, 180, 135], atol=1e-9)
    assert at.in_front.all()
    seen = centre_rays(camera).direction
    _, y = np.meshgrid(np.arange(360), np.arange(180) + 0.5)
    solid_angle = np.cos((y - 90) / 180 * np.pi) * (np.pi / 180) ** 2
    np.testing.assert_allclose(solid_angle.sum(), 4 * np.pi, rtol=1e-4)
    np.testing.assert_allclose((seen * solid_angle[..., None]).sum(axis=(0, 1)), 0, atol=1e-12)


def test_orthographic_pixels_are_squares_of_equal_size():
    camera = camera_of("orthographic", (64, 48), POSITION_M, width_m=16.0)
    at = project(camera, np.array([[8.0, 6.0, 2.0], [8.0, 6.0, 900.0], [-8.0, -6.0, 1.0]]))
    assert at.x_px.tolist() == [64.0, 64.0, 0.0]
    assert at.y_px.tolist() == [48.0, 48.0, 0.0]


@pytest.mark.parametrize("kind", KINDS)
def test_world_rays_are_the_cameras_turned(kind):
    camera = camera_of(kind, (16, 12), POSITION_M)
    own, world = centre_rays(camera), world_rays(camera)
    np.testing.assert_allclose(world.direction @ camera.world_from_camera, own.direction, atol=1e-14)
    start = np.broadcast_to(world.origin_m, world.direction.shape) - np.asarray(POSITION_M)
    np.testing.assert_allclose(start @ camera.world_from_camera, own.origin_m, atol=1e-12)
    np.testing.assert_array_equal(world_rays(camera, slice(3, 5)).direction, world.direction[3:5])


@pytest.mark.parametrize("size_px", [(64, 48), (63, 80), (10, 10)])
def test_the_image_circle_is_that_of_its_pixels_centres(size_px):
    camera = camera_of("fisheye", size_px, POSITION_M)
    width, height = size_px
    expected = [
        [(2 * x + 1 - width) ** 2 + (2 * y + 1 - height) ** 2 <= width**2 for x in range(width)] for y in range(height)
    ]
    np.testing.assert_array_equal(image_circle(camera), expected)
    assert image_circle(camera_of("panorama", size_px, POSITION_M)).all()
    assert rays(camera, np.array(width), np.array(height / 2)).valid


def test_lens_points_fill_the_disc_evenly_for_each_sample_and_within_each_pixel():
    column, row = np.meshgrid(np.arange(200), np.arange(150))
    for number in (0, 7):
        point = lens_points(column, row, np.array(number)).reshape(-1, 2)
        radius, angle = np.hypot(*point.T), np.arctan2(point[:, 1], point[:, 0])
        cells, _, _ = np.histogram2d(radius**2, angle, bins=(10, 10), range=[[0, 1], [-np.pi, np.pi]])
        chi2 = ((cells - 300) ** 2 / 300).sum()
        assert chi2 < 150, "99 degrees of freedom: 150 has a chance of 0.0007"
    own = lens_points(np.array(31), np.array(17), np.arange(1024))
    cells, _, _ = np.histogram2d(
        np.hypot(*own.T) ** 2, np.arctan2(own[:, 1], own[:, 0]), bins=(8, 8), range=[[0, 1], [-np.pi, np.pi]]
    )
    assert np.abs(cells - 16).max() <= 6, "a sequence of low discrepancy; random points miss by up to 12"


def test_neighbouring_pixels_go_through_other_points_of_the_lens():
    column, row = np.meshgrid(np.arange(64), np.arange(64))
    point = lens_points(column, row, np.array(3))
    for axis in (0, 1):
        step = np.diff(point, axis=axis)
        assert np.abs((point[1:] * point[:-1]).mean()) < 0.02
        assert np.sqrt((step**2).sum(axis=-1)).mean() > 0.8
    assert len(np.unique(pixel_hash(column, row)[0])) == 64 * 64


@pytest.mark.parametrize("kind", ["fisheye", "panorama", "perspective"])
def test_what_follows_from_rays_and_points_is_what_a_projection_computes_itself(kind):
    """The numerical defaults of `Projection`, which projections of other packages have, against closed forms."""
    camera, rng = camera_of(kind, (64, 32), POSITION_M, **{"hfov_deg": 120.0}), np.random.default_rng(3)
    own = projection_of(camera)
    x, y = (one - size / 2 for one, size in zip(random_points(camera, 500, rng), camera.size_px, strict=True))
    distance = np.array([3.0, 50.0])
    finest = own.finest_pixel_m(camera, distance)
    np.testing.assert_allclose(Projection.finest_pixel_m(own, camera, distance), finest, rtol=0.25)
    if kind == "perspective":
        return
    toward = own.rays(camera, x, y).direction
    expected = own.pixels_per_sr(camera, toward)
    np.testing.assert_allclose(Projection.pixels_per_sr(own, camera, toward), expected, rtol=1e-2)  # at the poles
    columns, rows = np.linspace(-30, 30, 20), np.linspace(-15, 15, 20)
    steps = (columns[1] - columns[0], rows[1] - rows[0])
    found = Projection.step_rad(own, camera, columns, rows, steps)
    assert 0.5 < found / own.step_rad(camera, columns, rows, steps) < 1.05


@pytest.mark.parametrize("kind", ["fisheye", "panorama", "perspective", "orthographic"])
def test_boxes_of_any_projection_hold_what_is_seen_of_hulls(kind):
    camera, rng = camera_of(kind, (64, 32), POSITION_M), np.random.default_rng(4)
    cube = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    edges = np.array([(a, b) for a in range(8) for b in range(a)])
    seen = cube + rng.normal(size=(40, 1, 3)) + [0.0, 0.0, 9.0]
    own = projection_of(camera)
    (box, anywhere), (expected, _) = (
        Projection.hull_boxes(own, camera, seen, edges),
        own.hull_boxes(camera, seen, edges),
    )
    assert anywhere.all()
    np.testing.assert_allclose(box, expected, atol=0.05)


def by_hand(kind: str, camera: Camera, focal: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels from the middle and depths, otherwise than the projections compute them."""
    x, y, z = np.moveaxis(points, -1, 0)
    distance, aside = np.sqrt((points**2).sum(axis=-1)), x + 1j * y
    if kind == "perspective":
        return points[..., :2] / z[..., None] * focal, z
    if kind == "distorted":
        k, slope = DISTORTION, (x + 1j * y) / z
        radial = np.polynomial.Polynomial([0.0, 1.0, 0.0, k["k1"], 0.0, k["k2"], 0.0, k["k3"]])
        r, p = np.abs(slope), k["p2"] + 1j * k["p1"]
        bent = slope / r * radial(r) + 2.0 * slope * np.real(p * slope.conj()) + p * r**2  # OpenCV's sums of squares
        fine = np.linspace(0.0, 10.0, 100_001)
        folds = fine[np.argmax(radial.deriv()(fine) < 0.1)]
        return np.stack([bent.real, bent.imag], axis=-1) * focal, np.where((r > folds) & (z > 0), -z, z)
    if kind == "orthographic":
        return points[..., :2] * focal, z
    if kind == "panorama":
        flat = np.stack([np.angle(z + 1j * x), np.angle(np.sqrt(x * x + z * z) + 1j * y)], axis=-1)
        return flat * focal, distance
    # Half angles: 2 atan2(|a - b|, |a + b|) of the axis and the direction, exact at both ends.
    near, far = (np.sqrt(np.abs(aside) ** 2 + (distance + sign * z) ** 2) for sign in (-1, 1))
    angle, turn = 2 * np.arctan2(near, far), aside / np.abs(aside)
    seen = np.where(angle > np.radians(camera.hfov_deg) / 2, -distance, distance)
    return np.stack([turn.real * angle, turn.imag * angle], axis=-1) * focal, seen


@pytest.mark.parametrize("stretch", [1.0, 1.25])
@pytest.mark.parametrize("kind", ["perspective", "distorted", "fisheye", "orthographic", "panorama"])
def test_what_a_file_says_is_what_its_formulas_say(kind, stretch):
    camera, rng = camera_of(kind, (64, 32), POSITION_M), np.random.default_rng(5)
    own = projection_of(camera)
    values = own.file_keys(camera)
    if "K" in values:
        values["K"] = (np.array(values["K"]) * [[1, 1, 1.1], [1, stretch, 0.9], [1, 1, 1]]).tolist()
    found = own.read(values, camera.size_px)
    points = rng.normal(size=(400, 3)) * [1.0, 1.0, 3.0]
    (pixel, depth), (expected, expected_depth) = (
        found.project(points),
        by_hand(kind, camera, np.array(found.focal_px), points),
    )
    front = expected_depth > 0
    np.testing.assert_array_equal(depth > 0, front)
    np.testing.assert_allclose(depth[front], expected_depth[front], rtol=1e-12)
    np.testing.assert_allclose(pixel[front], expected[front] + found.centre_px, atol=1e-9)


@pytest.mark.parametrize("kind", ["perspective", "distorted", "fisheye", "orthographic", "panorama"])
def test_a_files_rays_lead_to_their_pixels(kind):
    camera = camera_of(kind, (64, 32), POSITION_M)
    found = projection_of(camera).read(projection_of(camera).file_keys(camera), camera.size_px)
    there = found.starts((8, 6)) + 2.5 * found.rays((8, 6))
    again, depth = found.project(there)
    sees = found.sees((8, 6))
    np.testing.assert_allclose(again[sees], (np.indices((6, 8))[::-1] + 0.5).transpose(1, 2, 0)[sees], atol=1e-9)
    np.testing.assert_allclose(depth[sees], 2.5, rtol=1e-12)
    beyond = found.beyond_rim_px((np.indices((6, 8))[::-1] + 0.5).transpose(1, 2, 0))
    assert sees.all() if beyond is None else np.array_equal(beyond <= 0, sees)


def test_a_point_through_a_lens_by_hand():
    """OpenCV's formula, term by term, with r² = 0.13."""
    numbers = {"k1": -0.2, "k2": 0.05, "p1": 0.001, "p2": -0.002, "k3": 0.01}
    camera = camera_of("distorted", (200, 100), (0.0, 0.0, 0.0), numbers=numbers)
    at = project(camera, np.array([[0.3, -0.2, 1.0]]))
    radial = 1.0 - 0.2 * 0.13 + 0.05 * 0.0169 + 0.01 * 0.002197
    x = 0.3 * radial + 2 * 0.001 * -0.06 - 0.002 * (0.13 + 0.18)
    y = -0.2 * radial + 0.001 * (0.13 + 0.08) + 2 * -0.002 * -0.06
    np.testing.assert_allclose([at.x_px[0], at.y_px[0]], np.array([x, y]) * camera.focal_px + [100, 50], atol=1e-10)


def test_a_lens_that_folds_its_image_is_refused():
    with pytest.raises(ValidationError, match="folds"):
        DistortedCamera.model_validate(
            {"name": "a", "kind": "distorted", "hfov_deg": 90, "distortion": [-0.28, 0.11, 0, 0, -0.02]}
        )


@pytest.mark.parametrize("distortion", [[0, 0, 0.5], [0.1, 0, 0, 0.4], [-0.3, 0.1, 0, 0, -0.05]])
def test_a_distortion_without_one_ray_for_each_pixel_is_refused(distortion):
    with pytest.raises(ValidationError, match="folds"):
        DistortedCamera.model_validate({"name": "a", "kind": "distorted", "hfov_deg": 100, "distortion": distortion})


def test_numbers_of_no_lens_are_refused_where_they_are_read():
    camera = camera_of("distorted", (64, 32), POSITION_M)
    for wrong in (float("nan"), 1e308, float("inf")):
        values = projection_of(camera).file_keys(camera) | {"distortion": [wrong, 0.0, 0.0, 0.0, 0.0]}
        with pytest.raises(ValueError, match="lens"):
            projection_of(camera).read(values, camera.size_px)
    tiny = camera_of("distorted", (64, 32), POSITION_M, numbers=dict.fromkeys(DISTORTION, 0.0) | {"k3": 1e-320})
    assert centre_rays(tiny).valid.all()


def test_the_ground_below_a_distorted_camera_is_what_its_rays_reach():
    keys = {"name": "a", "kind": "distorted", "hfov_deg": 60, "size_px": [640, 480], "position_m": [0, 0, 50]}
    section = DistortedCamera.model_validate(keys | {"look": "down", "distortion": list(DISTORTION.values())})
    camera = camera_of("distorted", (640, 480), POSITION_M)
    across, along = section.footprint_m(50.0)
    edge = rays(camera, np.array([0.0, 640.0, 320.0, 320.0]), np.array([240.0, 240.0, 0.0, 480.0])).direction
    at = 50.0 * edge[:, :2] / edge[:, 2:]
    np.testing.assert_allclose([across, along], [at[1, 0] - at[0, 0], at[3, 1] - at[2, 1]], rtol=1e-9)
