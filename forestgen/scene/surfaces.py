"""What the recipe's surfaces do with light: materials of plants, and the ground."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from forestgen.core.spectrum import Spectrum
from forestgen.plants.bark.texture import bark_texture
from forestgen.recipe import species as recipe_species
from forestgen.recipe.spectra import Season, load_spectra, of_season, surface_columns
from forestgen.scene.colour import colours_of_surface
from forestgen.scene.spec import Camera, Material

Species = recipe_species.Species
COLOUR_ENDS_NM = 720.0  # beyond it a surface's colour tells nothing
TABLES_END_NM = 2400.0  # what tables of measured spectra reach to; the little beyond is as good as known


def materials_of(species: Mapping[str, Species], season: Season = "summer") -> dict[tuple[str, str], Material]:
    """Materials of all species by (species, material). `season`: of the spectra whose material names none."""
    return {
        (name, key): surface_of(material, season, f"{name}/{key}")
        for name, one in species.items()
        for key, material in one.materials.items()
    }


def surface_of(material: recipe_species.Material, season: Season, name: str) -> Material:
    """A recipe's material; `name`, such as "birch/bark", seeds its texture."""
    file = material.spectrum
    spectra: tuple[Spectrum | None, Spectrum | None] = None, None
    if file is None:
        assert material.reflectance is not None  # the recipe's own check
        reflectance, transmittance = material.reflectance, material.transmittance
    else:
        columns = load_spectra(file.name) if file.text is None else surface_columns(file.text, file.name)
        found = of_season(columns, material.season or season)
        assert found is not None  # the same
        spectra = found
        reflectance, transmittance = colours_of_surface(*found)
    return Material(
        reflectance,
        transmittance,
        material.roughness,
        None if material.bark is None else bark_texture(material.bark, reflectance, name),
        material.gloss,
        *spectra,
    )


def infrared_notes(materials: Mapping[tuple[str, str], Material], cameras: Sequence[Camera]) -> list[str]:
    """Notes on surfaces of which less is known than a camera's bands see: colours, and tables that end too early."""
    ends_nm = [band.response.wavelength_nm[-1] for camera in cameras for band in camera.bands]
    farthest_nm = max(ends_nm, default=0.0)
    notes = []
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
