"""Light's channels: radiance, albedo, sun, clouds; and the marks of occlusion boundaries."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from forestgen.core.spectrum import LUMINANCE
from forestgen.dataset.check.finding import Finding
from forestgen.dataset.check.frame_data import EXR, FrameData
from forestgen.dataset.check.pixels import wrong_pixels

_RADIANCE = ("radiance", "radiance.denoised", "radiance.variance")
_ROUNDED = 1e-3  # of the channels: luminance has four digits
_MARKS = ("sun", "boundary")  # 0 or 1


def radiance(frame: FrameData) -> Iterator[Finding]:
    """Radiance and its variance are finite and not negative.

    Two exceptions: of one replicate alone no variance is known, nor a relative error told; and a colour made of
    wavelengths may lie outside of Rec. 709, when its luminance is not negative.
    """
    spectral = frame.recipe["render"].get("mode") == "spectral" and "forestgen/bands" not in frame.exr_header
    for part in _RADIANCE:
        values = frame.exr.get(part, {})
        unknown = part == "radiance.variance" and "forestgen/relative_error" not in frame.exr_header
        if unknown and all(np.isnan(one).all() for one in values.values()):
            continue
        for name, one in values.items():
            wrong = ~np.isfinite(one)
            if part == "radiance.variance" or (part == "radiance" and not spectral):
                wrong |= ~(one >= 0)
            yield from wrong_pixels(frame, EXR, wrong, f"{part}.{name} is no light", "0 or more, finite", one)
        if part == "radiance" and spectral and set(values) == set("RGB"):
            light = np.stack([values[name].astype(np.float64) for name in "RGB"], axis=-1)
            luminance = light @ LUMINANCE
            wrong = luminance < -_ROUNDED * np.abs(light).sum(axis=-1)
            yield from wrong_pixels(frame, EXR, wrong, "radiance has no luminance", "0 or more cd/m2", luminance)


def surfaces(frame: FrameData) -> Iterator[Finding]:
    """Marks are 0 or 1, the sun shines on surfaces alone, albedo and cloud opacity lie within 0 to 1."""
    sky = np.isinf(frame.exr["depth"]["Z"])
    for part in _MARKS:
        for name, values in frame.exr.get(part, {}).items():
            yield from wrong_pixels(frame, EXR, values > 1, f"{part}.{name} is no mark", "0 or 1", values)
    for name, values in frame.exr.get("sun", {}).items():
        wrong = sky & (values != 0)
        yield from wrong_pixels(frame, EXR, wrong, f"sun.{name}: the sun shines on the sky", "0 for the sky", values)
    for name, values in frame.exr.get("albedo", {}).items():
        wrong = ~((values >= 0) & (values <= 1 + 1e-5))
        yield from wrong_pixels(frame, EXR, wrong, f"albedo.{name} lies outside 0 to 1", "0 to 1", values)
        wrong = sky & (values != 0)
        yield from wrong_pixels(frame, EXR, wrong, f"albedo.{name}: the sky has none", "0 for the sky", values)
    for name, values in frame.exr.get("cloud", {}).items():
        wrong = ~((values >= 0) & (values <= 1))
        yield from wrong_pixels(frame, EXR, wrong, f"cloud.{name} lies outside 0 to 1", "0 to 1", values)


def has_radiance(frame: FrameData) -> bool:
    return any(part in frame.exr for part in _RADIANCE)


def has_light(frame: FrameData) -> bool:
    return "depth" in frame.exr and any(part in frame.exr for part in (*_MARKS, "albedo", "cloud"))
