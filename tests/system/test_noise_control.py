"""Images go on until their noise is as low as was asked for, and no longer; interrupted ones resume."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shots import radiance

from forestgen.core.progress import Silent, Timings
from forestgen.render import rendering as radiance_module
from forestgen.render.frame import RenderJob, StoppingCriterion
from forestgen.render.rendering import Estimate, Noise, Schedule, SliceSum, noise_of, render_radiance, unfinished
from forestgen.scene.spec import SceneSpec
from support.scenes import plain_ground, scattered_scene

EVERYWHERE = np.ones((30, 40), dtype=bool)


def stand(size_px=(48, 27)) -> SceneSpec:
    ground = plain_ground(-12000, 12000, albedo=0.2)
    return scattered_scene(40, size_m=30, exemplars=3, leaves=400, size_px=size_px, terrain=ground, seed=8)


class Painter:
    """An image of known mean and noise by sample, heavy-tailed over the pixels and over the samples."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        shape = (*EVERYWHERE.shape, 3)
        fixed = np.random.default_rng(99)
        self.mean = fixed.lognormal(5.0, 1.0, shape)
        self.sigma = self.mean * fixed.lognormal(-0.7, 0.6, (*shape[:2], 1))

    def take(self, samples: int) -> np.ndarray:
        # A light that is found once in five samples, five times as bright.
        hits = self.rng.binomial(samples, 0.2, self.mean.shape) / (samples * 0.2)
        return self.mean + self.sigma * (hits - 1.0) / 2.0

    def error(self, samples: int) -> Noise:
        return noise_of(Estimate(self.mean, self.sigma**2 / samples), EVERYWHERE)


def run(until: StoppingCriterion, painter: Painter, passes: int = 1) -> tuple[SliceSum, Noise, Schedule]:
    schedule, total, noise = Schedule(until, passes), SliceSum(), Noise(np.nan, np.nan)
    while size := schedule.next_size(total, noise, 0.0):
        total = total.added(painter.take(size * passes), size)
        if schedule.asks_for_noise(total):
            noise = noise_of(total.estimate(), EVERYWHERE)
    return total, noise, schedule


@pytest.mark.parametrize("target", [0.2, 0.05, 0.02])
@pytest.mark.parametrize("key", ["target_error", "target_error_p95"])
def test_no_more_samples_than_the_target_needs(target, key):
    """Against the known noise: on average at most a tenth more than the fewest samples that would do."""
    name = key.replace("target", "relative")
    per_sample = getattr(Painter(0).error(1), name)
    ideal = (per_sample / target) ** 2
    waste = []
    for seed in range(8):
        total, noise, schedule = run(StoppingCriterion(8, most_samples=65536, **{key: target}), Painter(seed))
        assert schedule.stopped_by == "target_error"
        assert getattr(noise, name) <= target
        waste.append(total.samples / max(ideal, 8) - 1)
    slack = 1 / max(ideal, 8)  # samples are whole
    assert np.mean(waste) < 0.1 + slack
    assert max(waste) < 0.25 + slack
    assert min(waste) > -0.25 - slack


def test_both_targets_are_met_and_none_is_needed():
    total, noise, _ = run(StoppingCriterion(8, target_error=0.1, target_error_p95=0.1), Painter(1))
    assert noise.relative_error < 0.1
    assert noise.relative_error_p95 <= 0.1
    total, _, schedule = run(StoppingCriterion(100), Painter(1))
    assert (total.samples, schedule.stopped_by) == (100, "samples")


def test_an_image_ends_at_the_most_samples():
    total, _, schedule = run(StoppingCriterion(16, target_error=1e-4, most_samples=333), Painter(1))
    assert (total.samples, schedule.stopped_by) == (333, "most_samples")


def test_samples_are_shared_by_the_passes():
    assert sum(Schedule(StoppingCriterion(16), 4).first) == 4
    assert sum(Schedule(StoppingCriterion(16), 5).first) == 4  # whole rounds: 20
    assert sum(Schedule(StoppingCriterion(1), 5).first) == 1
    total, _, _ = run(StoppingCriterion(16, target_error=0.05), Painter(2), passes=4)
    alone, _, _ = run(StoppingCriterion(16, target_error=0.05), Painter(2))
    assert 4 * total.samples == pytest.approx(alone.samples, rel=0.15)


def test_a_time_budget_is_not_overrun():
    """A renderer of 0.1 s a sample: the last slice is what still fits."""
    until = StoppingCriterion(16, time_budget_s=5.05, most_samples=65536)
    schedule, total, painter = Schedule(until, 1), SliceSum(), Painter(3)
    while size := schedule.next_size(total, Noise(np.nan, np.nan), 0.1 * total.samples):
        total = total.added(painter.take(size), size)
    assert (total.samples, schedule.stopped_by) == (50, "time_budget_s")


def test_the_error_is_that_of_many_images():
    """Of a scene: the stated error is the scatter of independent images, by pixel and over all of them."""
    spec = stand((32, 18))
    runs = [radiance(spec, 16, seed) for seed in range(12)]
    means = np.array([one.mean for one in runs], dtype=np.float64)
    scatter = Estimate(means.mean(axis=0), means.var(axis=0, ddof=1))
    truth = noise_of(scatter, np.ones((18, 32), dtype=bool))
    assert np.mean([one.relative_error for one in runs]) == pytest.approx(truth.relative_error, rel=0.1)
    assert np.mean([one.relative_error_p95 for one in runs]) == pytest.approx(truth.relative_error_p95, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["spectral", "rgb"])
def test_a_target_is_met_by_the_true_noise(mode):
    spec = stand((32, 18))
    until = StoppingCriterion(16, target_error=0.03, most_samples=4096)
    runs = [radiance(spec, until, seed, mode=mode) for seed in range(5)]
    assert all(one.relative_error <= 0.03 for one in runs)
    assert all(one.stopped_by == "target_error" for one in runs)
    assert np.ptp([one.samples for one in runs]) <= 0.25 * np.mean([one.samples for one in runs])
    means = np.array([one.mean for one in runs], dtype=np.float64)
    scatter = noise_of(Estimate(means.mean(axis=0), means.var(axis=0, ddof=1)), np.ones((18, 32), dtype=bool))
    assert scatter.relative_error == pytest.approx(0.03, rel=0.2)


def test_darkness_and_emptiness_have_no_noise():
    nothing = np.zeros((5, 5, 3))
    assert noise_of(Estimate(nothing, nothing), np.ones((5, 5), dtype=bool)) == Noise(0.0, 0.0)
    mean, variance = np.ones((30, 40, 2)), np.full((30, 40, 2), 0.01)
    circle = np.hypot(*np.meshgrid(np.arange(40) - 20, np.arange(30) - 15)) < 12
    dark = np.where(circle[..., None], mean, 0.0)
    seen = noise_of(Estimate(dark, np.where(circle[..., None], variance, 0.0)), circle)
    assert seen.relative_error == pytest.approx(0.1)  # what lies outside of a fisheye's circle does not count
    bands = noise_of(Estimate(mean * [1.0, 1e-3], variance * [1.0, 1e-6]), EVERYWHERE)
    assert bands.relative_error == pytest.approx(0.1)  # nor does the strength of a band


class Stopped(BaseException):
    """As Ctrl-C: no `Exception`."""


@pytest.mark.parametrize(
    ("until", "mode"),
    [
        (StoppingCriterion(16), "rgb"),
        (StoppingCriterion(16), "spectral"),
        (StoppingCriterion(8, target_error=0.1, most_samples=512), "rgb"),
    ],
    ids=["samples", "spectral", "target"],
)
def test_an_interrupted_image_goes_on_with_the_same_bytes(until, mode, monkeypatch):
    spec = stand((24, 14))
    shot = RenderJob(spec, spec.cameras[0], until, 5, mode)
    whole = render_radiance(shot, progress=Silent(), timer=Timings())
    count = [0]
    original = radiance_module._replicate

    def counted(*args):
        count[0] += 1
        if count[0] == 2:
            raise Stopped
        return original(*args)

    monkeypatch.setattr(radiance_module, "_replicate", counted)
    kept = unfinished("test", str(until), mode)
    assert kept is not None
    with pytest.raises(Stopped):
        render_radiance(shot, progress=Silent(), timer=Timings(), kept=kept)
    assert count == [2]
    again = render_radiance(shot, progress=Silent(), timer=Timings(), kept=unfinished("test", str(until), mode))
    for name in ("mean", "variance", "samples", "relative_error", "relative_error_p95", "stopped_by"):
        np.testing.assert_array_equal(getattr(again, name), getattr(whole, name))
    slices = count[0] - 1  # of both runs
    count[0] = 10**6
    render_radiance(shot, progress=Silent(), timer=Timings())
    assert slices == count[0] - 10**6  # none was rendered twice
    assert kept.read()[0].slices == 0  # nothing is left behind


def test_a_killed_process_loses_little(monkeypatch):
    """Without an interruption that Python sees: what was written last is there."""
    monkeypatch.setattr(radiance_module, "EVERY_S", 0.0)
    kept = unfinished("killed")
    assert kept is not None
    total = SliceSum().added(np.ones((2, 2, 3)), 2)
    kept.read()
    kept.write(total, 1.5)
    found, elapsed_s = unfinished("killed").read()
    assert (found.samples, found.slices, elapsed_s) == (2, 1, 1.5)
    kept.store.write(kept.key, b"cut short")
    again, elapsed_s = kept.read()
    assert (again.samples, again.slices, elapsed_s) == (0, 0, 0.0)


def test_another_recipe_or_camera_finds_nothing():
    keys = {unfinished(*identity).key for identity in (("a", 1, "c"), ("b", 1, "c"), ("a", 2, "c"), ("a", 1, "d"))}
    assert len(keys) == 4


def test_time_budget_of_a_scene():
    spec = stand((24, 14))
    one = radiance(replace(spec), StoppingCriterion(4, time_budget_s=0.5, most_samples=10**6), 1)
    assert one.stopped_by == "time_budget_s"
    assert one.samples > 4
