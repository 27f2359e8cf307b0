from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from forestgen.core.errors import RecipeError
from forestgen.recipe.curves import evaluate_formula
from forestgen.recipe.load import load_recipe
from support.error_messages import raises_error

Write = Callable[..., Path]
TEXT = """\
forestgen: 1
species: {oak: ./oak.yaml}
community: {model: lattice, steps: {formula: "round(50 + 300 * wetness)"}, share: {formula: "1 - wetness"}}
plants: {season: {variable: season}}
sky: {turbidity: {formula: "2 + 4 * haze"}, sun: {elevation_deg: {variable: angle}}, clouds: {cover: {variable: haze}}}
sampling:
  variables:
    haze: {formula: "max(wetness^2, low)"}
    wetness: {uniform: [0, 1]}
    low: 0.1
    angle: {integers: [20, 40]}
    season: {choice: [summer, autumn]}
"""


def test_what_shares_a_variable_goes_together(write: Write) -> None:
    loaded = load_recipe(write(TEXT))
    seen = set()
    for index in range(20):
        drawn = loaded.draw(index)
        values = {str(keys[-1]): value for keys, value in drawn.draws.items() if keys[0] == "sampling"}
        wetness, haze = values["wetness"], values["haze"]
        assert haze == pytest.approx(max(wetness**2, 0.1))  # type: ignore[operator]
        assert drawn.recipe.sky.turbidity == pytest.approx(2 + 4 * haze)  # type: ignore[operator]
        assert drawn.recipe.sky.clouds.cover == haze
        assert drawn.recipe.sky.sun.elevation_deg == values["angle"]
        assert drawn.recipe.plants.season == values["season"]
        steps = drawn.recipe.community.parameters["steps"]
        assert isinstance(steps, int)
        assert steps == round(50 + 300 * wetness)  # type: ignore[operator]
        assert drawn.recipe.community.parameters["share"] == pytest.approx(1 - wetness)  # type: ignore[operator]
        assert drawn.draws[("community", "steps")] == steps
        seen.add(wetness)
    assert len(seen) == 20


def test_probes_follow_the_variables(write: Write) -> None:
    probes = [drawn.data for drawn in load_recipe(write(TEXT)).probes()]
    assert {probe["community"]["steps"] for probe in probes} >= {50, 350}
    assert {probe["sky"]["turbidity"] for probe in probes} >= {2.4, 6.0}
    with raises_error(RecipeError, place="sky.turbidity"):
        load_recipe(write(TEXT.replace("2 + 4 * haze", "2 + 40 * haze")))


def test_a_variable_can_be_set(write: Write) -> None:
    drawn = load_recipe(write(TEXT), ["sampling.variables.wetness=0.5"]).draw(0)
    assert drawn.recipe.community.parameters["steps"] == 200
    assert drawn.recipe.sky.turbidity == 3.0


def test_curves_keep_their_formulas(write: Write) -> None:
    text = TEXT.replace("./oak.yaml", '{from: ./oak.yaml, plant: {leaves: {formula: "0.3 - 0.22 * x^2"}}}')
    drawn = load_recipe(write(text)).draw(0)
    assert drawn.data["species"]["oak"]["plant"]["leaves"] == {"formula": "0.3 - 0.22 * x^2"}
    drawn = load_recipe(write(text.replace("0.22 * x^2", "0.22 * wetness"))).draw(0)
    wetness = drawn.draws[("sampling", "variables", "wetness")]
    assert drawn.data["species"]["oak"]["plant"]["leaves"] == pytest.approx(0.3 - 0.22 * wetness)  # type: ignore[operator]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("{variable: angle}", "{variable: angel}"),
        ("2 + 4 * haze", "2 + 4 * hazy"),
        ("2 + 4 * haze", "2 + 4 * haze)"),
        ("2 + 4 * haze", "2 + x * haze"),
        ("2 + 4 * haze", "open(haze)"),
        ("2 + 4 * haze", "haze.real"),
        ("2 + 4 * haze", "2 + season"),
        ("{choice: [summer, autumn]}", "{choice: [summer, monsoon]}")
    ],
)  # fmt: skip
def test_mistakes(write: Write, old: str, new: str) -> None:
    with raises_error(RecipeError):
        load_recipe(write(TEXT.replace(old, new)))


def test_a_number_that_must_be_whole(write: Write) -> None:
    with raises_error(RecipeError, place="plants.exemplars_per_species"):
        load_recipe(
            write(TEXT.replace("{variable: season}", "summer, exemplars_per_species: {formula: 3.3 + wetness}"))
        )


def test_without_the_section_there_are_no_variables(write: Write) -> None:
    text = TEXT.partition("sampling:")[0]
    with raises_error(RecipeError, place="plants.season"):
        load_recipe(write(text))


def test_round_is_a_function_of_all_formulas() -> None:
    assert evaluate_formula("round(3 * x)", np.array([0.0, 0.3, 0.6])).tolist() == [0.0, 1.0, 2.0]
