"""`plants.library`: plants that the images of a split share, and no two splits."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from forestgen.community.population import Population
from forestgen.core.errors import RecipeError
from forestgen.core.progress import Silent
from forestgen.plants import growing
from forestgen.recipe.load import dump_yaml, load_recipe
from forestgen.scene import growth
from forestgen.scene.exemplars import modelled_species
from forestgen.scene.plan import Plan, make_plan
from support.error_messages import raises_error

RECIPE = """
forestgen: 1
seed: 5
site: {size_m: [20, 20]}
species:
  fireweed: {from: fireweed, height_m: {uniform: [1.2, 1.9]}}
  grass:
community: {model: uniform, plants: {fireweed: {count: 20}, grass: {count: 20}}}
plants: {library: 2, exemplars_per_species: 4}
cameras: [{position_m: [10, -5, 2], look_at_m: [10, 10, 1]}]
dataset: {splits: {train: 1, val: 1}}
"""


@pytest.fixture(autouse=True)
def _nothing_kept() -> Iterator[None]:
    growing.forget_shared()
    yield
    growing.forget_shared()


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    path = tmp_path / "recipe.yaml"
    path.write_text(RECIPE)
    return path


def planned(recipe: Path, image: int = 0, *overrides: str) -> Plan:
    return make_plan(load_recipe(recipe, overrides).draw(image))


def herbs(plan: Plan, n: int = 12) -> Population:
    rng = np.random.default_rng(plan.drawn.image_seed)
    species = np.arange(n) % 2
    radius = rng.uniform(0.06, 0.14, n)
    heights = [one.allometry.height(radius) for one in plan.drawn.species.values()]
    return Population(
        time_yr=0.0,
        species_names=("fireweed", "grass"),
        plant_id=np.arange(1, n + 1, dtype=np.uint32),
        species=species.astype(np.uint16),
        position_m=np.zeros((n, 3)),
        radius_m=radius,
        height_m=np.where(species == 0, *heights),
        age_yr=np.zeros(n),
        status=np.zeros(n, np.uint8),
    )


def keys(plan: Plan) -> set[str]:
    chosen = growth.choose_exemplars(plan, herbs(plan), ())
    return {request.key() for request in growth.exemplar_requests(plan, chosen, herbs(plan))}


def test_images_of_a_split_ask_for_the_same_plants_and_other_splits_for_others(recipe: Path) -> None:
    loaded = load_recipe(recipe)
    asked: dict[str, set[str]] = {"train": set(), "val": set()}
    total = 0
    for image in range(40):
        plan = make_plan(loaded.draw(image))
        found = keys(plan)
        total += len(found)
        asked[plan.drawn.split] |= found
    assert not asked["train"] & asked["val"]
    # Radii span four rungs, and drawn heights four of fireweed's scale: each with two plants.
    assert all(10 < len(found) <= 2 * (4 * 4 + 4) for found in asked.values())
    assert total > 3 * sum(map(len, asked.values()))


def test_without_a_library_every_image_has_its_own(recipe: Path) -> None:
    one, other = (keys(planned(recipe, image, "plants.library=null")) for image in (0, 2))
    assert not one & other
    plan = planned(recipe, 0, "plants.library=null")
    requests = growth.exemplar_requests(plan, growth.choose_exemplars(plan, herbs(plan), ()), herbs(plan))
    assert requests[0].identity == ("exemplar", "fireweed", 0)
    assert requests[0].seed == plan.drawn.image_seed
    assert requests[0].species is plan.drawn.species["fireweed"]
    assert not any(request.is_shared for request in requests)


def test_another_root_seed_has_other_plants(recipe: Path) -> None:
    assert not keys(planned(recipe)) & keys(planned(recipe, 0, "seed=6"))


def test_the_stored_recipe_of_an_image_asks_for_the_same_plants(recipe: Path, tmp_path: Path) -> None:
    for image in (3, 4):
        plan = planned(recipe, image)
        stored = tmp_path / f"{image}.yaml"
        stored.write_text(dump_yaml(plan.drawn))
        assert keys(planned(stored)) == keys(plan)


def test_images_late_in_the_data_set_take_their_plants_from_memory_or_disk(
    recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FORESTGEN_CACHE", str(tmp_path / "cache"))
    plan = planned(recipe, growth.MOST_CACHED_IMAGES + 4)
    chosen = growth.choose_exemplars(plan, herbs(plan), ())

    def vertices() -> list[bytes]:
        grown = growth.grow_planned(plan, chosen, Silent(), herbs(plan))
        return [organ.mesh.vertices_m.tobytes() for one in grown for organ in one.organs]

    first = vertices()
    assert len(list((tmp_path / "cache" / "exemplars").iterdir())) == len(chosen)
    monkeypatch.setattr(growing, "grow_exemplar", None)  # would fail
    growing.forget_shared()
    assert vertices() == first  # from disk
    monkeypatch.setattr(growing, "load_exemplar", None)
    assert vertices() == first  # from memory


def test_memory_holds_no_more_than_its_bytes(recipe: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORESTGEN_CACHE", "")
    monkeypatch.setattr(growing._shared, "most_bytes", 300_000)
    for image in (0, 2):
        plan = planned(recipe, image)
        growth.grow_planned(plan, growth.choose_exemplars(plan, herbs(plan), ()), Silent(), herbs(plan))
        held = list(growing._shared._kept.values())
        assert sum(one.nbytes for one in held) <= 300_000


def test_proportions_stay_near_the_plants_own(recipe: Path) -> None:
    """The scale of the heights is on a ladder, too: a model is at most 7% too slender or too stout."""
    for image in range(12):
        drawn = planned(recipe, image)
        for name, species in drawn.drawn.species.items():
            law, grown = (one.allometry.height_m for one in (species, modelled_species(drawn.drawn, name)))
            assert abs(np.log(grown.scale / law.scale)) <= np.log(1.15) / 2 + 1e-12
            assert grown.exponent == law.exponent
            assert modelled_species(drawn.drawn, name).allometry.width_m == species.allometry.width_m


@pytest.mark.parametrize(
    "override",
    [
        "plants.library=0",
        "plants.library=1.5",
        "plants={library: 2, variants_per_size: 3}",
        "plants={library: 2, traits: [age_yr]}",
    ],
)
def test_bad_input_is_refused(recipe: Path, override: str) -> None:
    with raises_error(RecipeError):
        load_recipe(recipe, [override])


def test_the_fewer_trees_an_image_shows_the_nearer_they_are_to_the_median(recipe: Path) -> None:
    """Alone a tree has all sizes of the median but its leaf area, which is the mean of trees of its height."""
    recipe.write_text(RECIPE.replace("{library: 2", "{library: 60").replace("  grass:", "  grass: birch"))
    logs = []
    for shown in (1, 4, 60):
        plan = planned(recipe, 0, f"plants.variants_per_size={shown}")
        trees = np.array([growth._library_tree(plan, "grass", 10, variant, 0) for variant in range(60)])
        logs.append(np.log(trees[:, [1, 2, 4]]))
    species = plan.drawn.species["grass"]
    assert species.tree is not None
    height_m = np.full(1000, 1.25**10)
    every = species.tree.sizes(height_m, np.random.default_rng(1).standard_normal((1000, 4)))
    alone, few, many = logs
    np.testing.assert_allclose(np.std(alone, axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(alone[0, :2], np.median(np.log([every.crown_width_m, every.dbh_m]), axis=1), atol=0.05)
    leaf_area_m2 = every.leaf_kg.mean() / species.tissue.leaf_mass_per_area_kg_per_m2
    assert alone[0, 2] == pytest.approx(np.log(leaf_area_m2), abs=0.1)
    np.testing.assert_allclose(np.std(few, axis=0), np.sqrt(0.75 / (1 - 1 / 60)) * np.std(many, axis=0), rtol=0.03)
