"""How well a climate suits a species (Makowski 2023, Eq. 13): a Gaussian of temperature times one of precipitation.

The climate is one for the whole site, colder with elevation; or it differs by place (`LocalClimate`, Eq. 38). Then it
bounds what leaves gain, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from forestgen.community.branch_modules.parameters import BranchModulesParameters
    from forestgen.community.branch_modules.surroundings import Surroundings
    from forestgen.community.branch_modules.traits import Traits

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class LocalClimate:
    """The climate by place: maps over the site, row 0 at y = 0."""

    size_m: tuple[float, float]
    temperature_c: Floats  # (rows, cols) mean at the ground in the open; elevation is in it
    precipitation_mm_per_yr: Floats  # (rows, cols) rain that would keep the soil as wet as it is
    shade_cooling_k: float = 0.0  # by which complete shade is cooler
    even_shade: bool = False  # whether shade counts by its mean over the site

    def light_at(self, position_m: Floats, around: Surroundings) -> Floats:
        """(N,) the light at (N, 2) world x and y on the site by which shade cools, 0 to 1."""
        if not self.shade_cooling_k:
            return np.ones(len(position_m))
        if not self.even_shade:
            return around.light_at(position_m)
        rows, cols = self.temperature_c.shape
        x, y = ((np.arange(n) + 0.5) / n * side for n, side in zip((cols, rows), self.size_m, strict=True))
        middles = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        return np.full(len(position_m), around.light_at(middles).mean())

    def at(self, position_m: Floats, light: Floats) -> tuple[Floats, Floats]:
        """(N,) temperature and precipitation at (N, 2) world x and y on the site, in so much light, 0 to 1."""
        cells = []
        for axis, count in ((1, self.temperature_c.shape[0]), (0, self.temperature_c.shape[1])):
            at = (position_m[:, axis] / self.size_m[axis] * count).astype(np.int64)
            cells.append(np.clip(at, 0, count - 1))
        row, col = cells
        temperature_c = self.temperature_c[row, col] - self.shade_cooling_k * (1.0 - light)
        return temperature_c, self.precipitation_mm_per_yr[row, col]


def temperature_at(parameters: BranchModulesParameters, elevation_m: Floats) -> Floats:
    """(N,) mean temperature, deg C, at ground of these elevations above z = 0, metres; a climate must be given."""
    if parameters.temperature_c is None:
        raise ValueError("no climate is given")
    return np.asarray(parameters.temperature_c + parameters.lapse_rate_k_per_km * elevation_m / 1000.0)


def adaptation(
    parameters: BranchModulesParameters,
    traits: Traits,
    species: NDArray[np.integer],
    position_m: Floats,
    elevation_m: Floats,
    around: Surroundings,
    climate: LocalClimate | None,
) -> tuple[Floats, Floats]:
    """(N,) o of Eq. 13, or of Eq. 38 in a local climate, and (N,) the share of its light that a leaf can use.

    Both are 1 where no climate is given, for plants of these species. The share is 1 without a local climate. In one it
    is o, but for rain above the optimum, which counts as the optimum: water in plenty takes nothing from leaves. What a
    module needs itself does not become less, so that a drought takes the darkest leaves first (docs/adr/0012).

    Parameters
    ----------
    position_m : (N, 2) of their feet, world.
    elevation_m : (N,) of the ground there.
    """
    unhindered = np.ones(len(species))
    if climate is not None:
        temperature_c, rain = climate.at(position_m, climate.light_at(position_m, around))
        enough = np.minimum(rain, traits.precipitation_mm_per_yr[species])
        return suited(traits, species, temperature_c, rain), suited(traits, species, temperature_c, enough)
    if parameters.temperature_c is None or parameters.precipitation_mm_per_yr is None:
        return unhindered, unhindered
    warmth = temperature_at(parameters, elevation_m)
    return suited(traits, species, warmth, parameters.precipitation_mm_per_yr), unhindered


def suited(
    traits: Traits, species: NDArray[np.integer], temperature_c: Floats, precipitation_mm_per_yr: Floats | float
) -> Floats:
    """(N,) o of species where it is so warm and so wet.

    The ratio of the densities at the climate and at the optimum: 1 at the optimum, whatever the widths.
    """
    warm = (temperature_c - traits.temperature_c[species]) / traits.temperature_width_c[species]
    wet = (precipitation_mm_per_yr - traits.precipitation_mm_per_yr[species]) / traits.precipitation_width_mm_per_yr[
        species
    ]
    return np.asarray(np.exp(-0.5 * (warm**2 + wet**2)))
