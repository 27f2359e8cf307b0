"""From many plants to few exemplars."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.community.population import Population
from forestgen.core.errors import RecipeError
from forestgen.scene.exemplars import check_traits, plan_exemplars, size_errors
from support.error_messages import raises_error


def population(radius_m, species=None, names=("a", "b"), height_m=None) -> Population:
    radius = np.asarray(radius_m, dtype=np.float64)
    n = len(radius)
    kind = np.zeros(n, np.uint16) if species is None else np.asarray(species, dtype=np.uint16)
    return Population(
        time_yr=0.0,
        species_names=names,
        plant_id=np.arange(1, n + 1, dtype=np.uint32),
        species=kind,
        position_m=np.zeros((n, 3)),
        radius_m=radius,
        height_m=radius * 5 if height_m is None else np.asarray(height_m, dtype=np.float64),
        age_yr=np.zeros(n),
        status=np.zeros(n, np.uint8),
    )


def test_separated_clusters_are_found_and_their_geometric_means_taken():
    rng = np.random.default_rng(0)
    groups = [np.exp(rng.normal(np.log(r), 0.02, 50)) for r in (0.2, 1.0, 4.0)]
    order = rng.permutation(150)
    plants = population(np.concatenate(groups)[order])
    plan = plan_exemplars(plants, 3, seed=0)
    expected = [np.exp(np.log(group).mean()) for group in groups]
    np.testing.assert_allclose(plan.radius_m, expected, rtol=1e-6)
    np.testing.assert_array_equal(plan.exemplar_of_plant, (np.arange(150) // 50)[order])


def test_every_plant_has_the_nearest_exemplar_of_its_species():
    rng = np.random.default_rng(1)
    plants = population(rng.lognormal(0, 0.8, 300), rng.integers(0, 2, 300))
    plan = plan_exemplars(plants, 6, seed=2)
    assert list(plan.species) == [0] * 6 + [1] * 6
    np.testing.assert_array_equal(plan.species[plan.exemplar_of_plant], plants.species)
    for row in range(300):
        mine = np.flatnonzero(plan.species == plants.species[row])
        distance = np.abs(np.log(plan.radius_m[mine] / plants.radius_m[row]))
        assert plan.exemplar_of_plant[row] == mine[np.argmin(distance)]


def test_fewer_sizes_than_exemplars_gives_one_each():
    plan = plan_exemplars(population([2.0, 1.0, 2.0, 3.0]), 10, seed=0)
    np.testing.assert_allclose(plan.radius_m, [1, 2, 3])
    np.testing.assert_array_equal(plan.exemplar_of_plant, [1, 0, 1, 2])


@pytest.mark.parametrize("k", [1, 10])
def test_a_single_plant(k):
    plan = plan_exemplars(population([1.7], [1]), k, seed=0)
    np.testing.assert_allclose(plan.radius_m, [1.7])
    assert list(plan.species) == [1]
    assert list(plan.exemplar_of_plant) == [0]


def test_no_plant_no_exemplar():
    plan = plan_exemplars(population([]), 10, seed=0)
    assert len(plan.radius_m) == len(plan.species) == len(plan.exemplar_of_plant) == 0


def test_the_plan_belongs_to_the_seed_and_the_species_name():
    rng = np.random.default_rng(3)
    radius = rng.lognormal(0, 0.8, 200)
    one = plan_exemplars(population(radius, np.zeros(200), ("a", "b")), 8, seed=5)
    again = plan_exemplars(population(radius, np.zeros(200), ("a", "b")), 8, seed=5)
    beside = plan_exemplars(
        population(np.concatenate([radius, [9.0]]), np.concatenate([np.ones(200), [0]]), ("b", "a")), 8, seed=5
    )
    np.testing.assert_array_equal(one.radius_m, again.radius_m)
    np.testing.assert_array_equal(one.radius_m, beside.radius_m[1:])


def test_the_reported_error_is_the_definition_and_shrinks_with_more_exemplars():
    rng = np.random.default_rng(4)
    plants = population(rng.lognormal(0, 0.7, 400), names=("a",))
    errors = []
    for k in (1, 3, 10, 40):
        plan = plan_exemplars(plants, k, seed=1)
        height, width = plan.radius_m * 5, plan.radius_m * 2
        [error] = size_errors(plants, plan, height, width, plants.radius_m**0.9 * 2)
        mine = plan.exemplar_of_plant
        relative = plan.radius_m[mine] / plants.radius_m - 1
        assert error.radius_rms == pytest.approx(np.sqrt(np.mean(relative**2)))
        scaled = width[mine] * plants.height_m / height[mine]
        assert error.crown_width_rms == pytest.approx(np.sqrt(np.mean((scaled / (plants.radius_m**0.9 * 2) - 1) ** 2)))
        assert (error.species, error.plants, error.exemplars) == ("a", 400, k)
        errors.append(error.radius_rms)
    assert errors[0] > 2 * errors[1] > 4 * errors[2] > 8 * errors[3]


def test_plants_without_a_crown_have_no_error_of_its_width():
    plants = population([0.5, 1.0, 1.5], np.array([0, 1, 1]), ("birch", "snag"))
    plan = plan_exemplars(plants, 1, seed=0)
    width = np.where(plants.species == 0, plants.radius_m, np.nan)
    birch, snag = size_errors(plants, plan, plan.radius_m * 5, plan.radius_m, width)
    assert birch.crown_width_rms == 0.0
    assert snag.crown_width_rms is None
    assert snag.radius_rms > 0


def test_as_many_exemplars_as_plants_leave_no_error():
    plants = population([0.5, 1.0, 1.5], names=("a",))
    plan = plan_exemplars(plants, 3, seed=0)
    [error] = size_errors(plants, plan, plan.radius_m * 5, plan.radius_m, plants.radius_m)
    assert error.radius_rms == error.crown_width_rms == 0.0


def with_columns(plants: Population, age_yr=None, **columns) -> Population:
    return replace(plants, age_yr=plants.age_yr if age_yr is None else np.asarray(age_yr, float), columns=columns)


def test_a_trait_separates_what_the_size_does_not():
    rng = np.random.default_rng(5)
    young = rng.random(200) < 0.5
    plants = with_columns(population(np.full(200, 1.3)), np.where(young, 5.0, 80.0) + rng.normal(0, 1, 200))
    assert len(plan_exemplars(plants, 2, seed=0)) == 1
    plan = plan_exemplars(plants, 2, seed=0, traits=["age_yr"])
    assert len(plan) == 2
    np.testing.assert_allclose(plan.radius_m, 1.3)
    assert {tuple(np.unique(plan.exemplar_of_plant[group])) for group in (young, ~young)} == {(0,), (1,)}
    np.testing.assert_array_equal(plan.rank, [0, 1])


def test_a_trait_counts_half_as_much_as_the_size_and_in_no_unit():
    rng = np.random.default_rng(6)
    size, trait = rng.normal(size=(2, 4000))
    plants = with_columns(population(np.exp(0.5 * size)), vigour=trait)
    plan = plan_exemplars(plants, 2, seed=0, traits=["vigour"])
    one = plan.exemplar_of_plant == 0
    # Two clusters of a cloud twice as long in one direction part along it.
    apart = [abs(values[one].mean() - values[~one].mean()) for values in (size, trait)]
    assert apart[0] > 1.4 > 0.4 > apart[1]
    scaled = with_columns(plants, vigour=1e6 * trait + 3e4)
    again = plan_exemplars(scaled, 2, seed=0, traits=["vigour"])
    np.testing.assert_array_equal(again.exemplar_of_plant, plan.exemplar_of_plant)


def test_traits_that_are_no_numbers_or_all_alike_do_no_harm():
    rng = np.random.default_rng(7)
    trait = rng.normal(size=300)
    trait[::7] = np.nan
    plants = with_columns(population(rng.lognormal(0, 0.5, 300)), odd=trait, same=np.ones(300))
    assert len(plan_exemplars(plants, 5, seed=0, traits=["odd", "same"])) == 5
    plain, same = (plan_exemplars(plants, 5, seed=0, traits=traits) for traits in ([], ["same"]))
    np.testing.assert_allclose(plain.radius_m, same.radius_m)


def test_an_unknown_trait_is_refused_with_the_columns_there_are():
    plants = with_columns(population([1.0]), vigour=np.ones(1), word=np.array(["a"]))
    check_traits(["age_yr", "height_m", "vigour"], plants, "here")
    with raises_error(RecipeError, place="here") as refused:
        check_traits(["vigor"], plants, "here")
    assert "word" not in str(refused.value)


def test_variants_share_a_size_and_a_plant_keeps_its_own():
    rng = np.random.default_rng(8)
    plants = population(rng.lognormal(0, 0.8, 300), names=("a",))
    plain, plan = (plan_exemplars(plants, 6, seed=2, variants=variants) for variants in (1, 3))
    assert len(plan) == 18
    np.testing.assert_array_equal(plan.rank[plan.exemplar_of_plant], plain.rank[plain.exemplar_of_plant])
    np.testing.assert_array_equal(plan.radius_m[plan.exemplar_of_plant], plain.radius_m[plain.exemplar_of_plant])
    assert len({*zip(plan.rank, plan.variant, strict=True)}) == 18
    mine = plan.variant[plan.exemplar_of_plant]
    assert np.bincount(mine).min() > 70  # of 100; 4 standard deviations are 33
    kept = rng.random(300) < 0.6  # the others die
    fewer = replace(
        plants,
        **{
            name: getattr(plants, name)[kept]
            for name in ("plant_id", "species", "position_m", "radius_m", "height_m", "age_yr", "status")
        },
    )
    later = plan_exemplars(fewer, 6, seed=2, variants=3)
    np.testing.assert_array_equal(later.variant[later.exemplar_of_plant], mine[kept])


def test_a_variant_that_no_plant_has_is_not_grown():
    plan = plan_exemplars(population([1.0, 2.0]), 10, seed=0, variants=50)
    assert len(plan) == 2
    assert sorted(plan.exemplar_of_plant) == [0, 1]


def test_levels_split_exemplars_by_what_their_plants_need():
    plants = population([1.0, 1.0, 2.0, 2.0, 3.0], [0, 0, 0, 0, 1])
    plan = plan_exemplars(plants, 10, seed=0).split("level", np.array([0, 2, 1, 1, 0]))
    np.testing.assert_allclose(plan.radius_m, [1, 1, 2, 3])
    np.testing.assert_array_equal(plan.level, [0, 2, 1, 0])
    np.testing.assert_array_equal(plan.species, [0, 0, 0, 1])
    np.testing.assert_array_equal(plan.exemplar_of_plant, [0, 1, 2, 2, 3])
    first = plants.plant_id[[0, 0, 2, 4]]  # levels of one plant have the same
    np.testing.assert_array_equal(plan.first_plant(plants.plant_id), first)
