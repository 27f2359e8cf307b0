"""Copies of the stand around the site: where they stand, what they are called, and what far meshes keep of plants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scene_plants import population

from forestgen.core.errors import RecipeError
from forestgen.core.parts import Part
from forestgen.geometry.mesh import part_of, surface_area_m2
from forestgen.recipe import land
from forestgen.scene.blocks import UNEVEN_SEEN, WOODS_M, Stands
from forestgen.scene.build import place_instances, stand_on
from forestgen.scene.far_mesh import SPECIES, areas_m2, far_mesh, thinned
from forestgen.scene.shaped_ground import shaped
from forestgen.scene.spec import Material
from forestgen.scene.surroundings import (
    APART,
    FAR_BLOCKS,
    REACH_HEIGHTS,
    UNEVEN,
    SurroundedStand,
    _free_of_stems,
    layers_around,
    most_copies,
    surrounded,
)
from forestgen.scene.terrain import HeightField
from forestgen.scene.terrains.rolling import rolling
from forestgen.scene.wind import sway_in
from support.cameras import camera_of
from support.error_messages import raises_error
from support.scenes import simple_tree

SIZE_M = (50.0, 40.0)
FLAT = HeightField(SIZE_M)


def stand(height=FLAT, count=60):
    """Trees, and as many plants of up to 2 m."""
    rng = np.random.default_rng(4)
    trees = tuple(simple_tree("a", size, 400, rng) for size in (1.0, 9.0, 20.0))
    plants = population(count, rng)
    heights = np.where(np.arange(count) % 2, 8.0 + 12.0 * rng.random(count), 0.3 + 1.7 * rng.random(count))
    place = np.column_stack([rng.random((count, 2)) * SIZE_M, np.zeros(count)])
    plants = stand_on(replace(plants, position_m=place, height_m=heights), height)
    exemplar = np.where(heights < 3, 0, np.where(heights < 14, 1, 2)).astype(np.uint32)
    materials = {("a", name): Material((0.1, 0.1, 0.1)) for name in ("bark", "leaf")}
    instances = place_instances(plants, exemplar, trees, 3)
    return SurroundedStand.of(plants, instances, trees, materials)


def around(height=FLAT, labelled=True, count=60, rng=None):
    site = stand(height, count)
    return site, surrounded(site, layers(site.population, height, rng), height, 1, labelled)


def layers(plants, height=FLAT, rng=None):
    return layers_around(plants, np.arange(len(plants)), height, rng)


def test_the_site_stays_as_it_is_and_copies_have_ids_of_their_own():
    site, found = around()
    count = len(site.instances)
    for name in ("exemplar", "transform", "plant_id"):
        np.testing.assert_array_equal(getattr(found.instances.on_site, name), getattr(site.instances, name))
        np.testing.assert_array_equal(getattr(found.instances, name)[:count], getattr(site.instances, name))
    ids = found.plants.plant_id
    assert len(np.unique(ids)) == len(ids) == count + found.copies
    np.testing.assert_array_equal(found.population.plant_id, ids)
    np.testing.assert_array_equal(found.population.columns["outside"], np.arange(len(ids)) >= count)
    np.testing.assert_array_equal(
        found.population.height_m[count:], site.population.height_m[found.source[count : len(ids)]]
    )
    assert (found.instances.plant_id[len(ids) :] == 0).all()


def test_each_plant_has_one_copy_in_each_copy_of_the_site():
    """Near ones as themselves, the others in a far mesh: together the whole lattice, without gap or overlap."""
    site, found = around()
    count, whole = len(site.instances), len(found.plants)
    moved = found.instances.transform[count:whole, :2, 3] - site.instances.transform[found.source[count:whole], :2, 3]
    period = np.round(moved / SIZE_M)
    np.testing.assert_allclose(moved, period * SIZE_M, atol=1e-9)
    assert (np.abs(period).sum(axis=1) > 0).all()
    near = {
        (row, *turn) for row, turn in zip(found.source[count:whole].tolist(), period.astype(int).tolist(), strict=True)
    }
    assert len(near) == found.copies
    tall = site.population.height_m > 3
    for rows in (tall, ~tall):
        reach = max(REACH_HEIGHTS * site.population.height_m[rows].max(), 10.0)
        for row in np.flatnonzero(rows).tolist():
            for i in range(-2, 3):
                for j in range(-2, 3):
                    x, y = site.population.position_m[row, :2] + np.multiply((i, j), SIZE_M)
                    if (i or j) and float(FLAT.distance_m(np.array(x), np.array(y))) < reach:
                        assert (row, i, j) in near
    triangles = {one: found.exemplars[one].triangles for one in range(len(site.exemplars), len(found.exemplars))}
    assert triangles
    far = found.instances.transform[whole:, :2, 3]
    for number in triangles:
        at = far[found.instances.exemplar[whole:] == number]
        turns = (at - at[0]) / SIZE_M
        np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
        assert len(np.unique(np.round(turns), axis=0)) == len(at)
    assert found.reach_m == FAR_BLOCKS * 40.0  # of the blocks of trees, half a site wide


def test_feet_are_on_the_ground():
    height = rolling(SIZE_M, 2.0, 60.0, np.random.default_rng(2))
    site, found = around(height)
    place = found.plants.transform[:, :, 3]
    np.testing.assert_allclose(place[:, 2], height(place[:, 0], place[:, 1]), atol=1e-9)
    whole = len(found.plants)
    tallest = site.population.height_m.max()
    assert found.copies > around()[1].copies  # uneven ground is followed plant by plant
    for row in range(whole, len(found.instances), 7):
        # Feet of a far mesh: its plane at the places of its plants.
        matrix = found.instances.transform[row]
        x, y = np.meshgrid(np.linspace(-5, 5, 3), np.linspace(-5, 5, 3))
        at = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3) @ matrix[:, :3].T + matrix[:, 3]
        if FLAT.distance_m(at[:, 0], at[:, 1]).max() < 150:
            miss = np.abs(at[:, 2] - height(at[:, 0], at[:, 1])).max()
            assert miss < 2 * UNEVEN * tallest


def test_unlabelled_copies_are_the_same_plants_without_ids():
    site, found = around(labelled=False)
    other = around()[1]
    np.testing.assert_array_equal(found.instances.transform, other.instances.transform)
    assert (found.instances.plant_id[len(site.instances) :] == 0).all()
    assert found.population is site.population


def test_a_far_mesh_keeps_the_area_of_leaves_and_the_box():
    rng = np.random.default_rng(0)
    tree = simple_tree("a", 16.0, 3000, rng)
    few = replace(tree, organs=thinned(tree, areas_m2(tree), 0.05, rng))
    assert few.triangles < tree.triangles / 2
    area = {organ.part: surface_area_m2(organ.mesh) for organ in few.organs}
    assert area[Part.LEAF] == pytest.approx(tree.leaf_area_m2, rel=1e-5)
    assert area[Part.TRUNK] == pytest.approx(surface_area_m2(tree.organs[0].mesh), rel=0.05)
    np.testing.assert_allclose(few.bounds_m(), tree.bounds_m(), atol=0.4)
    transform = np.stack([np.eye(3, 4), 2.0 * np.eye(3, 4)])
    transform[1, :, 3] = 30.0, 0.0, 0.0
    both = far_mesh([(few, transform)])
    assert both.leaf_area_m2 == pytest.approx(5 * tree.leaf_area_m2)
    assert sum(surface_area_m2(one.mesh) for one in both.organs) == pytest.approx(5 * sum(area.values()), rel=1e-5)
    assert {organ.material for organ in both.organs} == {"a/bark", "a/leaf"}


def test_a_stem_of_several_barks_is_one_frustum_in_a_far_mesh():
    tree = simple_tree("a", 16.0, 300, np.random.default_rng(0))
    bark, leaf = tree.organs
    is_moss = np.arange(bark.mesh.triangles) % 4 == 0
    pieces = [
        replace(bark, material=name, mesh=part_of(bark.mesh, bark.mesh.faces[chosen]))
        for name, chosen in (("moss", is_moss), ("bark", ~is_moss))
    ]
    mossy = replace(tree, organs=(*pieces, leaf))
    found, bare = (thinned(one, areas_m2(one), 0.05, np.random.default_rng(0)) for one in (mossy, tree))
    assert [organ.material for organ in found] == ["a/bark", "a/leaf"]
    np.testing.assert_allclose(found[0].mesh.vertices_m, bare[0].mesh.vertices_m, atol=1e-4)


def test_far_meshes_have_the_materials_of_their_plants():
    site, found = around()
    for one in found.exemplars[len(site.exemplars) :]:
        assert one.species == SPECIES
        for organ in one.organs:
            assert found.materials[one.species, organ.material] == site.materials[tuple(organ.material.split("/"))]


def test_what_people_built_is_not_repeated():
    site = stand()
    some = np.flatnonzero(site.instances.exemplar != 0)
    found = layers_around(site.population, some, FLAT, None)
    assert np.isin(np.concatenate([one.source for one in found]), some).all()
    assert np.isin(np.concatenate([far.rows for one in found for far in one.far]), some).all()
    assert surrounded(site, layers_around(site.population, some[:0], FLAT, None), FLAT, 1, True) is site


def forest(seed=1, size_m=(60.0, 60.0), count=400):
    """A site in whose near surroundings there are many trees."""
    height = HeightField(size_m)
    rng = np.random.default_rng(4)
    plants = population(count, rng)
    place = np.column_stack([rng.random((count, 2)) * size_m, np.zeros(count)])
    plants = replace(plants, position_m=place, height_m=8.0 + 7.0 * rng.random(count))
    return plants, layers(plants, height, np.random.default_rng(seed)), layers(plants, height)


def test_a_forest_is_as_dense_as_the_site_and_does_not_repeat_it():
    plants, (found,), (lattice,) = forest()
    assert len(found.source) == pytest.approx(len(lattice.source), rel=0.2)
    moved = (found.position_m[:, :2] - plants.position_m[found.source, :2]) / 60.0
    assert np.mean(np.abs(moved - np.round(moved)).max(axis=1) < 1e-6) < 0.1  # where it would be in `repeat`
    assert set(found.turn.tolist()) == {0, 1, 2, 3}
    turned = [far.transform[:, 0, 0].round().astype(int).tolist() for far in found.far]
    assert {-1, 0, 1} == {one for far in turned for one in far}
    again = forest()[1][0]
    np.testing.assert_array_equal(found.position_m, again.position_m)
    assert not np.array_equal(found.source[:50], forest(2)[1][0].source[:50])
    assert set(forest(size_m=(60.0, 45.0))[1][0].turn.tolist()) == {0, 2}  # a block must fit in another's place


def test_no_tree_around_the_site_stands_in_water_or_on_a_road():
    """Seen from the plants of all copies and far meshes; beyond the road's end the forest is as dense as ever."""
    road = land.Path(what="forest_road", points_m=((-55.0, -50.0), (25.0, 20.0), (105.0, 95.0)))
    pond = land.Pond(what="pond", position_m=(40.0, 30.0), radius_m=60.0)
    height = shaped(FLAT, None, (road,), (pond,), 3)
    plants = stand(count=600).population
    for layer in layers(plants, height, np.random.default_rng(2)):
        far = [
            (block.xy_m @ one[:2, :2].T + one[:2, 3])
            for block in layer.far
            if not block.wide
            for one in block.transform
        ]
        places = np.concatenate([layer.position_m[:, :2], *far])
        assert not height.barred(*places.T).any()
        assert len(places) > 2000


def test_a_forest_keeps_stems_apart_at_the_seams_and_closes_them():
    plants, (found,), _ = forest()
    at = np.concatenate([plants.position_m[:, :2], found.position_m[:, :2]])
    radius = plants.radius_m[np.concatenate([np.arange(len(plants)), found.source])]
    away = np.linalg.norm(at[:, None] - at, axis=2)
    np.fill_diagonal(away, np.inf)
    close = away < APART * (radius[:, None] + radius) - 1e-9
    block = np.floor(at / 20.0)  # a third of the site
    block[: len(plants)] = 0.0  # the site keeps all of its own
    assert not (close & (block[:, None] != block).any(axis=2)).any()
    low, high = at.min(axis=0), at.max(axis=0)
    assert (low < -10).all()
    assert (high > 70).all()
    outward = np.abs(at - 30.0).max(axis=1) - 30.0
    assert np.sum((outward >= 0) & (outward < 3.0)) / (66.0**2 - 60.0**2) == pytest.approx(400 / 3600, rel=0.25)


def test_a_copy_gives_way_only_to_stems_that_stay():
    plants = replace(population(1, np.random.default_rng(0)), position_m=np.zeros((1, 3)), radius_m=np.full(1, 2.0))
    apart = APART * 4.0
    away = np.array([2.7, 1.8, 0.9, 2.7, 6.0]) * apart  # from the site's tree, in a row
    block = np.array([2, 1, 0, 3, 3])
    kept = _free_of_stems(plants, np.zeros(1, int), np.zeros(5, int), block, np.stack([away, np.zeros(5)], axis=1))
    assert kept.tolist() == [False, True, False, False, True]


def test_copies_move_as_their_plants_and_nothing_else_moves():
    site, found = around()
    own = sway_in(site.instances, site.exemplars, speed_m_per_s=9, gustiness=0.5, from_deg=270, seed=1)
    lean = found.sway(own).lean_rad(2.5)
    whole = len(found.plants)
    np.testing.assert_array_equal(lean[:whole], own.lean_rad(2.5)[found.source[:whole]])
    assert (lean[whole:] == 0).all()
    assert (lean[:whole] > 0).all()


def test_the_number_of_copies_is_known_before_there_are_exemplars():
    site, found = around()
    assert found.copies <= most_copies(site.population, SIZE_M, flat=True) <= 1.2 * found.copies
    assert most_copies(site.population.at(np.zeros(0, dtype=np.int64)), SIZE_M, flat=True) == 0


def test_a_bare_site_has_bare_surroundings():
    site = stand()
    bare = site.population.at(np.zeros(0, dtype=np.int64))
    assert layers(bare) == ()


def test_ids_beyond_32_bits_are_refused():
    site = stand()
    plants = replace(site.population, plant_id=np.arange(2**32 - 61, 2**32 - 1).astype(np.uint32))
    with raises_error(RecipeError, place="site.surroundings"):
        surrounded(replace(site, population=plants), layers(plants), FLAT, 1, True)


HILLS = rolling((60.0, 60.0), 2.0, 60.0, np.random.default_rng(2), 60.0)


def beyond(height, look_at_m, kind=np.random.default_rng, stands=None):
    """What is around a site of trees for one camera above them."""
    rng = np.random.default_rng(4)
    plants = population(300, rng)
    place = np.column_stack([rng.random((300, 2)) * 60.0, np.zeros(300)])
    plants = stand_on(replace(plants, position_m=place, height_m=np.full(300, 20.0)), height)
    camera = camera_of("perspective", (96, 64), (30.0, 30.0, 90.0), look_at_m)
    (found,) = layers_around(plants, np.arange(300), height, kind(1), [camera], stands)
    return found


@pytest.mark.parametrize("kind", [np.random.default_rng, lambda seed: None], ids=["forest", "repeat"])
def test_forest_goes_on_to_the_horizon_without_gap_or_overlap(kind):
    """Each place in view belongs to one block or square, and feet are as near to its ground as can be seen."""
    found = beyond(HILLS, (30.0, 3000.0, 60.0), kind)
    assert any(one.wide for one in found.far)
    rng = np.random.default_rng(0)
    distance, aside = rng.uniform(900.0, 5500.0, 400), rng.uniform(-0.4, 0.4, 400)
    x, y = 30.0 + distance * np.sin(aside), 60.0 + distance * np.cos(aside)
    covered, miss_m = np.zeros(400, dtype=int), np.zeros(400)
    for block in found.far:
        half_m = 90.0 if block.wide else 15.0  # three sites, or half of one, wide
        for matrix in block.transform:
            dx, dy = x - matrix[0, 3], y - matrix[1, 3]
            inside = (np.abs(dx) <= half_m) & (np.abs(dy) <= half_m)
            covered += inside
            local = np.linalg.inv(matrix[:2, :2]) @ np.stack([dx, dy])
            miss_m += np.where(inside, np.abs(matrix[2, :2] @ local + matrix[2, 3] - HILLS.on_mesh(x, y)), 0.0)
    assert (covered == 1).all()
    assert (miss_m < 1.5 * UNEVEN_SEEN * distance).all()  # between the places where it is looked up, a little more
    assert found.reach_m == WOODS_M


def test_far_stands_have_their_heights_and_no_tree_stands_in_clearings():
    stands = Stands.drawn(np.random.default_rng(3))
    same, found = (beyond(HILLS, (30.0, 3000.0, 60.0), stands=one) for one in (None, stands))
    every, transform = (np.concatenate([block.transform for block in one.far]) for one in (same, found))
    x, y = transform[:, :2, 3].T
    relative_height = stands.relative_height(x, y, HILLS.distance_m(x, y))
    assert (relative_height > 0).all()
    np.testing.assert_allclose(transform[:, 2, 2], relative_height)
    np.testing.assert_array_equal(every[:, 2, 2], 1.0)
    assert 0.85 * len(every) < len(transform) < len(every)


def test_only_what_a_camera_sees_goes_on_to_the_horizon():
    down = beyond(HILLS, (30.0, 31.0, 0.0))
    assert not any(one.wide for one in down.far)
    north = beyond(HILLS, (30.0, 3000.0, 60.0))
    assert all((one.transform[:, 1, 3] > -600.0).all() for one in north.far if one.wide)
    np.testing.assert_array_equal(down.position_m, north.position_m)  # near ones do not depend on cameras


def test_a_camera_deep_in_a_stand_does_not_see_so_far():
    plants = replace(population(300, np.random.default_rng(4)), height_m=np.full(300, 20.0))
    camera = camera_of("perspective", (96, 64), (30.0, 30.0, 2.0), (30.0, 3000.0, 2.0))
    above = replace(camera, position_m=(30.0, 30.0, 25.0))
    seen = [layers_around(plants, np.arange(300), HeightField((60.0, 60.0)), None, [one]) for one in (camera, above)]
    assert [any(block.wide for block in found.far) for (found,) in seen] == [False, True]


def test_hills_are_as_high_as_asked_for():
    x, y = np.meshgrid(np.linspace(-6000.0, 6000.0, 120), np.linspace(-6000.0, 6000.0, 120))
    high, low = (rolling((60.0, 60.0), 1.0, 60.0, np.random.default_rng(2), one) for one in (60.0, 20.0))
    away = np.hypot(x, y)
    ring = (away > 1900.0) & (away < 3000.0)
    assert np.std(high(x, y)[ring]) == pytest.approx(60.0, rel=0.35)
    np.testing.assert_allclose(high(x, y)[ring], 3.0 * low(x, y)[ring], rtol=1e-9)
