"""A frame's row of the index against counts made pixel by pixel."""

from __future__ import annotations

import math

import numpy as np
import pytest
from dataset_shots import CLASSES, make_camera

from forestgen.core.parts import Part
from forestgen.dataset.index import COLUMNS
from forestgen.dataset.writer import frame_row
from forestgen.instruments.stand_table import StandRow
from forestgen.recipe.load import load_recipe_data
from forestgen.scene.spec import Sky

RECIPE = {
    "forestgen": 1,
    "species": {"poplar": None, "spruce": None, "oak": {"from": "poplar"}},
    "community": {"model": "multiset_lsystem", "program": "succession", "steps": 1},
    "sky": {"turbidity": {"uniform": [2, 6]}, "clouds": {"type": "noise", "cover": 0.25}},
    "plants": {"season": "autumn"},
}
STAND = StandRow("all", "all", 0.0, 0.0, *[math.nan] * 4, 0.0, 0.0, 0.0, 0.0)
SKY = Sky(sun_elevation_deg=30.0, sun_azimuth_deg=-90.0, turbidity=4.0)


@pytest.fixture(scope="module")
def drawn():
    return load_recipe_data(RECIPE, "three").draw(3)


@pytest.fixture
def row(shot, drawn):
    return frame_row("000003-camera0", shot.labelled, drawn, SKY, 2.0, STAND.figures(), ["a note"])


def test_counts_are_those_of_the_masks(row, shot):
    pixels, population = shot.labelled.pixels, shot.population
    winners = [int(one) for one in pixels.instance.ravel()]
    won = {int(plant): winners.count(int(plant)) for plant in population.plant_id if int(plant) in winners}
    assert row["plants"] == len(population)
    assert row["plants_in_view"] == len(won) > 5
    name_of = {
        int(plant): population.species_names[kind]
        for plant, kind in zip(population.plant_id, population.species, strict=True)
    }
    names = [name_of[plant] for plant in won]
    assert row["species_instances"] == {name: names.count(name) for name in set(names)} == row["category_instances"]
    assert row["species_pixels"] == {
        name: sum(count for plant, count in won.items() if name_of[plant] == name) for name in set(names)
    }
    classes = [CLASSES.names[one] for one in pixels.semantic.ravel()]
    assert row["class_pixels"] == {name: classes.count(name) for name in set(classes)}
    assert sum(row["part_pixels"].values()) == pixels.part.size
    assert row["part_pixels"]["leaf"] == int((pixels.part == Part.LEAF).sum())
    assert row["instance_pixels_median"] == np.median(list(won.values()))
    for power, count in enumerate(row["instance_pixels_histogram"]):
        assert count == sum(2**power <= size < 2 ** (power + 1) for size in won.values())
    assert sum(row["instance_pixels_histogram"]) == len(won)


def test_shares_and_depths_are_those_of_the_rays(row, shot):
    surface = shot.frame.surface
    sky = surface.part == Part.NOTHING
    depths = sorted(float(one) for one in surface.depth_m[np.isfinite(surface.depth_m)])
    assert row["sky_share"] == sky.mean()
    assert row["sunlit_share"] == pytest.approx(surface.sun_visible.sum() / (~sky).sum())
    assert row["cloud_share"] == pytest.approx(shot.frame.cloud_opacity[sky].mean(), rel=1e-6)
    assert (row["depth_min_m"], row["depth_max_m"]) == (depths[0], depths[-1])
    assert row["depth_median_m"] == pytest.approx(np.median(depths))


def test_camera_sky_and_draws(row, drawn):
    camera = make_camera()
    x, y, z = camera.world_from_camera[:, 2]
    assert row["camera_pitch_deg"] == pytest.approx(math.degrees(math.atan2(z, math.hypot(x, y))))
    assert row["camera_azimuth_deg"] == pytest.approx(math.degrees(math.atan2(x, y)))
    assert row["camera_height_m"] == 10.0
    assert (row["sun_elevation_deg"], row["sun_azimuth_deg"]) == (30.0, 270.0)
    assert (row["clouds"], row["cloud_cover"], row["season"]) == ("noise", 0.25, "autumn")
    assert row["draw.sky.turbidity"] == drawn.recipe.sky.turbidity
    assert (row["image"], row["split"], row["folder"]) == (3, drawn.split, f"{drawn.split}/000003-camera0")
    assert row["notes"] == ["a note"]
    assert row["image_seed"] == drawn.image_seed


def test_the_row_has_all_columns_and_plain_values(row):
    import json

    assert set(row) == {*COLUMNS, "draw.sky.turbidity"}
    assert json.loads(json.dumps(row, allow_nan=False)) == row


def test_an_empty_stand(drawn):
    """No plant, no ground, no known noise: nulls and empty maps, never NaN."""
    from format_shots import drawn as frame_of

    labelled = frame_of(np.zeros((8, 8)), part=np.zeros((8, 8)))
    row = frame_row("000003-eye", labelled, drawn, SKY, 0.0, STAND.figures())
    assert (row["plants"], row["plants_in_view"], row["sky_share"]) == (0, 0, 1.0)
    assert row["instance_pixels_histogram"] == []
    assert row["class_pixels"] == {"nothing": 64}
    for name in ("depth_min_m", "depth_median_m", "sunlit_share", "instance_pixels_median", "relative_error"):
        assert row[name] is None
