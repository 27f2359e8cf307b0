"""Independent replicates of an image, how noisy their mean is, and how many samples it still needs.

The relative error of a pixel is its standard error over its value, both over all channels:

    e² = sum over c of (variance_c / s_c²) / sum over c of (max(mean_c, 0.1 s_c) / s_c)²,

where s_c is the channel's mean over the image: bands of different strength count alike, and a pixel darker than a tenth
of it is measured against that tenth. Variance and mean are first averaged over 3 x 3 pixels: the variance of one pixel
comes from a few replicates and is itself noisy, which would raise the percentile. `relative_error` is the mean of e
over the pixels, which a few bright specks do not move, `relative_error_p95` its 95th percentile. Pixels outside of a
fisheye's circle do not count.

e falls as 1 / sqrt(n). So an image with error e after n samples needs n (e / target)²; slices are at most a sixteenth
of that, and the need is judged anew after each, by all slices so far. The last slice is what is left.

Samples need not be independent inside a slice (a stratified sampler's are not): the scatter of slices gives the
variance of the mean.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.render.frame import StoppingCriterion
from forestgen.render.variant import MOST_SLICE_SAMPLES, SLICES

_FLOOR = 0.1
_WINDOW = 3
_SHARE_OF_NEED = 16
_FINEST = 64  # a slice is at least this share of the samples so far


@dataclass(frozen=True)
class Estimate:
    """Mean of slices and the variance of that mean; the variance is NaN for a single slice."""

    mean: NDArray[np.float64]
    variance: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SliceSum:
    """Weighted running mean and variance of slices of different length (West 1979); the same after an interruption."""

    samples: int = 0
    slices: int = 0
    mean: Any = 0.0  # (H, W, C)
    scatter: Any = 0.0  # (H, W, C) sum of samples x squared distance from the mean

    def added(self, image: NDArray[np.float64], samples: int) -> SliceSum:
        """The sum with one more slice."""
        weight = self.samples + samples
        difference = image - self.mean
        mean = self.mean + difference * (samples / weight)
        return SliceSum(weight, self.slices + 1, mean, self.scatter + samples * difference * (image - mean))

    def estimate(self) -> Estimate:
        if self.slices < 2:
            return Estimate(self.mean, np.full_like(self.mean, np.nan))
        return Estimate(self.mean, self.scatter / (self.samples * (self.slices - 1)))


def slice_sizes(samples: int) -> list[int]:
    """Samples of each slice: nearly equal ones, at least two if there are two samples."""
    count = min(samples, max(SLICES, -(-samples // MOST_SLICE_SAMPLES)))
    return [samples // count + (1 if k < samples % count else 0) for k in range(count)]


@dataclass(frozen=True)
class Noise:
    """Relative error of an image; NaN for a single slice."""

    relative_error: float
    relative_error_p95: float


def noise_of(estimate: Estimate, seen: NDArray[np.bool_]) -> Noise:
    """Of (H, W, C) mean and variance; `seen` are the (H, W) pixels that count."""
    from scipy.ndimage import uniform_filter

    if not np.isfinite(estimate.variance).all() or not seen.any():
        return Noise(math.nan, math.nan)
    scale = estimate.mean[seen].mean(axis=0)
    used = scale > 0
    if not used.any():
        return Noise(0.0, 0.0)  # no light
    size = (_WINDOW, _WINDOW, 1)
    share = np.maximum(uniform_filter(seen.astype(np.float64), _WINDOW, mode="constant"), 1e-9)[..., None]
    mean, variance = (
        uniform_filter(image[..., used] * seen[..., None], size, mode="constant") / share / scale[used] ** power
        for image, power in ((estimate.mean, 1), (estimate.variance, 2))
    )
    signal = (np.maximum(mean, _FLOOR) ** 2).sum(axis=2)
    error = np.sqrt(np.maximum(variance.sum(axis=2), 0.0) / signal)[seen]
    return Noise(float(error.mean()), float(np.quantile(error, 0.95)))


class Schedule:
    """Which slice comes next. A function of what has been done alone: interrupted work goes on the same."""

    def __init__(self, until: StoppingCriterion, passes: int, least: int = 1) -> None:
        """`least` is the number of samples below which a camera takes no pass.

        `first` are sizes of the slices that are always rendered (but for a time budget).
        """
        self._until, self._least = until, least
        self.first = [max(size, least) for size in slice_sizes(-(-until.samples // passes))]
        self._most = max(-(-until.most_samples // passes), sum(self.first))
        self.stopped_by = ""

    def next_size(self, total: SliceSum, noise: Noise, elapsed_s: float) -> int:
        """Samples of the next slice in each pass, 0 when the image is done, for the reason in `stopped_by`."""
        size = self._wanted(total, noise)
        budget_s = self._until.time_budget_s
        if size and budget_s is not None and total.slices >= min(2, len(self.first)):
            fits = int((budget_s - elapsed_s) / (elapsed_s / total.samples)) if elapsed_s > 0 else size
            if fits < 1:
                self.stopped_by = "time_budget_s"
            size = max(min(size, fits), 0)
        return size

    def asks_for_noise(self, total: SliceSum) -> bool:
        """Whether the next slice depends on the noise so far."""
        targets = (self._until.target_error, self._until.target_error_p95)
        return targets != (None, None) and total.slices >= len(self.first)

    def progress(self, total: SliceSum, noise: Noise, elapsed_s: float) -> float:
        """Share of the work that is done, at a guess."""
        if not total.samples:
            return 0.0
        need = min(self._need(total, noise), float(self._most)) if self._until.open_ended else float(sum(self.first))
        if self._until.time_budget_s is not None and elapsed_s > 0:
            need = min(need, total.samples * self._until.time_budget_s / elapsed_s)
        return min(total.samples / max(need, sum(self.first), 1.0), 1.0)

    def _wanted(self, total: SliceSum, noise: Noise) -> int:
        if total.slices < len(self.first):
            return self.first[total.slices]
        need = self._need(total, noise)
        if not self._until.open_ended:
            self.stopped_by = "samples"
        elif need <= total.samples:
            self.stopped_by = "target_error"
        elif total.samples >= self._most:
            self.stopped_by = "most_samples"
        if self.stopped_by:
            return 0
        need = min(need, float(self._most))
        size = max(self.first[0], min(int(need / _SHARE_OF_NEED), MOST_SLICE_SAMPLES))
        size = max(min(size, math.ceil(need - total.samples)), total.samples // _FINEST)
        return max(min(size, self._most - total.samples), self._least)

    def _need(self, total: SliceSum, noise: Noise) -> float:
        """Samples in each pass that the targets ask for."""
        errors = (noise.relative_error, noise.relative_error_p95)
        targets = (self._until.target_error, self._until.target_error_p95)
        ratios = [error / target for error, target in zip(errors, targets, strict=True) if target is not None]
        if not ratios or math.isnan(max(ratios)):
            return math.inf
        return total.samples * max(ratios) ** 2
