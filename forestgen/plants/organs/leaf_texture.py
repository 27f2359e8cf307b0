"""Textures of leaves near a camera: veins as tone and relief, mottles, and the patches and rims of decay.

A simple or lobed leaf has a midrib with straight side veins, of which a lobed one has one to each lobe; a palmate one
has a main vein to each lobe, with side veins of their own. Between veins the blade bulges up a little, and veins are
grooves of the upper side: from below the same relief stands out. Veins are paler than the blade, as from below and in
dry leaves. The mean over the blade stays the colour of the material. Sizes and tones are ours, after photographs.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from forestgen.core.randomness import child_rng
from forestgen.geometry.mesh import Bools, Floats
from forestgen.geometry.patches import Patch
from forestgen.plants.bark.patterns import Image, Tile, upper_share
from forestgen.plants.bark.texture import Colour, SurfaceTexture
from forestgen.plants.organs.base import OrganForm
from forestgen.plants.organs.leaves import CompoundLeaf, LobedBlade, PalmateBlade, SimpleBlade

_ROWS, _COLUMNS = 112, 80
_PAIRS = 7  # of side veins: five to nine of a beech
_VEIN_DEG = 47.0  # from the vein that bears them
_CURVE = 0.25  # of side veins towards the tip, share of the half-width at the margin
_MIDRIB, _SIDE = 0.016, 0.007  # half-width over the length
_PALE = 0.4, 0.22  # midrib and side veins over the blade
_MOTTLED = 0.1  # standard deviation of the blade's tone
_SOFT = 0.5  # edges of patches, in standard deviations of their noise
_DARK = np.array([0.30, 0.28, 0.30], np.float32)  # decayed tissue over sound one: browner black


class LeafLooks(NamedTuple):
    """How a leaf's surface varies over the blade."""

    relief: float = 0.12  # slope between veins
    mottled: float = _MOTTLED
    decayed: float = 0.0  # share of the blade


def leaf_texture(form: OrganForm, colour: Colour, looks: LeafLooks, name: str) -> SurfaceTexture | None:
    """Texture over the uv of a form's blade, whose mean is a colour; None: a form without such veins.

    `name`: seeds mottles and patches.
    """
    blade = form.leaflet if isinstance(form, CompoundLeaf) else form
    if not isinstance(blade, SimpleBlade | LobedBlade | PalmateBlade):
        return None
    tone, height_m, size_m = _pattern(blade, looks, name)
    return SurfaceTexture(np.minimum(tone * np.array(colour, np.float32), 1.0), height_m, size_m)


@lru_cache(maxsize=32)
def _pattern(
    blade: SimpleBlade | LobedBlade | PalmateBlade, looks: LeafLooks, name: str
) -> tuple[Image, Image, tuple[float, float]]:
    """(H, W, 3) tones of mean 1 on the blade, (H, W) heights, and the size of the blade's box, metres."""
    flat = blade.flat().sheet(2)
    low, half = flat.points[:, :2].min(axis=0), float(np.abs(flat.points[:, 0]).max())
    size_m = 2.0 * half, float(np.ptp(flat.points[:, 1]))
    tile = Tile(_ROWS, _COLUMNS, size_m)
    x, y = np.meshgrid(*(one.ravel().astype(np.float64) for one in tile.places_m()))
    along = y + low[1]
    main_m, side = _veins(blade, np.abs(x - half), along)
    midrib = np.exp(-((main_m / (_MIDRIB * blade.length_m * np.clip(1.1 - along / blade.length_m, 0.3, 1.0))) ** 2))
    narrow = np.exp(-((side.from_vein_m / (_SIDE * blade.length_m)) ** 2))
    rng = child_rng(0, "leaf texture", name)
    mottles = 1.0 + looks.mottled * tile.noise(rng, (0.2 * size_m[0], 0.2 * size_m[1]), 2.0)
    pale = 1.0 + np.maximum(_PALE[0] * midrib, _PALE[1] * narrow)
    patches = upper_share(tile.noise(rng, (0.45 * size_m[0], 0.45 * size_m[1]), 3.0), looks.decayed, _SOFT)
    tone = (np.clip(mottles, 0.3, 1.7) * pale)[..., None] * (1.0 + (_DARK - 1.0) * patches[..., None])
    inside = _covered(flat, x - half, along)
    tone = np.where(inside[..., None], tone / tone[inside].mean(axis=0), 1.0)
    height = looks.relief * side.step_m / np.pi * (np.abs(np.sin(np.pi * side.phase)) - 1.5 * midrib)
    return tone.astype(np.float32), (height - height.min()).astype(np.float32), size_m


class _Side(NamedTuple):
    """Where points are among side veins."""

    phase: Floats  # whole on veins
    from_vein_m: Floats
    step_m: float  # between veins, along the vein that bears them


def _veins(blade: SimpleBlade | LobedBlade | PalmateBlade, across: Floats, along: Floats) -> tuple[Floats, _Side]:
    """Distance from the main vein of points of the right half, metres, and where they are among its side veins."""
    if isinstance(blade, PalmateBlade):
        side = (blade.lobes - 1) // 2
        step = np.radians(blade.spread_deg) / max(side, 1)
        angle, radius = np.arctan2(across, along), np.hypot(across, along)
        off = angle - step * np.clip(np.round(angle / step), 0, side)
        across, along = radius * np.abs(np.sin(off)), radius * np.cos(off)
        step_m = 0.13 * blade.length_m
    else:
        pairs = blade.lobes + 1 if isinstance(blade, LobedBlade) else _PAIRS
        step_m = 0.8 * blade.length_m / pairs
    steep = np.radians(_VEIN_DEG)
    phase = (along - across / np.tan(steep) - _CURVE * 2.0 * across**2 / blade.width_m) / step_m - 0.3
    return across, _Side(phase, np.abs(phase - np.round(phase)) * step_m * np.sin(steep), step_m)


def _covered(flat: Patch, x: Floats, y: Floats) -> Bools:
    """(H, W) whether points are on a flat leaf."""
    a, b, c = flat.points[flat.faces][..., :2].transpose(1, 0, 2)
    found = np.zeros(x.shape, dtype=np.bool_)
    for corners in zip(a, b, c, strict=True):
        sides = [
            (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])
            for p, q in zip(corners, (*corners[1:], corners[0]), strict=True)
        ]
        found |= (np.min(sides, axis=0) >= 0.0) | (np.max(sides, axis=0) <= 0.0)
    return found
