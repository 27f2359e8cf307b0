"""What is known to be wrong before anything is simulated."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import pytest

from forestgen.core.errors import RecipeError, ResourceError
from forestgen.recipe.load import load_recipe
from forestgen.stages import plan
from forestgen.stages.plan import (
    Plan,
    check_memory,
    check_plan,
    estimate_bytes,
    mature_triangles,
    views_below_ground,
    why_barren,
)

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
    said = why_barren(planned(*overrides))
    assert (said is None) if reason is None else (reason in (said or ""))


def test_a_barren_recipe_has_no_plants_and_another_may() -> None:
    from forestgen.core.progress import Silent
    from forestgen.stages.community import final_population

    for overrides in (
        ("community.steps=0",),
        (f"community={{{PERIOD}, parameters: {{initial_plants_per_ha: 0}}, steps: 2}}",),
    ):
        one = planned(*overrides)
        assert why_barren(one)
        assert len(final_population(one, Silent())) == 0
    assert len(final_population(planned("community.steps=4"), Silent())) > 0


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
    assert views_below_ground(planned("site.terrain=rolling", override)) == below


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
    assert {name for name in more if more[name] != less[name]} <= {part, "ground", "community"}


def test_no_shipped_species_has_more_triangles_than_estimated() -> None:
    """The numbers of docs/species.md, which are measured on plants that were grown."""
    page = (QUICKSTART.parents[1] / "docs" / "species.md").read_text()
    rows = re.findall(r"^\| \[(\w+)\]\(.*?\) \|.*?\| [\d.]+ \| [\d.]+ \| ([\d,]+) \|", page, re.MULTILINE)
    grown = {name: int(triangles.replace(",", "")) for name, triangles in rows}
    assert grown["bracken"] > grown["poplar"] > 100_000
    drawn = load_recipe(QUICKSTART, [f"species={{{', '.join(f'{name}: ' for name in grown)}}}"]).draw(0)
    few = {name: triangles for name, triangles in grown.items() if mature_triangles(drawn.species[name]) < triangles}
    assert few == {}


def test_plants_and_clouds_above_them_need_memory() -> None:
    clear, cloudy = (planned(f"sky.clouds={kind}") for kind in ("none", "noise"))
    assert estimate_bytes(clear, plants=0)["plants"] == 0
    assert estimate_bytes(cloudy, plants=1000)["plants"] > estimate_bytes(clear, plants=1000)["plants"] > 1_000_000
    assert set(estimate_bytes(clear, simulate_only=True)) == {"community", "libraries"}


def test_the_limit_is_exact_and_the_message_names_the_largest_part(monkeypatch: pytest.MonkeyPatch) -> None:
    one = planned()
    need = sum(estimate_bytes(one).values())
    monkeypatch.setattr(plan, "free_bytes", lambda: int(need / 0.8) + 2)
    check_memory(one)
    monkeypatch.setattr(plan, "free_bytes", lambda: int(need / 0.8) - 2)
    with pytest.raises(ResourceError, match="exemplars"):
        check_memory(one)
    monkeypatch.setattr(plan, "free_bytes", lambda: 10**12)
    with pytest.raises(ResourceError, match=r"100,000,000 plants grew[\s\S]*smaller"):
        check_memory(one, plants=100_000_000)


def test_every_part_has_a_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    one = planned("sky.clouds=noise")
    parts = estimate_bytes(one)
    for name in parts:
        monkeypatch.setattr(plan, "estimate_bytes", lambda *_, name=name, **__: {**parts, name: 10**15})
        with pytest.raises(ResourceError, match=f"most of it for the {name}") as refused:
            check_memory(one)
        assert refused.value.hint
        assert "1,000 TB" in str(refused.value)


def test_clouds_beyond_reach_and_cameras_in_them_are_refused() -> None:
    thick = "sky.clouds={type: noise, extinction_per_m: 0.2, thickness_m: 6000}"
    with pytest.raises(RecipeError, match=r"too thick[\s\S]*0\.2 x 6000 = 1200"):
        planned(thick)
    low = ("sky.clouds={type: noise, base_m: 30}", "cameras.0.position_m=[60,-14,31]")
    with pytest.raises(RecipeError, match=r"above the clouds[\s\S]*render.clouds to exact"):
        planned(*low, "render.clouds=farfield")
    planned(*low, "render.clouds=exact")
    planned("sky.clouds={type: none, base_m: 30}", "cameras.0.position_m=[60,-14,31]")
