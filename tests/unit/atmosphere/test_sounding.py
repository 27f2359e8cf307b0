"""Air at rest: published values, the hydrostatic equation, and what no air can be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from forestgen.atmosphere.sounding import (
    AUTOCONVECTION_K_PER_M,
    EARTH_RADIUS_M,
    GRAVITY_M_PER_S2,
    Sounding,
    geopotential_m,
    saturation_ratio,
)
from forestgen.atmosphere.weather_files import read_sounding
from forestgen.core.errors import AssetError
from support.error_messages import raises_error
from support.soundings import check_sounding, sounding_of_lapse_rates, standard_sounding


def mild(**changes: object) -> Sounding:
    given_values = {
        "ground_temperature_k": 288.15,
        "lapse_rate_k_per_m": -0.0065,
        "inversion_m": 8000.0,
        "lapse_rate_above_k_per_m": 0.0065,
        "top_m": 12_000.0,
        "relative_humidity": 0.5,
        **changes,
    }
    return sounding_of_lapse_rates(**given_values)  # type: ignore[arg-type]


def few(**changes: object) -> Sounding:
    """Three levels."""
    values = {
        "height_m": np.array([0.0, 1000.0, 3000.0]),
        "temperature_k": np.array([290.0, 283.0, 270.0]),
        "vapour": np.array([5e-3, 4e-3, 1e-3]),
        "wind_m_per_s": np.array([[1.0, 0.0], [2.0, 1.0], [4.0, -1.0]]),
        **changes,
    }
    return Sounding(**values)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("height_m", "temperature_k", "pressure_pa", "density"),
    [(0, 288.15, 101_325.0, 1.225), (5000, 255.6755, 54_048.262, 0.736429), (11_000, 216.7735, 22_699.937, 0.364801)],
)
def test_the_standard_atmosphere_has_its_published_values(
    height_m: float, temperature_k: float, pressure_pa: float, density: float
) -> None:
    air = standard_sounding()
    assert air.temperature_at(height_m) == pytest.approx(temperature_k, rel=1e-5)
    assert air.pressure_at(height_m) == pytest.approx(pressure_pa, rel=3e-4)
    assert air.density_at(height_m) == pytest.approx(density, rel=3e-4)


def test_eq_16_holds_where_gravity_is_constant() -> None:
    """By geopotential height, that of constant gravity, the pressure is the paper's power of the temperature."""
    air = mild(lapse_rate_k_per_m=-0.007)
    z = np.linspace(0.0, 8000.0, 33)
    gas_constant = 8314.0 / 28.96
    power = (1.0 - 0.007 * geopotential_m(z) / 288.15) ** (GRAVITY_M_PER_S2 / (gas_constant * 0.007))
    np.testing.assert_allclose(air.pressure_at(z), 101_325.0 * power, rtol=1e-9)


@given(
    ground_k=st.floats(250.0, 310.0),
    lapse=st.floats(-0.012, 0.01),
    above=st.floats(-0.004, 0.01),
    inversion_m=st.floats(50.0, 6000.0),
    height_m=st.floats(0.0, 12_000.0),
)
def test_pressure_is_in_hydrostatic_balance(
    ground_k: float, lapse: float, above: float, inversion_m: float, height_m: float
) -> None:
    """The numerical derivative of the pressure is minus density times gravity at that height (Eq. 14)."""
    air = mild(
        ground_temperature_k=ground_k,
        lapse_rate_k_per_m=lapse,
        inversion_m=inversion_m,
        lapse_rate_above_k_per_m=above,
    )
    h = 0.5
    slope = (air.pressure_at(height_m + h) - air.pressure_at(height_m - h)) / (2 * h)
    gravity = GRAVITY_M_PER_S2 * (EARTH_RADIUS_M / (EARTH_RADIUS_M + height_m)) ** 2
    assert float(slope) == pytest.approx(-float(air.density_at(height_m)) * gravity, rel=1e-5)


def test_an_isothermal_layer_falls_exponentially() -> None:
    air = mild(lapse_rate_k_per_m=0.0, lapse_rate_above_k_per_m=0.0)
    z = np.array([0.0, 3000.0, 9000.0])
    scale_m = 8314.0 / 28.96 * 288.15 / GRAVITY_M_PER_S2
    np.testing.assert_allclose(air.pressure_at(z), 101_325.0 * np.exp(-geopotential_m(z) / scale_m), rtol=1e-10)


def test_the_second_lapse_rate_begins_at_the_inversion() -> None:
    air = mild()
    assert air.temperature_at(8000.0) == pytest.approx(288.15 - 0.0065 * geopotential_m(8000.0), abs=1e-9)
    risen = geopotential_m(9000.0) - geopotential_m(8000.0)
    assert air.temperature_at(9000.0) - air.temperature_at(8000.0) == pytest.approx(0.0065 * risen, abs=1e-6)
    assert air.temperature_at(15_000.0) == air.temperature_at(12_000.0)


def test_an_adiabatic_column_has_one_potential_temperature() -> None:
    air = mild(lapse_rate_k_per_m=-GRAVITY_M_PER_S2 * 28.96 * 0.4 / (8314.0 * 1.4), relative_humidity=0.0)
    theta = air.potential_temperature_at(np.linspace(0.0, 8000.0, 9))
    np.testing.assert_allclose(theta, theta[0], rtol=2e-6)


def test_relative_humidity_is_the_one_asked_for_at_the_levels() -> None:
    air = mild(relative_humidity=0.7)
    np.testing.assert_allclose(air.relative_humidity_at(air.height_m), 0.7, rtol=1e-12)


def test_values_between_the_levels_are_linear() -> None:
    air = few()
    assert air.vapour_at(500.0) == pytest.approx(4.5e-3)
    np.testing.assert_allclose(air.wind_at(2000.0), [3.0, 0.0])
    assert air.wind_at(np.zeros((4, 5))).shape == (4, 5, 2)
    assert air.temperature_at(500.0) == pytest.approx(286.5, abs=1e-3)


def test_sound_air_passes() -> None:
    for air in (standard_sounding(), mild(), few(), mild(relative_humidity=1.0)):
        check_sounding(air)


@pytest.mark.parametrize(
    ("air", "words"),
    [
        (few(height_m=np.array([0.0, 1000.0, 1000.0])), "at 1000 m: height: expected more than the 1000 m"),
        (few(height_m=np.array([0.0, 2000.0, 1000.0])), "at 1000 m: height: expected more than the 2000 m"),
        (few(height_m=np.array([5.0, 1000.0, 3000.0])), "first height: expected 0 m, the ground, got 5 m"),
        (few(height_m=np.array([0.0, np.nan, 3000.0])), "height: expected 0 to 100000 m, got nan m"),
        (few(temperature_k=np.array([290.0, np.nan, 270.0])), "at 1000 m: temperature: expected 150 to 350 K, got nan"),
        (few(temperature_k=np.array([290.0, 283.0, 120.0])), "at 3000 m: temperature: .* got 120 K"),
        (few(temperature_k=np.array([17.0, 10.0, 0.0])), "at 0 m: temperature: .* got 17 K"),
        (few(vapour=np.array([5e-3, -1e-3, 0.0])), "at 1000 m: vapour: expected 0 to 0.2 kg/kg, got -0.001"),
        (
            few(vapour=np.array([5e-3, 2e-2, 0.0])),
            r"at 1000 m: relative humidity: expected at most 1, got 2\.\d+: super",
        ),
        (few(wind_m_per_s=np.full((3, 2), 200.0)), "at 0 m: wind: expected 0 to 150 m/s, got 282.8"),
        (few(wind_m_per_s=np.full((3, 2), np.inf)), "at 0 m: wind: .* got inf"),
        (few(ground_pressure_pa=1013.25), "pressure at the ground: expected 300 to 1200 hPa, got 10.1325 hPa"),
        (few(ground_pressure_pa=np.nan), "pressure at the ground: .* got nan"),
        (few(temperature_k=np.array([330.0, 290.0, 270.0])), "at 0 m: lapse rate .* at least -34.2 K/km .* got -40"),
        (Sounding(np.zeros(1), np.zeros(1), np.zeros(1), np.zeros((1, 2))), "levels: expected at least two heights"),
    ],
)
def test_air_that_cannot_be_is_refused_in_words(air: Sounding, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        check_sounding(air)


def test_the_limit_of_the_lapse_rate_is_that_of_constant_density() -> None:
    def column(rate: float) -> Sounding:
        return mild(lapse_rate_k_per_m=rate, inversion_m=500.0, top_m=4000.0, relative_humidity=0.0)

    steep = column(1.02 * AUTOCONVECTION_K_PER_M)
    assert steep.density_at(400.0) > steep.density_at(0.0)
    with pytest.raises(ValueError, match="heavier above than below"):
        check_sounding(steep)
    below = column(0.98 * AUTOCONVECTION_K_PER_M)
    assert below.density_at(400.0) < below.density_at(0.0)
    check_sounding(below)


TABLE = """\
# a summer day
wind_from_deg,height_m,temperature_c,relative_humidity,wind_m_per_s

270,0,20,0.5,4
180,1000,12,0.8,6
180,3000,-2,0.3,10
"""


def written(folder: Path, text: str | bytes) -> Path:
    path = folder / "air.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_a_table_is_read(tmp_path: Path) -> None:
    air = read_sounding(written(tmp_path, TABLE), ground_pressure_pa=98_000.0)
    np.testing.assert_array_equal(air.height_m, [0.0, 1000.0, 3000.0])
    np.testing.assert_allclose(air.temperature_k, [293.15, 285.15, 271.15])
    np.testing.assert_allclose(air.relative_humidity_at(air.height_m), [0.5, 0.8, 0.3])
    np.testing.assert_allclose(air.wind_m_per_s, [[4, 0], [0, 6], [0, 10]], atol=1e-12)  # from the west, the south
    assert air.ground_pressure_pa == 98_000.0


def test_humidity_may_be_given_in_three_ways(tmp_path: Path) -> None:
    by_ratio = read_sounding(written(tmp_path, "height_m,temperature_c,vapour_g_per_kg\n0,20,7\n2000,8,3\n"))
    np.testing.assert_allclose(by_ratio.vapour, [0.007, 0.003])
    rows = []
    for z, q in ((0.0, 0.007), (2000.0, 0.003)):
        share = float(np.log(q * by_ratio.pressure_at(z) / 380.16))
        rows.append(f"{z},{by_ratio.temperature_at(z) - 273.15},{243.5 * share / (17.67 - share)}\n")
    by_dew_point = read_sounding(written(tmp_path, "height_m,temperature_c,dewpoint_c\n" + "".join(rows)))
    np.testing.assert_allclose(by_dew_point.vapour, by_ratio.vapour, rtol=1e-9)
    humidity = by_ratio.relative_humidity_at(by_ratio.height_m)
    rows = [f"{z},{t},{h}\n" for z, t, h in zip((0, 2000), (20, 8), humidity, strict=True)]
    by_humidity = read_sounding(written(tmp_path, "height_m,temperature_c,relative_humidity\n" + "".join(rows)))
    np.testing.assert_allclose(by_humidity.vapour, by_ratio.vapour, rtol=1e-9)


def test_a_table_without_humidity_and_wind_is_dry_and_calm(tmp_path: Path) -> None:
    air = read_sounding(written(tmp_path, b"\xef\xbb\xbftemperature_c,height_m\r\n20,0\r\n10,1000\r\n"))
    assert not air.vapour.any()
    assert not air.wind_m_per_s.any()
    eastward = read_sounding(
        written(tmp_path, "height_m,temperature_c,east_m_per_s,north_m_per_s\n0,20,3,-1\n900,12,5,0\n")
    )
    np.testing.assert_array_equal(eastward.wind_m_per_s, [[3, -1], [5, 0]])


HEAD = "height_m,temperature_c,relative_humidity\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["expected  a first line of columns, such as height_m,temperature_c", "got       no line"]),
        ("height_m,temperature\n0,1\n", ["line 1, a column's name", "'temperature'; do you mean temperature_c?"]),
        ("height_m,dewpoint_c\n0,1\n", ["line 1", "a column temperature_c", "height_m, dewpoint_c"]),
        ("height_m,temperature_c,height_m\n", ["line 1, column height_m", "it once", "2 times"]),
        (
            "height_m,temperature_c,dewpoint_c,relative_humidity\n",
            ["one column of humidity", "relative_humidity and dewpoint_c"],
        ),
        (
            "height_m,temperature_c,wind_m_per_s\n",
            ["the wind as wind_from_deg and wind_m_per_s", "got       wind_m_per"],
        ),
        ("height_m,temperature_c\n0,20\n", ["2 to 100,000 rows", "got       1"]),
        (HEAD + "0,20,0.5\n1000,warm,0.5\n", ["line 3, column temperature_c", "expected  a number", "'warm'"]),
        (HEAD + "0,20,0.5\n1000,nan,0.5\n", ["line 3, column temperature_c", "'nan'"]),
        (HEAD + "0,20,0.5\n1000,,0.5\n", ["line 3, column temperature_c", "got       ''"]),
        (HEAD + "0,20,0.5\n1000,12\n", ["line 3", "3 numbers, one a column", "got       2"]),
        (HEAD + "0,20,0.5\n\n# up\n1000,12,1.3\n", ["line 5, column relative_humidity", "at most 1", "1.3: supersat"]),
        (HEAD + "0,20,0.5\n1000,12,50\n", ["line 3, column relative_humidity"]),
        (HEAD + "0,20,-0.5\n1000,12,0.5\n", ["line 2, column relative_humidity: vapour"]),
        (HEAD + "300,20,0.5\n1000,12,0.5\n", ["line 2, column height_m: first height", "0 m, the ground", "300 m"]),
        (HEAD + "0,20,0.5\n1000,12,0.5\n500,14,0.5\n", ["line 4, column height_m: height", "more than the 1000 m"]),
        (HEAD + "0,293,0.5\n1000,285,0.5\n", ["line 2, column temperature_c: temperature", "150 to 350 K"]),
        (HEAD + "0,20,0.5\n100,10,0.5\n", ["line 2, column temperature_c: lapse rate", "-100 K/km"]),
        ("height_m,temperature_c,dewpoint_c\n0,20,21\n1000,12,5\n", ["line 2, column dewpoint_c: relative humidity"]),
        ("height_m,temperature_c,dewpoint_c\n0,20,-400\n1000,12,-300\n", []),
        (b"\xff\xfe\x00h", ["a table in UTF-8"]),
        (HEAD.encode() + b"0,20,0.5\x00\n9,20,0.5\n", ["line 2, column relative_humidity", "a number"]),
        (HEAD + "1" * 200_000, ["line 2", "a row of numbers with commas between", "field larger"]),
        ("height_m;temperature_c\n0;20\n", ["line 1, a column's name", "'height_m;temperature_c'"]),
    ],
)
def test_a_bad_table_is_refused_by_line_and_column(tmp_path: Path, text: str | bytes, words: list[str]) -> None:
    path = written(tmp_path, text)
    if not words:  # a dew point below all weather: no vapour worth the name
        assert read_sounding(path).vapour.max() < 1e-12
        return
    with raises_error(AssetError, place="air.csv"):
        read_sounding(path)


def test_a_missing_table_and_a_huge_one_are_refused(tmp_path: Path) -> None:
    with raises_error(AssetError, place="none.csv"):
        read_sounding(tmp_path / "none.csv")
    with raises_error(AssetError, place="air.csv"):
        read_sounding(written(tmp_path, HEAD + "0,20,0.5\n" * 1_200_000))


def test_saturation_is_the_printed_formula() -> None:
    """Eq. 29 in degrees Celsius and Pa."""
    assert saturation_ratio(273.15, 1e5) == pytest.approx(380.16e-5, rel=1e-12)
    warm = replace(few(), temperature_k=np.array([303.15, 290.0, 280.0]))
    expected = 380.16 / 101_325.0 * np.exp(17.67 * 30.0 / 273.5)
    assert saturation_ratio(warm.temperature_k, 101_325.0)[0] == pytest.approx(expected, rel=1e-12)


def test_saturation_rises_with_temperature_and_has_no_pole() -> None:
    ratio = saturation_ratio(np.arange(1.0, 350.0), 1e5)
    assert (ratio > 0.0).all()
    assert (np.diff(ratio) >= 0.0).all()
    assert (np.diff(ratio[80:]) > 0.0).all()
