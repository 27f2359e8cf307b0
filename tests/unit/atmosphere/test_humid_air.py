"""Humid air: published values, the exact mixture, and the dry and saturated limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from forestgen.atmosphere.sounding import AIR_EXPONENT, GRAVITY_M_PER_S2, LATENT_HEAT_J_PER_KG, saturation_ratio
from support.dew_point import dew_point_k
from support.humid_air import (
    buoyancy_m_per_s2,
    density_kg_per_m3,
    dry_adiabat,
    heat_capacity_j_per_kg_k,
    isentropic_exponent,
    mass_fraction_of_ratio,
    moist_adiabat,
    molar_mass,
    mole_fraction_of_ratio,
    saturation_pressure_pa,
)

AIR, WATER, R = 28.96, 18.02, 8314.0
ratios = st.floats(0.0, 0.04, allow_subnormal=False)
warmths = st.floats(230.0, 310.0)


@pytest.mark.parametrize(("celsius", "hpa"), [(5.0, 8.72), (18.0, 20.63)])
def test_saturation_pressure_has_its_published_values(celsius: float, hpa: float) -> None:
    assert saturation_pressure_pa(celsius + 273.15) == pytest.approx(100 * hpa, rel=1e-3)


def test_the_moist_adiabat_has_its_published_value() -> None:
    end = moist_adiabat(293.0, 100_000.0, np.array([80_000.0, 60_000.0]))[-1]
    assert end == pytest.approx(272.81, rel=1e-4)


@given(q=ratios)
def test_fractions_are_those_of_one_kilogram_of_air_and_q_of_water(q: float) -> None:
    y, x = mass_fraction_of_ratio(q), mole_fraction_of_ratio(q)
    assert float(y) == pytest.approx(q / (1 + q), rel=1e-12)
    assert float(x) == pytest.approx((q / WATER) / (q / WATER + 1 / AIR), rel=1e-12)
    assert float(x * WATER / molar_mass(x)) == pytest.approx(float(y), rel=1e-12, abs=1e-15)
    # The mass of a kilomole is the mass of all over the kilomoles of all.
    assert float(molar_mass(x)) == pytest.approx((1 + q) / (q / WATER + 1 / AIR), rel=1e-12)
    assert x >= y


@given(q=st.floats(0.0, 0.02))
def test_eq_24_is_close_to_the_exact_mixture(q: float) -> None:
    x = float(mole_fraction_of_ratio(q))
    exact = 1 + 1 / (x / 0.33 + (1 - x) / 0.4)
    assert float(isentropic_exponent(mass_fraction_of_ratio(q))) == pytest.approx(exact, rel=1e-3)


def test_heat_capacity_of_dry_air_and_of_the_mixture() -> None:
    assert heat_capacity_j_per_kg_k(0.0) == pytest.approx(1.4 / 0.4 * R / AIR, rel=1e-12)
    assert heat_capacity_j_per_kg_k(0.0) == pytest.approx(1004.7, rel=1e-3)
    q = 0.015
    by_mass = (1.4 / 0.4 * R / AIR + q * 1.33 / 0.33 * R / WATER) / (1 + q)
    assert heat_capacity_j_per_kg_k(q) == pytest.approx(by_mass, rel=1e-2)
    assert heat_capacity_j_per_kg_k(q) > heat_capacity_j_per_kg_k(0.0)


@given(warm=warmths, q=ratios, air=warmths, q_air=ratios, p=st.floats(20_000.0, 105_000.0))
def test_buoyancy_is_that_of_the_densities(warm: float, q: float, air: float, q_air: float, p: float) -> None:
    """Eq. 28 against Eq. 26 with Eq. 27's densities."""
    by_density = density_kg_per_m3(air, p, q_air) / density_kg_per_m3(warm, p, q) - 1.0
    got = float(buoyancy_m_per_s2(warm, q, air, q_air))
    assert got == pytest.approx(GRAVITY_M_PER_S2 * float(by_density), rel=1e-9, abs=1e-12)


def test_warm_and_humid_air_rises() -> None:
    assert buoyancy_m_per_s2(290.0, 0.0, 290.0) == 0.0
    assert buoyancy_m_per_s2(291.0, 0.0, 290.0) == pytest.approx(GRAVITY_M_PER_S2 / 290.0, rel=1e-9)
    assert buoyancy_m_per_s2(290.0, 0.01, 290.0) == pytest.approx(0.01 * (AIR / WATER - 1) * GRAVITY_M_PER_S2, rel=0.02)
    assert buoyancy_m_per_s2(290.0, 0.0, 290.0, 0.01) < 0.0


def test_dry_air_cools_with_the_dry_exponent() -> None:
    p = np.array([100_000.0, 70_000.0, 30_000.0])
    np.testing.assert_allclose(dry_adiabat(300.0, 1e5, p), 300.0 * (p / 1e5) ** AIR_EXPONENT, rtol=1e-12)
    # Vapour has more ways to keep heat: humid air cools a little less.
    assert (dry_adiabat(300.0, 1e5, p[1:], 0.02) > dry_adiabat(300.0, 1e5, p[1:])).all()


@given(celsius=st.floats(-60.0, 40.0), p=st.floats(20_000.0, 105_000.0))
def test_the_dew_point_undoes_saturation(celsius: float, p: float) -> None:
    q = float(saturation_ratio(celsius + 273.15, p))
    assert float(dew_point_k(q, p)) == pytest.approx(celsius + 273.15, abs=1e-8)


def test_no_vapour_has_no_dew_point() -> None:
    np.testing.assert_array_equal(dew_point_k(np.array([0.0, 0.0]), 1e5), 0.0)


def test_eq_29_is_the_saturation_pressure_over_a_share_of_the_air() -> None:
    celsius, p = np.array([-20.0, 0.0, 18.0, 30.0]), 101_325.0
    e = saturation_pressure_pa(celsius + 273.15)
    exact = WATER / AIR * e / (p - e)
    np.testing.assert_allclose(saturation_ratio(celsius + 273.15, p), 0.622 * e / p, rtol=1e-4)
    off = 1.0 - saturation_ratio(celsius + 273.15, p) / exact
    assert (off[:3] < 0.022).all()  # the page's 2% at 18 °C
    assert off[3] < 0.045


def test_cold_air_that_is_saturated_cools_as_dry_air_does() -> None:
    """The moist adiabat's dry limit: at -90 °C there is nothing left to condense."""
    p = np.array([30_000.0, 20_000.0, 10_000.0])
    np.testing.assert_allclose(moist_adiabat(183.0, 30_000.0, p), dry_adiabat(183.0, 30_000.0, p), rtol=1e-4)


def test_the_moist_adiabat_lies_between_the_dry_one_and_no_cooling() -> None:
    p = np.linspace(1e5, 2e4, 30)
    moist = moist_adiabat(300.0, 1e5, p)
    assert moist[0] == pytest.approx(300.0)
    assert (np.diff(moist) < 0.0).all()
    assert (moist[1:] > dry_adiabat(300.0, 1e5, p[1:])).all()


def test_the_moist_adiabat_does_not_depend_on_the_heights_asked_for() -> None:
    coarse = moist_adiabat(295.0, 95_000.0, np.array([30_000.0]))[-1]
    fine = moist_adiabat(295.0, 95_000.0, np.linspace(95_000.0, 30_000.0, 400))[-1]
    assert coarse == pytest.approx(fine, abs=1e-5)


def test_the_moist_adiabat_conserves_energy() -> None:
    """c_p dT - dp / rho + L dq = 0, by quadrature of the curve itself, with the exact ratio of saturation."""
    p = np.linspace(1e5, 4e4, 4001)
    warmth = moist_adiabat(295.0, 1e5, p)
    e = saturation_pressure_pa(warmth)
    q = WATER / AIR * e / (p - e)
    middle = 0.5 * (warmth[1:] + warmth[:-1])
    gained = heat_capacity_j_per_kg_k(0.0) * np.diff(warmth) - R / AIR * middle * np.diff(np.log(p))
    released = -LATENT_HEAT_J_PER_KG * np.diff(q)
    assert gained.sum() == pytest.approx(released.sum(), rel=1e-5)


def test_the_moist_adiabat_against_a_solver_from_a_library() -> None:
    def slope(log_p: float, state: np.ndarray) -> list[float]:
        warmth, p = float(state[0]), float(np.exp(log_p))

        def ratio(t: float) -> float:
            e = float(saturation_pressure_pa(t))
            return WATER / AIR * e / (p - e)

        def by_pressure(factor: float) -> float:
            e = float(saturation_pressure_pa(warmth))
            return WATER / AIR * e / (p * factor - e)

        h = 1e-3
        by_warmth = (ratio(warmth + h) - ratio(warmth - h)) / (2 * h)
        by_log_p = (by_pressure(1 + 1e-6) - by_pressure(1 - 1e-6)) / 2e-6
        c_p = 1.4 / 0.4 * R / AIR
        latent = LATENT_HEAT_J_PER_KG
        return [(R / AIR * warmth - latent * by_log_p) / (c_p + latent * by_warmth)]

    ends = (float(np.log(1e5)), float(np.log(3e4)))
    solved = solve_ivp(slope, ends, [300.0], rtol=1e-9, atol=1e-9).y[0, -1]
    assert moist_adiabat(300.0, 1e5, np.array([3e4]))[-1] == pytest.approx(solved, abs=1e-3)


@pytest.mark.parametrize("pressures", [[90_000.0, 95_000.0], [101_000.0, 90_000.0]])
def test_a_moist_adiabat_downwards_is_refused(pressures: list[float]) -> None:
    with pytest.raises(ValueError, match="followed upwards"):
        moist_adiabat(290.0, 100_000.0, np.array(pressures))
