"""Exemplars of trees: which sizes they are built to, and what error is left."""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
import pytest
from scene_plants import population

from forestgen.api.plant_requests import drawn_of
from forestgen.community.population import Status
from forestgen.core.dead_wood import dead_codes
from forestgen.plants.build import tree_size
from forestgen.recipe.tree_sizes import own_normals
from forestgen.scene.exemplars import plan_exemplars
from forestgen.scene.tree_exemplars import instance_dbh_m, instance_scales, tree_sizes_of


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


def scaled(plants, plan):
    """(N, 5) sizes of the instances' geometry: cones as stems, leaves of all attitudes."""
    made = plan.tree[plan.exemplar_of_plant]
    upright, across = instance_scales(
        tree_sizes_of(plants), plants.height_m, plan.exemplar_of_plant, plan.tree[:, 0], plan.tree
    )
    leaf = made[:, 4] * across * np.sqrt(0.5 * (upright**2 + across**2))
    sizes = [
        made[:, 0] * upright,
        made[:, 1] * across,
        instance_dbh_m(plants.height_m, plan.exemplar_of_plant, across, plan.tree),
    ]
    return np.stack([*sizes, made[:, 3] * upright, leaf], axis=1)


def rms(values):
    return float(np.sqrt(np.nanmean(values**2)))


def test_each_trees_exemplar_is_like_it() -> None:
    """Heights are exact, leaf area is in sum, and the other errors fall with the number of exemplars."""
    _, plants = trees(800)
    sizes, errors = tree_sizes_of(plants), []
    for clusters in (6, 24):
        plan = plan_exemplars(plants, clusters, 1)
        assert len(plan) == clusters
        made = scaled(plants, plan)
        np.testing.assert_allclose(made[:, 0], plants.height_m)
        assert made[:, 4].sum() == pytest.approx(sizes[:, 4].sum(), rel=0.02)
        errors.append([rms(made[:, k] / sizes[:, k] - 1.0) for k in (1, 2, 4)])
        errors[-1].append(rms((made - sizes)[:, 3] / sizes[:, 0]))
        assert np.all(plan.tree[:, 3] < plan.tree[:, 0])
    assert np.all(np.array(errors[1]) < errors[0])
    assert errors[1][0] < 0.06
    assert errors[1][1] < 0.06
    assert errors[1][3] < 0.09


def test_a_trees_width_follows_its_crown_and_its_diameter_half_each() -> None:
    """Twice as stout as its exemplar: diameter and width are off by the root of two, to either side."""
    exemplar = np.array([[10.0, 3.0, 0.12, 4.0, 50.0]])
    sizes = np.array(
        [[10.0, 3.0, 0.24, 4.0, 50.0], [20.0, 6.0, 0.24 * 18.7 / 17.4, 8.0, 200.0], [1.2, 0.4, np.nan, 0.5, 1.0]]
    )
    upright, across = instance_scales(sizes, sizes[:, 0], np.zeros(3, dtype=np.int64), np.array([10.0]), exemplar)
    np.testing.assert_allclose(upright, [1.0, 2.0, 0.12])
    np.testing.assert_allclose(across, [np.sqrt(2.0), 2.0, 0.4 / 3.0])


@pytest.mark.parametrize("clusters", [1, 3, 4, 9])
def test_living_and_dead_low_and_tall_trees_have_exemplars_of_their_own(clusters) -> None:
    """At least one of each kind, and no more than asked for where that is enough."""
    _, plants = trees(300)
    plants.columns["leaf_area_m2"][::5] = 0.0  # type: ignore[index]
    plants.height_m[1::7] = 1.0
    plants.columns["dbh_m"][1::7] = np.nan  # type: ignore[index]
    plan = plan_exemplars(plants, clusters, 1)
    assert len(plan) == max(clusters, 4)
    own, made = tree_sizes_of(plants), plan.tree[plan.exemplar_of_plant]
    np.testing.assert_array_equal(made[:, 4] > 0.0, own[:, 4] > 0.0)
    np.testing.assert_array_equal(np.isnan(made[:, 2]), np.isnan(own[:, 2]))


def test_a_library_shows_each_tree_the_variant_most_like_it() -> None:
    species, plants = trees(300)

    def made(name: str, rung: int, variant: int, code: int) -> np.ndarray:
        height_m = np.array([1.25**rung])
        sizes = species.tree.sizes(height_m, own_normals(1000 + rung, np.array([variant], dtype=np.uint64)))
        return np.array(astuple(tree_size(species, float(height_m[0]), sizes)))

    few, many = (plan_exemplars(plants, 8, 1, variants=shown, library=6, library_tree=made) for shown in (1, 6))
    assert len(many) > len(few)
    sizes = tree_sizes_of(plants)
    errors = []
    for plan in (few, many):
        assert np.all(plan.variant < 6)
        errors.append(np.nanmedian(np.abs(np.log(scaled(plants, plan)[:, 2] / sizes[:, 2]))))
    assert errors[1] < errors[0]
    again = plan_exemplars(plants, 8, 1, variants=6, library=6, library_tree=made)
    np.testing.assert_array_equal(again.tree, many.tree)


def test_dead_trees_have_exemplars_without_leaves_and_a_librarys_size_is_no_images_own() -> None:
    species, plants = trees(200)
    dead = np.arange(200) % 7 == 0
    plants.columns["leaf_area_m2"][dead] = 0.0  # type: ignore[index]
    plants.status[dead] = Status.DEAD

    def made(name: str, rung: int, variant: int, code: int) -> np.ndarray:
        height_m = np.array([1.25**rung])
        sizes = species.tree.sizes(height_m, own_normals(1000 + rung, np.array([variant], dtype=np.uint64)))
        return np.array(astuple(tree_size(species, float(height_m[0]), sizes))) * [1, 1, 1, 1, code == 0]

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


def test_each_form_and_class_of_the_dead_has_exemplars_and_the_living_keep_theirs() -> None:
    _, plants = trees(200)
    alone = plan_exemplars(plants, 6, 1)
    form, decay = np.zeros((2, 200), dtype=np.uint8)
    dead = np.arange(200) % 4 == 0
    form[dead], decay[dead] = 1 + np.arange(50) % 4, 1 + np.arange(50) % 5
    plants.columns["leaf_area_m2"][dead] = 0.0  # type: ignore[index]
    plants.status[dead] = Status.DEAD
    columns = {**plants.columns, "dead_form": form, "decay_class": decay}
    plan = plan_exemplars(replace(plants, columns=columns), 6, 1)
    np.testing.assert_array_equal(plan.dead[plan.exemplar_of_plant], dead_codes(form, decay))
    assert np.sum(plan.dead == 0) == 6 == len(alone)
    assert len(np.unique(plan.dead)) == 21
    again = plan_exemplars(plants.at(~dead), 6, 1)
    np.testing.assert_array_equal(plan.tree[:6], again.tree)


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
