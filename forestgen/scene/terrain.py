"""The ground: its height everywhere, a mesh dense on the site and coarse to the horizon, and its colour.

Heights are a finite sum of waves with random directions, so any point can be asked, at any resolution, with the same
answer; the mesh and the plants' feet both ask the same function.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.bounded_cache import BoundedCache
from forestgen.core.compiled import compiled
from forestgen.core.spectrum import Spectrum
from forestgen.geometry.mesh import Mesh
from forestgen.plants.bark.texture import with_mean
from forestgen.recipe.spectra import load_spectra
from forestgen.scene.colour import colours_of_surface
from forestgen.scene.soil_colour import DARKENED, Wetness, wet_ground
from forestgen.scene.spec import Terrain

HORIZON_M = 200_000.0  # from 300 m up, a flat earth ends 0.1 degrees below the horizon
HILLS_FROM_M = 250.0
_MARGIN_M = 20.0
_SITE_CELL_M = 0.75
TEXTURE_TILE_M = 24.0
_TEXTURE_PX = 1536
_LEAVES_PER_M2 = 260
SNOW_AFAR = 0.4  # share of woods and meadows that lies under snow
_AT_ONCE = 8192  # points whose height is asked for: their numbers stay in the processor's cache


@dataclass(frozen=True, eq=False)  # arrays have no equality of one word: a field equals itself
class HeightField:
    """Height of the ground: waves on and near the site, hills in the distance.

    z = sum of amplitude * fade * sin(k . x + phase). Near waves fade out over a wavelength away from the site, where
    the mesh is too coarse to carry them; hills fade in from `HILLS_FROM_M` on, so that the site keeps its own
    relief, and out again four wavelengths away.
    """

    size_m: tuple[float, float]  # of the site
    wave_per_m: NDArray[np.float64]  # (M, 2) angular wave vectors
    amplitude_m: NDArray[np.float64]  # (M,)
    phase: NDArray[np.float64]  # (M,)
    hill: NDArray[np.bool_]  # (M,) a hill of the distance, not a wave of the site

    def __call__(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Height at points of any shape; O(points x waves)."""
        x, y = np.broadcast_arrays(x_m, y_m)
        shape, x, y = x.shape, x.ravel(), y.ravel()
        z = np.empty(x.shape)
        for start in range(0, len(z), _AT_ONCE):
            part = slice(start, start + _AT_ONCE)
            z[part] = self._height(x[part], y[part])
        return z.reshape(shape)

    def _height(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        z = np.zeros(x_m.shape)
        away = self.distance_m(x_m, y_m)
        far = smooth_step((away - HILLS_FROM_M) / (6 * HILLS_FROM_M))
        has_hills = bool(far.any())
        for k, amplitude, phase, hill in zip(self.wave_per_m, self.amplitude_m, self.phase, self.hill, strict=True):
            if hill and not has_hills:
                continue
            wavelength = 2 * np.pi / np.hypot(*k)
            fade = (
                far * (1 - smooth_step(away / (2 * wavelength) - 1))
                if hill
                else 1 - smooth_step((away - _MARGIN_M) / wavelength)
            )
            z += amplitude * fade * np.sin(k[0] * x_m + k[1] * y_m + phase)
        return z

    def distance_m(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance from the site's rectangle, 0 inside."""
        dx = np.maximum(np.maximum(-x_m, x_m - self.size_m[0]), 0.0)
        dy = np.maximum(np.maximum(-y_m, y_m - self.size_m[1]), 0.0)
        return np.hypot(dx, dy)


def smooth_step(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """0 below 0, 1 above 1, with a continuous slope."""
    t = np.clip(x, 0.0, 1.0)
    return t * t * (3 - 2 * t)


def rolling(
    size_m: tuple[float, float], amplitude_m: float, wavelength_m: float, rng: np.random.Generator
) -> HeightField:
    """Gently rolling ground: standard deviation `amplitude_m`, wavelengths from `wavelength_m` down to 1/8 of it.

    Around it, from some hundred metres on, hills of 900 to 3000 m and a standard deviation of 22 m.
    """
    waves, hills = 24, 10
    wavelength = np.concatenate([wavelength_m * 0.5 ** (3.0 * rng.random(waves)), 900.0 + 2100.0 * rng.random(hills)])
    angle = rng.random(waves + hills) * 2 * np.pi
    k = 2 * np.pi / wavelength
    hill = np.arange(waves + hills) >= waves
    weight = np.where(hill, wavelength, wavelength**2)  # long waves carry most of the height, as on eroded land
    for group, deviation in ((~hill, amplitude_m), (hill, 22.0 if amplitude_m > 0 else 0.0)):
        weight[group] *= deviation * np.sqrt(2.0 / np.sum(weight[group] ** 2))
    direction = np.stack([k * np.cos(angle), k * np.sin(angle)], axis=1)
    return HeightField(size_m, direction, weight, rng.random(waves + hills) * 2 * np.pi, hill)


def flat(size_m: tuple[float, float]) -> HeightField:
    """z = 0."""
    return HeightField(size_m, np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0, dtype=bool))


def _graded_axis(length_m: float) -> NDArray[np.float64]:
    """Coordinates: even cells over the site and a margin, then each cell 8% longer than the last, to the horizon."""
    cells = int(min(np.ceil((length_m + 2 * _MARGIN_M) / _SITE_CELL_M), 1200))
    inner = np.linspace(-_MARGIN_M, length_m + _MARGIN_M, cells + 1)
    step, reach, outer = inner[1] - inner[0], _MARGIN_M, []
    while reach < HORIZON_M:
        step *= 1.08
        reach += step
        outer.append(reach)
    out = np.asarray(outer)
    return np.concatenate([-out[::-1], inner, length_m + out])


def terrain_mesh(height: HeightField) -> Mesh:
    """Height field as triangles, smooth normals, uv in tiles of `TEXTURE_TILE_M`."""
    xs, ys = _graded_axis(height.size_m[0]), _graded_axis(height.size_m[1])
    x, y = np.meshgrid(xs, ys)
    z = height(x, y)
    slope_y, slope_x = np.gradient(z, ys, xs)
    normal = np.stack([-slope_x, -slope_y, np.ones_like(z)], axis=-1).reshape(-1, 3)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    columns = len(xs)
    corner = (np.arange(len(ys) - 1)[:, None] * columns + np.arange(columns - 1)[None, :]).ravel()
    lower = np.stack([corner, corner + 1, corner + columns + 1], axis=1)
    upper = np.stack([corner, corner + columns + 1, corner + columns], axis=1)
    return Mesh(
        vertices_m=np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32),
        faces=np.concatenate([lower, upper]).astype(np.uint32),
        normals=normal.astype(np.float32),
        uv=(np.stack([x, y], axis=-1).reshape(-1, 2) / TEXTURE_TILE_M).astype(np.float32),
    )


def _tile_noise(longest_m: float, shortest_m: float, slope: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """(P, P) periodic noise of unit variance with power ~ k^-slope between two wavelengths."""
    cell = TEXTURE_TILE_M / _TEXTURE_PX
    frequency = np.fft.fftfreq(_TEXTURE_PX, cell)
    k = np.hypot(frequency[:, None], frequency[None, : _TEXTURE_PX // 2 + 1])
    band = (k >= 1 / longest_m) & (k <= 1 / shortest_m)
    amplitude = np.where(band, np.maximum(k, 1e-9) ** (-slope / 2), 0.0)
    field = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((_TEXTURE_PX, _TEXTURE_PX))) * amplitude)
    return np.asarray((field - field.mean()) / field.std())


_DRY_LEAVES = np.array(  # linear Rec. 709: russet, tan, straw, grey-brown, dark and half-rotten
    [[0.135, 0.078, 0.038], [0.190, 0.125, 0.062], [0.255, 0.190, 0.100], [0.150, 0.118, 0.082], [0.060, 0.042, 0.028]]
)
_HUMUS = np.array([0.040, 0.030, 0.021])
_MOSS = np.array([0.046, 0.066, 0.019])


def _scattered_leaves(rng: np.random.Generator) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """(P, P) index of the uppermost leaf or -1; each leaf's colour (L, 3); (P, P) shade of a leaf's folded halves."""
    leaves = int(_LEAVES_PER_M2 * TEXTURE_TILE_M**2)
    cell = TEXTURE_TILE_M / _TEXTURE_PX
    centre = rng.random((leaves, 2)) * _TEXTURE_PX
    angle = rng.random(leaves) * 2 * np.pi
    half_length = (0.018 + 0.026 * rng.random(leaves)) / cell
    half_width = half_length * (0.45 + 0.35 * rng.random(leaves))
    upper = np.full((_TEXTURE_PX, _TEXTURE_PX), -1, dtype=np.int64)
    side = np.zeros((_TEXTURE_PX, _TEXTURE_PX), dtype=np.int8)
    _lay_leaves(centre, np.cos(angle), np.sin(angle), half_length, half_width, upper, side)
    kind = rng.choice(len(_DRY_LEAVES), leaves, p=[0.30, 0.26, 0.10, 0.20, 0.14])
    colour = _DRY_LEAVES[kind] * (0.75 + 0.5 * rng.random((leaves, 1)))
    return upper, colour, 1 + 0.16 * side.astype(np.float64)


@compiled
def _lay_leaves(centre, cos, sin, half_length, half_width, upper, side):  # type: ignore[no-untyped-def]
    """Lay leaves one upon another, periodically: each pixel keeps the last one's index, and which half of it it sees.

    Parameters
    ----------
    centre : (L, 2) column and row, pixels; cos, sin : (L,) of the direction of a leaf's axis.
    half_length, half_width : (L,) pixels.
    upper, side : (P, P) written: index of the uppermost leaf, and 1 or -1 left and right of its axis.
    """
    pixels = len(upper)
    reach = int(np.ceil(half_length.max()))
    for leaf in range(len(centre)):
        column, row = int(np.floor(centre[leaf, 0])), int(np.floor(centre[leaf, 1]))
        for dy in range(-reach, reach + 1):
            y = row + dy + 0.5 - centre[leaf, 1]
            for dx in range(-reach, reach + 1):
                x = column + dx + 0.5 - centre[leaf, 0]
                along = (x * cos[leaf] + y * sin[leaf]) / half_length[leaf]
                across = (y * cos[leaf] - x * sin[leaf]) / half_width[leaf]
                if across * across < (1 - along * along) * (1 - 0.45 * along):
                    upper[(row + dy) % pixels, (column + dx) % pixels] = leaf
                    side[(row + dy) % pixels, (column + dx) % pixels] = np.sign(across)


def litter_texture(rng: np.random.Generator) -> NDArray[np.float32]:
    """(P, P, 3) reflectance of a forest floor, periodic: fallen leaves on dark humus, moss in patches."""
    upper, leaf_colour, shade = _scattered_leaves(rng)
    patches = _tile_noise(9.0, 0.25, 2.6, rng)
    grain = _tile_noise(0.25, 0.032, 0.5, rng)
    cover = 1 / (1 + np.exp(-(patches - 0.55) / 0.22))
    texture = np.empty((*upper.shape, 3), dtype=np.float32)
    _grow_moss(upper, leaf_colour, shade, patches, grain, cover, texture)
    return texture


@compiled
def _grow_moss(upper, leaf_colour, shade, patches, grain, cover, texture):  # type: ignore[no-untyped-def]
    """Write the colours of leaves, humus and moss: every image has a floor of its own, so it has to be fast.

    Parameters
    ----------
    upper, leaf_colour, shade : of `_scattered_leaves`.
    patches, grain : (P, P) of unit variance.
    cover : (P, P) share of the ground that moss takes.
    texture : (P, P, 3) written.
    """
    for row in range(upper.shape[0]):
        for column in range(upper.shape[1]):
            leaf, share = upper[row, column], cover[row, column]
            if leaf >= 0:  # moss spreads under the leaves first: where it is thin, leaves still lie on it
                share = min(max(2.2 * share - 1.2, 0.0), 1.0)
            fine, coarse = grain[row, column], patches[row, column]
            for k in range(3):
                litter = leaf_colour[leaf, k] * shade[row, column] if leaf >= 0 else _HUMUS[k] * (1 + 0.25 * fine)
                moss = _MOSS[k] * (1 + 0.3 * fine) * (1 + 0.25 * coarse)
                texture[row, column, k] = min(max(litter + share * (moss - litter), 0.012), 0.6)


_UNEVENNESS = {  # of a ground's brightness: in patches of metres, in grains of centimetres
    "soil_dry": (0.10, 0.16),
    "soil_wet": (0.16, 0.20),
    "grass": (0.14, 0.30),
    "rock": (0.20, 0.12),
    "sand": (0.04, 0.08),
    "snow": (0.004, 0.002),
}


def uneven_texture(ground: str, rng: np.random.Generator) -> NDArray[np.float32]:
    """(P, P, 3) brightness of a ground without a pattern of its own, periodic, about 1."""
    patches, grains = _UNEVENNESS[ground]
    tone = 1 + patches * _tile_noise(6.0, 0.25, 2.4, rng) + grains * _tile_noise(0.25, 0.032, 0.5, rng)
    return np.repeat(np.clip(tone, 0.2, 2.0).astype(np.float32)[..., None], 3, axis=2)


def build_terrain(
    height: HeightField, rng: np.random.Generator, ground: str = "litter", wetness: Wetness | None = None
) -> Terrain:
    """Ground of a site: `ground` on it and around it, woods and meadows beyond; colours are those of the spectra.

    Parameters
    ----------
    ground : a table of scenes/spectra/ground; leaf litter shows its leaves, the others are uneven.
    wetness : of the site's soil, which darkens it; None: as the spectrum is.
    """
    mesh = terrain_mesh(height)
    x, y = mesh.vertices_m[:, 0].astype(np.float64), mesh.vertices_m[:, 1].astype(np.float64)
    away = height.distance_m(x, y)
    far = smooth_step((away - 30.0) / 120.0)
    spectrum, far_spectrum = _reflectance(f"ground/{ground}"), _reflectance("ground/far")
    if ground == "snow":
        far_spectrum = _mixed(far_spectrum, spectrum, SNOW_AFAR)
    colour, _ = colours_of_surface(spectrum, None)
    wet = None
    if wetness is not None and ground in DARKENED:
        wet = wet_ground(spectrum, wetness.at(x, y, smooth_step(away / _MARGIN_M)))
    return Terrain(
        mesh=mesh,
        texture=_texture(ground, colour, rng),
        far_share=far.astype(np.float32),
        far_reflectance=colours_of_surface(far_spectrum, None)[0],
        spectrum=spectrum,
        far_spectrum=far_spectrum,
        wet=wet,
    )


_Kept = tuple[NDArray[np.float32], Mapping[str, Any]]  # a texture, and the generator's state after it
_kept: BoundedCache[_Kept] = BoundedCache(_TEXTURE_PX**2 * 12, lambda kept: kept[0].nbytes)  # one


def _texture(ground: str, colour: tuple[float, float, float], rng: np.random.Generator) -> NDArray[np.float32]:
    """(P, P, 3) reflectance of mean `colour`. The last one is kept, for an image that is made again."""

    def make() -> _Kept:
        pattern = litter_texture(rng) if ground == "litter" else uneven_texture(ground, rng)
        return with_mean(pattern, colour), rng.bit_generator.state

    key = (ground, colour, repr(rng.bit_generator.state))
    texture, rng.bit_generator.state = _kept.get(key, make)
    return texture


def _reflectance(name: str) -> Spectrum:
    return load_spectra(name)["reflectance"]


def _mixed(one: Spectrum, other: Spectrum, share: float) -> Spectrum:
    """A spectrum with a share of another in it."""
    grid = np.union1d(one.wavelength_nm, other.wavelength_nm)
    return Spectrum(grid, (1 - share) * one.at(grid) + share * other.at(grid))
