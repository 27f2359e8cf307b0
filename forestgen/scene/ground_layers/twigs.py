"""Dead twigs and small branches on the ground, grey and brown.

Example
-------
    site: {ground: {layers: [{what: twigs, cover: 0.03}, {what: twigs, cover: 0.03, length_m: 0.9, patch_m: 3}]}}
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import Field

from forestgen.core.parts import Part
from forestgen.core.spectrum import Spectrum
from forestgen.geometry.mesh import Floats
from forestgen.geometry.patches import Patch, join, tube
from forestgen.recipe.fields import Number, Positive
from forestgen.recipe.ground import DENSEST, GroundLayer
from forestgen.recipe.spectra import load_spectra
from forestgen.scene.ground_layers.layer import GroundLayerKind, Layer, Request, Spread, Thing, centred, opaque, sheet

_SURFACES = ("bark/log", "wood/snag", "bark/log")
_VARIANTS = 6
_TRAPPED = 0.54  # share of light: benchmarks/ground_cover.py
_THICKNESS = 0.014  # diameter over length
_FORK = 0.7  # chance that a twig has a side branch
_SIDES_PER_M = 4.0  # further side branches, on which a longer one lies
_MOST_SIDES = 6


class TwigsKeys(GroundLayer):
    """Dead twigs."""

    cover: Number = Field(0.03, gt=0, le=DENSEST, description="Share of the ground that they hide, seen from above.")
    length_m: Positive = Field(0.18, ge=0.01, le=3, description="Their median length, metres; thickness goes with it.")


class Twigs(GroundLayerKind[TwigsKeys]):
    """Dead twigs."""

    Parameters = TwigsKeys

    def layers(self, keys: TwigsKeys, request: Request, rng: np.random.Generator) -> Sequence[Layer]:
        spectra = [load_spectra(table)["reflectance"] for table in _SURFACES]
        materials = {f"twigs-{index}": opaque(one) for index, one in enumerate(spectra)}
        things = [
            Thing(
                centred([sheet(Part.LITTER, f"twigs-{index % len(_SURFACES)}", twig(keys.length_m, rng))]),
                keys.length_m,
                closed=True,
            )
            for index in range(_VARIANTS)
        ]
        grid = spectra[0].wavelength_nm
        mean = opaque(Spectrum(grid, np.mean([one.at(grid) for one in spectra], axis=0)))
        spread = Spread(tilt_deg=5.0, depth_m=0.01, size_sigma=0.5)
        return [Layer("twigs", tuple(things), materials, keys.cover, mean, _TRAPPED, spread, keys.patch_m)]


def twig(length_m: float, rng: np.random.Generator) -> Patch:
    """A crooked twig along y, often with a side branch; longer ones are branches, and lie on theirs."""
    radius = 0.5 * _THICKNESS * length_m
    path = _crooked(length_m, np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, radius]), rng)
    pieces = [tube(path, radius * np.linspace(1.0, 0.45, len(path)), 5)]
    further = min(int(_SIDES_PER_M * length_m), _MOST_SIDES)
    low = -0.3 if further else 0.0
    for side in range(int(rng.random() < _FORK) + further):
        turn = rng.choice([-1.0, 1.0]) * np.radians(rng.uniform(30.0, 60.0))
        along = np.array([np.sin(turn), np.cos(turn), rng.uniform(low, low + 0.25 + 0.3 * (further > 0))])
        at = (len(path) // 2 + side) % len(path)
        lies = _crooked(rng.uniform(0.25, 0.5) * length_m, along, path[at], rng)
        pieces.append(tube(lies, 0.6 * radius * np.linspace(1.0, 0.4, len(lies)), 4))
    return join(pieces)


def _crooked(length_m: float, along: Floats, start: Floats, rng: np.random.Generator) -> Floats:
    """(K, 3) points of a line that bends a little at each."""
    points = [start]
    for _ in range(5):
        along = along + rng.normal(0.0, 0.14, 3) * [1.0, 1.0, 0.35]
        along /= np.linalg.norm(along)
        points.append(points[-1] + along * length_m / 5)
    return np.array(points)


LAYER = Twigs()
