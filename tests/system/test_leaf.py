"""A leaf's reflectance R and transmittance T, by integration over both hemispheres, against its material.

Measured: T exact, R +0.5% at normal incidence, +0.8% at 60 degrees, +2.2% at 75, on both sides (the reflecting lobe of
`principledthin` is not quite Lambertian).
"""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.render.build import leaf_bsdf
from forestgen.render.variant import LLVM, drjit, mitsuba
from forestgen.scene.spec import Material

LEAVES = {
    "poplar": Material((0.060, 0.115, 0.038), (0.048, 0.100, 0.020)),
    "near infrared": Material((0.45, 0.45, 0.50), (0.45, 0.40, 0.45)),
    "white petal": Material((0.70, 0.68, 0.60), (0.25, 0.20, 0.15)),
    "opaque": Material((0.30, 0.20, 0.10)),
    "thin": Material((0.02, 0.02, 0.02), (0.80, 0.60, 0.40)),
    "black": Material((0.0, 0.0, 0.0)),
}
ANGLES_DEG = (0, 30, 60)


def interaction(angle_deg: float, side: int, count: int):
    mi, dr = mitsuba(), drjit()
    angle = np.radians(angle_deg)
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.wi = mi.Vector3f(float(np.sin(angle)), 0.0, float(side * np.cos(angle)))
    return si


def integrate(bsdf, angle_deg: float, side: int, steps: int = 256) -> tuple[np.ndarray, np.ndarray]:
    """((3,) R, (3,) T) for light from `side` (+1 is the upper side): midpoints in the cosine and in the azimuth."""
    mi = mitsuba()
    cosine, azimuth = np.meshgrid((np.arange(steps) + 0.5) / steps, (np.arange(2 * steps) + 0.5) / steps * np.pi)
    cosine, azimuth = cosine.ravel(), azimuth.ravel()
    sine = np.sqrt(1 - cosine**2)
    si = interaction(angle_deg, side, len(cosine))
    shares = []
    for hemisphere in (side, -side):
        wo = mi.Vector3f(sine * np.cos(azimuth), sine * np.sin(azimuth), hemisphere * cosine)
        value = np.array(bsdf.eval(mi.BSDFContext(), si, wo), dtype=np.float64)  # includes the cosine
        shares.append(value.mean(axis=1) * 2 * np.pi)
    return shares[0], shares[1]


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("leaf", LEAVES)
def test_reflectance_and_transmittance_are_the_materials(leaf, side):
    mi = mitsuba()
    material = LEAVES[leaf]
    with mi.variant_context(LLVM):
        bsdf = mi.load_dict(leaf_bsdf(material))
        for angle in ANGLES_DEG:
            r, t = integrate(bsdf, angle, side)
            np.testing.assert_allclose(r, material.reflectance, rtol=0.009, atol=1e-6)
            np.testing.assert_allclose(t, material.transmittance, rtol=0.001, atol=1e-6)


def test_energy_is_conserved():
    mi = mitsuba()
    with mi.variant_context(LLVM):
        bsdf = mi.load_dict(leaf_bsdf(Material((0.6, 0.5, 0.4), (0.38, 0.48, 0.58))))
        for angle in (0, 30, 60, 75):
            r, t = integrate(bsdf, angle, 1)
            assert np.all(r + t <= 1.0)


@pytest.mark.parametrize("side", [1, -1])
def test_sampled_paths_carry_what_the_integral_says(side):
    """The path tracer samples; its mean weights by hemisphere are R and T too."""
    mi, dr = mitsuba(), drjit()
    material = LEAVES["poplar"]
    count = 1 << 18
    with mi.variant_context(LLVM):
        bsdf = mi.load_dict(leaf_bsdf(material))
        for angle in ANGLES_DEG:
            rng = np.random.default_rng(angle)
            one, two = mi.Float(rng.random(count)), mi.Point2f(rng.random(count), rng.random(count))
            sample, weight = bsdf.sample(mi.BSDFContext(), interaction(angle, side, count), one, two)
            weight = np.nan_to_num(np.array(dr.select(sample.pdf > 0, weight, 0.0), dtype=np.float64))
            same_side = np.array(sample.wo.z) * side > 0
            for share, expected in (
                (same_side, integrate(bsdf, angle, side)[0]),
                (~same_side, integrate(bsdf, angle, side)[1]),
            ):
                carried = weight * share
                error = carried.std(axis=1) / np.sqrt(count)
                assert np.all(np.abs(carried.mean(axis=1) - expected) < 5 * error + 1e-5)
