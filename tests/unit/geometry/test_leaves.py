"""Leaf blades: what their outlines and triangles must be, whatever the keys say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import gamma

from forestgen.geometry.leaves import Blade, Entire, Lobed, Outline, Palmate, blade, compound_leaf, leaf
from forestgen.geometry.patches import Patch, area_m2

LENGTH_M, WIDTH_M = 0.1, 0.06


def shares(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False)


ENTIRE = st.builds(
    Entire,
    widest=shares(0.1, 0.9),
    base=shares(0.15, 3.0),
    tip=shares(0.15, 3.0),
    teeth=st.integers(0, 60),
    tooth_depth=shares(0.0, 0.35),
    double=st.booleans(),
)
HEART = st.builds(replace, ENTIRE, base=shares(0.15, 1.0), heart=shares(0.0, 0.3))
LOBED = st.builds(
    Lobed,
    lobes=st.integers(1, 15),
    sinus=shares(0.0, 0.9),
    roundness=shares(1.0, 8.0),
    slant=shares(0.0, 0.45),
    widest=shares(0.1, 0.9),
    base=shares(0.15, 3.0),
    tip=shares(0.15, 3.0),
)
PALMATE = st.builds(
    Palmate,
    lobes=st.sampled_from([3, 5, 7, 9, 11, 13]),
    sinus=shares(0.0, 0.9),
    spread_deg=shares(30.0, 108.0),
    outer=shares(0.2, 1.0),
    teeth=st.integers(0, 6),
    tooth_depth=shares(0.0, 0.3),
)


def signed_areas_m2(sheet: Patch) -> np.ndarray:
    a, b, c = (sheet.points[sheet.faces[:, k], :2] for k in range(3))
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def boundary_area_m2(sheet: Patch) -> float:
    """Area within the edges that one triangle alone has, by the shoelace formula."""
    edges = np.concatenate([sheet.faces[:, [0, 1]], sheet.faces[:, [1, 2]], sheet.faces[:, [2, 0]]])
    there = {tuple(edge) for edge in edges.tolist()}
    assert len(there) == len(edges), "an edge has a direction once at most"
    rim = np.array([edge for edge in there if edge[::-1] not in there])
    (x0, y0), (x1, y1) = sheet.points[rim[:, 0], :2].T, sheet.points[rim[:, 1], :2].T
    assert len(np.unique(rim[:, 0])) == len(rim), "the margin passes each of its points once"
    return float(0.5 * np.sum(x0 * y1 - x1 * y0))


def flat(outline: Outline, detail: int) -> Patch:
    return blade(Blade(outline, LENGTH_M, WIDTH_M, detail=detail))


@settings(max_examples=120, deadline=None)
@given(outline=st.one_of(ENTIRE, HEART, LOBED, PALMATE), detail=st.sampled_from([0, 1, 2]))
def test_any_outline_is_tiled_by_upright_triangles(outline: Outline, detail: int) -> None:
    sheet = flat(outline, detail)
    areas = signed_areas_m2(sheet)
    assert areas.min() > 0.0, "every triangle shows its upper side, so none crosses another's fan"
    assert areas.sum() == pytest.approx(boundary_area_m2(sheet), rel=1e-9)


@settings(max_examples=60, deadline=None)
@given(
    outline=st.one_of(ENTIRE, HEART, LOBED, PALMATE),
    fold_deg=shares(0, 80),
    curl_deg=shares(-200, 200),
    waves=shares(0, 20),
)
def test_every_level_of_detail_has_the_same_area(
    outline: Outline, fold_deg: float, curl_deg: float, waves: float
) -> None:
    area = area_m2(flat(outline, 2))
    assert area > 0.0
    for detail in (0, 1, 2):
        shaped = Blade(outline, LENGTH_M, WIDTH_M, fold_deg, curl_deg, waves, 0.15, detail)
        assert area_m2(blade(shaped)) == pytest.approx(area, rel=0.03)


@pytest.mark.parametrize("widest", [0.3, 0.5, 0.7])
@pytest.mark.parametrize(("base", "tip"), [(0.5, 0.5), (0.5, 1.0), (1.0, 1.0), (1.5, 1.0), (0.35, 0.8), (0.5, 2.0)])
def test_area_of_an_entire_leaf_is_that_of_its_formula(widest: float, base: float, tip: float) -> None:
    def half(sharpness: float) -> float:
        return np.sqrt(np.pi) * gamma(sharpness + 1.0) / (2.0 * gamma(sharpness + 1.5))

    expected = LENGTH_M * WIDTH_M * (widest * half(base) + (1.0 - widest) * half(tip))
    assert area_m2(flat(Entire(widest, base, tip), 2)) == pytest.approx(expected, rel=0.01)


def test_an_ellipse_is_a_leaf() -> None:
    sheet = flat(Entire(0.5, 0.5, 0.5), 2)
    assert area_m2(sheet) == pytest.approx(np.pi / 4.0 * LENGTH_M * WIDTH_M, rel=0.01)
    off = (sheet.points[:, 0] / (0.5 * WIDTH_M)) ** 2 + (sheet.points[:, 1] / (0.5 * LENGTH_M) - 1.0) ** 2
    rim = np.abs(sheet.points[:, 0]) > 1e-9
    np.testing.assert_allclose(off[rim], 1.0, atol=1e-9)


@pytest.mark.parametrize("outline", [Entire(), Entire(teeth=9), Lobed(), Palmate()])
@pytest.mark.parametrize("fold_deg", [0.0, 30.0])
@pytest.mark.parametrize("curl_deg", [0.0, 40.0])
def test_fold_and_curl_leave_the_area(outline: Outline, fold_deg: float, curl_deg: float) -> None:
    shaped = area_m2(blade(Blade(outline, LENGTH_M, WIDTH_M, fold_deg, curl_deg, detail=2)))
    assert shaped == pytest.approx(area_m2(flat(outline, 2)), rel=0.002)


@pytest.mark.parametrize("outline", [Entire(), Entire(heart=0.2), Palmate()])
def test_length_and_width_are_those_asked_for(outline: Outline) -> None:
    sheet = flat(outline, 2)
    assert np.ptp(sheet.points[:, 0]) == pytest.approx(WIDTH_M, rel=0.01)
    assert sheet.points[:, 1].max() == pytest.approx(LENGTH_M, rel=1e-9)
    assert np.linalg.norm(sheet.points, axis=1).min() == 0.0, "the foot is in the origin"


def test_lobes_can_be_counted() -> None:
    sheet = flat(Lobed(lobes=4, slant=0.0), 2)
    right = sheet.points[sheet.points[:, 0] > 1e-9]
    x = right[np.argsort(right[:, 1]), 0]
    peaks = np.sum((x[1:-1] > x[:-2] + 1e-6) & (x[1:-1] > x[2:] + 1e-6))
    assert peaks in (4, 5), "the lobe at the tip may have a peak of its own"


def test_teeth_can_be_counted() -> None:
    sheet = flat(Entire(0.5, 0.5, 0.5, teeth=12, tooth_depth=0.1), 2)
    right = sheet.points[sheet.points[:, 0] > 1e-9]
    right = right[np.argsort(right[:, 1])]
    t = right[:, 1] / LENGTH_M
    beyond = right[:, 0] / (0.5 * WIDTH_M) > np.sqrt(1.0 - (2.0 * t - 1.0) ** 2)
    assert beyond.sum() == 12


def test_palmate_lobes_are_the_farthest_points() -> None:
    sheet = flat(Palmate(lobes=7, spread_deg=108.0, teeth=0), 1)
    radius = np.linalg.norm(sheet.points[1:] / [0.5 * WIDTH_M, LENGTH_M, 1.0], axis=1)
    peaks = (radius[1:-1] > radius[:-2]) & (radius[1:-1] > radius[2:])
    assert peaks.sum() == 7


def test_curl_bends_the_tip_down_and_fold_raises_the_margin() -> None:
    curled = blade(Blade(Entire(), LENGTH_M, WIDTH_M, 0.0, 90.0, detail=2))
    assert curled.points[:, 2].min() == pytest.approx(-LENGTH_M * 2.0 / np.pi, rel=0.01), "a quarter of a circle"
    folded = blade(Blade(Entire(), LENGTH_M, WIDTH_M, 30.0, detail=2))
    margin = np.abs(folded.points[:, 0]) > 1e-9
    np.testing.assert_allclose(
        folded.points[margin, 2] / np.abs(folded.points[margin, 0]), np.tan(np.radians(30.0)), rtol=1e-6
    )


def test_the_petiole_adds_its_own_area() -> None:
    for detail in (0, 1):
        shape = Blade(Entire(), LENGTH_M, WIDTH_M, detail=detail)
        assert area_m2(leaf(shape, 0.04, 0.002)) - area_m2(blade(shape)) == pytest.approx(0.04 * 0.002)


@pytest.mark.parametrize("palmate", [False, True])
@pytest.mark.parametrize("leaflets", [2, 3, 7, 12])
def test_a_compound_leaf_is_its_leaflets(palmate: bool, leaflets: int) -> None:
    shape = Blade(Entire(), 0.05, 0.02, detail=1)
    whole = compound_leaf(
        shape,
        leaflets,
        palmate=palmate,
        rachis_m=0.1,
        stalk_m=0.0 if palmate else 0.02,
        stalk_width_m=0.001,
        angle_deg=60.0,
        taper=1.0,
        curl_deg=0.0,
    )
    stalk = 0.0 if palmate else 0.12 * 0.001
    assert area_m2(whole) == pytest.approx(leaflets * area_m2(blade(shape)) + stalk, rel=1e-6)
