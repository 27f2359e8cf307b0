"""The stages in a row, as a library calls them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from forestgen import pipeline
from forestgen.core.progress import Silent
from forestgen.core.timing import Timings
from forestgen.recipe.load import load_recipe

QUICKSTART = Path(__file__).parents[3] / "recipes" / "quickstart.yaml"
TINY = (
    "site={size_m: [8, 8]}",
    "species={fireweed: }",
    "community.steps=8",
    "sky.clouds=none",
    "cameras=[{name: a, size_px: [32, 18]}, {name: b, position_m: [4, 4, -3], size_px: [16, 16]}]",
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


def test_a_run_tells_its_progress_its_notes_and_its_numbers(tmp_path: Path) -> None:
    noted, timings = Noted(), Timings()
    summary = pipeline.render(load_recipe(QUICKSTART, TINY), tmp_path / "out", progress=noted, timings=timings)
    assert summary.frames == 2
    assert summary.plants == sum(summary.counts.values()) > 0
    assert summary.notes[-1] == "000000-b: the camera stands below the ground"
    assert {"images", "community", "plants", "identity a", "identity b", "radiance"} <= set(noted.done)
    assert all(done == total for done, total in noted.done.values()), noted.done
    assert set(summary.timings_s) <= set(timings.seconds)
    assert 0 < sum(summary.timings_s.values()) <= summary.total_s * 1.01
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert manifest["run"]["notes"] == summary.notes
    assert "coco.json" in manifest["files"]


def test_a_simulation_is_the_first_images_community(tmp_path: Path) -> None:
    loaded = load_recipe(QUICKSTART, TINY)
    alone = pipeline.simulate(loaded, tmp_path / "alone", progress=Silent(), timings=Timings())
    assert alone.frames == 0
    assert not alone.notes
    rendered = pipeline.render(loaded, tmp_path / "out", progress=Silent(), timings=Timings())
    assert alone.counts == rendered.counts


def test_an_image_that_fails_takes_the_whole_run_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    real = pipeline.build_scene

    def second_fails(*arguments: object) -> object:
        calls.append(1)
        if len(calls) == 2:
            raise RuntimeError("no")
        return real(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(pipeline, "build_scene", second_fails)
    loaded = load_recipe(QUICKSTART, [*TINY, "images=2"])
    with pytest.raises(RuntimeError, match="no"):
        pipeline.render(loaded, tmp_path / "out", progress=Silent(), timings=Timings())
    assert len(calls) == 2
    assert not list(tmp_path.iterdir())
