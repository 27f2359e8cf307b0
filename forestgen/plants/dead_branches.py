"""Dead branches below the living crown of a tree: branches that shade has killed, and what has broken off since.

The base of the crown rises as a stand grows, and the branches below it die. A branch at a height h, which is the depth
d = b - h below the lowest living branch, was at the base of the crown when that was at h. It was then

    L = longest x R x (1/3 + 2/3 h / b)

long, R being the radius of the crown today: crowns were narrower. Of that

    L exp(-E (d / keeps)^2)        E: of each branch, gamma with the mean 1 and shape 2

is left, in the median half at d = 0.91 keeps: dead branches keep their length at first, and break as they rot. Of all
branches exp(-d / gone) are left: over the others the stem has closed. Branches of Scots pine die 7 years after they
cease to grow, and a stem takes more than 40 years to close over them (Mäkinen 1999, Canadian Journal of Forest Research
29, 585-594), in which the tree grows by 10 m.

The sizes of spruce, pine and birch give the dry mass that Repola found in Finland (2009, Silva Fennica 43, 625-647;
2008, ibid. 42, 605-624) within a factor of two: tests/unit/plants/test_dead_branches.py.

Their course has kinks, where a fork once went the other way, and they are thinner beyond; they sag, and their tips turn
up. Those that have lost their tip end in a splinter. The stem forms a collar of its own bark around each. Kinks, sags
and collars are ours.

Far versions of a plant have no twigs, no collars and no stubs shorter than a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from forestgen.core.parts import Part
from forestgen.geometry.mesh import Bools, Floats, Ints, Mesh, concatenate, unit
from forestgen.geometry.sweep import Polylines, sides_for_radius, sweep_tubes
from forestgen.plants.crown_twigs import TWIG_ORDER, first_stem, is_second_stem
from forestgen.plants.exemplar import OrganMesh
from forestgen.plants.parameters import Wood
from forestgen.plants.skeleton import Skeleton
from forestgen.plants.tree_size import TreeSize
from forestgen.recipe.wood import DeadBranches

_LOWEST_M = 0.15  # of a whorl
_LEAST_M = 0.015  # of a stub, from the bark
_LOWEST_SHARE = 0.03  # of the living branches' sections, which may be below the lowest
_MOST = 0.9  # of the crown's radius: the living crown stays the widest
_NODES, _TWIG_NODES = 9, 3  # of a branch, of a twig
_MOST_SIDES = 5
_THIN_M = 0.004  # radius: thinner branches have every other node, no collar and no splinter
_CROOKED_DEG, _KINK_DEG = 9.0, 20.0  # standard deviation of the turn from node to node, and at a kink
_KINKS = 0.3  # share of the nodes
_BUTT = np.array([1.5, 1.2, 1.05])  # radius at the first nodes: branches are thick where they leave the stem
_LOST = 0.12  # of the radius, at a kink; `thickness` is that beyond the first
_UNEVEN = 0.15  # standard deviation of the logarithm of the radius
_UPTURN_DEG = 40.0  # of a whole branch's tip
_SPLINTER = (2.4, 0.8)  # ahead and aside, over the radius at the break
_COLLAR = np.array([[0.0, 2.1], [1.0, 1.9], [2.0, 1.35], [3.2, 0.85]])  # way from the bark, radius; over the branch's
_COLLAR_TILE_M = 0.12  # of the bark's texture, round a collar
_ANGLE_DEG = 7.0  # of the angle to the stem
_TAPER = 0.75  # of a whole branch's radius, lost up to its tip
_TWIG_LENGTH, _TWIG_ANGLE_DEG, _TWIG_DROOP_DEG = 0.5, 58.0, 35.0  # over what is left of the branch beyond; ...
_TWIG_M, _LEAST_TWIG_M = 0.0045, 0.06  # diameter at the foot, length
_TWIGS_KEEP = 0.6  # of the depth by which branches keep their length


def dead_branches(
    skeleton: Skeleton, law: DeadBranches, wood: Wood, tree: TreeSize, pixel_m: float, rng: np.random.Generator
) -> tuple[OrganMesh, ...]:
    """The dead branches of a tree, the first mesh, and the stem's collars around them; none: it has none.

    `skeleton`: of the living tree, at its final size. `wood`: the barks of its stem. `pixel_m`: what a pixel covers of
    the plant, metres; 0: all.
    """
    stem = _Stem.of(skeleton)
    base_m = max(tree.crown_base_m, _lowest_branch_m(skeleton))
    at_rng, form_rng, twig_rng = rng.spawn(3)
    height_m, thin = _places(law, base_m, at_rng)
    depth_m = base_m - height_m
    whole_m = law.longest * 0.5 * tree.crown_width_m * (1.0 / 3.0 + 2.0 / 3.0 * height_m / base_m) * thin
    whole_m = np.minimum(whole_m * form_rng.uniform(0.6, 1.2, len(whole_m)), _MOST * 0.5 * tree.crown_width_m)
    left_m = whole_m * np.exp(-form_rng.gamma(2.0, 0.5, len(whole_m)) * (depth_m / law.keeps_m) ** 2)
    left_m = np.maximum(left_m, _LEAST_M)
    kept = (form_rng.random(len(whole_m)) < np.exp(-depth_m / law.gone_m)) & (left_m >= pixel_m)
    branches = _Branches.of(stem, law, height_m, whole_m, left_m, form_rng).at(np.flatnonzero(kept))
    if not len(branches.left_m):
        return ()
    is_near, tile_m = pixel_m <= 0.0, law.tile_m or (1.0, 1.0)
    lines, sides, pointed = branches.tubes(is_near)
    meshes = [sweep_tubes(lines, sides, pointed=pointed, tile_m=tile_m)[0]]
    if not is_near:
        return (OrganMesh(Part.BRANCH, law.material, meshes[0]),)
    if law.twigs_per_m > 0.0:
        twigs = _twigs(branches, law, (base_m - branches.height_m) / law.keeps_m, twig_rng)
        meshes += [] if twigs is None else [sweep_tubes(twigs, np.full(len(twigs.lengths), 3), tile_m=tile_m)[0]]
    return (OrganMesh(Part.BRANCH, law.material, concatenate(meshes)), *_collars(branches, wood, tree.height_m))


def _collars(branches: _Branches, wood: Wood, height_m: float) -> list[OrganMesh]:
    """Swellings of the stem around its dead branches, of the bark at their height."""
    barks, which = [(wood.material, wood.bark_tile_m)], np.zeros(len(branches.height_m), dtype=np.int64)
    for zone in () if wood.years is None else wood.years.bark_zones:
        middle_m = float(np.mean(zone.above or zone.below or (0.0, 0.0))) * height_m
        which[(branches.height_m > middle_m) == (zone.above is not None)] = len(barks)
        barks.append((zone.material, zone.tile_m or wood.bark_tile_m))
    which[branches.radius_m[:, 0] < _THIN_M] = -1
    return [
        OrganMesh(Part.BRANCH, material, branches.at(np.flatnonzero(which == k)).collars(tile_m))
        for k, (material, tile_m) in enumerate(barks)
        if np.any(which == k)
    ]


def _places(law: DeadBranches, base_m: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """(B,) heights of branches on the stem, ascending from whorl to whorl, and (B,) factors on their length."""
    count = int(np.ceil(1.5 * base_m / law.whorl_m)) + 2
    whorl_m = _LOWEST_M + np.cumsum(law.whorl_m * rng.uniform(0.7, 1.3, count))
    number = np.floor(law.per_whorl + rng.random(count)).astype(np.int64)
    of_whorls = np.repeat(whorl_m, number) + 0.03 * rng.normal(size=int(number.sum()))
    between = rng.uniform(_LOWEST_M, max(base_m, _LOWEST_M), round(law.between_per_m * max(base_m - _LOWEST_M, 0.0)))
    height_m = np.concatenate([of_whorls, between])
    thin = np.repeat([1.0, 0.5], [len(of_whorls), len(between)])
    below = (height_m < base_m) & (height_m > 0.5 * _LOWEST_M)
    return height_m[below], thin[below]


def _lowest_branch_m(skeleton: Skeleton) -> float:
    """Height at which the lowest living branches leave the stem: below it are few of their sections."""
    stem, parent = first_stem(skeleton.axis) | is_second_stem(skeleton), np.maximum(skeleton.parent, 0)
    foot = ~stem & stem[parent] & (skeleton.parent >= 0) & (skeleton.order < TWIG_ORDER)
    if not foot.any():
        return 0.0
    height_m = skeleton.position_m[parent[foot], 2].astype(np.float64)
    section = skeleton.radius_m[foot].astype(np.float64) ** 2
    order = np.argsort(height_m, kind="stable")
    share = np.cumsum(section[order]) / max(float(section.sum()), 1e-12)
    return float(height_m[order[np.searchsorted(share, _LOWEST_SHARE)]])


@dataclass(frozen=True)
class _Stem:
    """A tree's stem, by height."""

    height_m: Floats  # (K,) ascending
    place_m: Floats  # (K, 2)
    radius_m: Floats  # (K,)

    @classmethod
    def of(cls, skeleton: Skeleton) -> _Stem:
        node = np.flatnonzero(first_stem(skeleton.axis))
        points = skeleton.position_m[node].astype(np.float64)
        order = np.argsort(points[:, 2], kind="stable")
        return cls(points[order, 2], points[order, :2], skeleton.radius_m[node][order].astype(np.float64))

    def at(self, height_m: Floats) -> tuple[Floats, Floats]:
        """(B, 3) middles and (B,) radii at heights."""
        x, y, radius = (np.interp(height_m, self.height_m, one) for one in (*self.place_m.T, self.radius_m))
        return np.stack([x, y, height_m], axis=1), radius


@dataclass(frozen=True)
class _Branches:
    """What is left of B branches."""

    height_m: Floats  # (B,) at which each leaves the stem
    whole_m: Floats  # (B,) length when it died
    left_m: Floats  # (B,) of it
    points_m: Floats  # (B, N, 3) from inside the stem to the end, and beyond it the tip of a splinter
    radius_m: Floats  # (B, N)
    stem_m: Floats  # (B,) radius of the stem

    @classmethod
    def of(
        cls, stem: _Stem, law: DeadBranches, height_m: Floats, whole_m: Floats, left_m: Floats, rng: np.random.Generator
    ) -> _Branches:
        count = len(height_m)
        middle, bearer_m = stem.at(height_m)
        # Within a whorl as far apart as may be, from whorl to whorl by chance.
        turn = 2.399963 * np.arange(count) + rng.normal(0.0, 0.35, count)
        share = np.linspace(0.0, 1.0, _NODES)
        tilt = law.angle_deg + rng.normal(0.0, _ANGLE_DEG, count)
        kink = rng.random((count, _NODES - 1)) < _KINKS
        crook = np.cumsum(rng.normal(0.0, np.where(kink, _KINK_DEG, _CROOKED_DEG), (2, count, _NODES - 1)), axis=2)
        step_m = left_m / (_NODES - 1)
        along = 0.5 * (share[1:] + share[:-1])
        age = (left_m / whole_m).clip(0.0, 1.0)[:, None] * along
        sag = law.droop_deg_per_m * left_m[:, None] * along * (2.0 - 2.0 * age) - _UPTURN_DEG * age**2
        down = np.radians(tilt[:, None] + sag + crook[0])
        aside = turn[:, None] + np.radians(crook[1])
        way = np.stack([np.sin(down) * np.cos(aside), np.sin(down) * np.sin(aside), np.cos(down)], axis=2)
        bark = middle + bearer_m[:, None] * 0.95 * np.stack([np.cos(turn), np.sin(turn), np.zeros(count)], axis=1)
        out = bark[:, None] + np.cumsum(way * step_m[:, None, None], axis=1)
        thick = 0.5 * law.thickness * whole_m[:, None]
        radius = thick * (1.0 - _TAPER * share * (left_m / whole_m).clip(0.0, 1.0)[:, None])
        radius[:, 1:] *= np.exp(rng.normal(0.0, _UNEVEN, kink.shape)) * (1.0 - _LOST) ** (np.cumsum(kink, 1) - 1)
        radius[:, : len(_BUTT)] *= _BUTT
        radius = np.minimum(np.concatenate([radius[:, :1], radius, radius[:, -1:]], axis=1), 0.7 * bearer_m[:, None])
        across = unit(np.cross(way[:, -1], rng.normal(size=(count, 3))))
        splinter = out[:, -1] + radius[:, -1:] * (_SPLINTER[0] * way[:, -1] + _SPLINTER[1] * across)
        inside = middle + 0.4 * (bark - middle)
        points = np.concatenate([inside[:, None], bark[:, None], out, splinter[:, None]], axis=1)
        points[:, 2:, 2] = np.maximum(points[:, 2:, 2], 0.02)
        thin = radius[:, 0] < _THIN_M
        points[thin, 2:-2:2] = 0.5 * (points[thin, 1:-3:2] + points[thin, 3:-1:2])  # on the lines that `tubes` has
        return cls(height_m, whole_m, left_m, points, radius, bearer_m)

    def at(self, rows: Ints) -> _Branches:
        return _Branches(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    @property
    def are_whole(self) -> Bools:
        """(B,) which have their tip: the others end in a break."""
        return np.asarray(self.left_m > 0.8 * self.whole_m, dtype=np.bool_)

    def tubes(self, is_near: bool) -> tuple[Polylines, Ints, Bools]:
        """Lines, (B,) sides, and (B,) which end in a point."""
        thick = is_near & (self.radius_m[:, 0] >= _THIN_M)
        kept = np.ones(self.radius_m.shape, dtype=np.bool_)
        kept[:, 2:-2:2] = thick[:, None]
        kept[:, -1] = thick & ~self.are_whole
        offset = np.concatenate([[0], np.cumsum(kept.sum(axis=1))])
        lines = Polylines(self.points_m[kept], self.radius_m[kept], offset)
        return lines, np.minimum(sides_for_radius(self.radius_m[:, 0]), _MOST_SIDES), thick | self.are_whole

    def collars(self, tile_m: tuple[float, float]) -> Mesh:
        """Tubes around the feet; `tile_m`: of the bark's texture."""
        way, thick_m = unit(self.points_m[:, 2] - self.points_m[:, 1]), self.radius_m[:, :1]
        along = 0.05 * self.stem_m[:, None] + _COLLAR[:, 0] * thick_m
        points = self.points_m[:, 1, None] + along[..., None] * way[:, None]
        radius = np.minimum(_COLLAR[:, 1] * thick_m, 0.5 * self.stem_m[:, None])
        lines = Polylines(points.reshape(-1, 3), radius.ravel(), np.arange(len(thick_m) + 1) * len(_COLLAR))
        mesh, _ = sweep_tubes(lines, np.full(len(thick_m), _MOST_SIDES + 1), pointed=False, tile_m=tile_m)
        assert mesh.uv is not None
        mesh.uv[:, 0] *= np.float32(_COLLAR_TILE_M / tile_m[0])
        return mesh


def _twigs(branches: _Branches, law: DeadBranches, depth: Floats, rng: np.random.Generator) -> Polylines | None:
    """Thin twigs to both sides of branches that died lately; `depth`: (B,) over that at which half is left."""
    wanted = law.twigs_per_m * branches.left_m * np.exp(-depth / _TWIGS_KEEP)
    row = np.repeat(np.arange(len(wanted)), np.floor(wanted + rng.random(len(wanted))).astype(np.int64))
    if not len(row):
        return None
    at = rng.uniform(0.15, 1.0, len(row))  # along what is left
    beyond_m = branches.whole_m[row] - at * branches.left_m[row]
    length_m = _TWIG_LENGTH * beyond_m * rng.uniform(0.3, 1.0, len(row))
    node = 1 + np.minimum((at * (_NODES - 1)).astype(np.int64), _NODES - 2)
    first, second = branches.points_m[row, node], branches.points_m[row, node + 1]
    foot = first + (at * (_NODES - 1) - (node - 1))[:, None] * (second - first)
    ahead = unit(second - first)
    side = unit(np.cross(ahead, [0.0, 0.0, 1.0])) * np.where(np.arange(len(row)) % 2, 1.0, -1.0)[:, None]
    angle = np.radians(_TWIG_ANGLE_DEG + rng.normal(0.0, 12.0, len(row)))[:, None]
    down = np.tan(np.radians(_TWIG_DROOP_DEG * rng.uniform(-0.3, 1.3, len(row))))[:, None] * np.array([0.0, 0.0, -1.0])
    out = unit(np.cos(angle) * ahead + np.sin(angle) * side + 0.5 * down)
    later = unit(out + down)
    middle = foot + 0.5 * length_m[:, None] * out
    points = np.stack([foot, middle, middle + 0.5 * length_m[:, None] * later], axis=1)
    points[:, :, 2] = np.maximum(points[:, :, 2], 0.02)
    kept = length_m >= _LEAST_TWIG_M
    if not kept.any():
        return None
    radius = np.tile(0.5 * _TWIG_M * np.array([1.0, 0.7, 0.3]), (int(kept.sum()), 1))
    offset = np.arange(int(kept.sum()) + 1) * _TWIG_NODES
    return Polylines(points[kept].reshape(-1, 3), radius.reshape(-1), offset)
