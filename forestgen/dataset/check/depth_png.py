"""depth.png against frame.exr: within half a step, with 0 for the sky and 65,535 beyond its reach."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from forestgen.dataset.check.check import FrameCheck
from forestgen.dataset.check.files import read_json
from forestgen.dataset.check.finding import Finding
from forestgen.dataset.check.frame_data import FrameData
from forestgen.dataset.check.pixels import wrong_pixels

PICTURE, SCALE = "depth.png", "depth.json"
_MOST, _BEYOND = 65_534, 65_535
_HALF = 0.5 + 1e-6  # a step; float32 against decimal


def has_depth_png(frame: FrameData) -> bool:
    return frame.has(PICTURE) and frame.has_part("depth", "Z")


def depth_png(frame: FrameData) -> Iterator[Finding]:
    """Steps times unit_m is the depth within half a step."""
    unit_m = float(read_json(frame.task.root, frame.file(SCALE))["unit_m"])
    if not 0 < unit_m < np.inf:
        yield frame.finding(SCALE, "unit_m is no length", expected="metres, more than 0 and finite", got=str(unit_m))
        return
    got = frame.picture(PICTURE).astype(np.float64)
    depth_m = frame.exr["depth"]["Z"].astype(np.float64)
    with np.errstate(over="ignore"):  # a depth in steps of almost nothing lies beyond the format
        steps = depth_m / unit_m
    sky = np.isinf(depth_m)
    yield from wrong_pixels(frame, PICTURE, (got == 0) != sky, "0 is the sky's alone", "0 for the sky", got)
    beyond = ~sky & (steps > _MOST + _HALF)
    wrong = beyond & (got != _BEYOND)
    yield from wrong_pixels(frame, PICTURE, wrong, "the depth is beyond the format", str(_BEYOND), got)
    near = ~sky & (steps <= _MOST)
    wrong = near & ~(np.abs(got - np.maximum(steps, 1.0)) <= _HALF)
    yield from wrong_pixels(frame, PICTURE, wrong, "the depth is not frame.exr's, in steps", steps, got)


FRAME_CHECKS = (FrameCheck("depth.png", "within half a step", PICTURE, has_depth_png, depth_png),)
