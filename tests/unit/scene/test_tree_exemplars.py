"""Exemplars of trees: which sizes they are built to, and what error is left."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
from scene_plants import population

from forestgen.api.plant_requests import drawn_of
from forestgen.plants.build import tree_size
from forestgen.recipe.tree_sizes import own_normals
from forestgen.scene.exemplars import plan_exemplars
from forestgen.scene.tree_exemplars import instance_scales, tree_sizes_of


def trees(count: int):
    """A population of spruces, all of one species, with sizes drawn from the allometries."""
    species = drawn_of("spruce", 0).species["spruce"]
    assert species.tree is not None
    plants = population(count, np.random.default_rng(2))
    object.__setattr__(plants, "species", np.zeros(count, dtype=np.uint16))
    made = species.tree.sizes(plants.height_m, own_normals(3, plants.plant_id))
    leaf_area_m2 = made.leaf_kg / species.tissue.leaf_mass_per_area_kg_per_m2
    object.__setattr__(
        plants,
        "columns",
        {
            "dbh_m": made.dbh_m,
            "crown_radius_m": 0.5 * made.crown_width_m,
            "crown_base_m": made.crown_base_m,
            "leaf_area_m2": leaf_area_m2,
        },
    )
    return species, plants


def test_each_trees_exemplar_is_like_it() -> None:
    """With 24 exemplars for 800 trees of all heights the scaled diameter is within 15% (root mean square)."""
    _, plants = trees(800)
    sizes = tree_sizes_of(plants)
    errors = []
    for clusters in (6, 24):
        plan = plan_exemplars(plants, clusters, 1)
        assert len(plan) == clusters
        mine = plan.exemplar_of_plant
        _, across = instance_scales(sizes, plants.height_m, mine, plan.tree[:, 0], plan.tree[:, 1])
        known = np.isfinite(sizes[:, 2]) & np.isfinite(plan.tree[mine, 2])
        assert known.mean() > 0.8
        errors.append(np.sqrt(np.mean((plan.tree[mine, 2] * across / sizes[:, 2] - 1.0)[known] ** 2)))
        assert np.all(plan.tree[:, 3] < plan.tree[:, 0])
    assert errors[1] < errors[0]
    assert errors[1] < 0.15


def test_a_library_shows_each_tree_the_variant_most_like_it() -> None:
    species, plants = trees(300)

    def made(name: str, rung: int, variant: int) -> np.ndarray:
        height_m = np.array([1.25**rung])
        sizes = species.tree.sizes(height_m, own_normals(1000 + rung, np.array([variant], dtype=np.uint64)))
        return np.array(astuple(tree_size(species, float(height_m[0]), sizes)))

    few, many = (plan_exemplars(plants, 8, 1, variants=shown, library=6, library_tree=made) for shown in (1, 6))
    assert len(many) > len(few)
    sizes = tree_sizes_of(plants)
    errors = []
    for plan in (few, many):
        assert np.all(plan.variant < 6)
        mine = plan.exemplar_of_plant
        _, across = instance_scales(sizes, plants.height_m, mine, plan.tree[:, 0], plan.tree[:, 1])
        errors.append(np.nanmedian(np.abs(np.log(plan.tree[mine, 2] * across / sizes[:, 2]))))
    assert errors[1] < errors[0]
    again = plan_exemplars(plants, 8, 1, variants=6, library=6, library_tree=made)
    np.testing.assert_array_equal(again.tree, many.tree)


def test_dead_trees_have_exemplars_without_leaves_and_a_librarys_size_is_no_images_own() -> None:
    species, plants = trees(200)
    dead = np.arange(200) % 7 == 0
    plants.columns["leaf_area_m2"][dead] = 0.0  # type: ignore[index]

    def made(name: str, rung: int, variant: int) -> np.ndarray:
        height_m = np.array([1.25**rung])
        sizes = species.tree.sizes(height_m, own_normals(1000 + rung, np.array([variant], dtype=np.uint64)))
        return np.array(astuple(tree_size(species, float(height_m[0]), sizes)))

    for keys in ({}, {"library": 4, "variants": 2, "library_tree": made}):
        plan = plan_exemplars(plants, 12, 1, **keys)  # type: ignore[arg-type]
        leaf_m2 = plan.tree[plan.exemplar_of_plant, 4] / plan.tree[plan.exemplar_of_plant, 1] ** 2
        assert np.all(leaf_m2[dead] < 1e-5)
        assert np.all(leaf_m2[~dead] > 1e-2)
        assert np.isfinite(plan.tree[:, [0, 1, 3, 4]]).all()
    few = plants.at(np.arange(50))
    for one in (plants, few):
        plan = plan_exemplars(one, 12, 1, library=4, variants=4, library_tree=made)
        np.testing.assert_allclose(plan.radius_m, 0.5 * plan.tree[:, 1])


def test_traits_count_for_trees_too() -> None:
    """Trees of two ages and the same sizes have exemplars of their own where the age is a trait."""
    _, plants = trees(60)
    object.__setattr__(plants, "age_yr", np.where(np.arange(60) % 2, 100.0, 10.0))
    for name in ("dbh_m", "crown_radius_m", "crown_base_m", "leaf_area_m2"):
        plants.columns[name][:] = plants.columns[name][0]  # type: ignore[index]
    object.__setattr__(plants, "height_m", np.full(60, plants.height_m[0]))
    object.__setattr__(plants, "radius_m", np.full(60, 1.0))
    assert len(plan_exemplars(plants, 6, 1)) == 1
    old = plan_exemplars(plants, 6, 1, traits=["age_yr"])
    assert len(old) == 2
    assert len(np.unique(old.exemplar_of_plant[::2])) == len(np.unique(old.exemplar_of_plant[1::2])) == 1
