"""Baking: an atlas shows what the repeating texture shows at the same place."""

from __future__ import annotations

import numpy as np

from forestgen.geometry.mesh import Mesh
from forestgen.geometry.simplify import Image, bake, decimate, unwrap
from forestgen.geometry.sweep import Polylines
from support.swept import sweep

SIZE_PX = 256


def tube(x_m: float, points: int = 30) -> Mesh:
    """A vertical tube 3 m tall; one repeat of its texture is 3 m."""
    line = np.stack([np.full(points, x_m), np.zeros(points), np.linspace(0, 3, points)], axis=1)
    lines = Polylines(line, np.full(points, 0.3), np.array([0, points]))
    return sweep(lines, np.array([16]), pointed=False, tile_m=(3.0, 3.0))


def plain(colour: tuple[float, float, float]) -> Image:
    return np.tile(np.array(colour, dtype=np.float32), (8, 8, 1))


def at_middles(mesh: Mesh, image: Image) -> np.ndarray:
    """(F, 3) colours at the middles of the faces' charts."""
    assert mesh.uv is not None
    middle = np.floor(mesh.uv[mesh.faces].mean(axis=1) * SIZE_PX).astype(int)
    return image[middle[:, 1], middle[:, 0]]


def test_each_mesh_gives_its_own_colour() -> None:
    fine = [(tube(0.0), plain((1, 0, 0))), (tube(2.0), plain((0, 0, 1)))]
    parts = [decimate(mesh, 200) for mesh, _ in fine]
    vertices = np.concatenate([part.vertices_m for part in parts])
    faces = np.concatenate([parts[0].faces, parts[1].faces + np.uint32(len(parts[0].vertices_m))])
    atlas = unwrap(Mesh(vertices, faces))
    image = bake(atlas, fine, SIZE_PX)
    assert image.shape == (SIZE_PX, SIZE_PX, 3)
    np.testing.assert_allclose(image.sum(axis=2), 1.0, err_msg="no texel is left empty or mixes the two")
    is_second = atlas.vertices_m[atlas.faces, 0].mean(axis=1) > 1.0
    np.testing.assert_array_equal(at_middles(atlas, image)[:, 2] > 0.5, is_second)


def test_the_texture_stays_where_it_was() -> None:
    rows = 64
    up = np.repeat(np.linspace(0, 1, rows, endpoint=False, dtype=np.float32) + np.float32(0.5 / rows), rows)
    ramp = np.tile(up.reshape(rows, rows, 1), (1, 1, 3))  # grey by height
    fine = tube(0.0)
    atlas = unwrap(decimate(fine, 300))
    middle_m = atlas.vertices_m[atlas.faces, 2].mean(axis=1)
    round_the_tube = np.ptp(atlas.vertices_m[atlas.faces, 2], axis=1) > 0.05  # the flat ends have another uv
    grey = at_middles(atlas, bake(atlas, [(fine, ramp)], SIZE_PX))[:, 0]
    away = np.abs(grey - middle_m / 3.0)[round_the_tube]
    assert np.count_nonzero(round_the_tube) > 100
    assert np.quantile(away, 0.9) < 0.02


def test_a_fine_pattern_is_averaged_not_sampled() -> None:
    checks = (np.indices((512, 512)).sum(axis=0) % 2).astype(np.float32)
    fine = tube(0.0)
    image = bake(unwrap(fine), [(fine, np.repeat(checks[..., None], 3, axis=2))], 64)
    np.testing.assert_allclose(image, 0.5, atol=1e-6)
