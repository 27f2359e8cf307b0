"""An image with standing dead trees: its labels pass `forestgen verify`, and say what is dead and what lives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from command_line import run

from forestgen.community.population import Status
from forestgen.core.parts import Part
from forestgen.dataset.check.files import read_exr

FRAME = "000000-camera0"
RECIPE = """\
forestgen: 1
seed: 3
site: {size_m: [12, 12], terrain: flat, ground: soil_wet}
species:
  birch: {from: birch, modules: {life_span_yr: 4, seeds_per_yr: 0}}
  pine: {from: pine, modules: {growth_rate_per_yr: 0.5, temperature_c: 8, shade_tolerance: 0.9}}
community:
  model: branch_modules
  steps: 9
  temperature_c: 5
  precipitation_mm_per_yr: 700
  initial_plants: {birch: 14, pine: 8}
  senescence_yr: 4
  standing_dead_yr: 40
plants: {unique: 6, exemplars_per_species: 1, levels: true}
cameras: [{position_m: [6, -4, 1.6], look_at_m: [6, 6, 2], size_px: [120, 90]}]
render: {samples: 1, denoise: false}
labels: {samples: 9, channels: [surface, coverage, module]}
dataset: {formats: [coco]}
"""


@pytest.fixture(scope="module")
def data_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dead")
    (folder / "dying.yaml").write_text(RECIPE, encoding="utf-8")
    answer = run("render", folder / "dying.yaml", "-o", folder / "good")
    assert answer.code == 0, answer.err
    return folder / "good" / "train"


def test_the_dead_are_dead_wood_and_nobody_else_is(data_set: Path) -> None:
    plants = pq.read_table(data_set / FRAME / "plants.parquet")
    plant_id, status = plants["plant_id"].to_numpy(), plants["status"].to_numpy()
    dead = plant_id[status == Status.DEAD]
    seen = plant_id[plants["visible_pixels"].to_numpy() > 0]
    assert np.isin(dead, seen).sum() >= 3
    assert np.isin(seen, plant_id[status != Status.DEAD]).sum() >= 2
    parts, _ = read_exr(data_set, f"{FRAME}/frame.exr")
    shown, part = parts["identity"]["centre.plant_id"], parts["identity"]["centre.part"]
    on_plant = shown != 0
    assert np.array_equal(np.isin(shown, dead) & on_plant, (part == Part.DEAD_WOOD) & on_plant)
    assert np.any(part == Part.LEAF)


def test_the_table_says_who_is_dead_bare_and_under_stress(data_set: Path) -> None:
    plants = pq.read_table(data_set / FRAME / "plants.parquet").to_pydict()
    dead = np.array(plants["status"]) == Status.DEAD
    species = np.array(plants["species"])
    assert dead.any()
    assert set(species[dead]) == {"birch"}
    assert not np.array(plants["leaf_area_m2"])[dead].any()
    assert np.all(np.array(plants["leaf_area_m2"])[~dead] > 0)
    felt = np.array(plants["adaptation"], dtype=np.float64)
    assert np.all((felt > 0) & (felt <= 1))
    assert len(np.unique(felt[species == "pine"])) == 1


def test_it_passes_the_check(data_set: Path) -> None:
    answer = run("verify", data_set.parent)
    assert answer.code == 0, answer.out + answer.err
