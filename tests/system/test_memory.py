"""The estimate of memory that guards a run is an upper bound, within reason: measured on whole runs."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from command_line import run, start

QUICKSTART = Path(__file__).parents[2] / "recipes" / "quickstart.yaml"
SMALL = [
    "sky.clouds=none",
    "render.samples=1",
    "labels.samples=1",
    "cameras=[{size_px: [64, 36]}]",
    "community.steps=40",
]
# Settings, least plants, and how many times what is taken the estimate may be.
RUNS: dict[str, tuple[list[str], int, float]] = {
    "quickstart": (["render.samples=1"], 0, 2.0),
    "images": ([*SMALL, "cameras=[{size_px: [2048, 1024]}]", "labels.samples=16"], 0, 2.0),
    "ground and plants": ([*SMALL, "site.size_m=[600,600]"], 50_000, 2.5),
    "tall exemplars": (
        [
            *SMALL,
            "species={spruce: {from: spruce, ecology: {seedling_radius_m: 0.4}}}",
            "community={model: multiset_lsystem, program: self_thinning, steps: 70}",
            "plants.exemplars_per_species=60",
        ],
        0,
        2.0,
    ),
    "clouds": ([*SMALL, "sky.clouds={type: noise, extent_m: 12000, thickness_m: 3000}"], 0, 2.0),
}
MOST_OVER = 3.0


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_the_estimate_holds(name: str, tmp_path: Path) -> None:
    from forestgen.recipe.load import load_recipe
    from forestgen.scene.plan import check_plan, estimate_bytes

    overrides, least_plants, most_over = RUNS[name]
    options = [text for one in overrides for text in ("--set", one)]
    process = start("render", QUICKSTART, "-o", tmp_path / "out", *options)
    out, err = process.communicate(timeout=600)
    assert process.returncode == 0, err
    plants = int(re.search(r"^([\d,]+) plants", out, re.MULTILINE)[1].replace(",", ""))  # type: ignore[index]
    assert plants >= least_plants
    peak = json.loads((tmp_path / "out" / "run" / "summary.json").read_text())["peak_memory_bytes"]
    parts = estimate_bytes(check_plan(load_recipe(QUICKSTART, overrides)), plants=plants)
    estimate = sum(parts.values())
    print(f"{name}: estimate {estimate / 1e6:.0f} MB, peak {peak / 1e6:.0f} MB, {plants} plants")  # noqa: T201
    assert peak < estimate < most_over * peak


@pytest.mark.slow
@pytest.mark.parametrize(
    ("recipe", "overrides"),
    [
        (QUICKSTART, ["site.size_m=[1500,1500]", "community.steps=60"]),
        (QUICKSTART.with_name("branch_modules.yaml"), []),
        (QUICKSTART.parent / "biomes" / "tundra.yaml", []),  # short segments: the most modules a square metre
    ],
)
def test_a_simulations_estimate_holds(recipe: Path, overrides: list[str], tmp_path: Path) -> None:
    from forestgen.recipe.load import load_recipe
    from forestgen.scene.plan import check_plan, estimate_bytes

    options = [text for one in overrides for text in ("--set", one)]
    process = start("simulate", recipe, "-o", tmp_path / "out", *options)
    _, err = process.communicate(timeout=600)
    assert process.returncode == 0, err
    peak = json.loads((tmp_path / "out" / "manifest.json").read_text())["peak_memory_bytes"]
    estimate = sum(estimate_bytes(check_plan(load_recipe(recipe, overrides)), simulate_only=True).values())
    print(f"simulate: estimate {estimate / 1e6:.0f} MB, peak {peak / 1e6:.0f} MB")  # noqa: T201
    assert peak < estimate < MOST_OVER * peak


def test_validate_tells_the_estimate() -> None:
    told = run("validate", QUICKSTART).out
    assert re.search(r"memory +up to about [\d.]+ GB to render, [\d.]+ [MG]B to simulate alone$", told, re.MULTILINE)
