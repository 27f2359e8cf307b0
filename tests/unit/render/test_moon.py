"""The moon's disc as the renderer has it, among clouds, against the disc of our own light paths."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.core.frames import look_at
from forestgen.render.capture import capture
from forestgen.render.light import moon_phase, sun_disc, sun_irradiance, sun_radiance
from forestgen.render.paths.tracer import Sun
from forestgen.render.variant import LLVM, SCALAR, mi, mitsuba, path_tracer, using
from forestgen.scene.colour import RGB
from forestgen.scene.projection import world_rays
from forestgen.scene.spec import Camera, Moon, Sky


@pytest.mark.parametrize("azimuth_deg", [30.0, 200.0])
def test_both_discs_have_the_same_phase_and_the_same_light(azimuth_deg):
    sky = Sky(-25.0, azimuth_deg, 3.0, moon=Moon(40.0, 120.0, 75.0))
    x, y, z = (float(one) for one in sky.to_light)
    camera = Camera("moon", (0.0, 0.0, 0.0), look_at((0.0, 0.0, 0.0), (x, y, z)), (64, 64), 0.7)
    with using(SCALAR):
        scene = mi.load_dict({"type": "scene", "sun": sun_disc(sky, RGB)})
        image = capture(path_tracer("path", 2), scene, camera, samples=64, seed=1)[..., :3]
    mitsuba()
    with using(LLVM):
        sun = Sun(sky.to_light, sun_irradiance(sky, RGB), sun_radiance(sky, RGB), None, np.zeros(3), moon_phase(sky))
        way = world_rays(camera).direction.reshape(-1, 3).T
        own = np.array(sun.seen(mi.Vector3f(*(mi.Float(one) for one in way)))).T.reshape(64, 64, 3)
    assert image.mean() == pytest.approx(own.mean(), rel=0.02)
    assert np.abs(image - own).mean() < 0.05 * own.mean()
    assert 0.2 < (own[..., 1] > 0.1 * own.max()).mean() / (np.pi / 4 * (0.533 / 0.7) ** 2) < 0.8
