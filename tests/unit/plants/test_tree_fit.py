"""Trees are built to their height, crown width, diameter, crown base and leaf area."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import forestgen as fg
from forestgen.api.plant_requests import plan_of, request_of
from forestgen.core.parts import Part
from forestgen.plants.build import leaf_area_m2
from forestgen.plants.exemplar import Exemplar
from forestgen.plants.growing import grow_exemplar
from forestgen.plants.plan import plan_plants
from forestgen.plants.tree_fit import BELOW_CROWN, Stretch, _reach
from forestgen.recipe.load import load_recipe_data
from forestgen.recipe.schema import NO_PLANTS
from forestgen.recipe.wood import Sweep, Wood
from forestgen.scene.plant_measures import stem_diameter_m
from support.error_messages import raises_error

SILHOUETTES_AND_STRANDS = ("spruce", "pine", "birch", "beech", "oak", "maple", "poplar")


def leaf_heights(exemplar: Exemplar) -> tuple[np.ndarray, np.ndarray]:
    """Height and area of every triangle of the leaves."""
    leaves = [organ.mesh for organ in exemplar.organs if organ.part == Part.LEAF]
    corners = np.concatenate([mesh.vertices_m.astype(float)[mesh.faces] for mesh in leaves])
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return corners[:, :, 2].mean(axis=1), 0.5 * np.linalg.norm(normal, axis=1)


def check_sizes(name: str, height_m: float, grown: str, seed: int) -> None:
    plan = plan_of(name, seed)
    request = request_of(plan, name, height_m, seed, grown)  # type: ignore[arg-type]
    tree, exemplar = request.tree, grow_exemplar(request)
    assert tree is not None
    assert exemplar.height_m == pytest.approx(height_m, rel=1e-3)
    assert exemplar.crown_width_m == pytest.approx(tree.crown_width_m, rel=0.05)
    assert leaf_area_m2(exemplar.organs, request.parameters.shapes) == pytest.approx(tree.leaf_area_m2, rel=0.05)
    assert stem_diameter_m(exemplar, np.array([1.3]))[0] == pytest.approx(tree.dbh_m, rel=0.05)
    height, area = leaf_heights(exemplar)
    order = np.argsort(height)
    base_m = height[order][np.searchsorted(np.cumsum(area[order]), BELOW_CROWN * area.sum())]
    assert base_m == pytest.approx(tree.crown_base_m, rel=0.05, abs=0.02 * height_m)


@pytest.mark.parametrize("name", SILHOUETTES_AND_STRANDS)
@pytest.mark.parametrize(("height_m", "grown"), [(5.0, "stand"), (14.0, "open"), (14.0, "suppressed"), (24.0, "stand")])
def test_a_tree_has_its_sizes(name: str, height_m: float, grown: str) -> None:
    check_sizes(name, height_m, grown, seed=3)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*SILHOUETTES_AND_STRANDS, "larch", "eucalyptus", "meranti"])
@pytest.mark.parametrize("height_m", [4.0, 8.0, 16.0, 30.0])
@pytest.mark.parametrize("grown", ["stand", "open", "suppressed"])
def test_any_tree_has_its_sizes(name: str, height_m: float, grown: str) -> None:
    for seed in (1, 2):
        check_sizes(name, height_m, grown, seed)


def test_trees_of_one_height_differ_and_a_seed_is_one_tree() -> None:
    plan = plan_of("spruce", 0)
    trees = [request_of(plan, "spruce", 20.0, seed).tree for seed in range(200)]
    spread = np.std(np.log([tree.dbh_m for tree in trees if tree is not None]))
    assert 0.15 < spread < 0.3  # 0.22 in the species' file
    assert request_of(plan, "spruce", 20.0, 5).tree == trees[5]


@pytest.mark.parametrize(
    ("name", "height_m", "grown"),
    [("spruce", 20.0, "stand"), ("spruce", 9.0, "open"), ("larch", 20.0, "stand")],
)
def test_crowns_of_conifers_end_in_a_tip(name: str, height_m: float, grown: str) -> None:
    """The radius about the stem that holds 90% of the leaf area falls from the crown's middle to its top."""
    plan = plan_of(name, 2)
    exemplar = grow_exemplar(request_of(plan, name, height_m, 2, grown))  # type: ignore[arg-type]
    height, area = leaf_heights(exemplar)
    leaves = [one.mesh for one in exemplar.organs if one.part == Part.LEAF]
    place = np.concatenate([mesh.vertices_m.astype(float)[mesh.faces].mean(axis=1) for mesh in leaves])[:, :2]
    base_m = np.quantile(height, BELOW_CROWN)
    layer = np.digitize((height - base_m) / (height.max() - base_m), [0.5, 0.7, 0.9])
    radius_m = []
    for here in (layer == k for k in range(1, 4)):
        away = np.hypot(*(place[here] - np.average(place[here], axis=0, weights=area[here])).T)
        order = np.argsort(away)
        radius_m.append(away[order][np.searchsorted(np.cumsum(area[here][order]), 0.9 * area[here].sum())])
    assert radius_m[0] > 1.2 * radius_m[1] > 2.0 * radius_m[2]
    assert radius_m[2] < 0.3 * 0.5 * exemplar.crown_width_m


@pytest.mark.parametrize(
    "species",
    [{"larch": {"from": "larch", "wood": {"sweep": None}}}, {"beech": {"from": "beech", "plant": {"pointed": 0.8}}}],
)
def test_an_outline_that_no_crown_would_get_is_refused(species: dict[str, object]) -> None:
    recipe = {"forestgen": 1, "seed": 1, "species": species, "community": NO_PLANTS}
    with raises_error(fg.RecipeError, place="plant.pointed"):
        plan_plants(load_recipe_data(recipe, "test", Path()).draw(0))


@pytest.mark.parametrize("name", ["spruce", "pine"])
def test_crowns_of_conifers_are_wide_about_their_stem(name: str) -> None:
    """A stem that is not straight counts as no part of the crown's width: layers are nearly as wide as the crown."""
    plan = plan_of(name, 0)
    for seed in range(4):
        request = request_of(plan, name, 20.0, seed)
        exemplar = grow_exemplar(request)
        assert request.tree is not None
        leaves = [one.mesh for one in exemplar.organs if one.part == Part.LEAF]
        place = np.concatenate([mesh.vertices_m.astype(float)[mesh.faces].mean(axis=1) for mesh in leaves])
        layer = (place[:, 2] / 20.0 * 40).astype(int)
        widths_m = [np.ptp(place[layer == k, :2], axis=0).mean() for k in np.unique(layer)]
        assert 0.75 < max(widths_m) / request.tree.crown_width_m < 1.05


def test_filling_a_crown_draws_no_point_in() -> None:
    """Whorls on a stem of which most layers are bare: each keeps its place at least."""
    points = np.zeros((400, 3))
    points[:, 2] = np.linspace(0.0, 20.0, 400)
    points[::57, 0] = np.random.default_rng(3).uniform(0.5, 3.0, len(points[::57]))
    stretch = Stretch(1.0, 1.5, _reach(points, 24), 10.0, 10.0, 20.0, 20.0, np.zeros((1, 3)), 1.0, np.ones(24))
    assert (stretch.points(points)[:, 0] > points[:, 0] - 1e-9).all()


@pytest.mark.parametrize(("name", "is_straight"), [("pine", True), ("eucalyptus", False)])
def test_stems_alone_that_a_sweep_bends_are_straight_before(name: str, is_straight: bool) -> None:
    request = request_of(plan_of(name, 0), name, 20.0, 1)
    parameters = request.parameters
    if is_straight:
        wood = parameters.wood.model_copy(update={"years": Wood(sweep=Sweep())})
        request = replace(request, parameters=parameters.model_copy(update={"wood": wood}))
    stem = [one.mesh.vertices_m for one in grow_exemplar(request).organs if one.part == Part.TRUNK]
    place = np.concatenate(stem).astype(float)
    layer = np.digitize(place[:, 2], np.arange(1.0, 19.0, 2.0))
    middle = np.array([np.median(place[layer == k, :2], axis=0) for k in np.unique(layer)])
    assert (np.ptp(middle, axis=0).max() < 0.03) == is_straight


def test_open_grown_trees_are_stout_with_a_low_crown() -> None:
    plan = plan_of("oak", 0)
    trees = [request_of(plan, "oak", 16.0, 1, grown).tree for grown in ("suppressed", "stand", "open")]  # type: ignore[arg-type]
    for name, direction in (("dbh_m", 1), ("crown_width_m", 1), ("leaf_area_m2", 1), ("crown_base_m", -1)):
        values = [getattr(tree, name) for tree in trees]
        assert sorted(values) == values[::direction]


def test_the_way_of_growing_is_checked() -> None:
    with raises_error(fg.RecipeError, place="grown"):
        fg.plant("spruce", 10.0, grown="lonely")  # type: ignore[arg-type]
    with raises_error(fg.RecipeError, place="grown"):
        fg.plant("fireweed", grown="open")


def test_saplings_that_reach_breast_height_with_their_tips_are_thin() -> None:
    for name in ("spruce", "birch"):
        plan = plan_of(name, 0)
        for height_m in (1.31, 1.4, 1.9):
            exemplar = grow_exemplar(request_of(plan, name, height_m, 0, "open"))
            assert exemplar.wood_volume_m3 < 0.005
            assert exemplar.crown_width_m < 2.5
