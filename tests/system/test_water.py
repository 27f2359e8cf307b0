"""Light at water and in it, against closed forms."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from shots import seen

from forestgen.core.errors import RecipeError
from forestgen.core.parts import Part
from forestgen.core.progress import Silent, Timings
from forestgen.core.spectrum import Spectrum
from forestgen.geometry.mesh import Mesh
from forestgen.pipeline import assemble_image
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.recipe.load import load_recipe_data
from forestgen.render.build import load, origin_of, scene_dict
from forestgen.render.capture import capture
from forestgen.render.identity import SceneTracer
from forestgen.render.light import sun_irradiance
from forestgen.render.paths.scattering import WATER_INDEX
from forestgen.render.paths.tracer import Image, PathTracer
from forestgen.render.paths.tracer import Sky as SkyOnDevice
from forestgen.render.paths.water import interface
from forestgen.render.skies.model import MAP_COLUMNS, MAP_ROWS, map_directions
from forestgen.render.surfaces import SpectralBsdfs
from forestgen.render.variant import LLVM, SCALAR, mi, using
from forestgen.scene.colour import RGB
from forestgen.scene.plan import check_plan
from forestgen.scene.spec import FogLayer, GroundPatch, Instances, Material, SceneSpec, Sky, WetGround
from support.error_messages import raises_error
from support.guides import trace_guides
from support.radiometry import upper_sky
from support.scenes import camera_at, plain_ground, scattered_scene
from support.twins import trace_twin

WIDE_M = 4000.0
NIGHT, NOON = Sky(-30.0, 0.0, 3.0), Sky(50.0, 180.0, 2.0)


def by_fresnel(angle_deg: float, index: float = WATER_INDEX) -> float:
    """Reflectance by the laws of sines and tangents."""
    one = np.radians(max(angle_deg, 1e-3))
    other = np.arcsin(np.sin(one) / index)
    across = np.sin(one - other) ** 2 / np.sin(one + other) ** 2
    along = np.tan(one - other) ** 2 / np.tan(one + other) ** 2
    return float(0.5 * (across + along))


def pool(albedo: float, depth_m: float, per_m: float, sky: Sky, zenith_deg: float, alpha: float = 0.004) -> SceneSpec:
    """Level water without shores, seen at an angle."""
    ground = plain_ground(-WIDE_M, WIDE_M, albedo=albedo)
    lowered = ground.mesh.vertices_m - np.array([0.0, 0.0, depth_m], np.float32)
    half = WIDE_M * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
    sheet = Mesh(half, np.array([[0, 1, 2], [0, 2, 3]], np.uint32))
    surface = Exemplar("water", (OrganMesh(Part.WATER, "water", sheet),), 1.0, 0.01, 1.0, 0.0, 0.0)
    absorbs = Spectrum(np.array([300.0, 2500.0]), np.array([per_m, per_m]))
    up = np.array([0.0, -np.sin(np.radians(zenith_deg)), np.cos(np.radians(zenith_deg))])
    x, y, z = 3.0 * up
    return replace(
        scattered_scene(1, exemplars=1, leaves=4),
        exemplars=(surface,),
        materials={("water", "water"): Material((0.07, 0.07, 0.07), roughness=np.sqrt(alpha), absorption=absorbs)},
        instances=Instances(np.zeros(1, np.uint32), np.eye(3, 4)[None], np.zeros(1, np.uint32), 1),
        terrain=replace(ground, mesh=replace(ground.mesh, vertices_m=lowered)),
        sky=sky,
        cameras=(camera_at((x, y, z), (0.0, 0.001, 0.0), (8, 8), 0.5),),
    )


def image(spec: SceneSpec, radiance: np.ndarray | float, samples: int = 1024, *, sampled: bool = False) -> Image:
    whole = np.zeros((MAP_ROWS, MAP_COLUMNS, 3), np.float32) + np.asarray(radiance, np.float32)
    paths = PathTracer(SceneTracer(spec, Timings()), spec.cameras[0], 4096, lambda _: whole)
    paths.show(RGB)
    if sampled:
        with using(LLVM):
            paths._sky = SkyOnDevice(whole, sampled=True)
    return paths.take(samples, 7)


def test_reflectance_is_fresnels_on_both_sides() -> None:
    angles = np.array([0.0, 20.0, 53.12, 70.0, 85.0])
    with using(LLVM):
        outside = np.array(interface(mi.Float(np.cos(np.radians(angles))), mi.Float(WATER_INDEX)))
        inside = np.array(interface(mi.Float(np.cos(np.radians([10.0, 45.0, 49.0]))), mi.Float(1.0 / WATER_INDEX)))
    np.testing.assert_allclose(outside, [by_fresnel(one) for one in angles], rtol=2e-4)
    np.testing.assert_allclose(inside[:2], [by_fresnel(one, 1.0 / WATER_INDEX) for one in (10.0, 45.0)], rtol=2e-4)
    assert inside[2] == 1.0


def test_black_water_mirrors_an_even_sky_as_much_as_measured() -> None:
    """By angle; and in all 0.061 +- 0.005 of the light of an overcast sky (Payne 1972)."""
    node, weight = np.polynomial.legendre.leggauss(5)
    square = 0.5 + 0.5 * node  # of the cosine
    albedo = 0.0
    for one, share in zip(square, weight / 2.0, strict=True):
        angle = float(np.degrees(np.arccos(np.sqrt(one))))
        found = float(image(pool(0.0, 1.0, 0.0, NIGHT, angle), 1.0).by_sky.mean())
        assert found == pytest.approx(by_fresnel(angle), rel=0.04)
        albedo += share * found
    assert albedo == pytest.approx(0.061, abs=0.006)


@pytest.mark.parametrize(("angle", "per_m"), [(5.0, 0.0), (40.0, 0.0), (80.0, 0.0), (40.0, 0.1)])
def test_still_water_has_the_guides_of_what_it_mirrors_by_fresnels_share(angle: float, per_m: float) -> None:
    """A white sky, and in front of it a wall; the rest is the water's own; in fog all is that of the way to it, too."""
    spec = pool(0.2, 1.0, 1.0, NIGHT, angle)
    spec = replace(spec, fog=(FogLayer(per_m, 500.0, 2.0, 0.85),) if per_m else ())
    corners = np.array([[-9, 5, -9], [9, 5, -9], [9, 5, 90], [-9, 5, 90]], np.float32)
    wall = Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], np.uint32))
    behind = Exemplar("wall", (OrganMesh(Part.TRUNK, "wall", wall),), 1.0, 0.01, 1.0, 0.0, 0.0)
    walled = replace(
        spec,
        exemplars=(*spec.exemplars, behind),
        materials={**spec.materials, ("wall", "wall"): Material((0.3, 0.1, 0.05))},
        instances=Instances(np.arange(2, dtype=np.uint32), np.stack([np.eye(3, 4)] * 2), np.zeros(2, np.uint32), 2),
    )
    open_sky, wooden = (trace_guides(SceneTracer(one, Timings()), one.cameras[0]) for one in (spec, walled))
    share, level = by_fresnel(angle), np.array([0.0, 0.0, 1.0])
    own = 0.07 * (1.0 - share)
    here, beyond = np.exp(-3.0 * per_m), np.exp(-per_m * 5.0 / np.sin(np.radians(angle)))
    np.testing.assert_allclose(open_sky.colour, 1.0 + here * (share + own - 1.0), rtol=0.03)
    np.testing.assert_allclose(open_sky.normal, np.broadcast_to(here * (1.0 - share) * level, (8, 8, 3)), rtol=0.03)
    normal = here * (share * beyond * np.array([0.0, -1.0, 0.0]) + (1.0 - share) * level)
    np.testing.assert_allclose(wooden.normal, np.broadcast_to(normal, (8, 8, 3)), rtol=0.03, atol=1e-5)
    red, green, blue = wooden.colour.mean(axis=(0, 1))  # the wall's, what is added has the same of all
    assert (red - green) / (green - blue) == pytest.approx(4.0, rel=1e-3)


def test_the_mirrored_sky_is_that_at_the_mirrored_height() -> None:
    sky = np.maximum(map_directions()[..., 2:], 0.0) ** 2 + 0.1
    found = float(image(pool(0.0, 1.0, 0.0, NIGHT, 65.0), sky).by_sky.mean())
    assert found == pytest.approx(by_fresnel(65.0) * (np.cos(np.radians(65.0)) ** 2 + 0.1), rel=0.03)


@pytest.mark.parametrize(
    ("alpha", "sampled", "fog"), [(0.004, False, False), (0.1, False, False), (0.1, True, False), (0.1, False, True)]
)
def test_clear_water_over_a_white_bed_is_white(alpha: float, sampled: bool, fog: bool) -> None:
    layers = (FogLayer(0.05, 5.0, 2.0, 0.85),) if fog else ()
    found = image(replace(pool(1.0, 1.0, 0.0, NIGHT, 55.0, alpha), fog=layers), 1.0, sampled=sampled)
    assert (found.by_sky + found.beyond).mean() == pytest.approx(1.0, abs=0.012)


DATA: dict[str, Any] = {
    "forestgen": 1,
    "seed": 4,
    "site": {
        "size_m": [24, 24],
        "ground": {"layers": [{"what": "stones", "cover": 0.5, "size_m": 0.15}]},
        "water": [{"what": "pond", "position_m": [12, 14], "radius_m": 5}],
        "paths": [{"points_m": [[2, -5], [2, 30]]}],
    },
    "species": {"beech": "beech"},
    "community": {
        "model": "placed",
        "plants": [
            {"species": "beech", "position_m": place, "height_m": 4} for place in ([12, 13], [2.2, 9], [12, 22])
        ],
    },
    "plants": {"geometry": "silhouettes"},
    "cameras": [
        {"name": "eye", "size_px": [48, 32], "position_m": [12, 5, 1.8], "look_at_m": [12, 14, -0.6], "hfov_deg": 70}
    ],
}


def test_water_is_seen_and_labelled_and_nothing_stands_or_lies_in_it() -> None:
    scene = assemble_image(check_plan(load_recipe_data(DATA, "test")), Silent(), Timings())
    assert scene.population.position_m[:, :2].tolist() == [[12.0, 22.0]]
    assert any("2 of 3 plants" in note for note in scene.notes)
    ground = scene.plan.views.height
    found, surface = seen(scene.spec, 1)
    water = found.part[..., 0] == Part.WATER
    assert 0.1 < water.mean() < 0.9
    assert np.all(found.plant_id[..., 0][water] == 0)
    at = surface.position_m[surface.part == Part.WATER].astype(np.float64)
    np.testing.assert_allclose(at[:, 2], ground.level(*at[:, :2].T), atol=2e-3)
    assert np.all(ground(*at[:, :2].T) < at[:, 2] + 2e-3)
    np.testing.assert_allclose(surface.normal[surface.part == Part.WATER], [[0.0, 0.0, 1.0]] * len(at), atol=1e-3)
    stones = surface.position_m[surface.part == Part.ROCK].astype(np.float64)
    assert len(stones) > 20
    assert np.mean(ground.barred(*stones[:, :2].T)) < 0.1  # those at a tile's edge
    alone = replace(scene.spec, instances=scene.spec.instances.at(np.array([len(scene.spec.instances) - 1])))
    ours, twin = seen(alone, 4)[0], trace_twin(alone, alone.cameras[0], 4)
    assert np.mean(ours.part == Part.WATER) > 0.1
    assert np.mean(ours.part == twin.part) > 0.999  # but for ties at the shore


def test_cameras_and_clouds_that_water_does_not_suit() -> None:
    below = {**DATA["cameras"][0], "position_m": [12, 14, 0.3]}
    with raises_error(RecipeError, place="cameras.0.position_m"):
        check_plan(load_recipe_data({**DATA, "cameras": [below]}, "test"))
    exact = {"sky": {"clouds": "noise"}, "render": {"clouds": "exact"}}
    with raises_error(RecipeError, place="site.water"):
        check_plan(load_recipe_data({**DATA, **exact}, "test"))


@pytest.mark.parametrize(("albedo", "per_m"), [(0.6, 0.0), (0.3, 0.7)])
def test_the_bed_in_the_sun(albedo: float, per_m: float) -> None:
    """Light that enters, is absorbed on a slant way down, scattered evenly, in part turned back at the surface."""
    depth_m = 0.8
    found = image(pool(albedo, depth_m, per_m, NOON, 0.0), 0.0).by_sun.mean(axis=(0, 1))
    inside = np.sqrt(1.0 - (np.cos(np.radians(50.0)) / WATER_INDEX) ** 2)
    down = np.sin(np.radians(50.0)) * (1.0 - by_fresnel(40.0)) * np.exp(-per_m * depth_m / inside)
    cosine = (np.arange(20000) + 0.5) / 20000
    out = WATER_INDEX * np.sqrt(1.0 - cosine**2) < 1.0
    back = np.ones_like(cosine)
    back[out] = [by_fresnel(float(one), 1.0 / WATER_INDEX) for one in np.degrees(np.arccos(cosine[out]))]
    returned = float(np.mean(2.0 * cosine * back * np.exp(-2.0 * per_m * depth_m / cosine)))
    bed = down / (1.0 - albedo * returned) * albedo / np.pi
    expected = bed * np.exp(-per_m * depth_m) * (1.0 - by_fresnel(0.0)) / WATER_INDEX**2
    np.testing.assert_allclose(found, expected * sun_irradiance(NOON, RGB), rtol=0.02)


def test_a_patch_of_another_ground_mixes_in_both_renderers_and_in_labels() -> None:
    """Of 0.2 and 0.6, by a share that grows from 0 to 1 over the view; a film of water dims both."""
    spec = pool(0.2, 0.0, 0.0, NIGHT, 0.0)
    ground = spec.terrain
    share = (ground.mesh.vertices_m[:, 0] > 0).astype(np.float32)
    wide = Spectrum(np.array([300.0, 2500.0]), np.array([0.6, 0.6]))
    patch = GroundPatch(share, np.full((4, 4, 3), 0.6, np.float32), (0.6, 0.6, 0.6), wide)
    none = Instances(np.zeros(0, np.uint32), np.zeros((0, 3, 4)), np.zeros(0, np.uint32))
    x = 0.5 * WIDE_M
    camera = camera_at((x, 0.0, 3.0), (x, 0.001, 0.0), (8, 8), 0.5)
    dry = replace(spec, terrain=replace(ground, patches=(patch,)), instances=none, cameras=(camera,))
    film = WetGround(np.ones_like(share), (0.1, 0.1, 0.1), None)
    for one, expected in ((dry, 0.5), (replace(dry, terrain=replace(dry.terrain, wet=film)), 0.25)):
        assert image(one, 1.0, 64).by_sky.mean() == pytest.approx(expected, rel=0.01)
        np.testing.assert_allclose(seen(one, 1)[1].albedo, expected, rtol=0.01)
        with using(SCALAR) as scalar:
            scene = load({**scene_dict(one, origin_of(camera), SpectralBsdfs()), "light": upper_sky()})
            light = capture(scalar.load_dict({"type": "path", "max_depth": 2}), scene, camera, samples=64, seed=1)
        assert light[..., :3].mean() == pytest.approx(expected, rel=0.01)
