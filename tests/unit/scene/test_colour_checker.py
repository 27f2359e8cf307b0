"""The colour chart: its geometry, its colours by colour-science, the whites of known lights."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.core.spectrum import Spectrum
from forestgen.geometry.mesh import surface_area_m2
from forestgen.scene import colour_checker as checker
from forestgen.scene.colour import colour_science
from forestgen.scene.projection import project


def illuminant(name: str) -> Spectrum:
    colour = colour_science()

    found = colour.SDS_ILLUMINANTS[name]
    return Spectrum(np.asarray(found.wavelengths), np.asarray(found.values))


def centre_of(region: int) -> np.ndarray:
    mesh = checker.chart().organs[region].mesh
    return mesh.vertices_m[mesh.faces].mean(axis=(0, 1))


def test_the_regions_tile_the_board_and_face_the_viewer() -> None:
    organs = checker.chart().organs
    areas = np.array([surface_area_m2(organ.mesh) for organ in organs])
    np.testing.assert_allclose(areas[:-1], checker.PATCH_M**2, rtol=1e-5)
    assert areas.sum() == pytest.approx(checker.WIDTH_M * checker.HEIGHT_M, rel=1e-5)
    for organ in organs:
        a, b, c = (organ.mesh.vertices_m[organ.mesh.faces[:, k]] for k in range(3))
        assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_patches_are_where_the_charts_table_says() -> None:
    """Rows of six from the upper left: the greys are the lowest row, white at its left."""
    names = checker.region_names()
    assert names[18].startswith("white")
    assert names[23].startswith("black")
    assert centre_of(18)[1] < centre_of(0)[1]
    assert centre_of(0)[0] == pytest.approx(centre_of(18)[0], abs=1e-6)
    assert centre_of(23)[0] > centre_of(18)[0]
    faces = checker.region_of_face()
    assert len(faces) == checker.chart().triangles
    assert np.bincount(faces)[:24].tolist() == [2] * 24


@pytest.mark.parametrize("normal", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0.3, -0.5, 0.8)])
def test_the_board_fills_its_cameras_picture(normal: tuple[float, float, float]) -> None:
    point, towards = np.array([5.0, -3.0, 2.0]), np.array(normal, dtype=float)
    axes = checker.axes_of(towards)
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    camera = checker.camera(point, towards, 96)
    half = np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) / 2
    corners = half * [checker.WIDTH_M, checker.HEIGHT_M, 0]  # upper left first, clockwise
    world = corners @ checker.transform(point, towards)[:, :3].T + checker.transform(point, towards)[:, 3]
    seen = project(camera, (world - camera.position_m) @ camera.world_from_camera)
    width, height = camera.size_px
    np.testing.assert_allclose(seen.x_px, [0, width, width, 0], atol=1e-6)
    np.testing.assert_allclose(seen.y_px, [0, 0, height, height], atol=0.6)  # the height is rounded to pixels


@pytest.mark.parametrize(("name", "kelvins", "xy"), [("D65", 6503, (0.3127, 0.3290)), ("A", 2856, (0.4476, 0.4075))])
def test_whites_of_standard_illuminants(name: str, kelvins: float, xy: tuple[float, float]) -> None:
    """CIE 15:2018, table T.3, and the illuminants' own temperatures."""
    white = checker.white_of(illuminant(name))
    np.testing.assert_allclose(white.xy, xy, atol=1e-4)
    assert white.cct_k == pytest.approx(kelvins, abs=2)


def test_no_temperature_where_it_means_nothing() -> None:
    dark = Spectrum(np.array([500.0]), np.array([0.0]))
    green = Spectrum(np.array([530.0, 540.0, 550.0]), np.array([0.0, 1.0, 0.0]))
    assert np.isnan(checker.temperature_of(dark)[0])
    assert np.isnan(checker.temperature_of(green)[0])


@pytest.mark.parametrize("name", ["D65", "A"])
def test_expected_colours_are_the_tables(name: str) -> None:
    """The grey card is grey; patches are what a plain sum gives; under D65 near the chart's published xyY."""
    light = illuminant(name)
    white = checker.white_of(light)
    expected = checker.expected_xyz(light)
    grid = np.arange(380.0, 781.0, 5.0)
    reflected = np.array([one.at(grid) * light.at(grid) for one in checker.reflectances()])
    plain = checker.xyz_of_radiance(grid, reflected / np.pi) * 100 / white.luminance_cd_per_m2
    np.testing.assert_allclose(plain, expected, rtol=2e-4)
    assert expected[-1][1] == pytest.approx(18.0, rel=1e-6)
    assert checker.delta_e(plain, expected, white.xy).max() < 0.01


def test_delta_e_is_ciede2000() -> None:
    """Sharma, Wu and Dalal (2005), table 1, pairs 1 and 20."""
    colour = colour_science()

    white = np.array([0.31270, 0.32900])
    pairs = [((50, 2.6772, -79.7751), (50, 0, -82.7485), 2.0425), ((50, 2.5, 0), (61, -5, 29), 22.8977)]
    for one, other, difference in pairs:
        xyz = [100 * colour.Lab_to_XYZ(lab, white) for lab in (one, other)]
        assert float(checker.delta_e(xyz[0], xyz[1], white)) == pytest.approx(difference, abs=2e-3)


def test_rgb_colours_are_radiances_colours() -> None:
    from forestgen.scene.colour import colour_of_radiance

    light = illuminant("A")
    np.testing.assert_allclose(checker.xyz_of_colour(colour_of_radiance(light)), checker.xyz_of_light(light), rtol=2e-4)
