"""Communities from disk: the same as simulated ones, and never those of another recipe."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from forestgen.architecture.modules import Modules
from forestgen.community import simulation
from forestgen.community.placement.density_map import MapSection
from forestgen.community.population import Population, Site, SpeciesEcology
from forestgen.community.registry import COMMUNITY_MODELS
from forestgen.community.simulation import _plain, as_kept, community_key, final_population
from forestgen.core.array_serialization import pack, read_packed
from forestgen.core.cache import ENVIRONMENT
from forestgen.core.errors import RecipeError
from forestgen.core.progress import Silent
from forestgen.recipe.load import load_recipe
from forestgen.recipe.species import PlantType
from forestgen.scene.plan import Plan, make_plan

SUCCESSION = """\
forestgen: 1
seed: 3
site: {size_m: [20, 16], terrain: {kind: rolling, amplitude_m: 2}}
species:
  fireweed: {from: fireweed, ecology: {seedlings_per_ha_per_yr: 4000}}
  spruce: {from: spruce, ecology: {seedlings_per_ha_per_yr: 900}}
community: {model: multiset_lsystem, program: succession, steps: 6}
"""
PLACED = """\
forestgen: 1
site: {size_m: [6, 4], terrain: {kind: map, map: hills.npy}}
species: {fireweed: }
community: {model: deformation_kernel, plants: {fireweed: {count: 12, map: meadow.png}}, keep_out: path.png}
"""
MODULES = """\
forestgen: 1
site: {size_m: [12, 12], terrain: flat}
species: {spruce: }
community:
  {model: branch_modules, steps: 4, initial_plants: {spruce: 3}, temperature_c: 5, precipitation_mm_per_yr: 800}
"""
RECIPES = {"succession": SUCCESSION, "placed": PLACED, "modules": MODULES}


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache in which everything is worth its place."""
    monkeypatch.setenv(ENVIRONMENT, str(tmp_path / "cache"))
    monkeypatch.setattr(simulation, "WORTHWHILE_S", 0.0)
    return tmp_path / "cache" / "communities"


def planned(folder: Path, text: str, *overrides: str) -> Plan:
    folder.mkdir(exist_ok=True)
    if "png" in text:
        values = np.linspace(0, 255, 24).astype(np.uint8).reshape(4, 6)
        Image.fromarray(values).save(folder / "meadow.png")
        Image.fromarray(np.where(values > 200, 255, 0).astype(np.uint8)).save(folder / "path.png")
        if not (folder / "hills.npy").exists():
            np.save(folder / "hills.npy", values / 100.0)
    (folder / "recipe.yaml").write_text(text)
    return make_plan(load_recipe(folder / "recipe.yaml", overrides).draw(0))


def simulations(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Grows with each simulation."""
    done: list[int] = []
    own = simulation.snapshots
    monkeypatch.setattr(simulation, "snapshots", lambda *args: done.append(1) or own(*args))
    return done


@pytest.mark.parametrize("name", RECIPES)
def test_what_comes_from_disk_is_what_would_be_simulated(
    name: str, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = simulations(monkeypatch)
    plan = planned(tmp_path, RECIPES[name])
    first = final_population(plan.community, Silent())
    assert len(first) > 1
    assert (name == "modules") == (first.modules is not None)
    again = final_population(planned(tmp_path, RECIPES[name]).community, Silent())
    assert len(done) == 1
    monkeypatch.setenv(ENVIRONMENT, "")  # no cache
    fresh = final_population(plan.community, Silent())
    assert len(done) == 2
    assert pack(first) == pack(again) == pack(fresh)
    for one in fields(Population):
        mine, theirs = getattr(fresh, one.name), getattr(again, one.name)
        assert type(mine) is type(theirs)
        if isinstance(mine, np.ndarray):
            assert mine.flags.c_contiguous
            assert theirs.flags.c_contiguous
            assert theirs.flags.writeable == mine.flags.writeable
    assert dict(fresh.state) == dict(again.state)


def test_an_empty_community_and_a_states_lists_come_back(cache: Path, tmp_path: Path) -> None:
    store = simulation.community_store()
    assert store is not None
    empty = final_population(planned(tmp_path, SUCCESSION, "community.steps=0").community, Silent())
    told = replace(empty, state={"notes": ["one", "two"], "next_id": 7, "deep": {"a": [1, [2.5, None]], "b": (1,)}})
    assert simulation.keep_community(store, "x", told)
    found = read_packed(store, "x", (Population, Modules))
    assert found is not None
    assert pack(found) == pack(told)
    assert found.state == told.state
    assert found.notes == ("one", "two")


def test_a_damaged_entry_is_simulated_anew(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done = simulations(monkeypatch)
    plan = planned(tmp_path, SUCCESSION)
    first = final_population(plan.community, Silent())
    [path] = cache.iterdir()
    whole = path.read_bytes()
    for damaged in (whole[: len(whole) // 2], b"", whole[:-1] + bytes([whole[-1] ^ 1])):
        path.write_bytes(damaged)
        assert pack(final_population(plan.community, Silent())) == pack(first)
        assert path.read_bytes() == whole
    assert len(done) == 4


def test_what_is_simulated_in_no_time_is_not_kept(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulation, "WORTHWHILE_S", 3600.0)
    final_population(planned(tmp_path, SUCCESSION).community, Silent())
    assert not cache.exists()


def test_images_of_one_stand_are_simulated_once(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done = simulations(monkeypatch)
    planned(tmp_path, SUCCESSION + "same_stand: true\nsky: {turbidity: {uniform: [2, 6]}}\n")
    loaded = load_recipe(tmp_path / "recipe.yaml")
    for index in range(3):
        final_population(make_plan(loaded.draw(index)).community, Silent())
    assert len(done) == 1


def leaves(value: Any, keys: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Key path and value of everything below a section that is no section itself."""
    if isinstance(value, dict):
        for key, one in value.items():
            yield from leaves(one, (*keys, key))
    else:
        yield keys, value


OTHER = {"kind": ["flat"], "model": [], "program": ["self_thinning"], "environment": ["sphere"]}
SECTIONS = ("site", "community", "species")
MATTERS = ("community", "ecology", "size_m", "altitude_m", "latitude_deg", "wind_from_deg")


def others(key: str, value: Any) -> list[str]:
    """Other values to try, as YAML."""
    if isinstance(value, bool):
        return [str(not value).lower()]
    if isinstance(value, int | float):
        return [repr(value * 1.01 + 0.01), repr(value + 1), repr(value * 0.5)]
    if isinstance(value, tuple | list) and value and all(isinstance(one, int | float) for one in value):
        return [repr([one + 1 for one in value])]
    return OTHER.get(key, [])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["succession", "placed"])
def test_recipes_of_one_key_have_one_community(name: str, cache: Path, tmp_path: Path) -> None:
    """Every value of the community, the site and the species is changed: the key tells whatever the plants tell."""
    base = planned(tmp_path, RECIPES[name])
    known = {community_key(base.community): pack(_simulated(base))}
    tried = set()
    for section in SECTIONS:
        for keys, value in leaves(base.drawn.data[section], (section,)):
            if section == "species" and keys[2] not in ("ecology", "allometry", "modules"):
                continue
            if (changed := _changed(tmp_path, RECIPES[name], keys, value)) is None:
                continue
            tried.add(".".join(keys))
            key = community_key(changed.community)
            assert key is not None
            if set(keys) & set(MATTERS):
                assert key != community_key(base.community), keys
            else:
                assert known.setdefault(key, pack(_simulated(changed))) == pack(_simulated(changed)), keys
    assert len(tried) > 12, tried


def _simulated(plan: Plan) -> Population:
    *_, last = simulation.snapshots(plan.community, Silent())
    return as_kept(last)


def _changed(folder: Path, text: str, keys: tuple[str, ...], value: Any) -> Plan | None:
    """The plan of a recipe with another value there; None if none of those tried may stand there."""
    for other in others(keys[-1], value):
        try:
            return planned(folder, text, f"{'.'.join(keys)}={other}")
        except RecipeError:
            continue
    return None


def test_seed_steps_files_and_code_are_in_the_key(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = {community_key(planned(tmp_path, PLACED).community)}
    seen.add(community_key(planned(tmp_path, PLACED, "seed=4").community))
    seen.add(community_key(planned(tmp_path, PLACED, "first_image=1").community))
    seen.add(community_key(planned(tmp_path, PLACED, "community.model=uniform").community))
    np.save(tmp_path / "hills.npy", np.full((4, 6), 2.0))
    seen.add(community_key(planned(tmp_path, PLACED).community))
    monkeypatch.setattr(simulation, "code_hash", lambda *_: "other")
    seen.add(community_key(planned(tmp_path, PLACED).community))
    assert len(seen) == 6
    assert None not in seen


def test_the_key_does_not_tell_where_the_recipe_lies(cache: Path, tmp_path: Path) -> None:
    first = community_key(planned(tmp_path / "one", PLACED).community)
    shutil.copytree(tmp_path / "one", tmp_path / "two")
    (tmp_path / "two" / "meadow.png").rename(tmp_path / "two" / "field.png")
    (tmp_path / "two" / "recipe.yaml").write_text(PLACED.replace("meadow", "field"))
    assert community_key(make_plan(load_recipe(tmp_path / "two" / "recipe.yaml").draw(0)).community) == first


def another(value: Any) -> Any:
    """A value that differs."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return value + 1
    return "another" if value is None or isinstance(value, str) else (value, 1)


def complete(kind: type[BaseModel]) -> BaseModel:
    """A section with all keys, unchecked."""
    values = {
        name: 1 if field.is_required() or field.default is PydanticUndefined else field.default
        for name, field in kind.model_fields.items()
    }
    return kind.model_construct(**values)


@pytest.mark.parametrize("name", [*COMMUNITY_MODELS.ids(), "plant type", "map"])
def test_every_key_of_every_model_is_told(name: str) -> None:
    own = {"plant type": PlantType, "map": MapSection}
    kind = own.get(name) or COMMUNITY_MODELS.load(name).Parameters
    base = complete(kind)
    for field, about in kind.model_fields.items():
        if not about.exclude:  # a map's file is told by its SHA-256
            assert _content(base.model_copy(update={field: another(getattr(base, field))})) != _content(base), field


def test_everything_of_the_site_and_of_a_species_is_told(tmp_path: Path) -> None:
    plan = planned(tmp_path, SUCCESSION)
    for whole in (plan.community.site, plan.community.ecologies[1]):
        for one in fields(whole):
            if one.name in ("height", "modules", "tree"):
                changed = replace(whole, **{one.name: None})
            elif one.name == "size_m":
                changed = replace(whole, size_m=(20.0, 17.0))
            elif one.name == "name":
                changed = replace(whole, name="other")
            elif one.name == "buildings":
                changed = replace(whole, buildings=("a house",))
            else:
                changed = replace(whole, **{one.name: getattr(whole, one.name) * 0.5 + 0.01})
            assert _content(changed) != _content(whole), one.name
    assert _content(Site((1.0, 2.0))) != _content(SpeciesEcology("a", 0, 1, 0, 0, 0, 1, 1, 1))


def _content(value: Any) -> bytes:
    return pack(_plain(value))


def test_what_its_content_does_not_tell_is_not_kept(tmp_path: Path) -> None:
    plan = planned(tmp_path, SUCCESSION)
    strange = replace(plan.community.site, height=lambda x, y: x + y)
    assert community_key(replace(plan.community, site=strange)) is None
    unnamed = MapSection.model_construct(file="x.png", sha256=None, rows=None)
    with pytest.raises(TypeError):
        _content(unnamed)
