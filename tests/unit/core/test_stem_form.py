"""The taper of stems against measured trees."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from forestgen.core.stem_form import stem_radius_m

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
