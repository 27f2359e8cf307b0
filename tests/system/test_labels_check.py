"""`forestgen labels check` passes a data set that was rendered, and finds each of many single breaks in it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from command_line import run, tree
from label_breaks import BIRCH, FRAME, NEXT, cell, content, exr, spots, text
from label_mutations import MUTATIONS

from forestgen.dataset.check import check_dataset

RECIPE = """\
forestgen: 1
seed: 3
site: {size_m: [8, 8], terrain: flat, ground: soil_wet}
species: {fireweed: , birch: }
community:
  model: placed
  plants:
    - {species: birch, position_m: [4, 3.5], height_m: 3}
    - {species: birch, position_m: [6.4, 4.5], height_m: 4}
    - {species: fireweed, position_m: [3, 2], height_m: 1.2}
    - {species: fireweed, position_m: [4.1, 4.2], height_m: 1}
    - {species: fireweed, position_m: [7.9, 0.1], height_m: 1.3}
plants: {exemplars_per_species: 1}
cameras:
  - name: walk
    position_m: [4, -1, 1.5]
    look_at_m: [4, 4, 1.2]
    size_px: [96, 54]
    path: {frames: 2, position_m: [[4.2, -0.8, 1.5]]}
render: {samples: 2, denoise: false}
labels: {samples: 16}
wind: {speed_m_per_s: 4}
dataset:
  formats: [coco, panoptic, yolo, bop, depth_png, cryptomatte, points, nerfstudio]
  licence: {name: CC BY 4.0, url: "https://creativecommons.org/licenses/by/4.0/"}
"""


@pytest.fixture(scope="session")
def data_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two frames of a path, in all formats."""
    folder = tmp_path_factory.mktemp("labels")
    (folder / "walk.yaml").write_text(RECIPE, encoding="utf-8")
    answer = run("render", folder / "walk.yaml", "-o", folder / "good")
    assert answer.code == 0, answer.err
    return folder / "good"


def test_a_rendered_data_set_passes(data_set):
    report = check_dataset(data_set, jobs=1)
    assert report.findings == ()
    assert report.frames == report.checked == 2
    assert all(check_result.good == check_result.images for check_result in report.check_results)
    idle = {check_result.name for check_result in report.check_results if not check_result.images}
    # Of fisheyes, of exposures and of branch modules: see test_module_labels.
    assert idle <= {"circle", "raw", "modules"}, "a check that looked at nothing"


def test_every_picture_has_8_bits_or_16_of_depth(data_set):
    pictures = sorted(data_set.rglob("*.png"))
    assert {"semantic.png", "instance.png", "panoptic.png", "depth.png"} <= {path.name for path in pictures}
    for path in pictures:
        is_depth = path.stem == "depth" or path.parent.name == "depth"
        assert path.read_bytes()[24] == (16 if is_depth else 8), path


CLASSES = {
    "two species": ('{tree trunk: [trunk], "green, \\"é\\": all 🌲": [birch, fireweed]}', ['green, "é": all 🌲']),
    "others": ("{herb: [fireweed], rest: [others]}", ["herb", "rest"]),
    "parts alone": (
        "{wood: [trunk, branch, dead_wood], soft: [leaf, flower, fruit], herb: [fireweed]}",
        ["herb", "birch"],
    ),
}


SLOW = ("others", "parts alone")


def of_classes(folder: Path, name: str) -> Path:
    """An image without coverage, whose recipe has classes."""
    rules, _ = CLASSES[name]
    recipe = folder / "classes.yaml"
    channels = "[surface, albedo, sun, cloud, boundaries, amodal]"
    labels = f"labels: {{samples: 16, channels: {channels}, classes: {rules}}}"
    changed = RECIPE.replace("labels: {samples: 16}", labels).replace("    path: {frames: 2, ", "    # ")
    recipe.write_text(changed.replace(", bop, depth_png, cryptomatte, points, nerfstudio]", ", cryptomatte]"))
    answer = run("render", recipe, "-o", folder / "out")
    assert answer.code == 0, answer.err
    return folder / "out"


@pytest.mark.parametrize("name", ["two species", *(pytest.param(one, marks=pytest.mark.slow) for one in SLOW)])
def test_classes_are_categories(name, tmp_path):
    root, expected = of_classes(tmp_path, name), CLASSES[name][1]
    report = check_dataset(root, jobs=1)
    assert report.findings == ()
    ran = {check_result.name for check_result in report.check_results if check_result.images}
    assert {"coco", "coco files", "panoptic", "yolo boxes", "cryptomatte", "names", "classes.json"} <= ran
    assert "coverage" not in ran
    legend = json.loads((root / "classes.json").read_text())
    assert list(legend["categories"].values()) == expected
    frame = "000000-walk"
    breaks = {
        "classes.json": content("classes.json", lambda c: c["categories"].update({"1": "tree"})),
        "coco files": content("coco.json", lambda c: c["categories"][0].update(name="tree")),
        "panoptic files": content("panoptic.json", lambda c: c["categories"][0].update(name="tree")),
        "yolo files": text("yolo/boxes/data.yaml", "names: {0: tree}\n"),
        "cryptomatte": exr("", "CryptoPlant00.G", 0.0, file="cryptomatte.exr", frame=frame),
    }
    for check, make in breaks.items():
        broken = tmp_path / check
        shutil.copytree(root, broken)
        make(broken)
        found = check_dataset(broken, jobs=1, hashes=False, most=50).findings
        assert check in {finding.check for finding in found}, check


@pytest.mark.parametrize("name", MUTATIONS)
def test_a_single_break_is_named(name, data_set, tmp_path):
    check, file, make, place = MUTATIONS[name]
    broken = tmp_path / "broken"
    shutil.copytree(data_set, broken)
    make(broken)
    report = check_dataset(broken, jobs=1, hashes="hashes" in check)
    assert len(report.findings) == 1, "nothing found"
    finding = report.findings[0]
    assert (finding.check, finding.file) == (check, file), finding
    place = dict(place)
    if "spot" in place:
        place["pixel"] = spots(data_set)[place.pop("spot")]
    assert {key: getattr(finding, key) for key in place} == place, finding
    assert finding.problem


def test_the_command_tells_what_it_found(data_set, tmp_path):
    before = tree(data_set)
    good = run("labels", "check", data_set)
    assert (good.code, good.err) == (0, "")
    assert "2 images in" in good.out
    assert "FAILED" not in good.out
    assert tree(data_set) == before

    broken = tmp_path / "broken"
    shutil.copytree(data_set, broken)
    cell("visible_pixels", 3)(broken)
    cell("stem_pixels", 999)(broken)
    first = run("labels", "check", broken)
    assert first.code == 6
    assert first.err.startswith(f"error: {broken / FRAME / 'plants.parquet'}, plant_id {BIRCH}: ")
    assert "(check 'plants')" in first.err
    assert "expected" in first.err
    assert "got       3" in first.err
    assert "Traceback" not in first.err

    every = run("labels", "check", broken, "--all")
    assert every.code == 6
    for word in ("plants: ", "stems: ", "hashes: "):
        assert word in every.out
    assert "3 findings" in every.err


@pytest.mark.slow
def test_the_number_of_processes_changes_nothing(data_set, tmp_path):
    broken = tmp_path / "broken"
    shutil.copytree(data_set, broken)
    for frame in (FRAME, NEXT):
        text(f"{frame}/semantic.png", "none")(broken)
    one, two = (check_dataset(broken, jobs=jobs, most=50) for jobs in (1, 2))
    assert one.findings == two.findings
    assert [finding.image for finding in one.findings] == [FRAME, FRAME, NEXT, NEXT]


def test_what_is_no_data_set_is_refused(tmp_path, data_set):
    (tmp_path / "empty").mkdir()
    (tmp_path / "strange").mkdir()
    (tmp_path / "strange" / "holiday.jpg").write_bytes(b"sun")
    (tmp_path / "simulated").mkdir()
    manifest = json.loads((data_set / "manifest.json").read_text())
    (tmp_path / "simulated" / "manifest.json").write_text(json.dumps({**manifest, "files": {}}))
    run("labels", "check", tmp_path / "none").refused(2, "there is no such folder")
    run("labels", "check", data_set / "coco.json").refused(2, "this is a file")
    run("labels", "check", tmp_path / "empty").refused(2, "no images of forestgen", "nothing")
    run("labels", "check", tmp_path / "strange").refused(2, "1 other file")
    run("labels", "check", tmp_path / "simulated").refused(2, "no images of forestgen")
    run("labels", "check", data_set / FRAME).refused(2, "give the folder above it")
    run("labels", "check", data_set.parent).refused(2, "folder of outputs", "good")


def test_a_half_written_data_set_is_told(data_set, tmp_path):
    broken = tmp_path / "broken"
    shutil.copytree(data_set, broken)
    for path in (broken / NEXT).iterdir():
        if path.is_file():
            path.unlink()
    (broken / "manifest.json").unlink()
    answer = run("labels", "check", broken)
    assert answer.code == 6
    assert "the file is missing" in answer.err
    assert "Traceback" not in answer.err
