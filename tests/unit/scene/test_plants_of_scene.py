"""The recipe's `plants` section: sizes, variants, traits, levels and the cache."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from forestgen.community.population import Population
from forestgen.core.errors import RecipeError
from forestgen.core.progress import Silent, Timings
from forestgen.core.randomness import child_rng
from forestgen.plants import growing
from forestgen.recipe.load import load_recipe
from forestgen.scene import build as scene
from forestgen.scene import growth
from forestgen.scene.plan import Plan, check_plan, estimate_bytes, make_plan
from forestgen.scene.spec import Terrain
from forestgen.scene.terrain import HeightField, build_terrain
from support.error_messages import raises_error

QUICKSTART = Path(__file__).parents[3] / "recipes" / "quickstart.yaml"
ALONE = ("species={fireweed: }", "sky.clouds=none", "site.terrain=flat")


def planned(*overrides: str, image: int = 0) -> Plan:
    return make_plan(load_recipe(QUICKSTART, (*ALONE, *overrides)).draw(image))


def herbs(y_m: list[float]) -> Population:
    n = len(y_m)
    radius = np.linspace(0.08, 0.12, n)
    return Population(
        time_yr=0.0,
        species_names=("fireweed",),
        plant_id=np.arange(1, n + 1, dtype=np.uint32),
        species=np.zeros(n, np.uint16),
        position_m=np.column_stack([np.full(n, 60.0), y_m, np.zeros(n)]),
        radius_m=radius,
        height_m=10 * radius,
        age_yr=np.zeros(n),
        status=np.zeros(n, np.uint8),
    )


@pytest.fixture(scope="module")
def ground() -> Terrain:
    return build_terrain(HeightField((10.0, 10.0)), child_rng(0))


@pytest.fixture(autouse=True)
def _same_ground(ground: Terrain, monkeypatch: pytest.MonkeyPatch) -> None:
    """Litter takes seconds a scene, and is not what is looked at here."""
    monkeypatch.setattr(scene, "build_terrain", lambda *_: ground)


@pytest.mark.parametrize(
    "override",
    [
        "plants.variants_per_size=0",
        "plants.variants_per_size=1.5",
        "plants.exemplars_per_species=1e9",
        "plants.levels=maybe",
        "plants.cache=7",
        "plants.traits=age_yr",
        "plants.traits=[age_yr, age_yr]",
        "plants.traits=[age]",
    ],
)
def test_bad_input_is_refused_before_the_simulation(override: str) -> None:
    with raises_error(RecipeError):
        check_plan(load_recipe(QUICKSTART, (*ALONE, override)))


def test_a_models_own_column_may_be_a_trait() -> None:
    model = "community={model: forest_footprints}"
    check_plan(load_recipe(QUICKSTART, (*ALONE, model, "plants.traits=[vigour, age_yr]")))
    with raises_error(RecipeError, place="plants.traits"):
        check_plan(load_recipe(QUICKSTART, (*ALONE, model, "plants.traits=[vigor]")))


def test_far_plants_have_a_far_version_of_the_same_exemplar() -> None:
    population = herbs([0.0, 1500.0])
    near = scene.build_scene(planned("plants.exemplars_per_species=1"), population, Silent(), Timings()).spec
    spec = scene.build_scene(
        planned("plants.exemplars_per_species=1", "plants.levels=true"), population, Silent(), Timings()
    ).spec
    assert len(near.exemplars) == 1
    assert len(spec.exemplars) == 2
    assert list(spec.instances.exemplar) == [0, 1]
    full, far = spec.exemplars
    assert far.triangles < full.triangles == near.exemplars[0].triangles
    assert far.leaf_area_m2 == pytest.approx(full.leaf_area_m2, rel=1e-4)
    np.testing.assert_allclose(spec.instances.transform, near.instances.transform, rtol=0.02, atol=1e-9)


def test_identities_are_the_species_rank_and_variant_at_any_level() -> None:
    plan = planned("plants.variants_per_size=2", "plants.levels=true", "plants.exemplars_per_species=2")
    population = herbs([*np.linspace(0, 1, 40), *np.linspace(1500, 1600, 40)])
    built = scene.build_scene(plan, population, Silent(), Timings())
    chosen = growth.choose_exemplars(plan, built.population, built.spec.cameras)
    requests = growth.exemplar_requests(plan, chosen, built.population)
    by_identity: dict[tuple[str | int, ...], set[float]] = {}
    for one in requests:
        by_identity.setdefault(one.identity, set()).add(one.radius_m)
    name = ("exemplar", "fireweed")
    assert set(by_identity) <= {(*name, 0), (*name, 0, 1), (*name, 1), (*name, 1, 1)}
    assert len(by_identity) == 4
    assert all(len(radii) == 1 for radii in by_identity.values())
    assert len({one.key() for one in requests}) == len(requests) > 4


def test_dead_wood_has_no_error_of_its_crown_width() -> None:
    plan = planned("species={fireweed: , snag: }", "plants.exemplars_per_species=1")
    population = herbs([1.0, 2.0, 3.0])
    both = replace(population, species_names=("fireweed", "snag"), species=np.array([0, 1, 1], np.uint16))
    herb, snag = scene.build_scene(plan, both, Silent(), Timings()).size_errors
    assert (herb.species, snag.species, snag.plants) == ("fireweed", "snag", 2)
    assert herb.crown_width_rms is not None
    assert snag.crown_width_rms is None


def test_the_cache_changes_nothing_and_a_later_image_leaves_it_alone(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("FORESTGEN_CACHE", str(tmp_path))
    population = herbs([0.0, 10.0, 20.0])

    def vertices(plan: Plan) -> list[bytes]:
        built = scene.build_scene(plan, population, Silent(), Timings())
        return [organ.mesh.vertices_m.tobytes() for one in built.spec.exemplars for organ in one.organs]

    without = vertices(planned("plants.cache=false"))
    assert not list(tmp_path.iterdir())
    assert vertices(planned()) == without
    entries = len(list((tmp_path / "exemplars").iterdir()))
    assert entries == 3
    vertices(planned("images=99", image=growth.MOST_CACHED_IMAGES))
    assert len(list((tmp_path / "exemplars").iterdir())) == entries
    monkeypatch.setattr(growing, "grow_exemplar", None)  # would fail
    assert vertices(planned()) == without


def test_variants_and_levels_need_more_memory() -> None:
    plain, variants, levels = (
        estimate_bytes(planned(one, "plants.near_foliage=false"))["exemplars"]
        for one in ("plants.cache=true", "plants.variants_per_size=3", "plants.levels=true")
    )
    assert variants == pytest.approx(3 * plain, rel=1e-3)
    assert plain < levels < 3 * plain


def test_plants_near_a_camera_need_more_memory() -> None:
    far = ("cameras.0.position_m=[60, -10, 900]", "cameras.0.look_at_m=[60, 60, 0]")
    near, none = (estimate_bytes(planned(f"plants.near_foliage={one}"))["exemplars"] for one in ("true", "false"))
    assert near - none == pytest.approx(4 * 640 * 360 * 250, rel=0.01)
    near, none = (estimate_bytes(planned(f"plants.near_foliage={one}", *far))["exemplars"] for one in ("true", "false"))
    assert near == none
