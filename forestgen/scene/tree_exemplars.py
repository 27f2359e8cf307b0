"""Exemplars of trees: by height, crown width, diameter, crown base and leaf area.

Trees are told apart by the logarithms of height and crown width, of diameter and leaf area over what the width asks
for, and of the crown's length over the stem's below it. Instances get each tree's own height and width, so that the
rest of the error is in the other sizes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population
from forestgen.community.tree_columns import COLUMNS
from forestgen.core.randomness import child_rng
from forestgen.scene.exemplar_plan import TREE_SIZES, ExemplarPlan, Floats, cluster, rungs_of

LibraryTree = Callable[[str, int, int], Floats]  # species, rung, variant -> (5,) sizes

_WIDTH_WEIGHT, _BASE_WEIGHT, _LEAF_WEIGHT = 0.5, 0.4, 0.4  # against height and diameter
_LEAST_DBH_M = 0.002
_BARE = 1e-6  # leaf area over the square of the width: dead trees are told apart from all others
_MOST_STRETCH = 1.6  # of a tree's width over its height


def tree_sizes_of(population: Population) -> Floats:
    """(N, 5) sizes of each plant in the order of `TreeSize`; NaN of plants that are no trees."""
    columns = population.columns
    sizes = np.full((len(population), TREE_SIZES), np.nan)
    if not all(name in columns for name in COLUMNS):
        return sizes
    radius_m, base_m, leaf_m2 = (
        np.asarray(columns[name]) for name in ("crown_radius_m", "crown_base_m", "leaf_area_m2")
    )
    dbh_m = np.asarray(columns["dbh_m"])
    sizes[:] = np.stack([population.height_m, 2.0 * radius_m, dbh_m, base_m, leaf_m2], axis=1)
    sizes[~np.isfinite(sizes[:, [0, 1, 3, 4]]).all(axis=1)] = np.nan
    return sizes


def plan_trees(index: int, sizes: Floats, radius_m: Floats, traits: Floats, clusters: int, seed: int) -> ExemplarPlan:
    """Exemplars of a species' trees: each cluster's is built to the sizes in its middle.

    `sizes`: (n, 5) of the trees. `radius_m`: (n,) of their neighbourhoods. `traits`: (n, K) what else tells them apart,
    weighted.
    """
    low = np.isnan(sizes[:, 2])  # below breast height
    features = np.concatenate([_tree_features(sizes), traits], axis=1)
    middles, label = cluster(features, clusters, seed)
    height = np.exp(middles[:, 0])
    width = np.exp(middles[:, 1] / _WIDTH_WEIGHT)
    odds = np.exp(middles[:, 3] / _BASE_WEIGHT)
    tall = np.array([not low[label == k].any() for k in range(len(middles))], dtype=np.bool_)
    tree = np.stack(
        [
            height,
            width,
            np.where(tall, np.exp(middles[:, 2]) * width, np.nan),
            height * odds / (1.0 + odds),
            np.exp(middles[:, 4] / _LEAF_WEIGHT) * width**2,
        ],
        axis=1,
    )
    radius = np.array([np.exp(np.log(radius_m[label == k]).mean()) for k in range(len(middles))])
    return ExemplarPlan.of_species(index, radius, label, tree=tree)


def _tree_features(sizes: Floats) -> Floats:
    """(n, 5) what trees are told apart by, of their (n, 5) sizes."""
    height_m, width_m, dbh_m, base_m, leaf_m2 = sizes.T
    ratio = np.clip(base_m / height_m, 0.02, 0.98)
    columns = [
        np.log(height_m),
        _WIDTH_WEIGHT * np.log(width_m),
        np.log(np.where(np.isnan(dbh_m), _LEAST_DBH_M, dbh_m) / width_m),
        _BASE_WEIGHT * np.log(ratio / (1.0 - ratio)),
        _LEAF_WEIGHT * np.log(np.maximum(leaf_m2 / width_m**2, _BARE)),
    ]
    return np.stack(columns, axis=1)


def plan_library_trees(
    index: int,
    name: str,
    sizes: Floats,
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
    parts: list[tuple[int, int, Floats]] = []
    exemplar = np.zeros(len(sizes), dtype=np.int64)
    bare = sizes[:, 4] == 0.0  # dead
    for rung, dead in sorted(set(zip(rungs[label.reshape(-1)].tolist(), bare.tolist(), strict=True))):
        chosen = np.sort(child_rng(seed, "library", name, rung).permutation(variants)[:shown])
        made = np.array([library_tree(name, rung, int(variant)) for variant in chosen])
        made[:, 4] *= not dead
        rows = np.flatnonzero((rungs[label.reshape(-1)] == rung) & (bare == dead))
        away = np.sum((features[rows, None] - _tree_features(made)[None, :, 1:]) ** 2, axis=2)
        used, place = np.unique(np.argmin(away, axis=1), return_inverse=True)
        exemplar[rows] = len(parts) + place.reshape(-1)
        parts += [(rung, int(chosen[k]), made[k]) for k in used.tolist()]
    radius = np.array([0.5 * made[1] for *_, made in parts])  # of the library alone: images share its exemplars
    plan = ExemplarPlan.of_species(
        index,
        radius,
        exemplar,
        rank=np.array([rung for rung, _, _ in parts]),
        tree=np.array([made for _, _, made in parts]),
    )
    return replace(plan, variant=np.array([variant for _, variant, _ in parts], dtype=np.int64))


def instance_scales(
    sizes: Floats, height_m: Floats, exemplar: NDArray[np.integer], exemplar_height_m: Floats, exemplar_width_m: Floats
) -> tuple[Floats, Floats]:
    """(N,) vertical and (N,) horizontal scale of the instances of plants; one and the same but of trees.

    `sizes`: (N, 5), see `tree_sizes_of`. `exemplar`: (N,) of the (E,) exemplars. A tree's scales differ by at most
    `_MOST_STRETCH`.
    """
    upright = height_m / exemplar_height_m[exemplar]
    across = sizes[:, 1] / exemplar_width_m[exemplar] / upright
    return upright, upright * np.where(np.isnan(across), 1.0, np.clip(across, 1.0 / _MOST_STRETCH, _MOST_STRETCH))
