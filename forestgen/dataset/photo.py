"""photo.jpg: the picture that a camera makes of its own raw image, with the sensor's noise and clipping in it.

1. Digital numbers less the black level, over the range: 1 is saturation.
2. Colours that a mosaic leaves out, by the linear filters of Malvar, He and Cutler (2004); linear Rec. 709 by the
   camera's colour matrix.
3. White balance. `daylight`: that of D65. `auto`: the temperature that the picture's own greys seem to have. Greys are
   pixels, neither clipped nor dark, whose green lies within 15% of what light of the CIE daylight locus would give at
   their ratio of red to blue: leaves and meadows are left out. The mean logarithm of that ratio gives the temperature,
   kept within 4000 and 10,000 K. Without greys it is 6504 K.
4. Brightness: a metered mean, which lies at 12.7% of saturation, comes to 18%, the half stop of ISO 12232.
5. Saturation: each pixel's difference from its luminance.
6. A curve that is steep about middle grey and reaches white where the first colour, balanced, is saturated, so that
   clipped highlights are white, and keeps hues (dataset/tonemap.py); the sRGB encoding.
7. Sharpening: each value's difference from a mean about it is added by a share, an unsharp mask. The mean is Pillow's
   approximation, by boxes, of a Gaussian of a standard deviation of 1 pixel.
8. JPEG, 4:2:0.

References
----------
CIE 15:2004, section 3.1, daylight illuminants. ISO 12232:2019.
Malvar, H. S., He, L. and Cutler, R. (2004). High-quality linear interpolation for demosaicing of Bayer-patterned color
images. ICASSP 2004, figure 2.
Buchsbaum, G. (1980). A spatial processor model for object colour perception. J. Franklin Institute 310, 1-26.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.spectrum import LUMINANCE
from forestgen.dataset.files import write_bytes
from forestgen.dataset.raw import Raw
from forestgen.dataset.tonemap import filmic
from forestgen.recipe.exposure import Exposure, Jpeg
from forestgen.scene.colour import rec709_from_xyz

NAME = "photo.jpg"
Floats = NDArray[np.float64]
_GAIN = np.sqrt(2.0)  # from 12.7% to 18%
_D65_K, _COOLEST_K, _WARMEST_K = 6504.0, 4000.0, 10_000.0
_GREY_WIDTH = 0.15  # of the green's ratio
_DARK, _FULL = 0.02, 0.95  # of saturation
_FEWEST_GREYS = 0.002  # of the pixels
_LAST_K = 25_000
_MASK_PX = 1.0
_GREEN = np.array([[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1], [0, 0, 2, 0, 0], [0, 0, -1, 0, 0]]) / 8
_BESIDE = np.array([[0, 0, 1, 0, 0], [0, -2, 0, -2, 0], [-2, 8, 10, 8, -2], [0, -2, 0, -2, 0], [0, 0, 1, 0, 0]]) / 16
_DIAGONAL = np.array([[0, 0, -3, 0, 0], [0, 4, 0, 4, 0], [-3, 0, 12, 0, -3], [0, 4, 0, 4, 0], [0, 0, -3, 0, 0]]) / 16
_TAGS = {33434: "shutter_s", 33437: "f_number", 34855: "iso"}  # Exif 2.32: ExposureTime, FNumber, sensitivity
_EXIF_IFD = 0x8769


@dataclass(frozen=True)
class Photo:
    """A picture and how it was made."""

    picture: NDArray[np.uint8]  # (H, W, 3) before compression
    content: bytes  # JPEG
    facts: Mapping[str, Any]  # for raw.json

    @property
    def decoded(self) -> NDArray[np.uint8]:
        """(H, W, 3) as it is read back."""
        from PIL import Image

        return np.asarray(Image.open(io.BytesIO(self.content)).convert("RGB"))


def photo_of(raw: Raw, jpeg: Jpeg) -> Photo:
    """The picture of a raw image of three colours."""
    light = linear_colours(raw)
    kelvin = _D65_K if jpeg.white_balance == "daylight" else grey_temperature(light)
    white_rgb = daylight_rgb(kelvin)
    gain = _GAIN * (np.array(LUMINANCE) @ white_rgb) / white_rgb
    white = float(gain.min())
    exposed = np.minimum(light * gain, white)  # saturation is white in all channels
    picture = filmic(saturated(exposed, jpeg.saturation).astype(np.float32), white, jpeg.contrast)
    picture = sharpened(picture, jpeg.sharpening)
    facts = {"file": NAME, "temperature_k": kelvin, **jpeg.model_dump()}
    return Photo(picture, _encoded(picture, jpeg.quality, raw.facts), facts)


def saturated(light: Floats, share: float) -> Floats:
    """(H, W, 3) with another share of each pixel's difference from its luminance, not below 0."""
    grey = (light @ np.array(LUMINANCE))[..., None]
    return np.asarray((grey + share * (light - grey)).clip(0.0))


def sharpened(picture: NDArray[np.uint8], share: float) -> NDArray[np.uint8]:
    """(H, W, 3) plus a share of its difference from its mean about each pixel, about a Gaussian of `_MASK_PX`."""
    from PIL import Image, ImageFilter

    if share == 0.0:
        return picture
    return np.asarray(Image.fromarray(picture).filter(ImageFilter.UnsharpMask(_MASK_PX, round(100 * share), 0)))


def with_photo(folder: Path, raw: Raw, exposure: Exposure) -> Raw:
    """Write the picture, if it is wanted; the raw image with what is said of it. A failure raises `OutputError`."""
    if exposure.jpeg is None or not raw.is_colour:
        return raw
    photo = photo_of(raw, exposure.jpeg)
    write_bytes(folder / NAME, photo.content)
    return replace(raw, facts={**raw.facts, "photo": dict(photo.facts)})


def linear_colours(raw: Raw) -> Floats:
    """(H, W, 3) linear Rec. 709, saturation 1, all colours in all pixels; a white surface under D65 is neutral."""
    facts = raw.facts
    black, white, names = facts["black_level"], facts["white_level"], facts["channels"]
    balance = np.array([facts["white_balance"][name] for name in names])
    planes = [(one.astype(np.float64) - black) / (white - black) for one in raw.planes.values()]
    if facts["mosaic"] is None:
        light = np.stack(planes, axis=-1) * balance
    else:
        pattern = np.array([[names.index(one) for one in row] for row in facts["mosaic"]])
        light = _demosaiced(planes[0], pattern, balance)
    # Clipped first: what is saturated is white, whatever its colour was.
    return np.asarray(np.clip(np.clip(light, 0.0, 1.0) @ np.array(facts["colour_matrix"]).T, 0.0, 1.0))


def _demosaiced(image: Floats, pattern: NDArray[np.int64], balance: Floats) -> Floats:
    """(H, W, 3) of squares of R G over G B."""
    from scipy.ndimage import convolve

    rows, columns = np.indices(image.shape) % 2
    channel = pattern[rows, columns]
    image = image * balance[channel]
    green, along, down, across = (
        convolve(image, one, mode="mirror") for one in (_GREEN, _BESIDE, _BESIDE.T, _DIAGONAL)
    )
    red_row = rows == 0
    red = np.where(channel == 2, across, np.where(red_row, along, down))
    blue = np.where(channel == 0, across, np.where(red_row, down, along))
    found = np.stack([red, green, blue], axis=-1)
    return np.asarray(np.where(channel[..., None] == np.arange(3), image[..., None], found))


def grey_temperature(light: Floats) -> float:
    """Kelvin of the light that (H, W, 3) colours, neutral under D65, seem to stand in."""
    colours = light.reshape(-1, 3)
    usable = (colours.min(axis=1) > _DARK) & (colours.max(axis=1) < _FULL)
    red, green = (np.log(colours[usable, k] / colours[usable, 2 if k == 0 else 0]) for k in (0, 1))
    kelvin, locus = _locus()
    ratio, expected = locus[:, 0] - locus[:, 2], locus[:, 1] - locus[:, 0]  # falls as the temperature rises
    near = np.interp(red, ratio[::-1], expected[::-1])
    grey = np.abs(green - near) < _GREY_WIDTH
    if grey.sum() < max(_FEWEST_GREYS * len(colours), 1):
        return _D65_K
    found = np.interp(red[grey].mean(), ratio[::-1], kelvin[::-1])
    return round(float(np.clip(found, _COOLEST_K, _WARMEST_K)), 1)


def daylight_rgb(kelvin: float) -> Floats:
    """(3,) linear Rec. 709 of a white surface in daylight of a temperature, green 1; (1, 1, 1) of D65."""
    temperatures, locus = _locus()
    at = np.array([np.interp(kelvin, temperatures, locus[:, k]) for k in range(3)])
    return np.asarray(np.exp(at - at[1]))


@cache
def _locus() -> tuple[Floats, Floats]:
    """Temperatures, and (N, 3) logarithms of linear Rec. 709 over that of D65."""
    kelvin = np.arange(_COOLEST_K, _LAST_K + 1, 50.0)

    def rgb(t: Floats) -> Floats:
        low = -4.6070e9 / t**3 + 2.9678e6 / t**2 + 0.09911e3 / t + 0.244063
        high = -2.0064e9 / t**3 + 1.9018e6 / t**2 + 0.24748e3 / t + 0.237040
        x = np.where(t <= 7000.0, low, high)
        y = -3.0 * x**2 + 2.870 * x - 0.275
        return np.stack([x / y, np.ones_like(x), (1 - x - y) / y], axis=-1) @ rec709_from_xyz().T

    return kelvin, np.log(np.maximum(rgb(kelvin), 1e-3) / rgb(np.array([_D65_K])))


def _encoded(picture: NDArray[np.uint8], quality: int, facts: Mapping[str, Any]) -> bytes:
    """JPEG without a date, exposure in its Exif."""
    from PIL import Image

    exif = Image.Exif()
    of_exposure = exif.get_ifd(_EXIF_IFD)
    for tag, name in _TAGS.items():
        of_exposure[tag] = round(facts[name]) if name == "iso" else float(facts[name])
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "JPEG", quality=quality, subsampling="4:2:0", optimize=True, exif=exif)
    return buffer.getvalue()
