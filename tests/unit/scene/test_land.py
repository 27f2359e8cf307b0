"""Micro-relief, paths, ponds and streams: the ground's shape, its mesh, what keeps off, and errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from forestgen.core.errors import RecipeError
from forestgen.recipe import land
from forestgen.recipe.load import load_recipe_data
from forestgen.scene.fine_cells import cut_grid
from forestgen.scene.ground_cover import _placed
from forestgen.scene.ground_layers.layer import Layer
from forestgen.scene.ground_view import TILE_M
from forestgen.scene.shaped_ground import BESIDE_M, SHALLOW_M, ShapedGround, shaped
from forestgen.scene.site import height_field
from forestgen.scene.spec import Material
from forestgen.scene.terrain import HeightField, terrain_mesh
from forestgen.scene.terrains.rolling import rolling
from forestgen.scene.water import WAVES_M, slope_variance, water_material, waves
from forestgen.scene.water_surface import _surfaces
from support.error_messages import raises_error

SIZE_M = (60.0, 60.0)
POND = land.Pond(what="pond", position_m=(34.0, 36.0), radius_m=8.0, depth_m=1.2)
STREAM = land.Stream(what="stream", points_m=((-20.0, 5.0), (10.0, 10.0), (34.0, 36.0)), width_m=1.5)
ROAD = land.Path(what="forest_road", points_m=((-30.0, 52.0), (30.0, 50.0), (90.0, 55.0)))
PATH = land.Path(points_m=((50.0, -20.0), (48.0, 30.0), (55.0, 80.0)))


@pytest.fixture(scope="module")
def base() -> HeightField:
    return rolling(SIZE_M, 0.8, 70.0, np.random.default_rng(1))


@pytest.fixture(scope="module")
def ground(base: HeightField) -> ShapedGround:
    return shaped(base, None, (ROAD, PATH), (POND, STREAM), 3)


def grid(step_m: float = 0.2) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.arange(-5.0, 65.0, step_m), np.arange(-5.0, 65.0, step_m))
    return x.ravel(), y.ravel()


def test_a_pond_has_its_size_and_depth_and_runs_out_nowhere(base: HeightField) -> None:
    ground = shaped(base, None, (), (POND,), 3)
    x, y = grid()
    height, level = ground(x, y), ground.level(x, y)
    wet = level > height
    assert wet.sum() * 0.04 == pytest.approx(np.pi * 8.0**2, rel=0.25)
    assert np.max(level[wet] - height[wet]) == pytest.approx(1.2, abs=0.05)
    assert len(np.unique(level[wet])) == 1
    side = round(np.sqrt(len(x)))
    wet, known = wet.reshape(side, side), np.isfinite(level).reshape(side, side)
    for axis in (0, 1):  # beside wet ground lies ground whose level is known: a shore
        assert not (wet & ~np.roll(known, 1, axis)).any()
        assert not (wet & ~np.roll(known, -1, axis)).any()


def test_a_stream_runs_down_to_a_pond_and_cuts_no_cliffs(base: HeightField, ground: ShapedGround) -> None:
    fall = np.diff(ground.bodies[1].level_m)
    assert fall.max() < 1e-9
    x, y = grid(0.15)
    side = round(np.sqrt(len(x)))
    slopes = np.gradient(ground(x, y).reshape(side, side), 0.15)
    assert np.hypot(*slopes).max() < 1.2  # the base has 0.3, a bank up to 1
    far = np.hypot(x - 34.0, y - 36.0) > 40.0
    assert np.mean(ground(x[far], y[far]) == base(x[far], y[far])) > 0.5


@dataclass(frozen=True, eq=False)
class Slope(HeightField):
    """Ground that rises northwards."""

    rise: float = 0.3

    def _height(self, x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
        return 5.0 - 0.01 * x_m + self.rise * y_m


@pytest.mark.parametrize("width_m", [1.5, 20.0])
def test_a_stream_on_a_cross_slope_stays_below_its_banks(width_m: float) -> None:
    stream = land.Stream(what="stream", points_m=((0.0, 30.0), (60.0, 30.0)), width_m=width_m)
    ground = shaped(Slope(SIZE_M), None, (), (stream,), 3)
    x, y = (one.ravel() for one in np.meshgrid(np.arange(5.0, 55.0, 0.2), np.arange(5.0, 55.0, 0.2)))
    near = ground.bodies[0].near(x, y)
    beyond = (near.shore_m > 0.45) & (near.shore_m < 0.5)
    assert np.max(near.level_m[beyond] - ground(x, y)[near.rows][beyond]) < 0.0


def test_a_stream_runs_into_a_pond_in_either_order(base: HeightField) -> None:
    one, other = (shaped(base, None, (), water, 3) for water in ((POND, STREAM), (STREAM, POND)))
    x, y = grid(0.5)
    both = [np.sort([body.keys.what for body in ground.bodies]).tolist() for ground in (one, other)]
    assert both[0] == both[1]
    shared = [np.isfinite(ground.level(x, y)).mean() for ground in (one, other)]
    assert shared[0] == pytest.approx(shared[1], rel=0.1)


@pytest.mark.parametrize("longest_m", [2.0, 4.0])
def test_the_mesh_has_the_micro_relief(longest_m: float) -> None:
    ground = shaped(HeightField((20.0, 20.0)), land.MicroRelief(rms_m=0.1, longest_m=longest_m), (), (), 3)
    mesh = terrain_mesh(ground)
    middle = mesh.vertices_m[mesh.faces].astype(np.float64).mean(axis=1)
    inside = (np.abs(middle[:, :2] - 10.0) < 10.0).all(axis=1)
    error = middle[inside, 2] - ground(*middle[inside, :2].T)
    assert error.std() < 0.25 * 0.1


def test_a_path_is_level_across_and_a_road_has_two_ruts() -> None:
    slope = rolling(SIZE_M, 3.0, 200.0, np.random.default_rng(1))
    road = land.Path(what="forest_road", points_m=((10.0, 30.0), (50.0, 30.0)))
    ground = shaped(slope, None, (road,), (), 3)
    across = np.linspace(-2.2, 2.2, 441)
    section = np.mean([ground(np.full(441, x), 30.0 + across) for x in np.linspace(20.0, 40.0, 60)], axis=0)
    inner = np.abs(across) < 1.7
    assert abs(np.polyfit(across[inner], section[inner], 1)[0]) < 0.01
    low = across[np.r_[False, (np.diff(section)[:-1] < 0) & (np.diff(section)[1:] >= 0), False]]
    np.testing.assert_allclose(low[np.abs(low) < 1.5], [-0.9, 0.9], atol=0.1)
    along = np.linspace(20.0, 40.0, 400)
    strip, rut, verge, beyond = (
        [part(along, np.full(400, 30.0 + away)).mean() for part in (ground.trodden, ground.roadside, ground.open_share)]
        for away in (0.0, 0.9, 2.4, 4.2)
    )
    assert rut[0] > 0.8
    assert min(strip[1], verge[1]) > 0.7
    assert beyond == pytest.approx([0.0, 0.0, 1.0], abs=0.05)


def test_where_roads_meet_neither_has_grass_on_the_ruts_of_the_other() -> None:
    roads = [land.Path(what="forest_road", points_m=ends) for ends in (((10, 30), (50, 30)), ((30, 10), (30, 50)))]
    one, both = (shaped(HeightField(SIZE_M), None, tuple(paths), (), 3) for paths in (roads[:1], roads))
    x, y = np.meshgrid(np.linspace(20.0, 40.0, 100), np.linspace(29.0, 31.0, 20))
    bare, green = both.bare_and_green(x.ravel(), y.ravel())
    assert (bare + green).max() <= 1.0
    assert (bare >= one.bare_and_green(x.ravel(), y.ravel())[0]).all()


def test_plants_of_the_shore_stand_in_shallow_water_and_beside_it_alone(ground: ShapedGround) -> None:
    x, y = grid()
    share, deep, from_shore = ground.shore(x, y), ground.level(x, y) - ground(x, y), np.full(len(x), np.inf)
    for body in ground.bodies:
        near = body.near(x, y)
        from_shore[near.rows] = np.minimum(from_shore[near.rows], near.shore_m)
    assert share[(from_shore > BESIDE_M) | (deep > SHALLOW_M + 0.1)].max() == 0.0
    assert share[np.abs(from_shore) < 0.1].min() > 0.7
    assert share.max() == 1.0
    layer = Layer("reed", (), {}, 0.3, Material((0.1, 0.1, 0.1)), 0.0)
    density = _placed(layer, "shore", ground).where
    assert density is not None
    assert density(x, y)[from_shore > BESIDE_M + TILE_M].max() == 0.0  # a tile's corners are less far from its middle
    afloat = _placed(layer, "water", ground)
    assert afloat.where is not None
    assert afloat.floats
    assert afloat.where(x, y)[deep > 0.8].min() == 1.0
    assert afloat.where(x, y)[from_shore > TILE_M].max() == 0.0


def test_micro_relief_has_its_deviation_and_fades_beside_the_site() -> None:
    ground = shaped(HeightField(SIZE_M), land.MicroRelief(rms_m=0.08), (), (), 5)
    x, y = np.random.default_rng(1).random((2, 40_000)) * 60.0
    assert ground(x, y).std() == pytest.approx(0.08, rel=0.1)
    assert not ground(x + 100.0, y).any()
    assert len(terrain_mesh(ground).faces) > 1.5 * len(terrain_mesh(HeightField(SIZE_M)).faces)


def test_fine_cells_leave_no_gap_and_no_overlap() -> None:
    rng = np.random.default_rng(2)
    xs, ys = np.cumsum(rng.random(13) + 0.5), np.cumsum(rng.random(9) + 0.5)
    places, faces = cut_grid(xs, ys, rng.random((8, 12)) < 0.3, 4)
    a, b, c = (places[faces[:, k]] for k in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert area.min() > 0.0
    assert area.sum() == pytest.approx((xs[-1] - xs[0]) * (ys[-1] - ys[0]))
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    twins = {(int(one), int(other)) for one, other in edges}
    alone = np.array([pair for pair in twins if pair[::-1] not in twins])
    on_edge = (places == places.min(axis=0)) | (places == places.max(axis=0))
    assert len(twins) == len(edges)
    assert np.all((on_edge[alone[:, 0]] & on_edge[alone[:, 1]]).any(axis=1))


def test_the_mesh_has_the_ruts_and_water_lies_on_it(ground: ShapedGround) -> None:
    mesh = terrain_mesh(ground)
    corner = mesh.vertices_m[mesh.faces].astype(np.float64)
    middle = corner.mean(axis=1)
    near = ground.tracks[0].within(*middle[:, :2].T, -0.1) & (np.abs(middle[:, :2] - 30.0) < 30.0).all(axis=1)
    error = middle[near, 2] - ground(*middle[near, :2].T)
    assert np.abs(error).max() < 0.01
    surfaces = _surfaces(ground, mesh)
    assert sorted(surfaces) == [0, 1]
    np.testing.assert_allclose(surfaces[0].vertices_m[:, 2], ground.bodies[0].level_m, atol=1e-4)


def test_waves_have_the_slopes_of_cox_and_munk() -> None:
    assert slope_variance(5.0) == pytest.approx(0.0286)
    height = waves(0.01, np.random.default_rng(1)).astype(np.float64)
    slopes = [(np.roll(height, -1, k) - np.roll(height, 1, k)) * len(height) / (2.0 * WAVES_M) for k in (0, 1)]
    assert np.mean(slopes[0] ** 2 + slopes[1] ** 2) == pytest.approx(0.01, rel=1e-3)
    windy = water_material(POND, 4.0, np.random.default_rng(1))
    assert windy.texture is not None
    normals = windy.texture.normals().astype(np.float64)
    seen = np.mean((normals[..., 0] / normals[..., 2]) ** 2 + (normals[..., 1] / normals[..., 2]) ** 2)
    assert seen + windy.roughness**4 == pytest.approx(slope_variance(4.0), rel=0.03)
    assert water_material(POND, 0.0, np.random.default_rng(1)).texture is None


DATA: dict[str, Any] = {
    "forestgen": 1,
    "seed": 4,
    "site": {"size_m": [20, 20]},
    "species": {"beech": "beech"},
    "community": {"model": "placed", "plants": [{"species": "beech", "position_m": [2, 5], "height_m": 6}]},
}


def test_without_its_keys_the_ground_is_as_it_was() -> None:
    drawn = load_recipe_data(DATA, "test").draw(0)
    assert type(height_field(drawn)) is HeightField
    assert "water" not in drawn.recipe.site.model_dump()


def test_a_stream_does_not_run_uphill_to_a_pond() -> None:
    site: dict[str, Any] = {"size_m": [60, 60], "terrain": {"kind": "rolling", "amplitude_m": 3, "wavelength_m": 40}}
    hills = height_field(load_recipe_data({**DATA, "site": site}, "test").draw(0))
    x, y = (one.ravel() for one in np.meshgrid(np.arange(5.0, 60.0, 5.0), np.arange(5.0, 60.0, 5.0)))
    order = np.argsort(hills(x, y))
    low, top, lowest = ([float(x[k]), float(y[k])] for k in order[[8, -1, 0]])
    pond = {"what": "pond", "position_m": top, "radius_m": 2}
    site["water"] = [pond, {"what": "stream", "points_m": [low, top, top, top, lowest]}]
    with raises_error(RecipeError, place="site.water.1"):
        height_field(load_recipe_data({**DATA, "site": site}, "test").draw(0))


@pytest.mark.parametrize(
    ("site", "place"),
    [
        ({"water": [{"what": "pond", "position_m": [25, 5], "radius_m": 3}]}, "site.water.0.position_m"),
        ({"water": [{"what": "stream", "points_m": [[5, 5], [5, 90]]}]}, "site.water.0.points_m.1"),
        ({"water": [{"what": "pond", "position_m": [5, 5], "radius_m": 3, "depth_m": -1}]}, "site.water.0.depth_m"),
        ({"water": [{"what": "lake"}]}, "site.water.0.what"),
        ({"paths": [{"points_m": [[5, 5]]}]}, "site.paths.0.points_m"),
        ({"paths": [{"points_m": [[5, 5], [5, 5]]}]}, "site.paths.0.points_m"),
        ({"paths": [{"points_m": [[5, 5], [9, 9]], "ground": "tar"}]}, "site.paths.0.ground"),
        ({"micro_relief": {"rms_m": 2}}, "site.micro_relief.rms_m"),
        ({"paths": [{"what": "forest_road", "points_m": [[5, 5], [9, 9]], "width_m": 1}]}, "site.paths.0"),
        ({"ground": {"layers": [{"what": "moss", "on": "shore"}]}}, "site.ground.layers.0.on"),
        (
            {"paths": [{"points_m": [[5, 5], [9, 9]]}], "ground": {"layers": [{"what": "moss", "on": "roadside"}]}},
            "site.ground.layers.0.on",
        ),
    ],
)
def test_bad_keys(site: dict[str, Any], place: str) -> None:
    with raises_error(RecipeError, place=place):
        load_recipe_data({**DATA, "site": {**DATA["site"], **site}}, "test").draw(0)
