"""The sun's place against NREL's published example and what almanacs say."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone

import pytest

from forestgen.atmosphere.daylight import sun_position

NOON = datetime(2026, 6, 21, 12, tzinfo=UTC)


def test_the_example_of_reda_and_andreas() -> None:
    """NREL/TP-560-34302, table A5.1: Golden, Colorado; zenith 50.11162, azimuth 194.34024, distance 0.9965423 au."""
    moment = datetime(2003, 10, 17, 12, 30, 30, tzinfo=timezone(timedelta(hours=-7)))
    sun = sun_position(moment, 39.742476, -105.1786, 1830.14, air_pressure_pa=82_000.0, temperature_c=11.0)
    assert 90.0 - sun.elevation_deg == pytest.approx(50.11162, abs=1e-4)
    assert sun.azimuth_deg == pytest.approx(194.34024, abs=1e-4)
    assert sun.distance_au == pytest.approx(0.9965422974, abs=1e-7)


def test_distances_of_perihelion_and_aphelion() -> None:
    # Astronomical Almanac 2026: 3 January 17 h 0.98330 au, 6 July 17 h 1.01664 au.
    assert sun_position(datetime(2026, 1, 3, 17, tzinfo=UTC), 0.0, 0.0).distance_au == pytest.approx(0.98330, abs=2e-5)
    assert sun_position(datetime(2026, 7, 6, 17, tzinfo=UTC), 0.0, 0.0).distance_au == pytest.approx(1.01664, abs=2e-5)


def test_noons_of_solstice_and_equinox() -> None:
    # The obliquity is 23.436 degrees; on 21 June the equation of time is 2 minutes, half a degree of longitude.
    assert sun_position(NOON, 50.0, 0.45).elevation_deg == pytest.approx(90 - 50 + 23.436, abs=0.02)
    assert sun_position(NOON, 50.0, 0.45).azimuth_deg == pytest.approx(180.0, abs=0.2)
    south = sun_position(NOON, -35.0, 0.45)
    assert south.azimuth_deg == pytest.approx(0.0, abs=0.2) or south.azimuth_deg == pytest.approx(360.0, abs=0.2)
    assert south.elevation_deg == pytest.approx(90 - 35 - 23.436, abs=0.05)
    # Equinox of 20 March 2026: the sun rises in the east and sets in the west, at the equator and elsewhere.
    for latitude_deg in (0.0, 40.0):
        morning = sun_position(datetime(2026, 3, 20, 6, 12, tzinfo=UTC), latitude_deg, 0.0)
        evening = sun_position(datetime(2026, 3, 20, 18, 3, tzinfo=UTC), latitude_deg, 0.0)
        assert morning.azimuth_deg == pytest.approx(90.0, abs=1.5)
        assert evening.azimuth_deg == pytest.approx(270.0, abs=1.5)
        assert 0 < morning.elevation_deg < 2


def test_east_is_positive_and_clocks_of_all_zones_agree() -> None:
    # 15 degrees further east the sun is an hour ahead.
    here, east = sun_position(NOON, 50.0, 10.0), sun_position(NOON - timedelta(hours=1), 50.0, 25.0)
    assert east.azimuth_deg == pytest.approx(here.azimuth_deg, abs=0.02)
    zone = timezone(timedelta(hours=5, minutes=30))
    assert sun_position(NOON.astimezone(zone), 50.0, 10.0) == here


def test_refraction_lifts_the_horizon_by_half_a_degree_and_less_on_a_mountain() -> None:
    rising = datetime(2026, 3, 20, 6, 5, tzinfo=UTC)
    airless = sun_position(rising, 0.0, 0.0, air_pressure_pa=1e-6).elevation_deg
    lifted = sun_position(rising, 0.0, 0.0).elevation_deg
    mountain = sun_position(rising, 0.0, 0.0, 5000.0).elevation_deg
    assert -1 < airless < 1
    assert lifted - airless == pytest.approx(0.5, abs=0.12)  # 29 minutes of arc at sunrise (Almanac)
    assert airless < mountain < lifted


def test_a_moment_without_offset_is_refused() -> None:
    with pytest.raises(ValueError, match="offset"):
        sun_position(datetime(2026, 6, 21, 12), 50.0, 10.0)
