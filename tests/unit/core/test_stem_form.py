"""The taper of stems against measured trees."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from forestgen.core.stem_form import stem_radius_m, volume_above_m3

BEECHES = Path(__file__).parents[1] / "plants" / "data" / "beech_trees.csv"
KG_PER_M3 = 570.0  # dry wood of beech over its fresh volume


def volume_m3(height_m: float, dbh_m: float) -> float:
    at_m = np.linspace(0.0, height_m, 2001)
    return float(np.trapezoid(np.pi * stem_radius_m(at_m, height_m, dbh_m) ** 2, at_m))


def test_the_diameter_is_that_at_breast_height() -> None:
    assert 2.0 * stem_radius_m(np.array([1.3]), 20.0, 0.3)[0] == pytest.approx(0.3)
    assert stem_radius_m(np.array([20.0, 25.0]), 20.0, 0.3).tolist() == [0.0, 0.0]


@pytest.mark.parametrize(("low", "high"), [(10, 15), (15, 20), (20, 25), (25, 30), (30, 40)])
def test_stems_weigh_as_measured_beeches(low: float, high: float) -> None:
    """Median of measured over computed stem mass within 15%."""
    trees = pd.read_csv(BEECHES)
    trees = trees[(trees.height_m >= low) & (trees.height_m < high)]
    computed = [KG_PER_M3 * volume_m3(h, d) for h, d in zip(trees.height_m, trees.dbh_m, strict=True)]
    assert len(trees) >= 10
    assert np.median(trees.stem_kg / computed) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("from_m", [0.0, 1.3, 9.0, 13.0, 15.9, 16.0])
def test_volume_above_is_the_integral_of_the_taper(from_m: float) -> None:
    at_m = np.linspace(from_m, 16.0, 20_001)
    expected = np.trapezoid(np.pi * stem_radius_m(at_m, 16.0, 0.25) ** 2, at_m)
    found = volume_above_m3(np.array([from_m]), np.array([16.0]), np.array([0.25]))
    assert found == pytest.approx(expected, rel=1e-5, abs=1e-12)


def test_tops_are_cones() -> None:
    radius_m = stem_radius_m(np.array([14.0, 15.0, 15.5]), 16.0, 0.25)
    np.testing.assert_allclose(radius_m / radius_m[2], [4.0, 2.0, 1.0])
