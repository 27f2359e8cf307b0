"""Every recipe of docs/clouds.md is accepted; its numbers are those of the code."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from forestgen.atmosphere.extinction import rain_extinction
from forestgen.recipe.load import load_recipe
from forestgen.recipe.registries import CLOUD_SOURCES
from forestgen.scene.site import sky_of

DOCS = Path(__file__).parents[3] / "docs"
PAGE = (DOCS / "clouds.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
LINKS = re.findall(r"!?\[[^\]]+\]\(([^)#]+)(?:#[^)]*)?\)", PAGE)
ROWS = {row[0]: row for row in re.findall(r"^\| `(\w+)` \| (.*?) \| (.*?) \| (.*?) \| (.*?) \|$", PAGE, re.MULTILINE)}
BASE = {
    "forestgen": 1,
    "seed": 1,
    "site": {"size_m": [30, 30]},
    "species": {"spruce": None},
    "community": {"model": "uniform", "plants": {"spruce": {"count": 3}}},
    "cameras": [{"position_m": [15, -8, 2]}],
}


@pytest.mark.parametrize("example", EXAMPLES)
def test_an_example_is_accepted(example: str, tmp_path: Path) -> None:
    (tmp_path / "sky.nc").write_bytes(b"a field")
    path = tmp_path / "recipe.yaml"
    with path.open("w", encoding="utf-8") as stream:
        YAML(typ="safe").dump({**BASE, **YAML(typ="safe").load(example)}, stream)
    drawn = load_recipe(path).draw(0)
    assert sky_of(drawn.recipe, 0.2).visibility_m == drawn.recipe.sky.visibility_m


def test_the_page_has_examples() -> None:
    assert len(EXAMPLES) >= 8


@pytest.mark.parametrize("path", LINKS)
def test_what_the_page_shows_and_links_is_there(path: str) -> None:
    assert (DOCS / path).is_file()


@pytest.mark.parametrize("kind", ["fog", "stratus", "stratocumulus", "cumulus", "cumulonimbus"])
def test_the_table_has_the_types_own_numbers(kind: str) -> None:
    own = CLOUD_SOURCES.load(kind)
    domain, minutes = own.conditions.domain, own.time_s / 60
    _, _, box, droplets, when = ROWS[kind]
    metres = [float(number) * (1000 if unit == "km" else 1) for number, unit in re.findall(r"([\d.]+) (km|m)\b", box)]
    assert metres == [domain.extent_m, domain.height_m]
    assert float(droplets.split()[0]) == own.droplet_radius_um
    assert float(when.split()[0]) == minutes


def test_heavy_rain_is_as_thick_as_the_page_says() -> None:
    extinction = float(rain_extinction(np.array([1e-3]))[0])
    assert f"{extinction:.4f} per metre" in PAGE
    assert np.exp(-1000 * extinction) == pytest.approx(0.1, abs=0.02)
