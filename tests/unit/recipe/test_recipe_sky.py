"""The sky's keys: the sun by angles or by date, each with its mistakes."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import pytest

from forestgen.core.errors import RecipeError
from forestgen.recipe.json_schema import recipe_json_schema
from forestgen.recipe.load import dump_yaml, load_recipe

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
    ("sun", "parts"),
    [
        ("{date: 2026-06-21}", ["sky.sun.date", "half a date", "add time: '14:30' and utc_offset_h"]),
        ("{time: '14:30'}", ["sky.sun.time", "half a date", "add date"]),
        ("{date: 2026-06-21, utc_offset_h: 1}", ["half a date", "add time"]),
        ("{date: 2026-06-21, time: 12, utc_offset_h: 1, azimuth_deg: 3}", ["sky.sun.azimuth_deg", "by angle and by"]),
        ("{date: 2026-06-21T12:00Z, elevation_deg: 30}", ["sky.sun.elevation_deg", "leave out elevation_deg"]),
        ("{date: 2026-06-21T12:00Z, time: 3}", ["sky.sun.time", "given twice", "leave out time"]),
        ("{date: 2026-06-21T12:00}", ["without its offset", "Z is UTC"]),
        ("{date: 2026-06-31}", ["not a date", "2026-06-31"]),
        ("{date: 21.6.2026, time: 12, utc_offset_h: 1}", ["not a date"]),
        ("{date: 20260621, time: 12, utc_offset_h: 1}", ["sky.sun.date", "expected  text"]),
        ("{date: 1500-06-21, time: 12, utc_offset_h: 1}", ["from 1700 to 2200"]),
        ("{date: 2026-06-21, time: '25:00', utc_offset_h: 1}", ["sky.sun.time", "not a time of day", "'25:00'"]),
        ("{date: 2026-06-21, time: '12:61', utc_offset_h: 1}", ["not a time of day"]),
        ("{date: 2026-06-21, time: 24, utc_offset_h: 1}", ["from 0 to 24"]),
        ("{date: 2026-06-21, time: -1, utc_offset_h: 1}", ["from 0 to 24"]),
        ("{date: 2026-06-21, time: true, utc_offset_h: 1}", ["not a time of day", "true"]),
        ("{date: 2026-06-21, time: [1], utc_offset_h: 1}", ["not a time of day"]),
        ("{date: 2026-06-21, time: {uniform: [8, 30]}, utc_offset_h: 1}", ["not a time", "from {uniform: [8, 30]}"]),
        ("{date: 2026-06-21, time: 12, utc_offset_h: 200}", ["sky.sun.utc_offset_h", "at most 14"]),
        ("{dat: 2026-06-21}", ["unknown key 'dat'", "did you mean 'date'"]),
        ("{elevation_deg: -3}", ["greater than 0"]),
        ("{elevation_deg: 91}", ["at most 90"]),
    ],
)
def test_mistakes_are_told_with_their_place(write: Write, sun: str, parts: list[str]) -> None:
    with pytest.raises(RecipeError) as caught:
        load_recipe(write(), [f"sky.sun={sun}", *PLACE])
    for part in (*parts, "set='sky.sun="):
        assert part in str(caught.value)


@pytest.mark.parametrize(
    ("places", "missing"),
    [
        ([], "no latitude_deg and no longitude_deg"),
        (["site.latitude_deg=51"], "no longitude_deg"),
        (["site.longitude_deg=13.7"], "no latitude_deg"),
    ],
)
def test_a_date_needs_a_place(write: Write, places: list[str], missing: str) -> None:
    with pytest.raises(RecipeError, match="needs a place on earth") as caught:
        load_recipe(write(), ["sky.sun={date: 2026-06-21T12:00Z}", *places])
    assert missing in str(caught.value)
    assert "stand.yaml" in str(caught.value) or "set='site" in str(caught.value)


def test_an_overcast_sky_has_no_cumulus(write: Write) -> None:
    assert load_recipe(write(), ["sky.kind=overcast", CLEAR]).draw(0).recipe.sky.kind == "overcast"
    with pytest.raises(RecipeError, match="no single clouds") as caught:
        load_recipe(write(), ["sky.kind=overcast"])
    assert "sky.clouds" in str(caught.value)
    with pytest.raises(RecipeError, match="no single clouds"):
        load_recipe(write(), ["sky.kind={choice: [clear, overcast]}"])
    with pytest.raises(RecipeError, match="one of clear, overcast"):
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
