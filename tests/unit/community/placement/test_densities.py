"""Numbers of plants and their sizes."""

from __future__ import annotations

import numpy as np
from scipy import stats

from forestgen.community.placement.densities import (
    PlacementParameters,
    Sizes,
    Stand,
    cells_for,
    draw_heights,
    draw_radii,
    grid_shape,
    plant_counts,
)
from forestgen.community.placement.model import wanted_plants
from forestgen.community.population import Site
from forestgen.core.errors import RecipeError
from forestgen.core.randomness import child_rng
from support.error_messages import raises_error


def test_radii_are_log_normal_and_cut_off(tree):
    species = tree(max_radius_m=3.0)
    radii = draw_radii(Sizes(median=1.2, sigma=0.5), species, 20_000, np.random.default_rng(1))
    z = np.log(radii / 1.2) / 0.5
    top = np.log(3.0 / 1.2) / 0.5
    assert stats.kstest(z, stats.truncnorm(-np.inf, top).cdf).pvalue > 0.001
    assert radii.max() <= 3.0
    assert np.unique(draw_radii(Sizes(median=1.2, sigma=0.0), species, 9, np.random.default_rng(1))) == 1.2


def test_heights_follow_the_allometry_with_their_scatter(tree):
    species, radii = tree(), np.linspace(0.1, 2, 20_000)
    stand = Stand.model_validate({"count": 1, "height_sigma": 0.2})
    expected = species.height_scale * radii**species.height_exponent
    z = np.log(draw_heights(stand, species, radii, np.random.default_rng(2)) / expected) / 0.2
    assert stats.kstest(z, "norm").pvalue > 0.001
    np.testing.assert_allclose(draw_heights(None, species, radii, np.random.default_rng(2)), expected)


def test_a_site_half_barred_has_half_the_plants_per_hectare_and_all_of_a_count(tree):
    site, half = Site((100.0, 50.0)), {"rows": [[1, 0]], "smooth": False}
    plants = {
        "tree": {"plants_per_ha": 400, "map": half},
        "b": {"plants_per_ha": 400},
        "c": {"count": 31, "map": half},
    }
    species = [tree(name=name) for name in ("tree", "b", "c", "none")]
    counts = plant_counts(PlacementParameters.model_validate({"plants": plants}), site, species)
    assert counts.tolist() == [100, 200, 31, 0]
    kept_out = PlacementParameters.model_validate({"plants": plants, "keep_out": half})
    assert plant_counts(kept_out, site, species).tolist() == [0, 100, 31, 0]


def test_plants_come_largest_first_and_another_species_leaves_their_sizes(tree):
    asked = {
        "tree": {"count": 300},
        "b": {"count": 200, "radius_m": {"median": 0.5, "sigma": 0.9}, "height_sigma": 0.3},
    }
    site, species = Site((10.0, 10.0)), [tree(), tree(name="b"), tree(name="c")]
    two = wanted_plants(
        PlacementParameters.model_validate({"plants": asked}), site, species[:2], child_rng(4, "community", 0)
    )
    more = {"c": {"count": 100}, **asked}
    order = [species[2], species[0], species[1]]
    three = wanted_plants(
        PlacementParameters.model_validate({"plants": more}), site, order, child_rng(4, "community", 0)
    )
    for wanted in (two, three):
        assert np.all(np.diff(wanted.r_m) <= 0)
    for before, after in ((0, 1), (1, 2)):
        np.testing.assert_array_equal(two.r_m[two.sp == before], three.r_m[three.sp == after])
        np.testing.assert_array_equal(two.height_m[two.sp == before], three.height_m[three.sp == after])


def test_a_radius_that_the_species_cannot_have_is_refused(tree):
    parameters = PlacementParameters.model_validate({"plants": {"tree": {"count": 3, "radius_m": 2.5}}})
    with raises_error(RecipeError, place="community.plants.tree.radius_m"):
        wanted_plants(parameters, Site((10.0, 10.0)), [tree()], child_rng(0, "community", 0))


def test_cells_show_a_length_within_the_memory_for_fields():
    site = Site((100.0, 50.0))
    assert cells_for(site, 2.0, per_length=8, at_least=64, fields=1) == 400
    assert cells_for(site, 50.0, per_length=8, at_least=64, fields=1) == 64
    rows, cols = grid_shape(site, cells_for(site, 1e-3, per_length=8, at_least=64, fields=4))
    assert (rows, cols) == (cols // 2, cols)
    assert 0.99 * 2**25 < 4 * rows * cols < 1.01 * 2**25
