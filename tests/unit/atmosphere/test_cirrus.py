"""Thin high clouds: how thick they are, and that they lie in streaks along the wind."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.atmosphere.clouds.cirrus import ICE, CirrusKeys, cirrus_field
from forestgen.atmosphere.grid import CloudGrid, check_clouds


def depth_of(wind: tuple[float, float], seed: int = 1, **keys: float) -> np.ndarray:
    asked = CirrusKeys(type="cirrus", **keys)
    field = cirrus_field(asked, wind, np.random.default_rng(seed))
    check_clouds(CloudGrid(field, (0.0, 0.0, 9000.0), (asked.extent_m, asked.extent_m, 9900.0), 1.0, ICE))
    return np.asarray(field.sum(axis=0, dtype=np.float64)) * asked.thickness_m / len(field)


def test_the_cloudy_part_has_the_optical_depth_asked_for() -> None:
    depth = depth_of((1.0, 0.0), cover=0.5, optical_depth=0.3, extent_m=45000.0)
    assert depth.mean() == pytest.approx(0.15, rel=0.01)
    assert 0.4 < (depth > 0.01).mean() < 0.8  # streaks reach out of their patches
    assert depth.max() < 5.0


@pytest.mark.parametrize("turn", [0.0, 0.6])
def test_streaks_lie_along_the_wind(turn: float) -> None:
    wind = (float(np.cos(turn)), float(np.sin(turn)))
    depth = depth_of(wind, cover=1.0)
    power = np.abs(np.fft.fft2(depth - depth.mean())) ** 2
    k = np.fft.fftfreq(len(depth))
    along, across = k[None] * wind[0] + k[:, None] * wind[1], k[None] * wind[1] - k[:, None] * wind[0]
    assert np.sum(power * across**2) > 10 * np.sum(power * along**2)


def test_ice_scatters_as_the_crystals_of_retrievals_do() -> None:
    assert ICE.asymmetry == pytest.approx(0.75, abs=0.005)
