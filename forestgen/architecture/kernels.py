"""Compiled loops over modules: where nodes are (Eqs. 9, 11, 12) and how thick (Eq. 10). See geometry.py.

A module's frame is turned by its unit quaternion. `turned` below is that rotation as a matrix, row by row.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from forestgen.core.compiled import compiled, unowned_view


class Shapes(NamedTuple):
    """`Tables` as kernels read them."""

    shape: Any  # (S, N, 5) of the prototypes: direction x, y, z, length, birth
    kind: Any  # (T, 5) of the plant types: mature age, length per age, longest segment, tropism's strength and decay
    # What follows are columns of `Tables`.
    parent: Any
    nodes: Any
    birth: Any
    thickness: Any
    disused_node: Any
    first_child: Any
    next_sibling: Any
    terminal_index: Any
    mature_age: Any
    thickening_m: Any
    most_terminals: Any


class Poses(NamedTuple):
    """M modules; columns as in `Modules` but for the first."""

    kind: Any  # (M,) index of the plant type
    prototype: Any
    age: Any
    base_m: Any
    rotation: Any


class Graphs(NamedTuple):
    """P plants of M modules; columns as in `Modules` but for the first."""

    kind: Any  # (P,) index of the plant type
    first: Any
    parent: Any
    node: Any
    prototype: Any
    age: Any
    disused_m2: Any
    base_m: Any
    rotation: Any


@compiled
def matrix_of(rotation, row, turned):  # type: ignore[no-untyped-def]
    """Fill `turned` (3, 3) with the rotation of the unit quaternion `rotation[row]` (w, x, y, z)."""
    w, x = np.float64(rotation[row, 0]), np.float64(rotation[row, 1])
    y, z = np.float64(rotation[row, 2]), np.float64(rotation[row, 3])
    turned[0, 0], turned[0, 1], turned[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    turned[1, 0], turned[1, 1], turned[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    turned[2, 0], turned[2, 1], turned[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@compiled
def place_nodes(shapes, s, type_, age, turned, place, metres):  # type: ignore[no-untyped-def]
    """Fill `place` (N, 3), metres from the module's root along the world's axes, and `metres` (N,), segment lengths.

    `s` and `type_` are the index of the prototype and of the plant type. What of `age` passes the mature age does not
    count.
    """
    shape, parent, count, kind = shapes.shape[s], shapes.parent[s], shapes.nodes[s], shapes.kind[type_]
    grown = min(age, kind[0])
    place[0, 0] = place[0, 1] = place[0, 2] = 0.0
    metres[0] = 0.0
    for node in range(1, count):
        bearer = parent[node]
        since = grown - shape[node, 4] * kind[0]
        if not since > 0.0:
            place[node, 0], place[node, 1], place[node, 2] = place[bearer, 0], place[bearer, 1], place[bearer, 2]
            metres[node] = 0.0
            continue
        length = shape[node, 3] * min(kind[2], kind[1] * since)
        x, y, z = shape[node, 0], shape[node, 1], shape[node, 2]
        east = turned[0, 0] * x + turned[0, 1] * y + turned[0, 2] * z
        north = turned[1, 0] * x + turned[1, 1] * y + turned[1, 2] * z
        up = turned[2, 0] * x + turned[2, 1] * y + turned[2, 2] * z
        if kind[3] != 0.0:
            bent = up + kind[4] * kind[3] / (since + kind[4])
            norm = np.sqrt(east * east + north * north + bent * bent)
            if norm > 1e-9:  # else the bend undoes the segment's own direction exactly: it keeps that
                east, north, up = east / norm, north / norm, bent / norm
        place[node, 0] = place[bearer, 0] + length * east
        place[node, 1] = place[bearer, 1] + length * north
        place[node, 2] = place[bearer, 2] + length * up
        metres[node] = length


@compiled
def place_module(shapes, modules, row, turned, place, metres):  # type: ignore[no-untyped-def]
    """Fill `turned`, `place` and `metres` for a row of `Poses`."""
    matrix_of(modules.rotation, row, turned)
    place_nodes(shapes, modules.prototype[row], modules.kind[row], modules.age[row], turned, place, metres)


@compiled
def fill_spheres(shapes, modules, scale, first, end, centre, radius):  # type: ignore[no-untyped-def]
    """Fill `centre` (M, 3) and `radius` (M,) of modules `first` to `end`."""
    shapes, modules = unowned_view(shapes), unowned_view(modules)
    base = modules.base_m
    n = shapes.parent.shape[1]
    turned, place, metres = np.empty((3, 3)), np.empty((n, 3)), np.empty(n)
    for row in range(first, end):
        count = shapes.nodes[modules.prototype[row]]
        place_module(shapes, modules, row, turned, place, metres)
        x = y = z = total = 0.0
        for node in range(1, count):
            x += metres[node] * place[node, 0]
            y += metres[node] * place[node, 1]
            z += metres[node] * place[node, 2]
            total += metres[node]
        reach = 0.0
        if total > 0.0:
            x, y, z = x / total, y / total, z / total
            away = np.sqrt(x * x + y * y + z * z)
            if away > 0.0:
                for node in range(1, count):
                    if metres[node] > 0.0:
                        along = (place[node, 0] * x + place[node, 1] * y + place[node, 2] * z) / away
                        reach = max(reach, along)
        centre[row, 0], centre[row, 1], centre[row, 2] = base[row, 0] + x, base[row, 1] + y, base[row, 2] + z
        radius[row] = 0.5 * reach * scale


@compiled
def fill_terminals(shapes, modules, wanted, first, end, position, direction):  # type: ignore[no-untyped-def]
    """Fill `position` (K, 3) and `direction` (K, 3) of nodes `wanted` of grown modules `first` to `end`."""
    shapes, modules = unowned_view(shapes), unowned_view(modules)
    n = shapes.parent.shape[1]
    turned, place, metres = np.empty((3, 3)), np.empty((n, 3)), np.empty(n)
    for row in range(first, end):
        place_module(shapes, modules, row, turned, place, metres)
        node = wanted[row]
        bearer = shapes.parent[modules.prototype[row], node]
        for axis in range(3):
            position[row, axis] = modules.base_m[row, axis] + place[node, axis]
            direction[row, axis] = (place[node, axis] - place[bearer, axis]) / metres[node]


@compiled
def fill_nodes(shapes, modules, start, first, end, position, length):  # type: ignore[no-untyped-def]
    """Fill `position` (., 3) and `length` (.,) of the nodes of modules `first` to `end`, row's from start[row]."""
    shapes, modules = unowned_view(shapes), unowned_view(modules)
    n = shapes.parent.shape[1]
    turned, place, metres = np.empty((3, 3)), np.empty((n, 3)), np.empty(n)
    for row in range(first, end):
        place_module(shapes, modules, row, turned, place, metres)
        for node in range(shapes.nodes[modules.prototype[row]]):
            length[start[row] + node] = metres[node]
            for axis in range(3):
                position[start[row] + node, axis] = modules.base_m[row, axis] + place[node, axis]


@compiled
def fill_pipes(shapes, plants, plant, joint, borne, squared):  # type: ignore[no-untyped-def]
    """Fill `squared` (modules, N) of one plant with the squared diameters of its nodes, m2: pipes from the tips down.

    Scratch: `joint` (modules, terminals), the root node of the module that each terminal bears; `borne` (N,).
    """
    begin, size, kind = plants.first[plant], plants.first[plant + 1] - plants.first[plant], plants.kind[plant]
    mature = shapes.mature_age[kind]
    joint[:size] = -1.0
    for own in range(size - 1, -1, -1):
        row = begin + own
        s = plants.prototype[row]
        grown = min(plants.age[row], mature)
        pipes = squared[own]
        for node in range(shapes.nodes[s]):
            slot = shapes.terminal_index[s, node]
            borne[node] = joint[own, slot] if slot >= 0 else -1.0
            pipes[node] = -1.0  # of no child yet
        for node in range(shapes.nodes[s] - 1, -1, -1):
            if pipes[node] < 0.0:  # a terminal
                birth = shapes.birth[s, node]
                share = min(1.0, max(0.0, grown / mature - birth) / (1.0 - birth))
                thick = shapes.thickening_m[kind] * shapes.thickness[s, node] * share
                pipes[node] = max(thick * thick, borne[node])
            if node == shapes.disused_node[s]:
                pipes[node] += plants.disused_m2[row]
            if node > 0:
                bearer = shapes.parent[s, node]
                pipes[bearer] = max(pipes[bearer], 0.0) + pipes[node]
        if plants.parent[row] >= 0:
            slot = shapes.terminal_index[plants.prototype[begin + plants.parent[row]], plants.node[row]]
            joint[plants.parent[row], slot] = pipes[0]


@compiled
def fill_diameters(shapes, plants, first, end, start, root_m, node_m):  # type: ignore[no-untyped-def]
    """Fill `root_m` (M,), diameters of the root nodes of the plants' modules, for plants `first` to `end`.

    `node_m` (.,) takes those of all nodes, module row's from start[row]; of no length: not wanted.
    """
    shapes, plants = unowned_view(shapes), unowned_view(plants)
    n = shapes.parent.shape[1]
    joint, squared, borne = np.empty((0, shapes.most_terminals)), np.empty((0, n)), np.empty(n)
    for plant in range(first, end):
        begin, size = plants.first[plant], plants.first[plant + 1] - plants.first[plant]
        if size > len(joint):
            joint, squared = np.empty((2 * size, shapes.most_terminals)), np.empty((2 * size, n))
        fill_pipes(shapes, plants, plant, joint, borne, squared)
        for own in range(size):
            row = begin + own
            root_m[row] = np.sqrt(squared[own, 0])
            if len(node_m):
                for node in range(shapes.nodes[plants.prototype[row]]):
                    node_m[start[row] + node] = np.sqrt(squared[own, node])


@compiled
def fill_sizes(shapes, plants, leaf_area, first, end, sizes):  # type: ignore[no-untyped-def]
    """Fill `sizes` (P, 6) of plants `first` to `end`, in the order of `PlantSizes`, less the number of modules."""
    shapes, plants = unowned_view(shapes), unowned_view(plants)
    parents, counts, births, first_child = shapes.parent, shapes.nodes, shapes.birth, shapes.first_child
    terminal_index, most_terminals = shapes.terminal_index, shapes.most_terminals
    parent_of, node_of, prototype, age, base = plants.parent, plants.node, plants.prototype, plants.age, plants.base_m
    n = parents.shape[1]
    turned, place, metres, borne = np.empty((3, 3)), np.empty((n, 3)), np.empty(n), np.empty(n)
    joint, squared = np.empty((0, most_terminals)), np.empty((0, n))
    child, bare = np.empty((0, most_terminals), dtype=np.int64), np.empty((0, most_terminals))
    low, high = np.empty(4), np.empty(4)
    half = np.sqrt(0.5)
    for plant in range(first, end):
        begin, size = plants.first[plant], plants.first[plant + 1] - plants.first[plant]
        if size == 0:  # an obstacle
            continue
        kind = plants.kind[plant]
        if size > len(joint):
            joint, squared = np.empty((2 * size, most_terminals)), np.empty((2 * size, n))
            child = np.empty((2 * size, most_terminals), dtype=np.int64)
            bare = np.empty((2 * size, most_terminals))
        fill_pipes(shapes, plants, plant, joint, borne, squared)
        child[:size] = -1
        bare[:size] = 1.0
        low[:] = 0.0
        high[:] = 0.0
        height = volume = leaves = 0.0
        for own in range(size - 1, -1, -1):
            row = begin + own
            s = prototype[row]
            grown = min(1.0, age[row] / shapes.mature_age[kind])
            for node in range(counts[s]):
                slot = terminal_index[s, node]
                if slot >= 0:
                    share = max(0.0, grown - births[s, node]) / (1.0 - births[s, node]) * shapes.thickness[s, node]
                    leaves += leaf_area[kind, s] * share * share * bare[own, slot]
            if parent_of[row] >= 0:
                slot = terminal_index[prototype[begin + parent_of[row]], node_of[row]]
                child[parent_of[row], slot] = own
                bare[parent_of[row], slot] = 1.0 - grown
            matrix_of(plants.rotation, row, turned)
            place_nodes(shapes, s, kind, age[row], turned, place, metres)
            for node in range(1, counts[s]):
                if metres[node] == 0.0:
                    continue
                bearer = parents[s, node]
                tip = squared[own, node]
                foot = squared[own, bearer] if first_child[s, bearer] == node else tip  # a lateral does not taper
                volume += metres[node] * (foot + np.sqrt(foot * tip) + tip)
                x, y = base[row, 0] + place[node, 0], base[row, 1] + place[node, 1]
                height = max(height, base[row, 2] + place[node, 2])
                low[0], high[0] = min(low[0], x), max(high[0], x)
                low[1], high[1] = min(low[1], y), max(high[1], y)
                x, y = half * (x + y), half * (x - y)
                low[2], high[2] = min(low[2], x), max(high[2], x)
                low[3], high[3] = min(low[3], y), max(high[3], y)
        sizes[plant, 0] = height
        sizes[plant, 1] = (high - low).sum() / 8.0
        sizes[plant, 2] = _trunk(shapes, plants, kind, begin, squared, child, turned, place, metres)
        sizes[plant, 3] = np.sqrt(squared[0, 0])
        sizes[plant, 4] = volume * np.pi / 12.0
        sizes[plant, 5] = leaves


@compiled
def _trunk(shapes, plants, kind, begin, squared, child, turned, place, metres):  # type: ignore[no-untyped-def]
    """Diameter of the stem 1.3 m above the foot, metres; at the foot where it does not reach so high.

    The stem takes the thickest way at each fork, the first of equals.
    """
    own = 0
    while own >= 0:
        row = begin + own
        s = plants.prototype[row]
        matrix_of(plants.rotation, row, turned)
        place_nodes(shapes, s, kind, plants.age[row], turned, place, metres)
        node = 0
        while shapes.first_child[s, node] >= 0:
            thickest = shapes.first_child[s, node]
            other = shapes.next_sibling[s, thickest]
            while other >= 0:
                if squared[own, other] > squared[own, thickest]:
                    thickest = other
                other = shapes.next_sibling[s, other]
            node = thickest
            if plants.base_m[row, 2] + place[node, 2] >= 1.3:
                return np.sqrt(squared[own, node])
        own = child[own, shapes.terminal_index[s, node]]
    return np.sqrt(squared[0, 0])
