"""Plants of branch modules outside of communities of such: as high as asked for, other seeds other plants."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.api.plant_requests import plan_of
from forestgen.api.plants import plant
from forestgen.plants.generators.branch_modules import GENERATOR
from forestgen.plants.growing import ExemplarRequest
from forestgen.recipe.assets import list_assets


@pytest.mark.parametrize(("name", "height_m"), [("redgrass", 0.9), ("rosemary", 1.0), ("larch", 4.0)])
def test_it_is_as_high_as_asked_for_and_its_seed_decides_the_rest(name: str, height_m: float) -> None:
    species = plan_of(name, 0).drawn.species[name]
    first, again, other = (GENERATOR.wood_alone(name, species, (height_m, 1.5), seed) for seed in (1, 1, 2))
    assert first.height_m == pytest.approx(height_m)
    assert first.position_m.tobytes() == again.position_m.tobytes()
    assert not np.array_equal(first.position_m, other.position_m)
    assert np.all(first.parent[1:] < np.arange(1, len(first)))


def test_a_single_plant_bears_foliage_at_its_height() -> None:
    tuft = plant("redgrass", 0.7)
    assert tuft.height_m == pytest.approx(0.7, rel=1e-3)
    assert tuft.measures.leaf_area_m2 > 0
    assert tuft.measures.triangles["leaf"] > 100


def test_what_is_kept_depends_on_the_modules() -> None:
    plan = plan_of("rosemary", 0)
    species = plan.drawn.species["rosemary"]
    assert species.modules is not None
    slower = species.model_copy(update={"modules": species.modules.model_copy(update={"growth_rate_per_yr": 0.01})})
    keys = {
        ExemplarRequest("rosemary", one, plan.generators["rosemary"], 0.3, 0, ("exemplar",)).key()
        for one in (species, slower)
    }
    assert len(keys) == 2


@pytest.mark.slow
@pytest.mark.parametrize("name", list_assets("species"))
def test_every_shipped_species_grows_as_a_single_plant(name: str) -> None:
    one = plant(name)
    plan = plan_of(name, 0)
    mature_m = plan.drawn.species[name].mature_height_m
    assert one.height_m == pytest.approx(mature_m, rel=0.05)
