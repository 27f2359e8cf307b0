"""A plant's wood for programs that draw in real time: few triangles, and one texture that does not repeat."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from forestgen.core.arguments import whole_of
from forestgen.geometry.export import Piece, Surface, srgb
from forestgen.geometry.mesh import concatenate, part_of, surface_area_m2
from forestgen.geometry.simplify import bake, decimate, unwrap
from forestgen.plants.bark.texture import SurfaceTexture

FEWEST_TRIANGLES = 100
_MOST_TRIANGLES = 10**9
ATLAS_PX = 2048
_NAME = "wood"


def check_wood_triangles(number: int | None) -> None:
    """Raise `RecipeError` for a number that no trunk can be made of."""
    if number is not None:
        whole_of(number, "wood_triangles", FEWEST_TRIANGLES, _MOST_TRIANGLES)


def with_light_wood(
    pieces: Sequence[Piece], textures: Mapping[str, SurfaceTexture], triangles: int
) -> tuple[Piece, ...]:
    """The pieces; those with a bark decimated to about `triangles` in all, with one atlas of their barks' colours.

    The relief is left out: from as far as such a plant is seen it does not show. Every twig keeps four triangles, so
    that a plant of many twigs keeps more than asked for.

    `textures`: by the names of the pieces' surfaces; pieces of other surfaces stay.
    """
    wood = [piece for piece in pieces if piece.surface.name in textures]
    if not wood:
        return tuple(pieces)
    share = min(triangles / sum(piece.mesh.triangles for piece in wood), 1.0)
    coarse = [decimate(piece.mesh, round(share * piece.mesh.triangles)) for piece in wood]
    atlas = unwrap(concatenate(coarse))
    fine = [(piece.mesh, textures[piece.surface.name].colour) for piece in wood]
    image = srgb(bake(atlas, fine, ATLAS_PX))
    first = wood[0].surface
    surface = Surface(_NAME, first.reflectance, roughness=first.roughness, colour_image=image)
    ends = np.cumsum([mesh.triangles for mesh in coarse])
    light = {}
    for piece, start, end in zip(wood, [0, *ends], ends, strict=False):
        mesh = part_of(atlas, atlas.faces[start:end])
        area = {"area_m2": surface_area_m2(mesh)}
        light[piece.name] = replace(piece, mesh=mesh, surface=surface, properties={**piece.properties, **area})
    return tuple(light.get(piece.name, piece) for piece in pieces)
