"""Data sets of cameras of every kind: the checks of labels pass them, and find what is wrong with them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from command_line import run
from label_breaks import exr

from forestgen.dataset.check.run import check_dataset
from forestgen.dataset.exr import read_exr
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import check_plan
from support.error_messages import raises_error

RECIPE = """\
forestgen: 1
seed: 3
site: {size_m: [8, 8], terrain: flat, ground: soil_wet}
species: {fireweed: , birch: }
community:
  model: placed
  plants:
    - {species: birch, position_m: [4, 3.5], height_m: 3}
    - {species: birch, position_m: [6.4, 5.5], height_m: 4}
    - {species: fireweed, position_m: [3, 2], height_m: 1.2}
    - {species: fireweed, position_m: [5.1, 4.2], height_m: 1}
    - {species: fireweed, position_m: [4.4, 5.4], height_m: 1.3}
plants: {exemplars_per_species: 1}
cameras:
  - {name: up, kind: fisheye, position_m: [4.7, 4.4, 0.4], size_px: [40, 40], PATH}
  - {name: ahead, kind: fisheye, position_m: [4, 1, 1.5], look_at_m: [4, 4, 1.2], size_px: [48, 40], PATH}
  - {name: around, kind: panorama, position_m: [4.7, 4.4, 1.5], size_px: [64, 32], PATH}
  - {name: nadir, kind: orthographic, position_m: [4, 4, 50], width_m: 8, size_px: [40, 40], PATH}
  - {name: lens, position_m: [4, -1, 1.5], look_at_m: [4, 4, 1.2], size_px: [48, 32], f_number: 2.8, focus_m: 4, PATH}
render: {samples: 2, denoise: false}
labels: {samples: 16}
wind: {speed_m_per_s: 4}
dataset: {formats: [coco, panoptic, yolo, depth_png, cryptomatte, pointsNERF]}
"""
PATH = "path: {frames: 2, position_m: [[4.3, 3.9, HEIGHT]]}"


def recipe_of(text: str) -> str:
    lines = []
    for line in text.replace("NERF", "").splitlines():
        height = {"up": "0.45", "ahead": "1.6", "around": "1.55", "nadir": "51", "lens": "1.5"}
        name = line.partition("name: ")[2].partition(",")[0]
        lines.append(line.replace("PATH", PATH.replace("HEIGHT", height.get(name, "2"))))
    return "\n".join(lines) + "\n"


@pytest.fixture(scope="module")
def data_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("kinds")
    (folder / "kinds.yaml").write_text(recipe_of(RECIPE), encoding="utf-8")
    answer = run("render", folder / "kinds.yaml", "-o", folder / "good")
    assert answer.code == 0, answer.err
    return folder / "good" / "train"


FRAMES = [f"000000-{name}-{frame:04d}" for name in ("up", "ahead", "around", "nadir", "lens") for frame in (0, 1)]


@pytest.mark.slow
def test_a_data_set_of_all_kinds_passes(data_set):
    report = check_dataset(data_set, jobs=1)
    assert report.findings == ()
    assert report.frames == 10
    ran = report.looked_at
    for check in ("camera", "circle", "position", "normals", "motion", "stem places", "amodal", "points.ply"):
        assert ran[check] == 10


@pytest.mark.slow
def test_cameras_tell_their_model(data_set):
    models = [camera_file(data_set / frame)["model"] for frame in FRAMES[::2]]
    assert models == ["fisheye", "fisheye", "equirectangular", "orthographic", "pinhole"]
    fisheye, lens = (camera_file(data_set / f"000000-{name}-0000") for name in ("up", "lens"))
    assert fisheye["K"][0][0] == pytest.approx(40 / np.pi)
    assert fisheye["distortion"] == [0.0] * 4
    assert lens["lens"]["focus_m"] == 4


@pytest.mark.slow
def test_a_fisheye_that_looks_up_tells_of_its_canopy(data_set):
    canopy = json.loads((data_set / "000000-up-0000" / "canopy.json").read_text())
    assert 0 < canopy["openness"] < 1
    assert canopy["effective_lai"] > 0
    assert not (data_set / "000000-ahead-0000" / "canopy.json").exists()


@pytest.mark.slow
def test_plants_are_seen_by_all(data_set):
    for frame in FRAMES:
        table = pq.read_table(data_set / frame / "plants.parquet")
        assert sum(pixels > 0 for pixels in table["visible_pixels"].to_pylist()) >= 1, frame
        parts = read_exr(data_set / frame / "frame.exr")
        assert parts["boundary"]["occluding"].any()
        if frame.endswith("0000"):
            assert np.isfinite(parts["motion"]["forward.u"]).mean() > 0.3


def camera_file(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "camera.json").read_text()))


def changed_camera(folder: Path, **about) -> None:
    (folder / "camera.json").write_text(json.dumps({**camera_file(folder), **about}))


def moved(folder: Path, part: str, channel: str, by: float) -> None:
    exr(part, channel, lambda values: values + np.float32(by), frame=folder.name)(folder.parent)


BREAKS = {
    "another field of view": ("000000-up-0000", "camera", lambda folder: changed_camera(folder, hfov_deg=170.0)),
    "another width": ("000000-nadir-0000", "camera", lambda folder: changed_camera(folder, width_m=9.0)),
    "another model": ("000000-around-0000", "files", lambda folder: changed_camera(folder, model="fisheye")),
    "depth of a fisheye": ("000000-ahead-0000", "depth", lambda folder: moved(folder, "depth", "Z", -0.01)),
    "position in a panorama": ("000000-around-0000", "position", lambda folder: moved(folder, "position", "X", 0.1)),
    "position from above": ("000000-nadir-0000", "position", lambda folder: moved(folder, "position.camera", "Y", 0.2)),
    "motion around": ("000000-around-0000", "motion", lambda folder: moved(folder, "motion", "forward.u", 1.0)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", BREAKS)
def test_what_is_wrong_is_found(name, data_set, tmp_path):
    frame, check, spoil = BREAKS[name]
    shutil.copytree(data_set, tmp_path / "bad")
    spoil(tmp_path / "bad" / frame)
    report = check_dataset(tmp_path / "bad", jobs=1)
    assert report.findings
    assert report.findings[0].check == check
    assert report.findings[0].image == frame


@pytest.mark.parametrize("name", ["bop", "nerfstudio"])
def test_formats_without_words_for_a_camera_are_refused_before_rendering(name, tmp_path):
    from forestgen.core.errors import RecipeError

    path = tmp_path / "recipe.yaml"
    path.write_text(recipe_of(RECIPE).replace("points]", f"points, {name}]"), encoding="utf-8")
    with raises_error(RecipeError):
        check_plan(load_recipe(path))
