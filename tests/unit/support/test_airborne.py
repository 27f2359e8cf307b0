"""What compares airborne pictures, on pictures of known answers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from support.airborne import (
    LUMINANCE,
    WINDOW_PX,
    Floats,
    Picture,
    boxes_of,
    chromaticity,
    compare,
    crowns_and_ground,
    distance,
    distances,
    encoded,
    figures,
    linear,
    otsu,
    quantiles,
    spread,
    sunlit,
    textures,
)

CROWN, GROUND, SHADOW = np.array([0.30, 0.40, 0.15]), np.array([0.45, 0.40, 0.30]), np.array([0.04, 0.06, 0.10])
BOXES = [(10.0, 10.0, 70.0, 70.0), (100.0, 120.0, 180.0, 180.0)]


@pytest.fixture
def painted() -> Picture:
    """Green crowns on brown ground, the eastern quarter in shadow, grain of 1%."""
    side = WINDOW_PX
    crowns, ground = crowns_and_ground(BOXES, (side, side))
    rgb = np.where(crowns[..., None], CROWN, GROUND)
    rgb[:, -50:] = SHADOW
    grain = 1 + 0.01 * np.random.default_rng(1).standard_normal((side, side, 1))
    return Picture(rgb * grain, crowns, ground)


def test_srgb_there_and_back() -> None:
    levels = np.repeat(np.arange(256, dtype=np.uint8), 3).reshape(16, 16, 3)
    assert np.array_equal(encoded(linear(levels)), levels)
    assert linear(np.uint8([188]))[0] == pytest.approx(0.503, abs=0.001)


def test_white_has_the_chromaticity_of_d65() -> None:
    assert chromaticity(np.ones((5, 3))) == pytest.approx([0.1978, 0.4683], abs=2e-4)


def test_otsu_lies_between_two_heaps() -> None:
    rng = np.random.default_rng(2)
    values = np.concatenate([rng.normal(-3, 0.1, 3000), rng.normal(-1, 0.2, 1000)])
    assert -2.7 < otsu(values) < -1.6


def test_ellipses_fill_pi_over_four_of_their_boxes() -> None:
    crowns, ground = crowns_and_ground(BOXES, (WINDOW_PX, WINDOW_PX))
    area = 60 * 60 + 80 * 60
    assert (~ground).sum() == area
    assert crowns.sum() == pytest.approx(np.pi / 4 * area, rel=0.01)


def test_boxes_of_a_file(tmp_path: Path) -> None:
    path = tmp_path / "boxes.xml"
    box = "<bndbox><xmin>1</xmin><ymin>2</ymin><xmax>5</xmax><ymax>7</ymax></bndbox>"
    path.write_text(f"<annotation><object>{box}</object></annotation>")
    assert boxes_of(path) == [(1, 2, 5, 7)]


def test_figures_of_a_painted_picture(painted: Picture) -> None:
    (found,) = figures(painted)
    crown, floor, shade = (colour @ LUMINANCE for colour in (CROWN, GROUND, SHADOW))
    assert found["shadow share"] == pytest.approx(0.25, abs=1e-3)
    for method in ("boxes", "split"):
        assert found[f"crown / ground, {method}"] == pytest.approx(crown / floor, rel=0.02), method
        assert found[f"crown u', {method}"] == pytest.approx(chromaticity(CROWN[None])[0], abs=1e-3)
        assert found[f"ground v', {method}"] == pytest.approx(chromaticity(GROUND[None])[1], abs=1e-3)
    lit = painted.rgb[sunlit(painted)].mean(axis=0) @ LUMINANCE
    assert found["shadow / sunlit"] == pytest.approx(shade / lit, rel=0.01)


def test_figures_do_not_depend_on_exposure(painted: Picture) -> None:
    (one,), (other,) = figures(painted), figures(replace(painted, rgb=0.5 * painted.rgb))
    assert other == pytest.approx(one, rel=0.02)


def test_crowns_may_be_the_less_green(painted: Picture) -> None:
    (found,) = figures(replace(painted, greener=False))
    assert found["crown / ground, split"] == pytest.approx(GROUND @ LUMINANCE / (CROWN @ LUMINANCE), rel=0.02)


def test_without_boxes_there_is_the_split_alone(painted: Picture) -> None:
    (found,) = figures(replace(painted, crowns=None, ground=None))
    assert np.isnan(found["crown / ground, boxes"])
    assert found["crown / ground, split"] > 0


def test_what_does_not_count_is_left_out(painted: Picture) -> None:
    seen = np.ones(painted.rgb.shape[:2], dtype=bool)
    seen[:, :40] = False
    assert figures(replace(painted, seen=seen)) == []


def test_a_ramp_has_its_slope_as_gradient() -> None:
    across = np.exp(np.linspace(-4, 0, WINDOW_PX))
    rgb = np.broadcast_to(across[:, None], (WINDOW_PX, WINDOW_PX, 3)) - 1e-3
    slope = 4 / (WINDOW_PX - 1)
    found = textures(Picture(np.asarray(rgb)))
    assert np.median(found["gradient"][0]) == pytest.approx(slope, rel=0.01)
    assert np.median(found["contrast"][0]) == pytest.approx(slope * np.sqrt((9**2 - 1) / 12), rel=0.01)


def test_distance_of_shifted_distributions_is_the_shift() -> None:
    rng = np.random.default_rng(3)
    one: Floats = quantiles(rng.normal(size=20000))
    assert distance(one, one + 0.3) == pytest.approx(0.3)
    ours, between = distances([one + 0.5], [one, one + 0.1, one - 0.1])
    assert ours[0] == pytest.approx(0.5, abs=0.05)
    assert max(between) < 0.2


def test_spread_and_medians_leave_out_what_is_not_known() -> None:
    assert spread([*np.linspace(0, 1, 101), np.nan]) == pytest.approx((0.05, 0.95))
    found = compare([{"a": 1.0}, {"a": np.nan}, {"a": 3.0}], [{"a": 2.5}])
    assert found["a"] == pytest.approx((1.1, 2.9, 2.0, 2.5))
