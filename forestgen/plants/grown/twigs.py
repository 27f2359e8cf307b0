"""Twigs on the wood of branch modules, and their leaves."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import unit
from forestgen.plants.branching import Grown, Shoots, around, grow, lateral_sites
from forestgen.plants.budget import check_budget
from forestgen.plants.foliage import place
from forestgen.plants.generators.branch_modules import FIRST_TWIG_ORDER, Bearing, Parameters
from forestgen.plants.generators.silhouette import Order
from forestgen.plants.grown.wood import ClothedWood, ModuleWood, wood_skeleton
from forestgen.plants.skeleton import Skeleton
from forestgen.recipe.curves import evaluate, evaluate_one

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_TWIG_BYTES = 5000  # of a twig with its side twigs, while it is meshed
_DEAD_TWIG_YR = 4.0  # after which half of a dead plant's twigs have fallen
_PARENT_SHARE = 0.7  # a twig is at most this share of the radius of what bears it


def clothed(parameters: Parameters, wood: ModuleWood, height_m: float, rng: np.random.Generator) -> Skeleton:
    """The plant's wood with its twigs and leaves.

    Parameters
    ----------
    wood : the plant's skeletal graph.
    height_m : of the plant, by which rules of foliage and sizes are chosen.

    Raises
    ------
    RecipeError : more twigs or leaves than memory holds.
    """
    wood_rng, twig_rng, foliage_rng = rng.spawn(3)
    bearing = parameters.bearing if parameters.twigs else None
    growth = 1.0 if bearing is None else max(evaluate_one(bearing.size_by_height, height_m), 1e-3)
    chosen = np.zeros(len(wood), dtype=bool)
    spacing_m = 1.0
    if bearing is not None:
        chosen = (wood.diameter_m < bearing.thinner_than_m) & (wood.age_yr < bearing.younger_than_yr)
        spacing_m = bearing.spacing_m * growth
        length = np.linalg.norm(wood.position_m - wood.position_m[np.maximum(wood.parent, 0)], axis=1)
        twigs = float(np.sum(length[chosen])) / spacing_m * bearing.per_node
        check_budget("twigs", twigs, _TWIG_BYTES, "a larger bearing.spacing_m, a smaller bearing.thinner_than_m")
    dressed = wood_skeleton(wood, chosen, spacing_m, smooth=parameters.smooth, crook=parameters.crook, rng=wood_rng)
    skeleton = dressed.skeleton
    if bearing is not None:
        left = 1.0 if wood.dead_yr is None else 0.5 ** (wood.dead_yr / _DEAD_TWIG_YR)
        skeleton = _with_twigs(dressed, bearing, parameters.twigs, growth, left, twig_rng)
    rules = [rule for rule in parameters.foliage if rule.suits(height_m)]
    organs = tuple(place(rule, skeleton, height_m, foliage_rng) for rule in rules)
    return replace(skeleton, organs=organs)


def _with_twigs(
    dressed: ClothedWood,
    bearing: Bearing,
    orders: tuple[Order, ...],
    growth: float,
    left: float,
    rng: np.random.Generator,
) -> Skeleton:
    wood = dressed.skeleton
    shoots = _first_shoots(dressed, bearing, orders[0].longest_m, growth, left, rng)
    nodes: list[tuple[NDArray[Any], ...]] = [(wood.parent, wood.position_m, wood.radius_m, wood.order, wood.axis)]
    size, axes = len(wood.parent), int(wood.axis[-1]) + 1
    radius_of, mark_of = wood.radius_m.astype(np.float64), wood.mark
    for number, rules in enumerate(orders):
        if not len(shoots.length_m):
            break
        grown = grow(shoots, rules, rng)
        radius = _radius(rules, grown, shoots, _PARENT_SHARE * radius_of[shoots.parent])
        index = size + np.arange(len(grown.axis))
        parent = index - 1
        parent[grown.first] = shoots.parent
        mark = None if mark_of is None else mark_of[shoots.parent][grown.axis]
        order = np.full(len(index), FIRST_TWIG_ORDER + number, dtype=np.uint8)
        nodes.append((parent, grown.position_m, radius, order, axes + grown.axis))
        size, axes = size + len(index), axes + len(grown.first)
        radius_of = np.concatenate([radius_of, radius])
        mark_of = None if mark_of is None or mark is None else np.concatenate([mark_of, mark])
        if number + 1 < len(orders):
            shoots = _side_shoots(grown, rules, orders[number + 1].longest_m, index, rng)
    columns = [np.concatenate(column) for column in zip(*nodes, strict=True)]
    return Skeleton(
        parent=columns[0].astype(np.int32),
        position_m=columns[1].astype(np.float32),
        radius_m=columns[2].astype(np.float32),
        order=columns[3].astype(np.uint8),
        axis=columns[4].astype(np.int32),
        mark=mark_of,
    )


def _first_shoots(
    dressed: ClothedWood, bearing: Bearing, longest_m: float, growth: float, left: float, rng: np.random.Generator
) -> Shoots:
    """Twigs along the wood, and those that go on from free terminals; the share `left` of them, always the same."""
    wood = dressed.skeleton
    side = np.flatnonzero(dressed.bears & np.isin(wood.order, bearing.orders))
    node = np.repeat(side, bearing.per_node)
    member = np.tile(np.arange(bearing.per_node), len(side))
    kept = rng.random(len(node)) >= bearing.missing
    node, member = node[kept], member[kept]
    tangent = _tangents(wood)
    axis, rank = wood.axis[node], np.repeat(_rank_on_axis(wood.axis[side].astype(np.int64)), bearing.per_node)[kept]
    phase = rng.uniform(0.0, 2.0 * np.pi, int(wood.axis[-1]) + 1)[axis]
    azimuth = np.where(bearing.planar, np.round(phase / (2.0 * np.pi)) * np.pi, phase)
    azimuth = azimuth + np.radians(bearing.phyllotaxis_deg) * rank + 2.0 * np.pi * member / bearing.per_node
    azimuth = azimuth + np.radians(bearing.phyllotaxis_jitter_deg) * rng.normal(size=len(node))
    angle = np.radians(bearing.angle_deg + bearing.angle_jitter_deg * rng.normal(size=len(node)))
    direction = around(tangent[node], azimuth, angle)
    if bearing.terminal:
        ends = np.flatnonzero(dressed.free)
        node, direction = np.concatenate([node, ends]), np.concatenate([direction, tangent[ends]])
    length = _lengths(dressed, bearing, node, rng) * min(growth, 1.0) * longest_m
    if left < 1.0:
        stays = rng.random(len(node)) < left
        node, direction, length = node[stays], direction[stays], length[stays]
    return Shoots(wood.position_m[node].astype(np.float64), direction, np.minimum(length, longest_m), node)


def _rank_on_axis(axis: Ints) -> Ints:
    """(N,) how many nodes of the same axis come before each: phyllotaxis counts those that bear, no others."""
    order = np.argsort(axis, kind="stable")
    ordered = axis[order]
    rank = np.empty(len(axis), dtype=np.int64)
    rank[order] = np.arange(len(axis)) - np.searchsorted(ordered, ordered)
    return rank


def _lengths(dressed: ClothedWood, bearing: Bearing, node: Ints, rng: np.random.Generator) -> Floats:
    """Share of the longest twig's length."""
    thick = 2.0 * dressed.skeleton.radius_m[node] / bearing.thinner_than_m
    share = evaluate(bearing.age_length, dressed.age_share[node]) * evaluate(bearing.light_length, dressed.light[node])
    share = share * evaluate(bearing.thick_length, np.clip(thick, 0.0, 1.0))
    return share * np.clip(1.0 + bearing.length_jitter * rng.normal(size=len(node)), 0.3, 1.4)


def _tangents(wood: Skeleton) -> Floats:
    position = wood.position_m.astype(np.float64)
    return unit(position - position[np.maximum(wood.parent, 0)])


def _side_shoots(grown: Grown, rules: Order, longest_m: float, index: Ints, rng: np.random.Generator) -> Shoots:
    """Twigs on the twigs of one order, as L-system 6.1 has them."""
    sites = lateral_sites(grown, rules, rng)
    share = evaluate(rules.branch_length, grown.relative[sites.node])
    length = longest_m * share * np.clip(1.0 + rules.branch_length_jitter * rng.normal(size=len(share)), 0.3, 1.4)
    length = np.minimum(length, np.minimum(longest_m, 0.9 * grown.remaining_m[sites.node] + rules.shortest_m))
    chosen = (length >= rules.shortest_m) & (rng.random(len(length)) >= rules.missing)
    node = sites.node[chosen]
    return Shoots(grown.position_m[node], sites.direction[chosen], length[chosen], index[node])


def _radius(rules: Order, grown: Grown, shoots: Shoots, cap_m: Floats) -> Floats:
    """A short twig is the top of a longer one, and no thicker than what bears it allows."""
    radius = 0.5 * evaluate(rules.diameter_m, grown.relative)
    foot = 0.5 * evaluate(rules.diameter_m, np.clip(1.0 - shoots.length_m / rules.longest_m, 0.0, 1.0))
    return np.asarray(radius * np.minimum(1.0, cap_m / np.maximum(foot, 1e-9))[grown.axis])
