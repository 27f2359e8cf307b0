from __future__ import annotations

import pytest
from recipe_example import SPECIES

from forestgen.core.errors import RecipeError
from forestgen.recipe.load import load_recipe
from support.error_messages import raises_error

WITH_BARK = SPECIES + "  bark:\n    reflectance: [0.2, 0.2, 0.15]\n    bark: {pattern: plated}\n"


def test_bark_has_defaults(write):
    path = write(species=WITH_BARK)
    bark = load_recipe(path).draw(0).species["oak"].materials["bark"].bark
    assert bark.pattern == "plated"
    assert bark.tile_m == (0.5, 0.75)
    assert bark.scale_m is None
    assert load_recipe(path).draw(0).species["oak"].materials["leaf"].bark is None


def test_bark_may_be_drawn(write):
    species = WITH_BARK.replace("{pattern: plated}", "{pattern: plated, lichen: {uniform: [0.1, 0.4]}}")
    loaded = load_recipe(write(species=species))
    shares = {loaded.draw(image).species["oak"].materials["bark"].bark.lichen for image in range(3)}
    assert len(shares) == 3
    assert all(0.1 <= share <= 0.4 for share in shares)


@pytest.mark.parametrize(
    ("block", "key"),
    [
        ("{pattern: plaid}", "bark.pattern"),
        ("{pattern: smooth, tile_m: [0, 1]}", "bark.tile_m.0"),
        ("{pattern: smooth, tile_m: [0.5, 11]}", "bark.tile_m.1"),
        ("{pattern: smooth, depth_m: -0.01}", "bark.depth_m"),
        ("{pattern: smooth, marks: 0.6}", "bark.marks"),
        ("{pattern: smooth, lichen: 1}", "bark.lichen"),
        ("{pattern: smooth, dark: [0.1, 0.1, 1.5]}", "bark.dark.2"),
        ("{pattern: plated, scale_m: 0.3}", "bark.scale_m"),
        ("{pattern: plated, width_m: 0.3}", "bark.width_m"),
        ("{}", "bark.pattern"),
    ],
)
def test_mistakes_name_line_and_key(write, block, key):
    species = WITH_BARK.replace("{pattern: plated}", block)
    with raises_error(RecipeError, place=f"materials.bark.{key}") as caught:
        load_recipe(write(species=species))
    text = str(caught.value)
    assert f"oak.yaml:{len(species.splitlines())}" in text


def test_bark_is_opaque(write):
    species = WITH_BARK.replace("    bark: {", "    transmittance: [0, 0.1, 0]\n    bark: {")
    with raises_error(RecipeError, place="species.oak.materials.bark"):
        load_recipe(write(species=species))
