"""Sizes of a community's trees: diameter, crown radius, crown base and leaf area, beside the heights.

Where a model does not say itself, they follow from a tree's height by its species' allometries
(`recipe.tree_sizes`), from numbers of the tree's own, and from its neighbours:

- c: crowns of neighbours at least 0.6 times as tall, over the area of a disc of 0.4 heights around the tree.
  A tree without any is open-grown; from 0.6 on it is of a stand.
- o: the same of trees at least 1.25 times as tall. From 0.7 on the tree is suppressed.

In between the logarithm of the diameter changes in proportion. Crowns count by the median of their species at their
height. A dead tree grew among all trees, dead ones too; a living one does not count the dead. Beyond a site that does
not repeat there is more of the same: the part of a disc outside counts as the part inside.

A dead tree has no leaves unless a model gives it some.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.community.competition.grid import near as is_near
from forestgen.community.competition.grid import span, wrapped
from forestgen.community.population import Floats, Population, Site, SpeciesEcology, Status
from forestgen.core.compiled import compiled
from forestgen.core.randomness import child_root
from forestgen.recipe.tree_sizes import NUMBERS, TreeSizes, own_normals

COLUMNS = ("dbh_m", "crown_radius_m", "crown_base_m", "leaf_area_m2")
HIGHEST_BASE = 0.95  # of a crown over the height
_DISC_HEIGHTS, _DISC_M = 0.4, (2.0, 12.0)
_NEIGHBOUR, _TALLER = 0.6, 1.25  # heights over the tree's
_OPEN_COVER, _SHADE_COVER = 0.6, 0.7
_RAYS = 16  # directions in which a disc's part inside the site is measured


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
    nothing = np.full(len(population), np.nan)
    known = {name: np.array(population.columns.get(name, nothing), dtype=np.float64) for name in COLUMNS}
    if not np.isnan([known[name][trees] for name in COLUMNS]).any():
        return population
    dead = population.status == Status.DEAD
    known["leaf_area_m2"][trees & dead & np.isnan(known["leaf_area_m2"])] = 0.0
    shift, rows = np.zeros(len(population)), np.flatnonzero(trees)
    shift[rows] = competition_shifts(
        population.position_m[rows, :2],
        population.species[rows],
        population.height_m[rows],
        laws,
        site,
        periodic=periodic,
        dead=dead[rows],
    )
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
    known["crown_base_m"] = np.minimum(known["crown_base_m"], HIGHEST_BASE * population.height_m)
    return replace(population, columns={**population.columns, **known})


def competition_shifts(
    position_m: Floats,
    species: NDArray[np.integer],
    height_m: Floats,
    laws: Sequence[TreeSizes | None],
    site: Site,
    *,
    periodic: bool,
    dead: NDArray[np.bool_] | None = None,
) -> Floats:
    """(N,) logarithm of the diameter over that of a tree in a stand, by the neighbours.

    `position_m`: (N, 2). `species`: (N,) index in `laws`, which has a law for each of them. `dead`: (N,) trees that
    count as neighbours of one another alone; None: all live.
    """
    if dead is not None and dead.any():
        shift = competition_shifts(position_m, species, height_m, laws, site, periodic=periodic)
        live = ~dead
        own = position_m[live], species[live], height_m[live]
        shift[live] = competition_shifts(*own, laws, site, periodic=periodic)
        return shift
    crown_m2, opened, suppressed = (np.zeros(len(height_m)) for _ in range(3))
    for index in np.unique(species).tolist():
        mine, law = species == index, laws[index]
        assert law is not None
        median = law.sizes(height_m[mine], np.zeros((int(mine.sum()), NUMBERS)))
        crown_m2[mine] = 0.25 * np.pi * median.crown_width_m**2
        opened[mine], suppressed[mine] = law.shift("open"), law.shift("suppressed")
    radius_m = np.clip(_DISC_HEIGHTS * height_m, *_DISC_M)
    near, over = _covers(position_m, height_m, crown_m2, radius_m, site.size_m, periodic)
    return opened * np.maximum(1.0 - near / _OPEN_COVER, 0.0) + suppressed * np.minimum(over / _SHADE_COVER, 1.0)


def _covers(
    position_m: Floats,
    height_m: Floats,
    crown_m2: Floats,
    radius_m: Floats,
    size_m: tuple[float, float],
    periodic: bool,
) -> tuple[Floats, Floats]:
    """(N,) crown area of neighbours and of taller ones over that of each tree's disc."""
    box = np.array(size_m)
    if periodic:
        radius_m = np.minimum(radius_m, 0.49 * float(box.min()))
        position_m = position_m % box
    reach = float(radius_m.max(initial=_DISC_M[0]))
    cells = np.maximum(1, np.minimum(box / reach, 2000).astype(np.int64))
    at = np.minimum((position_m / box * cells).astype(np.int64), cells - 1)
    cell = at[:, 1] * cells[0] + at[:, 0]
    order = np.argsort(cell, kind="stable")
    start = np.searchsorted(cell[order], np.arange(int(cells.prod()) + 1))
    near, over = np.zeros(len(position_m)), np.zeros(len(position_m))
    trees = np.stack([*position_m.T, height_m, crown_m2, radius_m], axis=1)[order]
    _sum_near(trees, start, (int(cells[0]), int(cells[1])), (float(box[0]), float(box[1])), periodic, near, over)
    inside = 1.0 if periodic else _share_inside(trees[:, :2], trees[:, 4], box)
    disc_m2 = np.pi * trees[:, 4] ** 2 * inside
    back = np.argsort(order, kind="stable")
    return (near / disc_m2)[back], (over / disc_m2)[back]


@compiled
def _sum_near(trees, start, n, size_m, periodic, near, over):  # type: ignore[no-untyped-def]
    """Sum crown areas around each of `trees` (N, 5: x, y, height, crown, reach), sorted by cell, into near and over."""
    per_x, per_y = n[0] / size_m[0], n[1] / size_m[1]
    for i in range(len(trees)):
        x, y, height, reach = trees[i, 0], trees[i, 1], trees[i, 2], trees[i, 4]
        x0, across = span(x * per_x, reach * per_x, n[0], periodic)
        y0, along = span(y * per_y, reach * per_y, n[1], periodic)
        for b in range(along):
            for a in range(across):
                cell = wrapped(y0 + b, n[1]) * n[0] + wrapped(x0 + a, n[0])
                for j in range(start[cell], start[cell + 1]):
                    ratio = trees[j, 2] / height
                    if (
                        ratio < _NEIGHBOUR
                        or j == i
                        or not is_near(x, y, trees[j, 0], trees[j, 1], reach, size_m, periodic)
                    ):
                        continue
                    near[i] += trees[j, 3]
                    if ratio >= _TALLER:
                        over[i] += trees[j, 3]


def _share_inside(position_m: Floats, radius_m: Floats, box: Floats) -> Floats:
    """(N,) about what share of each disc lies on the site, by its reach in some directions."""
    angle = (np.arange(_RAYS) + 0.5) * (2.0 * np.pi / _RAYS)
    way = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    with np.errstate(divide="ignore"):
        ends = np.where(way[None] > 0, (box - position_m)[:, None] / way, -position_m[:, None] / way)
    reach = np.minimum(ends.min(axis=2) / radius_m[:, None], 1.0)
    return np.asarray(np.mean(np.maximum(reach, 0.05) ** 2, axis=1))
