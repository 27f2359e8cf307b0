"""`register` adds parts of other packages; `models`, `species` and `schema` list what there is."""

from __future__ import annotations

import json
import sys
import types
from pathlib import Path

import numpy as np
import own_parts
import pytest
from api_recipe import STAND

import forestgen as fg
from forestgen.api import catalogue
from forestgen.core import registry
from forestgen.core.cache import code_hash
from support.error_messages import raises_error

pytestmark = pytest.mark.usefixtures("registries_as_before")


@pytest.mark.parametrize("part", [own_parts.MODEL, "own_parts:MODEL"])
def test_a_registered_model_is_used_like_a_shipped_one(part: object) -> None:
    before = code_hash(("core",), ())
    fg.register("community_model", "own", part, "my own")
    (entry,) = fg.models("own")
    assert (entry.kind, entry.description) == ("community_model", "my own")
    assert "A community model of another package" in entry.page
    assert "step_yr: duration of a step, years (> 0)" in entry.page
    stand = fg.load(STAND, set={"community.model": "own"}).simulate(progress=False)
    assert len(stand) == 42
    assert "own" in json.dumps(fg.schema())
    assert code_hash(("core",), ()) != before  # what is kept on disk depends on its code
    (sent,) = registry.registrations()
    assert (sent.name, sent.path) == ("own", "own_parts:MODEL")  # what worker processes import


@pytest.mark.parametrize("part", [own_parts.MODEL, "own_parts:MODEL"])
def test_its_description_is_its_documentations_first_line(part: object) -> None:
    fg.register("community_model", "own", part)
    assert fg.models("own")[0].description == "Plants at random, by another name."


def test_the_same_again_changes_nothing_and_another_is_refused() -> None:
    for _ in range(2):
        fg.register("community_model", "own", own_parts.MODEL)
    assert len(registry.registrations()) == 1
    registry.register_again(registry.registrations())
    assert len(registry.registrations()) == 1
    for name in ("own", "uniform"):
        with raises_error(fg.RecipeError, place="name") as caught:
            fg.register("community_model", name, "own_parts:UNIFORM")
        assert caught.value.got == repr(name)


@pytest.mark.parametrize("name", ["", "1st", "my own", "../up", "a" * 65, "über"])
def test_what_is_no_name(name: str) -> None:
    with raises_error(fg.RecipeError, place="name"):
        fg.register("community_model", name, own_parts.MODEL)
    assert not registry.registrations()


def test_an_unknown_kind_lists_the_known_ones() -> None:
    with raises_error(fg.RecipeError, place="kind"):
        fg.register("comunity_model", "own", own_parts.MODEL)


def test_what_workers_cannot_import_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    script = types.ModuleType("__main__")
    made = type("Mine", (own_parts.Own,), {"__module__": "__main__"})
    script.MODEL = made()  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "__main__", script)
    for part in (script.MODEL, made, own_parts.Own()):  # the last one lies at the top of no module
        with raises_error(fg.RecipeError, place="part"):
            fg.register("community_model", "mine", part)
    assert not registry.registrations()


@pytest.mark.parametrize(
    "path",
    [
        "own_parts",
        "own_parts:",
        ":X",
        "a b:c d",
        "nix_of_nowhere:MODEL",
        "own_parts.sub:MODEL",
        "own_parts:NONE",
        "broken_part:MODEL",
    ],
)
def test_a_place_that_is_none_is_refused_at_once(path: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "broken_part.py").write_text("1 / 0\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with raises_error(fg.RecipeError, place="part"):
        fg.register("community_model", "own", path)


def test_a_protocols_methods_are_not_those_of_a_part_based_on_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "from forestgen.community.model import CommunityModel, CommunityParameters as P\n"
    text += "class Half(CommunityModel):\n    Parameters = P\n    def init(self, *_): ...\nMODEL = Half()\n"
    (tmp_path / "half_a_model.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with raises_error(fg.RecipeError, place="part"):
        fg.register("community_model", "half", "half_a_model:MODEL")


def test_an_error_in_another_packages_part_is_said_to_be_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "from forestgen.community.static_model import StaticModel, StaticParameters as P\n"
    text += "class Bad(StaticModel):\n    Parameters = P\n    def most_plants(self, *_):\n        return 1\n"
    text += "    def place(self, *_):\n        return 1 / 0\nMODEL = Bad()\n"
    (tmp_path / "bad_model.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    fg.register("community_model", "bad", "bad_model:MODEL")
    with pytest.raises(ZeroDivisionError) as caught:
        fg.load(STAND, set={"community": {"model": "bad"}}).simulate(progress=False)
    said = registry.explained_bug(caught.value)
    assert (
        said
        == "an error in bad_model, which is no part of forestgen: ZeroDivisionError: division by zero (bad_model.py:7)"
    )


@pytest.mark.parametrize(
    ("kind", "part"),
    [
        ("community_model", "os:path"),
        ("community_model", "own_parts:Own"),
        ("community_model", "own_parts:INCOMPLETE"),
        ("community_model", "own_parts:OTHER"),
        ("competition_model", "own_parts:MODEL"),
        ("plant_generator", "own_parts:MODEL"),
        ("rig", "own_parts:MODEL"),
        ("instrument", "own_parts:MODEL"),
    ],
)
def test_a_part_that_lacks_what_its_kind_has_is_refused(kind: str, part: str) -> None:
    with raises_error(fg.RecipeError, place="part"):
        fg.register(kind, "own", part)
    assert not registry.registrations()


@pytest.mark.parametrize("kind", list(catalogue._REGISTRIES))
def test_all_shipped_parts_pass_the_check(kind: str) -> None:
    assert catalogue._REGISTRIES[kind].ids()
    for name in catalogue._REGISTRIES[kind].ids():
        catalogue._REGISTRIES[kind].check_part(name, catalogue._REGISTRIES[kind].load(name))


def test_the_example_of_the_manual_makes_a_stand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = Path(__file__).parents[3] / "docs" / "python.md"
    text = page.read_text(encoding="utf-8").partition("# rows_model.py\n")[2].partition("```")[0]
    (tmp_path / "rows_model.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    fg.register("community_model", "rows", "rows_model:MODEL")
    settings = {"model": "rows", "spacing_m": 0.5, "plants": {"fireweed": {"count": 20}}}
    stand = fg.load(STAND, set={"community": settings}).simulate(progress=False)
    assert len(stand) == 20
    offset = stand["y_m"] / 0.5
    assert np.allclose(offset, np.round(offset))


@pytest.mark.parametrize("name", ["palm", "fig_5_2", "koch"])
def test_descriptions_are_whole_sentences(name: str) -> None:
    (entry,) = fg.models(name, kind="lsystem")
    assert entry.description.endswith(".")


def test_models_of_a_kind_or_a_name() -> None:
    assert {one.kind for one in fg.models(kind="competition_model")} == {"competition_model"}
    names = {one.name for one in fg.models()}
    assert {"uniform", "silhouette", "spruce", "koch", "quickstart"} <= names
    (spruce,) = fg.models("spruce", kind="species")
    assert spruce.path is not None
    assert "ecology:" in spruce.page
    assert json.loads(json.dumps(spruce.as_dict()))["path"] == str(spruce.path)
    with raises_error(fg.RecipeError, place="kind"):
        fg.models(kind="specie")
    with raises_error(fg.RecipeError, place="name"):
        fg.models("sprce")
    with raises_error(fg.RecipeError, place="name"):
        fg.models("spruce", kind="recipe")


def test_species_have_the_size_of_a_mature_plant() -> None:
    found = {one.name: one for one in fg.species()}
    assert set(found) == {one.name for one in fg.models(kind="species")}
    assert found["fireweed"].height_m == pytest.approx(1.54, abs=0.01)
    assert 0 < found["spruce"].crown_width_m < found["spruce"].height_m
    assert found["fireweed"].generator == "silhouette"


def test_the_schema_is_a_copy() -> None:
    first = fg.schema()
    first.clear()
    assert "properties" in fg.schema()
