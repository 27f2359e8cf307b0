"""Keys of the ground of a site: the surface that is painted, and layers of what lies and grows on it."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field, SerializeAsAny

from forestgen.recipe import fields
from forestgen.recipe.registries import GROUND_COVERS, GROUND_LAYERS

MOST_LAYERS = 20
DENSEST = 0.98  # cover of a layer: the last bare places would take endlessly many things


class GroundLayer(fields.PartSection):
    """Things of one kind that lie or grow on the ground."""

    registry = GROUND_LAYERS
    selector = "what"
    is_painted: ClassVar[bool] = False  # nothing of it is drawn: it is a colour of the ground

    what: Annotated[fields.Text, Field(description="What lies or grows there.")]
    cover: fields.Number = Field(
        0.5, gt=0, le=DENSEST, description="Share of the ground that it hides, seen from above; mean over the site."
    )
    patch_m: fields.Positive | None = Field(
        None,
        ge=0.5,
        le=1000,
        description="Size of its patches, metres. Where it is painted, patches of more than 12 m do not show. "
        "Default: as dense everywhere.",
    )


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
