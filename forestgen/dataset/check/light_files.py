"""What frame.exr says of its light, and the raw image beside it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.check.files import read_json, read_palette, read_picture
from forestgen.dataset.check.finding import Finding, UnreadableError, number
from forestgen.dataset.check.frame_data import EXR, FrameData
from forestgen.dataset.check.pixels import wrong_pixels
from forestgen.dataset.safe_path import load_json
from forestgen.recipe.registries import PROJECTIONS
from forestgen.scene.projection import load_projection

RAW, _PREVIEW = "raw.json", "preview.png"
_RADIANCE = ("radiance", "radiance.variance", "radiance.denoised")
_REC709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
_LUMINANCE, _RADIANCE_PER_NM = "cd/m2", "W m-2 sr-1 nm-1"
_SD_OF_A_PIXEL, _SD_OF_A_MEAN = 12.0, 7.0  # what chance does not bring about
_LEVELS = ("black_level", "white_level", "bits", "electrons_per_dn", "read_noise_electrons", "vignetting")


def header(frame: FrameData) -> Iterator[Finding]:
    """Radiance has a unit, colour a white, bands their figures; the biased part is named."""
    about, parts = frame.exr_header, frame.exr
    channels = list(parts.get("radiance", {}))
    bands = _bands(about.get("forestgen/bands"))
    if bands is None:
        if sorted(channels) != ["B", "G", "R"]:
            yield frame.finding(EXR, "channels without bands are no colour", expected="R G B", got=" ".join(channels))
        white = about.get("whiteLuminance")
        if white is None or white != 1.0:
            problem = "whiteLuminance is not that of cd/m2"
            yield frame.finding(EXR, problem, expected="1", got="none" if white is None else number(white))
    elif sorted(str(band.get("channel")) for band in bands) != sorted(channels):
        got = " ".join(str(band.get("channel")) for band in bands)
        yield frame.finding(EXR, "forestgen/bands is not of radiance's channels", expected=" ".join(channels), got=got)
    chromaticities = np.ravel(about.get("chromaticities", ()))
    if chromaticities.shape != (8,) or not np.allclose(chromaticities, _REC709, atol=1e-6):
        got = " ".join(map(number, chromaticities)) or "none"
        yield frame.finding(EXR, "chromaticities are not Rec. 709's", expected=" ".join(map(str, _REC709)), got=got)
    unit = _LUMINANCE if bands is None else _RADIANCE_PER_NM
    for part in _RADIANCE:
        if part not in parts:
            continue
        told = str(about.get(f"forestgen/units.{part}", "none"))
        wanted = f"({unit})^2" if part == "radiance.variance" else unit
        if not told.startswith(wanted):
            yield frame.finding(EXR, f"forestgen/units.{part} is not its unit", expected=wanted, got=told)
        if list(parts[part]) != channels:
            got = " ".join(parts[part])
            yield frame.finding(EXR, f"{part} has other channels than radiance", expected=" ".join(channels), got=got)
    if frame.has(_PREVIEW):
        told = read_palette(frame.task.root, frame.file(_PREVIEW))[1].get("view", "none")
        if told != about.get("forestgen/view"):
            wanted = str(about.get("forestgen/view"))
            yield frame.finding(_PREVIEW, "the view is not frame.exr's", expected=wanted, got=told)
    biased = "radiance.denoised" if "radiance.denoised" in parts else None
    if about.get("forestgen/biased") != biased:
        got = str(about.get("forestgen/biased"))
        yield frame.finding(EXR, "forestgen/biased does not name the denoised part", expected=str(biased), got=got)


def raw(frame: FrameData) -> Iterator[Finding]:
    """Digital numbers lie within their range, and within their noise of the radiance."""
    facts = read_json(frame.task.root, frame.file(RAW))
    black, white, bits, gain, _, _ = (facts[name] for name in _LEVELS)
    if not (0 <= black < white < 2**bits <= 2**16 and gain > 0):
        got = f"black {black}, white {white}, {bits} bits, {gain} electrons"
        yield frame.finding(RAW, "levels contradict each other", expected="0 <= black < white < 2^bits", got=got)
        return
    if facts["of"] not in frame.exr:
        yield frame.finding(RAW, "the raw image is of a part that frame.exr lacks", got=str(facts["of"]))
        return
    light = frame.exr[facts["of"]]
    for key, name in facts["files"].items():
        numbers = read_picture(frame.task.root, frame.file(name))
        if numbers.ndim != 2 or numbers.shape != frame.instance.shape:
            got = " x ".join(map(str, numbers.shape[::-1]))
            yield frame.finding(name, "the raw image has another size", expected=str(frame.size_px), got=got)
            continue
        wrong = numbers.astype(np.int64) > white
        yield from wrong_pixels(frame, name, wrong, "brighter than white_level", str(white), numbers)
        yield from _noise(frame, name, numbers.astype(np.float64), _expected(frame, facts, light, key), facts)


def has_raw(frame: FrameData) -> bool:
    return frame.has(RAW) or frame.file(RAW) in frame.task.listed


def has_radiance(frame: FrameData) -> bool:
    return "radiance" in frame.exr


def _noise(
    frame: FrameData, name: str, numbers: NDArray[np.float64], expected: NDArray[np.float64], facts: Mapping[str, Any]
) -> Iterator[Finding]:
    """Findings of pixels that are off by more than noise, and of their mean."""
    gain, white = facts["electrons_per_dn"], facts["white_level"]
    electrons = (expected - facts["black_level"]) * gain
    variance = (electrons + facts["read_noise_electrons"] ** 2) / gain**2 + 1 / 12
    slack = _SD_OF_A_PIXEL * (np.sqrt(variance) + 1 / gain)
    wrong = np.abs(numbers - np.minimum(expected, white)) > slack
    problem = "a digital number is not the radiance's"
    yield from wrong_pixels(frame, name, wrong, problem, np.minimum(expected, white), numbers)
    inside = expected + _SD_OF_A_MEAN * np.sqrt(variance) < white  # nothing is cut off
    off = float((numbers - expected)[inside].sum())
    if abs(off) > _SD_OF_A_MEAN * float(np.sqrt(variance[inside].sum())) + 1e-3 * inside.sum():
        got = f"{number(off / inside.sum())} digital numbers off"
        yield frame.finding(name, "the raw image's mean is not the radiance's", got=got)


def _expected(
    frame: FrameData, facts: Mapping[str, Any], light: Mapping[str, NDArray[Any]], key: str
) -> NDArray[np.float64]:
    """(H, W) digital numbers without noise, not yet cut off at white."""
    scale = facts["radiance_per_dn"]
    rows, columns = np.indices(frame.instance.shape)
    if facts["mosaic"] is None:
        values = light[key].astype(np.float64) / scale[key]
    else:
        pattern = facts["mosaic"]
        values = np.zeros(frame.instance.shape)
        for row in range(2):
            for column in range(2):
                own = (rows % 2 == row) & (columns % 2 == column)
                values[own] = light[pattern[row][column]][own] / scale[pattern[row][column]]
    strength = facts["vignetting"]
    name = str(facts["projection"])
    if strength and name in PROJECTIONS and load_projection(name).is_pinhole:
        width, height = frame.size_px
        focal = width / 2 / np.tan(np.radians(facts["hfov_deg"]) / 2)
        slope = np.hypot(columns + 0.5 - width / 2, rows + 0.5 - height / 2) / focal
        values *= 1 - strength + strength / (1 + slope**2) ** 2
    return np.asarray(facts["black_level"] + values.clip(0.0))


def _bands(text: object) -> list[Mapping[str, Any]] | None:
    """Rows of the attribute; None where there is none."""
    if text is None:
        return None
    try:
        rows = load_json(str(text))
    except ValueError as error:
        problem = "forestgen/bands is no JSON"
        raise UnreadableError(Finding(EXR, problem, got=str(error))) from error
    return [row for row in rows if isinstance(row, dict)]
