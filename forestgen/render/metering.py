"""The shutter of a camera whose image depends on it: one that moves, or before which rain or snow falls.

Where the recipe gives no time, a meter sees the scene before: the mean luminance of a still image of few samples, in
colour whatever the sensor's bands. The raw image is then exposed for as long as things moved.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.core.frames import look_at
from forestgen.core.randomness import child_seed
from forestgen.core.spectrum import LUMINANCE
from forestgen.render.frame import Radiance, RenderJob, StoppingCriterion
from forestgen.scene.projection import image_circle
from forestgen.scene.spec import Camera

_SAMPLES = 4
_SPHERE_PX, _SAMPLES_AROUND = (32, 16), 32
_SUN_SHARE = 0.5  # per cent of pixels that the meter leaves out, the brightest


def metered_luminance(luminance: NDArray[np.float64], camera: Camera) -> float:
    """Mean of (H, W) over the picture, without the brightest; 0 where nothing is known."""
    grey = luminance[image_circle(camera)]
    grey = grey[np.isfinite(grey)]
    return float(np.minimum(grey, np.percentile(grey, 100.0 - _SUN_SHARE)).mean()) if grey.size else 0.0


def light_around(job: RenderJob, render: Callable[[RenderJob], Radiance]) -> NDArray[np.float64]:
    """(C,) mean radiance from all directions at a job's camera, without the brightest ones, such as the sun."""
    level = replace(
        job.camera, projection="panorama", world_from_camera=look_at((0, 0, 0), (0, 1, 0)), size_px=_SPHERE_PX
    )
    camera = replace(level, lens=None, motion=None, exposure=None, numbers={})
    seed = child_seed(job.seed, "around")
    found = render(replace(job, camera=camera, until=StoppingCriterion(_SAMPLES_AROUND), seed=seed, position_m=None))
    light = found.mean.astype(np.float64).reshape(-1, found.mean.shape[2])
    light = np.minimum(light, np.percentile(light, 100.0 - _SUN_SHARE, axis=0))
    weight = np.cos((np.arange(_SPHERE_PX[1]) + 0.5) / _SPHERE_PX[1] * np.pi - np.pi / 2)
    return np.average(light, axis=0, weights=np.repeat(weight, _SPHERE_PX[0]))


def with_shutter(job: RenderJob, render: Callable[[RenderJob], Radiance]) -> RenderJob:
    """The job with the shutter's time in its camera's exposure, if its image depends on that."""
    camera, exposure = job.camera, job.camera.exposure
    if exposure is None or exposure.shutter_s is not None or job.is_exact:
        return job
    if camera.motion is None and not job.spec.falling:
        return job
    luminance = 0.0
    if exposure.ev is None:
        still = replace(camera, motion=None, bands=())
        seed = child_seed(job.seed, "meter")
        metered = render(replace(job, camera=still, until=StoppingCriterion(_SAMPLES), seed=seed, mode="rgb"))
        luminance = metered_luminance(metered.mean.astype(np.float64).clip(0.0) @ np.array(LUMINANCE), still)
    exposure = exposure.model_copy(update={"shutter_s": exposure.shutter_for_s(luminance)})
    return replace(job, camera=replace(camera, exposure=exposure))
