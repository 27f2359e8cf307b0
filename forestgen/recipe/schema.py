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

from forestgen.recipe.buildings import Building
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

    size_m: Annotated[tuple[Extent, Extent], Field(description="Extent east (x) and north (y), metres.")] = (
        100.0,
        100.0,
    )
    terrain: SerializeAsAny[Terrain] = Field(
        default_factory=lambda: Terrain.model_validate({}), description="Shape of the ground, or just its kind."
    )
    ground: Annotated[
        Text,
        *part_name(GROUND_COVERS),
        Field(description="What covers it."),
    ] = "litter"
    altitude_m: Annotated[
        Number,
        Field(
            ge=-430,
            le=9000,
            description="Height of z = 0 above sea level, metres; for species with a response to elevation_m, and for "
            "the light that comes through the air above.",
        ),
    ] = 0.0
    latitude_deg: Annotated[
        Number,
        Field(
            ge=-90,
            le=90,
            description="Latitude, degrees, north positive: where the sun stands over the year, for species with a "
            "response to sun, and for an image's own sun where sky.sun has a date.",
        ),
    ] = 50.0
    longitude_deg: Annotated[
        Number | None,
        Field(ge=-180, le=180, description="Longitude, degrees, east positive; for a sun by date and time."),
    ] = None
    wind_from_deg: Annotated[
        Number,
        Field(
            ge=-360,
            le=360,
            description="Where the prevailing wind comes from, degrees clockwise from north: 270 is west; for species "
            "with a response to wind, and for the wind that plants lean and sway in.",
        ),
    ] = 270.0
    buildings: Annotated[
        tuple[SerializeAsAny[Building], ...],
        Field(
            max_length=1000, description="What people have built there; for community models that know of buildings."
        ),
    ] = ()
    wet_soil: Annotated[
        WetSoil | None,
        Field(
            description="How litter, dry soil, rock and sand darken where the community model has water in its "
            "soil; false: they do not. Default: they do."
        ),
    ] = None

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
        few = {"wet_soil": None, "buildings": ()}
        return {key: value for key, value in found.items() if key not in few or value not in (few[key], [])}

    @model_validator(mode="after")
    def _buildings_stand_on_it(self) -> Self:
        width, depth = self.size_m
        for index, one in enumerate(self.buildings):
            corners = one.corners_m()
            low, high = (", ".join(f"{value:.1f}" for value in corner) for corner in (corners.min(0), corners.max(0)))
            if (corners < 0).any() or (corners > (width, depth)).any():
                x, y = one.position_m
                raise mistake(
                    f"all of its ground plan within x from 0 to {width:g} and y from 0 to {depth:g} metres",
                    problem="this building does not lie on the site",
                    got=f"[{x:g}, {y:g}], from [{low}] to [{high}]",
                    at=("buildings", index, "position_m"),
                )
        return self


class Community(OpenSection):
    """The plants of the stand: a community model, and keys that the model checks itself."""

    model: Annotated[Text, Field(min_length=1, max_length=100, description="Id of the community model.")]


Channel = Annotated[Text, *part_name(LABEL_CHANNELS)]


class Labels(Section):
    """Which labels are made, and how."""

    samples: Annotated[
        Whole, Field(ge=1, le=1024, description="Identity samples a pixel, a square number: 1, 4, 9, 16, ...")
    ] = 16
    channels: Annotated[
        tuple[Channel, ...],
        AfterValidator(each_once),
        Field(
            description="Labels besides the masks: coverage ranks, surface (position, normals), albedo, sun (shadows), "
            "cloud opacity, motion, occlusion boundaries, amodal masks; and module, not among those made by default: "
            "branch modules and their segments."
        ),
    ] = DEFAULT_CHANNELS
    classes: Annotated[
        dict[Label, tuple[Name, ...]] | None,
        Field(
            max_length=MOST_CLASSES,
            description="Semantic classes: name -> the species and parts in it, a part before a species; `others` "
            "are the species that no class names. A name may have blanks. Default: each species is a class.",
        ),
    ] = None

    @field_validator("samples")
    @classmethod
    def _is_square(cls, value: int) -> int:
        if math.isqrt(value) ** 2 != value:
            raise mistake("a square number: 1, 4, 9, 16, 25, ...")
        return value


class Wind(Section):
    """Wind at each plant's top, in which it leans and sways; it blows from site.wind_from_deg, by default the west."""

    speed_m_per_s: Annotated[NonNegative, Field(le=40, description="Mean speed, metres per second; 0: still air.")] = (
        0.0
    )
    gustiness: Annotated[Fraction, Field(description="Amplitude of the sway by the mean lean, 0 to 1.")] = 0.5


def _is_same_stand(value: Any) -> Any:
    if isinstance(value, bool) or value == "by_split":
        return value
    hint = "this key may not be a distribution" if isinstance(value, Mapping) else None
    raise mistake("true, false or by_split", hint=hint)


class Recipe(Section):
    """A drawn, complete recipe."""

    forestgen: Annotated[Literal[1], Field(description="Version of the recipe's schema.")]
    seed: Annotated[Whole, Field(ge=0, lt=2**63, description="Root of all randomness; 0 is a seed.")] = 0
    images: Annotated[Whole, Field(ge=1, le=10**9, description="How many images, each drawn anew.")] = 1
    first_image: Annotated[
        Whole,
        Field(ge=0, le=10**12, description="Index of the first image; a stored drawn recipe keeps its own here."),
    ] = 0
    same_stand: Annotated[
        Flag | Literal["by_split"],
        BeforeValidator(_is_same_stand),
        Field(
            description="Whether all images show image 0's stand, or by_split, all images of a split the split's own; "
            "distributions are still drawn by image."
        ),
    ] = False
    site: Site = Field(default_factory=Site, description="The piece of land.")
    species: Annotated[dict[Name, Species], Field(min_length=1, max_length=1000, description="Species by name.")]
    community: Annotated[Community, Field(description="The plants of the stand: a community model and its own keys.")]
    plants: Annotated[Plants, Field(description="How plants are modelled.")] = Plants()
    sky: SerializeAsAny[SkySection] = Field(
        default_factory=lambda: SkySection.model_validate({}), description="Everything above: sun, sky, clouds."
    )
    cameras: Annotated[list[AnyCamera], Field(min_length=1, max_length=1000, description="Cameras, at least one.")]
    render: Annotated[Render, Field(description="The light's computation.")] = Render()
    labels: Annotated[Labels, Field(description="The labels' computation.")] = Labels()
    wind: Annotated[Wind, Field(description="How plants lean and sway.")] = Wind()
    dataset: Annotated[Dataset, Field(description="Files for training and measuring.")] = Dataset()
    sampling: Annotated[
        Sampling | None, Field(description="How draws are spread over the images, correlated and shared.")
    ] = None

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

    @property
    def labelled_names(self) -> tuple[str, ...]:
        """Names of what has instances: the species, and the kinds of buildings."""
        return (*self.species, *dict.fromkeys(one.kind for one in self.site.buildings))

    @model_validator(mode="after")
    def _species_are_plants(self) -> Self:
        reserved = (*NO_SPECIES, *(one.kind for one in self.site.buildings))
        for name in self.species:
            if name.lower() in reserved:
                raise mistake(
                    f"another name than {', '.join(reserved)}",
                    problem="labels use this name for what is no plant",
                    got=name,
                    at=("species", name),
                )
        return self

    @model_validator(mode="after")
    def _classes_hold_all(self) -> Self:
        wrong = None if self.labels.classes is None else check_classes(self.labels.classes, self.labelled_names)
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
