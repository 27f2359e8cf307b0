"""From a skeleton and its organs to meshes: swept wood and instanced blades.

Every axis is a closed tube of its own. A branch begins on the middle of the axis that bears it, deep inside, and comes
out through a collar: close rings that swell towards the bearer's surface, by each vertex' own distance from it, so that
the collar follows the bearer's curve and reaches further up in the axil. Stems that begin at the ground reach below it,
and flare. An axis that ends where others of like thickness begin ends in a dome.

`wood_meshes(..., plain=True)` leaves out flare, relief, collars and domes. The signed volume of its closed tubes is the
sum of the frusta of the polylines meshed (`branch_lines`, `stem_line`), within 2%: tips of twigs end in points, bends
above 120 degrees are pinched. Those polylines reach into the bearer and below the ground, which `Skeleton.volume_m3`
does not count. Flare and collars add to that what a real root collar and branch collars do; relief adds nothing on
average.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.geometry.mesh import Floats, Ints, Mesh, concatenate, instance, unit
from forestgen.geometry.sweep import Polylines, sides_for_radius, sweep_tubes
from forestgen.plants.collars import sweep_with_collars
from forestgen.plants.exemplar import OrganMesh
from forestgen.plants.levels import far_piece, mean_size
from forestgen.plants.parameters import OrganShape, Wood
from forestgen.plants.roots import StemRoots, roots_of
from forestgen.plants.skeleton import Skeleton
from forestgen.plants.stem_surface import surfaced
from forestgen.recipe.wood import Roots

MarkedMesh = tuple[Mesh, NDArray[np.uint32] | None]  # and (F,) marks of its triangles

_FOOT_M = 0.3  # stems reach this far below the ground, so that none hangs over a slope
_STANDS = 0.3  # least z of a stem's direction at its foot: one that lies on the ground gets no foot
_MESHED_FLARE_RADIUS_M = 0.012  # thinner stems get no flare and no bark relief
_FLARE_RINGS = np.array([0.0, 0.025, 0.06, 0.12, 0.22, 0.36, 0.55, 0.77, 1.0])  # shares of the flare's height
_POINTED_M = 0.002  # radius up to which an end is a point, which saves a third of a twig's triangles
_POINTED = 0.15  # the same as a share of the radius before
_ROOTS_REACH = 0.4  # of a crown's width, at most: the crown stays the widest
_SIDES_A_ROOT = 7  # of a stem at least
_FLUTED, _FLUTES_FADE = 0.06, 25.0  # how far ridges go on up a stem, over its radius; height at 1/e of that, in radii
# Of a stem's lumps, waves round and up it: how many round it, length up it in metres, and size over the radius.
# None changes the girth, and none is shorter than twice the distance of most stems' rings; ours.
_LUMPS = ((1, 2.3, 0.04), (2, -1.6, 0.045), (3, 3.7, 0.03))
_DOMED = 0.4  # an axis that ends where another of this share of its radius begins gets a dome


def wood_meshes(
    skeleton: Skeleton,
    trunk: bool,
    flare: float,
    *,
    height_ratio: float = 1.0,
    tile_m: tuple[float, float] = (1.0, 1.0),
    plain: bool = False,
    foot_m: tuple[float, float] = (0.0, np.inf),
    roots: Roots | None = None,
) -> list[MarkedMesh]:
    """Closed tubes of the stems (`trunk`) or of all branches, and (F,) marks if the skeleton has some.

    Parameters
    ----------
    flare : widening of stems at the root collar, as a share of the radius.
    height_ratio : height over width of the branches' sections; stems are round.
    tile_m : extent of one repeat of the bark's texture, round and along an axis.
    plain : tubes as measured: no flare, relief, collars or domes.
    foot_m : of the branches, those alone whose diameter at the foot is within (first included, second not).
    roots : of the stems, above the ground.
    """
    made: list[MarkedMesh] = []

    def add(mesh: Mesh, start: Ints, line: Polylines, node: Ints) -> None:
        """A mesh of tubes, where each tube's vertices begin, and the polylines and their nodes that they follow."""
        mark = skeleton.mark
        made.append((mesh, None if mark is None else tube_marks(mesh, start, line, mark[node], tile_m[1])))

    first, last = skeleton.axes()
    standing = (skeleton.order[first] == 0) & (skeleton.parent[first] <= 0)
    bears = _bears_at_its_end(skeleton, first, last) & (not plain)
    if trunk:
        for a, b, forks in zip(first[standing], last[standing], bears[standing], strict=True):
            own = stem_line(skeleton, int(a), int(b))
            ringed = own if plain else stem_line(skeleton, int(a), int(b), rings=True)
            if own is not None and ringed is not None:
                grown = None if plain else _roots(skeleton, roots, own)
                mesh = _stem(_domed(ringed, np.array([forks])), flare, tile_m, plain, grown)
                add(mesh, np.array([0, len(mesh.vertices_m)]), own, _stem_nodes(skeleton, int(a), own))
                if grown is not None:
                    mesh, mark = grown.mesh(own.points_m[1], tile_m), skeleton.mark
                    made.append((mesh, None if mark is None else np.full(mesh.triangles, mark[a], dtype=np.uint32)))
    chosen = ~standing & ((skeleton.order[first] == 0) == trunk) & ~skeleton.is_thread()
    if not trunk:
        foot = 2.0 * skeleton.radius_m[first]
        chosen &= (foot >= foot_m[0]) & (foot < foot_m[1])
    if np.any(chosen):
        own = branch_lines(skeleton, first[chosen], last[chosen])
        lines = _domed(own, bears[chosen])
        ratio = 1.0 if trunk else height_ratio
        look: dict[str, Any] = {"pointed": _is_pointed(lines), "height_ratio": ratio, "tile_m": tile_m}
        if plain:
            mesh, start = sweep_tubes(lines, sides_for_radius(lines.radius_m[lines.offset[:-1]]), **look)
        else:
            mesh, start = sweep_with_collars(skeleton, lines, skeleton.parent[first[chosen]], **look)
        add(mesh, start, own, _branch_nodes(skeleton, first[chosen], last[chosen]))
    return made


def organ_meshes(
    skeleton: Skeleton, shapes: Mapping[str, OrganShape], wood: Wood, *, pixel_m: float = 0.0
) -> tuple[OrganMesh, ...]:
    """All surfaces of a plant, one mesh per part and material; empty ones are left out.

    `pixel_m`: what a pixel covers of the plant, metres; 0 is all detail.
    """
    parts: dict[tuple[Part, str], list[MarkedMesh]] = {}
    stem, limb = (Part.DEAD_WOOD, Part.DEAD_WOOD) if wood.dead else (Part.TRUNK, Part.BRANCH)
    years = None if wood.dead else wood.years
    roots = None if wood.years is None or pixel_m > 0.0 else wood.years.roots
    parts[stem, wood.material] = wood_meshes(skeleton, True, wood.flare, tile_m=wood.bark_tile_m, roots=roots)
    thick = np.inf if wood.thick_branch_m is None else wood.thick_branch_m
    for foot_m, material, tile_m in (
        ((0.0, thick), wood.branch_material or wood.material, wood.branch_tile_m),
        ((thick, np.inf), wood.material, wood.bark_tile_m),
    ):
        ratio, plain = wood.branch_height_ratio, pixel_m > 0.0  # collars do not show from far
        branches = wood_meshes(skeleton, False, 0.0, height_ratio=ratio, tile_m=tile_m, plain=plain, foot_m=foot_m)
        parts.setdefault((limb, material), []).extend(branches)
    owner = {key: [np.full(mesh.triangles, -1, np.int32) for mesh, _ in found] for key, found in parts.items()}
    first = 0
    for placement in skeleton.organs:
        organ_pixel_m = pixel_m / mean_size(placement.frame) if pixel_m else 0.0
        for piece in shapes[placement.shape].pieces():
            mesh = far_piece(piece.mesh, organ_pixel_m)
            mark = None if skeleton.mark is None else np.repeat(skeleton.mark[placement.node], mesh.triangles)
            key = piece.part, piece.material
            parts.setdefault(key, []).append((instance(mesh, placement.frame), mark))
            number = np.arange(first, first + len(placement.node), dtype=np.int32)
            owner.setdefault(key, []).append(np.repeat(number, mesh.triangles))
        first += len(placement.node)
    made = []
    for (part, material), found in parts.items():
        if not any(mesh.triangles for mesh, _ in found):
            continue
        mesh, marks = concatenate([one for one, _ in found]), [mark for _, mark in found if mark is not None]
        organ = np.concatenate(owner[part, material])
        mark = np.concatenate(marks) if len(marks) == len(found) else None
        organ_mesh = OrganMesh(part, material, mesh, mark, organ if organ.max() >= 0 else None)
        if part == stem and years is not None:
            made += surfaced(organ_mesh, years, float(skeleton.radius_m[0]), pixel_m, wood.bark_tile_m)
        else:
            made.append(organ_mesh)
    return tuple(made)


def _roots(skeleton: Skeleton, law: Roots | None, line: Polylines) -> StemRoots | None:
    """The roots of a stem, none of which reaches beyond the crown."""
    if law is None or not _is_standing(line.points_m):
        return None
    return roots_of(
        law, float(line.radius_m[0]), _ROOTS_REACH * float(np.ptp(skeleton.position_m[:, :2], axis=0).min())
    )


def branch_lines(skeleton: Skeleton, first: Ints, last: Ints) -> Polylines:
    """Axes from the middle of the axis that bears them, so that no gap shows, to their tips.

    `first`, `last`: (A,) first node of each axis, and one beyond its last.
    """
    offset = np.concatenate([[0], np.cumsum(last - first + 1)]).astype(np.int64)
    foot = offset[:-1]
    index = _branch_nodes(skeleton, first, last)
    radius = skeleton.radius_m[index].astype(np.float64)
    radius[foot] = radius[foot + 1]
    return Polylines(skeleton.position_m[index].astype(np.float64), radius, offset)


def _branch_nodes(skeleton: Skeleton, first: Ints, last: Ints) -> Ints:
    """Nodes along the lines of branches: of each the one that bears it, and its own."""
    lengths = last - first + 1
    offset = np.cumsum(lengths) - lengths
    index = np.arange(lengths.sum()) - np.repeat(offset, lengths) + np.repeat(first - 1, lengths)
    index[offset] = skeleton.parent[first]
    return np.asarray(index, dtype=np.int64)


def _stem_nodes(skeleton: Skeleton, first: int, line: Polylines) -> Ints:
    """Nodes along a stem's line without rings; the part below the ground is that of its foot."""
    own = np.flatnonzero(skeleton.axis == skeleton.axis[first])
    if skeleton.parent[first] >= 0:
        own = np.concatenate([[skeleton.parent[first]], own])
    below = len(line.radius_m) - len(own)
    return np.asarray(np.concatenate([np.repeat(own[:1], below), own]), dtype=np.int64)


def stem_line(skeleton: Skeleton, first: int, last: int, *, rings: bool = False) -> Polylines | None:
    """A stem from below the ground, with close `rings` where the root collar flares; None if it has no length."""
    index = np.arange(first, last)
    if skeleton.parent[first] >= 0:
        index = np.concatenate([[skeleton.parent[first]], index])
    if len(index) < 2:
        return None
    points = skeleton.position_m[index].astype(np.float64)
    radius = skeleton.radius_m[index].astype(np.float64)
    if skeleton.parent[first] >= 0:  # a further stem of a clump has its own girth at the common foot
        radius[0] = radius[1]
    if rings and radius[0] > _MESHED_FLARE_RADIUS_M:
        points, radius = _with_flare_rings(points, radius)
    if _is_standing(points):
        points = np.concatenate([points[:1] - _FOOT_M * unit(points[1] - points[0]), points])
        radius = np.concatenate([radius[:1], radius])
    return Polylines(points, radius, np.array([0, len(points)]))


def _with_flare_rings(points: Floats, radius: Floats) -> tuple[Floats, Floats]:
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    stops = np.union1d(arc, _FLARE_RINGS * min(14.0 * radius[0], 0.5 * arc[-1]))
    stops = np.array(_apart(stops.tolist(), 0.3 * float(radius[0])))  # slivers would show in the shading
    line = np.stack([np.interp(stops, arc, points[:, k]) for k in range(3)], axis=1)
    return line, np.interp(stops, arc, radius)


def _apart(stops: list[float], least_m: float) -> list[float]:
    """The first of the ascending stops, those at least so far from the one kept before, and the last."""
    kept = stops[:1]
    for stop in stops[1:-1]:
        if stop - kept[-1] >= least_m and stops[-1] - stop >= 0.5 * least_m:
            kept.append(stop)
    return [*kept, stops[-1]]


def _stem(line: Polylines, flare: float, tile_m: tuple[float, float], plain: bool, roots: StemRoots | None) -> Mesh:
    """A stem with its flare, whose ridges run into the main roots, and faint relief further up."""
    base = float(line.radius_m[0])
    sides = sides_for_radius(line.radius_m[:1])
    pointed = _is_pointed(line)
    if base < _MESHED_FLARE_RADIUS_M or plain:
        return sweep_tubes(line, sides, pointed=pointed, tile_m=tile_m)[0]
    sides = np.maximum(3 * sides // 2, 16)  # the stem's outline is what one sees from near
    if roots is not None:
        sides = np.maximum(sides, _SIDES_A_ROOT * len(roots.azimuth_rad))
    step = np.linalg.norm(np.diff(line.points_m, axis=0), axis=1)
    height = np.concatenate([[0.0], np.cumsum(step)]) - (_FOOT_M if _is_standing(line.points_m) else 0.0)
    count = int(sides[0])
    angle = np.arange(count) * (2.0 * np.pi / count)
    phase = 40.0 * line.points_m[min(8, len(height) - 1), :2]  # differs from tree to tree, needs no random number
    near_ground = np.exp(-np.maximum(height, 0.0) / (3.5 * base))[:, None]
    if roots is None:
        ridges = 1.0 + 0.55 * np.cos(5.0 * angle + phase[0]) + 0.35 * np.cos(3.0 * angle + phase[1])
    else:
        ridges = roots.ridges(angle.astype(np.float64))
    factor = 1.0 + flare * near_ground * ridges
    for k, (around, length_m, size) in enumerate(_LUMPS):
        turn = around * angle + (2.0 * np.pi / length_m) * height[:, None]
        factor += size * np.sin(turn + (k + 1.0) * phase[0] + k * phase[1])
    if roots is not None:
        factor += roots.widening(angle.astype(np.float64), np.maximum(height, 0.0).astype(np.float64))
        factor += _FLUTED * np.exp(-np.maximum(height, 0.0) / (_FLUTES_FADE * base))[:, None] * (ridges - 1.0)
    return sweep_tubes(line, sides, pointed=pointed, radial_factor=factor, tile_m=tile_m)[0]


def _bears_at_its_end(skeleton: Skeleton, first: Ints, last: Ints) -> NDArray[np.bool_]:
    """Which axes end in a node that bears another axis of like thickness."""
    bearer = skeleton.parent[first]
    alike = (bearer >= 0) & (skeleton.radius_m[first] >= _DOMED * skeleton.radius_m[bearer])
    return np.asarray(np.isin(last - 1, bearer[alike]), dtype=np.bool_)


def _domed(lines: Polylines, chosen: NDArray[np.bool_]) -> Polylines:
    """The chosen lines with two more points each: a dome in two steps on their flat ends."""
    if not np.any(chosen):
        return lines
    end = lines.offset[1:][chosen] - 1
    along = unit(lines.points_m[end] - lines.points_m[end - 1]) * lines.radius_m[end, None]
    half = np.sqrt(0.5)
    points = (lines.points_m[end, None] + along[:, None] * np.array([half, 1.0])[:, None]).reshape(-1, 3)
    radius = (lines.radius_m[end, None] * np.array([half, 0.0])).reshape(-1)
    at = np.repeat(end + 1, 2)
    offset = lines.offset + 2 * np.concatenate([[0], np.cumsum(chosen)])
    return Polylines(np.insert(lines.points_m, at, points, axis=0), np.insert(lines.radius_m, at, radius), offset)


def _is_standing(points: Floats) -> bool:
    """Whether a stem rises from the ground, rather than lying on it or growing down."""
    return bool(unit(points[1] - points[0])[2] > _STANDS)


def _is_pointed(lines: Polylines) -> NDArray[np.bool_]:
    end = lines.offset[1:] - 1
    return lines.radius_m[end] <= np.maximum(_POINTED_M, _POINTED * lines.radius_m[end - 1])


def tube_marks(
    mesh: Mesh, vertex_start: Ints, lines: Polylines, mark: NDArray[np.uint32], tile_m: float
) -> NDArray[np.uint32]:
    """(F,) marks of the triangles of swept tubes: of the segment beside which each lies.

    A tube's texture runs along it by arc length, which tells the segment; caps have a texture of their own, and are
    their ends'.

    `vertex_start`: (A + 1,) where each tube's vertices begin, see `sweep_tubes`. `lines`: the A polylines that tubes
    follow; they may be finer, and go on beyond the ends. `mark`: (P,) of the segment that each point of `lines` ends; a
    line's first is that of its second. `tile_m`: metres along a tube for which the texture runs from 0 to 1.
    """
    if not mesh.triangles or mesh.uv is None:
        return np.zeros(mesh.triangles, dtype=np.uint32)
    tube = np.searchsorted(vertex_start, mesh.faces[:, 0].astype(np.int64), side="right") - 1
    step = np.linalg.norm(np.diff(lines.points_m, axis=0, prepend=lines.points_m[:1]), axis=1)
    step[lines.offset[:-1]] = 0.0
    total = np.cumsum(step)
    begin, end = total[lines.offset[:-1]], total[lines.offset[1:] - 1]
    along = mesh.uv[:, 1].astype(np.float64)[mesh.faces].mean(axis=1) * tile_m
    place = np.clip(begin[tube] + along, begin[tube], end[tube])
    first, last = lines.offset[:-1][tube] + 1, lines.offset[1:][tube] - 1
    point = np.clip(np.searchsorted(total, place, side="left"), first, last)
    centre = mesh.vertices_m.astype(np.float64)[mesh.faces].mean(axis=1)
    share = (total[point] - place) / np.maximum(step[point], 1e-12)
    beside = lines.points_m[point] + np.clip(share, 0.0, 1.0)[:, None] * (
        lines.points_m[point - 1] - lines.points_m[point]
    )
    at_end = np.linalg.norm(centre - lines.points_m[last], axis=1) < np.linalg.norm(centre - beside, axis=1)
    return np.asarray(mark[np.where(at_end, last, point)], dtype=np.uint32)
