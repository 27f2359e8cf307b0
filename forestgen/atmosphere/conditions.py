"""What weather is simulated from: one set of parameters; `forestgen.atmosphere.clouds.simulated` has values.

Model
-----
Air at rest is a column of layers, by heights above the ground in metres: a mixed layer next to the ground, in which
potential temperature and vapour are the same at all heights; a layer of constant lapse rate up to the inversion, in
which relative humidity goes linearly from the mixed layer's top to `relative_humidity_aloft`; the inversion itself,
`inversion_jump_k` over a tenth of its height and at most 100 m; a second lapse rate above (Eq. 17 with a step). Vapour
is bounded by saturation.

The ground gives off heat and vapour: noise of patches on it, or a map. The wind is the same at all heights to begin
with. The air below the inversion cools at a constant rate as it radiates: without that there is no fog.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere import sounding as soundings
from forestgen.atmosphere.grid import AirGrid

ZERO_CELSIUS_K = 273.15
_DRY_K_PER_M = soundings.GRAVITY_M_PER_S2 * soundings.AIR_EXPONENT / soundings.GAS_CONSTANT_AIR_J_PER_KG_K
_MOST_HUMID = 0.9995  # air at rest holds no cloud
_INVERSION_SHARE, _INVERSION_M = 0.1, 100.0


@dataclass(frozen=True)
class Layers:
    """Air at rest, by a few numbers; see the module."""

    ground_temperature_c: float
    mixed_layer_m: float
    lapse_rate_k_per_km: float  # cooling upwards, between the mixed layer and the inversion
    inversion_m: float
    inversion_jump_k: float
    lapse_rate_above_k_per_km: float
    relative_humidity: float  # at the ground, [0, 1]
    relative_humidity_aloft: float  # just below the inversion
    relative_humidity_above: float
    ground_pressure_hpa: float = 1013.25

    def sounding(self, top_m: float, wind_m_per_s: tuple[float, float]) -> soundings.Sounding:
        """The column up to `top_m`. ValueError: the layers leave no air that can be: below 100 K, or above 400 K."""
        mixed = min(self.mixed_layer_m, self.inversion_m)
        thin = min(_INVERSION_SHARE * self.inversion_m, _INVERSION_M)
        knots = np.array([0.0, mixed, self.inversion_m, self.inversion_m + thin, max(top_m, 2 * self.inversion_m)])
        rates = np.array([_DRY_K_PER_M, self.lapse_rate_k_per_km / 1e3, 0.0, self.lapse_rate_above_k_per_km / 1e3])
        steps = -rates * np.diff(knots) + np.array([0.0, 0.0, self.inversion_jump_k, 0.0])
        at_knots = ZERO_CELSIUS_K + self.ground_temperature_c + np.concatenate([[0.0], np.cumsum(steps)])
        height = np.unique(np.concatenate([np.linspace(0.0, knots[-1], 401), knots, np.linspace(0.0, knots[3], 101)]))
        temperature = np.interp(height, knots, at_knots)
        if not (temperature.min() > 100.0 and temperature.max() < 400.0):
            raise ValueError(f"air of {temperature.min():.0f} to {temperature.max():.0f} K")
        pressure_pa = 100.0 * self.ground_pressure_hpa
        dry = soundings.Sounding(height, temperature, 0 * height, np.zeros((len(height), 2)), pressure_pa)
        saturated = soundings.saturation_ratio(temperature, dry.pressure_at(height))
        own = self.relative_humidity * saturated[0]
        top_rh = min(own / float(np.interp(mixed, height, saturated)), 1.0)
        over = np.interp(
            height,
            [mixed, self.inversion_m, self.inversion_m + thin],
            [top_rh, self.relative_humidity_aloft, self.relative_humidity_above],
        )
        vapour = np.minimum(np.where(height <= mixed, own, over * saturated), _MOST_HUMID * saturated)
        return replace(dry, vapour=vapour, wind_m_per_s=np.tile(np.asarray(wind_m_per_s, float), (len(height), 1)))


@dataclass(frozen=True)
class Emission:
    """What the ground gives to the air: means, and how they differ from place to place."""

    heat_w_per_m2: float
    latent_w_per_m2: float
    patch_m: float  # size of patches
    contrast: float  # standard deviation over mean
    map: NDArray[np.float32] | None = None  # (rows, columns) of mean 1, row 0 in the south; instead of patches


@dataclass(frozen=True)
class Domain:
    """The box of air that is simulated."""

    extent_m: float
    height_m: float
    cell_m: float
    cell_height_m: float

    @property
    def cells(self) -> tuple[int, int, int]:
        """Along x, y, z: even numbers, at least 8, whose sides come closest to those asked for."""
        across = max(8, 2 * round(self.extent_m / self.cell_m / 2))
        return across, across, max(8, 2 * round(self.height_m / self.cell_height_m / 2))

    def grid(self) -> AirGrid:
        """About the origin."""
        across, _, up = self.cells
        side = self.extent_m / across
        half = self.extent_m / 2
        return AirGrid((across, across, up), (side, side, self.height_m / up), (-half, -half, 0.0))


@dataclass(frozen=True)
class Conditions:
    """One kind of weather."""

    kind: str
    layers: Layers | soundings.Sounding
    emission: Emission
    domain: Domain
    cooling_k_per_h: float  # of the air below the inversion
    wind_m_per_s: tuple[float, float] = (0.0, 0.0)  # towards east and north

    @property
    def inversion_m(self) -> float:
        """Height up to which the air cools; of a measured sounding, where potential temperature rises most quickly."""
        if isinstance(self.layers, Layers):
            return self.layers.inversion_m
        height = np.linspace(0.0, self.domain.height_m, 201)
        rise = np.diff(self.layers.potential_temperature_at(height))
        return float(height[int(np.argmax(rise))])

    def sounding(self) -> soundings.Sounding:
        """The air at rest, with the wind."""
        top_m = self.domain.height_m
        if isinstance(self.layers, Layers):
            return self.layers.sounding(top_m, self.wind_m_per_s)
        measured = _between_levels(self.layers, self.domain.grid().layer_heights_m)
        if self.wind_m_per_s == (0.0, 0.0):
            return measured  # with its own wind
        return replace(measured, wind_m_per_s=np.tile(np.asarray(self.wind_m_per_s), (len(measured.height_m), 1)))


def _between_levels(measured: soundings.Sounding, height_m: NDArray[np.float64]) -> soundings.Sounding:
    """A sounding with levels at more heights, where vapour is bounded by saturation.

    Between far levels of humid air, vapour, which is linear, would exceed saturation, which sags below the line.
    """
    height = np.union1d(measured.height_m, height_m)
    temperature = measured.temperature_at(height)
    most = _MOST_HUMID * soundings.saturation_ratio(temperature, measured.pressure_at(height))
    own = np.isin(height, measured.height_m)  # these are the author's to answer for
    vapour = measured.vapour_at(height)
    vapour = np.where(own, vapour, np.minimum(vapour, most))
    return soundings.Sounding(height, temperature, vapour, measured.wind_at(height), measured.ground_pressure_pa)


def wind_towards(speed_m_per_s: float, from_deg: float) -> tuple[float, float]:
    """East and north components of a wind that comes from an azimuth."""
    angle = math.radians(from_deg)
    return -speed_m_per_s * math.sin(angle), -speed_m_per_s * math.cos(angle)
