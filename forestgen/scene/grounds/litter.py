"""A forest floor: fallen leaves on dark humus, moss in patches.

In autumn, leaves that fell lately lie among the brown ones in their own colours: `site.date`, or `plants.season`.

Example
-------
    site: {ground: litter}
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.core.compiled import compiled
from forestgen.core.spectrum import Spectrum
from forestgen.scene.colour import colours_of_surface
from forestgen.scene.surfaces import FreshLitter
from forestgen.scene.terrain import TEXTURE_PX, TEXTURE_TILE_M, GroundCover, tile_noise

_LEAVES_PER_M2 = 260
_DRY_LEAVES = np.array(  # linear Rec. 709: russet, tan, straw, grey-brown, dark and half-rotten
    [[0.135, 0.078, 0.038], [0.190, 0.125, 0.062], [0.255, 0.190, 0.100], [0.150, 0.118, 0.082], [0.060, 0.042, 0.028]]
)
_HUMUS = np.array([0.040, 0.030, 0.021])
_MOSS = np.array([0.046, 0.066, 0.019])


def _scattered_leaves(rng: np.random.Generator) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """(P, P) index of the uppermost leaf or -1; each leaf's colour (L, 3); (P, P) shade of a leaf's folded halves."""
    leaves = int(_LEAVES_PER_M2 * TEXTURE_TILE_M**2)
    cell = TEXTURE_TILE_M / TEXTURE_PX
    centre = rng.random((leaves, 2)) * TEXTURE_PX
    angle = rng.random(leaves) * 2 * np.pi
    half_length = (0.018 + 0.026 * rng.random(leaves)) / cell
    half_width = half_length * (0.45 + 0.35 * rng.random(leaves))
    upper = np.full((TEXTURE_PX, TEXTURE_PX), -1, dtype=np.int64)
    side = np.zeros((TEXTURE_PX, TEXTURE_PX), dtype=np.int8)
    _lay_leaves(centre, np.cos(angle), np.sin(angle), half_length, half_width, upper, side)
    kind = rng.choice(len(_DRY_LEAVES), leaves, p=[0.30, 0.26, 0.10, 0.20, 0.14])
    colour = _DRY_LEAVES[kind] * (0.75 + 0.5 * rng.random((leaves, 1)))
    return upper, colour, 1 + 0.16 * side.astype(np.float64)


@compiled
def _lay_leaves(centre, cos, sin, half_length, half_width, upper, side):  # type: ignore[no-untyped-def]
    """Lay leaves one upon another, periodically: each pixel keeps the last one's index, and which half of it it sees.

    `centre`: (L, 2) column and row, pixels; cos, sin : (L,) of the direction of a leaf's axis. `half_length`,
    `half_width`: (L,) pixels. `upper`, `side`: (P, P) written: index of the uppermost leaf, and 1 or -1 left and right
    of its axis.
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


class Litter(GroundCover):
    """Fallen leaves and moss."""

    def __init__(self, table: str, *, darkens_when_wet: bool, fresh: FreshLitter | None = None) -> None:
        super().__init__(table, darkens_when_wet=darkens_when_wet)
        self._fresh = fresh

    def under(self, fresh: FreshLitter) -> Litter:
        return Litter(self.table, darkens_when_wet=self.darkens_when_wet, fresh=fresh)

    def reflectance(self) -> Spectrum:
        old = super().reflectance()
        return old if self._fresh is None else self._fresh.on(old)

    def pattern(self, rng: np.random.Generator) -> NDArray[np.float32]:
        upper, leaf_colour, shade = _scattered_leaves(rng)
        patches = tile_noise(9.0, 0.25, 2.6, rng)
        grain = tile_noise(0.25, 0.032, 0.5, rng)
        if self._fresh is not None:  # drawn last, as many for any cover: the rest is the same on all days
            new = rng.random(len(leaf_colour)) < self._fresh.cover
            bright = 0.6 + 0.8 * rng.random((len(leaf_colour), 1))
            leaf_colour[new] = bright[new] * colours_of_surface(self._fresh.spectrum, None)[0]
        cover = 1 / (1 + np.exp(-(patches - 0.55) / 0.22))
        texture = np.empty((*upper.shape, 3), dtype=np.float32)
        _grow_moss(upper, leaf_colour, shade, patches, grain, cover, texture)
        return texture


COVER = Litter("litter", darkens_when_wet=True)
