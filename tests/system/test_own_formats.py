"""A format that another package registers is written, merged, checked and refused like those that come along."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from batch_runs import RECIPE, recipe

import forestgen as fg
from forestgen.core import registry
from forestgen.dataset.check import check_dataset
from forestgen.dataset.formats.format import load_format
from forestgen.recipe.registries import DATASET_FORMATS
from forestgen.runs.foreign_files import foreign_files

OWN = RECIPE.replace("formats: []", "formats: [coco, sizes]").replace("train: 2", "train: 1")


@pytest.fixture(autouse=True)
def _as_before() -> Iterator[None]:
    """What a test registers is forgotten."""
    entries, registered = dict(DATASET_FORMATS._entries), list(registry._registered)
    yield
    DATASET_FORMATS._entries.clear()
    DATASET_FORMATS._entries.update(entries)
    registry._registered[:] = registered


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
    report = check_dataset(root / "val", jobs=2, hashes=False, most=None)
    assert [(one.check, one.image, one.got) for one in report.findings] == [("size", "000001-right", "[1, 1]")]
    assert {"size", "sizes"} <= {one.name for one in report.check_results if one.images}


def test_a_data_set_of_a_format_that_is_not_registered(tmp_path: Path) -> None:
    """It can be opened, verified and replaced; only to merge it the format must be there."""
    fg.register("dataset_format", "sizes", "own_formats:FORMAT", "sizes of frames")
    root = Path(fg.load(recipe(tmp_path, OWN)).render(tmp_path / "set", count=1, progress=False).target)
    del DATASET_FORMATS._entries["sizes"]
    assert len(fg.Dataset(root)) == 2
    assert fg.verify(root, workers=1, progress=False).findings == ()
    with pytest.raises(fg.RecipeError, match="not registered here") as refused:
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
    with pytest.raises(fg.RecipeError, match="sizes has no such camera") as refused:
        loaded.validate()
    assert "fireweed.yaml:10: cameras.1.kind" in str(refused.value.where)
    assert refused.value.got == "panorama"


def test_what_is_no_format_is_not_registered() -> None:
    with pytest.raises(fg.RecipeError, match="this is no dataset format: it has no "):
        fg.register("dataset_format", "sizes", "own_formats:NO_FORMAT")


def test_what_is_no_format_of_its_name_is_refused_with_its_place(tmp_path: Path) -> None:
    fg.register("dataset_format", "lengths", "own_formats:FORMAT")
    loaded = fg.load(recipe(tmp_path, OWN.replace("sizes", "lengths")))
    with pytest.raises(fg.RecipeError, match="no data set format of this name") as refused:
        loaded.validate()
    assert "fireweed.yaml:13: dataset.formats.1" in str(refused.value.where)


@pytest.mark.parametrize("name", list(DATASET_FORMATS))
def test_shipped_formats_have_the_names_they_are_registered_under(name: str) -> None:
    found = load_format(name)
    assert found.frame_checks()
    (entry,) = fg.models(name, kind="dataset_format")
    assert len(entry.page) > 200  # its module's manual
