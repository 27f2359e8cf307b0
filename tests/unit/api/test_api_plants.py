"""`plant`: meshes, measures and files of one plant are those that the command makes."""

from __future__ import annotations

import json
import re
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

import forestgen as fg
from forestgen.cli import app
from forestgen.core import registry
from forestgen.geometry.export import MESH_EXPORTERS
from support.error_messages import raises_error


@pytest.fixture(scope="module")
def plant() -> fg.Plant:
    return fg.plant("fireweed", 0.9, seed=3)


def test_a_plant_is_as_tall_as_asked(plant: fg.Plant) -> None:
    assert (plant.species, plant.seed) == ("fireweed", 3)
    assert plant.height_m == pytest.approx(0.9, rel=0.02)
    assert plant.vertices[:, 2].max() == pytest.approx(0.9, rel=0.02)
    across = np.ptp(plant.vertices[:, :2], axis=0)
    assert 0.5 * plant.crown_width_m < across.max() < 1.5 * plant.crown_width_m
    assert repr(plant).startswith("<Plant fireweed: 0.90 m tall, crown ")
    assert fg.plant("fireweed").height_m == pytest.approx(1.54, abs=0.02)  # a mature one


def test_the_mesh_is_that_of_all_parts(plant: fg.Plant) -> None:
    assert {"trunk-stem", "leaf-leaf"} <= set(plant.meshes)
    assert plant.vertices.shape == (sum(len(mesh.vertices_m) for mesh in plant.meshes.values()), 3)
    assert len(plant.faces) == sum(plant.measures.triangles.values())
    assert plant.faces.min() == 0
    assert plant.faces.max() == len(plant.vertices) - 1
    area = {name: trimesh.Trimesh(mesh.vertices_m, mesh.faces).area for name, mesh in plant.meshes.items()}
    whole = trimesh.Trimesh(plant.vertices, plant.faces, process=False)
    assert whole.area == pytest.approx(sum(area.values()), rel=1e-5)
    assert area["leaf-leaf"] == pytest.approx(plant.leaf_area_m2, rel=0.2)  # blades are bent


def test_its_measures_are_those_that_the_command_prints(plant: fg.Plant, tmp_path: Path) -> None:
    words = ["plant", "fireweed", "--height-m", "0.9", "--seed", "3", "--out", str(tmp_path / "a.ply")]
    told = CliRunner().invoke(app, [*words, "--json"])
    assert told.exit_code == 0, told.output
    (one,) = json.loads(told.stdout)
    assert {**one, "files": {}} == asdict(plant.measures)
    said = CliRunner().invoke(app, [*words, "--overwrite"]).stdout
    assert f"{plant.height_m:.2f} m tall, crown {plant.crown_width_m:.2f} m wide" in said
    assert f"{len(plant.faces):,} triangles" in said
    assert f"leaf area {plant.leaf_area_m2:.3g} m²" in said
    assert re.search(r"\(\d.*B\)", said)


@pytest.mark.parametrize("suffix", [".glb", ".ply", ".obj", ".usd", ".usda", ".usdc", ".usdz"])
def test_an_exported_file_is_the_commands(suffix: str, plant: fg.Plant, tmp_path: Path) -> None:
    path = plant.export(tmp_path / "own" / f"plant{suffix}")
    assert path == tmp_path / "own" / f"plant{suffix}"
    words = ["plant", "fireweed", "--height-m", "0.9", "--seed", "3", "--out", str(tmp_path / "its" / path.name)]
    assert CliRunner().invoke(app, words).exit_code == 0
    own, its = ({one.name: one for one in folder.iterdir()} for folder in (tmp_path / "own", tmp_path / "its"))
    assert set(own) == set(its) == {path.name, *(["plant.mtl"] if suffix == ".obj" else [])}
    for name in own:
        assert own[name].read_bytes() == its[name].read_bytes(), name
    if suffix in (".glb", ".ply", ".obj"):
        mesh = trimesh.load(path, force="scene").to_geometry()
        assert len(mesh.faces) == len(plant.faces)


def test_a_registered_exporter_serves_api_and_command(
    plant: fg.Plant, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(MESH_EXPORTERS, "_entries", dict(MESH_EXPORTERS._entries))
    monkeypatch.setattr(registry, "_registered", list(registry._registered))
    with raises_error(fg.RecipeError, place="part"):
        fg.register("mesh_exporter", "stl", "own_exporter:NO_EXPORTER")
    fg.register("mesh_exporter", "stl", "own_exporter:EXPORTER", "triangles alone")
    assert [(one.kind, one.description) for one in fg.models("stl")] == [("mesh_exporter", "triangles alone")]
    assert fg.models("glb")[0].page.startswith("glTF 2.0 binary files")
    plant.export(tmp_path / "plant.stl")
    assert len(trimesh.load(tmp_path / "plant.stl").faces) == len(plant.faces)
    (tmp_path / "plant.stl").unlink()
    words = ["plant", "fireweed", "--height-m", "0.9", "--seed", "3", "--out", str(tmp_path / "plant.stl")]
    taken = CliRunner().invoke(app, words)  # by the file beside it
    assert (taken.exit_code, "plant.stl.txt" in taken.stderr) == (4, True)
    assert CliRunner().invoke(app, [*words, "--overwrite"]).exit_code == 0
    assert (tmp_path / "plant.stl").exists()


def test_what_cannot_be_exported(plant: fg.Plant, tmp_path: Path) -> None:
    with raises_error(fg.RecipeError, place="out"):
        plant.export(tmp_path / "a.stl")
    with raises_error(fg.RecipeError, place="wood_triangles"):
        plant.export(tmp_path / "a.glb", wood_triangles=3)
    assert not list(tmp_path.iterdir())
    (tmp_path / "a.ply").write_text("mine")
    with raises_error(fg.OutputError, place="a.ply"):
        plant.export(tmp_path / "a.ply")
    assert (tmp_path / "a.ply").read_text() == "mine"
    plant.export(tmp_path / "a.ply", overwrite=True)
    assert (tmp_path / "a.ply").read_bytes().startswith(b"ply")


@pytest.mark.parametrize(
    ("arguments", "place"),
    [
        ({"height_m": 99}, "height_m"),
        ({"height_m": float("nan")}, "height_m"),
        ({"seed": -1}, "seed"),
        ({"detail": 7}, "detail"),
        ({"detail": -1}, "detail"),
    ],
)
def test_a_plant_that_cannot_be(arguments: dict[str, float], place: str) -> None:
    with raises_error(fg.RecipeError, place=place):
        fg.plant("fireweed", **arguments)  # type: ignore[arg-type]


def test_an_unknown_species_is_named() -> None:
    with raises_error(fg.AssetError, place="species"):
        fg.plant("sprouce")


def test_detail_draws_leaves_finer() -> None:
    coarse, fine = (len(fg.plant("fireweed", 0.9, seed=3, detail=level).faces) for level in (0, 2))
    assert coarse < fine


def test_a_picture_shows_the_plant(plant: fg.Plant) -> None:
    picture = plant.picture((48, 64), samples=4)
    assert (picture.shape, picture.dtype) == ((64, 48, 3), np.uint8)
    green = (picture[..., 1] > picture[..., 0]) & (picture[..., 1] > picture[..., 2])
    assert green[8:56, 16:32].any()
    with raises_error(fg.RecipeError, place="size_px"):
        plant.picture((0, 64))


def test_a_tree_sways_and_a_herb_does_not(plant: fg.Plant) -> None:
    with raises_error(fg.RecipeError, place="frames"):
        plant.sway(3)
    frames = fg.plant("beech", 2.0).sway(2, 2.0)
    assert len(frames) == 2
    assert np.array_equal(frames[0].faces, frames[1].faces)
    moved = np.linalg.norm(frames[1].vertices - frames[0].vertices, axis=1)
    assert 1e-3 < moved.max() < 0.3
