"""Views under clouds: `uv run python benchmarks/cloud_views.py [--quick]`; exits 1 if a bound is missed.

A stand under a field of cumulus, ten cameras: on the ground, over the crowns, and from the air. Each image comes from
`render_radiance`, as the pipeline calls it, by both transports of light and without clouds. Seconds are of all
processors; compiling is not counted, building scenes and baking the sky are. Errors are the images' own relative errors
(render/rendering.py).

1. agreement: mean radiance of the pixels that see no sky, farfield against exact. Bounds: all cameras together within
   3%; each camera too, three standard errors beyond.
2. cost: what all images take with the error that farfield's have: seconds of an exact one times the square of the ratio
   of errors, and the building of its scene. Bound: farfield takes a sixth. Also said: against a clear sky at the same
   samples and at the same error.
3. paths: efficiency, 1 / (variance x seconds), of render/cloud_paths.py on an image of the clouds alone, against the
   renderer's volume path tracer on the same; and the means. Bounds: 10 times, and 1% beyond three standard errors.

`--quick`: small images, four cameras; same bounds.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from time import process_time

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.clouds.noise import NoiseKeys, cumulus_field
from forestgen.core.parts import Part
from forestgen.core.progress import Silent, Timings
from forestgen.render import sky
from forestgen.render.capture import sensor_of
from forestgen.render.cloud_shadow import base_of, cloud_transport_of, shadow_of
from forestgen.render.frame import CloudTransport, Radiance, RenderJob, StoppingCriterion
from forestgen.render.identity import SceneTracer, trace_identity
from forestgen.render.light import sky_light, sun_disc
from forestgen.render.rendering import render_radiance
from forestgen.render.variant import SCALAR, mitsuba, using
from forestgen.render.views import build_view, sky_pixels
from forestgen.scene.colour import RGB
from forestgen.scene.spec import Camera, SceneSpec
from support.cloud_box import cloud_volume
from support.scenes import camera_at, plain_ground, scattered_scene

MOST_DIFFERENCE, LEAST_GAIN, LEAST_PATHS_GAIN, MOST_PATHS_DIFFERENCE = 0.03, 6.0, 10.0, 0.01
SITE_M = 100.0
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Sizes:
    size_px: tuple[int, int] = (96, 54)
    plants: int = 2000
    samples: int = 64
    exact_samples: int = 32
    cameras: tuple[int, ...] = tuple(range(10))
    runs: int = 8  # of the clouds alone


QUICK = Sizes(size_px=(48, 27), plants=800, samples=32, exact_samples=32, cameras=(0, 3, 6, 8), runs=4)


@dataclass(frozen=True)
class Cost:
    """Of one image."""

    radiance: Radiance
    build_s: float
    capture_s: float


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    sizes = QUICK if parser.parse_args().quick else Sizes()
    spec = scene(sizes)
    spec = replace(spec, cameras=tuple(cameras(sizes.size_px)[k] for k in sizes.cameras))
    warm_up(spec)
    missed = views(spec, sizes) + paths(spec, sizes)
    print("\n".join(f"MISSED: {one}" for one in missed) or "all bounds are met")
    return 1 if missed else 0


def scene(sizes: Sizes) -> SceneSpec:
    middle = (SITE_M / 2, SITE_M / 2)
    keys = NoiseKeys(type="noise", extent_m=6000.0, base_m=900.0, thickness_m=600.0, cover=0.37, extinction_per_m=0.08)
    clouds = cumulus_field(keys, middle, np.random.default_rng(3), cell_m=40.0)
    ground = plain_ground(-20_000, 20_000, albedo=0.12)
    return scattered_scene(sizes.plants, size_m=SITE_M, exemplars=6, leaves=500, clouds=clouds, terrain=ground, seed=4)


def cameras(size_px: tuple[int, int]) -> list[Camera]:
    """Six among the trees and at their edge, two over the crowns, two high up that see far."""
    middle = (SITE_M / 2, SITE_M / 2, 6.0)
    turns = np.arange(6) / 6 * 2 * np.pi
    places = [
        (SITE_M / 2 + r * np.sin(t), SITE_M / 2 + r * np.cos(t), 3.0) for r, t in zip([58, 30] * 3, turns, strict=True)
    ]
    views = [camera_at(place, middle, size_px, hfov_deg=60.0) for place in places]
    views += [
        camera_at((50.0, -40.0, 60.0), (50.0, 60.0, 0.0), size_px),
        camera_at((120.0, 130.0, 90.0), (40.0, 40.0, 0.0), size_px),
    ]
    views += [
        camera_at((50.0, -250.0, 180.0), (50.0, 60.0, 0.0), size_px),
        camera_at((-300.0, 50.0, 250.0), (90.0, 60.0, 0.0), size_px),
    ]
    return [replace(one, name=f"{number}") for number, one in enumerate(views)]


def shot_of(
    spec: SceneSpec, camera: Camera, samples: int, transport: CloudTransport, seed: int
) -> tuple[RenderJob, NDArray[np.bool_]]:
    """And the (H, W) pixels that see no sky."""
    tracer = SceneTracer(spec, Timings())
    identity, surface = trace_identity(tracer, camera, samples=4, timer=Timings(), advance=lambda rows: None)
    closed = (identity.part != Part.NOTHING).all(axis=2)
    shot = RenderJob(
        spec, camera, StoppingCriterion(samples), seed, cloud_transport=transport, position_m=surface.position_m
    )
    return shot, closed


def render(shot: RenderJob) -> Cost:
    start_s = process_time()
    with using(SCALAR):
        build_view(shot, Silent(), Timings())
    built_s = process_time()
    radiance = render_radiance(shot, progress=Silent(), timer=Timings())
    build_s = built_s - start_s
    return Cost(radiance, build_s, max(process_time() - built_s - build_s, 1e-3))


def warm_up(spec: SceneSpec) -> None:
    """Compile, and start threads."""
    other = replace(spec, sky=replace(spec.sky, sun_azimuth_deg=10.0))
    transports: tuple[CloudTransport, ...] = ("farfield", "exact")
    for transport in transports:
        shot, _ = shot_of(other, replace(spec.cameras[0], size_px=(16, 9)), 2, transport, 1)
        render(shot)


def bake_s(spec: SceneSpec) -> float:
    """Seconds of what all cameras share."""
    start_s = process_time()
    assert spec.clouds is not None
    base_m = base_of(spec.clouds)
    assert base_m is not None
    with using(SCALAR):
        place = sky.site_middle(spec)
        sky.overland(sky.baked_sky(sky.traced_clouds_of(spec), place), place, base_m)
        shadow_of(spec.clouds, spec.sky.to_sun, base_m)
    return process_time() - start_s


def views(spec: SceneSpec, sizes: Sizes) -> list[str]:
    missed = []
    far_s, exact_s, clear_s, clear_equal_s = bake_s(spec), 0.0, 0.0, 0.0
    print(f"shared by all cameras: {far_s:.1f} s; auto is {cloud_transport_of('auto', spec, spec.cameras)}")
    print("camera  forest   +-     seconds: farfield, exact at its error, clear, clear at its error")
    sums = np.zeros((2, 2))  # farfield and exact: mean radiance, variance
    for camera in spec.cameras:
        shot, closed = shot_of(spec, camera, sizes.samples, "farfield", 7)
        far = render(shot)
        exact = render(replace(shot, until=StoppingCriterion(sizes.exact_samples), cloud_transport="exact"))
        clear = render(replace(shot, spec=replace(spec, clouds=None)))
        means, errors = zip(*(mean_of(one.radiance, closed) for one in (far, exact)), strict=True)
        difference, error = means[0] / means[1] - 1, float(np.hypot(*errors)) / means[1]
        sums += np.array([means, np.square(errors)]).T
        times = [
            one.build_s + one.capture_s * (one.radiance.relative_error / far.radiance.relative_error) ** 2
            for one in (far, exact, clear)
        ]
        plain_s = clear.build_s + clear.capture_s
        far_s, exact_s, clear_equal_s, clear_s = (
            far_s + times[0], exact_s + times[1], clear_equal_s + times[2], clear_s + plain_s,
        )  # fmt: skip
        print(
            f"{camera.name:>6}  {difference:+6.2%}  {error:.2%}",
            *(f"{one:8.1f}" for one in (times[0], times[1], plain_s, times[2])),
        )
        if abs(difference) > MOST_DIFFERENCE + 3 * error:
            missed.append(f"camera {camera.name}: farfield {difference:+.2%} from exact, at most {MOST_DIFFERENCE:.0%}")
    total, error = sums[0, 0] / sums[1, 0] - 1, float(np.sqrt(sums[:, 1].sum())) / sums[1, 0]
    print(
        f"all cameras: {total:+.2%} +- {error:.2%} (bound {MOST_DIFFERENCE:.0%});",
        f"exact takes {exact_s / far_s:.1f} times as long (bound {LEAST_GAIN:g})",
    )
    print(
        f"against a clear sky: {far_s / clear_s:.2f} times at the same samples,",
        f"{far_s / clear_equal_s:.2f} at the same error",
    )
    if abs(total) > MOST_DIFFERENCE:
        missed.append(f"mean radiance of the forest {total:+.2%} from exact, at most {MOST_DIFFERENCE:.0%}")
    if exact_s < LEAST_GAIN * far_s:
        missed.append(f"exact takes {exact_s / far_s:.1f} times as long as farfield, at least {LEAST_GAIN:g}")
    return missed


def mean_of(radiance: Radiance, where: NDArray[np.bool_]) -> tuple[float, float]:
    """Of the green channel, and its standard error."""
    mean = float(radiance.mean[where][:, 1].mean(dtype=np.float64))
    return mean, float(np.sqrt(radiance.variance[where][:, 1].sum(dtype=np.float64))) / int(where.sum())


def paths(spec: SceneSpec, sizes: Sizes) -> list[str]:
    """Clouds alone, over a plain."""
    assert spec.clouds is not None
    camera = camera_at((50.0, 50.0, 2.0), (150.0, 90.0, 90.0), (48, 32), hfov_deg=70.0)
    mi = mitsuba()
    with using(SCALAR):
        clouds = sky.traced_clouds_of(spec)
        level = mi.ScalarTransform4f().translate([0, 0, clouds.ground_m - 2.0]).scale([2e5, 2e5, 1.0])
        matt = {"type": "diffuse", "reflectance": {"type": "rgb", "value": clouds.albedo(RGB).tolist()}}
        world = mi.load_dict(
            {
                "type": "scene",
                "sky": sky_light(spec.sky, RGB),
                "sun": sun_disc(spec.sky, RGB),
                "clouds": cloud_volume(spec.clouds, np.array(camera.position_m)),
                "plain": {"type": "rectangle", "to_world": level, "bsdf": matt},
            }
        )
        tracer = mi.load_dict({"type": "volpath", "max_depth": 256, "rr_depth": 256})
        wanted = np.ones((32, 48), dtype=np.bool_)
        start_s = process_time()
        own = np.array([sky_pixels(clouds, camera, wanted, RGB, 64, seed)[..., 1] for seed in range(sizes.runs)])
        own_s = process_time() - start_s
        theirs = np.array(
            [
                np.array(tracer.render(world, sensor=sensor_of(camera, 16), seed=seed, spp=16))[..., 1]
                for seed in range(sizes.runs)
            ],
            dtype=np.float64,
        )
        their_s = process_time() - start_s - own_s
    broken = int((~np.isfinite(theirs)).any(axis=0).sum())
    whole = np.isfinite(theirs).all(axis=0)
    own, theirs = own[:, whole], theirs[:, whole]
    gain = float(theirs.var(axis=0, ddof=1).mean() * their_s / (own.var(axis=0, ddof=1).mean() * own_s))
    difference = float(own.mean() / theirs.mean() - 1)
    error = float(np.sqrt(sum(one.mean(axis=1).var(ddof=1) for one in (own, theirs)) / sizes.runs) / theirs.mean())
    each_us = 1e6 * own_s / (sizes.runs * 64 * wanted.size)
    print(
        f"clouds alone: {each_us:.1f} us a path, {gain:.0f} times volpath's efficiency (bound {LEAST_PATHS_GAIN:g}),",
        f"mean {difference:+.2%} +- {error:.2%}",
    )
    if broken:
        print(f"  {broken} pixels left out, in which volpath gave no number")
    missed = []
    if gain < LEAST_PATHS_GAIN:
        missed.append(
            f"paths through clouds are {gain:.1f} times as efficient as volpath's, at least {LEAST_PATHS_GAIN:g}"
        )
    if abs(difference) > MOST_PATHS_DIFFERENCE + 3 * error:
        missed.append(f"clouds alone are {difference:+.2%} from volpath, at most {MOST_PATHS_DIFFERENCE:.0%}")
    return missed


if __name__ == "__main__":
    sys.exit(main())
