"""A data set of four tiny images of two cameras, rendered once, and what tests do to copies of it."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path

import pytest
from filelock import FileLock

from forestgen.dataset.settings import data_set_of
from forestgen.recipe.load import LoadedRecipe, load_recipe
from forestgen.runs.contract import Job, JobRecord, Work
from forestgen.runs.finish import Finished, finish
from forestgen.runs.records import job_key, record_bytes, record_path, records_of, versions_hash
from forestgen.runs.storage import LocalStorage
from forestgen.runs.work import make_job

RECIPE = """\
forestgen: 1
seed: 5
site: {size_m: [6, 5], terrain: flat, ground: soil_wet}
species: {fireweed: }
community: {model: multiset_lsystem, program: succession, steps: 12}
plants: {exemplars_per_species: 1}
sky: {sun: {elevation_deg: {uniform: [20, 60]}}, turbidity: {choice: [2, 4.5]}}
cameras:
  - {name: near, position_m: [3, -1, 1], look_at_m: [3, 3, 0.4], size_px: [32, 24]}
  - {name: high, position_m: [3, 2, 6], look_at_m: [3, 2.5, 0], size_px: [16, 16]}
render: {samples: 1, denoise: false}
labels: {samples: 1}
dataset:
  formats: [coco, panoptic, yolo, bop, depth_png]
  description: Fireweed in spring
  licence: {name: CC BY 4.0, url: "https://creativecommons.org/licenses/by/4.0/"}
  splits: {train: 1, val: 1}
"""


def recipe(folder: Path, *swaps: tuple[str, str]) -> LoadedRecipe:
    """The recipe, with texts replaced."""
    text = RECIPE
    for old, new in swaps:
        assert old in text
        text = text.replace(old, new)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "fireweed.yaml").write_text(text, encoding="utf-8")
    return load_recipe(folder / "fireweed.yaml")


def jobs_of(loaded: LoadedRecipe, images: Iterable[int]) -> list[Job]:
    drawn = [(index, loaded.draw(index)) for index in images]
    return [Job(index, one.image_index, one.split, job_key(one, versions_hash())) for index, one in drawn]


def make(loaded: LoadedRecipe, jobs: Sequence[Job], root: Path) -> None:
    """Do the jobs, as a worker does them."""
    work = Work(loaded, data_set_of(loaded.draw(0)), LocalStorage(root), versions_hash())
    for job in jobs:
        outcome = make_job(work, job, 1)
        assert not hasattr(outcome, "message"), outcome


def finished(
    loaded: LoadedRecipe, jobs: Sequence[Job], root: Path, records: Iterable[JobRecord] | None = None
) -> Finished:
    place = LocalStorage(root)
    return finish(place, loaded, data_set_of(loaded.draw(0)), jobs, records_of(place) if records is None else records)


def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a finished data set of images 0 to 3, made once for all processes of the tests; nobody changes it."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "fireweed"
    with FileLock(folder.with_suffix(".lock")):
        if not (folder / "whole" / "dataset.json").exists():
            loaded = recipe(folder)
            jobs = jobs_of(loaded, range(4))
            make(loaded, jobs, folder / "whole")
            finished(loaded, jobs, folder / "whole")
    return folder / "whole"


def copied(source: Path, target: Path, images: Iterable[int] | None = None) -> Path:
    """A copy; with `images` a piece that holds these alone, not yet finished."""
    if images is None:
        shutil.copytree(source, target)
        return target
    place, wanted = LocalStorage(target), set(images)
    for record in records_of(LocalStorage(source)):
        if record.image in wanted:
            for path in record.files:
                (target / path).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(source / path, target / path)
            place.write(record_path(record.key), record_bytes(record))
    return target


def shown(root: Path) -> dict[str, bytes]:
    """Every file that two runs must agree on: path -> bytes."""
    paths = (path for path in sorted(root.rglob("*")) if path.is_file())
    names = {path.relative_to(root).as_posix(): path for path in paths}
    return {
        name: path.read_bytes()
        for name, path in names.items()
        if name.partition("/")[0] not in (".forestgen", "run", "report.html")
    }
