"""What the ground is painted with, where things on it are too small or too far away to be drawn.

The ground of the recipe has a texture; the layers on it (`site.ground.layers`) add their mean reflectance, the first
lowest, so that the ground looks alike where geometry gives way to paint. A layer with `patch_m` lies in patches: the
texture shows them, and where the layer is drawn, its things lie in the same patches. Patches are where a periodic noise
is high; those longer than `LONGEST_PATCH_M` do not fit into the texture, which has the layer's mean then. Bare soil
hides the layers before it, drawn or painted.

Where only some layers are drawn, the ground's colour lies between both, by their optical depth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from forestgen.core.randomness import child_rng
from forestgen.core.spectrum import Spectrum
from forestgen.geometry.mesh import Floats
from forestgen.plants.bark.texture import with_mean
from forestgen.recipe.ground import GroundLayer
from forestgen.scene.colour import colours_of_surface
from forestgen.scene.ground_layers.layer import Layer
from forestgen.scene.ground_view import TILE_M
from forestgen.scene.spec import GroundMixture, GroundPart, GroundPatch, Terrain
from forestgen.scene.surfaces import wet_spectrum
from forestgen.scene.terrain import TEXTURE_TILE_M, tile_noise

LONGEST_PATCH_M = 0.5 * TEXTURE_TILE_M
_SOFT, _SHARP = 0.35, 0.08  # widths of the edges of patches, in standard deviations of the noise
# Around patches of bare soil lie spots of it, and in them spots of what is around: of so many standard deviations.
_SPOTS, _SPOT_SLOPE = 0.5, 2.0  # their spectrum
_SPOT_M, _SPOT_SHARE, _FINEST_SPOT_M = 1.2, 0.3, 0.05  # the longest, at most so much of a patch; the shortest
_FINEST_M = 0.12  # ragged edges have bays of this size
_SLOPE = 3.0  # of the noise: its power goes with the wave number to the power -_SLOPE
_GRAIN, _BARE_GRAIN = 0.25, 0.08  # standard deviation of brightness within patches
_EVERY = 8  # texels from one that counts to the next, where a threshold is sought

Images = NDArray[np.float32]
Patches = Mapping[int, Images]  # by number of a layer in the recipe: share of the texture's texels that it hides


def patches_of(sections: Sequence[GroundLayer], seed: int) -> dict[int, Images]:
    """Where the layers lie that lie in patches."""
    found = {}
    for index, keys in enumerate(sections):
        if keys.patch_m is not None and keys.patch_m <= LONGEST_PATCH_M:
            rng = child_rng(seed, "ground", "patches", index)
            found[index] = patches(keys.cover, keys.patch_m, keys.has_things, rng)
    return found


def patches(cover: float, patch_m: float, has_things: bool, rng: np.random.Generator) -> Images:
    """(P, P) share of each texel that patches of a size hide, of a mean; row 0 is the texture's southern edge.

    `has_things`: their edges are even; those of bare soil are in spots.
    """
    longest_m, edge = min(4.0 * patch_m, TEXTURE_TILE_M), _SOFT if has_things else _SHARP
    noise = tile_noise(longest_m, min(_FINEST_M, 0.5 * patch_m), _SLOPE, rng).astype(np.float32)
    if not has_things:
        spot_m = min(_SPOT_M, _SPOT_SHARE * patch_m)
        spots = tile_noise(spot_m, min(_FINEST_SPOT_M, 0.5 * spot_m), _SPOT_SLOPE, rng).astype(np.float32)
        noise = np.asarray((noise + _SPOTS * spots) / np.hypot(1.0, _SPOTS), dtype=np.float32)
    some = noise[::_EVERY, ::_EVERY].astype(np.float64)
    low, high = -8.0, 8.0
    for _ in range(40):
        threshold = 0.5 * (low + high)
        mean = float((1.0 / (1.0 + np.exp((threshold - some) / edge))).mean())
        low, high = (threshold, high) if mean > cover else (low, threshold)
    share = 1.0 / (1.0 + np.exp((np.float32(threshold) - noise) / np.float32(edge)))
    return np.asarray(share, dtype=np.float32)


def relative_cover(sections: Sequence[GroundLayer], found: Patches) -> list[Floats | None]:
    """Of each layer, a factor on its cover by square metre of the texture, (rows, columns); None: even."""
    cells = round(TEXTURE_TILE_M / TILE_M)
    relative: list[Floats | None] = []
    for index, keys in enumerate(sections):
        share = found.get(index)
        if not keys.has_things and share is not None:
            left = _by_cell(1.0 - share, cells)
            relative = [left if one is None else one * left for one in relative]
        relative.append(None if share is None else _by_cell(share, cells) / keys.cover)
    return relative


def _by_cell(share: Images, cells: int) -> Floats:
    side = len(share) // cells
    return np.asarray(share.reshape(cells, side, cells, side).mean(axis=(1, 3), dtype=np.float64))


def painted(
    terrain: Terrain,
    layers: Sequence[Layer],
    tiles: Sequence[NDArray[np.intp]],
    found: Patches | None = None,
    seed: int = 0,
) -> Terrain:
    """The ground with the colours that it has under its layers, the first lowest, but bare where they are drawn.

    `tiles`: (K, 2) columns and rows that have each layer as geometry.
    """
    if terrain.spectrum is None or not layers:
        return terrain
    share = bare_share(terrain.mesh.vertices_m[:, :2].astype(np.float64), layers, tiles)
    covered = _covered(terrain, layers, found or {}, seed)
    wet = terrain.wet
    if wet is not None:
        assert covered.spectrum is not None
        film = wet_spectrum(covered.spectrum)
        wet = replace(wet, reflectance=colours_of_surface(film, None)[0], spectrum=film)
    under = None
    if share.any():
        own = _covered(terrain, [one for one in layers if not one.things], found or {}, seed)
        assert own.spectrum is not None
        under = GroundPatch(share.astype(np.float32), own.texture, own.mean_colour, own.spectrum, own.mixture)
    return replace(covered, wet=wet, bare=under)


def _covered(terrain: Terrain, layers: Sequence[Layer], found: Patches, seed: int) -> Terrain:
    """The ground under layers that are all painted."""
    assert terrain.spectrum is not None
    parts: list[tuple[Images | float, Spectrum]] = [
        (1.0, terrain.spectrum)
    ]  # share and reflectance; the ground's first
    grains = [0.0]
    for number, group in groupby(layers, key=lambda layer: int(layer.name.split("/")[0])):
        mixed_up = list(group)  # things of one layer of the recipe lie among each other
        depth = np.array([-np.log1p(-one.cover) for one in mixed_up])
        grid = np.unique(np.concatenate([one.spectrum.wavelength_nm for one in mixed_up]))
        own = np.average([one.spectrum.at(grid) for one in mixed_up], axis=0, weights=depth)
        cover = found.get(number, 1.0 - float(np.exp(-depth.sum())))
        parts = [(share * (1.0 - cover), spectrum) for share, spectrum in parts]
        parts.append((cover, Spectrum(grid, own)))
        grains.append(_GRAIN if mixed_up[0].things else _BARE_GRAIN)
    grid = np.unique(np.concatenate([spectrum.wavelength_nm for _, spectrum in parts]))
    mean = Spectrum(grid, np.sum([float(np.mean(share)) * one.at(grid) for share, one in parts], axis=0))
    if not any(isinstance(share, np.ndarray) for share, _ in parts):
        return replace(terrain, texture=with_mean(terrain.texture, colours_of_surface(mean, None)[0]), spectrum=mean)
    mixture = _mixture(terrain, parts, grains, child_rng(seed, "ground", "grain"))
    return replace(terrain, texture=mixture.image(), spectrum=mean, mixture=mixture)


def _mixture(
    terrain: Terrain,
    parts: Sequence[tuple[Images | float, Spectrum]],
    grains: Sequence[float],
    rng: np.random.Generator,
) -> GroundMixture:
    shape = terrain.texture.shape[:2]
    grain = tile_noise(0.5, 0.032, 0.6, rng).astype(np.float32)
    own = np.broadcast_to(np.asarray(parts[0][0], dtype=np.float32), shape)
    base = own[..., None] * terrain.texture
    colour = terrain.mean_colour
    base *= np.float32(float(own.mean())) * np.array(colour, np.float32) / np.maximum(base.mean(axis=(0, 1)), 1e-9)
    found = []
    for (share, spectrum), deviation in zip(parts[1:], grains[1:], strict=True):
        amount = share * np.clip(1.0 + deviation * grain, 0.2, 2.0)
        amount *= np.float32(np.mean(share) / max(float(amount.mean()), 1e-9))
        found.append(GroundPart(amount.astype(np.float32), colours_of_surface(spectrum, None)[0], spectrum))
    assert terrain.spectrum is not None
    return GroundMixture(base.astype(np.float32), colour, terrain.spectrum, tuple(found))


def bare_share(places: Floats, layers: Sequence[Layer], tiles: Sequence[NDArray[np.intp]]) -> Floats:
    """(V,) share of the layers' optical depth that is drawn around (V, 2) places."""
    depth = np.array([-np.log1p(-one.cover) if one.things else 0.0 for one in layers])
    share = np.zeros(len(places))
    for own, at in zip(depth / max(depth.sum(), 1e-12), tiles, strict=True):
        if not len(at):
            continue
        low, high = at.min(axis=0), at.max(axis=0)
        drawn = np.zeros(high - low + 3, dtype=bool)  # with an empty edge
        drawn[tuple((at - low + 1).T)] = True
        for way in ((-1, -1), (-1, 1), (1, -1), (1, 1)):  # a place at a tile's corner counts all four
            tile_at = np.floor(places / TILE_M + 0.25 * np.array(way)).astype(np.intp) - low + 1
            share += 0.25 * own * drawn[tuple(np.clip(tile_at, 0, np.array(drawn.shape) - 1).T)]
    return share
