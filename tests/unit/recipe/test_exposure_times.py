from __future__ import annotations

import pytest

from forestgen.recipe.exposure import Exposure


def test_a_set_shutter_is_kept():
    assert Exposure(shutter_s=0.25).shutter_for_s(1e9) == 0.25


@pytest.mark.parametrize(
    ("ev", "f_number", "iso", "shutter_s"),
    [
        (0.0, 1.0, 100.0, 1.0),  # the definition
        (15.0, 16.0, 100.0, 1 / 128),
        (12.0, 8.0, 100.0, 1 / 64),
        (12.0, 8.0, 400.0, 1 / 256),
        (-2.0, 2.0, 1600.0, 1.0),
    ],
)
def test_exposure_values(ev, f_number, iso, shutter_s):
    made = Exposure(ev=ev, f_number=f_number, iso=iso)
    assert made.shutter_for_s(1e9) == pytest.approx(shutter_s)  # whatever the light


def test_a_meter_on_4096_candelas_says_ev_15():
    """ISO 2720: L = K 2^EV / 100 with K = 12.5."""
    metered = Exposure(f_number=16.0).shutter_for_s(12.5 * 2**15 / 100)
    assert metered == pytest.approx(Exposure(f_number=16.0, ev=15.0).shutter_for_s(0.0))
    assert Exposure(f_number=16.0, compensation_ev=-2.0).shutter_for_s(4096.0) == pytest.approx(1 / 512)
    assert Exposure().shutter_for_s(0.0) == 1.0
