"""Orientation: modules turn to free space and to their angle; each step is the best of its choices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from forestgen.community.branch_modules import orientation
from forestgen.community.branch_modules.crowding import NO_BOXES, Boxes, SphereGrid, lens
from forestgen.community.branch_modules.orientation import Turning, orient
from support.module_spheres import intersection_ratio

Floats = NDArray[np.float64]
EMPTY = SphereGrid.of(np.empty((0, 3)), np.empty(0))


def turning(
    base: Floats, rotation: Floats, *, tropism: float = 0.0, angle: float = 0.0, radius: float = 0.5
) -> Turning:
    """Newborn modules whose spheres lie on their axes, as far out as they are large."""
    n = len(base)
    return Turning(
        np.asarray(base, dtype=float), rotation, np.tile([0.0, 0.0, radius], (n, 1)), np.full(n, radius),
        np.full(n, -1), np.full(n, -1), np.full(n, angle), np.full(n, tropism), np.ones(n),
    )  # fmt: skip


def upright(n: int) -> Floats:
    return np.tile([1.0, 0, 0, 0], (n, 1))


def spheres(modules: Turning, rotation: NDArray[np.floating]) -> Floats:
    """Centres of the grown spheres, world frame."""
    turned = Rotation.from_quat(np.roll(np.asarray(rotation, dtype=float), -1, axis=1))
    return modules.base_world_m + turned.apply(np.asarray(modules.centre_m, dtype=float))


def axis(rotation: NDArray[np.floating]) -> Floats:
    turned: Floats = Rotation.from_quat(np.roll(np.asarray(rotation, dtype=float), -1, axis=1)).apply([0.0, 0, 1])
    return turned


@pytest.mark.parametrize("angle", [0.0, 0.5, 1.2])
def test_alone_a_module_turns_to_its_angle(angle: float) -> None:
    rng = np.random.default_rng(1)
    start = Rotation.random(50, rng=rng).as_quat()[:, [3, 0, 1, 2]]
    modules = turning(rng.uniform(0, 1e4, (50, 3)), start, tropism=1.0, angle=angle)
    before = abs(np.cos(angle) - axis(start)[:, 2])
    after = abs(np.cos(angle) - axis(orient(EMPTY, modules, steps=12, angle_rad=0.5))[:, 2])
    assert np.all(after <= before + 1e-6)
    assert np.median(after) < 0.05


def test_a_step_takes_the_best_of_its_choices() -> None:
    """Against every choice tried by hand, one module at a time among fixed spheres."""
    rng = np.random.default_rng(2)
    centre, radius = rng.uniform(0, 6, (150, 3)), rng.uniform(0.05, 0.9, 150)
    grid = SphereGrid.of(centre, radius)
    none = np.full(151, -1)
    for _ in range(20):
        start = Rotation.random(rng=rng)
        one = turning(rng.uniform(1, 5, (1, 3)), start.as_quat()[None, [3, 0, 1, 2]], tropism=0.4, angle=0.7)
        worth = []
        for vector in ([0, 0, 0], [0.35, 0, 0], [-0.35, 0, 0], [0, 0.35, 0], [0, -0.35, 0]):
            choice = start * Rotation.from_rotvec(vector)
            at = one.base_world_m[0] + choice.apply(one.centre_m[0])
            joined = SphereGrid.of(np.vstack([centre, at]), np.append(radius, 0.5))
            alone = intersection_ratio(grid, none[:150]) * grid.volume_m3.sum()
            common = intersection_ratio(joined, none) * joined.volume_m3.sum() - alone
            worth.append((common / joined.volume_m3[-1] + 0.4 * abs(np.cos(0.7) - choice.apply([0, 0, 1])[2]), choice))
        best = min(worth, key=lambda pair: pair[0])[1].as_quat()[[3, 0, 1, 2]]
        found = orient(grid, one, steps=1, angle_rad=0.35)[0]
        assert abs(float(found @ best)) == pytest.approx(1, abs=1e-6)


def test_a_step_among_a_thousand_neighbours_takes_the_best_of_its_choices() -> None:
    """More neighbours than the kernel's lists have room for at first: they grow, and must stay its own."""
    rng = np.random.default_rng(5)
    side = np.arange(60) * 0.1
    x, y = np.meshgrid(side, side)
    centre, radius = np.column_stack([x.ravel(), y.ravel(), np.zeros(3600)]), rng.uniform(0.02, 0.05, 3600)
    grid = SphereGrid.of(centre, radius)
    for _ in range(60):
        reach, start = rng.uniform(0.58, 0.66), Rotation.random(rng=rng)
        base = np.append(rng.uniform(2, 4, 2), 0.0) - start.apply([0, 0, reach])
        one = turning(base[None], start.as_quat()[None, [3, 0, 1, 2]], radius=reach)
        shared = []
        for vector in ([0, 0, 0], [0.35, 0, 0], [-0.35, 0, 0], [0, 0.35, 0], [0, -0.35, 0]):
            choice = start * Rotation.from_rotvec(vector)
            away2 = np.sum((centre - base - choice.apply([0, 0, reach])) ** 2, axis=1)
            near = away2 < (radius + reach) ** 2
            assert near.sum() > 64
            pairs = zip(away2[near], radius[near], strict=True)
            shared.append((sum(lens(d2, reach, r) for d2, r in pairs), choice))
        shared.sort(key=lambda pair: pair[0])
        if shared[1][0] - shared[0][0] < 1e-6:
            continue
        best = shared[0][1].as_quat()[[3, 0, 1, 2]]
        found = orient(grid, one, steps=1, angle_rad=0.35)[0]
        assert abs(float(found @ best)) == pytest.approx(1, abs=1e-6)


def test_quaternions_stay_of_length_one_and_no_steps_change_nothing() -> None:
    rng = np.random.default_rng(3)
    start = Rotation.random(300, rng=rng).as_quat()
    modules = turning(rng.uniform(0, 5, (300, 3)), start, tropism=0.3, angle=0.5)
    np.testing.assert_array_equal(orient(EMPTY, modules, steps=0), start.astype(np.float32))
    np.testing.assert_allclose(np.linalg.norm(orient(EMPTY, modules, steps=30), axis=1), 1, atol=1e-6)


def test_siblings_born_together_part() -> None:
    """Two on one terminal, upright both: nearly all of what they share is gone after a few steps."""
    modules = turning(np.zeros((2, 3)), upright(2), radius=0.5)
    turned = orient(EMPTY, modules, steps=6, angle_rad=0.5)
    gap = np.linalg.norm(np.diff(spheres(modules, turned), axis=0))
    assert gap > 0.8


def test_dense_newborns_find_room() -> None:
    rng = np.random.default_rng(4)
    modules = turning(rng.uniform(0, 9, (400, 3)), upright(400), radius=0.45)
    none = np.full(400, -1)
    before = intersection_ratio(SphereGrid.of(spheres(modules, modules.rotation), modules.radius_m), none)
    turned = orient(EMPTY, modules, steps=5, angle_rad=0.5)
    after = intersection_ratio(SphereGrid.of(spheres(modules, turned), modules.radius_m), none)
    assert after < 0.5 * before


def test_own_row_and_own_bearer_are_no_obstacle() -> None:
    """A module in the grid is replaced by its grown sphere, and the one that bears it touches it by construction."""
    one = turning(np.zeros((1, 3)), upright(1))
    grid = SphereGrid.of(np.array([[0.2, 0, 0.3], [0.2, 0.0, 0.6]]), np.array([0.4, 0.3]))
    known = replace(one, row=np.array([1]), parent_row=np.array([0]))
    np.testing.assert_array_equal(orient(grid, known), one.rotation)
    assert not np.allclose(orient(grid, one), one.rotation)


def test_boxes_and_ground_are_obstacles() -> None:
    wall = Boxes(np.array([[10.2, 0, 0]]), np.array([[20.0, 20, 20]]), np.zeros(1))
    one = turning(np.array([[0.0, 0, 5]]), upright(1))
    assert orient(EMPTY, one, boxes=NO_BOXES).tolist() == one.rotation.tolist()
    assert axis(orient(EMPTY, one, boxes=wall))[0, 0] < -0.3
    flat = turning(np.zeros((1, 3)), Rotation.from_euler("y", [[1.5]]).as_quat()[:, [3, 0, 1, 2]])
    assert axis(orient(EMPTY, replace(flat, ground_m=np.zeros(1))))[0, 2] > 0.4


def test_on_a_torus_neighbours_across_the_edge_count() -> None:
    grid = SphereGrid.of(np.array([[19.8, 15.0, 0.5]]), np.array([0.5]), (20.0, 30.0))
    one = turning(np.array([[0.1, 15.0, 0]]), upright(1))
    assert axis(orient(grid, one))[0, 0] > 0.3
    pair = turning(np.array([[0.1, 15.0, 0], [19.8, 15, 0]]), upright(2))
    turned = orient(SphereGrid.of(np.empty((0, 3)), np.empty(0), (20.0, 30.0)), pair)
    assert axis(turned)[0, 0] - axis(turned)[1, 0] > 0.3


def test_on_a_torus_whole_periods_change_nothing() -> None:
    rng = np.random.default_rng(6)
    grid = SphereGrid.of(rng.uniform(0, 8, (200, 3)), rng.uniform(0.02, 0.6, 200), (8.0, 9.0))
    start = Rotation.random(60, rng=rng).as_quat()
    base = rng.integers(0, 64, (60, 3)) / 8  # exact in binary, so that the sums are the same to the bit
    apart = base + rng.integers(-2, 3, (60, 3)) * np.array([8.0, 9.0, 0.0])
    near, far = (orient(grid, turning(one, start, tropism=0.2, angle=0.5)) for one in (base, apart))
    np.testing.assert_allclose(near, far, atol=1e-6)


@pytest.mark.parametrize("n", [1, 700])
def test_many_neighbours_and_few_are_all_counted(n: int) -> None:
    """More than the kernel has room for at first: the same choice as one sphere of the same common volume forces."""
    crowd = np.tile([[0.3, 0.0, 0.6]], (n, 1))
    one = turning(np.zeros((1, 3)), upright(1))
    turned = axis(orient(SphereGrid.of(crowd, np.full(n, 0.2)), one, steps=4))
    alone = axis(orient(SphereGrid.of(crowd[:1], np.full(1, 0.2)), one, steps=4))
    np.testing.assert_allclose(turned, alone, atol=1e-6)
    assert turned[0, 0] < -0.3


def test_common_volumes_by_the_formula_without_branches() -> None:
    """Apart, touching, cut, one in the other and of one centre: those of `lens`, over pi / 12."""
    rng = np.random.default_rng(7)
    near = np.vstack([rng.uniform(-1.2, 1.2, (3, 400)), rng.uniform(0.01, 1.5, 400)])
    near[:3, :4], near[3, :4] = 0.1, [0.5, 0.2, 0.9, 0.5 + 1e-12]
    near[:, 4] = [1.1, 0.1, 0.1, 0.5]
    volume = np.empty(400)
    orientation._lenses(0.1, 0.1, 0.1, 0.5, near, 400, volume)
    d2 = ((near[:3] - 0.1) ** 2).sum(axis=0)
    expected = [lens(float(a), 0.5, float(b)) for a, b in zip(d2, near[3], strict=True)]
    np.testing.assert_allclose(np.pi / 12 * volume, expected, rtol=1e-6, atol=1e-12)


def test_the_same_bytes_with_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    modules = turning(rng.uniform(0, 34, (21_000, 3)), upright(21_000), tropism=0.3, angle=0.6)
    several = orient(EMPTY, modules)
    monkeypatch.setattr(orientation, "parallel_for", lambda n, work: work(0, n))
    assert several.tobytes() == orient(EMPTY, modules).tobytes()
