"""The sky's keys: the sun by angles or by date, each with its mistakes."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import pytest

from forestgen.core.errors import RecipeError
from forestgen.recipe.json_schema import recipe_json_schema
from forestgen.recipe.load import dump_yaml, load_recipe
from support.error_messages import raises_error

Write = Callable[..., Path]
PLACE = ["site.latitude_deg=51", "site.longitude_deg=13.7"]
CLEAR = "sky.clouds=none"


@pytest.mark.parametrize(
    ("sun", "moment"),
    [
        ("{date: 2026-06-21, time: '14:30', utc_offset_h: 2}", datetime(2026, 6, 21, 12, 30, tzinfo=UTC)),
        ("{date: 2026-06-21, time: 14:30, utc_offset_h: 2}", datetime(2026, 6, 21, 12, 30, tzinfo=UTC)),
        ("{date: '2026-06-21', time: 14.5, utc_offset_h: 2}", datetime(2026, 6, 21, 12, 30, tzinfo=UTC)),
        ("{date: 2026-06-21, time: '9:05:30', utc_offset_h: 0}", datetime(2026, 6, 21, 9, 5, 30, tzinfo=UTC)),
        ("{date: 2026-06-21, time: 12, utc_offset_h: 5.5}", datetime(2026, 6, 21, 6, 30, tzinfo=UTC)),
        ("{date: 2026-06-21, time: 0, utc_offset_h: 14}", datetime(2026, 6, 20, 10, tzinfo=UTC)),
        ("{date: 2026-06-21T14:30+02:00}", datetime(2026, 6, 21, 12, 30, tzinfo=UTC)),
        ("{date: 2026-06-21T12:30:00Z}", datetime(2026, 6, 21, 12, 30, tzinfo=UTC)),
    ],
)
def test_dates_as_people_write_them(write: Write, sun: str, moment: datetime) -> None:
    drawn = load_recipe(write(), [f"sky.sun={sun}", *PLACE]).draw(0)
    found = drawn.recipe.sky.sun
    assert found.moment == moment
    assert found.elevation_deg is None
    assert found.azimuth_deg is None
    assert "elevation_deg" not in drawn.data["sky"]["sun"]


@pytest.mark.parametrize(
    ("sun", "angles"),
    [
        ("null", (40.0, 140.0)),
        ("{}", (40.0, 140.0)),
        ("{azimuth_deg: 90}", (40.0, 90.0)),
        ("{elevation_deg: 3, azimuth_deg: -20, date: null}", (3.0, -20.0)),
    ],
)
def test_without_a_date_angles_count_and_have_defaults(write: Write, sun: str, angles: tuple[float, float]) -> None:
    drawn = load_recipe(write(), [f"sky.sun={sun}"]).draw(0)
    found = drawn.recipe.sky.sun
    assert (found.elevation_deg, found.azimuth_deg) == angles
    assert found.moment is None
    assert drawn.data["sky"]["sun"] == dict(zip(("elevation_deg", "azimuth_deg"), angles, strict=True))


@pytest.mark.parametrize(
    "sun",
    [
        "{date: 2026-06-21}",
        "{time: '14:30'}",
        "{date: 2026-06-21, utc_offset_h: 1}",
        "{date: 2026-06-21, time: 12, utc_offset_h: 1, azimuth_deg: 3}",
        "{date: 2026-06-21T12:00Z, elevation_deg: 30}",
        "{date: 2026-06-21T12:00Z, time: 3}",
        "{date: 2026-06-21T12:00}",
        "{date: 2026-06-31}",
        "{date: 21.6.2026, time: 12, utc_offset_h: 1}",
        "{date: 20260621, time: 12, utc_offset_h: 1}",
        "{date: 1500-06-21, time: 12, utc_offset_h: 1}",
        "{date: 2026-06-21, time: '25:00', utc_offset_h: 1}",
        "{date: 2026-06-21, time: '12:61', utc_offset_h: 1}",
        "{date: 2026-06-21, time: 24, utc_offset_h: 1}",
        "{date: 2026-06-21, time: -1, utc_offset_h: 1}",
        "{date: 2026-06-21, time: true, utc_offset_h: 1}",
        "{date: 2026-06-21, time: [1], utc_offset_h: 1}",
        "{date: 2026-06-21, time: {uniform: [8, 30]}, utc_offset_h: 1}",
        "{date: 2026-06-21, time: 12, utc_offset_h: 200}",
        "{dat: 2026-06-21}",
        "{elevation_deg: -93}",
        "{elevation_deg: 91}",
    ],
)
def test_mistakes_are_told_with_their_place(write: Write, sun: str) -> None:
    with raises_error(RecipeError):
        load_recipe(write(), [f"sky.sun={sun}", *PLACE])


@pytest.mark.parametrize(
    "places",
    [[], ["site.latitude_deg=51"], ["site.longitude_deg=13.7"]],
)
def test_a_date_needs_a_place(write: Write, places: list[str]) -> None:
    with raises_error(RecipeError) as caught:
        load_recipe(write(), ["sky.sun={date: 2026-06-21T12:00Z}", *places])
    assert "stand.yaml" in str(caught.value) or "set='site" in str(caught.value)


def test_an_overcast_sky_has_no_cumulus(write: Write) -> None:
    assert load_recipe(write(), ["sky.kind=overcast", CLEAR]).draw(0).recipe.sky.kind == "overcast"
    with raises_error(RecipeError, place="sky.clouds.type"):
        load_recipe(write(), ["sky.kind=overcast"])
    with raises_error(RecipeError, place="sky.clouds.type"):
        load_recipe(write(), ["sky.kind={choice: [clear, overcast]}"])
    with raises_error(RecipeError, place="sky.kind"):
        load_recipe(write(), ["sky.kind=grey"])


def test_hours_are_drawn_and_a_drawn_recipe_is_that_image_again(write: Write, tmp_path: Path) -> None:
    sun = "sky.sun={date: 2026-06-21, time: {uniform: [8, 18]}, utc_offset_h: 2}"
    loaded = load_recipe(write(), [sun, *PLACE])
    times = [loaded.draw(index).recipe.sky.sun.time for index in range(6)]
    assert len(set(times)) == 6
    assert all(isinstance(time, float) and 8 <= time <= 18 for time in times)
    for index in range(2):
        drawn = loaded.draw(index)
        (tmp_path / "drawn.yaml").write_text(dump_yaml(drawn))
        again = load_recipe(tmp_path / "drawn.yaml").draw(0)
        assert again.data == drawn.data
        assert again.recipe.sky.sun.moment == drawn.recipe.sky.sun.moment
    assert loaded.complete["sky"]["sun"]["time"] == {"uniform": [8, 18]}


def test_editors_are_told_of_times_as_text_and_as_numbers() -> None:
    sun = recipe_json_schema()["$defs"]["Sun"]["properties"]
    kinds = str(sun["time"])
    assert "'number'" in kinds
    assert "'string'" in kinds
    assert {"date", "utc_offset_h", "elevation_deg", "azimuth_deg"} <= sun.keys()
