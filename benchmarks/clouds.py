"""Cost of clouds traced with a scene: `uv run python benchmarks/clouds.py [--quick]`; exits 1 if a bound is missed.

The quickstart's stand under a field of cumulus of 4 km. The transport `exact` is rendered by turns with Mitsuba's
`volpath` on the same scene with the clouds in one box, which has one majorant, twice: as it comes (roulette from the
fifth scattering on, independent samples of the film as ours) and at its best (roulette from the 256th on, no limit of
scatterings that matters). Efficiency is 1 / (variance x seconds of all processors), without building the scene. The
means are compared by region: their difference over its standard error must stay below 4. Bound: 3 times the efficiency
of the better of the two, over the whole image. `--quick`: small and without bounds.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from time import process_time

import numpy as np
from numpy.typing import NDArray
from radiance import LUMINANCE, identity_of, stand

from forestgen.atmosphere.clouds.noise import NoiseKeys, cumulus_field
from forestgen.core.parts import Part
from forestgen.core.progress import Timings
from forestgen.render.build import load, origin_of, scene_dict
from forestgen.render.capture import capture
from forestgen.render.exact_view import ExactView
from forestgen.render.frame import RenderJob, StoppingCriterion
from forestgen.render.light import emitters_of
from forestgen.render.surfaces import SpectralBsdfs
from forestgen.render.variant import SCALAR, drjit, mitsuba, path_tracer, using
from forestgen.scene.colour import RGB
from forestgen.scene.spec import Camera, SceneSpec
from support.cloud_box import cloud_volume

BOUND, MOST_SIGMA = 3.0, 4.0
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Sizes:
    size_px: tuple[int, int] = (192, 108)
    samples: int = 16
    repetitions: int = 8


QUICK = Sizes((64, 36), 4, 4)


def cloudy(spec: SceneSpec) -> SceneSpec:
    keys = NoiseKeys(type="noise", extent_m=4000.0, base_m=800.0, thickness_m=700.0, cover=0.37, extinction_per_m=0.12)
    return replace(spec, clouds=cumulus_field(keys, (60.0, 60.0), np.random.default_rng(1)))


def images(spec: SceneSpec, camera: Camera, sizes: Sizes) -> tuple[dict[str, Floats], dict[str, float]]:
    """(repetitions, H, W) luminance and seconds of one image, by way."""
    found: dict[str, list[Floats]] = {}
    seconds: dict[str, float] = {}
    assert spec.clouds is not None
    with using(SCALAR) as mi:
        view = ExactView(RenderJob(spec, camera, StoppingCriterion(sizes.samples), 3), Timings())
        origin = origin_of(camera)
        lights = {name: mi.load_dict(make(RGB)) for name, make in emitters_of(spec.sky).items()}
        plain = load({**scene_dict(spec, origin, SpectralBsdfs()), "box": cloud_volume(spec.clouds, origin), **lights})
        tracers = {
            "volpath as it comes": mi.load_dict({"type": "volpath", "max_depth": -1}),
            "volpath at its best": path_tracer("volpath", 4096, rr_depth=256),
        }
        view.take(RGB, 1, (10_000, 0))  # compiles
        for repetition in range(sizes.repetitions):
            for name in ("exact", *tracers):
                start = process_time()
                if name == "exact":
                    image = view.take(RGB, sizes.samples, (repetition, 0))
                else:
                    tracer = tracers[name]
                    image = capture(tracer, plain, camera, samples=sizes.samples, seed=repetition + 1)[..., :3]
                seconds[name] = seconds.get(name, 0.0) + (process_time() - start) / sizes.repetitions
                found.setdefault(name, []).append(image @ LUMINANCE)
    return {name: whole(np.array(each), name) for name, each in found.items()}, seconds


def whole(each: Floats, name: str) -> Floats:
    """(repetitions, H, W) images in which a pixel that is no number is the mean of the other repetitions'.

    One path in half a million of `volpath` through a box of clouds ends in no number.
    """
    wrong = ~np.isfinite(each)
    if wrong.any():
        print(f"{name}: {wrong.sum()} of {wrong.size} pixels are no numbers: left out")
    return np.where(wrong, np.nanmean(np.where(wrong, np.nan, each), axis=0), each)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    quick = parser.parse_args().quick
    sizes = QUICK if quick else Sizes()
    mitsuba()
    drjit()
    spec = cloudy(stand(None))
    camera = replace(spec.cameras[0], size_px=sizes.size_px)
    part = identity_of(spec, camera).part
    regions = {"forest": (part != Part.NOTHING).all(axis=2), "sky": (part == Part.NOTHING).all(axis=2)}
    regions["all"] = np.ones_like(regions["sky"])
    found, seconds = images(spec, camera, sizes)
    good, ratio = True, 0.0
    for region, pixels in regions.items():
        efficiency, means, errors = {}, {}, {}
        for name, each in found.items():
            by_image = each[:, pixels].mean(axis=1)
            means[name], errors[name] = by_image.mean(), by_image.std(ddof=1) / np.sqrt(len(by_image))
            efficiency[name] = means[name] ** 2 / (each.var(axis=0, ddof=1)[pixels].mean() * seconds[name])
            print(
                f"{region:<7}{name:<22}{seconds[name]:7.2f} s, mean {means[name]:9.2f} ± {errors[name]:.2f}, "
                f"efficiency {efficiency[name]:9.4f}"
            )
        best = max(efficiency[name] for name in found if name != "exact")
        ratio = efficiency["exact"] / best
        reference = "volpath at its best"
        sigma = (means["exact"] - means[reference]) / np.hypot(errors["exact"], errors[reference])
        good &= abs(sigma) < MOST_SIGMA
        print(
            f"{region:<7}exact over the better: {ratio:.2f}; over the one as it comes "
            f"{efficiency['exact'] / efficiency['volpath as it comes']:.2f}; means differ by "
            f"{means['exact'] / means[reference] - 1:+.2%}, {sigma:+.2f} standard errors"
        )
    good &= ratio >= BOUND
    print(f"whole image: {ratio:.2f} (bound {BOUND}){'' if good else ': MISSED'}")
    return int(not good and not quick)


if __name__ == "__main__":
    sys.exit(main())
