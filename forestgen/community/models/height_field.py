"""Trees on the vertices of a grid, moved a little but never too near to one another; the ground decides their species.

Reference: W. T. Reeves and R. Blau, Approximate and probabilistic algorithms for shading and rendering structured
particle systems, SIGGRAPH 1985, after B. Lane, Models of Plant Communities for Image Synthesis, University of Calgary,
2002, sections 3.2.1 and 3.2.2.

The density of trees is uniform. The ground determines their species: in Reeves and Blau's picture by its height, here
by each species' own density w, map times conditions, such as `elevation_m`.

1.  Vertices: a grid as near to squares as can be, with as many vertices on ground that allows any species as there are
    trees; of those that are left over, random ones stay empty.
2.  Places: each tree moves to a random place, at most J/2 of a cell from its vertex along each axis, if no other tree
    is then nearer than d and the ground allows a tree there; else it stays. All trees do so twelve times.
3.  Species: the tree at x is of species s with probability

        c_s w_s(x) / Σ_t c_t w_t(x),    c_s so that each species has the number that the recipe asks for.

Parameters: see below; J is jitter, d is min_distance_m. w and the numbers are those of `plants`.
Radii and heights follow from the species' max_radius_m and height_m.

Recipe::

    community:
      model: height_field
      min_distance_m: 2
      plants:
        spruce: {count: 300, conditions: {elevation_m: [[900, 0], [1200, 1]]}}
        poplar: {count: 300, conditions: {elevation_m: [[900, 1], [1200, 0]]}}

Decisions
---------
- The number of each species is the recipe's, as with every model here; Reeves and Blau let it follow from the terrain.
  c_s reconciles the two. Without conditions and maps, species are dealt out at random.
- The density of all trees together is even: a map says which species, not how many trees. Only ground that no species
  likes, or that keep_out bars, stays bare. `jittered_grid` follows maps.
- Vertices are at most 4 million, or four a tree: where next to no ground allows trees, not all of them find a vertex.
- Where n trees do not fit at the distance d, the grid of that spacing is filled with the largest, and a note says how
  many that were. A tree may stand where only a species grows that already has its number: then it is left out.
- They move a tree and test again, here as there; that no tree is lost by it is the reason why it may stay.
- Trees are `periodic` neighbours across the edges, or not.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.community.placement import model as placement
from forestgen.community.placement.labelling import assign, label, lattice_shape
from forestgen.community.population import Ecologies, Floats, Site
from forestgen.core.compiled import compiled
from forestgen.recipe.fields import Fraction, NonNegative

_SWEEPS = 12  # of moving: the first trees that move find the others still on their vertices
_VERTICES_PER_TREE, _VERTICES = 256, 4_000_000  # at most, the latter or four a tree


class HeightFieldParameters(placement.GriddedParameters):
    """What a recipe says about the model besides its species."""

    jitter: Fraction = Field(0.8, description="part of its cell of the grid in which a tree may stand")
    min_distance_m: NonNegative | None = Field(
        None, description="no two trees are nearer, metres; null: half of the grid's spacing"
    )


@compiled
def _move(at, vertex, moved, allowed, shape, size, distance, periodic):  # type: ignore[no-untyped-def]
    """Move (N, 2) trees `at`, in place, to the (N, 2) places `moved`, one after another.

    `vertex` is (N,) k of the cell, `shape` the grid's rows and columns; two trees that are two cells apart along an
    axis are a whole cell apart, which `distance` never exceeds, so only the eight cells around can matter.
    """
    rows, cols = shape
    tree = np.full(rows * cols, -1, np.int64)
    for i in range(len(vertex)):
        tree[vertex[i]] = i
    for i in range(len(vertex)):
        x, y = moved[i]
        row = min(int(y / size[1] * allowed.shape[0]), allowed.shape[0] - 1)
        col = min(int(x / size[0] * allowed.shape[1]), allowed.shape[1] - 1)
        free = allowed[row, col]
        for up in range(-1, 2):
            for along in range(-1, 2):
                r, c = vertex[i] // cols + up, vertex[i] % cols + along
                if periodic:
                    r, c = r % rows, c % cols
                elif r < 0 or r >= rows or c < 0 or c >= cols:
                    continue
                j = tree[r * cols + c]
                if j < 0 or j == i:
                    continue
                dx, dy = abs(x - at[j, 0]), abs(y - at[j, 1])
                if periodic:
                    dx, dy = min(dx, size[0] - dx), min(dy, size[1] - dy)
                free = free and dx * dx + dy * dy >= distance * distance
        if free:
            at[i, 0], at[i, 1] = x, y


def _vertices(shape: tuple[int, int], size_m: tuple[float, float]) -> Floats:
    """(rows cols, 2) middles of the cells, metres, in order of k."""
    rows, cols = shape
    x, y = (np.arange(cols) + 0.5) * (size_m[0] / cols), (np.arange(rows) + 0.5) * (size_m[1] / rows)
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def _grid(
    n: int, allowed: NDArray[np.bool_], size_m: tuple[float, float], least_m: float
) -> tuple[tuple[int, int], NDArray[np.intp]]:
    """Rows and columns, and the vertices on allowed ground: n or more, or as many as there are at the least spacing."""
    limit = min(n * _VERTICES_PER_TREE, max(4 * n, _VERTICES))
    rows_most, cols_most = (
        max(1, min(limit, math.floor(side / least_m))) if least_m > 0 else limit for side in reversed(size_m)
    )
    vertices = n
    while True:
        rows, cols = lattice_shape(vertices, size_m)
        shape = min(rows, rows_most), min(cols, cols_most)
        good = np.flatnonzero(placement.density_at(allowed, _vertices(shape, size_m), size_m))
        if len(good) >= n or shape == (rows_most, cols_most) or vertices >= limit:
            return shape, good
        vertices = math.ceil(vertices * min(4.0, max(1.02, n / max(len(good), 1))))


class HeightField(placement.GriddedModel[HeightFieldParameters]):
    Parameters = HeightFieldParameters
    missing_reason = "the ground that suits them has no vertex left at this distance between trees"

    def positions(
        self,
        parameters: HeightFieldParameters,
        site: Site,
        species: Ecologies,
        wanted: placement.PlantingTargets,
        rng: np.random.Generator,
    ) -> tuple[Floats, str]:
        """The trees of all species on one grid."""
        counts = np.bincount(wanted.sp, minlength=len(species))
        fields = placement.read_densities(parameters, site, species)
        able = np.array([n if np.any(field) else 0 for n, field in zip(counts, fields, strict=True)], dtype=np.int64)
        if not able.any():
            return np.full((len(wanted.sp), 2), np.nan), self.missing_reason
        mine = wanted.sp[able[wanted.sp] > 0]
        allowed = np.any([field > 0 for n, field in zip(able, fields, strict=True) if n], axis=0)
        at = _places(parameters, site, allowed, len(mine), rng)
        weight = np.array([placement.density_at(field, at, site.size_m) for field in fields])
        # Of fewer places than trees, the largest trees have theirs.
        labels = label(weight, np.bincount(mine[: len(at)], minlength=len(species)), rng)
        return assign(wanted, at, labels, rng), self.missing_reason


def _places(
    parameters: HeightFieldParameters, site: Site, allowed: NDArray[np.bool_], n: int, rng: np.random.Generator
) -> Floats:
    """(n, 2) places of trees of whatever species, metres; fewer where there are fewer vertices."""
    shape, good = _grid(n, allowed, site.size_m, parameters.min_distance_m or 0.0)
    vertex = rng.permutation(good)[:n]
    cell_m = np.array([site.size_m[0] / shape[1], site.size_m[1] / shape[0]])
    distance = parameters.min_distance_m if parameters.min_distance_m is not None else float(cell_m.min()) / 2
    at = _vertices(shape, site.size_m)[vertex]
    middle = at.copy()
    for _ in range(_SWEEPS):
        moved = middle + parameters.jitter * cell_m * (rng.random((len(vertex), 2)) - 0.5)
        _move(at, vertex, moved, allowed, shape, site.size_m, distance, parameters.periodic)
    return np.asarray(at)


MODEL = HeightField()
