"""What the checker recomputes: run lengths, fills, extents, hashes, against brute force and other libraries."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rasterisers import opencv_fill

from forestgen.dataset.check.coco import area, library_box, run_lengths, runs_of_ones, window
from forestgen.dataset.check.cryptomatte import standard_id
from forestgen.dataset.check.files import UnreadableError, read_recipe
from forestgen.dataset.check.frame_data import CameraFile, camera_of, extents_of
from forestgen.dataset.check.masks import keypoint_states
from forestgen.dataset.check.merged import UNKNOWN, following_frames
from forestgen.dataset.check.yolo import _differences, fill, line_pixels

SHAPES = st.tuples(st.integers(1, 12), st.integers(1, 12))
MASKS = SHAPES.flatmap(lambda shape: arrays(np.uint8, shape, elements=st.integers(0, 1)))


def code_of(mask):
    from pycocotools import mask as coco

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        code = coco.encode(np.asfortranarray(mask))
    return {"size": code["size"], "counts": code["counts"].decode()}


@given(MASKS)
def test_run_lengths_are_those_of_pycocotools(mask):
    size = mask.shape[::-1]
    runs = run_lengths(code_of(mask), size)
    flat = np.repeat(np.arange(len(runs)) % 2, runs)
    assert np.array_equal(flat, mask.T.ravel())
    decoded = runs_of_ones(code_of(mask), size)
    width, height = size
    assert area(decoded) == mask.sum()
    assert np.array_equal(window(decoded, height, 0, 0, *size), mask)
    x, y = width // 3, height // 2
    assert np.array_equal(window(decoded, height, x, y, width - x, height - y), mask[y:, x:])


def test_long_runs_and_negative_differences():
    mask = np.zeros((500, 400), np.uint8)
    mask[:, 10:200] = 1
    mask[3, 250] = 1
    decoded = runs_of_ones(code_of(mask), (400, 500))
    assert area(decoded) == 190 * 500 + 1
    assert library_box(code_of(mask)) == [10, 0, 241, 500]
    assert np.array_equal(window(decoded, 500, 0, 0, 400, 500), mask)


@given(st.text(max_size=30))
def test_any_text_is_a_code_or_refused(text):
    try:
        runs = run_lengths({"size": [4, 5], "counts": text}, (5, 4))
    except ValueError:
        return
    assert runs.min() >= 0
    assert runs.sum() == 20


@pytest.mark.parametrize(
    "code", [None, {}, {"size": [4, 5]}, {"size": [5, 4], "counts": "d0"}, {"size": [4, 5], "counts": 3}]
)
def test_what_is_no_code_is_refused(code):
    with pytest.raises(ValueError, match="the code's"):
        run_lengths(code, (5, 4))


@given(SHAPES.flatmap(lambda shape: arrays(np.uint32, shape, elements=st.sampled_from([0, 1, 2, 70_000, 2**32 - 1]))))
def test_extents_are_those_of_each_mask_alone(mask):
    extents = extents_of(mask)
    assert extents.plant_id.tolist() == sorted(set(mask.ravel().tolist()) - {0})
    for row, plant in enumerate(extents.plant_id):
        y, x = np.nonzero(mask == plant)
        assert extents.pixels[row] == len(x)
        expected = [x.min(), y.min(), x.max() - x.min() + 1, y.max() - y.min() + 1]
        assert extents.box_px[row].tolist() == expected


@given(arrays(np.float64, st.tuples(st.integers(3, 9), st.just(2)), elements=st.integers(0, 8)))
def test_fill_counts_crossings_of_a_ray_to_the_left(ring):
    filled = fill(ring, (8, 8))
    for y in range(8):
        for x in range(8):
            crossings = 0
            for (ax, ay), (bx, by) in zip(ring, np.roll(ring, -1, axis=0), strict=True):
                if (ay > y + 0.5) != (by > y + 0.5):
                    crossings += ax + (y + 0.5 - ay) * (bx - ax) / (by - ay) <= x + 0.5
            assert filled[y, x] == crossings % 2


def test_a_bridge_and_a_hole():
    outer, hole = [(0, 0), (6, 0), (6, 6), (0, 6)], [(2, 2), (2, 4), (4, 4), (4, 2)]
    ring = np.array([*outer, outer[0], *hole, hole[0]], dtype=float)  # from the corner to the hole, and back
    expected = np.ones((6, 6), bool)
    expected[2:4, 2:4] = False
    assert np.array_equal(fill(ring, (6, 6)), expected)


RINGS = arrays(np.int64, st.tuples(st.integers(1, 9), st.just(2)), elements=st.integers(0, 8))


@given(RINGS)
def test_lines_and_inside_are_what_opencv_fills_but_for_ties(ring):
    pixels, edge = line_pixels(ring)
    assert sorted(set(edge.tolist())) == list(range(len(ring)))
    found = fill(ring + 0.5, (9, 9))
    found[pixels[:, 1], pixels[:, 0]] = True
    differs = found != opencv_fill(ring, (9, 9))
    step = np.abs(np.roll(ring, -1, axis=0) - ring)
    if ((step == 0).any(axis=1) | (step[:, 0] == step[:, 1])).all():
        assert not differs.any()
    for y, x in np.argwhere(differs):  # half a pixel beside a line, which is rounded to either side
        assert np.abs(pixels - [x, y]).max(axis=1).min() <= 1


def test_differences_of_an_outline():
    mask = np.zeros((9, 12), bool)
    mask[1:8, 1:7] = True
    mask[3:5, 3:5] = False
    mask[4, 9] = True
    block, piece = [(1, 1), (6, 1), (6, 7), (1, 7)], (9, 4)
    hole = [(3, 2), (2, 3), (2, 4), (3, 5), (4, 5), (5, 4), (5, 3), (4, 2), (3, 2)]

    def wrong(*ring):
        return tuple(int(found.sum()) for found in _differences(np.array(ring), mask))

    hanging = [(1, 1), (3, 1), *hole, (3, 1), *block[1:]]
    assert wrong(*hanging) == (0, 0)
    assert wrong(*block) == (4, 0)
    assert wrong(*hanging[:-2], (6, 4), piece, (6, 4), *hanging[-2:]) == (0, 0)
    assert wrong(*hanging[:-2], (6, 1), (11, 0), (11, 8), *hanging[-2:])[0] > 0  # a triangle is no bridge
    assert wrong(*[(x, y - (y == 7)) for x, y in hanging])[1] == 6  # the last row of a piece with a border
    assert wrong(piece)[1] == 38  # the largest piece is missing


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("", 1 << 23),
        ("hello", 0x248BFA47),
        ("hello, world", 0x149BBB7F),
        ("The quick brown fox jumps over the lazy dog", 0x2E4FF723),
    ],
)
def test_ids_of_names_are_published_hashes(name, value):
    assert standard_id(name) == value


@given(st.text(max_size=40))
def test_ids_of_names_are_normal_numbers(name):
    assert (standard_id(name) >> 23) & 0xFF not in (0, 255)


def test_states_of_keypoints():
    instance = np.array([[7, 0], [0, 8]], np.uint32)
    x = np.array([0.0, 1.9, 1.0, -0.1, 2.0, np.nan])
    y = np.array([0.9, 0.0, 1.0, 0.0, 0.0, np.nan])
    ids = np.array([7, 7, 8, 7, 7, 7], np.uint32)
    assert keypoint_states(x, y, ids, instance).tolist() == [2, 1, 2, 0, 0, 0]


def camera_values():
    turn = np.array([[0.0, 1.0, 0.0, 2.0], [0.0, 0.0, -1.0, 3.0], [-1.0, 0.0, 0.0, 9.0], [0.0, 0.0, 0.0, 1.0]])
    k = [[30.0, 0.0, 8.0], [0.0, 30.0, 6.0], [0.0, 0.0, 1.0]]
    position = -turn[:3, :3].T @ turn[:3, 3]
    return {"size_px": [16, 12], "K": k, "camera_from_world": turn.tolist(), "position_m": position.tolist()}


def test_rays_lead_to_where_points_are_projected():
    camera = camera_of(camera_values(), "camera.json")
    assert isinstance(camera, CameraFile)
    points = camera.position_m + camera.pixel_rays((16, 12)) * 7.5
    pixel, depth = camera.geometry.project((points - camera.position_m) @ camera.rotation.T)
    assert depth == pytest.approx(np.full((12, 16), 7.5))
    assert pixel[4, 9] == pytest.approx([9.5, 4.5])


@pytest.mark.parametrize(
    "change",
    [{"K": [[1, 0], [0, 1]]}, {"K": [[0.0] * 3] * 3}, {"position_m": [0, 0, float("nan")]}, {"size_px": 4}, {"K": "x"}],
)
def test_a_camera_that_is_none_is_refused(change):
    with pytest.raises(UnreadableError):
        camera_of({**camera_values(), **change}, "camera.json")


def test_of_a_recipe_the_labels_are_read(tmp_path):
    (tmp_path / "recipe.yaml").write_text(
        "forestgen: 1\nsite:\n  terrain: {kind: flat}\n  buildings:\n  - kind: house\n    size_m: [3, 4, 5]\n"
        "  - kind: house\nspecies:\n  oak:\n    plant: {a: 1}\n    list:\n    - {b: 2}\n  red beech:\n    x: 1\n"
        "cameras:\n- name: a\n  labels: 3\nlabels:\n  samples: 4\n  classes:\n    tree trunk: [trunk]\n"
        "wind: {speed_m_per_s: 4}\n"
    )
    recipe = read_recipe(tmp_path, "recipe.yaml")
    assert recipe["species"] == ["oak", "red beech", "house"]
    assert recipe["labels"] == {"samples": 4, "classes": {"tree trunk": ["trunk"]}}
    assert recipe["wind"] == {"speed_m_per_s": 4}
    assert recipe["dataset"] == {}


@pytest.mark.parametrize("text", ["", "species: 3", "labels: [", "species:\n", "species: {a: 1}\nlabels: 7\n"])
def test_what_is_no_recipe_is_refused(text, tmp_path):
    (tmp_path / "recipe.yaml").write_text(text)
    with pytest.raises(UnreadableError) as error:
        read_recipe(tmp_path, "recipe.yaml")
    assert error.value.finding.file == "recipe.yaml"


def camera_file(root: Path, frame: str, text: str) -> str:
    (root / frame).mkdir()
    (root / frame / "camera.json").write_text(text)
    return frame


def test_frames_follow_in_time_within_their_image(tmp_path):
    frames = [
        camera_file(tmp_path, f"{image:06d}-{name}", f'{{"sequence": {sequence}, "time_s": {time}}}')
        for image in (0, 1)
        for name, sequence, time in (
            ("a", '"walk"', 0.5),
            ("b", '"walk"', 0.0),
            ("c", "null", 0.0),
            ("d", '"fly"', 0.1),
        )
    ]
    assert following_frames(tmp_path, frames) == {"000000-b": "000000-a", "000001-b": "000001-a"}
    (tmp_path / "000001-a" / "camera.json").write_text("{")
    unsure = following_frames(tmp_path, frames)
    assert unsure["000000-b"] == "000000-a"
    assert {unsure[f"000001-{name}"] for name in "abcd"} == {UNKNOWN}


def test_a_frame_that_is_gone_has_no_wrong_successor(tmp_path):
    frames = [
        camera_file(tmp_path, f"000000-walk-{k:04d}", f'{{"sequence": "walk", "time_s": {k / 24}}}') for k in (0, 1, 3)
    ]
    expected = {frames[0]: frames[1], frames[1]: UNKNOWN}
    assert following_frames(tmp_path, frames) == expected  # gone, and in no manifest
    with_manifest = following_frames(tmp_path, [*frames, "000000-walk-0002"])
    assert with_manifest == {**expected, frames[2]: UNKNOWN, "000000-walk-0002": UNKNOWN}
