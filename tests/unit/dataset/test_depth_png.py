from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from dataset_shots import SETTINGS, make_shot
from format_shots import all_bytes, drawn, written
from PIL import Image

from forestgen.core.errors import OutputError
from forestgen.dataset.formats import depth_png
from support.error_messages import raises_error


def read_back(folder):
    """Depth in metres: NaN for the sky, infinite for what lies beyond, by depth.json alone."""
    scale = json.loads((folder / "depth.json").read_text())
    with Image.open(folder / "depth.png") as image:
        assert image.mode == "I;16"
        steps = np.asarray(image).astype(np.int64)
    depth = steps * scale["unit_m"]
    depth[steps == scale["no_depth"]] = np.nan
    depth[steps == scale["beyond"]] = np.inf
    return depth, scale


def with_depth(depth_m):
    labelled = drawn(np.zeros(np.shape(depth_m), np.uint32))
    surface = replace(labelled.frame.surface, depth_m=np.asarray(depth_m, np.float32))
    return replace(labelled, frame=replace(labelled.frame, surface=surface))


@pytest.mark.parametrize("unit_m", [0.01, 0.001, 0.25, 1.0])
def test_read_back_within_half_a_step(tmp_path, unit_m):
    rng = np.random.default_rng(1)
    depth = np.exp(rng.uniform(np.log(unit_m), np.log(65_534 * unit_m), (40, 60))).astype(np.float32)
    depth[:5] = np.inf
    written(depth_png, tmp_path, {"a": with_depth(depth)}, replace(SETTINGS, depth_unit_m=unit_m))
    found, _ = read_back(tmp_path / "a")
    assert np.isnan(found[:5]).all()
    assert np.abs(found[5:] - depth[5:]).max() <= unit_m * (0.5 + 1e-9)


def test_marks_at_both_ends(tmp_path):
    depth = [[np.inf, 1e-6, 0.004, 0.014, 655.34, 655.344, 655.36, 1e9]]
    written(depth_png, tmp_path, {"a": with_depth(depth)})
    found, scale = read_back(tmp_path / "a")
    np.testing.assert_allclose(found[0], [np.nan, 0.01, 0.01, 0.01, 655.34, 655.34, np.inf, np.inf])
    assert scale["farthest_m"] == pytest.approx(655.34)


def test_frames_of_two_workers_and_merges(tmp_path):
    frames = {name: make_shot(range(1, 5), seed=i).labelled for i, name in enumerate(("b", "a"))}
    first = all_bytes(written(depth_png, tmp_path / "x", frames))
    assert first == all_bytes(written(depth_png, tmp_path / "y", dict(reversed(frames.items()))))
    depth_png.FORMAT.merge(tmp_path / "x", ["a", "b"], SETTINGS)
    assert all_bytes(tmp_path / "x") == first
    (tmp_path / "x" / "b" / "depth.json").write_text("{")
    with raises_error(OutputError, place="depth.json"):
        depth_png.FORMAT.merge(tmp_path / "x", ["a", "b"], SETTINGS)
