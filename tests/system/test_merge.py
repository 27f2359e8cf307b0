"""`forestgen merge`: pieces give the whole to the last byte; what cannot be one is refused, and nothing is left."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from batch_pieces import copied, finished, jobs_of, make, recipe, shown
from command_line import run, tree

from forestgen.core.errors import DatasetError, OutputError, RecipeError
from forestgen.recipe.load import load_recipe
from forestgen.runs.contract import Job
from forestgen.runs.merge import merge
from forestgen.runs.records import read_record, record_bytes, records_of
from forestgen.runs.storage import LocalStorage
from forestgen.runs.verify import verify
from support.error_messages import raises_error


def piece(whole: Path, target: Path, *images: int) -> Path:
    """A data set of these images alone, as a machine made it with --first and --count."""
    loaded = load_recipe(whole.parent / "fireweed.yaml", [f"first_image={min(images)}"])
    root = copied(whole, target, images)
    known = {one.image: one for one in records_of(LocalStorage(root))}
    span = range(min(images), max(images) + 1)
    jobs = [
        Job(image - min(images), image, known[image].split if image in known else "train", known[image].key)
        if image in known
        else Job(image - min(images), image, "train", f"{image:06d}-{'0' * 40}")
        for image in span
    ]
    finished(loaded, jobs, root)
    return root


@pytest.mark.parametrize("link", [False, True])
def test_pieces_are_the_whole(whole, tmp_path, link):
    """Whatever their order, with an image in two of them, copied or linked."""
    pieces = [piece(whole, tmp_path / "b", 1, 2, 3), piece(whole, tmp_path / "a", 0, 1)]
    before = [tree(one) for one in pieces]
    done = merge(pieces, tmp_path / "c", link=link)
    assert (done.frames, done.missing) == (8, ())
    assert shown(tmp_path / "c") == shown(whole)
    assert [tree(one) for one in pieces] == before
    same = (tmp_path / "c/train/000000-near/frame.exr").samefile(tmp_path / "a/train/000000-near/frame.exr")
    assert same == link
    assert verify(tmp_path / "c", labels=False, workers=1).findings == ()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b", "c"]


def test_a_merged_set_can_be_merged_again(whole, tmp_path):
    merge([piece(whole, tmp_path / "a", 0), piece(whole, tmp_path / "b", 1)], tmp_path / "ab")
    merge([tmp_path / "ab", piece(whole, tmp_path / "c", 2, 3)], tmp_path / "all")
    assert shown(tmp_path / "all") == shown(whole)


def test_holes_are_told(whole, tmp_path):
    answer = run("merge", piece(whole, tmp_path / "a", 0), piece(whole, tmp_path / "b", 3), "--out", tmp_path / "c")
    assert answer.code == 0, answer.err
    assert "2 images are missing: 1-2" in answer.out
    assert "of the images that the recipes ask for, 2 are missing" in " ".join(
        verify(tmp_path / "c", labels=False, workers=1).notes
    )
    said = json.loads((tmp_path / "c/dataset.json").read_text())
    assert said["recipes"][0]["missing"] == [[1, 2]]
    assert piece(whole, tmp_path / "once", 0, 3)
    assert shown(tmp_path / "c") == shown(tmp_path / "once")


def test_images_that_differ_are_refused_by_name(whole, tmp_path):
    one, other = piece(whole, tmp_path / "a", 0, 1), piece(whole, tmp_path / "b", 1, 2)
    path = next((other / ".forestgen/jobs").glob("000001-*"))
    path.write_bytes(record_bytes(replace(read_record(path.read_bytes(), ""), image_seed=3)))
    with raises_error(DatasetError):
        merge([one, other], tmp_path / "c")
    assert not (tmp_path / "c").exists()


def test_pieces_that_would_show_one_stand_in_two_splits_are_refused(whole, tmp_path):
    """Each piece is sound: it is of one split, as ``same_stand: true`` asks for."""
    one, other = piece(whole, tmp_path / "a", 0), piece(whole, tmp_path / "b", 1)
    seed = next(records_of(LocalStorage(one))).image_seed
    path = next((other / ".forestgen/jobs").glob("000001-*"))
    path.write_bytes(record_bytes(replace(read_record(path.read_bytes(), ""), image_seed=seed)))
    with raises_error(RecipeError):
        merge([one, other], tmp_path / "c")
    assert not (tmp_path / "c").exists()


def test_pieces_with_a_sea_between_them_are_refused(whole, tmp_path):
    """Numbers of a stranger's piece are not counted up to."""
    one, other = piece(whole, tmp_path / "a", 0), piece(whole, tmp_path / "b", 1)
    said = json.loads((other / "dataset.json").read_text())
    for asked in ([[10**12, 10**12]], [[0, 10**12]]):
        said["recipes"][0]["asked"] = asked
        (other / "dataset.json").write_text(json.dumps(said))
        with raises_error(RecipeError, DatasetError):
            merge([one, other], tmp_path / "c")


def test_a_damaged_piece_is_refused_by_its_file(whole, tmp_path):
    one, other = piece(whole, tmp_path / "a", 0, 1), piece(whole, tmp_path / "b", 2)
    path = other / "train/000002-near/frame.exr"
    content = bytearray(path.read_bytes())
    content[100] ^= 1
    path.write_bytes(content)
    with raises_error(DatasetError, place="frame.exr"):
        merge([one, other], tmp_path / "c")
    path.unlink()
    with raises_error(DatasetError, place="frame.exr"):
        merge([one, other], tmp_path / "c", link=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]


def test_a_lost_record_is_told(whole, tmp_path):
    one, other = piece(whole, tmp_path / "a", 0, 1), piece(whole, tmp_path / "b", 2)
    next((one / ".forestgen/jobs").glob("000001-*")).unlink()
    with raises_error(DatasetError, place="jobs"):
        merge([one, other], tmp_path / "c")
    shutil.rmtree(one / ".forestgen")
    with raises_error(RecipeError, place="a"):
        merge([one, other], tmp_path / "c")


def other_set(tmp_path: Path, name: str, first: int, images: int = 1) -> Path:
    """A data set of another recipe: one image is asked for, and made or not."""
    swaps = (("uniform: [20, 60]", "uniform: [50, 60]"), ("seed: 5", f"seed: 5\nfirst_image: {first}"))
    loaded = recipe(tmp_path / f"recipe-{name}", *swaps)
    jobs = jobs_of(loaded, range(1))
    make(loaded, jobs[:images], tmp_path / name)
    finished(loaded, jobs, tmp_path / name)
    return tmp_path / name


@pytest.mark.slow
def test_data_sets_of_two_recipes(whole, tmp_path):
    first = piece(whole, tmp_path / "a", 0, 1)
    second = other_set(tmp_path, "b", 10)
    merge([second, first], tmp_path / "c")
    merge([first, second], tmp_path / "d")
    assert shown(tmp_path / "c") == shown(tmp_path / "d")
    said = json.loads((tmp_path / "c/dataset.json").read_text())
    assert [(one["file"], one["first_image"], one["images"]) for one in said["recipes"]] == [
        ("recipe.yaml", 0, 2),
        ("recipe-2.yaml", 10, 1),
    ]
    assert load_recipe(tmp_path / "c/recipe-2.yaml").draw(0).image_index == 10
    assert verify(tmp_path / "c", labels=False, workers=1).findings == ()
    clash = other_set(tmp_path, "e", 1, images=0)
    answer = run("merge", first, clash, "--out", tmp_path / "f")
    answer.refused(2)
    assert not (tmp_path / "f").exists()


def test_settings_that_differ_are_named(whole, tmp_path):
    first = piece(whole, tmp_path / "a", 0)
    second = piece(whole, tmp_path / "b", 1)
    path = second / "dataset.json"
    path.write_text(path.read_text().replace('"view": "filmic"', '"view": "srgb"'))
    with raises_error(RecipeError, place="b"):
        merge([first, second], tmp_path / "c")


def test_a_previous_set_is_replaced_if_asked(whole, tmp_path):
    pieces = [piece(whole, tmp_path / "a", 0, 1), piece(whole, tmp_path / "b", 2, 3)]
    old = piece(whole, tmp_path / "c", 1)
    (old / "mine.txt").write_text("mine")
    before = shown(old)
    with raises_error(OutputError, place="c"):
        merge(pieces, old, overwrite=True)
    assert shown(old) == before
    (old / "mine.txt").unlink()
    merge(pieces, old, overwrite=True)
    assert shown(old) == shown(whole)
    with raises_error(OutputError, place="a"):
        merge(pieces, pieces[0], overwrite=True)


def test_bad_arguments_are_refused(whole, tmp_path):
    first = piece(whole, tmp_path / "a", 0)
    run("merge", first, first, "--out", tmp_path / "c").refused(2)
    run("merge", first, tmp_path / "none", "--out", tmp_path / "c").refused(2)
    run("merge", first, "--out", "s3://bucket/set").refused(2)
    (tmp_path / "full").mkdir()
    (tmp_path / "full/mine.txt").write_text("mine")
    with raises_error(OutputError, place="full"):
        merge([first], tmp_path / "full")
    with raises_error(OutputError, place="b"):
        merge([first], piece(whole, tmp_path / "b", 1))
    with raises_error(OutputError, place="mine.txt"):
        merge([first], tmp_path / "full/mine.txt")
    with raises_error(RecipeError):
        merge([], tmp_path / "c")
    with raises_error(OutputError, place="inside"):
        merge([first], first / "inside")
    assert not (tmp_path / "c").exists()
