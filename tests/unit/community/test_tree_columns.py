"""Trees' sizes follow their neighbours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from forestgen.api.plant_requests import drawn_of
from forestgen.community.population import Population, Site, Status, ecology_of
from forestgen.community.tree_columns import COLUMNS, _covers, with_tree_sizes

SPECIES = [ecology_of(name, drawn_of(name, 0).species[name]) for name in ("spruce", "fireweed")]


def population(position_m: np.ndarray, height_m: np.ndarray, species: np.ndarray | int = 0, **columns) -> Population:
    count = len(height_m)
    return Population(
        time_yr=0.0,
        species_names=("spruce", "fireweed"),
        plant_id=np.arange(1, count + 1, dtype=np.uint32),
        species=np.broadcast_to(species, count).astype(np.uint16),
        position_m=np.column_stack([position_m, np.zeros(count)]),
        radius_m=np.ones(count),
        height_m=height_m,
        age_yr=np.zeros(count),
        status=np.zeros(count, dtype=np.uint8),
        columns=columns,
    )


def sized(plants: Population, side_m: float = 100.0, *, periodic: bool = True) -> Population:
    return with_tree_sizes(plants, SPECIES, Site((side_m, side_m)), 1, periodic=periodic)


def test_crowded_trees_are_slender_and_open_grown_ones_stout() -> None:
    x, y = np.meshgrid(np.arange(1.0, 100.0, 3.3), np.arange(1.0, 100.0, 3.3))
    grid = np.column_stack([x.ravel(), y.ravel()])
    dense = sized(population(grid, np.full(len(grid), 20.0)))
    lone = sized(population(np.array([[50.0, 50.0]]), np.array([20.0])))
    tall = sized(population(grid, np.where(np.arange(len(grid)) == 300, 12.0, 20.0)))
    law = SPECIES[0].tree
    assert law is not None
    relative = np.log(dense.columns["dbh_m"]) - law.log_dbh(dense.height_m)
    assert abs(np.median(relative)) < 0.05  # of a stand
    same = dense.columns["dbh_m"][0]  # of the same number
    assert lone.columns["dbh_m"][0] / same > 1.4
    assert lone.columns["crown_base_m"][0] < dense.columns["crown_base_m"][0]
    others = sized(population(grid, np.full(len(grid), 12.0))).columns["dbh_m"][300]
    assert tall.columns["dbh_m"][300] < others


def test_what_a_model_knows_stays_and_herbs_have_no_sizes() -> None:
    where = np.array([[10.0, 10.0], [20.0, 20.0], [30.0, 30.0]])
    known = np.array([0.4, np.nan, np.nan])
    made = sized(population(where, np.array([20.0, 20.0, 1.0]), np.array([0, 0, 1]), dbh_m=known))
    assert made.columns["dbh_m"][0] == 0.4
    assert np.isfinite(made.columns["dbh_m"][1])
    for name in COLUMNS:
        assert np.isnan(made.columns[name][2])
    median = sized(population(where, np.array([20.0, 20.0, 1.0]), np.array([0, 0, 1])))
    assert made.columns["leaf_area_m2"][0] != median.columns["leaf_area_m2"][0]  # follows the known diameter
    assert made.columns["leaf_area_m2"][1] == median.columns["leaf_area_m2"][1]


def test_dead_trees_have_the_leaves_that_a_model_gives_them_or_none() -> None:
    where = np.array([[10.0, 10.0], [20.0, 20.0], [30.0, 30.0], [40.0, 40.0]])
    given = np.array([np.nan, np.nan, 3.0, np.nan])
    plants = population(where, np.array([20.0, 20.0, 20.0, 1.0]), np.array([0, 0, 0, 1]), leaf_area_m2=given)
    made = sized(replace(plants, status=np.array([Status.GROWING, *[Status.DEAD] * 3], dtype=np.uint8)))
    assert made.columns["leaf_area_m2"][0] > 10
    assert made.columns["leaf_area_m2"][1:3].tolist() == [0, 3]
    assert np.isnan(made.columns["leaf_area_m2"][3])  # no tree
    assert np.isfinite(made.columns["dbh_m"][:3]).all()


def test_covers_are_those_of_every_pair() -> None:
    rng = np.random.default_rng(2)
    for periodic in (True, False):
        where, height, crown = rng.random((60, 2)) * 30.0, rng.uniform(3.0, 25.0, 60), rng.uniform(2.0, 9.0, 60)
        radius = np.clip(0.4 * height, 2.0, 12.0)
        near, over = _covers(where, height, crown, radius, (30.0, 30.0), periodic)
        away = where[:, None] - where[None]
        if periodic:
            away -= 30.0 * np.round(away / 30.0)
        inside = (np.hypot(away[..., 0], away[..., 1]) <= radius[:, None]) & ~np.eye(60, dtype=bool)
        ratio = height[None] / height[:, None]
        expected = np.where(inside & (ratio >= 0.6), crown[None], 0.0).sum(axis=1) / (np.pi * radius**2)
        if periodic:
            np.testing.assert_allclose(near, expected, rtol=1e-9)
        else:
            assert np.all(near >= expected - 1e-12)  # the part outside counts as the part inside
        assert np.all(over <= near + 1e-12)


def test_a_trees_number_is_its_own() -> None:
    """Another order or fewer trees far away change nothing."""
    where = np.array([[10.0, 10.0], [80.0, 80.0]])
    both = sized(population(where, np.array([18.0, 15.0])))
    alone = sized(population(where[:1], np.array([18.0])))
    assert both.columns["dbh_m"][0] == alone.columns["dbh_m"][0]
