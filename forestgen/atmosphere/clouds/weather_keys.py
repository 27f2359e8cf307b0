"""Keys of simulated weather: air at rest, what the ground gives off, the box of air, and phases of a story.

All may be left out, and are then those of the type; see `forestgen.atmosphere.clouds.simulated`.
"""

from __future__ import annotations

from typing import Annotated, Any, Self

from pydantic import Field, field_validator, model_validator

from forestgen.core.errors import RecipeError
from forestgen.recipe.fields import Fraction, GivenSection, NonNegative, Number, Positive, Text, shorthand, violation
from forestgen.recipe.map_files import Sha256
from forestgen.recipe.registries import CLOUD_SOURCES
from forestgen.recipe.sky import FileName, NamedFile


def _or_of_type(description: str, **bounds: Any) -> Any:
    """A key that the type has a value for."""
    return Field(None, description=f"{description} Default: the type's.", **bounds)


class SoundingSection(GivenSection):
    """Air at rest by height: a file, or a mixed layer, a layer above it and an inversion."""

    file: FileName | None = Field(
        None, description="CSV file of heights, temperature and humidity, relative to the recipe's folder."
    )
    sha256: Sha256 | None = Field(
        None, description="SHA-256 of the file, written when the recipe is loaded; another file is refused."
    )
    ground_temperature_c: Number | None = _or_of_type("Of the air at the ground, degrees Celsius.", ge=-60, le=60)
    ground_pressure_hpa: Number | None = Field(
        None, ge=400, le=1100, description="At the ground, hPa; also beside a file. Default: 1013.25."
    )
    mixed_layer_m: NonNegative | None = _or_of_type(
        "Depth of the air next to the ground that is stirred through: it cools upwards by 9.8 K/km, "
        "and its vapour is the same at all heights. Metres.",
        le=20000,
    )
    lapse_rate_k_per_km: Number | None = _or_of_type(
        "How fast it cools upwards from there to the inversion, K/km; negative: it gets warmer.", ge=-300, le=30
    )
    inversion_m: Positive | None = _or_of_type("Height of the inversion, metres.", le=30000)
    inversion_jump_k: NonNegative | None = _or_of_type(
        "How much warmer it becomes across the inversion itself, K.", le=40
    )
    lapse_rate_above_k_per_km: Number | None = _or_of_type("How fast it cools upwards above it, K/km.", ge=-300, le=30)
    relative_humidity: Fraction | None = _or_of_type("At the ground, 0 to 1, over water.")
    relative_humidity_aloft: Fraction | None = _or_of_type(
        "Just below the inversion, 0 to 1; linear between it and the mixed layer's top."
    )
    relative_humidity_above: Fraction | None = _or_of_type("Above the inversion, 0 to 1.")

    @model_validator(mode="after")
    def _file_or_numbers(self) -> Self:
        of_files = {"file", "sha256", "ground_pressure_hpa"}  # a table has no pressure
        given = [key for key in self.model_fields_set - of_files if getattr(self, key) is not None]
        if self.file is not None and given:
            problem, got = "the sounding is given twice", f"file and {', '.join(sorted(given))}"
            raise violation("a file, or numbers", problem=problem, got=got, hint="leave out one of them", at=("file",))
        return self


class EmissionSection(GivenSection):
    """What the ground gives to the air."""

    heat_w_per_m2: Number | None = _or_of_type("Mean flux of sensible heat, W/m2.", ge=-500, le=5000)
    latent_w_per_m2: Number | None = _or_of_type("Mean flux of vapour as latent heat, W/m2.", ge=-100, le=5000)
    vapour_g_per_m2_s: Number | None = Field(
        None, ge=-0.05, le=2, description="The same as mass: 0.1 g/m2/s is 250 W/m2. Instead of latent_w_per_m2."
    )
    patch_m: Positive | None = _or_of_type("Size of warm and moist patches, metres.", le=100000)
    contrast: NonNegative | None = _or_of_type("How much patches differ: standard deviation over mean.", le=10)
    map: Annotated[NamedFile | None, *shorthand("file")] = Field(
        None,
        description="A grey picture (or .npy array) of the emission over the domain, north up, whose mean is made "
        "1; instead of patches of noise. The domain is where the simulation is, not the site.",
    )

    @model_validator(mode="after")
    def _vapour_once(self) -> Self:
        for one, other in (("latent_w_per_m2", "vapour_g_per_m2_s"), ("map", "patch_m"), ("map", "contrast")):
            if getattr(self, one) is not None and getattr(self, other) is not None:
                raise violation(f"{one} or {other}", problem="given twice", got=f"{one}, {other}", at=(other,))
        return self


class DomainSection(GivenSection):
    """The box of air that is simulated; at its sides it goes on periodically."""

    extent_m: Positive | None = _or_of_type("Side of its square, metres.", ge=100, le=200000)
    height_m: Positive | None = _or_of_type("Its height, metres.", ge=20, le=25000)
    cell_m: Positive | None = _or_of_type("Width of a cell, metres.", ge=0.5, le=5000)
    cell_height_m: Positive | None = _or_of_type("Height of a cell, metres.", ge=0.5, le=2000)


class WeatherKeys(GivenSection):
    """What makes one kind of weather another."""

    sounding: Annotated[SoundingSection | None, *shorthand("file")] = _or_of_type(
        "The air at rest: a file's name, or its keys."
    )
    emission: EmissionSection | None = _or_of_type("What the ground gives off.")
    domain: DomainSection | None = _or_of_type("The box that is simulated.")
    cooling_k_per_h: Number | None = _or_of_type(
        "How fast the air below the inversion radiates its heat away, K/h.", ge=-10, le=10
    )
    wind_m_per_s: NonNegative | None = _or_of_type("Speed of the wind aloft, m/s.", le=100)
    wind_from_deg: Number | None = Field(
        None,
        ge=-360,
        le=360,
        description="Where it comes from, degrees clockwise from north: 270 is west. Default: site.wind_from_deg.",
    )


class Phase(WeatherKeys):
    """The weather from one moment of a story on, until the next phase."""

    at_s: Annotated[NonNegative, Field(le=1e6, description="When it begins, seconds after the story does.")]
    type: Annotated[Text, Field(description="The type whose values hold for all keys that are left out.")]
    change_s: Positive | None = Field(
        None, le=1e6, description="How quickly the mean air becomes that of the new sounding, seconds. Default 1200."
    )

    @field_validator("type")
    @classmethod
    def _is_simulated(cls, value: str) -> str:
        try:
            if hasattr(CLOUD_SOURCES.load(value), "conditions"):
                return value
        except RecipeError:
            pass
        simulated = [name for name, part in CLOUD_SOURCES.parts() if hasattr(part, "conditions")]
        raise violation("one of " + ", ".join(simulated), problem="no simulated weather is called so", got=value)
