"""A species: its ecology, its shape's scaling, its geometry's generator and its materials.

One file a species, ``scenes/species/NAME.yaml``; a recipe's ``species`` section names the file and overrides its keys,
or holds the whole species itself. Under a shipped species' name the overrides do without ``from``.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from forestgen.recipe.fields import (
    Colour,
    Fraction,
    Name,
    NonNegative,
    Number,
    OpenSection,
    Positive,
    Section,
    Text,
    mistake,
    spelled_out,
)
from forestgen.recipe.plant_type import PlantType
from forestgen.recipe.spectra import MOST_BYTES, Season

TALLEST_M = 200.0


class Ecology(Section):
    """How a species grows, competes and spreads."""

    growth_m_per_yr: NonNegative = Field(le=10, description="Growth of the radius, metres per year.")
    max_radius_m: Positive = Field(le=100, description="Radius at which a plant is mature, metres.")
    shade_tolerance: Fraction = Field(description="Probability that a dominated plant survives a step, 0 to 1.")
    old_age_survival: Fraction = Field(description="Probability that a mature plant survives a step, 0 to 1.")
    seedlings_per_ha_per_yr: NonNegative = Field(le=1e6, description="New plants per hectare (10,000 m²) and year.")
    seedling_radius_m: Positive = Field(default=0.05, le=10, description="Radius of a new plant, metres.")


class PowerLaw(Section):
    """``scale * radius^exponent``, metres; the radius in metres."""

    scale: Positive = Field(description="Value at a radius of 1 m, metres.")
    exponent: Number = Field(ge=0, le=5, description="Power of the radius, no unit.")

    def __call__(self, radius_m: float | NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(self.scale * np.asarray(radius_m, dtype=np.float64) ** self.exponent, dtype=np.float64)

    def inverse(self, value_m: float) -> float:
        """Radius in metres of a plant that has this value; the exponent must not be 0."""
        return float((value_m / self.scale) ** (1.0 / self.exponent))


class Allometry(Section):
    """Size of a plant from its radius in the community (Lane 2002, chapter 6)."""

    height_m: PowerLaw = Field(description="Height of the plant, metres, from its radius.")
    width_m: PowerLaw = Field(description="Width of the crown, metres, from its radius.")

    def height(self, radius_m: float | NDArray[np.float64]) -> NDArray[np.float64]:
        """Height in metres of plants of `radius_m`, metres, any shape."""
        return self.height_m(radius_m)

    def width(self, radius_m: float | NDArray[np.float64]) -> NDArray[np.float64]:
        """Crown width in metres of plants of `radius_m`, metres, any shape."""
        return self.width_m(radius_m)


class Plant(OpenSection):
    """What makes a species' geometry: a generator, and keys that the generator checks itself."""

    generator: Text = Field(min_length=1, max_length=100, description="Id of the plant generator.")


BarkPattern = Literal["furrowed", "plated", "scaly", "smooth", "papery", "ringed", "fibrous", "end_grain"]
TileSide = Annotated[Positive, Field(ge=0.01, le=10)]


class Bark(Section):
    """Pattern and relief of a surface, whose mean colour stays the material's reflectance; see plants/bark/."""

    pattern: BarkPattern = Field(description="What the bark looks like.")
    tile_m: tuple[TileSide, TileSide] = Field(
        default=(0.5, 0.75), description="Width round the stem and height of the texture's one repeat, metres."
    )
    scale_m: Positive | None = Field(
        default=None,
        ge=0.0005,
        le=1,
        description="Width of a ridge, plate, scale, ring or mark, metres; null: the pattern's own.",
    )
    depth_m: NonNegative | None = Field(
        default=None, le=0.1, description="Deepest crack, metres; null: the pattern's own."
    )
    dark: Colour | None = Field(
        default=None, description="Colour of cracks, linear Rec. 709, before the mean is set; null: chosen."
    )
    light: Colour | None = Field(
        default=None, description="Colour of what stands out, before the mean is set; null: chosen."
    )
    marks: Fraction | None = Field(
        default=None, le=0.5, description="Share of lenticels, checks or cracks, 0 to 0.5; null: the pattern's own."
    )
    mark_colour: Colour | None = Field(
        default=None, description="Colour of the marks of smooth and papery bark; null: as dark."
    )
    lichen: NonNegative = Field(default=0.0, le=0.9, description="Share of the surface that lichen covers.")
    lichen_colour: Colour = Field(default=(0.3, 0.33, 0.24), description="Colour of lichen, before the mean is set.")

    @model_validator(mode="after")
    def _repeats(self) -> Self:
        if self.scale_m is not None and self.scale_m > 0.5 * min(self.tile_m):
            raise mistake(
                f"at most half of tile_m: {0.5 * min(self.tile_m):g} m",
                problem="the texture's repeat is too small for features of this size",
                got=f"{self.scale_m:g} m",
                at=("scale_m",),
            )
        return self


class SpectrumFile(Section):
    """A table of reflectance and perhaps transmittance by wavelength; see recipe/spectra.py."""

    name: Text = Field(min_length=1, max_length=1000, description="Such as leaves/birch, or a path.")
    text: Text | None = Field(
        default=None, max_length=MOST_BYTES, description="The table itself, as drawn recipes keep a file of your own."
    )


class Material(Section):
    """What an organ's surface does with light: by a spectrum, or by a colour, linear Rec. 709."""

    spectrum: SpectrumFile | None = Field(
        default=None,
        description="Table of reflectance and transmittance by wavelength, of which the colours follow: leaves/birch, "
        "bark/oak, ... or a path from the recipe's folder. In place of reflectance and transmittance.",
    )
    season: Season | None = Field(
        default=None, description="Of the spectrum, where it has seasons; null: plants.season."
    )
    reflectance: Colour | None = Field(
        default=None, description="Reflected fraction of red, green, blue; linear Rec. 709."
    )
    transmittance: Colour = Field(
        default=(0.0, 0.0, 0.0), description="Fraction let through of red, green, blue; linear Rec. 709."
    )
    roughness: Fraction = Field(default=0.5, description="Roughness of the gloss, 0 to 1: 0.2 is waxy, 0.6 matt.")
    gloss: NonNegative = Field(
        default=0.0,
        le=0.08,
        description="Share of light that the skin of a leaf or petal mirrors, part of its reflectance: 0 is matt, 0.04 "
        "smooth wax. Bark has none.",
    )
    bark: Bark | None = Field(
        default=None, description="Pattern of an opaque surface; null: one colour. The reflectance is its mean."
    )

    @field_validator("spectrum", mode="before")
    @classmethod
    def _name_alone(cls, value: Any) -> Any:
        return spelled_out(value, "name")

    @model_validator(mode="after")
    def _says_it_once(self) -> Self:
        if self.spectrum is None and self.reflectance is None:
            raise mistake("reflectance, or a spectrum", problem="a material without colour", got="neither")
        if self.spectrum is None and self.season is not None:
            raise mistake("a season of a spectrum", problem="colours have no season", got=self.season, at=("season",))
        if self.spectrum is not None and (self.reflectance is not None or max(self.transmittance) > 0):
            raise mistake(
                "a spectrum, or reflectance and transmittance",
                problem="colours beside a spectrum, of which they follow",
                got="both",
                hint="leave one out; `spectrum: null` takes back a species file's",
            )
        return self

    @model_validator(mode="after")
    def _bark_is_opaque(self) -> Self:
        if self.bark is not None and max(self.transmittance) > 0:
            raise mistake("no transmittance, or no bark", problem="bark lets no light through", got="both")
        return self

    @model_validator(mode="after")
    def _conserves_energy(self) -> Self:
        reflectance = self.reflectance or (0.0, 0.0, 0.0)
        for channel, r, t in zip(("red", "green", "blue"), reflectance, self.transmittance, strict=True):
            if r + t > 1.0 + 1e-9:
                raise mistake(
                    "reflectance + transmittance of at most 1 in every channel",
                    problem="more light leaves than arrives",
                    got=f"{r:g} + {t:g} in {channel}",
                )
        return self


class Tissue(Section):
    """What turns volume and area into mass, dry."""

    wood_density_kg_per_m3: Positive = Field(
        default=500.0, le=1500, description="Dry wood over its fresh volume, kg/m³."
    )
    leaf_mass_per_area_kg_per_m2: Positive = Field(
        default=0.08, le=2, description="Dry leaf over one side's area, kg/m²."
    )


class Species(Section):
    """One species of the recipe, complete: its file and the recipe's overrides merged."""

    description: Text = Field(default="", max_length=2000, description="What the species is, for people.")
    height_m: Positive | None = Field(
        default=None,
        le=TALLEST_M,
        description="Mature height, metres: sets allometry.height_m.scale so that a plant of ecology.max_radius_m is "
        "this tall. Null leaves the allometry as it is.",
    )
    map_colour: Text | None = Field(
        default=None, pattern="^#[0-9A-Fa-f]{6}$", description="Colour on maps, #RRGGBB; null: chosen."
    )
    ecology: Ecology = Field(description="How the species grows, competes and spreads.")
    allometry: Allometry = Field(description="Size of a plant from its radius.")
    tissue: Tissue = Field(default=Tissue(), description="Density of wood and leaves, for mass.")
    sources: tuple[Text, ...] = Field(
        default=(), max_length=20, description="Where the proportions come from, one reference each."
    )
    plant: Plant = Field(description="What makes its geometry.")
    modules: PlantType | None = Field(default=None, description="How it grows as branch modules; null: it does not.")
    modules_plant: Plant | None = Field(
        default=None,
        description="Plant generator of its branch modules, if `plant` serves other communities; null: `plant`.",
    )
    materials: dict[Name, Material] = Field(
        default_factory=dict, description="Materials of the plant's organs, by name."
    )

    @model_validator(mode="after")
    def _height_is_a_plants(self) -> Self:
        height_m = self.mature_height_m
        if not 0 < height_m <= TALLEST_M:
            raise mistake(
                f"a mature height of at most {TALLEST_M:g} m",
                problem="the allometry gives no plant's height",
                got=f"{height_m:g} m = allometry.height_m at ecology.max_radius_m",
            )
        return self

    @property
    def mature_height_m(self) -> float:
        """Height at ``ecology.max_radius_m``, metres."""
        return self.height_m or float(self.allometry.height(self.ecology.max_radius_m))

    def settled(self) -> Species:
        """The same species with `height_m` moved into the allometry's scale."""
        if self.height_m is None:
            return self
        law = self.allometry.height_m
        scale = self.height_m / self.ecology.max_radius_m**law.exponent
        allometry = self.allometry.model_copy(update={"height_m": law.model_copy(update={"scale": scale})})
        return self.model_copy(update={"height_m": None, "allometry": allometry})
