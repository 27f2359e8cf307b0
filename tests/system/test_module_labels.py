"""Labels of branch modules: a data set with them passes the checks of labels, and each single break is found."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from command_line import run
from label_breaks import exr

from forestgen.architecture.prototypes import MOST_NODES
from forestgen.dataset.check import masks
from forestgen.dataset.check.files import read_exr
from forestgen.dataset.check.run import check_dataset

FRAME = "000000-camera0"
RECIPE = """\
forestgen: 1
seed: 3
site:
  size_m: [12, 12]
  terrain: flat
  ground: soil_wet
  buildings: [{kind: house, position_m: [7, 8], azimuth_deg: 20, size_m: [4, 3, 2.5]}]
species: {pine: }
community:
  model: branch_modules
  steps: 7
  initial_plants: {pine: 12}
plants: {unique: 6, exemplars_per_species: 1, levels: true}
cameras: [{position_m: [6, -2, 1.2], look_at_m: [6, 6, 0.8], size_px: [96, 54]}]
render: {samples: 1, denoise: false}
labels: {samples: 4, channels: [surface, coverage, module]}
dataset: {formats: [coco, points, cryptomatte, panoptic]}
"""


@pytest.fixture(scope="module")
def data_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("modules")
    (folder / "pines.yaml").write_text(RECIPE, encoding="utf-8")
    answer = run("render", folder / "pines.yaml", "-o", folder / "good")
    assert answer.code == 0, answer.err
    return folder / "good" / "train"


@pytest.fixture(scope="module")
def kinds(data_set: Path) -> dict[str, np.ndarray]:
    """Masks of the image by what the centre of a pixel shows."""
    parts, _ = read_exr(data_set, f"{FRAME}/frame.exr")
    plant, module = parts["identity"]["centre.plant_id"], parts["module"]
    of_modules = module["number"] > 0
    return {
        "ground": (plant == 0) & (parts["identity"]["centre.part"] == 1),
        "house": plant == 1,
        "own": of_modules & (module["own"] == 1),
        "stand-in": of_modules & (module["own"] == 0),
    }


def test_modules_pass(data_set: Path, kinds: dict[str, np.ndarray]) -> None:
    assert all(mask.sum() > 3 for mask in kinds.values())
    report = check_dataset(data_set, jobs=1)
    assert report.findings == ()
    assert "modules" in set(report.looked_at)
    assert masks._MOST_NODES == MOST_NODES


BREAKS = {
    "a node that no prototype has": ("node", MOST_NODES, "own", "module.node is out of range"),
    "a number beyond all": ("number", 2**32 - 1, "own", "module.number is out of range"),
    "own is neither": ("own", 2, "own", "module.own is out of range"),
    "a node without a module": ("node", 3, "ground", "module.node is set where there is no module"),
    "the ground has a module": ("number", 1, "ground", "a module of no plant"),
    "a house has a module": ("number", 1, "house", "a module of no plant"),
    "a hole in a plant": ("number", 0, "stand-in", "a plant of modules has none here"),
    "own in most pixels": ("own", 0, "own", "a plant's branches are its own in other pixels only"),
}


@pytest.mark.parametrize("name", BREAKS)
def test_a_single_break_is_named(name: str, data_set: Path, kinds: dict[str, np.ndarray], tmp_path: Path) -> None:
    channel, value, kind, problem = BREAKS[name]
    plant = read_exr(data_set, f"{FRAME}/frame.exr")[0]["identity"]["centre.plant_id"]
    ids, counts = np.unique(plant[kinds[kind]], return_counts=True)
    y, x = np.argwhere(kinds[kind] & (plant == ids[np.argmax(counts)]))[0]

    def changed(pixels: np.ndarray) -> np.ndarray:
        pixels = pixels.copy()
        pixels[y, x] = value
        return pixels

    broken = tmp_path / "broken"
    shutil.copytree(data_set, broken)
    exr("module", channel, changed, frame=FRAME)(broken)
    report = check_dataset(broken, jobs=1)
    found = [finding for finding in report.findings if finding.check == "modules"]
    assert any(finding.problem.startswith(problem) and finding.pixel == (x, y) for finding in found), found
    assert {finding.check for finding in report.findings} == {"modules"}
