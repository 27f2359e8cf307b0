"""The studio's cameras hold the plant, and its ground meets the sky."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.core.errors import RecipeError
from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.render.studio import PictureSettings, camera_of, ground
from forestgen.scene.spec import Camera
from support.error_messages import raises_error


def plant(height_m: float, width_m: float, lean_m: float = 0.0) -> Exemplar:
    """A cloud of triangles in an ellipsoid above the ground, its top at `height_m`."""
    rng = np.random.default_rng(4)
    way = rng.normal(size=(600, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    vertices = way * [width_m / 2, width_m / 2, height_m / 2] + [lean_m, 0, height_m / 2]
    mesh = Mesh(vertices.astype(np.float32), np.arange(600, dtype=np.uint32).reshape(-1, 3))
    return Exemplar("ball", (OrganMesh(Part.LEAF, "leaf", mesh),), 1.0, height_m, width_m, 1.0, 0.0)


def pixels(camera: Camera, exemplar: Exemplar) -> np.ndarray:
    """(V, 2) where the plant's vertices are seen, in pixels."""
    seen = (exemplar.organs[0].mesh.vertices_m - np.array(camera.position_m)) @ camera.world_from_camera
    assert np.all(seen[:, 2] > 0)
    return seen[:, :2] / seen[:, 2:] * camera.focal_px + np.array(camera.size_px) / 2


SIZES = [(0.1, 0.05, 0.0), (0.4, 3.0, 0.0), (12.0, 4.0, 2.0), (30.0, 22.0, 0.0)]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("size_px", [(540, 720), (640, 200)])
@pytest.mark.parametrize("distance_m", [None, 30.0])
def test_the_plant_fills_the_picture(
    size: tuple[float, float, float], size_px: tuple[int, int], distance_m: float | None
) -> None:
    one = plant(*size)
    at = pixels(camera_of(one, PictureSettings(size_px, distance_m=distance_m)), one)
    share = (at.max(axis=0) - at.min(axis=0)) / size_px
    assert np.all(at >= 0)
    assert np.all(at <= size_px)
    assert 0.75 < share.max() <= 0.9


def test_a_distance_is_where_the_camera_stands() -> None:
    camera = camera_of(plant(12, 4), PictureSettings(distance_m=30.0))
    assert camera.position_m == pytest.approx((0, -30, 1.7))


@pytest.mark.parametrize("level", [0.0, 2.0, 6.0, 11.9])
def test_a_close_view_is_centred_on_that_height(level: float) -> None:
    one = plant(12, 4)
    camera = camera_of(one, PictureSettings(look_at_m=level, distance_m=0.8, window_m=0.4))
    ahead = np.array(camera.position_m) + camera.world_from_camera[:, 2] * 0.8
    assert ahead[2] == pytest.approx(level, abs=0.37)
    assert np.linalg.norm(one.organs[0].mesh.vertices_m - ahead, axis=1).min() < 0.01  # something is there to be seen
    assert camera.size_px[1] / camera.focal_px * 0.8 == pytest.approx(0.4, rel=0.02)


@pytest.mark.parametrize(
    "shot",
    [
        PictureSettings(look_at_m=12.5),
        PictureSettings(look_at_m=-1.0),
        PictureSettings(look_at_m=float("nan")),
        PictureSettings(distance_m=1.5),
    ],
)
def test_views_of_nothing_are_refused(shot: PictureSettings) -> None:
    with raises_error(RecipeError):
        camera_of(plant(12, 4), shot)


@pytest.mark.parametrize("size_m", [0.05, 1.0, 40.0])
def test_ground_is_level_about_the_plant_and_reaches_the_horizon(size_m: float) -> None:
    terrain = ground(size_m)
    x, y, z = terrain.mesh.vertices_m.T
    away = np.hypot(x, y)
    assert np.abs(z[away < 30 * size_m]).max() == 0
    assert away.max() > 1e5
    assert np.all(terrain.far_share[away < size_m] == 0)
    assert np.all(terrain.far_share[(y > 50 * size_m)] == 1)
    corners = terrain.mesh.vertices_m[terrain.mesh.faces].astype(np.float64)
    up = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    assert np.all(up > 0)
    assert np.linalg.norm(terrain.mesh.normals, axis=1) == pytest.approx(np.ones(len(x)), abs=1e-5)
