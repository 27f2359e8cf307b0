"""What every form of organ has in common: its label, its materials, its pieces."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated, Literal, NamedTuple

from pydantic import AfterValidator, Field

from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh
from forestgen.geometry.patches import Patch, to_mesh
from forestgen.plants.exemplar import OrganMesh
from forestgen.recipe.fields import Section

_LEAST_M = 1e-4  # triangles that are smaller vanish in single precision


def _none_or_seen(size_m: float) -> float:
    if 0.0 < size_m < _LEAST_M:
        raise ValueError(f"0 for none, or at least {_LEAST_M:g} m")
    return size_m


Size = Annotated[float, Field(ge=_LEAST_M, le=30.0)]  # metres
MaybeSize = Annotated[float, Field(ge=0.0, le=30.0), AfterValidator(_none_or_seen)]  # metres
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Bend = Annotated[float, Field(ge=-360.0, le=360.0)]  # degrees
Detail = Annotated[
    Literal[0, 1, 2],
    Field(description="0: few triangles, for large trees; 1: the outline; 2: for a close view. The area is the same"),
]
PartName = Literal["leaf", "flower", "fruit", "trunk", "branch", "dead_wood"]


class OrganPatch(NamedTuple):
    """Triangles of one material, in the organ's frame: foot at the origin, y along it, z its upper side, metres."""

    material: str
    patch: Patch
    part: Part | None = None  # None: the organ's own


class OrganForm(Section):
    """The form of one kind of organ; subclasses have the keys that their form understands and no other."""

    part: PartName = Field("leaf", description="the label of its surface")
    material: str = Field(description="name of one of the species' materials")

    def patches(self) -> list[OrganPatch]:
        """The organ's triangles, in its own frame."""
        raise NotImplementedError

    def pieces(self) -> tuple[OrganMesh, ...]:
        """The organ's surfaces, one for each of its labels and materials."""
        return _pieces(self)

    def template(self) -> Mesh:
        """The whole organ as one mesh, in its own frame."""
        return _template(self)


@lru_cache(maxsize=512)
def _pieces(form: OrganForm) -> tuple[OrganMesh, ...]:
    joined: dict[tuple[Part, str], list[Patch]] = {}
    for material, patch, part in form.patches():
        if len(patch.faces):
            part = Part[form.part.upper()] if part is None else part
            joined.setdefault((part, material), []).append(patch)
    return tuple(OrganMesh(part, material, to_mesh(*patches)) for (part, material), patches in joined.items())


@lru_cache(maxsize=512)
def _template(form: OrganForm) -> Mesh:
    return to_mesh(*(one.patch for one in form.patches()))
