"""Every form of organ that docs/organs.md shows: sound geometry, labels, areas; wrong keys and numbers."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError
from ruamel.yaml import YAML

from forestgen.core.errors import RecipeError
from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh, surface_area_m2
from forestgen.plants.foliage import Foliage
from forestgen.plants.organs.base import OrganForm
from forestgen.plants.parameters import OrganShape
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import make_plan
from support.error_messages import raises_error

ORGAN_SHAPE = TypeAdapter(OrganShape)

ROOT = Path(__file__).parents[3]
BLOCKS = re.findall(r"```yaml\n(.*?)```", (ROOT / "docs/organs.md").read_text(encoding="utf-8"), re.DOTALL)
READ = [YAML(typ="safe").load(block) for block in BLOCKS]
EXAMPLES: dict[str, dict[str, Any]] = {
    name: keys for block in READ for name, keys in block.items() if name != "foliage"
}
FORMS = {keys["form"] for keys in EXAMPLES.values()}
SHEETS = (
    "simple",
    "lobed",
    "palmate",
    "compound",
    "fascicle",
    "needle_twig",
    "fern_frond",
    "palm_frond",
    "grass_blade",
)


def shaped(name: str, detail: int) -> OrganForm:
    keys = dict(EXAMPLES[name])
    return ORGAN_SHAPE.validate_python(keys if keys["form"] == "disc" else keys | {"detail": detail})


def leaf_area_m2(form: OrganForm) -> float:
    return sum(surface_area_m2(piece.mesh) for piece in form.pieces() if piece.part == Part.LEAF)


def corners(mesh: Mesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    a, b, c = (mesh.vertices_m[mesh.faces[:, k]].astype(np.float64) for k in range(3))
    return a, b, c


def test_the_page_shows_every_form_and_rule() -> None:
    with pytest.raises(ValidationError) as caught:
        ORGAN_SHAPE.validate_python({"form": "none of them"})
    known = set(re.findall(r"'(\w+)'", caught.value.errors()[0]["ctx"]["expected_tags"]))
    assert known == FORMS
    for block in READ:
        for rule in block.get("foliage", ()):
            Foliage.model_validate(rule)


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_page_tells_the_triangles(name: str) -> None:
    told = re.search(rf"^{name}: .*# ([\d, ]+) triangles", "".join(BLOCKS), re.MULTILINE)
    assert told is not None
    triangles = [shaped(name, detail).template().triangles for detail in (0, 1, 2)]
    assert [int(number) for number in told[1].split(",")] in (triangles, triangles[:1])


@pytest.mark.parametrize("detail", [0, 1, 2])
@pytest.mark.parametrize("name", EXAMPLES)
def test_geometry_is_sound(name: str, detail: int) -> None:
    form = shaped(name, detail)
    for piece in form.pieces():
        mesh = piece.mesh
        assert mesh.normals is not None
        assert mesh.uv is not None
        assert np.all(np.isfinite(mesh.vertices_m))
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-5)
        assert mesh.uv.min() >= 0.0
        assert mesh.uv.max() <= 1.0
        a, b, c = corners(mesh)
        size = np.maximum(np.linalg.norm(b - a, axis=1), np.linalg.norm(c - a, axis=1))
        assert np.all(np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-7 * size**2), "no degenerate face"
        assert len(np.unique(np.sort(mesh.faces, axis=1), axis=0)) == mesh.triangles, "no face twice"
        assert len(np.unique(mesh.faces)) == len(mesh.vertices_m), "no vertex without a face"
    whole = form.template()
    assert whole.triangles == sum(piece.mesh.triangles for piece in form.pieces())
    reach = float(np.linalg.norm(np.ptp(whole.vertices_m, axis=0)))
    assert np.linalg.norm(whole.vertices_m, axis=1).min() < 0.1 * reach, "its foot is in the origin"


@pytest.mark.parametrize("name", [name for name, keys in EXAMPLES.items() if keys["form"] in SHEETS])
def test_levels_of_detail_have_one_area_and_more_triangles(name: str) -> None:
    forms = [shaped(name, detail) for detail in (0, 1, 2)]
    areas = [leaf_area_m2(form) for form in forms]
    assert areas[:2] == pytest.approx([areas[2]] * 2, rel=0.03)
    triangles = [form.template().triangles for form in forms]
    assert triangles[0] < triangles[1] <= triangles[2]


@pytest.mark.parametrize("name", [name for name, keys in EXAMPLES.items() if keys["form"] in SHEETS[:3]])
def test_leaves_show_their_upper_side_and_are_as_light_as_promised(name: str) -> None:
    for detail, most in ((0, 12), (1, 50), (2, 180)):
        mesh = ORGAN_SHAPE.validate_python({**EXAMPLES[name], "detail": detail, "curl_deg": 0}).template()
        a, b, c = corners(mesh)
        assert np.all(np.cross(b - a, c - a)[:, 2] > -1e-12)
        assert mesh.triangles <= most


@pytest.mark.parametrize("name", ["bud", "acorn", "blackberry"])
def test_bodies_are_wound_outward(name: str) -> None:
    keys = {key: value for key, value in EXAMPLES[name].items() if not key.startswith("stalk")}
    for piece in ORGAN_SHAPE.validate_python(keys | {"detail": 2}).pieces():
        a, b, c = corners(piece.mesh)
        middle = piece.mesh.vertices_m.mean(axis=0)
        assert np.sum((a - middle) * np.cross(b - middle, c - middle)) > 0.0


@pytest.mark.parametrize("drawn", [10, 40, 200])
def test_drawing_fewer_needles_keeps_their_area(drawn: int) -> None:
    keys = EXAMPLES["spruce"] | {"diameter_m": 0.0}
    needles = round(keys["per_m"] * keys["length_m"])
    expected = needles * 0.8 * keys["needle_length_m"] * keys["needle_width_m"]
    few = ORGAN_SHAPE.validate_python(keys | {"drawn": drawn})
    assert surface_area_m2(few.template()) == pytest.approx(expected, rel=0.03)
    assert few.template().triangles == drawn


def test_a_daisy_has_its_rays() -> None:
    daisy = shaped("daisy", 1)
    by_material = {piece.material: piece for piece in daisy.pieces()}
    assert set(by_material) == {"ray", "disc", "stalk"}
    assert {piece.part for piece in daisy.pieces()} == {Part.FLOWER}
    fewer = ORGAN_SHAPE.validate_python(EXAMPLES["daisy"] | {"petals": 17})
    rays = {piece.material: piece.mesh.triangles for piece in fewer.pieces()}["ray"]
    assert by_material["ray"].mesh.triangles == 2 * rays
    width = np.ptp(by_material["ray"].mesh.vertices_m[:, 0])
    assert width == pytest.approx(EXAMPLES["daisy"]["diameter_m"], rel=0.06)


def test_a_needle_twigs_axis_is_a_branch() -> None:
    parts = {piece.part: piece.material for piece in shaped("spruce", 1).pieces()}
    assert parts == {Part.LEAF: "needle", Part.BRANCH: "bark"}


def test_templates_are_made_once() -> None:
    assert shaped("maple", 2).template() is shaped("maple", 2).template()
    assert shaped("maple", 2).template() is not shaped("maple", 1).template()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"length_m": 0}, "greater than or equal to 0.0001"),
        ({"length_m": -1}, "greater than or equal"),
        ({"length_m": float("nan")}, "finite"),
        ({"teeth": 10**9}, "less than or equal to 60"),
        ({"petals": 4}, "Extra inputs"),
        ({"detail": 3}, "0, 1 or 2"),
        ({"heart": 0.2, "base": 2}, "base of at most 1"),
    ],
)
def test_a_wrong_leaf_is_refused(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        ORGAN_SHAPE.validate_python(EXAMPLES["beech"] | keys)


@pytest.mark.parametrize(
    ("name", "keys"),
    [
        ("spruce", {"length_m": 20, "per_m": 9000}),
        ("daisy", {"petals": 201}),
        ("daisy", {"disc_m": 0.03}),
        ("ash", {"leaflets": 201}),
        ("ash", {"rachis_m": 0}),
        ("horse_chestnut", {"rachis_m": 0.1}),
        ("maple", {"lobes": 4}),
        ("maple", {"lobes": 3, "spread_deg": 150}),
        ("feather_palm", {"stalk_m": 2.9}),
    ],
)
def test_a_wrong_organ_is_refused(name: str, keys: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        ORGAN_SHAPE.validate_python(EXAMPLES[name] | keys)


@pytest.mark.parametrize("detail", [0, 1, 2])
def test_a_broken_blade_of_grass_hangs_and_keeps_its_area(detail: int) -> None:
    whole = ORGAN_SHAPE.validate_python(EXAMPLES["broken_leaf"] | {"broken_deg": 0, "detail": detail})
    broken = shaped("broken_leaf", detail)
    assert leaf_area_m2(broken) == pytest.approx(leaf_area_m2(whole), rel=0.01)
    assert broken.template().vertices_m[-1, 1] < 0.75 * whole.template().vertices_m[-1, 1]
    tip = [surface_area_m2(one.mesh) for one in broken.pieces() if one.material == "dead"]
    assert sum(tip) < 0.15 * leaf_area_m2(broken)
    assert bool(tip) == (detail > 0)


@pytest.mark.parametrize(
    ("leaf", "place"),
    [
        ("{form: simple, material: leaf, length_m: 0.1, width_m: 0.02, teth: 3}", "leaf.teth"),
        ("{form: simpel, material: leaf, length_m: 0.1, width_m: 0.02}", "leaf.form"),
        ("{material: leaf, length_m: 0.1}", "shapes.leaf"),
        ("{form: simple, material: leaf, width_m: 0.1}", "leaf.length_m"),
        (
            "{form: compound, material: leaf, rachis_m: 1, leaflet: {form: simple, length_m: 1, width_m: 0}}",
            "leaf.leaflet.width_m",
        ),
    ],
)
def test_a_mistake_in_a_shape_is_told_with_its_line(tmp_path: Path, leaf: str, place: str) -> None:
    lines = (ROOT / "scenes/species/fireweed.yaml").read_text(encoding="utf-8").splitlines()
    row = next(k for k, line in enumerate(lines) if line.startswith("    leaf: {form"))
    lines[row] = f"    leaf: {leaf}"
    (tmp_path / "weed.yaml").write_text("\n".join(lines), encoding="utf-8")
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text(
        "forestgen: 1\nseed: 1\nspecies: {weed: {from: ./weed.yaml}}\ncommunity: {model: multiset_lsystem}\n"
    )
    with raises_error(RecipeError, place=place):
        make_plan(load_recipe(recipe).draw(0))
