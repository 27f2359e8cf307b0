"""The engine of branch modules: what every step keeps."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from forestgen.architecture.geometry import node_diameters, node_positions
from forestgen.community.branch_modules.growth import axis_lengths_m, distribute, net_gain, stature_of
from forestgen.community.branch_modules.state import step_parameters
from forestgen.community.disturbance import Planting
from forestgen.community.model import simulate
from forestgen.community.models.branch_modules import MODEL
from forestgen.community.population import Site, SpeciesEcology, Status
from forestgen.core import threads
from forestgen.core.errors import RecipeError, ResourceError
from forestgen.recipe.species import Building, PlantType
from support.error_messages import raises_error

ROWS = {  # of Table 1
    "a": (20, 42, 0.19, 0.62, None, 0.25, None, 0, 0.52, 0.63, -0.38, 0.57, 0.47),
    "b": (200, 78, 0.30, 0.84, None, 1.0, None, 0, 0.52, 0.63, -1.2, 1.00, 0.79),
    "c": (80, 11, 0.80, 1.0, None, 1.0, None, 0, 0.9, 0.5, 1.0, 5.0, 1.95),
    "h": (500, 570, 0.24, 1.0, 0.5, 1.0, 0.5, 55, 0.5, 0.27, -0.66, 1.38, 1.29),
    "o": (300, 600, 0.20, 0.8, None, 0.86, None, 0, -0.19, 0.81, 1.0, 1.0, 1.6),
}
NAMES = (
    "life_span_yr", "root_vigour_max", "growth_rate_per_yr", "apical_control", "apical_control_mature", "determinacy",
    "determinacy_mature", "flowering_age_yr", "tropism_angle_rad", "tropism_weight", "tropism_strength",
    "thickening_cm", "length_per_age_m",
)  # fmt: skip


def plant_type(row, **more):
    keys = dict(zip(NAMES, ROWS[row], strict=True))
    return PlantType(**{**keys, **more})


def ecology(name, modules):
    return SpeciesEcology(name, 0.1, 5.0, 0.5, 0.9, 0.0, 0.1, 4.0, 0.75, modules=modules)


def states(row, steps, plants=1, side_m=40.0, seed=1, types=None, **keys):
    """States 0 to `steps` of one species, or of several types by name."""
    kinds = types or {"x": plant_type(row, seeds_per_yr=0.0)}
    parameters = MODEL.Parameters(initial_plants=plants, steps=steps, **keys)
    state = MODEL.init(parameters, Site((side_m, side_m)), [ecology(*one) for one in kinds.items()], seed)
    yield state
    for _ in range(steps):
        state = MODEL.step(state)
        yield state


def last(*args, **keys):
    *_, state = states(*args, **keys)
    return state


def mixed(steps=22, **keys):
    """A small dense stand of three types that seed."""
    types = {
        "a": plant_type("a", seeds_per_yr=2.0, shade_tolerance=0.15),
        "b": plant_type("b", seeds_per_yr=0.5, shade_tolerance=0.45),
        "o": plant_type("o", seeds_per_yr=0.5, shade_tolerance=0.6),
    }
    return {"row": "", "steps": steps, "plants": 120, "side_m": 18.0, "types": types, **keys}


@pytest.fixture(scope="module")
def stand():
    return list(states(**mixed()))


def columns(part):
    return {name: values.tobytes() for name, values in vars(part).items()}


def same(a, b):
    return columns(a.plants) == columns(b.plants) and columns(a.modules) == columns(b.modules)


def test_the_graphs_of_all_states_are_sound(stand):
    for state in stand:
        modules, parent = state.modules, state.modules.parent
        assert modules.plants == len(state.plants)
        assert np.all(np.diff(modules.first) >= 1)  # the dead have left
        roots = np.zeros(len(modules), dtype=bool)
        roots[modules.first[:-1]] = True
        assert np.array_equal(parent < 0, roots)
        row = np.arange(len(modules)) - modules.first[modules.plant()]
        assert np.all(parent < row)
        bearer = modules.parent_row()[~roots]
        tables = step_parameters(state).tables
        assert np.all(tables.terminal_index[modules.prototype[bearer], modules.node[~roots]] >= 0)
        assert np.all(modules.age[bearer] == np.float32(1.0))  # only grown modules bear others
        key = modules.parent_row() * 64 + modules.node
        assert len(np.unique(key[~roots])) == np.sum(~roots)  # a terminal bears one
        assert np.all(modules.number < state.plants.next_number[modules.plant()])
        assert np.allclose(np.linalg.norm(modules.rotation, axis=1), 1, atol=1e-5)


def test_numbers_and_ids_are_never_given_again(stand):
    seen = {}
    for state in stand:
        plant = state.plants.plant_id[state.modules.plant()].tolist()
        for key, born in zip(
            zip(plant, state.modules.number.tolist(), strict=True),
            np.rint(state.step - state.modules.age_yr).astype(int).tolist(),
            strict=True,
        ):
            assert seen.setdefault(key, born) == born
    assert stand[-1].plants.plant_id.max() > 120  # some were seeded
    assert not np.isin(np.arange(1, 121), stand[-1].plants.plant_id).all()  # and some have died


def test_plants_stay_on_the_site_and_grown_modules_where_they_are(stand):
    for before, after in pairwise(stand):
        assert np.all((after.plants.position_m >= 0) & (after.plants.position_m <= 18.0))

        def grown(state):
            chosen = state.modules.age >= 1
            plant = state.plants.plant_id[state.modules.plant()]
            keys = zip(plant[chosen].tolist(), state.modules.number[chosen].tolist(), strict=True)
            place = np.hstack([state.modules.base_m, state.modules.rotation])[chosen]
            return dict(zip(keys, map(bytes, place), strict=True))

        old, new = grown(before), grown(after)
        assert all(new[key] == place for key, place in old.items() if key in new)


def test_a_new_module_begins_at_the_terminal_that_bears_it(stand):
    state = stand[-1]
    modules = state.modules
    nodes = node_positions(step_parameters(state).tables, modules, state.plants.species)
    borne = np.flatnonzero(modules.parent >= 0)
    at = nodes.start[modules.parent_row()[borne]] + modules.node[borne]
    assert np.allclose(nodes.position_m[at], modules.base_m[borne], atol=1e-4)


def test_vigour_of_children_sums_to_what_reaches_their_fork(stand):
    """By a plain recursion over the nodes of each plant, in place of the compiled passes."""
    state = stand[-1]
    modules, plants, kinds = state.modules, state.plants, step_parameters(state)
    traits, tables, sp = kinds.traits, kinds.tables, plants.species
    most, control = traits.root_vigour_max[sp], traits.apical_control[sp]
    gain = net_gain(modules.light, sp, modules.first, kinds)
    assert np.all(gain <= 1)
    stature, axis = stature_of(modules, sp, kinds), axis_lengths_m(kinds)
    assert np.all((axis > 0.5) & (axis < 8))
    flow = distribute(modules, gain, stature, sp, most, control, kinds)
    parent, plant_of, forks = modules.parent_row(), modules.plant(), 0
    borne = {(int(u), int(n)): w for w, (u, n) in enumerate(zip(parent, modules.node, strict=True)) if u >= 0}
    flux, way = np.zeros(len(modules)), np.zeros(len(modules))
    for row, age in enumerate(modules.age):  # leaves, terminal by terminal
        s, ends = modules.prototype[row], tables.terminals[modules.prototype[row]]
        bearing = sum(modules.age[w] for (u, _), w in borne.items() if u == row)
        u = parent[row]
        way[row] = way[u] + axis[sp[plant_of[row]], modules.prototype[u]] if u >= 0 else 0.0
        whole = age if parent[row] >= 0 else age + (1 - age) / ends
        flux[row] = gain[row] * whole * (ends - bearing) / ends
    for row in range(len(modules) - 1, -1, -1):
        if parent[row] >= 0:
            flux[parent[row]] += flux[row]
    assert np.allclose(flux, flow.flux)
    for row in np.flatnonzero(modules.age >= 1)[:1000]:
        s, p = modules.prototype[row], plant_of[row]
        light = np.zeros(tables.nodes[s])
        for k in range(tables.nodes[s] - 1, -1, -1):
            if tables.first_child[s, k] < 0:
                child = borne.get((row, k))
                light[k] += max(0, gain[row]) / tables.terminals[s] * (1 if child is None else 1 - modules.age[child])
                light[k] += 0 if child is None else max(0, flux[child])
            if k:
                light[tables.parent[s, k]] += light[k]
        vigour = np.zeros(tables.nodes[s])
        reach = traits.reach_m[sp[p]]
        left = np.exp((way[row] / reach) ** 3 - (axis[sp[p], s] / reach + way[row] / reach) ** 3)
        vigour[0] = (1 - traits.upkeep[sp[p]]) ** axis[sp[p], s] * left * flow.vigour[row]
        for k in range(tables.nodes[s]):
            children = [c for c in range(k + 1, tables.nodes[s]) if tables.parent[s, c] == k]
            if children:
                lateral = light[children[1:]].sum()
                weight = control[p] * light[children[0]]
                whole = weight + (1 - control[p]) * lateral
                part = weight / whole if lateral > 0 and whole > 0 else 1.0
                vigour[children[0]] = vigour[k] * part
                for c in children[1:]:
                    vigour[c] = vigour[k] * (1 - part) * light[c] / lateral if lateral > 0 else 0.0
                assert vigour[children].sum() == pytest.approx(vigour[k], abs=1e-9)
                forks += 1
            elif (row, k) in borne:
                assert flow.vigour[borne[row, k]] == pytest.approx(vigour[k], rel=1e-5, abs=1e-6)
            else:
                sprouts = bool(flow.sprouts[row] >> np.uint32(k) & np.uint32(1))
                assert sprouts == (vigour[k] > traits.sprouting[sp[p]] * traits.vigour_min[sp[p]] / tables.terminals[s])
    assert forks > 300


def test_the_pipe_model_holds_at_every_fork_of_a_stand_that_sheds(stand):
    state = stand[-1]
    tables, modules = step_parameters(state).tables, state.modules
    diameter = node_diameters(tables, modules, state.plants.species).astype(float)
    assert modules.disused_m2.max() > 0
    start = np.concatenate([[0], np.cumsum(tables.nodes[modules.prototype])])
    for row in range(0, len(modules), 7):
        s = modules.prototype[row]
        for k in range(tables.nodes[s]):
            children = [c for c in range(tables.nodes[s]) if tables.parent[s, c] == k]
            if children:
                extra = modules.disused_m2[row] if k == tables.disused_node[s] else 0.0
                squares = np.sum(diameter[start[row] + np.array(children)] ** 2) + extra
                assert diameter[start[row] + k] ** 2 == pytest.approx(squares, rel=1e-4, abs=1e-12)


def test_trunks_never_shrink(stand):
    before = {}
    for state in stand:
        found = MODEL.population(state)
        foot = node_diameters(step_parameters(state).tables, state.modules, state.plants.species)
        nodes = step_parameters(state).tables.nodes[state.modules.prototype]
        first = np.concatenate([[0], np.cumsum(nodes)])[state.modules.first[:-1]]
        for plant, width in zip(found.plant_id.tolist(), foot[first].tolist(), strict=True):
            assert width >= before.get(plant, 0.0) * (1 - 1e-4)
            before[plant] = width


def test_the_same_bytes_with_one_thread_and_many(monkeypatch):
    found = []
    for cores, least in ((1, 10_000), (3, 10)):
        monkeypatch.setattr(threads, "cores", lambda cores=cores: cores)
        monkeypatch.setattr(threads, "_LEAST_PER_THREAD", least)
        found.append(last(**mixed(12)))
    assert same(*found)


def test_a_step_leaves_its_state_alone_and_a_snapshot_resumes_to_the_bit(stand):
    state = stand[15]
    kept = columns(state.modules), columns(state.plants)
    again = MODEL.resume(state.parameters, state.site, state.species, state.seed, MODEL.population(state))
    for step in range(16, 19):
        again = MODEL.step(again)
        assert same(again, stand[step])
    assert (columns(state.modules), columns(state.plants)) == kept


def test_a_snapshot_without_modules_is_refused(stand):
    state = stand[3]
    bare = replace(MODEL.population(state), modules=None)
    with raises_error(RecipeError, place="community.history_modules"):
        MODEL.resume(state.parameters, state.site, state.species, state.seed, bare)


def test_felled_plants_leave_with_their_modules_and_planted_ones_come_last(stand):
    state = stand[10]
    gone = state.plants.plant_id[::3]
    after = MODEL.remove(state, np.append(gone, np.uint32(10**9)))
    assert np.array_equal(after.plants.plant_id, np.setdiff1d(state.plants.plant_id, gone))
    assert len(after.modules) == np.sum(state.modules.plant() % 3 != 0)
    new = MODEL.plant(after, Planting(np.array([2, 0], np.uint16), np.array([[1.0, 2.0], [3, 4]]), np.ones(2)))
    assert new.plants.plant_id[-2:].tolist() == [state.next_id, state.next_id + 1]
    assert new.plants.position_m[-2:].tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert MODEL.population(MODEL.step(new)).age_yr[-1] >= 0


def test_a_tree_of_type_h_has_the_size_of_a_tree():
    found = MODEL.population(last("h", 150, side_m=60.0))
    assert 15 < found.height_m[0] < 35
    assert 100 < found.columns["modules"][0] < 1000
    assert 0.1 < found.columns["trunk_diameter_m"][0] < 1
    assert found.status[0] == Status.MATURE


def test_a_palm_is_one_stem_and_a_shrub_stays_low():
    found = list(states("c", 30))
    assert all(np.all(state.modules.parent <= np.arange(len(state.modules)) - 1) for state in found)
    palm = found[-1].modules
    assert palm.parent.tolist() == [-1, *range(len(palm) - 1)]
    assert 6 <= len(palm) <= 15
    shrub = MODEL.population(last("a", 19))
    assert 0.7 < shrub.height_m[0] < 3


def test_in_deep_shade_the_tolerant_live_and_the_others_die():
    """A dense thicket, of the same type but for its tolerance."""

    def left(tolerance):
        types = {"x": plant_type("b", seeds_per_yr=0.0, shade_tolerance=tolerance)}
        return len(last("", 20, plants=60, side_m=5.0, types=types).plants)

    assert left(0.1) < left(0.4) < left(0.8) == 60


def test_plants_grow_old_and_die():
    counts = [len(state.plants) for state in states("a", 45, plants=20, side_m=60.0, senescence_yr=10.0)]
    assert counts[20] == 20
    assert counts[-1] == 0


def test_the_climate_decides_how_many_germinate():
    def seeded(temperature_c):
        types = {"a": plant_type("a", seeds_per_yr=3.0, temperature_c=10.0, temperature_width_c=4.0)}
        climate = {"temperature_c": temperature_c, "precipitation_mm_per_yr": 800.0}
        return last("", 14, plants=30, side_m=40.0, types=types, **climate).next_id

    best = seeded(10.0)
    assert seeded(10.0 + 3.0) < best
    assert seeded(10.0 + 11.0) == 31  # below adaptation_min


def test_seeds_keep_their_distance(stand):
    feet = stand[-1].plants
    new = feet.plant_id > 120
    gap = np.linalg.norm(feet.position_m[:, None] - feet.position_m[new][None], axis=-1)
    gap[gap == 0] = np.inf
    assert gap.min() >= 0.8


def test_two_equal_species_get_equal_room_for_their_seeds():
    one = plant_type("a", seeds_per_yr=50.0)
    kept = np.zeros(2)
    for seed in (1, 2, 3):
        state = last("", 14, plants=60, side_m=20.0, seed=seed, types={"x": one, "y": one}, seedling_spacing_m=1.0)
        young = state.plants.plant_id > 60
        kept += np.bincount(state.plants.species[young], minlength=2)
    assert kept.sum() > 300  # the room is taken: most seeds find none
    assert 0.7 < kept[0] / kept[1] < 1.4


def test_a_species_without_modules_is_told_and_too_many_modules_too():
    with raises_error(RecipeError, place="species.oak.modules"):
        MODEL.init(MODEL.Parameters(), Site((10.0, 10.0)), [ecology("oak", None)], 1)
    with raises_error(ResourceError, place="community.most_modules"):
        last("b", 12, plants=5, most_modules=20)
    species = [ecology("x", plant_type("a"))]
    empty = MODEL.Parameters(initial_plants=0)
    assert "initial_plants" in MODEL.empty_reason(empty, Site((9.0, 9.0)), species)
    assert MODEL.empty_reason(MODEL.Parameters(), Site((9.0, 9.0)), species) is None


def test_the_estimate_is_above_what_a_stand_holds(stand):
    held = sum(values.nbytes for part in (stand[-1].modules, stand[-1].plants) for values in vars(part).values())
    state = stand[-1]
    assert MODEL.estimate_bytes(state.parameters, state.site, state.species) > 4 * held
    assert MODEL.expected_plants(state.parameters, state.site, state.species) >= len(state.plants)


def test_a_house_is_a_row_without_modules_that_stays():
    parameters = MODEL.Parameters(initial_plants={"x": 5}, steps=3)
    site = Site((20.0, 20.0), buildings=(Building.model_validate({"kind": "house", "position_m": (10, 10)}),))
    species = [ecology("x", plant_type("b", seeds_per_yr=0.0)), ecology("house", None)]
    states_ = list(simulate(MODEL, parameters, site, species, 1, steps=3))
    for found in states_:
        assert found.species[0] == 1
        assert found.columns["modules"][0] == 0
        assert found.height_m[0] == 7.0
    state = MODEL.init(parameters, site, species, 1)
    assert len(MODEL.remove(state, state.plants.plant_id).plants) == 1
