"""Phases of water and falling drops."""

import numpy as np
import pytest

from forestgen.atmosphere.fluid.microphysics import change_phases, fall
from forestgen.atmosphere.fluid.parameters import HEAT_CAPACITY_J_PER_KG_K, Physics, background
from forestgen.atmosphere.grid import AirGrid
from forestgen.atmosphere.sounding import LATENT_HEAT_J_PER_KG, saturation_ratio
from support.soundings import sounding_of_lapse_rates

GRID = AirGrid((6, 5, 8), (50.0, 50.0, 100.0))
INNER = (slice(2, -2),) * 3


@pytest.fixture
def air():
    sounding = sounding_of_lapse_rates(
        ground_temperature_k=295.0, lapse_rate_k_per_m=-0.0065, inversion_m=5000.0, lapse_rate_above_k_per_m=0.0
    )
    return background(GRID, sounding)


def changed(air, heat, vapour, cloud, rain, physics, step_s):
    fields = []
    for values in (heat, vapour, cloud, rain):
        field = np.zeros(tuple(n + 4 for n in GRID.shape), np.float32)
        field[INNER] = values
        fields.append(field)
    change_phases(*fields, air, physics, step_s)
    return tuple(field[INNER].astype(float) for field in fields)


def saturation(air, heat):
    exner = air.temperature_ratio[:, None, None]
    temperature = exner * (air.potential_temperature_k[:, None, None] + heat)
    return saturation_ratio(temperature, air.pressure_pa[:, None, None])


class TestPhases:
    def test_condensation_and_evaporation_end_at_saturation_and_keep_the_energy(self, air):
        rng = np.random.default_rng(0)
        heat = rng.normal(0, 2, GRID.shape)
        vapour = saturation(air, heat) * rng.uniform(0.8, 1.2, GRID.shape)
        cloud = np.where(rng.random(GRID.shape) < 0.5, rng.uniform(0, 2e-3, GRID.shape), 0)
        none = Physics(autoconversion_per_s=0, accretion_per_s=0, evaporation=0)
        h, v, c, r = changed(air, heat, vapour, cloud, 0 * cloud, none, 1.0)
        over = v / saturation(air, h) - 1
        np.testing.assert_allclose(over[c > 1e-9], 0, atol=3e-5)  # 1e-4 K of single precision
        assert over[c == 0].max() < 3e-5
        assert (c > 0).any()
        assert ((c == 0) & (cloud > 0)).any()
        assert c.min() >= 0
        assert not r.any()
        np.testing.assert_allclose(v + c, vapour + cloud, rtol=3e-7)
        exner = air.temperature_ratio[:, None, None]
        gained = HEAT_CAPACITY_J_PER_KG_K * exner * (h - heat) + LATENT_HEAT_J_PER_KG * (v - vapour)
        assert abs(gained).max() < 0.01  # J/kg, of up to 5000 set free

    def test_dry_air_without_droplets_changes_nothing(self, air):
        heat, vapour = np.zeros(GRID.shape), 0.5 * saturation(air, np.zeros(GRID.shape))
        h, v, c, r = changed(air, heat, vapour, 0 * heat, 0 * heat, Physics(), 5.0)
        assert not h.any()
        assert not c.any()
        assert not r.any()
        np.testing.assert_array_equal(v, vapour.astype(np.float32))

    def test_thin_cloud_makes_no_rain_and_thick_cloud_at_kesslers_rate(self, air):
        heat = np.zeros(GRID.shape)
        full = saturation(air, heat)
        for amount, rate in ((0.9e-3, 0.0), (3e-3, 1e-3 * (3e-3 - 1e-3))):
            _, _, _, r = changed(air, heat, full, 0 * heat + amount, 0 * heat, Physics(accretion_per_s=0), 1.0)
            np.testing.assert_allclose(r, rate, rtol=1e-3)

    def test_drops_collect_droplets_in_proportion_to_both(self, air):
        heat = np.zeros(GRID.shape)
        physics = Physics(autoconversion_per_s=0, accretion_per_s=5.2, evaporation=0)
        _, _, c, r = changed(air, heat, saturation(air, heat), 0 * heat + 5e-4, 0 * heat + 2e-3, physics, 0.1)
        np.testing.assert_allclose(r - 2e-3, 0.1 * 5.2 * 5e-4 * 2e-3, rtol=3e-3)
        np.testing.assert_allclose(c + r, 2.5e-3, rtol=1e-3)

    def test_drops_evaporate_in_dry_air_at_the_published_rate_and_never_past_saturation(self, air):
        heat = np.zeros(GRID.shape)
        full = saturation(air, heat)
        _, v, _, r = changed(air, heat, 0.6 * full, 0 * heat, 0 * heat + 1e-3, Physics(), 1.0)
        water = 1e-3 * air.density_kg_per_m3[0] * 1e-3  # g/cm3, lowest layer
        rate = 0.4 * (1.6 + 124.9 * water**0.2046) * water**0.525
        rate /= 5.4e5 + 2.55e6 / (0.01 * air.pressure_pa[0] * full[0, 0, 0])
        rate /= 1e-3 * air.density_kg_per_m3[0]
        assert 1e-3 - r[0, 0, 0] == pytest.approx(rate, rel=1e-3)
        np.testing.assert_allclose(v + r, 0.6 * full + 1e-3, rtol=1e-6)
        h, v, _, r = changed(air, heat, 0.9 * full, 0 * heat, 0 * heat + 5e-3, Physics(), 1e5)
        assert (v <= saturation(air, h) * 1.001).all()
        assert r.min() > 0
        h, v, _, r = changed(air, heat, 0.1 * full, 0 * heat, 0 * heat + 1e-5, Physics(), 1e5)
        assert not r.any()
        _, v, _, r = changed(air, heat, full, 0 * heat, 0 * heat + 1e-3, Physics(), 100.0)
        np.testing.assert_allclose(r, 1e-3, rtol=1e-5)  # none in saturated air


class TestFall:
    SPEED, LAYERS = 7.0, 60

    def dropped(self, rain, ground, seconds, step_s):
        field = np.zeros((self.LAYERS + 4, 9, 10), np.float32)
        field[INNER] = rain
        fallen = np.zeros((5, 6))
        for _ in range(round(seconds / step_s)):
            fall(field, fallen, ground, self.SPEED * step_s, 20.0, 1.2)
        return field[INNER], fallen

    @pytest.mark.parametrize("step_s", [0.5, 2.0, 5.0, 25.0])
    def test_drops_fall_at_their_speed_at_any_step(self, step_s):
        height = (np.arange(self.LAYERS) + 0.5) * 20
        rain = np.zeros((self.LAYERS, 5, 6), np.float32)
        rain += (1e-3 * np.exp(-(((height - 900) / 100) ** 2)))[:, None, None].astype(np.float32)
        out, fallen = self.dropped(rain, np.zeros((5, 6), np.int64), 50.0, step_s)
        middle = (out * height[:, None, None]).sum(axis=0) / out.sum(axis=0)
        np.testing.assert_allclose(middle, 900 - 7.0 * 50, atol=1.0)
        spread = np.sqrt((out * (height[:, None, None] - middle) ** 2).sum(axis=0) / out.sum(axis=0))
        assert spread.max() < 1.05 * 100 / np.sqrt(2)
        assert fallen.max() < 1e-6

    def test_all_arrives_and_is_counted_in_millimetres_on_terrain_too(self):
        rng = np.random.default_rng(1)
        ground = rng.integers(0, 20, (5, 6))
        layer = np.arange(self.LAYERS)[:, None, None]
        rain = np.where(layer >= ground, rng.uniform(0, 1e-3, (self.LAYERS, 5, 6)), 0).astype(np.float32)
        want = rain.sum(axis=0, dtype=float) * 1.2 * 20.0
        out, fallen = self.dropped(rain, ground, 60.0, 3.0)
        assert out.min() >= 0
        assert not out[np.broadcast_to(layer < ground, out.shape)].any()
        np.testing.assert_allclose(fallen + out.sum(axis=0, dtype=float) * 24.0, want, rtol=1e-6)
        out, fallen = self.dropped(rain, ground, 1000.0, 10.0)
        assert out.max() < 1e-9
        np.testing.assert_allclose(fallen, want, rtol=1e-6)
