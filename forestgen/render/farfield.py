"""A scene under clouds that are far above it.

Three estimators add up: light of the sky on the scene, from a map that all cameras share (render/sky.py) and corrected
for what lies elsewhere; light of the sun on the scene, through the clouds' shadow (render/cloud_shadow.py); and the sky
itself in the share of each pixel that the scene leaves open (render/sky_pixels.py). Clouds never enter the renderer's
scene, so a view costs about what it costs under a clear sky. When that holds: render/transport.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.progress import Progress
from forestgen.core.randomness import child_seed
from forestgen.render import sky
from forestgen.render.assembled import share_inside
from forestgen.render.build import load, origin_of, scene_dict
from forestgen.render.cloud_heights import base_of
from forestgen.render.cloud_shadow import sun_sheet
from forestgen.render.light import has_sun, sun_disc
from forestgen.render.painted import Painted, path_tracer
from forestgen.render.sensors import FilmWindow, capture
from forestgen.render.sky_pixels import SkyPixels
from forestgen.render.views import Shot, Timer
from forestgen.scene.channels import Channels

_CLOSED = 1e-6  # share of a pixel that rounding may leave open
Floats = NDArray[np.float64]


class FarfieldView:
    def __init__(self, shot: Shot, progress: Progress, timer: Timer) -> None:
        self._shot, self._timer = shot, timer
        self._painted = painted = Painted(timer)
        spec, origin = shot.spec, origin_of(shot.camera)
        clouds = sky.traced_clouds_of(spec)
        with progress.stage("light of the sky", 1) as advance, timer("clouds: bake"):
            place = sky.site_middle(spec)
            baked = sky.baked_sky(clouds, place)
            self._land = self._overland(baked, place)
            sheet = sun_sheet(spec, origin) if has_sun(spec.sky) else None
            advance(1)
        with timer("radiance: build"):
            plants = scene_dict(spec, origin, painted.paints)  # meshes are shared; instances belong to one scene each
            self._by_sky = load({**plants, "light": painted.light(baked.light)})
            self._by_sun = None
            if has_sun(spec.sky):
                disc = painted.light(lambda channels: sun_disc(spec.sky, channels))
                self._by_sun = load({**plants, "light": disc, **({} if sheet is None else {"sheet": sheet})})
            self._hidden = path_tracer("volpath", shot.max_depth, hide_emitters=True)
        self._sky = SkyPixels(clouds, shot.camera)
        width, height = shot.camera.size_px
        self._inside = np.ones((height, width))
        if shot.camera.projection == "fisheye":
            self._inside = share_inside(shot.camera, FilmWindow(0, 0, width, height))

    def _overland(self, here: sky.SkyLight, place_m: Floats) -> sky.Overland | None:
        base_m = None if self._shot.spec.clouds is None else base_of(self._shot.spec.clouds)
        if base_m is None or self._shot.position_m is None:
            return None
        return sky.overland(here, place_m, base_m)

    def take(self, channels: Channels, samples: int, number: tuple[int, int]) -> Floats:
        self._painted.show(channels)
        # Under clouds the sky gives about as much light as the sun, and more noise: it has as many samples.
        by_sky = self._capture(self._by_sky, samples, ("sky", *number))
        image, cover = by_sky[..., :3], by_sky[..., 3]
        if self._land is not None and self._shot.position_m is not None:
            image = image * self._land.ratio(channels, self._shot.position_m)
        if self._by_sun is not None:
            image = image + self._capture(self._by_sun, samples, ("sun", *number))[..., :3]
        left_open = np.maximum(self._inside - cover, 0.0)
        with self._timer("clouds: sky pixels"):
            seed = child_seed(self._shot.seed, "clouds", *number)
            # Clouds are smooth: where the denoiser works least, and a path costs most.
            beyond = self._sky.take(left_open > _CLOSED, channels, max((samples + 1) // 2, min(samples, 4)), seed)
        return np.asarray(np.maximum(image, 0.0) + left_open[..., None] * beyond)  # cube faces leave -1e-15

    def _capture(self, scene: Any, samples: int, name: tuple[str, int, int]) -> Floats:
        seed = child_seed(self._shot.seed, *name)
        with self._timer("mitsuba"):
            return capture(self._hidden, scene, self._shot.camera, samples=samples, seed=seed)
