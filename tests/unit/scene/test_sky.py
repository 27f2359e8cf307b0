"""The recipe's sky as the scene's."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from forestgen.atmosphere.daylight import sun_position
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import check_plan
from forestgen.scene.site import sky_of, sun_notes

QUICKSTART = Path(__file__).parents[3] / "recipes" / "quickstart.yaml"
GOLDEN = ["site.latitude_deg=39.742476", "site.longitude_deg=-105.1786", "site.altitude_m=1830.14"]


def test_angles_go_through_and_the_sun_is_at_its_mean_distance() -> None:
    plan = check_plan(load_recipe(QUICKSTART, ["sky.sun={elevation_deg: 12, azimuth_deg: 200}", "site.altitude_m=300"]))
    sky = sky_of(plan.drawn.recipe, 0.13)
    assert (sky.sun_elevation_deg, sky.sun_azimuth_deg, sky.sun_distance_au) == (12.0, 200.0, 1.0)
    assert (sky.ground_albedo, sky.altitude_m, sky.kind) == (0.13, 300.0, "clear")


def test_a_date_and_a_place_give_the_sun_of_nrels_example() -> None:
    sun = "sky.sun={date: 2003-10-17, time: '12:30:30', utc_offset_h: -7}"
    plan = check_plan(load_recipe(QUICKSTART, [sun, *GOLDEN, "sky.precipitable_water_mm=8", "sky.ozone_du=290"]))
    sky = sky_of(plan.drawn.recipe, 0.2)
    assert 90.0 - sky.sun_elevation_deg == pytest.approx(50.11162, abs=2e-3)  # other weather, other refraction
    assert sky.sun_azimuth_deg == pytest.approx(194.34024, abs=1e-4)
    assert sky.sun_distance_au == pytest.approx(0.9965423, abs=1e-6)
    assert (sky.precipitable_water_mm, sky.ozone_du) == (8.0, 290.0)
    # East 0.1682, north -0.9689 of its level part: south and a little west.
    assert sky.to_sun[:2] / sky.to_sun[1] == pytest.approx([0.2557, 1.0], abs=1e-3)
    assert sky.to_sun[1] < 0 < sky.to_sun[2]


def test_a_night_by_date_is_noted_and_has_its_moon() -> None:
    """On 2026-06-30 at 0 o'clock UTC the moon is full (1:57 the night before) and low in the south of Dresden."""
    place = ["site.latitude_deg=51", "site.longitude_deg=13.7"]
    plan = check_plan(load_recipe(QUICKSTART, ["sky.sun={date: 2026-06-29T23:30Z}", *place]))
    sky = sky_of(plan.drawn.recipe, 0.2)
    assert sky.moon is not None
    assert sky.moon.phase_angle_deg < 8
    assert 5 < sky.moon.elevation_deg < 15
    assert sky.to_light[1] < -0.9
    assert ["below the horizon" in one for one in sun_notes(plan.drawn.recipe)] == [True]


def test_the_moons_phase_follows_from_its_angle_from_the_sun_unless_it_is_given() -> None:
    night = ["sky.sun={elevation_deg: -20, azimuth_deg: 270}"]
    for moon, phase_deg in (
        ("{elevation_deg: 20, azimuth_deg: 90}", 0.0),
        ("{elevation_deg: 20, illuminated: 0.5}", 90.0),
    ):
        sky = sky_of(check_plan(load_recipe(QUICKSTART, [*night, f"sky.moon={moon}"])).drawn.recipe, 0.2)
        assert sky.moon is not None
        assert sky.moon.phase_angle_deg == pytest.approx(phase_deg, abs=1e-6)
    day = sky_of(check_plan(load_recipe(QUICKSTART, ["sky.moon={elevation_deg: 20}"])).drawn.recipe, 0.2)
    assert day.moon is None


def test_the_sun_sinks_steadily_and_shines_at_midnight_in_the_polar_day() -> None:
    place = ["site.latitude_deg=78.2", "site.longitude_deg=15.6"]
    plan = check_plan(load_recipe(QUICKSTART, ["sky.sun={date: 2026-06-21T23:00Z}", *place]))
    assert 10 < sky_of(plan.drawn.recipe, 0.2).sun_elevation_deg < 13
    minutes = [datetime(2026, 3, 20, 16, tzinfo=UTC) + timedelta(minutes=k) for k in range(0, 120, 2)]
    sinking = np.diff([sun_position(moment, 51.0, 13.7).elevation_deg for moment in minutes])
    assert (sinking < 0.01).all()
    assert sinking.min() > -0.45


@pytest.mark.parametrize(
    ("date", "latitude_deg", "elevation_deg", "noted"),
    [("2026-12-21", 51.0, 40.0, True), ("2026-12-21", 51.0, 15.0, False), ("2026-06-21", 51.0, 62.0, False)],
)
def test_a_sun_that_never_stands_so_high_is_noted(
    date: str, latitude_deg: float, elevation_deg: float, noted: bool
) -> None:
    """At 51 degrees north it is at most 15.6 degrees high at the winter's solstice, and 62.4 at the summer's."""
    sun = f"sky.sun={{elevation_deg: {elevation_deg}, azimuth_deg: 180}}"
    plan = check_plan(load_recipe(QUICKSTART, [sun, f"site.date={date}", f"site.latitude_deg={latitude_deg}"]))
    notes = sun_notes(plan.drawn.recipe)
    assert [("at most 16 on 2026-12-21" in one) for one in notes] == [True] * noted
