"""Motion vectors land on the same plant and the same point of it: both frames are traced."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shots import seen

from forestgen.community.population import Population
from forestgen.community.simulation import final_population
from forestgen.core.frames import look_at
from forestgen.core.progress import Silent, Timings
from forestgen.labels.channels.motion import motion_px
from forestgen.recipe.assets import recipes_dir
from forestgen.recipe.cameras import Camera as CameraSection
from forestgen.recipe.load import load_recipe
from forestgen.render.frame import Surface
from forestgen.scene.build import BuiltScene, build_scene
from forestgen.scene.plan import check_plan
from forestgen.scene.spec import Camera, SceneSpec
from forestgen.scene.terrain import HeightField
from forestgen.scene.views import expand
from forestgen.scene.wind import Sway, posed, sway_in
from support.scenes import blade_cloud, plain_ground, scattered_scene
from support.twins import Oracle

SIZE = (96, 54)


@pytest.fixture(scope="module")
def stand() -> SceneSpec:
    """Trees of a few very large leaves, so that brute force can meet every triangle, and all is plants."""
    ground = plain_ground(-60, 100, 4, bumps_m=0.5)
    spec = scattered_scene(14, size_m=16.0, exemplars=3, leaves=10, size_px=SIZE, terrain=ground, seed=5)
    rng = np.random.default_rng(8)
    trees = []
    for tree in spec.exemplars:
        trunk, crown = tree.organs
        crown = replace(crown, mesh=blade_cloud(60, tree.height_m, tree.crown_width_m, 1.5, rng))
        trees.append(replace(tree, organs=(trunk, crown)))
    return replace(spec, exemplars=tuple(trees))


@pytest.fixture(scope="module")
def wind(stand: SceneSpec) -> Sway:
    gale = sway_in(stand.instances, stand.exemplars, speed_m_per_s=9, gustiness=0.8, from_deg=300, seed=2)
    return replace(gale, mean_rad=np.maximum(gale.mean_rad, np.radians(5.0)))  # the simple trees' trunks are stout


def frame(stand: SceneSpec, wind: Sway | None, time_s: float, position: tuple[float, float, float]) -> SceneSpec:
    camera = Camera("walk", position, look_at(position, (8.0 + time_s, 8.0, 4.0)), SIZE, 60.0, "walk", time_s)
    instances = stand.instances if wind is None else posed(stand.instances, wind, time_s)
    return replace(stand, cameras=(camera,), instances=instances)


def motion(now: SceneSpec, surface: Surface, then: SceneSpec) -> np.ndarray:
    return motion_px(now.cameras[0], surface, now.instances, then.cameras[0], then.instances)


def landings(shift: np.ndarray) -> np.ndarray:
    x, y = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    return shift.astype(np.float64) + np.stack([x, y], axis=-1)


def own_frame(spec: SceneSpec, plant_id: np.ndarray, world: np.ndarray) -> np.ndarray:
    """(M, 3) points of plants in their exemplars' frames."""
    row = np.searchsorted(spec.instances.plant_id, plant_id)
    transform = spec.instances.transform[row]
    return np.linalg.solve(transform[:, :, :3], (world - transform[:, :, 3])[..., None])[..., 0]


@pytest.mark.parametrize(("blows", "walks"), [(False, True), (True, False), (True, True)])
def test_each_vector_meets_its_point_or_something_before_it(
    stand: SceneSpec, wind: Sway, blows: bool, walks: bool
) -> None:
    """Brute force, in double precision, through the very point that the vector names, not the pixel that holds it."""
    now = frame(stand, wind if blows else None, 0.4, (8.0, -4.0, 3.0))
    there = (8.6, -3.4, 3.2) if walks else (8.0, -4.0, 3.0)
    then = frame(stand, wind if blows else None, 0.7, there)
    _, surface = seen(now, 1)
    land = landings(motion(now, surface, then))
    inside = np.all((land > 0) & (land < SIZE), axis=-1)
    inside[1::2] = False  # half of the rows: brute force is slow
    solid = np.isfinite(surface.distance_m)
    plant = surface.plant_id > 0
    assert (inside & plant).sum() > 1000
    hits = Oracle(then, then.cameras[0]).trace(land[inside][:, 0], land[inside][:, 1])
    world = surface_points(now.cameras[0], surface)[inside]
    expected = world.copy()  # where the point is in the next frame
    moving = plant[inside]
    ids = surface.plant_id[inside][moving]
    mine = own_frame(now, ids, world[moving])
    matrix = then.instances.transform[np.searchsorted(then.instances.plant_id, ids)]
    expected[moving] = np.einsum("nij,nj->ni", matrix[:, :, :3], mine) + matrix[:, :, 3]
    distance = np.where(solid[inside], np.linalg.norm(expected - then.cameras[0].position_m, axis=1), np.inf)
    tolerance = 1e-4 * np.where(np.isfinite(distance), distance, 1.0)
    before = hits.distance_m < distance - tolerance
    with np.errstate(invalid="ignore"):
        same = (hits.distance_m == distance) | (np.abs(hits.distance_m - distance) <= tolerance)
    same &= hits.plant_id == surface.plant_id[inside]
    # A point on a triangle's very edge may be missed by a rounding.
    assert (~(same | before)).mean() < 1e-3
    assert same[moving].mean() > 0.6
    assert same[~moving].mean() > 0.5


def surface_points(camera: Camera, surface: Surface) -> np.ndarray:
    """(H, W, 3) world points by the depth channel and the camera's definition; sky 0."""
    height, width = surface.depth_m.shape
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    depth = np.where(np.isfinite(surface.depth_m), surface.depth_m, 0.0).astype(np.float64)
    own = np.stack([(x - width / 2) / camera.focal_px, (y - height / 2) / camera.focal_px, np.ones_like(x)], axis=-1)
    return (own * depth[..., None]) @ camera.world_from_camera.T + camera.position_m


def test_following_the_vectors_the_next_frame_shows_the_same_plants_and_points(stand: SceneSpec, wind: Sway) -> None:
    """With the channels of both frames alone: a point that is not hidden there lies within its pixel."""
    now, then = frame(stand, wind, 0.4, (8.0, -4.0, 3.0)), frame(stand, wind, 0.5, (8.3, -3.8, 3.0))
    (_, first), (_, second) = seen(now, 1), seen(then, 1)
    land = landings(motion(now, first, then))
    column, row = (np.floor(land[..., k]).astype(int) for k in (0, 1))
    inside = (column >= 0) & (column < SIZE[0]) & (row >= 0) & (row < SIZE[1]) & (first.plant_id > 0)
    column, row = column[inside], row[inside]
    ids = first.plant_id[inside]
    assert (second.plant_id[row, column] == ids).mean() > 0.85
    mine = own_frame(now, ids, surface_points(now.cameras[0], first)[inside])
    other = own_frame(then, ids, surface_points(then.cameras[0], second)[row, column])
    scale = np.linalg.norm(now.instances.transform[np.searchsorted(now.instances.plant_id, ids)][:, :, 2], axis=1)
    pixel_m = second.depth_m[row, column] / then.cameras[0].focal_px
    # On a triangle seen aslant points of one pixel are further apart, by the cosine to the ray.
    cosine = np.abs(np.sum(second.normal[row, column] * toward(then.cameras[0], row, column), axis=1))
    apart_px = np.linalg.norm(mine - other, axis=1) * scale * cosine / pixel_m
    not_hidden = (second.plant_id[row, column] == ids) & (second.face[row, column] == first.face[inside])
    assert not_hidden.mean() > 0.65
    assert apart_px[not_hidden].max() < 0.75  # half a pixel's diagonal, and what the image's corners add
    still = motion(now, first, replace(now, instances=replace(now.instances)))
    assert np.abs(still).max() < 1e-3


def toward(camera: Camera, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    width, height = camera.size_px
    along = np.stack([column + 0.5 - width / 2, row + 0.5 - height / 2, np.full(len(row), camera.focal_px)], axis=-1)
    return (along / np.linalg.norm(along, axis=1, keepdims=True)) @ camera.world_from_camera.T


def test_the_scene_at_a_time_is_one_object_and_the_next_frames_is_kept_beside_it(stand: SceneSpec, wind: Sway) -> None:
    path = {"frames": 5, "position_m": [[8, -3, 2]]}
    section = CameraSection.model_validate(
        {"name": "walk", "position_m": [8, -4, 2], "look_at_m": [8, 8, 4], "path": path}
    )
    cameras = tuple(expand(section, HeightField((16.0, 16.0))))
    nobody = np.zeros(0, dtype=np.uint8)
    empty = Population(0.0, (), nobody, nobody, np.zeros((0, 3)), nobody, nobody, nobody, nobody)
    built = BuiltScene(None, replace(stand, cameras=cameras), empty, [], wind)
    before = None
    for index, camera in enumerate(cameras):
        now, following = built.at(camera.time_s), built.next_view(camera)
        assert np.array_equal(now.instances.transform, posed(stand.instances, wind, index / 24).transform)
        assert before is None or not np.array_equal(now.instances.transform, before.instances.transform)
        before = now
        if index == 4:
            assert following is None
            continue
        assert following is not None
        assert following[0] is cameras[index + 1]
        assert following[1] is built.at(following[0].time_s)
        assert built.at(camera.time_s) is now
    still = BuiltScene(None, built.spec, empty, [])
    assert all(still.at(camera.time_s) is still.spec for camera in cameras)


@pytest.mark.slow
def test_a_recipes_wind_reaches_its_plants() -> None:
    small = ("plants.exemplars_per_species=1", "site.size_m=[12, 12]", "plants.geometry=silhouettes", "sky.clouds=none")

    def built(*settings: str) -> BuiltScene:
        plan = check_plan(load_recipe(recipes_dir() / "walk_in_the_wind.yaml", (*small, *settings)))
        return build_scene(plan, final_population(plan.community, Silent()), Silent(), Timings())

    windy, still = built(), built("wind.speed_m_per_s=0")
    assert len(windy.population) > 0
    assert [one.name for one in windy.spec.cameras] == [f"walk-{k:04d}" for k in range(8)]
    assert still.sway is None
    assert np.array_equal(still.spec.instances.transform, windy.spec.instances.transform)
    top = windy.at(0.25).instances.transform[:, :, 2]
    east, north = np.sin(np.radians(60)), np.cos(np.radians(60))  # from 240 degrees towards 60
    assert np.all(top[:, 0] * east + top[:, 1] * north > 0)
