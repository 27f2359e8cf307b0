"""The cloud label of a camera that stands in fog."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.atmosphere.grid import CloudGrid
from forestgen.atmosphere.optical_depth import cloud_opacity, optical_depth
from forestgen.scene.projection import world_rays
from support.scenes import camera_at

TOP_M, HALF_M, PER_M = 60.0, 600.0, 0.01
EYE = (3.0, -8.0, 1.7)


def even_fog() -> CloudGrid:
    """On the ground, and on into it."""
    fog = np.full((21, 40, 40), PER_M, dtype=np.float32)
    return CloudGrid(fog, (-HALF_M, -HALF_M, -45.0), (HALF_M, HALF_M, TOP_M))


def test_what_stands_in_fog_is_veiled_by_its_distance() -> None:
    rays = world_rays(camera_at(EYE, (3.0, 60.0, 4.0), (24, 16)))
    distance = np.linspace(0.5, 120.0, 24 * 16).reshape(16, 24).astype(np.float32)
    height = EYE[2] + distance * rays.direction[..., 2]
    assert height.min() > -45.0
    assert height.max() < TOP_M
    veil = cloud_opacity(even_fog(), rays.origin_m, rays.direction, distance)
    np.testing.assert_allclose(veil, -np.expm1(-PER_M * distance.astype(float)), rtol=1e-5)


def test_the_sky_is_veiled_up_to_the_fogs_top_and_sides() -> None:
    rays = world_rays(camera_at(EYE, (3.0, 60.0, 40.0), (24, 16)))
    d = rays.direction
    assert (d[..., 2] > 0).all()
    with np.errstate(divide="ignore"):
        to_side = [((np.sign(d[..., k]) * HALF_M) - EYE[k]) / d[..., k] for k in (0, 1)]
    out = np.minimum((TOP_M - EYE[2]) / d[..., 2], np.minimum(*to_side))
    veil = cloud_opacity(even_fog(), rays.origin_m, d, np.full(d.shape[:2], np.inf, dtype=np.float32))
    np.testing.assert_allclose(veil, -np.expm1(-PER_M * out), rtol=1e-5)


def test_fog_of_varying_density_is_summed_from_the_eye_on() -> None:
    """As fine steps find it; and from eye to sky is from sky's end to eye."""
    rng = np.random.default_rng(2)
    fog = CloudGrid(rng.uniform(0, 0.03, (12, 30, 30)).astype(np.float32), (-150, -150, 0), (150, 150, 60))
    eye = np.array(EYE)
    for _ in range(20):
        towards = rng.normal(size=3) * [1, 1, 0.1]
        towards /= np.linalg.norm(towards)
        towards[2] = abs(towards[2])
        length = rng.uniform(5, 100)
        step = length / 4000
        points = eye + (np.arange(4000)[:, None] + 0.5) * step * towards
        forwards = optical_depth(fog, eye, towards[None], np.array([length]))[0]
        backwards = optical_depth(fog, eye + length * towards, -towards[None], np.array([length]))[0]
        assert forwards == pytest.approx(backwards, rel=1e-9)
        assert forwards == pytest.approx(_by_points(fog, points).sum() * step, rel=1e-4)


def _by_points(fog: CloudGrid, points: np.ndarray) -> np.ndarray:
    from scipy.ndimage import map_coordinates

    place = (points - np.array(fog.low_m)) / fog.cell_m - 0.5
    return map_coordinates(fog.extinction_per_m, place[:, ::-1].T, order=1, mode="nearest", output=np.float64)
