"""Charts: every value is in a bar, bars are true to scale, ticks lie on the axis."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forestgen.dataset.report.charts import (
    BOTTOM,
    LEFT,
    RIGHT,
    SUN_CENTRE,
    SUN_RADIUS,
    TOP,
    histogram,
    nice_step,
    percent,
    ranges,
    shares,
    short,
    sun_plot,
)
from forestgen.dataset.report.frames import standard_ranks

NUMBERS = st.floats(-1e12, 1e12).map(lambda x: float(f"{x:.6g}")) | st.integers(-1000, 1000).map(float)
MANY = st.lists(NUMBERS, min_size=1, max_size=60)


def counted(chart):
    return sum(int(bar.title.rpartition(": ")[2].replace(",", "")) for bar in chart.bars)


@settings(deadline=None)
@given(MANY, st.booleans())
def test_a_histogram_holds_every_value_once(values, log):
    chart = histogram([*values, math.nan], "t", "x", log=log)
    known = [one for one in values if one > 1e-30 or not log]
    if not known:
        assert chart is None
        return
    assert counted(chart) == len(known)
    assert len(chart.bars) <= 30 or log
    for bar in chart.bars:
        assert LEFT - 0.1 <= bar.x <= bar.x + bar.width <= RIGHT + 0.2
        assert TOP - 0.1 <= bar.y <= bar.y + bar.height <= BOTTOM + 0.2
    assert chart.x_ticks
    assert all(LEFT - 0.1 <= tick.at <= RIGHT + 0.1 for tick in chart.x_ticks)
    assert [tick.at for tick in chart.x_ticks] == sorted(tick.at for tick in chart.x_ticks)


@pytest.mark.parametrize(
    "values", [[1e18, 1e18 + 512], [0.1, 0.1 + 1e-16], [5e-324], [1e-165, 2e-165], [-1e300, 1e300]]
)
@pytest.mark.parametrize("log", [False, True])
def test_extreme_numbers_make_a_chart_or_none(values, log):
    chart = histogram(values, "t", "x", log=log)
    positive = sum(one > 1e-30 for one in values)
    assert (chart is None) == (log and not positive)
    assert chart is None or counted(chart) == (positive if log else len(values))


def test_heights_are_proportional_to_counts():
    chart = histogram([1, 1, 1, 1, 2, 2, 3], "t", "x")
    assert [counted_height(bar) for bar in chart.bars] == [4, 2, 1]
    first = chart.bars[0].height
    assert [bar.height / first for bar in chart.bars] == pytest.approx([1, 0.5, 0.25], abs=0.01)
    top = chart.y_ticks[-1]
    assert first / (BOTTOM - top.at) == pytest.approx(4 / float(top.text), abs=0.01)


def counted_height(bar):
    return int(bar.title.rpartition(": ")[2])


def test_bins_agree_with_numpy():
    values = np.random.default_rng(0).lognormal(2, 1.5, 5000)
    for log in (False, True):
        for bar in histogram(values, "t", "x", log=log).bars:
            text, _, count = bar.title.partition(": ")
            low, high = (float(one.replace("k", "e3").replace("M", "e6")) for one in text.split(" to "))
            near = np.sum((values > low * 0.999) & (values < high * 1.001))
            assert int(count.replace(",", "")) == pytest.approx(near, rel=0.05, abs=3)


@given(st.floats(1e-9, 1e12), st.integers(1, 50))
def test_steps_are_round_and_no_smaller_than_asked(span, most):
    step = nice_step(span, most)
    assert step * most >= span * (1 - 1e-6)
    assert round(step / 10.0 ** math.floor(math.log10(step * 1.0001)), 6) in (1, 2, 5)


@settings(deadline=None)
@given(st.lists(st.tuples(st.floats(-360, 720), st.floats(-20, 90)), min_size=1, max_size=40))
def test_every_sun_above_the_horizon_is_in_a_cell_and_a_dot(suns):
    azimuth, elevation = np.array(suns).T
    plot = sun_plot(np.append(azimuth, np.nan), np.append(elevation, np.nan))
    up = elevation >= 0
    assert sum(int(wedge.title.rpartition(": ")[2]) for wedge in plot.wedges) == up.sum() == len(plot.dots)
    for (x, y), a, e in zip(plot.dots, np.radians(azimuth[up]), elevation[up], strict=True):
        radius = SUN_RADIUS * (90 - e) / 90
        assert (x - SUN_CENTRE, SUN_CENTRE - y) == pytest.approx((radius * math.sin(a), radius * math.cos(a)), abs=0.1)


def test_north_is_up_and_east_right():
    north, east = sun_plot(np.array([0.0, 90.0]), np.array([0.0, 0.0])).dots
    assert north == pytest.approx((SUN_CENTRE, SUN_CENTRE - SUN_RADIUS), abs=0.1)
    assert east == pytest.approx((SUN_CENTRE + SUN_RADIUS, SUN_CENTRE), abs=0.1)


def test_ranges_are_ordered_on_one_axis():
    rng = np.random.default_rng(1)
    chart = ranges(
        {"a": rng.lognormal(0, 1, 400), "b": rng.lognormal(4, 1, 400), "c": np.full(3, np.nan)}, "t", "x", "m"
    )
    assert [row.name for row in chart.rows] == ["a", "b"]
    for row in chart.rows:
        assert list(row.spots) == sorted(row.spots)
    assert chart.rows[0].spots[2] < chart.rows[1].spots[2]
    assert ranges({"a": np.array([np.nan])}, "t", "x", "m") is None


@settings(deadline=None, max_examples=20)
@given(st.lists(st.integers(0, 6), min_size=3, max_size=40).filter(lambda x: min(x) < max(x)))
def test_rank_correlation_is_spearmans(values):
    from scipy.stats import spearmanr

    first = np.array(values, dtype=float)
    second = np.arange(len(values)) % 5 * 1.0
    expected = spearmanr(first, second).statistic
    assert float(standard_ranks(first) @ standard_ranks(second)) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("share", "text"),
    [(0, "0%"), (1, "100%"), (0.5, "50%"), (1e-9, "<0.01%"), (0.0009, "0.09%"), (0.99999, ">99.9%"), (1 / 3, "33.3%")],
)
def test_shares_for_people(share, text):
    assert percent(share) == text


def test_lists_of_shares():
    rows = shares(["a", "b"], [3, 1])
    assert [(row.text, row.share) for row in rows] == [("75% · 3", 1.0), ("25% · 1", 1 / 3)]
    assert [row.text for row in shares(["a"], [3], of=12)] == ["25% · 3"]
    assert short(1234567) == "1.23M"
