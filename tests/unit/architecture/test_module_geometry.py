"""Geometry of modules against the paper's equations, one node at a time, and its symmetries."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from module_graphs import (
    plant_type,
    random_plants,
    shipped_tables,
    single,
    turned_about_vertical,
    unit_quaternions,
    upright,
)
from numpy.typing import NDArray

from forestgen.architecture.geometry import (
    diameters,
    node_diameters,
    node_positions,
    plant_sizes,
    spheres,
    terminal_pose,
    type_of_module,
)
from forestgen.architecture.modules import Modules
from forestgen.architecture.prototypes import Tables
from forestgen.core import threads

TYPES = (
    plant_type(),
    plant_type(tropism_strength=-0.6, mature_age=2.0, length_per_age_m=1.7, thickening_cm=2.5),
    plant_type(tropism_strength=0.9, tropism_decay=0.7, longest_segment_m=0.4, opacity=0.9),
)


def stand(tables: Tables, plants: int = 40, size: int = 30, seed: int = 1) -> tuple[Modules, NDArray[Any]]:
    rng = np.random.default_rng(seed)
    kinds = rng.integers(0, len(TYPES), plants)
    return random_plants(tables, kinds, size, rng), kinds


def matrix(rotation: NDArray[np.float32]) -> NDArray[np.float64]:
    w, (x, y, z) = float(rotation[0]), rotation[1:].astype(np.float64)
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + 2 * w * skew + 2 * skew @ skew)


def plain_nodes(tables: Tables, modules: Modules, kind: int, row: int) -> NDArray[np.float64]:
    """(N, 3) by Eqs. 9, 11 and 12, straight from their text."""
    s = modules.prototype[row]
    turn = matrix(modules.rotation[row])
    place = [modules.base_m[row].astype(np.float64)]
    for node in range(1, tables.nodes[s]):
        age = max(0.0, min(modules.age[row], TYPES[kind].mature_age) - tables.birth[s, node] * TYPES[kind].mature_age)
        length = min(TYPES[kind].longest_segment_m, TYPES[kind].length_per_age_m * age) * tables.length[s, node]
        way = turn @ tables.direction[s, node]
        g_1, g_2 = TYPES[kind].tropism_decay, TYPES[kind].tropism_strength
        way = way + np.array([0, 0, g_1 * g_2 / (age + g_1)])
        place.append(place[tables.parent[s, node]] + length * way / np.linalg.norm(way))
    return np.array(place)


def test_nodes_are_where_the_equations_put_them() -> None:
    tables = shipped_tables(*TYPES)
    modules, kinds = stand(tables)
    nodes = node_positions(tables, modules, kinds)
    kind = type_of_module(modules, kinds)
    for row in range(len(modules)):
        found = nodes.position_m[nodes.start[row] : nodes.start[row + 1]]
        assert np.allclose(found, plain_nodes(tables, modules, kind[row], row), atol=2e-5)


def test_segments_grow_from_their_births_to_their_lengths() -> None:
    tables = shipped_tables(*TYPES)
    for kind, one in enumerate(TYPES):
        for share in (0.0, 0.2, 0.55, 1.0, 1.5):
            modules = single(tables, np.arange(9), share * one.mature_age)
            nodes = node_positions(tables, modules, np.full(9, kind))
            birth = np.concatenate([tables.birth[s, : tables.nodes[s]] for s in range(9)])
            factor = np.concatenate([tables.length[s, : tables.nodes[s]] for s in range(9)])
            since = np.maximum(min(share, 1.0) - birth, 0) * one.mature_age
            expected = factor * np.minimum(one.longest_segment_m, one.length_per_age_m * since)
            assert np.allclose(nodes.length_m, expected, atol=1e-6)
            born = (share > birth) & (factor > 0)
            assert np.all((nodes.length_m > 0) == born)
            # ... and the positions are so far apart.
            for s in range(9):
                place = nodes.position_m[nodes.start[s] : nodes.start[s + 1]]
                apart = np.linalg.norm(place[1:] - place[tables.parent[s, 1 : tables.nodes[s]]], axis=1)
                assert np.allclose(apart, nodes.length_m[nodes.start[s] + 1 : nodes.start[s + 1]], atol=1e-5)


def test_tropism_has_its_limits() -> None:
    """Eq. 12: a segment starts at direction + g_2 up, tends to its own with age, and is straight at g_2 = 0."""
    strength, decay = 0.5, 0.3
    straight = plant_type(mature_age=50.0, longest_segment_m=20.0)
    bent = plant_type(mature_age=50.0, longest_segment_m=20.0, tropism_strength=strength, tropism_decay=decay)
    tables = shipped_tables(straight, bent)
    s = tables.names.index("dichotomous")
    rotation = unit_quaternions(np.random.default_rng(5), 1)
    own = matrix(rotation[0]) @ tables.direction[s, 1]

    def direction(kind: int, age: float) -> NDArray[np.float64]:
        place = node_positions(tables, single(tables, s, age, rotation), np.array([kind])).position_m
        return np.asarray(place[1] / np.linalg.norm(place[1]), dtype=np.float64)

    young = own + np.array([0, 0, strength])
    assert np.allclose(direction(1, 1e-3), young / np.linalg.norm(young), atol=3e-3)
    half = own + np.array([0, 0, strength / 2])  # of age g_1
    assert np.allclose(direction(1, decay), half / np.linalg.norm(half), atol=1e-5)
    assert np.allclose(direction(1, 50.0), own, atol=strength * decay / 50)
    assert np.allclose(direction(0, 0.2), own, atol=1e-6)
    up = [direction(1, age)[2] for age in (0.1, 0.4, 1.0, 5.0)]
    assert np.all(np.diff(up) < 0)


def test_a_grown_module_is_rigid() -> None:
    tables = shipped_tables(*TYPES)
    rng = np.random.default_rng(2)
    rotation = unit_quaternions(rng, 9)
    for kind, one in enumerate(TYPES):
        ages = one.mature_age * np.array([1.0, 1.3, 40.0])
        places = [
            node_positions(tables, single(tables, np.arange(9), age, rotation), np.full(9, kind)).position_m
            for age in ages
        ]
        assert np.array_equal(places[0], places[1])
        assert np.array_equal(places[0], places[2])


def test_terminal_poses_are_ends_of_grown_modules() -> None:
    tables = shipped_tables(*TYPES)
    rng = np.random.default_rng(4)
    pairs = [(s, n) for s in range(9) for n in tables.terminal[s, : tables.terminals[s]]]
    prototype, node = np.array(pairs).T
    kind = rng.integers(0, 3, len(pairs))
    rotation = unit_quaternions(rng, len(pairs))
    base = rng.normal(size=(len(pairs), 3))
    position, direction = terminal_pose(tables, kind, prototype, base, rotation, node)
    for k, (s, n) in enumerate(pairs):
        modules = single(tables, s, TYPES[kind[k]].mature_age, rotation[k : k + 1])
        place = plain_nodes(tables, modules, int(kind[k]), 0)
        way = place[n] - place[tables.parent[s, n]]
        assert np.allclose(position[k], base[k] + place[n], atol=1e-5)
        assert np.allclose(direction[k], way / np.linalg.norm(way), atol=1e-5)


def test_spheres_hold_most_of_a_module_and_touch_along_a_chain() -> None:
    tables = shipped_tables(plant_type())
    modules = single(tables, np.arange(9), 1.0)
    nodes = node_positions(tables, modules, np.zeros(9, dtype=int))
    centre, radius = spheres(tables, modules, np.zeros(9, dtype=int))
    for s, name in enumerate(tables.names):
        place = nodes.position_m[nodes.start[s] : nodes.start[s + 1]]
        length = nodes.length_m[nodes.start[s] : nodes.start[s + 1]]
        assert np.allclose(centre[s], np.average(place, axis=0, weights=length), atol=1e-5)
        # Of the wood, by length, in steps of a hundredth of a segment.
        share = np.linspace(0.005, 0.995, 100)[:, None, None]
        bearer = place[np.maximum(tables.parent[s, : tables.nodes[s]], 0)]
        points = bearer + share * (place - bearer)
        inside = np.linalg.norm(points - centre[s], axis=-1) < radius[s]
        assert (inside * length).sum() / (len(share) * length.sum()) > 0.7, name
        # The next module of the chain begins at the top, its centre as far up as this one's.
        top = place[tables.terminal[s, : tables.terminals[s]]] @ (centre[s] / np.linalg.norm(centre[s]))
        assert 2 * radius[s] == pytest.approx(top.max(), abs=1e-5)


def test_tables_of_spheres_are_those_of_modules_without_tropism() -> None:
    straight = tuple(one.model_copy(update={"tropism_strength": 0.0}) for one in TYPES)
    tables = shipped_tables(*straight)
    for kind in range(3):
        grown = single(tables, np.arange(9), tables.mature_age[kind])
        centre, radius = spheres(tables, grown, np.full(9, kind))
        assert np.allclose(tables.grown_spheres_m[0][kind], centre, atol=1e-5)
        assert np.allclose(tables.grown_spheres_m[1][kind], radius, atol=1e-5)


def plain_squares(tables: Tables, modules: Modules, kind: int, first: int, end: int) -> list[NDArray[np.float64]]:
    """Squared diameters of each module's nodes by a plain recursion down from each fork."""
    one = TYPES[kind]
    borne = {(int(modules.parent[row]), int(modules.node[row])): row for row in range(first, end)}
    found = [np.zeros(tables.nodes[modules.prototype[row]]) for row in range(first, end)]

    def square(row: int, node: int) -> float:
        s = modules.prototype[row]
        children = np.flatnonzero(tables.parent[s, : tables.nodes[s]] == node)
        total = sum(square(row, int(child)) for child in children)
        if not len(children):
            age = max(0.0, min(modules.age[row], one.mature_age) / one.mature_age - tables.birth[s, node])
            own = one.thickening_cm / 100 * tables.thickness[s, node] * age / (1 - tables.birth[s, node])
            child = borne.get((row - first, node))
            total = max(own**2, 0.0 if child is None else square(child, 0))
        if node == tables.disused_node[s]:
            total += modules.disused_m2[row]
        found[row - first][node] = total
        return float(total)

    square(first, 0)
    return found


def test_pipes_are_conserved_at_every_fork_and_joint() -> None:
    tables = shipped_tables(*TYPES)
    modules, kinds = stand(tables)
    node = node_diameters(tables, modules, kinds).astype(np.float64)
    root = diameters(tables, modules, kinds)
    start = np.concatenate([[0], np.cumsum(tables.nodes[modules.prototype])])
    assert np.array_equal(root, node[start[:-1]].astype(np.float32))
    for plant in range(modules.plants):
        first, end = modules.first[plant], modules.first[plant + 1]
        for row, squares in enumerate(plain_squares(tables, modules, kinds[plant], first, end), first):
            assert np.allclose(node[start[row] : start[row + 1]] ** 2, squares, rtol=1e-5, atol=1e-14)


def test_wood_of_what_was_shed_stays_below() -> None:
    """The main axis of a module carries it from its last fork down; branches do not."""
    tables = shipped_tables(plant_type())
    kinds = np.zeros(9, dtype=int)
    before = single(tables, np.arange(9), 1.0)
    parts = {name: getattr(before, name) for name in before.__dataclass_fields__}
    after = Modules(**{**parts, "disused_m2": np.full(9, 0.01, dtype=np.float32)})
    added = node_diameters(tables, after, kinds) ** 2.0 - node_diameters(tables, before, kinds) ** 2.0
    start = np.concatenate([[0], np.cumsum(tables.nodes)])
    for s in range(9):
        on_main, node = {0}, 0
        while tables.first_child[s, node] >= 0:
            node = int(tables.first_child[s, node])
            if tables.first_child[s, node] >= 0:
                on_main.add(node)
        expected = [0.01 * (n in on_main) for n in range(tables.nodes[s])]
        assert np.allclose(added[start[s] : start[s + 1]], expected, atol=1e-7)


def test_plants_are_the_same_from_every_side() -> None:
    """Turned about the vertical, with tropism: nodes turn along, and sizes stay; crowns' to their four directions."""
    tables = shipped_tables(*TYPES)
    modules, kinds = stand(tables)
    angle = np.pi / 4
    turned = turned_about_vertical(modules, angle)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    one, other = node_positions(tables, modules, kinds), node_positions(tables, turned, kinds)
    assert np.allclose(one.position_m @ turn.T, other.position_m, atol=1e-4)
    (centre, radius), (centre_2, radius_2) = spheres(tables, modules, kinds), spheres(tables, turned, kinds)
    assert np.allclose(centre @ turn.T, centre_2, atol=1e-4)
    assert np.allclose(radius, radius_2, atol=1e-4)
    sizes, sizes_2 = plant_sizes(tables, modules, kinds), plant_sizes(tables, turned, kinds)
    for name in ("height_m", "crown_radius_m", "wood_volume_m3", "leaf_area_m2"):
        assert np.allclose(getattr(sizes, name), getattr(sizes_2, name), rtol=1e-4, atol=1e-5), name


def test_any_number_of_threads_gives_the_same_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    tables = shipped_tables(*TYPES)
    modules, kinds = stand(tables, 60, 20)
    monkeypatch.setattr(threads, "_LEAST_PER_THREAD", 10)

    def everything() -> list[bytes]:
        nodes, sizes = node_positions(tables, modules, kinds), plant_sizes(tables, modules, kinds)
        arrays = [*spheres(tables, modules, kinds), diameters(tables, modules, kinds)]
        arrays += [node_diameters(tables, modules, kinds), nodes.position_m, nodes.length_m]
        arrays += [getattr(sizes, name) for name in sizes.__dataclass_fields__]
        return [array.tobytes() for array in arrays]

    results = []
    for cores in (1, 2, 5):
        monkeypatch.setattr(threads, "cores", lambda count=cores: count)
        results.append(everything())
    assert results[0] == results[1] == results[2]


def test_no_plants_no_geometry() -> None:
    tables = shipped_tables(*TYPES)
    none = single(tables, np.zeros(0, dtype=int), np.zeros(0))
    kinds = np.zeros(0, dtype=int)
    assert len(spheres(tables, none, kinds)[1]) == 0
    assert len(diameters(tables, none, kinds)) == 0
    assert len(plant_sizes(tables, none, kinds).height_m) == 0
    assert len(node_positions(tables, none, kinds).position_m) == 0


def test_sizes_of_a_column_are_those_of_its_chain() -> None:
    """A palm of one module: everything can be told by hand."""
    kind = plant_type(apical_control=1.0, determinacy=1.0, length_per_age_m=3.0, longest_segment_m=5.0, opacity=0.75)
    tables = shipped_tables(kind)
    s = tables.names.index("column")
    modules = single(tables, s, 1.0)
    sizes = plant_sizes(tables, modules, np.zeros(1, dtype=int))
    nodes = node_positions(tables, modules, np.zeros(1, dtype=int))
    _, radius = spheres(tables, modules, np.zeros(1, dtype=int))
    thick = kind.thickening_cm / 100 * tables.thickness[s, tables.terminal[s, 0]]
    assert sizes.height_m[0] == pytest.approx(nodes.position_m[:, 2].max())
    assert sizes.trunk_diameter_m[0] == pytest.approx(thick)
    assert sizes.wood_volume_m3[0] == pytest.approx(np.pi / 4 * thick**2 * nodes.length_m.sum(), rel=1e-5)
    assert sizes.leaf_area_m2[0] == pytest.approx(-2 * np.log(0.25) * np.pi * float(radius[0]) ** 2, rel=1e-4)
    assert sizes.modules[0] == 1


def test_sizes_hold_against_all_nodes() -> None:
    tables = shipped_tables(*TYPES)
    modules, kinds = stand(tables)
    sizes = plant_sizes(tables, modules, kinds)
    nodes, diameter = node_positions(tables, modules, kinds), node_diameters(tables, modules, kinds)
    _, radius = spheres(tables, modules, kinds)
    for plant in range(modules.plants):
        rows = range(modules.first[plant], modules.first[plant + 1])
        place = nodes.position_m[nodes.start[rows[0]] : nodes.start[rows[-1] + 1]].astype(np.float64)
        assert sizes.height_m[plant] == pytest.approx(max(0.0, place[:, 2].max()), abs=1e-5)
        ways = np.array([[1, 0, 0], [0, 1, 0], [0.5**0.5, 0.5**0.5, 0], [0.5**0.5, -(0.5**0.5), 0]])
        assert sizes.crown_radius_m[plant] == pytest.approx(np.ptp(place @ ways.T, axis=0).mean() / 2, abs=1e-5)
        volume = leaves = 0.0
        one = TYPES[kinds[plant]]
        for row in rows:
            s, first = modules.prototype[row], nodes.start[row]
            for node in range(1, tables.nodes[s]):
                bearer = tables.parent[s, node]
                tip = float(diameter[first + node])
                foot = float(diameter[first + bearer]) if tables.first_child[s, bearer] == node else tip
                volume += np.pi / 12 * nodes.length_m[first + node] * (foot**2 + foot * tip + tip**2)
            free = tables.terminals[s] - np.sum(modules.parent_row() == row)
            share = modules.age[row] / one.mature_age * free / tables.terminals[s]
            if one.tropism_strength == 0 and modules.age[row] == one.mature_age:
                leaves += -2 * np.log(1 - one.opacity) * np.pi * float(radius[row]) ** 2 * share
        assert sizes.wood_volume_m3[plant] == pytest.approx(volume, rel=1e-4)
        if one.tropism_strength == 0 and np.all(modules.age[rows] == one.mature_age):
            assert sizes.leaf_area_m2[plant] == pytest.approx(leaves, rel=1e-3)


def test_trunks_are_measured_at_breast_height_or_at_the_foot() -> None:
    tall = plant_type(length_per_age_m=2.0, longest_segment_m=5.0)
    tables = shipped_tables(tall)
    s = tables.names.index("whorled")
    kinds = np.zeros(1, dtype=int)
    for age, foot in ((0.3, True), (1.0, False)):
        modules = single(tables, s, age, upright(1))
        nodes = node_positions(tables, modules, kinds).position_m
        diameter = node_diameters(tables, modules, kinds)
        trunk = float(plant_sizes(tables, modules, kinds).trunk_diameter_m[0])
        assert (nodes[:, 2].max() < 1.3) == foot
        main = [1, 2, 7]  # nodes of the leading axis
        at = 0 if foot else next(node for node in main if nodes[node, 2] >= 1.3)
        assert trunk == pytest.approx(float(diameter[at]))
