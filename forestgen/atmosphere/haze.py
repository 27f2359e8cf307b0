"""A thin, even haze: what it takes from light and where it scatters it.

Koschmieder (1924): a black thing at the meteorological range V is just seen against the horizon, with a contrast of
2%, so the extinction at 550 nm is 3.912 / V. It has two parts.

- Air's molecules: 1.16e-5 /m at 550 nm and sea level (V = 337 km), as wavelength^-4; Rayleigh's phase function.
- Aerosol: the rest, as wavelength^-q. q is 1.3, as in atmosphere/daylight.py, and 0.585 V^(1/3), V in kilometres, below
  6 km, where particles are large (Kruse, McGlauchlin and McQuistan 1962); a Henyey-Greenstein lobe of g = 0.65, as in
  atmosphere/spctrl2.py.

At 50 km the sum falls as wavelength^-1.7 in the visible, where Kruse has 1.6.

References
----------
Koschmieder, H. (1924): Theorie der horizontalen Sichtweite. Beitr. Phys. freien Atmos. 12, 33-53, 171-181.
Kruse, P. W., McGlauchlin, L. D., McQuistan, R. B. (1962): Elements of Infrared Technology. Wiley.
Bucholtz, A. (1995): Rayleigh-scattering calculations for the terrestrial atmosphere. Appl. Opt. 34, 2765-2773.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

KOSCHMIEDER = 3.912  # -log of the contrast 0.02
REFERENCE_NM = 550.0
ASYMMETRY = 0.65
_MOLECULAR_PER_M = 1.16e-5
_ANGSTROM, _KRUSE, _MURKY_M = 1.3, 0.585, 6000.0
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Haze:
    """Haze by its meteorological range."""

    visibility_m: float

    def extinction_per_m(self, wavelength_nm: Floats) -> Floats:
        """Of molecules and aerosol, of the wavelengths' shape."""
        return self.molecular_per_m(wavelength_nm) + self._aerosol(wavelength_nm)

    def molecular_per_m(self, wavelength_nm: Floats) -> Floats:
        """Of molecules alone: never more than the visibility leaves."""
        reference = min(_MOLECULAR_PER_M, KOSCHMIEDER / self.visibility_m)
        return np.asarray(reference * (wavelength_nm / REFERENCE_NM) ** -4.0)

    def _aerosol(self, wavelength_nm: Floats) -> Floats:
        murky = self.visibility_m < _MURKY_M
        exponent = _KRUSE * (self.visibility_m / 1000.0) ** (1.0 / 3.0) if murky else _ANGSTROM
        rest = max(KOSCHMIEDER / self.visibility_m - _MOLECULAR_PER_M, 0.0)
        return np.asarray(rest * (wavelength_nm / REFERENCE_NM) ** -exponent)


def molecular_phase(cosine: Floats) -> Floats:
    """Rayleigh's phase function by the cosine of the scattering angle; its mean over the sphere is 1."""
    return np.asarray(0.75 * (1.0 + cosine * cosine))


def aerosol_phase(cosine: Floats) -> Floats:
    """Henyey and Greenstein's; its mean over the sphere is 1."""
    g = ASYMMETRY
    return np.asarray((1.0 - g * g) / (1.0 + g * g - 2.0 * g * cosine) ** 1.5)
