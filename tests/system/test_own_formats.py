"""Formats, label channels and packs that another package registers are used like those that come along."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from batch_runs import RECIPE, recipe

import forestgen as fg
from forestgen.dataset.check.run import check_dataset
from forestgen.recipe.registries import DATASET_FORMATS
from forestgen.runs.replace import foreign_files
from support.error_messages import raises_error

OWN = RECIPE.replace("formats: []", "formats: [coco, sizes]").replace("train: 2", "train: 1")


pytestmark = pytest.mark.usefixtures("registries_as_before")


@pytest.mark.slow
def test_a_registered_format_is_used_like_a_shipped_one(tmp_path: Path) -> None:
    """Two worker processes write it, two check it, and the merged files of the whole data set are there."""
    fg.register("dataset_format", "sizes", "own_formats:FORMAT", "sizes of frames")
    (entry,) = fg.models("sizes")
    assert (entry.kind, entry.description) == ("dataset_format", "sizes of frames")
    assert "of another package" in entry.page
    assert '"sizes"' in json.dumps(fg.schema())
    run = fg.load(recipe(tmp_path, OWN)).batch(tmp_path / "set", 2, workers=2, threads=1, progress=False)
    root = Path(run.target)
    assert json.loads((root / "val" / "sizes.json").read_text()) == {"000001-left": [32, 24], "000001-right": [16, 16]}
    assert (root / "sizes.txt").read_text() == "train/sizes.json\nval/sizes.json\n"
    assert "\n`SPLIT/sizes.json` has the sizes of frames.\n" in (root / "README.md").read_text()
    report = fg.verify(root, workers=2, progress=False)
    assert report.findings == ()
    (root / "val" / "000001-right" / "size.json").write_text('{"size_px": [1, 1]}')
    report = check_dataset(root / "val", jobs=2)
    assert [(one.check, one.image, one.got) for one in report.findings] == [("size", "000001-right", "[1, 1]")]
    assert {"size", "sizes", "whole size"} <= set(report.looked_at)
    whole = root / "val" / "sizes.json"
    whole.write_text(whole.read_text().replace("[32,24]", "[24,32]"))
    report = check_dataset(root / "val", jobs=2)
    assert [(one.check, one.image) for one in report.findings if one.file == "sizes.json"] == [
        ("whole size", "000001-left")
    ]


def test_a_registered_label_channel_and_pack_are_used_like_shipped_ones(tmp_path: Path) -> None:
    fg.register("label_channel", "triangles", "own_formats:CHANNEL", "triangles of exemplars")
    fg.register("pack", "names", "own_formats:PACK")
    text = OWN.replace("[coco, sizes]", "[]").replace(
        "labels: {samples: 1}", "labels: {samples: 1, channels: [triangles]}"
    )
    run = fg.load(recipe(tmp_path, text)).batch(tmp_path / "set", 2, workers=2, threads=1, progress=False)
    data_set = fg.Dataset(run.target)
    counts = data_set["000000-left"].channel("triangles", "count")
    assert set(data_set["000000-left"].parts) == {"radiance", "radiance.variance", "depth", "triangles", "identity"}
    plants = data_set["000000-left"].instance > 0
    assert counts[plants].max() > 0
    assert (counts > 0).sum() < counts.size
    packed = data_set.pack(tmp_path / "pack", "names", channels="semantic", by_name=True, progress=False)
    assert packed.channels == ("semantic",)
    assert (tmp_path / "pack" / "val.txt").read_text() == "000001-left semantic\n000001-right semantic\n"
    assert 'Path("PATH/train.txt")' in (tmp_path / "pack" / "README.md").read_text()


def test_a_data_set_of_a_format_that_is_not_registered(tmp_path: Path) -> None:
    """It can be opened, verified and replaced; only to merge it the format must be there."""
    fg.register("dataset_format", "sizes", "own_formats:FORMAT", "sizes of frames")
    root = Path(fg.load(recipe(tmp_path, OWN)).render(tmp_path / "set", count=1, progress=False).target)
    del DATASET_FORMATS._entries["sizes"]
    assert len(fg.Dataset(root)) == 2
    assert fg.verify(root, workers=1, progress=False).findings == ()
    with raises_error(fg.RecipeError, place="set") as refused:
        fg.merge([root], tmp_path / "merged", progress=False)
    assert refused.value.got == "sizes"
    (root / "SHA256SUMS").unlink()  # as a run does that resumes
    assert foreign_files(root) == []
    (root / "train" / "mine.json").write_text("{}")
    assert foreign_files(root) == ["train/mine.json"]


def test_its_own_rule_refuses_a_camera(tmp_path: Path) -> None:
    fg.register("dataset_format", "sizes", "own_formats:FORMAT")
    text = OWN.replace("size_px: [16, 16]", "size_px: [16, 16], kind: panorama").replace(
        "size_px: [16, 16]", "size_px: [32, 16]"
    )
    loaded = fg.load(recipe(tmp_path, text))
    with raises_error(fg.RecipeError, place="cameras.1.kind") as refused:
        loaded.validate()
    assert "fireweed.yaml:10: cameras.1.kind" in str(refused.value.where)
    assert refused.value.got == "panorama"


def test_what_is_no_format_is_not_registered() -> None:
    with raises_error(fg.RecipeError, place="part"):
        fg.register("dataset_format", "sizes", "own_formats:NO_FORMAT")


def test_a_format_of_another_name_is_not_registered() -> None:
    with raises_error(fg.RecipeError, place="part") as refused:
        fg.register("dataset_format", "lengths", "own_formats:FORMAT")
    assert refused.value.got == "'sizes'"


@pytest.mark.parametrize("name", list(DATASET_FORMATS))
def test_shipped_formats_have_the_names_they_are_registered_under(name: str) -> None:
    found = DATASET_FORMATS.load(name)
    assert found.frame_checks()
    (entry,) = fg.models(name, kind="dataset_format")
    assert len(entry.page) > 200  # its module's manual
