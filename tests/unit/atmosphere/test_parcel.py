"""Clouds predicted from soundings: Fig. 24's figures, the paper's rules of Fig. 23, and thermals that make none."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forestgen.atmosphere.sounding import GRAVITY_M_PER_S2, Sounding, geopotential_m, saturation_ratio
from support.dew_point import dew_point_k
from support.humid_air import dry_adiabat, moist_adiabat
from support.parcel import FIG24, Sky, Thermal, predict_cloud, prediction_of, thermal_profiles
from support.soundings import check_sounding, sounding_of_lapse_rates

PUBLISHED_M = {"stratocumulus": (1800.0, 2000.0), "cumulus": (1500.0, 2500.0), "cumulonimbus": (1500.0, 8000.0)}


def plain_air(lapse: float = -0.0065, *, humidity: float = 0.0) -> Sounding:
    """One lapse rate all the way up."""
    return sounding_of_lapse_rates(
        ground_temperature_k=290.0,
        lapse_rate_k_per_m=lapse,
        inversion_m=15_000.0,
        lapse_rate_above_k_per_m=0.0,
        relative_humidity=humidity,
    )


@pytest.mark.parametrize("name", PUBLISHED_M)
def test_fig_24s_bases_and_tops(name: str) -> None:
    cloud = FIG24[name].prediction()
    base, top = PUBLISHED_M[name]
    assert cloud
    assert cloud.base_m == pytest.approx(base, rel=0.1)
    assert cloud.top_m == pytest.approx(top, rel=0.1)


@pytest.mark.parametrize("latent_heat", [False, True])
def test_fig_24s_fog_lies_on_the_ground_and_is_some_tens_of_metres_thick(latent_heat: bool) -> None:
    cloud = replace(FIG24["fog"], latent_heat=latent_heat).prediction()
    assert cloud.base_m == 0.0
    assert cloud.top_m is not None
    assert 20.0 <= cloud.top_m <= 60.0
    assert cloud.fastest_m_per_s < 1.0  # "vanishing buoyancy at ground level"


@pytest.mark.parametrize("name", ["stratocumulus", "cumulus"])
def test_fair_weather_clouds_are_the_same_with_latent_heat_on(name: str) -> None:
    cloud = replace(FIG24[name], latent_heat=True).prediction()
    base, top = PUBLISHED_M[name]
    assert cloud.base_m == pytest.approx(base, rel=0.1)
    assert cloud.top_m == pytest.approx(top, rel=0.1)


def test_the_thunderhead_spreads_under_its_inversion() -> None:
    sky = FIG24["cumulonimbus"]
    cloud = sky.prediction()
    assert cloud.spreads
    assert cloud.top_m == cloud.neutral_m
    assert sky.inversion_m < cloud.neutral_m < 1.1 * sky.inversion_m
    lift = thermal_profiles(sky.sounding(), sky.thermal(), top_m=sky.inversion_m).buoyancy_m_per_s2
    assert (lift > 0.0).all()  # "constant upward acceleration of the thermal to the inversion layer"


def test_without_latent_heat_a_thunderhead_takes_nearly_the_dry_lapse_rate() -> None:
    sky = replace(FIG24["cumulonimbus"], latent_heat=False)
    assert (sky.prediction().top_m or 0.0) < 5000.0
    steep = replace(sky, lapse_rate_k_per_m=-0.0094).prediction()
    assert steep.base_m == pytest.approx(1500.0, rel=0.1)
    assert steep.top_m == pytest.approx(8000.0, rel=0.1)
    assert steep.spreads


@pytest.mark.parametrize("name", FIG24)
def test_fig_24s_parameters_are_weather(name: str) -> None:
    sky = FIG24[name]
    air = sky.sounding()
    check_sounding(air)
    # No layer is steeper than the dry adiabat, and thermals are no hotter than over sunlit ground.
    theta = air.potential_temperature_at(air.height_m)
    assert (np.diff(theta) > 0.0).all()
    assert 0.0 < sky.excess_k <= 3.0
    assert sky.thermal_vapour > air.vapour[0]
    assert sky.thermal_vapour <= 1.02 * saturation_ratio(sky.thermal().temperature_k, 101_325.0)
    cloud = sky.prediction()
    assert cloud.top_m is not None
    assert cloud.top_m < sky.domain_m


@settings(max_examples=30)
@given(excess=st.floats(0.5, 4.0), lapse=st.floats(-0.0085, -0.003))
def test_the_lift_of_dry_air_ends_where_the_adiabat_meets_the_air_and_its_motion_twice_as_high(
    excess: float, lapse: float
) -> None:
    """Fig. 23a: h0 and 2 h0 of buoyancy that is linear by height."""
    cloud = predict_cloud(plain_air(lapse), Thermal(290.0 + excess, 0.0))
    dry = GRAVITY_M_PER_S2 / (3.5 * 8314.0 / 28.96)  # g / c_p
    # By Eqs. 16 and 23 both temperatures are powers of the pressure; where they are equal:
    ratio = (1.0 + excess / 290.0) ** (1.0 / (1.0 - dry / -lapse))
    assert geopotential_m(cloud.neutral_m) == pytest.approx(290.0 * (1.0 - ratio) / -lapse, rel=1e-3)
    assert not cloud
    work = thermal_profiles(plain_air(lapse), Thermal(290.0 + excess, 0.0)).work_j_per_kg
    assert cloud.fastest_m_per_s == pytest.approx(math.sqrt(2 * work.max()), rel=1e-3)
    top = float(cloud.reason.split(" at ")[1].split(" m ")[0])
    assert top == pytest.approx(2 * cloud.neutral_m, rel=0.07)


def test_the_work_of_a_linear_buoyancy_is_its_triangle() -> None:
    cloud = predict_cloud(plain_air(), Thermal(292.0, 0.0))
    triangle = GRAVITY_M_PER_S2 * 2.0 / 290.0 * cloud.neutral_m / 2.0
    assert cloud.fastest_m_per_s == pytest.approx(math.sqrt(2 * triangle), rel=0.02)


@settings(max_examples=30)
@given(celsius=st.floats(0.0, 30.0), humidity=st.floats(0.2, 0.95))
def test_the_base_is_where_the_dry_adiabat_reaches_the_dew_point(celsius: float, humidity: float) -> None:
    air, warmth = plain_air(), celsius + 273.15
    thermal = Thermal(warmth, humidity * float(saturation_ratio(warmth, 101_325.0)))
    base = thermal_profiles(air, thermal, latent_heat=False, top_m=6000.0).saturated_m
    assert base is not None
    pressure = air.pressure_at(base)
    there = dry_adiabat(warmth, 101_325.0, pressure, thermal.vapour)
    assert float(there) == pytest.approx(float(dew_point_k(thermal.vapour, pressure)), abs=2e-3)
    # The rule of thumb, 125 m for each degree between temperature and dew point.
    spread = warmth - float(dew_point_k(thermal.vapour, 101_325.0))
    assert base == pytest.approx(125.0 * spread, rel=0.06)


def test_latent_heat_leaves_the_base_and_raises_the_top() -> None:
    air, thermal = plain_air(-0.006, humidity=0.3), Thermal(293.0, 0.009)
    off, on = (predict_cloud(air, thermal, latent_heat=heat) for heat in (False, True))
    assert off.base_m == on.base_m
    assert (on.top_m or 0.0) > (off.top_m or 0.0) > (off.base_m or 0.0)


def test_a_wet_thermal_is_on_its_moist_adiabat_and_its_water_is_conserved_below() -> None:
    air, thermal = plain_air(-0.007, humidity=0.3), Thermal(293.0, 0.009)
    rising = thermal_profiles(air, thermal, top_m=9000.0)
    base = rising.saturated_m
    assert base is not None
    wet = rising.height_m > base
    np.testing.assert_allclose(rising.thermal_relative_humidity[wet], 1.0, rtol=1e-2)
    assert (rising.thermal_vapour[~wet] == thermal.vapour).all()
    assert (np.diff(rising.thermal_vapour[wet]) < 0.0).all()
    pressure = air.pressure_at(np.array([base, 6000.0]))
    at_base = float(np.interp(base, rising.height_m, rising.thermal_temperature_k))
    expected = moist_adiabat(at_base, float(pressure[0]), pressure[1:])[0]
    assert np.interp(6000.0, rising.height_m, rising.thermal_temperature_k) == pytest.approx(expected, abs=0.05)


def test_profiles_are_those_of_the_air_and_of_one_pressure() -> None:
    sky = FIG24["cumulus"]
    air = sky.sounding()
    p = thermal_profiles(air, sky.thermal(), latent_heat=False, top_m=4000.0)
    assert p.height_m[0] == 0.0
    assert p.height_m[-1] == 4000.0
    assert (np.diff(p.height_m) > 0.0).all()
    np.testing.assert_allclose(p.air_temperature_k, air.temperature_at(p.height_m))
    np.testing.assert_allclose(p.air_relative_humidity, air.relative_humidity_at(p.height_m), rtol=1e-12)
    lift = GRAVITY_M_PER_S2 * (p.air_density_kg_per_m3 / p.thermal_density_kg_per_m3 - 1.0)
    np.testing.assert_allclose(p.buoyancy_m_per_s2, lift, atol=1e-12)
    assert p.thermal_temperature_k[0] == pytest.approx(sky.ground_temperature_k + sky.excess_k)


def test_a_thermal_that_is_no_lighter_does_not_rise() -> None:
    cold = predict_cloud(plain_air(), Thermal(289.0, 0.0))
    assert not cold
    assert cold.base_m is None
    assert cold.reason == "the thermal is not lighter than the air at the ground: it does not rise"
    dew = predict_cloud(plain_air(humidity=1.0), Thermal(288.0, 0.012))
    assert not dew
    assert "saturated, but not lighter" in dew.reason


def test_a_dry_thermal_comes_to_rest_below_saturation() -> None:
    blue = predict_cloud(plain_air(), Thermal(291.0, 0.003))
    assert not blue
    assert "comes to rest at" in blue.reason
    assert "below 1" in blue.reason
    assert blue.neutral_m > 0.0


def test_an_inversion_stops_what_would_go_on() -> None:
    """Fig. 23b, and that a lower inversion makes a lower top."""
    tops = []
    for inversion_m in (2000.0, 3000.0, 4000.0):
        sky = Sky(290.0, -0.009, inversion_m, 0.03, inversion_m + 500.0, 0.3, 2.5, 0.006, 6000.0, latent_heat=True)
        cloud = sky.prediction()
        assert cloud.spreads
        assert cloud.top_m is not None
        assert inversion_m < cloud.top_m < inversion_m + 500.0
        tops.append(cloud.top_m)
    assert tops == sorted(tops)


def test_a_thermal_still_rising_at_the_highest_height_ends_there() -> None:
    sky = FIG24["cumulonimbus"]
    cloud = prediction_of(thermal_profiles(sky.sounding(), sky.thermal(), top_m=5000.0))
    assert cloud.top_m == 5000.0
    assert not cloud.spreads
