"""Responses to living conditions: what they refuse, what they bar, and that a ground is computed once."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from forestgen.community.ground import living_conditions
from forestgen.community.ground.living_conditions import Conditions, ground_raster, suitability, why_barred
from forestgen.community.population import Site

SHAPE = (48, 64)

NAMES = ("elevation_m", "slope_deg", "moisture", "wind", "sun")


def ground_rasters(site, shape, names=NAMES):  # type: ignore[no-untyped-def]
    """Each living condition on a grid."""
    return {name: ground_raster(site, name, shape) for name in names}


def asked(**responses: Any) -> Conditions:
    return Conditions.model_validate(responses)


def hills(x: Any, y: Any) -> Any:
    return 15 * np.sin(0.031 * x + 0.3) * np.cos(0.043 * y) + 6 * np.sin(0.05 * x - 0.06 * y)


class Counted:
    """A height function that knows how often it was asked."""

    def __init__(self, height: Callable[[Any, Any], Any]) -> None:
        self.height, self.calls = height, 0

    def __call__(self, x: Any, y: Any) -> Any:
        self.calls += 1
        return self.height(x, y)


SITE = Site((240.0, 180.0), hills, altitude_m=300.0)
CURVES = {
    "elevation_m": [[295, 0], [305, 1]],
    "slope_deg": [[15, 1], [25, 0]],
    "moisture": {"smooth": [[0.3, 0], [0.6, 1]]},
    "wind": {"formula": "max(0, min(1, 2 - 3 * x))"},
    "sun": [[0.7, 0], [1.0, 1]],
}


def test_a_suitability_is_the_product_and_any_condition_bars() -> None:
    alone = {name: suitability(asked(**{name: curve}), SITE, SHAPE) for name, curve in CURVES.items()}
    together = suitability(asked(**CURVES), SITE, SHAPE)
    np.testing.assert_allclose(together, np.prod(list(alone.values()), axis=0), rtol=1e-12)
    values = ground_rasters(SITE, SHAPE)
    np.testing.assert_array_equal(alone["slope_deg"] == 0, values["slope_deg"] >= 25)
    np.testing.assert_array_equal(alone["elevation_m"] == 0, values["elevation_m"] <= 295)
    np.testing.assert_array_equal(alone["sun"] == 0, values["sun"] <= 0.7)
    for one in alone.values():
        assert 0.02 < np.mean(one == 0) < 0.98  # each bars somewhere
        assert not together[one == 0].any()
    assert together.min() >= 0
    assert together.max() <= 1
    assert together.any()


def test_a_grid_done_in_blocks_of_rows_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = suitability(asked(**CURVES), SITE, SHAPE)
    monkeypatch.setattr(living_conditions, "_BLOCK_CELLS", 5 * SHAPE[1])
    np.testing.assert_array_equal(suitability(asked(**CURVES), SITE, SHAPE), whole)


def test_a_ground_is_computed_once_for_all_species_and_only_as_far_as_it_is_asked_for() -> None:
    height = Counted(hills)
    for _ in range(5):
        assert (suitability(asked(), Site((90.0, 70.0), height), (9, 8)) == 1).all()
    assert height.calls == 0
    for shape in ((20, 20), (30, 31), (20, 20)):
        suitability(asked(elevation_m=CURVES["elevation_m"], slope_deg=1), Site((90.0, 70.0), height), shape)
    assert height.calls == 1
    for shape in ((20, 20), (30, 31)):
        suitability(asked(**CURVES), Site((90.0, 70.0), height), shape)
    assert height.calls == 2  # the land far around, which wind and sun need


def test_grounds_of_other_functions_latitudes_and_winds_are_told_apart() -> None:
    def other(x: Any, y: Any) -> Any:
        return -hills(x, y)

    for changed in (
        Site(SITE.size_m, other, altitude_m=300.0),
        Site(SITE.size_m, hills, altitude_m=300.0, latitude_deg=-50.0),
        Site(SITE.size_m, hills, altitude_m=300.0, wind_from_deg=90.0),
        Site(SITE.size_m, hills, altitude_m=301.0),
    ):
        before, now = ground_rasters(SITE, SHAPE), ground_rasters(changed, SHAPE)
        assert any((before[name] != now[name]).any() for name in NAMES)
    for _ in range(40):  # a function's number in memory may be that of one long gone
        height = float(_)
        flat = Site(SITE.size_m, lambda x, y, z=height: z + 0 * x)
        np.testing.assert_array_equal(ground_raster(flat, "elevation_m", (2, 2)), height)


@pytest.mark.parametrize(
    ("responses", "said"),
    [
        ({"slope_deg": [[0, 1], [30, 1.2]]}, "response from 0"),
        ({"slope_deg": [[0, 1], [30, -0.2]]}, "response from 0"),
        ({"slope_deg": 1.5}, "response from 0"),
        ({"elevation_m": {"formula": "x / 100"}}, "response from 0"),
        ({"wind": {"smooth": [[0, 1], [0.5, 2]]}}, "response from 0"),
        ({"moisture": [[0, 1], [60, 0]]}, "values from 0 to 1"),
        ({"slope_deg": [[-5, 1], [30, 0]]}, "values from 0 to 90"),
        ({"sun": {"formula": "frac(x)"}}, "a formula knows"),
        ({"wetness": 1}, "Extra inputs"),
    ],
)
def test_responses_that_make_no_sense_are_refused(responses: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        asked(**responses)


def test_what_bars_a_species_everywhere_is_named() -> None:
    assert why_barred(asked(**CURVES), SITE, SHAPE) is None
    assert why_barred(asked(), SITE, SHAPE) is None
    level = Site((50.0, 50.0))
    said = why_barred(asked(elevation_m=[[500, 0], [600, 1]], wind=[[0, 1], [1, 0]]), level, SHAPE)
    assert said == "elevation_m bars it on the whole site, where it is 0 m"
    said = why_barred(asked(slope_deg=[[80, 0], [90, 1]]), SITE, SHAPE)
    assert said is not None
    assert said.startswith("slope_deg bars it on the whole site, where it is 1.2")
    assert " to " in said
    low, high = (float(np.quantile(ground_raster(SITE, "elevation_m", SHAPE), q)) for q in (0.4, 0.5))
    both = asked(
        elevation_m=[[low, 1], [low + 0.01, 0]], slope_deg=1, sun={"formula": "1"}, wind=[[0.0, 0], [0.999, 0], [1, 1]]
    )
    assert "wind bars" in str(why_barred(both, SITE, SHAPE))
    values = ground_rasters(SITE, SHAPE)
    steep = float(values["slope_deg"][values["elevation_m"] >= high].max())  # some lower ground is steeper
    said = why_barred(
        asked(elevation_m=[[low, 0], [high, 0], [high + 1, 1]], slope_deg=[[steep, 0], [90, 1]]), SITE, SHAPE
    )
    assert said is not None
    assert "together: elevation_m on 5" in said
    assert "slope_deg on 99%" in said  # rounded down: not everywhere


def test_all_five_of_a_hilly_site_take_less_than_a_second() -> None:
    times = []
    ground_rasters(Site((100.0, 100.0), lambda x, y: hills(x, y)), SHAPE)  # compile first
    for _ in range(3):
        site = Site((400.0, 400.0), lambda x, y: hills(x, y))
        start = time.process_time()
        values = ground_rasters(site, (512, 512))
        times.append(time.process_time() - start)
    assert set(values) == set(NAMES)
    assert values["sun"].shape == (512, 512)
    assert min(times) < 1.0  # measured 0.4 s on one core
