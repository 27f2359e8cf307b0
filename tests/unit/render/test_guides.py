"""Guides of the denoiser."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.core.parts import Part
from forestgen.core.progress import Timings
from forestgen.render.identity import SceneTracer, trace_identity
from support.guides import trace_guides
from support.scenes import camera_at, plain_ground, scattered_scene


def lit_ground(elevation_deg, kind="clear"):
    """Bare ground as a camera straight above sees it, and its colour."""
    spec = scattered_scene(3, exemplars=1, leaves=4, terrain=plain_ground(-200, 200))
    aside = replace(spec.instances, transform=spec.instances.transform + np.array([0, 0, 0, 1000.0]))
    camera = camera_at((0.0, 0.0, 30.0), (0.0, 0.1, 0.0), (16, 16))
    sky = replace(spec.sky, sun_elevation_deg=elevation_deg, kind=kind)
    spec = replace(spec, instances=aside, cameras=(camera,), sky=sky)
    return trace_guides(SceneTracer(spec, Timings()), camera), spec.terrain.mean_colour


@pytest.mark.parametrize("elevation_deg", [15.0, 60.0])
def test_open_ground_has_its_colour_in_the_suns_light(elevation_deg):
    guides, colour = lit_ground(elevation_deg)
    light = 0.15 + 0.85 * np.sin(np.radians(elevation_deg))
    np.testing.assert_allclose(guides.colour.mean(axis=(0, 1)), np.array(colour) * light, rtol=0.02)
    np.testing.assert_allclose(guides.normal[8, 8], [0.0, 0.0, 1.0], atol=1e-5)


def test_under_an_overcast_sky_there_is_no_shade():
    guides, colour = lit_ground(15.0, "overcast")
    np.testing.assert_allclose(guides.colour.mean(axis=(0, 1)), colour, rtol=0.02)


def test_under_an_overcast_sky_what_lies_below_others_is_darker():
    spec = scattered_scene(60, size_m=40.0, exemplars=2, leaves=300, terrain=plain_ground(-200, 200))
    camera = camera_at((20.0, 20.0, 60.0), (20.0, 20.1, 0.0), (24, 24))
    spec = replace(spec, cameras=(camera,), sky=replace(spec.sky, kind="overcast"))
    tracer = SceneTracer(spec, Timings())
    guides = trace_guides(tracer, camera)
    _, surface = trace_identity(tracer, camera, samples=4, timer=Timings(), advance=lambda rows: None)
    ground = (surface.part == Part.GROUND) & (guides.normal[..., 2] > 0.999)
    share = (guides.colour / np.array(spec.terrain.mean_colour))[ground]
    assert ground.sum() > 20
    assert 0.2 <= share.min() < 0.93 < share.max() < 1.03


def test_the_shade_is_darker_where_the_sky_is_hidden_too():
    spec = scattered_scene(60, size_m=40.0, exemplars=2, leaves=300, terrain=plain_ground(-200, 200))
    camera = camera_at((20.0, 20.0, 4.0), (20.0, 20.1, 0.0), (64, 64))
    spec = replace(spec, cameras=(camera,), sky=replace(spec.sky, kind="clear", sun_elevation_deg=20.0))
    share = trace_guides(SceneTracer(spec, Timings()), camera).colour.mean(axis=-1) / np.mean(spec.terrain.mean_colour)
    assert np.median(share) == pytest.approx(0.15 + 0.85 * np.sin(np.radians(20.0)), rel=0.01)
    assert 0.07 <= share.min() < 0.145  # 0.15 is the open shade
