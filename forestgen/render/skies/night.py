"""The clear sky while the sun is below the horizon: twilight, the moon's light, and the night's own light, added up.

- Twilight is the light of a sun on the horizon times the ratios of atmosphere/twilight.py, by direction and wavelength.
- Moonlight is that of a sun in the moon's place, of which the moon returns a share (atmosphere/moon.py): a moonlit sky
  is as blue as by day.
- The night's own light is airglow, zodiacal light and stars together. There are no single stars.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.daylight import Daylight, aerosol_optical_depth, daylight, illuminance, pressure_pa
from forestgen.atmosphere.moon import moonlight_share
from forestgen.atmosphere.twilight import (
    Depths,
    TwilightRatio,
    illuminance_below,
    night_radiance,
    night_shape,
    twilight_ratio,
)
from forestgen.core.spectrum import Spectrum
from forestgen.recipe.spectra import load_table
from forestgen.render.skies.hosek import NODES_NM, hosek_shape, radiance_by
from forestgen.render.skies.model import MAP_COLUMNS, MAP_ROWS, Floats, map_directions, row_weights
from forestgen.scene.colour import Channels
from forestgen.scene.spec import Sky

_HORIZON_DEG = 1e-3  # of the sun on the horizon
# Of the twilight's ratios: the directions' nodes, and further ones that only the spectrum needs.
_RATIO_NM = np.concatenate([NODES_NM, [800.0, 950.0, 1200.0, 1600.0, 2200.0, 4000.0]])
_SEA_LEVEL_PA = 101325.0
_AEROSOL_ALBEDO = 0.93  # of scattering: SPCTRL2's rural aerosol in the visible


@dataclass(frozen=True, eq=False)
class NightLight:
    """One of the lights of a night."""

    level: Spectrum  # on a level plane
    shape: NDArray[np.float32]  # (MAP_ROWS // 2 + 1, MAP_COLUMNS or 1, nodes) radiance over irradiance, 1/sr
    # Of a twilight: by the scattering alone, its illuminance over that of a sun on the horizon.
    modelled_share: float = 1.0


@dataclass(frozen=True, eq=False)
class Night:
    """All lights of a sky without its sun."""

    moon: Spectrum  # on a plane that faces it
    elevation_deg: float  # of the moon; of the sun where there is no moon
    lights: tuple[NightLight, ...]  # of the sky: twilight, moonlit air, the night's own

    @property
    def daylight(self) -> Daylight:
        """Spectra of the light at the ground."""
        grid = self.moon.wavelength_nm
        return Daylight(
            self.moon, Spectrum(grid, np.sum([one.level.at(grid) for one in self.lights], axis=0)), self.elevation_deg
        )

    def radiance(self, light: Spectrum, channels: Channels) -> NDArray[np.float32]:
        """(MAP_ROWS // 2 + 1, MAP_COLUMNS, 3); `light` is that of all parts, which share it as their own does."""
        grid = light.wavelength_nm
        whole = np.maximum(self.daylight.sky.at(grid), np.finfo(float).tiny)
        result = np.zeros((MAP_ROWS // 2 + 1, MAP_COLUMNS, 3), dtype=np.float32)
        for one in self.lights:
            result += radiance_by(one.shape, Spectrum(grid, light.value * one.level.at(grid) / whole), channels)
        return result


def clear_daylight(sky: Sky, sun_elevation_deg: float) -> Daylight:
    """Spectra of the clear sky and its sun, above the horizon."""
    return daylight(
        sun_elevation_deg,
        sky.turbidity,
        sky.ground_albedo,
        sky.altitude_m,
        sun_distance_au=sky.sun_distance_au,
        precipitable_water_mm=sky.precipitable_water_mm,
        ozone_du=sky.ozone_du,
    )


@lru_cache(maxsize=8)
def night_of(sky: Sky) -> Night:
    """The lights of a sky whose sun is below the horizon."""
    own = _own_light()
    grid = load_table("standards/spctrl2")["sun"].wavelength_nm
    lights = [NightLight(Spectrum(grid, own.level.at(grid)), own.shape)]
    moon, elevation_deg = Spectrum(grid, np.zeros_like(grid)), sky.sun_elevation_deg
    if illuminance_below(sky.sun_elevation_deg) > 0:
        lights.append(twilight_of(sky))
    if sky.moon_by_night is not None:
        one = sky.moon_by_night
        share = moonlight_share(one.phase_angle_deg, grid, one.distance_km)
        day = clear_daylight(sky, one.elevation_deg)
        moon, elevation_deg = Spectrum(grid, day.sun.value * share), one.elevation_deg
        shape = hosek_shape(one.elevation_deg, one.azimuth_deg, sky.turbidity, sky.ground_albedo)
        lights.append(NightLight(Spectrum(grid, day.sky.value * share), shape))
    return Night(moon, elevation_deg, tuple(lights))


def twilight_of(sky: Sky) -> NightLight:
    """Light of a sun below the horizon."""
    ratio = twilight_ratio(_depths(sky), sky.sun_elevation_deg)
    day = clear_daylight(sky, _HORIZON_DEG).on_level
    value = day.value * np.exp(np.interp(day.wavelength_nm, _RATIO_NM, np.log(np.maximum(ratio.level, 1e-300))))
    amount = illuminance_below(sky.sun_elevation_deg) / illuminance_below(0.0)
    modelled = illuminance(Spectrum(day.wavelength_nm, value)) / illuminance(day)
    value *= amount / modelled
    on_horizon = hosek_shape(_HORIZON_DEG, sky.sun_azimuth_deg, sky.turbidity, sky.ground_albedo)
    shape = on_horizon * _on_map(ratio, sky.sun_azimuth_deg)
    shape /= np.einsum("rck,r->k", shape, row_weights())
    return NightLight(Spectrum(day.wavelength_nm, value), shape.astype(np.float32), modelled)


def _depths(sky: Sky) -> Depths:
    """Optical depths of a sky's air at the wavelengths of the ratios; molecules by SPCTRL2's equation 2-4."""
    micrometres = _RATIO_NM / 1000.0
    molecules = 1.0 / (micrometres**4 * (115.6406 - 1.3366 / micrometres**2))
    pressure = pressure_pa(sky.altitude_m) / _SEA_LEVEL_PA
    aerosol = [aerosol_optical_depth(sky.turbidity, wavelength) for wavelength in _RATIO_NM]
    ozone = load_table("standards/spctrl2")["ozone"].at(_RATIO_NM) * sky.ozone_du / 1000.0
    return Depths(
        tuple(_RATIO_NM.tolist()),
        tuple((molecules * pressure).tolist()),
        tuple(aerosol),
        (_AEROSOL_ALBEDO,) * len(_RATIO_NM),
        tuple(ozone.tolist()),
        sky.ground_albedo,
    )


def _on_map(ratio: TwilightRatio, sun_azimuth_deg: float) -> Floats:
    """(MAP_ROWS // 2 + 1, MAP_COLUMNS, nodes) ratios of radiances in the map's directions."""
    from scipy.interpolate import RegularGridInterpolator

    direction = map_directions()[: MAP_ROWS // 2 + 1]
    elevation = np.degrees(np.arcsin(np.clip(direction[..., 2], 0.0, 1.0)))
    turn = np.degrees(np.arctan2(direction[..., 0], direction[..., 1])) - sun_azimuth_deg
    turn = np.abs((turn + 180.0) % 360.0 - 180.0)
    log = np.log(np.maximum(ratio.radiance[..., : len(NODES_NM)], 1e-300))
    return np.asarray(
        np.exp(RegularGridInterpolator((ratio.elevation_deg, ratio.from_sun_deg), log)((elevation, turn)))
    )


@lru_cache(maxsize=1)
def _own_light() -> NightLight:
    zenith, sine = night_radiance(), np.cos(np.arange(MAP_ROWS // 2 + 1) * np.pi / (MAP_ROWS - 1))
    shape = night_shape(sine)
    level = float(shape @ row_weights() * MAP_COLUMNS)
    shape = np.repeat((shape / level)[:, None, None], len(NODES_NM), axis=2)
    return NightLight(Spectrum(zenith.wavelength_nm, zenith.value * level), shape.astype(np.float32))
