"""Transport of heat and water: order, bounds, mass."""

import numpy as np
import pytest

from forestgen.atmosphere.fluid.advection import Transport
from forestgen.atmosphere.fluid.momentum import advance_velocity, fill_sides

CELL_M = (1.0, 1.0, 1.0)


def padded(field):
    out = np.zeros(tuple(n + 4 for n in field.shape), np.float32)
    out[tuple(slice(2, 2 + n) for n in field.shape)] = field
    return out


def joined(field):
    """Ghosts of periodic sides; above and below: the last layers."""
    out = np.pad(field, ((0, 0), (2, 2), (2, 2)), mode="wrap")
    return np.ascontiguousarray(np.pad(out, ((2, 2), (0, 0), (0, 0)), mode="edge"), dtype=np.float32)


def eddies(shape, rng, largest_courant):
    """A velocity free of divergence to rounding, from a random vector potential; nothing passes ground and ceiling."""
    z, y, x = shape
    a, b, c = (rng.normal(size=(z + 1, y, x)) for _ in range(3))
    a[0] = a[-1] = b[0] = b[-1] = 0
    u = (np.roll(c, -1, 1) - c)[:-1] - np.diff(b, axis=0)
    v = np.diff(a, axis=0) - (np.roll(c, -1, 2) - c)[:-1]
    w = (np.roll(b, -1, 2) - b) - (np.roll(a, -1, 1) - a)
    scale = largest_courant / (abs(u).max() + abs(v).max() + abs(w).max())
    u, v, w = joined(u * scale), joined(v * scale), joined(w * scale)[:-1]
    return u, v, w


def carried(q, velocity, steps, step_s, least=0.0):
    field = padded(q)
    transport = Transport(q.shape, None)
    transport.prepare(velocity, step_s, CELL_M)
    for _ in range(steps):
        transport.carry(field, least=least)
    return field[2:-2, 2:-2, 2:-2]


class TestTransport:
    def test_even_ratio_stays_even_in_any_eddies(self):
        rng = np.random.default_rng(0)
        out = carried(np.full((12, 10, 14), 0.3, np.float32), eddies((12, 10, 14), rng, 0.9), 20, 1.0)
        np.testing.assert_allclose(out, 0.3, rtol=5e-6)

    def test_water_is_neither_made_nor_lost_nor_negative_nor_beyond_what_was(self):
        rng = np.random.default_rng(1)
        q = np.where(rng.random((12, 10, 14)) < 0.2, rng.random((12, 10, 14)), 0).astype(np.float32)
        out = carried(q, eddies(q.shape, rng, 0.95), 30, 1.0)
        assert out.min() >= 0
        assert out.max() <= q.max() * (1 + 1e-5)
        assert out.sum(dtype=float) == pytest.approx(q.sum(dtype=float), rel=1e-6)
        assert out.std() < 0.9 * q.std()  # it was indeed stirred

    @pytest.mark.parametrize("axis", [0, 1, 2])
    def test_a_step_profile_gets_no_new_extremes(self, axis):
        """Along each axis; upwards between two walls, with an eddy instead of an even wind."""
        shape = [8, 8, 8]
        shape[axis] = 32
        q = np.full(shape, 0.25, np.float32)
        q[tuple(slice(10, 20) if a == axis else slice(None) for a in range(3))] = 1.0
        velocity = [np.zeros(tuple(n + 4 for n in shape), np.float32) for _ in range(3)]
        if axis == 0:
            velocity = eddies(tuple(shape), np.random.default_rng(2), 0.9)
        else:
            velocity[2 - axis][...] = 0.45
        out = carried(q, velocity, 40, 1.0)
        assert out.min() >= 0.25 * (1 - 1e-5)
        assert out.max() <= 1 + 1e-5
        assert out.std() > 0.1 * q.std()

    def test_wind_carries_a_smooth_profile_with_third_order_and_eddies_with_second(self):
        straight, turning = [], []
        sizes = (32, 64, 128)
        for n in sizes:
            place = (np.arange(n) + 0.5) / n
            wave = np.broadcast_to(2 + np.sin(2 * np.pi * place), (4, 4, n)).astype(np.float32)
            even = [np.zeros((8, 8, n + 4), np.float32) for _ in range(3)]
            even[0][...] = 1
            steps = n  # half a turn round the box at Courant's number 0.5
            out = carried(wave, even, steps, 0.5)
            straight.append(abs(out - np.roll(wave, n // 2, axis=2)).mean())
            turning.append(self.turned(n))
        slope = np.polyfit(np.log(sizes), np.log(straight), 1)[0]
        assert slope < -2.2  # third order but for the two extremes, which the limiter holds
        slope = np.polyfit(np.log(sizes), np.log(turning), 1)[0]
        assert slope < -1.8

    @staticmethod
    def turned(n):
        """Mean error after a solid turn by a tenth, of a bell that stays inside: the turn is the same on all grids."""
        edge = np.arange(n + 1) / n - 0.5
        middle = (np.arange(n) + 0.5) / n - 0.5
        taper = np.clip((0.5 - np.hypot(*np.meshgrid(edge, edge))) * 6, 0, 1) ** 2
        stream = 0.5 * np.hypot(*np.meshgrid(edge, edge)) ** 2 * (taper * taper * (3 - 2 * taper)) * n * n
        u, v = np.diff(stream, axis=0), -np.diff(stream, axis=1)  # in cells, counter-clockwise once in 2 pi
        velocity = [np.zeros((8, n + 4, n + 4), np.float32) for _ in range(3)]
        velocity[0][2:-2, 2:-2, 2:-1], velocity[1][2:-2, 2:-1, 2:-2] = -u, -v
        steps = 2 * n
        angle = 0.2 * np.pi
        x, y = np.meshgrid(middle, middle)

        def bell(x, y):
            return np.exp(-((x - 0.1) ** 2 + y**2) / 0.004)

        q = np.broadcast_to(bell(x, y), (4, n, n)).astype(np.float32)
        out = carried(q, velocity, steps, angle / steps)
        return abs(out - bell(np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x)).mean()

    @pytest.mark.slow
    def test_terrain_keeps_what_is_inside_out_of_the_air(self):
        """Values in solid cells are absurd; the air near them stays within its own."""
        shape = (10, 8, 12)
        solid = np.zeros(shape, bool)
        solid[:3, :, 4:7] = True
        around = np.pad(solid, 2, mode="wrap")
        around[:2], around[-2:] = True, True
        opened = tuple((~(around | np.roll(around, 1, axis))).astype(np.float32) for axis in (2, 1, 0))
        rng = np.random.default_rng(3)
        velocity = tuple((rng.uniform(-0.15, 0.15, opened[0].shape) * part).astype(np.float32) for part in opened)
        velocity[0][:, :, -2:], velocity[0][:, :, :2] = velocity[0][:, :, 2:4], velocity[0][:, :, -4:-2]
        velocity[1][:, -2:], velocity[1][:, :2] = velocity[1][:, 2:4], velocity[1][:, -4:-2]
        q = np.where(solid, 1e3, rng.random(shape)).astype(np.float32)
        transport = Transport(shape, opened)
        transport.prepare(velocity, 0.02, CELL_M)
        field = padded(q)
        for _ in range(10):
            transport.carry(field)
        out = field[2:-2, 2:-2, 2:-2]
        np.testing.assert_array_equal(out[solid], 1e3)
        assert out[~solid].max() < 1.2  # the velocity is not free of divergence: it squeezes, but lets nothing in


class TestMomentum:
    def test_an_even_wind_stays_even_but_for_the_ground(self):
        wind = tuple(np.full((10, 12, 14), speed, np.float32) for speed in (3.0, -2.0, 0.5))
        out = tuple(np.zeros_like(field) for field in wind)
        advance_velocity(wind, wind, out, 1.0, (10.0, 12.0, 8.0), 5.0)
        for before, after in zip(wind, out, strict=True):
            np.testing.assert_allclose(after[3:-2, 2:-2, 2:-2], before[3:-2, 2:-2, 2:-2], rtol=1e-6)
        braked = 1 - 5.0 * 1.0 * 2 / 8.0**2  # half a layer above air at rest
        np.testing.assert_allclose(out[0][2, 2:-2, 2:-2], 3.0 * braked, rtol=1e-6)
        np.testing.assert_allclose(out[2][2, 2:-2, 2:-2], 0.5, rtol=1e-6)

    def test_momentum_is_kept(self):
        rng = np.random.default_rng(4)
        wind = eddies((8, 10, 12), rng, 1.0)
        out = tuple(np.zeros_like(field) for field in wind)
        advance_velocity(wind, wind, out, 0.3, CELL_M, 0.0)
        inner = (slice(2, -2),) * 3
        for before, after in zip(wind[:2], out[:2], strict=True):
            change = (after - before)[inner].astype(float)
            assert abs(change.sum()) < 1e-4 * abs(change).sum()

    @pytest.mark.slow
    def test_error_falls_with_the_second_power_of_the_cell(self):
        """d(u u)/dx of a sine against calculus: the flux is of third order, the mean that carries it of second."""
        errors = []
        for n in (16, 32, 64):
            place = np.arange(n + 4) - 2
            phase = 2 * np.pi * place / n
            u = np.broadcast_to(2 + np.sin(phase), (8, 8, n + 4)).astype(np.float32)
            still = np.zeros_like(u)
            out = tuple(np.zeros_like(u) for _ in range(3))
            cell = (1.0 / n, 1.0, 1.0)
            advance_velocity((still, still, still), (u, still, still), out, 1.0, cell, 0.0)
            want = -2 * (2 + np.sin(phase)) * 2 * np.pi * np.cos(phase)
            errors.append(abs(out[0][4, 4, 2:-2] - want[2:-2]).mean())
        assert errors[0] / errors[1] > 3.5
        assert np.polyfit(np.log((16, 32, 64)), np.log(errors), 1)[0] < -1.9


def test_sides():
    field = padded(np.arange(4 * 4 * 5, dtype=float).reshape(4, 4, 5))
    fill_sides(field[2:-2])
    np.testing.assert_array_equal(field[2:-2], np.pad(field[2:-2, 2:-2, 2:-2], ((0, 0), (2, 2), (2, 2)), mode="wrap"))
