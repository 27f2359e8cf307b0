"""Sizes of a community's trees: diameter, crown radius, crown base and leaf area, beside the heights.

Where a model does not say itself, they follow from a tree's height by its species' allometries
(`recipe.tree_sizes`), from numbers of the tree's own, and from its neighbours:

- c: crowns of neighbours at least 0.6 times as tall, over the area of a disc of 0.4 heights around the tree.
  A tree without any is open-grown; from 0.6 on it is of a stand.
- o: the same of trees at least 1.25 times as tall. From 0.7 on the tree is suppressed.

In between the logarithm of the diameter changes in proportion. Crowns count by the median of their species at their
height, dead trees not at all. Beyond a site that does not repeat there is more of the same: the part of a disc outside
counts as the part inside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Floats, Population, Site, SpeciesEcology, Status
from forestgen.core.randomness import child_root
from forestgen.recipe.tree_sizes import NUMBERS, TreeSizes, own_normals

COLUMNS = ("dbh_m", "crown_radius_m", "crown_base_m", "leaf_area_m2")
_DISC_HEIGHTS, _DISC_M = 0.4, (2.0, 12.0)
_NEIGHBOUR, _TALLER = 0.6, 1.25  # heights over the tree's
_OPEN_COVER, _SHADE_COVER = 0.6, 0.7
_RAYS = 16  # directions in which a disc's part inside the site is measured
_AT_ONCE = 20_000


def with_tree_sizes(
    population: Population, species: Sequence[SpeciesEcology], site: Site, seed: int, *, periodic: bool
) -> Population:
    """The population with `COLUMNS`: NaN of plants that are no trees, or have grown branches of their own.

    What a model knows itself stays. `species`: by the population's index. `seed`: the root seed of the simulation.
    """
    laws = [one.tree for one in species]
    has_law = np.array([law is not None for law in laws], dtype=np.bool_)
    trees = has_law[population.species] if len(population) else np.zeros(0, dtype=np.bool_)
    if population.modules is not None:
        trees &= np.diff(population.modules.first) == 0
    if not trees.any():
        return population
    known = {name: _column(population, name) for name in COLUMNS}
    shift = _shifts(population, laws, trees, site, periodic)
    normals = np.zeros((len(population), NUMBERS))
    normals[trees] = own_normals(child_root(seed, "trees"), population.plant_id[trees])
    for index in np.unique(population.species[trees]).tolist():
        law, rows = laws[index], np.flatnonzero(trees & (population.species == index))
        assert law is not None
        height_m = population.height_m[rows]
        sizes = law.sizes(height_m, normals[rows], shift[rows], known["dbh_m"][rows])
        leaf_area_m2 = sizes.leaf_kg / species[index].leaf_mass_per_area_kg_per_m2
        made = (sizes.dbh_m, 0.5 * sizes.crown_width_m, sizes.crown_base_m, leaf_area_m2)
        for name, values in zip(COLUMNS, made, strict=True):
            own = known[name][rows]
            known[name][rows] = np.where(np.isnan(own), values, own)
    known["crown_base_m"] = np.minimum(known["crown_base_m"], 0.95 * population.height_m)
    return replace(population, columns={**population.columns, **known})


def _column(population: Population, name: str) -> Floats:
    """A copy of a model's own column, or NaN."""
    if name in population.columns:
        return np.array(population.columns[name], dtype=np.float64)
    return np.full(len(population), np.nan)


def _shifts(
    population: Population, laws: Sequence[TreeSizes | None], trees: NDArray[np.bool_], site: Site, periodic: bool
) -> Floats:
    """(N,) logarithm of each tree's diameter over that of a tree in a stand, by its neighbours; 0 of other plants."""
    rows = np.flatnonzero(trees & (population.status != Status.DEAD))
    height_m = population.height_m[rows]
    crown_m2, opened, suppressed = np.zeros(len(rows)), np.zeros(len(rows)), np.zeros(len(rows))
    for index in np.unique(population.species[rows]).tolist():
        mine, law = population.species[rows] == index, laws[index]
        assert law is not None
        median = law.sizes(height_m[mine], np.zeros((int(mine.sum()), NUMBERS)))
        crown_m2[mine] = 0.25 * np.pi * median.crown_width_m**2
        opened[mine], suppressed[mine] = law.shift("open"), law.shift("suppressed")
    radius_m = np.clip(_DISC_HEIGHTS * height_m, *_DISC_M)
    near, over = _covers(population.position_m[rows, :2], height_m, crown_m2, radius_m, site.size_m, periodic)
    shift = np.zeros(len(population))
    shift[rows] = opened * np.maximum(1.0 - near / _OPEN_COVER, 0.0) + suppressed * np.minimum(over / _SHADE_COVER, 1.0)
    return shift


def _covers(
    position_m: Floats,
    height_m: Floats,
    crown_m2: Floats,
    radius_m: Floats,
    size_m: tuple[float, float],
    periodic: bool,
) -> tuple[Floats, Floats]:
    """(N,) crown area of neighbours and of taller ones over that of each tree's disc."""
    from scipy.spatial import cKDTree  # slow to import

    box = np.array(size_m)
    if periodic:
        radius_m = np.minimum(radius_m, 0.49 * float(box.min()))
        position_m = position_m % box
    tree = cKDTree(position_m, boxsize=box if periodic else None)
    near, over = np.zeros(len(position_m)), np.zeros(len(position_m))
    for start in range(0, len(position_m), _AT_ONCE):
        chunk = slice(start, start + _AT_ONCE)
        found = tree.query_ball_point(position_m[chunk], radius_m[chunk], return_sorted=True)
        counts = np.array([len(one) for one in found])
        other = np.concatenate([np.asarray(one, dtype=np.int64) for one in found])
        me = np.repeat(np.arange(start, start + len(found)), counts)
        ratio = height_m[other] / height_m[me]
        area = np.where(other == me, 0.0, crown_m2[other])
        near += np.bincount(me, np.where(ratio >= _NEIGHBOUR, area, 0.0), len(position_m))
        over += np.bincount(me, np.where(ratio >= _TALLER, area, 0.0), len(position_m))
    inside = 1.0 if periodic else _share_inside(position_m, radius_m, box)
    disc_m2 = np.pi * radius_m**2 * inside
    return near / disc_m2, over / disc_m2


def _share_inside(position_m: Floats, radius_m: Floats, box: Floats) -> Floats:
    """(N,) about what share of each disc lies on the site, by its reach in some directions."""
    angle = (np.arange(_RAYS) + 0.5) * (2.0 * np.pi / _RAYS)
    way = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    with np.errstate(divide="ignore"):
        ends = np.where(way[None] > 0, (box - position_m)[:, None] / way, -position_m[:, None] / way)
    reach = np.minimum(ends.min(axis=2) / radius_m[:, None], 1.0)
    return np.asarray(np.mean(np.maximum(reach, 0.05) ** 2, axis=1))
