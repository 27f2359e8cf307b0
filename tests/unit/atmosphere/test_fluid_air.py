"""The whole step: against plain NumPy, at rest, symmetric, conserving, resumed, and refusing."""

from dataclasses import fields, replace

import numpy as np
import pytest

from forestgen.atmosphere.fluid.air import Air, at_rest
from forestgen.atmosphere.fluid.parameters import Physics, Surface, UnstableError
from forestgen.atmosphere.grid import AirGrid
from forestgen.core import threads
from support.air_balance import divergence_per_s, energies_j, total_energy_j
from support.plain_air import PlainAir
from support.soundings import sounding_of_lapse_rates

CALM = Physics(viscosity_m2_per_s=0, confinement=0, sponge_share=0)


def sounding(**changes):
    usual = {
        "ground_temperature_k": 293.0,
        "lapse_rate_k_per_m": -0.0075,
        "inversion_m": 1200.0,
        "lapse_rate_above_k_per_m": -0.002,
        "relative_humidity": 0.85,
    }
    return sounding_of_lapse_rates(**(usual | changes))


def even(grid, heat, vapour, height_m=None):
    y, x = grid.shape[1:]
    return Surface(np.full((y, x), heat, np.float32), np.full((y, x), vapour, np.float32), height_m)


def arrays(weather):
    found = {field.name: getattr(weather, field.name) for field in fields(weather)}
    return {name: value for name, value in found.items() if isinstance(value, np.ndarray)}


def bubble(grid, weather, *, warmer_k, radius_m, height_m):
    """A warm, damp ball in the middle of the box."""
    x, y = ((np.arange(n) + 0.5) * side for n, side in zip(grid.cells[:2], grid.cell_m[:2], strict=True))
    z = grid.layer_heights_m[:, None, None]
    squares = (x - grid.size_m[0] / 2) ** 2 + (y[:, None] - grid.size_m[1] / 2) ** 2 + (z - height_m) ** 2
    share = np.where(squares < radius_m**2, np.cos(np.pi / 2 * np.sqrt(squares) / radius_m) ** 2, 0)
    return replace(
        weather,
        potential_temperature_k=weather.potential_temperature_k + (warmer_k * share).astype(np.float32),
        vapour=weather.vapour * (1 + 0.15 * share).astype(np.float32),
    )


def showers(cells=(16, 14, 12), *, height_m=None, steps=8):
    """Some weather with wind, cloud and rain in it, and its solver."""
    grid = AirGrid(cells, (60.0, 50.0, 70.0))
    rng = np.random.default_rng(5)
    air_at_rest = sounding(wind_m_per_s=(6.0, -4.0))
    heat = rng.uniform(0, 500, grid.shape[1:]).astype(np.float32)
    surface = Surface(heat, np.full_like(heat, 1e-4), height_m)
    air = Air(grid, air_at_rest, surface, Physics())
    weather = at_rest(grid, air_at_rest, surface, rng=rng, noise_k=1.5)
    water = rng.uniform(0, 2e-3, (2, *grid.shape)).astype(np.float32)
    if weather.solid is not None:
        water[:, weather.solid] = 0
    weather = replace(weather, cloud=water[0], rain=water[1])
    for _ in range(steps):
        weather = air.step(weather)
    return air, weather


def step_limit_s(air, weather):
    """The length of the step that `step` chooses."""
    return air.step(weather).time_s - weather.time_s


class TestOracle:
    @pytest.mark.parametrize("physics", [Physics(confinement=0.15), CALM])
    def test_same_numbers_as_plain_numpy(self, physics):
        air, weather = showers()
        air = Air(air.grid, air.sounding, air.surface, physics)
        step_s = 0.9 * step_limit_s(air, weather)
        got = air.step(weather, step_s)
        want = PlainAir(air.grid, air.sounding, air.surface, physics, np.float64).step(weather, step_s)
        for name, values in arrays(got).items():
            expected, before = getattr(want, name), getattr(weather, name)
            changed = max(abs(expected - before).max(), 1e-3 * abs(expected).max())
            spare = 3e-5 if name == "potential_temperature_k" else 0  # its own rounding
            assert abs(values - expected).max() < 2e-4 * changed + spare, name


class TestRest:
    @pytest.mark.parametrize("hilly", [True, False])
    def test_air_at_rest_stays_there(self, hilly):
        grid = AirGrid((16, 14, 12), (60.0, 50.0, 70.0))
        y, x = np.indices(grid.shape[1:])
        hill = 300 * np.exp(-((x - 6) ** 2 + (y - 7) ** 2) / 10.0) if hilly else None
        surface = even(grid, 0, 0, hill)
        start = at_rest(grid, sounding(), surface, rng=np.random.default_rng(0))
        weather = start
        air = Air(grid, sounding(), surface, Physics())
        for _ in range(20):
            weather = air.step(weather)
        for name, values in arrays(weather).items():
            np.testing.assert_array_equal(values, getattr(start, name), err_msg=name)

    def test_wind_over_even_ground_goes_on_without_friction(self):
        grid = AirGrid((12, 12, 10), (60.0, 50.0, 70.0))
        blowing = sounding(wind_m_per_s=(7.0, -3.0))
        weather = at_rest(grid, blowing, None, rng=np.random.default_rng(0))
        air = Air(grid, blowing, None, CALM)
        weather = air.run(weather, 100.0)
        assert weather.time_s == 100.0
        np.testing.assert_allclose(weather.east_m_per_s, 7.0, rtol=1e-5)
        np.testing.assert_allclose(weather.up_m_per_s, 0.0, atol=1e-5)

    def test_ground_brakes_and_the_mean_wind_comes_back(self):
        grid = AirGrid((8, 8, 10), (60.0, 50.0, 20.0))
        blowing = sounding(wind_m_per_s=(7.0, 0.0))
        start = at_rest(grid, blowing, None, rng=np.random.default_rng(0))
        braked = Air(grid, blowing, None, Physics(viscosity_m2_per_s=5)).run(start, 200.0).east_m_per_s[:, 0, 0]
        assert braked[0] < 0.5 * 7
        assert (np.diff(braked) > -1e-4).all()
        led = Air(grid, blowing, None, Physics(viscosity_m2_per_s=5, wind_relaxation_s=20.0)).run(start, 200.0)
        assert led.east_m_per_s[0, 0, 0] > braked[0] + 1

    def test_a_gravity_wave_swings_at_its_frequency(self):
        """Standing wave of stable dry air: omega^2 = N^2 k^2 / (k^2 + m^2), with the grid's own k and m."""
        grid = AirGrid((32, 4, 32), (100.0, 100.0, 100.0))
        still = sounding(lapse_rate_k_per_m=-0.004, lapse_rate_above_k_per_m=-0.004, relative_humidity=0.0)
        air = Air(grid, still, None, CALM)
        weather = at_rest(grid, still, None, rng=np.random.default_rng(0))
        across, up = np.cos(2 * np.pi * (np.arange(32) + 0.5) / 32), np.sin(np.pi * (np.arange(32) + 0.5) / 32)
        shape = (up[:, None, None] * across).astype(np.float32)
        rest = weather.potential_temperature_k
        weather = replace(weather, potential_temperature_k=rest + np.float32(0.01) * shape)
        k, m = 2 * np.sin(np.pi / 32) / 100, 2 * np.sin(np.pi / 64) / 100
        theta = air.background.potential_temperature_k
        frequency = np.sqrt(9.81 * np.mean(np.diff(theta) / 100 / (theta[1:] + theta[:-1]) * 2)) * k / np.hypot(k, m)
        amounts, times = [], []
        while weather.time_s < 1.2 * 2 * np.pi / frequency:
            weather = air.step(weather)
            amounts.append(float(((weather.potential_temperature_k - rest) * shape).sum(dtype=float)))
            times.append(weather.time_s)
        crossings = [
            t - b * (t - s) / (b - a)
            for a, b, s, t in zip(amounts, amounts[1:], times, times[1:], strict=False)
            if a * b <= 0
        ]
        assert (crossings[1] - crossings[0]) / (np.pi / frequency) == pytest.approx(1, abs=0.03)
        assert max(abs(amount) for amount in amounts[len(amounts) // 2 :]) > 0.93 * amounts[0]


class TestBubble:
    GRID = AirGrid((24, 24, 28), (50.0, 50.0, 50.0))

    def test_it_rises_symmetrically_makes_a_cloud_and_keeps_water_and_energy(self):
        start = at_rest(self.GRID, sounding(), None, rng=np.random.default_rng(0))
        start = bubble(self.GRID, start, warmer_k=2.0, radius_m=280, height_m=350)
        air = Air(self.GRID, sounding(), None, CALM)
        weather, heights = start, []
        z = self.GRID.layer_heights_m[:, None, None]
        extra = (
            start.potential_temperature_k
            - at_rest(self.GRID, sounding(), None, rng=np.random.default_rng(0)).potential_temperature_k
        )
        rest = start.potential_temperature_k - extra
        while weather.time_s < 240:
            weather = air.step(weather)
            warm = np.maximum(weather.potential_temperature_k - rest, 0)
            heights.append(float((warm * z).sum(dtype=float) / warm.sum(dtype=float)))
        assert (np.diff(heights[3:]) > 0).all()
        assert heights[-1] > heights[0] + 150
        assert weather.cloud.max() > 2e-4
        assert 1 < weather.up_m_per_s.max() < 15
        for values in (weather.up_m_per_s, weather.cloud, weather.potential_temperature_k):
            size = abs(values).max()
            for other in (values[:, :, ::-1], values[:, ::-1], values.transpose(0, 2, 1)):
                assert abs(values - other).max() < 2e-2 * size
        one = air.step(start)
        assert abs(one.up_m_per_s - one.up_m_per_s[:, :, ::-1]).max() < 1e-6
        assert abs(divergence_per_s(weather)).max() < 1e-6
        assert weather.total_water_kg == pytest.approx(start.total_water_kg, rel=1e-7)
        assert total_energy_j(weather) == pytest.approx(total_energy_j(start), rel=3e-6)

    def test_warmth_becomes_motion(self):
        """In dry air, what the enthalpy loses the motion has, but for what the fluxes damp."""
        dry = sounding(relative_humidity=0.0)
        start = at_rest(self.GRID, dry, None, rng=np.random.default_rng(0))
        start = bubble(self.GRID, start, warmer_k=2.0, radius_m=280, height_m=350)
        weather = Air(self.GRID, dry, None, CALM).run(start, 120.0)
        before, after = energies_j(start), energies_j(weather)
        lost, won = before["enthalpy"] - after["enthalpy"], after["motion"]
        assert won > 1e7
        assert 0.9 < won / lost < 1.02


class TestEmission:
    def test_heat_and_vapour_arrive_in_the_air_to_the_joule_and_gram(self):
        grid = AirGrid((8, 9, 10), (60.0, 50.0, 70.0))
        for height in (None, np.full(grid.shape[1:], 200.0)):
            surface = even(grid, 400.0, 2e-4, height)
            start = at_rest(grid, sounding(), surface, rng=np.random.default_rng(0))
            weather = Air(grid, sounding(), surface, CALM).run(start, 60.0)
            area = grid.size_m[0] * grid.size_m[1]
            gained = weather.total_water_kg - start.total_water_kg
            assert gained == pytest.approx(60 * 2e-4 * area, rel=1e-3)
            before, after = energies_j(start), energies_j(weather)
            assert after["enthalpy"] - before["enthalpy"] == pytest.approx(60 * 400 * area, rel=3e-3)


class TestRuns:
    def test_a_run_taken_up_again_is_the_same_to_the_last_bit(self):
        y, x = np.indices((14, 16))
        hill = 300 * np.exp(-((x - 6) ** 2 + (y - 7) ** 2) / 10.0)
        air, weather = showers(height_m=hill, steps=2)
        straight = weather
        for _ in range(4):
            straight = air.step(straight)
        halfway = air.step(air.step(weather))
        saved = replace(halfway, **{name: values.copy() for name, values in arrays(halfway).items()})
        other = Air(air.grid, air.sounding, air.surface, air.physics)
        taken_up = other.step(other.step(saved))
        assert taken_up.time_s == straight.time_s
        for name, values in arrays(straight).items():
            np.testing.assert_array_equal(values, getattr(taken_up, name), err_msg=name)
        assert abs(divergence_per_s(straight)).max() < 1e-5
        assert (straight.rain > 0).any()

    def test_threads_do_not_change_a_bit(self, monkeypatch):
        air, weather = showers()
        alone = air.step(weather)

        def in_pieces(n, work):
            for first in range(0, n, n // 7):
                work(first, min(n, first + n // 7))

        monkeypatch.setattr(threads, "parallel_for", in_pieces)
        for name, values in arrays(air.step(weather)).items():
            np.testing.assert_array_equal(values, getattr(alone, name), err_msg=name)

    def test_run_ends_on_time(self):
        air, weather = showers(steps=0)
        end = air.run(weather, 31.0)
        assert end.time_s == 31.0
        assert air.run(end, 31.0) is end


class TestRefusals:
    def test_air_that_speeds_up_within_a_step(self):
        grid = AirGrid((8, 8, 8), (50.0, 50.0, 50.0))
        start = at_rest(grid, sounding(), None, rng=np.random.default_rng(0))
        hot = start.potential_temperature_k.copy()
        hot[2:5, 2:5, 2:5] += 200
        hot = replace(start, potential_temperature_k=hot)
        air = Air(grid, sounding(), None, CALM)
        with pytest.raises(UnstableError, match="speeds up and crosses"):
            air.step(hot, 10.0)
        weather = air.run(hot, 10.0)  # left to itself it takes shorter steps
        assert weather.up_m_per_s.max() > 5

    @pytest.mark.parametrize("name", ["east_m_per_s", "potential_temperature_k", "rain"])
    def test_a_field_that_is_not_finite(self, name):
        air, weather = showers(steps=0)
        values = getattr(weather, name).copy()
        values[3, 2, 1] = np.nan
        words = {"east_m_per_s": "east wind", "potential_temperature_k": "potential temperature", "rain": "rain"}
        with pytest.raises(UnstableError, match=f"{words[name]} is nan in layer 3, row 2, column 1"):
            air.step(replace(weather, **{name: values}))

    def test_air_faster_than_any(self):
        air, weather = showers(steps=0)
        fast = replace(weather, east_m_per_s=weather.east_m_per_s + 400)
        with pytest.raises(UnstableError, match=r"the air has \d+ m/s at .* expected 150 or less"):
            air.step(fast)

    def test_grids_and_maps_that_do_not_fit(self):
        grid = AirGrid((8, 8, 8), (50.0, 50.0, 50.0))
        rng = np.random.default_rng(0)
        with pytest.raises(ValueError, match="terrain rises to 400 m"):
            at_rest(grid, sounding(), even(grid, 0, 0, np.full((8, 8), 400.0)), rng=rng)
        with pytest.raises(ValueError, match=r"supersaturated at \d+ m"):
            at_rest(grid, sounding(relative_humidity=1.3), None, rng=rng)
        _, weather = showers(steps=0)
        with pytest.raises(ValueError, match="this solver's is"):
            Air(grid, sounding(), None, Physics()).step(weather)


@pytest.mark.slow
def test_a_closed_box_keeps_water_and_energy_over_a_thousand_steps():
    """Heated from below until it rains. The energy is held against the heat that the ground gave, and the whole."""
    grid = AirGrid((16, 16, 40), (75.0, 75.0, 75.0))
    humid = sounding(inversion_m=2200.0, lapse_rate_k_per_m=-0.008, relative_humidity=0.9)
    rng = np.random.default_rng(1)
    heat = rng.uniform(0, 800, grid.shape[1:]).astype(np.float32)
    air = Air(grid, humid, Surface(heat, 0 * heat), CALM)
    start = weather = at_rest(grid, humid, air.surface, rng=rng, noise_k=1.0)
    for _ in range(1000):
        weather = air.step(weather)
    given = float(heat.sum(dtype=float)) * 75.0**2 * weather.time_s
    drift = total_energy_j(weather) - total_energy_j(start) - given
    assert weather.fallen_kg_per_m2.max() > 0
    assert weather.total_water_kg == pytest.approx(start.total_water_kg, rel=1e-6)
    assert abs(drift) < 0.05 * given  # motion that is damped is not given back as heat
    assert abs(drift) < 1e-4 * total_energy_j(start)
    assert abs(divergence_per_s(weather)).max() < 1e-6
