"""A scene under a clear or overcast sky."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from forestgen.core.randomness import child_seed
from forestgen.render.identity import SceneTracer
from forestgen.render.paths.lit_scene import LitScene
from forestgen.render.shot import Shot, Timer
from forestgen.render.sky_radiance import sky_map
from forestgen.scene.channels import Channels


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
