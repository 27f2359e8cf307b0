"""The ground: its height everywhere, a mesh dense on the site and coarse to the horizon, and its colour.

Heights are a finite sum of waves with random directions, so any point can be asked, at any resolution, with the same
answer; the mesh and the plants' feet both ask the same function.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Mesh
from forestgen.scene.spec import Terrain

HORIZON_M = 12_000.0
_SITE_CELL_M = 0.75
TEXTURE_TILE_M = 48.0
_TEXTURE_PX = 1024


@dataclass(frozen=True)
class HeightField:
    """z(x, y) = sum of amplitude * sin(k . x + phase), in metres."""

    wave_per_m: NDArray[np.float64]  # (M, 2) angular wave vectors
    amplitude_m: NDArray[np.float64]  # (M,)
    phase: NDArray[np.float64]  # (M,)

    def __call__(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Height at points of any shape; O(points x waves)."""
        z = np.zeros(np.broadcast(x_m, y_m).shape)
        for (kx, ky), amplitude, phase in zip(self.wave_per_m, self.amplitude_m, self.phase, strict=True):
            z += amplitude * np.sin(kx * x_m + ky * y_m + phase)
        return z


def rolling(amplitude_m: float, wavelength_m: float, rng: np.random.Generator) -> HeightField:
    """Gently rolling ground: standard deviation `amplitude_m`, wavelengths from `wavelength_m` down to 1/8 of it."""
    waves = 24
    wavelength = wavelength_m * 0.5 ** (3.0 * rng.random(waves))
    angle = rng.random(waves) * 2 * np.pi
    k = 2 * np.pi / wavelength
    weight = wavelength**1.2  # long waves carry most of the height, as eroded land does
    amplitude = amplitude_m * np.sqrt(2.0) * weight / np.sqrt(np.sum(weight**2))
    return HeightField(
        np.stack([k * np.cos(angle), k * np.sin(angle)], axis=1), amplitude, rng.random(waves) * 2 * np.pi
    )


def flat() -> HeightField:
    """z = 0."""
    return HeightField(np.zeros((0, 2)), np.zeros(0), np.zeros(0))


def _graded_axis(length_m: float) -> NDArray[np.float64]:
    """Coordinates: even cells over the site and a margin, then each cell 12% longer than the last, to the horizon."""
    margin = 20.0
    cells = int(min(np.ceil((length_m + 2 * margin) / _SITE_CELL_M), 1200))
    inner = np.linspace(-margin, length_m + margin, cells + 1)
    step, reach, outer = inner[1] - inner[0], margin, []
    while reach < HORIZON_M:
        step *= 1.12
        reach += step
        outer.append(reach)
    out = np.asarray(outer)
    return np.concatenate([-out[::-1], inner, length_m + out])


def terrain_mesh(height: HeightField, size_m: tuple[float, float]) -> Mesh:
    """Height field as triangles, smooth normals, uv in tiles of `TEXTURE_TILE_M`."""
    xs, ys = _graded_axis(size_m[0]), _graded_axis(size_m[1])
    x, y = np.meshgrid(xs, ys)
    z = height(x, y)
    step = 0.1
    slope_x = (height(x + step, y) - height(x - step, y)) / (2 * step)
    slope_y = (height(x, y + step) - height(x, y - step)) / (2 * step)
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


def litter_texture(rng: np.random.Generator) -> NDArray[np.float32]:
    """(P, P, 3) reflectance of a forest floor: leaf litter with moss, dark humus and straw, in patches and flecks."""
    patches = _tile_noise(16.0, 1.0, 3.0, rng)
    flecks = _tile_noise(0.6, 0.1, 1.0, rng)
    straw = _tile_noise(3.0, 0.1, 1.6, rng)
    litter, humus = np.array([0.118, 0.080, 0.046]), np.array([0.048, 0.036, 0.025])
    moss, dry = np.array([0.060, 0.088, 0.024]), np.array([0.200, 0.158, 0.088])

    def share(field: NDArray[np.float64], middle: float, width: float) -> NDArray[np.float64]:
        return np.asarray(1 / (1 + np.exp(-(field - middle) / width)))[..., None]

    colour = litter + share(-flecks, 0.6, 0.35) * (humus - litter)
    colour = colour + share(patches + 0.35 * straw, 0.25, 0.3) * 0.85 * (moss - colour)
    colour = colour + share(flecks + 0.6 * straw, 1.5, 0.3) * (dry - colour)
    return np.clip(colour * (1 + 0.10 * flecks[..., None]), 0.01, 0.6).astype(np.float32)


def build_terrain(height: HeightField, size_m: tuple[float, float], rng: np.random.Generator) -> Terrain:
    """Ground of a site."""
    return Terrain(mesh=terrain_mesh(height, size_m), texture=litter_texture(rng))
