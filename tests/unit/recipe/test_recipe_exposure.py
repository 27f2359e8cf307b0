from __future__ import annotations

import pytest
from pydantic import ValidationError

from forestgen.recipe.exposure import Exposure


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ({"shutter_s": 0.01, "ev": 14.0}, "exposure is given twice"),
        ({"shutter_s": 0.01, "compensation_ev": 1.0}, "only a metered exposure"),
        ({"ev": 12.0, "compensation_ev": 1.0}, "only a metered exposure"),
        ({"iso": 50.0}, "well is full"),
        ({"iso": 200.0, "base_iso": 400.0}, "well is full"),
        ({"shutter_s": 0.0}, "greater than"),
        ({"f_number": 0.1}, "greater than or equal to 0.5"),
        ({"vignetting": 1.5}, "less than or equal to 1"),
        ({"bits": 24}, "less than or equal to 16"),
        ({"bits": 14.5}, "integer"),
        ({"ev": float("inf")}, "finite"),
        ({"read_noise_electrons": -1.0}, "greater than or equal to 0"),
        ({"aperture": 8}, "Extra inputs"),
    ],
)
def test_mistakes(section, words):
    with pytest.raises(ValidationError, match=words):
        Exposure(**section)


def test_nothing_said_is_metered():
    made = Exposure()
    assert made.shutter_s is None
    assert made.ev is None
    assert Exposure(iso=50.0, base_iso=50.0).iso == 50.0
