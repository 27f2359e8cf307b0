"""Stones and boulders, partly in the ground.

A stone is a ball cut by random planes and roughened, wider than high: what is left is angular, as broken rock is, or
round, as of a stream.

Example
-------
    site: {ground: {layers: [{what: stones, cover: 0.02, size_m: 0.2}]}}
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import Field

from forestgen.core.parts import Part
from forestgen.geometry.mesh import Floats, Ints, Mesh, vertex_normals
from forestgen.plants.exemplar import OrganMesh
from forestgen.recipe.fields import Fraction, Number, Positive
from forestgen.recipe.ground import DENSEST, GroundLayer
from forestgen.recipe.spectra import load_spectra
from forestgen.scene.ground_layers.layer import GroundLayerKind, Layer, Request, Spread, Thing, opaque, scaled, shades

_VARIANTS = 8
_TRAPPED = 0.27  # share of light: benchmarks/ground_cover.py
_SHADES = (0.6, 0.85, 1.15)
_PLANES = 9
_HEIGHT, _WIDTH = 0.6, 0.8  # over the length


class StonesKeys(GroundLayer):
    """Stones."""

    cover: Number = Field(0.02, gt=0, le=DENSEST, description="Share of the ground that they hide, seen from above.")
    size_m: Positive = Field(0.12, ge=0.01, le=10, description="Their median length, metres.")
    size_sigma: Fraction = Field(0.5, description="Spread of the logarithm of their length.")
    roundness: Fraction = Field(0.3, description="0 broken rock, 1 stones of a stream.")


class Stones(GroundLayerKind[StonesKeys]):
    """Stones."""

    Parameters = StonesKeys

    def layers(self, keys: StonesKeys, request: Request, rng: np.random.Generator) -> Sequence[Layer]:
        rock = opaque(load_spectra("ground/rock")["reflectance"], roughness=0.9)
        rounds = 2 + request.detail(0.3 * keys.size_m)
        things = []
        for index in range(_VARIANTS):
            mesh = _stone(keys.size_m, keys.roundness, rounds, rng)
            organ = OrganMesh(Part.ROCK, f"stones-{index % len(_SHADES)}", mesh)
            things.append(Thing((organ,), keys.size_m, closed=True))
        mean = scaled(rock, float(np.mean(_SHADES)))
        spread = Spread(tilt_deg=12.0, size_sigma=keys.size_sigma, sunk=0.35)
        materials = shades(rock, _SHADES, "stones")
        return [Layer("stones", tuple(things), materials, keys.cover, mean, _TRAPPED, spread, keys.patch_m)]


def _stone(length_m: float, roundness: float, rounds: int, rng: np.random.Generator) -> Mesh:
    """A stone of about a length, its lowest point at z = 0."""
    points, faces = _sphere(rounds)
    normal = rng.normal(size=(_PLANES, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    reach = rng.uniform(0.55 + 0.4 * roundness, 1.0, _PLANES)
    for axis, most in zip(normal, reach, strict=True):
        beyond = np.maximum(points @ axis - most, 0.0)
        points = points - 0.96 * beyond[:, None] * axis
    points *= (1.0 + (1.0 - 0.6 * roundness) * _bumps(points, rng))[:, None]
    points *= 0.5 * length_m * np.array([1.0, rng.uniform(0.85, 1.1) * _WIDTH, rng.uniform(0.8, 1.2) * _HEIGHT])
    points[:, 2] -= points[:, 2].min()
    normals = vertex_normals(points, faces)
    return Mesh(points.astype(np.float32), faces.astype(np.uint32), normals.astype(np.float32))


def _bumps(points: Floats, rng: np.random.Generator) -> Floats:
    """(V,) roughness of a few octaves of plane waves."""
    height = np.zeros(len(points))
    for octave in range(4):
        k = rng.normal(size=(6, 3)) * 2.5 * 1.9**octave
        height += 0.035 * 0.55**octave * np.sin(points @ k.T + rng.uniform(0, 2 * np.pi, 6)).sum(axis=1) / 2
    return height


def _sphere(rounds: int) -> tuple[Floats, Ints]:
    """Points and outward triangles of an octahedron whose faces are divided in four so many times, on a unit ball."""
    points = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    for _ in range(rounds):
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        unique, index = np.unique(edges, axis=0, return_inverse=True)
        middle = points[unique].sum(axis=1)
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
        ab, bc, ca = (index.reshape(3, -1) + len(points)).astype(np.int64)
        a, b, c = faces.T
        faces = np.concatenate([np.stack(one, 1) for one in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
        points = np.concatenate([points, middle])
    return points, faces


LAYER = Stones()
