"""How much of the sun reaches a camera's lens: past what stands in the way, through clouds and fog.

Rays from the camera's place to `_RAYS` points of the disc, in the middle of the exposure. By night it is the moon's.
"""

from __future__ import annotations

import numpy as np

from forestgen.atmosphere.optical_depth import optical_depth
from forestgen.render.build import origin_of
from forestgen.render.frame import RenderJob, SunAtLens
from forestgen.render.identity import SceneTracer
from forestgen.render.light import SUN_RADIUS_DEG, has_sun
from forestgen.render.paths.fog import Fog
from forestgen.render.skies.model import daylight_of
from forestgen.render.variant import dr, mi, on_device, using
from forestgen.render.wavelengths import quadrature_of

_RAYS = 256
_LEAST_SLOPE = 0.02  # z of a direction that a lens sees


def sun_at_lens(job: RenderJob, tracer: SceneTracer) -> SunAtLens | None:
    """Of a camera whose lens has ghosts; None: of another one, or there is no sun before it."""
    camera, spec = job.camera, job.spec
    if camera.exposure is None or camera.exposure.ghosts is None or not has_sun(spec.sky):
        return None
    to_sun = np.asarray(spec.sky.to_light, dtype=np.float64)
    x, y, z = (float(one) for one in to_sun @ camera.world_from_camera)
    if z < _LEAST_SLOPE:
        return None
    number = np.arange(_RAYS)
    radius = np.tan(np.radians(SUN_RADIUS_DEG)) * np.sqrt((number + 0.5) / _RAYS)
    turn = number * np.pi * (3.0 - np.sqrt(5.0))  # Vogel's spiral
    side = np.cross(to_sun, [1.0, 0.0, 0.0] if abs(to_sun[0]) < 0.9 else [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    disc = (radius * np.cos(turn))[:, None] * side + (radius * np.sin(turn))[:, None] * np.cross(to_sun, side)
    ways = (to_sun + disc) / np.linalg.norm(to_sun + disc, axis=1, keepdims=True)
    comes = np.ones(_RAYS)
    if spec.clouds is not None:
        comes *= np.exp(-optical_depth(spec.clouds, np.asarray(camera.position_m), ways, np.inf))
    with using(tracer.variant):
        start = mi.Point3f(*(origin_of(camera) - tracer.origin_m).tolist()) + dr.zeros(mi.Point3f, _RAYS)
        along = mi.Vector3f(*(on_device(mi.Float, axis) for axis in ways.T))
        comes *= ~np.array(tracer.scene.ray_test(mi.Ray3f(start, along)))
        if spec.fog:
            comes *= np.array(Fog(spec.fog, tracer.origin_m).through(start, along))
    light = daylight_of(spec.sky)
    share = float(comes.mean())
    of_channel = quadrature_of(camera, job.mode, light.on_level).of_light(light.sun)
    return SunAtLens((x, y, z), tuple(share * max(one, 0.0) for one in of_channel))
