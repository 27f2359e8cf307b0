"""The five living conditions against closed forms, an integration of another kind, and their symmetries."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from forestgen.community.ground import relief
from forestgen.community.ground.living_conditions import ground_raster
from forestgen.community.ground.relief import Nodes, Relief, near_relief, route
from forestgen.community.population import Site

SIZE = (200.0, 200.0)
SHAPE = (40, 40)

NAMES = ("elevation_m", "slope_deg", "moisture", "wind", "sun")


def ground_rasters(site, shape, names=NAMES):  # type: ignore[no-untyped-def]
    """Each living condition on a grid."""
    return {name: ground_raster(site, name, shape) for name in names}


def plane(slope_deg: float, downhill_deg: float) -> Any:
    """Height function of a plane that falls towards a direction, clockwise from north."""
    gradient, away = np.tan(np.radians(slope_deg)), np.radians(downhill_deg)
    return lambda x, y: 50 - gradient * (np.sin(away) * x + np.cos(away) * y)


def hills(x: Any, y: Any) -> Any:
    return 9 * np.sin(0.041 * x + 0.3) * np.cos(0.053 * y) + 4 * np.sin(0.07 * x - 0.06 * y) + 0.03 * x


def ridge(x: Any, y: Any) -> Any:
    """A crest along x in the middle of the site."""
    return 20 * np.exp(-(((y - 100) / 40) ** 2)) + 0 * x


@pytest.mark.parametrize("height", [None, lambda x, y: 0 * x, lambda x, y: 7.0 + 0 * y])
def test_level_ground_is_neutral(height: Any) -> None:
    values = ground_rasters(Site(SIZE, height, altitude_m=100.0, latitude_deg=37.0, wind_from_deg=10.0), SHAPE)
    expected = {
        "elevation_m": 107.0 if height and height(0, 0) else 100.0,
        "slope_deg": 0,
        "moisture": 0.5,
        "wind": 0.5,
    }
    for name, level in expected.items():
        np.testing.assert_array_equal(values[name], level)
    np.testing.assert_allclose(values["sun"], 1.0, rtol=1e-9)


def test_hardly_any_relief_is_hardly_different_from_level_ground() -> None:
    values = ground_rasters(Site(SIZE, lambda x, y: 1e-4 * hills(x, y)), SHAPE)
    for name, level in (("moisture", 0.5), ("wind", 0.5), ("sun", 1.0), ("slope_deg", 0.0)):
        np.testing.assert_allclose(values[name], level, atol=0.01)


@pytest.mark.parametrize("slope_deg", [3.0, 20.0, 60.0])
@pytest.mark.parametrize("downhill_deg", [0.0, 90.0, 203.0])
def test_a_plane_has_its_slope_and_its_elevation(slope_deg: float, downhill_deg: float) -> None:
    site = Site((200.0, 120.0), plane(slope_deg, downhill_deg), altitude_m=-20.0)
    values = ground_rasters(site, (24, 40), ("slope_deg", "elevation_m"))
    np.testing.assert_allclose(values["slope_deg"], slope_deg, rtol=1e-9)
    x, y = np.meshgrid(np.arange(40) * 5 + 2.5, np.arange(24) * 5 + 2.5)
    np.testing.assert_allclose(values["elevation_m"], plane(slope_deg, downhill_deg)(x, y) - 20, atol=1e-9)


def sun_by_the_clock(latitude_deg: float, slope_deg: float, facing_deg: float) -> float:
    """Annual irradiation of a plane over that of level ground: Duffie and Beckman's equation 1.6.2, day by day.

    An orbit with its eccentricity (Kepler's equation by iteration) and its irradiance, perihelion 283 degrees of
    longitude; nothing of it is used by the raster.
    """
    mean = 2 * np.pi * (np.arange(365) + 0.5) / 365
    eccentricity, anomaly = 0.0167, mean
    for _ in range(20):
        anomaly = mean + eccentricity * np.sin(anomaly)
    true = 2 * np.arctan(np.sqrt((1 + eccentricity) / (1 - eccentricity)) * np.tan(anomaly / 2))
    irradiance = 1 / (1 - eccentricity * np.cos(anomaly)) ** 2
    d = np.arcsin(np.sin(np.radians(23.44)) * np.sin(true + np.radians(283.0)))[:, None]
    w = 2 * np.pi * ((np.arange(1440) + 0.5) / 1440 - 0.5)
    p, b, g = np.radians([latitude_deg, slope_deg, facing_deg - 180.0])  # g from south, west positive
    incidence = (
        np.sin(d) * np.sin(p) * np.cos(b)
        - np.sin(d) * np.cos(p) * np.sin(b) * np.cos(g)
        + np.cos(d) * np.cos(p) * np.cos(b) * np.cos(w)
        + np.cos(d) * np.sin(p) * np.sin(b) * np.cos(g) * np.cos(w)
        + np.cos(d) * np.sin(b) * np.sin(g) * np.sin(w)
    )
    level = np.maximum(np.sin(d) * np.sin(p) + np.cos(d) * np.cos(p) * np.cos(w), 0)
    plane = np.where(level > 0, np.maximum(incidence, 0), 0)
    return float((irradiance[:, None] * plane).sum() / (irradiance[:, None] * level).sum())


@pytest.mark.parametrize("latitude_deg", [-66.0, -23.0, 0.0, 15.0, 46.5, 90.0])
@pytest.mark.parametrize(("slope_deg", "facing_deg"), [(10, 180), (30, 0), (30, 180), (30, 250), (45, 90), (60, 20)])
def test_the_sun_on_a_plane_is_that_of_a_year_by_the_clock(
    latitude_deg: float, slope_deg: float, facing_deg: float
) -> None:
    site = Site((10.0, 10.0), plane(slope_deg, facing_deg), latitude_deg=latitude_deg)
    values = ground_raster(site, "sun", (8, 8))
    np.testing.assert_allclose(values, sun_by_the_clock(latitude_deg, slope_deg, facing_deg), rtol=0.006, atol=0.003)


def test_at_the_equator_north_and_south_get_the_same_and_the_page_tells_the_truth() -> None:
    def sun(latitude_deg: float, slope_deg: float, facing_deg: float) -> float:
        site = Site((10.0, 10.0), plane(slope_deg, facing_deg), latitude_deg=latitude_deg)
        return float(ground_raster(site, "sun", (3, 3))[1, 1])

    assert sun(0.0, 25.0, 0.0) == pytest.approx(sun(0.0, 25.0, 180.0), rel=1e-6)
    assert sun(50.0, 25.0, 90.0) == pytest.approx(sun(50.0, 25.0, 270.0), rel=1e-6)
    assert sun(-35.0, 25.0, 0.0) == pytest.approx(sun(35.0, 25.0, 180.0), rel=1e-6)
    assert (round(sun(50.0, 30.0, 180.0), 2), round(sun(50.0, 30.0, 0.0), 2)) == (1.36, 0.51)


def test_a_wall_to_the_south_takes_the_sun_and_one_to_the_north_does_not() -> None:
    def wall(y: Any) -> Any:
        return 30 / (1 + np.exp(-y / 2))

    level = slice(15, 25)  # level ground between
    south = ground_raster(Site(SIZE, lambda x, y: wall(60 - y) + 0 * x), "sun", SHAPE)[level]
    north = ground_raster(Site(SIZE, lambda x, y: wall(y - 140) + 0 * x), "sun", SHAPE)[level]
    assert south.max() < 0.9
    assert (np.diff(south[:, 20]) > 0).all()
    assert north.min() > 0.95
    assert north.max() <= 1 + 1e-9


def test_crests_are_windier_and_drier_than_valleys_and_wind_changes_sides_with_the_relief() -> None:
    crest, valley = Site(SIZE, ridge), Site(SIZE, lambda x, y: -ridge(x, y) + 0.02 * x)
    windy, calm = (ground_raster(site, "wind", SHAPE)[20, 5:35] for site in (crest, valley))
    assert windy.min() > 0.7
    assert calm.max() < 0.3
    dry, wet = (ground_raster(site, "moisture", SHAPE)[20, 5:35] for site in (crest, valley))
    assert dry.max() < 0.45
    assert wet.min() > 0.75
    up, down = (ground_raster(Site(SIZE, lambda x, y, s=s: s * hills(x, y)), "wind", SHAPE) for s in (1, -1))
    np.testing.assert_allclose(up + down, 1.0, atol=1e-5)
    facing = [
        ground_raster(Site(SIZE, plane(10, side), wind_from_deg=270), "wind", (3, 3))[1, 1] for side in (270, 90, 0)
    ]
    assert facing == pytest.approx([0.73, 0.27, 0.5], abs=0.01)


def raster(height: Any, nodes: int = 121, cell_m: float = 1.5) -> Relief:
    xs = np.arange(nodes) * cell_m
    return Relief(Nodes(xs, xs), cell_m, np.ascontiguousarray(height(*np.meshgrid(xs, xs)), dtype=np.float64))


@pytest.mark.parametrize("drunk", [False, True])
@pytest.mark.parametrize(
    "height", [hills, ridge, plane(10, 31), lambda x, y: 0 * x, lambda x, y: np.round(hills(x, y))]
)
def test_no_rain_is_lost_but_what_is_drunk(height: Any, drunk: bool) -> None:
    ground = raster(height)
    flow = route(ground, np.hypot(*ground.slopes) if drunk else None)
    ends = flow.share.sum(axis=1) == 0  # the water stays, or leaves the raster
    rain_m2 = ground.z_m.size * ground.cell_m**2
    assert flow.area_m2[ends].sum() + flow.lost_m2 == pytest.approx(rain_m2, rel=1e-12)
    assert (flow.lost_m2 > 0) == (drunk and not ends.all())
    sent = flow.share > 0
    z = ground.z_m.ravel()
    nodes = np.broadcast_to(np.arange(len(z))[:, None], sent.shape)
    assert (z[flow.receiver[sent]] < z[nodes[sent]]).all()  # always downhill


@pytest.mark.parametrize("downhill_deg", [0.0, 20.0, 45.0, 70.0, 225.0])
def test_on_a_plane_the_area_upslope_is_the_way_to_its_upper_edge(downhill_deg: float) -> None:
    flow = route(raster(plane(12, downhill_deg)))
    middle, away = 60, np.radians(downhill_deg)
    way_m = 60 * 1.5 / max(abs(np.sin(away)), abs(np.cos(away)))
    node = middle * 121 + middle
    assert flow.area_m2[node] / flow.contour_m[node] == pytest.approx(way_m, rel=0.03)


def test_a_hollow_keeps_its_water_and_a_narrow_valley_does_not() -> None:
    bowl = raster(lambda x, y: np.hypot(x - 90, y - 90))
    flow = route(bowl)
    assert int(np.argmax(flow.area_m2)) == 60 * 121 + 60
    assert flow.area_m2.max() > 0.7 * bowl.z_m.size * bowl.cell_m**2

    def valley(x: Any, y: Any) -> Any:  # at an angle that the raster has no step for
        along, across = x * np.cos(0.4) + y * np.sin(0.4), y * np.cos(0.4) - x * np.sin(0.4) - 30
        return 0.3 * np.abs(across) - 0.02 * along

    flow = route(raster(valley))
    inside = np.zeros((121, 121), dtype=bool)
    inside[6:-6, 6:-6] = True
    assert not (inside.ravel() & (flow.share.sum(axis=1) == 0)).any()


def test_twice_as_many_nodes_make_little_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[dict[str, NDArray[np.float64]]] = []
    for nodes in (240, 480, 960):
        monkeypatch.setattr(relief, "_NODES", nodes)
        found.append(ground_rasters(Site(SIZE, lambda x, y: hills(x, y)), SHAPE))
    for name, allowed in zip(NAMES, (0.01, 0.2, 0.04, 0.02, 0.02), strict=True):
        coarse, fine = (np.sqrt(np.mean((one[name] - found[2][name]) ** 2)) for one in found[:2])
        assert fine < coarse or coarse < 1e-3, name
        assert fine < allowed, name


def test_grids_of_any_number_of_cells_agree() -> None:
    site = Site(SIZE, hills)
    for name in NAMES:
        fine = ground_raster(site, name, (120, 120))
        np.testing.assert_allclose(ground_raster(site, name, SHAPE), fine[1::3, 1::3], atol=1e-9)
        np.testing.assert_allclose(ground_raster(site, name, (120, 120), slice(50, 60)), fine[50:60])


def test_land_that_is_moved_takes_its_conditions_with_it() -> None:
    still = ground_rasters(Site(SIZE, hills), SHAPE)
    moved = ground_rasters(Site(SIZE, lambda x, y: hills(x + 25, y - 10)), SHAPE)
    for name, allowed in zip(NAMES, (0.02, 0.2, 0.03, 0.02, 0.02), strict=True):
        np.testing.assert_allclose(moved[name][2:, :-5], still[name][:-2, 5:], atol=allowed, err_msg=name)
    lifted = ground_rasters(Site(SIZE, lambda x, y: hills(x, y) + 1000), SHAPE)
    for name in NAMES:
        np.testing.assert_allclose(lifted[name], still[name] + 1000 * (name == "elevation_m"), atol=1e-6, err_msg=name)


def test_land_that_turns_together_with_the_wind_takes_its_conditions_with_it() -> None:
    still = ground_rasters(Site(SIZE, hills, wind_from_deg=300.0, latitude_deg=90.0), SHAPE)
    turned = Site(
        SIZE, lambda x, y: hills(y, 200 - x), wind_from_deg=210.0, latitude_deg=90.0
    )  # a quarter, to the left
    for name, values in ground_rasters(turned, SHAPE).items():
        np.testing.assert_allclose(values, np.rot90(still[name], -1), atol=2e-3, err_msg=name)


def test_a_height_that_is_no_number_is_refused() -> None:
    with pytest.raises(ValueError, match="must be finite"):
        ground_raster(Site(SIZE, lambda x, y: np.where(x > 150, np.nan, 0.0)), "slope_deg", SHAPE)


@pytest.mark.parametrize("size_m", [(1.0, 1.0), (3.0, 700.0), (5000.0, 40.0)])
def test_sites_of_any_form_have_all_conditions(size_m: tuple[float, float]) -> None:
    for values in ground_rasters(Site(size_m, hills), (7, 5)).values():
        assert values.shape == (7, 5)
        assert np.isfinite(values).all()


def test_the_land_around_the_site_counts_alike_on_all_sides() -> None:
    ground = near_relief(hills, Site((60.0, 30.0)))
    assert ground.nodes.x_m[0] <= -200
    assert ground.nodes.x_m[-1] >= 260
    assert ground.nodes.y_m[0] <= -200
    assert ground.nodes.y_m[-1] >= 230
    assert ground.nodes.x_m[0] + ground.nodes.x_m[-1] == pytest.approx(60.0)
