"""What the checker takes for light: finite and not negative, but for colours outside of Rec. 709."""

from types import SimpleNamespace

import numpy as np
import pytest

from forestgen.dataset.check.light import radiance

KNOWN = {"forestgen/relative_error": "0.1"}


def findings(colour, variance=1.0, mode="rgb", header=KNOWN):
    def planes(values):
        return {name: np.full((2, 3), value, np.float32) for name, value in zip("RGB", values, strict=True)}

    frame = SimpleNamespace(
        exr={"radiance": planes(colour), "radiance.variance": planes([variance] * 3)},
        exr_header=header,
        recipe={"render": {"mode": mode}},
        instance=np.zeros((2, 3), np.uint32),
        name="camera0",
        file=lambda name: f"camera0/{name}",
    )
    return [finding.problem.partition(" (")[0] for finding in radiance.findings(frame)]


@pytest.mark.parametrize(
    ("colour", "mode", "wrong"),
    [
        ((1, 2, 3), "rgb", []),
        ((400, 100, -3), "rgb", ["radiance.B is no light"]),
        ((400, 100, -3), "spectral", []),  # a saturated petal
        ((-400, 100, -3), "spectral", ["radiance has no luminance"]),
        ((400, np.nan, 3), "spectral", ["radiance.G is no light"]),
    ],
)
def test_only_a_colour_made_of_wavelengths_may_have_a_negative_part(colour, mode, wrong):
    assert findings(colour, mode=mode) == wrong


def test_bands_are_not_negative_in_any_mode():
    header = {**KNOWN, "forestgen/bands": "[]"}
    assert findings((1, 2, -3), mode="spectral", header=header) == ["radiance.B is no light"]


def test_a_variance_is_unknown_only_where_no_error_is_told():
    wrong = [f"radiance.variance.{name} is no light" for name in "RGB"]
    assert findings((1, 2, 3), variance=np.nan, header={"forestgen/samples": "4"}) == []
    assert findings((1, 2, 3), variance=np.nan) == wrong
    assert findings((1, 2, 3), variance=-1.0, header={}) == wrong
