"""Far versions of a plant: fewer and larger organs, fewer twigs, straighter axes, the same leaf area and silhouette.

A level is chosen by what a pixel covers of the plant. Organs are pruned until one that remains is about as long as a
pixel, and enlarged so that their area stays exactly the same; thin twigs likewise. Which organs remain is random, a
part of every stretch of the plant, and nested: a coarser level's are among a finer level's. The box around the plant
stays: the outermost organs always remain, and none grows beyond it (Cook, R. L., Halstead, J., Planck, M., Ryu, D.
(2007). Stochastic simplification of aggregate detail. ACM Transactions on Graphics 26(3), article 79, section 3; its
correction of contrast, section 5, is for elements that differ in colour; ours share a material).

What remains of an organ that is much smaller than a pixel shows its area, its attitude and its place: each sheet
becomes one triangle along its longest extent, across its mean normal. Where an organ has many sheets, as a twig has
needles, some stand for the rest, wider by what is left out.

Wood is simplified as a skeleton, before it is meshed, which makes a far version cheaper to grow than a full one. Edge
collapse (geometry/simplify.py) took ten times as long as growing the plant; it serves mesh files.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from forestgen.core.randomness import child_rng
from forestgen.geometry.mesh import Bools, Floats, Ints, Mesh, concatenate, part_of
from forestgen.geometry.simplify import bodies
from forestgen.plants.skeleton import OrganPlacements, Skeleton

PIXEL_STEPS_M = (0.0, 0.2, 0.4)  # pixels for which versions are made; 0: all detail

_ORGAN_PIXELS = 0.7  # length of an enlarged organ
_TWIG_PIXELS = 0.1  # diameter of an enlarged twig
_BEND_PIXELS = 0.05  # an axis may be moved this far when it is straightened
_LEAST_ORGANS = 0.75  # share of the organs: half of them hide less of themselves, and cover 3% more in all
_LEAST_TWIGS = 1.0 / 64.0  # share of the twigs
_FEWEST_ORGANS = 200  # so many always remain: fewer would not stand for the rest
_NOT_WORTH = 0.85  # a larger share saves nothing
_STRETCH = 16  # organs of which the same share remains
_MOST_PASSES = 6
_DIRECTIONS = 200
TRIANGLE_PIXELS = 0.7  # sheets up to this long become triangles
_SMALLEST = 0.15  # of the largest sheet's area: smaller ones lend theirs to the others
_FEWEST_SHEETS = 24  # of an organ with many; fewer would cover one another less
_LONGER = 1.12  # a triangle than its sheet: so they hide one another as the sheets do (measured: spruce, poplar)
_ROUNDEST = 1.15  # greatest width over length of a triangle: equal sides


def level_for(pixel_m: Floats) -> Ints:
    """Index of ``PIXEL_STEPS_M`` for what a pixel covers of the plant in each view, metres; any shape."""
    return np.searchsorted(np.asarray(PIXEL_STEPS_M[1:]), pixel_m, side="right").astype(np.int64)


def simplified(skeleton: Skeleton, templates: Mapping[str, Mesh], pixel_m: float, rng: np.random.Generator) -> Skeleton:
    """A skeleton with the detail that shows where a pixel covers at least `pixel_m` of it, metres; 0: all.

    `skeleton`: at its final size, with all organs. `templates`: organ shapes by name. `rng`: decides what remains; the
    same for all levels of a plant, so that they are nested.
    """
    if pixel_m <= 0.0:
        return skeleton
    organ_rng, twig_rng = rng.spawn(2)
    organs = _pruned_organs(skeleton, templates, pixel_m, organ_rng)
    thinned = _pruned_twigs(replace(skeleton, organs=organs), pixel_m, twig_rng)
    return _straightened(thinned, pixel_m)


def _pruned_organs(
    skeleton: Skeleton, templates: Mapping[str, Mesh], pixel_m: float, rng: np.random.Generator
) -> tuple[OrganPlacements, ...]:
    boxes = [_boxes(one.frame, templates[one.shape]) for one in skeleton.organs]
    nodes = skeleton.position_m.astype(np.float64)
    low = np.min([nodes.min(axis=0), *(b.min(axis=0) for b, _ in boxes if len(b))], axis=0)
    high = np.max([nodes.max(axis=0), *(b.max(axis=0) for _, b in boxes if len(b))], axis=0)
    pruned = []
    for one, (lowest, highest), own in zip(skeleton.organs, boxes, rng.spawn(len(boxes)), strict=True):
        template = templates[one.shape]
        size = _sizes(one.frame)
        if not len(size):
            pruned.append(one)
            continue
        length = float(np.ptp(template.vertices_m, axis=0).max()) * float(np.sqrt(np.mean(size**2)))
        share = max((length / (_ORGAN_PIXELS * pixel_m)) ** 2, _LEAST_ORGANS, _FEWEST_ORGANS / len(size))
        if share > _NOT_WORTH:
            pruned.append(one)
            continue
        outermost = np.any((lowest <= low) | (highest >= high), axis=1)
        keep = (_keys(len(size), own) < share) | outermost
        # Area goes with the square of the size; the outermost stay as they are.
        others = keep & ~outermost
        growth = np.sqrt(np.sum(size[~outermost] ** 2) / max(np.sum(size[others] ** 2), 1e-30))
        frame = _enlarged(one.frame, template, np.where(outermost, 1.0, growth), low, high, keep)
        pruned.append(OrganPlacements(one.shape, frame, one.node[keep]))
    return tuple(pruned)


def mean_size(frame: NDArray[np.float32]) -> float:
    """Root mean square of the scale of (M, 3, 4) organ frames; 1 without organs."""
    return float(np.sqrt(np.mean(_sizes(frame) ** 2))) if len(frame) else 1.0


def _sizes(frame: NDArray[np.float32]) -> Floats:
    return np.asarray(np.cbrt(np.abs(np.linalg.det(frame[:, :, :3].astype(np.float64)))), dtype=np.float64)


def _support(template: Mesh) -> Floats:
    """(K, 3) the vertices that are outermost in some of many directions: what a turned organ's box depends on."""
    points = template.vertices_m.astype(np.float64)
    k = np.arange(_DIRECTIONS) + 0.5
    z, turn = 1.0 - 2.0 * k / _DIRECTIONS, np.pi * (1.0 + np.sqrt(5.0)) * k
    radius = np.sqrt(1.0 - z * z)
    direction = np.stack([radius * np.cos(turn), radius * np.sin(turn), z])
    return points[np.unique(np.argmax(points @ direction, axis=0))] if len(points) else np.zeros((1, 3))


def _keys(count: int, rng: np.random.Generator) -> Floats:
    """(count,) numbers in [0, 1), spread evenly over every stretch of neighbours: those below s are a share s."""
    stretches = -(-count // _STRETCH)
    order = rng.random((stretches, _STRETCH)).argsort(axis=1)
    keys: Floats = (order + rng.random((stretches, _STRETCH))) / _STRETCH
    return keys.reshape(-1)[:count]


def _boxes(frame: NDArray[np.float32], template: Mesh) -> tuple[Floats, Floats]:
    """Lowest and highest corner of every organ, (M, 3) each."""
    points = _support(template)
    low, high = np.empty((2, len(frame), 3))
    for axis in range(3):
        reach = frame[:, axis, :3].astype(np.float64) @ points.T
        low[:, axis] = reach.min(axis=1, initial=np.inf) + frame[:, axis, 3]
        high[:, axis] = reach.max(axis=1, initial=-np.inf) + frame[:, axis, 3]
    return low, high


def _enlarged(
    frame: NDArray[np.float32], template: Mesh, growth: Floats, low: Floats, high: Floats, keep: Bools
) -> NDArray[np.float32]:
    """The frames that remain, enlarged about the organ's middle, and moved back into the plant's box."""
    corners = template.vertices_m
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0)).astype(np.float64)
    linear = frame[keep, :, :3].astype(np.float64)
    factor = growth[keep, None]
    foot = frame[keep, :, 3] + (1.0 - factor) * (linear @ middle)
    out = np.concatenate([linear * factor[:, None], foot[:, :, None]], axis=2)
    lowest, highest = _boxes(out.astype(np.float32), template)
    out[:, :, 3] += np.maximum(low - lowest, 0.0) - np.maximum(highest - high, 0.0)
    return out.astype(np.float32)


def _pruned_twigs(skeleton: Skeleton, pixel_m: float, rng: np.random.Generator) -> Skeleton:
    """A share of the thin axes that bear no other, widened so that the area they show stays."""
    parent = skeleton.parent
    first, last = skeleton.axes()
    number = np.repeat(np.arange(len(first)), last - first)  # of each node's axis, 0, 1, 2, ...
    radius = np.maximum.reduceat(skeleton.radius_m, first).astype(np.float64)
    begins = first[parent[first] >= 0]
    bears = np.zeros(len(first), dtype=bool)
    bears[number[parent[begins]]] = True
    thin = ~bears & (skeleton.order[first] > 0) & (2.0 * radius < _TWIG_PIXELS * pixel_m)
    for column in skeleton.position_m.T:  # the outermost stay
        thin[number[[column.argmin(), column.argmax()]]] = False
    way = skeleton.position_m - skeleton.position_m[np.maximum(parent, 0)]
    segment = np.asarray(np.linalg.norm(way, axis=1) * skeleton.radius_m, dtype=np.float64)
    shown = np.bincount(number, weights=segment)
    if not shown[thin].any():  # also of axes without length
        return skeleton
    width = float(np.sum(shown[thin] * 2.0 * radius[thin]) / np.sum(shown[thin]))
    share = max(width / (_TWIG_PIXELS * pixel_m), _LEAST_TWIGS)
    kept = thin.copy()
    kept[thin] = _keys(int(thin.sum()), rng) < share
    if share > _NOT_WORTH or not kept.any():
        return skeleton
    growth = np.where(kept, shown[thin].sum() / shown[kept].sum(), 1.0)
    widened = replace(skeleton, radius_m=(skeleton.radius_m * growth[number]).astype(np.float32))
    return _without(widened, (thin & ~kept)[number])


def _straightened(skeleton: Skeleton, pixel_m: float) -> Skeleton:
    """Without the nodes that lie within a small part of a pixel of a straight line.

    A node that bears others goes only where its neighbours are closer than a pixel: what it bears hangs on the one
    before it then.
    """
    for turn in range(_MOST_PASSES):
        count = len(skeleton.parent)
        index = np.arange(count)
        chained = np.zeros(count, dtype=bool)  # the node before and the node behind are of the same axis
        chained[1:-1] = (skeleton.axis[:-2] == skeleton.axis[1:-1]) & (skeleton.axis[2:] == skeleton.axis[1:-1])
        children = np.bincount(skeleton.parent[1:], minlength=count)
        near = np.zeros(count, dtype=bool)
        near[1:-1] = np.linalg.norm(skeleton.position_m[2:] - skeleton.position_m[:-2], axis=1) < pixel_m
        able = np.flatnonzero(chained & ((children == 1) | near) & (index % 2 == turn % 2))
        before, after = skeleton.position_m[able - 1], skeleton.position_m[able + 1]
        way = (after - before).astype(np.float64)
        from_before = (skeleton.position_m[able] - before).astype(np.float64)
        share = np.clip(np.sum(from_before * way, axis=1) / np.maximum(np.sum(way * way, axis=1), 1e-30), 0.0, 1.0)
        bend = np.linalg.norm(from_before - share[:, None] * way, axis=1)
        straight = (1.0 - share) * skeleton.radius_m[able - 1] + share * skeleton.radius_m[able + 1]
        bend = np.maximum(bend, np.abs(skeleton.radius_m[able] - straight))
        gone = np.zeros(count, dtype=bool)
        gone[able[bend < _BEND_PIXELS * pixel_m]] = True
        if turn and not gone.any():
            break
        skeleton = _without(skeleton, gone)
    return skeleton


def _without(skeleton: Skeleton, gone: Bools) -> Skeleton:
    """The skeleton less some nodes; what hung on one of them hangs on the node before it."""
    if not gone.any():
        return skeleton
    holder = np.arange(len(gone))  # of what hangs on a node: itself, or the last node before it that stays
    while True:
        lost = gone[holder]
        if not lost.any():
            break
        holder[lost] = skeleton.parent[holder[lost]]
    keep = ~gone
    renumbered = (np.cumsum(keep) - 1)[holder].astype(np.int32)
    above = skeleton.parent[keep]
    return replace(
        skeleton,
        parent=np.where(above >= 0, renumbered[np.maximum(above, 0)], -1).astype(np.int32),
        position_m=skeleton.position_m[keep],
        radius_m=skeleton.radius_m[keep],
        order=skeleton.order[keep],
        axis=skeleton.axis[keep],
        organs=tuple(replace(one, node=renumbered[one.node]) for one in skeleton.organs),
        mark=None if skeleton.mark is None else skeleton.mark[keep],
    )


@dataclass(frozen=True)
class _Sheets:
    """The connected pieces of a mesh that have an edge."""

    faces: Bools  # (F,) faces of the mesh that belong to them
    area_m2: Floats  # (C,)
    centre_m: Floats  # (C, 3) of the area
    normal: Floats  # (C, 3) unit, the mean of the faces'
    along: Floats  # (C, 3) unit, across the normal, along the longest extent
    length_m: Floats  # (C,) that extent
    uv: NDArray[np.float32] | None  # (C, 2) mean


def far_piece(mesh: Mesh, pixel_m: float) -> Mesh:
    """A piece of an organ as it is seen where a pixel covers at least `pixel_m` of it; the area stays.

    Bodies without an edge, and sheets longer than `TRIANGLE_PIXELS`, stay as they are.
    """
    if pixel_m <= 0.0 or not mesh.triangles:
        return mesh
    sheets = _sheets(mesh, TRIANGLE_PIXELS * pixel_m)
    if not len(sheets.area_m2):
        return mesh
    chosen, width, length = _chosen(sheets)
    if len(chosen) >= np.count_nonzero(sheets.faces):
        return mesh
    slivers = _slivers(sheets, chosen, length, width)
    if sheets.faces.all():
        return slivers
    return concatenate([slivers, part_of(mesh, mesh.faces[~sheets.faces])])


def _chosen(sheets: _Sheets) -> tuple[Ints, Floats, Floats]:
    """Which sheets remain, and the width and length of the triangles that stand for all."""
    area = sheets.area_m2
    large = np.flatnonzero(area >= _SMALLEST * area.max())  # a leaf without its stalk
    length = np.maximum(sheets.length_m, 1e-9)
    slim = float(np.median(2.0 * area[large] / length[large] ** 2))  # width over length of a triangle
    count = max(slim / _ROUNDEST * len(large), float(min(_FEWEST_SHEETS, len(large))))
    order = np.argsort(child_rng(0, "far piece").random(len(large)))
    chosen = np.sort(large[order[: max(1, round(count))]])
    shown = area[chosen] * (area.sum() / area[chosen].sum())
    length = np.maximum(length[chosen], np.sqrt(2.0 * shown / _ROUNDEST))  # none is wider than long
    return chosen, 2.0 * shown / (_LONGER * length), _LONGER * length


def _sheets(mesh: Mesh, longest_m: float) -> _Sheets:
    faces = mesh.faces.astype(np.int64)
    points = mesh.vertices_m.astype(np.float64)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    of_vertex = bodies(len(points), faces)
    count = int(of_vertex.max(initial=-1)) + 1
    _, which, times = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    open_edge = times[which.reshape(-1)] == 1
    has_edge = np.zeros(count, dtype=bool)
    has_edge[of_vertex[edges[open_edge, 0]]] = True

    of_face = of_vertex[faces[:, 0]]
    a, b, c = (points[faces[:, k]] for k in range(3))
    cross = 0.5 * np.cross(b - a, c - a)
    face_area = np.linalg.norm(cross, axis=1)
    area = np.bincount(of_face, weights=face_area, minlength=count)
    weight = np.maximum(area, 1e-30)[:, None]
    centre = _sums(of_face, (a + b + c) / 3.0 * face_area[:, None], count) / weight
    spread = np.zeros((count, 3, 3))
    offset = points - centre[of_vertex]
    np.add.at(spread, of_vertex, offset[:, :, None] * offset[:, None, :])
    axes = np.linalg.eigh(spread)[1]
    normal = _sums(of_face, cross, count)
    size = np.linalg.norm(normal, axis=1)
    normal = np.where((size > 0.1 * area)[:, None], normal / np.maximum(size, 1e-30)[:, None], axes[:, :, 0])
    along = axes[:, :, 2] - np.sum(axes[:, :, 2] * normal, axis=1, keepdims=True) * normal
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-30)
    place = np.sum(offset * along[of_vertex], axis=1)
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(low, of_vertex, place)
    np.maximum.at(high, of_vertex, place)
    length = high - low
    chosen = has_edge & (length <= longest_m) & (area > 0.0) & (np.linalg.norm(along, axis=1) > 0.5)
    uv = None
    if mesh.uv is not None:
        vertices = np.maximum(np.bincount(of_vertex, minlength=count), 1)[:, None]
        uv = (_sums(of_vertex, mesh.uv.astype(np.float64), count) / vertices).astype(np.float32)[chosen]
    return _Sheets(chosen[of_face], area[chosen], centre[chosen], normal[chosen], along[chosen], length[chosen], uv)


def _sums(owner: Ints, values: Floats, count: int) -> Floats:
    """(count, K) sums of the (N, K) values of each owner."""
    return np.stack([np.bincount(owner, weights=column, minlength=count) for column in values.T], axis=1)


def _slivers(sheets: _Sheets, chosen: Ints, length: Floats, width: Floats) -> Mesh:
    """A triangle for each chosen sheet, its middle where the sheet's is."""
    along, normal, centre = sheets.along[chosen], sheets.normal[chosen], sheets.centre_m[chosen]
    tip = along * (length[:, None] / 3.0)
    side = np.cross(along, normal) * (0.5 * width[:, None])
    corners = np.stack([centre - tip - side, centre - tip + side, centre + 2.0 * tip], axis=1).astype(np.float32)
    return Mesh(
        corners.reshape(-1, 3),
        np.arange(3 * len(chosen), dtype=np.uint32).reshape(-1, 3),
        np.repeat(normal, 3, axis=0).astype(np.float32),
        None if sheets.uv is None else np.repeat(sheets.uv[chosen], 3, axis=0),
    )
