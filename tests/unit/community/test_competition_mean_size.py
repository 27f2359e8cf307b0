"""Aikman-Watkinson competition by mean size, and what all environments have in common."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from pydantic import ValidationError

from forestgen.community.competition.aikman_watkinson import MODEL, AikmanWatkinsonParameters
from forestgen.community.competition.contract import Circles
from forestgen.community.registry import COMPETITION_MODELS
from forestgen.core.errors import RecipeError
from support.error_messages import raises_error

SIZE = (40.0, 25.0)
ASYMMETRY = pytest.mark.parametrize("a", [0.0, 0.5, 1.0, 4.0])
SHARPNESS = pytest.mark.parametrize("s", [0.5, 1.0, 2.0, 50.0])


def make(r, x=None):
    r = np.asarray(r, dtype=float)
    n = len(r)
    x = np.zeros((n, 2)) if x is None else x
    return Circles(x, r, r, np.arange(1, n + 1, dtype=np.uint32), np.zeros(n, dtype=np.uint16))


def shares(r, a=1.0, s=2.0, size=SIZE):
    return MODEL.answer(AikmanWatkinsonParameters(asymmetry=a, sharpness=s), make(r), size, periodic=True)


def radii(n=200, seed=1):
    return np.random.default_rng(seed).lognormal(0, 0.5, n)


@ASYMMETRY
@SHARPNESS
def test_an_empty_plot_leaves_everybody_alone(a, s):
    np.testing.assert_allclose(shares(radii(), a, s, (1e9, 1e9)), 1.0, atol=1e-2 if s < 1 else 1e-6)
    assert shares([], a, s).shape == (0,)


@ASYMMETRY
@SHARPNESS
def test_a_crowded_plot_is_divided_up(a, s):
    r = radii()
    np.testing.assert_allclose(np.sum(np.pi * r**2 * shares(r, a, s, (1e-7, 1e-7))), 1e-14, rtol=1e-3)


@ASYMMETRY
@SHARPNESS
@pytest.mark.parametrize("side", [0.1, 5.0, 20.0, 30.0, 100.0])
def test_no_ground_is_given_away_twice(a, s, side):
    r = radii()
    area = np.pi * r**2
    got = shares(r, a, s, (side, side))
    assert np.all((got >= 0) & (got <= 1))
    assert np.sum(area * got) <= min(area.sum(), side * side) * (1 + 1e-12)


@pytest.mark.parametrize("a", [0.5, 1.0, 4.0])
def test_larger_plants_get_more(a):
    r = np.sort(radii())
    assert np.all(np.diff(shares(r, a)) > 0)


def test_without_asymmetry_all_get_the_same():
    got = shares(radii(), 0.0)
    np.testing.assert_allclose(got, got[0], rtol=1e-12)


@ASYMMETRY
def test_crowding_only_takes(a):
    r = radii()
    got = np.array([shares(r, a, size=(side, side)) for side in (100.0, 50.0, 20.0, 5.0)])
    assert np.all(np.diff(got, axis=0) < 0)


def test_the_equation_by_hand():
    r = np.array([1.0, 2.0])
    q = np.pi * r**2
    u = q * q.sum() / np.sum(q**2)
    crowding = q.sum() / 1000
    np.testing.assert_allclose(shares(r, 1.0, 2.0), (1 + (crowding / u) ** 2) ** -0.5, rtol=1e-12)


def test_equals_at_full_cover():
    """One mean plant a mean plant's area: a sharp onset leaves all of it."""
    got = shares(np.full(10, np.sqrt(100 / np.pi)), 1.0, 1.0)
    np.testing.assert_allclose(got, 0.5, rtol=1e-12)


def test_places_do_not_matter_and_rows_follow():
    r, rng = radii(), np.random.default_rng(2)
    mixed = rng.permutation(len(r))
    np.testing.assert_allclose(shares(r[mixed]), shares(r)[mixed], rtol=1e-12)
    moved = MODEL.answer(AikmanWatkinsonParameters(), make(r, rng.random((len(r), 2)) * SIZE), SIZE, periodic=False)
    np.testing.assert_array_equal(moved, shares(r))


def test_extreme_sizes_stay_finite():
    got = shares([1e-100, 1.0, 1e100], 10.0, 100.0)
    assert np.all(np.isfinite(got))
    assert got[0] == 0


def test_memory_of_a_circle_is_bounded():
    c = make(radii(50_000))
    tracemalloc.start()
    try:
        MODEL.answer(AikmanWatkinsonParameters(asymmetry=0.7), c, SIZE, periodic=True)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak / len(c) < 48


@pytest.mark.parametrize("bad", [{"asymmetry": -1}, {"sharpness": 0}, {"sharpness": float("nan")}, {"b": 1}])
def test_impossible_parameters_are_refused(bad):
    with pytest.raises(ValidationError):
        AikmanWatkinsonParameters(**bad)


def test_competition_models_are_found_by_name():
    assert COMPETITION_MODELS.ids() == [
        "aikman_watkinson",
        "crown_light",
        "domination",
        "firbank_watkinson",
        "leps_kindlmann",
    ]
    for name in COMPETITION_MODELS.ids():
        environment = COMPETITION_MODELS.load(name)
        got = environment.answer(environment.Parameters(), make([0.5] * 3, np.eye(3, 2) * 9), SIZE, periodic=True)
        assert got.dtype == np.float64
        np.testing.assert_allclose(got, 1.0, atol=1e-2)
    with raises_error(RecipeError):
        COMPETITION_MODELS.load("dominance")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("position_m", np.zeros((2, 3))),
        ("position_m", np.full((2, 2), np.nan)),
        ("radius_m", np.array([1.0, 0.0])),
        ("radius_m", np.array([1.0, np.nan])),
        ("height_m", np.array([1.0, np.inf])),
        ("height_m", np.ones(3)),
        ("plant_id", np.ones(1, dtype=np.uint32)),
    ],
)
def test_impossible_circles_are_refused(name, value):
    given = {**vars(make([1.0, 2.0])), name: value}
    with pytest.raises(ValueError, match=name):
        Circles(**given)
