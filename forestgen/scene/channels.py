"""What the renderer's three channels stand for in a pass: Rec. 709, or three wavelengths.

A path through the scene does not care what its three numbers mean. So a spectral image is made of passes, each with
three wavelengths of its own, and a pass differs from one in colour by nothing but its numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.core.spectrum import Spectrum
from forestgen.scene.colour import colour_of_radiance, primaries

Floats = NDArray[np.float64]


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
