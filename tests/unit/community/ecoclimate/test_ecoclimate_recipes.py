"""Recipes of ecoclimates that cannot be: one clear message each, from the command that checks them."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from forestgen.cli import app

RECIPE = """\
forestgen: 1
seed: 1
site:
  size_m: [20, 15]
  buildings: [{kind: house, position_m: [10, 8], size_m: [4, 3, 3]}]
species:
  shrub: {from: shrub}
community:
  model: ecoclimate
  steps: 3
  initial_plants: {shrub: 20}
  climate: {place: Juneau}
cameras: [{position_m: [10, -10, 2], look_at_m: [10, 5, 1], size_px: [48, 27]}]
"""
CLIMATE = "climate: {place: Juneau}"
TWELVE = ", ".join(["5"] * 12)


def months(temperature: str = TWELVE, precipitation: str = TWELVE) -> str:
    return f"climate: {{temperature_c: [{temperature}], precipitation_mm: [{precipitation}]}}"


ELEVEN = ", ".join(["5"] * 11)

# What is wrong: text to replace, its replacement, and what the message must say.
MISTAKES: dict[str, tuple[str, str, list[str]]] = {
    "no climate": (CLIMATE, "climate:", ["climate"]),
    "no climate at all": (f"  {CLIMATE}\n", "", ["climate", "missing"]),
    "half a climate, warmth": (
        CLIMATE,
        f"climate: {{temperature_c: [{TWELVE}]}}",
        ["half a climate", "precipitation_mm"],
    ),
    "half a climate, rain": (
        CLIMATE,
        f"climate: {{precipitation_mm: [{TWELVE}]}}",
        ["half a climate", "temperature_c"],
    ),
    "no such place": (CLIMATE, "climate: {place: Junau}", ["community.climate.place", "'Juneau'", "San Diego"]),
    "a place that is a number": (CLIMATE, "climate: {place: 7}", ["community.climate.place"]),
    "eleven months": (CLIMATE, months(ELEVEN), ["community.climate.temperature_c", "12"]),
    "not a number": (CLIMATE, months(ELEVEN + ", .nan"), ["community.climate.temperature_c.11", "nan"]),
    "negative rain": (CLIMATE, months(TWELVE, ELEVEN + ", -1"), ["community.climate.precipitation_mm.11", "-1"]),
    "a hundred degrees": (CLIMATE, months(ELEVEN + ", 100"), ["community.climate.temperature_c.11", "60"]),
    "text for months": (CLIMATE, "climate: {temperature_c: warm, precipitation_mm: wet}", ["community.climate.temp"]),
    "a key of no climate": (CLIMATE, "climate: {plaice: Juneau}", ["plaice", "place"]),
    "a tenth of a year": (
        CLIMATE,
        CLIMATE + "\n  step_yr: 0.1",
        ["community.step_yr", "whole number of months", "0.1"],
    ),
    "no time": (CLIMATE, CLIMATE + "\n  step_yr: 0", ["community.step_yr"]),
    "a step that is not a number": (CLIMATE, CLIMATE + "\n  step_yr: .nan", ["community.step_yr"]),
    "backwards": (
        CLIMATE,
        CLIMATE + "\n  climate_changes: [{from_yr: 5, to_yr: 4, temperature_k: 1}]",
        ["community.climate_changes.0.to_yr", "5", "4"],
    ),
    "rain below none": (
        CLIMATE,
        CLIMATE + "\n  climate_changes: [{from_yr: 1, to_yr: 4, precipitation: -0.5}]",
        ["community.climate_changes.0.precipitation", "-0.5"],
    ),
    "vapour without air": (
        CLIMATE,
        CLIMATE + "\n  climate_changes: [{from_yr: 1, to_yr: 4, vapour: 0.5}]",
        ["community.climate_changes.0.vapour", "0.5", "weather: {}"],
    ),
    "vapour below none": (
        CLIMATE,
        CLIMATE + "\n  weather: {}\n  climate_changes: [{from_yr: 1, to_yr: 4, vapour: -0.5}]",
        ["community.climate_changes.0.vapour", "-0.5"],
    ),
    "heat of eleven months": (
        CLIMATE,
        CLIMATE + f"\n  weather: {{heat_w_per_m2: [{ELEVEN}]}}",
        ["community.weather.heat_w_per_m2", "twelve", "11 of them"],
    ),
    "a month that takes vapour": (
        CLIMATE,
        CLIMATE + f"\n  weather: {{vapour_w_per_m2: [{ELEVEN}, -1]}}",
        ["community.weather.vapour_w_per_m2", "-1 in Dec"],
    ),
    "air by no number": (CLIMATE, CLIMATE + "\n  weather: {extent_m: [4000]}", ["community.weather.extent_m"]),
    "two climates": (CLIMATE, CLIMATE + "\n  temperature_c: 9", ["community.temperature_c", "two climates"]),
    "a biome beside months": (CLIMATE, CLIMATE + "\n  biome: {place: Helsinki}", ["biome"]),
    "a climate in a change": (
        CLIMATE,
        CLIMATE + "\n  changes: [{at_yr: 0.1, set: {temperature_c: 9}}]",
        ["community.changes.0.set.temperature_c", "two climates"],
    ),
    "half a climate in a change": (
        CLIMATE,
        CLIMATE + f"\n  changes: [{{at_yr: 0.1, set: {{climate: {{temperature_c: [{TWELVE}]}}}}}}]",
        ["community.changes.0.set.climate", "half a climate"],
    ),
    "other cells in a change": (
        CLIMATE,
        CLIMATE + "\n  changes: [{at_yr: 0.1, set: {soil_water: {kind: dryland, cell_m: 3}}}]",
        ["community.changes.0.set.soil_water", "cell_m: 1.5"],
    ),
    "cells of a millimetre": (CLIMATE, CLIMATE + "\n  soil_water: {cell_m: 0.001}", ["soil_water.cell_m", "0.25"]),
    "cells of a kilometre": (CLIMATE, CLIMATE + "\n  soil_water: {cell_m: 1000}", ["soil_water.cell_m", "100"]),
    "cells of no number": (CLIMATE, CLIMATE + "\n  soil_water: {cell_m: .nan}", ["soil_water.cell_m"]),
    "no such soil": (CLIMATE, CLIMATE + "\n  soil_water: {kind: peat}", ["soil_water.kind", "forest", "dryland"]),
    "a key of no soil": (CLIMATE, CLIMATE + "\n  soil_water: {los_per_day: 1}", ["los_per_day", "loss_per_day"]),
    "more than all": (CLIMATE, CLIMATE + "\n  soil_water: {bare_infiltration: 1.5}", ["soil_water.bare_infiltration"]),
    "a past without end": (CLIMATE, CLIMATE + "\n  memory_yr: .inf", ["community.memory_yr"]),
    "a microclimate in between": (CLIMATE, CLIMATE + "\n  microclimate: 0.5", ["community.microclimate"]),
    "seeds of strangers": (
        CLIMATE,
        CLIMATE + "\n  global_seeding: [{species: [shrup]}]",
        ["community.global_seeding.0.species.0", "did you mean 'shrub'"],
    ),
    "seeds of houses": (
        CLIMATE,
        CLIMATE + "\n  global_seeding: [{species: [house]}]",
        ["community.global_seeding.0.species", "no species of this name"],
    ),
    "a species' seeds twice": (
        CLIMATE,
        CLIMATE + "\n  global_seeding: [{species: [shrub, shrub]}]",
        ["community.global_seeding.0.species", "shrub"],
    ),
    "a billion seeds": (
        CLIMATE,
        CLIMATE + "\n  global_seeding: [{seeds_per_ha: 1.0e9}]",
        ["community.global_seeding.0.seeds_per_ha", "100000"],
    ),
    "seeds at all times": (
        CLIMATE,
        CLIMATE + "\n  global_seeding: [{every_yr: 1.0e-300}]",
        ["community.global_seeding.0.every_yr", "0.01"],
    ),
    "more cells than memory": (
        "size_m: [20, 15]",
        "size_m: [5000, 5000]",
        ["more memory than is free", "community"],
    ),
    "more seeds than can be drawn": (
        "size_m: [20, 15]",
        "size_m: [5000, 5000]",
        ["more seeds would fall", "community.global_seeding"],
    ),
}
EXTRA = {
    "more cells than memory": "\n  soil_water: {cell_m: 0.25}\n  most_modules: 1000",
    "more seeds than can be drawn": "\n  soil_water: {cell_m: 100}\n  most_modules: 1000\n"
    "  global_seeding: [{seeds_per_ha: 1.0e5, every_yr: 0.01}]",
}


def validated(folder: Path, text: str) -> tuple[int, str, str]:
    path = folder / "recipe.yaml"
    path.write_text(text, encoding="utf-8")
    result = CliRunner().invoke(app, ["validate", str(path)], prog_name="forestgen")
    return result.exit_code, result.stdout, result.stderr


def test_the_recipe_itself_is_valid(tmp_path: Path) -> None:
    code, out, _ = validated(tmp_path, RECIPE)
    assert code == 0
    assert "ecoclimate, 3 steps" in out


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_told_at_its_place(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("forestgen.scene.plan.free_bytes", lambda: 64_000_000_000)
    old, new, parts = MISTAKES[name]
    assert RECIPE.count(old) == 1
    text = RECIPE.replace(old, new)
    text = text.replace(CLIMATE, CLIMATE + EXTRA.get(name, ""))
    code, out, err = validated(tmp_path, text)
    assert code in (2, 3, 4), err
    assert err.startswith("error: ")
    assert (errors := err.count("error: ")) == 1 or err.rstrip().endswith(f"\n{errors} errors")
    assert "Traceback" not in err + out
    assert "a bug in forestgen" not in err
    assert not out
    for part in parts:
        assert part in err, f"{part!r} is not in: {err}"


PAGE = (Path(__file__).parents[4] / "docs" / "ecoclimates.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("number", range(PAGE.count("```yaml")))
def test_the_snippets_of_the_page_are_valid(number: int, tmp_path: Path) -> None:
    """As they stand, or as the community of the page's first recipe."""
    snippets = [part.split("```")[0] for part in PAGE.split("```yaml\n")[1:]]
    whole, text = snippets[0], snippets[number]
    before, rest = whole.split("community:\n")
    code, out, err = validated(tmp_path, text if number == 0 else before + text + rest[rest.index("cameras:") :])
    assert code == 0, err
    assert "ecoclimate" in out


@pytest.mark.parametrize("cell_m", ["0.25", "100"])
@pytest.mark.parametrize("size", ["[20, 15]", "[1, 1]", "[300, 2]"])
def test_cells_much_smaller_or_larger_than_the_site_will_do(cell_m: str, size: str, tmp_path: Path) -> None:
    text = RECIPE.replace(CLIMATE, CLIMATE + f"\n  soil_water: {{cell_m: {cell_m}}}").replace("[20, 15]", size)
    text = "".join(line for line in text.splitlines(keepends=True) if "house" not in line)
    code, _, err = validated(tmp_path, text)
    assert code == 0, err
