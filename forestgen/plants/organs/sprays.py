"""Twigs with leaves or needles of true size, which stand near a camera for one large leaf or one coarse shoot.

A spray has the area of what it stands for, and its frame: its foot in the origin, y along it, z its upper side. Leaves
sit in two rows along a twig, their upper sides towards z, each with its petiole, size, attitude and bend: a leaf's tip
hangs by up to some 20 degrees more or less than the species' own (of varied plants leaves differ in their bend: Streit,
L., Federl, P., Sousa, M. C. (2005). Modelling plant variation through growth. Computer Graphics Forum 24(3), figure 11).
Needles stand all around their shoots, at the golden angle from one bundle to the next. A shoot has at most
`_BUNDLES` bundles on a needle's length; if these are too few for the area, it has side shoots in its plane.

Where a pixel is too coarse for single needles one stands for `merged` of them, mostly wider and a little longer.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from forestgen.core.randomness import child_rng
from forestgen.geometry.mesh import GOLDEN_RAD, Floats, Mesh, surface_area_m2
from forestgen.geometry.patches import Patch, attitude, copies, join, on_axis, to_mesh, tube
from forestgen.plants.organs.leaves import CompoundLeaf, LobedLeaf, PalmateLeaf, SimpleLeaf
from forestgen.plants.organs.needles import NeedleTwig, needle_patch

Leaf = SimpleLeaf | LobedLeaf | PalmateLeaf

_LONGEST_STALK = 0.45  # of a leaf's length: twigs drawn with fewer leaves have longer ones
_ROW_STEP = 0.42  # of a leaf's width, from one leaf to the next on the other side of the twig
_LEAF_ANGLES_DEG = (58.0, 35.0)  # between twig and leaf, at its foot and its tip
_BENDS_DEG = (-16.0, 0.0, 12.0, 24.0)  # added to the bend of the species' leaves
_BUNDLES = 25.0  # of needles on a needle's length
_SIDE_SHOOT = 0.28  # length over that of the spray, where their number is chosen
_LONGEST_SIDE = 0.6
_SIDE_ANGLE_DEG = 50.0
_MERGED_LENGTH = 0.25  # power of the number of merged needles in their length
_TIP = 0.06  # share of a shoot whose needles point ahead
_SPLIT_DEG = 9.0  # of a needle from the middle of its bundle


class Spray(NamedTuple):
    """What one organ is drawn as, in its own frame."""

    leaves: Mesh
    twig: Mesh | None
    area_m2: float  # of the leaves

    @classmethod
    def of(cls, leaves: list[Patch], twigs: list[Patch]) -> Spray:
        mesh = replace(to_mesh(*leaves), uv=None)
        return cls(mesh, to_mesh(*twigs) if twigs else None, surface_area_m2(mesh))

    @property
    def triangles(self) -> int:
        return self.leaves.triangles + (self.twig.triangles if self.twig else 0)


def true_leaf(form: Leaf, length_m: float, detail: int, more_bend_deg: float = 0.0) -> Patch:
    """A leaf of a length with its petiole."""
    size = length_m / form.length_m
    update = {
        "length_m": length_m,
        "width_m": form.width_m * size,
        "stalk_m": min(form.stalk_m * size, _LONGEST_STALK * length_m),
        "stalk_width_m": None,
        "curl_deg": form.curl_deg + more_bend_deg,
        "detail": detail,
    }
    return join([one.patch for one in form.model_copy(update=update).patches()])


@lru_cache(maxsize=512)
def leafy_twig(form: Leaf, length_m: float, number: int, detail: int, variant: int) -> Spray:
    """A twig of so many leaves of a length; one alone has no twig."""
    rng = child_rng(0, "leafy twig", number, variant)
    bends = [true_leaf(form, length_m, detail, one) for one in _BENDS_DEG]
    step = _ROW_STEP * form.width_m * length_m / form.length_m
    foot = step * (np.arange(number) + 0.5 * (number > 1))
    share = np.arange(number) / max(number - 1, 1)
    angle = np.radians(np.interp(share, (0.0, 1.0), _LEAF_ANGLES_DEG) + 9.0 * rng.normal(size=number))
    angle[-1] = np.radians(8.0) * rng.normal()
    side = np.where((np.arange(number) + variant) % 2 == 0, 1.0, -1.0)
    along = np.column_stack([side * np.sin(angle), np.cos(angle), 0.12 * rng.normal(size=number)])
    upper = np.column_stack([0.2 * rng.normal(size=(number, 2)), np.ones(number)])
    size = rng.uniform(0.82, 1.12, number) * np.where(share < 0.2, 0.9, 1.0)
    linear = attitude(along, upper) * size[:, None, None]
    kind = rng.integers(len(bends), size=number)
    leaves = [copies(bends[one], linear[kind == one], on_axis(foot[kind == one])) for one in np.unique(kind).tolist()]
    twig_m = float(foot[-1])
    radius = 0.006 * length_m + 0.003 * twig_m
    twig = [tube(on_axis(np.array([0.0, twig_m])), np.array([radius, 0.0]), 3)] if number > 1 else []
    return Spray.of(leaves, twig)


@lru_cache(maxsize=64)
def finer_leaf(form: CompoundLeaf, detail: int) -> Spray:
    """The leaf itself with another number of triangles."""
    return Spray.of([one.patch for one in form.model_copy(update={"detail": detail}).patches()], [])


class Needles(NamedTuple):
    """The needles of a spray."""

    length_m: float  # of a true one
    number: int  # of true ones
    merged: int  # that one stands for
    detail: int  # 0 or 1, see `needle_patch`


@lru_cache(maxsize=128)
def needle_spray(form: NeedleTwig, needles: Needles, reach_m: float, variant: int) -> Spray:
    """Shoots of a length in all that bears the needles; the first is `reach_m` long, the others are at its sides."""
    rng = child_rng(0, "needle spray", variant)
    start, along, length = _shoots(needles, form.fascicle, reach_m, rng)
    count = max(round(needles.number / needles.merged / form.fascicle), 1)
    ends = np.round(np.cumsum(length) / length.sum() * count).astype(np.int64)
    each = np.diff(ends, prepend=0)
    shoot = np.repeat(np.arange(len(each)), each)
    share = (np.arange(count) - np.repeat(ends - each, each) + rng.uniform(0.2, 0.8, count)) / np.maximum(
        each[shoot], 1
    )
    foot = start[shoot] + (share * length[shoot])[:, None] * along[shoot]
    frame = attitude(along, np.tile([0.0, 0.0, 1.0], (len(along), 1)))[shoot]
    own = _bundles(form, count, share, rng)
    way = np.einsum("nij,nkj->nki", frame, own).reshape(-1, 3)
    foot = np.repeat(foot, form.fascicle, axis=0)
    upper = rng.normal(size=way.shape)  # needles are turned about themselves anyhow
    upper = np.where(upper[:, 2:] < 0.0, -upper, upper)
    longer = needles.merged**_MERGED_LENGTH
    width_m = form.needle_width_m * needles.merged / longer
    one = needle_patch(needles.length_m * longer, width_m, np.radians(form.curl_deg), needles.detail)
    size = rng.uniform(0.85, 1.1, len(way))
    leaves = copies(one, attitude(way, upper) * size[:, None, None], foot)
    radius = 0.0005 + 0.0025 * length
    twigs = [
        tube(np.stack([a, a + b * c]), np.array([r, 0.0]), 3)
        for a, b, c, r in zip(start, along, length, radius, strict=True)
    ]
    return Spray.of([leaves], twigs)


def _shoots(needles: Needles, fascicle: int, reach_m: float, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """(S, 3) feet, (S, 3) directions and (S,) lengths of the shoots that needles need."""
    total = needles.number * needles.length_m / (_BUNDLES * fascicle)
    sides = int(np.ceil(max(total - reach_m, 0.0) / (_SIDE_SHOOT * reach_m)))
    place = 0.1 + 0.8 * (np.arange(sides) + 0.5) / max(sides, 1)
    raw = (1.15 - place) * rng.uniform(0.8, 1.2, sides)
    length = np.minimum(raw * max(total - reach_m, 0.0) / max(float(raw.sum()), 1e-9), _LONGEST_SIDE * reach_m)
    angle = np.radians(_SIDE_ANGLE_DEG + 6.0 * rng.normal(size=sides)) * np.where(np.arange(sides) % 2 == 0, 1.0, -1.0)
    along = np.column_stack([np.sin(angle), np.cos(angle), 0.15 * rng.normal(size=sides)])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    start = np.concatenate([np.zeros((1, 3)), on_axis(place * reach_m)])
    return start, np.concatenate([[[0.0, 1.0, 0.0]], along]), np.concatenate([[reach_m], length])


def _bundles(form: NeedleTwig, count: int, share: Floats, rng: np.random.Generator) -> Floats:
    """(count, fascicle, 3) directions of the needles of bundles on a shoot along y."""
    turn = np.arange(count) * GOLDEN_RAD + 0.15 * rng.normal(size=count)
    side, rise = np.cos(turn), np.sin(turn)
    rise = rise * (1.0 - form.parting) + 0.15 * form.parting
    outward = np.column_stack([side, np.zeros(count), rise])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    angle = np.radians(form.angle_deg) * (1.15 - 0.3 * share) * rng.uniform(0.8, 1.2, count)
    angle = np.where(share > 1.0 - _TIP, 0.5 * angle, angle)
    middle = np.sin(angle)[:, None] * outward + np.cos(angle)[:, None] * [0.0, 1.0, 0.0]
    if form.fascicle == 1:
        return middle[:, None]
    across = np.cross(middle, outward)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    second = np.cross(across, middle)
    split = 2.0 * np.pi * np.arange(form.fascicle) / form.fascicle + rng.uniform(0.0, np.pi, (count, 1))
    apart = np.radians(_SPLIT_DEG) * rng.uniform(0.6, 1.4, (count, 1))
    off = np.cos(split)[..., None] * across[:, None] + np.sin(split)[..., None] * second[:, None]
    return np.asarray(np.cos(apart)[..., None] * middle[:, None] + np.sin(apart)[..., None] * off)
