"""Keys of the ground of a site: the surface that is painted, and layers of what lies and grows on it."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, SerializeAsAny, SerializerFunctionWrapHandler, model_serializer

from forestgen.recipe import fields
from forestgen.recipe.registries import GROUND_COVERS, GROUND_LAYERS

MOST_LAYERS = 20
DENSEST = 0.98  # cover of a layer: the last bare places would take endlessly many things


class GroundLayer(fields.PartSection):
    """Things of one kind that lie or grow on the ground."""

    registry = GROUND_LAYERS
    selector = "what"
    has_things: ClassVar[bool] = True  # that are drawn; others are a colour of the ground

    what: Annotated[fields.Text, Field(description="What lies or grows there.")]
    cover: fields.Number = Field(
        0.5, gt=0, le=DENSEST, description="Share of the ground that it hides, seen from above; mean over the site."
    )
    on: Literal["ground", "roadside", "path", "shore", "water"] = Field(
        "ground",
        description="ground: everywhere but in water and on paths. roadside: on the middle strips of forest roads and "
        "beside them alone. path: on what is bare of paths and roads. shore: in shallow water and beside it alone. "
        "water: floating, on all of it.",
    )
    patch_m: fields.Positive | None = Field(
        None,
        ge=0.5,
        le=1000,
        description="Size of its patches, metres. Where it is painted, patches of more than 12 m do not show. "
        "Default: as dense everywhere.",
    )

    @model_serializer(mode="wrap")
    def _without_the_usual_place(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        found: dict[str, Any] = handler(self)
        return {key: value for key, value in found.items() if (key, value) != ("on", "ground")}


class Ground(fields.Section):
    """What covers the ground."""

    kind: Annotated[fields.Text, *fields.part_name(GROUND_COVERS)] = Field(
        "litter", description="What it is painted as."
    )
    layers: tuple[SerializeAsAny[GroundLayer], ...] = Field(
        (),
        max_length=MOST_LAYERS,
        description="What lies and grows on it as geometry near the cameras, where things are larger than a pixel; "
        "farther away its mean colour is painted. It is background, without a plant_id: herbs that should count as "
        "plants belong into the community. `forestgen models --kind ground_layer` lists the kinds.",
    )


class WetSoil(fields.Section):
    """How the water that a community has in its soil shows in the ground's colour."""

    shown: fields.Flag = Field(True, description="Whether wet ground is darker.")
    depth_m: fields.Positive | None = Field(
        None,
        le=100,
        description="Depth of the soil that holds the water, metres: what makes a saturation of mm. Default: 1 in "
        "forest soil, 0.05 in a dryland's, whose rains wet little more than its crust.",
    )
    porosity: fields.Fraction = Field(0.4, gt=0, description="Share of the soil that water can fill.")
    pond_mm: fields.Positive = Field(
        25.0,
        le=10_000,
        description="Water on the ground that begins to drown it, mm; twice as much makes it wholly wet. Less is what "
        "runs past in showers, in a month's mean.",
    )
