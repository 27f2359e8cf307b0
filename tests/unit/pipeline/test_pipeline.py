"""The stages in a row."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from forestgen import pipeline
from forestgen.core.progress import Silent, Timings
from forestgen.dataset.settings import data_set_of
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import make_plan

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
class Written:
    """The tiny recipe's image, which the tests share: it takes seconds."""

    folder: Path
    image: pipeline.WrittenImage
    noted: Noted
    timings: Timings
    total_s: float


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    folder, noted, timings = tmp_path_factory.mktemp("run"), Noted(), Timings()
    loaded = load_recipe(QUICKSTART, TINY)
    scene = pipeline.assemble_image(make_plan(loaded.draw(0)), noted, timings)
    image = pipeline.write_image(scene, data_set_of(scene.drawn), folder, noted, timings)
    return Written(folder, image, noted, timings, timings.total())


def test_an_image_tells_its_progress_its_notes_and_its_numbers(written: Written) -> None:
    image, noted = written.image, written.noted
    assert [folder.relative_to(written.folder).as_posix() for folder in image.folders] == ["000000-a", "000000-b"]
    assert all((folder / "frame.exr").exists() for folder in image.folders)
    assert [row["frame"] for row in image.rows] == ["000000-a", "000000-b"]
    assert image.report["image"] == 0
    assert sum(image.report["counts"].values()) > 0 == image.report["visible_plants"]  # too small to be in view
    assert image.notes[-1] == "000000-b: the camera stands below the ground"
    assert {"community", "plants", "identity a", "identity b", "radiance"} <= set(noted.done)
    assert all(done == total for done, total in noted.done.values()), noted.done
    seconds = written.timings.seconds
    assert {"community", "measures", "labels", "write"} <= set(seconds)
    assert 0 < sum(seconds.values()) <= written.total_s * 1.01


def test_a_simulation_is_the_first_images_community(tmp_path: Path, written: Written) -> None:
    loaded = load_recipe(QUICKSTART, TINY)
    alone = pipeline.simulate(loaded, tmp_path / "alone", progress=Silent(), timings=Timings())
    assert not alone.notes
    assert alone.counts == written.image.report["counts"]
    assert (tmp_path / "alone" / "history.parquet").exists()
    in_memory = pipeline.simulate(loaded, None, progress=Silent(), timings=Timings())
    assert in_memory.counts == alone.counts
    assert in_memory.last.plant_id.tobytes() == alone.last.plant_id.tobytes()
    assert [path.name for path in tmp_path.iterdir()] == ["alone"]


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
