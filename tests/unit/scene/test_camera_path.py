"""Cameras along their paths: where they stand, when, under which name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from forestgen.core.errors import RecipeError
from forestgen.recipe.cameras import Camera
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import check_plan
from forestgen.scene.terrain import HeightField
from forestgen.scene.terrains.rolling import Waves
from forestgen.scene.views import expand, next_frame
from support.error_messages import raises_error

QUICKSTART = Path(__file__).parents[3] / "recipes" / "quickstart.yaml"
FLAT = HeightField((100.0, 100.0))
WAVY = Waves((100.0, 100.0), np.array([[0.1, 0.03]]), np.array([5.0]), np.array([0.4]), np.array([0]))


def section(path: dict[str, Any] | None, **keys: Any) -> Camera:
    return Camera.model_validate(
        {"name": "walk", "position_m": (0, 0, 2), "look_at_m": (0, 50, 2), "path": path, **keys}
    )


def positions(camera: Camera, height: HeightField = FLAT) -> np.ndarray:
    return np.array([one.position_m for one in expand(camera, height)])


def targets(camera: Camera) -> np.ndarray:
    """Unit directions of the images' middles."""
    return np.array([one.world_from_camera[:, 2] for one in expand(camera, FLAT)])


def test_equal_steps_of_time_along_one_piece() -> None:
    camera = section({"frames": 5, "position_m": [[8, 4, 4]]})
    assert np.allclose(positions(camera), np.linspace([0, 0, 2], [8, 4, 4], 5), atol=1e-12)


def test_each_piece_takes_the_same_time_and_waypoints_are_met_exactly() -> None:
    way = [(8.1, 0, 2), (8.1, 1.3, 2), (0.7, 1.3, 9)]
    camera = section({"frames": 31, "position_m": way})
    there = positions(camera)
    assert [tuple(row) for row in there[[0, 10, 20, 30]]] == [(0, 0, 2), *way]
    for piece in range(3):
        steps = np.diff(there[10 * piece : 10 * piece + 11], axis=0)
        assert np.allclose(steps, steps[0], atol=1e-12)


def test_two_lists_of_different_length_are_two_ways_over_the_same_time() -> None:
    camera = section({"frames": 7, "position_m": [[6, 0, 2]], "look_at_m": [[0, 50, 8], [60, 50, 8], [60, 50, 2]]})
    assert np.allclose(positions(camera)[:, 0], range(7))
    look = np.array([[0, 50, 2], [0, 50, 5], [0, 50, 8], [30, 50, 8], [60, 50, 8], [60, 50, 5], [60, 50, 2]], float)
    to = look - positions(camera)
    assert np.allclose(targets(camera), to / np.linalg.norm(to, axis=1, keepdims=True), atol=1e-12)


def test_a_missing_list_stands_still() -> None:
    turning = section({"frames": 3, "look_at_m": [[50, 0, 2]]})
    assert np.array_equal(positions(turning), [[0, 0, 2]] * 3)
    walking = section({"frames": 3, "position_m": [[0, 10, 2]]})
    assert np.allclose(targets(walking), [0, 1, 0])


def test_names_times_and_who_follows_whom() -> None:
    still = section(None, name="still")
    walk = section({"frames": 3, "frames_per_s": 4.0, "position_m": [[1, 0, 2]]})
    run = section({"frames": 2, "position_m": [[1, 0, 2]]}, name="run")
    cameras = [camera for one in (walk, still, run) for camera in expand(one, FLAT)]
    assert [one.name for one in cameras] == ["walk-0000", "walk-0001", "walk-0002", "still", "run-0000", "run-0001"]
    assert [one.sequence for one in cameras] == ["walk"] * 3 + [None] + ["run"] * 2
    assert [one.time_s for one in cameras] == [0.0, 0.25, 0.5, 0.0, 0.0, 1 / 24]
    after = [next_frame(cameras, one) for one in cameras]
    assert after == [cameras[1], cameras[2], None, None, cameras[5], None]


def test_a_walker_keeps_his_height_above_the_ground() -> None:
    camera = section({"frames": 41, "position_m": [[60, 30, 2]]})
    there = positions(camera, WAVY)
    ground = WAVY(there[:, 0], there[:, 1])
    assert np.ptp(ground) > 5
    assert np.allclose(there[:, 2] - ground, 2.0, atol=1e-12)
    flying = section({"frames": 41, "position_m": [[60, 30, 2]]}, height_above_ground=False)
    assert np.array_equal(positions(flying, WAVY)[:, 2], np.full(41, 2.0))


def test_a_camera_without_a_path_is_the_one_frame_of_before() -> None:
    (camera,) = expand(section(None), WAVY)
    assert (camera.name, camera.sequence, camera.time_s) == ("walk", None, 0.0)
    assert camera.position_m[2] == pytest.approx(2.0 + float(WAVY(np.zeros(1), np.zeros(1))[0]))


PATH = "cameras.0.path="


@pytest.mark.parametrize(
    ("overrides", "where"),
    [
        ([PATH + "{frames: 3}"], "cameras.0.path"),
        ([PATH + "{frames: 3, position_m: [[60, -10, 3.2]]}"], "cameras.0.path"),
        ([PATH + "{frames: 3}", "wind={speed_m_per_s: 9, gustiness: 0}"], "cameras.0.path"),
        ([PATH + "{frames: 3, position_m: [[62, 60, 8]]}"], "cameras.0.path.position_m"),
        ([PATH + "{frames: 5, look_at_m: [[58, -80, -1.6]]}"], "cameras.0.path.look_at_m"),
        ([PATH + "{frames: 1, position_m: [[9, 9, 9]]}"], "cameras.0.path.frames"),
        ([PATH + "{frames: 1001, position_m: [[9, 9, 9]]}"], "cameras.0.path.frames"),
        ([PATH + "{position_m: [[9, 9, 9]]}"], "cameras.0.path.frames"),
        ([PATH + "{frames: 3, position_m: [[9, 9]]}"], "cameras.0.path.position_m.0"),
        ([PATH + "{frames: 3, frames_per_s: 0, position_m: [[9, 9, 9]]}"], "frames_per_s"),
        ([PATH + "{frames: 3, positions_m: [[9, 9, 9]]}"], "cameras.0.path.positions_m"),
        ([PATH + "{frames: 3, position_m: [[9, 9, 950]]}", "render.clouds=farfield"], "cameras.0.path.position_m"),
        ([PATH + "{frames: 1000, position_m: [[9, 9, 9]]}", "cameras.1={}"], "cameras.1"),
        ([PATH + "{frames: 3, position_m: [[9, 9, 9]]}", "cameras.1={name: CAMERA0-0002}"], "cameras.1.name"),
        (["cameras=[{name: a-0001}, {name: a, path: {frames: 2, position_m: [[9, 9, 9]]}}]"], "cameras.1.name"),
        (["cameras=[{name: a}, {name: A, path: {frames: 2, position_m: [[9, 9, 9]]}}]"], "cameras.1.name"),
    ],
)
def test_a_bad_path_is_refused_where_it_stands(overrides: list[str], where: str) -> None:
    with raises_error(RecipeError, place=f"{where}"):
        check_plan(load_recipe(QUICKSTART, overrides))


def test_wind_is_motion_enough() -> None:
    plan = check_plan(load_recipe(QUICKSTART, [PATH + "{frames: 3}", "wind.speed_m_per_s=3"]))
    assert plan.drawn.recipe.cameras[0].frames == 3


def test_the_end_of_a_range_that_stills_everything_is_found_before_the_start() -> None:
    with raises_error(RecipeError, place="cameras.0.path"):
        check_plan(load_recipe(QUICKSTART, [PATH + "{frames: 3}", "wind={speed_m_per_s: {uniform: [0, 4]}}"]))


def test_frames_below_the_ground_are_named() -> None:
    down = PATH + "{frames: 4, position_m: [[60, -10, -4]]}"
    with raises_error(RecipeError, place="cameras.0.path.position_m"):
        check_plan(load_recipe(QUICKSTART, [down]))
    plan = check_plan(load_recipe(QUICKSTART, [down, "cameras.0.obstructed=note"]))
    assert list(plan.views.below_ground) == ["camera0-0002", "camera0-0003"]
