"""What is known to be wrong before anything is simulated."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from forestgen.core.errors import RecipeError, ResourceError
from forestgen.recipe.load import load_recipe
from forestgen.scene import plan
from forestgen.scene.plan import Plan, check_memory, check_plan, estimate_bytes, make_plan
from forestgen.scene.terrain import terrain_mesh
from support.error_messages import raises_error
from support.tiers import few

QUICKSTART = Path(__file__).parents[3] / "recipes" / "quickstart.yaml"
PERIOD = "model: multiset_lsystem, program: self_thinning"


def planned(*overrides: str) -> Plan:
    return check_plan(load_recipe(QUICKSTART, overrides))


@pytest.mark.parametrize(
    ("overrides", "reason"),
    [
        ((), None),
        (("community.steps=0",), "community.steps is 0"),
        (("species={fireweed: {from: fireweed, ecology: {seedlings_per_ha_per_yr: 0}}}",), "0 for every species"),
        ((f"community={{{PERIOD}}}",), None),
        ((f"community={{{PERIOD}, steps: 0}}",), None),
        ((f"community={{{PERIOD}, parameters: {{initial_plants_per_ha: 0}}}}",), "initial_plants_per_ha is 0"),
    ],
)
def test_a_recipe_that_can_never_grow_a_plant_says_why(overrides: Sequence[str], reason: str | None) -> None:
    said = planned(*overrides).community.empty_reason
    assert (said is None) if reason is None else (reason in (said or ""))


def test_a_barren_recipe_has_no_plants_and_another_may() -> None:
    from forestgen.community.simulation import final_population
    from forestgen.core.progress import Silent

    for overrides in (
        ("community.steps=0",),
        (f"community={{{PERIOD}, parameters: {{initial_plants_per_ha: 0}}, steps: 2}}",),
    ):
        one = planned(*overrides)
        assert one.community.empty_reason
        assert len(final_population(one.community, Silent())) == 0
    assert len(final_population(planned("community.steps=4").community, Silent())) > 0


@pytest.mark.parametrize(
    ("override", "below"),
    [
        ("cameras=[{position_m: [0, 0, -1], look_at_m: [5, 5, 5], obstructed: note}]", ["camera0"]),
        ("cameras=[{position_m: [0, 0, 1], look_at_m: [5, 5, -5]}]", []),
        (
            "cameras=[{position_m: [0, 0, -30], look_at_m: [5, 5, 5], height_above_ground: false, obstructed: note}]",
            ["camera0"],
        ),
    ],
)
def test_cameras_below_the_ground_are_named(override: str, below: list[str]) -> None:
    assert list(planned("site.terrain=rolling", override).views.below_ground) == below


MORE = {
    "images": ("cameras.0.size_px=[1280,720]", "cameras.0.size_px=[2560,1440]"),
    "exemplars": ("plants.exemplars_per_species=10", "plants.exemplars_per_species=20"),
    "ground": ("site.size_m=[100,100]", "site.size_m=[300,300]"),
    "community": ("site.size_m=[100,100]", "site.size_m=[300,300]"),
    "clouds": ("sky.clouds.extent_m=3000", "sky.clouds.extent_m=6000"),
}


@pytest.mark.parametrize("part", MORE)
def test_more_needs_more_memory(part: str) -> None:
    less, more = (estimate_bytes(planned("sky.clouds=noise", override)) for override in MORE[part])
    assert more[part] > less[part] > 0
    assert {name for name in more if more[name] != less[name]} <= {part, "ground", "community"} | (
        {"exemplars"} if part == "images" else set()
    )


def test_plants_and_clouds_above_them_need_memory() -> None:
    clear, far, near, asked = (
        planned(*one)
        for one in (
            ("sky.clouds=none",),
            ("sky.clouds=noise",),
            ("sky.clouds={type: noise, base_m: 250}",),
            ("sky.clouds=noise", "render.clouds=exact"),
        )
    )
    assert estimate_bytes(clear, plants=0)["plants"] == 0
    for part in ("plants", "exemplars"):
        sizes = [estimate_bytes(one, plants=1000)[part] for one in (clear, far, near, asked)]
        assert 1_000_000 < sizes[0] == sizes[1] < sizes[2] == sizes[3]  # far clouds are not traced with the plants
    assert set(estimate_bytes(clear, simulate_only=True)) == {"community", "libraries"}


@pytest.mark.parametrize("hills_m", [0, 60])
def test_the_grounds_estimate_is_that_of_its_mesh(hills_m: int) -> None:
    one = planned(f"site.terrain={{kind: rolling, hills_m: {hills_m}}}")
    faces = len(terrain_mesh(one.views.height).faces)
    assert estimate_bytes(one)["ground"] == faces * plan._BYTES_PER_TRIANGLE


@pytest.mark.parametrize(("name", "most"), few([("quickstart", 2.2e9), ("mixed_stand", 2.6e9), ("vista", 4.1e9)]))
def test_the_memory_of_shipped_recipes_is_within_that_of_usual_machines(name: str, most: float) -> None:
    loaded = load_recipe(QUICKSTART.with_name(f"{name}.yaml"))
    assert max(sum(estimate_bytes(make_plan(drawn)).values()) for drawn in loaded.probes()) < most


def test_the_limit_is_exact_and_the_message_names_the_largest_part(monkeypatch: pytest.MonkeyPatch) -> None:
    one = planned("plants.exemplars_per_species=60")
    need = sum(estimate_bytes(one).values())
    monkeypatch.setattr(plan, "free_bytes", lambda: int(need / 0.8) + 2)
    check_memory(one)
    monkeypatch.setattr(plan, "free_bytes", lambda: int(need / 0.8) - 2)
    with raises_error(ResourceError, place="plants.exemplars_per_species"):
        check_memory(one)
    monkeypatch.setattr(plan, "free_bytes", lambda: 10**12)
    with raises_error(ResourceError, place="site.size_m"):
        check_memory(one, plants=1_000_000_000)


def test_every_part_has_a_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    one = planned("sky.clouds=noise")
    parts = estimate_bytes(one)
    for name in parts:
        monkeypatch.setattr(plan, "estimate_bytes", lambda *_, name=name, **__: {**parts, name: 10**15})
        with raises_error(ResourceError) as refused:
            check_memory(one)
        assert refused.value.hint


def test_clouds_beyond_reach_and_cameras_in_them_are_refused() -> None:
    thick = "sky.clouds={type: noise, extinction_per_m: 0.2, thickness_m: 6000}"
    with raises_error(RecipeError, place="sky.clouds"):
        planned(thick)
    low = ("sky.clouds={type: noise, base_m: 30}", "cameras.0.position_m=[60,-14,31]")
    with raises_error(RecipeError, place="cameras.0.position_m"):
        planned(*low, "render.clouds=farfield")
    planned(*low, "render.clouds=exact")
    planned("sky.clouds={type: none, base_m: 30}", "cameras.0.position_m=[60,-14,31]")
