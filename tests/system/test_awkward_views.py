"""Views that are easily got wrong: the labels of all formats are written and true to each other."""

from __future__ import annotations

import pytest
from command_line import run

from forestgen.dataset.check.run import check_dataset

STAND = """\
forestgen: 1
seed: 3
site: {size_m: [20, 20], terrain: rolling}
species: {fireweed: , poplar: }
community:
  model: placed
  plants:
    - {species: poplar, position_m: [10, 10], height_m: 14}
    - {species: poplar, position_m: [10.3, 10.1], height_m: 12}
    - {species: fireweed, position_m: [10, 9]}
plants: {exemplars_per_species: 2}
render: {samples: 1, denoise: false}
labels: {samples: 4}
wind: {speed_m_per_s: 10}
dataset: {formats: [coco, panoptic, yolo, bop, depth_png, cryptomatte, points, nerfstudio]}
"""
VIEWS = """\
cameras:
  - {name: crown, position_m: [10, 10, 8], look_at_m: [10, 20, 8], size_px: [48, 32]}
  - {name: zenith, position_m: [10, 10, 0.5], look_at_m: [10, 10, 10], size_px: [32, 48], obstructed: note}
  - {name: sky, position_m: [10, -6, 60], look_at_m: [10, -6, 200], size_px: [24, 16]}
  - {name: below, position_m: [10, -6, -3], look_at_m: [10, 10, -3], size_px: [24, 16], obstructed: note}
  - {name: behind, position_m: [10, 25, 2], look_at_m: [10, 60, 2], size_px: [24, 16]}
  - {name: smallest, position_m: [10, -6, 1.7], look_at_m: [10, 10, 5], size_px: [8, 8]}
"""
# Through the plants, about, and away from them in leaps: leaves that were near are finer than pixels in the next frame.
LEAPS = """\
cameras:
  - name: walk
    position_m: [10, -6, 1.7]
    look_at_m: [10, 10, 5]
    size_px: [96, 64]
    path: {frames: 5, frames_per_s: 1, position_m: [[10, 9, 2], [10, 30, 2]], look_at_m: [[30, -6, 5], [10, -30, 5]]}
"""


@pytest.mark.slow
@pytest.mark.parametrize(("cameras", "frames"), [(VIEWS, 6), (LEAPS, 5)], ids=["views", "leaps"])
def test_what_is_written_passes_the_checks(cameras, frames, tmp_path):
    (tmp_path / "recipe.yaml").write_text(STAND + cameras, encoding="utf-8")
    answer = run("render", tmp_path / "recipe.yaml", "-o", tmp_path / "out")
    assert answer.code == 0, answer.err
    report = check_dataset(tmp_path / "out" / "train", jobs=1)
    assert report.findings == ()
    assert report.frames == frames
