"""The surface at pixel centres is exact: every field against brute force in double precision, textures against Mitsuba.

One scene holds what is hard: plants that overlap, a plant inside another's crown, plants partly behind the camera and
at the image's edge, far ones, leaning and sheared ones, meshes with vertex normals and without.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shots import seen
from ties import hits_around

from forestgen.core.parts import Part
from forestgen.core.spectrum import Spectrum
from forestgen.geometry.mesh import Mesh
from forestgen.plants.bark.texture import SurfaceTexture
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.render.build import load, origin_of, to_mesh
from forestgen.render.identity import camera_rays
from forestgen.render.identity.interpolation import bilinear_places, weighted_sum
from forestgen.render.surfaces import _bitmap, ground_bsdf
from forestgen.render.variant import LLVM, drjit, mitsuba
from forestgen.scene.spec import Camera, Instances, Material, SceneSpec, Sky, WetGround
from support.scenes import blade_cloud, camera_at, plain_ground, scattered_scene
from support.twins import Oracle

SIZE_PX = (48, 27)
VIEWS = {
    "from the south": camera_at((7.0, -5.0, 2.5), (7.0, 8.0, 3.0), SIZE_PX, 75.0),
    "inside a crown": camera_at((2.9, 5.2, 5.3), (9.0, 9.0, 3.5), SIZE_PX, 80.0),
    "from above": camera_at((8.0, 7.0, 40.0), (7.0, 8.0, 0.0), SIZE_PX, 40.0),
}


def stem(height_m: float, radius_m: float, sides: int = 12) -> Mesh:
    """A cylinder with round normals and uv."""
    angle = np.arange(sides + 1) * 2 * np.pi / sides
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(sides + 1)], axis=1)
    vertices = np.concatenate([ring * radius_m, ring * radius_m + [0, 0, height_m]])
    uv = np.concatenate([np.stack([angle * 0.7, np.full(sides + 1, v)], axis=1) for v in (-0.4, 3.1)])
    k = np.arange(sides)
    low, high = np.stack([k, k + 1, k + sides + 2], axis=1), np.stack([k, k + sides + 2, k + sides + 1], axis=1)
    faces = np.concatenate([low, high]).astype(np.uint32)
    return Mesh(vertices.astype(np.float32), faces, np.tile(ring, (2, 1)).astype(np.float32), uv.astype(np.float32))


def plant(species: str, height_m: float, leaves: int, rng: np.random.Generator) -> Exemplar:
    crown = blade_cloud(leaves, height_m, 0.5 * height_m, 0.12 * height_m, rng)
    return Exemplar(
        species=species,
        organs=(
            OrganMesh(Part.TRUNK, "bark", stem(0.9 * height_m, 0.05 * height_m)),
            OrganMesh(Part.LEAF, "leaf", crown),
        ),
        radius_m=height_m,
        height_m=height_m,
        crown_width_m=0.5 * height_m,
        leaf_area_m2=1.0,
        wood_volume_m3=1.0,
    )


def mixed_scene(camera: Camera, texture: SurfaceTexture | None = None) -> SceneSpec:
    rng = np.random.default_rng(11)
    places = rng.uniform(0, 14, (26, 2)).tolist()
    places += [[8.6, -4.4], [6.2, -5.6], [1.0, -1.0], [13.0, -1.0]]  # about the camera, and at the edges
    places += np.add(rng.uniform(-60, 60, (8, 2)), [7, 150]).tolist()  # far
    places += [[4.1, 6.1], [4.0, 6.0]]  # the camera's own tree and a plant in its crown
    count = len(places)
    angle, scale = rng.random(count) * 2 * np.pi, rng.uniform(0.6, 1.3, count)
    transform = np.zeros((count, 3, 4))
    transform[:, 0, 0], transform[:, 0, 1] = np.cos(angle), -np.sin(angle)
    transform[:, 1, 0], transform[:, 1, 1] = np.sin(angle), np.cos(angle)
    transform[:, 2, 2] = 1.0
    transform[:, :, :3] = np.eye(3) @ transform[:, :, :3] * scale[:, None, None]
    transform[::3, :2, 2] = rng.uniform(-0.25, 0.25, (len(places[::3]), 2))  # leaning by a shear
    transform[1::5, 0] *= 1.4  # broader than deep
    transform[:, :2, 3] = places
    transform[-1, :, :3] *= 0.3
    transform[-1, 2, 3] = 5.0
    exemplar = rng.integers(0, 2, count)
    exemplar[-2:] = [1, 0]
    ground = plain_ground(-200, 240, 6, bumps_m=0.5)
    bark = Material((0.2, 0.15, 0.1), texture=texture)
    leaf = Material((0.05, 0.10, 0.03), (0.04, 0.09, 0.02))
    return replace(
        scattered_scene(1, exemplars=1, leaves=4, terrain=ground),
        exemplars=(plant("low", 3.0, 30, rng), plant("tall", 8.0, 40, rng)),
        materials={(kind, name): value for kind in ("low", "tall") for name, value in (("bark", bark), ("leaf", leaf))},
        instances=Instances(exemplar.astype(np.uint32), transform, (np.arange(count) * 7 + 3).astype(np.uint32)),
        sky=Sky(35.0, 200.0, 3.0),
        cameras=(camera,),
    )


@pytest.mark.parametrize("view", VIEWS)
def test_every_field_equals_brute_force_in_double_precision(view):
    spec = mixed_scene(VIEWS[view])
    camera, oracle = spec.cameras[0], Oracle(spec, spec.cameras[0])
    _, ours = seen(spec, 1)
    column, row = np.meshgrid(np.arange(SIZE_PX[0]) + 0.5, np.arange(SIZE_PX[1]) + 0.5)
    hits = oracle.trace(column, row)
    names = ("plant_id", "part", "exemplar", "face")
    same = np.all([getattr(ours, name).ravel() == getattr(hits, name) for name in names], axis=0)
    assert (~same).sum() <= 2
    for k in np.flatnonzero(~same):
        found = hits_around(oracle, column.ravel()[k], row.ravel()[k])
        assert (ours.plant_id.ravel()[k], ours.part.ravel()[k]) in found
    assert len(np.unique(ours.plant_id)) > 6
    assert {Part.GROUND, Part.TRUNK, Part.LEAF} <= set(np.unique(ours.part).tolist())

    sky = ~np.isfinite(hits.distance_m)
    flat_image = {name: np.reshape(value, (-1, *value.shape[2:])) for name, value in vars(ours).items()}
    on = same & ~sky
    _, direction, _ = oracle.rays(column.ravel(), row.ravel())
    np.testing.assert_allclose(flat_image["distance_m"][on], hits.distance_m[on], rtol=2e-5)
    depth = hits.distance_m[on] * (direction[on] @ camera.world_from_camera[:, 2])
    np.testing.assert_allclose(flat_image["depth_m"][on], depth, rtol=2e-5)
    point = direction[on] * hits.distance_m[on, None] + camera.position_m
    np.testing.assert_array_less(
        np.linalg.norm(flat_image["position_m"][on] - point, axis=1), 3e-5 * hits.distance_m[on] + 1e-5
    )
    np.testing.assert_allclose(flat_image["normal"][on], hits.normal[on], atol=3e-5)
    np.testing.assert_allclose(flat_image["shading_normal"][on], hits.shading_normal[on], atol=1e-3)
    trunk = on & (hits.part == Part.TRUNK)
    assert (np.linalg.norm(hits.shading_normal - hits.normal, axis=1)[trunk] > 0.02).mean() > 0.5, "too easy"

    empty = same & sky
    assert np.isinf(flat_image["depth_m"][empty]).all()
    assert np.isinf(flat_image["distance_m"][empty]).all()
    assert np.isnan(flat_image["position_m"][empty]).all()
    for name in ("normal", "shading_normal", "albedo", "sun_visible", "face", "exemplar"):
        assert not flat_image[name][empty].any()

    expected = oracle.sun_visible(column, row, hits)
    wrong = np.flatnonzero(same & (flat_image["sun_visible"] != expected))
    assert len(wrong) <= 3
    assert 0.1 < expected[on].mean() < 0.9
    angle = np.arange(12) / 12 * 2 * np.pi
    for k in wrong:  # a shadow's edge within a hundredth of a pixel, or something within two millimetres
        x, y = column.ravel()[k] + 0.01 * np.cos(angle), row.ravel()[k] + 0.01 * np.sin(angle)
        nearby = oracle.trace(x, y)
        outcomes = {bool(v) for start_m in (0.0, 2e-3) for v in oracle.sun_visible(x, y, nearby, start_m)}
        assert outcomes == {True, False}


def test_a_surface_does_not_shade_itself_at_any_place_and_scale():
    """Bare ground, flat and up to 40 km away, is in the sun wherever it is seen, however low the sun stands."""
    spec = scattered_scene(1, exemplars=1, leaves=4, terrain=plain_ground(-40_000, 40_000, 128))
    nobody = Instances(np.zeros(0, np.uint32), np.zeros((0, 3, 4)), np.zeros(0, np.uint32))
    for height_m in (0.5, 30.0, 900.0):
        camera = camera_at((50.0, -8.0, height_m), (50.0, 50.0, height_m * 0.9), (96, 54))
        low = replace(spec, instances=nobody, cameras=(camera,), sky=Sky(2.0, 77.0, 3.0))
        _, surface = seen(low, 1)
        ground = surface.part == Part.GROUND
        assert ground.sum() > 1000
        assert surface.sun_visible[ground].all()
        assert not surface.sun_visible[~ground].any()


def test_a_leaf_is_in_the_sun_on_both_sides_and_a_trunk_on_one():
    """A camera below a horizontal blade sees its dark side: nothing lies between it and the sun but itself."""
    camera = camera_at((0.0, -6.0, 0.5), (0.0, 0.0, 2.0), (32, 32), 50.0)
    corners = np.array([[-2, -2, 3], [2, -2, 3], [2, 2, 3], [-2, 2, 3]], dtype=np.float32)
    blade = OrganMesh(Part.LEAF, "leaf", Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)))
    trunk = OrganMesh(Part.TRUNK, "bark", stem(2.0, 0.3, 48))
    spec = mixed_scene(camera)
    low = replace(spec.exemplars[0], organs=(blade, trunk))
    one = Instances(np.zeros(1, np.uint32), np.eye(4)[None, :3], np.ones(1, np.uint32))
    spec = replace(spec, exemplars=(low,), instances=one, sky=Sky(10.0, 90.0, 3.0))  # from the east, below the blade
    _, surface = seen(spec, 1)
    assert surface.sun_visible[surface.part == Part.LEAF].all()
    side = surface.normal @ spec.sky.to_sun
    on_trunk = surface.part == Part.TRUNK
    assert on_trunk.sum() > 20
    np.testing.assert_array_equal(surface.sun_visible[on_trunk], side[on_trunk] > 0)


def test_texels_are_where_mitsuba_has_them():
    rng = np.random.default_rng(3)
    image = rng.random((5, 7, 3)).astype(np.float32)
    u, v = rng.uniform(-3, 3, (2, 4000)).astype(np.float32)
    u[:3], v[:3] = [0.0, 1.0, -1e-9], [0.0, 0.5, 1.0]
    mi, dr = mitsuba(), drjit()
    with mi.variant_context(LLVM):
        wanted = dict(_bitmap(image), format="variant")
        interaction = dr.zeros(mi.SurfaceInteraction3f, len(u))
        interaction.uv = mi.Point2f(u, v)
        theirs = np.array(mi.load_dict(wanted).eval(interaction)).T
        before = np.zeros((4, 3), dtype=np.float32)  # another texture's texels
        texel = mi.Float(np.concatenate([before, image.reshape(-1, 3)]).ravel())
        places = bilinear_places(mi.UInt32(4), mi.UInt32(7), mi.UInt32(5), mi.Float(u), mi.Float(v))
        ours = np.array(weighted_sum(mi.Color3f, texel, places, mi.Bool(True))).T
    assert ours.std() > 0.1
    np.testing.assert_allclose(ours, theirs, atol=2e-5)


@pytest.mark.parametrize("is_wet", [False, True])
def test_the_grounds_albedo_is_what_the_radiance_pass_shades(is_wet):
    ground = plain_ground(-40.0, 40.0, 16, bumps_m=0.5)
    away = np.linalg.norm(ground.mesh.vertices_m[:, :2], axis=1)
    ground = replace(
        ground,
        mesh=replace(ground.mesh, uv=ground.mesh.vertices_m[:, :2] / np.float32(6.0)),
        texture=np.random.default_rng(4).random((12, 20, 3)).astype(np.float32),
        far_share=np.clip((away - 12) / 15, 0, 1).astype(np.float32),
    )
    dry = ground
    if is_wet:
        film, share = (0.2, 0.25, 0.3), (0.5 + 0.5 * np.sin(away)).astype(np.float32)
        ground = replace(dry, wet=WetGround(share, film, Spectrum(np.array([550.0]), np.array([0.25]))))
    camera = camera_at((0.0, -2.0, 6.0), (0.0, 30.0, -6.0), (96, 54))
    spec = replace(scattered_scene(3, exemplars=1, leaves=4, terrain=ground), cameras=(camera,))
    _, surface = seen(spec, 1)
    theirs = shaded_albedo(spec, camera, ground=True)
    on = surface.part == Part.GROUND
    assert on.sum() > 1500
    np.testing.assert_allclose(surface.albedo[on], theirs[on], atol=2e-3)
    assert np.abs(surface.albedo[on] - spec.terrain.far_reflectance).max(axis=1).min() < 1e-4, "reaches the far colour"
    assert surface.albedo[on].std(axis=0).max() > 0.02
    if not is_wet:
        return
    _, before = seen(replace(spec, terrain=dry), 1)
    factor = surface.albedo[on] / before.albedo[on]
    assert np.all((factor > film / np.asarray(dry.mean_colour) - 1e-5) & (factor <= 1 + 1e-6))
    near = np.linalg.norm(surface.position_m[on][:, :2], axis=1) < 12
    # Interpolated along 5 m of a face, a share between its corners.
    assert np.ptp(factor[near][:, 0]) > 0.3


def test_wet_ground_has_the_formulas_albedo_at_every_pixel():
    """A share that rises evenly with x is itself at any point of a face."""
    ground = plain_ground(-40.0, 40.0, 16, albedo=0.4)
    share = (ground.mesh.vertices_m[:, 0] + 40.0) / np.float32(80.0)
    ground = replace(ground, wet=WetGround(share, (0.1, 0.2, 0.3), Spectrum(np.array([550.0]), np.array([0.2]))))
    camera = camera_at((0.0, -2.0, 6.0), (0.0, 30.0, -6.0), (96, 54))
    spec = replace(scattered_scene(1, exemplars=1, leaves=4, terrain=ground), cameras=(camera,))
    _, surface = seen(spec, 1)
    on = surface.part == Part.GROUND
    wet = (surface.position_m[on][:, :1] + 40.0) / 80.0
    np.testing.assert_allclose(surface.albedo[on], (1 - wet) * 0.4 + wet * [0.1, 0.2, 0.3], atol=2e-6)


def test_albedo_of_plants_is_their_textures_and_leaves_both_sides():
    rng = np.random.default_rng(6)
    texture = SurfaceTexture(rng.random((8, 16, 3)).astype(np.float32), np.zeros((8, 16), np.float32), (0.1, 0.1))
    camera = VIEWS["from the south"]
    spec = mixed_scene(camera, texture)
    ids, surface = seen(spec, 1)
    plain_ids, plain = seen(mixed_scene(camera), 1)
    leaf, trunk = surface.part == Part.LEAF, surface.part == Part.TRUNK
    np.testing.assert_allclose(surface.albedo[leaf], np.tile([0.09, 0.19, 0.05], (leaf.sum(), 1)), rtol=1e-5)
    np.testing.assert_allclose(plain.albedo[trunk], np.tile([0.2, 0.15, 0.1], (trunk.sum(), 1)), rtol=1e-5)
    theirs = shaded_albedo(spec, camera, ground=False)
    assert trunk.sum() > 40
    np.testing.assert_allclose(surface.albedo[trunk], theirs[trunk], atol=5e-3)
    for name in vars(surface):
        if name != "albedo":
            np.testing.assert_array_equal(getattr(surface, name), getattr(plain, name))
    np.testing.assert_array_equal(ids.plant_id, plain_ids.plant_id)


def shaded_albedo(spec: SceneSpec, camera: Camera, *, ground: bool) -> np.ndarray:
    """(H, W, 3) diffuse reflectance that the renderer's own surfaces have at the first hits."""
    mi = mitsuba()
    with mi.variant_context(LLVM):
        origin, shapes = origin_of(camera), {}
        if ground:
            terrain = to_mesh(spec.terrain.mesh, mi.load_dict(ground_bsdf(spec.terrain)), origin, "terrain")
            terrain.add_attribute("vertex_far_share", 1, spec.terrain.far_share)
            if spec.terrain.wet is not None:
                terrain.add_attribute("vertex_wet_share", 1, spec.terrain.wet.share)
            shapes["terrain"] = terrain
        for number, row in enumerate(range(0 if ground else len(spec.instances))):
            exemplar = spec.exemplars[int(spec.instances.exemplar[row])]
            matrix = spec.instances.transform[row]
            for organ in exemplar.organs:
                texture = spec.materials[exemplar.species, organ.material].texture
                colour = np.ones((1, 1, 3), np.float32) if texture is None else texture.colour
                bsdf = mi.load_dict({"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": _bitmap(colour)}})
                vertices = organ.mesh.vertices_m @ matrix[:, :3].T + matrix[:, 3] - origin
                mesh = replace(organ.mesh, vertices_m=vertices.astype(np.float32), normals=None)
                shapes[f"{number}-{organ.material}"] = to_mesh(mesh, bsdf, None, f"{number}-{organ.material}")
        scene = load(shapes)
        direction = camera_rays(camera, np.array([0.5, 0.5]), 0, camera.size_px[1]).direction
        hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(0.0), direction))
        value = hit.bsdf().eval_diffuse_reflectance(hit, hit.is_valid())
        return np.array(value).T.reshape(*camera.size_px[::-1], 3)
