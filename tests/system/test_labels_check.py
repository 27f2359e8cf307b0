"""The checks of labels pass a data set that was rendered, and find each of many single breaks in it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from command_line import run, tree
from label_breaks import BIRCH, FRAME, NEXT, cell, content, exr, spots, text
from label_mutations import MUTATIONS

from forestgen.core.errors import RecipeError
from forestgen.dataset.check.run import _dataset_checks, _frame_checks, check_dataset
from support.error_messages import raises_error
from support.tiers import slow_but

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
    """The split of two frames of a path, in all formats."""
    folder = tmp_path_factory.mktemp("labels")
    (folder / "walk.yaml").write_text(RECIPE, encoding="utf-8")
    answer = run("render", folder / "walk.yaml", "-o", folder / "good")
    assert answer.code == 0, answer.err
    return folder / "good" / "train"


def test_a_rendered_data_set_passes(data_set):
    report = check_dataset(data_set, jobs=1)
    assert report.findings == ()
    assert report.frames == 2
    idle = {one.name for one in (*_frame_checks(), *_dataset_checks())} - set(report.looked_at)
    # Of fisheyes, of exposures and of branch modules: see test_module_labels.
    assert idle <= {"circle", "raw", "photo", "modules"}, "a check that looked at nothing"


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
    return folder / "out" / "train"


@pytest.mark.parametrize("name", ["two species", *(pytest.param(one, marks=pytest.mark.slow) for one in SLOW)])
def test_classes_are_categories(name, tmp_path):
    root, expected = of_classes(tmp_path, name), CLASSES[name][1]
    report = check_dataset(root, jobs=1)
    assert report.findings == ()
    ran = set(report.looked_at)
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
        found = check_dataset(broken, jobs=1).findings
        assert check in {finding.check for finding in found}, check


FIRST_OF_ITS_CHECK = {check: name for name, (check, *_) in reversed(MUTATIONS.items())}


@pytest.mark.parametrize("name", slow_but(MUTATIONS, *FIRST_OF_ITS_CHECK.values()))
def test_a_single_break_is_named(name, data_set, tmp_path):
    check, file, make, place = MUTATIONS[name]
    broken = tmp_path / "broken"
    shutil.copytree(data_set, broken)
    make(broken)
    report = check_dataset(broken, jobs=1)
    assert report.findings, "nothing found"
    finding = report.findings[0]
    assert (finding.check, finding.file) == (check, file), finding
    place = dict(place)
    if "spot" in place:
        place["pixel"] = spots(data_set)[place.pop("spot")]
    assert {key: getattr(finding, key) for key in place} == place, finding
    assert finding.problem


def test_the_command_tells_what_it_found(data_set, tmp_path):
    whole = data_set.parent
    before = tree(whole)
    good = run("verify", whole)
    assert (good.code, good.err) == (0, "")
    assert "1 image, 2 frames" in good.out
    assert "FAILED" not in good.out
    assert tree(whole) == before

    broken = tmp_path / "broken"
    shutil.copytree(whole, broken)
    cell("visible_pixels", 3)(broken / "train")
    cell("stem_pixels", 999)(broken / "train")
    answer = run("verify", broken)
    assert answer.code == 6
    plants = f"{FRAME}/plants.parquet"
    assert f"sums: train/{plants}: " in answer.out
    for check, problem in (("plants", "visible_pixels"), ("stems", "stem_pixels")):
        (line,) = (line for line in answer.out.splitlines() if f"(check {check!r})" in line)
        assert line.startswith(f"labels train: train/{plants}, ")
        assert f"plant_id {BIRCH}: {problem}" in line
        assert "(expected" in line
    assert "got 3)" in answer.out
    assert answer.err.startswith(f"error: {broken / 'train' / plants}: ")
    assert "Traceback" not in answer.err


def test_a_text_in_place_of_a_picture_is_told_in_the_same_words(data_set, tmp_path):
    """Not by the number of an open file, which is another in every process."""
    broken = shutil.copytree(data_set, tmp_path / "broken")
    text(f"{FRAME}/semantic.png", "none")(broken)
    (finding, *_) = check_dataset(broken, jobs=1).findings
    assert (finding.file, finding.got) == (f"{FRAME}/semantic.png", "this is no PNG")


@pytest.mark.slow
def test_the_number_of_processes_changes_nothing(data_set, tmp_path):
    broken = tmp_path / "broken"
    shutil.copytree(data_set, broken)
    for frame in (FRAME, NEXT):
        text(f"{frame}/semantic.png", "none")(broken)
    one, two = (check_dataset(broken, jobs=jobs) for jobs in (1, 2))
    assert one.findings == two.findings
    assert [finding.image for finding in one.findings] == [FRAME, FRAME, NEXT, NEXT]


def test_what_is_no_data_set_is_refused(tmp_path, data_set):
    (tmp_path / "empty").mkdir()
    (tmp_path / "strange").mkdir()
    (tmp_path / "strange" / "holiday.jpg").write_bytes(b"sun")
    (tmp_path / "simulated").mkdir()
    manifest = json.loads((data_set / "manifest.json").read_text())
    (tmp_path / "simulated" / "manifest.json").write_text(json.dumps({**manifest, "files": {}}))
    for folder in (
        tmp_path / "none",
        data_set / "coco.json",
        tmp_path / "empty",
        tmp_path / "strange",
        tmp_path / "simulated",
        data_set / FRAME,
        data_set.parent,
    ):
        with raises_error(RecipeError):
            check_dataset(folder, jobs=1)


def test_a_half_written_data_set_is_told(data_set, tmp_path):
    broken = tmp_path / "broken"
    shutil.copytree(data_set.parent, broken)
    for path in (broken / "train" / NEXT).iterdir():
        if path.is_file():
            path.unlink()
    (broken / "train" / "manifest.json").unlink()
    (first, *_) = check_dataset(broken / "train", jobs=1).findings
    assert first.image == NEXT
    assert first.problem == "the file is missing"
    answer = run("verify", broken)
    assert answer.code == 6
    assert "the file is missing" in answer.err
    assert f"train/{NEXT}/frame.exr" in answer.out
    assert "train/manifest.json" in answer.out
    assert "Traceback" not in answer.err
