"""Light in frame.exr: radiance with its header, albedo, sun, clouds, occlusion boundaries; raw image and photograph."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.spectrum import LUMINANCE
from forestgen.dataset.check.files import (
    Finding,
    as_text,
    finding,
    read_bytes,
    read_jpeg,
    read_json,
    read_palette,
    read_picture,
)
from forestgen.dataset.check.frame_data import EXR, FrameData, Wrong, frame_check
from forestgen.dataset.ghosts import ghosts_of
from forestgen.dataset.optics import falloff, through_lens
from forestgen.dataset.photo import NAME as PHOTO
from forestgen.dataset.photo import photo_of
from forestgen.dataset.raw import Raw
from forestgen.dataset.safe_path import load_json
from forestgen.recipe.exposure import Jpeg
from forestgen.recipe.registries import PROJECTIONS
from forestgen.scene.projection import load_projection

_RAW, _PREVIEW = "raw.json", "preview.png"
_RADIANCE = ("radiance", "radiance.variance", "radiance.denoised")
_ROUNDED = 1e-3  # of the channels: luminance has four digits
_MARKS = ("sun", "boundary")  # 0 or 1
_REC709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
_LUMINANCE, _RADIANCE_PER_NM = "cd/m2", "W m-2 sr-1 nm-1"
_BLOCK_PX, _BLOCK_OFF = 8, 4.0  # of a photograph: mean difference of so wide squares
_SD_OF_A_PIXEL, _SD_OF_A_MEAN = 12.0, 7.0  # what chance does not bring about


@frame_check("radiance", EXR, when=lambda frame: any(part in frame.exr for part in _RADIANCE))
def radiance(frame: FrameData) -> Iterator[Wrong]:
    """Radiance and its variance are finite and not negative.

    Two exceptions: one replicate alone has neither a variance nor a relative error; and a colour made of wavelengths
    may lie outside of Rec. 709, when its luminance is not negative.
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
            yield Wrong(wrong, f"{part}.{name} is no light", "0 or more, finite", one)
        if part == "radiance" and spectral and set(values) == set("RGB"):
            light = np.stack([values[name].astype(np.float64) for name in "RGB"], axis=-1)
            luminance = light @ LUMINANCE
            wrong = luminance < -_ROUNDED * np.abs(light).sum(axis=-1)
            yield Wrong(wrong, "radiance has no luminance", "0 or more cd/m2", luminance)


@frame_check(
    "light", EXR,
    when=lambda frame: "depth" in frame.exr and any(part in frame.exr for part in (*_MARKS, "albedo", "cloud")),
)  # fmt: skip
def surfaces(frame: FrameData) -> Iterator[Wrong]:
    """Marks are 0 or 1, the sun shines on surfaces alone, albedo and cloud opacity lie within 0 to 1."""
    sky = np.isinf(frame.exr["depth"]["Z"])
    for part in _MARKS:
        for name, values in frame.exr.get(part, {}).items():
            yield Wrong(values > 1, f"{part}.{name} is no mark", "0 or 1", values)
    for name, values in frame.exr.get("sun", {}).items():
        yield Wrong(sky & (values != 0), f"sun.{name}: the sun shines on the sky", "0 for the sky", values)
    for name, values in frame.exr.get("albedo", {}).items():
        wrong = ~((values >= 0) & (values <= 1 + 1e-5))
        yield Wrong(wrong, f"albedo.{name} lies outside 0 to 1", "0 to 1", values)
        yield Wrong(sky & (values != 0), f"albedo.{name}: the sky has none", "0 for the sky", values)
    for name, values in frame.exr.get("cloud", {}).items():
        yield Wrong(~((values >= 0) & (values <= 1)), f"cloud.{name} lies outside 0 to 1", "0 to 1", values)


@frame_check("light units", EXR, when=lambda frame: "radiance" in frame.exr)
def header(frame: FrameData) -> Iterator[Finding]:
    """Radiance has a unit, colour a white, bands their figures; the biased part is named."""
    about, parts = frame.exr_header, frame.exr
    channels = list(parts.get("radiance", {}))
    bands = _bands(frame)
    if bands is None:
        if sorted(channels) != ["B", "G", "R"]:
            yield finding("channels without bands are no colour", "R G B", " ".join(channels))
        white = about.get("whiteLuminance")
        if white != 1.0:
            yield finding("whiteLuminance is not that of cd/m2", 1, "none" if white is None else white)
    elif sorted(bands) != sorted(channels):
        yield finding("forestgen/bands is not of radiance's channels", " ".join(channels), " ".join(bands))
    chromaticities = np.ravel(about.get("chromaticities", ()))
    if chromaticities.shape != (8,) or not np.allclose(chromaticities, _REC709, atol=1e-6):
        yield finding("chromaticities are not Rec. 709's", np.array(_REC709), as_text(chromaticities) or "none")
    unit = _LUMINANCE if bands is None else _RADIANCE_PER_NM
    for part in (one for one in _RADIANCE if one in parts):
        got = str(about.get(f"forestgen/units.{part}", "none"))
        expected = f"({unit})^2" if part == "radiance.variance" else unit
        if not got.startswith(expected):
            yield finding(f"forestgen/units.{part} is not its unit", expected, got)
        if list(parts[part]) != channels:
            yield finding(f"{part} has other channels than radiance", " ".join(channels), " ".join(parts[part]))
    if frame.has(_PREVIEW):
        view = read_palette(frame.root, frame.file(_PREVIEW))[1].get("view", "none")
        if view != about.get("forestgen/view"):
            yield finding("the view is not frame.exr's", about.get("forestgen/view"), view, file=frame.file(_PREVIEW))
    biased = "radiance.denoised" if "radiance.denoised" in parts else None
    if about.get("forestgen/biased") != biased:
        yield finding("forestgen/biased does not name the denoised part", biased, about.get("forestgen/biased"))


def _bands(frame: FrameData) -> list[str] | None:
    """Channels that the attribute forestgen/bands names; None where there is none."""
    text = frame.exr_header.get("forestgen/bands")
    if text is None:
        return None
    try:
        return [str(row.get("channel")) for row in load_json(str(text)) if isinstance(row, dict)]
    except ValueError as error:
        raise frame.refused(EXR, "forestgen/bands is no JSON", got=error) from error


@frame_check(
    "raw", _RAW,
    when=lambda frame: frame.has(_RAW) or frame.file(_RAW) in frame.listed,
)  # fmt: skip
def raw(frame: FrameData) -> Iterator[Finding | Wrong]:
    """Digital numbers lie within their range, and within their noise of the radiance."""
    facts = read_json(frame.root, frame.file(_RAW))
    black, white, bits, gain = (facts[name] for name in ("black_level", "white_level", "bits", "electrons_per_dn"))
    if not (0 <= black < white < 2**bits <= 2**16 and gain > 0):
        got = f"black {black}, white {white}, {bits} bits, {gain} electrons"
        yield finding("levels contradict each other", "0 <= black < white < 2^bits", got)
        return
    if facts["of"] not in frame.exr:
        yield finding("the raw image is of a part that frame.exr lacks", got=facts["of"])
        return
    light = frame.exr[facts["of"]]
    if facts.get("ghosts") is not None:
        shown = ghosts_of(facts["ghosts"], frame.size_px)
        light = {name: light[name] + shown[..., k] for k, name in enumerate(facts["ghosts"]["channels"])}
    for key, name in facts["files"].items():
        numbers = read_picture(frame.root, frame.file(name))
        if numbers.ndim != 2 or numbers.shape != frame.instance.shape:
            yield finding("the raw image has another size", frame.size_px, numbers.shape[::-1], file=frame.file(name))
            continue
        yield Wrong(numbers.astype(np.int64) > white, "brighter than white_level", str(white), numbers, name)
        yield from _noise(frame, name, numbers.astype(np.float64), _expected(frame, facts, light, key), facts)


def _noise(
    frame: FrameData, name: str, numbers: NDArray[np.float64], expected: NDArray[np.float64], facts: Mapping[str, Any]
) -> Iterator[Finding | Wrong]:
    """Pixels that are off by more than noise, and their mean."""
    gain, white = facts["electrons_per_dn"], facts["white_level"]
    electrons = (expected - facts["black_level"]) * gain
    variance = (electrons + facts["read_noise_electrons"] ** 2) / gain**2 + 1 / 12
    slack = _SD_OF_A_PIXEL * (np.sqrt(variance) + 1 / gain)
    cut = np.minimum(expected, white)
    yield Wrong(np.abs(numbers - cut) > slack, "a digital number is not the radiance's", cut, numbers, name)
    inside = expected + _SD_OF_A_MEAN * np.sqrt(variance) < white  # nothing is cut off
    off = float((numbers - expected)[inside].sum())
    if abs(off) > _SD_OF_A_MEAN * float(np.sqrt(variance[inside].sum())) + 1e-3 * inside.sum():
        got = f"{as_text(off / inside.sum())} digital numbers off"
        yield finding("the raw image's mean is not the radiance's", got=got, file=frame.file(name))


def _expected(
    frame: FrameData, facts: Mapping[str, Any], light: Mapping[str, NDArray[Any]], key: str
) -> NDArray[np.float64]:
    """(H, W) digital numbers without noise, not yet cut off at white."""
    scale, pattern = facts["radiance_per_dn"], facts["mosaic"]
    light = _behind_lens(facts, light)
    rows, columns = np.indices(frame.instance.shape)
    if pattern is None:
        values = light[key].astype(np.float64) / scale[key]
    else:
        values = np.zeros(frame.instance.shape)
        for row, column in np.ndindex(2, 2):
            own, channel = (rows % 2 == row) & (columns % 2 == column), pattern[row][column]
            values[own] = light[channel][own] / scale[channel]
    strength = facts["vignetting"]
    name = str(facts["projection"])
    if strength and name in PROJECTIONS and load_projection(name).is_pinhole:
        width, height = frame.size_px
        focal = width / 2 / np.tan(np.radians(facts["hfov_deg"]) / 2)
        slope = np.hypot(columns + 0.5 - width / 2, rows + 0.5 - height / 2) / focal
        values *= 1 - strength + strength / (1 + slope**2) ** 2
    values *= falloff(frame.size_px, facts.get("falloff", ()))
    return np.asarray(facts["black_level"] + values.clip(0.0))


def _behind_lens(facts: Mapping[str, Any], light: Mapping[str, NDArray[Any]]) -> Mapping[str, NDArray[Any]]:
    """The sensor's channels as its lens shows them."""
    names, colours = facts["channels"], facts.get("chromatic_aberration", ())
    glare, blur_px = facts.get("veiling_glare", 0), facts.get("blur_px", 0)
    if not any(colours) and not glare and not blur_px:
        return light
    stacked = np.stack([light[name].astype(np.float64).clip(0.0) for name in names], axis=-1)
    shown = through_lens(stacked, colours, glare, blur_px)
    return dict(zip(names, np.moveaxis(shown, -1, 0), strict=True))


@frame_check(
    "photo", _RAW,
    when=lambda frame: frame.has(PHOTO) or frame.file(PHOTO) in frame.listed,
)  # fmt: skip
def photo(frame: FrameData) -> Iterator[Finding]:
    """photo.jpg is the picture that the raw image and raw.json make; another encoder may round elsewhere."""
    facts = read_json(frame.root, frame.file(_RAW))
    about, planes = facts.get("photo"), {}
    if about is None:
        yield finding("raw.json knows no photo.jpg", "its white balance and quality", "none", file=frame.file(PHOTO))
        return
    for name in facts["files"].values():
        planes[name] = read_picture(frame.root, frame.file(name)).astype(np.uint16)
    jpeg = Jpeg(**{key: about[key] for key in Jpeg.model_fields if key in about})  # older ones have fewer
    made = photo_of(Raw(planes, facts, is_colour=True), jpeg)
    if abs(made.facts["temperature_k"] - about["temperature_k"]) > 1.0:
        yield finding("temperature_k is not the raw image's", made.facts["temperature_k"], about["temperature_k"])
    content = read_bytes(frame.root, frame.file(PHOTO))
    if content == made.content:
        return
    got, expected = read_jpeg(frame.root, frame.file(PHOTO)), made.decoded
    if got.shape != expected.shape:
        yield finding("photo.jpg has another size", expected.shape, got.shape, file=frame.file(PHOTO))
        return
    from scipy.ndimage import uniform_filter

    off = np.abs(got.astype(np.float64) - expected).mean(axis=2)
    wrong = int((uniform_filter(off, _BLOCK_PX) > _BLOCK_OFF).sum())
    if wrong:
        problem, got_px = "photo.jpg is not the raw image's picture", f"{wrong} pixels of other squares"
        yield finding(problem, f"mean differences up to {_BLOCK_OFF:g}", got_px, file=frame.file(PHOTO))
