"""Wood: closed tubes of the skeleton's volume, collars that join a branch to its bearer, no trace of threads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from plant_species import read

from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh, concatenate
from forestgen.geometry.simplify import merged
from forestgen.plants.generators.silhouette import GENERATOR
from forestgen.plants.meshing import branch_lines, organ_meshes, stem_line
from forestgen.plants.parameters import Wood
from forestgen.plants.skeleton import Skeleton
from support.swept import volume_m3, wood_mesh

Floats = NDArray[np.float64]


def skeleton(parent: list[int], position: object, radius: object, order: list[int], axis: list[int]) -> Skeleton:
    return Skeleton(
        np.array(parent, np.int32),
        np.array(position, np.float32),
        np.array(radius, np.float32),
        np.array(order, np.uint8),
        np.array(axis, np.int32),
    )


def tee(angle_deg: float = 90.0, thickness: float = 0.06, *, bearer: float = 0.15, length: float = 2.0) -> Skeleton:
    """A stem of three nodes with a branch of three nodes on the middle one."""
    turn = np.radians(angle_deg)
    way = np.array([np.sin(turn), 0.0, np.cos(turn)])
    foot = np.array([0.0, 0.0, 1.5])
    branch = [foot + length * share * way for share in (0.4, 0.7, 1.0)]
    return skeleton(
        [-1, 0, 1, 1, 3, 4],
        [[0, 0, 0], foot, [0, 0, 3], *branch],
        [bearer, bearer, bearer, thickness, thickness, thickness],
        [0, 0, 0, 1, 1, 1],
        [0, 0, 0, 1, 1, 1],
    )


def random_skeleton(seed: int, axes: int = 25) -> Skeleton:
    rng = np.random.default_rng(seed)
    parent, position, radius, order, axis = [-1], [np.zeros(3)], [0.2], [0], [0]
    for number in range(axes):
        bearer = 0 if number == 0 else int(rng.integers(1, len(parent)))
        way = np.array([0, 0, 1.0]) if number == 0 else rng.normal(size=3)
        way /= np.linalg.norm(way)
        girth = radius[bearer] * (1.0 if number == 0 else rng.uniform(0.3, 0.9))
        for step in range(int(rng.integers(2, 8))):
            way = way + rng.normal(scale=0.2, size=3)
            way /= np.linalg.norm(way)
            parent.append(bearer if step == 0 else len(parent) - 1)
            position.append(position[parent[-1]] + way * rng.uniform(3.0, 8.0) * girth)
            girth *= rng.uniform(0.75, 1.0)
            radius.append(girth)
            order.append(0 if number == 0 else min(order[bearer] + 1, 9))
            axis.append(number)
    return skeleton(parent, position, radius, order, axis)


def grown(name: str) -> Skeleton:
    return GENERATOR.grow(read(name)[1], 12.0, 3.5, np.random.default_rng(4))


def volume(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices_m.astype(np.float64)[mesh.faces[:, k]] for k in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6.0)


def frusta_m3(wood: Skeleton) -> float:
    """Volume of the polylines that are meshed."""
    first = np.flatnonzero(np.diff(wood.axis, prepend=-1))
    last = np.append(first[1:], len(wood.axis))
    total = 0.0
    for a, b in zip(first, last, strict=True):
        if wood.order[a] == 0 and wood.parent[a] <= 0:
            line = stem_line(wood, int(a), int(b))
            total += volume_m3(line) if line is not None else 0.0
        else:
            total += volume_m3(branch_lines(wood, np.array([a]), np.array([b])))
    return total


def assert_closed(mesh: Mesh) -> None:
    _, faces = merged(mesh)
    assert len(faces) == mesh.triangles, "no face lost a corner"
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    there, back = edges @ [10**7, 1], edges[:, ::-1] @ [10**7, 1]
    np.testing.assert_array_equal(np.sort(there), np.sort(back))


def both(wood: Skeleton, *, plain: bool, ratio: float = 1.0) -> Mesh:
    parts = [wood_mesh(wood, trunk, 0.3, height_ratio=ratio, plain=plain) for trunk in (True, False)]
    return concatenate([part for part in parts if part.triangles])


@pytest.mark.parametrize("name", ["poplar", "spruce"])
@pytest.mark.parametrize("plain", [True, False])
def test_a_tree_is_closed_and_sound(name: str, plain: bool) -> None:
    mesh = both(grown(name), plain=plain, ratio=1.3)
    assert_closed(mesh)
    assert mesh.normals is not None
    assert mesh.uv is not None
    assert np.all(np.isfinite(mesh.vertices_m))
    assert np.all(np.isfinite(mesh.uv))
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-5)
    _, faces = merged(mesh)
    assert len(np.unique(np.sort(faces, axis=1), axis=0)) == len(faces), "no face twice"


@pytest.mark.parametrize("name", ["poplar", "spruce"])
def test_a_tree_has_the_volume_of_its_frusta(name: str) -> None:
    wood = grown(name)
    assert volume(both(wood, plain=True)) == pytest.approx(frusta_m3(wood), rel=0.02)
    assert volume(both(wood, plain=True, ratio=1.6)) == pytest.approx(frusta_m3(wood), rel=0.02)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_random_skeleton_has_the_volume_of_its_frusta(seed: int) -> None:
    wood = random_skeleton(seed)
    assert volume(both(wood, plain=True)) == pytest.approx(frusta_m3(wood), rel=0.02)
    assert_closed(both(wood, plain=False))


@pytest.mark.parametrize("name", ["poplar", "spruce"])
def test_the_skeleton_counts_what_is_above_ground_and_outside_the_bearer(name: str) -> None:
    wood = grown(name)
    foot = 0.3 * np.pi * float(wood.radius_m[0]) ** 2
    first = np.flatnonzero(np.diff(wood.axis, prepend=-1))[1:]
    inside = np.sum(np.pi * wood.radius_m[first].astype(np.float64) ** 2 * wood.radius_m[wood.parent[first]])
    meshed = volume(both(wood, plain=True)) - foot
    assert wood.volume_m3() <= meshed
    assert wood.volume_m3() == pytest.approx(meshed - inside, rel=0.02)


@pytest.mark.parametrize("angle_deg", [40.0, 90.0, 130.0])
def test_the_skeleton_s_volume_is_that_of_the_union(angle_deg: float) -> None:
    """By counting: points in a box that lie in the stem or in the branch."""
    wood = tee(angle_deg, thickness=0.03)
    rng = np.random.default_rng(7)
    low, high = np.array([-0.2, -0.2, 0.0]), np.array([2.0, 0.2, 3.2])
    stem_m3 = np.pi * 0.15**2 * 3.0
    points = rng.uniform(low, high, (1_500_000, 3))
    turn = np.radians(angle_deg)
    way = np.array([np.sin(turn), 0.0, np.cos(turn)])
    from_foot = points - [0.0, 0.0, 1.5]
    along = from_foot @ way
    apart = np.linalg.norm(from_foot - along[:, None] * way, axis=1)
    branch = (along > 0.0) & (along < 2.0) & (apart < 0.03)
    only_branch = np.mean(branch & (np.hypot(points[:, 0], points[:, 1]) > 0.15)) * np.prod(high - low)
    counted = wood.volume_m3()
    assert counted - stem_m3 == pytest.approx(only_branch, rel=0.05)


@pytest.mark.parametrize("angle_deg", [35.0, 60.0, 90.0, 120.0])
def test_a_collar_swells_towards_the_bearer_and_is_small(angle_deg: float) -> None:
    wood = tee(angle_deg)
    plain, whole = (wood_mesh(wood, False, 0.0, plain=flag) for flag in (True, False))
    assert_closed(whole)
    assert volume(plain) < volume(whole) < 1.15 * volume(plain)
    turn = np.radians(angle_deg)
    way = np.array([np.sin(turn), 0.0, np.cos(turn)])
    from_foot = whole.vertices_m.astype(np.float64) - [0.0, 0.0, 1.5]
    along = from_foot @ way
    apart = np.linalg.norm(from_foot - along[:, None] * way, axis=1)
    outside = np.hypot(whole.vertices_m[:, 0], whole.vertices_m[:, 1]) > 0.15
    near, far = outside & (along < 0.45), along > 1.0
    own = apart[far & (along < 1.9)].max()
    assert 1.05 * own < apart[near].max() < 1.8 * own
    assert apart[far].max() < 1.001 * own
    assert np.hypot(whole.vertices_m[:, 0], whole.vertices_m[:, 1])[along < 0.01].max() < 0.15


def test_a_branch_begins_inside_its_bearer_without_a_gap() -> None:
    wood = tee(70.0)
    mesh = wood_mesh(wood, False, 0.0)
    radial = np.hypot(mesh.vertices_m[:, 0], mesh.vertices_m[:, 1])
    below = np.abs(mesh.vertices_m[:, 2] - 1.5) < 0.5
    assert radial[below].min() < 0.15 - 0.06
    cap = (radial < 0.149) & below
    assert np.count_nonzero(cap) >= 2 * 8, "the base cap and a ring lie inside"


def test_shading_at_the_foot_of_a_collar_turns_into_the_bearers() -> None:
    wood = tee(90.0)
    mesh = wood_mesh(wood, False, 0.0)
    assert mesh.normals is not None
    radial = np.hypot(mesh.vertices_m[:, 0], mesh.vertices_m[:, 1])
    outward = mesh.vertices_m * [1.0, 1.0, 0.0] / np.maximum(radial, 1e-9)[:, None]
    foot = (np.abs(radial - 0.15) < 0.02) & (mesh.vertices_m[:, 0] > 0.0)
    far = (mesh.vertices_m[:, 0] > 1.0) & (mesh.vertices_m[:, 0] < 1.9)
    assert np.any(foot)
    assert np.sum(mesh.normals * outward, axis=1)[foot].min() > 0.3
    assert np.abs(np.sum(mesh.normals * [1.0, 0.0, 0.0], axis=1)[far]).max() < 0.1


def test_twigs_without_collars_are_what_plain_wood_is() -> None:
    wood = tee(thickness=0.004, bearer=0.01)
    plain, whole = (wood_mesh(wood, False, 0.0, plain=flag) for flag in (True, False))
    np.testing.assert_array_equal(plain.vertices_m, whole.vertices_m)


def test_an_axis_that_ends_in_a_fork_ends_in_a_dome() -> None:
    fork = skeleton(
        [-1, 0, 1, 1],
        [[0, 0, 0], [0, 0, 1], [0.5, 0, 1.6], [-0.5, 0, 1.6]],
        [0.1, 0.1, 0.08, 0.08],
        [0, 0, 1, 1],
        [0, 0, 1, 2],
    )
    stem = wood_mesh(fork, True, 0.0)
    assert_closed(stem)
    assert 1.05 < stem.vertices_m[:, 2].max() <= 1.1 + 1e-6
    assert_closed(wood_mesh(fork, False, 0.0))
    flat = wood_mesh(replace(fork, radius_m=np.array([0.1, 0.1, 0.03, 0.03], np.float32)), True, 0.0)
    assert flat.vertices_m[:, 2].max() == pytest.approx(1.0)


def test_threads_between_pieces_leave_no_trace() -> None:
    joined = skeleton(
        [-1, 0, 1, 2, 3],
        [[0, 0, 0], [0, 0, 1], [0, 0, 2], [0, 0.2, 3], [0, 0.2, 4]],
        [0.1, 0.1, 1e-6, 0.05, 0.05],
        [0, 0, 1, 1, 1],
        [0, 0, 1, 2, 2],
    )
    mesh = wood_mesh(joined, False, 0.0)
    assert_closed(mesh)
    assert mesh.vertices_m[:, 2].min() > 1.9, "nothing of the thread from 1 m to 2 m"
    assert mesh.triangles > 0


def test_a_log_on_the_ground_has_no_foot_below_it() -> None:
    log = skeleton([-1, 0, 1], [[0, 0, 0.1], [1, 0, 0.1], [2, 0, 0.1]], [0.1, 0.1, 0.1], [0, 0, 0], [0, 0, 0])
    mesh = wood_mesh(log, True, 0.0, plain=True)
    assert_closed(mesh)
    assert mesh.vertices_m[:, 0].min() == pytest.approx(0.0, abs=1e-6)
    assert volume(mesh) == pytest.approx(np.pi * 0.01 * 2.0, rel=1e-4)


def test_flare_widens_the_foot_alone() -> None:
    stem = skeleton([-1, 0, 1], [[0, 0, 0], [0, 0, 4], [0, 0, 8]], [0.2, 0.2, 0.15], [0] * 3, [0] * 3)
    narrow, wide = (wood_mesh(stem, True, flare).vertices_m for flare in (0.0, 0.5))
    reach = [np.hypot(v[:, 0], v[:, 1]) for v in (narrow, wide)]
    assert reach[1][np.abs(wide[:, 2]) < 0.01].max() > 1.3 * reach[0][np.abs(narrow[:, 2]) < 0.01].max()
    np.testing.assert_allclose(reach[1][wide[:, 2] > 7.9].max(), reach[0][narrow[:, 2] > 7.9].max(), rtol=0.01)


def test_texture_keeps_its_scale() -> None:
    wood = grown("poplar")
    mesh = wood_mesh(wood, False, 0.0, tile_m=(0.25, 0.5))
    assert mesh.uv is not None
    assert mesh.uv[:, 1].max() < 12.0 / 0.5


def test_parts_with_and_without_texture_are_joined() -> None:
    with_uv = wood_mesh(tee(), True, 0.0)
    without = Mesh(with_uv.vertices_m, with_uv.faces, with_uv.normals)
    joined = concatenate([with_uv, without])
    assert joined.uv is not None
    assert with_uv.uv is not None
    np.testing.assert_array_equal(joined.uv[: len(with_uv.uv)], with_uv.uv)
    assert not joined.uv[len(with_uv.uv) :].any()
    assert concatenate([without, without]).uv is None


def test_thick_branches_have_the_stems_material() -> None:
    wood = random_skeleton(5)
    whole = organ_meshes(wood, {}, Wood(material="bark", branch_material="twig"))
    feet = 2.0 * wood.radius_m[np.flatnonzero(np.diff(wood.axis, prepend=-1))[1:]]
    limit = float(np.median(feet))
    split = organ_meshes(wood, {}, Wood(material="bark", branch_material="twig", thick_branch_m=limit))
    assert [(organ.part, organ.material) for organ in split] == [
        (Part.TRUNK, "bark"),
        (Part.BRANCH, "twig"),
        (Part.BRANCH, "bark"),
    ]
    assert sum(organ.mesh.triangles for organ in split) == sum(organ.mesh.triangles for organ in whole)
    thick = wood_mesh(wood, False, 0.3, plain=True, foot_m=(limit, np.inf))
    assert volume(thick) > 0.5 * volume(wood_mesh(wood, False, 0.3, plain=True))
    same = organ_meshes(wood, {}, Wood(material="bark", thick_branch_m=limit))
    assert len(same) == 2, "meshes of one part and material are one"
