"""Cost of light: `uv run python benchmarks/radiance.py [--peer-python PATH] [--quick]`; exits 1 if a bound is missed.

All images come from `render_radiance`, as the pipeline calls it. Seconds are of all processors, without building the
scene. `--quick`: small sizes, no bounds. `--only PART`: one of cycles, spectral, noise, denoise.

1. cycles: a stand of at least 10,000 instances at 64 samples a pixel, by turns with Blender Cycles on the same scene:
   the same triangles, matt surfaces of one colour each, sky map, sun and camera, up to 64 scatterings, box filter, no
   clamping, no adaptive sampling, no denoising. Cycles renders with and without its light tree, and with and without
   light samples of the sky; its best counts. Its seconds are the slope from 1 to 64 samples of a scene that it keeps:
   neither its set-up nor its files count. The variance is that of the luminance over repetitions with other seeds,
   mean of the pixels, over the squared mean luminance, both of pixels that see no sky. Efficiency is
   1 / (variance x seconds). Bound: 1.3 times Cycles'. Void, and missed, unless both agree on the mean within 1% and on
   the image's blocks.
2. spectral: the quickstart's stand, in colour and by wavelengths at the same samples. Bound: 2.5 times the seconds.
3. noise: three views to three targets each, several seeds. The error that an image has at the end is that of the
   scatter over the seeds, which needs no trust in the image's own estimate; it falls as 1 / sqrt(samples), which gives
   the least samples that the target needs. Bound: on average under 10% more samples than that, nor 10% too few.
4. denoise: the same views at 16 samples, denoised, against 128 raw ones and a reference. Error is relative: squared
   difference over the reference squared (a pixel darker than a tenth of the mean counts as that tenth), less the
   variance of the reference itself; and PSNR of tone-mapped values. Bound: lower relative error on every view.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
from cycles_peer import WAYS, Cycles, scene_of
from numpy.typing import NDArray

from forestgen.community.simulation import final_population
from forestgen.core.frames import look_at
from forestgen.core.parts import Part
from forestgen.core.progress import Silent, Timings
from forestgen.geometry.mesh import Mesh
from forestgen.recipe.load import load_recipe
from forestgen.render.denoise import denoise
from forestgen.render.frame import Identity, Radiance, RenderJob, StoppingCriterion
from forestgen.render.identity import SceneTracer, trace_identity
from forestgen.render.rendering import Estimate, noise_of, render_radiance
from forestgen.render.variant import drjit, mitsuba
from forestgen.render.wavelengths import Mode
from forestgen.scene.build import build_scene
from forestgen.scene.plan import make_plan
from forestgen.scene.spec import Camera, SceneSpec
from support.guides import trace_guides

RECIPE = Path(__file__).parents[1] / "recipes" / "quickstart.yaml"
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
CYCLES_BOUND, SPECTRAL_BOUND, WASTE_BOUND = 1.3, 2.5, 0.10
MOST_MEAN_DIFFERENCE, MOST_BLOCK_DIFFERENCE, BLOCKS = 0.01, 0.03, 12
LEAST_INSTANCES = 10_000
MAKE_PEER = "uv venv -p 3.11 cycles && uv pip install -p cycles bpy==5.0.1, then --peer-python cycles/bin/python"

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Sizes:
    stand_m: float = 274.0
    cycles_px: tuple[int, int] = (256, 144)
    samples: int = 64
    repetitions: int = 3
    spectral_px: tuple[int, int] = (256, 144)
    noise_px: tuple[int, int] = (96, 54)
    targets: tuple[float, ...] = (0.2, 0.14, 0.1)
    seeds: int = 4
    denoise_px: tuple[int, int] = (640, 360)
    reference: int = 256


QUICK = Sizes(90.0, (96, 54), 16, 2, (96, 54), (48, 27), (0.25, 0.2), 3, (96, 54), 256)


class Clock:
    """Seconds of all processors by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        start = process_time()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + process_time() - start


def take(
    spec: SceneSpec, camera: Camera, until: StoppingCriterion, seed: int, mode: Mode = "rgb"
) -> tuple[Radiance, float]:
    """An image, and its seconds of all processors without those of building the scene."""
    clock, start = Clock(), process_time()
    image = render_radiance(RenderJob(spec, camera, until, seed, mode), progress=Silent(), timer=clock)
    return image, process_time() - start - clock.seconds["radiance: build"]


def stand(size_m: float | None) -> SceneSpec:
    """The quickstart's scene under a clear sky, of its own size or another."""
    options = ["sky.clouds=none"]
    if size_m is not None:
        options += [
            f"site.size_m=[{size_m}, {size_m}]",
            f"cameras.0.position_m=[{size_m / 2}, -10, 3.2]",
            f"cameras.0.look_at_m=[{size_m / 2 + 2}, 60, 8]",
        ]
    plan = make_plan(load_recipe(RECIPE, options).draw(0))
    return build_scene(plan, final_population(plan.community, Silent()), Silent(), Timings()).spec


def plain(spec: SceneSpec) -> SceneSpec:
    """As two renderers can have it alike: flat facets of one colour a material, no gloss."""
    exemplars = tuple(
        replace(
            exemplar,
            organs=tuple(replace(o, mesh=Mesh(o.mesh.vertices_m, o.mesh.faces)) for o in exemplar.organs),
        )
        for exemplar in spec.exemplars
    )
    ground = spec.terrain
    mesh = Mesh(ground.mesh.vertices_m, ground.mesh.faces, uv=ground.mesh.uv)
    colour = np.tile(np.asarray(ground.mean_colour, dtype=np.float32), (4, 4, 1))
    return replace(
        spec,
        exemplars=exemplars,
        materials={key: replace(one, texture=None, gloss=0.0) for key, one in spec.materials.items()},
        terrain=replace(ground, mesh=mesh, texture=colour, far_share=np.zeros_like(ground.far_share)),
    )


def views(spec: SceneSpec, size_px: tuple[int, int]) -> tuple[Camera, ...]:
    """The quickstart's own view, one from above, and one at eye level where the stand is most open around."""
    feet = spec.instances.transform[:, :, 3]
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(45, 75, 61), np.linspace(30, 60, 61)))
    away = np.full(len(x), np.inf)
    for foot in feet:
        away = np.minimum(away, np.hypot(x - foot[0], y - foot[1]))
    best = int(np.argmax(away))
    east, north = float(x[best]), float(y[best])
    floor = float(feet[np.argmin(np.hypot(feet[:, 0] - east, feet[:, 1] - north)), 2])
    eye, above = (east, north, floor + 1.7), (60.0, 45.0, floor + 60.0)
    own = replace(spec.cameras[0], size_px=size_px, name="quickstart's")
    return (
        own,
        replace(own, name="from above", position_m=above, world_from_camera=look_at(above, (60.0, 62.0, floor))),
        replace(own, name="eye level", position_m=eye, world_from_camera=look_at(eye, (east + 3, north + 30, eye[2]))),
    )


def identity_of(spec: SceneSpec, camera: Camera, tracer: SceneTracer | None = None) -> Identity:
    tracer = SceneTracer(spec, Timings()) if tracer is None else tracer
    return trace_identity(tracer, camera, samples=16, timer=Timings(), advance=lambda rows: None)[0]


@dataclass(frozen=True)
class Measured:
    """What repetitions of an image say."""

    name: str
    luminance: Floats  # (H, W) mean
    variance: Floats  # (H, W) of one repetition's luminance
    repetitions: int
    seconds: float  # of one
    solid: NDArray[np.bool_]  # (H, W) pixels that count

    @classmethod
    def of(cls, name: str, images: list[NDArray[Any]], seconds: list[float], solid: NDArray[np.bool_]) -> Measured:
        values = np.array(images, dtype=np.float64) @ LUMINANCE
        return cls(name, values.mean(0), values.var(0, ddof=1), len(values), float(np.mean(seconds)), solid)

    @property
    def relative_variance(self) -> float:
        return float(self.variance[self.solid].mean() / self.luminance[self.solid].mean() ** 2)

    @property
    def variance_by_pixel(self) -> float:
        mean = self.luminance[self.solid]
        return float((self.variance[self.solid] / np.maximum(mean, 0.1 * mean.mean()) ** 2).mean())

    @property
    def efficiency(self) -> float:
        return 1.0 / (self.relative_variance * self.seconds)

    def show(self) -> None:
        print(
            f"  {self.name:<36}{self.seconds:8.2f} s, variance {self.relative_variance:.5f} (by pixel "
            f"{self.variance_by_pixel:.4f}), efficiency {self.efficiency:6.2f} (by pixel "
            f"{1 / (self.variance_by_pixel * self.seconds):.3f}), mean {self.luminance[self.solid].mean():.1f} cd/m²"
        )


def agree(ours: Measured, theirs: Measured) -> bool:
    """Whether two renderers made the same image."""
    solid = ours.solid
    means = [one.luminance[solid].mean() for one in (ours, theirs)]
    difference = means[0] / means[1] - 1
    rows, columns = np.indices(solid.shape)
    block = (rows * BLOCKS // solid.shape[0]) * BLOCKS + columns * BLOCKS // solid.shape[1]

    def by_block(values: Floats) -> Floats:
        return np.bincount(block[solid], values[solid], BLOCKS**2)

    full = np.bincount(block[solid], minlength=BLOCKS**2) >= 0.5 * solid.size / BLOCKS**2
    one, other = by_block(ours.luminance)[full], by_block(theirs.luminance)[full]
    noise = sum(np.sqrt(by_block(m.variance)[full] / m.repetitions) ** 2 for m in (ours, theirs)) ** 0.5 / other
    off = np.abs(one / other - 1)
    typical, beyond = float(np.median(off)), float(np.maximum(off - 3 * noise, 0).max())
    same = abs(difference) <= MOST_MEAN_DIFFERENCE and max(typical, beyond) <= MOST_BLOCK_DIFFERENCE
    print(
        f"  ours against theirs: mean {difference:+.2%} (at most {MOST_MEAN_DIFFERENCE:.0%}); {full.sum()} blocks, "
        f"median {typical:.2%}, worst {off.max():.2%}, beyond 3 standard errors {beyond:.2%} (at most "
        f"{MOST_BLOCK_DIFFERENCE:.0%}){'' if same else ': NOT THE SAME IMAGE, nothing compared'}"
    )
    return same


def against_cycles(python: str | None, sizes: Sizes) -> bool:
    spec = plain(stand(sizes.stand_m))
    camera = replace(spec.cameras[0], size_px=sizes.cycles_px)
    print(f"{len(spec.instances):,} instances, {camera.size_px[0]} x {camera.size_px[1]} px, {sizes.samples} samples:")
    solid = (identity_of(spec, camera).part != Part.NOTHING).all(axis=2)
    with tempfile.TemporaryDirectory() as folder:
        peer = None if python is None else Cycles(python, Path(folder), scene_of(spec, camera))
        if peer is None or peer.ready == "absent":
            print(f"  Cycles: not compared. {MAKE_PEER}")
            peer = None
        images: dict[object, list[NDArray[Any]]] = {way: [] for way in ("ours", *WAYS)}
        seconds: dict[object, list[float]] = {way: [] for way in images}
        for repetition in range(sizes.repetitions):
            image, spent = take(spec, camera, StoppingCriterion(sizes.samples), seed=repetition + 1)
            images["ours"].append(image.mean)
            seconds["ours"].append(spent)
            for way in WAYS if peer else ():
                assert peer
                peer.take(1, 99, way)  # builds what this way needs and then keeps
                set_up = peer.take(1, 98, way)[1]
                picture, spent = peer.take(sizes.samples, repetition + 1, way)
                images[way].append(picture)
                seconds[way].append((spent - set_up) * sizes.samples / (sizes.samples - 1))
        if peer:
            peer.end()
    ours = Measured.of("forestgen", images["ours"], seconds["ours"], solid)
    ours.show()
    if not peer:
        return True
    names = {"flat": "no light tree", "tree": "light tree", "sampled": "sky sampled", "found": "sky not sampled"}
    every = [Measured.of(f"Cycles, {names[way[0]]}, {names[way[1]]}", images[way], seconds[way], solid) for way in WAYS]
    for one in every:
        one.show()
    best = max(every, key=lambda one: one.efficiency)
    ratio = ours.efficiency / best.efficiency
    by_pixel = best.variance_by_pixel * best.seconds / (ours.variance_by_pixel * ours.seconds)
    usual = max(one.efficiency for one, way in zip(every, WAYS, strict=True) if way[1] == "sampled")
    print(f"  efficiency, ours over Blender's {peer.ready.removeprefix('ready ')}:")
    print(f"    its best way: {ratio:.2f} (bound {CYCLES_BOUND}), by pixel {by_pixel:.2f}")
    print(f"    its best with the sky sampled, as Blender does unless told otherwise: {ours.efficiency / usual:.2f}")
    return agree(ours, best) and len(spec.instances) >= LEAST_INSTANCES and ratio >= CYCLES_BOUND


def spectral(spec: SceneSpec, sizes: Sizes) -> bool:
    camera = views(spec, sizes.spectral_px)[0]
    solid = np.ones(sizes.spectral_px[::-1], dtype=bool)
    modes: tuple[Mode, ...] = ("rgb", "spectral")
    images: dict[str, list[NDArray[Any]]] = {mode: [] for mode in modes}
    seconds: dict[str, list[float]] = {mode: [] for mode in modes}
    wall: dict[str, float] = dict.fromkeys(modes, 0.0)
    print(f"spectral, {camera.size_px[0]} x {camera.size_px[1]} px, {sizes.samples} samples:")
    for repetition in range(sizes.repetitions):
        for mode in modes:
            start = perf_counter()
            image, spent = take(spec, camera, StoppingCriterion(sizes.samples), repetition + 1, mode)
            wall[mode] += perf_counter() - start
            images[mode].append(image.mean)
            seconds[mode].append(spent)
    colour, by_wavelength = (Measured.of(mode, images[mode], seconds[mode], solid) for mode in modes)
    colour.show()
    by_wavelength.show()
    ratio = by_wavelength.seconds / colour.seconds
    noisier = by_wavelength.relative_variance / colour.relative_variance
    print(
        f"  spectral over colour: seconds {ratio:.2f} (bound {SPECTRAL_BOUND}), wall time with building "
        f"{wall['spectral'] / wall['rgb']:.2f}, variance {noisier:.2f}"
    )
    return ratio <= SPECTRAL_BOUND


def noise_control(spec: SceneSpec, sizes: Sizes) -> bool:
    seen = np.ones(sizes.noise_px[::-1], dtype=bool)
    print(f"noise control, {sizes.noise_px[0]} x {sizes.noise_px[1]} px, {sizes.seeds} seeds:")
    wastes = []
    for camera in views(spec, sizes.noise_px):
        for target in sizes.targets:
            until = StoppingCriterion(16, target_error=target, most_samples=8192)
            runs = [take(spec, camera, until, seed)[0] for seed in range(1, sizes.seeds + 1)]
            each = np.array([run.mean for run in runs], dtype=np.float64)
            error = noise_of(Estimate(each.mean(0), each.var(0, ddof=1)), seen).relative_error
            used = float(np.mean([run.samples for run in runs]))
            least = used * (error / target) ** 2
            wastes.append(used / least - 1)
            counts = ", ".join(str(run.samples) for run in runs)
            told = np.mean([run.relative_error for run in runs])
            print(
                f"  {camera.name:<14} target {target:.3f}: told {told:.4f}, in truth {error:.4f}; samples {counts}; "
                f"least {least:.0f}, waste {wastes[-1]:+.1%}"
            )
    mean = float(np.mean(wastes))
    print(f"  waste {mean:+.1%} on average (bound {WASTE_BOUND:.0%} either way), worst {max(wastes):+.1%}")
    return abs(mean) <= WASTE_BOUND


def tone_mapped(image: NDArray[Any], reference: NDArray[Any]) -> Floats:
    """In [0, 1]; the reference's mean luminance becomes a middle grey."""
    level = np.maximum(np.asarray(image, dtype=np.float64), 0) * (0.4 / float((reference @ LUMINANCE).mean()))
    return np.asarray((level / (1 + level)) ** (1 / 2.2))


def denoised(spec: SceneSpec, sizes: Sizes) -> bool:
    good, tracer = True, SceneTracer(spec, Timings())
    print(f"denoised, {sizes.denoise_px[0]} x {sizes.denoise_px[1]} px, reference of {sizes.reference} samples:")
    for camera in views(spec, sizes.denoise_px):
        guide = trace_guides(tracer, camera)
        truth = take(spec, camera, StoppingCriterion(sizes.reference), 1)[0]
        scale = np.maximum(truth.mean, 0.1 * truth.mean.mean(axis=(0, 1))) ** 2
        few, many = (take(spec, camera, StoppingCriterion(samples), 2)[0].mean for samples in (16, 128))
        clean = denoise(few, guide.colour, guide.normal)
        errors = []
        for name, image in (("16 raw", few), ("128 raw", many), ("16 denoised", clean)):
            error = float(np.mean(((image - truth.mean) ** 2 - truth.variance) / scale))
            psnr = -10 * np.log10(np.mean((tone_mapped(image, truth.mean) - tone_mapped(truth.mean, truth.mean)) ** 2))
            bias = float(image.mean() / truth.mean.mean() - 1)
            errors.append(error)
            print(f"  {camera.name:<14}{name:<12} relative error² {error:.4f}, PSNR {psnr:.2f} dB, mean {bias:+.2%}")
        good &= errors[2] < errors[1]
    return good


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peer-python", help="interpreter that has bpy")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", choices=("cycles", "spectral", "noise", "denoise"))
    options = parser.parse_args()
    sizes = QUICK if options.quick else Sizes()
    mitsuba()
    drjit()
    results, own = {}, None
    if options.only in (None, "cycles"):
        results["cycles"] = against_cycles(options.peer_python, sizes)
    if options.only != "cycles":
        own = stand(None)
        parts = {"spectral": spectral, "noise": noise_control, "denoise": denoised}
        results |= {name: part(own, sizes) for name, part in parts.items() if options.only in (None, name)}
    missed = [name for name, good in results.items() if not good]
    print("every bound is met" if not missed else f"missed: {', '.join(missed)}")
    return int(bool(missed) and not options.quick)


if __name__ == "__main__":
    sys.exit(main())
