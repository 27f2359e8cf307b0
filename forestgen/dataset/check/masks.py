"""Masks: instance, part, semantic, coverage and branch modules agree with each other and with the table of plants.

A pixel has one plant_id, so masks are disjoint and their union, with the pixels of plant_id 0, is the image. That holds
by the file's form; the checks find two files that disagree.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.dataset.check.files import Finding, finding, read_bit_depth
from forestgen.dataset.check.frame_data import EXR, INSTANCE, PLANTS, SEMANTIC, FrameData, Wrong, frame_check

_PLANT_PARTS = (Part.TRUNK, Part.BRANCH, Part.LEAF, Part.FLOWER, Part.FRUIT, Part.DEAD_WOOD, Part.STRUCTURE)
_NAMES = {part.name.lower(): int(part) for part in Part}
_OTHERS = "others"
_SEMANTIC_BITS = 8
_LARGEST_PNG_ID = (1 << 24) - 1
_SUM_TOLERANCE = 1e-6
_MOST_NODES = 32  # of a branch module's prototype; nodes are below
_MOST_NUMBERS = 2**32 // _MOST_NODES  # a triangle's mark holds both in 32 bits


@frame_check("ids", PLANTS)
def ids(frame: FrameData) -> Iterator[Finding | Wrong]:
    """plants.parquet holds each plant once, ids rising, and all that the image shows."""
    known = frame.plants["plant_id"]
    if known.dtype != np.uint32:
        yield finding("plant_id has another type", "uint32, no null", known.dtype)
        return
    steps = np.diff(known.astype(np.int64), prepend=-1)
    yield Wrong(steps <= 0, "ids do not rise from row to row, or one comes twice")
    if len(known) and known[0] == 0:
        yield finding("0 is no plant", "ids from 1", 0)
    strange = ~np.isin(frame.instance, known) & (frame.instance != 0)
    yield Wrong(strange, "a plant of the image is not in the table", "a row of it", "none")
    names = frame.plants["species"].tolist()
    for name in sorted(set(names) - set(frame.recipe["species"]), key=str):
        plant, expected = int(known[names.index(name)]), ", ".join(frame.recipe["species"])
        yield finding("the species is not the recipe's", expected, name, plant)


@frame_check("instance", INSTANCE, files=(INSTANCE,))
def instance_png(frame: FrameData) -> Iterator[Finding | Wrong]:
    """instance.png holds frame.exr's identity.plant_id, id = R + 256 G + 65536 B, if all ids fit 24 bits."""
    if int(frame.instance.max(initial=0)) > _LARGEST_PNG_ID:
        return
    rgb = frame.picture(INSTANCE).astype(np.uint32)
    if rgb.ndim != 3:
        yield finding("the picture has no three colours", "8-bit RGB", "one channel")
        return
    coded = rgb[..., 0] + 256 * rgb[..., 1] + 65536 * rgb[..., 2]
    yield Wrong(coded != frame.instance, "the id differs from frame.exr's", frame.instance, coded)


@frame_check("part", EXR)
def parts(frame: FrameData) -> Iterator[Wrong]:
    """A plant's pixel has a plant's part; no plant's has another part or is the sky."""
    part, is_plant = frame.part, frame.instance != 0
    yield Wrong(part >= len(Part), "no such part", f"0 to {len(Part) - 1}", part)
    own = np.isin(part, [int(one) for one in _PLANT_PARTS])
    names = "a part of a plant: trunk, branch, leaf, flower, fruit or dead wood; or a structure"
    yield Wrong(is_plant & ~own, "a plant's pixel has no plant's part", names, part)
    yield Wrong(~is_plant & own, "a pixel of no plant has a plant's part", "sky, ground or what lies on it", part)


@frame_check("semantic", SEMANTIC)
def semantic(frame: FrameData) -> Iterator[Finding | Wrong]:
    """semantic.png, of 8 bits a pixel, is frame.exr's identity.semantic, and both follow from species and part."""
    if frame.has(SEMANTIC):
        shown = frame.picture(SEMANTIC)
        if shown.ndim != 2:
            yield finding("the picture is no palette's", "8-bit indices", "colours")
            return
        bits = read_bit_depth(frame.root, frame.file(SEMANTIC))
        if bits != _SEMANTIC_BITS:
            yield finding("bits of a pixel", _SEMANTIC_BITS, bits)
        yield Wrong(shown != frame.semantic, "the class differs from frame.exr's semantic", frame.semantic, shown)
    expected = _classes(frame)
    problem = "the class does not follow from the plant's species and the part"
    yield Wrong(expected != frame.semantic, problem, expected, frame.semantic, EXR)


def _classes(frame: FrameData) -> NDArray[np.int64]:
    """(H, W) class by the recipe: 0 sky, 1 ground, then its classes; a part's class goes before a species'."""
    recipe = frame.recipe
    species = recipe["species"]
    own = recipe["labels"].get("classes") or {name: [name] for name in species}
    number_of = {member: number for number, members in enumerate(own.values(), start=2) for member in members}
    by_part = {_NAMES[name]: number for name, number in number_of.items() if name in _NAMES and name not in species}
    rest = number_of.get(_OTHERS, 1)
    by_species = {name: number_of.get(name, rest) for name in species}
    column = np.array([by_species.get(name, -1) for name in frame.plants["species"].tolist()], dtype=np.int64)
    found = np.ones(frame.instance.shape, dtype=np.int64)
    is_plant = frame.instance != 0
    rows = np.searchsorted(frame.plants["plant_id"], frame.instance[is_plant])
    found[is_plant] = column[np.minimum(rows, len(column) - 1)] if len(column) else -1
    for part, number in by_part.items():
        found[frame.part == part] = number
    found[frame.part == int(Part.NOTHING)] = 0
    return found


@frame_check("coverage", EXR, exr=("coverage rank0.id rank0.coverage",))
def coverage(frame: FrameData) -> Iterator[Wrong]:
    """Each share lies in (0, 1], they fall, sum to 1 (up to 1 where ranks ran out), and rank 0 is the instance."""
    ids, share = frame.ranks
    total = share.sum(axis=-1, dtype=np.float64)
    outside = np.any(~((share >= 0) & (share <= 1)), axis=-1)
    yield Wrong(outside, "a coverage lies outside 0 to 1", "0 to 1", share)
    rises = np.any(~(share[..., 1:] <= share[..., :-1]), axis=-1)
    yield Wrong(rises, "coverages do not fall from rank to rank", "falling", share)
    yield Wrong(~(total <= 1 + _SUM_TOLERANCE), "coverages sum to more than 1", "1", total)
    open_rank = (share[..., -1] == 0) & ~(np.abs(total - 1) <= _SUM_TOLERANCE)
    yield Wrong(open_rank, "coverages do not sum to 1 though ranks are free", f"1 ± {_SUM_TOLERANCE:g}", total)
    first = ids[..., 0]
    yield Wrong(first != frame.instance, "rank 0 is not the instance mask's plant", frame.instance, first)
    nameless = np.any((share == 0) & (ids != 0), axis=-1)
    yield Wrong(nameless, "a rank without coverage names a plant", "0", ids)
    tied = (share[..., 1:] > 0) & (share[..., 1:] == share[..., :-1])
    unsorted = np.any(tied & (ids[..., 1:] <= ids[..., :-1]), axis=-1)
    yield Wrong(unsorted, "equal coverages are not in the order of ids", "rising ids", ids)
    repeated = np.zeros(frame.instance.shape, dtype=bool)
    for rank in range(1, ids.shape[-1]):
        again = (ids[..., :rank] == ids[..., rank : rank + 1]).any(axis=-1)
        repeated |= again & (share[..., rank] > 0)
    yield Wrong(repeated, "an id has two ranks", "each id once", ids)


@frame_check("modules", EXR, exr=("module number node own",))
def branches(frame: FrameData) -> Iterator[Wrong]:
    """Numbers within their ranges; a plant's pixels have a module all or none, and no ground, sky or house has one."""
    module = frame.exr["module"]
    number, node, own = module["number"], module["node"], module["own"]
    for name, values, most in (("number", number, _MOST_NUMBERS), ("node", node, _MOST_NODES - 1), ("own", own, 1)):
        yield Wrong(values > most, f"module.{name} is out of range", f"at most {most}", values)
    for name, values in (("node", node), ("own", own)):
        without = (number == 0) & (values != 0)
        yield Wrong(without, f"module.{name} is set where there is no module", "0", values)
    if not frame.has_part("identity", "centre.plant_id", "centre.part"):
        return
    plant, part = frame.exr["identity"]["centre.plant_id"], frame.exr["identity"]["centre.part"]
    nowhere = (number != 0) & ((plant == 0) | (part == int(Part.STRUCTURE)))
    yield Wrong(nowhere, "a module of no plant", "0", number)
    _, index = np.unique(plant, return_inverse=True)
    index = index.reshape(plant.shape)
    has_some = np.bincount(index[number != 0], minlength=index.max() + 1) > 0
    is_own = np.bincount(index[own == 1], minlength=index.max() + 1) > 0
    torn = (plant != 0) & (number == 0) & has_some[index]
    yield Wrong(torn, "a plant of modules has none here", "a module's number", number)
    mixed = (plant != 0) & (number != 0) & (own == 0) & is_own[index]
    yield Wrong(mixed, "a plant's branches are its own in other pixels only", "1", own)
