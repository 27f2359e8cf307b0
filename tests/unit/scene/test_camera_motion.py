"""What a recipe says of a camera's motion, and the poses that follow from it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from forestgen.core.errors import RecipeError
from forestgen.dataset.camera import camera_model
from forestgen.recipe.load import load_recipe
from forestgen.scene.motion import row_poses, still_at
from forestgen.scene.spec import Camera
from forestgen.scene.terrain import HeightField
from forestgen.scene.views import Views, expand
from support.error_messages import raises_error


def camera(**motion: Any) -> Camera:
    """It looks north."""
    keys = {"position_m": [20, 5, 2], "look_at_m": [20, 50, 2], "exposure": {"shutter_s": 0.01}, "motion": motion}
    loaded = load_recipe(
        {"forestgen": 1, "species": {"spruce": None}, "community": {"model": "stand"}, "cameras": [keys]}
    )
    return expand(loaded.draw(0).recipe.cameras[0], HeightField((100.0, 100.0)))[0]


def test_a_camera_without_velocity_stands_still():
    assert camera(readout_s=0.03).motion is None


def test_a_camera_that_sinks_into_the_ground_while_it_exposes_is_told():
    def check(fall_m_per_s: float) -> None:
        motion = {"velocity_m_per_s": [0, 0, -fall_m_per_s], "readout_s": 0.2}
        keys = {"position_m": [20, 5, 0.3], "look_at_m": [20, 50, 2], "exposure": {"shutter_s": 0.02}, "motion": motion}
        site = {"terrain": "flat"}
        about = {"species": {"spruce": None}, "community": {"model": "stand"}, "site": site, "cameras": [keys]}
        Views.of(load_recipe({"forestgen": 1, **about}).draw(0)).check_above_ground()

    check(2.0)
    with raises_error(RecipeError, place="cameras.0.position_m"):
        check(3.0)


def test_motion_needs_an_exposure():
    keys = {"motion": {"velocity_m_per_s": [1, 0, 0]}}
    with raises_error(RecipeError, place="cameras.0.motion"):
        load_recipe(
            {"forestgen": 1, "species": {"spruce": None}, "community": {"model": "stand"}, "cameras": [keys]}
        ).draw(0)


@pytest.mark.parametrize(
    ("rotation", "axis", "towards"),
    [([10, 0, 0], 2, (0, 1, 1)), ([0, 10, 0], 2, (1, 1, 0)), ([0, 0, 10], 0, (1, 0, -1))],
)
def test_positive_rotations_turn_up_to_the_right_and_clockwise(rotation, axis, towards):
    later = still_at(camera(rotation_deg_per_s=rotation), 4.5)
    np.testing.assert_allclose(later.world_from_camera[:, axis], np.array(towards) / np.sqrt(2), atol=1e-12)


def test_camera_json_says_where_each_row_is_exposed():
    moving = camera(velocity_m_per_s=[3, -2, 1], rotation_deg_per_s=[20, -50, 70], readout_s=0.25)
    content = camera_model(moving)
    motion, (place, axes) = content["motion"], row_poses(moving)
    w = np.radians(motion["rotation_deg_per_s"])
    cross = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    middle = np.array(content["world_from_camera"])[:3, :3]
    for row in (0, 100, moving.size_px[1] - 1):
        t = motion["first_row_s"] + row * motion["row_step_s"]
        np.testing.assert_allclose(axes[row], middle @ expm(t * cross), atol=1e-12)
        np.testing.assert_allclose(place[row, 0], t * np.array(motion["velocity_m_per_s"]), atol=1e-12)
    assert motion["shutter_s"] == 0.01
    assert content["optics"]["f_number"] == 8.0
