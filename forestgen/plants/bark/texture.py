"""Bark as a texture: colour and relief of one tile that repeats round a stem and along it.

A material's ``reflectance`` stays what it is: the mean of the texture. The pattern, its colours and its marks only
share it out. `marks` are lenticels of smooth and papery bark, fresh scales of scaly and plated bark, checks or cracks
of others.

Recipe::

    materials:
      bark:
        reflectance: [0.33, 0.34, 0.26]
        bark: {pattern: smooth, tile_m: [0.4, 0.8], marks: 0.05, dark: [0.06, 0.055, 0.04]}

Blocks that read as these trees from 1 to 3 m; before the colon stands the material's reflectance::

    oak, 0.130 0.112 0.088: {pattern: furrowed, dark: [0.035, 0.028, 0.02], light: [0.24, 0.21, 0.17], lichen: 0.05}
    maple, 0.16 0.15 0.13: {pattern: furrowed, scale_m: 0.03, depth_m: 0.008, dark: [0.06, 0.055, 0.045]}
    pine, 0.19 0.12 0.08: {pattern: plated, dark: [0.042, 0.026, 0.018], light: [0.34, 0.26, 0.21],
                           mark_colour: [0.22, 0.115, 0.075]}
    spruce, 0.125 0.105 0.085: {pattern: scaly, dark: [0.05, 0.035, 0.025], light: [0.25, 0.20, 0.17], marks: 0.5,
                                mark_colour: [0.14, 0.07, 0.045]}
    beech, 0.26 0.26 0.235: {pattern: smooth, tile_m: [1, 1.6], dark: [0.06, 0.06, 0.055], light: [0.36, 0.36, 0.33],
                              lichen: 0.13, lichen_colour: [0.46, 0.48, 0.42]}
    birch, 0.58 0.56 0.51: {pattern: papery, tile_m: [0.7, 1.2], dark: [0.30, 0.22, 0.16], light: [0.75, 0.73, 0.68],
                            mark_colour: [0.03, 0.027, 0.025]}
    palm, 0.22 0.19 0.15: {pattern: ringed, tile_m: [0.6, 0.72]}
    bare wood, 0.24 0.225 0.20: {pattern: fibrous, dark: [0.05, 0.045, 0.04]}
    sawn wood, 0.38 0.27 0.16: {pattern: end_grain, tile_m: [0.4, 0.4], dark: [0.10, 0.06, 0.03]}

Noise is made in the frequency domain and cells wrap, so tiles join without a seam. The same material has the same
texture in every image: its random numbers come from its name alone.

The relief is shown by a normal map, which neither moves the surface nor casts shadows; slopes are therefore held below
about 50 degrees.

Another bark by height, and what grows on it: plants/stem_surface.py. Not modelled: ridges as wide as the stem is thick.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from forestgen.core.randomness import child_rng
from forestgen.geometry.export import srgb
from forestgen.plants.bark.patterns import PATTERNS, Image, Relief, Tile, upper_share
from forestgen.plants.parameters import PlantParameters
from forestgen.recipe.species import Bark, Material
from forestgen.recipe.wood import BarkZone, DeadBranches

Colour = tuple[float, float, float]

_TEXEL_M = 0.0015
_LEAST_TEXELS, _MOST_TEXELS = 64, 640
_COVER_M, _COVER_EDGE = 0.003, 0.25  # thickness of what grows on bark; half the width of its edges, of the noise
_STEEPEST = 1.2  # slope of the normal map: without shadows, steeper walls look wrong


@dataclass(frozen=True, eq=False)
class SurfaceTexture:
    """Colour and relief of one tile; row 0 is v = 0, the tile's foot, and column 0 is u = 0."""

    colour: NDArray[np.float32]  # (H, W, 3) linear Rec. 709 reflectance in [0, 1]
    height_m: NDArray[np.float32]  # (H, W) metres above the deepest crack
    tile_m: tuple[float, float]  # width along u and height along v of the tile, metres

    def normals(self) -> NDArray[np.float32]:
        """(H, W, 3) unit normals, x along u, y along v, z out of the surface; slopes stay below about 50 degrees."""
        rows, columns = self.height_m.shape
        slopes = []
        for axis, size_m in ((1, self.tile_m[0] / columns), (0, self.tile_m[1] / rows)):
            rise = np.roll(self.height_m, -1, axis) - np.roll(self.height_m, 1, axis)
            slopes.append(rise / np.float32(2 * size_m))
        steep = np.hypot(slopes[0], slopes[1])
        gentle = 1.0 / np.sqrt(1.0 + (steep / _STEEPEST) ** 2)
        normal = np.stack([-slopes[0] * gentle, -slopes[1] * gentle, np.ones_like(steep)], axis=-1)
        return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True), dtype=np.float32)


@lru_cache(maxsize=32)  # at most 6.6 MB each
def bark_texture(bark: Bark, reflectance: Colour, name: str) -> SurfaceTexture:
    """Texture of a material, made once.

    `bark`: the material's `bark` block; must be hashable. `reflectance`: mean of the texture, linear Rec. 709. `name`:
    of the material, such as "poplar/bark"; the texture's random numbers come from it.
    """
    pattern = PATTERNS[bark.pattern]
    tile = Tile(_texels(bark.tile_m[1]), _texels(bark.tile_m[0]), bark.tile_m)
    form, lichen = child_rng(0, "bark", name, bark.pattern).spawn(2)
    scale_m = pattern.scale_m if bark.scale_m is None else bark.scale_m
    # Features below four texels would be noise, and above the tile's size there is nothing to repeat.
    scale_m = min(max(scale_m, 4 * tile.size_m[0] / tile.columns), 0.5 * min(bark.tile_m))
    relief = pattern.make(tile, form, scale_m, pattern.marks if bark.marks is None else bark.marks)
    colour = _coloured(relief, bark, reflectance)
    if bark.lichen > 0:
        spread = tile.noise(lichen, (0.09, 0.07), 1.9) + 0.8 * relief.tone
        pale = np.array(bark.lichen_colour, dtype=np.float32)
        colour += upper_share(spread, bark.lichen, 0.15)[..., None] * (pale - colour) * np.float32(0.85)
    height = relief.height - relief.height.min()
    depth_m = pattern.depth_m if bark.depth_m is None else bark.depth_m
    height *= np.float32(depth_m / max(float(height.max()), 1e-9))
    return SurfaceTexture(with_mean(colour, reflectance), height.astype(np.float32), bark.tile_m)


@lru_cache(maxsize=32)
def covered_texture(
    bark: Bark,
    reflectance: Colour,
    name: str,
    cover: Colour,
    share: float,
    mean: Colour,
    own: SurfaceTexture | None = None,
) -> SurfaceTexture:
    """The texture of a bark, see `bark_texture`, a share of which something grows on, such as moss.

    `cover`: colour of what grows there. `mean`: of all. `own`: the cover's texture, if it has one; its tile is
    repeated a whole number of times, at least once, so it is stretched to fit. What a share covers a greater one covers
    too.
    """
    base = bark_texture(bark, reflectance, name)
    place, tone = _cover_noise(bark, reflectance, name)
    mask = upper_share(place, share, _COVER_EDGE)
    if own is None:
        over, top_m = np.array(cover, dtype=np.float32) * tone[..., None], base.height_m + _COVER_M * (0.7 + 0.3 * tone)
    else:
        times = [max(1, round(long / other)) for long, other in zip(base.tile_m, own.tile_m, strict=True)][::-1]
        sides = zip(base.height_m.shape, own.height_m.shape, times, strict=True)
        at = np.ix_(*(np.arange(n) * most * k // n % most for n, most, k in sides))
        over, top_m = own.colour[at], own.height_m[at]
    colour = base.colour + mask[..., None] * (over - base.colour)
    height_m = base.height_m + mask * (top_m - base.height_m)
    return SurfaceTexture(with_mean(np.maximum(colour, 0.0), mean), height_m.astype(np.float32), base.tile_m)


@lru_cache(maxsize=4)
def _cover_noise(bark: Bark, reflectance: Colour, name: str) -> tuple[Image, Image]:
    """Where things grow on a bark first, and the tone of what grows."""
    base = bark_texture(bark, reflectance, name)
    rows, columns = base.height_m.shape
    tile = Tile(rows, columns, base.tile_m)
    spread, fine = child_rng(0, "cover", name).spawn(2)
    place = tile.noise(spread, (0.09, 0.12), 1.45) + 0.1 * (base.height_m.mean() - base.height_m) / _COVER_M
    tone = np.clip(1.0 + 0.3 * tile.noise(fine, (0.01, 0.01), 1.2), 0.3, 1.7)
    return np.asarray(place, dtype=np.float32), np.asarray(tone, dtype=np.float32)


def _texels(length_m: float) -> int:
    return int(np.clip(round(length_m / _TEXEL_M / 16) * 16, _LEAST_TEXELS, _MOST_TEXELS))


def _coloured(relief: Relief, bark: Bark, reflectance: Colour) -> Image:
    """(H, W, 3) colours by tone and marks, whose mean is not yet the material's."""
    mean = np.array(reflectance, dtype=np.float32)
    dark = 0.25 * mean if bark.dark is None else np.array(bark.dark, dtype=np.float32)
    light = 1.3 * mean if bark.light is None else np.array(bark.light, dtype=np.float32)
    tone = np.clip(relief.tone, 0.0, 1.15)[..., None].astype(np.float32)
    colour = dark + tone * (light - dark)
    if relief.marks is not None:
        marks = dark if bark.mark_colour is None else np.array(bark.mark_colour, dtype=np.float32)
        colour += relief.marks[..., None] * (marks - colour)
    return np.asarray(np.maximum(colour, 0.0), dtype=np.float32)


def with_mean(colour: Image, mean: Colour) -> Image:
    """The colours scaled, channel by channel, so that their mean is `mean` and none is above 1."""
    out = np.empty_like(colour)
    for channel, target in enumerate(mean):
        plane = colour[..., channel].astype(np.float64)
        if not plane.max() > 0:
            plane = np.ones_like(plane)
        for _ in range(100):
            plane *= target / plane.mean()
            if plane.max() <= 1.0:
                break
            plane = np.minimum(plane, 1.0)
        else:
            plane = np.full_like(plane, target)  # so light a mean leaves no room for a pattern
        out[..., channel] = plane
    return out


P = TypeVar("P", BarkZone, DeadBranches)


def with_bark_tiles(parameters: PlantParameters, materials: Mapping[str, Material]) -> PlantParameters:
    """The plant's parameters with the tiles of its wood's materials, which its meshes' uv count in."""
    wood = parameters.wood
    tiles: dict[str, object] = {}
    for field, name in (("bark_tile_m", wood.material), ("branch_tile_m", wood.branch_material or wood.material)):
        bark = materials[name].bark if name in materials else None
        if bark is not None:
            tiles[field] = bark.tile_m
    if wood.years is not None:
        dead = wood.years.dead_branches
        zones = tuple(_with_tile(zone, materials) for zone in wood.years.bark_zones)
        own = {"bark_zones": zones, "dead_branches": dead and _with_tile(dead, materials)}
        tiles["years"] = wood.years.model_copy(update=own)
    return parameters.model_copy(update={"wood": wood.model_copy(update=tiles)}) if tiles else parameters


def _with_tile(part: P, materials: Mapping[str, Material]) -> P:
    """A part of a tree's wood with its material's tile."""
    bark = materials[part.material].bark
    return part if bark is None else part.model_copy(update={"tile_m": bark.tile_m})


def texture_images(texture: SurfaceTexture) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Colour as sRGB and normal map, both (H, W, 3) uint8, for mesh files.

    Row 0 is v = 0, the tile's foot; the normals' red, green and blue are (n + 1) / 2 along u, along v and outwards.
    """
    normal = np.round(255 * np.clip(0.5 + 0.5 * texture.normals(), 0.0, 1.0)).astype(np.uint8)
    return srgb(texture.colour), normal
