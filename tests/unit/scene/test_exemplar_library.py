"""Sizes on a ladder, and which of a library's plants an image shows."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.scene.exemplar_plan import SIZE_STEP, rungs_of
from forestgen.scene.exemplars import plan_exemplars, size_errors
from tests.unit.scene.test_exemplars import population


def radii(n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).lognormal(0.0, 0.8, n)


@pytest.mark.parametrize("most", [1, 2, 5, 10, 100])
def test_each_plant_has_the_nearest_of_few_rungs(most: int) -> None:
    radius = radii(500)
    rungs = rungs_of(radius, most)
    chosen = np.unique(rungs)
    assert len(chosen) <= most
    own = np.rint(np.log(radius) / np.log(SIZE_STEP))
    assert own.min() <= chosen.min()
    assert chosen.max() <= own.max()
    distance = np.abs(own[:, None] - chosen[None, :])
    np.testing.assert_array_equal(np.abs(own - rungs), distance.min(axis=1))
    assert (np.diff(rungs[np.argsort(radius)]) >= 0).all()  # a larger plant never has a smaller model


def test_with_rungs_enough_each_plant_has_its_own_whatever_else_grows() -> None:
    radius = radii(200)
    rungs = rungs_of(radius, 100)
    np.testing.assert_array_equal(rungs[50:60], rungs_of(radius[50:60], 100))
    assert np.abs(np.log(SIZE_STEP**rungs / radius)).max() <= np.log(SIZE_STEP) / 2 + 1e-12


def test_rungs_that_lie_apart_need_no_neighbours() -> None:
    """A species of seedlings and old trees: two sizes, however many rungs are between them."""
    radius = np.array([0.1, 0.1, 5.0])
    np.testing.assert_array_equal(rungs_of(radius, 2), rungs_of(radius, 100))


@pytest.mark.parametrize("shown", [1, 3])
def test_an_image_shows_so_many_variants_of_a_size_and_images_show_all(shown: int) -> None:
    plants = population(radii(300))
    seen: dict[int, set[int]] = {}
    for seed in range(40):
        plan = plan_exemplars(plants, 4, seed, library=5, variants=shown)
        for rung in np.unique(plan.rank).tolist():
            here = set(plan.variant[plan.rank == rung].tolist())
            assert here <= set(range(5))
            assert len(here) <= shown
            seen.setdefault(rung, set()).update(here)
    assert all(variants == set(range(5)) for variants in seen.values())


def test_the_plan_is_that_of_rungs_and_its_errors_are_small() -> None:
    plants = population(radii(400), np.arange(400) % 2)
    plan = plan_exemplars(plants, 100, seed=3, library=4, variants=2)
    np.testing.assert_allclose(plan.radius_m, SIZE_STEP ** plan.rank.astype(float))
    np.testing.assert_array_equal(plan.species[plan.exemplar_of_plant], plants.species)
    assert len({*zip(plan.species, plan.rank, plan.variant, strict=True)}) == len(plan)
    for error in size_errors(plants, plan, plan.radius_m * 5, plan.radius_m, plants.radius_m):
        assert error.radius_rms < 0.5 * np.log(SIZE_STEP)
        assert error.crown_width_rms < 1e-9  # a width in proportion to the height is exact
