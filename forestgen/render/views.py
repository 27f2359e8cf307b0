"""A view of a scene that is built once and captured pass after pass, in other channels and with other seeds.

clear_view.py has scenes without clouds. Under clouds, farfield.py lights the scene by a sky that was rendered once.
Both follow their paths by paths/. exact_view.py has Mitsuba trace the clouds' volume together with the scene.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.core.progress import Progress
from forestgen.core.randomness import child_rng, child_seed
from forestgen.render import sky
from forestgen.render.build import origin_of
from forestgen.render.cloud_heights import base_of
from forestgen.render.cloud_paths import gather
from forestgen.render.cloud_shadow import Sheet, sheet_of
from forestgen.render.identity import SceneTracer
from forestgen.render.light import has_sun, sky_map, sun_irradiance, sun_radiance
from forestgen.render.paths.scattering import Surfaces, paint_of, relief_tables
from forestgen.render.paths.tracer import Image, PathTracer, Sky, Sun
from forestgen.render.shot import Shot, Timer, View, is_exact
from forestgen.render.sky import TracedClouds
from forestgen.render.variant import SCALAR, using
from forestgen.scene.channels import Channels
from forestgen.scene.projection import image_circle, rays
from forestgen.scene.spec import Camera

if TYPE_CHECKING:
    from forestgen.render.identity import SceneTracer

_CALL_RAYS = 1 << 18
# Of two R2 sequences (Roberts 2018), powers of 0.7549 and of 0.8192: they fill a pixel, and the lens, evenly.
_STEPS = np.array([[0.7548776662466927], [0.5698402909980532], [0.8191725133961645], [0.6710436067037893]])
_LEVEL = 1e-6  # sine of the lowest elevation
Floats = NDArray[np.float64]


class LitScene:
    """
    Parameters
    ----------
    radiance : the sky in channels, as `sky_radiance.sky_map` has it.
    sheet : what clouds let through of the sun's light; None: all.
    """

    def __init__(
        self,
        tracer: SceneTracer,
        camera: Camera,
        max_depth: int,
        radiance: Callable[[Channels], NDArray[np.float32]],
        sheet: Sheet | None = None,
    ) -> None:
        self._tracer, self._radiance, self._sheet = tracer, radiance, sheet
        self._shown: Channels | None = None
        with using(tracer.variant):
            self._surfaces = Surfaces(tracer, relief_tables(tracer.spec))
            self._paths = PathTracer(tracer, camera, self._surfaces, max_depth)

    def show(self, channels: Channels) -> None:
        """Have the surfaces and lights of these channels."""
        if channels == self._shown:
            return
        spec = self._tracer.spec
        with using(self._tracer.variant):
            self._surfaces.show(paint_of(spec, channels))
            self._sky = Sky(self._radiance(channels), sampled=spec.clouds is not None)
            self._sun = None
            if has_sun(spec.sky):
                light, disc = sun_irradiance(spec.sky, channels), sun_radiance(spec.sky, channels)
                self._sun = Sun(spec.sky.to_sun, light, disc, self._sheet, self._tracer.origin_m)
        self._shown = channels

    def take(self, samples: int, seed: int) -> Image:
        """An image in the channels that are shown, by independent paths for each seed."""
        with using(self._tracer.variant):
            return self._paths.take(self._sky, self._sun, samples, seed)


class ClearView:
    def __init__(self, shot: Shot, tracer: SceneTracer, timer: Timer) -> None:
        self._seed, self._timer = shot.seed, timer
        with timer("radiance: build"):
            sky = partial(sky_map, shot.spec.sky)
            self._lit = LitScene(tracer, shot.camera, shot.max_depth, sky)

    def take(self, channels: Channels, samples: int, number: tuple[int, int]) -> NDArray[np.float64]:
        with self._timer("radiance: repaint"):
            self._lit.show(channels)
        with self._timer("light paths"):
            image = self._lit.take(samples, child_seed(self._seed, "clear", *number))
        return np.asarray(image.by_sky + image.by_sun + image.beyond, dtype=np.float64)


class SkyPixels:
    """The sky behind a scene.

    Rays that point below the horizon see the sky as high above it as they point below: there the terrain is, and what
    it leaves open of a pixel on the horizon is sky. The plain that lights the clouds from below is never seen.
    """

    def __init__(self, clouds: TracedClouds, camera: Camera) -> None:
        self._clouds, self._camera = clouds, camera

    def take(self, wanted: NDArray[np.bool_], channels: Channels, samples: int, seed: int) -> Floats:
        """(H, W, 3) mean radiance of the sky over what each pixel sees; 0 in pixels that are not wanted."""
        sky = self._clouds.sky
        light, sun = self._clouds.under(sky_map(sky, channels)), sun_irradiance(sky, channels)
        albedo = self._clouds.albedo(channels)
        image = np.zeros((*wanted.shape, 3))
        rows, columns = np.nonzero(wanted)
        for first in range(0, len(rows), _CALL_RAYS):
            part = slice(first, first + _CALL_RAYS)
            row, column = rows[part], columns[part]
            rng = child_rng(seed, "rays", first)
            shift = rng.random((4, len(row)))
            total, count = np.zeros((len(row), 3)), np.zeros((len(row), 1))
            for number in range(samples):
                places = (shift + number * _STEPS) % 1.0
                origin, direction, seen = camera_rays(self._camera, row, column, places)
                direction[:, 2] = np.maximum(np.abs(direction[:, 2]), _LEVEL)
                own = child_seed(seed, "paths", first, number)
                found = gather(self._clouds.field, light, origin, direction, seed=own)
                total += found.radiance(albedo, sun) * seen[:, None]
                count += seen[:, None]
            image[row, column] = total / np.maximum(count, 1.0)
            missed = count[:, 0] == 0  # on the edge of a fisheye's circle, which holds the pixel's centre
            if missed.any():
                centre = np.full((4, int(missed.sum())), 0.5)
                origin, direction, _ = camera_rays(self._camera, row[missed], column[missed], centre)
                direction[:, 2] = np.maximum(np.abs(direction[:, 2]), _LEVEL)
                own = child_seed(seed, "centres", first)
                found = gather(self._clouds.field, light, origin, direction, seed=own)
                image[row[missed], column[missed]] = found.radiance(albedo, sun)
        return image


def camera_rays(
    camera: Camera, row: NDArray[np.intp], column: NDArray[np.intp], places: Floats
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """(N, 3) origins and directions, world, of one ray through each pixel; (N,) whether it sees anything.

    Parameters
    ----------
    places : (4, N) in [0, 1): where a ray goes through its pixel, right and down, and two numbers for the lens.
    """
    own = rays(camera, column + places[0], row + places[1])
    origin, direction = own.origin_m, own.direction
    if camera.lens is not None:
        radius, turn = camera.lens.aperture_radius_m * np.sqrt(places[2]), 2 * np.pi * places[3]
        origin = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.zeros_like(turn)], axis=-1)
        direction = direction * (camera.lens.focus_m / direction[:, 2:]) - origin
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    axes = np.asarray(camera.world_from_camera, dtype=np.float64)
    return origin @ axes.T + np.asarray(camera.position_m), direction @ axes.T, own.valid


class FarfieldView:
    def __init__(self, shot: Shot, tracer: SceneTracer, progress: Progress, timer: Timer) -> None:
        self._shot, self._timer = shot, timer
        spec, origin = shot.spec, origin_of(shot.camera)
        clouds = sky.traced_clouds_of(spec)
        with progress.stage("light of the sky", 1) as advance, timer("clouds: bake"):
            place = sky.site_middle(spec)
            baked = sky.baked_sky(clouds, place)
            self._land = self._overland(baked, place)
            sheet = sheet_of(spec, origin) if has_sun(spec.sky) else None
            advance(1)
        with timer("radiance: build"):
            self._lit = LitScene(tracer, shot.camera, shot.max_depth, baked.radiance, sheet)
        self._sky = SkyPixels(clouds, shot.camera)

    def _overland(self, here: sky.SkyLight, place_m: Floats) -> sky.Overland | None:
        base_m = None if self._shot.spec.clouds is None else base_of(self._shot.spec.clouds)
        if base_m is None or self._shot.position_m is None:
            return None
        return sky.overland(here, place_m, base_m)

    def take(self, channels: Channels, samples: int, number: tuple[int, int]) -> Floats:
        with self._timer("radiance: repaint"):
            self._lit.show(channels)
        with self._timer("light paths"):
            found = self._lit.take(samples, child_seed(self._shot.seed, "farfield", *number))
        image: Floats = found.by_sky.astype(np.float64)
        if self._land is not None and self._shot.position_m is not None:
            image = image * self._land.ratio(channels, self._shot.position_m)
        with self._timer("clouds: sky pixels"):
            seed = child_seed(self._shot.seed, "clouds", *number)
            # Clouds are smooth: where the denoiser works least, and a path costs most.
            beyond = self._sky.take(found.open > 0, channels, max((samples + 1) // 2, min(samples, 4)), seed)
        return np.asarray(image + found.by_sun + found.open[..., None] * beyond)


def build_view(shot: Shot, progress: Progress, timer: Timer, tracer: SceneTracer | None = None) -> View:
    """Build the scene of a shot.

    Parameters
    ----------
    tracer : of the shot's scene, if there is one already.
    """
    if is_exact(shot):
        from forestgen.render.exact_view import ExactView

        with using(SCALAR):
            return ExactView(shot, timer)
    if tracer is None:
        from forestgen.render.identity import SceneTracer

        with timer("radiance: build"):
            tracer = SceneTracer(replace(shot.spec, cameras=(shot.camera,)), lambda name: nullcontext())
    if shot.spec.clouds is None:
        from forestgen.render.views import ClearView

        return ClearView(shot, tracer, timer)
    from forestgen.render.views import FarfieldView

    return FarfieldView(shot, tracer, progress, timer)


class PixelKinds(NamedTuple):
    """(H, W) pixels of a camera by what they can see."""

    seen: NDArray[np.bool_]  # the centre sees anything: it lies in a fisheye's circle
    whole: NDArray[np.bool_]  # all of the pixel does
    above: NDArray[np.bool_]  # all of it does, above a flat earth's horizon


def pixels_of(camera: Camera) -> PixelKinds:
    """What a camera's pixels can see."""
    width, height = camera.size_px
    seen = image_circle(camera)
    x, y = np.meshgrid(np.arange(width + 1.0), np.arange(height + 1.0))
    corners = rays(camera, x, y)
    whole = seen & _all_corners(corners.valid)
    return PixelKinds(seen, whole, whole & _all_corners(corners.direction @ camera.world_from_camera[2] > -1e-9))


def _all_corners(corners: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return np.asarray(corners[:-1, :-1] & corners[:-1, 1:] & corners[1:, :-1] & corners[1:, 1:])
