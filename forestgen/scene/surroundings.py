"""The stand beyond the site's edge: `site.surroundings`.

open: bare ground; for a plot in a clearing, and for pictures that look down on the site alone. repeat: copies of the
site's plants, side by side with it to all sides, for light, views, fisheyes and whatever else traces rays: the endless
stand of which the site is a period, for measurements. forest: other trees of the same stand, without visible
repetition, for pictures in which much of the surroundings is in view; from 250 m on in stands of several heights, with
clearings between. Buildings stand on the site alone. The ground keeps its own height, and the copies stand on it.

Plants are copied in two layers, low ones (under `LOW` times the tallest plant's height) and the others: low plants are
many and hide little. Each layer has a reach, `REACH_HEIGHTS` times its tallest plant, and a grid of blocks about as
long, `MOST_BLOCKS` along a side of the site at most:

- Near, where a block begins within the reach of the site's edge, each plant is an instance with all of its detail, and
  with a plant_id and a row of its own where copies are labelled. A block whose ground is uneven is near up to
  `UNEVEN_REACHES` times as far; one that water or a path crosses always is. None stands in water or on a path.
- Far, up to `FAR_BLOCKS` blocks or `FAR_M`, a block is one mesh of large triangles (`forestgen.scene.far_mesh`),
  sheared to the ground. It has no plant_id: its pixels are of the part `surroundings`.
- Beyond, where a camera looks, tall plants go on to the horizon in larger squares (`forestgen.scene.blocks`).

A place outside has, in repeat, the block that lies there when the site is laid side by side; in forest a block of the
site drawn at random, turned about its middle by a random number of right angles (of half turns, if it is no square).
Of near trees of two blocks whose stems are closer than `APART` times the sum of their crowns' radii, one stays: the
site's, or the first. So the stand is the site's in its composition and structure, tree by tree within a block.

Triangles of far meshes have about `GRAIN_M2`, those of squares are at most `SQUARE_TRIANGLES`: coarser ones hide less
of each other, so that a forest of them is brighter. Measured in four views over whole trees: beeches of 1 m2 by 12 to
27%, of 0.07 m2 by 1 to 11%; spruces of 1 m2 by 23 to 61%, of 0.07 m2 by 1 to 7% in level views, 17 and 32% from above.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population
from forestgen.core.errors import RecipeError
from forestgen.core.randomness import child_rng
from forestgen.geometry.mesh import Floats
from forestgen.plants.exemplar import Exemplar
from forestgen.scene.blocks import (
    MOST_BLOCKS_BEYOND,
    SQUARE_M,
    WOODS_M,
    Beyond,
    Blocks,
    FarBlock,
    Lattice,
    Rows,
    Stands,
    copied_blocks,
    sheared,
    turns,
)
from forestgen.scene.far_mesh import SPECIES, areas_m2, sheet_areas_m2, thinned
from forestgen.scene.spec import Camera, Instances, Material
from forestgen.scene.terrain import HeightField
from forestgen.scene.wind import Sway

LOW = 0.15
REACH_HEIGHTS, LEAST_REACH_M, MOST_REACH_M = 1.25, 10.0, 60.0
MOST_BLOCKS = 8
# A block's ground is uneven where it is farther from a plane than a share of the tallest plant, or m: the larger.
UNEVEN, UNEVEN_M, UNEVEN_REACHES = 0.05, 0.15, 4.0
FAR_BLOCKS, LOW_FAR_BLOCKS, FAR_M = 16, 8, 1000.0
APART, _LEAST_SEEN = 0.35, 0.02
GRAIN_M2, _MOST_TRIANGLES, SQUARE_TRIANGLES = 0.06, 1_000_000, 500_000
_MOST_LEAVES = 12.0  # m2 over a square metre of the site, for the estimate of memory
# Instances of far meshes, for the same: blocks near and beyond, squares all around.
MOST_FAR = (2 * FAR_BLOCKS + MOST_BLOCKS) ** 2 + MOST_BLOCKS_BEYOND + int((2 * WOODS_M / SQUARE_M) ** 2)

Bools = NDArray[np.bool_]
Materials = Mapping[tuple[str, str], Material]


@dataclass(frozen=True)
class SurroundedStand:
    """The plants of a scene, with those beyond the site's edge."""

    exemplars: tuple[Exemplar, ...]  # those of the site, then far meshes
    materials: Materials
    instances: Instances  # the site's plants, then copies of them, then far meshes
    source: Rows  # (N,) row of the site's plant that an instance is a copy of, or is; 0 of a far mesh
    population: Population  # with a row for each copy that has a plant_id, marked in a column `outside`
    copies: int = 0  # instances that are copies of a plant
    reach_m: float = 0.0  # how far they and the far meshes reach from the site's edge

    @classmethod
    def of(
        cls, population: Population, instances: Instances, exemplars: tuple[Exemplar, ...], materials: Materials
    ) -> SurroundedStand:
        """A site with nothing around it."""
        return cls(exemplars, materials, instances, np.arange(len(instances)), population)

    @property
    def plants(self) -> Instances:
        """Those of the site and the copies near it, without far meshes."""
        return self.instances.at(slice(0, len(self.instances) - self.instances.outside + self.copies))

    def sway(self, sway: Sway) -> Sway:
        """How all move, by how the site's plants do: copies as their source, still where they have no plant_id."""
        still = self.instances.plant_id == 0
        return replace(
            sway,
            mean_rad=np.where(still, 0.0, sway.mean_rad[self.source]),
            frequency_hz=sway.frequency_hz[self.source],
            phase_rad=sway.phase_rad[self.source],
        )


def surrounded(
    site: SurroundedStand, layers: Sequence[Layer], height: HeightField, seed: int, labelled: bool
) -> SurroundedStand:
    """The plants of a site with those of layers all around, on the ground of a height.

    `site`: with nothing around it. `labelled`: whether copies have a plant_id, and a row in the population.
    """
    if not layers:
        return site
    population, plants, exemplars = site.population, site.instances, site.exemplars
    source = np.concatenate([layer.source for layer in layers])
    copied = plants.transform[source]
    copied[:, :2, :3] = turns(np.concatenate([layer.turn for layer in layers])) @ copied[:, :2, :3]
    copied[:, :, 3] = np.concatenate([layer.position_m for layer in layers])
    plant_id = int(population.plant_id[-1]) + 1 + np.arange(len(source) if labelled else 0, dtype=np.int64)
    blocks = [block for layer in layers for block in layer.far]
    meshes = _meshes(site, blocks, seed)
    mesh = np.repeat(len(exemplars) + np.arange(len(blocks)), [len(block.transform) for block in blocks])
    instances = Instances(
        exemplar=np.concatenate([plants.exemplar, plants.exemplar[source], mesh]).astype(np.uint32),
        transform=np.concatenate([plants.transform, copied, *(block.transform for block in blocks)]),
        plant_id=np.zeros(len(plants) + len(source) + len(mesh), dtype=np.uint32),
        outside=len(source) + len(mesh),
    )
    instances.plant_id[: len(plants)] = plants.plant_id
    instances.plant_id[len(plants) : len(plants) + len(plant_id)] = plant_id
    return SurroundedStand(
        exemplars=(*exemplars, *meshes),
        materials={**site.materials, **{(SPECIES, f"{of}/{key}"): one for (of, key), one in site.materials.items()}},
        instances=instances,
        source=np.concatenate([np.arange(len(plants)), source, np.zeros(len(mesh), dtype=np.intp)]),
        population=_with_copies(population, source, copied[:, :, 3], plant_id) if labelled else population,
        copies=len(source),
        reach_m=max(layer.reach_m for layer in layers),
    )


def most_copies(population: Population, size_m: tuple[float, float], *, flat: bool) -> int:
    """About how many plants near the site will be added, at most; on uneven ground they reach farther."""
    farther = 1.0 if flat else UNEVEN_REACHES
    rows, total = np.arange(len(population)), 0.0
    for members in _by_height(population, rows):
        blocks = _block_counts(size_m, _reach_m(population, members))
        reach = np.ceil(farther * _reach_m(population, members) * blocks / size_m - 1e-9)  # blocks on each side
        total += len(members) * (float(np.prod((blocks + 2 * reach) / blocks)) - 1.0)
    return int(total)


def most_far_triangles(size_m: tuple[float, float]) -> int:
    """Of far meshes around a site, at most."""
    return SQUARE_TRIANGLES + int(min(_MOST_LEAVES * size_m[0] * size_m[1] / GRAIN_M2, _MOST_TRIANGLES))


@dataclass(frozen=True)
class Layer:
    """Plants of similar height around a site."""

    source: Rows  # (K,) of near copies: rows of the population
    position_m: Floats  # (K, 3) of their feet
    turn: Rows  # (K,) right angles by which they are turned, counter-clockwise
    far: list[FarBlock]
    reach_m: float


def layers_around(
    population: Population,
    rows: Rows,
    height: HeightField,
    rng: np.random.Generator | None,
    cameras: Sequence[Camera] = (),
    stands: Stands | None = None,
) -> tuple[Layer, ...]:
    """What stands around a site, of some rows of its plants.

    `rng`: draws the blocks of `forest`; None: those of `repeat`. `cameras`: for which there is forest beyond `FAR_M`,
    but for those that stand so deep in the stand that they do not see so far. `stands`: of the tall plants; None: all
    are as the site.
    """
    both = (FAR_BLOCKS, cameras, stands), (LOW_FAR_BLOCKS, (), None)
    return tuple(
        _layer(population, members, height, rng, *one)
        for one, members in zip(both, _by_height(population, rows), strict=False)
    )


def _sees(camera: Camera, population: Population, rows: Rows, height: HeightField, far_m: float) -> bool:
    """Whether plants at a camera's height leave `_LEAST_SEEN` of a level view open at a distance, were they at random
    and crowns open by half.
    """
    x, y, z = camera.position_m
    level_m = z - float(height(np.array([x]), np.array([y]))[0])
    known, plants = population.columns, population.at(rows)
    crown_m = 2.0 * plants.radius_m
    stem_m = np.nan_to_num(known["dbh_m"][rows]) if "dbh_m" in known else crown_m
    base_m = np.nan_to_num(known["crown_base_m"][rows]) if "crown_base_m" in known else np.zeros(len(rows))
    wide_m = np.where(level_m < base_m, stem_m, 0.5 * crown_m)[plants.height_m > level_m]
    return math.exp(-far_m * float(wide_m.sum()) / (height.size_m[0] * height.size_m[1])) > _LEAST_SEEN


def _by_height(population: Population, rows: Rows) -> list[Rows]:
    """The tall and the low of some plants."""
    low = population.height_m[rows] < LOW * population.height_m[rows].max(initial=0.0)
    return [one for one in (rows[~low], rows[low]) if len(one)]


def _reach_m(population: Population, rows: Rows) -> float:
    return float(np.clip(REACH_HEIGHTS * population.height_m[rows].max(), LEAST_REACH_M, MOST_REACH_M))


def _block_counts(size_m: tuple[float, float], reach_m: float) -> Rows:
    """(2,) blocks along the sides of the site."""
    return np.clip(np.floor(np.asarray(size_m) / reach_m), 1, MOST_BLOCKS).astype(np.intp)


def _layer(
    population: Population,
    members: Rows,
    height: HeightField,
    rng: np.random.Generator | None,
    far_blocks: int,
    cameras: Sequence[Camera],
    stands: Stands | None,
) -> Layer:
    reach_m, top_m = _reach_m(population, members), float(population.height_m[members].max())
    lattice = Lattice(np.asarray(height.size_m) / _block_counts(height.size_m, reach_m), height, rng, stands)
    side, count = lattice.side_m, lattice.count
    far_m = min(far_blocks * float(side.max()), FAR_M)
    at, apart = copied_blocks(side, count, far_m)
    own, turn = lattice.drawn(at)
    plane, miss_m = lattice.planes(at, 1)
    uneven = miss_m > max(UNEVEN * top_m, UNEVEN_M)
    barred = lattice.barred(at)
    near = (apart < np.where(uneven, UNEVEN_REACHES, 1.0) * reach_m - 1e-6) | ((barred > 0) & (barred < 1))
    cell = np.clip((population.position_m[members, :2] / side).astype(np.intp), 0, count - 1)
    blocks = Blocks(members, cell, population.position_m[members, :2] - (cell + 0.5) * side)
    far, source, place = [], [], []
    own_rng = None if rng is None else rng.spawn(1)[0]  # what cameras see changes nothing else
    far_sighted = [one for one in cameras if _sees(one, population, members, height, far_m)]
    beyond = Beyond.of(replace(lattice, rng=own_rng), far_m, top_m, far_sighted)
    every, far_own, far_turn = (
        np.concatenate(pair) for pair in ((at, beyond.at), (own, beyond.own), (turn, beyond.turn))
    )
    plane, relative_height = np.concatenate([plane, beyond.plane]), lattice.relative_height(every, 1)
    is_far = np.append(~near & (barred < 1), np.ones(len(beyond.at), dtype=bool)) & (relative_height > 0)
    for index in np.ndindex(*count):
        (plants, from_middle), here = blocks.of(index), (own == index).all(axis=1)
        copies, mine = np.flatnonzero(near & here), np.flatnonzero(is_far & (far_own == index).all(axis=1))
        source.append(np.stack([np.tile(plants, len(copies)), np.repeat(copies, len(plants))]))
        middle = (at[copies] + 0.5) * side
        place.append((middle[:, None] + from_middle @ turns(turn[copies]).transpose(0, 2, 1)).reshape(-1, 2))
        if len(plants) and len(mine):
            still = np.zeros(len(plants), dtype=np.intp)
            transform = sheared((every[mine] + 0.5) * side, plane[mine], far_turn[mine], relative_height[mine])
            far.append(FarBlock(plants, from_middle, still, transform))
    (row, block), xy = np.concatenate(source, axis=1), np.concatenate(place)
    kept = np.full(len(row), True) if rng is None else _free_of_stems(population, members, row, block, xy)
    kept &= ~height.barred(*xy.T)
    row, block, xy = row[kept], block[kept], xy[kept]
    far += beyond.squares(blocks)
    reach_m = WOODS_M if beyond.any else far_m
    return Layer(row, np.column_stack([xy, height(*xy.T)]), turn[block], far, reach_m)


def _free_of_stems(population: Population, members: Rows, row: Rows, block: Rows, xy: Floats) -> Bools:
    """(K,) copies to which no stem that stays, of the site or of a block before theirs, is too near."""
    from scipy.spatial import cKDTree  # late: half a second

    at = np.concatenate([population.position_m[members, :2], xy])
    radius_m = population.radius_m[np.concatenate([members, row])]
    of = np.concatenate([np.full(len(members), -1), block])
    first, second = cKDTree(at).query_pairs(2.0 * APART * radius_m.max(), output_type="ndarray").T
    close = np.linalg.norm(at[first] - at[second], axis=1) < APART * (radius_m[first] + radius_m[second])
    pairs = np.stack([first, second], axis=1)[close & (of[first] != of[second])]
    pairs = np.take_along_axis(pairs, np.argsort(of[pairs], axis=1), axis=1)  # of the earlier block, of the later
    kept = np.full(len(at), True)
    for earlier, later in pairs[np.argsort(of[pairs[:, 1]])].tolist():
        kept[later] &= not kept[earlier]
    return kept[len(members) :]


def _meshes(site: SurroundedStand, blocks: Sequence[FarBlock], seed: int) -> list[Exemplar]:
    """The far meshes of blocks and squares."""
    thin = {
        wide: _thinned(site, [one.rows for one in blocks if one.wide == wide], seed, grain_m2, most)
        for wide, grain_m2, most in ((False, GRAIN_M2, _MOST_TRIANGLES), (True, 0.0, SQUARE_TRIANGLES))
    }
    return [block.mesh(site.instances, thin[block.wide]) for block in blocks]


def _thinned(
    site: SurroundedStand, blocks: Sequence[Rows], seed: int, grain_m2: float, most: int
) -> dict[int, Exemplar]:
    """The exemplars of some blocks, by their index, of triangles of one size in the world: `grain_m2`, or larger where
    the blocks would have more than `most`.
    """
    if not blocks:
        return {}
    rows = np.concatenate(blocks)
    which = site.instances.exemplar[rows]
    faces_of = {one: areas_m2(site.exemplars[one]) for one in np.unique(which).tolist()}
    sheet_of = {one: sum(sheet_areas_m2(site.exemplars[one], areas)) for one, areas in faces_of.items()}
    growth = np.cbrt(np.linalg.det(site.instances.transform[rows, :, :3])) ** 2  # of areas
    shown_m2 = sum(area * float(growth[which == one].sum()) for one, area in sheet_of.items())
    grain_m2 = max(shown_m2 / most, grain_m2)
    found = {}
    for one, areas in faces_of.items():
        rng, local_m2 = child_rng(seed, "far mesh", one), grain_m2 / float(growth[which == one].mean())
        found[one] = replace(site.exemplars[one], organs=thinned(site.exemplars[one], areas, local_m2, rng))
    return found


def _with_copies(population: Population, source: Rows, place_m: Floats, plant_id: NDArray[np.int64]) -> Population:
    if len(source) and plant_id[-1] >= 2**32:
        problem, expected = "no plant_id is left for the copies around the site", f"ids below {2**32}"
        got, hint = f"{len(source):,} copies from {plant_id[0]} on", "set site.surroundings.labelled: false"
        raise RecipeError(problem, where="site.surroundings", expected=expected, got=got, hint=hint)
    everyone = np.concatenate([np.arange(len(population)), source])
    outside = np.arange(len(everyone)) >= len(population)
    more = population.at(
        everyone,
        plant_id=np.concatenate([population.plant_id, plant_id]).astype(np.uint32),
        position_m=np.concatenate([population.position_m, place_m]),
    )
    return replace(more, columns={**more.columns, "outside": outside})
