"""Images that share a library of plants have the same bytes however they are made: together, apart, or alone."""

from __future__ import annotations

from pathlib import Path

import pytest

import forestgen as fg
from forestgen.recipe.load import load_recipe
from forestgen.runs.contract import RUN_DEPENDENT, Engine, Notice, RunOptions, Work
from forestgen.runs.engines.local import LocalEngine
from forestgen.runs.run import run_batch
from forestgen.runs.work import make_job

RECIPE = """
forestgen: 1
seed: 8
site: {size_m: [8, 8], terrain: flat, ground: grass}
species:
  fireweed: {from: fireweed, height_m: {uniform: [1.2, 1.9]}}
  grass:
community: {model: uniform, plants: {fireweed: {count: 8}, grass: {count: 8}}}
plants: {library: 2, variants_per_size: 2, exemplars_per_species: 3, levels: true}
cameras: [{name: eye, position_m: [4, -2, 1.5], look_at_m: [4, 4, 0.5], size_px: [32, 24]}]
render: {samples: 1}
labels: {samples: 1}
"""


def _batch(recipe: Path, target: Path, workers: int) -> dict[str, bytes]:
    def engine(work: Work, notice: Notice) -> Engine:
        return LocalEngine(work, workers, make_job)

    summary = run_batch(load_recipe(recipe), str(target), RunOptions(count=6, threads=1), engine)
    assert not summary.failed
    files = (path for path in sorted(target.rglob("*")) if path.is_file())
    return {
        name: path.read_bytes()
        for path in files
        if (name := path.relative_to(target).as_posix()).split("/")[0] not in RUN_DEPENDENT
    }


@pytest.mark.slow
def test_neither_workers_nor_the_cache_nor_other_images_change_a_byte(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text(RECIPE)
    monkeypatch.setenv("FORESTGEN_CACHE", str(tmp_path / "cache"))
    cold = _batch(recipe, tmp_path / "cold", 2)
    assert _batch(recipe, tmp_path / "warm", 1) == cold
    monkeypatch.setenv("FORESTGEN_CACHE", "")
    assert _batch(recipe, tmp_path / "none", 1) == cold
    frame = next(name for name in cold if name.endswith("-eye/recipe.yaml") and "/000005-" in name).rpartition("/")[0]
    fg.load(tmp_path / "cold" / frame / "recipe.yaml").render(tmp_path / "alone", progress=False)
    alone = tmp_path / "alone" / frame
    assert {path.name: path.read_bytes() for path in alone.iterdir()} == {
        Path(name).name: content for name, content in cold.items() if name.startswith(f"{frame}/")
    }
