"""Golden render of a small stand: masks exactly, radiance by z-tests per pixel and per 8 x 8 block, noise bounded.

After a wanted change: `uv run python tests/golden/regenerate.py`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import stand

from forestgen.core.parts import Part


@pytest.fixture(scope="module")
def scene():
    return stand.build()


@pytest.fixture(scope="module")
def shot(scene):
    return stand.shoot(*scene, stand.TEST_SEED)


def test_the_stand_looks_as_it_did(shot):
    verdict = stand.compare(shot)
    if not (verdict.radiance_passes and verdict.identity_passes and verdict.noise <= stand.NOISE_BOUND):
        folder = stand.save_failure(shot, verdict)
        pytest.fail(f"{verdict.describe()}; see {folder}; if wanted: uv run python tests/golden/regenerate.py")


def small_tree(scene, shot) -> int:
    """The tree (no herb) that fills the fewest pixels of the mask, but at least 12 of the 5184."""
    population, labels = scene[1].population, shot.pixels
    trees = population.plant_id[population.species > 0]
    ids, pixels = np.unique(labels.instance[np.isin(labels.instance, trees)], return_counts=True)
    large_enough = pixels >= 12
    return int(ids[large_enough][np.argmin(pixels[large_enough])])


@pytest.mark.slow
def test_one_small_tree_less_fails(scene, shot):
    plan, built = scene
    gone = small_tree(scene, shot)
    assert (shot.pixels.instance == gone).sum() < 0.02 * shot.pixels.instance.size
    verdict = stand.compare(stand.shoot(plan, stand.without(built, gone), stand.TEST_SEED))
    assert not verdict.identity_passes
    assert not verdict.radiance_passes
    assert verdict.wrong_instance.sum() >= 12


def test_a_noisier_render_fails(shot):
    radiance = replace(shot.frame.radiance, variance=shot.frame.radiance.variance * 4)
    verdict = stand.compare(replace(shot, frame=replace(shot.frame, radiance=radiance)))
    assert verdict.noise > stand.NOISE_BOUND


def test_a_missing_or_swapped_reference_fails(shot, tmp_path):
    with pytest.raises(AssertionError, match=r"no golden reference.*regenerate\.py"):
        stand.compare(shot, reference=tmp_path / "stand.exr")
    stand.write_reference(shot, tmp_path / "stand.exr", tmp_path / "SHA256SUMS")
    with pytest.raises(AssertionError, match="is not the reference that SHA256SUMS pins"):
        stand.compare(shot, reference=tmp_path / "stand.exr")
    itself = stand.compare(shot, reference=tmp_path / "stand.exr", sums=tmp_path / "SHA256SUMS")
    assert itself.radiance_passes
    assert itself.identity_passes


def test_a_failure_leaves_pictures(shot, tmp_path):
    frame, labels = shot.frame, shot.pixels
    broken = replace(
        shot,
        pixels=replace(labels, instance=np.where(labels.part == Part.LEAF, 0, labels.instance)),
        frame=replace(frame, radiance=replace(frame.radiance, mean=frame.radiance.mean * 1.2)),
    )
    verdict = stand.compare(broken)
    assert not verdict.radiance_passes
    assert not verdict.identity_passes
    folder = stand.save_failure(broken, verdict, tmp_path)
    names = {path.name for path in folder.iterdir()}
    assert {"stand.exr", "radiance.png", "reference.png", "z-pixels.png", "z-blocks.png", "wrong-identity.png"} <= names


@pytest.mark.slow
def test_other_seeds_pass_too(scene):
    """The stated rate of false alarms holds for real light paths, whose noise is not normal."""
    verdicts = [stand.compare(stand.shoot(*scene, seed)) for seed in range(100, 120)]
    assert all(verdict.identity_passes for verdict in verdicts)
    assert sum(not verdict.radiance_passes for verdict in verdicts) <= 1
