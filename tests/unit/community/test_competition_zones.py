"""Firbank-Watkinson zones of influence and Lepš-Kindlmann overlaps, against oracles that know no grid and no arcs."""

from __future__ import annotations

import math
import tracemalloc
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from forestgen.community.competition import firbank_watkinson as fw
from forestgen.community.competition import leps_kindlmann as lk
from forestgen.community.competition.contract import Circles
from forestgen.core import threads

COMPETITION_MODELS = [fw.MODEL, lk.MODEL]
EACH = pytest.mark.parametrize("environment", COMPETITION_MODELS, ids=lambda one: type(one).__name__)
GAUSS = np.polynomial.legendre.leggauss(400)  # the eigenvalues of a large matrix: once
TORUS = pytest.mark.parametrize("periodic", [True, False])


def zones(circles, size=(100.0, 100.0), d=0.9, periodic=False):
    return fw.MODEL.answer(fw.MODEL.Parameters(one_sided=d), circles, size, periodic=periodic)


def factors(circles, size=(100.0, 100.0), q=1.0, periodic=False):
    return lk.MODEL.answer(lk.MODEL.Parameters(tolerance=q), circles, size, periodic=periodic)


def answer(environment, circles, size, periodic):
    return environment.answer(environment.Parameters(), circles, size, periodic=periodic)


def make(x, r, h=None, ids=None):
    n = len(r)
    r = np.asarray(r, dtype=float)
    return Circles(
        np.asarray(x, dtype=float).reshape(n, 2),
        r,
        r if h is None else np.asarray(h, dtype=float),
        np.arange(1, n + 1, dtype=np.uint32) if ids is None else np.asarray(ids, dtype=np.uint32),
        np.zeros(n, dtype=np.uint16),
    )


def stand(seed, n, size, largest=1.5):
    """Circles of mixed sizes; heights tie often."""
    rng = np.random.default_rng(seed)
    return make(
        rng.random((n, 2)) * size, largest * rng.beta(1, 3, n) + 0.01, rng.integers(1, 6, n), 1 + rng.permutation(n)
    )


def permuted(c, order):
    return make(c.position_m[order], c.radius_m[order], c.height_m[order], c.plant_id[order])


def lens(d, r, s):
    """Shared area of two circles by quadrature over the chord."""
    if d >= r + s:
        return 0.0
    y, w = GAUSS
    # x = centre + radius sin(t) removes the square root's end points
    low, high = max(-r, d - s), min(r, d + s)
    parts = sorted({low, high, min(max((d * d + r * r - s * s) / (2 * d), low), high)} if d > 0 else {low, high})
    total = 0.0
    for a, b in pairwise(parts):
        t = (a + b) / 2 - (b - a) / 2 * np.cos(np.pi * (y + 1) / 2)
        step = (b - a) / 2 * np.sin(np.pi * (y + 1) / 2) * np.pi / 2
        half = np.sqrt(np.maximum(0, np.minimum(r * r - t * t, s * s - (t - d) ** 2)))
        total += float(np.sum(w * step * 2 * half))
    return total


def shifts(size, periodic, reach):
    if not periodic:
        return [(0.0, 0.0)]
    many = [math.ceil(reach / length) for length in size]
    return [(i * size[0], j * size[1]) for i in range(-many[0], many[0] + 1) for j in range(-many[1], many[1] + 1)]


def zones_by_points(c, size, d, periodic, points=4_000):
    """z / q by a spiral of equal areas in each circle; the error is of the order of edge length / sqrt(points)."""
    k = np.arange(points)
    disc = np.sqrt((k + 0.5) / points)[:, None] * np.stack(
        [np.cos(k * np.pi * (3 - 5**0.5)), np.sin(k * np.pi * (3 - 5**0.5))], axis=1
    )
    rank = np.empty(len(c), dtype=int)
    rank[np.lexsort((c.plant_id, -c.height_m))] = np.arange(len(c))
    out = np.empty(len(c))
    for i in range(len(c)):
        at = c.position_m[i] + c.radius_m[i] * disc
        taller, all_ = np.zeros(points, dtype=int), np.zeros(points, dtype=int)
        for dx, dy in shifts(size, periodic, 2 * c.radius_m.max()):
            for j in range(len(c)):
                covers = np.sum((at - c.position_m[j] - (dx, dy)) ** 2, axis=1) <= c.radius_m[j] ** 2
                all_ += covers
                first = (rank[j], dx, dy) < (rank[i], 0.0, 0.0)
                taller += covers & first
        out[i] = np.where(taller == all_ - 1, (1 - d) ** taller, d * (1 - d) ** taller).mean()
    return out


def union_area(c, size, periodic):
    """Area of the union of circles, from lines across the site; exact along each line."""
    shift = shifts(size, periodic, 2 * c.radius_m.max())
    centre = np.concatenate([c.position_m + s for s in shift])
    r = np.tile(c.radius_m, len(shift))
    low, high = (0.0, size[1]) if periodic else (np.min(centre[:, 1] - r), np.max(centre[:, 1] + r))
    left, right = (0.0, size[0]) if periodic else (-np.inf, np.inf)
    lines = 2_000
    total = 0.0
    for y in low + (high - low) * (np.arange(lines) + 0.5) / lines:
        half2 = r * r - (y - centre[:, 1]) ** 2
        hit = half2 > 0
        half = np.sqrt(half2[hit])
        a = np.clip(centre[hit, 0] - half, left, right)
        b = np.clip(centre[hit, 0] + half, left, right)
        order = np.argsort(a)
        a, b = a[order], b[order]
        reached = np.maximum.accumulate(b)
        before = np.concatenate([[-np.inf], reached[:-1]])
        total += float(np.sum(np.maximum(0.0, b - np.maximum(a, before))))
    return total * (high - low) / lines


@EACH
@TORUS
def test_a_plant_without_neighbours_gets_all(environment, periodic):
    alone = make([[3, 3], [9, 9]], [1.0, 2.0])
    np.testing.assert_allclose(answer(environment, alone, (20.0, 20.0), periodic), 1.0, atol=1e-12)
    one = make([[3, 3]], [1.0])
    np.testing.assert_allclose(answer(environment, one, (20.0, 20.0), periodic), 1.0, atol=1e-12)
    assert answer(environment, make(np.zeros((0, 2)), []), (20.0, 20.0), periodic).shape == (0,)


@given(
    d=st.floats(0.0, 4.0),
    r=st.floats(0.1, 2.0),
    s=st.floats(0.1, 2.0),
    one_sided=st.floats(0.05, 1),
    angle=st.floats(0, 7),
)
@settings(deadline=None, max_examples=60)
def test_two_circles(d, r, s, one_sided, angle):
    shared = lens(d, r, s)
    x = np.array([[50.0, 50.0], [50 + d * math.cos(angle), 50 + d * math.sin(angle)]])
    got = zones(make(x, [r, s], [2.0, 1.0]), d=one_sided)
    expected = [1 - (1 - one_sided) * shared / (math.pi * r * r), 1 - one_sided * shared / (math.pi * s * s)]
    np.testing.assert_allclose(got, expected, atol=2e-6)
    got = factors(make(x, [r, s], [2.0, 1.0]), q=1.5)
    expected = [1 - shared * 0.5 / (1.5 * math.pi * r * r), 1 - shared * 2 / (1.5 * math.pi * s * s)]
    np.testing.assert_allclose(got, np.maximum(0, expected), atol=2e-6)


def test_a_lens_known_from_textbooks():
    assert lk.lens_area(1.0, 1.0, 1.0) == pytest.approx(2 * math.pi / 3 - math.sqrt(3) / 2, rel=1e-14)
    assert lk.lens_area(0.0, 1.0, 3.0) == pytest.approx(math.pi)
    assert lk.lens_area(2.0, 1.0, 3.0) == pytest.approx(math.pi)
    assert lk.lens_area(4.0, 1.0, 3.0) == 0.0


@pytest.mark.parametrize("d", [0.3, 0.9, 1.0])
@TORUS
def test_zones_agree_with_points(d, periodic):
    c = stand(3, 25, (10.0, 8.0), 3.0)
    got = zones(c, (10.0, 8.0), d, periodic)
    np.testing.assert_allclose(got, zones_by_points(c, (10.0, 8.0), d, periodic), atol=4e-3)


def test_zones_agree_with_points_where_circles_overlap_their_images():
    c = make([[0.3, 0.2], [0.8, 1.1], [1.5, 0.4]], [1.3, 0.9, 0.4], [1.0, 2.0, 2.0])
    got = zones(c, (2.0, 1.5), 0.7, True)
    np.testing.assert_allclose(got, zones_by_points(c, (2.0, 1.5), 0.7, True), atol=4e-3)


@pytest.mark.parametrize("d", [0.2, 0.5, 0.9, 1.0])
@TORUS
def test_zones_sum_to_the_union(d, periodic):
    for seed, n, size, largest in ((1, 150, (20.0, 15.0), 2.0), (2, 12, (3.0, 4.0), 3.5), (3, 1, (1.0, 2.0), 0.9)):
        c = stand(seed, n, size, largest)
        total = float(np.sum(zones(c, size, d, periodic) * np.pi * c.radius_m**2))
        assert total == pytest.approx(union_area(c, size, periodic), rel=1e-4)


def test_circles_in_one_place_share_it():
    c = make([[5, 5]] * 3 + [[5, 6]], [2.0, 2.0, 2.0, 1.0], [1.0, 3.0, 3.0, 0.5])
    np.testing.assert_allclose(zones(c, d=0.6), [0.16 * 0.75 + 0.4**2 * 0.6 * 0.25, 0.6, 0.24, 0.4**3], atol=1e-12)


def test_circles_that_touch_from_inside_or_outside():
    c = make([[5, 5], [5, 6], [5, 8]], [2.0, 1.0, 1.0], [1.0, 2.0, 3.0])
    np.testing.assert_allclose(zones(c, d=1.0), [0.75, 1.0, 1.0], atol=1e-12)


def test_many_circles_round_a_large_one():
    """More neighbours than the tables have room for at first."""
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    x = np.concatenate([[[50.0, 50.0]], 50 + 20 * np.stack([np.cos(angle), np.sin(angle)], axis=1)])
    c = make(x, [20.0] + [0.1] * 400, [9.0] + [1.0] * 400)
    shared = lens(20.0, 20.0, 0.1) / (np.pi * 0.01)
    np.testing.assert_allclose(zones(c, d=1.0), [1.0] + [1 - shared] * 400, atol=1e-6)


@pytest.mark.parametrize("q", [0.3, 1.0, 8.0])
@TORUS
def test_overlaps_agree_with_all_pairs(q, periodic):
    for seed, n, size, largest in ((5, 150, (20.0, 15.0), 2.0), (6, 6, (1.6, 2.0), 1.5)):
        c = stand(seed, n, size, largest)
        expected = np.empty(n)
        for i in range(n):
            total = 0.0
            for dx, dy in shifts(size, periodic, 2 * c.radius_m.max()):
                d = np.hypot(*(c.position_m + np.array([dx, dy]) - c.position_m[i]).T)
                total += sum(
                    lk.lens_area(d[j], c.radius_m[i], c.radius_m[j]) * c.height_m[j] for j in range(n) if j != i
                )
            expected[i] = max(0.0, 1 - total / (c.height_m[i] * q * math.pi * c.radius_m[i] ** 2))
        np.testing.assert_allclose(factors(c, size, q, periodic), expected, atol=1e-9)


@EACH
@TORUS
def test_rows_may_stand_in_any_order(environment, periodic):
    c = stand(7, 300, (20.0, 20.0))
    mixed = np.random.default_rng(1).permutation(300)
    here, there = (answer(environment, one, (20.0, 20.0), periodic) for one in (c, permuted(c, mixed)))
    np.testing.assert_allclose(there, here[mixed], atol=1e-10)


@EACH
@given(seed=st.integers(0, 1000), dx=st.floats(-100, 100), dy=st.floats(-100, 100))
@settings(deadline=None, max_examples=20)
def test_a_torus_has_no_preferred_place(environment, seed, dx, dy):
    c = stand(seed, 100, (12.0, 9.0))
    moved = make(c.position_m + np.array([dx, dy]), c.radius_m, c.height_m, c.plant_id)
    here, there = (answer(environment, one, (12.0, 9.0), True) for one in (c, moved))
    np.testing.assert_allclose(there, here, atol=1e-8)


@EACH
def test_the_plane_has_no_edge(environment):
    c = stand(8, 200, (15.0, 15.0))
    far = make(c.position_m + np.array([-40.0, 70.0]), c.radius_m, c.height_m, c.plant_id)
    here, there = (answer(environment, one, (15.0, 15.0), False) for one in (c, far))
    np.testing.assert_allclose(there, here, atol=1e-9)


@EACH
def test_threads_have_no_influence(environment, monkeypatch):
    c = stand(9, 40_000, (250.0, 250.0))
    answers = []
    for cores in (1, 2, 3):
        monkeypatch.setattr(threads, "cores", lambda cores=cores: cores)
        answers.append(answer(environment, c, (250.0, 250.0), True))
    np.testing.assert_array_equal(answers[0], answers[1])
    np.testing.assert_array_equal(answers[0], answers[2])


@EACH
def test_one_more_neighbour_never_helps(environment):
    c = stand(10, 80, (15.0, 15.0))
    extra = stand(11, 81, (15.0, 15.0))
    more = make(
        np.concatenate([c.position_m, extra.position_m[:1]]), np.append(c.radius_m, 1.0), np.append(c.height_m, 9.0)
    )
    fewer = make(c.position_m, c.radius_m, c.height_m)
    after, before = (answer(environment, one, (15.0, 15.0), True) for one in (more, fewer))
    assert np.all(after[:-1] <= before + 1e-9)
    assert np.any(after[:-1] < before - 0.01)


def test_taller_plants_get_more_as_competition_becomes_one_sided():
    c = make([[5, 5], [5.5, 5]], [1.0, 1.0], [2.0, 1.0])
    got = np.array([zones(c, d=d) for d in (0.5, 0.7, 0.9, 1.0)])
    assert got[0, 0] == pytest.approx(got[0, 1])
    assert np.all(np.diff(got[:, 0]) > 0)
    assert np.all(np.diff(got[:, 1]) < 0)


def test_neighbours_matter_less_as_tolerance_grows():
    c = stand(12, 100, (15.0, 15.0))
    got = np.array([factors(c, (15.0, 15.0), q) for q in (0.5, 1.0, 4.0, 1e9)])
    assert np.all(np.diff(got, axis=0) >= 0)
    np.testing.assert_allclose(got[-1], 1.0, atol=1e-5)


@EACH
def test_memory_of_a_circle_is_bounded(environment):
    c = stand(13, 50_000, (500.0, 500.0))
    answer(environment, c, (500.0, 500.0), True)
    tracemalloc.start()
    try:
        answer(environment, c, (500.0, 500.0), True)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak / len(c) < 92


@pytest.mark.parametrize("bad", [{"one_sided": 0}, {"one_sided": 1.1}, {"one_sided": float("nan")}, {"d": 0.5}])
def test_impossible_divisions_are_refused(bad):
    with pytest.raises(ValidationError):
        fw.FirbankWatkinsonParameters(**bad)


@pytest.mark.parametrize("bad", [{"tolerance": 0}, {"tolerance": float("inf")}, {"q": 1}])
def test_impossible_tolerances_are_refused(bad):
    with pytest.raises(ValidationError):
        lk.LepsKindlmannParameters(**bad)
