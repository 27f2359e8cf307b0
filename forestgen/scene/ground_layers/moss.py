"""Moss: cushions of many small shoots, which join to carpets where they are dense.

A carpet reflects what the table `wood/moss` has, 0.084 at 560 nm and 0.33 at 835 nm: floors of mosses and low plants in
Hyytiälä reflect 0.079 to 0.095 and 0.34 to 0.38 (Forsström et al. 2021, doi:10.17632/2g9nkcdj53.1; Hovi et al. 2024,
doi:10.23729/9a8d90cd-73e2-438d-9230-94e10e61adc9; fertility classes VT, MT, OMT). Shoots are brighter by the light that
they catch from each other.

Example
-------
    site: {ground: {layers: [{what: moss, cover: 0.3, patch_m: 3}]}}
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import Field

from forestgen.core.parts import Part
from forestgen.core.spectrum import Spectrum
from forestgen.geometry.mesh import GOLDEN_RAD
from forestgen.geometry.patches import Patch, copies, join
from forestgen.recipe.fields import Positive
from forestgen.recipe.ground import GroundLayer
from forestgen.recipe.spectra import load_spectra
from forestgen.scene.ground_layers.layer import (
    GroundLayerKind,
    Layer,
    Request,
    Spread,
    Thing,
    opaque,
    scaled,
    shades,
    sheet,
)

_VARIANTS = 4
_TRAPPED = 0.6  # share of light: benchmarks/ground_cover.py
_SHADES = (0.77, 1.0, 1.23)
_SHOOTS = (40, 100, 260)  # by detail
_HEIGHT = 0.35  # of a cushion over its radius


class MossKeys(GroundLayer):
    """Moss."""

    size_m: Positive = Field(0.16, ge=0.02, le=2, description="Median width of a cushion, metres.")


class Moss(GroundLayerKind[MossKeys]):
    """Moss."""

    Parameters = MossKeys
    most_triangles = 800_000

    def layers(self, keys: MossKeys, request: Request, rng: np.random.Generator) -> Sequence[Layer]:
        green = opaque(_of_shoots(load_spectra("wood/moss")["reflectance"]), roughness=0.7)
        detail = request.detail(0.3 * keys.size_m)
        things = [
            Thing(
                (sheet(Part.MOSS, f"moss-{index % len(_SHADES)}", _cushion(0.5 * keys.size_m, _SHOOTS[detail], rng)),),
                keys.size_m,
                is_bushy=True,
            )
            for index in range(_VARIANTS)
        ]
        mean = scaled(green, float(np.mean(_SHADES)))
        spread = Spread(tilt_deg=4.0, size_sigma=0.35)
        materials = shades(green, _SHADES, "moss")
        return [Layer("moss", tuple(things), materials, keys.cover, mean, _TRAPPED, spread, keys.patch_m)]


def _of_shoots(carpet: Spectrum) -> Spectrum:
    """Reflectance of shoots whose carpet has the given one: `Layer.spectrum` solved for it."""
    return Spectrum(carpet.wavelength_nm, carpet.value / (1.0 - _TRAPPED + _TRAPPED * carpet.value))


def _cushion(radius_m: float, shoots: int, rng: np.random.Generator) -> Patch:
    """A low dome with shoots all over it, each a star of three small leaves."""
    ring = np.sqrt((np.arange(shoots) + 0.5) / shoots) * radius_m * rng.uniform(0.85, 1.1, shoots)
    turn = np.arange(shoots) * GOLDEN_RAD + rng.normal(0.0, 0.15, shoots)
    share = np.clip(ring / radius_m, 0.0, 1.0)
    height = _HEIGHT * radius_m * (np.sqrt(np.maximum(1.0 - share**2, 0.0)) + 0.12 * rng.normal(size=shoots))
    foot = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), np.maximum(height, 0.0)])
    leaf_m = 2.4 * radius_m / np.sqrt(shoots)
    leaf = Patch(
        np.array([[-0.28, 0.0, 0.0], [0.28, 0.0, 0.0], [0.0, 1.0, 0.25]]) * leaf_m,
        np.array([[0, 1, 2]]),
        np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 1.0]]),
    )
    pieces = []
    for k in range(3):
        way = turn + 2.0 * np.pi * k / 3 + rng.normal(0.0, 0.4, shoots)
        rise = np.radians(rng.uniform(5.0, 50.0, shoots))
        along = np.column_stack([np.cos(way) * np.cos(rise), np.sin(way) * np.cos(rise), np.sin(rise)])
        across = np.column_stack([np.sin(way), -np.cos(way), np.zeros(shoots)])
        pieces.append(copies(leaf, np.stack([across, along, np.cross(across, along)], axis=-1), foot))
    dome = _dome(radius_m)
    return join([dome, *pieces])


def _dome(radius_m: float) -> Patch:
    """The cushion's body."""
    rings, sides = 3, 8
    share = np.repeat(np.linspace(1.0, 0.0, rings, endpoint=False), sides)
    turn = np.tile(np.arange(sides) * 2.0 * np.pi / sides, rings)
    z = _HEIGHT * radius_m * (np.sqrt(1.0 - share**2) - 0.06)
    points = np.column_stack([share * radius_m * np.cos(turn), share * radius_m * np.sin(turn), z])
    points = np.concatenate([points, [[0.0, 0.0, _HEIGHT * radius_m * 0.94]]])
    here = np.arange(sides)
    after = (here + 1) % sides
    faces = []
    for row in range(rings - 1):
        low, high = row * sides, (row + 1) * sides
        faces += [
            np.stack([low + here, low + after, high + after], 1),
            np.stack([low + here, high + after, high + here], 1),
        ]
    top = np.full(sides, len(points) - 1)
    faces.append(np.stack([(rings - 1) * sides + here, (rings - 1) * sides + after, top], 1))
    return Patch(points, np.concatenate(faces), np.zeros((len(points), 2)))


LAYER = Moss()
