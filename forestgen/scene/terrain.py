"""The ground: its height everywhere, a mesh dense on the site and coarse to the horizon, and its colour.

Heights are a function, so any point can be asked, at any resolution, with the same answer; the mesh and the plants'
feet both ask the same function. Kinds of terrain are parts (scene/terrains), and so are grounds (scene/grounds).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.cache import BoundedCache
from forestgen.geometry.mesh import Mesh
from forestgen.plants.bark.texture import with_mean
from forestgen.recipe.registries import GROUND_COVERS
from forestgen.scene.colour import colours_of_surface
from forestgen.scene.grounds.cover import TEXTURE_PX, TEXTURE_TILE_M, GroundCover
from forestgen.scene.soil_colour import Wetness, wet_ground
from forestgen.scene.spec import Terrain

HORIZON_M = 200_000.0  # from 300 m up, a flat earth ends 0.1 degrees below the horizon
MARGIN_M = 20.0
_SITE_CELL_M = 0.75
_AT_ONCE = 8192  # points whose height is asked for: their numbers stay in the processor's cache


@dataclass(frozen=True, eq=False)  # arrays have no equality of one word: a field equals itself
class HeightField:
    """Height of the ground at any place, on the site and up to the horizon: z = 0, unless a class based on it says."""

    size_m: tuple[float, float]  # of the site

    def __call__(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Height at points of any shape."""
        x, y = np.broadcast_arrays(x_m, y_m)
        shape, x, y = x.shape, x.ravel(), y.ravel()
        z = np.empty(x.shape)
        for start in range(0, len(z), _AT_ONCE):
            part = slice(start, start + _AT_ONCE)
            z[part] = self._height(x[part], y[part])
        return z.reshape(shape)

    def _height(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.zeros(x_m.shape)

    def distance_m(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance from the site's rectangle, 0 inside."""
        dx = np.maximum(np.maximum(-x_m, x_m - self.size_m[0]), 0.0)
        dy = np.maximum(np.maximum(-y_m, y_m - self.size_m[1]), 0.0)
        return np.hypot(dx, dy)


def smooth_step(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """0 below 0, 1 above 1, with a continuous slope."""
    t = np.clip(x, 0.0, 1.0)
    return t * t * (3 - 2 * t)


def _graded_axis(length_m: float) -> NDArray[np.float64]:
    """Coordinates: even cells over the site and a margin, then each cell 8% longer than the last, to the horizon."""
    cells = int(min(np.ceil((length_m + 2 * MARGIN_M) / _SITE_CELL_M), 1200))
    inner = np.linspace(-MARGIN_M, length_m + MARGIN_M, cells + 1)
    step, reach, outer = inner[1] - inner[0], MARGIN_M, []
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


def build_terrain(
    height: HeightField, rng: np.random.Generator, ground: str = "litter", wetness: Wetness | None = None
) -> Terrain:
    """Ground of a site: `ground` on it and around it, woods and meadows beyond; colours are those of the spectra.

    Parameters
    ----------
    ground : name of a ground cover.
    wetness : of the site's soil, which darkens it; None: as the spectrum is.
    """
    mesh = terrain_mesh(height)
    x, y = mesh.vertices_m[:, 0].astype(np.float64), mesh.vertices_m[:, 1].astype(np.float64)
    away = height.distance_m(x, y)
    far = smooth_step((away - 30.0) / 120.0)
    cover: GroundCover = GROUND_COVERS.load(ground)
    spectrum, far_spectrum = cover.reflectance(), cover.far_reflectance()
    colour, _ = colours_of_surface(spectrum, None)
    wet = None
    if wetness is not None and cover.darkens_when_wet:
        wet = wet_ground(spectrum, wetness.at(x, y, smooth_step(away / MARGIN_M)))
    return Terrain(
        mesh=mesh,
        texture=_texture(ground, cover, colour, rng),
        far_share=far.astype(np.float32),
        far_reflectance=colours_of_surface(far_spectrum, None)[0],
        spectrum=spectrum,
        far_spectrum=far_spectrum,
        wet=wet,
    )


_Kept = tuple[NDArray[np.float32], Mapping[str, Any]]  # a texture, and the generator's state after it
_kept: BoundedCache[_Kept] = BoundedCache(TEXTURE_PX**2 * 12, lambda kept: kept[0].nbytes)  # one


def _texture(
    ground: str, cover: GroundCover, colour: tuple[float, float, float], rng: np.random.Generator
) -> NDArray[np.float32]:
    """(P, P, 3) reflectance of mean `colour`. The last one is kept, for an image that is made again."""

    def make() -> _Kept:
        return with_mean(cover.pattern(rng), colour), rng.bit_generator.state

    key = (ground, colour, repr(rng.bit_generator.state))
    texture, rng.bit_generator.state = _kept.get(key, make)
    return texture
