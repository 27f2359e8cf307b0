from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forestgen.community import environment


def brute_force(x, r, ids, size, periodic):
    """Domination as the thesis words it, all pairs."""
    d = np.abs(x[:, None] - x[None])
    if periodic:
        d = np.minimum(d, np.array(size) - d)
    touch = np.sum(d**2, axis=2) <= (r[:, None] + r[None]) ** 2
    larger = (r[None] > r[:, None]) | ((r[None] == r[:, None]) & (ids[None] < ids[:, None]))
    return np.any(touch & larger, axis=1)


def circles(rng, n, size, kind):
    x = rng.random((n, 2)) * size
    if kind == "clustered":
        x = np.mod(x[rng.integers(0, max(1, n // 20) + 1, n) % n] + rng.normal(0, 0.3, (n, 2)), size)
    r = {
        "equal": np.full(n, 0.5),
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
    kind=st.sampled_from(["equal", "uniform", "forest", "clustered", "huge"]),
    periodic=st.booleans(),
)
def test_agrees_with_all_pairs(seed, n, size, kind, periodic):
    x, r, ids = circles(np.random.default_rng(seed), n, size, kind)
    got = environment.dominated(x, r, ids, size, periodic=periodic)
    np.testing.assert_array_equal(got, brute_force(x, r, ids, size, periodic))


@pytest.mark.parametrize("periodic", [True, False])
def test_agrees_with_all_pairs_on_a_stand(periodic):
    rng = np.random.default_rng(5)
    x, r, ids = circles(rng, 3000, (120.0, 80.0), "forest")
    got = environment.dominated(x, r, ids, (120.0, 80.0), periodic=periodic)
    np.testing.assert_array_equal(got, brute_force(x, r, ids, (120.0, 80.0), periodic))
    assert 0 < got.sum() < 3000


def test_touching_counts_and_the_smaller_loses():
    x = np.array([[2.0, 2.0], [5.0, 2.0]])
    got = environment.dominated(x, np.array([2.0, 1.0]), np.array([9, 1], np.uint32), (20.0, 20.0), periodic=False)
    assert got.tolist() == [False, True]
    got = environment.dominated(x, np.array([2.0, 0.999]), np.array([9, 1], np.uint32), (20.0, 20.0), periodic=False)
    assert got.tolist() == [False, False]


def test_of_equal_circles_the_later_born_loses():
    x, r = np.array([[2.0, 2.0], [2.5, 2.0], [3.0, 2.0]]), np.ones(3)
    got = environment.dominated(x, r, np.array([7, 3, 5], np.uint32), (20.0, 20.0), periodic=False)
    assert got.tolist() == [True, False, True]


def test_only_a_torus_joins_its_edges():
    x, r, ids = np.array([[0.1, 5.0], [9.9, 5.0]]), np.array([0.5, 0.4]), np.array([1, 2], np.uint32)
    assert environment.dominated(x, r, ids, (10.0, 10.0), periodic=True).tolist() == [False, True]
    assert environment.dominated(x, r, ids, (10.0, 10.0), periodic=False).tolist() == [False, False]


@given(seed=st.integers(0, 1000), dx=st.floats(-100, 100), dy=st.floats(-100, 100))
@settings(deadline=None, max_examples=30)
def test_a_torus_has_no_preferred_place(seed, dx, dy):
    x, r, ids = circles(np.random.default_rng(seed), 200, (30.0, 20.0), "uniform")
    here = environment.dominated(x, r, ids, (30.0, 20.0), periodic=True)
    there = environment.dominated(x + np.array([dx, dy]), r, ids, (30.0, 20.0), periodic=True)
    np.testing.assert_array_equal(here, there)


def test_rows_may_stand_in_any_order():
    rng = np.random.default_rng(3)
    x, r, ids = circles(rng, 500, (30.0, 30.0), "equal")
    mixed = rng.permutation(500)
    got = environment.dominated(x[mixed], r[mixed], ids[mixed], (30.0, 30.0), periodic=True)
    np.testing.assert_array_equal(got, environment.dominated(x, r, ids, (30.0, 30.0), periodic=True)[mixed])


def test_undominated_circles_never_intersect():
    x, r, ids = circles(np.random.default_rng(8), 2000, (50.0, 50.0), "uniform")
    free = ~environment.dominated(x, r, ids, (50.0, 50.0), periodic=True)
    assert not brute_force(x[free], r[free], ids[free], (50.0, 50.0), True).any()
