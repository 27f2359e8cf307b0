"""The stands of the biomes' recipes lie within published bounds."""

from __future__ import annotations

from dataclasses import asdict

import pytest

from support.biome_bounds import BIOMES, FOLDER, measured


def test_every_biomes_recipe_has_bounds():
    assert set(BIOMES) == {path.stem for path in FOLDER.glob("*.yaml")}


@pytest.mark.slow
@pytest.mark.parametrize("name", BIOMES)
def test_a_biomes_stand_lies_within_its_published_bounds(name: str):
    figures = asdict(measured(name))
    for key, value in figures.items():
        low, high = getattr(BIOMES[name], key)
        assert low <= value <= high, (key, figures)
