"""Cameras of a recipe: kinds, their keys, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from forestgen.core.errors import RecipeError
from forestgen.recipe.cameras import Camera
from forestgen.recipe.load import DrawnRecipe, dump_yaml, load_recipe
from support.error_messages import raises_error
from support.tiers import few

QUICKSTART = Path(__file__).parents[3] / "recipes" / "quickstart.yaml"
GOOD = [
    "{}",
    "{kind: fisheye}",
    "{kind: panorama, look_at_m: [9, 9, 9]}",
    "{kind: orthographic, width_m: 100}",
    "{focal_length_mm: 50, f_number: 1.8, focus_m: 6, exposure: {shutter_s: 0.01}}",
    "{look: up, rig: {kind: stereo, baseline_m: 0.2}, path: {frames: 3, position_m: [[50, 50, 3]]}}",
    "{look_at_m: [60, 60, 4], rig: {kind: orbit, radius_m: 20, height_m: 5, count: 12}}",
    "{rig: {kind: walk, waypoints_m: [[10, 10], [60, 80]], frames: 10}}",
    "{rig: {kind: drone_grid, altitude_m: 60}}",
    "{kind: orthographic, width_m: 40, rig: {kind: drone_grid, altitude_m: 60}}",
]


def drawn(camera: str) -> DrawnRecipe:
    return load_recipe(QUICKSTART, [f"cameras=[{camera}]"]).draw(0)


@pytest.mark.parametrize("camera", few(reversed(GOOD), 4))
def test_a_stored_recipe_gives_the_same_cameras_again(camera: str, tmp_path: Path) -> None:
    first = drawn(camera)
    (tmp_path / "again.yaml").write_text(dump_yaml(first), encoding="utf-8")
    again = load_recipe(tmp_path / "again.yaml").draw(0)
    assert again.recipe.cameras == first.recipe.cameras
    assert dump_yaml(again) == dump_yaml(first)
    (entry,) = first.recipe.cameras
    assert len(entry.frame_names) == len(set(entry.frame_names)) == entry.frames


def test_what_a_kind_has_by_default() -> None:
    fisheye, panorama, chart, plain = (
        drawn(text).recipe.cameras[0] for text in (GOOD[1], "{kind: panorama}", GOOD[3], "{}")
    )
    assert (fisheye.look, fisheye.size_px, fisheye.field_of_view_deg) == ("up", (512, 512), 180)
    assert (panorama.look, panorama.size_px, panorama.field_of_view_deg) == ("north", (1024, 512), 0)
    assert (chart.look, chart.position_m) == ("down", (60, 60, 100))
    assert (plain.look, plain.size_px, plain.hfov_deg) == (None, (640, 360), 60)


def test_a_lens_by_its_focal_length_and_by_its_angle() -> None:
    keys = {"name": "c", "position_m": (0, 0, 2), "look_at_m": (0, 9, 2), "f_number": 2.0, "focus_m": 5.0}
    by_length = Camera.model_validate({**keys, "focal_length_mm": 50})
    assert by_length.field_of_view_deg == pytest.approx(39.598, abs=1e-3)  # of 36 mm
    assert by_length.lens_mm == (12.5, 50)
    by_angle = Camera.model_validate({**keys, "hfov_deg": by_length.field_of_view_deg})
    assert by_angle.lens_mm == pytest.approx((12.5, 50))
    small = Camera.model_validate({**keys, "focal_length_mm": 8.8, "sensor_width_mm": 13.2})
    assert small.field_of_view_deg == pytest.approx(2 * math.degrees(math.atan(0.75)))


def test_lens_and_exposure_share_an_f_number() -> None:
    one = drawn("{f_number: 2.8, focus_m: 9, exposure: {iso: 400}}").recipe.cameras[0]
    assert one.exposure is not None
    assert one.exposure.f_number == 2.8


@pytest.mark.parametrize(
    ("camera", "where"),
    [
        ("{kind: orthographic}", "width_m"),
        ("{kind: orthographic, width_m: 9, hfov_deg: 50}", "hfov_deg"),
        ("{kind: fisheye, focal_length_mm: 8}", "focal_length_mm"),
        ("{kind: fisheye, f_number: 2, focus_m: 3}", "f_number"),
        ("{kind: panorama, hfov_deg: 360}", "hfov_deg"),
        ("{kind: panorama, size_px: [100, 100]}", "size_px"),
        ("{kind: panorama, look: up}", "look"),
        ("{kind: panorama, position_m: [5, 5, 2], look_at_m: [5, 5, 9]}", "look_at_m"),
        ("{width_m: 20}", "width_m"),
        ("{hfov_deg: 175}", "hfov_deg"),
        ("{focal_length_mm: 1}", "focal_length_mm"),
        ("{hfov_deg: 50, focal_length_mm: 3}", "focal_length_mm"),
        ("{f_number: 2}", "f_number"),
        ("{focus_m: 2}", "focus_m"),
        ("{focal_length_mm: 50, f_number: 2, focus_m: 0.05}", "focus_m"),
        ("{f_number: 2, focus_m: 3, exposure: {f_number: 8}}", "exposure.f_number"),
        ("{look: up, look_at_m: [1, 2, 3]}", "look_at_m"),
        ("{look: sideways}", "look"),
        ("{rig: {kind: sterio, baseline_m: 1}}", "rig.kind"),
        ("{rig: {kind: stereo, base_m: 1}}", "rig.baseline_m"),
        ("{rig: {kind: orbit, radius_m: 9, height_m: 2, count: 4}}", "rig"),
        ("{position_m: [1, 1, 1], rig: {kind: walk, waypoints_m: [[1, 1], [9, 9]], frames: 4}}", "position_m"),
        ("{rig: {kind: walk, waypoints_m: [[1, 1], [1, 1]], frames: 4}}", "rig.waypoints_m.1"),
        ("{look: down, rig: {kind: drone_grid, altitude_m: 9}}", "look"),
        ("{kind: fisheye, rig: {kind: drone_grid, altitude_m: 9}}", "kind"),
        ("{rig: {kind: drone_grid, altitude_m: 0.5}}", "rig"),
        ("{rig: {kind: drone_grid, altitude_m: 9, area_m: [[9, 9], [3, 12]]}}", "rig.area_m"),
    ],
)
def test_a_bad_camera_is_refused_where_it_is_written(camera: str, where: str) -> None:
    with raises_error(RecipeError, place=f"cameras.0.{where}"):
        drawn(camera)
