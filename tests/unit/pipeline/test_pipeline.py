"""The stages in a row, as a library calls them."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from forestgen import pipeline
from forestgen.core.progress import Silent
from forestgen.core.timing import Timings
from forestgen.recipe.load import load_recipe

QUICKSTART = Path(__file__).parents[3] / "recipes" / "quickstart.yaml"
TINY = (
    "site={size_m: [8, 8], ground: soil_wet}",
    "species={fireweed: }",
    "community.steps=8",
    "sky.clouds=none",
    "cameras=[{name: a, size_px: [32, 18]}, {name: b, position_m: [4, 4, -3], size_px: [16, 16], obstructed: note}]",
    "render={samples: 1, denoise: false}",
    "labels.samples=1",
)


class Noted:
    """A listener that remembers."""

    def __init__(self) -> None:
        self.done: dict[str, tuple[int, int]] = {}

    @contextmanager
    def stage(self, title: str, total: int) -> Iterator[Callable[[int], None]]:
        self.done[title] = (0, total)

        def advance(steps: int) -> None:
            self.done[title] = (self.done[title][0] + steps, total)

        yield advance


@dataclass(frozen=True)
class Rendered:
    """A run of the tiny recipe, which the tests share: it takes seconds."""

    folder: Path
    summary: pipeline.RunSummary
    noted: Noted
    timings: Timings


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Rendered:
    folder, noted, timings = tmp_path_factory.mktemp("run") / "out", Noted(), Timings()
    summary = pipeline.render(load_recipe(QUICKSTART, TINY), folder, progress=noted, timings=timings)
    return Rendered(folder, summary, noted, timings)


def test_a_run_tells_its_progress_its_notes_and_its_numbers(rendered: Rendered) -> None:
    summary, noted, timings = rendered.summary, rendered.noted, rendered.timings
    assert summary.frames == 2
    assert summary.plants == sum(summary.counts.values()) > 0
    assert summary.notes[-1] == "000000-b: the camera stands below the ground"
    assert {"images", "community", "plants", "identity a", "identity b", "radiance"} <= set(noted.done)
    assert all(done == total for done, total in noted.done.values()), noted.done
    assert set(summary.timings_s) <= set(timings.seconds)
    assert 0 < sum(summary.timings_s.values()) <= summary.total_s * 1.01
    manifest = json.loads((rendered.folder / "manifest.json").read_text())
    assert manifest["run"]["notes"] == summary.notes
    assert "coco.json" in manifest["files"]


def test_a_simulation_is_the_first_images_community(tmp_path: Path, rendered: Rendered) -> None:
    loaded = load_recipe(QUICKSTART, TINY)
    alone = pipeline.simulate(loaded, tmp_path / "alone", progress=Silent(), timings=Timings())
    assert alone.frames == 0
    assert not alone.notes
    assert alone.counts == rendered.summary.counts


def test_an_image_that_fails_takes_the_whole_run_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    real = pipeline.build_scene

    def second_fails(*arguments: object) -> object:
        calls.append(1)
        if len(calls) == 2:
            raise RuntimeError("no")
        return real(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(pipeline, "build_scene", second_fails)
    one_camera = ["cameras=[{size_px: [16, 16]}]", "community.steps=3", "images=2"]
    loaded = load_recipe(QUICKSTART, [*TINY, *one_camera])
    with pytest.raises(RuntimeError, match="no"):
        pipeline.render(loaded, tmp_path / "out", progress=Silent(), timings=Timings())
    assert len(calls) == 2
    assert not list(tmp_path.iterdir())


def test_the_pipeline_imports_nothing_that_is_not_always_needed():
    heavy = {
        "scipy.linalg",
        "scipy.special",
        "pandas",
        "matplotlib",
        "pvlib",
        "colour",
        "pyarrow",
        "trimesh",
        "mitsuba",
        "h5py",
    }
    code = "import sys, forestgen.pipeline; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not heavy & set(loaded)
