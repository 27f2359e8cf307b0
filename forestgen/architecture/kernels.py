"""Compiled loops over modules: where nodes are (Eqs. 9, 11, 12) and how thick (Eq. 10). See geometry.py and sizes.py.

A module's frame is turned by its unit quaternion. `turned` below is that rotation as a matrix, row by row.
"""

from __future__ import annotations

import numpy as np

from forestgen.core.compiled import borrowed, compiled


@compiled
def matrix_of(rotation, row, turned):  # type: ignore[no-untyped-def]
    """Fill `turned` (3, 3) with the rotation of the unit quaternion `rotation[row]` (w, x, y, z)."""
    w, x = np.float64(rotation[row, 0]), np.float64(rotation[row, 1])
    y, z = np.float64(rotation[row, 2]), np.float64(rotation[row, 3])
    turned[0, 0], turned[0, 1], turned[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    turned[1, 0], turned[1, 1], turned[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    turned[2, 0], turned[2, 1], turned[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@compiled
def place_nodes(shape, parent, count, kind, age, turned, place, metres):  # type: ignore[no-untyped-def]
    """Fill `place` (N, 3), metres from the module's root along the world's axes, and `metres` (N,), segment lengths.

    Parameters
    ----------
    shape : (N, 5) of the prototype: direction x, y, z, length, birth.
    kind : (5,) of the plant type: mature age, length per age, longest segment, tropism's strength g_2 and decay g_1.
    age : the module's physiological age; what passes the mature age does not count.
    """
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
def fill_spheres(  # type: ignore[no-untyped-def]
    shapes, parents, counts, kinds, scale, kind_of, prototype, age, base, rotation, first, end, centre, radius
):
    """Fill `centre` (M, 3) and `radius` (M,) of modules `first` to `end`."""
    shapes, parents, counts, kinds = borrowed(shapes), borrowed(parents), borrowed(counts), borrowed(kinds)
    turned, place, metres = np.empty((3, 3)), np.empty((parents.shape[1], 3)), np.empty(parents.shape[1])
    for row in range(first, end):
        s, count = prototype[row], counts[prototype[row]]
        matrix_of(rotation, row, turned)
        place_nodes(shapes[s], parents[s], count, kinds[kind_of[row]], age[row], turned, place, metres)
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
def fill_terminals(  # type: ignore[no-untyped-def]
    shapes, parents, counts, kinds, kind_of, prototype, base, rotation, wanted, first, end, position, direction
):
    """Fill `position` (K, 3) and `direction` (K, 3) of nodes `wanted` of grown modules `first` to `end`."""
    turned, place, metres = np.empty((3, 3)), np.empty((parents.shape[1], 3)), np.empty(parents.shape[1])
    for row in range(first, end):
        s, node = prototype[row], wanted[row]
        kind = kinds[kind_of[row]]
        matrix_of(rotation, row, turned)
        place_nodes(shapes[s], parents[s], counts[s], kind, kind[0], turned, place, metres)
        bearer = parents[s, node]
        for axis in range(3):
            position[row, axis] = base[row, axis] + place[node, axis]
            direction[row, axis] = (place[node, axis] - place[bearer, axis]) / metres[node]


@compiled
def fill_nodes(  # type: ignore[no-untyped-def]
    shapes, parents, counts, kinds, kind_of, prototype, age, base, rotation, rows, start, first, end, position, length
):
    """Fill `position` (., 3) and `length` (.,) of the nodes of modules `rows[first:end]`, the k-th's from start[k]."""
    turned, place, metres = np.empty((3, 3)), np.empty((parents.shape[1], 3)), np.empty(parents.shape[1])
    for k in range(first, end):
        row = rows[k]
        s = prototype[row]
        matrix_of(rotation, row, turned)
        place_nodes(shapes[s], parents[s], counts[s], kinds[kind_of[row]], age[row], turned, place, metres)
        for node in range(counts[s]):
            length[start[k] + node] = metres[node]
            for axis in range(3):
                position[start[k] + node, axis] = base[row, axis] + place[node, axis]


@compiled
def add_pipes(  # type: ignore[no-untyped-def]
    births, thickness, parents, counts, disused_node, mature, thickening, kind, s, age, disused, borne, squared
):
    """Fill `squared` (N,) with the squared diameters of one module's nodes, m2: the pipe model from its terminals down.

    Parameters
    ----------
    borne : (N,) squared diameter of the root node of the module that each terminal bears, m2; -1: none.
    """
    count = counts[s]
    grown = min(age, mature[kind])
    for node in range(count):
        squared[node] = -1.0  # of no child yet
    for node in range(count - 1, -1, -1):
        if squared[node] < 0.0:  # a terminal
            share = min(1.0, max(0.0, grown / mature[kind] - births[s, node]) / (1.0 - births[s, node]))
            own = thickening[kind] * thickness[s, node] * share
            squared[node] = max(own * own, borne[node])
        if node == disused_node[s]:
            squared[node] += disused
        if node > 0:
            bearer = parents[s, node]
            squared[bearer] = max(squared[bearer], 0.0) + squared[node]


@compiled
def fill_diameters(  # type: ignore[no-untyped-def]
    births, thickness, parents, counts, disused_node, mature, thickening, kind_of_plant,
    plant_first, parent_of, node_of, prototype, age, disused, terminal_index, most_terminals,
    first, end, start, root_m, node_m,
):  # fmt: skip
    """Fill `root_m` (M,), diameters of the root nodes of the plants' modules, for plants `first` to `end`.

    `node_m` (.,) takes those of all nodes, module row's from start[row]; of no length: not wanted.
    """
    births, thickness, parents, counts = borrowed(births), borrowed(thickness), borrowed(parents), borrowed(counts)
    terminal_index = borrowed(terminal_index)
    n = parents.shape[1]
    squared, borne = np.empty(n), np.empty(n)
    joint = np.empty((0, most_terminals))
    for plant in range(first, end):
        begin, size = plant_first[plant], plant_first[plant + 1] - plant_first[plant]
        if size > len(joint):
            joint = np.empty((2 * size, most_terminals))
        joint[:size] = -1.0
        for own in range(size - 1, -1, -1):
            row = begin + own
            s = prototype[row]
            for node in range(counts[s]):
                slot = terminal_index[s, node]
                borne[node] = joint[own, slot] if slot >= 0 else -1.0
            add_pipes(
                births, thickness, parents, counts, disused_node, mature, thickening,
                kind_of_plant[plant], s, age[row], disused[row], borne, squared,
            )  # fmt: skip
            root_m[row] = np.sqrt(squared[0])
            if len(node_m):
                for node in range(counts[s]):
                    node_m[start[row] + node] = np.sqrt(squared[node])
            bearer = parent_of[row]
            if bearer >= 0:
                slot = terminal_index[prototype[begin + bearer], node_of[row]]
                joint[bearer, slot] = squared[0]


@compiled
def fill_sizes(  # type: ignore[no-untyped-def]
    shapes, parents, counts, kinds, births, thickness, disused_node, mature, thickening, next_sibling, first_child,
    terminal_index, most_terminals, leaf_area, kind_of_plant, plant_first, parent_of, node_of,
    prototype, age, disused, base, rotation, first, end, sizes,
):  # fmt: skip
    """Fill `sizes` (P, 6) of plants `first` to `end`, in the order of `PlantSizes`, less the number of modules."""
    shapes, parents, counts, kinds = borrowed(shapes), borrowed(parents), borrowed(counts), borrowed(kinds)
    births, thickness, first_child = borrowed(births), borrowed(thickness), borrowed(first_child)
    terminal_index = borrowed(terminal_index)
    n = parents.shape[1]
    turned, place, metres, borne = np.empty((3, 3)), np.empty((n, 3)), np.empty(n), np.empty(n)
    joint, squared = np.empty((0, most_terminals)), np.empty((0, n))
    child, bare = np.empty((0, most_terminals), dtype=np.int64), np.empty((0, most_terminals))
    low, high = np.empty(4), np.empty(4)
    half = np.sqrt(0.5)
    for plant in range(first, end):
        begin, size = plant_first[plant], plant_first[plant + 1] - plant_first[plant]
        if size == 0:  # an obstacle
            continue
        kind = kind_of_plant[plant]
        if size > len(joint):
            joint, squared = np.empty((2 * size, most_terminals)), np.empty((2 * size, n))
            child = np.empty((2 * size, most_terminals), dtype=np.int64)
            bare = np.empty((2 * size, most_terminals))
        joint[:size] = -1.0
        child[:size] = -1
        bare[:size] = 1.0
        low[:] = 0.0
        high[:] = 0.0
        height = volume = leaves = 0.0
        for own in range(size - 1, -1, -1):
            row = begin + own
            s = prototype[row]
            grown = min(1.0, age[row] / mature[kind])
            for node in range(counts[s]):
                slot = terminal_index[s, node]
                borne[node] = joint[own, slot] if slot >= 0 else -1.0
                if slot >= 0:
                    share = max(0.0, grown - births[s, node]) / (1.0 - births[s, node]) * thickness[s, node]
                    leaves += leaf_area[kind, s] * share * share * bare[own, slot]
            add_pipes(
                births, thickness, parents, counts, disused_node, mature, thickening,
                kind, s, age[row], disused[row], borne, squared[own],
            )  # fmt: skip
            if parent_of[row] >= 0:
                slot = terminal_index[prototype[begin + parent_of[row]], node_of[row]]
                joint[parent_of[row], slot] = squared[own, 0]
                child[parent_of[row], slot] = own
                bare[parent_of[row], slot] = 1.0 - grown
            matrix_of(rotation, row, turned)
            place_nodes(shapes[s], parents[s], counts[s], kinds[kind], age[row], turned, place, metres)
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
        sizes[plant, 2] = _trunk(
            shapes, parents, counts, kinds, next_sibling, first_child, terminal_index, kind,
            begin, prototype, age, base, rotation, squared, child, turned, place, metres,
        )  # fmt: skip
        sizes[plant, 3] = np.sqrt(squared[0, 0])
        sizes[plant, 4] = volume * np.pi / 12.0
        sizes[plant, 5] = leaves


@compiled
def _trunk(  # type: ignore[no-untyped-def]
    shapes, parents, counts, kinds, next_sibling, first_child, terminal_index, kind,
    begin, prototype, age, base, rotation, squared, child, turned, place, metres,
):  # fmt: skip
    """Diameter of the stem 1.3 m above the foot, metres; at the foot where it does not reach so high.

    The stem takes the thickest way at each fork, the first of equals.
    """
    own = 0
    while own >= 0:
        row = begin + own
        s = prototype[row]
        matrix_of(rotation, row, turned)
        place_nodes(shapes[s], parents[s], counts[s], kinds[kind], age[row], turned, place, metres)
        node = 0
        while first_child[s, node] >= 0:
            thickest = first_child[s, node]
            other = next_sibling[s, thickest]
            while other >= 0:
                if squared[own, other] > squared[own, thickest]:
                    thickest = other
                other = next_sibling[s, other]
            node = thickest
            if base[row, 2] + place[node, 2] >= 1.3:
                return np.sqrt(squared[own, node])
        own = child[own, terminal_index[s, node]]
    return np.sqrt(squared[0, 0])
