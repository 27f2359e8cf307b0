"""What a simulation writes for a community that was placed by densities, and for one of no steps."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from forestgen.community.history_files import write_community
from forestgen.community.population import Population
from forestgen.community.simulation import snapshots
from forestgen.core.progress import Silent
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import check_plan

RECIPE = """\
forestgen: 1
seed: 3
site: {size_m: [30, 20]}
species: {fireweed: , spruce: , poplar: }
community:
  model: deformation_kernel
  keep_out: [[1, 0, 0], [0, 0, 0]]
  plants:
    fireweed: {count: 60, radius_m: 0.3, map: [[1, 2, 1], [0, 0, 3]]}
    spruce: {plants_per_ha: 100, radius_m: 1}
cameras: [{position_m: [3, -3, 1.5], look_at_m: [3, 3, 0.5], size_px: [48, 27]}]
"""
PLACED = {"history.parquet", "sizes.png", "statistics.json"}


def written(folder: Path, *overrides: str) -> tuple[Population, set[str], dict[str, object]]:
    (folder / "recipe.yaml").write_text(RECIPE, encoding="utf-8")
    plan = check_plan(load_recipe(folder / "recipe.yaml", overrides), simulate_only=True)
    out = folder / "out"
    out.mkdir()
    last = write_community(out, plan.community, snapshots(plan.community, Silent()), [])
    told = json.loads((out / "statistics.json").read_text(encoding="utf-8"))
    return last, {path.name for path in out.iterdir()}, told


def test_a_placement_is_shown_beside_what_was_asked_for(tmp_path: Path) -> None:
    last, files, told = written(tmp_path)
    assert files == PLACED | {"densities.png", "map-000000.png"}
    placement = told["placement"]
    assert isinstance(placement, dict)
    assert set(placement) == {"fireweed", "spruce"}
    for name, one in placement.items():
        here = int((last.species == last.species_names.index(name)).sum())
        assert set(one) == {"asked", "placed", "chi_square", "hopkins"}
        assert one["placed"] == here
        assert one["hopkins"]["value"] > 0
    assert placement["fireweed"]["asked"] == 60
    assert placement["spruce"]["asked"] == 5  # 6 on the whole site, of which a sixth is barred
    assert placement["fireweed"]["chi_square"]["degrees_of_freedom"] > 1
    assert told["self_thinning"] is None


def test_the_kernel_found_for_a_target_is_told(tmp_path: Path) -> None:
    last, _, told = written(tmp_path, "community.kernels={hopkins: 0.8}")
    clustering = told["clustering"]
    assert isinstance(clustering, dict)
    assert clustering == last.state["clustering"]
    assert clustering["asked_hopkins"] == 0.8
    assert clustering["hopkins"] == told["steps"][0]["hopkins"]["all"]["value"]  # type: ignore[index]
    assert set(clustering["kernels"]) == {"curve", "distance", "balanced"}


def test_plants_that_age_are_shown_as_they_were_placed(tmp_path: Path) -> None:
    fell = "community.disturbances=[{at_step: 2, fell: {}}]"
    last, files, told = written(tmp_path, "community.steps=2", fell)
    assert files == PLACED | {"densities.png", "map-000002.png", "curves.png", "thinning.png", "animation.gif"}
    assert not len(last)
    assert told["placement"]["fireweed"]["placed"] == 60  # type: ignore[index]


@pytest.mark.parametrize("community", ["{model: placed, steps: 0}", "{model: multiset_lsystem, steps: 0}"])
def test_a_community_without_densities_or_steps(community: str, tmp_path: Path) -> None:
    _, files, told = written(tmp_path, f"community={community}")
    assert files == PLACED | {"map-000000.png"}
    assert "placement" not in told
