"""Solids of revolution in place of plants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from plant_species import read

from forestgen.core.parts import Part
from forestgen.core.randomness import child_rng
from forestgen.geometry.mesh import Mesh, part_of
from forestgen.plants.build import build_exemplar
from forestgen.plants.exemplar import as_solids, measured_profile, solid_of_revolution


def closed(mesh: Mesh) -> trimesh.Trimesh:
    body = trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False)
    assert body.is_watertight
    assert body.is_winding_consistent
    return body


def test_an_ellipsoid_has_its_volume() -> None:
    z = -np.cos(np.linspace(0, np.pi, 60)) * 5
    body = closed(solid_of_revolution(z, 2 * np.sqrt(np.maximum(1 - (z / 5) ** 2, 0))))
    assert body.volume == pytest.approx(4 / 3 * np.pi * 2 * 2 * 5, rel=0.01)


def test_the_profile_of_points_in_a_cone_is_the_cone() -> None:
    rng = np.random.default_rng(0)
    height = rng.uniform(0, 1, 200_000)
    distance, turn = (1 - height) * np.sqrt(rng.uniform(0, 1, len(height))), rng.uniform(0, 2 * np.pi, len(height))
    points = np.stack([distance * np.cos(turn), distance * np.sin(turn), 10 * height], axis=1)
    z, radius = measured_profile(points)
    np.testing.assert_allclose(radius[1:-1], 1 - z[1:-1] / 10, atol=0.02)


@pytest.mark.parametrize(("name", "height_m"), [("poplar", 10.0), ("spruce", 8.0), ("fireweed", 1.2)])
def test_a_plants_solid_is_closed_and_as_large_as_the_plant(name: str, height_m: float) -> None:
    traits, parameters = read(name)
    radius = (height_m / traits.allometry.height_m.scale) ** (1 / traits.allometry.height_m.exponent)
    plant = build_exemplar(name, traits, parameters, radius, child_rng(1, name))
    solid = as_solids(plant)
    leafy = [organ.mesh.vertices_m for organ in plant.organs if organ.part in (Part.LEAF, Part.FLOWER)]
    is_clear = bool(min(points[:, 2].min() for points in leafy) > 0.0)  # a crown that reaches the ground hides its stem
    assert [organ.part for organ in solid.organs] == [Part.TRUNK] * is_clear + [Part.LEAF]
    for organ in solid.organs:
        assert closed(organ.mesh).volume > 0
    low, high = solid.bounds_m()
    assert high[2] == pytest.approx(plant.height_m, rel=0.03)
    assert np.mean((high - low)[:2]) == pytest.approx(plant.crown_width_m, rel=0.01)
    assert solid.triangles < 4000
    assert solid.leaf_area_m2 == plant.leaf_area_m2


def test_a_stem_with_a_patch_of_moss_has_the_solid_of_a_bare_one() -> None:
    traits, parameters = read("poplar")
    plant = build_exemplar("poplar", traits, parameters, 2.0, child_rng(1, "poplar"))
    stem = next(organ for organ in plant.organs if organ.part == Part.TRUNK)
    middle = stem.mesh.vertices_m[stem.mesh.faces].mean(axis=1)
    is_moss = (middle[:, 2] < 1.5) & (middle[:, 0] > middle[:, 1])
    pieces = [
        replace(stem, material=name, mesh=part_of(stem.mesh, stem.mesh.faces[chosen]))
        for name, chosen in (("moss", is_moss), (stem.material, ~is_moss))
    ]
    rest = [organ for organ in plant.organs if organ is not stem]
    bare, mossy = (as_solids(replace(plant, organs=(*first, *rest))).organs[0] for first in ([stem], pieces))
    assert mossy.material == bare.material == stem.material
    np.testing.assert_allclose(mossy.mesh.vertices_m, bare.mesh.vertices_m, atol=1e-5)
