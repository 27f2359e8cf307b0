"""The path tracer of paths/: exact cases, and Mitsuba's own integrator and surfaces as peers."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from shots import need_cuda, radiance
from test_exact_light import ALBEDO, COLOURED, GREY, bare_ground, loaded, path, regions, two_lights, white_forest
from test_exact_light import stand as leafy_stand
from test_leaf import LEAVES, PASSES

from forestgen.core.parts import Part
from forestgen.core.progress import Timings
from forestgen.core.spectrum import Spectrum
from forestgen.geometry.mesh import Mesh
from forestgen.plants.bark.texture import bark_texture
from forestgen.recipe.species import Bark
from forestgen.render.capture import capture
from forestgen.render.cloud_shadow import ShadowPlane
from forestgen.render.identity import SceneTracer, trace_identity
from forestgen.render.light import along, sky_map
from forestgen.render.paths.scattering import Local, face_tangents, paint_of
from forestgen.render.paths.sun import Sun
from forestgen.render.paths.tracer import PathTracer, sequence_of
from forestgen.render.paths.tracer import Sky as SkyOnDevice
from forestgen.render.skies.model import MAP_COLUMNS, MAP_ROWS, daylight_of
from forestgen.render.surfaces import surface_bsdf
from forestgen.render.variant import CUDA, LLVM, SCALAR, drjit, mitsuba, using
from forestgen.scene.bark_tones import bark_tones
from forestgen.scene.colour import RGB, Channels
from forestgen.scene.spec import Lens, Material, SceneSpec, Sky, WetGround
from support.bark_post import REFLECTANCE, TILE_M, leaning_texture, post_scene
from support.scenes import camera_at, plain_ground, scattered_scene, shifted
from support.tiers import few

UP = (0.0, 0.0, 1.0)


# ---- surfaces


def local(material: Material, towards, channels=RGB, part: Part = Part.LEAF, facet=UP) -> Local:
    """A level surface with the paint of an organ."""
    spec = scattered_scene(1, exemplars=1, leaves=4)
    exemplar = spec.exemplars[0]
    organ = replace(exemplar.organs[0], part=part)
    spec = replace(
        spec,
        exemplars=(replace(exemplar, organs=(organ,)),),
        materials={(exemplar.species, organ.material): material},
    )
    paint = paint_of(spec, channels)
    mi, count = mitsuba(), len(towards)

    def vector(kind, values):
        return kind(*(np.full(count, float(value), np.float32) for value in values))

    return Local(
        mi.Vector3f(np.asarray(towards, np.float32).T),
        *(vector(mi.Vector3f, one) for one in (UP, UP, facet)),
        *(vector(mi.Color3f, one[1]) for one in (paint.matt, paint.through)),
        vector(mi.Vector3f, paint.gloss[1]),
        vector(mi.Vector2f, paint.chance[1]),
    )


def directions(count: int, seed: int, *, above: bool = False) -> np.ndarray:
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    if above:
        vectors[:, 2] = np.maximum(np.abs(vectors[:, 2]), 1e-3)
        vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors.astype(np.float32)


def pairs(first, second):
    """Every one of both in a pair that runs by default; the other pairs are slow."""
    for i, one in enumerate(first):
        for k, other in enumerate(second):
            by_default = i % len(second) == k or (len(second) > len(first) and k % len(first) == i)
            yield pytest.param(one, other, marks=() if by_default else pytest.mark.slow, id=f"{one}-{other}")


@pytest.mark.parametrize(("name", "channels"), list(pairs(LEAVES, PASSES)))
def test_surfaces_are_those_that_mitsuba_is_given(name, channels):
    """Leaves and wood of every material, between any two directions."""
    channels = PASSES[channels]
    view, light = directions(4000, 1, above=True), directions(4000, 2)
    for part in (Part.LEAF, Part.TRUNK):
        with using(LLVM) as mi:
            dr = drjit()
            bsdf = mi.load_dict(surface_bsdf(part, LEAVES[name], channels), optimize=False)
            at = dr.zeros(mi.SurfaceInteraction3f, len(view))
            at.wi = mi.Vector3f(view.T)
            theirs = np.array(bsdf.eval(mi.BSDFContext(), at, mi.Vector3f(light.T)))
            ours = np.array(local(LEAVES[name], view, channels, part).value(mi.Vector3f(light.T)))
        np.testing.assert_allclose(ours, theirs, rtol=2e-3, atol=1e-6)


FACETS = {"smooth": UP, "leaning": (0.6, 0.0, 0.8)}


@pytest.mark.parametrize(("name", "facet"), list(pairs(LEAVES, FACETS)))
def test_chosen_directions_carry_what_the_surface_returns(name, facet):
    """The mean weight of sampled directions, by quarters of the sphere, is the integral of the value there."""
    facet = FACETS[facet]
    count = 400_000
    view = np.tile(np.float32([0.48, 0.36, 0.8]), (count, 1))
    rng = np.random.default_rng(5)
    with using(LLVM) as mi:
        surface = local(LEAVES[name], view, facet=facet)
        lobe, first, second = (mi.Float(rng.random(count).astype(np.float32)) for _ in range(3))
        going, weight = (np.array(one, dtype=np.float64).T for one in surface.sample(lobe, first, second))
        even = directions(count, 6)
        value = np.array(surface.value(mi.Vector3f(even.T)), dtype=np.float64).T * 4 * np.pi
        density = np.array(surface.density(mi.Vector3f(even.T)), dtype=np.float64) * 4 * np.pi
    assert np.isfinite(weight).all()
    assert (weight >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(going, axis=1), 1.0, atol=1e-4)
    for above in (True, False):
        for east in (True, False):
            parts = []
            for where, what in ((going, weight), (even, value)):
                inside = ((where[:, 2] > 0) == above) & ((where[:, 0] > 0) == east)
                parts.append(np.where(inside[:, None], what, 0.0))
            chosen, wanted = (((where[:, 2] > 0) == above) & ((where[:, 0] > 0) == east) for where in (going, even))
            chosen &= weight.max(axis=1) > 0  # the density leaves out what falls below a leaning facet or its mirror
            if weight.any():
                spread = np.hypot(chosen.std(), np.where(wanted, density, 0.0).std()) / np.sqrt(count)
                assert abs(chosen.mean() - np.where(wanted, density, 0.0).mean()) <= 4.5 * spread + 1e-6
            (one, other), error = (part.mean(axis=0) for part in parts), np.hypot(*(p.std(axis=0) for p in parts))
            assert np.all(np.abs(one - other) <= 4.5 * error / np.sqrt(count) + 1e-6), (above, east, one, other)


def test_tangents_run_along_u():
    corners = np.array([[0, 0, 0], [2, 0, 0], [0, 1, 0], [0, 0, 3]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 0, 0]], np.uint32)
    uv = np.array([[0, 0], [0, 1], [-1, 0], [0, 0]], np.float32)  # u falls along y; the second face has no area in uv
    tangents = face_tangents(Mesh(corners, faces, None, uv))
    np.testing.assert_allclose(tangents[0], [0, -1, 0], atol=1e-6)
    np.testing.assert_array_equal(tangents[1:], 0.0)


# ---- points


@pytest.mark.parametrize("count", [1, 2, 16, 64])
def test_points_fill_every_elementary_interval(count):
    """(0, 2)-nets in base 2: a point in each box of area 1 / N, in every choice of every pixel."""
    with using(LLVM) as mi:
        dr = drjit()
        number = dr.arange(mi.UInt32, count)
        seen = []
        for seed in range(4):
            for pixel in (0, 7, 2**24):
                sequence = sequence_of(mi.UInt32(seed), mi.UInt32(pixel) + dr.zeros(mi.UInt32, count), number)
                pairs = [sequence.pair(mi.UInt32(choice)) for choice in range(3)]
                seen += [np.stack([np.array(one) for one in pair]) for pair in pairs]
    powers = int(np.log2(count))
    for x, y in seen:
        for k in range(powers + 1):
            box = (x * 2**k).astype(int) * 2 ** (powers - k) + (y * 2 ** (powers - k)).astype(int)
            assert len(np.unique(box)) == count
    assert len({one.tobytes() for one in seen}) == len(seen)
    every = np.concatenate(seen, axis=1)
    assert every.min() >= 0
    assert every.max() < 1
    assert abs(every.mean() - 0.5) < 4 * np.sqrt(1 / 12 / every.size)


# ---- lights


def test_the_sky_is_looked_up_as_in_numpy():
    sky = sky_map(Sky(35.0, 120.0, 4.0), RGB)
    towards = np.concatenate([directions(5000, 3), np.float32([[0, 0, 1], [0, 0, -1], [-1, 0, 0], [-1, -1e-7, 0]])])
    with using(LLVM) as mi:
        seen = np.array(SkyOnDevice(sky).towards(mi.Vector3f(towards.T), mi.Bool(True))).T
    assert sky.shape == (MAP_ROWS, MAP_COLUMNS, 3)
    np.testing.assert_allclose(seen, along(sky, towards.astype(np.float64)), rtol=2e-3, atol=1e-3 * sky.mean())


def cloudy(seed: int = 4) -> np.ndarray:
    """A sky with bright edges of clouds, black below the horizon."""
    bright = np.random.default_rng(seed).gamma(0.2, 5.0, (MAP_ROWS, MAP_COLUMNS, 1)) * [1.0, 0.9, 0.7]
    bright[MAP_ROWS // 2 + 1 :] = 0.0
    return bright.astype(np.float32)


def test_sky_samples_follow_their_density():
    sky, count = cloudy(), 2**18
    rng = np.random.default_rng(7)
    with using(LLVM) as mi:
        device = SkyOnDevice(sky, sampled=True)
        pair = [mi.Float(rng.random(count).astype(np.float32)) for _ in range(2)]
        going, density = device.sample(*pair)
        again = np.array(device.density(going))
        going, density = np.array(going, dtype=np.float64).T, np.array(density, dtype=np.float64)
        even = directions(count, 8)
        spread = np.array(device.density(mi.Vector3f(even.T)), dtype=np.float64)
    assert going[:, 2].min() > -0.04  # within two rows of the last bright one
    np.testing.assert_allclose(np.linalg.norm(going, axis=1), 1.0, atol=1e-5)
    assert np.mean(np.isclose(again, density, rtol=1e-3)) > 0.998  # but for rounding on the edges of cells
    assert spread.mean() * 4 * np.pi == pytest.approx(1.0, abs=5 * spread.std() * 4 * np.pi / np.sqrt(count))
    light, truth = along(sky, going) / density[:, None], along(sky, even.astype(np.float64)) * 4 * np.pi
    error = np.hypot(light.std(axis=0), truth.std(axis=0)) / np.sqrt(count)
    assert np.all(np.abs(light.mean(axis=0) - truth.mean(axis=0)) < 4 * error)
    assert light.std() < 0.6 * truth.std()


@pytest.mark.slow
def test_light_samples_of_the_sky_change_the_noise_alone():
    """A glossy stand with barks under cloud edges: the same image whether the sky is looked for or found."""
    spec = leafy_stand(size_px=(48, 30))
    glossy = {key: replace(one, gloss=0.03 if key[1] != "bark" else 0.0) for key, one in spec.materials.items()}
    spec = replace(spec, materials=glossy)
    bark = bark_texture(Bark(pattern="furrowed", tile_m=TILE_M, depth_m=0.004), REFLECTANCE, "post/bark")
    for one in (spec, post_scene(Material(REFLECTANCE, texture=bark))):
        paths = PathTracer(SceneTracer(one, Timings()), one.cameras[0], 64, lambda channels: cloudy())
        images = []
        for sampled in (False, True):
            paths.show(RGB)
            with using(LLVM):
                paths._sky, paths._sun = SkyOnDevice(cloudy(), sampled=sampled), None
            images.append(np.array([paths.take(64, k).by_sky for k in range(12)]))
        found, looked_for = images
        assert looked_for.std(axis=0).mean() < 0.8 * found.std(axis=0).mean()
        assert_same(looked_for.astype(np.float64), found.astype(np.float64))


def test_the_sun_is_a_disc_behind_its_shadow_plane():
    to_sun = Sky(40.0, 200.0, 3.0).to_sun
    cells = np.random.default_rng(1).random((5, 7))
    shadow = ShadowPlane(cells, np.array([-70.0, -50.0]), np.array([70.0, 50.0]), 30.0)
    with using(LLVM) as mi:
        dr = drjit()
        sun = Sun(to_sun, np.ones(3), np.full(3, 2.0), shadow, np.array([10.0, 0.0, 5.0]))
        steps = (dr.arange(mi.Float, 4096) + 0.5) / 4096
        disc = np.array(sun.sample(steps, mi.Float(steps * 1000.0) - dr.floor(steps * 1000.0))).T
        angle = np.degrees(np.arcsin(np.linalg.norm(np.cross(disc, to_sun), axis=1)))
        assert angle.max() < 0.2666
        assert np.sqrt(np.mean(angle**2)) == pytest.approx(0.2665 / np.sqrt(2), rel=0.02)
        sides = [to_sun + np.array([0, 0, dz]) for dz in (0.0045, 0.0065)]
        seen = np.array(sun.seen(mi.Vector3f(np.float32([one / np.linalg.norm(one) for one in sides]).T)))
        np.testing.assert_allclose(seen[0], [2.0, 0.0])
        # Straight below the middles of cells; between two of them; beside the shadow; above it.
        up = to_sun / to_sun[2]
        above = [(-60, -40), (0, 0), (60, 40), (-50, -40), (75, 0), (0, 0)]
        depth = [25.0] * 5 + [-1.0]
        points = [np.array([x, y, 30.0]) - up * d - [10.0, 0, 5.0] for (x, y), d in zip(above, depth, strict=True)]
        found = np.array(sun.share(mi.Point3f(np.float32(points).T), mi.Vector3f(*map(float, to_sun)), mi.Bool(True)))
    wanted = [cells[0, 0], cells[2, 3], cells[4, 6], (cells[0, 0] + cells[0, 1]) / 2, 1.0, 1.0]
    np.testing.assert_allclose(found, wanted, atol=1e-4)


# ---- exact cases


@pytest.mark.parametrize("zenith_deg", [0, 60])
def test_a_lambertian_plane(zenith_deg):
    spec = bare_ground(Sky(90.0 - zenith_deg, 140.0, 3.0))
    light = daylight_of(spec.sky)
    on_level = RGB.of_light(light.sun) * np.cos(np.radians(zenith_deg)) + RGB.of_light(light.sky)
    seen = radiance(spec, 256, seed=2).mean.mean(axis=(0, 1))
    np.testing.assert_allclose(seen, ALBEDO / np.pi * on_level, rtol=0.003)


def white_sky(spec: SceneSpec, max_depth: int = 4096) -> PathTracer:
    """The first camera under a sky of 1 all around."""
    overcast = replace(spec, sky=replace(spec.sky, kind="overcast"))
    ones = np.ones((MAP_ROWS, MAP_COLUMNS, 3), dtype=np.float32)
    return PathTracer(SceneTracer(overcast, Timings()), spec.cameras[0], max_depth, lambda channels: ones)


@pytest.mark.parametrize(("leaf", "away_m"), few([(COLOURED, 1000.0), (GREY, 0.0), (COLOURED, 0.0), (GREY, 1000.0)], 2))
def test_white_furnace(leaf, away_m):
    """Nothing takes light away, so all of it comes back: from every part, near and far, and far from the origin."""
    spec = shifted(white_forest(leaf), (away_m, away_m, 0.0))
    lit = white_sky(spec)
    lit.show(RGB)
    found = [lit.take(64, seed=k) for k in range(6)]
    assert not any(one.by_sun.any() for one in found)
    images = np.array([one.by_sky + one.beyond for one in found])
    for name, where in {"all": np.ones(images.shape[1:3], dtype=bool), **regions(spec)}.items():
        means = images[:, where].mean(axis=1)
        error = images[:, where].std(axis=(0, 1)) / np.sqrt(means.shape[0] * where.sum())
        assert np.all(np.abs(means.mean(axis=0) - 1.0) <= 0.001 + 3.5 * error), name
        assert error.max() < 0.002 or name != "all"


# ---- Mitsuba's own integrator as a peer


def by_mitsuba(spec: SceneSpec, count: int, samples: int) -> np.ndarray:
    with using(SCALAR) as mi:
        built, integrator = loaded(spec, two_lights(spec.sky, RGB)), mi.load_dict(path())
        images = [
            capture(integrator, built, spec.cameras[0], samples=samples, seed=100 + k)[..., :3] for k in range(count)
        ]
    return np.array(images)


def assert_same(ours: np.ndarray, theirs: np.ndarray, side: int = 6) -> None:
    """(K, H, W, 3) independent images: blocks agree within noise, and the whole within 1%."""
    blocks = []
    for images in (ours, theirs):
        count, height, width, _ = images.shape
        cut = images[:, : height // side * side, : width // side * side]
        shaped = cut.reshape(count, height // side, side, width // side, side, 3).mean(axis=(2, 4))
        blocks.append((shaped.mean(axis=0), shaped.std(axis=0, ddof=1) / np.sqrt(count)))
    (one, one_error), (other, other_error) = blocks
    score = (one - other) / np.hypot(np.hypot(one_error, other_error), 1e-3 * other.mean())
    assert np.abs(score).max() < 6.5  # of t with few degrees of freedom, in hundreds of blocks
    assert np.sqrt(np.mean(score**2)) < 1.6
    error = np.hypot(ours.mean(axis=(1, 2)).std(axis=0), theirs.mean(axis=(1, 2)).std(axis=0)) / np.sqrt(len(ours) - 1)
    difference = ours.mean(axis=(0, 1, 2)) / theirs.mean(axis=(0, 1, 2)) - 1
    assert np.all(np.abs(difference) < 4 * error / theirs.mean(axis=(0, 1, 2)) + 0.002)


def images_of(spec: SceneSpec, count: int, samples: int) -> np.ndarray:
    return np.array([radiance(spec, samples, seed=k + 1).mean for k in range(count)], dtype=np.float64)


def below(eye, size_px=(48, 30)):
    return camera_at(eye, (12.0, 12.0, 0.0), size_px)


CAMERAS = {
    "perspective": camera_at((12.5, -6.0, 3.0), (12.5, 12.0, 1.5), (48, 30)),
    "lens": replace(below((12.5, -6.0, 3.0)), lens=Lens(0.2, 15.0)),
    "from above": replace(below((12.0, 11.9, 30.0)), projection="orthographic", width_m=25.0),
    "fisheye": replace(camera_at((12.0, 12.0, 0.5), (12.0, 12.1, 9.0), (30, 30)), projection="fisheye", hfov_deg=180.0),
    "panorama": replace(
        camera_at((12.0, 12.0, 2.5), (12.0, 30.0, 2.5), (48, 24)), projection="panorama", hfov_deg=360.0
    ),
}


@pytest.mark.parametrize("name", few(CAMERAS))
def test_all_cameras_see_what_mitsuba_renders(name):
    spec = replace(leafy_stand(), cameras=(CAMERAS[name],))
    glossy = {key: replace(one, gloss=0.03 if key[1] != "bark" else 0.0) for key, one in spec.materials.items()}
    spec = replace(spec, materials=glossy)
    # Near a panorama's poles Mitsuba's image, put together from cube faces, weighs rays by their solid angles.
    rows = slice(6, 18) if name == "panorama" else slice(None)
    assert_same(images_of(spec, 12, 32)[:, rows], by_mitsuba(spec, 12, 32)[:, rows])


def wet_terrain(albedo: float, low_m: float, high_m: float, cells: int = 1):
    """Dry and wet in waves; the film takes more of the long wavelengths."""
    ground = plain_ground(low_m, high_m, cells, albedo=albedo)
    place = ground.mesh.vertices_m[:, :2].astype(np.float64)
    share = (0.5 + 0.5 * np.sin(place @ [0.5, 0.9])).astype(np.float32)
    nm, film = np.array([400.0, 1000.0, 2000.0]), albedo * np.array([0.9, 0.6, 0.1])
    return replace(ground, wet=WetGround(share, (0.4 * albedo, 0.5 * albedo, 0.6 * albedo), Spectrum(nm, film)))


@pytest.mark.slow
def test_wet_ground_is_lit_as_mitsuba_lights_it():
    spec = replace(leafy_stand(), terrain=wet_terrain(0.4, -60.0, 84.0, 48))
    assert_same(images_of(spec, 12, 32), by_mitsuba(spec, 12, 32))


@pytest.mark.parametrize(
    ("channels", "factor"), [(RGB, (0.4, 0.5, 0.6)), (Channels((400.0, 1000.0, 1500.0)), (0.9, 0.6, 0.35))]
)
def test_a_wet_plane_returns_its_share_of_an_even_sky(channels, factor):
    """Of 1 all around, the plane sends back what it reflects: in colour and at wavelengths."""
    ground = wet_terrain(0.4, -20000.0, 20000.0)
    for wet in (0.0, 0.3, 1.0):
        share = np.full(len(ground.wet.share), wet, np.float32)
        even = replace(ground, wet=replace(ground.wet, share=share))
        lit = white_sky(replace(bare_ground(Sky(40.0, 140.0, 3.0)), terrain=even))
        lit.show(channels)
        found = lit.take(16, seed=1)
        wanted = 0.4 * (1.0 - wet * (1.0 - np.array(factor)))
        np.testing.assert_allclose((found.by_sky + found.beyond).mean(axis=(0, 1)), wanted, rtol=2e-3)


@pytest.mark.parametrize("turn_deg", few([140.0, 0.0]))
@pytest.mark.slow
def test_relief_of_bark_is_lit_as_mitsuba_lights_it(turn_deg):
    """A texture whose heights rise along u and v: it has a side, and is darker away from the sun."""
    furrowed = bark_texture(Bark(pattern="furrowed", tile_m=TILE_M, depth_m=0.004), REFLECTANCE, "post/bark")
    for texture in (leaning_texture((0.6, 0.3)), furrowed):
        spec = post_scene(Material(REFLECTANCE, texture=texture), turn_deg=turn_deg)
        spec = replace(spec, sky=Sky(30.0, 200.0, 3.0))
        assert_same(images_of(spec, 10, 64), by_mitsuba(spec, 10, 64))


def seen_albedo(spec: SceneSpec) -> NDArray[np.float32]:
    """Label of the pixels on wood."""
    tracer = SceneTracer(spec, Timings())
    _, surface = trace_identity(tracer, spec.cameras[0], samples=1, timer=Timings(), advance=lambda rows: None)
    return surface.albedo[surface.part == Part.TRUNK]


def test_wood_has_the_tone_of_its_plant():
    """A convex post: all of its light but what it sends to itself by the ground goes with its reflectance."""
    spec = replace(post_scene(Material(REFLECTANCE, texture=leaning_texture())), sky=Sky(30.0, 200.0, 3.0))
    spread = 0.3
    tone = float(bark_tones(spec.instances.plant_id, spread)[0])
    assert abs(tone - 1.0) > 0.05
    plain, toned = (radiance(one, 16, seed=1).mean for one in (spec, replace(spec, bark_spread=spread)))
    np.testing.assert_allclose(toned.mean() / plain.mean(), tone, rtol=0.02)
    plain, toned = (seen_albedo(one) for one in (spec, replace(spec, bark_spread=spread)))
    np.testing.assert_allclose(toned / plain, tone, rtol=1e-5)


def test_an_image_is_the_same_with_any_threads_and_blocks(monkeypatch):
    from forestgen.render.paths import tracer

    spec = leafy_stand(size_px=(40, 24))
    whole, before = radiance(spec, 8, seed=1).mean, drjit().thread_count()
    try:
        mitsuba(threads=1)
        np.testing.assert_array_equal(radiance(spec, 8, seed=1).mean, whole)
        monkeypatch.setattr(tracer, "_PATHS_AT_ONCE", 1000)  # of 125 pixels, in the middle of rows
        np.testing.assert_array_equal(radiance(spec, 8, seed=1).mean, whole)
    finally:
        mitsuba(threads=before)
    assert not np.array_equal(radiance(spec, 8, seed=2).mean, whole)


def test_a_hit_from_afar_does_not_shade_itself():
    """Ground in the sun near the origin, from 3 km away, by the cameras of a ring around it."""
    spec = bare_ground(Sky(60.0, 140.0, 3.0))
    places = [(900.0 * np.cos(turn), 900.0 * np.sin(turn), 3000.0) for turn in np.arange(4) * np.pi / 2]
    ring = [replace(camera_at(place, (0.5, 0.7, 0.0), (32, 18)), hfov_deg=0.05) for place in places]
    spec = replace(spec, cameras=tuple(replace(one, name=str(k)) for k, one in enumerate(ring)))
    tracer = SceneTracer(spec, Timings())
    assert np.abs(tracer.origin_m[:2]).max() < 1e-6
    for camera in spec.cameras:
        lit = PathTracer(tracer, camera, 2, partial(sky_map, spec.sky))
        lit.show(RGB)
        seen = lit.take(16, seed=1).by_sun
        assert np.ptp(seen[..., 1]) < 1e-3 * seen[..., 1].mean()


def test_depth_counts_scatterings():
    """Two: straight from the lights and by one scattering; each more adds light."""
    spec = leafy_stand(size_px=(40, 24))
    means = [radiance(spec, 32, seed=1, max_depth=depth).mean.mean() for depth in (1, 2, 3, 64)]
    assert all(one < other for one, other in pairwise(means))
    with using(SCALAR) as mi:
        built = loaded(spec, two_lights(spec.sky, RGB))
        theirs = [
            capture(mi.load_dict(path(depth)), built, spec.cameras[0], samples=64, seed=1)[..., :3].mean()
            for depth in (1, 2, 3)
        ]
    np.testing.assert_allclose(means[:3], theirs, rtol=0.02)


@pytest.mark.gpu
def test_cuda_and_llvm_see_the_same_light():
    need_cuda()
    spec, images = leafy_stand(size_px=(64, 40)), {}
    for variant in (LLVM, CUDA):
        lit = PathTracer(SceneTracer(spec, Timings(), variant), spec.cameras[0], 64, partial(sky_map, spec.sky))
        lit.show(RGB)
        found = [lit.take(32, seed=k) for k in range(4)]
        images[variant] = np.array([one.by_sky + one.by_sun + one.beyond for one in found], dtype=np.float64)
    # The same random numbers: paths differ where rounding turns one aside.
    close = np.isclose(images[LLVM], images[CUDA], rtol=1e-3, atol=1e-3 * images[LLVM].mean())
    assert close.mean() > 0.9
    assert_same(images[CUDA], images[LLVM], side=8)
