"""Views of plants against a loop over plants and pixels."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.core.frames import look_at
from forestgen.core.parts import Part
from forestgen.labels.labelled import HIDDEN, OUTSIDE, VISIBLE, plant_views, project, truncation
from forestgen.labels.masks import AmodalMasks, pixel_labels
from forestgen.recipe.classes import ClassMap
from forestgen.render.frame import Frame, Identity, Radiance, Surface
from forestgen.scene.plant_measures import PlantMeasures
from forestgen.scene.spec import Camera

WIDTH, HEIGHT, SAMPLES = 20, 12, 4
PLANTS = np.array([3, 70_000, 2**32 - 1], np.uint32)


def view():
    position = (2.0, -9.0, 3.0)
    return Camera("c", position, look_at(np.array(position), np.array([0.5, 1.0, 1.0])), (WIDTH, HEIGHT), 55.0)


def point_at(x_px, y_px, depth_m):
    """The point of the world that the camera sees at a point of the image: its definition the other way round."""
    camera = view()
    half = np.tan(np.radians(camera.hfov_deg) / 2)
    right, down, forward = camera.world_from_camera.T
    u, v = (x_px / WIDTH * 2 - 1) * half, (y_px - HEIGHT / 2) / (WIDTH / 2) * half
    return np.asarray(camera.position_m) + depth_m * (forward + u * right + v * down)


def measures(points_m):
    n = len(points_m)
    return PlantMeasures(
        np.zeros(n, np.uint32), np.zeros((n, 3, 4)), *np.ones((4, n)), *np.moveaxis(np.asarray(points_m), 1, 0)
    )


def frame_of(samples, part):
    height, width = samples.shape[:2]
    colour, number = np.zeros((height, width, 3), np.float32), np.zeros((height, width), np.uint32)
    depth = np.ones((height, width), np.float32)
    surface = Surface(number, number.astype(np.uint8), number, number, depth, depth, *[colour] * 4, depth > 2)
    return Frame(view(), Radiance(colour, colour, None, 1), Identity(samples, part, colour, colour), surface)


def views_of(samples, part, points_m, amodal=None):
    labels = pixel_labels(samples, part, PLANTS, np.zeros(len(PLANTS), int), ClassMap(("a",)))
    return plant_views(frame_of(samples, part), PLANTS, labels, measures(points_m), amodal)


def empty():
    return np.zeros((HEIGHT, WIDTH, SAMPLES), np.uint32), np.full((HEIGHT, WIDTH, SAMPLES), Part.LEAF, np.uint8)


def anywhere():
    return [[point_at(3.0, 3.0, 5.0)] * 3] * 3


def test_points_project_where_they_are_seen():
    pixels = np.array([[0.0, 0.0], [7.25, 3.5], [20.0, 12.0], [-40.0, 90.0]])
    points = np.array([point_at(x, y, depth) for (x, y), depth in zip(pixels, (0.1, 5.0, 80.0, 1e4), strict=True)])
    np.testing.assert_allclose(project(view(), points), pixels, atol=1e-8)
    behind = 2 * np.asarray(view().position_m) - points
    assert np.isnan(project(view(), behind)).all()


def test_keypoints_tell_whether_the_plant_wins_their_pixel():
    samples, part = empty()
    samples[5, 8] = 3
    samples[5, 9] = [3, 3, 3, 70_000]
    points = anywhere()
    points[0] = [point_at(8.99, 5.01, 4.0), point_at(9.0, 5.99, 4.0), point_at(10.0, 5.5, 4.0)]
    points[1] = [point_at(9.5, 5.5, 4.0), point_at(0.01, 0.01, 3.0), point_at(-0.01, 5.0, 3.0)]
    points[2] = [point_at(20.0, 5.0, 3.0), point_at(19.99, 11.99, 3.0), np.array([2.0, -30.0, 3.0])]
    found = views_of(samples, part, points)
    assert found.keypoint_state.tolist() == [
        [VISIBLE, VISIBLE, HIDDEN],
        [HIDDEN, HIDDEN, OUTSIDE],
        [OUTSIDE, HIDDEN, OUTSIDE],
    ]
    assert np.isnan(found.keypoint_px[2, 2]).all()
    np.testing.assert_allclose(found.keypoint_px[0, 0], [8.99, 5.01])


def test_distance_is_to_the_stem_base():
    points = anywhere()
    points[1] = [np.array([2.0, -9.0, 0.0]), *points[1][1:]]
    assert views_of(*empty(), points).distance_m[1] == pytest.approx(3.0)


def test_stem_pixels_are_won_and_trunk():
    rng = np.random.default_rng(0)
    samples, part = empty()
    samples[:] = rng.choice(np.array([0, *PLANTS], np.uint32), samples.shape, p=[0.2, 0.5, 0.2, 0.1])
    part[:] = rng.choice([Part.TRUNK, Part.LEAF], part.shape)
    found = views_of(samples, part, anywhere())
    labels = pixel_labels(samples, part, PLANTS, np.zeros(3, int), ClassMap(("a",)))
    expected = [((labels.instance == plant) & (labels.part == Part.TRUNK)).sum() for plant in PLANTS]
    assert found.stem_pixels.tolist() == expected
    assert min(expected) > 0


def masks_of(plants, boxes, area, full):
    sizes = [w * h for _, _, w, h in boxes]
    return AmodalMasks(
        plant_id=np.array(plants, np.uint32),
        box_px=np.array(boxes, np.int32),
        first=np.concatenate([[0], np.cumsum(sizes)]),
        inside=np.ones(sum(sizes), bool),
        pixels=np.array(sizes),
        area_px=np.array(area, float),
        full_box_px=np.array(full, float),
    )


def test_what_is_visible_of_what_there_is():
    samples, part = empty()
    samples[0, 0:2] = 70_000  # two pixels
    samples[3, 3, 0] = 2**32 - 1  # a quarter of one
    plants, boxes = [70_000, 2**32 - 1], [[0, 0, 5, 2], [3, 3, 1, 1]]
    amodal = masks_of(plants, boxes, [8.0, 0.25], [[-5, 0, 5, 2], [3, 3, 4, 4]])
    found = views_of(samples, part, anywhere(), amodal)
    assert found.amodal_pixels.tolist() == [0, 10, 1]
    assert found.amodal_box_px.tolist() == [[0, 0, 0, 0], [0, 0, 5, 2], [3, 3, 1, 1]]
    np.testing.assert_array_equal(found.visible_fraction, [np.nan, 0.25, 1.0])
    np.testing.assert_array_equal(found.truncation, [np.nan, 0.5, 0.0])
    np.testing.assert_array_equal(found.amodal_area_px, [np.nan, 8.0, 0.25])


def test_without_amodal_masks_nothing_is_claimed():
    samples, part = empty()
    samples[4] = 3
    found = views_of(samples, part, anywhere())
    assert not found.amodal_pixels.any()
    for values in (found.visible_fraction, found.truncation, found.amodal_area_px, found.full_box_px):
        assert np.isnan(values).all()


@pytest.mark.parametrize(
    ("box", "expected"),
    [
        ([1, 1, 5, 5], 0.0),
        ([-10, 0, 10, 12], 0.5),
        ([-10, -6, 30, 18], 0.75),
        ([30, 2, 40, 4], 1.0),
        ([4, 1, 4, 5], 0.0),  # no width, inside
        ([4, -5, 4, 5], 0.5),
        ([25, 1, 25, 5], 1.0),
        ([np.nan, 0, 1, 1], np.nan),
    ],
)
def test_truncation(box, expected):
    np.testing.assert_allclose(truncation(np.array([box], float), (WIDTH, HEIGHT)), [expected])
