"""Rain's water on surfaces: how dark it makes them, what it mirrors, and that no label knows of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.core.parts import Part
from forestgen.core.progress import Timings
from forestgen.recipe.spectra import load_table
from forestgen.render.identity import SceneTracer, hit_tables, trace_identity
from forestgen.render.paths.tracer import PathTracer
from forestgen.render.skies.model import MAP_COLUMNS, MAP_ROWS
from forestgen.scene.colour import RGB
from forestgen.scene.spec import SceneSpec, WetFilm
from forestgen.scene.surfaces import under_film
from support.scenes import camera_at, plain_ground, scattered_scene

SOIL = 0.2


def stand(share: float | None, slant: tuple[float, float] = (0.0, 0.0), pool_m: float = -1.0) -> SceneSpec:
    """Posts in leaves on grey soil; `share` of a film, None: dry. The ground is wet in the west alone."""
    spec = scattered_scene(60, size_m=20.0, leaves=60, terrain=plain_ground(-20.0, 40.0, 60, albedo=SOIL))
    camera = camera_at((10.0, -6.0, 3.0), (10.0, 10.0, 1.5), (96, 64), 70.0)
    vertices = spec.terrain.mesh.vertices_m
    if share is None:
        return replace(spec, cameras=(camera,))
    ground = np.where(vertices[:, 0] < 10.0, share, 0.0).astype(np.float32)
    water = load_table("standards/water")["absorption_per_m"]
    film = WetFilm(share, slant, ground, np.full(len(vertices), pool_m, np.float32), water)
    return replace(spec, cameras=(camera,), film=film)


def seen(spec: SceneSpec):
    tracer = SceneTracer(spec, Timings())
    return trace_identity(tracer, spec.cameras[0], samples=1, timer=Timings(), advance=lambda rows: None)[1]


def test_it_darkens_as_lekner_and_dorf_say_and_changes_no_label() -> None:
    dry, wet = seen(stand(None)), seen(stand(1.0))
    for name in ("plant_id", "part", "face", "depth_m", "position_m", "normal", "shading_normal", "sun_visible"):
        assert np.array_equal(getattr(dry, name), getattr(wet, name), equal_nan=name == "position_m"), name
    share = (wet.albedo / np.maximum(dry.albedo, 1e-9))[..., 1]
    ground = dry.part == Part.GROUND
    west, east = (ground & (side * (dry.position_m[..., 0] - 10.0) > 1.0) for side in (-1, 1))
    np.testing.assert_allclose(share[west], under_film(np.array(SOIL)) / SOIL, rtol=1e-4)
    assert (wet.albedo[east] == dry.albedo[east]).all()
    assert (wet.albedo[dry.part == Part.LEAF] == dry.albedo[dry.part == Part.LEAF]).all()
    bark = share[dry.part == Part.TRUNK]
    under = float(under_film(np.array(0.12))) / 0.12
    assert 0.5 < under < 0.56, "about halved"
    assert bark.min() == pytest.approx(under, abs=1e-3)
    assert bark.max() == pytest.approx(1.0 - 0.2 * (1.0 - under), abs=1e-3), "damp beside streaks"
    assert 0.3 < np.mean(bark < under + 0.02) < 0.8


def test_rain_that_falls_aslant_wets_its_side_of_stems() -> None:
    dry, wet = seen(stand(None)), seen(stand(1.0, slant=(0.0, 0.4)))
    bark = dry.part == Part.TRUNK
    under = float(under_film(np.array(0.12))) / 0.12
    south = bark & (dry.shading_normal[..., 1] < -0.8)
    share = (wet.albedo / np.maximum(dry.albedo, 1e-9))[south][:, 1]
    assert np.mean(share < under + 0.02) > 0.9


def test_water_that_stands_mirrors_as_a_pond_and_shows_wet_ground() -> None:
    spec = stand(1.0, pool_m=0.05)
    spec = replace(spec, instances=spec.instances.at(np.zeros(0, dtype=np.intp)))
    spec = replace(spec, cameras=(camera_at((4.0, 4.0, 3.0), (4.0, 4.01, 0.0), (8, 8), 2.0),))
    whole = np.ones((MAP_ROWS, MAP_COLUMNS, 3), np.float32)
    paths = PathTracer(SceneTracer(spec, Timings()), spec.cameras[0], 64, lambda _: whole)
    paths.show(RGB)
    found = float(paths.take(1024, 3).by_sky.mean())
    assert found == pytest.approx(float(under_film(np.array(SOIL))) + ((1.333 - 1) / (1.333 + 1)) ** 2, rel=0.02)


def test_wet_litter_is_not_wetted_twice() -> None:
    spec = stand(1.0)
    leaf = replace(spec.materials["kind0", "leaf"], is_wet=True)
    litter = tuple(
        replace(one, organs=tuple(replace(organ, part=Part.LITTER) for organ in one.organs)) for one in spec.exemplars
    )
    soaks = hit_tables(replace(spec, exemplars=litter)).soaks
    wet = hit_tables(replace(spec, exemplars=litter, materials=dict.fromkeys(spec.materials, leaf))).soaks
    assert soaks is not None
    assert wet is not None
    assert (soaks[1:] == 1.0).all()
    assert not wet[1:].any()
