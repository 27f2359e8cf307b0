"""What every registered model keeps of `CommunityModel`."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from forestgen.architecture.modules import Modules
from forestgen.community.disturbance import Planting
from forestgen.community.history import open_history, write_history
from forestgen.community.model import CommunityParameters, simulate
from forestgen.community.population import Site
from forestgen.community.registry import COMMUNITY_MODELS
from forestgen.community.snapshot_checks import check_snapshot
from forestgen.recipe.species import PlantType
from forestgen.recipe.tree_sizes import TreeSizes
from support.tiers import few

MODELS = COMMUNITY_MODELS.ids()
PLACEMENTS = (
    "deformation_kernel",
    "halftone",
    "height_field",
    "jittered_grid",
    "poisson_disc",
    "strauss",
    "thomas",
    "uniform",
)
LISTED = ("inventory", "placed", "stand")
PLACING = (*PLACEMENTS, *LISTED)
FOUNDED = ("branch_modules", "ecoclimate")  # plants of the start seed others; none arrive from outside
GROWING = tuple(name for name in MODELS if name not in (*PLACING, *FOUNDED))  # plants arrive by themselves
CLIMATE = {"climate": {"temperature_c": [10.0] * 12, "precipitation_mm": [60.0] * 12}}
GIVEN = {"ecoclimate": CLIMATE}  # keys without which there are no parameters
NEEDED = {
    "branch_modules": {"initial_plants": 9, "history_modules": True},
    "ecoclimate": {"initial_plants": 9, "history_modules": True, "soil_water": {"cell_m": 5}, **CLIMATE},
    "inventory": {"table": "species,x_m,y_m,dbh_cm\n" + "".join(f"tree,{x},{2 * x},20\n" for x in range(9))},
    "stand": {"storeys": [{"species": {"tree": 1}, "stems_per_ha": 150, "dbh": {"mean_cm": 20}}]},
    "placed": {"plants": [{"species": "tree", "position_m": [x, 2 * x]} for x in range(9)]},
    **{name: {"plants": {"tree": {"count": 9}}} for name in PLACEMENTS},
}
EMPTY = {name: {"initial_plants": 0} for name in FOUNDED}
SITE = Site((30.0, 20.0))
STEPS = 24
DISTURBANCES = (
    {"at_step": 0, "plant": {"species": "b", "count": 7, "radius_m": 0.5}},
    {"at_yr": 3, "fell": {"circle": {"center_m": [1, 1], "radius_m": 8}, "share": 0.7}},
    {"at_step": 9, "burn": {"species": ["tree"], "survival": 0.5}},
    {"at_step": 9, "plant": {"species": "tree", "positions_m": [[3, 4], [5, 6]]}},
    {"at_step": STEPS, "fell": {"max_radius_m": 0.4}},
)
# Resumed steps change what numbers a model holds; anything may follow any of them.
TYPE = PlantType(
    life_span_yr=15.0,
    root_vigour_max=6.0,
    growth_rate_per_yr=0.5,
    apical_control=0.8,
    determinacy=0.6,
    flowering_age_yr=4.0,
    seeds_per_yr=0.2,
)
SIZES = TreeSizes(
    tallest_m=40.0,
    dbh_m={"at_10_m": 0.1, "height_exponent": 1.0, "spread": 0.2},
    crown_width_m={"at_10_m": 3.0, "height_exponent": 0.8},
    crown_ratio={"at_10_m": 1.0},
    leaf_kg={"at_10_m": 3.0, "height_exponent": 2.0},
)
seeds, steps = st.integers(0, 2**63 - 1), st.integers(0, STEPS)


def identical(a, b) -> bool:
    """Whether two populations hold the same bytes."""

    def plain(value):
        if isinstance(value, Modules):
            return [plain(getattr(value, field.name)) for field in dataclasses.fields(value)]
        if isinstance(value, dict):
            return {key: plain(one) for key, one in value.items()}
        return (value.dtype, value.shape, value.tobytes()) if isinstance(value, np.ndarray) else value

    return all(plain(getattr(a, f.name)) == plain(getattr(b, f.name)) for f in dataclasses.fields(a))


def parameters_of(name, **more):
    chosen = {"disturbances": DISTURBANCES, **NEEDED.get(name, {}), **more}
    if name == "ecoclimate":  # steps of whole months
        chosen["step_yr"] = round(chosen.get("step_yr", 0.5) * 12) / 12
    return COMMUNITY_MODELS.load(name).Parameters(steps=STEPS, **chosen)


def run(name, species, seed, **more):
    parameters = parameters_of(name, **more.pop("parameters", {}))
    return list(simulate(COMMUNITY_MODELS.load(name), parameters, SITE, species, seed, steps=STEPS, **more))


@pytest.mark.parametrize(
    ("name", "key", "knows"),
    [
        ("uniform", "kernels", "deformation_kernel, kernel_growth"),
        ("deformation_kernel", "program", "multiset_lsystem"),
    ],
)
def test_a_key_left_over_from_another_model_is_told_as_such(name, key, knows):
    with pytest.raises(ValidationError) as caught:
        COMMUNITY_MODELS.load(name).Parameters(**{key: "inhibition"})
    (one,) = caught.value.errors()
    assert one["ctx"]["at"] == (key,)
    assert one["ctx"]["got"] == "'inhibition'"
    assert one["ctx"]["hint"].startswith(f"{key} is a key of {knows}: ")
    with pytest.raises(ValidationError, match="Extra inputs"):
        COMMUNITY_MODELS.load(name).Parameters(kernles=1)


@pytest.fixture
def species(tree):
    return [
        tree(modules=TYPE, tree=SIZES),
        tree(name="b", growth_m_per_yr=0.2, shade_tolerance=0.8, old_age_survival=0.5, modules=TYPE),
    ]


def check_that_it_resumes(name, parameters, species, tmp_path, seed, step):
    whole = run(name, species, seed, parameters=parameters)
    write_history(tmp_path / "a.parquet", whole, modules=name in FOUNDED)
    history = open_history(tmp_path / "a.parquet")
    start = history.whole(step) if name in FOUNDED else history.snapshot(step)
    check_snapshot(start, SITE, species)
    model = COMMUNITY_MODELS.load(name)
    model.check_snapshot(parameters_of(name, **parameters), SITE, species, start)
    again = run(name, species, seed, parameters=parameters, start=start)
    assert [one.step for one in again] == list(range(step, STEPS + 1))
    assert all(identical(one, other) for one, other in zip(again, whole[step:], strict=True))
    assert len(whole[-1])


other_parameters = pytest.mark.parametrize("parameters", [{}, {"step_yr": 0.3, "periodic": False, "disturbances": ()}])
one_folder = HealthCheck.function_scoped_fixture


@pytest.mark.parametrize("name", [*GROWING, *LISTED])
@other_parameters
@settings(max_examples=8, deadline=None, suppress_health_check=[one_folder])
@given(seed=seeds, step=steps)
def test_a_stored_snapshot_resumes_to_the_same_future(name, parameters, species, tmp_path, seed, step):
    check_that_it_resumes(name, parameters, species, tmp_path, seed, step)


@pytest.mark.parametrize("name", [*PLACEMENTS, *FOUNDED])
@other_parameters
@settings(max_examples=2, deadline=None, suppress_health_check=[one_folder])
@given(seed=seeds, step=steps)
def test_a_stored_placement_resumes_to_the_same_future(name, parameters, species, tmp_path, seed, step):
    """Few examples: after step 0 all placement models are the same code, and branch modules take long."""
    check_that_it_resumes(name, parameters, species, tmp_path, seed, step)


@pytest.mark.parametrize("name", MODELS)
def test_every_snapshot_is_of_its_step_and_in_the_file(name, species, tmp_path):
    whole = run(name, species, 1)
    assert [one.step for one in whole] == list(range(STEPS + 1))
    write_history(tmp_path / "a.parquet", whole, {"seed": 1}, modules=name in FOUNDED)
    history = open_history(tmp_path / "a.parquet")
    assert history.steps == list(range(STEPS + 1))
    assert history.origin == {"seed": 1}
    stored = history if name not in FOUNDED else map(history.whole, history.steps)
    assert all(identical(one, other) for one, other in zip(stored, whole, strict=True))


@pytest.mark.parametrize("name", MODELS)
def test_each_disturbance_happens_once_at_its_time(name, species, tree):
    """Plants of a species without seedlings, by what is planted and felled."""
    disturbances = [
        {"at_step": 0, "plant": {"species": "c", "positions_m": [[1, 1]]}},
        {"at_step": 5, "plant": {"species": "c", "count": 3}},
        {"at_yr": 3.9, "plant": {"species": "c", "count": 4}},
        {"at_step": 12, "fell": {"species": ["c"]}},
    ]
    barren = TYPE.model_copy(update={"seeds_per_yr": 0.0, "life_span_yr": 1000.0, "shade_tolerance": 1.0})
    immortal = tree(name="c", seedlings_per_ha_per_yr=0.0, shade_tolerance=1.0, old_age_survival=1.0, modules=barren)
    others = [dataclasses.replace(one, seedlings_per_ha_per_yr=0.0) for one in species]
    chosen = {
        "steps": STEPS,
        "step_yr": 0.5,
        "disturbances": disturbances,
        **EMPTY.get(name, {}),
        **GIVEN.get(name, {}),
    }
    model = COMMUNITY_MODELS.load(name)
    populations = list(simulate(model, model.Parameters(**chosen), SITE, [*others, immortal], 3, steps=STEPS))
    assert [len(one) for one in populations] == [1] * 5 + [4] * 3 + [8] * 4 + [0] * 13
    assert set(populations[4].plant_id) < set(populations[7].plant_id) < set(populations[11].plant_id)
    assert populations[8].age_yr.tolist() == [4.0, 1.5, 1.5, 1.5, 0, 0, 0, 0]


@pytest.mark.parametrize("name", MODELS)
def test_removing_and_planting(name, species):
    model = COMMUNITY_MODELS.load(name)
    parameters = model.Parameters(steps=20, **NEEDED.get(name, {}))
    state = model.init(parameters, SITE, species, 5)
    for _ in range(20):
        state = model.step(state)
    before = model.population(state)
    gone = before.plant_id[::2]
    after = model.population(model.remove(state, np.append(gone, np.uint32(4_000_000_000))))
    assert after.plant_id.tolist() == before.plant_id[1::2].tolist()
    assert identical(before, model.population(state))
    planting = Planting(np.array([1, 0], np.uint16), np.array([[2.0, 3.0], [25.0, 15.0]]), np.array([0.7, 1.1]))
    planted = model.population(model.plant(state, planting))
    assert planted.plant_id[:-2].tolist() == before.plant_id.tolist()
    assert planted.plant_id[-2] > before.plant_id[-1]
    # Where crowns are of modules, a planting of any radius sets seeds.
    assert planted.radius_m[-2:].tolist() == ([0.7, 1.1] if name not in FOUNDED else [0.01, 0.01])
    assert planted.species[-2:].tolist() == [1, 0]
    assert planted.position_m[-2:].tolist() == [[2.0, 3.0, 0.0], [25.0, 15.0, 0.0]]
    assert (planted.step, planted.age_yr[-1]) == (before.step, 0)
    assert len(model.population(model.remove(state, before.plant_id))) == 0


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("rate", few([500.0, 0.0]))
def test_no_more_plants_than_expected(name, rate, tree):
    species = [
        tree(seedlings_per_ha_per_yr=rate, modules=TYPE),
        tree(name="b", seedlings_per_ha_per_yr=rate, shade_tolerance=0.95, modules=TYPE),
    ]
    start = {"initial_plants": int(rate / 20), **GIVEN.get(name, {})} if name in FOUNDED else {}
    model = COMMUNITY_MODELS.load(name)
    planting = {"at_step": 3, "plant": {"species": "b", "count": 30}}
    for disturbances in ((), (planting,)):
        parameters = model.Parameters(steps=60, disturbances=disturbances, **start)
        bound = model.expected_plants(parameters, SITE, species)
        seeds = range(5 if name not in FOUNDED else 2)
        numbers = [[len(p) for p in simulate(model, parameters, SITE, species, k, steps=60)] for k in seeds]
        assert np.mean(numbers, axis=0).max() <= bound
        assert (
            (bound == 0) == (max(map(max, numbers)) == 0) == (model.empty_reason(parameters, SITE, species) is not None)
        )


@pytest.mark.parametrize("name", GROWING)
def test_what_keeps_plants_from_arriving_is_named(name, species, tree):
    model = COMMUNITY_MODELS.load(name)
    assert "0 for every species" in model.empty_reason(model.Parameters(), SITE, [tree(seedlings_per_ha_per_yr=0.0)])
    assert "steps is 0" in model.empty_reason(model.Parameters(steps=0), SITE, species)


@pytest.mark.parametrize("name", FOUNDED)
def test_that_nothing_was_founded_is_named(name, species):
    model, given = COMMUNITY_MODELS.load(name), GIVEN.get(name, {})
    assert "initial_plants is 0" in model.empty_reason(model.Parameters(initial_plants=0, **given), SITE, species)
    assert model.empty_reason(model.Parameters(initial_plants=1, **given), SITE, species) is None


@pytest.mark.parametrize("name", MODELS)
def test_parameters_are_a_communitys(name):
    model = COMMUNITY_MODELS.load(name)
    assert issubclass(model.Parameters, CommunityParameters)
    parameters = model.Parameters(disturbances=DISTURBANCES, **GIVEN.get(name, {}))
    assert model.Parameters.model_validate(parameters.model_dump(mode="json")) == parameters
    assert dict(parameters.named_species()) == {
        ("disturbances", 0, "plant", "species"): "b",
        ("disturbances", 2, "burn", "species", 0): "tree",
        ("disturbances", 3, "plant", "species"): "tree",
    }
