"""Raw images: what a sensor would have recorded of the radiance, in digital numbers, beside the linear truth.

From luminance L (cd/m²) to digital numbers, pixel by pixel:

    illuminance on the sensor   E = pi L V / (4 N²)                a lens focused far away that loses no light
    vignetting                  V = 1 - v + v cos⁴(theta)          theta: between the pixel's ray and the axis
    lens                        falloff, lateral colour, blur, glare     dataset/optics.py
    exposure                    H = E t                            lux seconds
    saturation                  H_sat = 78 / S                     ISO 12232; S: iso
    electrons expected          n = H F S_0 / 78                   F: full_well_electrons; S_0: base_iso
    electrons counted           Poisson(n) + Normal(0, r)          shot noise; r: read_noise_electrons
    digital number              D = round(black + electrons / g), clipped to 0 ... white = 2^bits - 1
    gain, electrons a number    g = F (S_0 / S) / (white - black)

So saturation fills the well at the base iso; at twice that, half of a well already reaches white and noise is larger.
The black level is 1/32 of the range, or five times the read noise if that is more, so that noise about zero is not cut
off. A shutter that is not given is metered: N² / t = L S / K of the mean luminance (recipe/cameras.py), without the
brightest half percent, such as the sun's disc. That puts the mean at 12.6% of saturation, as ISO 12232 has it.

What L is by channel:

- Colour: red, green and blue of linear Rec. 709, as if the sensor's filters were that space's matching functions. A
  negative value, of a colour more saturated than the space holds, counts as 0.
- A colour camera's three bands: electrons are in proportion to the integral of response times radiance, in which the
  three responses share a scale; under D65 light of luminance L the strongest channel has n of L. So a white surface is
  not neutral, as in any camera's raw image: `white_balance` makes it so, and `colour_matrix` (dataset/colour_matrix.py)
  turns the balanced values into linear Rec. 709.
- Other bands: each has a sensor of its own, which D65 of luminance L gives n of L. Beyond 780 nm D65 goes on as a black
  body of its temperature.

The light is the denoised radiance where there is one, else the rendered mean: Monte Carlo noise then adds to the
sensor's. Noise is drawn from the image's seed and the camera's name alone.

Files: ``raw.png``, 16-bit grey, one colour a pixel in squares of R G over G B; without mosaic, and for bands that are
no colour camera's, ``raw-NAME.png`` a channel (readers of 16-bit grey are many, of 16-bit colour few). ``raw.json``
has the numbers that lead back::

    radiance of the channel = (D - black_level) radiance_per_dn[channel] / V

V includes the falloff; lateral colour, blur, glare and ghosts (dataset/ghosts.py) are not undone by it.
dataset/photo.py has the camera's picture.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.randomness import child_rng
from forestgen.core.spectrum import LUMINANCE, SECOND_RADIATION_NM_K, Band, Spectrum
from forestgen.dataset.files import write_json
from forestgen.dataset.ghosts import COLOURS_NM, ghosts_of
from forestgen.dataset.optics import falloff, through_lens
from forestgen.dataset.png import write_png
from forestgen.dataset.tonemap import centre_nm, picture_bands
from forestgen.recipe.exposure import Exposure
from forestgen.recipe.spectra import load_table
from forestgen.render.frame import Radiance
from forestgen.render.metering import metered_luminance
from forestgen.scene.colour import colour_of_radiance
from forestgen.scene.projection import centre_rays, projection_of
from forestgen.scene.spec import Camera

JSON_NAME = "raw.json"
SCHEMA = "forestgen-raw/1"
SATURATION_LUX_S = 78.0  # at ISO 1: ISO 12232, saturation-based speed
_BLACK_SHARE = 1 / 32
_ROWS = 256  # even, as the mosaic's squares are
_READ_NOISES = 5.0  # that fit below the black level
_D65_KELVIN, _D65_END_NM, _LAST_NM = 6504.0, 780, 2500
_MOSAIC = ((0, 1), (1, 2))  # red, green over green, blue: index of the channel by row and column

_EXPOSURE = (
    "read_noise_electrons", "full_well_electrons", "f_number", "iso", "base_iso", "vignetting", "veiling_glare",
    "blur_px",
)  # fmt: skip

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Raw:
    """A raw image in memory."""

    planes: Mapping[str, NDArray[np.uint16]]  # file -> (H, W) digital numbers
    facts: Mapping[str, Any]  # raw.json
    is_colour: bool  # of three colours


@dataclass(frozen=True)
class _Sensor:
    """How channels answer to light."""

    names: tuple[str, ...]
    columns: tuple[int, ...]  # of each, in the radiance's channels
    luminance_per_radiance: Floats  # (C,) cd/m² of L by the channel's unit
    white_balance: Floats  # (C,) factors that make a white surface under D65 neutral
    meter: Floats  # (C,) weights of `luminance` by channel in the metered one
    colour_matrix: Floats | None  # (3, 3) from balanced values to linear Rec. 709; of three colours
    is_colour: bool


def raw_image(radiance: Radiance, camera: Camera, exposure: Exposure, seed: int) -> Raw:
    """A camera's raw image; `seed` is the image's."""
    sensor = _sensor(radiance)
    light = radiance.mean if radiance.denoised is None else radiance.denoised
    shutter_s = exposure.shutter_for_s(_metered_luminance(light, sensor, camera))
    ghosts = _ghosts(radiance, camera, exposure)
    if ghosts is not None:
        light = light + ghosts_of(ghosts, camera.size_px).astype(np.float32)
    black, white, gain = levels(exposure)
    electrons_per_luminance = (
        np.pi / 4 * shutter_s / exposure.f_number**2 * exposure.full_well_electrons * exposure.base_iso
    ) / SATURATION_LUX_S
    mosaic = exposure.mosaic and sensor.is_colour
    names = ("",) if mosaic else sensor.names
    numbers = np.empty((*light.shape[:2], len(names)), dtype=np.uint16)
    shade = vignetting(camera, exposure.vignetting) * falloff(camera.size_px, exposure.falloff)
    shade = shade[..., None] * electrons_per_luminance
    arrives = _arriving(light, sensor, exposure)
    shot, read = child_rng(seed, "raw", camera.name).spawn(2)
    for first in range(0, len(light), _ROWS):  # not all in float64 at once; no number depends on it
        rows = slice(first, first + _ROWS)
        expected = (_luminance(light[rows], sensor) if arrives is None else arrives[rows]) * shade[rows]
        if mosaic:
            expected = mosaiced(expected)[..., None]
        # Far above white nothing differs, and Poisson's numbers are bounded.
        full = 4.0 * gain * (white - black) + 1e4
        electrons = shot.poisson(np.minimum(np.nan_to_num(expected, posinf=full), full)).astype(np.float64)
        electrons += read.normal(0.0, 1.0, expected.shape) * exposure.read_noise_electrons
        numbers[rows] = np.clip(np.rint(black + electrons / gain), 0, white)
    planes = {f"raw-{name}.png" if name else "raw.png": numbers[..., k] for k, name in enumerate(names)}
    per_dn = gain / (electrons_per_luminance * sensor.luminance_per_radiance)
    facts = {
        "schema": SCHEMA,
        "size_px": [int(side) for side in camera.size_px],
        "channels": list(sensor.names),
        "files": {"mosaic": "raw.png"} if mosaic else dict(zip(names, planes, strict=True)),
        "mosaic": [[sensor.names[channel] for channel in row] for row in _MOSAIC] if mosaic else None,
        "bits": exposure.bits,
        "black_level": black,
        "white_level": white,
        "electrons_per_dn": gain,
        "shutter_s": float(shutter_s),
        **{name: float(getattr(exposure, name)) for name in _EXPOSURE},
        "falloff": list(exposure.falloff),
        "chromatic_aberration": list(exposure.chromatic_aberration if sensor.is_colour else (0.0, 0.0)),
        "ghosts": ghosts,
        "projection": camera.projection,
        "hfov_deg": float(camera.hfov_deg),
        "radiance_per_dn": dict(zip(sensor.names, per_dn.tolist(), strict=True)),
        "white_balance": dict(zip(sensor.names, sensor.white_balance.tolist(), strict=True)),
        "colour_matrix": None if sensor.colour_matrix is None else sensor.colour_matrix.tolist(),
        "radiance_unit": "W m-2 sr-1 nm-1" if radiance.bands else "cd/m2",
        "of": "radiance" if radiance.denoised is None else "radiance.denoised",
    }
    return Raw(planes, facts, sensor.is_colour)


def write_raw(folder: Path, raw: Raw) -> None:
    """Write a raw image's files; a failure raises `OutputError`."""
    for name, numbers in raw.planes.items():
        write_png(folder / name, numbers)
    write_json(folder / JSON_NAME, raw.facts)


def levels(exposure: Exposure) -> tuple[int, int, float]:
    """Black level, white level, and electrons a digital number."""
    white = (1 << exposure.bits) - 1
    saturation = exposure.full_well_electrons * exposure.base_iso / exposure.iso
    noise = _READ_NOISES * exposure.read_noise_electrons / saturation
    black = int(np.ceil((1 << exposure.bits) * max(_BLACK_SHARE, noise / (1 + noise))))
    black = min(black, white - 1)
    return black, white, saturation / (white - black)


def vignetting(camera: Camera, strength: float) -> Floats:
    """(H, W) share of light that reaches a pixel beside one on the axis; 1 of lenses of other projections."""
    width, height = camera.size_px
    if not strength or not projection_of(camera).is_pinhole:
        return np.ones((height, width))
    cosine = centre_rays(camera).direction[..., 2]
    return np.asarray(1.0 - strength + strength * cosine**4)


def mosaiced(values: Floats) -> Floats:
    """(H, W) of (H, W, 3): each pixel's own colour, R G over G B."""
    height, width = values.shape[:2]
    row, column = np.arange(height) % 2, np.arange(width) % 2
    channel = np.asarray(_MOSAIC)[row[:, None], column]
    return np.take_along_axis(values, channel[..., None], axis=-1)[..., 0]


def _luminance(light: NDArray[np.float32], sensor: _Sensor) -> Floats:
    """(H, W, C) what L is by channel, cd/m²."""
    return np.asarray(light[..., list(sensor.columns)].astype(np.float64).clip(0.0) * sensor.luminance_per_radiance)


def _arriving(light: NDArray[np.float32], sensor: _Sensor, exposure: Exposure) -> Floats | None:
    """(H, W, C) what L is behind the lens; None: the lens changes nothing."""
    colours = exposure.chromatic_aberration if sensor.is_colour else (0.0, 0.0)
    if not any(colours) and not exposure.veiling_glare and not exposure.blur_px:
        return None
    return through_lens(_luminance(np.nan_to_num(light), sensor), colours, exposure.veiling_glare, exposure.blur_px)


def _ghosts(radiance: Radiance, camera: Camera, exposure: Exposure) -> dict[str, Any] | None:
    """What ghosts follow from, by the radiance's channels; None: there are none."""
    if exposure.ghosts is None or radiance.sun is None:
        return None
    x, y, z = radiance.sun.direction
    nm = [centre_nm(band) for band in radiance.bands] or [COLOURS_NM[name] for name in radiance.channels]
    return {
        "surfaces": exposure.ghosts,
        "f_number": float(exposure.f_number),
        "focal_px": camera.focal_px,
        "sun_px": [x / z * camera.focal_px, y / z * camera.focal_px],
        "channels": list(radiance.channels),
        "irradiance": list(radiance.sun.irradiance),
        "wavelength_nm": nm,
    }


def _metered_luminance(light: NDArray[np.float32], sensor: _Sensor, camera: Camera) -> float:
    """Mean over the picture, without the brightest."""
    parts = [_luminance(light[first : first + _ROWS], sensor) @ sensor.meter for first in range(0, len(light), _ROWS)]
    return metered_luminance(np.concatenate(parts), camera)


def _sensor(radiance: Radiance) -> _Sensor:
    bands = radiance.bands
    if not bands:
        return _Sensor(
            radiance.channels, (0, 1, 2), np.ones(3), np.ones(3), np.array(LUMINANCE), np.eye(3), is_colour=True
        )
    chosen = picture_bands(bands)
    colour = len(bands) == 3 and chosen.kind == "true colour"
    columns = chosen.channels if colour else tuple(range(len(bands)))
    power = np.array([bands[column].mean(d65()) for column in columns])
    responses = [bands[column].response for column in columns]
    answer = power * [float(np.trapezoid(one.value, one.wavelength_nm)) for one in responses]
    sensitivity = answer / answer.max() if colour else np.ones(len(bands))
    names = tuple(radiance.channels[column] for column in columns)
    meter = 1.0 / sensitivity / len(names)
    matrix = _colour_matrix(tuple(bands[column] for column in columns)) if colour else None
    return _Sensor(names, columns, sensitivity / power, 1.0 / sensitivity, meter, matrix, colour)


def _colour_matrix(bands: tuple[Band, ...]) -> Floats:
    """Of cameras alone: the chart's reflectances are those of a library that takes a second to import."""
    from forestgen.dataset.colour_matrix import colour_matrix

    return colour_matrix(bands, d65())


@cache
def d65() -> Spectrum:
    """D65 of luminance 1 cd/m², W/m²/sr/nm; beyond 780 nm a black body of 6504 K goes on."""
    light = load_table("standards/d65")["power"]
    wavelength = np.arange(300, _LAST_NM + 1, 5, dtype=np.float64)
    value = light.at(wavelength)
    beyond = wavelength > _D65_END_NM
    planck = wavelength**-5.0 / np.expm1(SECOND_RADIATION_NM_K / (wavelength * _D65_KELVIN))
    value[beyond] = planck[beyond] / planck[~beyond][-1] * value[~beyond][-1]
    luminance = float(np.array(LUMINANCE) @ colour_of_radiance(Spectrum(wavelength, value)))
    return Spectrum(wavelength, value / luminance)
