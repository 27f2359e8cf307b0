"""Kernels that would take minutes are refused before the work."""

from __future__ import annotations

import time

import pytest

from forestgen.community.models.deformation_kernel import MODEL as DEFORMATION
from forestgen.community.models.kernel_growth import MODEL as GROWTH
from forestgen.community.placement.kernels import KernelSection, refuse_long_work
from forestgen.community.population import Site, SpeciesEcology
from forestgen.core.errors import RecipeError
from support.error_messages import raises_error

SITE = Site((50.0, 50.0))
SPECIES = [SpeciesEcology(name, 0.05, 2.0, 0.5, 0.99, 10.0, 0.05, 3.0, 0.9) for name in ("spruce", "birch")]
FAR = {"curve": [[0, 0], [1, 1]], "reach": 1e4, "distance": "metres"}


@pytest.mark.parametrize(
    ("kernels", "where"),
    [
        (FAR, "community.kernels"),
        ({"birch": FAR, "spruce": "inhibition"}, "community.kernels.birch"),
        ({"birch": {"spruce": FAR}, "spruce": "inhibition"}, "community.kernels.birch.spruce"),
    ],
)
def test_many_plants_that_change_the_whole_site_are_refused_at_once(kernels, where):
    plants = {one.name: {"count": 20_000} for one in SPECIES}
    parameters = DEFORMATION.Parameters(plants=plants, kernels=kernels)
    started = time.perf_counter()
    with raises_error(RecipeError, place=where):
        DEFORMATION.estimate_bytes(parameters, SITE, SPECIES)
    assert time.perf_counter() - started < 5
    few = parameters.model_copy(update={"plants": DEFORMATION.Parameters(plants={"birch": {"count": 100}}).plants})
    DEFORMATION.estimate_bytes(few, SITE, SPECIES)


def test_a_million_plants_with_an_ordinary_reach_are_not():
    parameters = DEFORMATION.Parameters(plants={"birch": {"count": 1_000_000, "radius_m": 0.04}}, kernels="clustering")
    assert DEFORMATION.estimate_bytes(parameters, SITE, SPECIES) > 1_000_000  # no error; bytes, at least one a plant


def test_a_first_cohort_that_competes_across_the_site_is_refused():
    parameters = GROWTH.Parameters(initial_plants_per_ha=400_000, kernels=FAR)
    with raises_error(RecipeError, place="community.kernels"):
        GROWTH.estimate_bytes(parameters, SITE, SPECIES)
    GROWTH.estimate_bytes(GROWTH.Parameters(initial_plants_per_ha=400_000), SITE, SPECIES)


def test_work_is_the_area_within_reach():
    kernel = KernelSection(curve=[[0, 0], [2, 1]])
    cells, words = 2 * 10 * 3.14159 * 3.0**2, ("", "", "")  # of 1 m, two fields
    acting, affected = {"a": (10, 1.5), "b": (10, 1.5)}, {"a": 2500.0, "b": 2500.0}
    refuse_long_work({"a": kernel}, SITE, acting, affected, cells * 1.001, words)
    with pytest.raises(RecipeError) as caught:
        refuse_long_work({"a": kernel}, SITE, acting, affected, cells * 0.999, words)
    assert caught.value.where == "community.kernels.a"
