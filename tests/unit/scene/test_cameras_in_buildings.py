"""A camera inside of a house sees dark walls: a mistake, or a note."""

from __future__ import annotations

import pytest

from forestgen.core.errors import RecipeError
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import make_plan
from support.error_messages import raises_error

# The house is 12 m along its ridge, which goes from north-west to south-east, and 6 m deep.
STAND = """
forestgen: 1
site:
  size_m: [40, 40]
  terrain: flat
  buildings: [{kind: house, position_m: [20, 20], size_m: [12, 6, 8], azimuth_deg: 45}]
species: {pine: }
community:
  model: branch_modules
  initial_plants: 3
  steps: 1
cameras: [{position_m: %s, look_at_m: [1, 2, 1], obstructed: %s}]
"""
INSIDE = ([20, 20, 1.6], [20, 20, 6.5], [23, 17, 2], [17, 23, 2])
OUTSIDE = ([20, 20, 8.5], [20, 20, 30], [23, 23, 2], [17, 17, 2], [22, 22, 7.5], [35, 5, 2])


def drawn_of(tmp_path, position, obstructed):
    (tmp_path / "stand.yaml").write_text(STAND % (position, obstructed))
    return load_recipe(tmp_path / "stand.yaml", []).draw(0)


@pytest.mark.parametrize("position", INSIDE)
def test_a_camera_in_a_house_is_refused_at_its_line(tmp_path, position):
    with raises_error(RecipeError, place="cameras.0.position_m") as told:
        make_plan(drawn_of(tmp_path, position, "error"))
    assert "stand.yaml:12: cameras.0.position_m" in str(told.value.where)


@pytest.mark.parametrize("position", INSIDE)
def test_a_camera_in_a_house_is_a_note_where_cameras_stand_at_random(tmp_path, position):
    plan = make_plan(drawn_of(tmp_path, position, "note"))
    (note,) = plan.views.check_outside_of_buildings()
    assert note == "the camera camera0 stands inside of a house"


@pytest.mark.parametrize("position", OUTSIDE)
def test_beside_above_and_before_a_house_cameras_stand_free(tmp_path, position):
    make_plan(drawn_of(tmp_path, position, "error"))
