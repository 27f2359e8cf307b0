from __future__ import annotations

import os
import subprocess
import sys
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forestgen.community.competition import domination
from forestgen.community.competition.contract import Circles
from forestgen.core import threads


def brute_force(x, r, ids, size, periodic):
    """Domination as the thesis words it, all pairs."""
    d = np.abs(x[:, None] - x[None])
    if periodic:
        d = np.minimum(d, np.array(size) - d)
    touch = np.sum(d**2, axis=2) <= (r[:, None] + r[None]) ** 2
    larger = (r[None] > r[:, None]) | ((r[None] == r[:, None]) & (ids[None] < ids[:, None]))
    return np.any(touch & larger, axis=1)


KINDS = ["equal", "few values", "nearly equal", "crowd", "uniform", "forest", "clustered", "huge"]


def circles(rng, n, size, kind):
    x = rng.random((n, 2)) * size
    if kind == "crowd":  # all in a corner: crowded cells with many that the champions do not meet
        x *= 0.1
    if kind == "clustered":
        x = np.mod(x[rng.integers(0, max(1, n // 20) + 1, n) % n] + rng.normal(0, 0.3, (n, 2)), size)
    r = {
        "equal": np.full(n, 0.5),
        "few values": rng.integers(1, 5, n) / 4,
        "nearly equal": 0.5 + 1e-9 * np.arange(n),
        "crowd": np.sort(rng.uniform(0.01, 0.05, n)),
        "uniform": rng.uniform(0.01, 1.5, n),
        "forest": np.where(rng.random(n) < 0.03, rng.uniform(1, 6, n), rng.uniform(0.02, 0.1, n)),
        "clustered": np.exp(rng.normal(-3, 2, n)),
        "huge": rng.uniform(0.1, 3 * max(size), n),
    }[kind]
    return x, r, (1 + rng.permutation(n)).astype(np.uint32)


@settings(deadline=None, max_examples=150)
@given(
    seed=st.integers(0, 2**32),
    n=st.integers(0, 300),
    size=st.tuples(st.floats(0.5, 60), st.floats(0.5, 60)),
    kind=st.sampled_from(KINDS),
    periodic=st.booleans(),
)
def test_agrees_with_all_pairs(seed, n, size, kind, periodic):
    x, r, ids = circles(np.random.default_rng(seed), n, size, kind)
    got = domination.dominated(x, r, ids, size, periodic=periodic)
    np.testing.assert_array_equal(got, brute_force(x, r, ids, size, periodic))


@pytest.mark.parametrize("periodic", [True, False])
def test_agrees_with_all_pairs_on_a_stand(periodic):
    rng = np.random.default_rng(5)
    x, r, ids = circles(rng, 3000, (120.0, 80.0), "forest")
    got = domination.dominated(x, r, ids, (120.0, 80.0), periodic=periodic)
    np.testing.assert_array_equal(got, brute_force(x, r, ids, (120.0, 80.0), periodic))
    assert 0 < got.sum() < 3000


def test_touching_counts_and_the_smaller_loses():
    x = np.array([[2.0, 2.0], [5.0, 2.0]])
    got = domination.dominated(x, np.array([2.0, 1.0]), np.array([9, 1], np.uint32), (20.0, 20.0), periodic=False)
    assert got.tolist() == [False, True]
    got = domination.dominated(x, np.array([2.0, 0.999]), np.array([9, 1], np.uint32), (20.0, 20.0), periodic=False)
    assert got.tolist() == [False, False]


def test_of_equal_circles_the_later_born_loses():
    x, r = np.array([[2.0, 2.0], [2.5, 2.0], [3.0, 2.0]]), np.ones(3)
    got = domination.dominated(x, r, np.array([7, 3, 5], np.uint32), (20.0, 20.0), periodic=False)
    assert got.tolist() == [True, False, True]


def test_only_a_torus_joins_its_edges():
    x, r, ids = np.array([[0.1, 5.0], [9.9, 5.0]]), np.array([0.5, 0.4]), np.array([1, 2], np.uint32)
    assert domination.dominated(x, r, ids, (10.0, 10.0), periodic=True).tolist() == [False, True]
    assert domination.dominated(x, r, ids, (10.0, 10.0), periodic=False).tolist() == [False, False]


@given(seed=st.integers(0, 1000), dx=st.floats(-100, 100), dy=st.floats(-100, 100))
@settings(deadline=None, max_examples=30)
def test_a_torus_has_no_preferred_place(seed, dx, dy):
    x, r, ids = circles(np.random.default_rng(seed), 200, (30.0, 20.0), "uniform")
    here = domination.dominated(x, r, ids, (30.0, 20.0), periodic=True)
    there = domination.dominated(x + np.array([dx, dy]), r, ids, (30.0, 20.0), periodic=True)
    np.testing.assert_array_equal(here, there)


def test_rows_may_stand_in_any_order():
    rng = np.random.default_rng(3)
    x, r, ids = circles(rng, 500, (30.0, 30.0), "equal")
    mixed = rng.permutation(500)
    got = domination.dominated(x[mixed], r[mixed], ids[mixed], (30.0, 30.0), periodic=True)
    np.testing.assert_array_equal(got, domination.dominated(x, r, ids, (30.0, 30.0), periodic=True)[mixed])


def test_undominated_circles_never_intersect():
    x, r, ids = circles(np.random.default_rng(8), 2000, (50.0, 50.0), "uniform")
    free = ~domination.dominated(x, r, ids, (50.0, 50.0), periodic=True)
    assert not brute_force(x[free], r[free], ids[free], (50.0, 50.0), True).any()


@pytest.mark.parametrize("periodic", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_agrees_with_all_pairs_in_crowds(kind, periodic):
    x, r, ids = circles(np.random.default_rng(2), 2500, (30.0, 20.0), kind)
    got = domination.dominated(x, r, ids, (30.0, 20.0), periodic=periodic)
    np.testing.assert_array_equal(got, brute_force(x, r, ids, (30.0, 20.0), periodic))


@pytest.mark.parametrize("periodic", [True, False])
@pytest.mark.parametrize("size", [(500.0, 0.2), (0.2, 500.0)])
def test_agrees_with_all_pairs_on_a_strip(size, periodic):
    x, r, ids = circles(np.random.default_rng(2), 1000, size, "forest")
    got = domination.dominated(x, r, ids, size, periodic=periodic)
    np.testing.assert_array_equal(got, brute_force(x, r, ids, size, periodic))


def test_plants_outside_a_bounded_site_compete_too():
    x, r, ids = circles(np.random.default_rng(4), 800, (30.0, 20.0), "uniform")
    x = x * 3 - 30
    got = domination.dominated(x, r, ids, (30.0, 20.0), periodic=False)
    np.testing.assert_array_equal(got, brute_force(x, r, ids, (30.0, 20.0), False))


def test_rows_may_lie_anywhere_in_memory():
    x, r, ids = circles(np.random.default_rng(4), 300, (30.0, 20.0), "uniform")
    wide = np.column_stack([x, r, r])
    wide.flags.writeable = False
    got = domination.dominated(wide[:, :2], wide[:, 2], ids, (30.0, 20.0), periodic=True)
    np.testing.assert_array_equal(got, domination.dominated(x, r, ids, (30.0, 20.0), periodic=True))


@pytest.mark.parametrize("kind", ["equal", "crowd", "forest"])
def test_threads_have_no_influence(kind, monkeypatch):
    x, r, ids = circles(np.random.default_rng(6), 60_000, (600.0, 600.0), kind)
    answers = []
    for cores in (1, 2, 5):
        monkeypatch.setattr(threads, "cores", lambda cores=cores: cores)
        answers.append(domination.dominated(x, r, ids, (600.0, 600.0), periodic=True))
    np.testing.assert_array_equal(answers[0], answers[1])
    np.testing.assert_array_equal(answers[0], answers[2])
    assert 0 < answers[0].sum() < len(r)


def test_growth_of_others_never_frees_anybody():
    x, r, ids = circles(np.random.default_rng(7), 400, (30.0, 30.0), "uniform")
    before = domination.dominated(x, r, ids, (30.0, 30.0), periodic=True)
    for i in range(0, 400, 40):
        larger = r.copy()
        larger[i] *= 1.5
        after = domination.dominated(x, larger, ids, (30.0, 30.0), periodic=True)
        others = np.arange(400) != i
        assert np.all(after[others] >= before[others])


@pytest.mark.parametrize("kind", ["equal", "uniform", "forest", "huge"])
def test_memory_of_a_circle_is_bounded(kind):
    n = 100_000
    x, r, ids = circles(np.random.default_rng(9), n, (800.0, 800.0), kind)
    domination.dominated(x[:2], r[:2], ids[:2], (800.0, 800.0), periodic=True)
    tracemalloc.start()
    try:
        domination.dominated(x, r, ids, (800.0, 800.0), periodic=True)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak / n < 68


def test_the_answer_is_the_opposite_of_dominated():
    x, r, ids = circles(np.random.default_rng(8), 200, (30.0, 30.0), "uniform")
    made = Circles(x, r, r, ids, np.zeros(200, dtype=np.uint16))
    got = domination.MODEL.answer(domination.DominationParameters(), made, (30.0, 30.0), periodic=True)
    assert got.dtype == np.float64
    np.testing.assert_array_equal(got, 1.0 - domination.dominated(x, r, ids, (30.0, 30.0), periodic=True))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system cannot fork")
def test_works_in_a_forked_process():
    code = """
import os, warnings
import numpy as np
from forestgen.community.competition.domination import dominated
warnings.simplefilter("error")
x = np.random.default_rng(0).random((50_000, 2)) * 300
given = (x, np.full(50_000, 0.4), np.arange(50_000, dtype=np.uint32), (300.0, 300.0))
here = dominated(*given, periodic=True)
child = os.fork()
if child == 0:
    os._exit(0 if (dominated(*given, periodic=True) == here).all() else 1)
raise SystemExit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120)
    assert (done.returncode, done.stderr) == (0, "")
