"""forestgen calibrate and forestgen light: colours against colour-science, files, and what is refused."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from command_line import TINY, run

from forestgen.atmosphere.grid import CloudGrid
from forestgen.atmosphere.netcdf_file import write_netcdf
from forestgen.cli.parsing import join_numbers
from forestgen.core.errors import RecipeError
from forestgen.core.parts import Part
from forestgen.core.progress import Silent
from forestgen.core.spectrum import Spectrum
from forestgen.geometry.mesh import Mesh
from forestgen.instruments import colour_chart as stage
from forestgen.instruments.calibration import Calibration
from forestgen.instruments.light_meter import Quantity, with_error
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.scene.colour import colour_science
from forestgen.scene.spec import Instances, Material, SceneSpec, Sky, Terrain
from support.error_messages import raises_error
from support.radiometry import under_uniform_sky
from support.tiers import few


def level(half_m: float, z_m: float) -> Mesh:
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=np.float32) * np.float32(half_m)
    vertices = np.column_stack([corners, np.full(4, z_m)]).astype(np.float32)
    return Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32), uv=corners)


def site(roof_m: float | None = None, half_m: float = 1.0) -> SceneSpec:
    """Bare ground, and perhaps a roof."""
    texture = np.full((2, 2, 3), 0.2, dtype=np.float32)
    terrain = Terrain(level(5000.0, 0.0), texture, np.zeros(4, dtype=np.float32))
    exemplars = ()
    if roof_m is not None:
        exemplars = (Exemplar("roof", (OrganMesh(Part.ROCK, "a", level(half_m, roof_m)),), 1.0, 1.0, 1.0, 0.0, 0.0),)
    count = len(exemplars)
    instances = Instances(
        np.zeros(count, np.uint32), np.tile(np.eye(4)[:3], (count, 1, 1)), np.full(count, 9, dtype=np.uint32)
    )
    return SceneSpec(
        exemplars, {("roof", "a"): Material((0.1, 0.1, 0.1))}, instances, terrain, Sky(38.0, 220.0, 3.0), None, ()
    )


def calibrated(spec: SceneSpec, name: str | None, samples: int = 4) -> Calibration:
    """Under a uniform sky of a standard illuminant, or under the scene's own."""
    with under_uniform_sky(None if name is None else illuminant(name)):
        return stage.measure_chart(
            spec,
            (0.0, 0.0, 1.0),
            (0.0, 0.0, 1.0),
            above_ground_m=1.0,
            width_px=64,
            samples=samples,
            max_depth=4,
            seed=3,
            progress=Silent(),
        )


def test_the_chart_stands_on_the_site_and_what_is_around_it_stays_outside() -> None:
    spec = site(3.0)
    old = spec.instances
    around = Instances(
        np.repeat(old.exemplar, 3), np.repeat(old.transform, 3, axis=0), np.array([9, 4, 0], np.uint32), outside=2
    )
    camera = stage.checker.camera(np.zeros(3), np.array([0.0, 0.0, 1.0]), 64)
    charted = stage.with_chart(replace(spec, instances=around), np.zeros(3), np.array([0.0, 0.0, 1.0]), camera)
    assert charted.instances.outside == 2
    assert charted.instances.plant_id.tolist() == [9, 10, 4, 0]
    assert charted.instances.on_site.exemplar.tolist() == [0, 1]
    assert charted.instances.exemplar.dtype == charted.instances.plant_id.dtype == np.uint32


def illuminant(name: str) -> Spectrum:
    colour = colour_science()

    found = colour.SDS_ILLUMINANTS[name]
    return Spectrum(np.asarray(found.wavelengths), 0.01 * np.asarray(found.values))


@pytest.mark.parametrize(("name", "kelvins", "rgb"), few([("A", 2856, (5.0, 15.0)), ("D65", 6503, (0.2, 3.0))]))
def test_colours_under_standard_illuminants(name: str, kelvins: float, rgb: tuple[float, float]) -> None:
    """The issue's bounds are 0.5 and 1.5. The rgb mode's are what it reaches: it is no spectral renderer."""
    found = calibrated(site(), name)
    exact, spectral, plain = (found.delta_e(mode) for mode in ("wavelengths", "spectral", "rgb"))
    assert exact.max() < 0.01
    assert spectral.mean() < 0.2
    assert spectral.max() < 0.6
    assert plain.mean() < rgb[0]
    assert plain.max() < rgb[1]
    assert found.holds
    np.testing.assert_allclose(found.light.value, illuminant(name).at(found.light.wavelength_nm), rtol=1e-5)
    assert found.white.cct_k == pytest.approx(kelvins, abs=3)
    assert found.illuminance_lux == pytest.approx(found.meter.illuminance_lux.value, rel=1e-4)
    assert found.unevenness < 1e-6


@pytest.mark.slow
def test_colours_under_the_scenes_own_sky() -> None:
    found = calibrated(site(), None, samples=64)
    assert found.holds
    assert found.delta_e("spectral").mean() < 0.5
    assert found.delta_e("spectral").max() < 1.5
    assert found.illuminance_lux == pytest.approx(found.meter.illuminance_lux.value, rel=0.01)
    assert not found.notes


def test_a_hidden_chart_is_told() -> None:
    with raises_error(RecipeError, place="at"):
        calibrated(site(roof_m=1.4), "D65")


@pytest.mark.slow
def test_shade_is_told() -> None:
    """A roof above the camera takes the sun and some of the sky; the chart itself is in full view."""
    found = calibrated(site(roof_m=3.0, half_m=2.5), None)
    assert "the sun does not reach the chart" in found.notes
    assert found.meter.from_sun.value == 0
    assert found.meter.from_sky.value > 0.5


def recipe_in(folder) -> str:
    path = folder / "tiny.yaml"
    path.write_text(TINY, encoding="utf-8")
    return str(path)


@pytest.mark.slow
def test_the_command_writes_a_sheet(tmp_path) -> None:
    recipe, target = recipe_in(tmp_path), tmp_path / "sheet"
    answer = run("calibrate", recipe, "-o", target, "--width-px", 64, "--samples", 32)
    assert answer.code == 0, answer.err
    assert {path.name for path in target.iterdir()} == {
        "calibration.html", "calibration.json", "chart.png", "manifest.json"
    }  # fmt: skip
    numbers = json.loads((target / "calibration.json").read_text(encoding="utf-8"))
    assert numbers["holds"] is True
    assert len(numbers["patches"]) == 24
    assert numbers["delta_e_2000"]["spectral"]["mean"] < 0.5
    page = (target / "calibration.html").read_text(encoding="utf-8")
    assert numbers["recipe_hash"] in page
    assert 'src="http' not in page
    assert "<script" not in page
    assert page.count("<tr>") > 24
    run("calibrate", recipe, "-o", target).refused(4)


@pytest.mark.slow
def test_missed_bounds_fail_and_the_sheet_is_there(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(stage, "MEAN_BOUND", 0.0)
    target = tmp_path / "sheet"
    answer = run("calibrate", recipe_in(tmp_path), "-o", target, "--width-px", 64, "--samples", 4)
    assert answer.code == 5
    assert "mean delta E 2000, spectral mode below 0" in answer.err
    assert json.loads((target / "calibration.json").read_text(encoding="utf-8"))["holds"] is False


@pytest.mark.slow
def test_the_light_meter_command(tmp_path) -> None:
    table = tmp_path / "light.csv"
    places = ("--at", 3, 2, 0.02, "--at", 3, 2, 30)
    answer = run("light", recipe_in(tmp_path), *places, "-o", table, "--samples", 2048, "--spectrum", 500)
    assert answer.code == 0, answer.err
    with table.open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    below, above = (float(row["illuminance_lux"]) for row in rows)
    assert 20_000 < above < 130_000
    assert below <= above * 1.02
    assert float(rows[1]["from_sun"]) + float(rows[1]["from_sky"]) == pytest.approx(1, abs=0.02)
    assert 5000 < float(rows[1]["cct_k"]) < 7000
    # Daylight has 0.0185 µmol/m²/s of photosynthetic light to the lux (Thimijan and Heins 1983: 54 lux to 1).
    assert float(rows[1]["par_umol_per_m2_s"]) / above == pytest.approx(1 / 54, rel=0.06)
    assert "lux" in answer.out
    run("light", recipe_in(tmp_path), "--at", 1, 1, 1, "-o", table).refused(4)


@pytest.mark.parametrize(
    "arguments",
    [
        (),
        ("--at", 1, 2),
        ("--at", 1, 2, "nan"),
        ("--at", 1, 2, -0.5),
        ("--at", 90_000, 2, 1),
        ("--at", 1, 2, 1, "--normal", "sideways"),
        ("--at", 1, 2, 1, "--normal", "0,0,0"),
        ("--at", 1, 2, 1, "-o", "light.txt"),
    ],
)
def test_what_is_no_point_is_refused(tmp_path, arguments) -> None:
    run("light", recipe_in(tmp_path), *arguments).refused(2)


def test_points_above_clouds_are_refused(tmp_path) -> None:
    recipe = recipe_in(tmp_path)
    run("calibrate", recipe, "--set", "sky.clouds=noise", "--at", 1, 1, 2000).refused(2)
    run("calibrate", recipe, "--at", 1, 1, 1, "--at", 2, 2, 2).refused(2)


@pytest.mark.parametrize("command", ["light", "calibrate"])
def test_light_in_fog_is_refused(tmp_path, command) -> None:
    """Of simulated and saved clouds the base is known only once they are there."""
    fog = CloudGrid(np.full((4, 6, 6), 0.01, np.float32), (0.0, 0.0, 0.0), (60.0, 60.0, 60.0))
    write_netcdf(tmp_path / "fog.nc", fog)
    path = tmp_path / "foggy.yaml"
    path.write_text(TINY + "sky: {clouds: {type: file, file: fog.nc}}\n", encoding="utf-8")
    run(command, str(path), "--at", 3, 2, 20).refused(2)


def test_three_numbers_make_a_point() -> None:
    assert join_numbers(["r", "--at", "-3", "2", "1", "--at", "4", "5", "6", "-o", "x"], "--at", 3) == [
        "r", "--at=-3,2,1", "--at=4,5,6", "-o", "x"
    ]  # fmt: skip
    assert join_numbers(["--at", "1", "--set", "a=1"], "--at", 3) == ["--at=1", "--set", "a=1"]


@pytest.mark.parametrize(
    ("value", "error", "said"),
    [
        (61215.3, 38.2, "61,215 ± 38"),
        (5603.73, 0.49, "5,603.7 ± 0.5"),
        (0.0454643, 0.0000077, "0.045464 ± 0.000008"),
        (0.0, 0.0, "0"),
        (1234.5, float("nan"), "1,234.5"),
        (1234567.0, 51000.0, "1,235,000 ± 51,000"),
    ],
)
def test_figures_have_the_digits_that_they_deserve(value: float, error: float, said: str) -> None:
    assert with_error(Quantity(value, error)) == said
