"""Every species that lives grows with every community model; dead wood does not grow branch by branch."""

from __future__ import annotations

from itertools import product

import pytest

from forestgen.community.registry import COMMUNITY_MODELS
from forestgen.community.simulation import final_population
from forestgen.core.errors import RecipeError
from forestgen.core.progress import Silent
from forestgen.plants.parameters import Lifeless
from forestgen.plants.registry import GENERATORS
from forestgen.recipe.assets import list_assets
from forestgen.recipe.load import load_recipe_data
from forestgen.scene import growth
from forestgen.scene.plan import make_plan
from forestgen.scene.views import drawn_cameras
from support.error_messages import raises_error
from tests.unit.community.test_model_contract import FOUNDED, NEEDED, PLACEMENTS

SPECIES, MODELS = list_assets("species"), COMMUNITY_MODELS.ids()
REPRESENTATIVES = {("fireweed", "branch_modules"), ("daisy", "uniform"), ("snag", "branch_modules")}
PAIRS = [
    pytest.param(*pair, marks=() if pair in REPRESENTATIVES else pytest.mark.slow) for pair in product(SPECIES, MODELS)
]


def keys_of(name: str, model: str) -> dict[str, object]:
    """A small community of one species."""
    keys = {**NEEDED.get(model, {}), "model": model, "steps": 3}
    if model in PLACEMENTS:
        keys["plants"] = {name: {"count": 4}}
    if model == "placed":
        keys["plants"] = [{"species": name, "position_m": [4, 5], "radius_m": 0.05}]
    if model == "inventory":
        keys["table"] = f"species,x_m,y_m,height_m\n{name},4,5,0.3"
    if model == "stand":
        keys |= {"storeys": [], "ground": {name: {"plants_per_ha": 500}}}
    if model in FOUNDED:
        keys |= {"initial_plants": 4, "history_modules": False}
    return keys


@pytest.mark.parametrize(("name", "model"), PAIRS)
def test_a_species_grows_with_a_model(name: str, model: str) -> None:
    data = {"forestgen": 1, "site": {"size_m": [9, 9]}, "species": {name: None}, "community": keys_of(name, model)}
    drawn = load_recipe_data(data, "test").draw(0)
    lifeless = isinstance(GENERATORS.load(drawn.species[name].plant.generator), Lifeless)
    if lifeless and model in FOUNDED:
        with raises_error(RecipeError):
            make_plan(drawn)
        return
    plan = make_plan(drawn)
    plants = final_population(plan.community, Silent())
    cameras = [camera for entry in drawn_cameras(drawn) for camera in entry]
    chosen = growth.choose_exemplars(plan, plants, cameras)
    requests = growth.exemplar_requests(plan, chosen, plants)
    assert len(requests) == len(chosen)
    if model in (*PLACEMENTS, *FOUNDED):
        assert len(plants) or model == "ecoclimate"  # in whose weather not every species lives for three steps
        assert all(request.species_name == name for request in requests)
