"""Measures of plants against the same taken from every instance's triangles in the world."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh, surface_area_m2
from forestgen.plants.exemplar import OrganMesh
from forestgen.scene.plant_measures import PlantMeter, crown_centre, stem_diameter_m, stem_volume_m3
from support.scenes import plain_ground, post, scattered_scene, simple_tree


@pytest.fixture(scope="module")
def spec():
    return scattered_scene(40, exemplars=4, leaves=60, terrain=plain_ground(0, 1))


def measure_plants(spec):
    return PlantMeter(spec.exemplars).measure(spec.instances)


def leaning(spec, lean_deg=12.0):
    """Each plant turned about a horizontal axis through its foot."""
    rng, lean = np.random.default_rng(5), np.radians(lean_deg)
    transform = spec.instances.transform.copy()
    for row in range(len(transform)):
        x, y = (lambda a: (np.cos(a), np.sin(a)))(rng.uniform(0, 2 * np.pi))
        axis = np.array([[0, 0, x], [0, 0, y], [-x, -y, 0]])
        turn = np.eye(3) + np.sin(lean) * axis + (1 - np.cos(lean)) * axis @ axis
        transform[row, :, :3] = turn @ transform[row, :, :3]
    return replace(spec, instances=replace(spec.instances, transform=transform))


def in_world(spec, row, parts=tuple(Part)):
    """Corners (F, 3, 3) of a plant's triangles."""
    matrix = spec.instances.transform[row]
    organs = spec.exemplars[spec.instances.exemplar[row]].organs
    corners = [organ.mesh.vertices_m.astype(float)[organ.mesh.faces] for organ in organs if organ.part in parts]
    return np.concatenate(corners) @ matrix[:, :3].T + matrix[:, 3]


def area_of(corners):
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2


@pytest.mark.parametrize("stand", [lambda spec: spec, leaning])
def test_measures_are_those_of_the_triangles_in_the_world(spec, stand):
    spec = stand(spec)
    measures = measure_plants(spec)
    np.testing.assert_array_equal(measures.exemplar, spec.instances.exemplar)
    for row in range(len(spec.instances)):
        everything, leaves = in_world(spec, row), in_world(spec, row, (Part.LEAF,))
        np.testing.assert_array_equal(measures.stem_base_m[row], spec.instances.transform[row, :, 3])
        assert measures.tip_m[row, 2] == pytest.approx(everything[..., 2].max(), rel=1e-9)
        assert np.abs(everything.reshape(-1, 3) - measures.tip_m[row]).sum(axis=1).min() < 1e-9  # it is a vertex
        area = area_of(leaves)
        np.testing.assert_allclose(measures.crown_centre_m[row], area @ leaves.mean(axis=1) / area.sum(), atol=1e-6)
        assert measures.leaf_area_m2[row] == pytest.approx(area.sum(), rel=1e-5)


def test_lengths_scale_and_do_not_mind_a_lean(spec):
    upright, leant = measure_plants(spec), measure_plants(leaning(spec))
    scale = np.linalg.norm(spec.instances.transform[:, :, 2], axis=1)
    exemplars = np.array([exemplar.crown_width_m for exemplar in spec.exemplars])
    np.testing.assert_allclose(upright.crown_width_m, exemplars[spec.instances.exemplar] * scale)
    for name in ("crown_width_m", "dbh_m", "leaf_area_m2"):
        np.testing.assert_allclose(getattr(leant, name), getattr(upright, name), rtol=1e-6)


def test_the_diameter_is_taken_at_breast_height_of_each_instance(spec):
    """The trunks are eight-sided cones: of a radius that falls from the foot, 0.2 m below the ground, to the tip."""
    measures = measure_plants(spec)
    scale = np.linalg.norm(spec.instances.transform[:, :, 2], axis=1)
    height = np.array([exemplar.height_m for exemplar in spec.exemplars])[spec.instances.exemplar]
    tip, foot = 0.9 * height, height * 0.012
    radius = scale * foot * (tip - 1.3 / scale) / (tip + 0.2)
    octagon = np.sqrt(4 / np.pi * 2 * np.sqrt(2))  # diameter of the circle of a unit octagon's area
    np.testing.assert_allclose(measures.dbh_m, octagon * radius, rtol=1e-5)


def test_more_scales_than_sections_are_interpolated_truly():
    tree = simple_tree("a", 10.0, 5, np.random.default_rng(1))
    heights = np.linspace(0.5, 4.0, 500)
    exact = np.concatenate([stem_diameter_m(tree, part) for part in np.array_split(heights, 10)])
    np.testing.assert_allclose(stem_diameter_m(tree, heights), exact, rtol=1e-6)


def test_stems_that_overlap_count_once_and_stems_apart_by_basal_area():
    tree = simple_tree("a", 10.0, 5, np.random.default_rng(1))
    one = stem_diameter_m(tree, np.array([1.3]))
    leaf = tree.organs[1]

    def with_stems(*offsets):
        stem = post(9.0, 0.12)
        moved = [Mesh((stem.vertices_m + np.array([x, 0, 0])).astype(np.float32), stem.faces) for x in offsets]
        return replace(tree, organs=(*(OrganMesh(Part.TRUNK, "bark", mesh) for mesh in moved), leaf))

    np.testing.assert_allclose(stem_diameter_m(with_stems(0.0, 0.0), np.array([1.3])), one, rtol=1e-6)
    np.testing.assert_allclose(stem_diameter_m(with_stems(0.0, 1.0, 2.0), np.array([1.3])), one * np.sqrt(3), rtol=1e-6)


def test_no_trunk_no_diameter():
    tree = simple_tree("a", 10.0, 5, np.random.default_rng(1))
    assert np.isnan(stem_diameter_m(replace(tree, organs=tree.organs[1:]), np.array([1.3]))).all()
    assert np.isnan(stem_diameter_m(tree, np.array([9.5])))[0]  # above the trunk's tip
    dead = replace(tree, organs=tuple(replace(organ, part=Part.DEAD_WOOD) for organ in tree.organs))
    assert np.isnan(stem_diameter_m(dead, np.array([1.3]))).all()


def test_a_crown_without_leaves_is_its_flowers_or_everything():
    tree = simple_tree("a", 10.0, 30, np.random.default_rng(1))
    leaves = crown_centre(tree)
    trunk, blades = tree.organs
    np.testing.assert_allclose(crown_centre(replace(tree, organs=(trunk, replace(blades, part=Part.FLOWER)))), leaves)
    bare = crown_centre(replace(tree, organs=(trunk, replace(blades, part=Part.DEAD_WOOD))))
    areas = [surface_area_m2(organ.mesh) for organ in tree.organs]
    alone = crown_centre(replace(tree, organs=(replace(trunk, part=Part.DEAD_WOOD),)))
    np.testing.assert_allclose(bare, (areas[0] * alone + areas[1] * leaves) / sum(areas), rtol=1e-6)


def test_an_empty_scene():
    measures = measure_plants(scattered_scene(0, exemplars=1, leaves=3, terrain=plain_ground(0, 1)))
    assert measures.tip_m.shape == (0, 3)
    assert measures.dbh_m.shape == (0,)


def test_volumes_are_those_of_the_cones_and_scale_with_the_instances(spec):
    """Above the ground a trunk is a cone of eight sides, of the volume base times height over three."""
    stem, wood = PlantMeter(spec.exemplars).volumes_m3(spec.instances)
    scale = np.linalg.norm(spec.instances.transform[:, :, 2], axis=1)
    height = np.array([exemplar.height_m for exemplar in spec.exemplars])[spec.instances.exemplar]
    tip, foot = 0.9 * height, height * 0.012
    base = 2 * np.sqrt(2) * (foot * tip / (tip + 0.2)) ** 2
    np.testing.assert_allclose(stem, base * tip / 3 * scale**3, rtol=1e-3)
    whole = np.array([exemplar.wood_volume_m3 for exemplar in spec.exemplars])[spec.instances.exemplar]
    np.testing.assert_allclose(wood, whole * scale**3)


def test_no_trunk_no_stem_volume():
    tree = simple_tree("a", 10.0, 5, np.random.default_rng(1))
    assert stem_volume_m3(replace(tree, organs=tree.organs[1:])) == 0.0


def test_leaf_area_lies_at_the_heights_of_the_leaves(spec):
    meter, measures, edges = PlantMeter(spec.exemplars), measure_plants(spec), np.arange(0.0, 16.0, 1.0)
    group = np.arange(len(spec.instances)) % 2 - 1  # half of the plants is left out
    found = meter.leaf_area_by_height_m2(spec.instances, measures.leaf_area_m2, group, edges)
    exact = np.zeros((1, len(edges) - 1))
    for row in np.flatnonzero(group == 0):
        leaves = in_world(spec, row, (Part.LEAF,))
        exact[0] += np.histogram(leaves[..., 2].mean(axis=1), edges, weights=area_of(leaves))[0]
    np.testing.assert_allclose(found.sum(), measures.leaf_area_m2[group == 0].sum(), rtol=1e-9)
    assert np.abs(found - exact).sum() < 0.02 * exact.sum()  # heights are known to a 128th of the crown


def test_leaves_below_the_lowest_edge_count_in_the_lowest_layer(spec):
    meter, measures = PlantMeter(spec.exemplars), measure_plants(spec)
    group = np.zeros(len(spec.instances), dtype=int)
    found = meter.leaf_area_by_height_m2(spec.instances, measures.leaf_area_m2, group, np.array([6.0, 7.0, 8.0]))
    np.testing.assert_allclose(found.sum(), measures.leaf_area_m2.sum(), rtol=1e-9)
