"""Canopies of leaves strewn at random, against the theory of plant stands.

Gaps follow Poisson's law. Reflectance follows the equations of two streams, which level leaves obey exactly, and for
other leaf angles the turbid medium of Ross, solved here by discrete ordinates. Leaves are squares of 0.0035 to 0.004 of
the layer's depth: finite leaves are brighter than the turbid medium by about their size over that depth times the
leaf area index, here under 1% (measured with level leaves, index 3: +1.4% at 0.01, +0.5% ± 0.4% at 0.003).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.core.progress import Timings
from forestgen.render.build import load, origin_of, scene_dict
from forestgen.render.capture import capture
from forestgen.render.identity import SceneTracer, sample_offsets, trace_identity
from forestgen.render.surfaces import SpectralBsdfs
from forestgen.render.variant import SCALAR, using
from forestgen.scene.projection import rays, world_rays
from forestgen.scene.spec import Material, SceneSpec, Terrain
from support.radiometry import Mean, Square, flux_through, path_integrator, upper_sky
from support.scenes import camera_at, plain_ground
from support.turbid import (
    ERECTOPHILE,
    PLANOPHILE,
    SPHERICAL,
    Angles,
    Leaves,
    discrete_ordinates,
    projection,
    strew,
    tiled,
    two_streams,
)

ANGLES = {"spherical": SPHERICAL, "planophile": PLANOPHILE, "erectophile": ERECTOPHILE, "level": None}
# Near infrared and red of RAMI's homogeneous canopies, and a leaf that lets through more than it reflects.
LEAF_R, LEAF_T = np.array([0.4957, 0.0546, 0.20]), np.array([0.4409, 0.0149, 0.60])
SOIL = np.array([0.159, 0.127, 0.60])
HALF_EXTENT_M = 30.0  # of the canopy, whose depth is 1: light from 88 degrees and more may pass its edge


def slow(*values):
    return pytest.param(*values, marks=pytest.mark.slow)


def ground(albedo: np.ndarray) -> Terrain:
    plain = plain_ground(-40, 40, albedo=1.0)
    lower = plain.mesh.vertices_m - np.float32([0, 0, 0.01])
    return replace(plain, mesh=replace(plain.mesh, vertices_m=lower), texture=plain.texture * np.float32(albedo))


def canopy(index: float, angles: Angles | None, soil: np.ndarray, *, side: float, light: dict, width: float = 0.5):
    """A loaded scene: a slab of depth 1 on soil."""
    leaves = strew(index, side, width, 1.0, angles, np.random.default_rng(5), exact=True)
    material = Material(tuple(LEAF_R), tuple(LEAF_T))
    tiles = int(2 * HALF_EXTENT_M / width) | 1
    spec = tiled(leaves, material, tiles, ground(soil), camera_at((0, 0, 3), (0, 0.01, 0), (8, 8)))
    return load({**scene_dict(spec, np.zeros(3), SpectralBsdfs()), "light": light}), width


def reflectance(scene, width: float, irradiance: float, rays: int, seed: int) -> Mean:
    top = Square(width / 2, 1.001)
    return flux_through(scene, path_integrator(), top, upward=True, rays=rays, seed=seed) * (1 / irradiance)


def sun(zenith_deg: float) -> dict:
    zenith = np.radians(zenith_deg)
    return {
        "type": "directional",
        "direction": [-float(np.sin(zenith)), 0.0, -float(np.cos(zenith))],
        "irradiance": 1.0,
    }


def assert_agrees(seen: Mean, theory: np.ndarray, finite: float, sigmas: float = 3.5) -> None:
    """Within the noise and what leaves' finite size may add."""
    assert np.all(seen.error < 0.01 * theory)
    off = seen.value - theory
    assert np.all(off > -sigmas * seen.error), off / seen.error
    assert np.all(off < sigmas * seen.error + finite * theory), (off / seen.error, off / theory)


@pytest.mark.parametrize("zenith_deg", [0, 30, 60])
@pytest.mark.parametrize("angles", ["spherical", "planophile", "erectophile", "level"])
def test_gaps_along_rays(angles, zenith_deg):
    """P = exp(-G LAI / cos theta), from 192 independent canopies; leaves of any size obey it."""
    index, zenith, rng = 1.5, np.radians(zenith_deg), np.random.default_rng([zenith_deg, 1])
    direction = np.array([np.sin(zenith), 0.0, np.cos(zenith)])
    kind = ANGLES[angles]
    gaps = []
    for _ in range(192):
        leaves = strew(index, 0.06, 1.0, 1.0, kind, rng)
        gaps.append(np.mean(leaves.crossings(rng.random((32, 2)), direction) == 0))
    g = np.cos(zenith) if kind is None else 0.5 if kind is SPHERICAL else projection(float(np.cos(zenith)), kind)
    error = np.std(gaps, ddof=1) / np.sqrt(len(gaps))
    assert error < 0.02
    assert abs(np.mean(gaps) - np.exp(-g * index / np.cos(zenith))) < 3 * error


def looking_up(leaves: Leaves, pixels: int) -> SceneSpec:
    """A fisheye under the slab's middle; leaves are black."""
    upward = camera_at((0, 0, -0.3), (0, 1e-3, 2), (pixels, pixels))
    camera = replace(upward, projection="fisheye", hfov_deg=180.0)
    lower = plain_ground(-40, 40)
    sunk = lower.mesh.vertices_m - np.float32([0, 0, 1])
    return tiled(
        leaves, Material((0.0, 0.0, 0.0)), 1, replace(lower, mesh=replace(lower.mesh, vertices_m=sunk)), camera
    )


def gaps_by_identity(spec: SceneSpec, samples: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """(N,) zenith angles of the identity pass' samples in a fisheye's circle, and whether they see no plant."""
    camera, timings = spec.cameras[0], Timings()
    tracer = SceneTracer(spec, timings)
    identity, _ = trace_identity(tracer, camera, samples=samples, timer=timings, advance=lambda rows: None)
    offset, width = sample_offsets(samples), camera.size_px[0]
    x, y = np.arange(width)[None, :, None] + offset[:, 0], np.arange(width)[:, None, None] + offset[:, 1]
    found = rays(camera, *np.broadcast_arrays(x, y))
    zenith = np.arccos(np.clip((found.direction @ camera.world_from_camera.T)[..., 2], -1, 1))
    return zenith[found.valid], identity.plant_id[found.valid] == 0


def gaps_by_radiance(spec: SceneSpec) -> tuple[np.ndarray, np.ndarray]:
    """(N,) zenith angles of a fisheye's pixels, and their radiance under a sky of radiance 1."""
    camera = spec.cameras[0]
    with using(SCALAR) as mi:
        scene = load({**scene_dict(spec, origin_of(camera), SpectralBsdfs()), "light": upper_sky()})
        image = capture(mi.load_dict({"type": "path", "max_depth": 2}), scene, camera, samples=4, seed=1)
    found = world_rays(camera)
    return np.arccos(np.clip(found.direction[..., 2], -1, 1))[found.valid], image[..., 0][found.valid]


@pytest.mark.parametrize(
    ("seen", "angles"),
    [
        (gaps_by_identity, "spherical"),
        slow(gaps_by_radiance, "spherical"),
        slow(gaps_by_identity, "planophile"),
        slow(gaps_by_radiance, "planophile"),
    ],
)
def test_gaps_in_a_fisheye(seen, angles):
    """Rings of 10 degrees of 12 independent hemispherical pictures: labels and light both see Poisson's gaps."""
    index, kind, edges = 1.2, ANGLES[angles], np.radians(np.arange(0, 71, 10))
    shares, expected = [], []
    for number in range(12):
        leaves = strew(index, 0.06, 7.4, 1.0, kind, np.random.default_rng([number, 99]))
        zenith, gap = seen(looking_up(leaves, 48))
        ring = np.digitize(zenith, edges) - 1
        shares.append([gap[ring == k].mean() for k in range(len(edges) - 1)])
        if not expected:
            cosine = [np.cos(zenith[ring == k]) for k in range(len(edges) - 1)]
            expected = [np.mean(np.exp(-extinction(kind, c) * index / c)) for c in cosine]
    error = np.std(shares, axis=0, ddof=1) / np.sqrt(len(shares))
    assert np.all(error < 0.04)
    assert np.all(np.abs(np.mean(shares, axis=0) - expected) < 3 * error)


def extinction(kind: Angles, cosine: np.ndarray) -> np.ndarray:
    grid = np.linspace(0.05, 1.0, 40)
    return np.interp(cosine, grid, [projection(float(c), kind) for c in grid])


def test_the_projection_of_spherical_leaves_is_a_half():
    for cosine in (0.1, 0.5, 1.0):
        assert projection(cosine, SPHERICAL) == pytest.approx(0.5, abs=1e-4)


@pytest.mark.parametrize(("index", "soil"), [slow(1.0, 0.0), slow(3.0, 0.0), slow(1.0, 1.0), (3.0, 1.0)])
def test_level_leaves_reflect_as_two_streams_do(index, soil):
    """Under a sky of one radiance, over black soil and over soil that reflects."""
    with using(SCALAR):
        scene, width = canopy(index, None, SOIL * soil, side=0.0035, light=upper_sky())
        seen = reflectance(scene, width, np.pi, 32000, seed=3)
    layer = two_streams(index, LEAF_R, LEAF_T)
    assert_agrees(seen, layer.over(SOIL * soil, layer), finite=0.01)


@pytest.mark.parametrize("zenith_deg", [slow(0), 70])
@pytest.mark.slow
def test_level_leaves_reflect_sunlight_of_any_angle_alike(zenith_deg):
    with using(SCALAR):
        scene, width = canopy(2.0, None, SOIL, side=0.0035, light=sun(zenith_deg))
        seen = reflectance(scene, width, float(np.cos(np.radians(zenith_deg))), 32000, seed=4)
    layer = two_streams(2.0, LEAF_R, LEAF_T)
    assert_agrees(seen, layer.over(SOIL, layer), finite=0.01)


@pytest.mark.parametrize("angles", ["spherical", slow("planophile"), slow("erectophile")])
def test_turbid_canopies_reflect_as_discrete_ordinates_say(angles):
    """Leaves and soil of RAMI's homogeneous canopies, leaf area index 3, under a sky of one radiance."""
    with using(SCALAR):
        scene, width = canopy(3.0, ANGLES[angles], SOIL, side=0.004, light=upper_sky())
        seen = reflectance(scene, width, np.pi, 32000, seed=6)
    diffuse = [discrete_ordinates(3.0, r, t, ANGLES[angles], steps=16)[2] for r, t in zip(LEAF_R, LEAF_T, strict=True)]
    theory = np.array([layer.over(soil, layer) for layer, soil in zip(diffuse, SOIL, strict=True)])
    assert_agrees(seen, theory, finite=0.01)


@pytest.mark.parametrize("zenith_deg", [slow(20), 50])
@pytest.mark.slow
def test_a_turbid_canopy_under_the_sun(zenith_deg):
    """The sun's angles of RAMI's homogeneous canopies, spherical leaf angles."""
    with using(SCALAR):
        scene, width = canopy(3.0, SPHERICAL, SOIL, side=0.004, light=sun(zenith_deg))
        seen = reflectance(scene, width, float(np.cos(np.radians(zenith_deg))), 32000, seed=7)
    theory = []
    for r, t, soil in zip(LEAF_R, LEAF_T, SOIL, strict=True):
        cosine, directional, diffuse = discrete_ordinates(3.0, r, t, SPHERICAL, steps=16)
        value = directional.over(soil, diffuse)
        theory.append(np.interp(np.cos(np.radians(zenith_deg)), cosine, value))
    assert_agrees(seen, np.array(theory), finite=0.01)


def test_the_theories_agree_and_conserve_energy():
    for index, r, t in ((1.0, 0.4, 0.3), (3.0, 0.05, 0.015)):
        flat = discrete_ordinates(index, r, t, lambda angle: np.exp(-((angle / 0.02) ** 2)), steps=18)[2]
        exact = two_streams(index, np.array(r), np.array(t))
        assert flat.reflected == pytest.approx(exact.reflected, rel=2e-3)
        assert flat.transmitted == pytest.approx(exact.transmitted, rel=2e-3)
    white = discrete_ordinates(2.0, 0.3, 0.7, ERECTOPHILE, steps=18)[1]
    np.testing.assert_allclose(white.reflected + white.transmitted, 1.0, atol=1e-5)
