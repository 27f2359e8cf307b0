"""`forestgen verify` passes what a batch has made, and names every file that is not as it was made."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import pytest
from batch_pieces import copied
from command_line import run
from dataset_breaks import edit, flip, sum_again

from forestgen.dataset.index import read_index
from forestgen.runs.records import read_record, record_bytes
from forestgen.runs.verify import VerificationReport, verify
from support.data_sets import write_rows


@pytest.fixture
def damaged(whole: Path, tmp_path: Path) -> Path:
    """A copy, to be damaged."""
    return copied(whole, tmp_path / "set")


def named(report: VerificationReport) -> set[tuple[str, str]]:
    return {(finding.check, finding.file) for finding in report.findings}


def test_a_sound_data_set_passes_in_full(whole):
    report = verify(whole, rerender=1, seed=2, workers=1)
    assert report.findings == ()
    assert report.notes == ()
    assert (report.images, report.frames) == (4, 8)
    names = [check_result.name for check_result in report.checks]
    assert names[:7] == ["sums", "listing", "records", "index", "manifests", "recipes", "frames"]
    assert names[7:9] == ["seeds", "communities"]
    assert names[9:] == ["labels train", "labels val", "renders"]
    assert all(check_result.good == check_result.images > 0 for check_result in report.checks)


def kinds(root: Path) -> Iterator[str]:
    """One file of each kind."""
    seen = set()
    for line in (root / "SHA256SUMS").read_text().splitlines():
        path = Path(line[66:])
        kind = (len(path.parts), path.name if path.parent.name[:1] == "0" else path.suffix, path.parts[-2:-1][:1])
        mark = (path.parts[0], path.name if len(path.parts) == 3 else kind)
        if path.name != "dataset.json" and mark not in seen and path.parts[0] != "val":
            seen.add(mark)
            yield str(path)


def test_a_flipped_bit_is_found_in_every_kind_of_file(whole, tmp_path):
    waiting = kinds(whole)
    count = 0
    while paths := list(islice(waiting, 10)):
        root = copied(whole, tmp_path / f"{count}")
        for path in paths:
            (root / path).write_bytes((root / path).read_bytes())  # it may be a link
            flip(root / path)
        found = {file for check, file in named(verify(root, labels=False, workers=2)) if check == "sums"}
        assert found == set(paths)
        count += len(paths)
        shutil.rmtree(root)
    assert count > 30


def replace_frame(root: Path) -> None:
    one, other = root / "train/000000-near", root / "train/000002-near"
    one.rename(root / "aside")
    other.rename(one)
    (root / "aside").rename(other)


def rename_camera(path: Path) -> None:
    """In a record, whose own sum is right."""
    record = read_record(path.read_bytes(), "")
    path.write_bytes(record_bytes(replace(record, rows=tuple({**row, "camera": "far"} for row in record.rows))))


DAMAGES: dict[str, tuple[Callable[[Path], object], tuple[str, str]]] = {
    "deleted": (
        lambda root: (root / "val/000001-near/semantic.png").unlink(),
        ("sums", "val/000001-near/semantic.png"),
    ),
    "merged deleted": (lambda root: (root / "val/coco.json").unlink(), ("sums", "val/coco.json")),
    "added": (lambda root: (root / "train/000000-near/x.txt").write_text("x"), ("listing", "train/000000-near/x.txt")),
    "added on top": (lambda root: (root / "notes.txt").write_text("x"), ("listing", "notes.txt")),
    "a split added": (
        lambda root: shutil.copytree(root / "val", root / "test"),
        ("listing", "test/000001-high/annotations.json"),
    ),
    "swapped": (replace_frame, ("sums", "train/000000-near/annotations.json")),
    "sums cut": (
        lambda root: edit(root / "SHA256SUMS", "  train/coco.json\n", "  t\n"),
        ("listing", "train/coco.json"),
    ),
    "sums no text": (lambda root: (root / "SHA256SUMS").write_bytes(b"\xff\xfe"), ("sums", "SHA256SUMS")),
    "sums gone": (lambda root: (root / "SHA256SUMS").unlink(), ("sums", "SHA256SUMS")),
    "record": (
        lambda root: rename_camera(next((root / ".forestgen/jobs").glob("000002-*"))),
        ("records", "index.parquet"),
    ),
    "record gone": (
        lambda root: next((root / ".forestgen/jobs").glob("000001-*")).unlink(),
        ("records", "index.parquet"),
    ),
    "counts": (lambda root: edit(root / "dataset.json", '"frames": 4', '"frames": 5'), ("index", "dataset.json")),
    "index": (lambda root: (root / "index.parquet").write_bytes(b"PAR1"), ("index", "index.parquet")),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_named(damaged, name):
    harm, expected = DAMAGES[name]
    harm(damaged)
    report = verify(damaged, labels=False, workers=2)
    assert expected in named(report)
    finding = next(one for one in report.findings if (one.check, one.file) == expected)
    assert finding.problem
    failed = {check_result.name for check_result in report.checks if check_result.good < check_result.images}
    assert expected[0] in failed


def test_a_damaged_record_is_named(damaged):
    path = next((damaged / ".forestgen/jobs").glob("000002-*"))
    path.write_bytes(path.read_bytes()[:-40])
    assert ("records", f".forestgen/jobs/{path.name}") in named(verify(damaged, labels=False, workers=1))


def test_without_hashes_only_what_is_missing_is_found(damaged):
    flip(damaged / "train/000000-near/overlay.png")
    assert verify(damaged, labels=False, hashes=False, workers=1).findings == ()
    (damaged / "train/000000-near/overlay.png").unlink()
    assert named(verify(damaged, labels=False, hashes=False, workers=1)) == {("sums", "train/000000-near/overlay.png")}


def rows_changed(root: Path, **values: object) -> None:
    """An index with other values in its first row, and sums to match."""
    rows = list(read_index(root / "index.parquet"))
    rows[0].update(values)
    write_rows(root / "index.parquet", rows)
    sum_again(root)


def test_an_index_that_lies_is_found_by_the_frames(damaged):
    rows_changed(damaged, plants_in_view=99)
    report = verify(damaged, labels=False, workers=1)
    assert named(report) == {("frames", "index.parquet")}
    assert "99" in report.findings[0].got
    assert any("no records" in note for note in report.notes)


def test_a_seed_in_two_splits_is_found(damaged):
    rows = list(read_index(damaged / "index.parquet"))
    other = next(row["image_seed"] for row in rows if row["split"] != rows[0]["split"])
    rows_changed(damaged, image_seed=other)
    found = named(verify(damaged, labels=False, workers=1))
    assert {check for check, _ in found} == {"index", "manifests", "seeds"}  # and dataset.json has another digest


def test_a_community_in_two_splits_is_found(damaged):
    """The plants of a training frame, copied into the validation's."""
    shutil.copyfile(damaged / "train/000000-near/plants.parquet", damaged / "val/000001-near/plants.parquet")
    sum_again(damaged)
    report = verify(damaged, labels=False, workers=1)
    finding = next(one for one in report.findings if one.check == "communities")
    assert finding.file == "val/000001-near"
    assert "train/000000-" in finding.expected


def test_labels_of_each_split_are_checked(damaged):
    path = damaged / "val/coco.json"
    content = json.loads(path.read_text())
    content["annotations"][0]["area"] += 1
    path.write_text(json.dumps(content))
    sum_again(damaged)
    found = [one for one in verify(damaged, workers=1).findings if one.check.startswith("labels")]
    assert {one.check for one in found} == {"labels val"}
    assert found[0].file == "val/coco.json"


def retouch(path: Path) -> None:
    from PIL import Image

    with Image.open(path) as image:
        picture = image.convert("RGB")
    picture.putpixel((0, 0), (255, 0, 255))
    picture.save(path)


def test_retouched_pictures_are_found_by_rendering_again(damaged):
    """Sums agree with them: the renderer does not. Other versions might be why, and are told."""
    paths = sorted(damaged.glob("*/*-near/overlay.png"))
    for path in paths:
        retouch(path)
    said = json.loads((damaged / "dataset.json").read_text())
    said["made_with"][0]["versions_hash"] = "0" * 40
    said["made_with"][0]["packages"]["numpy"] = "1.0"
    (damaged / "dataset.json").write_text(json.dumps(said))
    sum_again(damaged)
    assert verify(damaged, labels=False, workers=1).findings == ()
    report = verify(damaged, labels=False, rerender=1, workers=1)
    (finding,) = report.findings
    assert finding.check == "renders"
    assert damaged / finding.file in paths
    assert "numpy 1.0, now" in finding.got
    assert any("numpy 1.0, now" in note for note in report.notes)


def test_the_command_says_what_it_found(whole, damaged):
    answer = run("verify", whole, "--no-hashes", "--workers", "1")
    assert answer.code == 0, answer.err
    assert "4 images, 8 frames" in answer.out
    flip(damaged / "val/000001-near/frame.exr")
    answer = run("verify", damaged, "--workers", "1")
    assert answer.code == 6
    assert "val/000001-near/frame.exr" in answer.err
    assert "sha256" in answer.err
    assert "FAILED" in answer.out


def test_other_folders_are_refused_with_what_to_do(whole, tmp_path):
    run("verify", tmp_path / "none").refused(2)
    run("verify", tmp_path).refused(2)
    run("verify", "s3://bucket/set").refused(2)
    run("verify", whole / "train").refused(2)
    run("verify", whole.parent).refused(2)
    shutil.copytree(whole / "train", tmp_path / "plain")
    run("verify", tmp_path / "plain").refused(2)
    unfinished = copied(whole, tmp_path / "unfinished", [0])
    run("verify", unfinished).refused(2)
    (unfinished / "dataset.json").write_text("{}")
    run("verify", unfinished).refused(6)
