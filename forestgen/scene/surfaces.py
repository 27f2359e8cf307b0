"""What the recipe's surfaces do with light: materials of plants and buildings, and ground that is dark where it is wet.

What is wet lies under a film of water. Light that comes back from the ground meets the film's surface from below, which
turns much of it round to the ground again, and each time the ground and the water take their part (Ångström 1925):

    R_wet = (1 - r) (1 - p) T R / (1 - p T R),    1 - p = (1 - r) / n^2

at each wavelength, R being that of the dry ground. r is what a surface of water, n = 1.33, reflects of diffuse light
from above (0.066, Fresnel's mean over all directions), p what it does from below (0.47, by reciprocity: Lekner and Dorf
1988). T = exp(-a L) is what water of absorption a leaves on a way of L = 0.4 mm: nothing is lost in the visible, much
beyond 1300 nm. L is ours. What the film mirrors is not in R_wet: it has no gloss.

Ground that is partly wet is a mixture of both, as in MARMIT (Bablet et al. 2018): R = (1 - e) R_dry + e R_wet, with one
e for all wavelengths. e follows from the saturation s of the soil's pores, by the luminances of the two, for which
(1 - R)^2 / (2 R) is linear in s (Sadeghi, Jones and Philpot 2015). So half of the darkening is there at s = 0.35. In
the infrared, where wet ground is black, Sadeghi's law alone would darken faster.

References
----------
Ångström 1925 (Geografiska Annaler 7, 323-342). Lekner and Dorf 1988 (Applied Optics 27, 1278-1280). Sadeghi, Jones and
Philpot 2015 (Remote Sensing of Environment 164, 66-76). Bablet et al. 2018 (ibid. 217, 1-17).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from forestgen.core.spectrum import LUMINANCE, Spectrum
from forestgen.plants.bark.texture import bark_texture, covered_texture
from forestgen.plants.stem_surface import LEVELS, covered_name
from forestgen.recipe import species as recipe_species
from forestgen.recipe.phenology import SUMMER, LeafState
from forestgen.recipe.spectra import SEASONS, load_spectra, load_table, mixed, of_season, surface_columns
from forestgen.scene.colour import Channels, colours_of_surface
from forestgen.scene.spec import Camera, GroundPatch, Material, SeasonShare, Terrain, WetGround

Floats = NDArray[np.float64]
_INDEX = 1.33
FILM_WAY_M = 0.0004
_DIRECTIONS = 10_000  # over which Fresnel's mean is taken
Species = recipe_species.Species
COLOUR_ENDS_NM = 720.0  # beyond it a surface's colour tells nothing
TABLES_END_NM = 2400.0  # what tables of measured spectra reach to; the little beyond is as good as known


@cache
def film_reflectances() -> tuple[float, float]:
    """Shares of diffuse light that a surface of water reflects from above, r, and from below, p."""
    cosine = (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS
    inside = np.sqrt(1.0 - (1.0 - cosine**2) / _INDEX**2)
    across = ((cosine - _INDEX * inside) / (cosine + _INDEX * inside)) ** 2
    along = ((_INDEX * cosine - inside) / (_INDEX * cosine + inside)) ** 2
    above = float(np.mean((across + along) * cosine))  # 2 cos weighs directions, (s + p) / 2 is unpolarised light
    return above, 1.0 - (1.0 - above) / _INDEX**2


def wet_spectrum(dry: Spectrum) -> Spectrum:
    """Reflectance of a ground under a film of water."""
    water = load_table("standards/water")["absorption_per_m"]
    grid = np.union1d(dry.wavelength_nm, water.wavelength_nm)
    return Spectrum(grid, under_film(np.exp(-water.at(grid) * FILM_WAY_M) * dry.at(grid)))


def under_film(dry: Floats) -> Floats:
    """Reflectance under a film of water that takes nothing, of a dry surface's."""
    above, below = film_reflectances()
    return np.asarray((1.0 - above) * (1.0 - below) * dry / (1.0 - below * dry))


def wet_share(saturation: Floats, dry: float, wet: float) -> Floats:
    """Share of wet ground, 0 to 1, in soil whose pores are filled to `saturation`.

    `saturation`: of any shape, 0 to 1. `dry`, `wet`: luminances of the ground, dry and under a film: 1 > dry > wet > 0.
    """
    of_dry, of_wet = ((1.0 - one) ** 2 / (2.0 * one) for one in (dry, wet))
    transformed = of_dry + saturation * (of_wet - of_dry)
    reflectance = 1.0 / (1.0 + transformed + np.sqrt(transformed * (transformed + 2.0)))
    return np.asarray(np.clip((dry - reflectance) / (dry - wet), 0.0, 1.0))


@dataclass(frozen=True, eq=False)
class Wetness:
    """How wet a site's soil is, by place."""

    size_m: tuple[float, float]  # of the site
    saturation: Floats  # (rows, cols) share of its pores that is full, 0 to 1; row 0 at y = 0

    def at(self, x_m: Floats, y_m: Floats, away: Floats) -> Floats:
        """(N,) straight lines between the middles of cells; where `away` is 1 the site's mean, by shares in between."""
        rows, cols = self.saturation.shape
        row, v = _between(y_m * rows / self.size_m[1] - 0.5, rows)
        col, u = _between(x_m * cols / self.size_m[0] - 0.5, cols)
        above, right = np.minimum(row + 1, rows - 1), np.minimum(col + 1, cols - 1)
        south = self.saturation[row, col] * (1.0 - u) + self.saturation[row, right] * u
        north = self.saturation[above, col] * (1.0 - u) + self.saturation[above, right] * u
        here = south * (1.0 - v) + north * v
        return np.asarray(here + away * (float(self.saturation.mean()) - here))


def _between(place: Floats, count: int) -> tuple[NDArray[np.intp], Floats]:
    """Cell before each place, and the share of the next one; the outer cells go on outwards."""
    inside = np.clip(place, 0.0, count - 1.0)
    first = np.floor(inside).astype(np.intp)
    return first, inside - first


def wet_ground(dry: Spectrum, saturation: Floats) -> WetGround | None:
    """What a ground of a spectrum becomes where its soil is wet; None: all of it is dry.

    `saturation`: (V,) at the terrain's vertices.
    """
    if not saturation.any():
        return None
    wet = wet_spectrum(dry)
    colours = [colours_of_surface(one, None)[0] for one in (dry, wet)]
    share = wet_share(saturation, *(float(np.dot(LUMINANCE, colour)) for colour in colours))
    return WetGround(share.astype(np.float32), colours[1], wet)


def ground_texture(ground: Terrain | GroundPatch, channels: Channels) -> NDArray[np.float32]:
    """(H, W, 3) reflectance of the ground's texture in the channels."""
    mixture = ground.mixture
    if mixture is None:
        colour = ground.mean_colour if isinstance(ground, Terrain) else ground.reflectance
        return np.maximum(channels.texture(ground.texture, colour, ground.spectrum), 0.0)
    out = channels.texture(mixture.base, mixture.reflectance, mixture.spectrum)
    for one in mixture.parts:
        out += one.amount[..., None] * channels.of_surface(one.reflectance, one.spectrum).astype(np.float32)
    return np.clip(out, 0.0, 1.0)


def film_factor(terrain: Terrain, channels: Channels) -> Floats:
    """(3,) reflectance of the terrain under a film of water over that of the dry one, in [0, 1]; 1: none is wet.

    Bare ground between things has the factor of the painted ground, too, though wet sand of 0.29 is 0.57 times as
    bright as dry sand and litter of 0.12 0.52 times.
    """
    if terrain.wet is None:
        return np.ones(3)
    dry = channels.of_surface(terrain.mean_colour, terrain.spectrum)
    wet = channels.of_surface(terrain.wet.reflectance, terrain.wet.spectrum)
    return np.clip(wet / np.maximum(dry, 1e-9), 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class FreshLitter:
    """Leaves that fell lately and still have the colours of autumn."""

    cover: float  # share of the ground that they hide
    spectrum: Spectrum  # their mean reflectance

    def on(self, ground: Spectrum) -> Spectrum:
        """Mean reflectance of a ground that they lie on."""
        grid = np.union1d(ground.wavelength_nm, self.spectrum.wavelength_nm)
        return Spectrum(grid, ground.at(grid) + self.cover * (self.spectrum.at(grid) - ground.at(grid)))


def fresh_litter(species: Mapping[str, Species], leaf_area_index: Mapping[str, float]) -> FreshLitter | None:
    """Of leaves in random places, which hide 1 - exp(-their area) of the ground; None: none fell.

    `leaf_area_index`: by species, of the leaves that fell lately.
    """
    found = []
    for name, area in leaf_area_index.items():
        leaf = next((one for one in species[name].materials.values() if one.leaf_type is not None), None)
        if leaf is not None and area > 0.0:
            spectrum = surface_of(leaf, LeafState.of_season("autumn"), f"{name}/litter").reflectance_spectrum
            found += [] if spectrum is None else [(area, spectrum)]
    if not found:
        return None
    whole = sum(area for area, _ in found)
    grid = np.unique(np.concatenate([one.wavelength_nm for _, one in found]))
    value = np.sum([area / whole * one.at(grid) for area, one in found], axis=0)
    return FreshLitter(1.0 - float(np.exp(-whole)), Spectrum(grid, value))


def materials_of(
    species: Mapping[str, Species], leaves: Mapping[str, Sequence[LeafState]] | None = None
) -> dict[tuple[str, str], Material]:
    """Materials of all species by (species, material).

    `leaves`: by species, the leaves of each class of its plants; the materials of all but the first have the names that
    `material_of_class` gives. None, or a species that is not there: summer.
    """
    found: dict[tuple[str, str], Material] = {}
    for name, one in species.items():
        for index, state in enumerate((leaves or {}).get(name, [SUMMER])):
            for key, material in one.materials.items():
                first = found[name, key] if index and material.bark is not None else None  # bark has no season
                found[name, material_of_class(key, index)] = first or surface_of(material, state, f"{name}/{key}")
        covered = _covered(name, one, found)
        for index in range(len((leaves or {}).get(name, [SUMMER]))):
            found |= {(name, material_of_class(key, index)): material for key, material in covered.items()}
    return found


def _covered(name: str, species: Species, found: Mapping[tuple[str, str], Material]) -> dict[str, Material]:
    """The barks of a species' stem under each of its covers, and where a zone's bark begins; without season."""
    made: dict[str, Material] = {}
    wood = species.wood
    if wood is None:
        return made
    plants = (one for one in (species.plant, species.modules_plant) if one is not None)
    own = (one.parameters.get("wood", {}).get("material") for one in plants)
    barks, zones = species.materials.keys() & own, [zone.material for zone in wood.bark_zones]
    pairs = {
        *product(barks, zones),
        *combinations(zones, 2),
        *product({*barks, *zones}, (one.material for one in wood.covers)),
    }
    for (bark, cover), level in product(sorted(pairs), range(len(LEVELS))):
        key, below = covered_name(bark, cover, level), species.materials[bark]
        under, over = found[name, bark], found[name, cover]
        made[key] = _mixed(under, over, LEVELS[level], below.bark, f"{name}/{bark}")
    return made


def _mixed(bark: Material, cover: Material, share: float, pattern: recipe_species.Bark | None, name: str) -> Material:
    """A bark of which something covers a share."""
    r, g, b = (under + share * (over - under) for under, over in zip(bark.reflectance, cover.reflectance, strict=True))
    mean, spectrum, of_bark, of_cover = (r, g, b), None, bark.reflectance_spectrum, cover.reflectance_spectrum
    if of_bark is not None and of_cover is not None:
        grid = np.union1d(of_bark.wavelength_nm, of_cover.wavelength_nm)
        spectrum = Spectrum(grid, of_bark.at(grid) + share * (of_cover.at(grid) - of_bark.at(grid)))
        mean = colours_of_surface(spectrum, None)[0]
    texture = None
    if pattern is not None:
        texture = covered_texture(pattern, bark.reflectance, name, cover.reflectance, share, mean, cover.texture)
    return Material(mean, roughness=bark.roughness, texture=texture, reflectance_spectrum=spectrum)


def material_of_class(material: str, index: int) -> str:
    """Name of a species' material on plants of a class of phenology."""
    return f"{material}~{index}" if index else material


def surface_of(material: recipe_species.Material, leaves: LeafState, name: str) -> Material:
    """A recipe's material on a plant with such leaves; `name`, such as "birch/bark", seeds its texture."""
    file = material.spectrum
    spectra: tuple[Spectrum | None, Spectrum | None] = None, None
    seasons: tuple[SeasonShare, ...] = ()
    if file is None:
        assert material.reflectance is not None  # the recipe's own check
        reflectance, transmittance = material.reflectance, material.transmittance
    else:
        columns = load_spectra(file.name) if file.text is None else surface_columns(file.text, file.name)
        own = leaves if material.season is None else LeafState.of_season(material.season)
        found = spectra = mixed(columns, own.spectra)
        if material.leaf_type is not None:
            seasons = tuple(
                SeasonShare(season, share, *one)
                for season, share in zip(SEASONS, own.spectra, strict=True)
                if (one := of_season(columns, season)) is not None
            )
        reflectance, transmittance = colours_of_surface(*found)
    return Material(
        reflectance,
        transmittance,
        material.roughness,
        None if material.bark is None else bark_texture(material.bark, reflectance, name),
        material.gloss,
        *spectra,
        leaf_type=material.leaf_type,
        seasons=seasons,
    )


def infrared_notes(materials: Mapping[tuple[str, str], Material], cameras: Sequence[Camera]) -> list[str]:
    """Notes on surfaces of which less is known than a camera's bands see: colours, and tables that end too early."""
    ends_nm = [band.response.wavelength_nm[-1] for camera in cameras for band in camera.bands]
    farthest_nm = max(ends_nm, default=0.0)
    notes = []
    materials = {pair: one for pair, one in materials.items() if "~" not in pair[1]}  # the first class stands for all
    colours = [f"{owner}.{key}" for (owner, key), one in materials.items() if one.reflectance_spectrum is None]
    if farthest_nm > COLOUR_ENDS_NM and colours:
        notes.append(
            f"a camera's bands reach to {farthest_nm:g} nm, but these materials have colours, which say nothing of the "
            f"infrared: {_few(colours)}; give them a spectrum"
        )
    short = [
        f"{owner}.{key} ({one.reflectance_spectrum.wavelength_nm[-1]:g} nm)"
        for (owner, key), one in materials.items()
        if one.reflectance_spectrum is not None
        and one.reflectance_spectrum.wavelength_nm[-1] < min(farthest_nm, TABLES_END_NM)
    ]
    if short:
        notes.append(f"a camera's bands reach to {farthest_nm:g} nm, past the end of these spectra: {_few(short)}")
    return notes


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
