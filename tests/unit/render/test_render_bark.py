from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.core.parts import Part
from forestgen.core.progress import Timings
from forestgen.core.spectrum import Spectrum
from forestgen.plants.bark.texture import bark_texture
from forestgen.recipe.species import Bark
from forestgen.render.build import load, origin_of, plants_dict
from forestgen.render.capture import capture
from forestgen.render.identity import SceneTracer, trace_identity
from forestgen.render.surfaces import SpectralBsdfs, relief_colour, surface_bsdf, surface_of
from forestgen.render.variant import SCALAR, using
from forestgen.scene.colour import RGB, Channels
from forestgen.scene.spec import Material, SceneSpec
from support.bark_post import REFLECTANCE, TILE_M, leaning_texture, post_scene


def render(spec: SceneSpec, light: dict, samples: int = 64, paints: SpectralBsdfs | None = None) -> np.ndarray:
    camera = spec.cameras[0]
    with using(SCALAR) as mi:
        loaded = load({**plants_dict(spec, origin_of(camera), paints or SpectralBsdfs()), "light": light})
        return capture(mi.load_dict({"type": "path", "max_depth": 2}), loaded, camera, samples=samples, seed=3)[..., :3]


UNIFORM = {"type": "constant"}


def from_direction(x: float, y: float, z: float) -> dict:
    return {"type": "directional", "direction": [-x, -y, -z], "irradiance": 1.0}


@pytest.mark.parametrize("pattern", ["furrowed", "papery", "end_grain"])
def test_texture_keeps_the_mean_reflectance(pattern):
    """Under uniform light a convex body's radiance is its reflectance, leaning facets or not."""
    texture = bark_texture(Bark(pattern=pattern, tile_m=TILE_M, depth_m=0.004), REFLECTANCE, "post/bark")
    assert texture.normals()[..., 2].min() < 0.99
    seen = render(post_scene(Material(REFLECTANCE, texture=texture)), UNIFORM).mean(axis=(0, 1))
    np.testing.assert_allclose(seen, REFLECTANCE, rtol=0.012)


def test_a_flat_texture_is_the_plain_surface():
    plain = render(post_scene(Material(REFLECTANCE)), from_direction(0.3, -0.8, 0.5), 16)
    textured = render(post_scene(Material(REFLECTANCE, texture=leaning_texture())), from_direction(0.3, -0.8, 0.5), 16)
    np.testing.assert_allclose(textured, plain, rtol=0.003, atol=1e-4)


@pytest.mark.parametrize("turn_deg", [0.0, 70.0])
def test_slopes_face_the_light_that_they_rise_away_from(turn_deg):
    """A surface that sinks upwards leans to the light from above; one that sinks eastwards to light from the east."""
    middle = np.s_[6:18, 10:14]
    for lean, light in (((0.0, -0.5), (0.0, -0.7, 0.7)), ((-0.5, 0.0), (0.7, -0.7, 0.0))):
        textures = [leaning_texture(k) for k in (lean, (0.0, 0.0), (-lean[0], -lean[1]))]
        posts = [post_scene(Material(REFLECTANCE, texture=one), turn_deg=turn_deg) for one in textures]
        toward, plain, away = (np.median(render(one, from_direction(*light))[middle]) for one in posts)
        assert toward > 1.2 * plain > 1.5 * away


def test_wood_without_uv_has_one_colour():
    texture = bark_texture(Bark(pattern="furrowed", tile_m=TILE_M), REFLECTANCE, "post/bark")
    seen = render(post_scene(Material(REFLECTANCE, texture=texture), uv=False), UNIFORM)
    np.testing.assert_allclose(seen, np.broadcast_to(REFLECTANCE, seen.shape), rtol=0.06)  # the sampler's noise


def test_leaves_and_wood_take_a_texture_where_they_have_uv():
    material = Material(REFLECTANCE, (0.1, 0.1, 0.1), texture=leaning_texture())
    leaf = surface_bsdf(Part.LEAF, material, has_uv=True)
    assert leaf["type"] == "blendbsdf"
    for one in (leaf["r"], surface_bsdf(Part.TRUNK, material, has_uv=True)):
        assert [one[side]["type"] for side in ("side0", "side1")] == ["normalmap"] * 2
    assert surface_bsdf(Part.TRUNK, material)["side0"]["type"] == "diffuse"


def test_a_veined_leaf_reflects_what_its_table_says_and_never_more_than_it_gets():
    """Also where it is bright: texels that would pass what the leaf does not let through have less contrast."""
    dark = np.where(np.arange(64)[:, None, None] % 8 < 4, 0.4, 1.6).astype(np.float32)
    grid = np.array([400.0, 2500.0])
    for level, through, channels in ((0.2, 0.2, RGB), (0.5, 0.48, Channels((560.0, 833.0, 1614.0)))):
        reflectance = (level, level, level)
        texture = replace(leaning_texture(), colour=np.broadcast_to(level * dark, (64, 64, 3)))
        spectra = (Spectrum(grid, np.full(2, one)) for one in (level, through))
        material = Material(reflectance, (through,) * 3, 0.5, texture, 0.03, *spectra)
        surface = surface_of(Part.LEAF, material, channels, has_uv=True)
        colour = relief_colour(material, surface, channels)
        np.testing.assert_allclose(colour.mean(axis=(0, 1)), surface.sides.matt, rtol=0.02)
        assert np.all(colour + surface.sides.through + surface.sides.gloss <= 1.0 + 1e-3)


def test_repainted_bark_is_bark_built_anew():
    """The same scene object, repainted for other wavelengths, gives the same bytes as one made for them."""
    texture = bark_texture(Bark(pattern="furrowed", tile_m=TILE_M, depth_m=0.004), REFLECTANCE, "post/bark")
    spec, passes = post_scene(Material(REFLECTANCE, texture=texture)), Channels((450.0, 700.0, 1600.0))
    camera = spec.cameras[0]
    fresh = render(spec, UNIFORM, 4, SpectralBsdfs(passes))
    with using(SCALAR) as mi:
        paints = SpectralBsdfs()
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
        for one in (post_scene(Material(REFLECTANCE)), post_scene(Material(REFLECTANCE, texture=texture)))
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
