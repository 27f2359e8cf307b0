from __future__ import annotations

import numpy as np
import pytest

from forestgen.community.point_patterns import hopkins_index
from forestgen.community.population import Population, Status, count_by_species, cover_by_species


def make(species, radius_m, status):
    n = len(species)
    return Population(
        time_yr=1.0,
        species_names=("herb", "poplar", "spruce"),
        plant_id=np.arange(1, n + 1, dtype=np.uint32),
        species=np.array(species, np.uint16),
        position_m=np.zeros((n, 3)),
        radius_m=np.array(radius_m, float),
        height_m=np.ones(n),
        age_yr=np.ones(n),
        status=np.array(status, np.uint8),
    )


def test_counts_leave_out_the_dead():
    population = make([0, 0, 1, 1], [1, 1, 1, 1], [Status.GROWING, Status.DEAD, Status.DOMINATED, Status.MATURE])
    assert count_by_species(population) == {"herb": 1, "poplar": 2, "spruce": 0}


def test_cover_is_the_ground_under_undominated_circles():
    population = make([0, 0, 1, 1], [1, 2, 3, 4], [Status.GROWING, Status.DEAD, Status.DOMINATED, Status.MATURE])
    cover = cover_by_species(population, 200.0)
    assert cover == pytest.approx({"herb": np.pi / 200, "poplar": 16 * np.pi / 200, "spruce": 0.0})


def test_no_plants_no_numbers():
    assert count_by_species(make([], [], [])) == {"herb": 0, "poplar": 0, "spruce": 0}
    assert cover_by_species(make([], [], []), 1.0) == {"herb": 0.0, "poplar": 0.0, "spruce": 0.0}
    assert np.isnan(hopkins_index(np.zeros((1, 2)), (1.0, 1.0), np.random.default_rng(0)))
    assert hopkins_index(np.ones((4, 2)), (2.0, 2.0), np.random.default_rng(0)) == np.inf


def test_hopkins_of_random_points_is_one():
    rng = np.random.default_rng(1)
    values = [hopkins_index(rng.random((1000, 2)) * (40, 10), (40.0, 10.0), rng) for _ in range(40)]
    # Each value scatters by about 2% (nearest distances of a Poisson pattern: sd 0.523 of the mean, 1000 of them).
    assert np.mean(values) == pytest.approx(1.0, abs=0.012)
    assert np.std(values) < 0.04


def test_hopkins_of_a_square_lattice():
    k = np.arange(20) + 0.5
    lattice = np.stack(np.meshgrid(k, k), axis=-1).reshape(-1, 2)
    # Mean distance from a point of a unit square to its middle, over the lattice's spacing of 1.
    exact = (np.sqrt(2) + np.log(1 + np.sqrt(2))) / 6
    assert hopkins_index(lattice, (20.0, 20.0), np.random.default_rng(2)) == pytest.approx(exact, rel=0.01)


def test_hopkins_of_clusters_is_large():
    rng = np.random.default_rng(3)
    points = np.clip(np.repeat(rng.random((20, 2)) * 100, 30, axis=0) + rng.normal(0, 0.5, (600, 2)), 0, 100)
    assert hopkins_index(points, (100.0, 100.0), rng) > 5


@pytest.mark.parametrize("factor", [0.01, 37.0])
def test_hopkins_has_no_unit(factor):
    points = np.random.default_rng(4).random((200, 2))
    one = hopkins_index(points, (1.0, 1.0), np.random.default_rng(0))
    other = hopkins_index(points * factor, (factor, factor), np.random.default_rng(0))
    assert other == pytest.approx(one)
