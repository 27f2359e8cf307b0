"""Motion vectors against the flow that geometry gives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.core.frames import look_at
from forestgen.labels.channels.motion import motion_px
from forestgen.render.frame import Surface
from forestgen.scene.spec import Camera, Instances

SIZE = (40, 24)
NOBODY = Instances(np.zeros(0, np.uint32), np.zeros((0, 3, 4)), np.zeros(0, np.uint32))
ROTATION = look_at((0, 0, 0), (0.3, 1.0, 0.1))


def camera(position: tuple[float, float, float] = (500.0, -300.0, 40.0), rotation: np.ndarray = ROTATION) -> Camera:
    return Camera("one", position, rotation, SIZE, 70.0)


def view(distance: np.ndarray | float, plant_id: np.ndarray | int = 0) -> Surface:
    """Only what motion asks for; all else is empty."""
    shape = SIZE[::-1]
    flat, vector = np.zeros(shape, np.float32), np.zeros((*shape, 3), np.float32)
    return Surface(
        plant_id=np.broadcast_to(np.asarray(plant_id, np.uint32), shape),
        part=np.zeros(shape, np.uint8),
        exemplar=np.zeros(shape, np.uint32),
        face=np.zeros(shape, np.uint32),
        depth_m=flat,
        distance_m=np.broadcast_to(np.asarray(distance, np.float32), shape),
        position_m=vector,
        normal=vector,
        shading_normal=vector,
        albedo=vector,
        sun_visible=np.zeros(shape, bool),
    )


def rays() -> tuple[np.ndarray, np.ndarray]:
    """(H, W) each: slopes of the pixels' centres to the right and down."""
    x, y = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    focal = camera().focal_px
    return (x - SIZE[0] / 2) / focal, (y - SIZE[1] / 2) / focal


def random_distances(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    distance = np.exp(rng.uniform(0, 8, SIZE[::-1])).astype(np.float32)
    distance[rng.random(SIZE[::-1]) < 0.3] = np.inf
    return distance


def plants(count: int, rng: np.random.Generator) -> Instances:
    transform = rng.normal(size=(count, 3, 4)) + np.concatenate([3 * np.eye(3), np.zeros((3, 1))], axis=1)
    transform[:, :, 3] += camera().position_m
    ids = rng.permutation(np.arange(1, 3 * count, dtype=np.uint32))[:count]  # in no order, and with gaps
    return Instances(np.zeros(count, np.uint32), transform, ids)


def test_what_stands_still_moves_by_nothing() -> None:
    everyone = plants(9, np.random.default_rng(1))
    ids = np.random.default_rng(2).choice([0, *everyone.plant_id], SIZE[::-1])
    again = replace(everyone, transform=everyone.transform.copy())
    for after in (everyone, again):
        motion = motion_px(camera(), view(random_distances(), ids), everyone, camera(), after)
        assert motion.dtype == np.float32
        assert motion.shape == (*SIZE[::-1], 2)
        assert np.abs(motion).max() < 1e-6


@pytest.mark.parametrize("degrees", [0.5, 7.0, -20.0])
def test_a_turn_about_the_vertical_is_the_same_at_any_distance(degrees: float) -> None:
    """A pinhole's flow under a turn by a about its own down axis: x' = f tan(atan(x / f) - a), y' = y cos.. / cos.."""
    a = np.radians(degrees)
    turn = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])  # to the right by a
    motion = motion_px(camera(), view(random_distances()), NOBODY, camera(rotation=ROTATION @ turn), NOBODY)
    right, down = rays()
    focal, angle = camera().focal_px, np.arctan(right)
    assert np.allclose(motion[..., 0], focal * (np.tan(angle - a) - right), atol=2e-5)
    assert np.allclose(motion[..., 1], focal * down * (np.cos(angle) / np.cos(angle - a) - 1), atol=2e-5)


def test_a_roll_turns_the_image() -> None:
    a = np.radians(12.0)
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    motion = motion_px(camera(), view(random_distances()), NOBODY, camera(rotation=ROTATION @ turn), NOBODY)
    right, down = rays()
    moved = np.stack([right * np.cos(a) + down * np.sin(a), down * np.cos(a) - right * np.sin(a)], axis=-1)
    assert np.allclose(motion, camera().focal_px * (moved - np.stack([right, down], axis=-1)), atol=2e-5)


@pytest.mark.parametrize("step", [(0.2, 0.0, 0.0), (0.0, -0.1, 0.0), (0.0, 0.0, 0.15), (0.3, -0.2, -0.4)])
def test_a_step_moves_the_ground_by_its_depth_and_the_sky_not_at_all(step: tuple[float, float, float]) -> None:
    """In the camera's axes (right, down, forward): x' - x = f (X - s_x) / (Z - s_z) - f X / Z."""
    distance = random_distances()
    x, y, z = (float(v) for v in camera().position_m + ROTATION @ step)
    motion = motion_px(camera(), view(distance), NOBODY, camera((x, y, z)), NOBODY)
    sky = np.isinf(distance)
    assert np.abs(motion[sky]).max() < 1e-6
    right, down = (slope[~sky] for slope in rays())
    depth = distance[~sky].astype(np.float64) / np.sqrt(1 + right**2 + down**2)
    for k, slope in enumerate((right, down)):
        expected = camera().focal_px * ((slope * depth - step[k]) / (depth - step[2]) - slope)
        assert np.allclose(motion[~sky][:, k], expected, atol=1e-4, rtol=1e-5)


def test_a_zoom_spreads_the_image() -> None:
    motion = motion_px(camera(), view(random_distances()), NOBODY, replace(camera(), hfov_deg=35.0), NOBODY)
    right, down = rays()
    gain = replace(camera(), hfov_deg=35.0).focal_px - camera().focal_px
    assert np.allclose(motion, gain * np.stack([right, down], axis=-1), atol=2e-5)


def test_a_plant_carries_its_points_through_its_own_frame() -> None:
    rng = np.random.default_rng(4)
    now, then = plants(9, rng), plants(9, rng)
    then = replace(then, plant_id=now.plant_id)
    ids = rng.choice(now.plant_id, SIZE[::-1])
    distance = rng.uniform(3, 30, SIZE[::-1]).astype(np.float32)
    after = camera((495.0, -320.0, 39.0))
    motion = motion_px(camera(), view(distance, ids), now, after, then)
    finite = 0
    for row, column in np.ndindex(*SIZE[::-1]):
        along = np.array([(column + 0.5 - 20) / camera().focal_px, (row + 0.5 - 12) / camera().focal_px, 1.0])
        along /= np.linalg.norm(along)
        world = camera().position_m + float(distance[row, column]) * (ROTATION @ along)
        k = list(now.plant_id).index(ids[row, column])
        own = np.linalg.solve(now.transform[k, :, :3], world - now.transform[k, :, 3])
        seen = ROTATION.T @ (then.transform[k, :, :3] @ own + then.transform[k, :, 3] - after.position_m)
        if seen[2] <= 0:
            assert np.isnan(motion[row, column]).all()
            continue
        finite += 1
        expected = after.focal_px * seen[:2] / seen[2] + [20 - column - 0.5, 12 - row - 0.5]
        assert motion[row, column] == pytest.approx(expected, rel=1e-4, abs=1e-3)
    assert finite > 300


def test_only_plants_that_move_leave_their_place() -> None:
    now = plants(2, np.random.default_rng(6))
    transform = now.transform.copy()
    transform[1, :, 3] += ROTATION @ [0.5, 0, 0]  # to the right
    ids = np.zeros(SIZE[::-1], np.uint32)
    ids[:, 10:20], ids[:, 20:30] = now.plant_id[0], now.plant_id[1]
    motion = motion_px(camera(), view(10.0, ids), now, camera(), replace(now, transform=transform))
    assert np.abs(motion[:, np.r_[0:20, 30:40]]).max() < 1e-6
    right, down = (slope[:, 20:30] for slope in rays())
    expected = camera().focal_px * 0.5 / 10.0 * np.sqrt(1 + right**2 + down**2)
    assert np.allclose(motion[:, 20:30, 0], expected, rtol=1e-5)
    assert np.abs(motion[:, 20:30, 1]).max() < 1e-5


def test_what_falls_behind_the_camera_has_no_place() -> None:
    distance = np.full(SIZE[::-1], 5.0, np.float32)
    distance[:12] = 500.0
    distance[:, :4] = np.inf
    x, y, z = (float(v) for v in camera().position_m + ROTATION @ [0, 0, 20.0])
    motion = motion_px(camera(), view(distance), NOBODY, camera((x, y, z)), NOBODY)
    behind = distance == 5.0
    assert np.isnan(motion[behind]).all()
    assert np.isfinite(motion[~behind]).all()
    back = camera(rotation=ROTATION @ np.diag([-1.0, 1.0, -1.0]))
    assert np.isnan(motion_px(camera(), view(np.inf), NOBODY, back, NOBODY)).all()


def test_another_scene_is_refused() -> None:
    now = plants(3, np.random.default_rng(7))
    other = replace(now, plant_id=now.plant_id + np.uint32(1))
    with pytest.raises(ValueError, match="same plants"):
        motion_px(camera(), view(5.0), now, camera(), other)
    moved = replace(now, transform=now.transform + 0.1)
    with pytest.raises(ValueError, match="no instance"):
        motion_px(camera(), view(5.0, 4_000_000_000), now, camera(), moved)
