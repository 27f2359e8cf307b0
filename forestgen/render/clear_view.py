"""A scene under a clear or overcast sky: one capture does all."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.core.randomness import child_seed
from forestgen.render.build import load, origin_of, scene_dict
from forestgen.render.light import emitters_of
from forestgen.render.painted import Painted, path_tracer
from forestgen.render.sensors import capture
from forestgen.render.views import Shot, Timer
from forestgen.scene.channels import Channels


class ClearView:
    def __init__(self, shot: Shot, timer: Timer) -> None:
        self._shot, self._timer = shot, timer
        self._painted = Painted(timer)
        with timer("radiance: build"):
            emitters = {name: self._painted.light(emitter) for name, emitter in emitters_of(shot.spec.sky).items()}
            self._scene = load({**scene_dict(shot.spec, origin_of(shot.camera), self._painted.paints), **emitters})
            self._integrator = path_tracer("path", shot.max_depth)

    def take(self, channels: Channels, samples: int, number: tuple[int, int]) -> NDArray[np.float64]:
        self._painted.show(channels)
        seed = child_seed(self._shot.seed, "clear", *number)
        with self._timer("mitsuba"):
            return capture(self._integrator, self._scene, self._shot.camera, samples=samples, seed=seed)[..., :3]
