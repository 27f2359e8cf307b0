"""Plants with branches of their own: who is unique, who stands for whom, and which graph is whose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.architecture.geometry import skeletal_graph
from forestgen.architecture.modules import Modules
from forestgen.architecture.prototypes import MOST_NODES, load_prototypes, tables_of
from forestgen.community.population import Population
from forestgen.plants.grown import woods_of
from forestgen.recipe.species import PlantType
from forestgen.scene.build import place_instances
from forestgen.scene.exemplars import LEAST_PIXELS, MOST_TRIANGLES, plan_exemplars, plan_own, unique_plants
from support.scenes import simple_tree

TYPE = PlantType(life_span_yr=100, root_vigour_max=50, growth_rate_per_yr=0.2, apical_control=0.8, determinacy=0.8)


def stand(count=60, seed=0):
    """Plants of one or two modules: a second one grows from a terminal of the first."""
    rng = np.random.default_rng(seed)
    prototypes = load_prototypes()
    sizes = rng.integers(1, 3, count)
    first = np.concatenate([[0], np.cumsum(sizes)])
    total, is_root = int(first[-1]), np.zeros(int(first[-1]), dtype=bool)
    is_root[first[:-1]] = True
    kinds = rng.integers(0, len(prototypes), total).astype(np.uint8)
    terminal = np.array([int(prototypes[kinds[max(row - 1, 0)]].terminals[0]) for row in range(total)])
    number = np.where(is_root, 0, rng.integers(5, 900, total))
    modules = Modules(
        first=first,
        number=number.astype(np.uint32),
        parent=np.where(is_root, -1, 0).astype(np.int32),
        node=np.where(is_root, -1, terminal).astype(np.int16),
        prototype=kinds,
        age=rng.uniform(0.7, 1.0, total).astype(np.float32),
        age_yr=np.full(total, 6, dtype=np.float32),
        base_m=np.zeros((total, 3), dtype=np.float32),
        rotation=np.tile(np.array([1, 0, 0, 0], dtype=np.float32), (total, 1)),
        vigour=np.ones(total, dtype=np.float32),
        light=np.ones(total, dtype=np.float32),
        disused_m2=np.zeros(total, dtype=np.float32),
    )
    return Population(
        time_yr=0.0,
        species_names=("a", "b"),
        plant_id=(np.arange(count) * 2 + 3).astype(np.uint32),
        species=(np.arange(count) % 2).astype(np.uint16),
        position_m=rng.random((count, 3)) * 40,
        radius_m=rng.uniform(0.5, 4, count),
        height_m=rng.uniform(1, 20, count),
        age_yr=np.full(count, 10.0),
        status=np.zeros(count, dtype=np.uint8),
        columns={"modules": sizes.astype(np.int32), "trunk_diameter_m": rng.uniform(0.01, 0.4, count)},
        modules=modules,
    )


def chosen(plants, wanted, pixel_m=0.05, triangles=1e5, own=None):
    own = np.ones(len(plants), dtype=bool) if own is None else own
    pixel = np.full(len(plants), pixel_m)
    return unique_plants(plants, own, pixel, lambda: np.full(len(plants), triangles), wanted)


def test_the_largest_in_the_image_are_unique():
    plants = stand()
    five = chosen(plants, 5)
    assert five.sum() == 5
    assert plants.height_m[five].min() >= plants.height_m[~five].max()
    assert chosen(plants, "all").all()
    assert not chosen(plants, "none").any()
    assert chosen(plants, 1000).all()


def test_auto_takes_what_is_large_as_long_as_its_triangles_fit():
    plants = stand()
    free = chosen(plants, "auto", triangles=1.0)
    np.testing.assert_array_equal(free, plants.height_m / 0.05 >= LEAST_PIXELS)
    tight = chosen(plants, "auto", triangles=MOST_TRIANGLES / 7.5)
    assert tight.sum() == 7
    assert np.all(free[tight])
    assert not chosen(plants, "auto", pixel_m=100.0).any()


def test_only_species_that_are_clothed_have_unique_plants():
    plants = stand()
    own = plants.species == 1
    for wanted in ("all", "auto", 10_000):
        assert not chosen(plants, wanted, own=own, triangles=1.0)[~own].any()


def test_a_unique_plant_is_itself_and_every_other_one_is_of_its_species():
    plants = stand()
    unique = chosen(plants, 11)
    given = {index: plan_own(plants, index, unique, 4, seed=2) for index in (0, 1)}
    plan = plan_exemplars(plants, 3, 2, given=given).split("level", (plants.height_m > 10).astype(np.int64))
    mine = plan.exemplar_of_plant
    np.testing.assert_array_equal(plan.species[mine], plants.species)
    np.testing.assert_array_equal(plan.plant[mine][unique], np.flatnonzero(unique))
    np.testing.assert_array_equal(plan.is_unique[mine], unique)
    assert np.all(plants.species[plan.plant] == plan.species)
    assert not np.any(unique[plan.plant[~plan.is_unique]])
    stand_ins = {(int(s), int(p)) for s, p in zip(plan.species, plan.plant, strict=True) if not unique[p]}
    assert all(sum(s == index for s, _ in stand_ins) <= 4 for index in (0, 1))


def test_a_plant_stands_for_plants_of_like_size():
    plants = stand(400)
    none = np.zeros(len(plants), dtype=bool)
    spread = []
    for clusters in (1, 40):
        plan = plan_own(plants, 0, none, clusters, seed=0)
        rows = np.flatnonzero(plants.species == 0)
        spread.append(np.std(np.log(plants.height_m[plan.plant[plan.exemplar_of_plant]] / plants.height_m[rows])))
    assert spread[1] < 0.35 * spread[0]


def test_each_plants_graph_is_its_own():
    plants = stand(20)
    tables = tables_of(load_prototypes(), [TYPE, TYPE])
    rows = np.array([1, 2, 7, 19])
    for row, wood in zip(rows.tolist(), woods_of(plants, tables, rows), strict=True):
        alone = skeletal_graph(tables, plants.modules, plants.species, [row])
        np.testing.assert_array_equal(wood.parent, alone.parent)
        np.testing.assert_array_equal(wood.position_m, alone.position_m)
        np.testing.assert_array_equal(wood.mark // MOST_NODES, plants.modules.number[alone.module])
        np.testing.assert_array_equal(wood.mark % MOST_NODES, alone.node)
        assert wood.age_share.min() >= 0
        assert wood.age_share.max() <= 1
    assert woods_of(plants, tables, np.zeros(0, dtype=np.int64)) == []
    with pytest.raises(ValueError, match="no modules"):
        woods_of(replace(plants, modules=None), tables, rows)


def test_a_unique_plant_is_neither_turned_nor_scaled_and_others_are_scaled_by_the_plant_they_show():
    plants = stand(30)
    rng = np.random.default_rng(0)
    trees = (simple_tree("a", 3.0, 40, rng), simple_tree("a", 7.0, 40, rng))
    which = (np.arange(30) % 2).astype(np.uint32)
    placed = place_instances(
        plants, which, trees, 0, stands_for_m=np.array([3.0, 5.0]), is_unique=np.array([True, False])
    )
    np.testing.assert_array_equal(placed.transform[which == 0][:, :, :3], np.tile(np.eye(3), (15, 1, 1)))
    scale = np.cbrt(np.linalg.det(placed.transform[which == 1][:, :, :3]))
    np.testing.assert_allclose(scale, plants.height_m[which == 1] / 5.0)
    assert np.ptp(placed.transform[which == 1][:, 0, 1]) > 0
