"""The same recipe, seed and versions give the same bytes, however many threads work: clouds, denoiser, all writers.

Two things would break it, and each has its place: Mitsuba halves its render blocks until every thread has one, and each
block has a random stream of its own (`BLOCK_PX` in render/variant.py), and the denoiser's automatic exposure sums in
parallel (`_exposure` in render/denoise.py).
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys

import numpy as np
import pytest

from forestgen.render.denoise import denoise
from forestgen.render.variant import drjit, mitsuba

RECIPE = """\
forestgen: 1
seed: 7
site: {size_m: [14, 14], terrain: rolling, ground: soil_wet}
species: {fireweed: , poplar: , spruce: }
community: {model: multiset_lsystem, program: succession, steps: 36}
plants: {exemplars_per_species: 1}
sky: {clouds: {type: noise, extent_m: 1500}}
cameras: [{position_m: [7, -5, 2], look_at_m: [7, 7, 3], size_px: [48, 27]}]
render: {samples: 9}
labels: {samples: 4}
"""
OF_THE_RUN = ("run", ".forestgen", "report.html")  # and not of its results


def run(recipe, folder, threads: int, hash_seed: str) -> dict[str, bytes]:
    """Files of a run in a process of its own: relative path -> content, without those that tell how it went."""
    command = [sys.executable, "-m", "forestgen", "render", str(recipe), "-o", str(folder), "--threads", str(threads)]
    environment = {**os.environ, "PYTHONHASHSEED": hash_seed, "OPENBLAS_NUM_THREADS": str(threads)}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    files = {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    return {path.as_posix(): content for path, content in files.items() if path.parts[0] not in OF_THE_RUN}


def assert_equal_runs(recipe_text: str, folder, threads: tuple[int, ...]) -> None:
    recipe = folder / "stand.yaml"
    recipe.write_text(recipe_text, encoding="utf-8")
    first, *others = (run(recipe, folder / f"run{k}", count, str(k)) for k, count in enumerate(threads))
    assert {"dataset.json", "train/classes.json", "train/coco.json", "train/manifest.json"} < set(first)
    assert any(name.endswith("frame.exr") for name in first)
    for other in others:
        assert set(first) == set(other)
        assert [name for name in sorted(first) if first[name] != other[name]] == []


@pytest.mark.slow
def test_the_same_recipe_gives_the_same_bytes_with_one_and_two_threads(tmp_path):
    assert_equal_runs(RECIPE, tmp_path, (1, 2))


@pytest.mark.slow
def test_the_same_recipe_gives_the_same_bytes_with_any_number_of_threads(tmp_path):
    larger = RECIPE
    for less, more in {"[48, 27]": "[160, 90]", "per_species: 1": "per_species: 3", "soil_wet": "litter"}.items():
        assert less in larger
        larger = larger.replace(less, more)
    assert_equal_runs(larger, tmp_path, (1, 2, 2, 5, 16))


@pytest.mark.slow
def test_the_recipe_has_no_say_in_threads(tmp_path):
    """Or two runs that differ in threads alone would differ in recipe hash and stored recipe."""
    recipe = tmp_path / "stand.yaml"
    recipe.write_text(RECIPE.replace("samples: 9", "threads: 2"), encoding="utf-8")
    command = [sys.executable, "-m", "forestgen", "validate", str(recipe)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "threads" in done.stderr


def test_the_denoiser_does_not_depend_on_threads():
    """In one process per thread count, since the denoiser keeps the pool that it was made with."""
    program = (
        "import sys, hashlib, numpy as np\n"
        "from forestgen.render.variant import mitsuba; mitsuba(int(sys.argv[1]))\n"
        "from forestgen.render.denoise import denoise\n"
        "rng = np.random.default_rng(0)\n"
        "colour = rng.gamma(1, 1, (61, 97, 3)) * np.linspace(.01, 9, 97)[:, None]\n"
        "colour = colour.astype(np.float32)\n"
        "print(hashlib.sha256(denoise(colour).tobytes()).hexdigest())\n"
    )
    results = {
        subprocess.run([sys.executable, "-c", program, str(n)], capture_output=True, text=True, check=True).stdout
        for n in (1, 7)
    }
    assert len(results) == 1


@pytest.mark.parametrize("threads", [1, 3, 8])
def test_one_render_block_a_thread_or_not(threads):
    """A single block of 16 x 16 pixels, fewer blocks than threads: as with one thread."""
    from shots import radiance

    from support.scenes import plain_ground, scattered_scene

    spec = scattered_scene(5, size_m=10, exemplars=2, leaves=50, size_px=(16, 16), terrain=plain_ground(-40, 60))
    before = drjit().thread_count()
    try:
        mitsuba(1)
        alone = radiance(spec, 8, seed=3)
        mitsuba(threads)
        together = radiance(spec, 8, seed=3)
    finally:
        mitsuba(before)
    np.testing.assert_array_equal(alone.mean, together.mean)
    np.testing.assert_array_equal(alone.variance, together.variance)


def test_denoising_twice_is_denoising_once_and_again():
    colour = np.random.default_rng(1).gamma(1, 1, (40, 50, 3)).astype(np.float32)
    digests = {hashlib.sha256(denoise(colour).tobytes()).hexdigest() for _ in range(3)}
    assert len(digests) == 1
