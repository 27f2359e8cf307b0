"""A plant's numbers, and files that all appear or none."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest

from forestgen.api.plant_requests import name_of, plan_of, radius_of_m, request_of
from forestgen.api.plants import default_outputs, described, model_of, numbered
from forestgen.core.errors import OutputError, RecipeError
from forestgen.core.parts import Part
from forestgen.dataset.files import FileSet
from forestgen.plants.bark.texture import texture_images
from forestgen.plants.build import size_m
from forestgen.plants.growing import grow_exemplar
from forestgen.scene.spec import Material
from forestgen.scene.surfaces import materials_of
from support.error_messages import raises_error


@pytest.fixture(scope="module")
def fireweed():
    plan = plan_of("fireweed", 3)
    return plan, grow_exemplar(request_of(plan, "fireweed", 1.2, 3))


def test_numbers_follow_from_the_geometry(fireweed) -> None:
    plan, exemplar = fireweed
    species = plan.drawn.species["fireweed"]
    one = described(exemplar, species, 3)
    leaves = [organ.mesh for organ in exemplar.organs if organ.part == Part.LEAF]
    corners = np.concatenate([mesh.vertices_m[mesh.faces].astype(float) for mesh in leaves])
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert one.leaf_area_m2 == pytest.approx(area, rel=1e-6)
    assert one.leaf_area_index == pytest.approx(area / (math.pi * (one.crown_width_m / 2) ** 2), rel=1e-6)
    assert one.leaf_kg == pytest.approx(area * species.tissue.leaf_mass_per_area_kg_per_m2)
    assert one.wood_kg == pytest.approx(exemplar.wood_volume_m3 * species.tissue.wood_density_kg_per_m3)
    assert sum(one.triangles.values()) == exemplar.triangles
    assert one.height_m == pytest.approx(1.2, rel=0.02)
    assert one.dbh_m is None
    assert 0.0 < one.crown_base_m < one.height_m


def test_a_trees_stem_and_crown_base_are_those_it_was_built_to() -> None:
    plan = plan_of("birch", 0)
    request = request_of(plan, "birch", 12.0, 4)
    one = described(grow_exemplar(request), plan.drawn.species["birch"], 4)
    assert one.dbh_m == pytest.approx(request.tree.dbh_m, rel=0.05)
    assert one.crown_base_m == pytest.approx(request.tree.crown_base_m, rel=0.05, abs=0.24)


def test_height_and_radius_are_each_others_inverse(fireweed) -> None:
    species = fireweed[0].drawn.species["fireweed"]
    for height_m in (0.1, 1.0, 1.5):
        assert species.allometry.height(radius_of_m(species, height_m)) == pytest.approx(height_m)
    assert radius_of_m(species, None) == species.ecology.max_radius_m
    assert size_m(species, species.ecology.max_radius_m)[0] == pytest.approx(species.mature_height_m)


def test_a_species_of_one_height_refuses_others(fireweed) -> None:
    species = fireweed[0].drawn.species["fireweed"]
    law = species.allometry.height_m.model_copy(update={"scale": 2.0, "exponent": 0.0})
    level = species.model_copy(update={"allometry": species.allometry.model_copy(update={"height_m": law})})
    assert radius_of_m(level, 2.0) == species.ecology.max_radius_m
    with raises_error(RecipeError, place="height_m"):
        radius_of_m(level, 3.0)


def test_a_models_surfaces_take_textures_where_the_mesh_has_uv(fireweed) -> None:
    plan, exemplar = fireweed
    species = plan.drawn.species["fireweed"]
    plain = materials_of(plan.drawn.species)
    spruce = materials_of(plan_of("spruce", 0).drawn.species)
    textured = [one for one in spruce.values() if one.texture is not None]
    model = model_of(exemplar, species, plain, 3)
    assert all(piece.surface.sheet == (piece.part in (Part.LEAF, Part.FLOWER)) for piece in model.pieces)
    assert {piece.name for piece in model.pieces} == {
        f"{organ.part.name.lower()}-{organ.material}" for organ in exemplar.organs
    }
    assert textured, "the shipped spruce has bark"
    barked = {key: Material(one.reflectance, texture=textured[0].texture) for key, one in plain.items()}
    for piece, organ in zip(model_of(exemplar, species, barked, 3).pieces, exemplar.organs, strict=True):
        if organ.mesh.uv is None:
            assert piece.surface.colour_image is None
        else:
            assert np.array_equal(piece.surface.colour_image, texture_images(textured[0].texture)[0])


def test_names_of_several_are_numbered() -> None:
    outputs = (Path("a/x.glb"), Path("x.y.png"))
    assert list(numbered(outputs, 1, several=False)) == [list(outputs)]
    assert list(numbered(outputs, 2, several=True))[1] == [Path("a/x-0002.glb"), Path("x.y-0002.png")]
    assert list(numbered(outputs, 1, several=True)) == [[Path("a/x-0001.glb"), Path("x.y-0001.png")]]


@pytest.mark.parametrize(
    ("species", "name"),
    [("oak", "oak"), ("my/old oak.yaml", "old-oak"), ("../_x.yaml", "x"), ("", "plant"), ("Æsp.yml", "sp")],
)
def test_a_files_name_becomes_a_species_name(species: str, name: str) -> None:
    assert name_of(species) == name
    assert default_outputs(species) == (Path(f"outputs/{name}.glb"), Path(f"outputs/{name}.png"))


def everything(folder: Path) -> dict[str, bytes | None]:
    return {str(path): path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


def test_files_appear_together(tmp_path: Path) -> None:
    with FileSet(overwrite=False) as files:
        files.write(tmp_path / "new/deep/a", b"1")
        files.write(tmp_path / "new/b", b"2")
        assert not (tmp_path / "new/b").exists()
    assert {path.name for path in (tmp_path / "new").iterdir()} == {"deep", "b"}
    assert (tmp_path / "new/deep/a").read_bytes() == b"1"


@pytest.mark.parametrize("error", [OSError("full"), KeyboardInterrupt(), RecipeError("no")])
def test_a_failure_leaves_all_as_it_was(tmp_path: Path, error: BaseException) -> None:
    (tmp_path / "old").write_bytes(b"mine")
    before = everything(tmp_path)

    def fail() -> None:
        with FileSet(overwrite=True) as files:
            files.write(tmp_path / "old", b"1")
            files.write(tmp_path / "new/deep/a", b"1")
            raise error

    with pytest.raises(type(error)):
        fail()
    assert everything(tmp_path) == before


def test_a_file_that_cannot_be_placed_takes_the_new_ones_along(tmp_path: Path) -> None:
    """A folder of that name appears while the plant grows."""

    def fail() -> None:
        with FileSet(overwrite=False) as files:
            files.write(tmp_path / "a", b"1")
            files.write(tmp_path / "b", b"2")
            (tmp_path / "b").mkdir()

    with raises_error(OutputError, place="b"):
        fail()
    assert [path.name for path in tmp_path.iterdir()] == ["b"]


@pytest.mark.parametrize("kind", ["a pipe", "a link", "a broken link", "a file that appeared"])
def test_no_link_pipe_or_strange_file_is_replaced(tmp_path: Path, kind: str) -> None:
    """Whether it was there before, or came while the plant grew; a regular file only where it may be replaced."""
    (tmp_path / "mine").write_bytes(b"mine")
    target = tmp_path / "target"
    make = {
        "a pipe": lambda: os.mkfifo(target),
        "a link": lambda: target.symlink_to("mine"),
        "a broken link": lambda: target.symlink_to("nowhere"),
        "a file that appeared": lambda: target.write_bytes(b"theirs"),
    }[kind]

    def fail() -> None:
        with FileSet(overwrite=kind != "a file that appeared") as files:
            files.write(target, b"1")
            make()

    with raises_error(OutputError, place="target"):
        fail()
    with pytest.raises(OutputError), FileSet(overwrite="file" not in kind) as files:
        files.write(target, b"1")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine", "target"]
    assert (tmp_path / "mine").read_bytes() == b"mine"
