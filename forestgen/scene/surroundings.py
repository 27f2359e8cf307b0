"""The stand beyond the site's edge: `site.surroundings`.

open: bare ground. repeat: copies of the site's plants, side by side with it to all sides, for light, views, fisheyes
and whatever else traces rays. Buildings are not repeated. The ground keeps its own height, and the copies stand on it.

Plants are copied in two layers, low ones (under `LOW` times the tallest plant's height) and the others: low plants are
many and hide little. Each layer has a reach, `REACH_HEIGHTS` times its tallest plant, and a grid of blocks about as
long, `MOST_BLOCKS` along a side of the site at most:

- Near, where a block begins within the reach of the site's edge, each plant is an instance with all of its detail, and
  with a plant_id and a row of its own where copies are labelled. A block whose ground is uneven is near up to
  `UNEVEN_REACHES` times as far.
- Far, up to `FAR_BLOCKS` blocks or `FAR_M`, a block is one mesh of large triangles (`forestgen.scene.far_mesh`),
  sheared to the ground. It has no plant_id: its pixels are of the part `surroundings`.

A site's far meshes have about `FAR_SHARE` as many triangles as its exemplars.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population
from forestgen.core.errors import RecipeError
from forestgen.core.parts import Part
from forestgen.core.randomness import child_rng
from forestgen.geometry.mesh import Floats
from forestgen.plants.exemplar import Exemplar
from forestgen.scene.far_mesh import SPECIES, far_mesh, sheet_areas_m2, thinned
from forestgen.scene.spec import Camera, Instances, Material
from forestgen.scene.terrain import HeightField
from forestgen.scene.wind import Sway

LOW = 0.15
REACH_HEIGHTS, LEAST_REACH_M, MOST_REACH_M = 2.0, 10.0, 60.0
MOST_BLOCKS = 8
UNEVEN, UNEVEN_REACHES = 0.05, 4.0  # of the tallest plant: by how much feet in a far block may miss the ground
FAR_BLOCKS, FAR_M = 16, 1000.0
FAR_SHARE, _LEAST_TRIANGLES = 0.15, 20_000
_PROBES = np.linspace(-0.5, 0.5, 5)  # along a block, where the ground is looked up

Rows = NDArray[np.intp]
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


def seen_from(cameras: Sequence[Camera], size_m: tuple[float, float]) -> list[Camera]:
    """The cameras, and each moved so that it stands to the site as it stands to one of the eight copies beside it."""
    moved = []
    for i, j in ((i, j) for i in (0, 1, -1) for j in (0, 1, -1)):
        shift = (i * size_m[0], j * size_m[1], 0.0)
        moved += [replace(one, position_m=tuple(np.add(one.position_m, shift).tolist())) for one in cameras]
    return moved


def repeated(site: SurroundedStand, height: HeightField, seed: int, labelled: bool) -> SurroundedStand:
    """The plants of a site with copies of them all around, on the ground of a height.

    `site`: with nothing around it. `labelled`: whether copies have a plant_id, and a row in the population.
    """
    population, plants, exemplars = site.population, site.instances, site.exemplars
    living = np.array([all(organ.part != Part.STRUCTURE for organ in one.organs) for one in exemplars], dtype=np.bool_)
    rows = np.flatnonzero(living[plants.exemplar])
    if not len(rows):
        return site
    layers = list(_layers(population, rows, height))
    source = np.concatenate([layer.source for layer in layers])
    copied = plants.transform[source]
    copied[:, :2, 3] = np.concatenate([layer.place_m for layer in layers])
    copied[:, 2, 3] = height(copied[:, 0, 3], copied[:, 1, 3])
    plant_id = int(population.plant_id[-1]) + 1 + np.arange(len(source) if labelled else 0, dtype=np.int64)
    blocks = [block for layer in layers for block in layer.far]
    thin = _thinned(site, rows, seed)
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
        exemplars=(*exemplars, *(block.mesh(plants, thin) for block in blocks)),
        materials={**site.materials, **{(SPECIES, f"{of}/{key}"): one for (of, key), one in site.materials.items()}},
        instances=instances,
        source=np.concatenate([np.arange(len(plants)), source, np.zeros(len(mesh), dtype=np.intp)]),
        population=_with_copies(population, source, copied[:, :, 3], plant_id) if labelled else population,
        copies=len(source),
        reach_m=max(layer.reach_m for layer in layers),
    )


def most_copies(population: Population, size_m: tuple[float, float], *, flat: bool) -> int:
    """About how many plants near the site `repeated` will add, at most; on uneven ground they reach farther."""
    farther = 1.0 if flat else UNEVEN_REACHES
    rows, total = np.arange(len(population)), 0.0
    for members in _by_height(population, rows):
        blocks = _block_counts(size_m, _reach_m(population, members))
        reach = np.ceil(farther * _reach_m(population, members) * blocks / size_m - 1e-9)  # blocks on each side
        total += len(members) * (float(np.prod((blocks + 2 * reach) / blocks)) - 1.0)
    return int(total)


@dataclass(frozen=True)
class _FarBlock:
    """Plants of one block of the site as one mesh, at all places where a copy of it is far away."""

    rows: Rows  # of the site's instances
    middle_m: Floats  # (2,) of the block on the site
    transform: Floats  # (M, 3, 4) of the copies

    def mesh(self, plants: Instances, thin: Mapping[int, Exemplar]) -> Exemplar:
        which, transform = plants.exemplar[self.rows], plants.transform[self.rows]
        transform[:, :2, 3] -= self.middle_m
        transform[:, 2, 3] = 0.0  # feet are on the ground, which the copies' transforms know
        return far_mesh((thin[one], transform[which == one]) for one in np.unique(which).tolist())


@dataclass(frozen=True)
class _Layer:
    source: Rows  # (K,) of near copies: rows of the site's instances
    place_m: Floats  # (K, 2)
    far: list[_FarBlock]
    reach_m: float


def _by_height(population: Population, rows: Rows) -> list[Rows]:
    """The tall and the low of some plants."""
    low = population.height_m[rows] < LOW * population.height_m[rows].max(initial=0.0)
    return [one for one in (rows[~low], rows[low]) if len(one)]


def _reach_m(population: Population, rows: Rows) -> float:
    return float(np.clip(REACH_HEIGHTS * population.height_m[rows].max(), LEAST_REACH_M, MOST_REACH_M))


def _block_counts(size_m: tuple[float, float], reach_m: float) -> Rows:
    """(2,) blocks along the sides of the site."""
    return np.clip(np.floor(np.asarray(size_m) / reach_m), 1, MOST_BLOCKS).astype(np.intp)


def _layers(population: Population, rows: Rows, height: HeightField) -> Iterator[_Layer]:
    size = np.asarray(height.size_m)
    for members in _by_height(population, rows):
        reach_m, count = _reach_m(population, members), _block_counts(height.size_m, _reach_m(population, members))
        side = size / count
        at, apart = _copied_blocks(size, count)
        plane, miss_m = _planes(height, (at + 0.5) * side, side)
        uneven = miss_m > UNEVEN * population.height_m[members].max()
        near = apart < np.where(uneven, UNEVEN_REACHES, 1.0) * reach_m - 1e-6
        own, shift = at % count, at // count * size
        position = population.position_m[members, :2]
        cell = np.clip((position / side).astype(np.intp), 0, count - 1)
        inside = {(i, j): members[(cell == (i, j)).all(axis=1)] for i, j in np.ndindex(*count)}
        source = [inside[i, j] for i, j in own[near].tolist()]
        place = [population.position_m[one, :2] + by for one, by in zip(source, shift[near], strict=True)]
        far = []
        for (i, j), plants in inside.items():
            mine = np.flatnonzero(~near & (own == (i, j)).all(axis=1))
            if len(plants) and len(mine):
                middle = (np.array([i, j]) + 0.5) * side
                far.append(_FarBlock(plants, middle, _sheared((at[mine] + 0.5) * side, plane[mine])))
        yield _Layer(np.concatenate(source), np.concatenate(place), far, _far_m(size, count))


def _far_m(size: Floats, count: Rows) -> float:
    return min(FAR_BLOCKS * float((size / count).max()), FAR_M)


def _copied_blocks(size: Floats, count: Rows) -> tuple[Rows, Floats]:
    """(B, 2) columns and rows of the blocks outside, those of the site counted from 0; (B,) metres from the site."""
    side = size / count
    more = np.ceil(_far_m(size, count) / side).astype(np.intp)
    columns, rows = (np.arange(-n, c + n) for n, c in zip(more, count, strict=True))
    at = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    at = at[((at < 0) | (at >= count)).any(axis=1)]
    apart = np.hypot(*(np.maximum(np.maximum(-at - 1, at - count), 0) * side).T)
    near = apart < _far_m(size, count)
    return at[near], apart[near]


def _planes(height: HeightField, middle_m: Floats, side: Floats) -> tuple[Floats, Floats]:
    """(B, 3) rise east and north and height at the middle of the ground of blocks; (B,) how far it is from that."""
    x, y = (one.ravel() for one in np.meshgrid(_PROBES * side[0], _PROBES * side[1]))
    z = height(middle_m[:, :1] + x, middle_m[:, 1:] + y)
    plane = np.stack([z @ x / (x @ x), z @ y / (y @ y), z.mean(axis=1)], axis=1)
    miss = np.abs(z - plane @ np.stack([x, y, np.ones(len(x))]))
    return plane, miss.max(axis=1)


def _sheared(middle_m: Floats, plane: Floats) -> Floats:
    """(M, 3, 4) from the frames of far meshes to the world: stems stay upright, feet follow the plane."""
    transform = np.tile(np.eye(3, 4), (len(plane), 1, 1))
    transform[:, 2, :2], transform[:, 2, 3] = plane[:, :2], plane[:, 2]
    transform[:, :2, 3] = middle_m
    return transform


def _thinned(site: SurroundedStand, rows: Rows, seed: int) -> dict[int, Exemplar]:
    """The exemplars of some rows with few triangles, of one size in the world, by their index."""
    which = site.instances.exemplar[rows]
    area_of = {one: sheet_areas_m2(site.exemplars[one]) for one in np.unique(which).tolist()}
    growth = np.cbrt(np.linalg.det(site.instances.transform[rows, :, :3])) ** 2  # of areas
    shown_m2 = sum(sum(areas) * float(growth[which == one].sum()) for one, areas in area_of.items())
    grain_m2 = shown_m2 / max(FAR_SHARE * sum(one.triangles for one in site.exemplars), _LEAST_TRIANGLES)
    found = {}
    for one, areas in area_of.items():
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
