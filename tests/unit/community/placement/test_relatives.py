"""What the relatives of the deformation kernel have in common: numbers, maps, barred ground, seeds, messages."""

from __future__ import annotations

import dataclasses
import tracemalloc

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.stats import chisquare

from forestgen.community.population import Site
from forestgen.community.registry import COMMUNITY_MODELS
from forestgen.core.errors import RecipeError
from support.error_messages import raises_error

RELATIVES = ("halftone", "height_field", "jittered_grid", "poisson_disc", "strauss", "thomas", "uniform")
ALONE = ("halftone", "strauss", "thomas", "uniform")  # each species has a pattern of its own
SITE = Site((30.0, 20.0))
QUICK = {"strauss": {"sweeps": 10}}
# A third of the site is bare, another one has twice the density of the rest; plain squares, no slopes between them.
MAP = {"rows": [[0, 1, 2], [1, 2, 0]], "smooth": False}
SHARES = np.array([[1, 2, 0], [0, 1, 2]]) / 6  # of the plants, from south to north


def place(name, species, seed=1, site=SITE, **parameters):
    model = COMMUNITY_MODELS.load(name)
    chosen = model.Parameters(**{**QUICK.get(name, {}), **parameters})
    return model.population(model.init(chosen, site, species, seed))


def blocks(population, rows=2, cols=3, size_m=SITE.size_m):
    """(rows, cols) plants in the blocks of the site, from south to north."""
    x, y = population.position_m[:, 0], population.position_m[:, 1]
    return np.histogram2d(y, x, (rows, cols), ((0, size_m[1]), (0, size_m[0])))[0]


def bare(population, rows):
    """Whether some of the plants stand where `MAP` is 0, more than 0.25 m inside: maps are read on grids of cells."""
    x, y = population.position_m[rows, 0], population.position_m[rows, 1]
    nearby = [
        SHARES[np.clip((y + b) / 10, 0, 1).astype(int), np.clip((x + a) / 10, 0, 2).astype(int)]
        for a in (-0.25, 0.25)
        for b in (-0.25, 0.25)
    ]
    return np.max(nearby, axis=0) == 0


def count_of(population, name):
    return int(np.sum(population.species == population.species_names.index(name)))


@pytest.mark.parametrize("name", RELATIVES)
@pytest.mark.parametrize("periodic", [True, False])
def test_every_plant_of_every_species_stands_on_the_site(name, periodic, tree):
    species = [tree(), tree(name="b"), tree(name="none"), tree(name="c")]
    plants = {"tree": {"count": 61}, "b": {"count": 1}, "c": {"plants_per_ha": 500}}
    for seed in range(3):
        found = place(name, species, seed, periodic=periodic, plants=plants)
        assert [count_of(found, one.name) for one in species] == [61, 1, 0, 30]
        assert found.notes == ()
        at = found.position_m[:, :2]
        assert np.all((at >= 0) & (at <= SITE.size_m))
        assert np.all(found.position_m[:, 2] == 0)
        assert np.all(np.diff(found.radius_m) <= 0)  # largest first


@pytest.mark.parametrize("name", RELATIVES)
@pytest.mark.parametrize("periodic", [True, False])
def test_no_plant_stands_on_barred_ground(name, periodic, tree):
    keep_out = {"rows": [[0, 0, 0, 0, 0, 0], [0, 1, 1, 0, 0, 0], [0, 0, 0, 0, 1, 0]], "smooth": False}
    plants = {"tree": {"count": 90}, "b": {"count": 40, "map": MAP}}
    found = place(name, [tree(), tree(name="b")], 3, periodic=periodic, plants=plants, keep_out=keep_out)
    x, y = found.position_m[:, 0], found.position_m[:, 1]
    barred = np.array(keep_out["rows"])[::-1] > 0
    assert not np.any(barred[(y / 20 * 3).astype(int), (x / 30 * 6).astype(int)])
    assert not bare(found, found.species == 1).any()
    assert (count_of(found, "tree"), count_of(found, "b"), found.notes) == (90, 40, ())


@pytest.mark.parametrize("name", [one for one in RELATIVES if one != "height_field"])
def test_plants_follow_the_map(name, tree):
    """Independent plants have chi-square's distribution; those that keep apart are nearer to the map than that."""
    more = {"strauss": {"gamma": 1.0}, "thomas": {"plants_per_cluster": 0.1}}.get(name, {})  # hardly any clusters
    disc = name == "poisson_disc"
    plants = {"tree": {"count": 120 if disc else 240, "map": MAP}}
    grid = {"halftone": {"pixels": 96}, "jittered_grid": {}}.get(name, {"cells": 96})  # blocks are whole cells
    runs = [place(name, [tree()], seed, plants=plants, **grid, **more) for seed in range(3 if disc else 20)]
    found = np.sum([blocks(one) for one in runs], axis=0)
    assert not any(bare(one, slice(None)).any() for one in runs)
    some = SHARES > 0
    p = chisquare(found[some], SHARES[some] * found[some].sum()).pvalue
    assert p > 0.001
    if name in ("uniform", "strauss"):
        assert p < 0.999


@pytest.mark.parametrize("name", RELATIVES)
def test_conditions_bar_a_species(name, tree):
    """A slope from 0 m in the west to 30 m in the east; one species likes it low, the other high."""
    site = dataclasses.replace(SITE, height=lambda x, y: np.asarray(x, dtype=np.float64))
    plants = {
        "tree": {"count": 50, "conditions": {"elevation_m": [[10, 1], [20, 0]]}},
        "b": {"count": 30, "conditions": {"elevation_m": [[10, 0], [20, 1]]}},
    }
    found = place(name, [tree(), tree(name="b")], site=site, plants=plants)
    x = found.position_m[:, 0]
    low, high = x[found.species == 0], x[found.species == 1]
    assert (len(low), len(high)) == (50, 30)
    assert low.max() < 20.1
    assert high.min() > 9.9
    assert low.mean() < 11 < 19 < high.mean()


@pytest.mark.parametrize("name", RELATIVES)
def test_a_seed_is_a_pattern_whatever_else_was_placed_before(name, tree):
    species, plants = [tree(), tree(name="b")], {"tree": {"count": 40}, "b": {"count": 20, "map": MAP}}

    def places(seed):
        found = place(name, species, seed, plants=plants)
        return found.position_m.tobytes() + found.radius_m.tobytes() + found.species.tobytes()

    first = places(0)
    np.random.default_rng(5).random(7)
    assert places(1) != first
    place("uniform", species, 0, plants=plants)
    assert places(0) == first


@pytest.mark.parametrize("name", ALONE)
def test_a_species_leaves_the_places_of_those_before_it_alone(name, tree):
    plants = {"tree": {"count": 40}}
    alone = place(name, [tree()], plants=plants)
    both = place(name, [tree(), tree(name="b")], plants={**plants, "b": {"count": 25}})
    mine = both.position_m[both.species == 0]
    assert mine.tobytes() == alone.position_m.tobytes()


@pytest.mark.parametrize("name", RELATIVES)
def test_sizes_have_nothing_to_do_with_places(name, tree):
    """The larger half of the plants, many seeds: as many in the west as in the east, within four deviations."""
    west = 0
    for seed in range(12):
        found = place(name, [tree()], seed, plants={"tree": {"count": 60}})
        west += int(np.sum(found.position_m[:30, 0] < 15)) - int(np.sum(found.position_m[30:, 0] < 15))
    assert abs(west) < 4 * np.sqrt(12 * 60 * 0.25) * (3 if name == "thomas" else 1)


@pytest.mark.parametrize("name", RELATIVES)
def test_ground_that_bars_everything_is_a_result_with_a_reason(name, tree):
    nowhere = {"rows": [[0, 0]]}
    model = COMMUNITY_MODELS.load(name)
    parameters = model.Parameters(plants={"tree": {"plants_per_ha": 9}}, keep_out=[[1]])
    assert "keep_out bars the whole site" in model.empty_reason(parameters, SITE, [tree()])
    assert len(model.population(model.init(parameters, SITE, [tree()], 1))) == 0
    assert len(place(name, [], plants={})) == 0
    try:
        found = place(name, [tree(), tree(name="b")], plants={"tree": {"count": 5, "map": nowhere}, "b": {"count": 7}})
    except (RecipeError, ValidationError):
        return  # a map of nothing but zeros may be refused by itself
    assert count_of(found, "b") == 7
    assert any("0 of 5 plants of tree were placed: " in note for note in found.notes)


@pytest.mark.parametrize("name", RELATIVES)
def test_a_count_on_ground_that_is_all_kept_out(name, tree):
    found = place(name, [tree()], plants={"tree": {"count": 5}}, keep_out=[[1]])
    assert len(found) == 0
    assert len(found.notes) == 1
    assert found.notes[0].startswith("0 of 5 plants of tree were placed: ")


@pytest.mark.parametrize("name", ["deformation_kernel", *RELATIVES])
def test_conditions_that_bar_everything_are_named(name, tree):
    high = {"elevation_m": [[500, 0], [600, 1]], "slope_deg": [[5, 1], [10, 0]]}
    found = place(name, [tree()], plants={"tree": {"count": 5, "conditions": high}})
    bars = "elevation_m bars it on the whole site, where it is 0 m"
    assert found.notes == (f"0 of 5 plants of tree were placed: {bars}",)
    model = COMMUNITY_MODELS.load(name)
    parameters = model.Parameters(plants={"tree": {"plants_per_ha": 900, "conditions": high}})
    assert model.empty_reason(parameters, SITE, [tree()]) == f"no plant is placed: of tree, {bars}"


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("uniform", "cells", 3),
        ("uniform", "cells", "many"),
        ("jittered_grid", "jitter", 1.5),
        ("jittered_grid", "jitter", float("nan")),
        ("jittered_grid", "cells", 100),
        ("height_field", "jitter", -0.1),
        ("height_field", "min_distance_m", -1),
        ("height_field", "min_distance_m", float("inf")),
        ("halftone", "pixels", 3),
        ("halftone", "jitter", 2),
        ("halftone", "serpentine", "yes"),
        ("poisson_disc", "distance_m", 0),
        ("poisson_disc", "distance_m", float("nan")),
        ("thomas", "sigma_m", 0),
        ("thomas", "plants_per_cluster", 0),
        ("strauss", "gamma", 1.1),
        ("strauss", "gamma", -0.1),
        ("strauss", "interaction_radius_m", 0),
        ("strauss", "sweeps", 0),
    ],
)
def test_bad_values_are_refused(name, key, value):
    with pytest.raises(ValidationError) as refused:
        COMMUNITY_MODELS.load(name).Parameters(**{key: value})
    first = refused.value.errors()[0]
    assert (*first["loc"], *first.get("ctx", {}).get("at", ()))[0] == key


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("poisson_disc", {"plants": {"tree": {"count": 30_000}}}),
        ("poisson_disc", {"plants": {"tree": {"count": 3}}, "distance_m": 0.01}),
        ("poisson_disc", {"plants": {"tree": {"count": 3}}, "distance_m": 1e-300}),
        ("thomas", {"plants": {"tree": {"count": 30}}, "sigma_m": 31.0}),
        ("strauss", {"plants": {"tree": {"count": 100_000}}, "interaction_radius_m": 9.0}),
        ("strauss", {"plants": {"tree": {"count": 5_000_000}}, "sweeps": 100_000}),
    ],
)
def test_what_cannot_be_done_is_said_before_anything_is_placed(name, parameters, tree):
    model = COMMUNITY_MODELS.load(name)
    chosen = model.Parameters(**parameters)
    for ask in (lambda: model.estimate_bytes(chosen, SITE, [tree()]), lambda: model.init(chosen, SITE, [tree()], 1)):
        with raises_error(RecipeError):
            ask()


@pytest.mark.parametrize("name", RELATIVES)
def test_memory_is_no_more_than_estimated(name, tree):
    model = COMMUNITY_MODELS.load(name)
    n = {"poisson_disc": 60, "strauss": 500}.get(name, 4000)
    parameters = model.Parameters(plants={"tree": {"count": n, "map": MAP}}, **QUICK.get(name, {}))
    model.init(parameters, SITE, [tree()], 1)  # compiles
    tracemalloc.start()
    try:
        model.population(model.init(parameters, SITE, [tree()], 1))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak <= model.estimate_bytes(parameters, SITE, [tree()])
