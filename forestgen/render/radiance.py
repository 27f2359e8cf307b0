"""Radiance of one camera, with its variance.

Independent slices of samples are rendered and averaged. Their scatter gives the variance of the mean without assuming
independent samples inside a slice (a stratified sampler's are not), progress can be told between slices, and each
slice is repeatable on its own.

Three estimators add up: light of the sky on the scene, light of the sun on the scene, and the sky itself in the share
of each pixel that the scene leaves open (see render/sky.py). Under a clear sky one pass does all three.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.progress import Progress
from forestgen.core.randomness import child_seed
from forestgen.render import sky
from forestgen.render.build import (
    FilmWindow,
    ground_bsdf,
    load,
    origin_of,
    plants_dict,
    sensor_of,
    sky_emitter,
    to_mesh,
)
from forestgen.render.frame import Radiance
from forestgen.render.tracing import interruptible
from forestgen.render.variant import BLOCK_PX, SCALAR, mitsuba, using
from forestgen.scene.spec import Camera, SceneSpec

_SLICES = 8


@dataclass(frozen=True)
class Estimate:
    """Mean of slices and the variance of that mean; the variance is NaN for a single slice."""

    mean: NDArray[np.float64]
    variance: NDArray[np.float64]


class SliceSum:
    """Weighted running mean and variance of slices of different length (West 1979)."""

    def __init__(self) -> None:
        self._weight = 0
        self._slices = 0
        self._mean: Any = 0.0
        self._scatter: Any = 0.0

    def add(self, image: NDArray[np.float64], samples: int) -> None:
        self._weight += samples
        self._slices += 1
        difference = image - self._mean
        self._mean = self._mean + difference * (samples / self._weight)
        self._scatter = self._scatter + samples * difference * (image - self._mean)

    def estimate(self) -> Estimate:
        if self._slices < 2:
            return Estimate(self._mean, np.full_like(self._mean, np.nan))
        return Estimate(self._mean, self._scatter / (self._weight * (self._slices - 1)))


def slice_sizes(samples: int) -> list[int]:
    """Samples of each slice: at most eight nearly equal slices, of two samples each while that leaves four."""
    count = min(_SLICES, max(samples // 2, min(samples, 4)))
    return [samples // count + (1 if k < samples % count else 0) for k in range(count)]


def scene_dict(spec: SceneSpec, origin_m: NDArray[np.float64]) -> dict[str, Any]:
    """Plants on their terrain, without light."""
    scene = plants_dict(spec, origin_m, shaded=True)
    terrain = to_mesh(spec.terrain.mesh, mitsuba().load_dict(ground_bsdf(spec)), origin_m, "terrain")
    terrain.add_attribute("vertex_far_share", 1, spec.terrain.far_share)
    scene["terrain"] = terrain
    return scene


def render_radiance(
    spec: SceneSpec,
    camera: Camera,
    *,
    samples: int,
    max_depth: int,
    seed: int,
    progress: Progress,
    sky_share: NDArray[np.bool_],
    timer: Callable[[str], Any],
) -> Radiance:
    """Radiance of `camera`, not yet denoised.

    Parameters
    ----------
    samples : a pixel.
    max_depth : longest path through the canopy; clouds have their own.
    seed : of the frame.
    sky_share : (H, W) pixels that may see the sky; the others skip the cloud pass.
    timer : context manager that books time under a name; "mitsuba" is time inside the renderer's own calls.
    """
    with using(SCALAR):
        if spec.clouds is None:
            return _clear(spec, camera, samples, max_depth, seed, progress, timer)
        return _cloudy(spec, camera, samples, max_depth, seed, progress, sky_share, timer)


def _clear(
    spec: SceneSpec,
    camera: Camera,
    samples: int,
    max_depth: int,
    seed: int,
    progress: Progress,
    timer: Callable[[str], Any],
) -> Radiance:
    mi = mitsuba()
    origin = origin_of(camera)
    with timer("radiance: build"):
        scene = load({**scene_dict(spec, origin), "light": sky_emitter(spec, sun=True, sky=True)})
        integrator = mi.load_dict({"type": "path", "max_depth": max_depth, "rr_depth": 1, "block_size": BLOCK_PX})
    total = SliceSum()
    sizes = slice_sizes(samples)
    with progress.stage("radiance", len(sizes)) as advance:
        for number, size in enumerate(sizes):
            sensor = sensor_of(camera, size)
            with timer("mitsuba"):
                image = interruptible(integrator, scene, sensor, child_seed(seed, "clear", number), size)
            total.add(image[..., :3].astype(np.float64), size)
            advance(1)
    return _radiance(total, samples)


def _cloudy(
    spec: SceneSpec,
    camera: Camera,
    samples: int,
    max_depth: int,
    seed: int,
    progress: Progress,
    sky_share: NDArray[np.bool_],
    timer: Callable[[str], Any],
) -> Radiance:
    mi = mitsuba()
    origin = origin_of(camera)
    with progress.stage("light of the sky", 1) as advance:
        with timer("mitsuba"):
            environment = sky.bake_sky(spec, origin, seed=child_seed(seed, "bake") >> 1)
        advance(1)
    with timer("radiance: build"):
        plants = scene_dict(spec, origin)  # meshes are shared; instances belong to one scene each
        by_sky = load({**plants, "light": environment})
        by_sun = load({**plants, "light": sky_emitter(spec, sun=True, sky=False), "sheet": sky.sun_sheet(spec, origin)})
        clouds = load(sky.clouds_over_ground(spec, origin, sky_emitter(spec, sun=True, sky=True)))
        hidden = mi.load_dict(
            {"type": "volpath", "max_depth": max_depth, "rr_depth": 1, "hide_emitters": True, "block_size": BLOCK_PX}
        )
        through = mi.load_dict(sky.CLOUD_INTEGRATOR)
    horizon = horizon_row(camera)
    window = _window(sky_share, horizon)
    total = SliceSum()
    sizes = slice_sizes(samples)
    with progress.stage("radiance", len(sizes) * 3) as advance:
        for number, size in enumerate(sizes):
            sensor = sensor_of(camera, size)
            # The sky's light is smooth, and the sky itself easily denoised: they need fewer samples than the sun.
            few = (size + 1) // 2
            with timer("mitsuba"):
                a = interruptible(hidden, by_sky, sensor_of(camera, few), child_seed(seed, "sky", number), few)
            advance(1)
            with timer("mitsuba"):
                b = interruptible(hidden, by_sun, sensor, child_seed(seed, "sun", number), size).astype(np.float64)
            advance(1)
            image = a[..., :3].astype(np.float64) + b[..., :3]
            if window is not None:
                with timer("mitsuba"):
                    c = interruptible(
                        through, clouds, sensor_of(camera, few, window), child_seed(seed, "clouds", number), few
                    )
                below = min(max(horizon - window.y, 1), window.height)
                c[below:] = c[below - 1]
                rows, columns = slice(window.y, window.y + window.height), slice(window.x, window.x + window.width)
                image[rows, columns] += (1.0 - a[rows, columns, 3:4]) * c[..., :3]
            advance(1)
            total.add(image, size)
    return _radiance(total, samples)


def horizon_row(camera: Camera) -> int:
    """First row of pixels that reaches below a flat earth's horizon; the number of rows if none does.

    The cloud pass shows its plain below the horizon. In a pixel that holds both, mean coverage times the pass' mean
    would mix the plain into the sky (1% too dark along the horizon); so the row above the horizon stands for all below
    it. The horizon is level: cameras do not roll.
    """
    height, forward, down = camera.size_px[1], camera.world_from_camera[2, 2], camera.world_from_camera[2, 1]
    if abs(down) < 1e-9:
        return height if forward > 0 else 0
    row = height / 2 - forward / down * camera.focal_px
    return int(np.clip(np.floor(row), 0, height))


def _window(sky_share: NDArray[np.bool_], horizon: int) -> FilmWindow | None:
    """Smallest window that holds every pixel that may see the sky, and the row above the horizon if there is one."""
    rows, columns = np.flatnonzero(sky_share.any(axis=1)), np.flatnonzero(sky_share.any(axis=0))
    if not len(rows):
        return None
    top = min(int(rows[0]), max(horizon - 1, 0))
    return FilmWindow(int(columns[0]), top, int(columns[-1] - columns[0] + 1), int(rows[-1] - top + 1))


def _radiance(total: SliceSum, samples: int) -> Radiance:
    estimate = total.estimate()
    return Radiance(
        mean=estimate.mean.astype(np.float32),
        variance=estimate.variance.astype(np.float32),
        denoised=None,
        samples=samples,
    )
