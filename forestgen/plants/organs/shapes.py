"""Forms of organs, as the `shapes` of a species' file name them: `form` says which, and each has its own keys."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, TypeAdapter

from forestgen.plants.organs.base import OrganForm, OrganPiece
from forestgen.plants.organs.flowers import Acorn, Berry, Bud, Catkin, Cone, Daisy, Disc, FourPetals, Lily
from forestgen.plants.organs.fronds import (
    FanFrond,
    Fascicle,
    FernFrond,
    GrassBlade,
    GrassPanicle,
    NeedleTwig,
    PalmFrond,
)
from forestgen.plants.organs.leaves import CompoundLeaf, LobedLeaf, PalmateLeaf, SimpleLeaf

__all__ = ["OrganForm", "OrganPiece", "OrganShape", "organ_shape"]


#: The form of one kind of organ, told apart by its key `form`.
OrganShape = Annotated[
    SimpleLeaf
    | LobedLeaf
    | PalmateLeaf
    | CompoundLeaf
    | Fascicle
    | NeedleTwig
    | PalmFrond
    | FanFrond
    | FernFrond
    | GrassBlade
    | GrassPanicle
    | Daisy
    | FourPetals
    | Lily
    | Catkin
    | Bud
    | Berry
    | Acorn
    | Cone
    | Disc,
    Field(discriminator="form"),
]

_ADAPTER: TypeAdapter[Any] = TypeAdapter(OrganShape)


def organ_shape(keys: dict[str, Any]) -> OrganForm:
    """The shape that a mapping of keys describes.

    Raises `pydantic.ValidationError`: an unknown form or key, or a value out of bounds.
    """
    shape: OrganForm = _ADAPTER.validate_python(keys)
    return shape
