"""Exemplars of trees: by height, crown width, diameter, crown base and leaf area.

Trees above and below breast height have exemplars of their own: at least one each, even where that is more than a
recipe asks for; the others go where trees differ most. So have the dead, of each form and decay class, half as many as
the living. Leaf-out and leaf fall split exemplars
later (`ExemplarPlan.split`), so that a stand keeps its stems and branches through the year.

An instance has its tree's height. Its width goes by the tree's crown width and diameter, half each: with one scale for
both, what an exemplar is too thick for its width is divided between them. Stems count by their cone's diameter at the
ground, which goes with the scales, not by that at breast height, which after scaling is elsewhere on the stem. Clusters
are of what scales leave wrong, weighted by how much that matters, and of the scales themselves, since leaves and twigs
change with them. The leaf area of a cluster's trees is that of their instances, in sum.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population
from forestgen.community.tree_columns import COLUMNS
from forestgen.core.frames import BREAST_HEIGHT_M
from forestgen.core.randomness import child_rng
from forestgen.scene.exemplar_plan import TREE_SIZES, ExemplarPlan, Floats, Ints, cluster_groups, rungs_of

LibraryTree = Callable[[str, int, int, int], Floats]  # species, rung, variant, code of the dead -> (5,) sizes

# What k-means tells trees apart by: errors of diameter and width (each is half of what is left), of the crown's base
# as a share of the height and of leaf area count by the first three, scales of height and of width over height by the
# others. Chosen by the errors on the shipped recipes (docs/adr/0018-exemplars-of-trees.md).
_STOUT_WEIGHT, _BASE_WEIGHT, _LEAF_WEIGHT, _HEIGHT_WEIGHT, _WIDE_WEIGHT = 0.7, 1.2, 0.4, 0.5, 0.3
_LEAST_CONE = 0.1  # height above breast height over height, of trees that have a diameter
_MOST_STRETCH = 1.6  # of a tree's width over its height


def tree_sizes_of(population: Population) -> Floats:
    """(N, 5) sizes of each plant in the order of `TreeSize`; NaN of plants that are no trees."""
    if not all(name in population.columns for name in COLUMNS):
        return np.full((len(population), TREE_SIZES), np.nan)
    dbh_m, radius_m, base_m, leaf_m2 = (np.asarray(population.columns[name], dtype=np.float64) for name in COLUMNS)
    sizes = np.stack([population.height_m, 2.0 * radius_m, dbh_m, base_m, leaf_m2], axis=1)
    sizes[~np.isfinite(sizes[:, [0, 1, 3, 4]]).all(axis=1)] = np.nan
    return sizes


def plan_trees(
    index: int, sizes: Floats, radius_m: Floats, traits: Floats, dead: Ints, clusters: int, seed: int
) -> ExemplarPlan:
    """Exemplars of a species' trees: each cluster's is built to the sizes in its middle.

    `sizes`: (n, 5) of the trees. `radius_m`: (n,) of their neighbourhoods. `traits`: (n, K) what else tells them apart,
    weighted. `dead`: (n,) codes, see `ExemplarPlan.dead`.
    """
    features = np.concatenate([_tree_features(sizes), _HEIGHT_WEIGHT * traits], axis=1)
    label = np.zeros(len(sizes), dtype=np.int64)
    first = 0
    for many, rows in ((clusters, dead == 0), (max(1, clusters // 2), dead > 0)):
        if rows.any():
            label[rows] = first + cluster_groups(features[rows], _groups(sizes[rows], dead[rows]), many, seed)
            first = int(label[rows].max()) + 1
    height_m, width_m, _, base_m, leaf_m2 = sizes.T
    count = np.bincount(label)

    def middle(values: Floats) -> Floats:
        return np.asarray(np.exp(np.bincount(label, np.log(values)) / count))

    height, width, foot, radius = (middle(one) for one in (height_m, width_m, _foot_m(sizes), radius_m))
    upright, across = height_m / height[label], np.sqrt(width_m * _foot_m(sizes) / (width * foot)[label])
    grown = across * np.sqrt(0.5 * (upright**2 + across**2))  # of leaves of all attitudes
    base = height * np.bincount(label, base_m / height_m) / count
    dbh = np.where(np.bincount(label, np.isnan(sizes[:, 2])), np.nan, foot * _cone(height))
    leaf = np.bincount(label, leaf_m2) / np.bincount(label, grown)
    code = np.zeros(len(height), dtype=np.int64)
    code[label] = dead
    tree = np.stack([height, width, dbh, base, leaf], axis=1)
    return ExemplarPlan.of_species(index, radius, label, tree=tree, dead=code)


def _groups(sizes: Floats, dead: Ints) -> Ints:
    """(n,) which trees never share an exemplar: by form and class of the dead, above and below breast height."""
    return np.asarray(4 * dead + 2 * (sizes[:, 4] == 0.0) + np.isnan(sizes[:, 2]), dtype=np.int64)


def _cone(height_m: Floats) -> Floats:
    """(n,) diameter of a cone at breast height over that at its foot."""
    return np.maximum(1.0 - BREAST_HEIGHT_M / height_m, _LEAST_CONE)


def _foot_m(sizes: Floats) -> Floats:
    """(n,) diameter at the ground of a cone as thick as the stem at breast height; of lower trees the crown's width."""
    return np.where(np.isnan(sizes[:, 2]), sizes[:, 1], sizes[:, 2] / _cone(sizes[:, 0]))


def _tree_features(sizes: Floats) -> Floats:
    """(n, 5) coordinates in which trees are clustered, of their (n, 5) sizes; the first is the height's."""
    height_m, width_m, _, base_m, leaf_m2 = sizes.T
    foot_m = _foot_m(sizes)
    side = np.sqrt(width_m * foot_m)
    density = np.where(leaf_m2 > 0.0, leaf_m2, 1.0) / np.where(leaf_m2 > 0.0, side**1.5 * height_m**0.5, 1.0)
    columns = [
        _HEIGHT_WEIGHT * np.log(height_m),
        _WIDE_WEIGHT * np.log(side / height_m),
        _STOUT_WEIGHT * np.log(foot_m / width_m),
        _BASE_WEIGHT * base_m / height_m,
        _LEAF_WEIGHT * np.log(density),
    ]
    return np.stack(columns, axis=1)


def plan_library_trees(
    index: int,
    name: str,
    sizes: Floats,
    dead: Ints,
    per_species: int,
    seed: int,
    counts: tuple[int, int],
    library_tree: LibraryTree,
) -> ExemplarPlan:
    """Exemplars of a library: each tree's is the one most like it of those that the image shows at its rung.

    `counts`: variants of the library, and of these in an image.
    """
    rungs, label = np.unique(rungs_of(sizes[:, 0], per_species), return_inverse=True)
    variants, shown = counts
    features = _tree_features(sizes)[:, 1:]
    parts: list[tuple[int, int, Floats, int]] = []
    exemplar = np.zeros(len(sizes), dtype=np.int64)
    for rung, code in sorted(set(zip(rungs[label.reshape(-1)].tolist(), dead.tolist(), strict=True))):
        chosen = np.sort(child_rng(seed, "library", name, rung).permutation(variants)[:shown])
        made = np.array([library_tree(name, rung, int(variant), code) for variant in chosen])
        rows = np.flatnonzero((rungs[label.reshape(-1)] == rung) & (dead == code))
        away = np.sum((features[rows, None] - _tree_features(made)[None, :, 1:]) ** 2, axis=2)
        used, place = np.unique(np.argmin(away, axis=1), return_inverse=True)
        exemplar[rows] = len(parts) + place.reshape(-1)
        parts += [(rung, int(chosen[k]), made[k], code) for k in used.tolist()]
    radius = np.array([0.5 * made[1] for _, _, made, _ in parts])  # of the library alone: images share its exemplars
    plan = ExemplarPlan.of_species(
        index,
        radius,
        exemplar,
        rank=np.array([rung for rung, *_ in parts]),
        tree=np.array([made for _, _, made, _ in parts]),
        dead=np.array([code for *_, code in parts], dtype=np.int64),
    )
    return replace(plan, variant=np.array([variant for _, variant, *_ in parts], dtype=np.int64))


def instance_scales(
    sizes: Floats, height_m: Floats, exemplar: NDArray[np.integer], exemplar_height_m: Floats, tree: Floats
) -> tuple[Floats, Floats]:
    """(N,) vertical and (N,) horizontal scale of the instances of plants; one and the same but of trees.

    `sizes`: (N, 5), see `tree_sizes_of`. `exemplar`: (N,) of the (E,) exemplars. `tree`: (E, 5) sizes of these. A
    tree's scales differ by at most `_MOST_STRETCH`. Of the dead the diameter counts, not the crown.
    """
    upright, made = height_m / exemplar_height_m[exemplar], tree[exemplar]
    wide, stout = sizes[:, 1] / made[:, 1], _foot_m(sizes) / _foot_m(made)
    bare = (made[:, 4] == 0.0) & np.isfinite(sizes[:, 2] + made[:, 2])
    wide, stout = (np.where(bare, sizes[:, 2] / made[:, 2], one) for one in (wide, stout))
    stout = np.where(np.isnan(sizes[:, 2] + made[:, 2]), wide, stout)
    stretch = np.clip(np.sqrt(wide * stout) / upright, 1.0 / _MOST_STRETCH, _MOST_STRETCH)
    return upright, upright * np.where(np.isnan(stretch), 1.0, stretch)


def instance_dbh_m(height_m: Floats, exemplar: NDArray[np.integer], across: Floats, tree: Floats) -> Floats:
    """(N,) diameters at breast height of the instances of trees, their stems as cones; NaN of low trees.

    `across`: (N,) horizontal scale, see `instance_scales`. `tree`: (E, 5) sizes of the exemplars.
    """
    made = tree[exemplar]
    return np.asarray(made[:, 2] * across * _cone(height_m) / _cone(made[:, 0]))
