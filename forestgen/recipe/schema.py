"""The recipe's schema: what a drawn recipe may say, in which unit, and what it need not say.

Distributions are drawn, shorthands spelled out and species files merged before a recipe meets this schema
(`forestgen.recipe.load`); here every number is a number.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from forestgen.recipe.fields import (
    Coordinate,
    Flag,
    Fraction,
    Name,
    Number,
    OpenSection,
    Point,
    Positive,
    Section,
    Text,
    Whole,
    mistake,
)
from forestgen.recipe.species import Species

SCHEMA_VERSION = 1
Extent = Annotated[Positive, Field(le=5000)]
Pixels = Annotated[Whole, Field(ge=8, le=16384)]


def _spelled_out(value: Any, key: str) -> Any:
    """A shorthand such as ``terrain: flat`` as the mapping that it stands for."""
    return {key: value} if isinstance(value, str) else value


class Terrain(Section):
    """The ground's shape."""

    kind: Annotated[Literal["flat", "rolling"], Field(description="Shape of the ground.")] = "flat"
    amplitude_m: Annotated[
        Number, Field(ge=0, le=500, description="Standard deviation of rolling ground's height, metres.")
    ] = 0.8
    wavelength_m: Annotated[
        Positive, Field(ge=1, le=10000, description="Longest distance between rolling ground's crests, metres.")
    ] = 70.0


class Site(Section):
    """The piece of land: x from 0 to size_m[0] (east), y from 0 to size_m[1] (north)."""

    size_m: Annotated[tuple[Extent, Extent], Field(description="Extent east (x) and north (y), metres.")] = (
        100.0,
        100.0,
    )
    terrain: Annotated[Terrain, Field(description="Shape of the ground, or just its kind.")] = Terrain()
    altitude_m: Annotated[
        Number,
        Field(
            ge=-430,
            le=9000,
            description="Height of z = 0 above sea level, metres; for species with a response to elevation_m.",
        ),
    ] = 0.0
    latitude_deg: Annotated[
        Number,
        Field(
            ge=-90,
            le=90,
            description="Latitude, degrees, north positive: where the sun stands over the year, for species with a "
            "response to sun. An image's own sun is sky.sun.",
        ),
    ] = 50.0
    wind_from_deg: Annotated[
        Number,
        Field(
            ge=-360,
            le=360,
            description="Where the prevailing wind comes from, degrees clockwise from north: 270 is west; for species "
            "with a response to wind.",
        ),
    ] = 270.0

    @field_validator("terrain", mode="before")
    @classmethod
    def _kind_alone(cls, value: Any) -> Any:
        return _spelled_out(value, "kind")


class Community(OpenSection):
    """Who grows where: a community model, and keys that the model checks itself."""

    model: Annotated[Text, Field(min_length=1, max_length=100, description="Id of the community model.")]


class Plants(Section):
    """What each plant looks like."""

    geometry: Annotated[
        Literal["plants", "silhouettes"],
        Field(
            description="plants: stems, branches and leaves. silhouettes: solids of revolution of the crowns' forms, "
            "for looking at a stand before its plants (Lane 2002, Figure 6.2)."
        ),
    ] = "plants"

    exemplars_per_species: Annotated[
        Whole,
        Field(
            ge=1,
            le=1000,
            description="Sizes modelled for each species: the centres of clusters of its plants' radii. Every plant is "
            "one of these, scaled to its exact height.",
        ),
    ] = 10
    variants_per_size: Annotated[
        Whole,
        Field(
            ge=1,
            le=100,
            description="Plants modelled for each size, of different seeds; a plant's own number decides which it is. "
            "Time and memory grow with it.",
        ),
    ] = 1
    traits: Annotated[
        tuple[Text, ...],
        Field(
            max_length=20,
            description="What counts beside the radius when plants are grouped into sizes: age_yr, height_m, or a "
            "column of the community model's own. One standard deviation of a trait counts half as much as one of the "
            "radius' logarithm.",
        ),
    ] = ()
    levels: Annotated[
        Flag,
        Field(
            description="Whether plants far from every camera show fewer, larger leaves and twigs, of the same area, "
            "chosen so that they stay below a pixel."
        ),
    ] = False
    cache: Annotated[
        Flag,
        Field(
            description="Whether to keep the modelled plants on disk and take them from there when the same ones are "
            "asked for again; nothing else changes. FORESTGEN_CACHE names the folder."
        ),
    ] = True

    @field_validator("traits")
    @classmethod
    def _each_once(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for index, trait in enumerate(value):
            if trait in value[:index]:
                raise mistake("each trait once", problem="a trait named twice", got=repr(trait), at=(index,))
        return value


class Sun(Section):
    """Where the sun stands."""

    elevation_deg: Annotated[Number, Field(gt=0, le=90, description="Height above the horizon, degrees.")] = 40.0
    azimuth_deg: Annotated[
        Number, Field(ge=-360, le=360, description="Direction clockwise from north, degrees: 90 is east.")
    ] = 140.0


class Clouds(Section):
    """The cloud field above the site."""

    type: Annotated[Literal["cumulus", "none"], Field(description="Kind of cloud.")] = "none"
    cover: Annotated[Fraction, Field(description="Fraction of the sky's area under cloud, 0 to 1.")] = 0.35
    base_m: Annotated[Positive, Field(le=20000, description="Height of the clouds' base above ground, metres.")] = 900.0
    thickness_m: Annotated[Positive, Field(le=20000, description="Height of the cloud layer, metres.")] = 350.0
    extinction_per_m: Annotated[Positive, Field(le=1, description="Extinction inside a cloud, per metre.")] = 0.05
    extent_m: Annotated[Positive, Field(le=20000, description="Side of the square of clouds, metres.")] = 8000.0


class SkySection(Section):
    """Sun, clear sky and clouds."""

    sun: Annotated[Sun, Field(description="Direction of the sun.")] = Sun()
    turbidity: Annotated[Number, Field(ge=1, le=10, description="Haze: 1 is pure air, 3 clear, 10 hazy; no unit.")] = (
        3.0
    )
    clouds: Annotated[Clouds, Field(description="The cloud field, or just its type.")] = Clouds()

    @field_validator("clouds", mode="before")
    @classmethod
    def _type_alone(cls, value: Any) -> Any:
        return _spelled_out(value, "type")


class Camera(Section):
    """A camera; site frame: x east, y north, z up, metres."""

    name: Annotated[Name, Field(description="Name in file names; default camera0, camera1, ...")]
    kind: Annotated[Literal["perspective"], Field(description="Projection.")] = "perspective"
    position_m: Annotated[
        Point, Field(description="Where it stands: x, y, z, metres. Default: eye level, southern edge's middle.")
    ]
    look_at_m: Annotated[
        Point, Field(description="The point in the image's middle: x, y, z, metres. Default: amid the site.")
    ]
    size_px: Annotated[tuple[Pixels, Pixels], Field(description="Width and height of the image, pixels.")] = (640, 360)
    hfov_deg: Annotated[Number, Field(ge=0.1, le=170, description="Horizontal field of view, degrees.")] = 60.0
    height_above_ground: Annotated[
        Flag, Field(description="Whether the z of position_m and look_at_m count from the ground below or from z = 0.")
    ] = True

    @model_validator(mode="after")
    def _looks_somewhere(self) -> Self:
        if math.dist(self.position_m, self.look_at_m) < 1e-6:
            raise mistake(
                "a look_at_m away from position_m",
                problem="the camera looks at itself",
                got=str(list(self.look_at_m)),
                at=("look_at_m",),
            )
        return self


class Render(Section):
    """How the radiance is computed."""

    samples: Annotated[Whole, Field(ge=1, le=65536, description="Light paths a pixel.")] = 16
    denoise: Annotated[Flag, Field(description="Whether to remove the noise that remains.")] = True
    max_depth: Annotated[Whole, Field(ge=1, le=4096, description="Most scatterings of a path.")] = 64


class Labels(Section):
    """How the labels are computed."""

    samples: Annotated[
        Whole, Field(ge=1, le=1024, description="Identity samples a pixel, a square number: 1, 4, 9, 16, ...")
    ] = 16

    @field_validator("samples")
    @classmethod
    def _is_square(cls, value: int) -> int:
        if math.isqrt(value) ** 2 != value:
            raise mistake("a square number: 1, 4, 9, 16, 25, ...")
        return value


class Recipe(Section):
    """A drawn, complete recipe."""

    forestgen: Annotated[Literal[1], Field(description="Version of the recipe's schema.")]
    seed: Annotated[Whole, Field(ge=0, lt=2**63, description="Root of all randomness; 0 is a seed.")] = 0
    images: Annotated[Whole, Field(ge=1, le=10**9, description="How many images, each drawn anew.")] = 1
    first_image: Annotated[
        Whole,
        Field(ge=0, le=10**12, description="Index of the first image; a stored drawn recipe keeps its own here."),
    ] = 0
    site: Annotated[Site, Field(description="The piece of land.")] = Site()
    species: Annotated[dict[Name, Species], Field(min_length=1, max_length=1000, description="Species by name.")]
    community: Annotated[Community, Field(description="Who grows where: a model and its own keys.")]
    plants: Annotated[Plants, Field(description="How plants are modelled.")] = Plants()
    sky: Annotated[SkySection, Field(description="Everything above: sun, clear sky, clouds.")] = SkySection()
    cameras: Annotated[list[Camera], Field(min_length=1, max_length=1000, description="Cameras, at least one.")]
    render: Annotated[Render, Field(description="The light's computation.")] = Render()
    labels: Annotated[Labels, Field(description="The labels' computation.")] = Labels()

    @model_validator(mode="before")
    @classmethod
    def _complete_cameras(cls, data: Any) -> Any:
        if not isinstance(data, Mapping):
            return data
        cameras = data.get("cameras", [{}])
        if not isinstance(cameras, list):
            return data
        view = _default_view(data.get("site"))
        filled = [
            {"name": f"camera{i}", **view, **camera} if isinstance(camera, Mapping) else camera
            for i, camera in enumerate(cameras)
        ]
        return {**data, "cameras": filled}

    @field_validator("cameras")
    @classmethod
    def _names_differ(cls, cameras: list[Camera]) -> list[Camera]:
        # Compared without case: the names become files, and some file systems ignore case.
        names = [camera.name.lower() for camera in cameras]
        for i, name in enumerate(names):
            if name in names[:i]:
                raise mistake(
                    "a different name for each camera",
                    problem="two cameras of one name",
                    got=cameras[i].name,
                    at=(i, "name"),
                )
        return cameras


def _default_view(site: Any) -> dict[str, list[Coordinate]]:
    """Eye level at the middle of the southern edge, looking north over the site; metres."""
    size = site.get("size_m") if isinstance(site, Mapping) else None
    width, depth = 100.0, 100.0
    # A bad size is left for validation to name.
    pair = size if isinstance(size, list | tuple) and len(size) == 2 else (0, 0)
    good = all(isinstance(extent, int | float) and 0 < extent <= 5000 for extent in pair)
    width, depth = pair if good else (100.0, 100.0)
    return {"position_m": [0.5 * width, 0.02 * depth, 1.7], "look_at_m": [0.5 * width, 0.6 * depth, 6.0]}
