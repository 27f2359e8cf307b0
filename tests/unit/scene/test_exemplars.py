"""From many plants to few exemplars."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.community.population import Population
from forestgen.scene.exemplars import plan_exemplars, size_errors


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


def test_as_many_exemplars_as_plants_leave_no_error():
    plants = population([0.5, 1.0, 1.5], names=("a",))
    plan = plan_exemplars(plants, 3, seed=0)
    [error] = size_errors(plants, plan, plan.radius_m * 5, plan.radius_m, plants.radius_m)
    assert error.radius_rms == error.crown_width_rms == 0.0
