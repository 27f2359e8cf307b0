"""Crowding: the grid against every pair, spheres of known common volume, cost."""

from __future__ import annotations

from time import process_time

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from forestgen.community.branch_modules import crowding
from forestgen.community.branch_modules.crowding import (
    Boxes,
    SphereGrid,
    lens,
    overlap_volumes,
    without,
)
from support.module_spheres import intersection_ratio, overlap
from support.module_stands import ModuleStand, module_stand

Floats = NDArray[np.float64]
ROOTS = np.full(2, -1)


def pair_volumes(centre: Floats, radius: Floats, period: tuple[float, float] | None) -> Floats:
    """(M, M) common volumes of all pairs by the formula of two caps, 0 on the diagonal."""
    offset = centre[:, None] - centre[None]
    if period is not None:
        offset[..., :2] -= np.round(offset[..., :2] / period) * period
    d = np.maximum(np.sqrt((offset**2).sum(axis=-1)), 1e-12)
    r, s = radius[:, None], radius[None]
    caps = 0.0
    for a, b in ((r, s), (s, r)):
        height = np.clip(a - (d * d + a * a - b * b) / (2 * d), 0, 2 * a)
        caps = caps + np.pi * height**2 * (a - height / 3)
    volume = np.where(d >= r + s, 0.0, np.where(d <= abs(r - s), 4 / 3 * np.pi * np.minimum(r, s) ** 3, caps))
    np.fill_diagonal(volume, 0.0)
    return volume


def mixture(n: int, seed: int) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Spheres of radii from 1 cm to 3 m in clusters on a slope, and who bears whom."""
    rng = np.random.default_rng(seed)
    foot = rng.uniform(0, (20, 30, 0), (max(n // 5, 1), 3))
    centre = foot[rng.integers(0, len(foot), n)] + rng.normal(0, (1, 1, 4), (n, 3))
    centre[:, 2] += 3 * centre[:, 0] + 500
    bearer = np.where(rng.random(n) < 0.3, -1, rng.integers(0, np.maximum(np.arange(n), 1)))
    return centre, 10 ** rng.uniform(-2, 0.5, n), np.where(np.arange(n) == 0, -1, bearer)


@pytest.mark.parametrize("period", [None, (20.0, 30.0)])
@pytest.mark.parametrize("n", [1, 2, 40, 900])
def test_every_pair_is_found_once(n: int, period: tuple[float, float] | None) -> None:
    centre, radius, parent = mixture(n, n)
    grid = SphereGrid.of(centre, radius, period)
    pairs = pair_volumes(centre, radius, period)
    np.testing.assert_allclose(overlap_volumes(grid, np.full(n, -1)), pairs.sum(axis=1), rtol=1e-6, atol=1e-12)
    assert intersection_ratio(grid) == pytest.approx(pairs.sum() / 2 / grid.volume_m3.sum())
    born = np.flatnonzero(parent >= 0)
    pairs[born, parent[born]] = pairs[parent[born], born] = 0.0
    np.testing.assert_allclose(overlap(grid, parent), pairs.sum(axis=1) / grid.volume_m3, rtol=1e-6, atol=1e-9)
    assert intersection_ratio(grid, parent) == pytest.approx(pairs.sum() / 2 / grid.volume_m3.sum())


def test_two_spheres() -> None:
    assert lens(1.0, 1.0, 1.0) == pytest.approx(5 * np.pi / 12)  # unit spheres, each centre on the other
    assert lens(4.0, 1.0, 1.0) == 0.0
    assert lens(0.04, 1.0, 0.5) == pytest.approx(4 / 3 * np.pi / 8)  # contained
    inside = SphereGrid.of(np.zeros((2, 3)), np.array([2.0, 1.0]))
    np.testing.assert_allclose(overlap(inside, ROOTS), [1 / 8, 1.0])
    assert intersection_ratio(inside, ROOTS) == pytest.approx(1 / 9)


def test_a_module_that_has_just_begun_feels_what_it_stands_in() -> None:
    centre = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.3, 0]])
    f = overlap(SphereGrid.of(centre, np.array([0.0, 1, 1])), np.array([-1, -1, -1]))
    assert f[0] == pytest.approx(2)


def test_no_modules() -> None:
    grid = SphereGrid.of(np.empty((0, 3)), np.empty(0))
    assert overlap(grid, np.empty(0, dtype=np.int64)).shape == (0,)
    assert intersection_ratio(grid, np.empty(0, dtype=np.int64)) == 0.0


def test_boxes_count_like_spheres() -> None:
    wall = Boxes(np.array([[5.0, 0, 0]]), np.array([[2.0, 50, 50]]), np.zeros(1))
    grid = SphereGrid.of(np.array([[4.0, 0, 20], [1, 0, 20]]), np.array([1.0, 1.0]))
    np.testing.assert_allclose(overlap(grid, ROOTS, wall), [0.5, 0.0], atol=1e-6)
    assert intersection_ratio(grid, ROOTS) == 0.0


@pytest.mark.parametrize("period", [None, (20.0, 30.0)])
def test_cells_without_some_spheres_are_those_of_the_rest(period: tuple[float, float] | None) -> None:
    centre, radius, _ = mixture(600, 9)
    gone = np.random.default_rng(9).random(600) < 0.4
    cells = SphereGrid.of(centre, radius, period).cells
    rest = without(cells, gone)
    assert sorted(rest.row) == np.flatnonzero(~gone).tolist()
    assert rest.start[-1] == len(rest.row)
    for cell in range(len(cells.start) - 1):
        expected = [row for row in cells.row[cells.start[cell] : cells.start[cell + 1]] if not gone[row]]
        assert rest.row[rest.start[cell] : rest.start[cell + 1]].tolist() == expected
    np.testing.assert_array_equal(rest.sphere[:, 3], radius[rest.row])


def test_the_same_bytes_with_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    stand = module_stand(4000, seed=1)
    grid = SphereGrid.of(stand.centre_m, stand.radius_m)
    several = overlap(grid, stand.parent_row)
    monkeypatch.setattr(crowding, "parallel_for", lambda n, work: work(0, n))
    assert several.tobytes() == overlap(grid, stand.parent_row).tobytes()


def test_moved_as_a_whole_nothing_changes() -> None:
    centre, radius, parent = mixture(500, 8)
    near, far = (overlap(SphereGrid.of(centre + d, radius), parent) for d in ([0, 0, 0], [5e3, -2e3, 700]))
    np.testing.assert_allclose(near, far, rtol=1e-4, atol=1e-6)


def _seconds(stand: ModuleStand) -> float:
    start = process_time()
    overlap(SphereGrid.of(stand.centre_m, stand.radius_m, stand.period_m), stand.parent_row)
    return process_time() - start


@pytest.mark.slow
def test_cost_grows_with_the_number_of_modules() -> None:
    """Sixteen times the forest costs at most 28 times as much: caches miss more, pairs grow no more than modules."""
    small, large = module_stand(4000, seed=2), module_stand(64_000, seed=2)
    _seconds(small)
    ratio = min(_seconds(large) / _seconds(small) for _ in range(4))
    assert ratio < 28


@pytest.mark.slow
def test_one_large_sphere_does_not_slow_the_rest() -> None:
    """A tree of points (SciPy's) must look as far as the largest sphere reaches for each; the levels need not."""
    stand = module_stand(8000, seed=3)
    period = np.append(stand.period_m, 1e4)
    centre = np.mod(stand.centre_m + np.array([0.0, 0.0, 100.0]), period)
    radius = stand.radius_m.copy()
    radius[0] = 3.0
    grid = SphereGrid.of(centre, radius, stand.period_m)
    overlap(grid, stand.parent_row)

    def by_tree() -> Floats:
        pairs = cKDTree(centre, boxsize=period).query_pairs(radius[0] + np.sort(radius)[-2], output_type="ndarray")
        a, b = pairs.T
        joint = (stand.parent_row[a] == b) | (stand.parent_row[b] == a)
        a, b = a[~joint], b[~joint]
        offset = centre[a] - centre[b]
        offset -= np.round(offset / period) * period
        d, r, s = np.sqrt((offset**2).sum(axis=1)), radius[a], radius[b]
        lens_m3 = np.pi * (r + s - d) ** 2 * (d * d + 2 * d * (r + s) - 3 * (r - s) ** 2) / (12 * d)
        inside = 4 / 3 * np.pi * np.minimum(r, s) ** 3
        common = np.where(d >= r + s, 0.0, np.where(d <= abs(r - s), inside, lens_m3))
        return np.bincount(a, common, len(stand)) + np.bincount(b, common, len(stand))

    seconds = []
    for _ in range(3):
        start = process_time()
        expected = by_tree()
        middle = process_time()
        found = overlap_volumes(SphereGrid.of(centre, radius, stand.period_m), stand.parent_row)
        seconds.append((middle - start, process_time() - middle))
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-12)
    ratio = min(tree for tree, _ in seconds) / min(own for _, own in seconds)
    assert ratio > 1.5, f"SciPy's tree takes {ratio:.1f} times as long"
