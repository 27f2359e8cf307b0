"""Ponds and streams of a site: where their water stands, the bed under it, and their surfaces.

The ground is carved: the bed is a bowl or a channel below the level, as steep at the shore as the bank, which rises
until it meets the ground as it was. A pond's level is below all ground around its shore, so that nothing runs out on
a slope. A stream's level falls, or stays, all along to its lower end, and is below the ground beside it: where the
ground rises on its way it cuts in. A stream that meets a pond of the list before it has that pond's level there.
Nothing is mirrored or carried by a surface here: render/paths/water.py has the light. Slopes of banks are ours.

Waves
-----
Under a wind of U m/s (`wind.speed_m_per_s`) the slopes of a water surface have a variance of 0.003 + 0.00512 U, both
directions together (Cox and Munk 1954, at sea, 12.5 m up); in still air it is a mirror. Running water is as rough as
under a wind of `RUNNING_M_PER_S`, a number of ours. Every octave of wavelengths has the same share of the variance, as
in Phillips' range of saturation, from 1 m down to 2 mm: those of 4 cm and more are a relief that repeats every
`WAVES_M`, the rest are facets too small to be seen. The waves do not move.

Absorption
----------
Of pure water by the table `standards/water`, and of dissolved matter by a exp(-S (w - 440 nm)), S = 0.0171 /nm in fresh
water (Markager and Vincent 2000). a is `dissolved_per_m`: 404 spectra of 20 Finnish and Estonian lakes had from 0.71 to
19.5 /m at 380 nm, in the mean 6.6 (Sipelgas et al. 2003), which is 2.4 /m at 440 nm. Particles, which scatter, are left
out: what comes up from deep water is black.

References
----------
CERC (1984): Shore Protection Manual, 4th edition. US Army Coastal Engineering Research Center.
Cox, C., Munk, W. (1954): Measurement of the roughness of the sea surface from photographs of the sun's glitter. J. Opt.
Soc. Am. 44, 838-850.
Markager, S., Vincent, W. (2000): Spectral light attenuation and the absorption of UV and blue light in natural waters.
Limnol. Oceanogr. 45, 642-650.
Phillips, O. M. (1958): The equilibrium range in the spectrum of wind-generated waves. J. Fluid Mech. 4, 426-434.
Sipelgas, L., et al. (2003): Optical properties of dissolved organic matter in Finnish and Estonian lakes. Hydrology
Research 34, 361-386.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import RecipeError
from forestgen.core.spectrum import Spectrum
from forestgen.geometry.mesh import Floats
from forestgen.plants.bark.texture import SurfaceTexture
from forestgen.recipe import land
from forestgen.recipe.spectra import load_table
from forestgen.scene.courses import STEP_M, Course
from forestgen.scene.spec import Material
from forestgen.scene.surfaces import film_reflectances

REACH_M = 25.0  # of banks from the shore
RUNNING_M_PER_S = 1.5
WAVES_M, _WAVES_PX = 8.0, 512
_WAVE_M, _RELIEF_M = (0.002, 1.0), 0.04  # lengths of waves, and the shortest of the relief
_FREEBOARD_M = 0.08  # of the ground around the shore above the level
_BESIDE_M = (0.3, 1.0)  # of the shore, where the ground is to be above the level
_BANK, _BANK_PER_M = 0.15, 0.06  # slope of a bank at the shore, and by how much it grows with the distance, half
_BOWL = 0.6  # of a pond's radius, over which it grows deep
_LOBES = 20  # of a pond's outline
_LEVELLED_M = 2.0  # of a stream, over which its level is even
_DISSOLVED_SLOPE_PER_NM = 0.0171
_STILL_ALPHA = 0.004  # facets of a mirror: the renderer needs some

Ints = NDArray[np.intp]
Surface = Callable[[Floats, Floats], Floats]


class Near(NamedTuple):
    """Some of the points that were asked for, near a body of water."""

    rows: Ints  # (M,) of the points
    shore_m: Floats  # (M,) distance from the shore, negative in the water
    level_m: Floats  # (M,) of the water
    bed_m: Floats  # (M,) height of bed and bank


@dataclass(frozen=True, eq=False)
class Body:
    """A pond or stream."""

    keys: land.Pond | land.Stream

    def near(self, x_m: Floats, y_m: Floats) -> Near:
        """Of points (N,): those within `REACH_M` of the shore."""
        raise NotImplementedError

    def _near(self, rows: Ints, shore_m: Floats, level_m: Floats, shelf_m: Floats | float) -> Near:
        deep = np.clip(-shore_m / shelf_m, 0.0, 1.0)
        bank = np.maximum(shore_m, 0.0)
        first = np.minimum(_BANK * shelf_m / self.keys.depth_m, 2.0)  # slope of the bed at the shore, as the bank's
        shape = deep * (first + deep * (3.0 - 2.0 * first + deep * (first - 2.0)))
        bed = bank * (_BANK + _BANK_PER_M * bank) - self.keys.depth_m * shape
        return Near(rows, shore_m, level_m, level_m + bed)


@dataclass(frozen=True, eq=False)
class StillWater(Body):
    """A pond."""

    level_m: float
    lobes: Floats  # (L, 2) cosine and sine parts of the outline's radius over the mean one, from 2 waves around on

    def near(self, x_m: Floats, y_m: Floats) -> Near:
        assert isinstance(self.keys, land.Pond)
        x, y = x_m - self.keys.position_m[0], y_m - self.keys.position_m[1]
        rows = np.flatnonzero(np.hypot(x, y) < 2.0 * self.keys.radius_m + REACH_M)
        shore = np.hypot(x[rows], y[rows]) - outline_m(self.keys, self.lobes, np.arctan2(y[rows], x[rows]))
        rows, shore = rows[shore < REACH_M], shore[shore < REACH_M]
        return self._near(rows, shore, np.full(len(rows), self.level_m), _BOWL * self.keys.radius_m)


@dataclass(frozen=True, eq=False)
class RunningWater(Body):
    """A stream."""

    course: Course
    level_m: Floats  # (K,) by place of the course

    def near(self, x_m: Floats, y_m: Floats) -> Near:
        half_m = half_widths_m(self.keys, self.course)
        rows, distance, where = self.course.nearest(x_m, y_m, REACH_M + float(half_m.max()))
        half, level = (self.course.between(one, where) for one in (half_m, self.level_m))
        return self._near(rows, distance - half, level, half)


def outline_m(keys: land.Pond, lobes: Floats, angle: Floats) -> Floats:
    """(N,) radius of a pond by angle."""
    waves = np.zeros(len(angle))
    for number, (cosine, sine) in enumerate(lobes, start=2):
        waves += cosine * np.cos(number * angle) + sine * np.sin(number * angle)
    return keys.radius_m * np.clip(1.0 + waves, 0.5, 1.5)


def half_widths_m(keys: land.Pond | land.Stream, course: Course) -> Floats:
    """(K,) of a stream along its course."""
    assert isinstance(keys, land.Stream)
    return 0.5 * keys.width_m * np.clip(1.0 + 0.12 * course.uneven, 0.6, 1.4)


def pond(keys: land.Pond, ground: Surface, rng: np.random.Generator) -> StillWater:
    """A pond in the `ground`, or in the water that is there already."""
    size = 0.16 / np.arange(2, 2 + _LOBES)[:, None]
    lobes = size * rng.standard_normal((_LOBES, 2)) / np.sqrt(2.0)
    angle = np.linspace(0.0, 2.0 * np.pi, 361)
    shore = np.concatenate([outline_m(keys, lobes, angle) + beside for beside in (0.0, *_BESIDE_M)])
    x, y = (
        shore * np.tile(wave(angle), 1 + len(_BESIDE_M)) + middle
        for wave, middle in zip((np.cos, np.sin), keys.position_m, strict=True)
    )
    return StillWater(keys, float(ground(x, y).min()) - _FREEBOARD_M, lobes)


def stream(keys: land.Stream, ground: Surface, pond_level: Surface, rng: np.random.Generator) -> RunningWater:
    """A stream in the ground; `pond_level`: of the water that is there already, -inf where there is none."""
    from scipy.ndimage import uniform_filter1d

    course = Course.through(keys.points_m, rng)
    first_m, last_m = ground(*course.places_m[[0, -1]].T)
    if first_m < last_m:
        course = Course(course.places_m[::-1].copy(), course.uneven[::-1].copy())
    half = float(half_widths_m(keys, course).max())
    inside = half * np.linspace(-1.0, 1.0, 3 + 2 * int(half))
    offsets = np.concatenate([inside, *([-half - one, half + one] for one in _BESIDE_M)])
    places = course.across_m(offsets)
    dry_m = ground(*places.reshape(-1, 2).T).reshape(places.shape[:2]).min(axis=1) - _FREEBOARD_M
    still_m = pond_level(*course.places_m.T)
    later_m = np.maximum.accumulate(still_m[::-1])[::-1]  # of ponds that it comes to
    uphill = np.flatnonzero(~np.isfinite(still_m) & (later_m > dry_m + _FREEBOARD_M))
    if len(uphill):
        (x, y), rise_m = course.places_m[uphill[0]], later_m[uphill[0]] - dry_m[uphill[0]] - _FREEBOARD_M
        problem, expected = "this stream would run uphill to a pond", "ground above the pond's water all the way to it"
        got = f"ground {rise_m:.2g} m below it at [{x:.1f}, {y:.1f}]"
        raise RecipeError(problem, expected=expected, got=got, hint="move the pond or the stream")
    level = np.minimum.accumulate(np.where(np.isfinite(still_m), still_m, dry_m))
    even = uniform_filter1d(level, max(1, int(_LEVELLED_M / STEP_M)), mode="nearest")
    level = np.maximum(np.minimum.accumulate(np.minimum(even, level + _FREEBOARD_M)), later_m)
    return RunningWater(keys, course, np.where(np.isfinite(still_m), still_m, level))


def absorption(dissolved_per_m: float) -> Spectrum:
    """Absorption of water, 1/m."""
    pure = load_table("standards/water")["absorption_per_m"]
    brown = dissolved_per_m * np.exp(-_DISSOLVED_SLOPE_PER_NM * (pure.wavelength_nm - 440.0))
    return Spectrum(pure.wavelength_nm, pure.value + brown)


def slope_variance(wind_m_per_s: float) -> float:
    """Of both directions together."""
    return 0.003 + 0.00512 * wind_m_per_s if wind_m_per_s > 0.0 else 0.0


def wave_height_m(keys: land.Pond | land.Stream, wind_m_per_s: float) -> float:
    """Of waves where the wind has blown across the water: 0.0016 U (F / g)^0.5 (CERC 1984, equation 3-33)."""
    across_m = 2.0 * keys.radius_m if isinstance(keys, land.Pond) else keys.width_m
    return float(0.0016 * wind_m_per_s * np.sqrt(across_m / 9.81))


def water_material(keys: land.Pond | land.Stream, wind_m_per_s: float, rng: np.random.Generator) -> Material:
    """A body's surface: its waves, and what is too small of them for a relief as roughness.

    The reflectance is what it mirrors of an even sky: all that integrators which know no water have of it.
    """
    own_wind = max(wind_m_per_s, RUNNING_M_PER_S) if isinstance(keys, land.Stream) else wind_m_per_s
    variance = slope_variance(own_wind)
    coarse = np.log(_WAVE_M[1] / _RELIEF_M) / np.log(_WAVE_M[1] / _WAVE_M[0])
    alpha = max(_STILL_ALPHA, np.sqrt((1.0 - coarse) * variance))  # a Gaussian of slopes has the variance alpha²
    mirrored = film_reflectances()[0]
    texture = None
    if variance > 0.0:
        colour = np.full((_WAVES_PX, _WAVES_PX, 3), mirrored, dtype=np.float32)
        texture = SurfaceTexture(colour, waves(coarse * variance, rng), (WAVES_M, WAVES_M))
    return Material(
        (mirrored, mirrored, mirrored),
        roughness=float(np.sqrt(alpha)),
        texture=texture,
        absorption=absorption(keys.dissolved_per_m),
    )


def waves(variance: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """(P, P) heights, metres, periodic, whose slopes have a variance; alike in all directions."""
    cell = WAVES_M / _WAVES_PX
    axis = np.fft.fftfreq(_WAVES_PX, cell)
    k = np.hypot(axis[:, None], axis[None, : _WAVES_PX // 2 + 1])
    band = (k >= 1.0 / _WAVE_M[1]) & (k <= 1.0 / _RELIEF_M)
    power = np.where(band, np.maximum(k, 1e-9) ** -4.0, 0.0)
    noise = np.fft.rfft2(rng.standard_normal((_WAVES_PX, _WAVES_PX)))
    height = np.fft.irfft2(noise * np.sqrt(power))
    slopes = [(np.roll(height, -1, axis) - np.roll(height, 1, axis)) / (2.0 * cell) for axis in (0, 1)]
    found = float(np.mean(slopes[0] ** 2 + slopes[1] ** 2))
    return np.asarray(height * np.sqrt(variance / found), dtype=np.float32)
