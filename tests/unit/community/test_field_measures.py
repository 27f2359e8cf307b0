"""Patterns of fields that are drawn, not grown: every measure has its answer beforehand."""

from __future__ import annotations

import numpy as np
import pytest

from support.field_measures import measure_field, radial_spectrum, skewness, waves
from support.persistence import field_features

SIZE_M = (120.0, 80.0)
X, Y = np.meshgrid((np.arange(120) + 0.5), (np.arange(80) + 0.5))


def dots() -> np.ndarray:
    """4 x 6 hills, 20 m apart."""
    return np.exp(-10 * (np.sin(np.pi * X / 20) ** 2 + np.sin(np.pi * Y / 20) ** 2))


@pytest.mark.parametrize("wavelength_m", [10.0, 20.0, 40.0])
@pytest.mark.parametrize("periodic", [True, False])
def test_a_wave_is_found(wavelength_m: float, periodic: bool) -> None:
    found = waves(5 + np.cos(2 * np.pi * X / wavelength_m), SIZE_M, periodic=periodic)
    assert found.wavelength_m == pytest.approx(wavelength_m, rel=0.05)
    assert found.sharpness > 0.85
    assert found.anisotropy > (0.95 if periodic else 0.8)  # a window blurs across three waves
    assert found.direction_rad == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("turn", [-1, 1])
def test_the_direction_is_across_the_stripes(turn: int) -> None:
    stripes = np.cos(2 * np.pi * (2 * X / 40 + turn * Y / 20))
    assert waves(stripes, SIZE_M, periodic=True).direction_rad == pytest.approx(turn * np.pi / 4)
    assert waves(stripes.T, SIZE_M[::-1], periodic=True).direction_rad == pytest.approx(turn * np.pi / 4)


def test_waves_of_all_directions_have_none() -> None:
    noise = np.random.default_rng(0).standard_normal((80, 80))
    assert waves(noise, (80.0, 80.0), periodic=True).anisotropy < 0.05
    assert waves(dots(), SIZE_M, periodic=True).anisotropy < 1e-9


def test_the_spectrum_holds_the_variance() -> None:
    field = np.random.default_rng(0).random((80, 120))
    _, power = radial_spectrum(field, SIZE_M, periodic=True)
    assert power.sum() / field.size**2 == pytest.approx(field.var())


def test_dots_are_islands_and_their_reverse_lakes() -> None:
    spots = measure_field(dots(), SIZE_M, threshold=0.5, periodic=True)
    gaps = measure_field(1 - dots(), SIZE_M, threshold=0.5, periodic=True)
    assert (spots.islands, spots.lakes) == (24, 0)
    assert (gaps.islands, gaps.lakes) == (1, 23)  # one is the torus's sea
    assert measure_field(1 - dots(), SIZE_M, threshold=0.5, periodic=False).lakes == 15  # cut ones are open
    assert spots.skewness > 1
    assert gaps.skewness == pytest.approx(-spots.skewness)
    assert gaps.cover == pytest.approx(1 - spots.cover)
    assert spots.waves.wavelength_m == pytest.approx(20.0, rel=0.05)


def test_a_field_without_contrast() -> None:
    flat = measure_field(np.full((8, 9), 3.0), (9.0, 8.0), threshold=1.0, periodic=True)
    assert (flat.mean, flat.cover, flat.contrast, flat.skewness, flat.islands, flat.lakes) == (3.0, 1.0, 0, 0, 0, 0)
    assert np.isnan(flat.waves.wavelength_m)
    empty = measure_field(np.zeros((8, 9)), (9.0, 8.0), threshold=1.0, periodic=False)
    assert (empty.cover, empty.contrast, empty.islands) == (0.0, 0.0, 0)
    faint = measure_field(np.eye(8) * 1e-170, (8.0, 8.0), threshold=1.0, periodic=True)
    assert (faint.cover, faint.skewness, faint.islands) == (0.0, 0.0, 0)


def test_skewness_is_that_of_the_distribution() -> None:
    values = np.random.default_rng(0).exponential(2.0, (300, 300))
    assert skewness(values) == pytest.approx(2.0, rel=0.1)


def test_islands_and_lakes_live_between_their_levels() -> None:
    field = np.zeros((7, 7))
    field[1:6, 1:6] = 3.0  # a ring of land around a pond of level 1, and a hill of 5 on it
    field[2:5, 2:5] = 1.0
    field[1, 1] = 5.0
    for periodic in (False, True):
        assert field_features(field, 0, periodic=periodic) == pytest.approx(np.array([[5.0, 0.0]]))
        assert field_features(field, 1, periodic=periodic) == pytest.approx(np.array([[3.0, 1.0]]))


def test_a_second_hill_joins_the_higher_one() -> None:
    field = np.array([[0.0, 4.0, 2.0, 3.0, 0.0]] + [[0.0] * 5] * 2)
    assert field_features(field, 0, periodic=False) == pytest.approx(np.array([[4.0, 0.0], [3.0, 2.0]]))
    assert field_features(field, 1, periodic=False).shape == (0, 2)


def test_a_band_around_the_torus_is_no_lake() -> None:
    field = np.zeros((6, 8))
    field[2] = 1.0
    assert field_features(field, 1, periodic=True).shape == (0, 2)


@pytest.mark.parametrize(
    ("field", "dimension", "said"),
    [(np.zeros(4), 0, "two axes"), (np.full((2, 2), np.nan), 0, "finite"), (np.zeros((2, 2)), 2, "dimension")],
)
def test_what_has_no_features(field: np.ndarray, dimension: int, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        field_features(field, dimension, periodic=False)
