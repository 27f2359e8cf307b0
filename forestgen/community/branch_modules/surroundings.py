"""What the modules of a state see: their spheres, the light that is left, where there is room, and the climate.

How well a climate suits a species (Makowski 2023, Eq. 13) is a Gaussian of temperature times one of precipitation. The
climate is one for the whole site, colder with elevation; or it differs by place (`LocalClimate`, Eq. 38). Then it
bounds what leaves gain, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.geometry import spheres
from forestgen.community.branch_modules.boxes import NO_BOXES, Boxes
from forestgen.community.branch_modules.crowding import SphereGrid, overlap_volumes
from forestgen.community.branch_modules.parameters import cells_at
from forestgen.community.branch_modules.shade import Shade, ShadowGrid, shade
from forestgen.community.branch_modules.state import State, StepParameters, Traits
from forestgen.community.model import Site
from forestgen.community.population import Floats, Floats32


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
        cell = cells_at(position_m, self.size_m, self.temperature_c.shape)
        return self.temperature_c[cell] - self.shade_cooling_k * (1.0 - light), self.precipitation_mm_per_yr[cell]


def adaptation(
    now: StepParameters, species: NDArray[np.integer], position_m: Floats, elevation_m: Floats, around: Surroundings
) -> tuple[Floats, Floats]:
    """(N,) o of Eq. 13, or of Eq. 38 in a local climate, and (N,) the share of its light that a leaf can use.

    Both are 1 where no climate is given, for plants of these species. The share is 1 without a local climate. In one it
    is o, but for rain above the optimum, which counts as the optimum: water in plenty takes nothing from leaves. What a
    module needs itself does not become less, so that a drought takes the darkest leaves first (docs/adr/0012).
    `position_m` (N, 2) are their feet, `elevation_m` (N,) the ground's height there.
    """
    traits, parameters, climate, unhindered = now.traits, now.parameters, around.climate, np.ones(len(species))
    if climate is not None:
        temperature_c, rain = climate.at(position_m, climate.light_at(position_m, around))
        enough = np.minimum(rain, traits.precipitation_mm_per_yr[species])
        return suited(traits, species, temperature_c, rain), suited(traits, species, temperature_c, enough)
    if parameters.temperature_c is None or parameters.precipitation_mm_per_yr is None:
        return unhindered, unhindered
    warmth = parameters.temperature_c + parameters.lapse_rate_k_per_km * elevation_m / 1000.0
    return suited(traits, species, warmth, parameters.precipitation_mm_per_yr), unhindered


def suited(
    traits: Traits, species: NDArray[np.integer], temperature_c: Floats, precipitation_mm_per_yr: Floats | float
) -> Floats:
    """(N,) o of species where it is so warm and so wet.

    The ratio of the densities at the climate and at the optimum: 1 at the optimum, whatever the widths.
    """
    warm = (temperature_c - traits.temperature_c[species]) / traits.temperature_width_c[species]
    excess = precipitation_mm_per_yr - traits.precipitation_mm_per_yr[species]
    wet = excess / traits.precipitation_width_mm_per_yr[species]
    return np.asarray(np.exp(-0.5 * (warm**2 + wet**2)))


@dataclass(frozen=True)
class Surroundings:
    """The spheres of a state's modules, and the light that is left to each."""

    grid: SphereGrid
    shade: Shade | None  # None: plants do not shade what stands below them
    boxes: Boxes
    light: Floats32  # (M,) Q Q_G, 0 to 1: before the species' shade tolerance
    climate: LocalClimate | None = None  # None: that of the parameters

    def light_at(self, position_m: Floats) -> Floats:
        """(N,) Q_G near the ground at (N, 2) world x and y on the site."""
        return np.ones(len(position_m)) if self.shade is None else self.shade.light_at(position_m)


def boxes_of(site: Site) -> Boxes:
    """The buildings as boxes on the ground."""
    if not site.buildings:
        return NO_BOXES
    position = np.array([one.position_m for one in site.buildings])
    base_m = np.column_stack([position, ground_at(site, position)])
    azimuth = np.array([one.turn_rad for one in site.buildings])
    return Boxes(base_m, np.array([one.size_m for one in site.buildings]), azimuth)


def ground_at(site: Site, position_m: Floats) -> Floats:
    """(N,) height of the ground at (N, 2) world x and y, metres."""
    if site.height is None:
        return np.zeros(len(position_m))
    return np.asarray(site.height(position_m[:, 0], position_m[:, 1]), dtype=np.float64)


def surroundings_of(
    state: State, now: StepParameters, leaves: Floats32, climate: LocalClimate | None = None
) -> Surroundings:
    """Spheres, crowding (Eq. 1) and global shadow of a state's modules; `leaves` (M,) of a whole module's foliage."""
    parameters, modules, plants = now.parameters, state.modules, state.plants
    counts = np.diff(modules.first)
    centre, radius = spheres(now.tables, modules, plants.species)
    position = np.repeat(plants.position_m, counts, axis=0)
    position += centre[:, :2]
    ground = np.repeat(plants.ground_m, counts)
    world = np.column_stack([position, ground + centre[:, 2]])
    periodic = parameters.periodic
    grid = SphereGrid.of(world, radius, state.site.size_m if periodic else None)
    boxes = boxes_of(state.site)
    light = (overlap_volumes(grid, modules.parent_row(), boxes) / grid.volume_m3).astype(np.float32)
    np.exp(np.multiply(light, np.float32(-parameters.crowding), out=light), out=light)
    seen = None
    if parameters.global_shade:
        # The ground below a branch is that at the plant's foot: on a slope a crown keeps its height above its own foot.
        kind = np.repeat(plants.species, counts)
        depth = now.traits.opacity[kind] * leaves
        shadows = ShadowGrid(state.site.size_m, cell_m=parameters.cell_m, layer_m=parameters.cell_m, periodic=periodic)
        seen = shade(world, centre[:, 2], radius, depth, shadows, boxes)
        light *= seen.light
    return Surroundings(grid, seen, boxes, light, climate)
