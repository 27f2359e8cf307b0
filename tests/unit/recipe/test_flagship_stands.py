"""The recipes that people meet first show closed forests: stems, basal area, leaf area, heights, slenderness.

Bounds: stems and basal area of closed stands of the type, Pretzsch (2009), Forest Dynamics, Growth and Yield, and for
boreal mixed woods Man & Greenway (2011), The Forestry Chronicle 87, 385-398; leaf area index, Asner, Scurlock & Hicke
(2003), Global Ecology and Biogeography 12, 191-205 (mean and standard deviation by biome: boreal 2.6 ± 1.0 and
2.7 ± 1.3, temperate broadleaf 5.1 ± 1.6, temperate needle leaf 5.5 ± 3.4, plantations 8.7 ± 4.3); height over diameter,
Wang, Titus & LeMay (1998), Canadian Journal of Forest Research 28, 1171-1183 (boreal species).
"""

from __future__ import annotations

import numpy as np
import pytest

import forestgen as fg
from forestgen.core.progress import Silent, Timings
from forestgen.pipeline import assemble_image
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import check_plan
from forestgen.scene.plant_measures import PlantMeter

#: Recipe -> stems/ha, basal area m2/ha, leaf area index, dominant height m, median of height over diameter.
BOUNDS = {
    "quickstart": ((800, 3000), (15, 40), (1.5, 6), (11, 22), (70, 115)),
    "old_forest": ((500, 1500), (25, 60), (3, 9), (18, 30), (60, 105)),
    "training_set": ((500, 3000), (15, 60), (1.5, 9), (11, 32), (60, 115)),
    "mixed_stand": ((300, 1800), (18, 50), (3, 9), (15, 32), (55, 105)),
    "vista": ((250, 1500), (18, 50), (3, 9), (15, 32), (55, 105)),
    "drone": ((300, 1800), (20, 45), (2.5, 8), (18, 28), (55, 105)),
    "robot": ((250, 1500), (20, 40), (2.5, 8), (18, 30), (50, 105)),
}
LEAST_M = 0.07


@pytest.mark.slow
@pytest.mark.parametrize("name", BOUNDS)
def test_a_flagship_recipe_shows_a_closed_forest(name: str) -> None:
    stand = fg.load(f"recipes/{name}.yaml").simulate()
    width_m, depth_m = stand.summary.plan.site.size_m
    ha = width_m * depth_m / 1e4
    dbh_m, height_m = np.nan_to_num(stand["dbh_m"]), stand["height_m"]
    big = (dbh_m >= LEAST_M) & (stand["status"] != "dead")
    thickest = np.argsort(-dbh_m * big)[: round(100 * ha)]
    figures = (
        big.sum() / ha,
        np.sum(0.25 * np.pi * dbh_m[big] ** 2) / ha,
        np.nansum(stand["leaf_area_m2"]) / (ha * 1e4),
        height_m[thickest].mean(),
        np.median(height_m[big] / dbh_m[big]),
    )
    for value, (low, high) in zip(figures, BOUNDS[name], strict=True):
        assert low <= value <= high, (name, figures)
    crowns_m2 = np.nansum(np.pi * stand["crown_radius_m"] ** 2)
    assert crowns_m2 > 0.7 * ha * 1e4  # as discs that overlap, over the ground


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in BOUNDS if name != "vista"])  # vista has the brambles of mixed_stand
def test_a_flagship_recipe_has_an_understorey(name: str) -> None:
    """Leaf area index of herbs and brambles, as the scene has them: wanted are 0.3 to 1, a closed stand may have less.

    Herbs give way as the canopy closes: Majasalmi & Rautiainen (2020), Forest Ecology and Management 465, 118100.
    """
    side_m = 50 if name in ("mixed_stand", "drone") else 30  # a gap has its share of it
    small = [f"site.size_m=[{side_m},{side_m}]", "plants.exemplars_per_species=4"]
    scene = assemble_image(check_plan(load_recipe(f"recipes/{name}.yaml", small)), Silent(), Timings())
    herbs = [k for k, one in enumerate(scene.population.species_names) if one in ("bracken", "bramble", "fireweed")]
    leaf_m2 = PlantMeter(scene.spec.exemplars).measure(scene.spec.instances.on_site).leaf_area_m2
    assert 0.2 < leaf_m2[np.isin(scene.population.species, herbs)].sum() / side_m**2 < 1.0
