"""Samples that may differ: those within rounding error of an edge."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from forestgen.render.identity import sample_offsets
from forestgen.scene.spec import SceneSpec
from support.twins import Oracle

TIE_PX = 1e-4  # float32 directions and positions place an edge to within about 4e-5 px at the tests' sizes
MOST_TIES = 2e-5  # of all samples


class Samples(Protocol):
    """What samples hit, (H, W, S) each."""

    @property
    def plant_id(self) -> NDArray[np.uint32]: ...
    @property
    def part(self) -> NDArray[np.uint8]: ...


def assert_ties(
    spec: SceneSpec, one: Samples, other: Samples, tie_px: float = TIE_PX, most: float = MOST_TIES, camera: int = 0
) -> int:
    """Where plants or parts differ, exact rays within `tie_px` of the sample meet both; returns the number of ties."""
    differ = (one.plant_id != other.plant_id) | (one.part != other.part)
    assert differ.mean() <= most
    if not differ.any():
        return 0
    oracle, offsets = Oracle(spec, spec.cameras[camera]), sample_offsets(differ.shape[2])
    for row, column, sample in np.argwhere(differ):
        x_px, y_px = np.array([column, row]) + offsets[sample]
        found = hits_around(oracle, x_px, y_px, tie_px)
        for samples in (one, other):
            hit = (int(samples.plant_id[row, column, sample]), int(samples.part[row, column, sample]))
            assert hit in found, f"{hit} at pixel ({column}, {row}), sample {sample}: exact rays meet {found}"
    return int(differ.sum())


def hits_around(oracle: Oracle, x_px: float, y_px: float, tie_px: float = TIE_PX) -> set[tuple[int, int]]:
    """(plant, part) hit by exact rays within `tie_px` of a point of the image."""
    angle = np.arange(16) / 16 * 2 * np.pi
    radius = tie_px * np.array([0.25, 0.5, 1.0])[:, None]
    hits = oracle.trace(x_px + radius * np.cos(angle), y_px + radius * np.sin(angle))
    return set(zip(hits.plant_id.tolist(), hits.part.tolist(), strict=True))
