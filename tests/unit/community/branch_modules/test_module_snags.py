"""Standing dead trees: what dies stays as wood for its years, and nothing that lives knows of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_module_engine import MODEL, columns, mixed, plant_type, same, states

from forestgen.architecture.geometry import plant_sizes
from forestgen.community.branch_modules.growth import stands_yr
from forestgen.community.branch_modules.state import step_parameters
from forestgen.community.history import open_history, write_history
from forestgen.community.population import Status
from forestgen.core.errors import ResourceError

MEDIAN_YR = 6.0


TYPES = {  # of short lives
    "a": plant_type("a", seeds_per_yr=2.0, shade_tolerance=0.15, life_span_yr=5),
    "b": plant_type("b", seeds_per_yr=0.5, shade_tolerance=0.45, life_span_yr=9),
    "o": plant_type("o", seeds_per_yr=0.5, shade_tolerance=0.6),
}


def stand(**keys):
    keys = {"temperature_c": 12.0, "precipitation_mm_per_yr": 900.0, "senescence_yr": 10.0, **keys}
    return list(states(**mixed(**{"steps": 24, "types": TYPES, "plants": 70, "side_m": 14.0, **keys})))


@pytest.fixture(scope="module")
def without():
    return stand()


@pytest.fixture(scope="module")
def dying():
    return stand(standing_dead_yr=MEDIAN_YR)


def dead_of(population):
    return population.status == Status.DEAD


def test_nothing_that_lives_knows_of_the_dead(without, dying):
    assert len(dying[-1].snags.died) > 0
    for plain, state in zip(without, dying, strict=True):
        assert same(plain, state)
        assert not len(plain.snags.died)
        alone, among = MODEL.population(plain), MODEL.population(state)
        living = ~dead_of(among)
        for name, values in alone.columns.items():
            assert np.array_equal(values, among.columns[name][living])
        assert np.array_equal(alone.plant_id, among.plant_id[living])
        assert np.array_equal(alone.status, among.status[living])


def test_the_dead_stand_as_they_were_for_years_of_their_own(dying):
    """From the step of their death on, with the wood of the step before it, until they fall."""
    seed = dying[0].seed
    seen: dict[int, list[tuple[int, bytes]]] = {}
    for state in dying:
        snags = state.snags
        for row, plant_id in enumerate(snags.plants.plant_id.tolist()):
            one = np.arange(len(snags.died)) == row
            wood = b"".join(columns(snags.modules.of_plants(one)).values())
            seen.setdefault(plant_id, []).append((state.step, wood))
            assert snags.died[row] == seen[plant_id][0][0]
    last = dying[-1].step
    for plant_id, found in seen.items():
        died, wood = found[0]
        years = float(stands_yr(seed, np.array([plant_id], dtype=np.uint32), MEDIAN_YR)[0])
        assert [step for step, _ in found] == [step for step in range(died, last + 1) if step - died < years]
        assert all(same_wood == wood for _, same_wood in found)
        before, snags = dying[died - 1], dying[died].snags
        modules = before.modules.of_plants(before.plants.plant_id == plant_id)
        stands = snags.modules.of_plants(snags.plants.plant_id == plant_id)
        assert np.array_equal(stands.number, modules.number)  # nothing of it is shed
        species = before.plants.species[before.plants.plant_id == plant_id]
        assert plant_sizes(step_parameters(before).tables, stands, species).height_m > 1.3


def test_a_snapshot_holds_the_dead_in_their_place_without_leaves_or_vigour(dying):
    for state in dying:
        population = MODEL.population(state)
        dead = dead_of(population)
        assert np.array_equal(population.plant_id[dead], np.sort(state.snags.plants.plant_id))
        for name in ("leaf_area_m2", "vigour", "light"):
            assert not population.columns[name][dead].any()
        assert not population.columns["dead_yr"][~dead].any()
        assert np.all(np.diff(population.modules.first)[dead] > 0)
        assert np.all(population.height_m[dead] > 1.3)
        # its age is that at its death
        born = state.snags.plants.born[np.argsort(state.snags.plants.plant_id)]
        since = np.rint(population.columns["dead_yr"][dead])
        assert np.array_equal(population.age_yr[dead] + since, state.step - born)


def test_what_is_resumed_is_what_would_have_gone_on(tmp_path):
    keys = {"standing_dead_yr": MEDIAN_YR, "dieback_share": 0.8}
    whole = stand(**keys)
    snapshots = [MODEL.population(state) for state in whole]
    write_history(tmp_path / "history.parquet", snapshots, {}, modules=True)
    for step in (20, 22):
        kept = open_history(tmp_path / "history.parquet").whole(step)
        assert dead_of(kept).any()
        first = whole[0]
        state = MODEL.resume(first.parameters, first.site, first.species, first.seed, kept)
        assert same(state, whole[step])
        for _ in range(step, whole[-1].step):
            state = MODEL.step(state)
        again, straight = MODEL.population(state), snapshots[-1]
        assert columns(again.modules) == columns(straight.modules)
        assert {name: values.tobytes() for name, values in again.columns.items()} == {
            name: values.tobytes() for name, values in straight.columns.items()
        }


def test_half_of_the_dead_have_fallen_by_the_median_and_few_at_first():
    years = stands_yr(3, np.arange(1, 20_001, dtype=np.uint32), 10.0)
    assert np.mean(years < 10.0) == pytest.approx(0.5, abs=0.02)
    assert np.mean(years < 2.0) == pytest.approx(1 - 2**-0.04, abs=0.01)
    assert np.array_equal(stands_yr(3, np.array([7], dtype=np.uint32), 10.0), years[6:7])  # whoever else is dead


def test_a_tree_that_has_died_back_is_dead_with_the_wood_it_had(without):
    """Every third plant was once taller than its share allows, every other just not so tall."""
    share, state = 0.8, without[11]
    plants, n = state.plants, len(state.plants)
    plain = MODEL.population(MODEL.step(state))
    lives = np.isin(plants.plant_id, plain.plant_id)
    height_m = np.zeros(n)
    height_m[lives] = plain.height_m[np.isin(plain.plant_id, plants.plant_id)]
    once = np.where(np.arange(n) % 3 == 0, 1.01, 0.99) * height_m / share
    keys = {"dieback_share": share, "standing_dead_yr": 1000.0}
    tall = replace(
        state,
        plants=replace(plants, tallest_m=once.astype(np.float32)),
        parameters=state.parameters.model_copy(update=keys),
    )
    after = MODEL.step(tall)
    gone = lives & (np.arange(n) % 3 == 0) & (once > 1.3)
    assert 0 < gone.sum() < lives.sum()
    left = np.isin(plants.plant_id, after.plants.plant_id)
    assert np.array_equal(left, lives & ~gone)
    stands = np.isin(plants.plant_id, after.snags.plants.plant_id)
    assert np.any(stands & gone)
    assert np.array_equal(after.snags.modules.number, state.modules.of_plants(stands).number)
    never = replace(tall, parameters=state.parameters.model_copy(update={"dieback_share": 0.0}))
    assert np.array_equal(MODEL.step(never).plants.plant_id, plain.plant_id)


def test_the_felled_leave_no_snag_and_the_dead_are_spared(dying):
    state = dying[-1]
    felled = MODEL.remove(state, MODEL.population(state).plant_id)
    assert len(felled.plants) == 0
    assert columns(felled.snags.plants) == columns(state.snags.plants)
    assert np.all(dead_of(MODEL.population(felled)))


def test_modules_of_the_dead_count(dying):
    state = dying[-1]
    most = len(state.modules) + 1
    short = replace(state, parameters=state.parameters.model_copy(update={"most_modules": most}))
    with pytest.raises(ResourceError):
        MODEL.step(short)


def test_modules_in_another_order_are_the_plants_own(dying):
    modules, species = dying[-1].modules, dying[-1].plants.species
    turned = np.arange(modules.plants)[::-1].copy()
    there = modules.of_plants(turned)
    tables = step_parameters(dying[-1]).tables
    sizes = plant_sizes(tables, there, species[turned]).wood_volume_m3
    assert np.allclose(sizes[::-1], plant_sizes(tables, modules, species).wood_volume_m3)
    assert columns(there.of_plants(turned)) == columns(modules)


def test_adaptation_is_what_was_felt(without):
    population = MODEL.population(without[-1])
    felt = population.columns["adaptation"]
    assert np.all((felt > 0) & (felt <= 1))
    assert np.all(felt[population.age_yr == 0] == 1)
    for index in np.unique(population.species):
        assert len(np.unique(felt[(population.species == index) & (population.age_yr > 0)])) == 1  # one climate for all
    assert np.all(MODEL.population(list(states("a", 3))[-1]).columns["adaptation"] == 1)
