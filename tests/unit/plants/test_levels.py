"""Far versions keep the leaf area, the box and what they cover."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from plant_species import read
from silhouette_area import drawn

from forestgen.core.parts import Part
from forestgen.core.randomness import child_rng
from forestgen.geometry.mesh import Mesh, surface_area_m2
from forestgen.plants.build import build_exemplar
from forestgen.plants.exemplar import Exemplar
from forestgen.plants.levels import PIXEL_STEPS_M, far_piece, level_for

DIRECTIONS = ((1.0, 0.0, 0.0), (0.0, 1.0, -0.3), (0.3, 0.2, -1.0))
RADII = {"poplar": 1.5, "spruce": 1.2}


@cache
def plant(name: str, pixel_m: float) -> Exemplar:
    species, parameters = read(name)
    return build_exemplar(name, species, parameters, RADII[name], child_rng(3, name), pixel_m=pixel_m)


@pytest.mark.parametrize("pixel_m", PIXEL_STEPS_M[1:])
@pytest.mark.parametrize("name", RADII)
def test_leaf_area_box_and_volume_stay(name: str, pixel_m: float) -> None:
    full, far = plant(name, 0.0), plant(name, pixel_m)
    assert far.leaf_area_m2 == pytest.approx(full.leaf_area_m2, rel=1e-4)
    assert far.wood_volume_m3 == full.wood_volume_m3
    size = np.ptp(full.bounds_m(), axis=0)
    np.testing.assert_allclose(np.ptp(far.bounds_m(), axis=0), size, rtol=0.02)
    np.testing.assert_allclose(far.bounds_m(), full.bounds_m(), atol=0.02 * size.max())
    assert far.height_m == pytest.approx(full.height_m, rel=0.005)
    assert far.triangles < 0.9 * full.triangles
    for organ in far.organs:
        mesh = organ.mesh
        assert np.isfinite(mesh.vertices_m).all()
        assert mesh.normals is not None
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-3)


@pytest.mark.parametrize("pixel_m", PIXEL_STEPS_M[1:])
@pytest.mark.parametrize("name", RADII)
def test_the_crown_covers_the_same_area_from_the_distance_at_which_it_is_used(name: str, pixel_m: float) -> None:
    full, far = (
        np.array([float(drawn(plant(name, one), direction, 0.007).sum()) for direction in DIRECTIONS])
        for one in (0.0, pixel_m)
    )
    np.testing.assert_allclose(far, full, rtol=0.03)
    assert far.sum() == pytest.approx(full.sum(), rel=0.02)


def test_organs_of_a_coarse_level_are_among_those_of_a_finer_one_and_the_same_plants_are_the_same() -> None:
    from forestgen.plants.levels import simplified
    from forestgen.plants.skeleton import OrganPlacements, Skeleton

    rng = np.random.default_rng(1)
    count = 1500
    frame = np.zeros((count, 3, 4), np.float32)
    frame[:, :, :3] = np.eye(3)
    frame[:, :, 3] = rng.uniform(0, 10, (count, 3))
    nodes = np.linspace([0, 0, 0], [0, 0, 10], 40).astype(np.float32)
    skeleton = Skeleton(
        parent=np.arange(-1, 39, dtype=np.int32),
        position_m=nodes,
        radius_m=np.linspace(0.1, 0.02, 40, dtype=np.float32),
        order=np.zeros(40, np.uint8),
        axis=np.zeros(40, np.int32),
        organs=(OrganPlacements("leaf", frame, np.full(count, 39, np.int32)),),
    )
    square = Mesh(
        np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]], np.float32),
        np.array([[0, 1, 2], [0, 2, 3]], np.uint32),
    )
    kept = []
    for pixel_m in (0.155, 0.16, 0.4):
        far, again = (simplified(skeleton, {"leaf": square}, pixel_m, child_rng(1)) for _ in range(2))
        [organs] = far.organs
        np.testing.assert_array_equal(organs.frame, again.organs[0].frame)
        growth = np.linalg.norm(organs.frame[:, :, 0], axis=1)
        assert np.sum(growth**2) == pytest.approx(count, rel=1e-5)  # the area stays
        assert np.all(organs.node < len(far.parent))
        assert len(far.parent) == 2  # a straight stem
        middle = organs.frame[:, :, :3] @ [0.05, 0.05, 0] + organs.frame[:, :, 3]
        own = frame[:, :, 3] + np.float32([0.05, 0.05, 0])
        nearest = np.linalg.norm(own[None] - middle[:, None], axis=2)
        inside = nearest.min(axis=1) < 1e-4  # the others were moved into the box
        assert inside.mean() > 0.9
        kept.append(set(nearest[inside].argmin(axis=1)))
    assert len(kept[0]) > len(kept[1]) + 20 > len(kept[2]) + 40 > 900
    assert len(kept[2] - kept[1]) < 0.03 * len(kept[2])
    assert len(kept[1] - kept[0]) < 0.03 * len(kept[1])


def test_all_detail_is_the_plant_itself() -> None:
    species, parameters = read("fireweed")
    plain = build_exemplar("fireweed", species, parameters, 0.2, child_rng(1))
    level = build_exemplar("fireweed", species, parameters, 0.2, child_rng(1), pixel_m=0.0)
    for a, b in zip(plain.organs, level.organs, strict=True):
        np.testing.assert_array_equal(a.mesh.vertices_m, b.mesh.vertices_m)


def test_levels_are_numbered_by_what_a_pixel_covers() -> None:
    finest, coarsest = PIXEL_STEPS_M[1], PIXEL_STEPS_M[-1]
    pixels = np.array([0.0, 0.99 * finest, finest, 0.99 * coarsest, coarsest, 1e9, np.inf])
    index = level_for(pixels)
    assert index[:2].tolist() == [0, 0]
    assert np.all(np.diff(index) >= 0)
    for pixel_m, one in zip(pixels, index, strict=True):
        assert PIXEL_STEPS_M[one] <= pixel_m  # never coarser than what is seen


@pytest.mark.parametrize("name", ["poplar", "spruce", "fireweed"])
def test_far_organs_keep_area_and_attitude(name: str) -> None:
    _, parameters = read(name)
    for shape in parameters.shapes.values():
        for piece in shape.pieces():
            far = far_piece(piece.mesh, 10.0)
            assert surface_area_m2(far) == pytest.approx(surface_area_m2(piece.mesh), rel=1e-5)
            assert far.triangles <= piece.mesh.triangles
            assert far_piece(piece.mesh, 0.0) is piece.mesh
            if piece.part is Part.LEAF and far.triangles < piece.mesh.triangles:
                up, far_up = (np.asarray(_mean_normal(mesh)) for mesh in (piece.mesh, far))
                assert up @ far_up > 0.9


def _mean_normal(mesh: Mesh) -> np.ndarray:
    a, b, c = (mesh.vertices_m[mesh.faces[:, k]].astype(np.float64) for k in range(3))
    total = np.cross(b - a, c - a).sum(axis=0)
    return total / np.linalg.norm(total)
