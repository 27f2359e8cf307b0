"""Stones and boulders, partly in the ground.

A stone is what random planes about a ball leave, its edges rounded: in the direction d from the middle it reaches to

    r(d) = (sum_i max(n_i . d / h_i, 0)^p)^(-1/p)

of planes of normals n_i at distances h_i; p is large for broken rock, small for stones of a stream. It is roughened,
longer than wide and wider than high. Lichens grow on patches of most stones, moss on the upper side of some (shares are
ours).

Example
-------
    site: {ground: {layers: [{what: stones, cover: 0.02, size_m: 0.2}]}}
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import Field

from forestgen.core.parts import Part
from forestgen.geometry.contours import cut
from forestgen.geometry.mesh import GOLDEN_RAD, Floats, Ints, Mesh, vertex_normals
from forestgen.plants.exemplar import OrganMesh
from forestgen.recipe.fields import Fraction, Number, Positive
from forestgen.recipe.ground import DENSEST, GroundLayer
from forestgen.recipe.spectra import load_spectra
from forestgen.scene.ground_layers.layer import (
    GroundLayerKind,
    Layer,
    Request,
    Spread,
    Thing,
    mean_surface,
    opaque,
    scaled,
    shades,
)

_VARIANTS = 12
_TRAPPED = 0.27  # share of light: benchmarks/ground_cover.py
_SHADES = (0.5, 0.7, 0.95)
_LICHEN = 1.2  # brightness of a pale crust over the table's rock
_PLANES = 15
_EDGE = (30.0, 4.0)  # p of broken rock, and of stones of a stream
_NEAREST = 0.55  # h_i of a plane, over the farthest
_WIDTH, _HEIGHT = (0.6, 0.95), (0.4, 0.75)  # over the length
_PATCHES = 6.0  # of lichen and moss, on a stone's length
_LICHEN_SHARE, _MOSS_SHARE = (-0.1, 0.3), (-0.4, 0.4)  # of a stone's surface, from and to; below 0: none


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
            organs = _grown_over(mesh, f"stones-{index % len(_SHADES)}", rng)
            things.append(Thing(organs, keys.size_m, closed=True))
        moss = opaque(load_spectra("wood/moss")["reflectance"], roughness=0.9)
        materials = {**shades(rock, _SHADES, "stones"), "stones-lichen": scaled(rock, _LICHEN), "stones-moss": moss}
        share = np.array([sum(_from_above_m2(thing, key) for thing in things) for key in materials])
        mean = mean_surface(list(materials.values()), share)
        spread = Spread(tilt_deg=12.0, size_sigma=keys.size_sigma, sunk=0.35)
        return [Layer("stones", tuple(things), materials, keys.cover, mean, _TRAPPED, spread, keys.patch_m)]


def _stone(length_m: float, roundness: float, rounds: int, rng: np.random.Generator) -> Mesh:
    """A stone of about a length, its lowest point at z = 0."""
    points, faces = _sphere(rounds)
    around = np.arange(_PLANES) + 0.5
    turn, up = around * GOLDEN_RAD, 1.0 - 2.0 * around / _PLANES  # evenly about the ball
    flat = np.sqrt(1.0 - up**2)
    normal = np.column_stack([flat * np.cos(turn), flat * np.sin(turn), up]) + 0.3 * rng.normal(size=(_PLANES, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    reach = rng.uniform(_NEAREST, 1.0, _PLANES)
    power = _EDGE[0] ** (1.0 - roundness) * _EDGE[1] ** roundness
    away = np.sum(np.maximum(points @ normal.T / reach, 0.0) ** power, axis=1) ** (-1.0 / power)
    points *= (away * (1.0 + (1.0 - 0.6 * roundness) * _bumps(points, rng)))[:, None]
    points *= np.array([1.0, rng.uniform(*_WIDTH), rng.uniform(*_HEIGHT)])
    points *= length_m / np.ptp(points[:, 0])
    points[:, 2] -= points[:, 2].min()
    normals = vertex_normals(points, faces)
    return Mesh(points.astype(np.float32), faces.astype(np.uint32), normals.astype(np.float32))


def _grown_over(mesh: Mesh, rock: str, rng: np.random.Generator) -> tuple[OrganMesh, ...]:
    """The surface in patches of rock, lichen and moss."""
    size_m, bare = float(np.ptp(mesh.vertices_m[:, 0])), mesh
    pieces = []
    for name, (low, high), upper in (("moss", _MOSS_SHARE, 0.12), ("lichen", _LICHEN_SHARE, 0.0)):
        share, seed = rng.uniform(low, high), rng.integers(2**32)

        def grows(on: Mesh, seed: int = int(seed), upper: float = upper) -> Floats:
            assert on.normals is not None  # of a stone
            points = _PATCHES * on.vertices_m.astype(np.float64) / size_m
            return _bumps(points, np.random.default_rng(seed)) + upper * on.normals[:, 2]

        if share > 0.0 and bare.triangles:
            (bare, _), (covered, _) = cut(bare, grows(bare) - np.quantile(grows(mesh), 1.0 - share))
            pieces.append((covered, f"stones-{name}"))
    return tuple(OrganMesh(Part.ROCK, name, one) for one, name in [(bare, rock), *pieces] if one.triangles)


def _from_above_m2(thing: Thing, material: str) -> float:
    """Area of a material on the upper sides of a thing, as seen from above."""
    total = 0.0
    for organ in thing.organs:
        if organ.material == material:
            a, b, c = organ.mesh.vertices_m[organ.mesh.faces].astype(np.float64).transpose(1, 0, 2)
            total += float(np.maximum(0.5 * np.cross(b - a, c - a)[:, 2], 0.0).sum())
    return total


def _bumps(points: Floats, rng: np.random.Generator) -> Floats:
    """(V,) roughness of a few octaves of plane waves."""
    height = np.zeros(len(points))
    for octave in range(4):
        k = rng.normal(size=(6, 3)) * 2.5 * 1.9**octave
        height += 0.035 * 0.65**octave * np.sin(points @ k.T + rng.uniform(0, 2 * np.pi, 6)).sum(axis=1) / 2
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
