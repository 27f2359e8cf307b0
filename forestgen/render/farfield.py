"""A scene under clouds that are far above it.

Three parts add up: light of the sky on the scene, from a map that all cameras share (render/sky.py) and corrected for
what lies elsewhere; light of the sun on the scene, through the clouds' shadow (render/cloud_shadow.py), found by the
same paths; and the sky itself in the share of each pixel that the scene leaves open (render/sky_pixels.py). Clouds
never enter the scene that paths meet, so a view costs about what it costs under a clear sky. When that holds:
render/transport.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.core.progress import Progress
from forestgen.core.randomness import child_seed
from forestgen.render import sky
from forestgen.render.build import origin_of
from forestgen.render.cloud_heights import base_of
from forestgen.render.cloud_shadow import sheet_of
from forestgen.render.identity import SceneTracer
from forestgen.render.light import has_sun
from forestgen.render.paths.lit_scene import LitScene
from forestgen.render.shot import Shot, Timer
from forestgen.render.sky_pixels import SkyPixels
from forestgen.scene.channels import Channels

Floats = NDArray[np.float64]


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
