"""Twigs with leaves or needles of true size, which stand near a camera for one large leaf or one coarse shoot.

A spray has the area of what it stands for, and its frame: its foot in the origin, y along it, z its upper side. Leaves
sit in two rows along a twig, their upper sides towards z, each with its petiole, size and attitude; the lowest of a
shoot are the smallest. Their bends, folds, twists and widths differ, as those of plants that vary through growth
(Streit et al. 2005, figure 11), and twigs are bowed. Leaves are as far from the spray's foot as the large leaf, in the
mean. Needles stand all around their shoots, at the golden angle from one bundle to the next,
their flat sides as level, in the mean, as those of the coarse shoot, or at random where that one is of crossed strips.
Single needles are denser above, and stand along the twig below the shoot too (`twig_needles`). Where there are too many
for one shoot they are on side shoots too: in its plane, or of bundles in a whorl.

Where a pixel is too coarse for single needles one stands for `merged` of them: longer, wider, and closer to its shoot,
which stays as thick.

Reference
---------
Streit, L., Federl, P., Sousa, M. C. (2005). Modelling plant variation through growth. Computer Graphics Forum 24(3),
497-506.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from forestgen.core.randomness import child_rng
from forestgen.geometry.mesh import GOLDEN_RAD, Floats, Ints, Mesh, surface_area_m2, triangle_areas, unit
from forestgen.geometry.patches import (
    Patch,
    area_m2,
    attitude,
    bent,
    copies,
    creased,
    join,
    lifted,
    on_axis,
    outwards,
    to_mesh,
    tube,
)
from forestgen.plants.organs.base import OrganForm
from forestgen.plants.organs.leaves import CompoundLeaf, LobedLeaf, PalmateLeaf, SimpleLeaf
from forestgen.plants.organs.needles import NeedleTwig, needle_patch
from forestgen.plants.organs.wear import worn

Leaf = SimpleLeaf | LobedLeaf | PalmateLeaf

_LONGEST_STALK = 0.45  # of a leaf's length: twigs drawn with fewer leaves have longer ones
_ROW_STEP = 0.5  # of a leaf's width, from one leaf to the next on the other side of the twig
_LEAF_ANGLES_DEG = (58.0, 35.0)  # between twig and leaf, at its foot and its tip
WORN = 1.0 / 6.0  # share of leaves at detail 2, see `wear`
_GROWN = np.array([[0.0, 0.25, 0.7, 1.0], [0.66, 0.95, 1.1, 0.92]])  # place on a shoot, and size of its leaves there
_SIZES = 0.14  # standard deviation of the logarithm of leaves' sizes on a shoot
_BOWS_DEG = (-3.0, -1.5, 0.0, 1.5, 3.0)  # of twigs, from foot to tip
_TWIG_M, _TAPER = 0.00015, 0.001  # radius of a twig at its tip, and what it gains over its length
NEEDLES_ALONG, _BUNDLES_ALONG = 26.0, 55.0  # on a needle's length of shoot: single needles, and bundles of several
_WHORL = 0.4  # where side shoots of bundles spring from, share of the first
_SIDE_SHOOT = (0.4, 0.6)  # length over that of the spray, where their number is chosen
_LONGEST_SIDE = 0.8
_SIDE_ANGLE_DEG = 54.0
_SIDE_TURN = 0.25
_MERGED_LENGTH = 0.45  # power of the number of merged needles in their length
_DENSER_ABOVE = 0.25  # shift of single needles towards the upper side, radians at most
_TIP = 0.06  # share of a shoot whose needles point ahead
_MOST_LEVEL = 6.0  # factor on the vertical part of needles' normals
_SPLIT_DEG = 9.0  # of a needle from the middle of its bundle


class LeafShape(NamedTuple):
    """How one leaf differs from its species' form."""

    bend_deg: float = 0.0  # more of it along the midrib
    fold_deg: float = 0.0  # more of it
    twist_deg: float = 0.0  # of the tip about the midrib
    slender: float = 1.0  # length over width; the area stays


_PLAIN = LeafShape()
_SHAPES = (
    LeafShape(-8.0, 2.0, 5.0, 1.08),
    LeafShape(-4.0, -6.0, -8.0, 0.9),
    LeafShape(3.0, -1.0, 4.0, 1.0),
    LeafShape(9.0, 3.0, -5.0, 0.95),
    LeafShape(6.0, -6.0, 8.0, 1.1),
    LeafShape(-6.0, 2.0, -3.0, 0.98),
)


class LeafKind(NamedTuple):
    """Some of the leaves of a plant, which have a material of their own."""

    name: str
    share: float  # of all
    at_tip: bool = False  # the outer ends of shoots, not any


class Spray(NamedTuple):
    """What one organ is drawn as, in its own frame."""

    leaves: Mesh
    twig: Mesh | None
    area_m2: float  # of the leaves
    leaf: Ints  # (F,) number of the leaf or needle of each face
    along: Floats  # (L,) where each is on its shoot: 0 foot, 1 tip

    @classmethod
    def of(
        cls, leaves: list[Patch], twigs: list[Patch], along: Floats, faces: Ints | int, is_veined: bool = False
    ) -> Spray:
        """`along`: of each leaf, in the order of the faces. `faces`: of each leaf. `is_veined`: they have uv."""
        mesh = to_mesh(*leaves)
        mesh = mesh if is_veined else replace(mesh, uv=None)
        leaf = np.repeat(np.arange(len(along)), faces)
        return cls(mesh, to_mesh(*twigs) if twigs else None, surface_area_m2(mesh), leaf, along)

    @property
    def triangles(self) -> int:
        return self.leaves.triangles + (self.twig.triangles if self.twig else 0)


@lru_cache(maxsize=256)
def true_leaf(form: Leaf, length_m: float, detail: int, shape: LeafShape = _PLAIN) -> Patch:
    """A leaf of a length with its petiole, creased along its midrib."""
    size = length_m / form.length_m
    update = {
        "length_m": length_m * shape.slender**0.5,
        "width_m": form.width_m * size * shape.slender**-0.5,
        "stalk_m": min(form.stalk_m * size, _LONGEST_STALK * length_m),
        "stalk_width_m": None,
        "fold_deg": max(form.fold_deg + shape.fold_deg, 0.0),
        "curl_deg": form.curl_deg + shape.bend_deg,
        "detail": detail,
    }
    flat = creased(join([one.patch for one in form.model_copy(update=update).patches()]))
    x, y, z = flat.points.T
    turn = np.radians(shape.twist_deg) * np.clip(y / y.max(), 0.0, 1.0) ** 2
    return flat._replace(
        points=np.column_stack([x * np.cos(turn) + z * np.sin(turn), y, z * np.cos(turn) - x * np.sin(turn)])
    )


@lru_cache(maxsize=2048)  # a near tree has 100 to 200, of 10 to 30 kB
def leafy_twig(form: Leaf, length_m: float, number: int, detail: int, variant: int) -> Spray:
    """A twig of so many leaves of a length; one alone is at its end."""
    rng = child_rng(0, "leafy twig", number, variant)
    shapes = [true_leaf(form, length_m, detail, one) for one in _SHAPES]
    if detail == 2:
        shapes += [worn(one, child_rng(0, "worn leaf", k)) for k, one in enumerate(shapes)]
    step = _ROW_STEP * form.width_m * length_m / form.length_m
    foot = step * (np.arange(number) + 0.5 * (number > 1))
    share = np.arange(number) / max(number - 1, 1)
    angle = np.radians(np.interp(share, (0.0, 1.0), _LEAF_ANGLES_DEG) + 9.0 * rng.normal(size=number))
    angle[-1] = np.radians(8.0) * rng.normal()
    side = np.where((np.arange(number) + variant) % 2 == 0, 1.0, -1.0)
    along = np.column_stack([side * np.sin(angle), np.cos(angle), 0.09 * rng.normal(size=number)])
    upper = np.column_stack([0.14 * rng.normal(size=(number, 2)), np.ones(number)])
    size = np.interp(share, *_GROWN) * np.exp(_SIZES * rng.normal(size=number))
    linear = attitude(along, upper) * size[:, None, None]
    kind = (variant + rng.permutation(number)) % len(_SHAPES)
    if detail == 2:
        kind = np.where(rng.random(number) < WORN, kind + len(_SHAPES), kind)
    order = np.argsort(kind, kind="stable")
    leaves = [copies(shapes[one], linear[kind == one], on_axis(foot[kind == one])) for one in np.unique(kind).tolist()]
    whole = join(leaves)
    drawn_m = _middle_m(join([one.patch for one in form.patches()])) * np.sqrt(area_m2(whole) / form_area_m2(form))
    away = max(drawn_m - _middle_m(whole), 0.0)  # leaves are where the large one is
    twig_m, bow = float(foot[-1]) + away, np.radians(_BOWS_DEG[variant % len(_BOWS_DEG)])
    twig = []
    if twig_m > 0.0:
        path, radius = on_axis(twig_m * np.linspace(0.0, 1.0, 3)), _TWIG_M + _TAPER * twig_m * np.linspace(1.0, 0.0, 3)
        twig = [bent(tube(path, radius, 3), twig_m, bow)]
        whole = bent(lifted(whole, away), twig_m, bow)
    faces = np.array([len(one.faces) for one in shapes])
    return Spray.of([whole], twig, share[order], faces[kind[order]], detail > 0)


def form_area_m2(form: OrganForm) -> float:
    """Area of the whole organ, one side."""
    return surface_area_m2(form.template())


def _middle_m(patch: Patch) -> float:
    """How far along its axis the middle of a leaf's area is."""
    return float(
        np.average(patch.points[patch.faces, 1].mean(axis=1), weights=triangle_areas(patch.points, patch.faces))
    )


@lru_cache(maxsize=64)
def finer_leaf(form: CompoundLeaf, detail: int) -> Spray:
    """The leaf itself with another number of triangles."""
    whole = [one.patch for one in form.model_copy(update={"detail": detail}).patches()]
    return Spray.of(whole, [], np.full(1, 0.5), sum(len(one.faces) for one in whole), detail > 0)


class Needles(NamedTuple):
    """The needles of a spray."""

    length_m: float  # of a true one
    number: int  # of true ones
    merged: int  # that one stands for
    detail: int  # 0 or 1, see `needle_patch`


@lru_cache(maxsize=512)
def needle_spray(form: NeedleTwig, needles: Needles, reach_m: float, variant: int) -> Spray:
    """Shoots of a length in all that bears the needles; the first is `reach_m` long, the others are at its sides."""
    rng = child_rng(0, "needle spray", variant)
    start, along, length = _shoots(form, needles, reach_m, rng)
    leaves, share = _needles(form, needles, (start, along, length), rng)
    radius = 0.0002 + 0.001 * length
    twigs = [
        tube(np.stack([a, a + b * c]), np.array([r, 0.0]), 3)
        for a, b, c, r in zip(start, along, length, radius, strict=True)
    ]
    return Spray.of([leaves], twigs, share, len(leaves.faces) // len(share))


@lru_cache(maxsize=1024)
def twig_spray(form: NeedleTwig, needles: Needles, length_m: float, radius_m: float, variant: int) -> Spray:
    """The needles of a piece of twig along y, whose wood is drawn already."""
    rng = child_rng(0, "clothed twig", variant)
    shoot = np.zeros((1, 3)), np.array([[0.0, 1.0, 0.0]]), np.array([length_m])
    leaves, share = _needles(form, needles, shoot, rng, radius_m)
    return Spray.of([leaves], [], 0.0 * share, len(leaves.faces) // len(share))


def _needles(
    form: NeedleTwig,
    needles: Needles,
    shoots: tuple[Floats, Floats, Floats],
    rng: np.random.Generator,
    radius_m: float | None = None,
) -> tuple[Patch, Floats]:
    """The needles of shoots of feet, directions and lengths, and where each is on its shoot.

    `radius_m`: of a twig that goes on beyond its end.
    """
    start, along, length = shoots
    count = max(round(needles.number / needles.merged / form.fascicle), 1)
    ends = np.round(np.cumsum(length) / length.sum() * count).astype(np.int64)
    each = np.diff(ends, prepend=0)
    shoot = np.repeat(np.arange(len(each)), each)
    share = (np.arange(count) - np.repeat(ends - each, each) + rng.uniform(0.2, 0.8, count)) / np.maximum(
        each[shoot], 1
    )
    longer = needles.merged**_MERGED_LENGTH
    frame = attitude(along, np.tile([0.0, 0.0, 1.0], (len(along), 1)))[shoot]
    own = _bundles(form, count, share if radius_m is None else 0.5 * share, longer, rng)
    foot = start[shoot] + (share * length[shoot])[:, None] * along[shoot]
    way = np.einsum("nij,nkj->nki", frame, own).reshape(-1, 3)
    foot = np.repeat(foot, form.fascicle, axis=0)
    if radius_m is not None:
        foot = foot + radius_m * unit(way * [1.0, 0.0, 1.0])
    upper = _upper_sides(way, None if form.crossed else level_share(form), rng)
    width_m = form.needle_width_m * needles.merged / longer
    one = needle_patch(needles.length_m * longer, width_m, np.radians(form.curl_deg), needles.detail)
    size = rng.uniform(0.85, 1.1, len(way))
    return copies(one, attitude(way, upper) * size[:, None, None], foot), np.repeat(share, form.fascicle)


@lru_cache(maxsize=64)
def level_share(form: NeedleTwig) -> float:
    """Mean of the squared vertical component of the normals of a form's needles, weighted by area, in its frame."""
    needles = to_mesh(form.needles())
    a, b, c = needles.vertices_m[needles.faces].astype(np.float64).transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    return float(np.sum(normal[:, 2] ** 2 / area) / area.sum())


def _upper_sides(along: Floats, wanted: float | None, rng: np.random.Generator) -> Floats:
    """(M, 3) normals of needles, at random about them, but as level, in the mean, as `wanted` of `level_share`."""
    random = rng.normal(size=along.shape)
    most = _MOST_LEVEL if wanted is not None else 1.0
    low, high = np.log(1.0 / most), np.log(most)
    for _ in range(16):
        upper = random * [1.0, 1.0, np.exp(0.5 * (low + high))]
        upper -= np.sum(upper * along, axis=1, keepdims=True) * along
        upper /= np.linalg.norm(upper, axis=1, keepdims=True)
        share = float(np.mean(upper[:, 2] ** 2))
        low, high = (0.5 * (low + high), high) if share < (wanted or 0.0) else (low, 0.5 * (low + high))
    return np.asarray(np.where(upper[:, 2:] < 0.0, -upper, upper))


def _shoots(
    form: NeedleTwig, needles: Needles, reach_m: float, rng: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """(S, 3) feet, (S, 3) directions and (S,) lengths of the shoots that needles need.

    Those of single needles have side shoots to the right and left, along all of the first; of bundles, in a whorl.
    """
    is_whorl = form.fascicle > 1
    dense = _BUNDLES_ALONG * form.fascicle if is_whorl else NEEDLES_ALONG
    more_m = max(needles.number * needles.length_m / dense - reach_m, 0.0)
    sides = int(np.ceil(more_m / (_SIDE_SHOOT[is_whorl] * reach_m)))
    number = np.arange(sides)
    place = np.full(sides, _WHORL) if is_whorl else 0.08 + 0.84 * (number + 0.5) / max(sides, 1)
    raw = rng.uniform(0.8, 1.2, sides) * (1.0 if is_whorl else 1.15 - place)
    length = np.minimum(raw * more_m / max(float(raw.sum()), 1e-9), _LONGEST_SIDE * reach_m)
    angle = np.radians(_SIDE_ANGLE_DEG + 6.0 * rng.normal(size=sides))
    turn = number * (2.0 * np.pi / max(sides, 1) if is_whorl else np.pi) + _SIDE_TURN * rng.normal(size=sides)
    along = np.sin(angle)[:, None] * outwards(turn) + np.cos(angle)[:, None] * [0.0, 1.0, 0.0]
    start = np.concatenate([np.zeros((1, 3)), on_axis(place * reach_m)])
    return start, np.concatenate([[[0.0, 1.0, 0.0]], along]), np.concatenate([[reach_m], length])


def _parted(turn: Floats, parting: float) -> Floats:
    """(N, 3) directions at right angles to the shoot, swept to its two sides as far as the form has it."""
    side, rise = np.cos(turn), np.sin(turn)
    side = side + parting * (np.sign(side) * np.sqrt(1.0 - 0.2 * rise**2) - side)
    return unit(np.column_stack([side, np.zeros(len(turn)), rise * (1.0 - parting) + 0.15 * parting]))


def _bundles(form: NeedleTwig, count: int, share: Floats, longer: float, rng: np.random.Generator) -> Floats:
    """(count, fascicle, 3) directions of the needles of bundles on a shoot along y.

    `longer`: length of a needle over a true one's; longer ones lie closer to the shoot, which stays as thick.
    """
    turn = np.arange(count) * GOLDEN_RAD + 0.15 * rng.normal(size=count)
    if form.fascicle == 1:
        turn = turn + _DENSER_ABOVE * np.cos(turn)
    outward = _parted(turn, form.parting)
    angle = np.radians(form.angle_deg) * (1.15 - 0.3 * share) * rng.uniform(0.8, 1.2, count)
    angle = np.where(share > 1.0 - _TIP, 0.5 * angle, angle)
    angle = np.arcsin(np.clip(np.sin(angle), 0.0, 1.0) / longer) if longer > 1.0 else angle
    middle = np.sin(angle)[:, None] * outward + np.cos(angle)[:, None] * [0.0, 1.0, 0.0]
    if form.fascicle == 1:
        return np.asarray(middle[:, None])
    across = np.cross(middle, outward)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    second = np.cross(across, middle)
    split = 2.0 * np.pi * np.arange(form.fascicle) / form.fascicle + rng.uniform(0.0, np.pi, (count, 1))
    apart = np.radians(_SPLIT_DEG) * rng.uniform(0.6, 1.4, (count, 1))
    off = np.cos(split)[..., None] * across[:, None] + np.sin(split)[..., None] * second[:, None]
    return np.asarray(np.cos(apart)[..., None] * middle[:, None] + np.sin(apart)[..., None] * off)
