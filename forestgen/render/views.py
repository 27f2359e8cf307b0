"""A view of a scene that is built once and captured pass after pass, in other channels and with other seeds.

`ClearView` has scenes without clouds; `FarfieldView` lights a scene far below clouds by a sky that was rendered once.
Both follow their paths by paths/. exact_view.py has Mitsuba trace the clouds' volume together with the scene.

Under far clouds three parts add up: light of the sky on the scene, from a map that all cameras share (render/sky.py)
and corrected for what lies elsewhere; light of the sun on the scene, through the clouds' shadow
(render/cloud_shadow.py), found by the same paths; and the sky itself in the share of each pixel that the scene leaves
open (`sky_pixels`). Clouds never enter the scene that paths meet, so a view costs about what it costs under a clear
sky. When that holds: render/cloud_shadow.py.
"""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from forestgen.core.progress import Progress
from forestgen.core.randomness import child_rng, child_seed
from forestgen.render import sky
from forestgen.render.build import origin_of
from forestgen.render.cloud_paths import gather
from forestgen.render.cloud_shadow import base_of, shadow_plane_of
from forestgen.render.frame import RenderJob, Timer, View
from forestgen.render.identity import SceneTracer
from forestgen.render.light import has_sun, sky_map, sun_irradiance
from forestgen.render.paths.scattering import has_water
from forestgen.render.paths.tracer import PathTracer
from forestgen.render.variant import SCALAR, using
from forestgen.scene.colour import Channels
from forestgen.scene.exact_light import exact_light_error
from forestgen.scene.motion import poses_at, row_times_s, shutter_s
from forestgen.scene.projection import rays
from forestgen.scene.spec import Camera

_CALL_RAYS = 1 << 18
# Of two R2 sequences (Roberts 2018), powers of 0.7549 and of 0.8192, and of the golden ratio's: they fill a pixel, the
# lens, and the exposure evenly.
_STEPS = np.array(
    [[0.7548776662466927], [0.5698402909980532], [0.8191725133961645], [0.6710436067037893], [0.6180339887498949]]
)
_LEVEL = 1e-6  # sine of the lowest elevation
Floats = NDArray[np.float64]


def build_view(job: RenderJob, progress: Progress, timer: Timer, tracer: SceneTracer | None = None) -> View:
    """Build the scene of a job; `tracer` is that of its scene, if there is one already."""
    for found, what, where, leave_out in (
        (job.spec.fog or job.spec.snow is not None, "other weather", "weather", "the weather"),
        (has_water(job.spec), "water", "site.water", "site.water"),
        (job.camera.motion, "a camera that moves", f"cameras.{job.camera.name}.motion", "the camera's motion"),
    ):
        if job.is_exact and found:
            raise exact_light_error(what, where, leave_out, chosen=False)
    if job.is_exact:
        from forestgen.render.exact_view import ExactView

        with using(SCALAR):
            return ExactView(job, timer)
    if tracer is None:
        with timer("radiance: build"):
            tracer = SceneTracer(replace(job.spec, cameras=(job.camera,)), lambda name: nullcontext())
    if job.spec.clouds is None:
        return ClearView(job, tracer, timer)
    return FarfieldView(job, tracer, progress, timer)


class ClearView:
    """A scene under a clear or overcast sky."""

    def __init__(self, job: RenderJob, tracer: SceneTracer, timer: Timer) -> None:
        self._seed, self._timer = job.seed, timer
        with timer("radiance: build"):
            self._paths = PathTracer(tracer, job.camera, job.max_depth, partial(sky_map, job.spec.sky))

    def take(self, channels: Channels, samples: int, number: tuple[int, int]) -> Floats:
        with self._timer("radiance: repaint"):
            self._paths.show(channels)
        with self._timer("light paths"):
            image = self._paths.take(samples, child_seed(self._seed, "clear", *number))
        return np.asarray(image.by_sky + image.by_sun + image.beyond, dtype=np.float64)


class FarfieldView:
    """A scene under clouds that are far above it."""

    def __init__(self, job: RenderJob, tracer: SceneTracer, progress: Progress, timer: Timer) -> None:
        self._job, self._timer = job, timer
        spec = job.spec
        assert spec.clouds is not None
        self._clouds, self._land = sky.traced_clouds_of(spec), None
        with progress.stage("light of the sky", 1) as advance, timer("clouds: bake"):
            place, base_m = sky.site_middle(spec), base_of(spec.clouds)
            baked = sky.baked_sky(self._clouds, place)
            if base_m is not None and job.position_m is not None:
                self._land = sky.overland(baked, place, base_m)
            shadow = shadow_plane_of(spec, origin_of(job.camera)) if has_sun(spec.sky) else None
            advance(1)
        with timer("radiance: build"):
            self._paths = PathTracer(tracer, job.camera, job.max_depth, baked.radiance, shadow)

    def take(self, channels: Channels, samples: int, number: tuple[int, int]) -> Floats:
        job = self._job
        with self._timer("radiance: repaint"):
            self._paths.show(channels)
        with self._timer("light paths"):
            found = self._paths.take(samples, child_seed(job.seed, "farfield", *number))
        image: Floats = found.by_sky.astype(np.float64)
        if self._land is not None and job.position_m is not None:
            image = image * self._land.ratio(channels, job.position_m)
        with self._timer("clouds: sky pixels"):
            # Clouds are smooth: where the denoiser works least, and a path costs most.
            fewer, seed = max((samples + 1) // 2, min(samples, 4)), child_seed(job.seed, "clouds", *number)
            beyond = sky_pixels(self._clouds, job.camera, found.open > 0, channels, fewer, seed)
        return np.asarray(image + found.by_sun + found.open[..., None] * beyond)


def sky_pixels(
    clouds: sky.TracedClouds, camera: Camera, wanted: NDArray[np.bool_], channels: Channels, samples: int, seed: int
) -> Floats:
    """(H, W, 3) mean radiance of the cloudy sky over what each pixel sees; 0 in pixels that are not wanted.

    Each ray is followed by one path through the clouds. Rays that point below the horizon see the sky as high above it
    as they point below: there the terrain is, and what it leaves open of a pixel on the horizon is sky. The plain that
    lights the clouds from below is never seen.
    """
    light, sun = clouds.under(sky_map(clouds.sky, channels)), sun_irradiance(clouds.sky, channels)
    albedo, aloft = clouds.albedo(channels), clouds.sun_aloft(channels)

    def found(
        row: NDArray[np.intp], column: NDArray[np.intp], places: Floats, own: int
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """(N, 3) radiance, and (N, 1) which rays see anything."""
        origin, direction, seen = lens_rays(camera, row, column, places)
        direction[:, 2] = np.maximum(np.abs(direction[:, 2]), _LEVEL)
        return gather(clouds.field, light, origin, direction, seed=own).radiance(albedo, sun, aloft), seen[:, None]

    image, dimensions = np.zeros((*wanted.shape, 3)), 4 if camera.motion is None else 5
    rows, columns = np.nonzero(wanted)
    for first in range(0, len(rows), _CALL_RAYS):
        row, column = rows[first : first + _CALL_RAYS], columns[first : first + _CALL_RAYS]
        shift = child_rng(seed, "rays", first).random((dimensions, len(row)))
        total, count = np.zeros((len(row), 3)), np.zeros((len(row), 1))
        for number in range(samples):
            places = (shift + number * _STEPS[:dimensions]) % 1.0
            radiance, seen = found(row, column, places, child_seed(seed, "paths", first, number))
            total += radiance * seen
            count += seen
        image[row, column] = total / np.maximum(count, 1.0)
        missed = count[:, 0] == 0  # on the edge of a fisheye's circle, which holds the pixel's centre
        if missed.any():
            row, column = row[missed], column[missed]
            image[row, column], _ = found(
                row, column, np.full((dimensions, len(row)), 0.5), child_seed(seed, "centres", first)
            )
    return image


def lens_rays(
    camera: Camera, row: NDArray[np.intp], column: NDArray[np.intp], places: Floats
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """(N, 3) origins and directions, world, of one ray through each pixel; (N,) whether it sees anything.

    `places` (5, N) in [0, 1) are where a ray goes through its pixel, right and down, two numbers for the lens, and the
    time in the exposure, which of a camera that stands still may be left out.
    """
    own = rays(camera, column + places[0], row + places[1])
    origin, direction = own.origin_m, own.direction
    if camera.lens is not None:
        radius, turn = camera.lens.aperture_radius_m * np.sqrt(places[2]), 2 * np.pi * places[3]
        origin = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.zeros_like(turn)], axis=-1)
        direction = direction * (camera.lens.focus_m / direction[:, 2:]) - origin
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    axes = np.asarray(camera.world_from_camera, dtype=np.float64)
    if camera.motion is not None:
        time = row_times_s(camera)[row] + (places[4] - 0.5) * shutter_s(camera)
        way, axes = poses_at(camera, time)
        start, direction = (np.einsum("nij,nj->ni", axes, one) for one in (origin, direction))
        return start + way + np.asarray(camera.position_m), direction, own.valid
    return origin @ axes.T + np.asarray(camera.position_m), direction @ axes.T, own.valid
