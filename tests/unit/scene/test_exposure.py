from __future__ import annotations

import pytest

from forestgen.recipe.camera_keys import Exposure as Section
from forestgen.scene.exposure import Exposure, exposure_of


def test_a_section_becomes_an_exposure():
    assert exposure_of(None) is None
    section = Section(f_number=4.0, iso=800.0, base_iso=200.0, compensation_ev=0.5, bits=12, mosaic=False)
    made = exposure_of(section)
    assert made == Exposure(4.0, None, 800.0, 0.0, 30_000.0, 3.0, 12, False, 200.0, 0.5)
    assert exposure_of(Section(shutter_s=0.25)).shutter_s == 0.25


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
    made = exposure_of(Section(ev=ev, f_number=f_number, iso=iso))
    assert made.shutter_for_s(1e9) == pytest.approx(shutter_s)  # whatever the light


def test_a_meter_on_4096_candelas_says_ev_15():
    """ISO 2720: L = K 2^EV / 100 with K = 12.5."""
    metered = exposure_of(Section(f_number=16.0)).shutter_for_s(12.5 * 2**15 / 100)
    assert metered == pytest.approx(exposure_of(Section(f_number=16.0, ev=15.0)).shutter_s)
    assert exposure_of(Section(f_number=16.0, compensation_ev=-2.0)).shutter_for_s(4096.0) == pytest.approx(1 / 512)
    assert exposure_of(Section()).shutter_for_s(0.0) == 1.0
