"""Light under overlapping crowns, against every pair; and the succession that it drives."""

from __future__ import annotations

import math

import numpy as np
import pytest

import forestgen as fg
from forestgen.community.competition import crown_light
from forestgen.community.competition.contract import Circles
from forestgen.community.competition.leps_kindlmann import lens_area


def circles(seed: int, n: int, side_m: float) -> Circles:
    rng = np.random.default_rng(seed)
    return Circles(
        position_m=rng.random((n, 2)) * side_m,
        radius_m=rng.uniform(0.3, 3.0, n),
        height_m=rng.uniform(1.0, 25.0, n),
        plant_id=np.arange(1, n + 1, dtype=np.uint32),
        species=np.zeros(n, dtype=np.uint16),
    )


def answer(plants: Circles, side_m: float, *, periodic: bool, **keys: float) -> np.ndarray:
    return crown_light.MODEL.answer(crown_light.LightParameters(**keys), plants, (side_m, side_m), periodic=periodic)


def every_pair(plants: Circles, side_m: float, *, periodic: bool, k: float, leaves: float, base: float) -> np.ndarray:
    found = []
    images = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)] if periodic else [(0, 0)]
    for i in range(len(plants)):
        middle, total = 0.5 * (1.0 + base) * plants.height_m[i], 0.0
        for j in range(len(plants)):
            above = min(max((plants.height_m[j] - middle) / ((1.0 - base) * plants.height_m[j]), 0.0), 1.0)
            for a, b in images:
                if j == i:
                    continue
                way = plants.position_m[j] + np.array([a, b]) * side_m - plants.position_m[i]
                total += above * lens_area(math.hypot(*way), plants.radius_m[i], plants.radius_m[j])
        found.append(math.exp(-k * leaves * total / (math.pi * plants.radius_m[i] ** 2)))
    return np.array(found)


@pytest.mark.parametrize("periodic", [True, False])
def test_light_is_that_of_every_pair(periodic: bool) -> None:
    plants = circles(3, 60, 14.0)
    keys = {"extinction": 0.6, "leaf_area_index": 2.5, "crown_base": 0.3}
    ours = answer(plants, 14.0, periodic=periodic, **keys)
    np.testing.assert_allclose(
        ours, every_pair(plants, 14.0, periodic=periodic, k=0.6, leaves=2.5, base=0.3), rtol=1e-9
    )


def test_tall_plants_shade_small_ones() -> None:
    pair = Circles(
        np.array([[5.0, 5.0], [5.5, 5.0]]),
        np.array([3.0, 1.0]),
        np.array([20.0, 4.0]),
        np.array([1, 2], dtype=np.uint32),
        np.zeros(2, dtype=np.uint16),
    )
    tall, small = answer(pair, 50.0, periodic=False)
    assert tall == 1.0
    assert small == pytest.approx(math.exp(-0.5 * 3.0 * (20.0 - 2.8) / 12.0 if 17.2 / 12.0 < 1 else -1.5))


def test_succession_under_light_is_a_closed_forest_of_two_storeys() -> None:
    """After 80 years: crowns overlap, spruces stand below poplars, basal area as in boreal mixed woods.

    Basal areas of 20 to 45 m2/ha at 60 to 100 years: Légaré, Bergeron & Paré (2005), Annals of Forest Science 62,
    247-251 (aspen and black spruce); Man & Greenway (2011), The Forestry Chronicle 87, 385-398 (with white spruce).
    """
    ecology = {"poplar": 150, "spruce": 60}
    recipe = {
        "forestgen": 1,
        "seed": 1,
        "site": {"size_m": [40, 40]},
        "species": {
            name: {"from": name, "ecology": {"seedlings_per_ha_per_yr": rate}} for name, rate in ecology.items()
        },
        "community": {"model": "multiset_lsystem", "program": "crown_light", "steps": 160},
    }
    stand = fg.load(recipe).simulate()
    dbh_m, height_m = stand["dbh_m"], stand["height_m"]
    big = dbh_m >= 0.07
    assert 20.0 < np.sum(0.25 * np.pi * dbh_m[big] ** 2) / 0.16 < 45.0
    crowns = np.pi * stand["crown_radius_m"] ** 2
    assert crowns.sum() > 0.9 * 1600.0  # as much as the ground: under domination a third at most
    spruce = (stand["species"] == "spruce") & big
    tallest = height_m[stand["species"] == "poplar"].max()
    assert np.mean(height_m[spruce] < 0.85 * tallest) > 0.2
