"""Leaves over the year: dates of species, places, hemispheres and individuals."""

import dataclasses
import itertools
import re

import numpy as np
import pytest

from forestgen.core.errors import RecipeError
from forestgen.recipe.assets import find_asset, list_assets
from forestgen.recipe.load import load_recipe_data
from forestgen.recipe.phenology import (
    BARE,
    FRESH_DAYS,
    SUMMER,
    LeafState,
    Phenology,
    TimeOfYear,
    fallen_lately,
    leaf_state,
)
from forestgen.recipe.sources import parse_yaml
from support.error_messages import raises_error

NAMES = list_assets("species")
DAYS = range(1, 366)


def species(*names):
    return recipe({name: name for name in names}).draw(0).species


def recipe(kinds, **sections):
    return load_recipe_data({"forestgen": 1, "species": kinds, "community": {"model": "placed"}, **sections}, "test")


def section_of(name):
    """Phenology of a species file. The file as a whole takes 0.1 s to read, and tests are collected in each process."""
    found = re.search(r"^phenology:.*\n(?:[ #].*\n|\n)*", find_asset("species", name).read_text(encoding="utf-8"), re.M)
    data = found and parse_yaml(found[0], name)[0]["phenology"]
    return Phenology.model_validate({"habit": data} if isinstance(data, str) else data) if data else None


PHENOLOGY = {name: section_of(name) for name in NAMES}
SUMMERGREEN = [name for name, one in PHENOLOGY.items() if one is not None and one.habit == "summergreen"]
EVERGREEN = [name for name, one in PHENOLOGY.items() if one is not None and one.habit == "evergreen"]
DRY = [name for name, one in PHENOLOGY.items() if one is not None and one.habit == "drought_deciduous"]


def year(phenology, latitude_deg=51.0, altitude_m=300.0, **shift):
    place = latitude_deg, altitude_m
    return [leaf_state(phenology, TimeOfYear(None, day, *place), **shift) for day in DAYS]


def first(states, holds):
    return next(day for day, state in zip(DAYS, states, strict=True) if holds(state))


@pytest.mark.parametrize("name", ["beech", "pine", "acacia", "grass"])
def test_a_recipe_has_the_phenology_of_the_file(name):
    assert species(name)[name].phenology == PHENOLOGY[name]


def test_published_dates_are_reached_at_their_place():
    """Čufar et al. 2012: beech of Slovenia; PEP725: Flensburg; O'Keefe 2015: aspen at Harvard Forest."""
    beech = PHENOLOGY["beech"]
    for *place, leaf_out, colouring in ((46.0, 55.0, 104, 302), (54.8, 25.0, 122.2, 278.6)):  # 14 April, 29 October
        dates = beech.dates(*place)
        assert (dates[0], dates[2]) == pytest.approx((leaf_out, colouring), abs=2)
    higher = np.subtract(beech.dates(46.0, 1000.0), beech.dates(46.0, 900.0))
    np.testing.assert_allclose(higher, (2.6, 2.6, -1.9, -1.9))
    aspen = PHENOLOGY["poplar"]
    assert aspen.dates(42.5, 350.0)[:2] == (117, 140)


@pytest.mark.parametrize("name", SUMMERGREEN)
def test_a_year_passes_through_the_dates_of_the_species(name):
    one = PHENOLOGY[name]
    states = year(one, one.latitude_deg, one.altitude_m)
    size, share = (np.array([getattr(state, key) for state in states]) for key in ("size", "share"))
    assert states[int(one.full_leaf)].size == 1.0
    coloured = np.array([1.0 if state == BARE else state.spectra[2] + state.spectra[3] for state in states])
    out = share * size
    assert first(states, lambda state: state.size < 1.0) == pytest.approx(one.leaf_out, abs=4)
    assert np.interp(0.5, coloured[220:310], DAYS[220:310]) == pytest.approx(one.colouring, abs=2)
    fallen = 1.0 - (share[200:340] - one.kept) / (1.0 - one.kept)
    if one.kept == 0.0:
        assert np.interp(0.5, fallen, DAYS[200:340]) == pytest.approx(one.leaf_fall, abs=2)
        assert states[14] == BARE
        assert (np.diff(out[int(one.leaf_out) : 220]) >= 0).all()
    assert (np.diff(out[220:360]) <= 0).all()


@pytest.mark.parametrize("name", SUMMERGREEN)
def test_all_that_falls_lies_on_the_ground_for_a_month(name):
    """Over the year, the fresh litter of each day adds up to all leaves times the days that it lasts."""
    one = PHENOLOGY[name]
    fresh = [fallen_lately(one, TimeOfYear(None, day, one.latitude_deg, one.altitude_m)) for day in DAYS]
    assert sum(fresh) == pytest.approx(FRESH_DAYS * (1.0 - one.kept), rel=0.02)
    assert np.average(DAYS, weights=fresh) == pytest.approx(one.leaf_fall + FRESH_DAYS / 2, abs=2)
    assert max(fresh[90 : int(one.colouring) - 30]) < 0.01
    assert fallen_lately(one, TimeOfYear("autumn")) > 0.0
    assert {fallen_lately(one, TimeOfYear(season)) for season in ("summer", "dry")} == {0.0}


def test_summer_is_as_it_was():
    assert recipe({"oak": "oak"}).draw(0).recipe.time_of_year == TimeOfYear()
    assert {leaf_state(one, TimeOfYear()) for one in PHENOLOGY.values()} == {SUMMER}


@pytest.mark.parametrize("name", EVERGREEN)
def test_evergreens_are_the_same_all_year(name):
    seasons = [TimeOfYear(season) for season in ("spring", "summer", "autumn", "winter", "dry")]
    assert {leaf_state(PHENOLOGY[name], time) for time in seasons} | set(year(PHENOLOGY[name])) == {SUMMER}


@pytest.mark.parametrize("name", [*SUMMERGREEN, *DRY])
@pytest.mark.parametrize("latitude_deg", [12.0, 47.0])
def test_hemispheres_are_half_a_year_apart(name, latitude_deg):
    north, south = (np.array(year(PHENOLOGY[name], one), dtype=object) for one in (latitude_deg, -latitude_deg))
    half = np.roll(north, 182)  # 182.5 days: a day's change at most
    amount = [np.array([state.share * state.size for state in states]) for states in (half, south)]
    np.testing.assert_allclose(*amount, atol=0.16)
    assert np.corrcoef(*amount)[0, 1] > 0.99 if len(set(amount[0])) > 1 else (amount[0] == amount[1]).all()


def test_there_is_no_winter_between_the_tropics_but_a_dry_season():
    assert set(year(PHENOLOGY["beech"], 10.0)) == {SUMMER}
    kapok = year(PHENOLOGY["kapok"], 10.0)
    assert (kapok[50], kapok[200]) == (BARE, SUMMER)  # Condit et al. 2011: bare for about three months
    assert 60 < kapok.count(BARE) < 120
    assert min(state.share for state in year(PHENOLOGY["acacia"], -5.0)) == PHENOLOGY["acacia"].kept
    assert leaf_state(PHENOLOGY["kapok"], TimeOfYear("dry")) == BARE


@pytest.mark.parametrize("place", list(itertools.product((24.0, 50.0, 80.0), (-400.0, 2500.0, 9000.0))))
def test_dates_rise_everywhere(place):
    for name in (*SUMMERGREEN, *DRY):
        dates = PHENOLOGY[name].dates(*place)
        assert sorted(set(dates)) == list(dates)
        assert 2 * dates[3] - dates[2] - dates[0] <= 350.001


def test_plants_are_early_and_late_by_their_own_days():
    beech = PHENOLOGY["beech"]
    usual, late = year(beech, spring_days=0.0), year(beech, spring_days=6.0, autumn_days=6.0)
    assert usual[100:190] == late[106:196]
    assert usual[250:340] == late[256:346]


def test_what_is_kept_withers_or_stays_green():
    bracken, acacia = (leaf_state(PHENOLOGY["bracken"], TimeOfYear("winter")), year(PHENOLOGY["acacia"], 0.0)[80])
    assert (bracken.share, bracken.spectra) == (0.7, (0.0, 0.0, 0.0, 1.0))
    assert (acacia.share, acacia.spectra[1] > 0.3) == (0.4, True)


def test_without_phenology_leaves_stay_and_their_spectrum_is_the_seasons():
    for season in ("spring", "summer", "autumn", "dry"):
        assert leaf_state(None, TimeOfYear(season)) == LeafState.of_season(season)
    assert leaf_state(None, TimeOfYear("winter")) == LeafState.of_season("autumn")
    names = [TimeOfYear(None, day).name for day in (1, 59, 60, 151, 152, 243, 244, 334, 335, 365)]
    assert names == ["winter", "winter", *["spring"] * 2, *["summer"] * 2, *["autumn"] * 2, "winter", "winter"]
    assert [TimeOfYear(None, 1, latitude).name for latitude in (-40.0, 5.0)] == ["summer", "summer"]


def test_the_day_is_the_sites_or_the_suns():
    place = {"latitude_deg": 48.0, "longitude_deg": 11.0}
    sun = {"sun": {"date": "2026-01-15", "time": "12:00", "utc_offset_h": 1}}
    by_sun = recipe({"oak": "oak"}, site=place, sky=sun).draw(0).recipe.time_of_year
    by_site = recipe({"oak": "oak"}, site={"latitude_deg": 48.0, "date": "2026-01-15"}).draw(0).recipe.time_of_year
    assert by_sun == by_site == TimeOfYear(None, 15, 48.0, 0.0)
    named = recipe({"oak": "oak"}, site=place, sky=sun, plants={"season": "summer"}).draw(0).recipe.time_of_year
    assert named.season == "summer"


@pytest.mark.parametrize(
    ("sections", "place"),
    [
        ({"site": {"date": "15 October"}}, "site.date"),
        ({"site": {"date": "2026-02-30"}}, "site.date"),
        ({"site": {"date": "2026-10-15"}, "plants": {"season": "winter"}}, "site.date"),
        (
            {
                "site": {"date": "2026-10-15", "latitude_deg": 50.0, "longitude_deg": 10.0},
                "sky": {"sun": {"date": "2026-06-21T14:30+02:00"}},
            },
            "site.date",
        ),
        ({"plants": {"season": "monsoon"}}, "plants.season"),
    ],
)
def test_mistakes_in_dates(sections, place):
    with raises_error(RecipeError, place=place):
        recipe({"oak": "oak"}, **sections).draw(0)


def test_dates_must_follow_each_other():
    with raises_error(RecipeError, place="species.oak.phenology"):
        recipe({"oak": {"from": "oak", "phenology": {"full_leaf": 100}}}).draw(0)


def test_states_are_few_enough_to_be_shared():
    states = {dataclasses.astuple(state) for name in SUMMERGREEN for state in year(PHENOLOGY[name])}
    assert all(abs(20 * value - round(20 * value)) < 1e-9 for state in states for value in (*state[:2], *state[2]))
    assert all(sum(state[2]) == pytest.approx(1.0) for state in states)
    assert Phenology().habit == "summergreen"
