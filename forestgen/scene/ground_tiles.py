"""Meshes of tiles of the ground cover, and of single things that are too large for tiles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.core.randomness import child_rng
from forestgen.geometry.mesh import Floats, Mesh, concatenate, instance
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.scene.ground_layers.layer import GROUND, Layer, Thing
from forestgen.scene.ground_view import TILE_M

COVERS = (0.06, 0.2, 0.4, 0.6, 0.8, 0.92, 0.98)  # of the tiles that are made
VARIANTS = 4
MOST_THINGS = 6000  # on a tile


def number_per_m2(layer: Layer, cover: Floats) -> Floats:
    """How many things of a layer lie on a square metre where they hide a share of the ground, of any shape."""
    growth = np.exp(2.0 * layer.spread.size_sigma**2)  # mean square of sizes of median 1
    return np.asarray(-np.log1p(-cover) / (growth * float(np.mean([one.hidden_m2 for one in layer.things]))))


def single(layer: Layer, number: int) -> Exemplar:
    """One of the layer's things, sunk into the ground as the layer says."""
    thing = layer.things[number]
    frame = _sunk(np.eye(3, 4)[None], thing, layer.spread.sunk).astype(np.float32)
    organs = tuple(replace(one, mesh=_shown(layer, one.material, instance(one.mesh, frame))) for one in thing.organs)
    return Exemplar(GROUND, organs, 0.5 * thing.length_m, _top_m(organs), thing.length_m, 0.0, 0.0)


def _top_m(organs: tuple[OrganMesh, ...]) -> float:
    return max(1e-3, *(float(one.mesh.vertices_m[:, 2].max()) for one in organs))


def tile(layer: Layer, index: int, seed: int) -> tuple[Exemplar, int]:
    """One tile with the things of a layer, its middle in the origin, and their number; `index`: cover and variant."""
    cover, rng = COVERS[index // VARIANTS], child_rng(seed, "tile", layer.name, index)
    count = min(int(rng.poisson(float(number_per_m2(layer, np.array(cover))) * TILE_M**2)), MOST_THINGS)
    kind = rng.integers(len(layer.things), size=count)
    return laid(layer, kind, anywhere(layer, kind, rng), TILE_M), count


def laid(layer: Layer, kind: NDArray[np.integer], frames: Floats, width_m: float) -> Exemplar:
    """Things of a layer on an area of a width, its middle in the origin; `kind`: (N,); `frames`: (N, 3, 4)."""
    meshes: dict[tuple[Part, str], list[OrganMesh]] = {}
    for number, thing in enumerate(layer.things):
        mine = frames[kind == number]
        if not len(mine):
            continue
        mine = _sunk(mine, thing, layer.spread.sunk)
        for organ in thing.organs:
            one = replace(organ, mesh=instance(organ.mesh, mine.astype(np.float32)))
            meshes.setdefault((organ.part, organ.material), []).append(one)
    organs = tuple(
        OrganMesh(part, material, _shown(layer, material, concatenate([one.mesh for one in group])))
        for (part, material), group in meshes.items()
    )
    if not organs:  # a tile needs a surface
        first = layer.things[0].organs[0]
        buried = instance(first.mesh, np.hstack([0.01 * np.eye(3), [[0.0], [0.0], [-1.0]]])[None].astype(np.float32))
        organs = (OrganMesh(first.part, first.material, replace(buried, uv=None)),)
    return Exemplar(GROUND, organs, 0.5 * width_m, _top_m(organs), width_m, 0.0, 0.0)


def _shown(layer: Layer, material: str, mesh: Mesh) -> Mesh:
    """The mesh without uv where its material has no texture."""
    return mesh if layer.materials[material].texture is not None else replace(mesh, uv=None)


def anywhere(layer: Layer, kind: NDArray[np.integer], rng: np.random.Generator) -> Floats:
    """(N, 3, 4) of things anywhere on a tile, turned, leaning, of random sizes, lying on each other; `kind`: (N,)."""
    spread, count = layer.spread, len(kind)
    rise = np.array([one.rise for one in layer.things])[kind]
    turn, way = rng.random((2, count)) * 2.0 * np.pi
    lean = rise * np.abs(rng.normal(0.0, np.radians(spread.tilt_deg), count))
    size = np.exp(rng.normal(0.0, spread.size_sigma, count))
    cos, sin, zero, one = np.cos(turn), np.sin(turn), np.zeros(count), np.ones(count)
    turned = np.array([[cos, -sin, zero], [sin, cos, zero], [zero, zero, one]]).transpose(2, 0, 1)
    x, y, c, s = np.cos(way), np.sin(way), np.cos(lean), np.sin(lean)  # lean about the level axis (x, y)
    leant = np.array(
        [
            [c + x * x * (1 - c), x * y * (1 - c), y * s],
            [x * y * (1 - c), c + y * y * (1 - c), -x * s],
            [-y * s, x * s, c],
        ]
    ).transpose(2, 0, 1)
    frames = np.zeros((count, 3, 4))
    frames[:, :, :3] = size[:, None, None] * leant @ turned
    frames[:, :2, 3] = (rng.random((count, 2)) - 0.5) * TILE_M
    frames[:, 2, 3] = rise * rng.random(count) * spread.depth_m
    return frames


def _sunk(frames: Floats, thing: Thing, share: float) -> Floats:
    """The frames lowered by a share of the thing's height."""
    if share <= 0.0:
        return frames
    top_m = max(float(one.mesh.vertices_m[:, 2].max()) for one in thing.organs)
    lowered = frames.copy()
    lowered[:, 2, 3] -= share * top_m * frames[:, 2, 2]
    return lowered
