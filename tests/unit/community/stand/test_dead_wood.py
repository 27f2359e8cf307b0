"""Dead trees of a stand: the amounts that a recipe asks for, by kind and class; and lists that have dead trees."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.community.models import inventory, stand
from forestgen.community.models.stand import StandParameters
from forestgen.community.population import Site, Status
from forestgen.community.simulation import final_population
from forestgen.core.dead_wood import DeadForm, are_lying, left_of, lying_volume_m3, standing_volume_m3
from forestgen.core.errors import RecipeError
from forestgen.core.progress import Silent
from forestgen.recipe.load import load_recipe_data
from forestgen.scene.plan import check_plan
from support.error_messages import raises_error

SITE = Site((100.0, 80.0))
STOREY = {"species": {"spruce": 0.6, "beech": 0.4}, "stems_per_ha": 500, "basal_area_m2_per_ha": 35}


def placed(species, dead_wood, seed=0, storey=STOREY, **keys):
    parameters = StandParameters.model_validate({"storeys": [storey], "dead_wood": dead_wood, **keys})
    return stand.MODEL.place(parameters, SITE, species, np.random.default_rng(seed))


def volumes(found):
    of = found.dead_form, np.maximum(found.decay_class, 1), found.height_m, found.tree_sizes["dbh_m"]
    standing = np.where(found.dead_form == DeadForm.STANDING, standing_volume_m3(*of), 0.0)
    area = SITE.area_ha
    return standing[found.dead].sum() / area, lying_volume_m3(*of)[found.dead].sum() / area


@pytest.mark.parametrize("lying", [0.5, 15, 130])
def test_volumes_are_reached_by_trees_of_the_stand(species, lying):
    found = placed(species, {"standing_m3_per_ha": 20, "lying_m3_per_ha": lying})
    np.testing.assert_allclose(volumes(found), [20, lying], rtol=1e-6)
    living, dead = (found.tree_sizes["dbh_m"][one] for one in (~found.dead, found.dead))
    assert dead.min() >= 0.1 * 0.6
    assert dead.max() <= 1.3 * living.max()
    names = [one.name for one in species]
    if lying > 100:
        share = np.bincount(found.species[found.dead], minlength=len(names)) / found.dead.sum()
        assert share[names.index("spruce")] == pytest.approx(0.6, abs=0.12)


def test_numbers_classes_and_forms_are_those_of_the_recipe(species):
    decay = [0.1, 0.2, 0.4, 0.2, 0.1]
    asked = {"standing_per_ha": 100, "lying_per_ha": 400, "stumps_per_ha": 150, "snapped": 0.25, "decay": decay}
    found = placed(species, asked)
    form, classes = found.dead_form[found.dead], found.decay_class[found.dead]
    assert np.sum(form == DeadForm.STANDING) == 80
    assert are_lying(form).sum() == 320
    assert np.sum(form == DeadForm.STUMP) == 120
    assert np.mean(form[are_lying(form)] == DeadForm.SNAPPED) == pytest.approx(0.25, abs=0.08)
    np.testing.assert_allclose(np.bincount(classes, minlength=6)[1:] / len(classes), decay, atol=0.07)
    height, dbh = found.height_m[found.dead], found.tree_sizes["dbh_m"][found.dead]
    assert np.all(height[form == DeadForm.STUMP] <= 0.4)
    assert np.all(dbh >= 0.1)
    assert np.array_equal(np.isfinite(found.azimuth_deg[found.dead]), are_lying(form))


def test_the_living_are_as_without_and_the_dead_as_before(species):
    without, found, again = placed(species, None), *(placed(species, "beech_reserve") for _ in range(2))
    count = len(without.species)
    for name in ("species", "position_m", "height_m"):
        assert np.array_equal(getattr(found, name)[:count], getattr(without, name))
        assert np.array_equal(getattr(found, name), getattr(again, name))
    assert not found.dead[:count].any()
    assert found.dead[count:].all()
    assert found.found["reached"]["dead_wood"]["lying_m3_per_ha"] == pytest.approx(97)


def test_lying_stems_hit_no_stem_that_stands_and_stay_on_a_site_with_edges(species):
    found = placed(species, {"lying_per_ha": 40}, storey=STOREY | {"stems_per_ha": 300}, periodic=False)
    stems, radius = found.position_m[~found.dead], 0.5 * found.tree_sizes["dbh_m"][~found.dead]
    hits, inside = 0, []
    for row in np.flatnonzero(found.dead).tolist():
        angle = np.radians(found.azimuth_deg[row])
        at = np.linspace(0.0, found.height_m[row], 200)[:, None] * [np.sin(angle), np.cos(angle)]
        points = found.position_m[row] + at
        inside.append(np.mean((points >= 0.0) & (points <= np.array(SITE.size_m))))
        apart = np.linalg.norm(points[:, None] - stems, axis=2).min(axis=0)
        hits += int(np.any(apart < radius))
    assert hits <= 0.1 * found.dead.sum()
    assert np.mean(inside) > 0.99
    assert min(inside) > 0.9


def test_species_and_shares_of_types_may_be_changed(species):
    found = placed(species, {"type": "boreal_old_growth", "lying_m3_per_ha": 5})
    np.testing.assert_allclose(volumes(found), [33, 5], rtol=1e-6)
    fewer = placed(species, {"type": "boreal_managed", "standing_per_ha": 0})
    assert not np.any(fewer.dead_form == DeadForm.STANDING)
    assert np.sum(fewer.dead_form == DeadForm.STUMP) == 160


def recipe(dead_wood, **storey):
    return {
        "forestgen": 1,
        "site": {"size_m": [40, 30]},
        "species": {"spruce": None},
        "community": {
            "model": "stand",
            "storeys": [{"species": {"spruce": 1}, "stems_per_ha": 400, "dominant_height_m": 20} | storey],
            "dead_wood": dead_wood,
        },
        "cameras": [{"position_m": [5, 5, 50]}],
    }


BAD = {
    "two amounts": ({"lying_per_ha": 3, "lying_m3_per_ha": 10}, "community.dead_wood.lying_m3_per_ha"),
    "four classes": ({"decay": [1, 1, 1, 1]}, "community.dead_wood.decay"),
    "no class": ({"decay": [0, 0, 0, 0, 0]}, "community.dead_wood.decay"),
    "negative": ({"standing_per_ha": -1}, "community.dead_wood.standing_per_ha"),
    "unknown type": ("primeval", "community.dead_wood.type"),
    "unknown key": ({"snags_per_ha": 4}, "community.dead_wood.snags_per_ha"),
}


@pytest.mark.parametrize("bad", BAD)
def test_what_is_no_dead_wood_is_refused_with_its_place(bad):
    given, place = BAD[bad]
    with raises_error(RecipeError, place=place):
        check_plan(load_recipe_data(recipe(given), "test"))


def test_dead_trees_of_no_living_ones_are_refused():
    with raises_error(RecipeError, place="community.dead_wood"):
        check_plan(load_recipe_data(recipe({"lying_per_ha": 30, "min_dbh_cm": 60}), "test"))
    data = recipe({"lying_per_ha": 30})
    data["community"]["storeys"] = []
    with raises_error(RecipeError, place="community.dead_wood"):
        check_plan(load_recipe_data(data, "test"))


def test_a_snapshot_has_forms_and_classes_and_resumes():
    plan = check_plan(load_recipe_data(recipe("boreal_old_growth"), "test"))
    found = final_population(plan.community, Silent())
    dead = found.status == Status.DEAD
    assert np.array_equal(found.columns["dead_form"] > 0, dead)
    assert np.array_equal(found.columns["decay_class"] > 0, dead)
    model, community = plan.community.model, plan.community
    of = community.parameters, community.site, community.ecologies
    model.check_snapshot(*of, found)
    again = model.population(model.resume(*of, 0, found))
    for name in ("dead_form", "decay_class"):
        assert np.array_equal(again.columns[name], found.columns[name])
    sized = community.with_tree_sizes(found)
    assert not sized.columns["leaf_area_m2"][dead].any()


def test_a_list_says_form_and_class_and_what_it_leaves_out_follows(species):
    table = (
        "species, x_m, y_m, dbh_cm, height_m, status, decay_class\n"
        "spruce, 1, 1, 30, 24, alive, \n"
        "spruce, 2, 1, 30, 24, dead, \n"
        "spruce, 3, 1, 30, 5, dead, \n"
        "spruce, 4, 1, 30, , dead, 4\n"
        "beech, 5, 1, 30, 20, lying_dead, 1\n"
        "beech, 6, 1, 30, , snapped, 3\n"
    )
    parameters = inventory.InventoryParameters.model_validate({"table": table})
    found = inventory.MODEL.place(parameters, SITE, species, np.random.default_rng(0))
    assert found.dead_form.tolist() == [0, 1, 1, 1, DeadForm.UPROOTED, DeadForm.SNAPPED]
    assert found.decay_class.tolist() == [0, 2, 5, 4, 1, 3]
    assert found.height_m[:3].tolist() == [24, 24, 5]
    assert found.height_m[4] == 20
    whole = found.height_m / left_of(found.dead_form, found.decay_class)
    assert np.all((whole[3:] > 14) & (whole[3:] < 32))
