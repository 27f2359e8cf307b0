"""The picture of water in time: its numbers, and that it is drawn whatever there is to draw."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ecoclimate_cases import SITE, ecology, parameters

from forestgen.community.model import simulate
from forestgen.community.models.ecoclimate import MODEL
from forestgen.community.plot_series import SOIL, WaterSeries, plot_water
from forestgen.community.population import Population, Site


def series(times: np.ndarray) -> WaterSeries:
    """Rain of 600 mm a year: 100 drunk in the first year, 200 in the second, and so on; the rest is lost."""
    uptake = np.interp(times, np.arange(2000), 50.0 * np.arange(2000) * np.arange(1, 2001))
    told = [
        (time, {"start_mm": 5.0, "stored_mm": 5.0, "rain_mm": 600 * time, "uptake_mm": up, "loss_mm": 600 * time - up})
        for time, up in zip(times.tolist(), uptake.tolist(), strict=True)
    ]
    return WaterSeries.of(told)


def test_flows_are_sums_of_whole_years() -> None:
    months = series(np.arange(0, 5 * 12 + 4) / 12)
    ends = months.periods_yr()
    assert ends.tolist() == [0, 1, 2, 3, 4, 5]  # the last four months are no year
    rates = months.rates_mm_per_yr(ends)
    assert rates["rain"] == pytest.approx([600] * 5)
    assert rates["uptake"] == pytest.approx([100, 200, 300, 400, 500])
    assert rates["loss"] == pytest.approx([500, 400, 300, 200, 100])


def test_a_history_that_goes_on_begins_where_it_begins() -> None:
    later = series(10 + np.arange(0, 49) / 12)
    assert later.periods_yr().tolist() == [10, 11, 12, 13, 14]
    assert later.rates_mm_per_yr(later.periods_yr())["uptake"] == pytest.approx([1100, 1200, 1300, 1400])


def test_short_histories_show_every_snapshot_and_long_ones_some_hundred_periods() -> None:
    few = series(np.arange(7) / 12)
    assert few.periods_yr().tolist() == few.time_yr.tolist()
    assert few.rates_mm_per_yr(few.periods_yr())["rain"] == pytest.approx([600] * 6)
    long = series(np.arange(1501.0))
    ends = long.periods_yr()
    assert 100 < len(ends) < 302
    assert set(np.diff(ends)) == {5}
    assert long.rates_mm_per_yr(ends)["rain"] == pytest.approx([600] * (len(ends) - 1))


@pytest.fixture(scope="module")
def snapshots() -> list[Population]:
    species = [ecology(), ecology("bush")]
    return list(simulate(MODEL, parameters(steps=3), SITE, species, 1, steps=3))


def water_of(snapshots: list[Population]) -> WaterSeries:
    return WaterSeries.of([(one.time_yr, one.state["water"]) for one in snapshots])


def test_it_is_drawn_the_same_twice_of_a_single_cell(snapshots: list[Population], tmp_path: Path) -> None:
    last = replace(snapshots[-1], maps={SOIL: np.array([[3.0]])})
    for name in ("a", "b"):
        plot_water(water_of(snapshots), last, SITE, {"tree": "#336633"}, tmp_path / f"{name}.png")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_it_is_drawn_where_nobody_stands_on_a_long_dry_site(tmp_path: Path) -> None:
    bare = list(simulate(MODEL, parameters(steps=2, initial_plants=0), SITE, [ecology()], 1, steps=2))
    last = replace(bare[-1], maps={SOIL: np.zeros((4, 5))})
    with np.errstate(all="raise"):
        plot_water(water_of(bare), last, Site((90.0, 6.0)), {}, tmp_path / "water.png")
    assert (tmp_path / "water.png").stat().st_size > 10_000
