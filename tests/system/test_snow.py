"""Snow on ground and plants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.core.parts import Part
from forestgen.core.progress import Timings
from forestgen.core.randomness import child_rng
from forestgen.recipe.spectra import load_table
from forestgen.render.identity import SceneTracer, trace_identity
from forestgen.render.light import sky_map
from forestgen.render.paths.scattering import Surfaces, fresnel
from forestgen.render.paths.tracer import PathTracer
from forestgen.render.variant import dr, mi
from forestgen.scene import snow_depth
from forestgen.scene.colour import RGB
from forestgen.scene.snow_depth import Circles, FinerGround, SnowDepth
from forestgen.scene.spec import Material, SceneSpec, Sky, SnowCover, WetFilm
from forestgen.scene.terrain import HeightField, build_terrain, terrain_mesh
from forestgen.scene.weather.snow_cover import raised
from support.scenes import camera_at, scattered_scene

WHITE = (0.9, 0.9, 0.9)
NO_STEMS = Circles(np.zeros((0, 2)), np.zeros(0))
SKY = Sky(40.0, 140.0, 3.0)


def stand(above: bool, share: float | None, plants: int = 60) -> SceneSpec:
    spec = scattered_scene(plants, size_m=20.0, leaves=400)
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


@pytest.mark.parametrize(
    ("eye", "target", "white"),
    [
        ((10.0, 10.0, 60.0), (10.0, 10.1, 0.0), 0.8),
        ((10.0, -40.0, 6.0), (10.0, 10.0, 6.0), 0.66),
        ((10.0, 10.0, 0.05), (10.0, 10.1, 60.0), 0.0),
    ],
    ids=["from above", "from the side", "from below"],
)
def test_loads_hide_what_bears_them_but_from_below(
    eye: tuple[float, float, float], target: tuple[float, float, float], white: float
) -> None:
    """From the side, those whose thickness, the mean of two even numbers, is above 0.25 / 0.85."""
    spec = replace(stand(True, 0.8, 1000), cameras=(camera_at(eye, target, (64, 48), 20.0),))
    _, surface = seen(spec)
    leaves = surface.part == Part.LEAF
    snowy = np.isclose(surface.albedo[..., 1], WHITE[1])[leaves]
    assert snowy.mean() == pytest.approx(white, abs=0.06)


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


@pytest.mark.parametrize("wet", [None, 0.05, 1.0])
def test_no_leaf_in_snow_or_rain_makes_light(wet: float | None) -> None:
    """Pale leaves in all positions, seen from the side: what comes back and goes through is at most 1."""
    spec = stand(True, 0.8 if wet is None else None)
    leaf = Material((0.49, 0.49, 0.49), (0.47, 0.47, 0.47), gloss=0.03, roughness=0.3)
    camera = camera_at((10.0, -6.0, 6.0), (10.0, 10.0, 6.0), (96, 64), 50.0)
    spec = replace(spec, materials=dict.fromkeys(spec.materials, leaf), cameras=(camera,))
    if wet is not None:
        none = np.zeros(len(spec.terrain.mesh.vertices_m), np.float32)
        water = load_table("standards/water")["absorption_per_m"]
        spec = replace(spec, film=WetFilm(wet, (0.0, 0.0), none, none - 1.0, water))
    tracer = SceneTracer(spec, Timings())
    surfaces = Surfaces(tracer)
    for _, hits in tracer.by_rows(camera, np.array([0.5, 0.5]), 10_000):
        surfaces.show(RGB)
        local = surfaces.at(hits)
        mirrored = local.gloss.x * fresnel(mi.Float(1.0), local.gloss.z)
        total = np.array(local.matt.x + local.through.x + dr.select(local.gloss.x > 0, mirrored, 0.0))
        seen, passes = np.array(local.matt.x) == np.float32(WHITE[0]), np.array(local.chance.x) > 0
        assert total.max() < 1.001
        assert not (seen & passes).any()
        assert seen.any() == (wet is None)
        if wet == 0.05:
            shines = np.array(mirrored)[passes]
            assert shines.min() > 0.95 * shines.max() > 0.02, "hardly duller than a dry leaf"


def depth_in(spec: SceneSpec, stems: Circles = NO_STEMS) -> SnowDepth:
    return SnowDepth.of(0.3, spec, stems, (20.0, 20.0), child_rng(2))


def places(step_m: float = 0.1) -> np.ndarray:
    x, y = np.meshgrid(*[np.arange(0.5 * step_m, 20.0, step_m)] * 2)
    return np.column_stack([x.ravel(), y.ravel()])


@pytest.mark.parametrize("trees", [0, 3, 60])
def test_what_crowns_keep_lies_in_the_open(trees: int) -> None:
    """The mean over the site is the recipe's; below the middle of a dense crown lies a third of that beside it."""
    leafy = scattered_scene(max(trees, 1), size_m=20.0, leaves=20_000)
    spec = replace(leafy, instances=leafy.instances.at(slice(0, trees)))
    depth, at = depth_in(spec), places()
    assert depth.at(at).mean() == pytest.approx(0.3, abs=0.01)
    assert (depth.share(at).mean() * depth.scale == pytest.approx(1.0, abs=0.005)) == (trees < 60), "is capped"
    if trees == 3:
        below = depth.share(spec.instances.transform[:, :2, 3])
        assert depth.share(at).max() == 1.0
        assert np.all((below > 0.29) & (below < 0.5)), "0.34 by Hardy and Albert"


def test_wells_stand_around_stems() -> None:
    bare = replace(stand(True, None), instances=stand(True, None).instances.at(np.zeros(0, np.intp)))
    depth = depth_in(bare, Circles(np.array([[10.0, 10.0], [15.0, 5.0]]), np.array([0.2, 0.01])))
    away = np.array([0.0, 0.3, 0.6, 1.5])
    thick, thin = (
        depth.share(np.column_stack([x + radius + away, np.full(4, y)]))
        for x, y, radius in ((10.0, 10.0, 0.2), (15.0, 5.0, 0.01))
    )
    assert thick[0] == pytest.approx(0.45)
    assert (np.diff(thick) > 0).all()
    assert thick[-1] > 0.995
    assert 0.9 < thin[0] < 1.0
    assert depth.share(places()).mean() * depth.scale == pytest.approx(1.0, abs=0.002)


def test_snow_in_the_open_around_a_dense_stand_is_not_deep_and_the_map_has_no_stripes() -> None:
    leafy = scattered_scene(200, size_m=20.0, leaves=60_000, exemplars=3)
    depth = depth_in(leafy)
    still = replace(
        depth, waves=replace(depth.waves, phase=0.0 * depth.waves.phase, wave_per_m=0.0 * depth.waves.wave_per_m)
    )
    assert depth.scale > 1.7
    away = still.at(np.array([[-15.0, 10.0], [-500.0, 3.0], [400.0, 700.0]]))
    assert np.allclose(away, 0.3 / 0.6, atol=1e-3)
    shifted = replace(leafy.instances, transform=leafy.instances.transform + np.array([0, 0, 0, -18.0]))
    border = depth_in(replace(leafy, instances=shifted))
    ways = np.column_stack([np.full(200, -19.0), np.linspace(-19.0, 39.0, 200)])
    assert np.ptp(border.below_crowns(ways)) > 0.02
    assert np.ptp(border.below_crowns(ways - [1.2, 0.0])) == pytest.approx(0.0, abs=1e-9)


def test_the_mean_needs_few_points(monkeypatch: pytest.MonkeyPatch) -> None:
    leafy = scattered_scene(60, size_m=20.0, leaves=20_000)
    whole = depth_in(leafy).scale
    monkeypatch.setattr(snow_depth, "_MOST_POINTS", 900)
    monkeypatch.setattr(snow_depth, "_AT_ONCE", 64)
    assert depth_in(leafy).scale == pytest.approx(whole, rel=0.03)


def test_drifts_have_their_mean_depth_and_the_mesh_is_finer_near_cameras() -> None:
    bare = replace(stand(True, None), instances=stand(True, None).instances.at(np.zeros(0, np.intp)))
    deep = depth_in(bare).at(places())
    assert deep.min() >= 0
    assert 0.2 < deep.std() / 0.3 < 0.3
    flat = HeightField((60.0, 60.0))
    stems = Circles(np.array([[30.0, 50.0], [30.0, 5.0]]), np.full(2, 0.2))
    mesh = terrain_mesh(FinerGround(flat.size_m, flat, stems, np.array([[30.0, 30.0, 1.7]])))
    found = [np.sum(np.hypot(*(mesh.vertices_m[:, :2] - at).T) < 0.5) for at in ((30, 32), (30, 50), (10, 50))]
    assert found[0] > 70
    assert found[1] > 70
    assert found[2] < 6
    white = raised(mesh, 0.2 + 0.0 * mesh.vertices_m[:, 0])
    assert np.allclose(white.vertices_m - mesh.vertices_m, [0.0, 0.0, 0.2], atol=1e-6)
    assert white.normals is not None
    assert np.allclose(white.normals, [0.0, 0.0, 1.0], atol=1e-4)


def test_snow_is_the_plants_own_wherever_its_row() -> None:
    spec = stand(True, 0.5)
    shuffled = replace(spec, instances=spec.instances.at(np.random.default_rng(4).permutation(60)))
    (_, one), (_, other) = seen(spec), seen(shuffled)
    assert np.array_equal(one.albedo, other.albedo)
