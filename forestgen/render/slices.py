"""Independent replicates of an image, averaged; their scatter gives the variance of the mean.

No samples need be independent inside a slice (a stratified sampler's are not).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.render.settings import MOST_SLICE_SAMPLES, SLICES


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

    def state(self) -> dict[str, NDArray[Any]]:
        """Arrays from which `restored` makes the same sum, to the last bit."""
        return {"counts": np.array([self.samples, self.slices]), "mean": self.mean, "scatter": self.scatter}

    @classmethod
    def restored(cls, state: Mapping[str, NDArray[Any]]) -> SliceSum:
        samples, slices = (int(value) for value in state["counts"])
        return cls(samples, slices, state["mean"], state["scatter"])


def slice_sizes(samples: int) -> list[int]:
    """Samples of each slice: nearly equal ones, at least two if there are two samples."""
    count = min(samples, max(SLICES, -(-samples // MOST_SLICE_SAMPLES)))
    return [samples // count + (1 if k < samples % count else 0) for k in range(count)]
