"""The golden stand: how it is built, rendered, kept, and compared."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from forestgen.community.simulation import final_population
from forestgen.core.progress import Silent, Timings
from forestgen.dataset.exr import read_exr, write_exr
from forestgen.dataset.png import write_png
from forestgen.dataset.settings import class_map
from forestgen.labels.channels.channel import ChannelView, add_channels
from forestgen.labels.labelled import LabelledFrame, label_frame
from forestgen.recipe.load import load_recipe
from forestgen.render.frame import Frame
from forestgen.render.identity import SceneTracer
from forestgen.render.rendering import render_frame
from forestgen.scene.build import BuiltScene, build_scene
from forestgen.scene.plan import Plan, make_plan
from forestgen.scene.plant_measures import PlantMeter
from forestgen.scene.spec import SceneSpec
from support.ztest import Comparison, NoisyImage, welch, welch_blocks

HERE = Path(__file__).parent
RECIPE = HERE / "stand.yaml"
REFERENCE = HERE / "stand.exr"
SUMS = HERE / "SHA256SUMS"
FAILURES = HERE.parents[1] / "outputs" / "golden-failures"
REFERENCE_SEED, TEST_SEED = 1, 2  # of radiance: the test's noise is its own, so that it is a test of statistics
# Of both families of tests together; a fresh seed fails wrongly this often.
SIGNIFICANCE = 0.001
# Root of the mean variance over the mean radiance; 0.015 at 256 samples in eight slices. More noise, less power.
NOISE_BOUND = 0.022


def build() -> tuple[Plan, BuiltScene]:
    loaded = load_recipe(RECIPE)
    plan = make_plan(loaded.draw(0))
    return plan, build_scene(plan, final_population(plan.community, Silent()), Silent(), Timings())


def shoot(plan: Plan, built: BuiltScene, seed: int) -> LabelledFrame:
    tracer = SceneTracer(built.spec, Timings())
    frame = render_frame(tracer, built.spec.cameras[0], plan.drawn.recipe, seed, Silent(), Timings())
    channels = plan.drawn.recipe.labels.channels
    frame = add_channels(frame, channels, ChannelView(tracer, None, Silent(), Timings()))
    measures = PlantMeter(built.spec.exemplars).measure(built.spec.instances)
    return label_frame(frame, built.population, class_map(plan.drawn), measures, channels)


def without(built: BuiltScene, plant_id: int) -> BuiltScene:
    """The same scene with one plant less; the others keep their place, shape and turn."""
    kept = built.spec.instances.plant_id != plant_id
    columns = ("plant_id", "species", "position_m", "radius_m", "height_m", "age_yr", "status")
    population, instances = built.population, built.spec.instances
    spec: SceneSpec = replace(
        built.spec,
        instances=replace(
            instances,
            exemplar=instances.exemplar[kept],
            transform=instances.transform[kept],
            plant_id=instances.plant_id[kept],
        ),
    )
    rest = replace(population, **{name: getattr(population, name)[kept] for name in columns}, columns={})
    return replace(built, spec=spec, population=rest)


def write_reference(shot: LabelledFrame, path: Path = REFERENCE, sums: Path = SUMS) -> None:
    write_exr(path, shot, {"golden": "tests/golden/regenerate.py"})
    sums.write_text(f"{digest(path)}  {path.name}\n", encoding="utf-8")


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@dataclass(frozen=True)
class Verdict:
    """What differs from the reference."""

    pixels: Comparison
    blocks: Comparison
    wrong_instance: NDArray[np.bool_]  # (H, W)
    wrong_part: NDArray[np.bool_]  # (H, W)
    noise: float

    @property
    def radiance_passes(self) -> bool:
        return self.pixels.equal and self.blocks.equal

    @property
    def identity_passes(self) -> bool:
        return not (self.wrong_instance.any() or self.wrong_part.any())

    def describe(self) -> str:
        pixels, blocks = (int(test.rejected.any(axis=2).sum()) for test in (self.pixels, self.blocks))
        z_pixels, z_blocks = (float(np.abs(test.statistic).max()) for test in (self.pixels, self.blocks))
        return (
            f"{pixels} pixels and {blocks} blocks of radiance differ (largest z {z_pixels:.1f} and {z_blocks:.1f});"
            f" {int(self.wrong_instance.sum())} pixels of the instance mask and {int(self.wrong_part.sum())} of the"
            f" part mask differ; noise {self.noise:.3f}, at most {NOISE_BOUND}"
        )


def noise_of(frame: Frame) -> float:
    return float(np.sqrt(frame.radiance.variance.mean()) / frame.radiance.mean.mean())


def compare(shot: LabelledFrame, reference: Path = REFERENCE, sums: Path = SUMS) -> Verdict:
    """Raises `AssertionError` when there is no reference or it is not the pinned one."""
    how = "make one: uv run python tests/golden/regenerate.py"
    assert reference.is_file(), f"no golden reference at {reference}; {how}"
    assert f"{digest(reference)}  {reference.name}\n" in sums.read_text(encoding="utf-8"), (
        f"{reference.name} is not the reference that {sums.name} pins; {how}"
    )
    parts = read_exr(reference)
    mean, variance = (np.stack([parts[name][c] for c in "RGB"], axis=-1) for name in ("radiance", "radiance.variance"))
    golden = NoisyImage(mean.astype(np.float64), variance.astype(np.float64))
    frame, labels = shot.frame, shot.pixels
    image = NoisyImage(frame.radiance.mean.astype(np.float64), frame.radiance.variance.astype(np.float64))
    return Verdict(
        pixels=welch(image, golden, SIGNIFICANCE / 2),
        blocks=welch_blocks(image, golden, SIGNIFICANCE / 2),
        wrong_instance=labels.instance != parts["identity"]["plant_id"],
        wrong_part=labels.part != parts["identity"]["part"],
        noise=noise_of(frame),
    )


def save_failure(shot: LabelledFrame, verdict: Verdict, folder: Path = FAILURES) -> Path:
    """Pictures of what came out, what was wanted, and where they differ."""
    folder.mkdir(parents=True, exist_ok=True)
    write_exr(folder / "stand.exr", shot, {"golden": "failure"})
    pictures = {"radiance": tone(shot.frame.radiance.mean)}
    if REFERENCE.is_file():
        parts = read_exr(REFERENCE)["radiance"]
        pictures["reference"] = tone(np.stack([parts[c] for c in "RGB"], axis=-1))
    z = np.clip(np.abs(verdict.pixels.statistic).max(axis=2) / 8, 0, 1)
    blocks = np.kron(np.clip(np.abs(verdict.blocks.statistic).max(axis=2) / 8, 0, 1), np.ones((8, 8)))
    height, width = z.shape
    pictures["z-pixels"] = grey(z)
    pictures["z-blocks"] = grey(blocks[:height, :width])
    pictures["wrong-identity"] = grey((verdict.wrong_instance | verdict.wrong_part).astype(float))
    for name, picture in pictures.items():
        write_png(folder / f"{name}.png", picture)
    (folder / "verdict.txt").write_text(verdict.describe() + "\n", encoding="utf-8")
    return folder


def tone(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    scaled = np.clip(linear / (np.quantile(linear, 0.98) + 1e-9), 0, 1)
    return np.round(255 * scaled ** (1 / 2.2)).astype(np.uint8)


def grey(share: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.repeat(np.round(255 * share).astype(np.uint8)[..., None], 3, axis=2)
