"""Snow on ground and plants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.core.progress import Timings
from forestgen.core.randomness import child_rng
from forestgen.render.identity import SceneTracer, trace_identity
from forestgen.render.light import sky_map
from forestgen.render.paths.tracer import PathTracer
from forestgen.scene.colour import RGB
from forestgen.scene.spec import SceneSpec, Sky, SnowCover
from forestgen.scene.terrain import HeightField, build_terrain
from forestgen.scene.weather.snow_cover import drifted
from support.scenes import camera_at, scattered_scene

WHITE = (0.9, 0.9, 0.9)
SKY = Sky(40.0, 140.0, 3.0)


def stand(above: bool, share: float | None) -> SceneSpec:
    spec = scattered_scene(60, size_m=20.0, leaves=400)
    camera = camera_at((10.0, 10.0, 60.0), (10.0, 10.1, 0.0), (48, 32), 25.0)
    if not above:
        camera = camera_at((10.0, 10.0, 0.05), (10.0, 10.1, 60.0), (48, 32), 60.0)
    snow = None if share is None else SnowCover(share, WHITE, build_terrain(HeightField((9, 9)), child_rng(0)).spectrum)
    return replace(spec, cameras=(camera,), snow=snow)


def seen(spec: SceneSpec):
    return trace_identity(
        SceneTracer(spec, Timings()), spec.cameras[0], samples=1, timer=Timings(), advance=lambda rows: None
    )


@pytest.mark.parametrize("above", [True, False])
def test_snow_lies_on_what_faces_up_and_changes_no_label(above: bool) -> None:
    (_, bare), (_, white) = seen(stand(above, None)), seen(stand(above, 0.8))
    for name in ("plant_id", "part", "face", "depth_m", "position_m", "normal", "sun_visible"):
        assert np.array_equal(getattr(bare, name), getattr(white, name), equal_nan=name == "position_m"), name
    plants = bare.plant_id > 0
    changed = (bare.albedo != white.albedo).any(axis=-1)
    assert not changed[~plants].any()
    assert (white.normal[changed][:, 2] > 0).all()
    assert np.allclose(white.albedo[changed], WHITE)
    level = plants & (np.abs(white.normal[..., 2]) > 0.6)
    if above:
        assert changed[level].mean() == pytest.approx(0.8, abs=0.12)
    else:
        assert not changed[level & (white.normal[..., 2] < 0)].any()


def test_the_light_meets_the_snow_that_the_labels_know() -> None:
    light = []
    for spec in (stand(True, None), stand(True, 1.0)):
        tracer = SceneTracer(spec, Timings())
        paths = PathTracer(tracer, spec.cameras[0], 64, lambda channels: sky_map(SKY, channels))
        paths.show(RGB)
        found = paths.take(16, 1)
        light.append((found.by_sky + found.by_sun)[..., 1])
    _, surface = seen(stand(True, 1.0))
    snowy = np.isclose(surface.albedo[..., 1], WHITE[1]) & surface.sun_visible
    assert np.median(light[1][snowy] / light[0][snowy]) > 1.5


def test_drifts_have_their_mean_depth() -> None:
    mesh = build_terrain(HeightField((60.0, 60.0)), child_rng(1)).mesh
    raised = drifted(mesh, 0.2, child_rng(2))
    near = np.all(np.abs(mesh.vertices_m[:, :2] - 30.0) < 40.0, axis=1)
    depth = (raised.vertices_m - mesh.vertices_m)[near, 2]
    assert depth.min() >= 0
    assert depth.mean() == pytest.approx(0.2, abs=0.02)
    assert 0.02 < depth.std() < 0.08
    assert raised.normals is not None
    assert np.allclose(np.linalg.norm(raised.normals, axis=1), 1.0, atol=1e-5)


def test_snow_is_the_plants_own_wherever_its_row() -> None:
    spec = stand(True, 0.5)
    shuffled = replace(spec, instances=spec.instances.at(np.random.default_rng(4).permutation(60)))
    (_, one), (_, other) = seen(spec), seen(shuffled)
    assert np.array_equal(one.albedo, other.albedo)
