"""Images of every kind of camera against what their rays, one by one, must see."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from forestgen.core.frames import look_at
from forestgen.render.capture import LEAST_SAMPLES, FilmWindow, capture, ray_places, square_view, tiles_of
from forestgen.render.light import envmap
from forestgen.render.skies.model import map_directions
from forestgen.render.variant import BLOCK_PX, SCALAR, interruptible, mitsuba, using
from forestgen.scene.projection import project, rays
from forestgen.scene.spec import Camera, Lens
from support.tiers import few

HERE = (0.0, 0.0, 0.0)
LEVEL = look_at(HERE, (0.0, 1.0, 0.0))
UP = look_at(HERE, (0.0, 0.0, 1.0))
DOWN = look_at(HERE, (0.0, 0.0, -1.0))
TILTED = look_at(HERE, (0.4, 1.0, 0.7))
FISHEYE = Camera("fisheye", HERE, UP, (96, 96), 180.0, projection="fisheye")
WIDE = Camera("wide", HERE, TILTED, (96, 80), 230.0, projection="fisheye")
PANORAMA = Camera("panorama", HERE, LEVEL, (128, 64), 0.0, projection="panorama")
PINHOLE = Camera("pinhole", HERE, TILTED, (96, 64), 70.0)
MAP = Camera("map", HERE, DOWN, (96, 64), 0.0, projection="orthographic", width_m=24.0)
ALL = {camera.name: camera for camera in (FISHEYE, WIDE, PANORAMA, PINHOLE, MAP)}
ASSEMBLED = [FISHEYE, WIDE, PANORAMA]
SOME_SLOW = [
    pytest.param(one, id=name, marks=[pytest.mark.slow] if name in ("panorama", "wide") else [])
    for name, one in ALL.items()
]


@pytest.fixture(autouse=True)
def _scalar() -> Iterator[None]:
    with using(SCALAR):
        yield


def scene_of(**parts: Any) -> Any:
    return mitsuba().load_dict({"type": "scene", **parts})


def seen(scene: Any, camera: Camera, samples: int = 16, seed: int = 1, window: FilmWindow | None = None) -> np.ndarray:
    path = mitsuba().load_dict({"type": "path", "max_depth": 2, "block_size": BLOCK_PX})
    return capture(path, scene, camera, samples=samples, seed=seed, window=window)


def white(radiance: float = 1.0) -> dict[str, Any]:
    return {"type": "constant", "radiance": {"type": "rgb", "value": [radiance, 2 * radiance, 3 * radiance]}}


def lamp(at: tuple[float, float, float], radius: float) -> dict[str, Any]:
    return {
        "type": "sphere",
        "center": list(at),
        "radius": radius,
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 1.0}},
    }


def tilted_sky(toward: np.ndarray) -> dict[str, Any]:
    """Radiance 1 + 0.8 d.toward, as a map fine enough to be that."""
    value = 1 + 0.8 * map_directions(513, 1024) @ toward
    return envmap(np.repeat(value[..., None], 3, axis=2).astype(np.float32))


def fine_rays(camera: Camera, parts: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """World origins and directions of rays through parts x parts points of each pixel, and which there are."""
    width, height = camera.size_px
    x, y = ((np.arange(count * parts) + 0.5) / parts for count in (width, height))
    ways = rays(camera, x, y[:, None])
    turned = camera.world_from_camera
    return ways.origin_m @ turned.T, ways.direction @ turned.T, ways.valid


def inside_px(camera: Camera) -> np.ndarray:
    """(H, W) how far each pixel's middle lies in the fisheye's circle."""
    width, height = camera.size_px
    if camera.projection == "panorama":
        return np.full((height, width), np.inf)
    return width / 2 - np.hypot(np.arange(width) + 0.5 - width / 2, np.arange(height)[:, None] + 0.5 - height / 2)


def pixels(fine: np.ndarray, parts: int) -> np.ndarray:
    height, width = fine.shape[0] // parts, fine.shape[1] // parts
    return fine.reshape(height, parts, width, parts).mean(axis=(1, 3))


def test_the_place_of_a_ray_in_its_pixel_is_known() -> None:
    """Where rays of the renderer meet a plane; another version of it might draw others."""
    cells, seed = 2 * BLOCK_PX + 5, 12345
    with using(SCALAR) as mi:
        place = mi.ScalarTransform4f().translate([0, 0, 1]).rotate([0, 1, 0], 180).scale([2, 2, 1])
        scene = mi.load_dict({"type": "scene", "plane": {"type": "rectangle", "to_world": place}})
        hits = mi.load_dict({"type": "aov", "aovs": "point:position", "block_size": BLOCK_PX})
        view = square_view(np.eye(3), cells, FilmWindow(0, 0, cells, cells))
        met = (interruptible(hits, scene, view, seed, 1)[..., :2].astype(np.float64) + 1.0) * cells / 2
        assert np.abs(met - ray_places(cells, seed)).max() < 1e-3


@pytest.mark.parametrize("camera", ASSEMBLED, ids=lambda camera: camera.name)
@pytest.mark.parametrize("samples", [1, 16])
@pytest.mark.slow
def test_every_pixel_has_its_light_and_nothing_lies_outside(camera: Camera, samples: int) -> None:
    image = seen(scene_of(sky=white()), camera, samples)
    assert np.allclose(image / [1, 2, 3, 1], image[..., 3:], atol=1e-5)
    share, depth_px = image[..., 3], inside_px(camera)
    assert np.allclose(share[depth_px > 0.71], 1, atol=1e-5)
    assert not share[depth_px < -0.71].any()
    assert share.sum() == pytest.approx(pixels(fine_rays(camera, 8)[2], 8).sum(), rel=1e-3)


@pytest.mark.parametrize("camera", few(ASSEMBLED), ids=lambda camera: camera.name)
def test_a_smooth_sky_is_seen_as_it_is_across_all_seams(camera: Camera) -> None:
    toward = np.array([0.48, -0.6, 0.64])
    image = seen(scene_of(sky=tilted_sky(toward)), camera, 64)[..., 0]
    _, directions, _ = fine_rays(camera, 4)
    truth = pixels(1 + 0.8 * directions @ toward, 4)
    whole = inside_px(camera) > 1
    if camera.projection == "panorama":  # weighted by solid angle, a row at a pole lies elsewhere than by area
        whole[[0, -1]] = False
    error = (image - truth)[whole]
    assert np.abs(error).max() < 0.02
    for part in np.array_split(error, 12):  # bands of the image: no region is off
        assert abs(part.mean()) < 3e-4


@pytest.mark.parametrize("camera", SOME_SLOW)
def test_edges_are_where_rays_find_them(camera: Camera) -> None:
    """Lamps over the whole sphere, among them on edges and corners of the cube that the assembled cameras use."""
    rng = np.random.default_rng(3)
    toward = rng.normal(size=(40, 3))
    toward[:8] = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T @ camera.world_from_camera.T
    toward[8:12] = np.array([[1, 0, 1], [0, 1, 1], [-1, 1, 0], [0, -1, 1]]) @ camera.world_from_camera.T
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    size = 0.06 + 0.1 * rng.random(40)
    middles, radii = toward * 5.0, size * 5.0
    if camera.projection == "orthographic":
        middles = np.column_stack([rng.uniform(-11, 11, 40), rng.uniform(-7, 7, 40), np.full(40, -30.0)])
    scene = scene_of(**{f"lamp-{k}": lamp(tuple(middles[k]), radii[k]) for k in range(40)})
    image = seen(scene, camera, 64)[..., 0]
    parts = 8
    origin, way, valid = fine_rays(camera, parts)
    hit = np.zeros(valid.shape, dtype=bool)
    for middle, radius in zip(middles, radii, strict=True):
        if camera.projection == "orthographic":
            hit |= np.hypot(origin[..., 0] - middle[0], origin[..., 1] - middle[1]) < radius
        else:
            along = way @ middle
            hit |= (along > 0) & (middle @ middle - along**2 < radius**2)
    truth = pixels((hit & valid).astype(float), parts)
    error, edge = image - truth, (truth > 0.02) & (truth < 0.98)
    rows = slice(2, -2) if camera.projection == "panorama" else slice(None)
    error, edge, truth = error[rows], edge[rows], truth[rows]
    assert edge.sum() > 100
    assert np.abs(error[~edge]).max() < 0.05  # full and empty pixels
    # A blur would darken what is mostly lit and brighten what is mostly dark.
    for part in (edge & (truth > 0.5), edge & (truth < 0.5)):
        assert abs(error[part].mean()) < 4 * error[part].std() / np.sqrt(part.sum()) + 1e-3
        assert error[part].std() < 0.06


def test_a_fisheye_gives_the_irradiance_of_its_hemisphere() -> None:
    toward = np.array([0.0, 0.6, 0.8])
    image = seen(scene_of(sky=tilted_sky(toward)), FISHEYE, 16)[..., 0]
    x, y = (np.arange(count) + 0.5 for count in FISHEYE.size_px)
    focal_px = 96 / np.radians(FISHEYE.hfov_deg)
    theta = np.hypot(x - 48, y[:, None] - 48) / focal_px
    solid_angle = np.sinc(theta / np.pi) / focal_px**2
    irradiance = float((image * np.cos(theta) * solid_angle).sum())
    assert irradiance == pytest.approx(np.pi + 0.8 * 0.8 * 2 * np.pi / 3, rel=1e-3)


@pytest.mark.parametrize("camera", SOME_SLOW)
def test_a_lamp_appears_where_it_is_projected(camera: Camera) -> None:
    for point in ([3.0, 5.0, -6.0], [-4.0, 5.5, -6.0], [2.0, 6.0, 5.0], [-3.0, 4.0, 6.0]):
        there = project(camera, np.array(point) @ camera.world_from_camera)
        width, height = camera.size_px
        if not (there.in_front and 2 < there.x_px < width - 2 and 2 < there.y_px < height - 2):
            continue
        image = seen(scene_of(lamp=lamp(tuple(point), 0.4)), camera, 32)[..., 0]
        middle = [
            (image.sum(axis=axis) * (np.arange(n) + 0.5)).sum() / image.sum() for axis, n in ((0, width), (1, height))
        ]
        assert middle == pytest.approx([float(there.x_px), float(there.y_px)], abs=0.35)


def test_upward_east_is_left_and_downward_east_is_right() -> None:
    for camera, where in ((FISHEYE, np.s_[:, :48]), (replace(FISHEYE, world_from_camera=DOWN), np.s_[:, 48:])):
        z = 2.0 if camera is FISHEYE else -2.0
        image = seen(scene_of(lamp=lamp((3.0, 0.0, z), 0.3)), camera)[..., 0]
        assert image[where].sum() > 0.999 * image.sum() > 0
        image = seen(scene_of(lamp=lamp((0.0, 3.0, z), 0.3)), camera)[..., 0]
        assert image[:48].sum() > 0.999 * image.sum() > 0


@pytest.mark.parametrize(("focus_m", "lamp_m"), few([(4.0, 10.0), (10.0, 4.0), (6.0, 6.0)]))
def test_a_thin_lens_blurs_into_its_circle_of_confusion(focus_m: float, lamp_m: float) -> None:
    camera = Camera("lens", HERE, LEVEL, (64, 64), 20.0, lens=Lens(0.1, focus_m))
    image = seen(scene_of(lamp=lamp((0.0, lamp_m, 0.0), 0.02)), camera, 1024)[..., 0]
    x, y = (np.arange(64) + 0.5 - 32 for _ in range(2))
    spread = np.sqrt((image * (x**2 + y[:, None] ** 2)).sum() / image.sum())
    radius = camera.focal_px * 0.1 * abs(1 / focus_m - 1 / lamp_m)
    own = camera.focal_px * 0.02 / lamp_m  # the lamp's own disc; and a pixel's width
    if focus_m == lamp_m:
        assert spread < 0.8, "sharp: four pixels around the image's middle"
    else:
        assert spread == pytest.approx(np.sqrt(radius**2 / 2 + own**2 / 2 + 1 / 6), rel=0.05)


@pytest.mark.slow  # test_repeatable has it for other cameras
def test_the_same_bytes_with_any_number_of_threads() -> None:
    scene = scene_of(sky=white(), lamp=lamp((1.0, 2.0, 3.0), 0.5))
    images = []
    for threads in (1, 3):
        mitsuba(threads)
        images.append(seen(scene, WIDE, 8, seed=5))
    assert np.array_equal(*images)
    assert not np.array_equal(images[0], seen(scene, WIDE, 8, seed=6))


@pytest.mark.parametrize("camera", [pytest.param(PANORAMA, marks=pytest.mark.slow), WIDE], ids=["panorama", "wide"])
def test_a_window_is_that_part_of_the_image_for_a_part_of_the_rays(camera: Camera) -> None:
    scene = scene_of(sky=tilted_sky(np.array([0.0, 0.6, 0.8])), lamp=lamp((1.0, 2.0, 1.0), 0.5))
    window = FilmWindow(20, 14, 40, 24)
    image, part = seen(scene, camera, 64), seen(scene, camera, 64, window=window)
    assert part.shape == (24, 40, 4)
    difference = part - image[14:38, 20:60]
    assert abs(difference.mean()) < 2e-3
    assert np.percentile(np.abs(difference), 90) < 0.05
    count = [
        sum(tile.cells**2 for tile in tiles_of(camera, 64, w)) for w in (window, FilmWindow(0, 0, *camera.size_px))
    ]
    assert count[0] < 0.5 * count[1]


@pytest.mark.parametrize("camera", ASSEMBLED, ids=lambda camera: camera.name)
def test_few_samples_are_wasted(camera: Camera) -> None:
    """Cells rendered for each that an image asks for."""
    camera = replace(camera, size_px=tuple(4 * side for side in camera.size_px))
    asked = LEAST_SAMPLES * fine_rays(camera, 1)[2].sum()
    made = sum(tile.cells**2 for tile in tiles_of(camera, LEAST_SAMPLES, FilmWindow(0, 0, *camera.size_px)))
    assert asked < made < 1.15 * asked
