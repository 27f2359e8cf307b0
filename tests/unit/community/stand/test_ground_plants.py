"""Plants of a stand's ground: as many as asked for, in clumps of their own, where light is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import ncx2

from forestgen.community.population import Site
from forestgen.community.stand.ground_plants import GroundPlants
from forestgen.core.errors import RecipeError
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import check_plan
from support.error_messages import raises_error
from support.grown_stands import SIZE, brute_cover, grown


def test_plants_of_the_ground_stand_in_clumps_and_cover_as_much(species):
    size_m, bracken = (60.0, 60.0), {"cover": 0.2, "radius_m": 0.4}
    apart, clumped = (
        grown(species, {"ground": {"bracken": {**bracken, **more}}}, size_m=size_m) for more in ({}, {"clump_m": 5})
    )
    for found in (apart, clumped):
        assert brute_cover(found, size_m, 0.1, "radius_m") == pytest.approx(0.2, rel=0.1)
    many = [np.histogram2d(*one.position_m[:, :2].T, bins=12)[0] for one in (apart, clumped)]
    assert many[0].var() < 1.5 * many[0].mean()  # 1 where they are independent
    assert many[1].var() > 4.0 * many[1].mean()


def test_clumps_of_the_ground_stand_where_light_is(species):
    storey = {"species": {"spruce": 1}, "stems_per_ha": 500, "dbh": {"mean_cm": 20}}
    ground = {"bracken": {"plants_per_ha": 4000, "clump_m": 2}}
    found = grown(species, {"storeys": [storey], "canopy_cover": 0.5, "ground": ground})
    fern = found.species == 5
    away = found.position_m[fern, None, :2] - found.position_m[None, ~fern, :2]
    away = np.abs(away)
    away = np.hypot(*np.minimum(away, np.array(SIZE) - away).transpose(2, 0, 1))
    below = (away < found.columns["crown_radius_m"][~fern]).any(axis=1).mean()
    tolerance = species[5].shade_tolerance
    assert below == pytest.approx(tolerance / (1.0 + tolerance), abs=0.06)  # half of the ground is below crowns


def test_clumps_wider_than_the_site_are_refused_with_their_line(tmp_path):
    path = tmp_path / "recipe.yaml"
    path.write_text(
        "forestgen: 1\nsite: {size_m: [40, 30]}\nspecies: {bracken: {from: bracken}}\n"
        "community: {model: stand, ground: {bracken: {plants_per_ha: 9e5, clump_m: 200}}}\n"
    )
    with raises_error(RecipeError, place="community.ground.bracken.clump_m") as caught:
        check_plan(load_recipe(path), simulate_only=True)
    assert f"{path}:4: " in caught.value.where


@pytest.mark.parametrize("clump_m", [None, 0.4, 1, 2, 4, 16])
def test_plants_in_clumps_are_as_many_as_cover_even_ground(clump_m, species):
    keys = GroundPlants(cover=0.3, radius_m=0.4, clump_m=clump_m)
    per_m2, bracken = 1e-4 * keys.stand(species[5]).plants_per_ha, species[5]
    bare = np.exp(-per_m2 * np.pi * 0.4**2)
    if clump_m is not None:  # Neyman and Scott's process: no disc of any parent covers a point
        clumps = keys.clumps(bracken, Site(SIZE), periodic=True)
        many, sigma_m = clumps.plants_per_cluster, clumps.sigma_m
        away_m = np.linspace(0, 8 * sigma_m + 1, 2001)
        chance = ncx2.cdf((0.4 / sigma_m) ** 2, 2, (away_m / sigma_m) ** 2)
        bare = np.exp(-per_m2 / many * np.trapezoid(-np.expm1(-many * chance) * 2 * np.pi * away_m, away_m))
    assert bare == pytest.approx(0.7, rel=5e-3)


def test_another_species_leaves_clumps_alone(species):
    ground = {"bracken": {"plants_per_ha": 2000, "clump_m": 4}}
    alone, among = (grown(one, {"ground": ground}) for one in (species[5:], species))
    assert np.array_equal(alone.position_m, among.position_m)
