"""Cost of all labels: `uv run python benchmarks/labels.py` (`--quick`: small sizes, no bounds).

In one process, 640 x 480 pixels of 10,000 instances: the radiance at 64 samples a pixel, in four parts, and between
these every label channel at 16 samples. Prints each channel's median time and its share of the radiance's. Bounds: all
channels take under 5% of the radiance, amodal masks of the 100 plants that are most in view under 5% more. Set-ups are
shared by all cameras of a scene and are told apart; the radiance's own is left out too.

Then 500,000 instances in a process of its own: all labels, amodal ones included, in under 4 GB. Exits 1 if a bound is
missed.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from statistics import median
from time import perf_counter, process_time
from typing import TypeVar

import numpy as np

from forestgen.atmosphere.clouds.noise import NoiseKeys, cumulus_field
from forestgen.atmosphere.optical_depth import cloud_opacity
from forestgen.community.population import Population
from forestgen.core.progress import Silent, Timings
from forestgen.labels.channels.boundaries import occlusion_boundaries
from forestgen.labels.channels.motion import motion_px
from forestgen.labels.labelled import plant_views
from forestgen.labels.masks import PixelLabels, amodal_masks, pixel_labels
from forestgen.recipe.classes import ClassMap
from forestgen.render.amodal import trace_amodal
from forestgen.render.frame import Amodal, Frame, Identity, Radiance, RenderJob, StoppingCriterion, Surface
from forestgen.render.identity import SceneTracer, hit_tables, trace_identity
from forestgen.render.rendering import render_radiance
from forestgen.render.variant import drjit, mitsuba
from forestgen.scene.plant_measures import PlantMeasures, PlantMeter
from forestgen.scene.projection import world_rays
from forestgen.scene.spec import SceneSpec
from support.scenes import scattered_scene

LABEL_SHARE, AMODAL_SHARE, MOST_BYTES = 0.05, 0.05, 4e9
SAMPLES, RADIANCE_SAMPLES, PARTS, AMODAL_PLANTS = 16, 64, 4, 100
MANY, SPACING_M = 500_000, 3.0

Result = TypeVar("Result")


class Stopwatch:
    """Wall and processor seconds of pieces of work, by name."""

    def __init__(self) -> None:
        self.wall_s: dict[str, list[float]] = {}
        self.processor_s: dict[str, list[float]] = {}

    def run(self, name: str, work: Callable[[], Result]) -> Result:
        start, start_processor = perf_counter(), process_time()
        result = work()
        self.add(name, perf_counter() - start, process_time() - start_processor)
        return result

    def add(self, name: str, wall_s: float, processor_s: float) -> None:
        self.wall_s.setdefault(name, []).append(wall_s)
        self.processor_s.setdefault(name, []).append(processor_s)


class Subject:
    """A scene with what its labels need: the set-up that all of its cameras share."""

    def __init__(self, instances: int, size_px: tuple[int, int], leaves: int) -> None:
        size_m = SPACING_M * instances**0.5
        self.spec: SceneSpec = scattered_scene(
            instances, size_m=size_m, exemplars=10, leaves=leaves, size_px=size_px, terrain=None
        )
        self.camera = self.spec.cameras[0]
        keys = NoiseKeys(
            type="noise", extent_m=6000.0, base_m=900.0, thickness_m=900.0, cover=0.4, extinction_per_m=0.05
        )
        self.clouds = cumulus_field(keys, (size_m / 2, size_m / 2), np.random.default_rng(5))
        self.population = population(self.spec)
        self.classes = ClassMap(self.population.species_names)
        self.watch = Stopwatch()
        self.tracer = self.watch.run("tracer", lambda: SceneTracer(self.spec, Timings()))
        self.measures: PlantMeasures = self.watch.run(
            "plant measures", lambda: PlantMeter(self.spec.exemplars).measure(self.spec.instances)
        )

    def radiance(self, samples: int, watch: Stopwatch) -> None:
        """Without the time to build its scene."""
        timings = Timings()
        start = process_time()
        render_radiance(
            RenderJob(self.spec, self.camera, StoppingCriterion(samples), seed=1), progress=Silent(), timer=timings
        )
        watch.add("radiance", timings.seconds["light paths"], process_time() - start)

    def labels(self, watch: Stopwatch) -> tuple[Identity, Surface, PixelLabels]:
        """Every channel but amodal."""
        camera = self.camera
        timings = Timings()
        processor = process_time()
        identity, surface = trace_identity(
            self.tracer, camera, samples=SAMPLES, timer=timings, advance=lambda rows: None
        )
        processor = process_time() - processor
        for name, seconds in timings.seconds.items():
            watch.add(name, seconds, processor * seconds / sum(timings.seconds.values()))
        pixels = watch.run(
            "masks and coverage ranks",
            lambda: pixel_labels(
                identity.plant_id, identity.part, self.population.plant_id, self.population.species, self.classes
            ),
        )
        watch.run("plants", lambda: self.views(identity, surface, pixels, None))
        watch.run("occlusion boundaries", lambda: occlusion_boundaries(surface, camera))
        moved = replace(self.spec.instances)  # as in wind: each plant is taken along
        watch.run("motion", lambda: motion_px(camera, surface, self.spec.instances, camera, moved))
        watch.run(
            "cloud opacity",
            lambda: cloud_opacity(
                self.clouds, *(vars(world_rays(camera))[name] for name in ("origin_m", "direction")), surface.distance_m
            ),
        )
        return identity, surface, pixels

    def views(self, identity: Identity, surface: Surface, pixels: PixelLabels, amodal: Amodal | None) -> object:
        masks = None if amodal is None else amodal_masks(amodal, identity.plant_id, pixels.instance)
        dark = np.zeros((*pixels.instance.shape, 3), dtype=np.float32)
        frame = Frame(self.camera, Radiance(dark, dark, None, 1), identity, surface, amodal)
        return plant_views(frame, self.population.plant_id, pixels, self.measures, masks)

    def amodal(self, identity: Identity, pixels: PixelLabels, watch: Stopwatch, most: int) -> None:
        plants, count = np.unique(pixels.instance[pixels.instance > 0], return_counts=True)
        chosen = plants[np.argsort(-count, kind="stable")[:most]]

        def work() -> None:
            amodal = trace_amodal(
                self.tracer, self.camera, chosen, samples=SAMPLES, timer=Timings(), advance=lambda rows: None
            )
            amodal_masks(amodal, identity.plant_id, pixels.instance)

        watch.run(f"amodal of {len(chosen)} plants", work)


def population(spec: SceneSpec) -> Population:
    """The plants of `scattered_scene` as a community would tell of them."""
    instances = spec.instances
    names = tuple(sorted({exemplar.species for exemplar in spec.exemplars}))
    species = np.array([names.index(exemplar.species) for exemplar in spec.exemplars], dtype=np.uint16)
    some = np.ones(len(instances))
    return Population(
        time_yr=1.0,
        species_names=names,
        plant_id=instances.plant_id,
        species=species[instances.exemplar],
        position_m=instances.transform[:, :, 3],
        radius_m=some,
        height_m=some,
        age_yr=some,
        status=np.zeros(len(instances), dtype=np.uint8),
    )


def compare(instances: int, size_px: tuple[int, int], leaves: int) -> tuple[float, float]:
    """Shares of the radiance's time that the labels and the amodal masks take."""
    subject, watch = Subject(instances, size_px, leaves), Stopwatch()
    identity, _, pixels = subject.labels(Stopwatch())  # compiles the kernels
    first = Stopwatch()
    subject.amodal(identity, pixels, first, AMODAL_PLANTS)
    for _ in range(PARTS):
        subject.radiance(RADIANCE_SAMPLES // PARTS, watch)
        identity, _, pixels = subject.labels(watch)
        subject.amodal(identity, pixels, watch, AMODAL_PLANTS)
    whole_s, whole_processor_s = (sum(times.pop("radiance")) for times in (watch.wall_s, watch.processor_s))
    seen = len(np.unique(identity.plant_id)) - 1
    print(f"{instances:,} instances, {size_px[0]} x {size_px[1]} px, {seen:,} plants in view, {os.cpu_count()} cores")
    print(f"radiance at {RADIANCE_SAMPLES} samples {whole_s:8.2f} s, {whole_processor_s:8.2f} s of processors")
    shares = {"labels": [0.0, 0.0], "amodal": [0.0, 0.0]}
    for name in watch.wall_s:
        wall_s, processor_s = median(watch.wall_s[name]), median(watch.processor_s[name])
        share, processor_share = wall_s / whole_s, processor_s / whole_processor_s
        print(f"  {name:<28}{wall_s:8.3f} s {share:7.2%}, of processors {processor_s:7.3f} s {processor_share:7.2%}")
        total = shares["amodal" if name.startswith("amodal") else "labels"]
        total[0], total[1] = total[0] + share, total[1] + processor_share
    for name, (share, processor_share) in shares.items():
        print(f"  {name + ', all':<28}{share:19.2%}, of processors {processor_share:17.2%}")
    set_up = {**subject.watch.wall_s, "amodal, first camera": first.wall_s.popitem()[1]}
    print("set-up, once a scene:", ", ".join(f"{name} {times[0]:.2f} s" for name, times in set_up.items()))
    print(f"tables on the device: {hit_tables(subject.tracer.spec).nbytes / 1e6:.0f} MB")
    return shares["labels"][0], shares["amodal"][0]


def many(instances: int, size_px: tuple[int, int], leaves: int) -> None:
    """All labels of many instances; prints the peak memory of this process."""
    subject, watch = Subject(instances, size_px, leaves), Stopwatch()
    identity, _, pixels = subject.labels(watch)
    subject.amodal(identity, pixels, watch, AMODAL_PLANTS)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    set_up = sum(times[0] for times in subject.watch.wall_s.values())
    print(f"{instances:,} instances: set-up {set_up:.1f} s, peak memory {peak / 1e9:.2f} GB")
    print(int(peak))


def main() -> int:
    quick = "--quick" in sys.argv
    instances, size_px, leaves = (500, (160, 120), 500) if quick else (10_000, (640, 480), 25_000)
    mitsuba()
    drjit()
    if "--many" in sys.argv:
        many(20_000 if quick else MANY, size_px, leaves)
        return 0
    labels, amodal = compare(instances, size_px, leaves)
    command = [sys.executable, __file__, "--many", *(["--quick"] if quick else [])]
    output = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    print(output[0])
    missed = labels > LABEL_SHARE or amodal > AMODAL_SHARE or int(output[1]) > MOST_BYTES
    return int(missed and not quick)


if __name__ == "__main__":
    sys.exit(main())
