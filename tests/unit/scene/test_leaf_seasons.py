"""A stand over the year: bare in winter, evergreens as always, plants early and late by their own draws."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from forestgen.community.population import Population
from forestgen.core.parts import Part
from forestgen.core.progress import Silent
from forestgen.plants.exemplar import Exemplar
from forestgen.recipe.load import load_recipe_data
from forestgen.scene import growth
from forestgen.scene.build import place_instances
from forestgen.scene.phenology import class_days, leaf_class_of_plant, leaf_states
from forestgen.scene.plan import Plan, make_plan
from forestgen.scene.surfaces import materials_of

KINDS = ("beech", "spruce", "bramble")


def planned(**time: str) -> Plan:
    """Time: season, or date."""
    data = {
        "forestgen": 1,
        "seed": 4,
        "site": {"size_m": [30, 30], "latitude_deg": 51.0, "altitude_m": 300.0}
        | {key: value for key, value in time.items() if key == "date"},
        "species": {name: name for name in KINDS},
        "plants": {"exemplars_per_species": 1, "cache": False} | {k: v for k, v in time.items() if k == "season"},
        "community": {"model": "placed"},
    }
    return make_plan(load_recipe_data(data, "test").draw(0))


def stand(plan: Plan, n: int) -> Population:
    """Small plants, all of one size."""
    species = np.arange(n) % len(KINDS)
    radius = np.full(n, 0.3)
    heights = [plan.drawn.species[name].allometry.height(radius) for name in KINDS]
    return Population(
        time_yr=0.0,
        species_names=KINDS,
        plant_id=np.arange(1, n + 1, dtype=np.uint32),
        species=species.astype(np.uint16),
        position_m=np.zeros((n, 3)),
        radius_m=radius,
        height_m=np.choose(species, heights),
        age_yr=np.zeros(n),
        status=np.zeros(n, np.uint8),
    )


def grown(n: int = 3, **time: str) -> tuple[Plan, Population, growth.ExemplarPlan, tuple[Exemplar, ...]]:
    plan = planned(**time)
    plants = stand(plan, n)
    chosen = growth.choose_exemplars(plan, plants, ())
    return plan, plants, chosen, growth.grow_planned(plan, chosen, Silent(), plants)


@cache
def summer() -> tuple[Exemplar, ...]:
    return grown()[3]


def test_a_beech_is_bare_in_winter_and_of_the_same_wood_and_height() -> None:
    plan, plants, chosen, exemplars = grown(season="winter")
    (bare, spruce, bramble), (beech, evergreen, _) = exemplars, summer()
    assert bare.leaf_area_m2 == 0.0
    assert Part.LEAF not in {organ.part for organ in bare.organs}
    assert bare.wood_volume_m3 == beech.wood_volume_m3
    assert bare.height_m == pytest.approx(beech.height_m, abs=0.01)
    assert spruce.leaf_area_m2 == evergreen.leaf_area_m2 > 0.0
    assert bramble.leaf_area_m2 > 0.0
    scales = [
        place_instances(plants, chosen.exemplar_of_plant, those, plan.drawn.image_seed).transform[:, 2, 2]
        for those in (exemplars, summer())
    ]
    np.testing.assert_allclose(*scales, rtol=0.01)


def test_leaves_are_small_in_spring_and_few_in_autumn() -> None:
    full = summer()[0].leaf_area_m2
    for date, share in (("2026-05-13", 0.6), ("2026-10-26", 0.5)):
        plan, _, chosen, exemplars = grown(30, date=date)
        states = leaf_states(plan.drawn)["beech"]
        assert len(states) == 2
        assert np.mean([state.share * state.size for state in states]) == pytest.approx(share, abs=0.1)
        for exemplar, species, leaves in zip(exemplars, chosen.species, chosen.leaves, strict=True):
            if KINDS[species] == "beech":
                wanted = states[leaves].share * states[leaves].size
                assert exemplar.leaf_area_m2 / full == pytest.approx(wanted, abs=0.1)
        materials = materials_of(plan.drawn.species, leaf_states(plan.drawn))
        assert {(one.species, organ.material) for one in exemplars for organ in one.organs} <= set(materials)


def test_a_season_of_one_class_needs_no_more_exemplars_and_summer_is_the_default() -> None:
    for time in ({}, {"season": "summer"}, {"season": "winter"}, {"date": "2026-07-20"}):
        plan = planned(**time)
        assert {len(states) for states in leaf_states(plan.drawn).values()} == {1}
        assert len(growth.choose_exemplars(plan, stand(plan, 60), ())) == len(KINDS)
    keys = [
        [request.key() for request in growth.exemplar_requests(plan, growth.choose_exemplars(plan, plants, ()), plants)]
        for plan, plants in ((one, stand(one, 60)) for one in (planned(), planned(date="2026-07-20")))
    ]
    assert keys[0] == keys[1]


@pytest.mark.parametrize(("date", "sd_days"), [("2026-05-13", 4.0), ("2026-10-26", 8.5)])
def test_plants_of_a_stand_spread_as_their_species_says(date: str, sd_days: float) -> None:
    """Denéchère et al. 2021: 4.0 days in spring and 8.5 in autumn."""
    plan = planned(date=date)
    plants = stand(plan, 6000)
    classes = leaf_class_of_plant(plan.drawn, plants)
    beech = plants.species == 0
    days = sd_days * class_days(2)[classes[beech]]
    assert days.std() == pytest.approx(sd_days, rel=0.05)
    assert days.mean() == pytest.approx(0.0, abs=4 * sd_days / np.sqrt(beech.sum()))
    assert (classes[plants.species == 1] == 0).all()
    fewer = stand(plan, 300)
    assert (leaf_class_of_plant(plan.drawn, fewer) == classes[:300]).all()  # a plant's draw is its own


@pytest.mark.parametrize("classes", range(1, 6))
def test_classes_have_the_mean_and_the_deviation_of_their_species(classes: int) -> None:
    days = class_days(classes)
    assert (days.mean(), days.std()) == pytest.approx((0.0, float(classes > 1)), abs=1e-9)
    assert (np.diff(days) > 0).all()


def test_colours_pass_from_green_to_yellow_and_differ_between_plants() -> None:
    plan = planned(date="2026-10-12")
    states = leaf_states(plan.drawn)
    materials = materials_of(plan.drawn.species, states)
    early, late = (materials["beech", key].reflectance[0] for key in ("leaf", "leaf~1"))
    assert early > 1.5 * late
    green = materials_of(plan.drawn.species)
    assert materials["beech", "bark~1"] is materials["beech", "bark"]
    spectra = [one["spruce", "needle"].reflectance_spectrum for one in (materials, green)]
    np.testing.assert_array_equal(spectra[0].value, spectra[1].value)
