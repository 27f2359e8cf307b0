"""Cirrus: thin high clouds of ice in streaks, without dynamics.

Model
-----
Ice forms in small cells at the top of the layer, and falls while the wind below is slower: it is drawn out into a
streak against the wind, ever farther with depth, as mare's tails are. The cells are noise of 300 m to 3 km, many times
longer along the wind than across, in patches of some ten kilometres; its exponential makes few strong streaks and much
thin veil. A layer at the share s of the thickness below the top lies `streak_m` s² upwind, where the fall through air
of constant shear has brought it, and holds less ice the lower it is, which sublimes.

Ice scatters forwards less than droplets do: asymmetry 0.75 for the rough aggregates of columns that satellites'
retrievals use (Yang et al. 2013; the number is that of MODIS collection 6, Platnick et al. 2017, quoted from memory).
Here it is that of two Henyey-Greenstein lobes, 0.82 and -0.55, with 95% of the light in the first. Halos need smooth
crystals, and are left out. The extinction is scaled such that the mean optical depth of the cloudy part is
`optical_depth`: cirrus have 0.03 to 3, thin ones up to 0.3 (Sassen and Cho 1992).

The field is centred on the site, and is drawn once: it is a square with straight edges. Seen from its middle there is
no cirrus below an elevation of atan(2 base_m / extent_m), 22 degrees by default and 10 with an `extent_m` of 100,000.

Example
-------
    sky: {clouds: {type: cirrus, cover: 0.5, optical_depth: 0.2}}

Parameters: see below.

References
----------
Sassen, K., Cho, B. S. (1992): Subvisual-thin cirrus lidar dataset for satellite verification and climatological
research. J. Appl. Meteorol. 31, 1275-1285.
Yang, P., et al. (2013): Spectrally consistent scattering, absorption, and polarization properties of atmospheric ice
crystals at wavelengths from 0.2 to 100 um. J. Atmos. Sci. 70, 330-347.
Platnick, S., et al. (2017): The MODIS cloud optical and microphysical products: Collection 6 updates and examples from
Terra and Aqua. IEEE Trans. Geosci. Remote Sens. 55, 502-525.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.atmosphere.clouds.source import CloudRequest, CloudSource
from forestgen.atmosphere.conditions import wind_towards
from forestgen.atmosphere.grid import CloudGrid, PhaseFunction
from forestgen.core.randomness import child_rng
from forestgen.recipe.fields import Fraction, NonNegative, Positive
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.sky import Clouds

ICE = PhaseFunction(0.82, -0.55, 0.95)  # of asymmetry 0.75
_ALBEDO = 0.999999
_LAYERS, _CELLS = 8, 448  # cells along a side
_BYTES_PER_CELL = 60
_PATCH_M, _LONGEST_M = 12_000.0, 3000.0
_STRETCH = 7.0  # of the cells along the wind
_CONTRAST = 0.9  # of the noise before its exponential


class CirrusKeys(Clouds):
    """Keys of `clouds: {type: cirrus}`."""

    cover: Fraction = Field(0.6, description="Of cirrus: fraction of the sky's area under cloud, 0 to 1.")
    optical_depth: Positive = Field(
        0.2, le=3, description="Of cirrus: mean optical depth of the cloudy part; thin cirrus have 0.05 to 0.5."
    )
    base_m: Positive = Field(9000.0, le=18000, description="Of cirrus: height of the base above ground, metres.")
    thickness_m: Positive = Field(900.0, le=4000, description="Of cirrus: height of the layer, metres.")
    streak_m: NonNegative = Field(
        4000.0, le=20000, description="Of cirrus: length of the streaks of falling ice, metres."
    )
    extent_m: Positive = Field(
        45000.0,
        le=100000,
        description="Of cirrus: side of the square of clouds, metres. Nothing is beyond it: at 45 km no cirrus is seen "
        "below 22 degrees above the horizon, at 100 km below 10.",
    )

    @property
    def known_cover(self) -> float:
        return self.cover


class Cirrus(CloudSource[CirrusKeys]):
    """Thin high clouds of ice in streaks along the wind, made in a second."""

    Parameters = CirrusKeys

    def known_base_m(self, drawn: DrawnRecipe) -> float:
        return self.keys_of(drawn).base_m

    def estimate_bytes(self, drawn: DrawnRecipe, model: object, parameters: object) -> int:
        return _CELLS**2 * _LAYERS * _BYTES_PER_CELL

    def grid(self, request: CloudRequest) -> CloudGrid | None:
        keys, rng = self.keys_of(request.drawn), child_rng(request.drawn.image_seed, "cirrus")
        if keys.cover == 0:
            return None
        wind = wind_towards(1.0, request.drawn.recipe.site.wind_from_deg)
        x, y = request.middle_of_site_m
        half = keys.extent_m / 2.0
        return CloudGrid(
            cirrus_field(keys, wind, rng),
            (x - half, y - half, request.ground_m + keys.base_m),
            (x + half, y + half, request.ground_m + keys.base_m + keys.thickness_m),
            _ALBEDO,
            ICE,
        )


def cirrus_field(keys: CirrusKeys, wind: tuple[float, float], rng: np.random.Generator) -> NDArray[np.float32]:
    """(Z, Y, X) extinction per metre; `wind` is the unit vector towards which it blows, east and north."""
    import scipy.fft

    side_m = keys.extent_m / _CELLS
    north, east = np.meshgrid(scipy.fft.fftfreq(_CELLS, side_m), scipy.fft.fftfreq(_CELLS, side_m), indexing="ij")
    along, across = east * wind[0] + north * wind[1], east * wind[1] - north * wind[0]
    size = np.hypot(along * _STRETCH, across)
    # Power of k^-2.5 from the longest wavelength across the wind on; patches are round.
    cells = np.maximum(size, 1.0 / _LONGEST_M) ** (-0.5 * (2.5 + 1.0)) * (size > 0.5 / _LONGEST_M)
    patches = np.exp(-((np.hypot(along * 2.0, across) * _PATCH_M) ** 2)) * (size > 0)
    streaks, patch = (_noise(one, rng) for one in (cells, patches))
    there = np.clip((patch - np.quantile(patch, 1.0 - keys.cover)) / 0.6, 0.0, 1.0)
    ice = np.exp(_CONTRAST * streaks) * there
    spectrum = scipy.fft.fft2(ice)
    share = (np.arange(_LAYERS)[::-1] + 0.5) / _LAYERS  # of the way down, of layers from the base up
    layers = []
    for down in share:
        moved = spectrum * np.exp(2j * np.pi * along * keys.streak_m * down**2)  # upwind
        layers.append((1.0 - down) ** 0.7 * np.maximum(scipy.fft.ifft2(moved).real, 0.0))
    field = np.stack(layers)
    depth = field.sum(axis=0) * keys.thickness_m / _LAYERS
    cloudy = max(float(np.mean(there > 0)), 1.0 / _CELLS**2)
    return np.ascontiguousarray(field * (keys.optical_depth * cloudy / depth.mean()), dtype=np.float32)


def _noise(amplitude: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Periodic Gaussian noise of unit variance with the amplitudes of its waves."""
    import scipy.fft

    value = scipy.fft.ifft2(scipy.fft.fft2(rng.standard_normal(amplitude.shape)) * amplitude).real
    return np.asarray((value - value.mean()) / value.std())


SOURCE = Cirrus()
