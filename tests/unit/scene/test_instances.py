"""Plants become instances: exact height, own place, own angle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scene_plants import population

from forestgen.core.parts import Part
from forestgen.scene.build import place_instances, stand_on
from forestgen.scene.growth import pixel_size_m
from forestgen.scene.plant_measures import PlantMeter
from support.scenes import camera_at, simple_tree


def placed(count: int = 40, seed: int = 3):
    rng = np.random.default_rng(0)
    trees = tuple(simple_tree("a", height, 60, rng) for height in (2.0, 7.0, 19.0))
    trees = tuple(replace(tree, height_m=float(tree.bounds_m()[1, 2])) for tree in trees)
    plants = population(count, rng)
    exemplar = rng.integers(0, 3, count).astype(np.uint32)
    return trees, plants, exemplar, place_instances(plants, exemplar, trees, seed)


def test_the_tops_are_at_the_plants_exact_heights_over_their_feet():
    trees, plants, exemplar, instances = placed()
    for row in range(len(plants)):
        matrix = instances.transform[row]
        corners = np.concatenate([organ.mesh.vertices_m for organ in trees[exemplar[row]].organs]).astype(np.float64)
        world = corners @ matrix[:, :3].T + matrix[:, 3]
        assert abs(world[:, 2].max() - plants.position_m[row, 2] - plants.height_m[row]) < 1e-6 * plants.height_m[row]
        np.testing.assert_array_equal(matrix[:, 3], plants.position_m[row])


def test_transforms_turn_about_the_vertical_and_scale_evenly():
    _, _, _, instances = placed()
    linear = instances.transform[:, :, :3]
    scale = linear[:, 2, 2]
    np.testing.assert_allclose(linear @ linear.transpose(0, 2, 1), scale[:, None, None] ** 2 * np.eye(3), atol=1e-12)
    assert np.all(np.linalg.det(linear) > 0)
    np.testing.assert_array_equal(linear[:, 2, :2], 0)


def test_the_angle_belongs_to_the_plant_and_to_the_seed():
    trees, plants, exemplar, instances = placed()
    rows = np.array([3, 4, 17, 30])
    some = replace(
        plants,
        **{
            name: getattr(plants, name)[rows]
            for name in ("plant_id", "species", "position_m", "radius_m", "height_m", "age_yr", "status")
        },
    )
    alone = place_instances(some, exemplar[rows], trees, 3)
    np.testing.assert_array_equal(alone.transform, instances.transform[rows])
    other = place_instances(plants, exemplar, trees, 4)
    assert not np.allclose(other.transform[:, 0, 0], instances.transform[:, 0, 0])


def test_angles_are_spread_evenly():
    _, _, _, instances = placed(count=2000)
    angle = np.arctan2(instances.transform[:, 1, 0], instances.transform[:, 0, 0])
    count = np.histogram(angle, bins=8, range=(-np.pi, np.pi))[0]
    assert np.sum((count - 250) ** 2 / 250) < 24.3  # chi-squared of 7 degrees of freedom, p = 0.001


def test_trees_with_a_weather_side_keep_it():
    trees, plants, exemplar, _ = placed(count=500)
    instances = place_instances(plants, exemplar, [replace(tree, has_weather_side=True) for tree in trees], 3)
    angle = np.arctan2(instances.transform[:, 1, 0], instances.transform[:, 0, 0])
    assert np.abs(angle).max() < np.pi / 3 + 1e-9
    assert np.abs(np.mean(angle)) < 0.1


def test_no_plants_no_instances():
    trees, _, _, _ = placed()
    none = population(0, np.random.default_rng(0))
    assert len(place_instances(none, np.zeros(0, np.uint32), trees, 0)) == 0


def test_feet_stand_on_the_ground():
    plants = population(20, np.random.default_rng(1))
    stood = stand_on(plants, lambda x, y: 0.1 * x - 0.2 * y)
    np.testing.assert_allclose(stood.position_m[:, 2], 0.1 * plants.position_m[:, 0] - 0.2 * plants.position_m[:, 1])
    np.testing.assert_array_equal(stood.position_m[:, :2], plants.position_m[:, :2])


def test_a_pixel_covers_what_the_nearest_camera_sees_of_the_nearest_part() -> None:
    near = camera_at((0.0, 0.0, 2.0), (0.0, 10.0, 2.0), (200, 100), 90.0)  # 100 pixels of focal length
    far = replace(near, position_m=(0.0, -1000.0, 2.0))
    feet = np.array([[0.0, 50.0, 0.0], [0.0, 0.5, 0.0], [0.0, 60.0, 0.0], [0.0, -50.0, 0.0]])
    height, width = np.array([20.0, 20.0, 1.0, 20.0]), np.array([4.0, 4.0, 4.0, 4.0])
    covered = pixel_size_m([far, near], feet, height, width)
    corner = np.hypot(1.0, np.hypot(100, 50) / 100)
    expected = np.array([48.0, 0.0, np.hypot(58.0, 1.0), 48.0]) / 100.0 / corner
    np.testing.assert_allclose(covered, expected, atol=1e-12)
    np.testing.assert_array_equal(pixel_size_m([near, far], feet, height, width), covered)
    # No point of the image sees a finer pixel than that: the first plant's nearest edge, in the image's corner.
    x, y = (np.array([100.0, 50.0]) - 0.5) / 100.0
    depth = 48.0 / np.sqrt(1 + x**2 + y**2)
    assert depth / 100.0 >= covered[0]


def test_trees_have_their_own_heights_and_widths() -> None:
    """Of exemplars without a diameter: with one, it counts as much as the width (test_tree_exemplars)."""
    trees, plants, exemplar, _ = placed()
    rng = np.random.default_rng(4)
    of_exemplar = np.array([tree.crown_width_m / tree.height_m for tree in trees])[exemplar]
    width_m = plants.height_m * of_exemplar * rng.uniform(0.75, 1.4, len(plants))
    sizes = {"dbh_m": 0.2, "crown_base_m": 1.0, "leaf_area_m2": 5.0}
    columns = {name: np.full(len(plants), value) for name, value in sizes.items()}
    plants = replace(plants, columns={**plants.columns, **columns, "crown_radius_m": 0.5 * width_m})
    built = np.array([[tree.height_m, tree.crown_width_m, np.nan, 1.0, 5.0] for tree in trees])
    instances = place_instances(plants, exemplar, trees, 3, tree=built)
    measures = PlantMeter(trees).measure(instances)
    np.testing.assert_allclose(measures.crown_width_m, width_m, rtol=1e-9)
    np.testing.assert_allclose(measures.tip_m[:, 2] - plants.position_m[:, 2], plants.height_m, rtol=1e-6)
    linear = instances.transform[:, :, :3]
    assert np.any(np.abs(linear[:, 2, 2] - np.linalg.norm(linear[:, :, 0], axis=1)) > 0.05 * linear[:, 2, 2])
    for row in range(len(plants)):
        leaves = [one.mesh for one in trees[exemplar[row]].organs if one.part == Part.LEAF]
        corners = np.concatenate([mesh.vertices_m.astype(float)[mesh.faces] for mesh in leaves]) @ linear[row].T
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area_m2 = 0.5 * np.linalg.norm(normal, axis=1).sum()
        assert abs(measures.leaf_area_m2[row] / area_m2 - 1.0) < 2e-3
