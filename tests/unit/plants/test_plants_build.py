"""Exemplars: they fit the size asked for, grow with it, and hold sound meshes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from plant_species import read

from forestgen.core.errors import RecipeError
from forestgen.core.parts import Part
from forestgen.core.randomness import child_rng
from forestgen.plants.build import build_exemplar, size_m
from forestgen.plants.exemplar import Exemplar
from forestgen.plants.generators.silhouette import Parameters
from support.error_messages import raises_error

RADII = {"poplar": (0.05, 0.3, 1.0, 2.9), "spruce": (0.05, 0.3, 1.0, 3.2), "fireweed": (0.05, 0.13, 0.3, 0.5)}
BUDGET = {"poplar": 160_000, "spruce": 225_000, "fireweed": 12_000}
_BUILT: dict[tuple[str, float], Exemplar] = {}


def built(name: str, radius: float) -> Exemplar:
    if (name, radius) not in _BUILT:
        species, parameters = read(name)
        _BUILT[name, radius] = build_exemplar(name, species, parameters, radius, child_rng(3, name))
    return _BUILT[name, radius]


@pytest.mark.parametrize(("name", "radius"), [(name, r) for name, radii in RADII.items() for r in radii])
def test_geometry_fits_the_height_and_width_asked_for(name: str, radius: float) -> None:
    exemplar = built(name, radius)
    height, width = size_m(read(name)[0], radius)
    low, high = exemplar.bounds_m()
    assert exemplar.height_m == pytest.approx(height, rel=0.02)
    assert exemplar.height_m == pytest.approx(high[2])
    assert exemplar.crown_width_m == pytest.approx(width, rel=0.10)
    assert exemplar.crown_width_m == pytest.approx(np.mean((high - low)[:2]))
    assert -0.35 < low[2] < -0.25, "the stem reaches below the ground"


@pytest.mark.parametrize("name", RADII)
def test_triangles_grow_with_size_within_budget(name: str) -> None:
    counts = [built(name, radius).triangles for radius in RADII[name]]
    assert (counts[0], counts[-1]) == (min(counts), max(counts))  # in between a species' leaves may become coarser
    assert counts[-1] <= BUDGET[name]


@pytest.mark.parametrize("name", RADII)
def test_meshes_are_sound(name: str) -> None:
    for radius in (RADII[name][0], RADII[name][2]):
        for organ in built(name, radius).organs:
            mesh = organ.mesh
            assert mesh.triangles > 0
            assert int(mesh.faces.max()) < len(mesh.vertices_m)
            assert np.all(np.isfinite(mesh.vertices_m))
            assert mesh.normals is not None
            np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-4)


def test_parts_and_materials() -> None:
    for name in RADII:
        materials = read(name)[0].materials
        exemplar = built(name, RADII[name][-1])
        assert {organ.material for organ in exemplar.organs} <= set(materials)
        assert {Part.TRUNK, Part.LEAF} <= {organ.part for organ in exemplar.organs}
        assert all("spectrum" in material for material in materials.values())
    assert Part.FLOWER in {organ.part for organ in built("fireweed", 0.5).organs}
    assert Part.BRANCH in {organ.part for organ in built("poplar", 2.9).organs}


def test_branches_start_inside_their_bearer() -> None:
    from forestgen.plants.generators.silhouette import GENERATOR
    from forestgen.plants.meshing import branch_lines

    skeleton = GENERATOR.grow(read("poplar")[1], 8.0, 2.2, np.random.default_rng(4))
    first = np.flatnonzero(np.diff(skeleton.axis, prepend=-1))[1:]
    last = np.append(first[1:], len(skeleton.axis))
    lines = branch_lines(skeleton, first, last)
    foot = lines.offset[:-1]
    bearer = skeleton.parent[first]
    np.testing.assert_array_equal(lines.points_m[foot].astype(np.float32), skeleton.position_m[bearer])
    assert np.all(lines.radius_m[foot] <= skeleton.radius_m[bearer] + 1e-7)


def test_leaf_area_index_is_that_of_a_crown() -> None:
    for name, low, high in (("poplar", 2.5, 5.0), ("spruce", 4.0, 9.0)):
        exemplar = built(name, RADII[name][-1])
        leaves = next(organ.mesh for organ in exemplar.organs if organ.part == Part.LEAF)
        a, b, c = (leaves.vertices_m[leaves.faces[:, k]] for k in range(3))
        area = 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
        assert low < area / (np.pi / 4 * exemplar.crown_width_m**2) < high


def test_a_missing_material_is_named() -> None:
    species, parameters = read("fireweed")
    species.materials = {"leaf": {}}
    with raises_error(RecipeError, place="species fireweed: plant"):
        build_exemplar("fireweed", species, parameters, 0.1, np.random.default_rng(0))


def test_different_seeds_make_different_plants(species: tuple[str, Any, Parameters]) -> None:
    name, traits, parameters = species
    first, other = (build_exemplar(name, traits, parameters, 0.2, child_rng(seed, name)) for seed in (1, 2))
    assert first.organs[0].mesh.vertices_m.tobytes() != other.organs[0].mesh.vertices_m.tobytes()
