"""A plant in the wind: exemplars of one plant at a sequence of times."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from forestgen.core.errors import RecipeError
from forestgen.core.randomness import child_rng
from forestgen.plants.build import build_exemplar, leaf_area_m2, size_m
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.plants.meshing import organ_meshes
from forestgen.plants.parameters import Sways
from forestgen.plants.plan import PlantPlan
from forestgen.plants.registry import GENERATORS


def check_sways(species_name: str, parameters: Any) -> None:
    """Raise `RecipeError` if the plant's generator has no poses."""
    if parameters.variation is not None or not isinstance(GENERATORS.load(parameters.generator), Sways):
        able = " or ".join(name for name, generator in GENERATORS.parts() if isinstance(generator, Sways))
        raise RecipeError(
            "plants of this species cannot sway",
            parameter="frames",
            expected=f"a species of the generator {able}, without variation",
            got=f"{species_name}, of the generator {parameters.generator}",
            hint="`forestgen plant --list` shows generators; or leave `frames` out",
        )


def sway(
    plan: PlantPlan, species_name: str, radius_m: float, seed: int, frames: int, frames_per_s: float
) -> Iterator[Exemplar]:
    """The plant of a seed at times 0, 1 / frames_per_s, ..."""
    species, parameters = plan.drawn.species[species_name], plan.generators[species_name]
    generator: Sways = GENERATORS.load(parameters.generator)
    parameters = generator.in_wind(parameters)
    anew = partial(child_rng, seed, "exemplar", species_name)
    still = build_exemplar(species_name, species, parameters, radius_m, anew())
    times_s = (np.arange(frames) / frames_per_s).tolist()
    for skeleton in generator.poses(parameters, *size_m(species, radius_m), anew(), times_s):
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
