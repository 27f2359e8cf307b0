"""The ground: its height everywhere, a mesh dense on the site and coarse to the horizon, and its colour.

Heights are a function, so any point can be asked, at any resolution, with the same answer; the mesh and the plants'
feet both ask the same function. Kinds of terrain are parts (scene/terrains), and so are grounds (scene/grounds).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from forestgen.core.cache import BoundedCache
from forestgen.core.spectrum import Spectrum
from forestgen.geometry.mesh import Mesh, vertex_normals
from forestgen.plants.bark.texture import with_mean
from forestgen.recipe.registries import GROUND_COVERS
from forestgen.recipe.schema import Terrain as TerrainSection
from forestgen.recipe.sources import Keys
from forestgen.recipe.spectra import load_spectra
from forestgen.scene.colour import colours_of_surface
from forestgen.scene.fine_cells import cut_grid
from forestgen.scene.spec import Terrain
from forestgen.scene.surfaces import FreshLitter, Wetness, wet_ground

HORIZON_M = 200_000.0  # from 300 m up, a flat earth ends 0.1 degrees below the horizon
MARGIN_M = 20.0
SITE_CELL_M = 0.75
TEXTURE_TILE_M, TEXTURE_PX = 24.0, 1536  # side of the square of the ground's texture that repeats
FINE_M = 0.1  # cells of the mesh along paths and shores, about
_AT_ONCE = 8192  # points whose height is asked for: their numbers stay in the processor's cache

KeysT = TypeVar("KeysT", bound=TerrainSection)


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

    @property
    def cell_m(self) -> float:
        """Length of the mesh's cells on the site."""
        return SITE_CELL_M

    @property
    def coarsest_m(self) -> tuple[float, float]:
        """Length of the mesh's longest cells, and how far from the site no cell is longer."""
        return math.inf, 0.0

    @property
    def axes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """x of the columns and y of the rows of the mesh's vertices, but for those of fine cells."""
        return _graded_axis(self.size_m[0], self), _graded_axis(self.size_m[1], self)

    @cached_property
    def grid(self) -> NDArray[np.float64]:
        """(rows, columns) height of these vertices."""
        return self(*np.meshgrid(*self.axes))

    def on_mesh(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Height of the mesh at points of any shape, but for its fine cells: the ground's at vertices alone."""
        (xs, ys), z = self.axes, self.grid
        i, j = np.searchsorted(xs, x_m, side="right") - 1, np.searchsorted(ys, y_m, side="right") - 1
        east, north = (x_m - xs[i]) / (xs[i + 1] - xs[i]), (y_m - ys[j]) / (ys[j + 1] - ys[j])
        across, along = np.maximum(east, north), np.minimum(east, north)
        corner = np.where(east >= north, z[j, i + 1], z[j + 1, i])  # of the triangle
        return np.asarray((1.0 - across) * z[j, i] + (across - along) * corner + along * z[j + 1, i + 1])

    @property
    def fine_m2(self) -> float:
        """About the area of the mesh's fine cells."""
        return 0.0

    def level(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Height of water at points (N,); -inf where there is none. It stands where it is above the ground."""
        return np.full(len(x_m), -np.inf)

    def surface(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Height of the ground or of the water above it at points (N,)."""
        return self(x_m, y_m)

    def barred(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(N,) where no plant can stand: in water, on paths."""
        return np.zeros(len(x_m), dtype=np.bool_)

    def open_share(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N,) share of the ground that its layers may lie on."""
        return np.ones(len(x_m))

    def roadside(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N,) share of the ground that is a road's middle strip or lies beside a road."""
        return np.zeros(len(x_m))

    def trodden(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N,) share of the ground that is bare on paths."""
        return np.zeros(len(x_m))

    def shore(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N,) share of the ground that is shallow water or lies beside water."""
        return np.zeros(len(x_m))

    def under_water(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N,) 1 where water stands, else 0."""
        return np.asarray(self.level(x_m, y_m) > self(x_m, y_m), dtype=np.float64)

    def fine(
        self, x_m: NDArray[np.float64], y_m: NDArray[np.float64], cell_m: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """(N,) whether the mesh's cells about points, so long, are to be cut into pieces of `FINE_M`."""
        return np.zeros(len(x_m), dtype=np.bool_)

    def distance_m(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance from the site's rectangle, 0 inside."""
        dx = np.maximum(np.maximum(-x_m, x_m - self.size_m[0]), 0.0)
        dy = np.maximum(np.maximum(-y_m, y_m - self.size_m[1]), 0.0)
        return np.hypot(dx, dy)


class TerrainShape(Generic[KeysT]):
    """A kind of terrain."""

    Parameters: type[KeysT]  # keys of `site.terrain`; equal keys are equal ground
    file_keys: Keys = ()  # below `site.terrain`, of what an `AssetError` is about

    def is_level(self, keys: KeysT) -> bool:
        """Whether the ground is z = 0 everywhere, so that a community need not ask for its height."""
        return False

    def height(self, keys: KeysT, size_m: tuple[float, float], image_seed: int, folder: Path) -> HeightField:
        """Height of the ground everywhere.

        Parameters
        ----------
        size_m : of the site.
        image_seed : root of the image's randomness.
        folder : of the recipe, that files are relative to.

        Raises
        ------
        AssetError : a file that cannot be read, or is not of this site; without its place.
        """
        raise NotImplementedError


class GroundCover:
    """What covers the ground of a site; `site.ground` names it.

    Parameters
    ----------
    table : of `reflectance`, in scenes/spectra/ground.
    darkens_when_wet : whether the water that a community has in its soil darkens it.
    """

    def __init__(self, table: str, *, darkens_when_wet: bool = False) -> None:
        self.table, self.darkens_when_wet = table, darkens_when_wet

    def reflectance(self) -> Spectrum:
        """Mean reflectance on the site and around it."""
        return load_spectra(f"ground/{self.table}")["reflectance"]

    def under(self, fresh: FreshLitter) -> GroundCover:
        """The same with leaves on it that fell lately; grounds that are not of litter do not show them."""
        return self

    def far_reflectance(self) -> Spectrum:
        """Mean reflectance of the land up to the horizon: woods and meadows."""
        return load_spectra("ground/far")["reflectance"]

    def pattern(self, rng: np.random.Generator) -> NDArray[np.float32]:
        """(TEXTURE_PX, TEXTURE_PX, 3) linear Rec. 709, periodic; its mean is then made that of the reflectance."""
        raise NotImplementedError


def tile_noise(longest_m: float, shortest_m: float, slope: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """(P, P) periodic noise of unit variance with power ~ k^-slope between two wavelengths."""
    cell = TEXTURE_TILE_M / TEXTURE_PX
    frequency = np.fft.fftfreq(TEXTURE_PX, cell)
    k = np.hypot(frequency[:, None], frequency[None, : TEXTURE_PX // 2 + 1])
    band = (k >= 1 / longest_m) & (k <= 1 / shortest_m)
    amplitude = np.where(band, np.maximum(k, 1e-9) ** (-slope / 2), 0.0)
    field = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((TEXTURE_PX, TEXTURE_PX))) * amplitude)
    return np.asarray((field - field.mean()) / field.std())


def smooth_step(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """0 below 0, 1 above 1, with a continuous slope."""
    t = np.clip(x, 0.0, 1.0)
    return t * t * (3 - 2 * t)


def _graded_axis(length_m: float, height: HeightField) -> NDArray[np.float64]:
    """Coordinates: even cells over the site and a margin, then each cell 8% longer than the last, to the horizon; none
    longer than the `coarsest_m` within its distance.
    """
    longest, within = height.coarsest_m
    cells = int(min(np.ceil((length_m + 2 * MARGIN_M) / height.cell_m), 1200))
    inner = np.linspace(-MARGIN_M, length_m + MARGIN_M, cells + 1)
    step, reach, outer = inner[1] - inner[0], MARGIN_M, []
    while reach < HORIZON_M:
        step = 1.08 * step if reach > within else min(1.08 * step, longest)
        reach += step
        outer.append(reach)
    out = np.asarray(outer)
    return np.concatenate([-out[::-1], inner, length_m + out])


def terrain_mesh(height: HeightField) -> Mesh:
    """Height field as triangles, smooth normals, uv in tiles of `TEXTURE_TILE_M`."""
    if height.fine_m2 > 0.0:
        return _mesh_with_fine_cells(height)
    (xs, ys), z = height.axes, height.grid
    x, y = np.meshgrid(xs, ys)
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


def _mesh_with_fine_cells(height: HeightField) -> Mesh:
    xs, ys = height.axes
    middle = np.meshgrid(*(0.5 * (one[1:] + one[:-1]) for one in (xs, ys)))
    long = np.maximum(*np.meshgrid(np.diff(xs), np.diff(ys)))
    fine = height.fine(middle[0].ravel(), middle[1].ravel(), long.ravel()).reshape(long.shape)
    pieces = 2 * max(1, round(0.5 * height.cell_m / FINE_M))
    places, faces = cut_grid(xs, ys, fine, pieces)
    vertices = np.column_stack([places, height(*places.T)])
    return Mesh(
        vertices_m=vertices.astype(np.float32),
        faces=faces,
        normals=vertex_normals(vertices, faces).astype(np.float32),
        uv=(places / TEXTURE_TILE_M).astype(np.float32),
    )


def build_terrain(
    height: HeightField,
    rng: np.random.Generator,
    ground: str = "litter",
    wetness: Wetness | None = None,
    reach_m: float = 0.0,
    fresh: FreshLitter | None = None,
) -> Terrain:
    """Ground of a site: `ground` on it and around it, woods and meadows beyond; colours are those of the spectra.

    `ground`: name of a ground cover. `wetness`: of the site's soil, which darkens it; None: as the spectrum is.
    `reach_m`: how far from the site's edge the stand goes on. `fresh`: leaves that fell lately.
    """
    mesh = terrain_mesh(height)
    x, y = mesh.vertices_m[:, 0].astype(np.float64), mesh.vertices_m[:, 1].astype(np.float64)
    away = height.distance_m(x, y)
    far = smooth_step((away - reach_m - 30.0) / 120.0)
    cover: GroundCover = GROUND_COVERS.load(ground)
    cover = cover if fresh is None else cover.under(fresh)
    spectrum, far_spectrum = cover.reflectance(), cover.far_reflectance()
    colour, _ = colours_of_surface(spectrum, None)
    wet = None
    if wetness is not None and cover.darkens_when_wet:
        wet = wet_ground(spectrum, wetness.at(x, y, smooth_step(away / MARGIN_M)))
    return Terrain(
        mesh=mesh,
        texture=_texture(ground, cover, colour, 0.0 if fresh is None else fresh.cover, rng),
        far_share=far.astype(np.float32),
        far_reflectance=colours_of_surface(far_spectrum, None)[0],
        spectrum=spectrum,
        far_spectrum=far_spectrum,
        wet=wet,
    )


_Kept = tuple[NDArray[np.float32], Mapping[str, Any]]  # a texture, and the generator's state after it
_kept: BoundedCache[_Kept] = BoundedCache(TEXTURE_PX**2 * 12, lambda kept: kept[0].nbytes)  # one


def _texture(
    ground: str, cover: GroundCover, colour: tuple[float, float, float], fresh: float, rng: np.random.Generator
) -> NDArray[np.float32]:
    """(P, P, 3) reflectance of mean `colour`. The last one is kept, for an image that is made again.

    `fresh`: share of the ground that leaves hide that fell lately.
    """

    def make() -> _Kept:
        return with_mean(cover.pattern(rng), colour), rng.bit_generator.state

    key = (ground, colour, fresh, repr(rng.bit_generator.state))
    texture, rng.bit_generator.state = _kept.get(key, make)
    return texture
