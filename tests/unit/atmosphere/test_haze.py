"""Haze by its visibility."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from forestgen.render.haze import ASYMMETRY, Haze, aerosol_phase, molecular_phase


def at(haze: Haze, wavelength_nm: float) -> float:
    return float(haze.extinction_per_m(np.array(wavelength_nm)))


@pytest.mark.parametrize("visibility_m", [1000.0, 5999.0, 20_000.0, 300_000.0])
def test_contrast_is_two_percent_at_the_range(visibility_m: float) -> None:
    assert np.exp(-at(Haze(visibility_m), 550.0) * visibility_m) == pytest.approx(0.02, rel=1e-3)


@pytest.mark.parametrize(
    ("visibility_m", "exponent"), [(2000.0, 0.585 * 2 ** (1 / 3)), (15_000.0, 1.3), (50_000.0, 1.6)]
)
def test_colour_is_kruses(visibility_m: float, exponent: float) -> None:
    """Kruse's exponents are of all the air: molecules among it."""
    haze = Haze(visibility_m)
    found = -np.log(at(haze, 650.0) / at(haze, 450.0)) / np.log(650.0 / 450.0)
    assert found == pytest.approx(exponent, abs=0.2)


def test_the_clearest_air_is_of_molecules() -> None:
    haze = Haze(337_000.0)
    assert at(haze, 400.0) / at(haze, 550.0) == pytest.approx((550 / 400) ** 4, rel=0.01)


@pytest.mark.parametrize(("phase", "asymmetry"), [(molecular_phase, 0.0), (aerosol_phase, ASYMMETRY)])
def test_phases_are_normal(phase, asymmetry: float) -> None:  # type: ignore[no-untyped-def]
    mean = quad(lambda c: float(phase(np.array(c))) / 2, -1, 1)[0]
    cosine = quad(lambda c: c * float(phase(np.array(c))) / 2, -1, 1)[0]
    assert (mean, cosine) == pytest.approx((1.0, asymmetry), abs=1e-6)
