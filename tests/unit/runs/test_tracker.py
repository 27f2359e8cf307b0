"""How fast, how long: what people plan their weekend by."""

from __future__ import annotations

import pytest

from forestgen.api.display import line
from forestgen.runs import summary as module
from forestgen.runs.summary import ProgressTracker


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    return now


def test_a_steady_pace_is_told_whatever_was_done_before(clock: list[float]) -> None:
    meter = ProgressTracker(1000, already=400, started_s=clock[0])
    assert meter.images_per_hour is None
    assert meter.seconds_left is None
    clock[0] += 60  # workers start
    for _ in range(50):
        clock[0] += 9
        meter.count({"render": 3.0, "labels": 1.0})
    assert meter.images_per_hour == pytest.approx(400)  # the start no longer counts
    assert meter.seconds_left == pytest.approx(550 * 9)
    assert (meter.done, meter.left) == (450, 550)
    assert meter.shares() == {"render": 0.75, "labels": 0.25}


def test_before_the_first_image_a_line_tells_for_how_long_it_has_been_waited_for(clock: list[float]) -> None:
    meter = ProgressTracker(10, started_s=clock[0])
    clock[0] += 180
    assert line(meter) == "0 of 10 images, 3 min 00 s so far"


def test_the_first_images_are_judged_by_the_whole_run(clock: list[float]) -> None:
    meter = ProgressTracker(10, started_s=clock[0])
    clock[0] += 36
    meter.count({})
    assert meter.images_per_hour == pytest.approx(100)
    assert meter.shares() == {}


def test_the_line_names_what_matters(clock: list[float]) -> None:
    meter = ProgressTracker(1000, already=10, failed=2, retried=1, started_s=clock[0])
    assert line(meter) == "10 of 1,000 images, 0 s so far, 2 failed, 1 attempt again"
    clock[0] += 36
    meter.count({"render": 1.0})
    assert line(meter).startswith("11 of 1,000 images, 100 an hour, 9 h 52 min left, 2 failed")
    assert line(meter).endswith("; render 100 %")
