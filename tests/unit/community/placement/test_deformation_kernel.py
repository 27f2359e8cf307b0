"""The deformation kernel model."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

from forestgen.community.models.deformation_kernel import MODEL
from forestgen.community.population import Site

SITE = Site((40.0, 30.0))


def placed(plants, species, kernels="neutral", seed=0, site=SITE, **more):
    parameters = MODEL.Parameters(plants=plants, kernels=kernels, **more)
    return MODEL.init(parameters, site, species, seed)


def pairs(a, b, within_m, site=SITE):
    """Number of pairs of two patterns nearer than a distance, edges meeting."""
    trees = [cKDTree(np.mod(one, site.size_m), boxsize=site.size_m) for one in (a, b)]
    return trees[0].count_neighbors(trees[1], within_m)


@pytest.mark.parametrize("periodic", [True, False])
def test_counts_are_exact_plants_lie_on_the_site_and_ids_go_from_large_to_small(periodic, tree):
    asked = {"tree": {"count": 150}, "b": {"count": 70, "radius_m": 0.3}}
    made = placed(asked, [tree(), tree(name="b")], "weak_clustering", periodic=periodic)
    plants = made.plants
    assert np.bincount(plants.sp).tolist() == [150, 70]
    assert plants.plant_id.tolist() == list(range(1, 221))
    assert np.all(np.diff(plants.r_m) <= 0)
    assert np.all((plants.x_m >= 0) & (plants.x_m <= SITE.size_m))
    assert made.notes == ()


@pytest.mark.parametrize("periodic", [True, False])
def test_a_hard_core_is_violated_by_no_more_than_a_cells_diagonal(periodic, tree):
    plants = placed(
        {"tree": {"count": 250, "radius_m": {"median": 1.0, "sigma": 0.3}}},
        [tree()],
        {"curve": [[0, 0], [1, 0], [1.001, 1]]},
        periodic=periodic,
    ).plants
    cell_m = 40.0 / 320  # an eighth of the median radius
    apart = np.abs(plants.x_m[:, None] - plants.x_m[None])
    if periodic:
        apart = np.minimum(apart, np.array(SITE.size_m) - apart)
    distance = np.hypot(apart[..., 0], apart[..., 1])
    earlier = np.tril(np.ones(distance.shape, bool), -1)  # column j stood when row k came
    margin = (distance - plants.r_m[None])[earlier]
    assert margin.min() >= -cell_m * 2**0.5
    assert np.mean(margin < 0) < 1e-3
    if periodic:  # kernels reach across the edges, where they meet
        assert np.any(np.abs(plants.x_m[:, 0] - 20) > 19)
    assert len(plants) == 250


def test_the_effect_of_one_species_on_another_is_not_that_of_the_other_on_it(tree):
    """Large plants of a, placed first, invite b; b does nothing. And: small b bar a, but come too late to matter."""
    species = [tree(name="a"), tree(name="b")]
    asked = {"a": {"count": 30, "radius_m": 1.5}, "b": {"count": 300, "radius_m": 0.2}}
    ring = {"curve": [[0, 8], [1.0, 8], [1.2, 1]]}
    near = {}
    for name, kernels in {"none": {}, "a on b": {"a": {"b": ring}}, "b on a": {"b": {"a": ring}}}.items():
        counts = []
        for seed in range(4):
            plants = placed(asked, species, kernels, seed).plants
            counts.append(pairs(plants.x_m[plants.sp == 0], plants.x_m[plants.sp == 1], 1.5))
        near[name] = np.mean(counts)
    chance = 30 * 300 * np.pi * 1.5**2 / SITE.area_m2
    assert near["none"] == pytest.approx(chance, rel=0.25)
    assert near["a on b"] > 3 * chance
    assert near["b on a"] == near["none"]


def test_a_species_that_another_does_not_see_leaves_it_where_it_was(tree):
    species = [tree(name="a"), tree(name="b")]
    kernels = {"a": {"a": "inhibition"}, "b": {"b": "clustering"}}
    one = {"a": {"count": 50, "radius_m": {"median": 1.0, "sigma": 0.3}}}
    layout = {"cells": 200}
    alone = placed(one, species, kernels, 3, **layout).plants
    both = placed({**one, "b": {"count": 90, "radius_m": 0.9}}, species, kernels, 3, **layout).plants
    np.testing.assert_array_equal(both.x_m[both.sp == 0], alone.x_m)
    np.testing.assert_array_equal(both.r_m[both.sp == 0], alone.r_m)


def test_one_kernel_for_all_is_a_matrix_of_it(tree):
    """The first keeps one field, the second one for each species: the same plants."""
    species = [tree(name="a"), tree(name="b")]
    asked = {"a": {"count": 60, "radius_m": 1.2}, "b": {"count": 80, "radius_m": 0.6}}
    one = placed(asked, species, "inhibition", 2).plants
    many = placed(asked, species, {"a": "inhibition", "b": "inhibition"}, 2).plants
    np.testing.assert_allclose(one.x_m, many.x_m, atol=1e-9)


def test_the_same_seed_gives_the_same_bytes_and_another_one_others(tree):
    def made(seed):
        plants = placed({"tree": {"count": 200}}, [tree()], "clustering", seed).plants
        return b"".join(values.tobytes() for values in vars(plants).values())

    assert made(7) == made(7)
    assert made(7) != made(8)


def test_a_map_and_a_mask_bar(tree):
    west = {"rows": [[1, 0]], "smooth": False}
    plants = placed({"tree": {"count": 300, "map": west}}, [tree()], "clustering").plants
    assert plants.x_m[:, 0].max() <= 20.0
    plants = placed({"tree": {"count": 300}}, [tree()], keep_out=west).plants
    assert plants.x_m[:, 0].min() >= 20.0


def test_plants_without_a_place_are_told_with_the_reason(tree):
    species = [tree(name="a"), tree(name="b")]
    bar_all = {"curve": 0.0, "reach": 100, "distance": "metres"}
    made = placed({"a": {"count": 3}, "b": {"count": 5, "map": [[0]]}}, species, {"a": {"a": bar_all}})
    first, second = made.notes
    assert first.startswith("1 of 3 plants of a were placed: no place is left where the kernels")
    assert second == "0 of 5 plants of b were placed: the map, the conditions and keep_out bar the whole site"
    assert len(made.plants) == 1


def test_a_grid_too_coarse_for_its_kernels_is_told(tree):
    (note,) = placed({"tree": {"count": 20, "radius_m": 0.1}}, [tree()], "inhibition", cells=64).notes
    assert note.startswith("kernels are blurred: cells are 0.625 m wide")
    assert placed({"tree": {"count": 20, "radius_m": 0.1}}, [tree()], "inhibition").notes == ()


def test_estimates_bound_what_is_made(tree):
    species = [tree(name="a"), tree(name="b")]
    asked = {"a": {"plants_per_ha": 800, "map": [[1, 0.2]]}, "b": {"count": 40}}
    kernels = {"a": "inhibition", "b": "neutral"}
    parameters = MODEL.Parameters(plants=asked, kernels=kernels)
    assert len(placed(asked, species, kernels).plants) <= MODEL.expected_plants(parameters, SITE, species)
    fine = MODEL.Parameters(plants=asked, kernels=kernels, cells=4096)
    cells = 4096 * 3072
    more = MODEL.estimate_bytes(fine, SITE, species) - MODEL.estimate_bytes(parameters, SITE, species)
    assert more >= 2 * cells * 8
    one = MODEL.Parameters(plants={"b": {"count": 40}}, kernels=kernels, cells=4096)
    assert MODEL.estimate_bytes(one, SITE, species) < MODEL.estimate_bytes(fine, SITE, species)


def test_what_is_left_of_the_density_is_zero_where_plants_bar(tree):
    parameters = MODEL.Parameters(
        plants={"tree": {"count": 40, "radius_m": 1.5}}, kernels={"curve": [[0, 0], [1, 0], [1.001, 1]]}
    )
    state = MODEL.init(parameters, SITE, [tree()], 1)
    densities = MODEL.densities(parameters, SITE, [tree()], MODEL.population(state))
    assert densities.left_per_ha is not None
    left = densities.left_per_ha["tree"]
    rows, cols = left.shape
    for x, y in state.plants.x_m:
        assert left[int(y / 30 * rows), int(x / 40 * cols)] == 0
    covered = np.mean(left == 0)
    assert 0.5 * 40 * np.pi * 1.5**2 / 1200 < covered <= 1.02 * 40 * np.pi * 1.5**2 / 1200


def test_resuming_needs_no_field(tree):
    state = placed({"tree": {"count": 30}}, [tree()], "inhibition", steps=5)
    again = MODEL.resume(state.parameters, SITE, [tree()], 0, MODEL.population(MODEL.step(state)))
    assert dataclasses.replace(MODEL.step(state), plants=again.plants) == again


@pytest.mark.parametrize(
    ("radius_m", "kernels", "idle"), [(0.02, "clustering", True), (0.5, "clustering", False), (0.02, "neutral", False)]
)
def test_kernels_that_never_meet_a_plant_are_told(radius_m, kernels, idle, tree):
    notes = placed({"tree": {"count": 150, "radius_m": radius_m}}, [tree()], kernels).notes
    assert [note.startswith("kernels hardly act") for note in notes if "blurred" not in note] == [True] * idle
