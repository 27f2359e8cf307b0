"""A tree of given sizes: height, crown width, stem diameter, crown base and leaf area.

A generator grows a plant of about the right height and width. Here it gets the other sizes too:

- Leaves: their number and their size share the change. Of what is too many, some are left out; of what is too few, some
  get others beside them. Leaves are fewer where others above shade them, of the tree itself and of neighbours like it.
- Stems below the crown lose most of their way aside: those of forests are straight. Where the species has a `sweep`,
  which bends stems, and no `crown_twigs`, they become straight up to the tip, and widths count from the stem.
- Heights are stretched apart above and below the crown's base, which is the height that 2% of the leaf area lie below,
  widths throughout, until the geometry's extents fit. Organs keep their attitude. Where a few long branches make the
  extents, the others are stretched further: leaves are as far from the axis as the species' `fullness` says. About a
  stem that is straight up to the tip, what is farthest at each height counts: a pointed crown stays pointed, and where
  the species says how `pointed` crowns are, they get that outline.
- Where the species has `crown_twigs`, they take the place of the thin wood and its leaves, and what has moved is fitted
  once more.
- Where the species has a `sweep`, all that is at a height moves aside by as much as the stem there.
- Wood is made thinner or thicker by a power of its radius, so that the stem has its diameter 1.3 m above the ground,
  flare included, and the finest twigs stay as they are. Then the stem gets its taper (`forestgen.core.stem_form`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from forestgen.community.tree_columns import HIGHEST_BASE
from forestgen.core.frames import BREAST_HEIGHT_M
from forestgen.core.parts import Part
from forestgen.core.stem_form import stem_radius_m
from forestgen.geometry.mesh import Floats, Ints, Mesh, surface_area_m2
from forestgen.plants.crown_twigs import (
    DARKEST,
    EXTINCTION,
    Leaves,
    fill_crown,
    first_stem,
    is_second_stem,
    middle_of_stems,
    rules_of_twigs,
)
from forestgen.plants.forks import FORKED
from forestgen.plants.organs.base import OrganForm
from forestgen.plants.skeleton import OrganPlacements, Skeleton
from forestgen.plants.stem_bend import Bend
from forestgen.plants.tree_size import TreeSize

if TYPE_CHECKING:
    from forestgen.plants.parameters import PlantParameters

BELOW_CROWN = 0.02  # share of the leaf area below the crown's base
_ROUNDS = 12
_LAYERS = 24  # of a crown that is filled within its reach at each height
_LEAF_SIZE = (0.5, 1.25)  # factor on the length of leaves; their number makes up for the rest
_SIZE_SHARE = 1.0 / 3.0  # of the leaf area's logarithm that goes into the length
_MOST_LEAVES = 8.0  # times as many leaves as the generator placed, in the mean of a crown
_STRAIGHTENED = 0.7  # of a stem's way aside, as it grew
_MOST_WIDENED = 2.0  # distances at one height, for the outline of a pointed crown
_MOST_FILLED = 1.5  # the stretch of what is next to the axis, over that of the farthest, less 1
_TWIG_RADIUS_M = 0.002  # wood this thin keeps its radius
_BRANCH = 0.8
_MEASURED_M = 2.0  # lower trees keep their thickness: breast height is among their tips
_POWER = (0.3, 3.0)  # of the radius
_LOWEST_BASE = 0.02  # of the crown, over the height, where heights are stretched apart


def stalk_materials(shapes: Mapping[str, OrganForm]) -> set[str | None]:
    """Materials of stalks alone, which are no blades though they are labelled leaf."""
    stalks = {getattr(shape, "stalk_material", None) for shape in shapes.values()}
    return stalks - {shape.material for shape in shapes.values()}


def blade_areas_m2(shapes: Mapping[str, OrganForm]) -> dict[str, float]:
    """Area of the blades of one organ of each shape, one side, at size 1: what `build.leaf_area_m2` counts."""
    stalks = stalk_materials(shapes)
    return {
        name: sum(
            surface_area_m2(piece.mesh)
            for piece in shape.pieces()
            if piece.part == Part.LEAF and piece.material not in stalks
        )
        for name, shape in shapes.items()
    }


@dataclass(frozen=True)
class FittedTree:
    """A tree at its sizes, and where what the generator grew has come to."""

    skeleton: Skeleton
    base: Ints  # (N,) the generator's node that bears each node, or is it
    stretches: tuple[Stretch | Bend, ...]  # of the generator's points, one after the other

    def points(self, points_m: Floats) -> Floats:
        """(M, 3) points of the generator's plant, stretched."""
        for stretch in self.stretches:
            points_m = stretch.points(points_m)
        return points_m


def fit_tree(
    skeleton: Skeleton, plant: PlantParameters, templates: Mapping[str, Mesh], size: TreeSize, rng: np.random.Generator
) -> FittedTree:
    """The tree at its sizes, its crown filled with twigs where the species has them."""
    blade = blade_areas_m2(plant.shapes)
    leafy = fit_leaves(skeleton, plant.shapes, size, rng)
    sweep = None if plant.wood.years is None else plant.wood.years.sweep
    about_stem = sweep is not None and plant.crown_twigs is None
    stretch = stretch_to(leafy, templates, blade, size, plant.fullness, about_stem, plant.pointed)
    made, base = _carried(leafy, stretch.points), np.arange(len(skeleton.parent))
    stretches: list[Stretch | Bend] = [stretch]
    leaves = _leaves(made, blade)
    rules = rules_of_twigs(plant.crown_twigs, plant.foliage, blade, size.height_m)
    if plant.crown_twigs is not None and rules and leaves.total_m2 > 0.0:
        made, base = fill_crown(made, plant.crown_twigs, rules, blade, leaves, rng)
        made = fit_leaves(made, plant.shapes, size, rng)
        stretches.append(stretch_to(made, templates, blade, size, plant.fullness))
        made = _carried(made, stretches[-1].points)
    if sweep is not None:
        stretches.append(Bend.of(sweep, size.height_m, rng.spawn(1)[0]))
        made = _carried(made, stretches[-1].points)
    return FittedTree(fit_wood(made, plant.wood.flare, size.dbh_m), base, tuple(stretches))


def _leaves(skeleton: Skeleton, blade: Mapping[str, float]) -> Leaves:
    place = [np.zeros((0, 3)), *(one.frame[:, :, 3].astype(np.float64) for one in skeleton.organs)]
    area = [np.zeros(0), *(_areas(one, blade) for one in skeleton.organs)]
    return Leaves(np.concatenate(place), np.concatenate(area))


def fit_leaves(
    skeleton: Skeleton, shapes: Mapping[str, OrganForm], size: TreeSize, rng: np.random.Generator
) -> Skeleton:
    """The skeleton with leaves of the tree's area; organs without blades stay."""
    blade = blade_areas_m2(shapes)
    leafy = [blade[one.shape] > 0.0 and len(one.node) > 0 for one in skeleton.organs]
    bearing = [one for one, has in zip(skeleton.organs, leafy, strict=True) if has]
    area = np.concatenate([np.zeros(1), *(_areas(one, blade) for one in bearing)])
    made = float(area.sum())
    if made <= 0.0:
        return skeleton
    ratio = size.leaf_area_m2 / made
    larger = float(np.clip(ratio**_SIZE_SHARE, *_LEAF_SIZE))
    height = np.concatenate([np.zeros(1), *(one.frame[:, 2, 3] for one in bearing)])
    light = _light(height, ratio * area / (0.25 * np.pi * size.crown_width_m**2))
    number = min(ratio / larger**2, _MOST_LEAVES) * light * made / float(area @ light)
    shares = iter(np.split(number[1:], np.cumsum([len(one.node) for one in bearing])[:-1]))
    organs = []
    for one, has in zip(skeleton.organs, leafy, strict=True):
        if has:
            frame = one.frame.copy()
            frame[:, :, :3] *= np.float32(larger)
            one = _numbered(replace(one, frame=frame), next(shares), skeleton, rng)
        organs.append(one)
    left = sum(float(np.sum(_areas(one, blade))) for one in organs)
    last = np.float32(np.clip(np.sqrt(size.leaf_area_m2 / left), 0.9, 1.1)) if left > 0.0 else np.float32(1.0)
    for one, has in zip(organs, leafy, strict=True):
        if has:
            one.frame[:, :, :3] *= last  # whole numbers of leaves are not all
    return replace(skeleton, organs=tuple(organs))


def _light(height: Floats, leaf_area_index: Floats) -> Floats:
    """(M,) share of the light that reaches each leaf through the leaf area index of all above it, by Beer's law."""
    order = np.argsort(-height, kind="stable")
    above = np.empty(len(height))
    above[order] = np.cumsum(leaf_area_index[order])
    depth = EXTINCTION * above
    return np.asarray(np.exp(-depth * min(1.0, DARKEST / max(float(depth.max()), 1e-9))))


def _areas(organs: OrganPlacements, blade: Mapping[str, float]) -> Floats:
    """(M,) blade area of each organ."""
    size = np.linalg.norm(organs.frame[:, :, 1].astype(np.float64), axis=1)
    return np.asarray(blade[organs.shape] * size**2)


def _numbered(organs: OrganPlacements, number: Floats, skeleton: Skeleton, rng: np.random.Generator) -> OrganPlacements:
    """So many times each organ, (M,): some of them, or some once more, turned and moved along their twig."""
    count = len(organs.node)
    share = (rng.permutation(count) + 0.5) / count  # an organ's own: more organs include those of fewer
    chosen = np.repeat(np.arange(count), np.floor(number + share).astype(np.int64))
    turn, along = rng.uniform(0.6, 2.0 * np.pi - 0.6, len(chosen)), rng.uniform(0.15, 0.85, len(chosen))
    first = np.ones(len(chosen), dtype=bool)
    first[1:] = chosen[1:] != chosen[:-1]
    frame, node = organs.frame[chosen], organs.node[chosen]
    more = ~first
    cos, sin = np.cos(turn[more]), np.sin(turn[more])
    x, y = frame[more, 0, :3].copy(), frame[more, 1, :3].copy()
    frame[more, 0, :3] = cos[:, None] * x - sin[:, None] * y
    frame[more, 1, :3] = sin[:, None] * x + cos[:, None] * y
    start = skeleton.position_m[np.maximum(skeleton.parent[node[more]], 0)]
    way = skeleton.position_m[node[more]] - start
    at = np.sum((frame[more, :, 3] - start) * way, axis=1) / np.maximum(np.sum(way * way, axis=1), 1e-12)
    frame[more, :, 3] += (along[more] - np.clip(at, 0.0, 1.0))[:, None].astype(np.float32) * way
    return OrganPlacements(organs.shape, frame.astype(np.float32), node)


@dataclass(frozen=True)
class Stretch:
    """Straighter along `stem_m`; widths times `wide`; heights below and above `knee`, which comes to `base`, apart.

    Distances r from the axis become reach (1 + fill) r / (reach + fill r), before widths change. The reach is that of
    the whole plant, or, of more than one height, at least that of all points there: none comes nearer to the axis but
    by the `outline`, which distances at each of these heights are multiplied by too.
    """

    wide: float
    fill: float
    reach_m: Floats  # (2, K) heights before the stretch, and how far from the axis points are there
    knee: float
    base: float
    raw_top: float
    top: float  # where `raw_top` comes to
    stem_m: Floats  # (K, 3) of the stem, upwards, whose way aside is made less; all above goes aside with its top
    straightened: float  # share of its way aside that goes
    outline: Floats  # (K,) factor on distances at the heights of `reach_m`

    def heights(self, z: Floats) -> Floats:
        above = self.base + (z - self.knee) * ((self.top - self.base) / (self.raw_top - self.knee))
        return np.where(z < self.knee, z * (self.base / self.knee), above)

    def about_stem(self, points: Floats) -> Floats:
        """(M, 2) x and y of points where the stem is straight."""
        aside = np.stack([np.interp(points[:, 2], self.stem_m[:, 2], self.stem_m[:, k]) for k in (0, 1)], axis=1)
        return np.asarray(points[:, :2] - self.straightened * aside)

    def points(self, points: Floats) -> Floats:
        """(M, 3) points stretched."""
        across = self.about_stem(points)
        away = np.hypot(across[:, :1], across[:, 1:])
        reach = np.interp(points[:, 2:], *self.reach_m)
        outline = np.interp(points[:, 2:], self.reach_m[0], self.outline)
        across *= self.wide * outline * (1.0 + self.fill) / (1.0 + self.fill * away / reach)
        return np.concatenate([across, self.heights(points[:, 2:])], axis=1)


def _carried(skeleton: Skeleton, points: Callable[[Floats], Floats]) -> Skeleton:
    """The skeleton at its moved places; organs keep their size and attitude."""
    moved = []
    for one in skeleton.organs:
        frame = one.frame.copy()
        frame[:, :, 3] = points(frame[:, :, 3].astype(np.float64))
        moved.append(replace(one, frame=frame))
    position_m = points(skeleton.position_m.astype(np.float64)).astype(np.float32)
    return replace(skeleton, position_m=position_m, organs=tuple(moved))


def stretch_to(
    skeleton: Skeleton,
    templates: Mapping[str, Mesh],
    blade: Mapping[str, float],
    size: TreeSize,
    fullness: float,
    about_stem: bool = False,
    pointed: float | None = None,
) -> Stretch:
    """What gives the skeleton, with its organs, the tree's height, crown width and crown base.

    `fullness`: see `plants.parameters.PlantParameters`. `about_stem`: widths count from the stem, which becomes
    straight, and the crown is filled within its reach at each height; otherwise from the foot, within one reach. Then
    `pointed` may say how wide it is there, see `PlantParameters`.
    """
    feet, low, high = organ_boxes(skeleton.organs, templates)
    area = np.concatenate([np.zeros(1), *(_areas(one, blade) for one in skeleton.organs)])
    nodes = skeleton.position_m.astype(np.float64)
    raw_top = max(float((feet + high)[:, 2].max()), float(nodes[:, 2].max()), 1e-6)
    middle = 0.5 * (low + high)[:, 2]
    found = _low_quantile(feet[:, 2] + middle, area)
    knee = float(np.clip(0.5 * raw_top if found is None else found, 0.05 * raw_top, 0.9 * raw_top))
    wanted = float(np.clip(size.crown_base_m, _LOWEST_BASE * size.height_m, HIGHEST_BASE * size.height_m))
    base = knee * size.height_m / raw_top if found is None else wanted
    wide = size.crown_width_m / max(_mean_width(nodes, feet + low, feet + high), 1e-6)
    stem, share = _stem_below(skeleton, raw_top if about_stem else knee), 1.0 if about_stem else _STRAIGHTENED
    stretch = Stretch(wide, 0.0, np.ones((2, 1)), knee, base, raw_top, size.height_m, stem, share, np.ones(1))
    reached = [np.column_stack([stretch.about_stem(one), one[:, 2]]) if about_stem else one for one in (nodes, feet)]
    reach_m = _reach(np.concatenate(reached), _LAYERS if about_stem else 1)
    outline = np.ones(reach_m.shape[1])
    if about_stem and pointed is not None and not is_second_stem(skeleton).any():
        below_top = np.clip((raw_top - reach_m[0]) / (raw_top - knee), 0.0, 1.0)
        outline = np.minimum(below_top**pointed * reach_m[1].max() / reach_m[1], _MOST_WIDENED)
        outline[reach_m[0] < knee] = 1.0
    stretch = replace(stretch, reach_m=reach_m, outline=outline)
    stretch = _filled(stretch, nodes, feet, area, fullness)
    wood, organs = (replace(stretch, wide=1.0).points(one)[:, :2] for one in (nodes, feet))
    span = max(_mean_width(wood, organs, organs), 1e-6)
    for _ in range(_ROUNDS):
        at = stretch.heights(feet[:, 2])
        top = max(float((at + high[:, 2]).max()), float(stretch.heights(nodes[:, 2]).max()))
        now = stretch.wide * organs
        width = _mean_width(stretch.wide * wood, now + low[:, :2], now + high[:, :2])
        wide = stretch.wide + (size.crown_width_m - width) / span
        if found is not None:
            made = _low_quantile(at + middle, area)
            base = float(np.clip(stretch.base + wanted - (made or 0.0), 0.2 * wanted, HIGHEST_BASE * stretch.top))
        stretch = replace(
            stretch,
            wide=float(np.clip(wide, 0.05 * stretch.wide, 20.0 * stretch.wide)),
            base=base,
            top=max(stretch.top + size.height_m - top, 0.2 * size.height_m, 1.02 * base),
        )
    return stretch


def _reach(points: Floats, layers: int) -> Floats:
    """(2, K) heights of layers, and the greatest distance of points from the axis in each and the two next to it."""
    top_m = max(float(points[:, 2].max()), 1e-6)
    layer = np.clip((points[:, 2] / top_m * layers).astype(np.int64), 0, layers - 1)
    reach = np.full(layers, 1e-6)
    np.maximum.at(reach, layer, np.hypot(points[:, 0], points[:, 1]))
    reach = np.pad(reach, 1)
    reach = np.maximum(np.maximum(reach[:-2], reach[2:]), reach[1:-1])
    return np.stack([(np.arange(layers) + 0.5) * top_m / layers, reach])


def _filled(stretch: Stretch, nodes: Floats, feet: Floats, area: Floats, fullness: float) -> Stretch:
    """The stretch with the least `fill` at which leaves are as far from the axis as `fullness` says."""
    if not area.any():
        return stretch
    low, high = 0.0, _MOST_FILLED
    for _ in range(8):
        middle = 0.5 * (low + high)
        tried = replace(stretch, fill=middle)
        wood, organs = tried.points(nodes), tried.points(feet)
        radius = 0.5 * max(_mean_width(wood, organs, organs), 1e-6)
        found = float(np.average(np.sum(organs[:, :2] ** 2, axis=1), weights=area)) / radius**2
        low, high = (middle, high) if found < fullness else (low, middle)
    return replace(stretch, fill=low)


def _stem_below(skeleton: Skeleton, height_m: float) -> Floats:
    """(K, 3) nodes of the stem up to a height, the height of each above those before."""
    nodes = middle_of_stems(skeleton)
    nodes = nodes[np.maximum.accumulate(nodes[:, 2]) == nodes[:, 2]]
    below = nodes[(nodes[:, 2] <= height_m) & (np.diff(nodes[:, 2], prepend=-1.0) > 0.0)]
    return below if len(below) else np.zeros((1, 3))


def _mean_width(nodes: Floats, low: Floats, high: Floats) -> float:
    """Mean of the extents in x and y of nodes and organs' boxes."""
    extents = [  # column by column: several times as fast as along the rows
        max(nodes[:, k].max(), high[:, k].max()) - min(nodes[:, k].min(), low[:, k].min()) for k in (0, 1)
    ]
    return float(0.5 * (extents[0] + extents[1]))


def organ_boxes(organs: Sequence[OrganPlacements], templates: Mapping[str, Mesh]) -> tuple[Floats, Floats, Floats]:
    """Feet of all organs and the corners of their boxes, relative to them, each (1 + M, 3); the first is the origin."""
    feet, low, high = [np.zeros((1, 3))], [np.zeros((1, 3))], [np.zeros((1, 3))]
    for placement in organs:
        points = templates[placement.shape].vertices_m.T
        reach = [placement.frame[:, k, :3] @ points for k in range(3)]  # axis by axis: contiguous, so faster
        feet.append(placement.frame[:, :, 3].astype(np.float64))
        low.append(np.stack([one.min(axis=1) for one in reach], axis=1).astype(np.float64))
        high.append(np.stack([one.max(axis=1) for one in reach], axis=1).astype(np.float64))
    return np.concatenate(feet), np.concatenate(low), np.concatenate(high)


def _low_quantile(height_m: Floats, area: Floats) -> float | None:
    """Height below which `BELOW_CROWN` of the area lies; None without leaves."""
    total = float(area.sum())
    if total <= 0.0:
        return None
    order = np.argsort(height_m, kind="stable")
    return float(height_m[order][np.searchsorted(np.cumsum(area[order]), BELOW_CROWN * total)])


def fit_wood(skeleton: Skeleton, flare: float, dbh_m: float) -> Skeleton:
    """Wood thinner or thicker, so that the stem has this diameter at breast height; the skeleton at its final size."""
    stem = first_stem(skeleton.axis)
    heights = np.maximum.accumulate(skeleton.position_m[stem, 2].astype(np.float64))
    radius = skeleton.radius_m.astype(np.float64)
    if not np.isfinite(dbh_m) or len(heights) < 2 or float(heights.max()) < _MEASURED_M:
        return skeleton
    twig = min(_TWIG_RADIUS_M, 0.1 * dbh_m)
    at = int(np.clip(np.searchsorted(heights, BREAST_HEIGHT_M), 1, len(heights) - 1))
    up = skeleton.position_m[stem][at].astype(np.float64) - skeleton.position_m[stem][at - 1]
    length = max(float(np.linalg.norm(up)), 1e-9)
    slant = np.sqrt(length / max(float(up[2]), 0.5 * length))  # a stem that leans is cut aslant

    def powered(power: float) -> Floats:
        return np.where(radius > twig, twig * (radius / twig) ** power, radius)

    def diameter(power: float) -> float:
        now = powered(power)[stem]
        widened = 1.0 + flare * np.exp(-BREAST_HEIGHT_M / (3.5 * max(float(now[0]), 1e-9)))
        return float(2.0 * np.interp(BREAST_HEIGHT_M, heights, now) * widened * slant)

    low, high = _POWER
    for _ in range(40):  # the diameter rises with the power
        middle = 0.5 * (low + high)
        low, high = (middle, high) if diameter(middle) < dbh_m else (low, middle)
    made = powered(low)
    thin = np.minimum(1.0, dbh_m / diameter(low))  # where no power is small enough
    branched = replace(skeleton, radius_m=(made * thin).astype(np.float32))
    top_m, inner_m = float(heights[-1]), dbh_m
    for _ in range(_ROUNDS):  # the diameter without the flare, which goes by the foot
        foot_m = float(stem_radius_m(np.zeros(1), top_m, inner_m)[0])
        inner_m = dbh_m / slant / (1.0 + flare * np.exp(-BREAST_HEIGHT_M / (3.5 * foot_m)))
    return with_taper(branched, top_m, inner_m)


def with_taper(skeleton: Skeleton, top_m: float, dbh_m: float) -> Skeleton:
    """The skeleton with the taper of a tree's first stem; no branch is thicker than `_BRANCH` times what bears it.

    `top_m`: of the whole tree, of which this may be a part. `dbh_m`: without a flare.
    """
    stem, radius = first_stem(skeleton.axis), skeleton.radius_m.astype(np.float64)
    heights = np.maximum.accumulate(skeleton.position_m[stem, 2].astype(np.float64))
    thinnest = min(_TWIG_RADIUS_M, 0.1 * dbh_m)
    radius[stem] = np.maximum(stem_radius_m(heights, top_m, dbh_m), thinnest)
    second = is_second_stem(skeleton)
    if second.any():
        fork_m = float(skeleton.position_m[skeleton.parent[np.argmax(second)], 2])
        above = (stem & (skeleton.position_m[:, 2] > fork_m)) | second
        own = FORKED * stem_radius_m(skeleton.position_m[above, 2].astype(np.float64), top_m, dbh_m)
        radius[above] = np.maximum(own, thinnest)
        stem = stem | second
    onward = skeleton.axis[np.maximum(skeleton.parent, 0)] == skeleton.axis
    most, parents, thick = np.where(onward, 1.0, _BRANCH).tolist(), skeleton.parent.tolist(), radius.tolist()
    for node in np.flatnonzero(~stem).tolist():
        thick[node] = min(thick[node], most[node] * thick[parents[node]])
    return replace(skeleton, radius_m=np.array(thick, dtype=np.float32))
