"""The recipe's schema: what a drawn recipe may say, in which unit, and what it need not say.

Distributions are drawn, shorthands spelled out and species files merged before a recipe meets this schema
(`forestgen.recipe.load`); here every number is a number.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    SerializeAsAny,
    SerializerFunctionWrapHandler,
    field_validator,
    model_serializer,
    model_validator,
)

from forestgen.recipe.camera_keys import default_view
from forestgen.recipe.cameras import AnyCamera, Camera, check_cameras, check_motion
from forestgen.recipe.classes import MOST_CLASSES, NO_SPECIES, check_classes
from forestgen.recipe.dataset import Dataset
from forestgen.recipe.fields import (
    Flag,
    Fraction,
    Label,
    Name,
    NonNegative,
    Number,
    OpenSection,
    Positive,
    Section,
    Text,
    Whole,
    mistake,
    part_name,
    spelled_out,
)
from forestgen.recipe.plants import Plants
from forestgen.recipe.registries import DEFAULT_CHANNELS, GROUND_COVERS, LABEL_CHANNELS, each_once
from forestgen.recipe.render import Render
from forestgen.recipe.sampling import Sampling
from forestgen.recipe.sky import SkySection
from forestgen.recipe.species import Species
from forestgen.recipe.terrain import Terrain
from forestgen.recipe.wet_soil import WetSoil

SCHEMA_VERSION = 1
Extent = Annotated[Positive, Field(le=5000)]


class Site(Section):
    """The piece of land: x from 0 to size_m[0] (east), y from 0 to size_m[1] (north)."""

    size_m: tuple[Extent, Extent] = Field(
        default=(
            100.0,
            100.0,
        ),
        description="Extent east (x) and north (y), metres.",
    )
    terrain: SerializeAsAny[Terrain] = Field(
        default_factory=lambda: Terrain.model_validate({}), description="Shape of the ground, or just its kind."
    )
    ground: Annotated[Text, *part_name(GROUND_COVERS)] = Field(default="litter", description="What covers it.")
    altitude_m: Number = Field(
        default=0.0,
        ge=-430,
        le=9000,
        description="Height of z = 0 above sea level, metres; for species with a response to elevation_m, and for the "
        "light that comes through the air above.",
    )
    latitude_deg: Number = Field(
        default=50.0,
        ge=-90,
        le=90,
        description="Latitude, degrees, north positive: where the sun stands over the year, for species with a "
        "response to sun, and for an image's own sun where sky.sun has a date.",
    )
    longitude_deg: Number | None = Field(
        default=None, ge=-180, le=180, description="Longitude, degrees, east positive; for a sun by date and time."
    )
    wind_from_deg: Number = Field(
        default=270.0,
        ge=-360,
        le=360,
        description="Where the prevailing wind comes from, degrees clockwise from north: 270 is west; for species with "
        "a response to wind, and for the wind that plants lean and sway in.",
    )
    wet_soil: WetSoil | None = Field(
        default=None,
        description="How litter, dry soil, rock and sand darken where the community model has water in its soil; "
        "false: they do not. Default: they do.",
    )

    @field_validator("terrain", mode="before")
    @classmethod
    def _kind_alone(cls, value: Any) -> Any:
        return spelled_out(value, "kind")

    @field_validator("wet_soil", mode="before")
    @classmethod
    def _shown_alone(cls, value: Any) -> Any:
        return {"shown": value} if isinstance(value, bool) else value

    @model_serializer(mode="wrap")
    def _without_what_few_need(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        found: dict[str, Any] = handler(self)
        return {key: value for key, value in found.items() if key != "wet_soil" or value is not None}


class Community(OpenSection):
    """The plants of the stand: a community model, and keys that the model checks itself."""

    model: Text = Field(min_length=1, max_length=100, description="Id of the community model.")


Channel = Annotated[Text, *part_name(LABEL_CHANNELS)]


class Labels(Section):
    """Which labels are made, and how."""

    samples: Whole = Field(
        default=16, ge=1, le=1024, description="Identity samples a pixel, a square number: 1, 4, 9, 16, ..."
    )
    channels: Annotated[tuple[Channel, ...], AfterValidator(each_once)] = Field(
        default=DEFAULT_CHANNELS,
        description="Labels besides the masks: coverage ranks, surface (position, normals), albedo, sun (shadows), "
        "cloud opacity, motion, occlusion boundaries, amodal masks; and module, not among those made by default: "
        "branch modules and their segments.",
    )
    classes: dict[Label, tuple[Name, ...]] | None = Field(
        default=None,
        max_length=MOST_CLASSES,
        description="Semantic classes: name -> the species and parts in it, a part before a species; `others` are the "
        "species that no class names. A name may have blanks. Default: each species is a class.",
    )

    @field_validator("samples")
    @classmethod
    def _is_square(cls, value: int) -> int:
        if math.isqrt(value) ** 2 != value:
            raise mistake("a square number: 1, 4, 9, 16, 25, ...")
        return value


class Wind(Section):
    """Wind at each plant's top, in which it leans and sways; it blows from site.wind_from_deg, by default the west."""

    speed_m_per_s: NonNegative = Field(default=0.0, le=40, description="Mean speed, metres per second; 0: still air.")
    gustiness: Fraction = Field(default=0.5, description="Amplitude of the sway by the mean lean, 0 to 1.")


def _is_same_stand(value: Any) -> Any:
    if isinstance(value, bool) or value == "by_split":
        return value
    hint = "this key may not be a distribution" if isinstance(value, Mapping) else None
    raise mistake("true, false or by_split", hint=hint)


class Recipe(Section):
    """A drawn, complete recipe."""

    forestgen: Literal[1] = Field(description="Version of the recipe's schema.")
    seed: Whole = Field(default=0, ge=0, lt=2**63, description="Root of all randomness; 0 is a seed.")
    images: Whole = Field(default=1, ge=1, le=10**9, description="How many images, each drawn anew.")
    first_image: Whole = Field(
        default=0, ge=0, le=10**12, description="Index of the first image; a stored drawn recipe keeps its own here."
    )
    same_stand: Annotated[Flag | Literal["by_split"], BeforeValidator(_is_same_stand)] = Field(
        default=False,
        description="Whether all images show image 0's stand, or by_split, all images of a split the split's own; "
        "distributions are still drawn by image.",
    )
    site: Site = Field(default_factory=Site, description="The piece of land.")
    species: dict[Name, Species] = Field(min_length=1, max_length=1000, description="Species by name.")
    community: Community = Field(description="The plants of the stand: a community model and its own keys.")
    plants: Plants = Field(default=Plants(), description="How plants are modelled.")
    sky: SerializeAsAny[SkySection] = Field(
        default_factory=lambda: SkySection.model_validate({}), description="Everything above: sun, sky, clouds."
    )
    cameras: list[AnyCamera] = Field(min_length=1, max_length=1000, description="Cameras, at least one.")
    render: Render = Field(default=Render(), description="The light's computation.")
    labels: Labels = Field(default=Labels(), description="The labels' computation.")
    wind: Wind = Field(default=Wind(), description="How plants lean and sway.")
    dataset: Dataset = Field(default=Dataset(), description="Files for training and measuring.")
    sampling: Sampling | None = Field(
        default=None, description="How draws are spread over the images, correlated and shared."
    )

    @model_validator(mode="before")
    @classmethod
    def _complete_cameras(cls, data: Any) -> Any:
        if not isinstance(data, Mapping):
            return data
        cameras = data.get("cameras", [{}])
        if not isinstance(cameras, list):
            return data
        size = _size_m(data.get("site"))
        filled = [
            {"name": f"camera{i}", **camera, **default_view(camera, size, Camera.class_for(camera))}
            if isinstance(camera, Mapping)
            else camera
            for i, camera in enumerate(cameras)
        ]
        return {**data, "cameras": filled}

    @model_validator(mode="after")
    def _dated_sun_has_a_place(self) -> Self:
        given = {
            "latitude_deg": "latitude_deg" in self.site.model_fields_set,  # its default is no place to trust
            "longitude_deg": self.site.longitude_deg is not None,
        }
        missing = [key for key, known in given.items() if not known]
        if self.sky.sun.date is not None and missing:
            raise mistake(
                "site.latitude_deg and site.longitude_deg, degrees",
                problem="the sun by date needs a place on earth",
                got="no " + " and no ".join(missing),
                hint="site: {latitude_deg: 51.0, longitude_deg: 13.7} is Dresden",
                at=("site", missing[0]),
            )
        return self

    @field_validator("species")
    @classmethod
    def _species_are_plants(cls, species: dict[str, Species]) -> dict[str, Species]:
        for name in species:
            if name.lower() in NO_SPECIES:
                raise mistake(
                    f"another name than {', '.join(NO_SPECIES)}",
                    problem="labels use this name for what is no plant",
                    got=name,
                    at=(name,),
                )
        return species

    @model_validator(mode="after")
    def _classes_hold_all(self) -> Self:
        wrong = None if self.labels.classes is None else check_classes(self.labels.classes, list(self.species))
        if wrong is not None:
            at = ("labels", "classes", *wrong.at)
            raise mistake(wrong.expected, problem=wrong.problem, got=wrong.got, hint=wrong.hint, at=at)
        return self

    @field_validator("cameras")
    @classmethod
    def _names_differ(cls, cameras: list[Camera]) -> list[Camera]:
        check_cameras(cameras)
        return cameras

    @model_validator(mode="after")
    def _paths_show_something(self) -> Self:
        check_motion(self.cameras, plants_move=self.wind.speed_m_per_s > 0 and self.wind.gustiness > 0)
        return self


def _size_m(site: Any) -> tuple[float, float]:
    """The site's extent; its default instead of a bad one, which is left for validation to name."""
    size = site.get("size_m") if isinstance(site, Mapping) else None
    pair = size if isinstance(size, list | tuple) and len(size) == 2 else (0, 0)
    good = all(isinstance(extent, int | float) and 0 < extent <= 5000 for extent in pair)
    return (float(pair[0]), float(pair[1])) if good else (100.0, 100.0)
