"""Twilight: how the clear sky's light falls and changes while the sun sinks, and the night's own light.

How much
--------
Illuminance of level ground follows Seidelmann's polynomials (1992, table 9.34.1, after Janiczek and DeYoung 1987) from
its value for a sun on the horizon: log10 E = sum of l_k (h / 90)^k, with the sun's altitude h in degrees. 3.4 lux are
left at -6 degrees, 0.008 at -12. What they have at -18 degrees is the night's own light, which is subtracted.

Directions and colour
---------------------
Light is scattered in air around a globe: molecules (scale height 8 km), aerosol (1.2 km) and ozone, which only
absorbs, between 10 and 40 km (Bruneton and Neyret 2008; ozone as Hillaire 2020). The first scattering is integrated
along each line of sight, in sunlight that came through the air and past the globe; further scatterings are those of
Hillaire (2020, section 5.5): alike in all directions, with the light around a point that of its own height and sun.
Optical depths are those of SPCTRL2 (daylight.py), so ozone makes a late twilight blue (Hulburt 1953): without it, it
would be yellow. The model is used for ratios alone, those of a sun below the horizon to one on it, by which the
daylight's spectra and directions are multiplied: so day and twilight meet, and the amount is Seidelmann's. Its own
illuminances are 743, 234, 40, 4.2 and 0.31 lux at 0, -2, -4, -6 and -8 degrees (turbidity 3), Seidelmann's 759, 189,
30, 3.4 and 0.35. Deeper, light that was scattered several times far away matters, of which the model has too
little: the directions and colours of -8 degrees are kept.

The night's own light
---------------------
Airglow, zodiacal light and faint stars together: means of Patat (2003) at the zenith of a dark place, 22.3, 22.6, 21.6,
20.9 and 19.7 magnitudes per square arcsecond in U, B, V, R and I, as fluxes of Bessell (1979): 2.6e-4 cd/m². Towards
the horizon equation 2 of Krisciunas and Schaefer (1991), with an extinction of 0.172 magnitudes.

References
----------
Seidelmann, P. K. (ed.) (1992): Explanatory Supplement to the Astronomical Almanac. University Science Books.
Janiczek, P. M., DeYoung, J. A. (1987): Computer programs for sun and moon illuminance. USNO Circular 171.
Hulburt, E. O. (1953): Explanation of the brightness and color of the sky, particularly the twilight sky. J. Opt. Soc.
Am. 43, 113.
Bruneton, E., Neyret, F. (2008): Precomputed atmospheric scattering. Comput. Graph. Forum 27, 1079.
Hillaire, S. (2020): A scalable and production ready sky and atmosphere rendering technique. CGF 39, 13.
Patat, F. (2003): UBVRI night sky brightness during sunspot maximum at ESO-Paranal. Astron. Astrophys. 400, 1183.
Bessell, M. S. (1979): UBVRI photometry II. Publ. Astron. Soc. Pacific 91, 589.
Krisciunas, K., Schaefer, B. E. (1991): A model of the brightness of moonlight. Publ. Astron. Soc. Pacific 103, 1033.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from forestgen.core.spectrum import Spectrum

Floats = NDArray[np.float64]

DARK_DEG = -18.0  # end of astronomical twilight
# Lowest altitude, and l_0 to l_3 from there on.
_POLYNOMIALS = (
    (-18.0, (13.84, 262.72, 1447.42, 2797.93)),
    (-12.0, (2.70, 12.17, -431.69, -1899.83)),
    (-5.0, (2.88, 21.81, -258.11, -858.36)),
    (-0.8, (2.88, 22.26, -207.64, 1034.30)),
)
_GLOBE_KM, _TOP_KM = 6371.0, 100.0
_SCALE_KM = (8.0, 1.2)  # of molecules and aerosol
_OZONE_KM, _OZONE_HALF_KM = 25.0, 15.0  # middle, and half the width of a triangle
_AEROSOL_ASYMMETRY = 0.8
_LINE_STEPS, _SUN_STEPS = 48, 64
_LEAST_VIEW_DEG = 0.2  # the lowest line of sight, which stands for the horizon
_VIEW_DEG = np.array([_LEAST_VIEW_DEG, 1, 2, 3.5, 5, 7.5, 10, 14, 19, 25, 32, 42, 55, 72, 90])
_TURN_DEG = np.linspace(0.0, 180.0, 13)
_LOWEST_DEG = -8.0  # of the model's sun
_NIGHT_NM = np.array([365.0, 440.0, 550.0, 640.0, 790.0])  # U, B, V, R, I
_NIGHT_MAG = np.array([22.3, 22.6, 21.6, 20.9, 19.7])
_ZERO_W_PER_M2_NM = 1e-2 * np.array([4.19e-9, 6.60e-9, 3.61e-9, 2.25e-9, 1.22e-9])  # of magnitude 0
_SQUARE_ARCSECONDS = (180.0 / np.pi * 3600.0) ** 2  # of a steradian


def illuminance_below(elevation_deg: float) -> float:
    """Lux of level ground, without moon and the night's own light, by a sun at [-90, 0] degrees."""
    return max(_seidelmann(elevation_deg) - _seidelmann(DARK_DEG), 0.0)


def _seidelmann(elevation_deg: float) -> float:
    elevation_deg = max(elevation_deg, DARK_DEG)
    terms = next(terms for lowest, terms in reversed(_POLYNOMIALS) if elevation_deg >= lowest)
    return float(10.0 ** sum(term * (elevation_deg / 90.0) ** k for k, term in enumerate(terms)))


@dataclass(frozen=True)
class Depths:
    """Optical depths of the whole air, straight up."""

    wavelength_nm: tuple[float, ...]
    molecules: tuple[float, ...]
    aerosol: tuple[float, ...]
    aerosol_albedo: tuple[float, ...]
    ozone: tuple[float, ...]
    ground_albedo: float


@dataclass(frozen=True, eq=False)
class TwilightRatio:
    """Light of a sun below the horizon over that of one on it, by the model."""

    elevation_deg: Floats  # (E,) of lines of sight, rising from 0
    from_sun_deg: Floats  # (A,) of azimuth, 0 to 180
    radiance: Floats  # (E, A, W)
    level: Floats  # (W,) of the irradiance of level ground


@lru_cache(maxsize=8)
def twilight_ratio(depths: Depths, sun_elevation_deg: float) -> TwilightRatio:
    """By the air and the sun's elevation below 0."""
    below, level = _sky(depths, max(sun_elevation_deg, _LOWEST_DEG)), _sky(depths, 0.0)
    elevation, sine = _VIEW_DEG - _LEAST_VIEW_DEG * (_VIEW_DEG == _LEAST_VIEW_DEG), np.sin(np.radians(_VIEW_DEG))
    flux = [np.trapezoid(one.mean(axis=1) * sine[:, None], sine, axis=0) for one in (below, level)]
    return TwilightRatio(elevation, _TURN_DEG, below / level, flux[0] / flux[1])


@lru_cache(maxsize=8)
def _sky(depths: Depths, sun_elevation_deg: float) -> Floats:
    """(E, A, W) radiance along the lines of sight of `twilight_ratio`."""
    return _Air(depths).sky(sun_elevation_deg, _VIEW_DEG, _TURN_DEG)


class _Air:
    """Air around a globe. Densities are those over the ground's, lengths kilometres."""

    def __init__(self, depths: Depths) -> None:
        lengths = (*_SCALE_KM, _OZONE_HALF_KM)
        self.per_km = np.array([depths.molecules, depths.aerosol, depths.ozone]) / np.array(lengths)[:, None]
        self.scattered = self.per_km[:2] * np.array([np.ones(len(depths.molecules)), depths.aerosol_albedo])
        self.ground_albedo = depths.ground_albedo

    def sky(self, sun_elevation_deg: float, elevation_deg: Floats, turn_deg: Floats) -> Floats:
        """(E, A, W) radiance seen from the ground, of a sun that shines with 1 in space."""
        up, turn = np.meshgrid(np.radians(elevation_deg), np.radians(turn_deg), indexing="ij")
        view = np.stack([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)], axis=-1).reshape(-1, 3)
        sun = np.radians(sun_elevation_deg)
        to_sun = np.array([np.cos(sun), 0.0, np.sin(sun)])
        heights = np.array([0.0, 1, 3, 6, 10, 15, 22, 30, 45, 65, 100])
        cosines = np.sin(np.radians(np.linspace(sun_elevation_deg - 12.0, sun_elevation_deg + 12.0, 9)))
        further = self._further(heights, cosines)
        found = self._along(np.zeros(len(view)), view, to_sun, (heights, cosines, further))
        return np.asarray(found.reshape(*up.shape, -1))

    def _further(self, heights_km: Floats, cosines: Floats) -> Floats:
        """(H, C, W) radiance of light scattered twice and more, around points by height and cosine of the sun."""
        count = 6
        node, weight = np.polynomial.legendre.leggauss(count)
        turn = (np.arange(count) + 0.5) / count * np.pi
        z, phi = (one.ravel() for one in np.meshgrid(node, turn, indexing="ij"))
        view = np.stack([np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z], axis=-1)
        shares = np.repeat(weight / 2.0, count) / count
        result = np.empty((len(heights_km), len(cosines), self.per_km.shape[1]))
        for i, height in enumerate(heights_km):
            # Of light alike in all places and directions, the share that is scattered once more.
            again = np.tensordot(shares, self._along(np.full(len(view), height), view, None, None), 1)
            for j, cosine in enumerate(cosines):
                to_sun = np.array([np.sqrt(1.0 - cosine**2), 0.0, cosine])
                once = self._along(np.full(len(view), height), view, to_sun, None, even=True)
                result[i, j] = np.tensordot(shares, once, 1) / (1.0 - np.minimum(again, 0.95))
        return result

    def _along(
        self,
        height_km: Floats,
        view: Floats,
        to_sun: Floats | None,
        further: tuple[Floats, Floats, Floats] | None,
        *,
        even: bool = False,
    ) -> Floats:
        """(N, W) light scattered into lines of sight (N, 3) from heights above the place at x = y = 0.

        `to_sun` None: by light of 1 from everywhere. `even`: alike in all directions, and with light off the ground.
        """
        start = np.zeros_like(view)
        start[:, 2] = _GLOBE_KM + height_km
        reach, on_ground = _reach(start, view)
        share = (np.arange(_LINE_STEPS) + 0.5) / _LINE_STEPS
        way = reach[:, None] * share**2
        step = reach[:, None] * 2.0 * share / _LINE_STEPS
        point = start[:, None] + way[..., None] * view[:, None]
        radius = np.linalg.norm(point, axis=-1)
        density = _densities(radius - _GLOBE_KM)
        depth = np.cumsum(density * step, axis=-1) - 0.5 * density * step
        through = np.exp(-np.tensordot(np.moveaxis(depth, 0, -1), self.per_km, 1))
        sources = np.moveaxis(density[:2], 0, -1)
        if to_sun is None:
            return np.asarray(np.sum((sources @ self.scattered) * through * step[..., None], axis=1))
        lit = self._sunlight(point.reshape(-1, 3), to_sun).reshape(*radius.shape, -1)
        cosine = view @ to_sun
        phases = np.ones((2, len(view))) if even else np.stack([_rayleigh(cosine), _henyey(cosine)])
        weighted = np.einsum("nsk,kn,kw->nsw", sources, phases / (4.0 * np.pi), self.scattered) * lit
        if further is not None:
            around = _interpolated(further, radius - _GLOBE_KM, (point @ to_sun) / radius)
            weighted = weighted + (sources @ self.scattered) * around
        result = np.sum(weighted * through * step[..., None], axis=1)
        if even:
            end = start + reach[:, None] * view
            facing = np.maximum(end @ to_sun / np.linalg.norm(end, axis=-1), 0.0) * on_ground
            whole = np.exp(-np.tensordot(np.moveaxis(np.sum(density * step, axis=-1), 0, -1), self.per_km, 1))
            lit = self._sunlight(end * (1.0 + 1e-6), to_sun)
            result = result + self.ground_albedo / np.pi * facing[:, None] * lit * whole
        return np.asarray(result)

    def _sunlight(self, point: Floats, to_sun: Floats) -> Floats:
        """(N, W) of the sun's light, what comes to points through the air; 0 in the globe's shadow."""
        reach, blocked = _reach(point, np.broadcast_to(to_sun, point.shape))
        share = (np.arange(_SUN_STEPS) + 0.5) / _SUN_STEPS
        way = reach[:, None] * share**1.5
        step = reach[:, None] * 1.5 * share**0.5 / _SUN_STEPS
        radius = np.linalg.norm(point[:, None] + way[..., None] * to_sun, axis=-1)
        depth = np.sum(_densities(radius - _GLOBE_KM) * step, axis=-1)
        return np.asarray(np.exp(-depth.T @ self.per_km) * ~blocked[:, None])


def _reach(point: Floats, way: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """(N,) km from points along (N, 3) directions to the end of the air, or to the ground; whether it is the ground."""
    along, square = np.einsum("nk,nk->n", point, way), np.einsum("nk,nk->n", point, point)
    outer = -along + np.sqrt(np.maximum(along**2 - square + (_GLOBE_KM + _TOP_KM) ** 2, 0.0))
    inner = along**2 - square + (_GLOBE_KM - 1e-3) ** 2
    ground = (along < 0) & (inner > 0)
    return np.where(ground, -along - np.sqrt(np.maximum(inner, 0.0)), outer), ground


def _densities(height_km: Floats) -> Floats:
    """(3, ...) of molecules, aerosol and ozone over those at the ground; of ozone, over its greatest."""
    height = np.maximum(height_km, 0.0)
    ozone = np.maximum(1.0 - np.abs(height - _OZONE_KM) / _OZONE_HALF_KM, 0.0)
    return np.stack([np.exp(-height / _SCALE_KM[0]), np.exp(-height / _SCALE_KM[1]), ozone])


def _rayleigh(cosine: Floats) -> Floats:
    return np.asarray(0.75 * (1.0 + cosine**2))


def _henyey(cosine: Floats) -> Floats:
    g = _AEROSOL_ASYMMETRY
    return np.asarray((1.0 - g * g) / (1.0 + g * g - 2.0 * g * cosine) ** 1.5)


def _interpolated(table: tuple[Floats, Floats, Floats], height_km: Floats, cosine: Floats) -> Floats:
    """(..., W) straight lines between a table's heights and cosines."""
    heights, cosines, value = table
    places = []
    for nodes, at in ((heights, height_km), (cosines, cosine)):
        low = np.clip(np.searchsorted(nodes, at) - 1, 0, len(nodes) - 2)
        places.append((low, np.clip((at - nodes[low]) / (nodes[low + 1] - nodes[low]), 0.0, 1.0)[..., None]))
    (i, u), (j, v) = places
    below = value[i, j] * (1 - v) + value[i, j + 1] * v
    above = value[i + 1, j] * (1 - v) + value[i + 1, j + 1] * v
    return np.asarray(below * (1 - u) + above * u)


@cache
def night_radiance() -> Spectrum:
    """Of the dark sky's zenith, W/m²/sr/nm; beyond the bands as at their ends."""
    value = _ZERO_W_PER_M2_NM * 10.0 ** (-0.4 * _NIGHT_MAG) * _SQUARE_ARCSECONDS
    return Spectrum(_NIGHT_NM, value)


def night_shape(sine: Floats) -> Floats:
    """Radiance of the dark sky over the zenith's, by the sine of the elevation."""
    mass = (1.0 - 0.96 * (1.0 - np.clip(sine, 0.0, 1.0) ** 2)) ** -0.5
    return np.asarray(10.0 ** (-0.4 * 0.172 * (mass - 1.0)) * mass)
