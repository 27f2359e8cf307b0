"""Masks: instance, part and semantic agree with each other, with the table of plants and between files.

A pixel has one plant_id, so masks are disjoint and their union, with the pixels of plant_id 0, is the image. That holds
by the file's form; what can go wrong is that two files tell it differently, and that is checked here.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.dataset.check.files import read_bit_depth
from forestgen.dataset.check.finding import Finding
from forestgen.dataset.check.frame_data import EXR, INSTANCE, PLANTS, SEMANTIC, FrameData
from forestgen.dataset.check.pixels import wrong_pixels

_PLANT_PARTS = (Part.TRUNK, Part.BRANCH, Part.LEAF, Part.FLOWER, Part.FRUIT, Part.DEAD_WOOD, Part.STRUCTURE)
_NAMES = {part.name.lower(): int(part) for part in Part}
_OTHERS = "others"
_SEMANTIC_BITS = 8
_LARGEST_PNG_ID = (1 << 24) - 1


def instance_png(frame: FrameData) -> Iterator[Finding]:
    """instance.png tells frame.exr's identity.plant_id: id = R + 256 G + 65536 B."""
    rgb = frame.picture(INSTANCE).astype(np.uint32)
    if rgb.ndim != 3:
        yield frame.finding(INSTANCE, "the picture has no three colours", expected="8-bit RGB", got="one channel")
        return
    coded = rgb[..., 0] + 256 * rgb[..., 1] + 65536 * rgb[..., 2]
    wrong = coded != frame.instance
    yield from wrong_pixels(frame, INSTANCE, wrong, "the id differs from frame.exr's", frame.instance, coded)


def parts(frame: FrameData) -> Iterator[Finding]:
    """A plant's pixel has a plant's part; no plant's has another part or is the sky."""
    part, is_plant = frame.part, frame.instance != 0
    yield from wrong_pixels(frame, EXR, part >= len(Part), "no such part", f"0 to {len(Part) - 1}", part)
    own = np.isin(part, [int(one) for one in _PLANT_PARTS])
    names = "a part of a plant: trunk, branch, leaf, flower, fruit or dead wood; or a structure"
    yield from wrong_pixels(frame, EXR, is_plant & ~own, "a plant's pixel has no plant's part", names, part)
    yield from wrong_pixels(
        frame, EXR, ~is_plant & own, "a pixel of no plant has a plant's part", "sky, ground or what lies on it", part
    )


def semantic(frame: FrameData) -> Iterator[Finding]:
    """semantic.png, of 8 bits a pixel, is frame.exr's identity.semantic, and both follow from species and part."""
    if frame.has(SEMANTIC):
        shown = frame.picture(SEMANTIC)
        if shown.ndim != 2:
            yield frame.finding(SEMANTIC, "the picture is no palette's", expected="8-bit indices", got="colours")
            return
        bits = read_bit_depth(frame.task.root, frame.file(SEMANTIC))
        if bits != _SEMANTIC_BITS:
            yield frame.finding(SEMANTIC, "bits of a pixel", expected=str(_SEMANTIC_BITS), got=str(bits))
        wrong = shown != frame.semantic
        yield from wrong_pixels(
            frame, SEMANTIC, wrong, "the class differs from frame.exr's semantic", frame.semantic, shown
        )
    by_definition = classes_of(frame)
    wrong = by_definition != frame.semantic
    problem = "the class does not follow from the plant's species and the part"
    yield from wrong_pixels(frame, EXR, wrong, problem, by_definition, frame.semantic)


def classes_of(frame: FrameData) -> NDArray[np.int64]:
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


def ids(frame: FrameData) -> Iterator[Finding]:
    """plants.parquet holds each plant once, ids rising, and all that the image shows."""
    known = frame.plants["plant_id"]
    if known.dtype != np.uint32:
        yield frame.finding(PLANTS, "plant_id has another type", expected="uint32, no null", got=str(known.dtype))
        return
    steps = np.flatnonzero(np.diff(known.astype(np.int64)) <= 0)
    for row in steps.tolist():
        problem = "ids do not rise from row to row, or one comes twice"
        yield frame.finding(PLANTS, problem, plant_id=int(known[row + 1]))
    if len(known) and known[0] == 0:
        yield frame.finding(PLANTS, "0 is no plant", expected="ids from 1", got="0")
    strange = ~np.isin(frame.instance, known) & (frame.instance != 0)
    yield from wrong_pixels(frame, PLANTS, strange, "a plant of the image is not in the table", "a row of it", "none")
    for name in sorted(set(frame.plants["species"].tolist()) - set(frame.recipe["species"]), key=str):
        row = frame.plants["species"].tolist().index(name)
        expected = ", ".join(frame.recipe["species"])
        yield frame.finding(
            PLANTS, "the species is not the recipe's", expected=expected, got=str(name), plant_id=int(known[row])
        )


def holds_png(frame: FrameData) -> bool:
    """instance.png is left out where an id does not fit its 24 bits."""
    return frame.has(INSTANCE) and int(frame.instance.max(initial=0)) <= _LARGEST_PNG_ID
