"""What a batch will take: counts, times, memory, disk, and refusals."""

from __future__ import annotations

import math
import re
import shutil
import tempfile
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import pytest

import forestgen
from forestgen.core.errors import OutputError, ResourceError
from forestgen.core.progress import Silent
from forestgen.dataset.settings import DatasetSettings
from forestgen.recipe.load import LoadedRecipe, load_recipe
from forestgen.runs import estimate as module
from forestgen.runs.calibration_runs import (
    _BY_SAMPLE,
    _BY_SCENE,
    CalibrationRun,
    CalibrationRuns,
    ReducedSettings,
    full_stages,
    lightened,
    probe_images,
)
from forestgen.runs.contract import Engine, Notice, RunOptions, Work
from forestgen.runs.engines.local import LocalEngine
from forestgen.runs.estimate import Estimate, check_fits, count_images, estimate
from forestgen.runs.run import check_recipe, run_batch
from forestgen.runs.storage import LocalStorage
from forestgen.runs.work import make_job
from support.error_messages import raises_error

RECIPE = """
forestgen: 1
seed: 3
site: {size_m: [10, 10], terrain: flat, ground: grass}
species: {fireweed: , grass: }
community: {model: uniform, plants: {fireweed: {count: 6}, grass: {count: 8}}}
plants: {exemplars_per_species: 1}
sky: {sun: {elevation_deg: {uniform: [20, 60]}}}
cameras:
  - {name: a, position_m: [5, -3, 1.6], look_at_m: [5, 5, 0.5], size_px: [32, 24]}
  - {name: b, position_m: [5, -3, 6], look_at_m: [5, 5, 0.5], size_px: [16, 16]}
render: {samples: 4}
labels: {samples: 1}
"""


@pytest.fixture(scope="module")
def recipe(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., LoadedRecipe]:
    path = tmp_path_factory.mktemp("estimate") / "recipe.yaml"
    path.write_text(RECIPE)
    return cache(lambda *overrides: load_recipe(path, overrides))


@pytest.fixture(scope="module")
def settings(recipe: Callable[..., LoadedRecipe]) -> DatasetSettings:
    return check_recipe(recipe(), range(1))[0]


def probe(
    seconds: float = 10.0, *, first: bool = False, disk: int = 10**6, memory: int = 10**9, **stages: float
) -> CalibrationRun:
    return CalibrationRun(
        image=0, frames=2, plants=14, exemplars=2, triangles=9000, seconds=seconds, made_s=seconds,
        stages_s=stages or {"light paths": 0.6 * seconds}, disk_bytes=disk, memory_bytes=memory, is_first=first,
    )  # fmt: skip


@pytest.fixture
def expected(
    recipe: Callable[..., LoadedRecipe], settings: DatasetSettings, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., Estimate]:
    """An estimate from given probes, on a machine of eight cores with 10 GB free."""
    monkeypatch.setattr(module, "cores", lambda: 8)
    monkeypatch.setattr(module, "free_bytes", lambda: 10**10)

    def make(
        *probes: CalibrationRun,
        count: int = 100,
        workers: int | None = None,
        threads: int | None = 1,
        overrides: tuple[str, ...] = (),
    ) -> Estimate:
        monkeypatch.setattr(module, "probe_images", lambda *_, **__: CalibrationRuns(probes))
        return estimate(recipe(*overrides), settings, count=count, workers=workers, threads=threads, progress=Silent())

    return make


def test_counts_follow_from_the_recipe(recipe: Callable[..., LoadedRecipe]) -> None:
    counts = count_images(recipe(), 50)
    assert (counts.images, counts.frames) == (50, 100)
    assert counts.pixels == 50 * (32 * 24 + 16 * 16)
    assert counts.paths == 4 * counts.pixels
    assert counts.drawn == 0
    assert count_images(recipe(), 0).pixels == 0


def test_counts_that_are_drawn_are_their_mean(recipe: Callable[..., LoadedRecipe]) -> None:
    counts = count_images(recipe("render.samples={integers: [10, 30]}"), 1000)
    assert counts.drawn == 64
    assert counts.paths / counts.pixels == pytest.approx(20, abs=4 * 6 / math.sqrt(64))


@pytest.mark.parametrize("more", ["render.samples=8", "cameras.0.size_px=[64, 48]"])
def test_counts_grow_with_samples_and_pixels(recipe: Callable[..., LoadedRecipe], more: str) -> None:
    assert count_images(recipe(more), 10).paths > count_images(recipe(), 10).paths


def test_a_probe_is_scaled_to_its_image() -> None:
    stages = {"light paths": 1.0, "identity: guides": 1.0, "community": 1.0}
    assert full_stages(stages, ReducedSettings()) == stages
    assert full_stages(stages, ReducedSettings(samples=4)) == {
        "light paths": 4.0,
        "identity: guides": 1.0,
        "community": 1.0,
    }
    assert full_stages(stages, ReducedSettings(pixels=3)) == {
        "light paths": 3.0,
        "identity: guides": 3.0,
        "community": 1.0,
    }
    totals = [sum(full_stages(stages, ReducedSettings(s, p)).values()) for s, p in ((1, 1), (2, 1), (2, 2), (4, 2))]
    assert totals == sorted(set(totals))


def test_stages_that_are_scaled_are_booked_under_these_names() -> None:
    """A stage that was renamed would count as one that goes with the pixels."""
    package = Path(forestgen.__file__).parent
    sources = (path.read_text(encoding="utf-8") for path in package.rglob("*.py"))
    booked = {name for text in sources for name in re.findall(r'\b_?tim(?:er|ings)\("([^"]+)"\)', text)}
    assert {*_BY_SAMPLE, *_BY_SCENE} <= booked


def test_probes_are_lighter_than_their_images(recipe: Callable[..., LoadedRecipe]) -> None:
    """And not only said to be: an estimate multiplies by what is left out."""
    loaded = recipe("render.samples=8192", "cameras.0.size_px=[1280, 960]")
    full = loaded.draw(0).recipe
    light, lighter = lightened(loaded)
    made = light.draw(0).recipe
    assert full.render.samples / made.render.samples == lighter.samples == 16
    pixels = [sum(math.prod(camera.size_px) for camera in one.cameras) for one in (full, made)]
    assert pixels[0] / pixels[1] == pytest.approx(lighter.pixels)
    assert lighter.pixels > 4
    assert loaded.draw(1).recipe.render.samples == 8192
    assert lightened(recipe()) == (recipe(), ReducedSettings())


def test_time_is_that_of_warm_images_shared_among_workers(expected: Callable[..., Estimate]) -> None:
    one = expected(probe(70, first=True), probe(10), probe(10), workers=1)
    assert one.image_s is not None
    assert one.seconds is not None
    assert one.image_s.mean == pytest.approx(10)
    assert one.start_s == pytest.approx(60)
    assert one.seconds.mean == pytest.approx(60 + 100 * 10)
    assert one.images_per_hour == pytest.approx(360)
    four = expected(probe(70, first=True), probe(10), probe(10), workers=4)
    assert four.seconds is not None
    assert four.seconds.mean == pytest.approx(60 + 100 * 10 / 4)
    many = expected(probe(70, first=True), probe(10), workers=32)  # no faster than its cores
    assert many.images_per_hour == pytest.approx(8 * 360)


def test_totals_grow_with_the_count(expected: Callable[..., Estimate]) -> None:
    made = [expected(probe(), probe(12), count=count, workers=2) for count in (50, 100, 1000)]
    for before, after in pairwise(made):
        assert before.seconds is not None
        assert after.seconds is not None
        assert before.seconds.mean < after.seconds.mean
        assert before.total_disk_bytes < after.total_disk_bytes


def test_intervals_hold_the_mean_and_widen_with_the_spread(expected: Callable[..., Estimate]) -> None:
    alike, apart = expected(probe(10), probe(10.5)).image_s, expected(probe(5), probe(20)).image_s
    assert alike is not None
    assert apart is not None
    for one in (alike, apart):
        assert one.low < one.mean < one.high
    assert apart.high / apart.low > alike.high / alike.low


def test_shares_of_the_stages_add_up(expected: Callable[..., Estimate]) -> None:
    shares = expected(probe(10, mitsuba=5.0, plants=2.0), probe(20, mitsuba=10.0, scene=1.0)).stages
    assert sum(shares.values()) == pytest.approx(1)
    assert next(iter(shares)) == "mitsuba"
    assert shares["other"] == pytest.approx((3 + 9) / 30)


def test_a_librarys_plants_grow_once(expected: Callable[..., Estimate]) -> None:
    """Three splits of four plants a size, and twice the sizes of one image: 24 images' plants, shared by all."""
    probes = [probe(10, plants=8.0), probe(10, plants=8.0)]
    alone = expected(*probes, count=1000)
    few, many = (expected(*probes, count=count, overrides=("plants.library=4",)) for count in (60, 6000))
    assert alone.image_s is not None
    assert few.image_s is not None
    assert many.image_s is not None
    assert alone.image_s.mean == pytest.approx(10)
    assert few.image_s.mean == pytest.approx(2 + 8 * (24 / 60 + 0.05))
    assert many.image_s.mean == pytest.approx(2 + 8 * (24 / 6000 + 0.05))
    assert many.memory_bytes.mean > alone.memory_bytes.mean  # a worker keeps those that it used


def test_workers_are_as_many_as_cores_and_memory_allow(expected: Callable[..., Estimate]) -> None:
    small, large = (expected(probe(memory=size)) for size in (10**8, 3 * 10**9))
    assert small.workers == 8
    assert large.workers == 2
    assert large.workers * large.worker_bytes <= 0.8 * 10**10
    assert expected(probe(memory=10**8), threads=4).workers == 2
    assert expected(probe(memory=10**8), count=51, workers=3).workers == 3


def test_cores_that_memory_leaves_idle_become_threads(expected: Callable[..., Estimate]) -> None:
    made = expected(probe(memory=3 * 10**9), threads=None)
    assert (made.workers, made.threads) == (2, 4)
    made = expected(probe(memory=10**8), threads=None)
    assert (made.workers, made.threads) == (8, 1)


def test_a_small_batch_is_not_probed(
    recipe: Callable[..., LoadedRecipe], settings: DatasetSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "probe_images", None)  # would fail
    made = estimate(recipe(), settings, count=3, workers=1, threads=1, progress=Silent())
    assert made.seconds is None
    text = "\n".join(made.lines())
    assert "not measured" in text
    assert "upper bounds" in text
    larger = estimate(
        recipe("cameras.0.size_px=[320, 240]"), settings, count=3, workers=1, threads=1, progress=Silent()
    )
    assert larger.total_disk_bytes > made.total_disk_bytes > 0
    assert larger.memory_bytes.mean > made.memory_bytes.mean


def test_the_table_tells_what_and_how(expected: Callable[..., Estimate]) -> None:
    text = "\n".join(expected(probe(70, first=True), probe(10), workers=2).lines())
    for word in ("200 frames", "14 plants", "2, of 1 thread", "images an hour", "light paths 60 %", "disk", "100 MB"):
        assert word in text, text


def test_one_frame_is_told_in_the_singular(recipe: Callable[..., LoadedRecipe], settings: DatasetSettings) -> None:
    one = recipe("cameras=[{position_m: [5, -3, 1.6], look_at_m: [5, 5, 0.5], size_px: [32, 24]}]")
    text = "\n".join(estimate(one, settings, count=1, workers=1, threads=1, progress=Silent()).lines())
    assert "1; 1 frame, " in text


def test_one_worker_that_does_not_fit_is_refused(expected: Callable[..., Estimate], tmp_path: Path) -> None:
    with raises_error(ResourceError):
        check_fits(expected(probe(memory=9 * 10**9)), LocalStorage(tmp_path))
    check_fits(expected(probe(memory=9 * 10**9)), LocalStorage(tmp_path), workers_here=False)


def test_workers_that_were_asked_for_and_do_not_fit_are_refused(
    expected: Callable[..., Estimate], tmp_path: Path
) -> None:
    with raises_error(ResourceError, place="workers=8"):
        check_fits(expected(probe(memory=3 * 10**9), workers=8), LocalStorage(tmp_path))
    check_fits(expected(probe(memory=3 * 10**9)), LocalStorage(tmp_path))


def test_a_disk_that_is_too_small_is_refused(
    expected: Callable[..., Estimate], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=90_000_000))
    place = LocalStorage(tmp_path / "not" / "yet", "not/yet")
    with raises_error(OutputError, place="yet") as caught:
        check_fits(expected(probe()), place)
    assert caught.value.exit_code == 4  # the output cannot be written; 3 is for memory
    check_fits(expected(probe(disk=10**5)), place)


def test_nothing_left_to_make_fits(expected: Callable[..., Estimate], tmp_path: Path) -> None:
    made = expected(count=0)
    check_fits(made, LocalStorage(tmp_path))
    assert made.total_disk_bytes == 0


def test_a_failing_image_is_told_and_leaves_nothing(
    recipe: Callable[..., LoadedRecipe], settings: DatasetSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr("forestgen.runs.calibration_runs.versions_hash", lambda: "other")
    monkeypatch.setattr("forestgen.runs.calibration_runs.job_key", lambda *_: "no such key")
    probed = probe_images(recipe(), settings, count=1, threads=1, budget_s=60.0, progress=Silent())
    assert not probed.probes
    assert probed.notes[0].startswith("image 0 fails: ")
    assert not list((tmp_path / "temporary").iterdir())


TINY = (
    ("two cameras", ()),
    ("more light", ("render.samples=64", "cameras.0.size_px=[96, 72]")),
    ("more plants", ("community.plants.grass.count=60", "plants={exemplars_per_species: 4}", "site.size_m=[20, 20]")),
)


@pytest.mark.slow
@pytest.mark.parametrize("overrides", [overrides for _, overrides in TINY], ids=[name for name, _ in TINY])
def test_what_comes_is_within_a_factor_of_two(
    recipe: Callable[..., LoadedRecipe], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, overrides: tuple[str, ...]
) -> None:
    monkeypatch.setenv("FORESTGEN_CACHE", "")
    loaded = recipe(*overrides)
    settings, _ = check_recipe(loaded, range(8))
    made = estimate(loaded, settings, count=8, workers=1, threads=1, progress=Silent(), probe=True, budget_s=200)
    assert made.seconds is not None

    def engine(work: Work, notice: Notice) -> Engine:
        return LocalEngine(work, 1, make_job)

    target = tmp_path / "set"
    summary = run_batch(loaded, str(target), RunOptions(count=8, threads=1), engine)
    assert not summary.failed
    assert 0.5 < made.seconds.mean / summary.seconds < 2
    bytes_made = sum(path.stat().st_size for path in target.rglob("*") if path.is_file() and "run" not in path.parts)
    assert 0.5 < made.total_disk_bytes / bytes_made < 2
