"""Measured trees, and the allometries that are fitted to them."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.recipe.tree_sizes import LEAVES_BY_CROWN
from support.field_trees import COLUMNS, RELATIVES, classes, field_trees, fitted, left_out, sizes_of, spread_of_median


def test_allometries_are_found_again_in_trees_drawn_from_them() -> None:
    """Fitted to 4,000 trees that an allometry draws, the allometry comes out again."""
    rng = np.random.default_rng(5)
    allometries = fitted(field_trees(RELATIVES["spruce"]), 50.0)
    height_m = rng.uniform(4.0, 35.0, 4000)
    drawn = allometries.draw(height_m, rng)
    trees = field_trees(RELATIVES["spruce"]).iloc[:1].loc[[0] * len(height_m)].reset_index(drop=True)
    trees = trees.assign(
        height_m=height_m,
        dbh_m=drawn["dbh"],
        crown_width_m=drawn["width"],
        leaf_mass_kg=drawn["leaves"],
        crown_ratio=drawn["crown"],
    )
    again = fitted(trees, 50.0)
    for name, allometry in {"dbh": allometries.dbh, **allometries.others}.items():
        found = again.dbh if name == "dbh" else again.others[name]
        assert found.at_10_m == pytest.approx(allometry.at_10_m, abs=0.06)
        assert found.exponent == pytest.approx(allometry.exponent, abs=0.06)
        assert found.relative_dbh == pytest.approx(allometry.relative_dbh, abs=0.1)
        assert found.spread == pytest.approx(allometry.spread, abs=0.05)


@pytest.mark.parametrize("name", RELATIVES)
def test_drawn_diameters_have_the_measured_median(name: str) -> None:
    """In each class of height within 25%, or within two standard errors of the measured median."""
    rng = np.random.default_rng(1)
    trees = field_trees(RELATIVES[name])
    allometries = fitted(trees, sizes_of(name).tallest_m)
    for low, high, members in classes(trees, fewest=10):
        measured = members.dbh_m.to_numpy()
        drawn = allometries.draw(np.repeat(members.height_m.to_numpy(), 200), rng)["dbh"]
        away = abs(np.log(np.median(drawn) / np.median(measured)))
        assert away <= max(np.log(1.25), 2.0 * spread_of_median(measured, rng)), (low, high)


def test_studies_are_foretold_by_the_others() -> None:
    """Each study against allometries fitted to the others. Studies differ by site and age, so that not all are met;
    but half of the median diameters are within 25%, and on the whole nothing is too large or too small."""
    rng = np.random.default_rng(1)
    away = {
        size: np.log(
            [
                ratio
                for name in RELATIVES
                for ratio in left_out(field_trees(RELATIVES[name]), size, sizes_of(name).tallest_m, rng).values()
            ]
        )
        for size in COLUMNS
    }
    assert np.median(np.abs(away["dbh"])) < np.log(1.25)
    for size, ratios in away.items():
        if len(ratios) >= 5:  # widths are of one study
            assert abs(ratios.mean()) < max(np.log(1.1), 2.0 * ratios.std() / np.sqrt(len(ratios))), size


def test_stout_trees_have_wide_and_long_crowns() -> None:
    """At one height, crowns are wider, longer and leafier where the stem is thicker."""
    for species in ("spruce", "pine", "birch", "oak"):
        others = fitted(field_trees(RELATIVES[species]), sizes_of(species).tallest_m).others
        assert min(allometry.relative_dbh for allometry in others.values()) > 0.5


def test_leaves_follow_the_crowns_length() -> None:
    """Of trees of one height and diameter: mean power of the species, by the inverse of its variance."""
    powers, weights = [], []
    for species in RELATIVES.values():
        trees = field_trees(species)
        trees = trees[(trees.leaf_mass_kg > 0.0) & (trees.crown_ratio > 0.0) & (trees.height_m > 5.0)]
        if len(trees) < 25:
            continue
        sizes = np.log(trees[["height_m", "dbh_m", "crown_ratio"]].to_numpy())
        terms = np.column_stack([np.ones(len(trees)), sizes])
        found, squares, _, _ = np.linalg.lstsq(terms, np.log(trees.leaf_mass_kg.to_numpy()), rcond=None)
        powers.append(found[3])
        weights.append((len(trees) - 4) / (squares[0] * np.linalg.inv(terms.T @ terms)[3, 3]))
    assert len(powers) == 7
    error = 1.0 / np.sqrt(np.sum(weights))
    assert error < 0.1
    assert abs(np.average(powers, weights=weights) - LEAVES_BY_CROWN) < 0.02
