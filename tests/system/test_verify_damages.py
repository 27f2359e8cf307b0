"""`forestgen verify` names every one of many kinds of damage: alone, and all of them at once."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from batch_pieces import copied
from command_line import run
from dataset_breaks import (
    Harm,
    column,
    content,
    cut,
    edit,
    flip,
    index,
    record,
    repaint,
    sum_again,
    sums_line,
    swap,
    table,
    written,
)

from forestgen.dataset.check.run import MOST_NAMED
from forestgen.runs.verify import VerificationReport, verify


class Damage(NamedTuple):
    """A break, and what names it."""

    harm: Harm
    mark: str  # of a finding's place, problem or values
    deep: str | None = ""  # the check that names it where all sums agree with it; None: nothing shows it then
    deep_mark: str = ""  # where it is another


def coco(number: int, **values: Any) -> Harm:
    """Change an annotation of train's coco.json, counted from the end."""
    return lambda root: content(root / "train/coco.json", lambda c: c["annotations"][-number].update(values))


def code(c: dict[str, Any]) -> None:
    """Another mask of the right form."""
    a, b = c["annotations"][-3], c["annotations"][-4]
    a["segmentation"], b["segmentation"] = b["segmentation"], a["segmentation"]


def other_hash(line: str) -> str:
    return ("0" if line[0] != "0" else "1") + line[1:]


def without_first(columns: dict[str, list[Any]]) -> None:
    for values in columns.values():
        del values[0]


def taller(columns: dict[str, list[Any]]) -> None:
    seen = next(row for row, pixels in enumerate(columns["visible_pixels"]) if pixels)
    columns["height_m"][seen] += 0.5


def to_other_split(rows: list[dict[str, Any]]) -> None:
    for row in rows:
        if row["image"] == 3:
            row.update(split="train", folder=f"train/{row['frame']}")


def without_row(rows: list[dict[str, Any]]) -> None:
    rows[:] = [row for row in rows if row["frame"] != "000001-high"]


def stray(root: Path) -> None:
    shutil.copytree(root / "train/000002-near", root / "train/000008-near")


def without_entry(manifest: dict[str, Any]) -> None:
    del manifest["files"]["000001-near/frame.exr"]


def wrong_entry(manifest: dict[str, Any]) -> None:
    manifest["files"]["000001-high/frame.exr"]["sha256"] = "0" * 64


DAMAGES: dict[str, Damage] = {
    # Light may have any value: only rendering again would tell.
    "a bit of an EXR": Damage(lambda r: flip(r / "val/000003-near/frame.exr"), "val/000003-near/frame.exr", None),
    "an EXR cut short": Damage(lambda r: cut(r / "val/000003-high/frame.exr"), "val/000003-high/frame.exr", "labels"),
    "a file missing": Damage(
        lambda r: (r / "val/000001-near/preview.png").unlink(), "val/000001-near/preview.png", "labels"
    ),
    "an empty file": Damage(
        lambda r: written(r / "val/000001-near/overlay.png", b""), "val/000001-near/overlay.png", "labels"
    ),
    "masks swapped": Damage(
        lambda r: swap(r / "train/000000-near/instance.png", r / "train/000002-near/instance.png"),
        *("train/000000-near/instance.png", "labels"),
    ),
    "a wrong class": Damage(
        lambda r: repaint(r / "train/000002-high/semantic.png", (3, 3), lambda old: (old + 1) % 3),
        *("train/000002-high/semantic.png", "labels"),
    ),
    "a box of COCO": Damage(coco(1, bbox=[0, 0, 1, 1]), "train/coco.json", "labels", "bbox"),
    "an area of COCO": Damage(coco(2, area=12345), "train/coco.json", "labels", "12345"),
    "a mask of COCO": Damage(
        lambda r: content(r / "train/coco.json", code), "train/coco.json", "labels", "segmentation"
    ),
    "an annotation removed": Damage(
        lambda r: content(r / "train/coco.json", lambda c: c["annotations"].pop(0)),
        *("train/coco.json", "labels", "has no annotation"),
    ),
    "an annotation's id twice": Damage(
        lambda r: content(r / "train/coco.json", lambda c: c["annotations"][2].update(id=c["annotations"][1]["id"])),
        *("train/coco.json", "labels", "an id comes twice in annotations"),
    ),
    "a height of a plant": Damage(
        lambda r: table(r / "train/000000-near/plants.parquet", taller),
        *("train/000000-near/plants.parquet", "labels", "height_m"),
    ),
    "a plant removed": Damage(
        lambda r: table(r / "train/000000-high/plants.parquet", without_first),
        *("train/000000-high/plants.parquet", "frames", "plants of train/000000-high"),
    ),
    "a row of the index": Damage(
        lambda r: index(r, lambda rows: rows[0].update(plants_in_view=99)), "plants_in_view", "frames"
    ),
    "a row of the index removed": Damage(lambda r: index(r, without_row), "000001-high", "index"),
    "a camera turned": Damage(
        lambda r: content(r / "train/000002-near/camera.json", lambda c: c["position_m"].__setitem__(0, 9.0)),
        *("train/000002-near/camera.json", "labels"),
    ),
    "another checksum": Damage(
        lambda r: sums_line(r, "train/000002-near/overlay.png", other_hash), "train/000002-near/overlay.png", None
    ),
    "a checksum missing": Damage(
        lambda r: sums_line(r, "train/000002-high/overlay.png", lambda _: ""), "train/000002-high/overlay.png", None
    ),
    "a checksum's line cut": Damage(
        lambda r: sums_line(r, "train/000002-high/preview.png", lambda line: line[:40] + "\n"),
        *("train/000002-high/preview.png", None),
    ),
    "a thumbnail missing": Damage(
        lambda r: (r / "thumbnails/000002-near.jpg").unlink(), "thumbnails/000002-near.jpg", "index"
    ),
    "a stray file": Damage(lambda r: (r / "train/yolo/notes.txt").write_text("x"), "train/yolo/notes.txt", "listing"),
    "a stray file on top": Damage(lambda r: (r / "notes.txt").write_text("x"), "notes.txt", "listing"),
    "a stray folder": Damage(
        lambda r: (r / "train/yolo/boxes/spare/deeper").mkdir(parents=True), "train/yolo/boxes/spare", "listing"
    ),
    "a stray folder on top": Damage(lambda r: (r / "spare").mkdir(), "spare", "listing"),
    "a stray frame": Damage(stray, "train/000008-near/plants.parquet", "listing"),
    "a stray frame without files": Damage(
        lambda r: (r / "val/000009-near").mkdir(), "val/000009-near", "listing", "val/000009-near"
    ),
    "counts of dataset.json": Damage(
        lambda r: content(r / "dataset.json", lambda c: c.update(frames=7)), "dataset.json", "index"
    ),
    "missing images of dataset.json": Damage(
        lambda r: content(r / "dataset.json", lambda c: c["recipes"][0].update(missing=[[2, 2]])),
        *("dataset.json", "index", "counts its images wrongly"),
    ),
    "a wrong split": Damage(lambda r: index(r, to_other_split), "000003-near", "index", "in another split"),
    "a community twice": Damage(
        lambda r: shutil.copyfile(r / "train/000002-near/plants.parquet", r / "val/000001-near/plants.parquet"),
        *("val/000001-near/plants.parquet", "communities", "val/000001-near"),
    ),
    "a frame's recipe": Damage(
        lambda r: edit(r / "train/000002-high/recipe.yaml", "samples: 1", "samples: 2"),
        *("train/000002-high/recipe.yaml", "frames", "recipe_hash of train/000002-high"),
    ),
    "the recipe": Damage(lambda r: edit(r / "recipe.yaml", "seed: 5", "seed: 6"), "recipe.yaml", "recipes"),
    "classes": Damage(
        lambda r: content(r / "val/classes.json", lambda c: c["semantic"].update({"1": "lawn"})),
        *("val/classes.json", "labels"),
    ),
    "a label of YOLO": Damage(
        lambda r: edit(r / "val/yolo/boxes/labels/000001-near.txt", " 0.", " 0.9"),
        *("val/yolo/boxes/labels/000001-near.txt", "labels"),
    ),
    "a label of YOLO missing": Damage(
        lambda r: (r / "val/yolo/segmentation/labels/000001-high.txt").unlink(),
        *("val/yolo/segmentation/labels/000001-high.txt", "labels"),
    ),
    "depth.png": Damage(
        lambda r: repaint(r / "val/000001-high/depth.png", (2, 2), lambda old: old + 5),
        *("val/000001-high/depth.png", "labels"),
    ),
    "panoptic.png": Damage(
        lambda r: repaint(r / "val/000001-high/panoptic.png", (2, 2), lambda old: (7, 7, 7)),
        *("val/000001-high/panoptic.png", "labels"),
    ),
    "a file that the manifest lacks": Damage(
        lambda r: content(r / "val/manifest.json", without_entry), "val/000001-near/frame.exr", "manifests"
    ),
    "a sum of the manifest": Damage(
        lambda r: content(r / "val/manifest.json", wrong_entry), "val/000001-high/frame.exr", None
    ),
    "seeds of the manifest": Damage(
        lambda r: content(r / "val/manifest.json", lambda c: c["image_seeds"].reverse()),
        *("val/manifest.json", "manifests", "image_seeds"),
    ),
    "a record": Damage(lambda r: record(r, 2, files={}), ".forestgen/jobs/000002-", None),
    "a record missing": Damage(lambda r: next((r / ".forestgen/jobs").glob("000001-*")).unlink(), "000001-near", None),
    "a column of draws": Damage(lambda r: column(r, "draw.zz", 1.0), "draw.zz", "index"),
    "a column": Damage(lambda r: column(r, "z\x1b[1m", {"a": 1}), r"z\x1b[1m", "index"),
}


def texts(report: VerificationReport, check: str = "") -> list[str]:
    return [
        f"{one.check}: {one.where}: {one.problem} {one.expected} {one.got}"
        for one in report.findings
        if one.check.startswith(check)
    ]


def is_named(report: VerificationReport, mark: str, check: str = "") -> bool:
    return any(mark in text for text in texts(report, check))


@pytest.mark.slow
@pytest.mark.parametrize("name", DAMAGES)
def test_each_damage_is_named_alone(name: str, whole: Path, tmp_path: Path) -> None:
    damage = DAMAGES[name]
    root = copied(whole, tmp_path / "set")
    damage.harm(root)
    report = verify(root, workers=1)
    assert is_named(report, damage.mark), texts(report)
    if damage.deep is not None:
        sum_again(root)
        report = verify(root, workers=1)
        assert is_named(report, damage.deep_mark or damage.mark, damage.deep), texts(report)


def test_all_damages_are_named_at_once(whole: Path, tmp_path: Path) -> None:
    """First with the sums that the files had, then with sums that agree with every change."""
    root = copied(whole, tmp_path / "set")
    for damage in DAMAGES.values():
        damage.harm(root)
    report = verify(root, workers=1)
    assert [name for name, one in DAMAGES.items() if not is_named(report, one.mark)] == []
    assert report.not_named == 0
    sum_again(root)
    report = verify(root, workers=1)
    deep = {name: one for name, one in DAMAGES.items() if one.deep is not None}
    lost = [name for name, one in deep.items() if not is_named(report, one.deep_mark or one.mark, one.deep or "")]
    assert lost == []


def test_the_first_thousand_of_a_check_are_named_and_the_others_counted(whole: Path, tmp_path: Path) -> None:
    root = copied(whole, tmp_path / "set")
    for number in range(MOST_NAMED + 5):
        (root / f"thumbnails/{number}.txt").touch()
    (root / "val/coco.json").unlink()
    report = verify(root, labels=False, workers=1)
    assert report.not_named == 5
    assert len(texts(report, "listing")) == MOST_NAMED
    assert is_named(report, "val/coco.json", "sums")
    answer = run("verify", root, "-w", "1", "--no-hashes")
    assert answer.code == 6
    assert "... and 5 more" in answer.out
    assert "thumbnails/1.txt" in answer.out
    assert f"{MOST_NAMED + 5:,} findings)" in answer.out


def test_the_report_can_be_read_by_programs(whole: Path, tmp_path: Path) -> None:
    answer = run("verify", whole, "--json", "-w", "1")
    assert answer.code == 0, answer.err
    sound = json.loads(answer.out)
    assert (sound["ok"], sound["findings"], sound["images"], sound["frames"]) == (True, [], 4, 8)
    assert {"sums", "listing", "frames", "labels train"} <= {check["name"] for check in sound["checks"]}
    root = copied(whole, tmp_path / "set")
    coco(2, area=12345)(root)
    answer = run("verify", root, "--json", "-w", "1")
    assert answer.code == 6
    report = json.loads(answer.out)
    assert not report["ok"]
    finding = next(one for one in report["findings"] if one["check"] == "labels train" and "area" in one["problem"])
    assert finding["got"] == "12345"
    assert finding["plant_id"] is not None
    assert finding["where"].startswith("train/coco.json, image 00000")
    assert {one["check"]: one["file"] for one in report["findings"]}["sums"] == "train/coco.json"


def test_sums_that_cannot_be_read_hide_nothing(whole: Path, tmp_path: Path) -> None:
    """The records and the manifests have sums as well."""
    root = copied(whole, tmp_path / "set")
    (root / "SHA256SUMS").unlink()
    assert {(one.check, one.file) for one in verify(root, labels=False, workers=1).findings} == {("sums", "SHA256SUMS")}
    flip(root / "val/000003-near/frame.exr")
    flip(root / "val/coco.json")
    flip(root / "thumbnails/000003-near.jpg")
    report = verify(root, labels=False, workers=1)
    for path in ("val/000003-near/frame.exr", "val/coco.json", "thumbnails/000003-near.jpg"):
        assert is_named(report, path, "sums")
