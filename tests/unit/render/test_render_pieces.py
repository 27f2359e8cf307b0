"""The renderer's small pieces that need no scene."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.geometry.mesh import Mesh
from forestgen.render.denoise import _exposure, denoise
from forestgen.render.identity import face_normals, hit_tables, sample_offsets
from forestgen.render.rendering import slice_sizes
from support.scenes import plain_ground, scattered_scene


@pytest.mark.parametrize("samples", [1, 4, 9, 16, 256])
def test_sample_offsets_are_a_centred_grid(samples):
    offset = sample_offsets(samples)
    assert offset.shape == (samples, 2)
    assert len(np.unique(offset, axis=0)) == samples
    assert np.all((offset > 0) & (offset < 1))
    np.testing.assert_allclose(offset.mean(axis=0), 0.5)


def test_sample_offsets_want_a_square():
    with pytest.raises(ValueError, match="perfect square, got 8"):
        sample_offsets(8)


@pytest.mark.parametrize("samples", [1, 2, 7, 8, 9, 64, 100])
def test_slices_hold_all_samples_in_nearly_equal_parts(samples):
    sizes = slice_sizes(samples)
    assert sum(sizes) == samples
    assert max(sizes) - min(sizes) <= 1
    assert len(sizes) == {1: 1, 100: 4}.get(samples, 2)


def test_face_normals_follow_the_winding_and_a_degenerate_face_has_none():
    corners = np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0], [4, 0, 0]], dtype=np.float32)
    normals = face_normals(Mesh(corners, np.array([[0, 1, 2], [0, 2, 1], [0, 1, 3]], dtype=np.uint32)))
    np.testing.assert_array_equal(normals, [[0, 0, 1], [0, 0, -1], [0, 0, 0]])


def test_hit_tables_are_flat_and_in_order():
    spec = scattered_scene(12, exemplars=3, leaves=10, terrain=plain_ground(-5, 5))
    tables = hit_tables(spec)
    assert tables.plant_id.tolist() == [0, *range(1, 13)]
    assert len(tables.part) == 1 + 2 * 3
    for index, exemplar in enumerate(spec.exemplars):
        for number, organ in enumerate(exemplar.organs):
            entry = 1 + 2 * index + number
            assert tables.part[entry] == organ.part
            first = tables.first_face[entry]
            np.testing.assert_array_equal(tables.normal[first : first + organ.mesh.triangles], face_normals(organ.mesh))
    np.testing.assert_array_equal(tables.first_organ[1:], 1 + 2 * spec.instances.exemplar)


@pytest.mark.parametrize("brightness", [1e-4, 1.0, 300.0])
def test_exposure_is_0_18_over_the_brightness(brightness):
    assert _exposure(np.full((37, 50, 3), brightness, np.float32)) == pytest.approx(0.18 / brightness, rel=1e-4)


def test_exposure_is_a_geometric_mean_over_blocks_and_survives_black():
    colour = np.full((16, 32, 3), 1.0, np.float32)
    colour[:, 16:] = 4.0
    assert _exposure(colour) == pytest.approx(0.18 / 2.0, rel=1e-4)
    assert _exposure(np.zeros((20, 20, 3), np.float32)) == 1.0


def test_the_denoiser_keeps_the_mean_and_removes_noise():
    rng = np.random.default_rng(0)
    clean = np.ones((64, 64, 3), np.float32) * [0.2, 0.5, 0.9]
    noisy = (clean * rng.gamma(4, 0.25, clean.shape)).astype(np.float32)
    result = denoise(noisy)
    assert np.std(result - clean) < 0.2 * np.std(noisy - clean)
    np.testing.assert_allclose(result.mean(axis=(0, 1)), noisy.mean(axis=(0, 1)), rtol=0.02)


def test_the_denoiser_follows_brightness():
    """Scaling the image by 1000 scales the result: exposure is found, not assumed."""
    noisy = np.random.default_rng(1).gamma(4, 0.25, (48, 48, 3)).astype(np.float32)
    np.testing.assert_allclose(denoise(noisy * 1024) / 1024, denoise(noisy), rtol=2e-3)
