"""A plant in the wind: exemplars of one plant at a sequence of times."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from forestgen.core.errors import RecipeError
from forestgen.plants.build import build_exemplar, leaf_area_m2, size_m
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.plants.meshing import organ_meshes
from forestgen.recipe.species import Species

_SWAYING = "strands"  # the one generator that knows poses
# Where a species' file says nothing of wind, or makes the plant too stiff to move; degrees.
_BREEZE, _GIVING = {"speed_directed": 1.0, "speed_undirected": 2.5}, 0.3


def check_sways(species_name: str, parameters: Any) -> None:
    """Raise `RecipeError` if the plant's generator has no poses."""
    if parameters.generator != _SWAYING or parameters.variation is not None:
        raise RecipeError(
            "plants of this species cannot sway",
            parameter="frames",
            expected=f"a species of the generator {_SWAYING}, without variation",
            got=f"{species_name}, of the generator {parameters.generator}",
            hint="`forestgen plant --list` shows generators; or leave `frames` out",
        )


def sway(
    species_name: str,
    species: Species,
    parameters: Any,
    radius_m: float,
    seed_rng: Callable[[], np.random.Generator],
    frames: int,
    frames_per_s: float,
) -> Iterator[Exemplar]:
    """The plant of `build_exemplar` at times 0, 1 / frames_per_s, ...

    Parameters
    ----------
    seed_rng : gives the plant's random generator, anew at each call.
    """
    from forestgen.plants.strands.poses import poses

    wind = parameters.wind
    if wind.speed_undirected * (1.0 - parameters.stiffness) <= 0.0:
        breeze = wind.model_copy(update=_BREEZE)
        parameters = parameters.model_copy(update={"wind": breeze, "stiffness": min(parameters.stiffness, _GIVING)})
    still = build_exemplar(species_name, species, parameters, radius_m, seed_rng())
    times_s = (np.arange(frames) / frames_per_s).tolist()
    for skeleton in poses(parameters, *size_m(species, radius_m), seed_rng(), times_s):
        organs = organ_meshes(skeleton, parameters.shapes, parameters.wood)
        posed = replace(still, organs=_with_the_faces_of(still.organs, organs))
        low, high = posed.bounds_m()
        yield replace(
            posed,
            height_m=float(high[2]),
            crown_width_m=float(np.mean((high - low)[:2])),
            leaf_area_m2=leaf_area_m2(posed.organs, parameters.shapes),
        )


def _with_the_faces_of(still: tuple[OrganMesh, ...], posed: tuple[OrganMesh, ...]) -> tuple[OrganMesh, ...]:
    """Frames share their faces, as shape keys must; the mesher may cut a quad along its other diagonal."""
    shapes = [
        [(one.part, one.material, one.mesh.vertices_m.shape, one.mesh.faces.shape) for one in organs]
        for organs in (still, posed)
    ]
    if shapes[0] != shapes[1]:
        return posed
    pairs = zip(still, posed, strict=True)
    return tuple(replace(new, mesh=replace(new.mesh, faces=old.mesh.faces)) for old, new in pairs)
