"""Rigs: where their cameras stand, and trunks that are in the way."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from forestgen.core.errors import RecipeError
from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.recipe.cameras import Camera
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import check_plan, make_plan
from forestgen.scene.projection import project
from forestgen.scene.spec import Instances
from forestgen.scene.terrain import HeightField
from forestgen.scene.terrains.rolling import Waves
from forestgen.scene.trunks import BlockedError, Trunks, at_lengths, length_m, way_around
from forestgen.scene.views import check_trunks, drawn_cameras, expand, next_frame
from support.error_messages import raises_error

QUICKSTART = Path(__file__).parents[3] / "recipes" / "quickstart.yaml"
FLAT = HeightField((100.0, 100.0))
WAVY = Waves((100.0, 100.0), np.array([[0.1, 0.03]]), np.array([5.0]), np.array([0.4]), np.array([0]))


def section(**keys: Any) -> Camera:
    return Camera.model_validate({"name": "c", **keys})


def stem(radius_m: float = 0.25, height_m: float = 8.0, sides: int = 48) -> Exemplar:
    """A closed cylinder."""
    angle = np.arange(sides) / sides * 2 * np.pi
    ring = np.column_stack([radius_m * np.cos(angle), radius_m * np.sin(angle)])
    low, high = (np.column_stack([ring, np.full(sides, z)]) for z in (-0.5, height_m))
    vertices = np.concatenate([low, high, [[0, 0, -0.5], [0, 0, height_m]]]).astype(np.float32)
    k = np.arange(sides)
    n = (k + 1) % sides
    top, foot = np.full(sides, 2 * sides + 1), np.full(sides, 2 * sides)
    faces = np.concatenate(
        [
            np.stack(rows, axis=1)
            for rows in ((k, n, n + sides), (k, n + sides, k + sides), (k + sides, n + sides, top), (n, k, foot))
        ]
    )
    mesh = Mesh(vertices, faces.astype(np.uint32))
    return Exemplar("pole", (OrganMesh(Part.TRUNK, "bark", mesh),), 1.0, height_m, 0.5, 0.0, 1.0)


def standing(there: np.ndarray, scale: np.ndarray, exemplar: Exemplar) -> Trunks:
    count = len(there)
    transform = np.zeros((count, 3, 4))
    transform[:, [0, 1, 2], [0, 1, 2]] = scale[:, None]
    transform[:, :2, 3] = there
    ids = np.arange(1, count + 1, dtype=np.uint32)
    return Trunks([exemplar], Instances(np.zeros(count, dtype=np.uint32), transform, ids))


def test_a_stereo_pair_is_parallel_and_its_disparity_is_that_of_its_baseline() -> None:
    rig = {"kind": "stereo", "baseline_m": 0.4}
    left, right = expand(section(position_m=(5, 5, 2), look_at_m=(20, 30, 6), rig=rig), FLAT)
    assert (left.name, right.name, left.sequence) == ("c-left", "c-right", None)
    assert np.array_equal(left.world_from_camera, right.world_from_camera)
    apart = np.subtract(right.position_m, left.position_m)
    assert np.allclose(apart, 0.4 * left.world_from_camera[:, 0])
    assert np.allclose(np.add(left.position_m, right.position_m) / 2, [5, 5, 2])
    point = np.array([18.0, 31.0, 4.0])
    a, b = (project(one, (point - one.position_m) @ one.world_from_camera) for one in (left, right))
    assert a.x_px - b.x_px == pytest.approx(left.focal_px * 0.4 / a.depth_m)
    assert a.y_px == pytest.approx(float(b.y_px))


def test_a_stereo_pair_along_a_path_is_two_sequences_in_step() -> None:
    path = {"frames": 3, "frames_per_s": 2.0, "position_m": [[9, 5, 2]]}
    rig = {"kind": "stereo", "baseline_m": 0.4}
    cameras = expand(section(position_m=(5, 5, 2), look_at_m=(5, 30, 2), path=path, rig=rig), FLAT)
    names = ["c-left-0000", "c-right-0000", "c-left-0001", "c-right-0001", "c-left-0002", "c-right-0002"]
    assert [one.name for one in cameras] == names
    assert [one.time_s for one in cameras] == [0, 0, 0.5, 0.5, 1, 1]
    following = [next_frame(cameras, one) for one in cameras]
    assert [one.name if one else None for one in following] == [*names[2:], None, None]


def test_an_orbit_looks_inward_from_a_circle() -> None:
    rig = {"kind": "orbit", "radius_m": 12, "height_m": 3, "count": 8}
    cameras = expand(section(look_at_m=(40, 30, 2), rig=rig), WAVY)
    there = np.array([one.position_m for one in cameras])
    assert np.allclose(np.hypot(there[:, 0] - 40, there[:, 1] - 30), 12)
    assert np.allclose(there[:, 2] - WAVY(there[:, 0], there[:, 1]), 3)
    assert np.allclose(there[0, :2], [40, 18]), "the first in the south"
    assert np.allclose(there[2, :2], [28, 30]), "then clockwise: west"
    centre = np.array([40, 30, 2 + float(WAVY(np.array(40.0), np.array(30.0)))])
    for one in cameras:
        ahead = centre - one.position_m
        assert np.allclose(one.world_from_camera[:, 2], ahead / np.linalg.norm(ahead))
    assert {(one.sequence, one.time_s) for one in cameras} == {(None, 0.0)}
    around = expand(section(look_at_m=(40, 30, 2), rig={**rig, "frames_per_s": 4}), WAVY)
    assert [one.time_s for one in around] == [index / 4 for index in range(8)]
    assert {one.sequence for one in around} == {"c"}


@pytest.mark.parametrize(("forward", "side", "altitude"), [(0.8, 0.6, 30.0), (0.0, 0.0, 20.0), (0.5, 0.9, 200.0)])
def test_a_drone_grid_shows_the_area_with_its_overlaps(forward: float, side: float, altitude: float) -> None:
    area = [[10.0, 5.0], [110.0, 65.0]]
    rig = {
        "kind": "drone_grid",
        "altitude_m": altitude,
        "forward_overlap": forward,
        "side_overlap": side,
        "area_m": area,
    }
    entry = section(hfov_deg=70, size_px=(400, 300), rig=rig)
    cameras = expand(entry, FLAT)
    assert len(cameras) == entry.frames == len(entry.frame_names)
    width = 2 * altitude * np.tan(np.radians(35))
    depth = width * 3 / 4
    there = np.array([one.position_m for one in cameras])
    lines, rows = np.unique(there[:, 0].round(9)), np.unique(there[:, 1].round(9))
    for stops, seen, overlap, (low, high) in ((lines, width, side, (10, 110)), (rows, depth, forward, (5, 65))):
        if len(stops) > 1:
            assert np.allclose([stops[0] - seen / 2, stops[-1] + seen / 2], [low, high])
            assert 1 - np.diff(stops).max() / seen >= overlap - 1e-9
            fewer = (high - low - seen) / max(len(stops) - 2, 1)
            assert len(stops) == 2 or 1 - fewer / seen < overlap, "no more images than it takes"
        else:
            assert seen >= high - low
    assert np.array_equal(cameras[0].world_from_camera, [[1, 0, 0], [0, -1, 0], [0, 0, -1]]), "east right, north up"
    # Back and forth: steps are along a line or to the next line, never back to its start.
    steps = np.abs(np.diff(there[:, :2], axis=0))
    assert np.all(np.isclose(steps, 0, atol=1e-9).any(axis=1))


def test_a_walk_keeps_eye_height_pace_and_clearance_around_trunks() -> None:
    rng = np.random.default_rng(5)
    trunks = standing(rng.uniform(2, 58, (300, 2)), rng.uniform(0.4, 1.6, 300), stem())
    middles, radii = trunks.circles_m(2.0)
    assert np.allclose(np.sort(radii), np.sort(trunks._scale * 0.25), rtol=1e-5)
    rig = {"kind": "walk", "waypoints_m": [[3, 3], [40, 20], [55, 55]], "frames": 240, "clearance_m": 0.5}
    cameras = expand(section(rig=rig), WAVY, trunks)
    there = np.array([one.position_m for one in cameras])
    assert np.allclose(there[:, 2] - WAVY(there[:, 0], there[:, 1]), 1.7)
    away = np.hypot(there[:, 0, None] - middles[:, 0], there[:, 1, None] - middles[:, 1]) - radii
    assert away.min() > 0.48
    straight = np.array([one.position_m for one in expand(section(rig=rig), WAVY)])
    blocked = np.hypot(straight[:, 0, None] - middles[:, 0], straight[:, 1, None] - middles[:, 1]) - radii
    assert blocked.min() < 0, "there was something to avoid"
    pace = np.hypot(*np.diff(there[:, :2], axis=0).T)
    assert np.ptp(pace) < 0.05 * pace.mean()
    forward = np.array([one.world_from_camera[:, 2] for one in cameras])
    assert (forward[:-1] * np.diff(there, axis=0)).sum(axis=1).min() > 0, "it looks where it goes"
    turns = np.degrees(np.arccos(np.clip((forward[:-1] * forward[1:]).sum(axis=1), -1, 1)))
    assert turns.max() < 12
    again = np.array([one.position_m for one in expand(section(rig=rig), WAVY, trunks)])
    assert np.array_equal(there, again)
    assert {one.sequence for one in cameras} == {"c"}


def test_a_walk_squeezes_through_a_gap_and_says_when_there_is_none() -> None:
    posts = np.column_stack([np.zeros(161), np.linspace(-40, 40, 161)])
    radii = np.full(161, 0.26)
    ends = np.array([[-5.0, 0.1], [5.0, 0.1]])
    with pytest.raises(BlockedError):
        way_around(ends, posts, radii, 0.5)
    gap = np.abs(posts[:, 1] - 3.0) > 0.3
    way = way_around(ends, posts[gap], radii[gap], 0.5)
    fine = at_lengths(way, np.linspace(0, length_m(way), 2000))
    apart = (np.hypot(fine[:, 0, None], fine[:, 1, None] - posts[gap, 1]) - 0.26).min()
    assert 0.09 < apart < 0.5


def test_how_far_a_point_is_from_a_trunk() -> None:
    trunks = standing(np.array([[10.0, 10.0], [20.0, 10.0]]), np.array([1.0, 2.0]), stem())
    for point, distance, plant in (
        ([10.3, 10.0, 2.0], 0.05, 1),
        ([20.0, 10.6, 2.0], 0.1, 2),
        ([10.0, 10.0, 8.1], 0.1, 1),
        ([10.1, 10.0, 2.0], -0.15, 1),
        ([20.0, 9.9, 3.0], -0.4, 2),
        ([14.0, 10.0, 2.0], 0.2, 0),
    ):
        apart, whose = trunks.clearance_m(np.array(point), 0.2)
        assert (apart, whose) == (pytest.approx(distance, abs=2e-3), plant)


WALL = "{kind: walk, waypoints_m: [[10, 10], [20, 10]], frames: 3}"


@pytest.mark.parametrize(
    ("camera", "where", "problem"),
    [
        ("{position_m: [10.1, 10, 2], look_at_m: [30, 30, 2]}", "cameras.0.position_m", "in the trunk of plant 1"),
        ("{position_m: [10.28, 10, 2], look_at_m: [30, 30, 2]}", "cameras.0.position_m", "3 cm from the trunk"),
        (
            "{position_m: [5, 10, 2], look_at_m: [30, 30, 2], path: {frames: 11, position_m: [[15, 10, 2]]}}",
            "cameras.0.path.position_m",
            "camera0-0005 stands in the trunk",
        ),
        ("{look_at_m: [0, 10, 2], rig: {kind: orbit, radius_m: 10, height_m: 2, count: 4}}", "cameras.0.rig", "-0003"),
    ],
)
def test_a_camera_in_a_trunk_is_refused_where_it_is_written_or_noted(camera: str, where: str, problem: str) -> None:
    trunks = standing(np.array([[10.0, 10.0]]), np.array([1.0]), stem())
    overrides = [f"cameras=[{camera}]", "site.terrain=flat"]
    drawn = make_plan(load_recipe(QUICKSTART, overrides).draw(0)).drawn
    with raises_error(RecipeError, place=f"{where}"):
        check_trunks(drawn, drawn_cameras(drawn), trunks)
    drawn = load_recipe(QUICKSTART, [*overrides, "cameras.0.obstructed=note"]).draw(0)
    (note,) = check_trunks(drawn, drawn_cameras(drawn), trunks)
    assert problem in note


@pytest.mark.parametrize(
    ("camera", "where"),
    [
        ("{position_m: [0, 0, -1], look_at_m: [5, 5, 5]}", "cameras.0.position_m"),
        ("{position_m: [0, 0, -9], look_at_m: [5, 5, 5], height_above_ground: false}", "cameras.0.position_m"),
        ("{look_at_m: [60, 60, 5], rig: {kind: orbit, radius_m: 9, height_m: -1, count: 3}}", "cameras.0.rig"),
        ("{position_m: [0, 0, {uniform: [-1, 3]}], look_at_m: [5, 5, 5]}", "cameras.0.position_m"),
    ],
)
def test_a_camera_below_the_ground_is_refused_before_anything_is_simulated(camera: str, where: str) -> None:
    with raises_error(RecipeError, place=f"{where}"):
        check_plan(load_recipe(QUICKSTART, [f"cameras=[{camera}]"]))
