"""What data set formats need of a recipe is told before anything is simulated, with the key's place."""

from __future__ import annotations

from pathlib import Path

import pytest

from forestgen.api.recipes import load_checked
from forestgen.core.errors import ForestgenError, RecipeError
from forestgen.scene.plan import check_plan

RECIPE = """\
forestgen: 1
species: {birch: }
community: {model: uniform, plants: {birch: {count: 2}}}
labels: {channels: [amodal]}
cameras:
  - {kind: perspective, size_px: [32, 16]}
  - {kind: perspective, size_px: [32, 16]}
dataset: {formats: [coco]}
"""


def errors_of(folder: Path, *changes: tuple[str, str]) -> tuple[ForestgenError, ...]:
    text = RECIPE
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = folder / "r.yaml"
    path.write_text(text)
    with pytest.raises(RecipeError) as caught:
        check_plan(load_checked(path))
    return caught.value.errors


@pytest.mark.parametrize(("channels", "got"), [("[sun, cloud]", "sun, cloud"), ("[]", "none")])
def test_bop_without_amodal_names_the_channels(channels: str, got: str, tmp_path: Path) -> None:
    (error,) = errors_of(tmp_path, ("[amodal]", channels), ("[coco]", "[bop]"))
    assert "r.yaml:4: labels.channels" in str(error.where)
    assert (error.problem, error.got) == ("BOP's visible fractions need amodal masks", got)
    assert error.expected == "amodal among labels.channels"
    assert error.hint == "labels: {channels: [..., amodal]}, or leave bop out of dataset.formats"


@pytest.mark.parametrize(
    ("name", "kind", "held"),
    [("bop", "panorama", "perspective"), ("nerfstudio", "orthographic", "perspective, distorted, fisheye, panorama")],
)
def test_a_camera_that_a_format_has_no_words_for(name: str, kind: str, held: str, tmp_path: Path) -> None:
    wide = ", width_m: 9" if kind == "orthographic" else ""
    (error,) = errors_of(tmp_path, ("{kind: perspective", f"{{kind: {kind}{wide}"), ("[coco]", f"[{name}]"))
    assert "r.yaml:6: cameras.0.kind" in str(error.where)
    assert (error.problem, error.got) == (f"{name} has no such camera", kind)
    assert error.expected == f"a kind that the format {name} can hold: {held}"
    assert error.hint == f"leave {name} out of dataset.formats, or the camera out of this recipe"


def test_a_drawn_camera_says_from_what_it_was_drawn(tmp_path: Path) -> None:
    (error,) = errors_of(tmp_path, ("kind: perspective", "kind: {choice: [panorama, panorama]}"), ("[coco]", "[bop]"))
    assert error.got == "panorama, from {choice: ['panorama', 'panorama']}"


def test_formats_and_other_sections_are_told_together(tmp_path: Path) -> None:
    changes = (("[amodal]", "[]"), ("[coco]", "[coco, bop, nerfstudio]"), ("count: 2", "count: -2"))
    found = errors_of(tmp_path, *changes)
    assert {str(one.where).rpartition(": ")[2] for one in found} == {"labels.channels", "community.plants.birch.count"}
