"""The recipe's section ``plants``: how plants are modelled."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from forestgen.recipe.fields import Flag, Section, Text, Whole, mistake
from forestgen.recipe.spectra import Season


class Plants(Section):
    """What each plant looks like."""

    geometry: Literal["plants", "silhouettes"] = Field(
        default="plants",
        description="plants: stems, branches and leaves. silhouettes: solids of revolution of the crowns' forms, for "
        "looking at a stand before its plants (Lane 2002, Figure 6.2).",
    )
    exemplars_per_species: Whole = Field(
        default=10,
        ge=1,
        le=1000,
        description="Sizes modelled for each species: the centres of clusters of its plants' radii. Every plant is one "
        "of these, scaled to its exact height.",
    )
    variants_per_size: Whole = Field(
        default=1,
        ge=1,
        le=100,
        description="Plants modelled for each size, of different seeds; a plant's own number decides which it is. Time "
        "and memory grow with it.",
    )
    library: Whole | None = Field(
        default=None,
        ge=1,
        le=1000,
        description="Plants of each size that all images of a split share, for data sets of many images: sizes are on "
        "a fixed scale, and an image shows `variants_per_size` of them. null: every image grows its own plants. No "
        "two splits share a plant.",
    )
    traits: tuple[Text, ...] = Field(
        default=(),
        max_length=20,
        description="What counts beside the radius when plants are grouped into sizes: age_yr, height_m, or a column "
        "of the community model's own. One standard deviation of a trait counts half as much as one of the radius' "
        "logarithm.",
    )
    unique: Literal["auto", "all", "none"] | Annotated[Whole, Field(ge=0, le=100_000)] = Field(
        default="auto",
        description="Which plants that grew as branch modules are modelled with their own branches: auto, those that "
        "are large in an image, as many as ten million triangles hold; all; none; or so many of the largest. The "
        "others are one of `exemplars_per_species` of these, scaled and turned.",
    )
    levels: Flag = Field(
        default=False,
        description="Whether plants far from every camera show fewer, larger leaves and twigs, of the same area, "
        "chosen so that they stay below a pixel.",
    )
    season: Season = Field(
        default="summer",
        description="Of the leaves' spectra: spring, summer, autumn, dry. It changes their light, not their number; "
        "shipped evergreens stay green.",
    )
    cache: Flag = Field(
        default=True,
        description="Whether to keep the modelled plants on disk and take them from there when the same ones are asked "
        "for again; nothing else changes. FORESTGEN_CACHE names the folder.",
    )

    @field_validator("traits")
    @classmethod
    def _each_once(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for index, trait in enumerate(value):
            if trait in value[:index]:
                raise mistake("each trait once", problem="a trait named twice", got=repr(trait), at=(index,))
        return value

    @model_validator(mode="after")
    def _library_suits(self) -> Self:
        if self.library is None:
            return self
        if self.library < self.variants_per_size:
            raise mistake(
                f"at least variants_per_size = {self.variants_per_size}",
                problem="the library has fewer plants of a size than an image shows",
                got=str(self.library),
                at=("library",),
            )
        if self.traits:
            raise mistake(
                "no traits",
                problem="a library's plants are grouped by their size alone",
                got=", ".join(self.traits),
                hint="leave out plants.traits, or plants.library",
                at=("traits",),
            )
        return self
