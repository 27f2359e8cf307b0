"""Dead branches below the crown: where they are, how heavy, and that the living tree stays as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.api.plant_requests import plan_of, request_of
from forestgen.core.parts import Part
from forestgen.core.randomness import child_rng
from forestgen.core.stem_form import stem_radius_m
from forestgen.geometry.mesh import Floats, Mesh
from forestgen.plants.dead_branches import dead_branches
from forestgen.plants.exemplar import OrganMesh
from forestgen.plants.growing import grow_exemplar
from forestgen.plants.parameters import Wood
from forestgen.plants.skeleton import Skeleton
from forestgen.plants.tree_size import TreeSize
from forestgen.scene.plant_measures import PlantMeter
from forestgen.scene.spec import Instances

SIZES = {"spruce": (20.0, 0.21, 8.3), "pine": (20.0, 0.22, 10.4), "birch": (16.0, 0.14, 6.8)}
WOOD_KG_PER_M3 = 450.0


def wood_of(name: str) -> Wood:
    wood: Wood = request_of(plan_of(name, 1), name, 12.0, 1).parameters.wood
    return wood


def tree_of(name: str) -> TreeSize:
    height_m, dbh_m, base_m = SIZES[name]
    return TreeSize(height_m, 3.4, dbh_m, base_m, 100.0)


def stem_of(tree: TreeSize) -> Skeleton:
    """A stem without branches."""
    height_m = np.linspace(0.0, tree.height_m, 50)
    points = np.stack([np.zeros(50), np.zeros(50), height_m], axis=1)
    radius = stem_radius_m(height_m, tree.height_m, tree.dbh_m)
    return Skeleton.of(np.arange(-1, 49), points, radius, np.zeros(50), np.zeros(50))


def all_on_stem(name: str, seed: int = 1, pixel_m: float = 0.0) -> tuple[OrganMesh, ...]:
    tree, wood = tree_of(name), wood_of(name)
    assert wood.years is not None
    assert wood.years.dead_branches is not None
    return dead_branches(stem_of(tree), wood.years.dead_branches, wood, tree, pixel_m, child_rng(seed, "dead", name))


def on_stem(name: str, seed: int = 1, pixel_m: float = 0.0) -> OrganMesh:
    return all_on_stem(name, seed, pixel_m)[0]


def volume_m3(mesh: Mesh) -> float:
    a, b, c = mesh.vertices_m.astype(np.float64)[mesh.faces].transpose(1, 0, 2)
    return float(np.sum(a * np.cross(b, c)) / 6.0)


def repola_kg(name: str, height_m: float, dbh_m: float) -> float:
    """Dry mass of dead branches: Repola 2009 (spruce, pine), 2008 (birch), models by diameter and height."""
    foot_cm = 2.0 + 1.25 * 100.0 * dbh_m
    if name == "spruce":
        return float(1.343 * np.exp(-4.850 + 7.702 * foot_cm / (foot_cm + 18) + 0.513 * np.log(height_m)))
    if name == "pine":
        return float(0.911 * np.exp(-5.201 + 10.574 * foot_cm / (foot_cm + 16)))
    return float(2.0737 * np.exp(-8.335 + 12.402 * foot_cm / (foot_cm + 16)))


@pytest.mark.parametrize("name", SIZES)
def test_mass_is_that_of_finnish_trees_within_a_factor_of_two(name: str) -> None:
    made = np.mean([WOOD_KG_PER_M3 * volume_m3(on_stem(name, seed).mesh) for seed in range(4)])
    height_m, dbh_m, _ = SIZES[name]
    assert 0.5 < made / repola_kg(name, height_m, dbh_m) < 2.0


@pytest.mark.parametrize("name", SIZES)
def test_they_are_below_the_crown_and_shorter_further_down(name: str) -> None:
    points = on_stem(name).mesh.vertices_m.astype(np.float64)
    base_m = SIZES[name][2]
    reach = np.hypot(points[:, 0], points[:, 1])
    assert reach.max() < 0.5 * 3.4
    upper, lower = points[:, 2] > 0.6 * base_m, points[:, 2] < 0.3 * base_m

    def far(rows: Floats) -> float:
        return float(np.percentile(reach[rows], 90))

    assert far(lower) < 0.8 * far(upper)
    assert points[:, 2].min() > 0.0


def test_far_versions_have_no_twigs_and_no_stubs() -> None:
    near, far = on_stem("spruce"), on_stem("spruce", pixel_m=0.4)
    assert far.mesh.triangles < 0.5 * near.mesh.triangles
    assert far.part == Part.BRANCH


@pytest.mark.parametrize("name", ["spruce", "beech"])
def test_the_living_tree_stays_as_it_is(name: str) -> None:
    request = request_of(plan_of(name, 1), name, 12.0, 1)
    wood = request.parameters.wood
    years = wood.years.model_copy(update={"dead_branches": None})
    bare = request.parameters.model_copy(update={"wood": wood.model_copy(update={"years": years})})
    bare = replace(request, parameters=bare)
    with_dead, without = grow_exemplar(request), grow_exemplar(bare)
    assert with_dead.triangles > without.triangles
    assert (with_dead.leaf_area_m2, with_dead.height_m) == (without.leaf_area_m2, without.height_m)
    place = np.concatenate([np.eye(3), np.zeros((3, 1))], axis=1)[None]
    one = Instances(np.zeros(1, np.uint32), place, np.ones(1, np.uint32))
    measured = [PlantMeter([exemplar]).measure(one) for exemplar in (with_dead, without)]
    for column in ("crown_width_m", "dbh_m", "crown_base_m", "leaf_area_m2", "tip_m", "crown_centre_m"):
        assert np.array_equal(*(getattr(found, column) for found in measured)), column


def test_the_stem_has_a_collar_of_its_own_bark_round_each_thick_branch() -> None:
    tree, wood = tree_of("pine"), wood_of("pine")
    assert wood.years is not None
    assert wood.years.dead_branches is not None
    few = {"whorl_m": 2.5, "per_whorl": 0.99, "twigs_per_m": 0.0, "angle_deg": 90.0, "keeps_m": 100.0, "gone_m": 200.0}
    law = wood.years.dead_branches.model_copy(update=few)
    branch, *collars = dead_branches(stem_of(tree), law, wood, tree, 0.0, child_rng(1, "few"))
    assert {one.material for one in collars} == {"bark", "upper_bark"}
    points = np.concatenate([one.mesh.vertices_m for one in collars]).astype(np.float64)
    height_m = np.sort(points[:, 2])
    whorls = np.split(height_m, np.flatnonzero(np.diff(height_m) > 0.5) + 1)
    assert len(whorls) > 2
    for middle_m in (0.5 * (whorl[0] + whorl[-1]) for whorl in whorls):
        stem_m = float(stem_radius_m(np.array([middle_m]), tree.height_m, tree.dbh_m)[0])
        beside = [one[np.abs(one[:, 2] - middle_m) < 0.5] for one in (points, branch.mesh.vertices_m)]
        collar, own = [one[np.hypot(one[:, 0], one[:, 1]) < stem_m + 0.03] for one in beside]
        assert np.ptp(collar[:, 2]) > 1.5 * np.ptp(own[:, 2])
