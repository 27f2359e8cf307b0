"""Spreading and running downhill: conservation, exact cases, order of convergence."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from forestgen.community import soil_water as module
from forestgen.community.soil_water import Ground, Transport
from forestgen.core import threads

Floats = NDArray[np.float64]


def hills(rows: int, cols: int, *, seed: int = 0, periodic: bool = False) -> Ground:
    rng = np.random.default_rng(seed)
    y, x = np.meshgrid(np.arange(rows) / rows, np.arange(cols) / cols, indexing="ij")
    height = 8 * np.sin(2 * np.pi * x) * np.cos(2 * np.pi * y) + rng.normal(0, 0.3, (rows, cols))
    return Ground((60.0, 40.0), (rows, cols), periodic, height)


GROUNDS = {
    "closed": Ground((60.0, 40.0), (17, 24)),
    "joined": Ground((60.0, 40.0), (17, 24), periodic=True),
    "hillside": Ground((60.0, 40.0), (17, 24), periodic=True, gradient=(0.02, -0.05)),
    "hills": hills(17, 24),
    "joined hills": hills(17, 24, periodic=True),
    "a row": Ground((60.0, 40.0), (1, 24)),
    "a joined row": Ground((60.0, 40.0), (1, 24), periodic=True, gradient=(0.1, 0.0)),
    "a cell": Ground((60.0, 40.0), (1, 1)),
}


@pytest.mark.parametrize("name", GROUNDS)
@pytest.mark.parametrize("days", [1e-3, 0.03, 0.7, 40.0, 1e5])
@pytest.mark.parametrize(("diffusion", "speed"), [(0.0, 50.0), (3.0, 0.0), (80.0, 2000.0)])
def test_all_of_it_stays_and_none_is_negative(name: str, days: float, diffusion: float, speed: float) -> None:
    ground = GROUNDS[name]
    rng = np.random.default_rng(3)
    field = np.where(rng.random(ground.shape) < 0.2, 1000 * rng.random(ground.shape), 0.0)
    field[0, 0] = 1e6
    before = field.copy()
    after = Transport(ground, diffusion, speed).over(field, days)
    assert np.array_equal(field, before)
    assert after.min() >= 0
    assert after.sum() == pytest.approx(field.sum(), rel=1e-12)


@pytest.mark.parametrize("periodic", [False, True])
def test_a_wave_decays_as_diffusion_has_it(periodic: bool) -> None:
    diffusion, days, side = 3.0, 2.0, 50.0
    number = (2 if periodic else 1) * np.pi / side
    errors = []
    for cells in (20, 40, 80):
        x = (np.arange(cells) + 0.5) * side / cells
        wave = np.cos(number * x)[None, :] * np.cos(number * x)[:, None]
        got = Transport(Ground((side, side), (cells, cells), periodic), diffusion).over(2 + wave, days)
        errors.append(abs(got - 2 - np.exp(-2 * diffusion * number**2 * days) * wave).max())
    assert errors[-1] < 1e-3
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx(2.0, abs=0.05)


def test_transform_and_step_agree_where_little_moves() -> None:
    for ground in (GROUNDS["closed"], GROUNDS["joined"], GROUNDS["hillside"]):
        field = np.random.default_rng(0).random(ground.shape)
        transport = Transport(ground, 0.1, 0.5)
        days = 1e-3
        moved = abs(transport._stepped(field, days) - field).max()
        assert abs(transport._stepped(field, days) - transport._transformed(field, days)).max() < 1e-3 * moved


def test_times_add_up() -> None:
    field = np.random.default_rng(0).random((17, 24))
    for name in ("closed", "hillside"):
        transport = Transport(GROUNDS[name], 5.0, 300.0)
        twice = transport.over(transport.over(field, 1.0), 1.5)
        assert twice == pytest.approx(transport.over(field, 2.5), abs=1e-12)


@pytest.mark.parametrize("name", ["closed", "joined", "hillside"])
def test_without_end_it_is_the_same_everywhere(name: str) -> None:
    field = np.random.default_rng(0).random((17, 24))
    assert Transport(GROUNDS[name], 1e12).over(field, 30.0) == pytest.approx(np.full((17, 24), field.mean()))
    assert Transport(GROUNDS[name], 0.0).over(field, 30.0) is field


def test_on_a_hillside_it_goes_down_at_its_speed() -> None:
    """The middle of a patch moves by exactly speed times gradient; its shape converges with first order."""
    speed, days, side = 100.0, 4.0, 120.0
    errors = []
    for cells in (160, 320, 640):
        ground = Ground((side, 3.0), (1, cells), periodic=True, gradient=(-0.05, 0.0))
        x = (np.arange(cells) + 0.5) * side / cells
        patch = np.exp(-(((x - 40) / 8) ** 2))[None, :]
        got = Transport(ground, 0.0, speed).over(patch, days)
        assert np.sum(got * x) / got.sum() == pytest.approx(60.0, abs=0.01)
        errors.append(abs(got - np.exp(-(((x - 60) / 8) ** 2))).mean())
    assert np.log2(errors[-2] / errors[-1]) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("slope", [0.01, 0.04])
def test_the_speed_goes_with_a_power_of_the_gradient(slope: float) -> None:
    """Along a slope that runs down to the east and to the north alike, on a plane and over heights."""
    x, y = np.meshgrid(np.arange(60) + 0.5, np.arange(60) + 0.5)
    gradient = -slope * np.array([0.6, 0.8])
    patch = np.exp(-((x - 20) ** 2 + (y - 20) ** 2) / 30)
    for ground in (
        Ground((60.0, 60.0), (60, 60), periodic=True, gradient=tuple(gradient)),
        Ground((60.0, 60.0), (60, 60), height_m=gradient[0] * x + gradient[1] * y),
    ):
        got = Transport(ground, 0.0, 30.0, 0.5).over(patch, 1.0)
        moved = [np.sum(got * at) / got.sum() - 20 for at in (x, y)]
        assert moved == pytest.approx(30 * np.sqrt(slope) * np.array([0.6, 0.8]), rel=0.02)


@pytest.mark.parametrize("turn", [0, 1, 2, 3])
def test_heights_let_it_run_as_a_gradient_does(turn: int) -> None:
    """Whichever way the slope looks; first order in time and cells together."""
    speed, days, side = 100.0, 4.0, 120.0
    errors = []
    for cells in (160, 320, 640):
        x, steps = (np.arange(cells) + 0.5) * side / cells, cells // 10
        height = np.rot90(np.broadcast_to(-0.05 * x, (4, cells)), turn)
        field = np.rot90(np.broadcast_to(np.exp(-(((x - 40) / 8) ** 2)), (4, cells)), turn).copy()
        size_m = (side, 3.0) if turn % 2 == 0 else (3.0, side)
        transport = Transport(Ground(size_m, field.shape, height_m=height), 0.0, speed)
        for _ in range(steps):
            field = transport.over(field, days / steps)
        got = np.rot90(field, -turn)
        assert np.ptp(got, axis=0).max() < 1e-12  # along the contours all is alike
        assert np.sum(got[0] * x) / got[0].sum() == pytest.approx(60.0, abs=0.01)
        errors.append(abs(got[0] - np.exp(-(((x - 60) / 8) ** 2))).mean())
    assert np.log2(errors[-2] / errors[-1]) == pytest.approx(1.0, abs=0.25)


def test_all_water_ends_in_hollows() -> None:
    height = np.array([[5.0, 4.0, 1.0, 4.0, 6.0], [5.0, 4.0, 3.0, 4.0, 2.0]])
    after = Transport(Ground((5.0, 2.0), (2, 5), height_m=height), 0.0, 10.0).over(np.ones((2, 5)), 1e9)
    hollow = np.zeros((2, 5), bool)
    hollow[0, 2] = hollow[1, 4] = True
    assert after[~hollow].max() < 1e-6
    assert after[hollow].min() > 1


def test_on_a_terrace_nothing_runs() -> None:
    field = np.random.default_rng(0).random((6, 6))
    ground = Ground((6.0, 6.0), (6, 6), height_m=np.full((6, 6), 7.0))
    assert np.array_equal(Transport(ground, 0.0, 10.0).over(field, 5.0), field)


def test_threads_change_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    field = np.random.default_rng(0).random((330, 331))
    moves = [
        Transport(Ground((500.0, 500.0), field.shape, **kind), diffusion, 2000.0)  # type: ignore[arg-type]
        for kind in ({}, {"periodic": True, "gradient": (0.01, 0.0)})
        for diffusion in (0.05, 100.0)
    ]
    results = []
    for count in (1, 2, 5):
        monkeypatch.setattr(threads, "cores", lambda count=count: count)
        monkeypatch.setattr(module, "cores", lambda count=count: count)
        results.append([one.over(field, 0.5) for one in moves])
    for other in results[1:]:
        assert all(a.tobytes() == b.tobytes() for a, b in zip(results[0], other, strict=True))


def test_steepness_is_that_of_the_ground() -> None:
    x, y = np.meshgrid(np.arange(7) + 0.5, 2 * (np.arange(5) + 0.5))
    plane = Ground((7.0, 10.0), (5, 7), height_m=0.3 * x - 0.4 * y)
    assert plane.steepness() == pytest.approx(np.full((5, 7), 0.5))
    assert Ground((7.0, 10.0), (5, 7), True, gradient=(0.3, -0.4)).steepness() == pytest.approx(np.full((5, 7), 0.5))
    assert Ground((7.0, 10.0), (1, 1), height_m=np.ones((1, 1))).steepness() == 0
