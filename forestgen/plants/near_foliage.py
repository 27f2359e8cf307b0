"""Leaves and needles of true size in place of large ones that stand for several, where a camera is near.

A species' file may draw a crown with few large leaves of the same total area. Where a true leaf has at least the area
of a square of `LEAF_PX` pixels' side, the large one is replaced by a twig of true leaves (`organs.sprays`) of the same
area, at the same place and in the same attitude. A little farther away twigs have fewer leaves, of 2, 4, 8, ... times
the true area, none larger than that square, until the drawn leaf itself is no larger.

Outlines follow too: a leaf is drawn at the level of detail that its size in pixels asks for.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.core.randomness import child_rng, mixed
from forestgen.geometry.mesh import Bools, Floats, Ints, concatenate, instance, part_of, surface_area_m2
from forestgen.geometry.patches import area_m2
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.plants.meshing import MarkedMesh
from forestgen.plants.organs.base import OrganForm
from forestgen.plants.organs.leaves import CompoundLeaf, LobedLeaf, PalmateLeaf, SimpleLeaf
from forestgen.plants.organs.needles import NeedleTwig
from forestgen.plants.organs.sprays import (
    WORN,
    LeafKind,
    Needles,
    Spray,
    finer_leaf,
    form_area_m2,
    leafy_twig,
    needle_spray,
    true_leaf,
)
from forestgen.plants.skeleton import OrganPlacements
from forestgen.plants.twig_needles import TwigNeedles, sprays_on_twigs

VEINED = ", veins"  # at the end of names of materials of leaves with uv
LEAF_PX = 2.0  # side of a square, in pixels, that has a leaf's area where it is drawn at true size
_DETAIL_PX = (6.0, 16.0)  # side of a leaf in pixels, as of a square, from which on it has detail 1 and 2
_NEEDLE_PX = 1.5  # width of a needle from which on it has two triangles
_WORTH = 0.7  # a spray's leaves are at most so large, by area, as the leaves that they replace
_MOST_LEAVES = 48  # on one twig
_MOST_MERGED = 256
_SIZE_STEP = 1.25  # between the shoots of needles that are made; others are scaled
_VARIANTS, _LEAF_VARIANTS = 5, 18  # shoots of needles; twigs: of one leaf, three of each shape
_COVER = 0.8  # of a needle over length times width
_ORGANS_LEAVES = 1 << 20  # more than one organ has
_DRAWN = (NeedleTwig, SimpleLeaf, LobedLeaf, PalmateLeaf, CompoundLeaf)


@dataclass(frozen=True)
class NearOrgans:
    """How organs of one shape are drawn: one row an organ."""

    drawn: Bools  # (M,) whether it is replaced
    number: Ints  # (M,) leaves, or true needles by the size's step
    merged: Ints  # (M,) true leaves or needles that one stands for, 1, 2, 4, ...
    detail: Ints  # (M,)
    step: Ints  # (M,) of the size, of needles; 0 of leaves
    triangles: int  # of all, about


def near_organs(form: OrganForm, true_m: float | None, size: Floats, pixel_m: Floats) -> NearOrgans | None:
    """How organs are drawn near a camera; None: as ever.

    Parameters
    ----------
    true_m : length of a true leaf or needle; None: as the form says.
    size : (M,) of the organs, as factors on their form.
    pixel_m : (M,) what a pixel covers at each of them; inf where none does.
    """
    pixel_m = np.maximum(pixel_m, 1e-6)
    if form.part != "leaf":
        return None
    if isinstance(form, NeedleTwig):
        return _near_needles(form, true_m or form.needle_length_m, size, pixel_m)
    if isinstance(form, SimpleLeaf | LobedLeaf | PalmateLeaf):
        return _near_leaves(form, true_m or form.length_m, size, pixel_m)
    if isinstance(form, CompoundLeaf):
        side_px = size * np.sqrt(form_area_m2(form) / form.leaflets) / pixel_m
        detail = np.digitize(side_px, _DETAIL_PX)
        one = np.ones(len(size), dtype=np.int64)
        drawn = detail > form.detail
        triangles = sum(int(np.sum(detail[drawn] == k)) * finer_leaf(form, k).triangles for k in (1, 2))
        return NearOrgans(drawn, one, one, detail, 0 * one, triangles)
    return None


def near_pixel_m(form: OrganForm) -> float:
    """What a pixel covers, at most, where an organ of a form's own size is drawn in another way; 0: never."""
    if form.part != "leaf" or not isinstance(form, _DRAWN):
        return 0.0
    whole_m2 = _needles_m2(form) / form.equivalent_needles if isinstance(form, NeedleTwig) else form_area_m2(form)
    return float(np.sqrt(2.0 * _WORTH * whole_m2)) / LEAF_PX  # merged leaves may have half of the area


def largest_pixel_m(shapes: Mapping[str, OrganForm], foliage: Sequence[OrganPlacements]) -> float:
    """What a pixel covers, at most, where any organ is drawn in another way."""
    sized = (near_pixel_m(shapes[one.shape]) * float(organ_sizes(one.frame).max(initial=0.0)) for one in foliage)
    return max(sized, default=0.0)


def _merged(true_m2: float, pixel_m: Floats) -> Ints:
    """(M,) how many leaves or needles one may stand for: the largest power of 2 that is no larger than a square."""
    share = np.clip((LEAF_PX * pixel_m) ** 2 / true_m2, 1.0, _MOST_MERGED)
    return np.asarray(2 ** np.floor(np.log2(share)).astype(np.int64))


def _near_leaves(
    form: SimpleLeaf | LobedLeaf | PalmateLeaf, true_m: float, size: Floats, pixel_m: Floats
) -> NearOrgans:
    area, true_m2 = size**2 * form_area_m2(form), area_m2(true_leaf(form, true_m, 2))
    merged = _merged(true_m2, pixel_m)
    number = np.clip(np.rint(area / (merged * true_m2)), 1, _MOST_LEAVES).astype(np.int64)
    detail = np.digitize(np.sqrt(area / number) / pixel_m, _DETAIL_PX)
    drawn = (number > 1) | (detail > form.detail)
    each = np.array([true_leaf(form, true_m, k).faces.shape[0] for k in range(3)])
    each[2] = int((1.0 + 3.0 * WORN) * each[2])  # worn ones have more
    return NearOrgans(drawn, number, merged, detail, 0 * number, int(np.sum((number * each[detail])[drawn])))


def _near_needles(form: NeedleTwig, true_m: float, size: Floats, pixel_m: Floats) -> NearOrgans:
    true_m2, whole_m2 = _COVER * true_m * form.needle_width_m, _needles_m2(form)
    merged = _merged(true_m2, pixel_m)
    step = np.rint(np.log(np.maximum(size, 1e-6)) / np.log(_SIZE_STEP)).astype(np.int64)
    number = np.maximum(np.rint(whole_m2 * _SIZE_STEP ** (2.0 * step) / true_m2), 1).astype(np.int64)
    coarse_m2 = size**2 * whole_m2 / form.equivalent_needles
    drawn = merged * true_m2 < _WORTH * coarse_m2
    detail = (form.needle_width_m * merged > _NEEDLE_PX * pixel_m).astype(np.int64)
    triangles = int(np.sum(((1 + detail) * number / merged)[drawn]))
    return NearOrgans(drawn, number, merged, detail, step, triangles)


def _needles_m2(form: NeedleTwig) -> float:
    return sum(surface_area_m2(one.mesh) for one in form.pieces() if one.part == Part.LEAF)


def organ_sizes(frame: NDArray[np.float32]) -> Floats:
    """(M,) factors on the forms of organs."""
    return np.asarray(np.linalg.norm(frame[:, :, 1].astype(np.float64), axis=1))


def with_near_foliage(
    exemplar: Exemplar,
    shapes: Mapping[str, OrganForm],
    true_m: float | None,
    near: tuple[NearOrgans | None, ...],
    kinds: Mapping[str, Sequence[LeafKind]] = MappingProxyType({}),
    seed: int = 0,
) -> Exemplar:
    """The plant with sprays in place of some of its organs; its leaf area stays, and the materials of most leaves.

    Parameters
    ----------
    near : how the organs of each of `exemplar.foliage` are drawn.
    kinds : of the single leaves of a material, the last for all that is left; their materials: `material_of_kind`, and
        `VEINED` of those at detail 2.
    seed : which leaves are of which kind.
    """
    count = [len(one.node) for one in exemplar.foliage]
    gone = np.zeros(sum(count), dtype=np.bool_)
    first = np.cumsum([0, *count])
    for start, one in zip(first.tolist(), near, strict=False):
        if one is not None:
            gone[start : start + len(one.drawn)] = one.drawn
    kept = [_without(organ, gone) for organ in exemplar.organs]
    materials, of_organ = _leaf_materials(exemplar, len(gone))
    branches = [one for one in exemplar.organs if one.part == Part.BRANCH]
    bark = max(branches, key=lambda one: one.mesh.triangles).material if branches else None
    marks = _organ_marks(exemplar, len(gone))
    made: dict[tuple[Part, str], list[MarkedMesh]] = defaultdict(list)
    for placed, one, start in zip(exemplar.foliage, near, first.tolist(), strict=False):
        if one is None or not one.drawn.any():
            continue
        form = shapes[placed.shape]
        whole_m2 = organ_sizes(placed.frame) ** 2 * _whole_m2(form)
        for spray, frame, organ in _sprays(form, true_m, placed, one, of_organ[start : start + len(one.drawn)]):
            mark = None if marks is None else marks[start + organ]
            material, mesh = materials[of_organ[start + organ[0]]], instance(spray.leaves, frame)
            part = spray.area_m2 * organ_sizes(frame) ** 2 / whole_m2[organ]
            of_leaf = _kinds_of_leaves(kinds.get(material, ()), spray.along, part, start + organ, seed)
            for kind, chosen in of_leaf:
                here = np.ones(mesh.triangles, np.bool_) if chosen is None else chosen[:, spray.leaf].reshape(-1)
                if here.any():
                    own = mesh if here.all() else part_of(mesh, mesh.faces[here])
                    of_face = None if mark is None else np.repeat(mark, spray.leaves.triangles)[here]
                    name = material if kind is None else material_of_kind(material, kind)
                    name += "" if own.uv is None else VEINED
                    made[Part.LEAF, name].append((own, of_face))
            if spray.twig is not None and bark is not None:
                of_face = None if mark is None else np.repeat(mark, spray.twig.triangles)
                made[Part.BRANCH, bark].append((instance(spray.twig, frame), of_face))
    organs = (*(one for one in kept if one.mesh.triangles), *(_joined(*key, found) for key, found in made.items()))
    return replace(exemplar, organs=organs, foliage=())


def material_of_kind(material: str, kind: LeafKind) -> str:
    """Name of the material of some of the leaves of a material."""
    return f"{material} [{kind.name}]"


def _kinds_of_leaves(
    kinds: Sequence[LeafKind], along: Floats, part: Floats, organ: Ints, seed: int
) -> Iterator[tuple[LeafKind | None, Bools | None]]:
    """Each kind, and (M, L) which leaves of M organs are of it; None: all are alike.

    `part`: (M,) these leaves' share of their organ's area; twigs below shoots bear the rest, and no tips.
    """
    if not kinds:
        yield None, None
        return
    leaf = np.uint64(_ORGANS_LEAVES) * organ.astype(np.uint64)[:, None] + np.arange(len(along), dtype=np.uint64)
    even = (mixed(mixed(leaf) + mixed(np.full(1, seed, np.uint64))) >> np.uint64(11)) * 2.0**-53
    left = np.ones(even.shape, dtype=np.bool_)
    below = 0.0
    for kind in kinds[:-1]:
        if kind.at_tip:
            tip = kind.share / (part * (1.0 - below))
            mine = left & (along > np.maximum(1.0 - tip, 0.0)[:, None])
        else:
            mine = left & (even >= below) & (even < below + kind.share)
            below += kind.share
        left &= ~mine
        yield kind, mine
    yield kinds[-1], left


def _sprays(
    form: OrganForm, true_m: float | None, placed: OrganPlacements, one: NearOrgans, material: Ints
) -> Iterator[tuple[Spray, NDArray[np.float32], Ints]]:
    """What is drawn in place of organs of one shape, each with its frames and the organs that it is of.

    `material`: (M,) of each organ's leaves; what is drawn together has the same.
    """
    row = np.flatnonzero(one.drawn)
    variants = {NeedleTwig: _VARIANTS, CompoundLeaf: 1}.get(type(form), _LEAF_VARIANTS)
    variant = child_rng(0, "sprays", placed.shape).integers(variants, size=len(one.drawn))
    number, left_m2 = one.number, organ_sizes(placed.frame) ** 2 * _whole_m2(form)
    if isinstance(form, NeedleTwig) and placed.twigs is not None:
        needle_m = true_m or form.needle_length_m
        true_m2 = _COVER * needle_m * form.needle_width_m
        needles = TwigNeedles.of(placed.twigs, np.where(one.drawn, left_m2 / true_m2, 0.0), needle_m)
        number = np.maximum(np.rint(number * (1.0 - needles.share)), 1).astype(np.int64)
        alike = np.stack([one.merged, one.detail, variant, material], axis=1)
        for spray, frame, organ in sprays_on_twigs(form, needle_m, placed.twigs, needles, alike):
            left_m2 -= np.bincount(organ, spray.area_m2 * organ_sizes(frame) ** 2, minlength=len(left_m2))
            yield spray, frame, organ
    key = np.stack([one.step, number, one.merged, one.detail, variant, material], axis=1)[row]
    for chosen, group in _groups(key):
        spray, organ = _spray(form, true_m, chosen), row[group]
        frame = placed.frame[organ].copy()
        factor = np.sqrt(left_m2[organ] / spray.area_m2) / organ_sizes(frame)
        frame[:, :, :3] *= factor[:, None, None].astype(np.float32)
        yield spray, frame, organ


def _joined(part: Part, material: str, found: list[MarkedMesh]) -> OrganMesh:
    marks = [mark for _, mark in found if mark is not None]
    return OrganMesh(part, material, concatenate([mesh for mesh, _ in found]), np.concatenate(marks) if marks else None)


def _groups(key: Ints) -> list[tuple[Ints, Ints]]:
    """Each distinct row of a table, and the numbers of the rows that are alike."""
    found, which = np.unique(key, axis=0, return_inverse=True)
    order = np.argsort(which.reshape(-1), kind="stable")
    return list(zip(found, np.split(order, np.cumsum(np.bincount(which.reshape(-1)))[:-1]), strict=True))


def _spray(form: OrganForm, true_m: float | None, key: Ints) -> Spray:
    step, number, merged, detail, variant = (int(one) for one in key[:5])
    if isinstance(form, NeedleTwig):
        needles = Needles(true_m or form.needle_length_m, number, merged, detail)
        return needle_spray(form, needles, form.length_m * _SIZE_STEP**step, variant)
    if isinstance(form, CompoundLeaf):
        return finer_leaf(form, detail)
    assert isinstance(form, SimpleLeaf | LobedLeaf | PalmateLeaf)
    return leafy_twig(form, (true_m or form.length_m) * float(np.sqrt(merged)), number, detail, variant)


def _whole_m2(form: OrganForm) -> float:
    return _needles_m2(form) if isinstance(form, NeedleTwig) else form_area_m2(form)


def _without(organ: OrganMesh, gone: Bools) -> OrganMesh:
    """The surface without the faces of organs that are gone."""
    if organ.organ is None:
        return organ
    kept = ~((organ.organ >= 0) & gone[organ.organ])
    if kept.all():
        return organ
    mark = None if organ.mark is None else organ.mark[kept]
    return OrganMesh(organ.part, organ.material, part_of(organ.mesh, organ.mesh.faces[kept]), mark, organ.organ[kept])


def _organ_marks(exemplar: Exemplar, count: int) -> NDArray[np.uint32] | None:
    """(count,) mark of the first face of each organ; None of a plant without marks."""
    marks = np.zeros(count, dtype=np.uint32)
    for one in exemplar.organs:
        if one.mark is None:
            return None
        if one.organ is not None:
            own = one.organ >= 0
            marks[one.organ[own][::-1]] = one.mark[own][::-1]
    return marks


def _leaf_materials(exemplar: Exemplar, count: int) -> tuple[list[str], Ints]:
    """Materials of the leaves, and (count,) which of them the first face of each organ has."""
    leafy = [one for one in exemplar.organs if one.part == Part.LEAF and one.organ is not None]
    of_organ = np.zeros(count, dtype=np.int64)
    for number, one in reversed(list(enumerate(leafy))):
        assert one.organ is not None
        of_organ[one.organ[one.organ >= 0]] = number
    return [one.material for one in leafy], of_organ
