"""A run that resumes and is refused leaves the data set as it was, and says why."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from batch_runs import assert_same, faults_folder, recipe, serial, shown
from pretend_jobs import FAULTS, make

from forestgen.core.errors import DatasetError, OutputError, RecipeError
from support.error_messages import raises_error


@pytest.fixture
def finished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """A recipe, and a data set of four images of it."""
    monkeypatch.setenv(FAULTS, "")
    faults_folder(tmp_path)
    path, target = recipe(tmp_path), tmp_path / "data"
    serial(path, target, 4, make)
    return path, target


def to_fifo(path: Path) -> None:
    shutil.rmtree(path, ignore_errors=True)
    path.unlink(missing_ok=True)
    os.mkfifo(path)


def to_link(path: Path) -> None:
    shutil.rmtree(path, ignore_errors=True)
    path.unlink(missing_ok=True)
    path.symlink_to(path.parents[2] / "elsewhere")


@pytest.mark.parametrize("harm", [to_fifo, to_link])
@pytest.mark.parametrize("name", ["run/log.jsonl", ".forestgen/staging", ".forestgen/jobs"])
def test_what_cannot_be_written_is_told_before_anything_is_removed(
    name: str, harm: Callable[[Path], None], finished: tuple[Path, Path]
) -> None:
    path, target = finished
    before = {name: content for name, content in shown(target).items() if not name.startswith(".forestgen")}
    harm(target / name)
    with raises_error(OutputError, DatasetError, place=name):
        serial(path, target, 4, make, resume=True)
    assert {name: content for name, content in shown(target).items() if not name.startswith(".forestgen")} == before


@pytest.mark.parametrize(
    ("count", "overrides", "said"), [(1, ("seed=9",), "4 of 4 finished images"), (1, (), "3 of 3"), (4, (), None)]
)
def test_images_without_records_are_not_thrown_away_unasked(
    count: int, overrides: tuple[str, ...], said: str | None, finished: tuple[Path, Path]
) -> None:
    path, target = finished
    serial(path, target.with_name("whole"), count, make, *overrides)
    for record in (target / ".forestgen/jobs").iterdir():
        record.unlink()
    before = shown(target)
    if said is not None:
        with raises_error(RecipeError, place="data"):
            serial(path, target, count, make, *overrides, resume=True)
        assert shown(target) == before
    serial(path, target, count, make, *overrides, resume=True, discard=said is not None)
    assert_same(target, target.with_name("whole"))


def test_what_the_recipe_says_otherwise_is_named(finished: tuple[Path, Path]) -> None:
    path, target = finished
    with raises_error(RecipeError, place="data"):
        serial(path, target, 4, make, "seed=9", "cameras.0.size_px=[16, 24]", "images=9", resume=True)
    (target / "recipe.yaml").unlink()
    with raises_error(RecipeError, place="data"):
        serial(path, target, 4, make, "seed=9", resume=True)
