"""Twigs that fill the crown of a tree: what a generator leaves between its branches.

The generator's branches end where they are as thin as a twig. From there twigs grow to points spread evenly in the
crown, each from the branch or the twig that it reaches by the shortest way (a minimum spanning tree whose costs count
the way from the branch too: Cuntz, H., Forstner, F., Borst, A., Häusser, M. (2010). One rule to grow them all. PLoS
Computational Biology 6(8), e1000877). So every leaf sits on a twig, and leaves fill the crown as those of real trees.

The crown is the hull of the generator's own leaves about the stem, by height and azimuth. Fewer points lie where others
shade them: of a share v of the crown's volume, counted from above, the leaf area index a(v) follows
da/dv = c exp(-k a), which is solved by a = ln(1 + (exp(k L) - 1) v) / k. L is the crown's leaf area over its ground
area, k the extinction of light.

Crowns of most broad-leaved trees are round above: where the hull is narrower than half an ellipsoid above its widest
place, it is widened, by `dome` of the difference. The generators' branches, which end as they please, leave cones.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.core.compiled import compiled
from forestgen.geometry.mesh import Bools, Floats, Ints, unit
from forestgen.plants.foliage import Foliage, place
from forestgen.plants.skeleton import Skeleton
from forestgen.recipe.curves import evaluate, evaluate_one
from forestgen.recipe.fields import Fraction, Section

TWIG_ORDER = 100  # branch order of all twigs
EXTINCTION = 0.25  # of light by leaf area: half of it is seen, of which half acts as if at random
DARKEST = 4.0  # optical depth of a crown, as of a leaf area index of 16; the lowest leaves of denser ones live on
_LAYERS, _SECTORS = 12, 8  # of the hull's measurement
_LOBES = 12  # round the crown
_FINER = 6  # times as many for its volume
_UNEVEN = 0.25  # of points' mean distance, standard deviation by which they are moved at random
_IN_SPRAY, _CLOSER = 8, 0.45  # twigs of a spray, and how far they come together along its longer sides
_NEAREST = 12  # nodes of branches that a point may be reached from
TURN_COST = 0.6  # of a way straight back, as a share of its length
PATH_COST = 0.35  # of the way from the branch to where a twig begins
THICK_COST = 5.0  # of a bearer's radius
_PIPE = 0.42  # power of the number of tips in a twig's radius
_FEWEST, _MOST = 6, 15_000  # twigs: the time goes with their square
# Of evenly spread points: powers of 1/g, g⁴ = g + 1 (Roberts, M. (2018). The unreasonable effectiveness of
# quasirandom sequences).
_SPREAD = np.array([0.8191725133961645, 0.6710436067037893, 0.5497004779019703])


class CrownTwigs(Section):
    """Twigs between a tree's branches. Rules of `foliage` with the order 100 say where leaves sit on them."""

    replaces_below_m: float = Field(
        gt=0, le=0.5, description="branches that the generator grows thinner make way, metres"
    )
    taller_than_m: float = Field(5.0, ge=2, description="lower trees keep the generator's wood and leaves")
    leaves_each: float = Field(gt=0, le=1000, description="leaves of a twig; with the leaf area, their number")
    diameter_m: float = Field(0.0024, gt=0, le=0.02, description="of a twig's tip, metres")
    bend: float = Field(0.5, ge=0, le=1, description="how far a twig sets out along its bearer, not straight ahead")
    dome: float = Field(0.0, ge=0, le=1, description="how far the crown is filled up to half an ellipsoid above")
    lobes: float = Field(
        0.0, ge=0, le=0.5, description="standard deviation of the logarithm of the crown's radius, from lobe to lobe"
    )
    droop: float = Field(0.0, ge=-1, le=1, description="how far twigs rather grow down than up; negative: up")
    level: float = Field(0.0, ge=0, le=4, description="how far twigs rather grow level: flat sprays in tiers")
    sprays: Fraction = Field(0.0, description="how far twigs gather in sprays")
    spray_flat: float = Field(2.5, gt=0, le=10, description="width of sprays over their height; below 1: hanging")


def rules_of_twigs(
    twigs: CrownTwigs | None, foliage: Iterable[Foliage], blade_m2: Mapping[str, float], height_m: float
) -> list[Foliage]:
    """The rules of organs for a crown of twigs: leaves on them alone, other organs where they are; none: no twigs."""
    if twigs is None or height_m < twigs.taller_than_m:
        return []
    suited = [rule for rule in foliage if rule.suits(height_m)]
    on_twigs = [rule.model_copy(update={"orders": (TWIG_ORDER,)}) for rule in suited if TWIG_ORDER in rule.orders]
    if not any(blade_m2[rule.shape] > 0.0 for rule in on_twigs):
        return []
    return on_twigs + [rule for rule in suited if TWIG_ORDER not in rule.orders and not blade_m2[rule.shape] > 0.0]


def fill_crown(
    skeleton: Skeleton,
    twigs: CrownTwigs,
    rules: Sequence[Foliage],
    blade_m2: Mapping[str, float],
    leaves: Leaves,
    rng: np.random.Generator,
) -> tuple[Skeleton, Ints]:
    """The tree with twigs and leaves in place of its generator's; and the node of the given one that bears each node.

    `skeleton`: at its final size. `rules`: see `rules_of_twigs`. `blade_m2`: of an organ of each shape at size 1.
    `leaves`: those that the tree has so far.

    Raises `RecipeError`: more leaves than memory holds.
    """
    height_m = float(skeleton.position_m[:, 2].max())
    wood, kept = _branches(skeleton, twigs.replaces_below_m)
    wanted = leaves.total_m2 / (twigs.leaves_each * _leaf_m2(rules, blade_m2, height_m))
    count, extinct_m2 = round(float(np.clip(wanted, _FEWEST, _MOST))), EXTINCTION * leaves.total_m2
    position = leaves.position_m - _stem_at(wood, leaves.position_m[:, 2])
    hull = _hull(replace(leaves, position_m=position), twigs.dome)
    tips, apart_m = hull.lobed(twigs.lobes, rng).spread(count, extinct_m2, rng)
    tips += _stem_at(wood, tips[:, 2])
    tips = _gathered(tips, twigs.sprays, twigs.spray_flat)
    tips = np.concatenate([_beyond_ends(wood, apart_m), tips])
    grown, base = _grown(wood, *_spanned(wood, tips, twigs), twigs)
    organs = tuple(place(rule, grown, height_m, rng) for rule in rules)
    return replace(grown, organs=organs), kept[base]


def _gathered(tips: Floats, share: float, flat: float) -> Floats:
    """(T, 3) points moved towards the middle of their group, which is so many times as wide as high."""
    from scipy.spatial import cKDTree  # slow to import

    if share == 0.0:
        return tips
    scale = np.array([1.0, 1.0, flat])
    middles = tips[: max(len(tips) // _IN_SPRAY, 1)]  # the first of evenly spread points are evenly spread
    group = cKDTree(middles * scale).query(tips * scale)[1]
    return np.asarray(tips + share * np.minimum(_CLOSER * scale / scale.min(), 1.0) * (middles[group] - tips))


def _stem_at(skeleton: Skeleton, height_m: Floats) -> Floats:
    """(M, 3) how far the stem is aside of the tree's foot at heights, in x and y; 0 in z."""
    stem = middle_of_stems(skeleton)
    stem = stem[np.argsort(stem[:, 2], kind="stable")]
    x, y = (np.interp(height_m, stem[:, 2], stem[:, k]) for k in (0, 1))
    return np.stack([x, y, np.zeros_like(x)], axis=1)


def _leaf_m2(rules: Sequence[Foliage], blade_m2: Mapping[str, float], height_m: float) -> float:
    """Area of a leaf of the first rule that has any."""
    rule = next(rule for rule in rules if blade_m2[rule.shape] > 0.0)
    share = evaluate(rule.size, np.linspace(0.0, 1.0, 11)) * evaluate_one(rule.size_by_height, height_m)
    return float(blade_m2[rule.shape]) * max(float(np.mean(share**2)), 1e-6)


@dataclass(frozen=True)
class Leaves:
    """Where a tree's leaves are."""

    position_m: Floats  # (M, 3)
    area_m2: Floats  # (M,) one side

    @property
    def total_m2(self) -> float:
        return float(self.area_m2.sum())


@dataclass(frozen=True)
class _Hull:
    """A crown's radius about its stem, by height and azimuth."""

    low_m: float
    high_m: float
    radius_m: Floats  # (L, S) in layers from below, closed at both ends, and sectors from x on

    def lobed(self, deviation: float, rng: np.random.Generator) -> _Hull:
        """The hull with lobes and bays, of the same volume."""
        from scipy.ndimage import map_coordinates  # slow to import

        if deviation == 0.0:
            return self
        layers, sectors = self.radius_m.shape
        noise = rng.spawn(1)[0].normal(size=(_LAYERS, _LOBES))
        noise = np.pad(np.pad(noise, ((1, 1), (0, 0)), mode="edge"), ((0, 0), (1, 1)), mode="wrap")
        layer_at, sector_at = (
            (np.arange(many) + 0.5) * few / many + 0.5 for many, few in ((layers, _LAYERS), (sectors, _LOBES))
        )
        waves = map_coordinates(noise, np.stack(np.meshgrid(layer_at, sector_at, indexing="ij")), order=1)
        radius = self.radius_m * np.exp(deviation * waves / waves.std())
        return replace(self, radius_m=radius * np.sqrt(np.sum(self.radius_m**2) / np.sum(radius**2)))

    def spread(self, count: int, extinct_m2: float, rng: np.random.Generator) -> tuple[Floats, float]:
        """(count, 3) points, even but for shade, and their distance; `extinct_m2`: leaf area times extinction."""
        # Moved before the crown's shade and width stretch them: else layers of the even points show where they are few.
        u = (rng.random(3) + np.arange(1, count + 1)[:, None] * _SPREAD) % 1.0
        u += _UNEVEN * count ** (-1.0 / 3.0) * rng.normal(size=u.shape)
        u[:, 1] %= 1.0
        u[:, [0, 2]] = np.abs(1.0 - np.abs(1.0 - np.abs(u[:, [0, 2]])))  # mirrored at 0 and 1
        area = self.radius_m[::-1] ** 2 * (np.pi / self.radius_m.shape[1])  # layers from above
        above = np.append(0.0, np.cumsum(area.sum(axis=1))) / area.sum()
        shade = float(np.clip(extinct_m2 / area.sum(axis=1).max(), 1e-6, DARKEST))
        depth = np.interp(np.expm1(shade * u[:, 0]) / np.expm1(shade), above, np.arange(len(area) + 1))
        layer = np.minimum(depth.astype(np.int64), len(area) - 1)
        up_to = np.cumsum(area[layer], axis=1) / np.sum(area[layer], axis=1, keepdims=True)
        sector = np.sum(u[:, 1:2] >= up_to[:, :-1], axis=1)
        each = np.diff(up_to, axis=1, prepend=0.0)[np.arange(count), sector]
        turn = sector + 1.0 - (up_to[np.arange(count), sector] - u[:, 1]) / each
        away = self.radius_m[::-1][layer, sector] * np.sqrt(u[:, 2])
        angle = 2.0 * np.pi * turn / self.radius_m.shape[1]
        height = self.high_m - (self.high_m - self.low_m) * depth / len(area)
        points = np.stack([away * np.cos(angle), away * np.sin(angle), height], axis=1)
        apart_m = np.cbrt(float(area.sum()) * (self.high_m - self.low_m) / len(area) / count)
        return points, apart_m


def _hull(leaves: Leaves, dome: float = 0.0) -> _Hull:
    """The hull of leaves, its lobes half as deep, and its top round as `CrownTwigs.dome` says."""
    from scipy.ndimage import map_coordinates  # slow to import

    leaf_m, leaf_area = leaves.position_m, leaves.area_m2
    order = np.argsort(leaf_m[:, 2])
    share = np.cumsum(leaf_area[order]) / leaf_area.sum()
    low = float(leaf_m[order[np.searchsorted(share, 0.01)], 2])
    high = max(float(leaf_m[order[-1], 2]), low + 1e-3)
    layer = np.clip(((leaf_m[:, 2] - low) / (high - low) * _LAYERS).astype(np.int64), 0, _LAYERS - 1)
    turn = np.arctan2(leaf_m[:, 1], leaf_m[:, 0]) / (2.0 * np.pi) % 1.0
    sector = np.minimum((turn * _SECTORS).astype(np.int64), _SECTORS - 1)
    reach = np.zeros((_LAYERS, _SECTORS))
    np.maximum.at(reach, (layer, sector), np.hypot(leaf_m[:, 0], leaf_m[:, 1]))
    reach = 0.5 * reach + 0.5 * reach.mean(axis=1, keepdims=True)
    beside = np.pad(np.pad(reach, ((1, 1), (0, 0)), mode="edge"), ((0, 0), (1, 1)), mode="wrap")
    reach = 0.25 * (beside[:-2, 1:-1] + 2.0 * reach + beside[2:, 1:-1])
    reach += dome * np.maximum(_domed(reach.mean(axis=1)) - reach.mean(axis=1), 0.0)[:, None]
    edged = np.pad(np.pad(reach, ((1, 1), (0, 0))), ((0, 0), (1, 1)), mode="wrap")
    middles = np.concatenate([[0.0], np.arange(_LAYERS) + 0.5, [float(_LAYERS)]])
    layer_at = np.interp((np.arange(_LAYERS * _FINER) + 0.5) / _FINER, middles, np.arange(_LAYERS + 2))
    sector_at = (np.arange(_SECTORS * _FINER) + 0.5) / _FINER + 0.5
    fine = map_coordinates(edged, np.stack(np.meshgrid(layer_at, sector_at, indexing="ij")), order=1)
    return _Hull(low, high, np.maximum(fine, 0.02 * fine.max() + 1e-6))


def _domed(radius_m: Floats) -> Floats:
    """(L,) radii of half an ellipsoid on the widest of (L,) layers, which are counted from below; 0 under it."""
    widest = int(np.argmax(radius_m))
    up = np.clip(np.arange(len(radius_m)) - widest, 0, None) / (len(radius_m) - widest)
    return np.where(np.arange(len(radius_m)) < widest, 0.0, radius_m[widest] * np.sqrt(1.0 - up**2))


def first_stem(axis: NDArray[np.int32]) -> Bools:
    """(N,) nodes of the first stem of a skeleton, its foot too."""
    own: Bools = axis == axis[min(1, len(axis) - 1)]
    own[0] = True
    return own


def is_second_stem(skeleton: Skeleton) -> Bools:
    """(N,) nodes of stems that begin on the first one, above its foot."""
    first, last = skeleton.axes()
    stem = first_stem(skeleton.axis)
    bearer = skeleton.parent[first]
    own = (skeleton.order[first] == 0) & ~stem[first] & (bearer > 0) & stem[np.maximum(bearer, 0)]
    return np.repeat(own, last - first)


def middle_of_stems(skeleton: Skeleton) -> Floats:
    """(K, 3) nodes of the first stem; above a fork in the middle between both stems."""
    points, second = skeleton.position_m.astype(np.float64), is_second_stem(skeleton)
    stem = points[first_stem(skeleton.axis)]
    if second.any():
        other = points[second]
        other = np.concatenate([points[skeleton.parent[[np.argmax(second)]]], other])
        other = other[np.argsort(other[:, 2], kind="stable")]
        above = stem[:, 2] > other[0, 2]
        for k in (0, 1):
            stem[above, k] = 0.5 * (stem[above, k] + np.interp(stem[above, 2], other[:, 2], other[:, k]))
    return stem


def _branches(skeleton: Skeleton, thinnest_m: float) -> tuple[Skeleton, Ints]:
    """The stem, and what on it is at least so thick, without organs; and the numbers of its nodes."""
    kept: Bools = (2.0 * skeleton.radius_m >= thinnest_m) | first_stem(skeleton.axis)
    for one in range(1, len(kept)):
        kept[one] &= kept[skeleton.parent[one]]
    node = np.flatnonzero(kept)
    number = np.cumsum(kept) - 1
    parent = np.where(node > 0, number[np.maximum(skeleton.parent[node], 0)], -1)
    axis = np.unique(skeleton.axis[node], return_inverse=True)[1]
    mark = None if skeleton.mark is None else skeleton.mark[node]
    of = skeleton.position_m[node], skeleton.radius_m[node], skeleton.order[node]
    return Skeleton.of(parent, *of, axis, mark=mark), node


def _beyond_ends(wood: Skeleton, way_m: float) -> Floats:
    """(E, 3) points straight ahead of where branches end, so that none is left without a twig; of too many, some."""
    ends = np.setdiff1d(np.arange(1, len(wood.parent)), wood.parent)
    ends = ends[:: 1 + len(ends) // _MOST]
    position = wood.position_m.astype(np.float64)
    beyond = position[ends] + 0.6 * way_m * unit(position[ends] - position[wood.parent[ends]])
    beyond[:, 2] = np.maximum(beyond[:, 2], 0.5 * position[ends, 2])  # never below the ground
    return np.asarray(beyond)


@compiled
def _way_cost(start: Floats, end: Floats, ahead: Floats, droop: float, level: float) -> Any:
    """Length of a way, more if it turns back from `ahead`, the bearer's direction, or runs against `droop`, or is
    steeper than level by `level`, but for what the bearer is.
    """
    x, y, z = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    length = np.sqrt(x * x + y * y + z * z) + 1e-9
    back = 1.0 - (x * ahead[0] + y * ahead[1] + z * ahead[2]) / length
    wrong = 1.0 + np.sign(droop) * z / length
    steep = min(abs(z) / length, abs(z / length - ahead[2]))
    return length * (1.0 + 0.5 * TURN_COST * back + 0.5 * abs(droop) * wrong + level * steep)


@compiled
def _span(position, ahead, radius, near, tips, droop, level):  # type: ignore[no-untyped-def]
    """The order in which tips are reached, and what bears each: a node, or the number of nodes plus a tip's rank.

    `position`, `ahead`, `radius`: (N, 3), (N, 3), (N,) of nodes. `near`: (T, K) nodes that tips may be reached from.
    """
    many, count = len(position), len(tips)
    order, bearer = np.empty(count, np.int64), np.empty(count, np.int64)
    least, path = np.full(count, np.inf), np.zeros(count)
    waiting = np.arange(count)
    for i in range(count):
        for node in near[i]:
            cost = _way_cost(position[node], tips[i], ahead[node], droop, level) + THICK_COST * radius[node]
            if cost < least[i]:
                least[i], bearer[i] = cost, node
    ahead_of_tip = np.empty(3)
    for rank in range(count):
        at = 0
        for k in range(count - rank):
            if least[waiting[k]] < least[waiting[at]]:
                at = k
        here = waiting[at]
        waiting[at] = waiting[count - rank - 1]
        order[rank] = here
        inner = bearer[here] >= many
        start = tips[order[bearer[here] - many]] if inner else position[bearer[here]]
        x, y, z = tips[here, 0] - start[0], tips[here, 1] - start[1], tips[here, 2] - start[2]
        length = np.sqrt(x * x + y * y + z * z) + 1e-9
        ahead_of_tip[0], ahead_of_tip[1], ahead_of_tip[2] = x / length, y / length, z / length
        path[rank] = length + (path[bearer[here] - many] if inner else 0.0)
        for k in range(count - rank - 1):
            other = waiting[k]
            cost = _way_cost(tips[here], tips[other], ahead_of_tip, droop, level) + PATH_COST * path[rank]
            if cost < least[other]:
                least[other], bearer[other] = cost, many + rank
    return order, bearer[order]


def _spanned(wood: Skeleton, tips: Floats, twigs: CrownTwigs) -> tuple[Floats, Ints]:
    """The (T, 3) tips, bearers first, and (T,) what bears each: a node of the wood, or their number plus a tip's."""
    from scipy.spatial import cKDTree  # slow to import

    position = wood.position_m.astype(np.float64)
    ahead = unit(position - position[np.maximum(wood.parent, 0)])
    near = np.asarray(cKDTree(position).query(tips, k=np.arange(1, min(_NEAREST, len(position)) + 1))[1])
    order, bearer = _span(position, ahead, wood.radius_m.astype(np.float64), near, tips, twigs.droop, twigs.level)
    return tips[order], bearer


def _grown(wood: Skeleton, tips: Floats, bearer: Ints, twigs: CrownTwigs) -> tuple[Skeleton, Ints]:
    """The wood with its twigs, each an axis of two segments; and the wood's node that each node comes from."""
    many, count = len(wood.parent), len(tips)
    borne = np.ones(count)  # tips that a twig bears, its own too
    for one in range(count - 1, -1, -1):
        if bearer[one] >= many:
            borne[bearer[one] - many] += borne[one]
    last = many + 2 * np.arange(count) + 1
    inner, twig = bearer >= many, np.maximum(bearer - many, 0)
    start = np.where(inner, last[twig], bearer)
    parent = np.append(wood.parent.astype(np.int64), np.stack([start, last - 1], axis=1))
    position = np.concatenate([wood.position_m.astype(np.float64), np.repeat(tips, 2, axis=0)])
    way = tips - position[start]
    ahead = np.where(inner[:, None], way[twig], position[start] - position[np.maximum(parent[start], 0)])
    out = unit(unit(way) + twigs.bend * unit(ahead))
    position[last - 1] += 0.25 * np.linalg.norm(way, axis=1, keepdims=True) * out - 0.75 * way
    radius = np.append(wood.radius_m, 0.5 * twigs.diameter_m * np.stack([borne, np.maximum(borne - 1, 1)], 1) ** _PIPE)
    base = np.append(np.arange(many), np.zeros(2 * count, np.int64))
    for at, end in zip(start.tolist(), last.tolist(), strict=True):
        radius[end - 1 : end + 1] = np.minimum(radius[end - 1 : end + 1], radius[at])
        base[end - 1 : end + 1] = base[at]
    axis = np.append(wood.axis, int(wood.axis.max()) + 1 + np.repeat(np.arange(count), 2))
    order = np.append(wood.order, np.full(2 * count, TWIG_ORDER))
    mark = None if wood.mark is None else wood.mark[base]
    return Skeleton.of(parent, position, radius, order, axis, mark=mark), base
