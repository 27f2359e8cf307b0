"""A leaf's reflectance R and transmittance T, by integration over both hemispheres, against its material's table.

R and T are asked for as an integrating sphere measures them, for light from 8 degrees, and for light from the whole
hemisphere: on both sides, at every channel. The limit is 0.5% of the table, or 0.0005.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.core.parts import Part
from forestgen.core.spectrum import Spectrum
from forestgen.recipe.assets import list_assets, recipes_dir
from forestgen.recipe.load import load_recipe
from forestgen.recipe.phenology import LeafState
from forestgen.render.surfaces import SPHERE_DEG, gloss_of, gloss_share, repaint, sides_of, surface_bsdf
from forestgen.render.variant import LLVM, drjit, mitsuba, using
from forestgen.scene.colour import RGB, Channels
from forestgen.scene.spec import Material
from forestgen.scene.surfaces import materials_of
from support.tiers import few


def spectrum(wavelength_nm, value) -> Spectrum:
    return Spectrum(np.asarray(wavelength_nm, dtype=np.float64), np.asarray(value, dtype=np.float64))


# PROSPECT-D (N 1.5, Cab 40, Car 8, Cw .01, Cm .009), roughly, from the violet to 2500 nm.
NODES_NM = (360, 450, 550, 670, 700, 750, 800, 1100, 1450, 1650, 1940, 2200, 2500)
LEAF_R = (0.040, 0.042, 0.151, 0.036, 0.13, 0.42, 0.443, 0.445, 0.18, 0.30, 0.065, 0.17, 0.045)
LEAF_T = (0.000, 0.002, 0.150, 0.006, 0.15, 0.46, 0.475, 0.485, 0.22, 0.36, 0.060, 0.21, 0.030)
FRESH = Material(
    (0.055, 0.115, 0.045),
    (0.045, 0.105, 0.010),
    reflectance_spectrum=spectrum(NODES_NM, LEAF_R),
    transmittance_spectrum=spectrum(NODES_NM, LEAF_T),
)
LEAVES = {
    "poplar": Material((0.060, 0.115, 0.038), (0.048, 0.100, 0.020)),
    "waxy": Material((0.060, 0.115, 0.038), (0.048, 0.100, 0.020), roughness=0.3, gloss=0.03),
    "rough": Material((0.060, 0.115, 0.038), (0.048, 0.100, 0.020), roughness=0.7, gloss=0.03),
    "near infrared": Material((0.45, 0.45, 0.50), (0.45, 0.40, 0.45), gloss=0.03),
    "darker than its gloss": Material((0.30, 0.01, 0.02), (0.20, 0.01, 0.0), gloss=0.04),
    "white petal": Material((0.70, 0.68, 0.60), (0.25, 0.20, 0.15), gloss=0.02),
    "red one way, blue the other": Material((0.95, 0.05, 0.03), (0.02, 0.05, 0.94), gloss=0.03),
    "opaque": Material((0.30, 0.20, 0.10), gloss=0.03),
    "thin": Material((0.02, 0.02, 0.02), (0.80, 0.60, 0.40)),
    "black": Material((0.0, 0.0, 0.0), gloss=0.03),
    "white": Material((0.5, 0.7, 1.0), (0.5, 0.3, 0.0), gloss=0.03),
}
PASSES = {
    "colour": RGB,
    "visible": Channels((450.0, 550.0, 670.0)),
    "red edge to infrared": Channels((700.0, 750.0, 1100.0)),
    "dark and bright": Channels((360.0, 800.0, 1940.0)),
    "to the end": Channels((1450.0, 2200.0, 2500.0)),
}


def interaction(angle_deg: float, side: int, count: int):
    mi, dr = mitsuba(), drjit()
    angle = np.radians(angle_deg)
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.wi = mi.Vector3f(float(np.sin(angle)), 0.0, float(side * np.cos(angle)))
    return si


def integrate(bsdf, angle_deg: float, side: int, steps: int = 512) -> tuple[np.ndarray, np.ndarray]:
    """((3,) R, (3,) T) for light from `side` (+1 is the upper side): midpoints in the cosine and in the azimuth."""
    mi = mitsuba()
    cosine, azimuth = np.meshgrid((np.arange(steps) + 0.5) / steps, (np.arange(steps) + 0.5) / steps * np.pi)
    cosine, azimuth = cosine.ravel(), azimuth.ravel()
    sine = np.sqrt(1 - cosine**2)
    si = interaction(angle_deg, side, len(cosine))
    shares = []
    for hemisphere in (side, -side):
        wo = mi.Vector3f(sine * np.cos(azimuth), sine * np.sin(azimuth), hemisphere * cosine)
        value = np.array(bsdf.eval(mi.BSDFContext(), si, wo), dtype=np.float64)  # includes the cosine
        shares.append(value.mean(axis=1) * 2 * np.pi)
    return shares[0], shares[1]


def by_sphere(bsdf, side: int) -> tuple[np.ndarray, np.ndarray]:
    return integrate(bsdf, SPHERE_DEG, side)


def by_hemisphere(bsdf, side: int) -> tuple[np.ndarray, np.ndarray]:
    """R and T of light that comes equally from everywhere: each direction counts by its cosine."""
    node, weight = np.polynomial.legendre.leggauss(8)
    angles = np.degrees(np.arccos(np.sqrt((node + 1) / 2)))
    parts = [integrate(bsdf, float(angle), side, steps=256) for angle in angles]
    r, t = (sum(w / 2 * part[k] for w, part in zip(weight, parts, strict=True)) for k in (0, 1))
    return r, t


def assert_tabled(seen: tuple[np.ndarray, np.ndarray], material: Material, channels: Channels) -> None:
    r = channels.of_surface(material.reflectance, material.reflectance_spectrum)
    t = channels.of_surface(material.transmittance, material.transmittance_spectrum)
    assert np.all(np.abs(seen[0] - r) <= np.maximum(0.005 * r, 0.0005)), (seen[0], r)
    assert np.all(np.abs(seen[1] - t) <= np.maximum(0.0005 * t, 1e-6)), (seen[1], t)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("light", [by_sphere, by_hemisphere])
@pytest.mark.parametrize("leaf", LEAVES)
def test_reflectance_and_transmittance_are_the_materials(leaf, light, side):
    with using(LLVM) as mi:
        assert_tabled(light(mi.load_dict(surface_bsdf(Part.LEAF, LEAVES[leaf])), side), LEAVES[leaf], RGB)


@pytest.mark.parametrize("gloss", [0.0, 0.03])
@pytest.mark.parametrize("channels", PASSES.values(), ids=PASSES)
def test_a_leaf_is_its_table_at_every_wavelength(channels, gloss):
    """Up to R + T = 0.93 in the infrared, beside a channel where the leaf is nearly black: no lobe is clipped."""
    material = replace(FRESH, gloss=gloss)
    with using(LLVM) as mi:
        bsdf = mi.load_dict(surface_bsdf(Part.LEAF, material, channels))
        for side in (1, -1):
            assert_tabled(by_sphere(bsdf, side), material, channels)
        assert_tabled(by_hemisphere(bsdf, 1), material, channels)


@pytest.mark.slow
@pytest.mark.parametrize("season", ["summer", "autumn"])
def test_the_leaves_of_all_species_are_their_tables(season):
    """What the shipped species files say of leaves and petals, in colour, in the red edge and in the infrared."""
    rows = [f"species.{name}=" for name in list_assets("species")]
    recipe = load_recipe(recipes_dir() / "quickstart.yaml", ["sky.clouds=none", *rows])
    species = recipe.draw(0).species  # a plan would ask for a community that all of them can grow in
    bare = {
        name: one.model_copy(update={"materials": {k: m for k, m in one.materials.items() if m.bark is None}})
        for name, one in species.items()
    }
    thin = {
        key: one
        for key, one in materials_of(bare, {name: [LeafState.of_season(season)] for name in bare}).items()
        if max(one.transmittance) > 0
    }
    assert len(thin) > 15
    assert sum(gloss_share(one) > 0 for one in thin.values()) > 10
    with using(LLVM) as mi:
        for material in thin.values():
            for name in ("colour", "red edge to infrared", "to the end"):
                bsdf = mi.load_dict(surface_bsdf(Part.LEAF, material, PASSES[name]))
                for side in (1, -1):
                    assert_tabled(integrate(bsdf, SPHERE_DEG, side, 384), material, PASSES[name])


@pytest.mark.parametrize("leaf", few(LEAVES, 4))
def test_energy_is_conserved_at_every_angle(leaf):
    with using(LLVM) as mi:
        bsdf = mi.load_dict(surface_bsdf(Part.LEAF, LEAVES[leaf]))
        for angle in (0, 30, 60, 75, 85, 89):
            r, t = integrate(bsdf, angle, 1)
            assert np.all(r + t <= 1.0 + 1e-5), angle


def test_colours_that_promise_too_much_conserve_energy():
    """The colours of two saturated spectra may add up to more than 1; the leaf takes them down together."""
    sides = sides_of(Material((0.9, 0.2, 0.0), (0.3, 0.1, 0.0), gloss=0.02), RGB)
    np.testing.assert_allclose(sides.matt + sides.gloss + sides.through, [1.0, 0.3, 0.0])
    np.testing.assert_allclose(sides.matt / np.maximum(sides.through, 1e-9), [3.0, 2.0, 0.0])


def test_white_leaves_have_no_gloss():
    assert gloss_share(LEAVES["white"]) == 0.0
    assert gloss_share(LEAVES["waxy"]) == 0.03
    assert gloss_share(LEAVES["darker than its gloss"]) == 0.01


def test_the_gloss_is_the_same_in_all_passes():
    material = replace(FRESH, gloss=0.05)
    shares = {sides_of(material, channels).gloss for channels in PASSES.values()}
    assert shares == {min(LEAF_R)}


@pytest.mark.parametrize("roughness", few([0.3, 1.0, 0.0, 0.2, 0.45, 0.6, 0.7], 2))
def test_the_gloss_lobes_albedo_hardly_depends_on_the_angle(roughness):
    gloss = gloss_of(roughness)
    lobe = {"type": "roughconductor", "distribution": "ggx", "alpha": gloss.alpha, "eta": gloss.index, "k": 0.0}
    with using(LLVM) as mi:
        bsdf = mi.load_dict(lobe)
        seen = {angle: float(integrate(bsdf, angle, 1, 1024)[0][0]) / gloss.albedo for angle in (8, 30, 45, 60, 75, 89)}
    assert seen[8] == pytest.approx(1.0, abs=0.002)
    for angle in (30, 45, 60):
        assert seen[angle] == pytest.approx(1.0, abs=0.025)
    assert seen[75] == pytest.approx(1.0, abs=0.08)
    assert seen[89] <= gloss.highest


def test_the_gloss_lies_about_the_mirrors_direction():
    """And is white: the three channels rise by the same amount."""
    matt, waxy = LEAVES["poplar"], LEAVES["waxy"]
    with using(LLVM) as mi:
        si = interaction(50, 1, 1)
        values = []
        for material in (matt, waxy):
            bsdf = mi.load_dict(surface_bsdf(Part.LEAF, material))
            for x in (-0.766, 0.0):
                wo = mi.Vector3f(x, 0.0, float(np.sqrt(1 - x * x)))
                values.append(np.array(bsdf.eval(mi.BSDFContext(), si, wo))[:, 0] / np.sqrt(1 - x * x))
    mirror, above = values[2] - values[0], values[3] - values[1]
    assert np.ptp(mirror) < 1e-6
    assert mirror[0] > 0.2 > 0.0 > above[0]


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("leaf", ["poplar", "waxy", "red one way, blue the other"])
def test_sampled_paths_carry_what_the_integral_says(leaf, side):
    """The path tracer samples; its mean weights by hemisphere are R and T too."""
    mi, dr = mitsuba(), drjit()
    count = 1 << 18
    with using(LLVM):
        bsdf = mi.load_dict(surface_bsdf(Part.LEAF, LEAVES[leaf]))
        for angle in (0, 30, 60):
            rng = np.random.default_rng(angle)
            one, two = mi.Float(rng.random(count)), mi.Point2f(rng.random(count), rng.random(count))
            sample, weight = bsdf.sample(mi.BSDFContext(), interaction(angle, side, count), one, two)
            weight = np.nan_to_num(np.array(dr.select(sample.pdf > 0, weight, 0.0), dtype=np.float64))
            same_side = np.array(sample.wo.z) * side > 0
            for share, expected in zip((same_side, ~same_side), integrate(bsdf, angle, side), strict=True):
                carried = weight * share
                error = carried.std(axis=1) / np.sqrt(count)
                assert np.all(np.abs(carried.mean(axis=1) - expected) < 5 * error + 1e-5)


@pytest.mark.parametrize("leaf", ["waxy", "white", "thin", "opaque"])
def test_light_may_go_either_way(leaf):
    """Reciprocity: f(a, b) = f(b, a), on both sides and through the leaf; f is without the cosine."""
    rng = np.random.default_rng(2)
    one, other = rng.normal(size=(2, 4096, 3))
    one, other = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (one, other))
    mi, dr = mitsuba(), drjit()
    with using(LLVM):
        bsdf = mi.load_dict(surface_bsdf(Part.LEAF, LEAVES[leaf]))
        values = []
        for light, view in ((one, other), (other, one)):
            si = dr.zeros(mi.SurfaceInteraction3f, len(light))
            si.wi = mi.Vector3f(*(mi.Float(np.ascontiguousarray(light[:, k])) for k in range(3)))
            wo = mi.Vector3f(*(mi.Float(np.ascontiguousarray(view[:, k])) for k in range(3)))
            values.append(np.array(bsdf.eval(mi.BSDFContext(), si, wo)) / np.abs(view[:, 2]))
    assert values[0].max() > 0.01
    np.testing.assert_allclose(values[0], values[1], rtol=2e-3, atol=1e-6)


@pytest.mark.parametrize("gloss", [0.0, 0.03])
def test_a_repainted_leaf_is_the_leaf_built_anew(gloss):
    material = replace(FRESH, gloss=gloss)
    with using(LLVM) as mi:
        bsdf = mi.load_dict(surface_bsdf(Part.LEAF, material))
        for channels in PASSES.values():
            fresh = mi.load_dict(surface_bsdf(Part.LEAF, material, channels))
            repaint(bsdf, fresh)
            for ours, theirs in zip(integrate(bsdf, 40, 1, 64), integrate(fresh, 40, 1, 64), strict=True):
                assert np.array_equal(ours, theirs)


@pytest.mark.parametrize("part", [Part.TRUNK, Part.BRANCH, Part.FRUIT, Part.DEAD_WOOD])
def test_wood_and_fruit_reflect_their_material_and_let_nothing_through(part):
    material = Material((0.3, 0.2, 0.1), (0.1, 0.1, 0.1), roughness=0.3, gloss=0.03)
    with using(LLVM) as mi:
        bsdf = mi.load_dict(surface_bsdf(part, material))
        for side in (1, -1):
            assert_tabled(by_sphere(bsdf, side), replace(material, transmittance=(0.0, 0.0, 0.0)), RGB)
