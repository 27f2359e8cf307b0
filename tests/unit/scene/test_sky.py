"""The recipe's sky as the scene's."""

from __future__ import annotations

from pathlib import Path

import pytest

from forestgen.core.errors import RecipeError
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import check_plan
from forestgen.scene.site import sky_of, sun_notes
from support.error_messages import raises_error

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


@pytest.mark.parametrize(
    "sun",
    [
        "{date: 2026-06-21, time: '23:30', utc_offset_h: 2}",
        "{date: 2026-06-21, time: {uniform: [10, 23.5]}, utc_offset_h: 2}",
        "{date: 2026-12-21T12:00-12:00}",
    ],
)
def test_a_sun_below_the_horizon_is_told_before_anything_is_simulated(sun: str) -> None:
    recipe = load_recipe(QUICKSTART, [f"sky.sun={sun}", "site.latitude_deg=51", "site.longitude_deg=13.7"])
    with raises_error(RecipeError):
        check_plan(recipe)


def test_polar_night_is_told_and_the_midnight_sun_shines() -> None:
    place = ["site.latitude_deg=78.2", "site.longitude_deg=15.6"]
    with raises_error(RecipeError, place="sky.sun.date"):
        check_plan(load_recipe(QUICKSTART, ["sky.sun={date: 2026-12-21T11:00Z}", *place]))
    plan = check_plan(load_recipe(QUICKSTART, ["sky.sun={date: 2026-06-21T23:00Z}", *place]))
    assert 10 < sky_of(plan.drawn.recipe, 0.2).sun_elevation_deg < 13


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
