"""Spectra to colours, linear Rec. 709 by the CIE 1931 observer of 2 degrees, and to the channels of a pass.

The colour of a reflectance is that of the surface under D65, a perfect white being (1, 1, 1). The colour of light is
absolute: 0.2126 R + 0.7152 G + 0.0722 B is its luminance in cd/m².

A path through the scene does not care what its three numbers mean. So a spectral image is made of passes, each with
three wavelengths of its own, and a pass differs from one in colour by nothing but its numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.spectrum import LUMENS_PER_WATT, Spectrum
from forestgen.recipe.spectra import load_table

Floats = NDArray[np.float64]

# XYZ to Rec. 709: the inverse of its primaries (0.64, 0.33), (0.30, 0.60), (0.15, 0.06) and white (0.3127, 0.3290).
_PRIMARIES_XY = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06))
_WHITE_XY = (0.3127, 0.3290)


def colour_science() -> Any:
    """The package colour, whose import takes seconds and would change how NumPy prints for the rest of the process."""
    with np.printoptions():
        import colour
    return colour


def _xyz(xy: tuple[float, float]) -> Floats:
    return np.array([xy[0] / xy[1], 1.0, (1.0 - xy[0] - xy[1]) / xy[1]])


@cache
def rec709_from_xyz() -> Floats:
    """(3, 3) linear Rec. 709 from CIE XYZ (ITU-R BT.709-6): a white of luminance 1 is (1, 1, 1)."""
    primaries_xyz = np.stack([_xyz(xy) for xy in _PRIMARIES_XY], axis=1)
    return np.asarray(np.linalg.inv(primaries_xyz * np.linalg.solve(primaries_xyz, _xyz(_WHITE_XY))))


@cache
def observer() -> tuple[Floats, Floats]:
    """(W,) nm; (3, W) responses of linear Rec. 709: their integral over radiance per nm is colour in cd/m².

    From shipped tables, since importing colour-science takes seconds; tests/unit/scene/test_colour.py compares them.
    """
    matching = load_table("responses/cie_1931")
    wavelength = matching["x"].wavelength_nm
    xyz = np.stack([matching[name].value for name in "xyz"])
    return wavelength, LUMENS_PER_WATT * rec709_from_xyz() @ xyz


@cache
def _d65() -> Floats:
    """(W,) D65 on the observer's wavelengths, scaled so that a white under it has the luminance 1."""
    wavelength, _ = observer()
    power = load_table("standards/d65")["power"].at(wavelength)
    luminance = LUMENS_PER_WATT * load_table("responses/cie_1931")["y"].value @ power
    return np.asarray(power / luminance)


def colour_of_reflectance(spectrum: Spectrum) -> Floats:
    """(3,) linear Rec. 709 of a surface under D65. Saturated ones may lie outside of [0, 1]."""
    wavelength, response = observer()
    return np.asarray(response @ (_d65() * spectrum.at(wavelength)))


def colours_of_surface(
    reflectance: Spectrum, transmittance: Spectrum | None
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Colours of a surface's reflectance and transmittance, each in [0, 1] and their sum at most 1.

    Colours outside of Rec. 709 are clipped. A saturated orange may send back more red than a white does, though the
    surface sends back no more than arrives at any wavelength: its channel is scaled to a sum of 1.
    """
    r = np.clip(colour_of_reflectance(reflectance), 0.0, 1.0)
    t = np.zeros(3) if transmittance is None else np.clip(colour_of_reflectance(transmittance), 0.0, 1.0)
    scale = 1.0 / np.maximum(r + t, 1.0)
    (r0, r1, r2), (t0, t1, t2) = (r * scale).tolist(), (t * scale).tolist()
    return (r0, r1, r2), (t0, t1, t2)


def colour_of_radiance(spectrum: Spectrum) -> Floats:
    """(3,) linear Rec. 709 of light in W/m²/sr/nm; its luminance is in cd/m². Of irradiance: in lux."""
    wavelength, response = observer()
    return np.asarray(response @ spectrum.at(wavelength))


@cache
def primaries() -> tuple[Spectrum, Spectrum, Spectrum]:
    """Reflectances whose sum by a colour's red, green and blue has that colour under D65 (Mallett and Yuksel 2019).

    They add up to 1 at every wavelength, so a colour in [0, 1] has a spectrum in [0, 1]. They are made for 380 to
    780 nm and stay as they are beyond: of a surface's infrared a colour knows nothing.
    """
    basis = load_table("standards/mallett_2019")
    return basis["red"], basis["green"], basis["blue"]


@dataclass(frozen=True)
class Channels:
    """Three channels of a pass."""

    wavelength_nm: tuple[float, float, float] | None = None  # None: linear Rec. 709

    def of_light(self, spectrum: Spectrum) -> Floats:
        """(3,) of radiance or irradiance per nm: per nm at the wavelengths; or in colour, in cd/m² or lux."""
        return colour_of_radiance(spectrum) if self.wavelength_nm is None else spectrum.at(self.wavelength_nm)

    def of_surface(self, colour: Sequence[float], spectrum: Spectrum | None) -> Floats:
        """(3,) of a reflectance or transmittance, in [0, 1]: by its spectrum, or by what its colour stands for."""
        if self.wavelength_nm is None:
            return np.clip(np.asarray(colour, dtype=np.float64), 0.0, 1.0)
        if spectrum is None:
            return np.clip(self._basis() @ np.asarray(colour, dtype=np.float64), 0.0, 1.0)
        return np.clip(spectrum.at(self.wavelength_nm), 0.0, 1.0)

    def of_absorption(self, spectrum: Spectrum) -> Floats:
        """(3,) of an absorption in 1/m: at the wavelengths; or by the colour of what a metre lets through."""
        if self.wavelength_nm is not None:
            return spectrum.at(self.wavelength_nm)
        through = colour_of_reflectance(Spectrum(spectrum.wavelength_nm, np.exp(-spectrum.value)))
        return np.asarray(-np.log(np.clip(through, 1e-6, 1.0)))

    def of_texture(self, colour: Sequence[float], spectrum: Spectrum | None) -> Floats:
        """(3, 3) matrix that turns a texture's Rec. 709 colours into the channels, their mean into its spectrum.

        Bright texels may come out above 1: see `texture`.
        """
        if self.wavelength_nm is None:
            return np.eye(3)
        basis = self._basis()
        mean = basis @ np.asarray(colour, dtype=np.float64)
        return np.asarray(basis * (self.of_surface(colour, spectrum) / np.maximum(mean, 1e-9))[:, None])

    def texture(
        self,
        image: NDArray[np.floating],
        colour: Sequence[float],
        spectrum: Spectrum | None,
        most: NDArray[np.floating] | float = 1.0,
    ) -> NDArray[np.float32]:
        """A texture in the channels, none of it above `most`, its mean still that of the spectrum.

        Where the surface is so bright at a wavelength that its brightest texels would pass the limit, the contrast of
        the whole texture is reduced about its mean: clipping alone would lose light (12% of a log's sawn face at 1300
        nm). Bark and wood have less contrast in the infrared than in colour anyway.

        `image`: (H, W, 3) linear Rec. 709 reflectance, whose mean is `colour`. `most`: largest value of a texel, (H, W)
        or one for all.
        """
        out = np.asarray(image @ self.of_texture(colour, spectrum).T.astype(np.float32), dtype=np.float32)
        least = float(np.min(most))
        if self.wavelength_nm is None:
            return out if out.max() <= least else np.minimum(out, np.asarray(most, dtype=np.float32)[..., None])
        for channel, mean in enumerate(self.of_surface(colour, spectrum)):
            if out[..., channel].max() <= least:
                continue
            above = out[..., channel] - np.float32(mean)
            room = np.broadcast_to(most - mean, above.shape)
            over = above > np.maximum(room, 0.0)
            if over.any():
                share = float(np.clip((room[over] / above[over]).min(), 0.0, 1.0))
                out[..., channel] = np.minimum(mean + share * above, most)
        return out

    def _basis(self) -> Floats:
        """(3, 3) wavelengths by primaries."""
        assert self.wavelength_nm is not None
        return np.stack([one.at(self.wavelength_nm) for one in primaries()], axis=1)


RGB = Channels()
