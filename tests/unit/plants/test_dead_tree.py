"""Dead trees: what is left of the living one, class by class, and how it stands or lies."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from forestgen.api.plant_requests import plan_of, request_of
from forestgen.core.dead_wood import (
    CLASSES,
    DeadForm,
    DeadTree,
    lying_volume_m3,
    standing_volume_m3,
    stump_height_m,
)
from forestgen.core.parts import Part
from forestgen.core.randomness import child_rng
from forestgen.core.stem_form import stem_radius_m
from forestgen.geometry.mesh import surface_area_m2
from forestgen.plants.build import grown_tree
from forestgen.plants.crown_twigs import first_stem
from forestgen.plants.dead_exemplar import END_GRAIN, MOSS, WEATHERED, bare_parameters, with_dead_wood
from forestgen.plants.dead_tree import dead_skeleton
from forestgen.plants.exemplar import Exemplar
from forestgen.plants.growing import ExemplarRequest, grow_exemplar
from forestgen.plants.skeleton import Skeleton
from forestgen.plants.stem_surface import COVERED
from forestgen.plants.tree_fit import fit_tree

SPECIES = ("spruce", "maple")
HEIGHT_M = 15.0
STANDING = [DeadTree(DeadForm.STANDING, decay) for decay in range(1, CLASSES + 1)]
ALL = [DeadTree(form, decay) for form in list(DeadForm)[1:] for decay in range(1, CLASSES + 1)]


@cache
def request_for(name: str) -> ExemplarRequest:
    return request_of(plan_of(name, 1), name, HEIGHT_M, 1)


@cache
def living(name: str) -> Skeleton:
    request = request_for(name)
    rng, plant, tree = child_rng(1, "living", name), request.parameters, request.tree
    assert tree is not None
    grown = grown_tree(name, plant, tree, rng, None)[0]
    return fit_tree(grown, plant, plant.templates(), tree, rng).skeleton


def left(name: str, dead: DeadTree, seed: int = 0) -> Skeleton:
    return dead_skeleton(living(name), dead, HEIGHT_M, dbh_m(name), child_rng(seed, "dead")).skeleton


def dbh_m(name: str) -> float:
    tree = request_for(name).tree
    assert tree is not None
    return tree.dbh_m


@cache
def exemplar(name: str, dead: DeadTree, pixel_m: float = 0.0) -> Exemplar:
    request = request_for(name)
    species, parameters = with_dead_wood(request.species), bare_parameters(request.parameters, dead)
    return grow_exemplar(replace(request, species=species, parameters=parameters, dead=dead, pixel_m=pixel_m))


def branch_length_m(skeleton: Skeleton) -> float:
    way = skeleton.position_m - skeleton.position_m[np.maximum(skeleton.parent, 0)]
    return float(np.linalg.norm(way, axis=1)[~first_stem(skeleton.axis)].sum())


@pytest.mark.parametrize("name", SPECIES)
def test_branches_and_stem_diminish_with_every_class(name: str) -> None:
    lengths = [branch_length_m(one) for one in (living(name), *(left(name, one) for one in STANDING))]
    assert np.all(np.diff(lengths[:5]) < 0.0)
    last = left(name, STANDING[4])
    stem = first_stem(last.axis)
    top_m = float(last.position_m[stem, 2].max())
    assert last.position_m[~stem, 2].min() > 0.9 * top_m  # no branch but the break's splinters
    for form in (DeadForm.UPROOTED, DeadForm.SNAPPED):
        trees = [DeadTree(form, decay) for decay in range(1, CLASSES + 1)]
        lying = [dead_skeleton(living(name), one, HEIGHT_M, dbh_m(name), child_rng(0, "dead")) for one in trees]
        assert np.all(np.diff([one.lying_m3 for one in lying]) <= 0.0)


def test_a_number_of_each_branch_decides_so_that_what_is_left_was_there_before() -> None:
    finer, coarser = (left("spruce", DeadTree(DeadForm.STANDING, one)) for one in (1, 2))
    tips = np.setdiff1d(np.arange(len(coarser.parent)), coarser.parent)
    apart = np.linalg.norm(finer.position_m[None] - coarser.position_m[tips, None], axis=2).min(axis=1)
    assert np.median(apart) == 0.0  # whole branches of the second class end where they did
    assert np.array_equal(left("spruce", DeadTree(DeadForm.STANDING, 2)).position_m, coarser.position_m)
    other = left("spruce", DeadTree(DeadForm.STANDING, 2), seed=1)
    assert not np.array_equal(other.position_m[: len(tips)], coarser.position_m[: len(tips)])


@pytest.mark.parametrize("name", SPECIES)
@pytest.mark.parametrize("decay", range(1, CLASSES + 1))
def test_a_lying_stem_touches_flat_ground_all_along_and_nothing_floats(name: str, decay: int) -> None:
    tree = left(name, DeadTree(DeadForm.UPROOTED, decay))
    stem = first_stem(tree.axis)
    lowest_m = tree.position_m[stem, 2] - tree.radius_m[stem]
    assert np.all(lowest_m <= 1e-4)
    assert np.all(lowest_m >= -tree.radius_m[stem])
    assert float(tree.position_m[stem, 1].max()) == pytest.approx(
        DeadTree(DeadForm.UPROOTED, decay).left * 15, rel=0.05
    )
    roots = tree.position_m[:, 1] <= tree.position_m[0, 1] + 1e-6
    others = ~stem & ~roots & (tree.axis < tree.axis.max())
    assert float((tree.position_m[:, 2] + tree.radius_m)[others].min()) > 0.0  # no branch is all below the ground
    assert np.all(tree.parent[1:] >= 0)  # each hangs on the tree


@pytest.mark.parametrize("name", SPECIES)
@pytest.mark.parametrize("decay", [1, 3, 5])
def test_volumes_of_stems_are_those_of_the_formulas(name: str, decay: int) -> None:
    for form in (DeadForm.UPROOTED, DeadForm.SNAPPED):
        dead = DeadTree(form, decay)
        made = dead_skeleton(living(name), dead, HEIGHT_M, dbh_m(name), child_rng(0, "dead")).lying_m3
        of = np.array([form]), np.array([decay]), np.array([dead.left * HEIGHT_M]), np.array([dbh_m(name)])
        assert made == pytest.approx(float(lying_volume_m3(*of)[0]), rel=0.05)
    standing = np.array([DeadForm.STANDING]), np.array([1]), np.array([20.0]), np.array([0.3])
    at = np.linspace(0.0, 20.0, 20_001)
    radius = stem_radius_m(at, 20.0, 0.3)
    assert float(standing_volume_m3(*standing)[0]) == pytest.approx(np.trapezoid(np.pi * radius**2, at), rel=1e-3)
    assert 2.0 * float(stem_radius_m(np.array([1.3]), 20.0, 0.3)[0]) == pytest.approx(0.3)


@pytest.mark.parametrize("dead", ALL, ids=lambda one: f"{one.form.name}-{one.decay}")
def test_all_of_a_dead_tree_is_dead_wood_of_known_materials(dead: DeadTree) -> None:
    plant, known = exemplar("spruce", dead), with_dead_wood(request_for("spruce").species).materials
    assert {organ.part for organ in plant.organs} == {Part.DEAD_WOOD}
    assert all(organ.material.split(COVERED)[0] in known for organ in plant.organs)
    assert plant.leaf_area_m2 == 0.0
    assert (plant.lying_m3 > 0.0) == dead.lies
    assert all(np.isfinite(organ.mesh.vertices_m).all() for organ in plant.organs)
    if dead.form == DeadForm.STANDING:
        assert plant.height_m == pytest.approx(dead.left * HEIGHT_M, rel=0.12)
    elif dead.form == DeadForm.STUMP:
        assert plant.height_m == pytest.approx(float(stump_height_m(np.array(dbh_m("spruce")))), abs=0.01)
    else:
        reach_m = float(plant.bounds_m()[1, 1])
        assert reach_m == pytest.approx((dead.left - 0.2 * (dead.form == DeadForm.SNAPPED)) * HEIGHT_M, rel=0.15)


def test_bark_gives_way_to_grey_wood_and_moss_covers_what_lies() -> None:
    def area_m2(dead: DeadTree, *materials: str) -> float:
        organs = [organ for organ in exemplar("maple", dead).organs if organ.material in materials or not materials]
        return sum(surface_area_m2(organ.mesh) for organ in organs)

    bark = [area_m2(dead, "bark") for dead in STANDING]
    assert np.all(np.diff(bark) < 0.0)
    assert bark[4] == 0.0
    assert area_m2(STANDING[0], WEATHERED) == 0.0
    assert area_m2(STANDING[4], WEATHERED) == area_m2(STANDING[4])
    lying = [DeadTree(DeadForm.UPROOTED, decay) for decay in range(1, CLASSES + 1)]
    moss = [area_m2(dead, MOSS) / area_m2(dead) for dead in lying]
    assert moss[0] == 0.0
    assert np.all(np.diff(moss) > 0.0)
    assert area_m2(DeadTree(DeadForm.STUMP, 1), END_GRAIN) > 0.0


def test_a_plant_is_the_same_from_far_and_near_but_for_detail() -> None:
    near, far = (exemplar("maple", DeadTree(DeadForm.STANDING, 2), pixel_m) for pixel_m in (0.0, 0.05))
    assert far.triangles < near.triangles
    np.testing.assert_allclose(far.bounds_m(), near.bounds_m(), atol=0.15)
    assert far.wood_volume_m3 == near.wood_volume_m3
