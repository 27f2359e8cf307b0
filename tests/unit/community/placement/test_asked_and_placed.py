"""Densities as asked for, the field that is left, and counts against both."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chisquare, kstest

from forestgen.community.models.deformation_kernel import MODEL
from forestgen.community.placement.kernels import KernelSection, table
from forestgen.community.placement.model import (
    _FEWEST_EXPECTED,
    _joined,
    asked_densities,
    counts_against,
    deformed,
    describe_densities,
)
from forestgen.community.population import Population

SIZE = (60.0, 40.0)
MAP = [[0, 1, 2], [4, 2, 1]]


def parameters(**more):
    plants = {"tree": {"count": 120, "map": {"rows": MAP, "fit": "stretch", "smooth": False}}}
    return MODEL.Parameters(**{"plants": plants, "kernels": "neutral", **more})


def population(places, radii, species, names=("tree", "b")):
    n = len(places)
    return Population(
        time_yr=0.0,
        species_names=names,
        plant_id=np.arange(1, n + 1, dtype=np.uint32),
        species=np.array(species, np.uint16),
        position_m=np.column_stack([places, np.zeros(n)]),
        radius_m=np.array(radii, np.float64),
        height_m=np.ones(n),
        age_yr=np.ones(n),
        status=np.zeros(n, np.uint8),
    )


def draw(density, n, rng):
    """Places with a density, by cell and then evenly in it."""
    rows, cols = density.shape
    cell = rng.choice(density.size, size=n, p=density.ravel() / density.sum())
    return (np.stack([cell % cols, cell // cols], axis=1) + rng.random((n, 2))) / (cols, rows) * SIZE


def test_a_density_holds_as_many_plants_as_were_asked_for(site, tree):
    keep_out = {"rows": [[0, 0, 1], [0, 0, 0]], "fit": "stretch", "smooth": False}
    species = [tree(), tree(name="b")]
    found = asked_densities(parameters(keep_out=keep_out), site, species, (40, 60))
    assert found.asked == {"tree": 120}  # a species without an entry has no density
    assert found.asked_per_ha["tree"].mean() * site.area_ha == pytest.approx(120)
    assert found.barred is not None
    assert not found.asked_per_ha["tree"][found.barred].any()
    assert found.barred.mean() == pytest.approx(1 / 6)
    # Row 0 lies at y = 0: the map's last row, whose first value is the largest.
    assert found.asked_per_ha["tree"][0, 0] == pytest.approx(found.asked_per_ha["tree"].max())
    assert found.asked_per_ha["tree"][-1, 0] == 0


@pytest.mark.parametrize("periodic", [True, False])
def test_the_field_that_is_left_is_the_density_times_all_kernels(site, tree, periodic):
    both = {name: {"count": 50} for name in ("tree", "b")}
    species = [tree(), tree(name="b")]
    asked = asked_densities(parameters(plants=both), site, species, (40, 60))
    shy, fond = (table(KernelSection(curve=curve)) for curve in ([[0, 0], [2, 1]], [[0, 3], [4, 1]]))
    neutral = table(KernelSection(curve=1.0, reach=1.0))
    matrix = [[shy, neutral], [fond, shy]]
    placed = population([[5, 5], [30, 20], [57, 39], [31, 22]], [3, 2, 2, 1.5], [0, 1, 0, 0])
    left = deformed(asked, site, periodic, species, placed, matrix).left_per_ha
    assert left is not None
    x, y = np.meshgrid(np.arange(60) + 0.5, np.arange(40) + 0.5)
    for row, name in enumerate(("tree", "b")):
        wanted = asked.asked_per_ha[name].copy()
        for (px, py, _), radius, kind in zip(placed.position_m, placed.radius_m, placed.species, strict=True):
            dx, dy = np.abs(x - px), np.abs(y - py)
            if periodic:
                dx, dy = np.minimum(dx, 60 - dx), np.minimum(dy, 40 - dy)
            wanted *= matrix[row][kind](np.hypot(dx, dy), float(radius))
        np.testing.assert_allclose(left[name], wanted, rtol=1e-9)


def test_even_counts_are_those_of_the_textbook():
    rng = np.random.default_rng(3)
    places = rng.random((1000, 2)) * SIZE
    found = counts_against(np.ones((96, 144)), places, SIZE)
    counts, _, _ = np.histogram2d(places[:, 0], places[:, 1], bins=(12, 8), range=((0, 60), (0, 40)))
    book = chisquare(counts.ravel())
    assert found is not None
    assert found.degrees_of_freedom == 95
    assert found.statistic == pytest.approx(book.statistic, rel=1e-9)
    assert found.p_value == pytest.approx(book.pvalue, rel=1e-9)


def test_p_values_of_plants_that_follow_the_density_are_uniform():
    density = np.kron(np.array(MAP, dtype=np.float64)[::-1], np.ones((20, 20)))
    found = [counts_against(density, draw(density, 400, np.random.default_rng(k)), SIZE) for k in range(150)]
    assert kstest([one.p_value for one in found if one is not None], "uniform").pvalue > 0.001


def test_plants_that_do_not_follow_it_are_told():
    density = np.kron(np.array(MAP, dtype=np.float64), np.ones((20, 20)))
    found = counts_against(density, draw(density[::-1], 400, np.random.default_rng(1)), SIZE)
    assert found is not None
    assert found.p_value < 1e-6


@pytest.mark.parametrize("n", [0, 1, 9])
def test_few_plants_are_not_judged(n):
    assert counts_against(np.ones((9, 9)), np.random.default_rng(0).random((n, 2)) * SIZE, SIZE) is None


def test_one_bin_is_not_judged():
    density = np.zeros((40, 60))
    density[3, 4] = 1.0
    places = np.tile([[4.5, 3.5]], (50, 1))
    assert counts_against(density, places, SIZE) is None


def test_bins_are_put_together_without_losing_a_plant():
    rng = np.random.default_rng(5)
    found, expected = rng.integers(0, 9, 60).astype(float), rng.exponential(3.0, 60)
    some, wanted = _joined(found, expected)
    assert some.sum() == found.sum()
    assert wanted.sum() == pytest.approx(expected.sum())
    assert wanted.min() >= _FEWEST_EXPECTED
    assert len(wanted) > 10


def test_a_description_is_plain(site, tree):
    species = [tree(), tree(name="b")]
    asked = asked_densities(parameters(), site, species)
    places = np.random.default_rng(0).random((100, 2)) * SIZE
    told = describe_densities(asked, population(places, np.ones(100), [0] * 90 + [1] * 10), site)
    assert set(told) == {"tree"}
    assert told["tree"]["asked"] == 120
    assert told["tree"]["placed"] == 90
    assert told["tree"]["chi_square"]["p_value"] < 0.001
    assert set(told["tree"]["chi_square"]) == {"statistic", "degrees_of_freedom", "p_value"}


def test_every_placement_model_tells_its_densities(site, tree):
    placed = MODEL.population(MODEL.init(parameters(), site, [tree()], 1))
    told = MODEL.densities(parameters(), site, [tree()], placed)
    assert told.asked == {"tree": 120}
