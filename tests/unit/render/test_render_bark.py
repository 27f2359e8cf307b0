from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.core.frames import look_at
from forestgen.core.parts import Part
from forestgen.core.timing import Timings
from forestgen.geometry.mesh import Mesh
from forestgen.plants.bark.texture import SurfaceTexture, bark_texture
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.recipe.species import Bark
from forestgen.render.build import load, origin_of, plants_dict
from forestgen.render.identity import SceneTracer, trace_identity
from forestgen.render.sensors import capture
from forestgen.render.surfaces import Paints, surface_bsdf
from forestgen.render.variant import SCALAR, using
from forestgen.scene.channels import RGB, Channels
from forestgen.scene.spec import Camera, Instances, Material, SceneSpec
from forestgen.testing.scenes import plain_ground, scattered_scene

REFLECTANCE = (0.33, 0.24, 0.15)
TILE_M = (0.1, 0.1)


def cylinder(sides: int = 64, uv: bool = True) -> Mesh:
    """An open cylinder of radius 0.5 and height 2 about the z axis; u runs anticlockwise seen from above."""
    angle = np.arange(sides + 1) * 2 * np.pi / sides
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(sides + 1)], axis=1)
    vertices = np.concatenate([ring * 0.5, ring * 0.5 + [0, 0, 2]])
    repeats = np.round(np.pi / TILE_M[0])
    places = [np.stack([angle / (2 * np.pi) * repeats, np.full(sides + 1, v)], axis=1) for v in (0, 2 / TILE_M[1])]
    k = np.arange(sides)
    low = np.stack([k, k + 1, k + sides + 2], axis=1)
    high = np.stack([k, k + sides + 2, k + sides + 1], axis=1)
    return Mesh(
        vertices.astype(np.float32),
        np.concatenate([low, high]).astype(np.uint32),
        np.concatenate([ring, ring]).astype(np.float32),
        np.concatenate(places).astype(np.float32) if uv else None,
    )


def scene(material: Material, uv: bool = True, turn_deg: float = 0.0) -> SceneSpec:
    """One cylinder, seen from the south so that it fills the picture's width."""
    post = Exemplar(
        species="post",
        organs=(OrganMesh(Part.TRUNK, "bark", cylinder(uv=uv)),),
        radius_m=1.0,
        height_m=2.0,
        crown_width_m=1.0,
        leaf_area_m2=0.0,
        wood_volume_m3=1.0,
    )
    turn = np.radians(turn_deg)
    transform = np.array([[np.cos(turn), -np.sin(turn), 0, 0], [np.sin(turn), np.cos(turn), 0, 0], [0, 0, 1, 0]])
    eye = (0.0, -6.0, 1.0)
    return replace(
        scattered_scene(1, exemplars=1, leaves=4, terrain=plain_ground(-1.0, 1.0)),
        exemplars=(post,),
        materials={("post", "bark"): material},
        instances=Instances(np.zeros(1, np.uint32), transform[None], np.ones(1, np.uint32)),
        cameras=(Camera("main", eye, look_at(np.array(eye), np.array([0, 0, 1.0])), (24, 24), 8.0),),
    )


def render(spec: SceneSpec, light: dict, samples: int = 64, paints: Paints | None = None) -> np.ndarray:
    camera = spec.cameras[0]
    with using(SCALAR) as mi:
        loaded = load({**plants_dict(spec, origin_of(camera), paints or Paints()), "light": light})
        return capture(mi.load_dict({"type": "path", "max_depth": 2}), loaded, camera, samples=samples, seed=3)[..., :3]


def leaning_texture(lean: tuple[float, float] = (0.0, 0.0)) -> SurfaceTexture:
    """One colour; the height rises along u and v by `lean` everywhere but at the seam."""
    u, v = np.meshgrid((np.arange(64) + 0.5) / 64 * TILE_M[0], (np.arange(64) + 0.5) / 64 * TILE_M[1])
    height = (lean[0] * u + lean[1] * v).astype(np.float32)
    return SurfaceTexture(np.broadcast_to(np.float32(REFLECTANCE), (64, 64, 3)).copy(), height, TILE_M)


UNIFORM = {"type": "constant"}


def from_direction(x: float, y: float, z: float) -> dict:
    return {"type": "directional", "direction": [-x, -y, -z], "irradiance": 1.0}


@pytest.mark.parametrize("pattern", ["furrowed", "papery", "end_grain"])
def test_texture_keeps_the_mean_reflectance(pattern):
    """Under uniform light a convex body's radiance is its reflectance, leaning facets or not."""
    texture = bark_texture(Bark(pattern=pattern, tile_m=TILE_M, depth_m=0.004), REFLECTANCE, "post/bark")
    assert texture.normals()[..., 2].min() < 0.99
    seen = render(scene(Material(REFLECTANCE, texture=texture)), UNIFORM).mean(axis=(0, 1))
    np.testing.assert_allclose(seen, REFLECTANCE, rtol=0.012)


def test_a_flat_texture_is_the_plain_surface():
    plain = render(scene(Material(REFLECTANCE)), from_direction(0.3, -0.8, 0.5), 16)
    textured = render(scene(Material(REFLECTANCE, texture=leaning_texture())), from_direction(0.3, -0.8, 0.5), 16)
    np.testing.assert_allclose(textured, plain, rtol=0.003, atol=1e-4)


@pytest.mark.parametrize("turn_deg", [0.0, 70.0])
def test_slopes_face_the_light_that_they_rise_away_from(turn_deg):
    """A surface that sinks upwards leans to the light from above; one that sinks eastwards to light from the east."""
    middle = np.s_[6:18, 10:14]
    for lean, light in (((0.0, -0.5), (0.0, -0.7, 0.7)), ((-0.5, 0.0), (0.7, -0.7, 0.0))):
        toward, plain, away = (
            np.median(
                render(scene(Material(REFLECTANCE, texture=leaning_texture(k)), turn_deg=turn_deg), light_dict)[middle]
            )
            for light_dict in [from_direction(*light)]
            for k in (lean, (0.0, 0.0), (-lean[0], -lean[1]))
        )
        assert toward > 1.2 * plain > 1.5 * away


def test_wood_without_uv_has_one_colour():
    texture = bark_texture(Bark(pattern="furrowed", tile_m=TILE_M), REFLECTANCE, "post/bark")
    seen = render(scene(Material(REFLECTANCE, texture=texture), uv=False), UNIFORM)
    np.testing.assert_allclose(seen, np.broadcast_to(REFLECTANCE, seen.shape), rtol=0.06)  # the sampler's noise


def test_only_opaque_parts_take_a_texture():
    material = Material(REFLECTANCE, (0.1, 0.1, 0.1), texture=leaning_texture())
    assert surface_bsdf(Part.LEAF, material, has_uv=True)["type"] == "blendbsdf"
    assert surface_bsdf(Part.TRUNK, material, has_uv=True)["bsdf"]["type"] == "normalmap"
    assert surface_bsdf(Part.TRUNK, material)["bsdf"]["type"] == "diffuse"


def test_repainted_bark_is_bark_built_anew():
    """The same scene object, repainted for other wavelengths, gives the same bytes as one made for them."""
    texture = bark_texture(Bark(pattern="furrowed", tile_m=TILE_M, depth_m=0.004), REFLECTANCE, "post/bark")
    spec, passes = scene(Material(REFLECTANCE, texture=texture)), Channels((450.0, 700.0, 1600.0))
    camera = spec.cameras[0]
    fresh = render(spec, UNIFORM, 4, Paints(passes))
    with using(SCALAR) as mi:
        paints = Paints()
        loaded = load({**plants_dict(spec, origin_of(camera), paints), "light": UNIFORM})
        path = mi.load_dict({"type": "path", "max_depth": 2})
        images = []
        for channels in (passes, RGB):
            paints.repaint(channels)
            images.append(capture(path, loaded, camera, samples=4, seed=3)[..., :3])
    assert np.array_equal(images[0], fresh)
    assert np.array_equal(images[1], render(spec, UNIFORM, 4))


def test_of_all_labels_only_the_albedo_sees_the_texture():
    texture = bark_texture(Bark(pattern="furrowed", tile_m=TILE_M), REFLECTANCE, "post/bark")
    (plain, plain_surface), (textured, textured_surface) = (
        trace_identity(
            SceneTracer(one, Timings()), one.cameras[0], samples=4, timer=Timings(), advance=lambda rows: None
        )
        for one in (scene(Material(REFLECTANCE)), scene(Material(REFLECTANCE, texture=texture)))
    )
    for ours, theirs in ((plain, textured), (plain_surface, textured_surface)):
        for name, values in vars(ours).items():
            if values is not None and values is not plain_surface.albedo:
                assert np.array_equal(values, vars(theirs)[name], equal_nan=values.dtype == np.float32), name
    assert plain.part.max() == Part.TRUNK
    trunk = plain_surface.part == Part.TRUNK
    np.testing.assert_allclose(plain_surface.albedo[trunk], np.tile(REFLECTANCE, (trunk.sum(), 1)), rtol=1e-6)
    seen = textured_surface.albedo[trunk]
    np.testing.assert_allclose(seen.mean(axis=0), REFLECTANCE, rtol=0.1)
    assert seen.std(axis=0).min() > 0.02
