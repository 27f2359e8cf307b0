"""Lines on the ground that paths and streams run along: smooth at corners, of uneven width."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Floats

STEP_M = 0.1
_ROUNDS = 4  # of cutting corners
_UNEVEN = 12  # waves of a line's unevenness

Ints = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Course:
    """A line through places every `STEP_M`."""

    places_m: Floats  # (K, 2)
    uneven: Floats  # (K,) of mean 0 and variance 1, even over some metres

    @classmethod
    def through(cls, points_m: tuple[tuple[float, float], ...], rng: np.random.Generator) -> Course:
        """A line along points, its corners cut (Chaikin 1974)."""
        line = np.asarray(points_m, dtype=np.float64)
        for _ in range(_ROUNDS):
            first, second = line[:-1], line[1:]
            cut = np.stack([0.75 * first + 0.25 * second, 0.25 * first + 0.75 * second], axis=1).reshape(-1, 2)
            line = np.concatenate([line[:1], cut, line[-1:]])
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        at = np.linspace(0.0, along[-1], max(2, int(np.ceil(along[-1] / STEP_M)) + 1))
        wave = 2.0 * np.pi / (1.5 * 8.0 ** rng.random(_UNEVEN))  # of 1.5 to 12 m
        waves = np.sin(at[:, None] * wave + 2.0 * np.pi * rng.random(_UNEVEN))
        places = np.stack([np.interp(at, along, axis) for axis in line.T], axis=1)
        return cls(places, np.sqrt(2.0 / _UNEVEN) * waves.sum(axis=1))

    @cached_property
    def _tree(self) -> Any:
        from scipy.spatial import cKDTree  # late: half a second

        return cKDTree(self.places_m)

    @cached_property
    def _along(self) -> Floats:
        """(K, 2) unit vectors."""
        along = np.gradient(self.places_m, axis=0)
        return np.asarray(along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12))

    def nearest(self, x_m: Floats, y_m: Floats, reach_m: float) -> tuple[Ints, Floats, Floats]:
        """(M,) rows of the points (N,) within reach of the line, (M,) their distance, and where on the line: (M,)
        numbers of places, between them in fractions.
        """
        low, high = self.places_m.min(axis=0) - reach_m, self.places_m.max(axis=0) + reach_m
        near = np.flatnonzero((x_m > low[0]) & (x_m < high[0]) & (y_m > low[1]) & (y_m < high[1]))
        points = np.column_stack([x_m[near], y_m[near]])
        distance, place = self._tree.query(points, distance_upper_bound=reach_m)
        found = np.isfinite(distance)
        points, place = points[found], place[found].astype(np.intp)
        beside = points - self.places_m[place]
        ahead = np.sum(beside * self._along[place], axis=1)
        step_m = float(np.linalg.norm(self.places_m[1] - self.places_m[0]))
        first, last = np.where(place > 0, -0.5, 0.0), np.where(place < len(self.places_m) - 1, 0.5, 0.0)
        ahead = np.clip(ahead / step_m, first, last)
        beside -= step_m * ahead[:, None] * self._along[place]
        return near[found], np.hypot(*beside.T), place + ahead

    def between(self, values: Floats, where: Floats) -> Floats:
        """(M,) of values (K,) at numbers of places."""
        return np.interp(where, np.arange(len(values)), values)

    def across_m(self, offsets_m: Floats) -> Floats:
        """(K, M, 2) places beside the line, to its left by offsets (M,)."""
        left = np.stack([-self._along[:, 1], self._along[:, 0]], axis=1)
        return np.asarray(self.places_m[:, None] + offsets_m[:, None] * left[:, None])
