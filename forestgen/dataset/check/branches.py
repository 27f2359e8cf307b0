"""Branch modules: numbers, nodes and whose they are, at the centres of pixels."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from forestgen.core.parts import Part
from forestgen.dataset.check.finding import Finding
from forestgen.dataset.check.frame_data import EXR, FrameData
from forestgen.dataset.check.pixels import wrong_pixels

_MOST_NODES = 32  # of a prototype; nodes are below
_MOST_NUMBERS = 2**32 // _MOST_NODES  # a triangle's mark holds both in 32 bits


def has_branches(frame: FrameData) -> bool:
    return frame.has_part("module", "number", "node", "own")


def branches(frame: FrameData) -> Iterator[Finding]:
    """Numbers within their ranges; a plant's pixels have a module all or none, and no ground, sky or house has one."""
    module = frame.exr["module"]
    number, node, own = module["number"], module["node"], module["own"]
    for name, values, most in (("number", number, _MOST_NUMBERS), ("node", node, _MOST_NODES - 1), ("own", own, 1)):
        yield from wrong_pixels(frame, EXR, values > most, f"module.{name} is out of range", f"at most {most}", values)
    for name, values in (("node", node), ("own", own)):
        without = (number == 0) & (values != 0)
        yield from wrong_pixels(frame, EXR, without, f"module.{name} is told where there is no module", "0", values)
    if not frame.has_part("identity", "centre.plant_id", "centre.part"):
        return
    plant, part = frame.exr["identity"]["centre.plant_id"], frame.exr["identity"]["centre.part"]
    nowhere = (number != 0) & ((plant == 0) | (part == int(Part.STRUCTURE)))
    yield from wrong_pixels(frame, EXR, nowhere, "a module of no plant", "0", number)
    _, index = np.unique(plant, return_inverse=True)
    index = index.reshape(plant.shape)
    has_some = np.bincount(index[number != 0], minlength=index.max() + 1) > 0
    is_own = np.bincount(index[own == 1], minlength=index.max() + 1) > 0
    torn = (plant != 0) & (number == 0) & has_some[index]
    yield from wrong_pixels(frame, EXR, torn, "a plant of modules has none here", "a module's number", number)
    mixed = (plant != 0) & (number != 0) & (own == 0) & is_own[index]
    yield from wrong_pixels(frame, EXR, mixed, "a plant's branches are its own in other pixels only", "1", own)
