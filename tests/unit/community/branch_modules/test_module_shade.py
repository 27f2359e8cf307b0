"""Shade: Beer's law, conservation, who shades whom."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from forestgen.community.branch_modules.crowding import Boxes
from forestgen.community.branch_modules.shade import ShadowGrid, _open_shares, shade
from forestgen.core.errors import ResourceError
from support.error_messages import raises_error

SITE = ShadowGrid((40.0, 60.0), periodic=True)


def test_uniform_layers_obey_beer() -> None:
    """Discs of 20 x 30 cells, three to a cell, each of optical depth 0.5 x 0.8 m2 in 4 m2: exp(-tau) below."""
    x, y = np.meshgrid(np.arange(0.25, 40, 0.5), np.arange(0.25, 60, 0.5))
    leaves = np.stack([x.ravel(), y.ravel()], axis=1)  # sixteen to a cell
    n, radius = len(leaves), np.sqrt(0.25 / np.pi)  # each as large as its share of the ground
    for periodic in (True, False):
        for layers in (1, 3):
            seen = np.array([[11.0, 31.0], [0.1, 0.1]])
            at = np.vstack([leaves] * layers + [seen])
            height = np.concatenate([np.full(n, 7.0 + 2 * k) for k in range(layers)] + [[1.0, 4.9]])
            depth = np.concatenate([np.full(n * layers, 0.4), [0.0, 0.0]])
            grid = ShadowGrid((40.0, 60.0), periodic=periodic)
            light = shade(at, height, np.full(len(at), radius), depth, grid)
            np.testing.assert_allclose(light.light[-2:], np.exp(-0.4 * layers), rtol=1e-5)
            np.testing.assert_allclose(light.light_at(seen), np.exp(-0.4 * layers), rtol=1e-5)
            own = light.light[n * (layers - 1) : n * layers]  # the highest see half of their own layer less themselves
            np.testing.assert_allclose(own, np.exp(-0.5 * 0.4 * 15 / 16), rtol=1e-5)


@pytest.mark.parametrize("periodic", [True, False])
@pytest.mark.parametrize("spread", [0.0, 0.25, 0.5])
def test_spreading_keeps_optical_depth(periodic: bool, spread: float) -> None:
    """At the ground, depth times area is the sum of what all modules have, wherever they stand."""
    rng = np.random.default_rng(1)
    at, height, radius = rng.uniform(0, (40, 60), (300, 2)), rng.uniform(2, 30, 300), rng.uniform(0.05, 4, 300)
    depth = rng.uniform(0, 1, 300)
    grid = ShadowGrid((40.0, 60.0), spread=spread, periodic=periodic)
    ground = shade(at, height, radius, depth, grid).ground_depth
    assert ground.sum() * 4 == pytest.approx((depth * np.pi * radius**2).sum(), rel=1e-5)


def test_alone_a_module_stands_in_the_light() -> None:
    rng = np.random.default_rng(2)
    for _ in range(30):
        at, size = rng.uniform(0, 40, (1, 2)), rng.uniform(0.01, 5, 1)
        alone = shade(at, rng.uniform(0, 9, 1), size, np.ones(1), SITE)
        np.testing.assert_allclose(alone.light, 1, atol=1e-6)
    two = shade(np.full((2, 2), 9.0), np.array([5.0, 1]), np.ones(2), np.full(2, 3.0), SITE)
    assert two.light[0] == pytest.approx(1)
    assert two.light[1] < 0.9


def test_shadow_is_a_cone() -> None:
    """Below a small crown the deepest shade is at its foot, wider and fainter the further down."""
    at, low = np.full((1, 2), 21.0), np.array([[21.0, 31.0]])
    near, far = (
        shade(at + np.array([0.0, 10.0]), np.array([height]), np.ones(1), np.full(1, 2.0), SITE).ground_depth
        for height in (5.0, 25.0)
    )
    assert near.max() > 2 * far.max()
    assert np.count_nonzero(near) < np.count_nonzero(far)
    assert shade(low, np.array([5.0]), np.ones(1), np.full(1, 2.0), SITE).ground_depth.argmax() == 15 * 20 + 10


def test_order_of_modules_does_not_matter_to_the_bit() -> None:
    rng = np.random.default_rng(3)
    at, height, radius = rng.uniform(0, (40, 60), (500, 2)), rng.uniform(0, 20, 500), rng.uniform(0.05, 2, 500)
    depth, order = rng.uniform(0, 1, 500), rng.permutation(500)
    one = shade(at, height, radius, depth, SITE)
    other = shade(at[order], height[order], radius[order], depth[order], SITE)
    assert one.light[order].tobytes() == other.light.tobytes()
    assert one.ground_depth.tobytes() == other.ground_depth.tobytes()


def test_houses_are_opaque() -> None:
    house = Boxes(np.array([[20.0, 30, 0]]), np.array([[8.0, 8, 6]]), np.zeros(1))
    at = np.array([[20.0, 30], [20, 30], [20, 30], [25, 30], [36, 30]])
    height = np.array([1.0, 5, 9, 1, 1])
    light = shade(at, height, np.full(5, 0.1), np.zeros(5), SITE, house)
    np.testing.assert_allclose(light.light[:2], 0, atol=1e-9)
    assert light.light[2] == 1
    assert 0.4 < light.light[3] < 0.8  # at the foot of the wall
    assert light.light[4] == pytest.approx(1)
    np.testing.assert_array_equal(light.light_at(at[[0, 4]]), [0.0, light.light[4]])


@pytest.mark.parametrize("layer_m", [1.0, 2.0, 5.0])
@pytest.mark.parametrize("spread", [0.0, 0.25])
def test_a_cell_half_of_which_a_wall_takes_has_half_of_the_light(layer_m: float, spread: float) -> None:
    wall = Boxes(np.array([[4.5, 10.0, 0.0]]), np.array([[1.0, 20.0, 10.0]]), np.zeros(1))
    grid = ShadowGrid((20.0, 20.0), layer_m=layer_m, spread=spread)
    share = shade(np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0), grid, wall).ground_share
    np.testing.assert_allclose(share[:, 2], 0.5)
    assert share[:, 3].min() > 0.5
    assert share.max() <= 1


def test_a_turned_house_covers_as_much_ground() -> None:
    for azimuth in (0.0, 0.5, np.pi / 4):
        house = Boxes(np.array([[0.0, 30, 0]]), np.array([[12.0, 6, 2]]), np.array([azimuth]))
        dark = 1 - shade(np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0), SITE, house).ground_share
        assert dark.sum() * 4 == pytest.approx(72, rel=0.05)


def test_beyond_the_site() -> None:
    """Branches over the edge of a bounded site shade its edge; on a torus, the other side."""
    at, light = np.array([[-1.0, 30.0]]), np.array([9.0])
    bounded = shade(at, light, np.ones(1), np.ones(1), ShadowGrid((40.0, 60.0))).ground_depth
    torus = shade(at, light, np.ones(1), np.ones(1), SITE).ground_depth
    assert bounded.argmax() % 20 == 0
    assert torus.argmax() % 20 == 19
    assert bounded.sum() == pytest.approx(torus.sum(), rel=1e-6)


def test_what_no_grid_can_hold() -> None:
    with raises_error(ResourceError, place="community.cell_m"):
        shade(np.zeros((1, 2)), np.full(1, 1e9), np.ones(1), np.ones(1), SITE)


def many_houses(count: int) -> Boxes:
    rng = np.random.default_rng(5)
    middle = np.column_stack([rng.uniform(10, 190, (count, 2)), np.zeros(count)])
    size = rng.uniform([1, 1, 2], [60, 30, 20], (count, 3))
    return Boxes(middle, size, rng.uniform(-3, 3, count))


@pytest.mark.parametrize("periodic", [False, True])
def test_boxes_take_of_each_cell_the_share_of_its_points(periodic: bool) -> None:
    """Against all points of all cells, box by box."""
    grid = ShadowGrid((200.0, 200.0), cell_m=4.0, layer_m=3.0, periodic=periodic)
    boxes, (nx, ny) = many_houses(12), grid.cells
    point = (np.arange(8) + 0.5) / 8
    along = (np.arange(nx)[:, None] + point).ravel() / grid.per_m[0]
    at = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    box_layers = np.ceil(boxes.size_m[:, 2] / 3.0).astype(np.int64)
    for layer, share in zip(range(7, -1, -1), _open_shares(boxes, box_layers, grid, 8), strict=True):
        taken = np.zeros((ny, nx))
        for k in np.flatnonzero(np.ceil(boxes.size_m[:, 2] / 3.0) > layer):
            one = Boxes(boxes.base_m[k : k + 1], boxes.size_m[k : k + 1], boxes.azimuth_rad[k : k + 1])
            inside = one.cover(at, grid.size_m if periodic else None)
            taken += inside.reshape(ny, 8, nx, 8).mean(axis=(1, 3))
        np.testing.assert_array_equal(share, np.maximum(1 - taken, 0))


def test_memory_does_not_grow_with_the_houses() -> None:
    """A thousand houses over a fine grid take a plane of cells, and not one each: 640,000 cells are 5 MB."""
    grid = ShadowGrid((200.0, 200.0), cell_m=0.25, layer_m=0.25)
    tracemalloc.start()
    next(_open_shares(many_houses(300), np.ones(300, dtype=np.int64), grid, 1))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 200e6
