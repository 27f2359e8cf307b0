"""Eddies kept alive, and the sponge below the ceiling."""

from dataclasses import replace

import numpy as np

from forestgen.atmosphere.fluid.air import Air, at_rest
from forestgen.atmosphere.fluid.parameters import Physics, Surface
from forestgen.atmosphere.grid import AirGrid
from support.air_balance import divergence_per_s, energies_j
from support.soundings import sounding_of_lapse_rates

GRID = AirGrid((20, 18, 16), (50.0, 50.0, 50.0))
CALM = Physics(viscosity_m2_per_s=0, confinement=0, sponge_share=0)
DRY = sounding_of_lapse_rates(
    ground_temperature_k=293.0, lapse_rate_k_per_m=-0.0075, inversion_m=600.0, lapse_rate_above_k_per_m=-0.002
)


def stirred(seconds, surface=None, physics=CALM):
    """Dry air in motion above spots of warm ground."""
    heat = np.random.default_rng(1).uniform(0, 1500, GRID.shape[1:]).astype(np.float32)
    surface = surface or Surface(heat, 0 * heat)
    weather = at_rest(GRID, DRY, surface, rng=np.random.default_rng(2), noise_k=1.0)
    return Air(GRID, DRY, surface, physics).run(weather, seconds)


def test_confinement_keeps_eddies_alive_and_water_and_the_mean_wind_as_they_are():
    start = stirred(240.0)
    motion = []
    for strength in (0.0, 0.05, 0.15):
        air = Air(GRID, DRY, None, replace(CALM, confinement=strength))
        weather = air.run(start, 300.0)
        motion.append(energies_j(weather)["motion"])
        assert abs(weather.east_m_per_s.mean(dtype=float) - start.east_m_per_s.mean(dtype=float)) < 2e-3
        assert abs(divergence_per_s(weather)).max() < 1e-6
    assert motion[0] < motion[1] < motion[2] < 3 * motion[0]


def test_the_wind_that_slows_down_at_the_ground_is_no_eddy():
    sheared = at_rest(GRID, DRY, None, rng=np.random.default_rng(0))
    east = np.broadcast_to(np.linspace(1, 9, 16, dtype=np.float32)[:, None, None], sheared.east_m_per_s.shape).copy()
    weather = Air(GRID, DRY, None, replace(CALM, confinement=0.15)).step(replace(sheared, east_m_per_s=east))
    np.testing.assert_allclose(weather.east_m_per_s, east, rtol=1e-5)


def test_the_sponge_calms_waves_and_leaves_the_wind():
    windy = replace(DRY, wind_m_per_s=np.full_like(DRY.wind_m_per_s, 3.0))
    start = at_rest(GRID, windy, None, rng=np.random.default_rng(0))
    x, z = 2 * np.pi * (np.arange(20) + 0.5) / 20, np.pi * (np.arange(16) + 0.5) / 16
    wave = (0.3 * np.sin(z)[:, None, None] * np.cos(x)).astype(np.float32)
    start = replace(start, potential_temperature_k=start.potential_temperature_k + wave)
    ends = [
        Air(GRID, windy, None, replace(CALM, sponge_share=share, sponge_per_s=0.05)).run(start, 900.0)
        for share in (0.0, 0.5)
    ]
    swinging = [
        np.hypot(end.up_m_per_s.std(), (end.potential_temperature_k - start.potential_temperature_k + wave).std())
        for end in ends
    ]
    assert swinging[1] < 0.5 * swinging[0]
    for end in ends:
        np.testing.assert_allclose(end.east_m_per_s.mean(axis=(1, 2), dtype=float), 3.0, atol=0.1)
