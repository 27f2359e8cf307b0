"""How much of the sun shines on a lens."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.core.progress import Timings
from forestgen.recipe.exposure import Exposure
from forestgen.render.frame import RenderJob, StoppingCriterion
from forestgen.render.identity import SceneTracer
from forestgen.render.light import sun_irradiance
from forestgen.render.sun_at_lens import sun_at_lens
from forestgen.scene.colour import RGB
from forestgen.scene.spec import FogLayer
from support.scenes import camera_at, plain_ground, scattered_scene


def test_the_sun_shines_on_a_lens_unless_something_is_in_the_way():
    spec = scattered_scene(1, exemplars=1, leaves=4, terrain=plain_ground(-500.0, 500.0))
    to_sun, eye = spec.sky.to_sun, np.array([20.0, 0.0, 2.0])
    facing = replace(camera_at(tuple(eye), tuple(eye + to_sun), (32, 24)), exposure=Exposure(ghosts="coated"))
    away = replace(facing, world_from_camera=camera_at(tuple(eye), tuple(eye - to_sun), (32, 24)).world_from_camera)
    under = replace(facing, position_m=(20.0, 0.0, -2.0))

    def light(camera, **weather):
        spec_of = replace(spec, cameras=(camera,), **weather)
        job = RenderJob(spec_of, camera, StoppingCriterion(1), 1)
        return sun_at_lens(job, SceneTracer(spec_of, Timings()))

    free = light(facing)
    assert free is not None
    np.testing.assert_allclose(free.irradiance, sun_irradiance(spec.sky, RGB), rtol=1e-6)
    assert free.direction == pytest.approx((0.0, 0.0, 1.0), abs=1e-12)
    foggy = light(facing, fog=(FogLayer(0.01, 102.0, 0.5, 0.8),))
    assert foggy is not None
    through = np.exp(-0.01 * 100.0 / to_sun[2])
    assert foggy.irradiance[1] == pytest.approx(free.irradiance[1] * through, rel=0.03)
    assert light(under).irradiance == (0.0, 0.0, 0.0)
    assert light(away) is None
    assert light(replace(facing, exposure=Exposure())) is None
