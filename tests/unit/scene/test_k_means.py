"""Our k-means against scikit-learn's, bit by bit."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from forestgen.scene.k_means import k_means


def rows_of(kind: str, size: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    rows = rng.normal(size=size)
    if kind == "skewed":  # as radii are
        return np.log(rng.gamma(0.5, size=size) + 1e-3)
    if kind == "ties":
        return np.round(rows * 3) / 7
    if kind == "scales":
        return rows * np.exp(3 * rng.normal(size=size[1])) + 100 * rng.normal(size=size[1])
    return rows


def expected(rows: np.ndarray, clusters: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    from sklearn.cluster import KMeans
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # clusters that stay empty
        model = KMeans(n_clusters=clusters, random_state=seed, n_init=1).fit(rows)
    return model.cluster_centers_, model.labels_


@settings(max_examples=60)
@given(
    kind=st.sampled_from(["normal", "skewed", "ties", "scales"]),
    count=st.integers(2, 3000),
    features=st.integers(1, 6),
    clusters=st.integers(1, 60),
    seed=st.integers(0, 2**31 - 1),
)
def test_centres_and_labels_are_those_of_scikit_learn(kind, count, features, clusters, seed):
    rows = rows_of(kind, (count, features), np.random.default_rng(seed))
    assume(len(np.unique(rows, axis=0)) > clusters)
    centres, labels = k_means(rows, clusters, seed)
    wanted, wanted_labels = expected(rows, clusters, seed)
    assert centres.tobytes() == wanted.tobytes()
    np.testing.assert_array_equal(labels, wanted_labels)


@pytest.mark.parametrize("count", [255, 256, 257, 30_000])
def test_so_they_are_at_the_edges_of_blocks_and_of_many_rows(count):
    rows = rows_of("skewed", (count, 1), np.random.default_rng(count))
    for found, wanted in zip(k_means(rows, 12, 5), expected(rows, 12, 5), strict=True):
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.slow
def test_empty_clusters_take_the_farthest_rows():
    """Pairs of rows so alike that the first centres leave some of them without any row."""
    emptied = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        rows = np.repeat(rng.normal(size=(30, 1)), 4, axis=0) * (1 + 1e-15 * rng.integers(0, 3, (120, 1)))
        distinct = len(np.unique(rows))
        centres, labels = k_means(rows, distinct - 1, seed)
        wanted, wanted_labels = expected(rows, distinct - 1, seed)
        assert centres.tobytes() == wanted.tobytes()
        np.testing.assert_array_equal(labels, wanted_labels)
        emptied += len(np.unique(labels)) < distinct - 1
    assert emptied
