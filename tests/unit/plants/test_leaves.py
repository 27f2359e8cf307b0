"""Leaf blades: what their outlines and triangles must be, whatever the keys say."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import gamma

from forestgen.geometry.patches import Patch, area_m2
from forestgen.plants.leaf_fall import with_leaves
from forestgen.plants.organs.leaves import CompoundLeaf, LobedBlade, PalmateBlade, SimpleBlade, SimpleLeaf
from forestgen.plants.skeleton import OrganPlacements, Skeleton
from forestgen.recipe.phenology import LeafState

LENGTH_M, WIDTH_M = 0.1, 0.06
AnyBlade = SimpleBlade | LobedBlade | PalmateBlade


def simple(widest: float = 0.4, base: float = 0.5, tip: float = 1.0, **keys: Any) -> SimpleBlade:
    size = {"length_m": LENGTH_M, "width_m": WIDTH_M}
    return SimpleBlade(form="simple", widest=widest, base=base, tip=tip, **(size | keys))


def lobed(**keys: Any) -> LobedBlade:
    return LobedBlade(form="lobed", length_m=LENGTH_M, width_m=WIDTH_M, **keys)


def palmate(**keys: Any) -> PalmateBlade:
    return PalmateBlade(form="palmate", length_m=LENGTH_M, width_m=WIDTH_M, **keys)


def shares(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False)


ENTIRE = st.builds(
    simple,
    widest=shares(0.1, 0.9),
    base=shares(0.15, 3.0),
    tip=shares(0.15, 3.0),
    teeth=st.integers(0, 60),
    tooth_depth=shares(0.0, 0.35),
    double_teeth=st.booleans(),
)
HEART = st.builds(
    lambda blade, **keys: simple(**{**blade.model_dump(exclude={"form"}), **keys}),
    ENTIRE,
    base=shares(0.15, 1.0),
    heart=shares(0.0, 0.3),
)
LOBED = st.builds(
    lobed,
    lobes=st.integers(1, 15),
    sinus=shares(0.0, 0.9),
    roundness=shares(1.0, 8.0),
    slant=shares(0.0, 0.45),
    widest=shares(0.1, 0.9),
    base=shares(0.15, 3.0),
    tip=shares(0.15, 3.0),
)
PALMATE = st.builds(
    palmate,
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


@settings(max_examples=120, deadline=None)
@given(outline=st.one_of(ENTIRE, HEART, LOBED, PALMATE), detail=st.sampled_from([0, 1, 2]))
def test_any_outline_is_tiled_by_upright_triangles(outline: AnyBlade, detail: int) -> None:
    sheet = outline.blade(detail)
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
    outline: AnyBlade, fold_deg: float, curl_deg: float, waves: float
) -> None:
    area = area_m2(outline.blade(2))
    assert area > 0.0
    waved = {} if isinstance(outline, PalmateBlade) else {"waves": waves, "wave_height": 0.15}
    shaped = outline.model_copy(update={"fold_deg": fold_deg, "curl_deg": curl_deg, **waved})
    for detail in (0, 1, 2):
        assert area_m2(shaped.blade(detail)) == pytest.approx(area, rel=0.03)


@pytest.mark.parametrize("widest", [0.3, 0.5, 0.7])
@pytest.mark.parametrize(("base", "tip"), [(0.5, 0.5), (0.5, 1.0), (1.0, 1.0), (1.5, 1.0), (0.35, 0.8), (0.5, 2.0)])
def test_area_of_an_entire_leaf_is_that_of_its_formula(widest: float, base: float, tip: float) -> None:
    def half(sharpness: float) -> float:
        return np.sqrt(np.pi) * gamma(sharpness + 1.0) / (2.0 * gamma(sharpness + 1.5))

    expected = LENGTH_M * WIDTH_M * (widest * half(base) + (1.0 - widest) * half(tip))
    assert area_m2(simple(widest, base, tip).blade(2)) == pytest.approx(expected, rel=0.01)


def test_an_ellipse_is_a_leaf() -> None:
    sheet = simple(0.5, 0.5, 0.5).blade(2)
    assert area_m2(sheet) == pytest.approx(np.pi / 4.0 * LENGTH_M * WIDTH_M, rel=0.01)
    off = (sheet.points[:, 0] / (0.5 * WIDTH_M)) ** 2 + (sheet.points[:, 1] / (0.5 * LENGTH_M) - 1.0) ** 2
    rim = np.abs(sheet.points[:, 0]) > 1e-9
    np.testing.assert_allclose(off[rim], 1.0, atol=1e-9)


@pytest.mark.parametrize("outline", [simple(), simple(teeth=9), lobed(), palmate()])
@pytest.mark.parametrize("fold_deg", [0.0, 30.0])
@pytest.mark.parametrize("curl_deg", [0.0, 40.0])
def test_fold_and_curl_leave_the_area(outline: AnyBlade, fold_deg: float, curl_deg: float) -> None:
    shaped = outline.model_copy(update={"fold_deg": fold_deg, "curl_deg": curl_deg})
    assert area_m2(shaped.blade(2)) == pytest.approx(area_m2(outline.blade(2)), rel=0.002)


@pytest.mark.parametrize("outline", [simple(), simple(heart=0.2), palmate()])
def test_length_and_width_are_those_asked_for(outline: AnyBlade) -> None:
    sheet = outline.blade(2)
    assert np.ptp(sheet.points[:, 0]) == pytest.approx(WIDTH_M, rel=0.01)
    assert sheet.points[:, 1].max() == pytest.approx(LENGTH_M, rel=1e-9)
    assert np.linalg.norm(sheet.points, axis=1).min() == 0.0, "the foot is in the origin"


def test_lobes_can_be_counted() -> None:
    sheet = lobed(lobes=4, slant=0.0).blade(2)
    right = sheet.points[sheet.points[:, 0] > 1e-9]
    x = right[np.argsort(right[:, 1]), 0]
    peaks = np.sum((x[1:-1] > x[:-2] + 1e-6) & (x[1:-1] > x[2:] + 1e-6))
    assert peaks in (4, 5), "the lobe at the tip may have a peak of its own"


def test_teeth_can_be_counted() -> None:
    sheet = simple(0.5, 0.5, 0.5, teeth=12, tooth_depth=0.1).blade(2)
    right = sheet.points[sheet.points[:, 0] > 1e-9]
    right = right[np.argsort(right[:, 1])]
    t = right[:, 1] / LENGTH_M
    beyond = right[:, 0] / (0.5 * WIDTH_M) > np.sqrt(1.0 - (2.0 * t - 1.0) ** 2)
    assert beyond.sum() == 12


def test_palmate_lobes_are_the_farthest_points() -> None:
    sheet = palmate(lobes=7, spread_deg=108.0, teeth=0).blade(1)
    radius = np.linalg.norm(sheet.points[1:] / [0.5 * WIDTH_M, LENGTH_M, 1.0], axis=1)
    peaks = (radius[1:-1] > radius[:-2]) & (radius[1:-1] > radius[2:])
    assert peaks.sum() == 7


def test_curl_bends_the_tip_down_and_fold_raises_the_margin() -> None:
    curled = simple(curl_deg=90.0).blade(2)
    assert curled.points[:, 2].min() == pytest.approx(-LENGTH_M * 2.0 / np.pi, rel=0.01), "a quarter of a circle"
    folded = simple(fold_deg=30.0).blade(2)
    margin = np.abs(folded.points[:, 0]) > 1e-9
    np.testing.assert_allclose(
        folded.points[margin, 2] / np.abs(folded.points[margin, 0]), np.tan(np.radians(30.0)), rtol=1e-6
    )


def test_the_petiole_adds_its_own_area() -> None:
    keys: dict[str, Any] = {"form": "simple", "material": "leaf", "length_m": LENGTH_M, "width_m": WIDTH_M}
    for detail in (0, 1):
        leaf = SimpleLeaf(**keys, stalk_m=0.04, stalk_width_m=0.002, detail=detail)
        area = sum(area_m2(one.patch) for one in leaf.patches())
        assert area - area_m2(leaf.blade(detail)) == pytest.approx(0.04 * 0.002)


@pytest.mark.parametrize("palmate", [False, True])
@pytest.mark.parametrize("leaflets", [2, 3, 7, 12])
def test_a_compound_leaf_is_its_leaflets(palmate: bool, leaflets: int) -> None:
    leaflet = simple(length_m=0.05, width_m=0.02)
    whole = CompoundLeaf(
        form="compound",
        material="leaf",
        leaflet=leaflet,
        leaflets=leaflets,
        arrangement="palmate" if palmate else "pinnate",
        rachis_m=0.0 if palmate else 0.1,
        stalk_m=0.0 if palmate else 0.02,
        stalk_width_m=0.001,
        taper=1.0,
    )
    stalk = 0.0 if palmate else 0.12 * 0.001
    [one] = whole.patches()
    assert area_m2(one.patch) == pytest.approx(leaflets * area_m2(leaflet.blade(1)) + stalk, rel=1e-6)


def test_dead_leaves_with_a_shape_of_their_own_lie_once_all_are_withered() -> None:
    upright = np.tile(np.column_stack([np.eye(3)[:, [0, 2, 1]] * [1.0, 1.0, -1.0], np.zeros(3)]), (200, 1, 1))
    organs = OrganPlacements("frond", 0.7 * upright.astype(np.float32), np.zeros(200, np.int32))
    skeleton = Skeleton.of([-1], np.zeros((1, 3)), np.ones(1), np.zeros(1), np.zeros(1), organs=(organs,))
    frond = SimpleLeaf(form="simple", material="frond", length_m=0.7, width_m=0.3)
    shapes = {"frond": frond, "dead_frond": frond}
    for withered in (0.5, 1.0):
        state = LeafState(0.7, spectra=(0.0, 0.0, 1.0 - withered, withered))
        [left] = with_leaves(skeleton, shapes, state, np.random.default_rng(3)).organs
        rise = left.frame[:, 2, 1] / np.linalg.norm(left.frame[:, :, 1], axis=1)
        assert (left.shape, bool(np.all(np.abs(rise) < 0.4))) == (
            ("dead_frond", True) if withered == 1.0 else ("frond", False)
        )
        np.testing.assert_allclose(np.linalg.norm(left.frame[:, :, 1], axis=1), 0.7, rtol=1e-5)
