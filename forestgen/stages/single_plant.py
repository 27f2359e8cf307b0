"""One plant on its own: mesh, picture, numbers."""

from __future__ import annotations

import errno
import math
import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import OutputError, RecipeError
from forestgen.core.frames import look_at
from forestgen.core.progress import Progress
from forestgen.core.randomness import child_rng
from forestgen.core.timing import Timings
from forestgen.dataset.files import output_error, write_bytes
from forestgen.dataset.png import write_rgb
from forestgen.dataset.tonemap import tone_map
from forestgen.geometry.export import FORMATS, mesh_file
from forestgen.plants.build import build_exemplar
from forestgen.plants.exemplar import Exemplar
from forestgen.recipe.load import load_recipe_data
from forestgen.recipe.schema import Recipe
from forestgen.recipe.species import TALLEST_M, Species
from forestgen.scene.spec import Camera, Instances, SceneSpec, Sky
from forestgen.scene.terrain import build_terrain, flat
from forestgen.stages.frames import render_frame
from forestgen.stages.plan import make_plan
from forestgen.stages.scene import materials_of

_PICTURE_PX = (540, 720)


@dataclass(frozen=True)
class SinglePlant:
    """What was made."""

    species: str
    height_m: float
    crown_width_m: float
    triangles: int
    by_part: dict[str, int]
    leaf_area_m2: float
    mesh_path: Path
    picture_path: Path


def grow_single_plant(
    species: str, height_m: float | None, seed: int, mesh_path: Path, *, overwrite: bool, progress: Progress
) -> SinglePlant:
    """Grow a plant of a species (a shipped name or a file), write its mesh, and a picture beside it.

    Raises
    ------
    RecipeError, AssetError : unknown species, a height that is none, an unknown mesh format.
    OutputError : a file exists and may not be replaced, or cannot be written.
    """
    picture_path = mesh_path.with_suffix(".png")
    _check_paths(mesh_path, picture_path, overwrite)
    name = Path(species).stem
    alone = {"species": {name: {"from": species}}, "community": {"model": "multiset_lsystem"}}
    loaded = load_recipe_data({"forestgen": 1, "seed": seed, **alone}, "forestgen plant")
    plan = make_plan(loaded.draw(0))
    radius_m = _radius_m(plan.drawn.species[name], height_m)
    kind = plan.drawn.species[name]
    with progress.stage("plant", 1) as advance:
        rng = child_rng(seed, "exemplar", name)
        exemplar = build_exemplar(name, kind, plan.generator_parameters[name], radius_m, rng)
        advance(1)
    meshes = {
        f"{organ.part.name.lower()}-{organ.material}": (organ.mesh, kind.materials[organ.material].reflectance)
        for organ in exemplar.organs
    }
    picture = _picture(exemplar, plan.drawn.recipe, seed, progress)
    _write(mesh_path, mesh_file(meshes, mesh_path.suffix.lower()), picture_path, picture)
    return _described(exemplar, mesh_path, picture_path)


def _check_paths(mesh_path: Path, picture_path: Path, overwrite: bool) -> None:
    if mesh_path.suffix.lower() not in FORMATS:
        got = f"{str(mesh_path)!r:.200}"
        raise RecipeError("unknown mesh format", where="--output", expected=" or ".join(FORMATS), got=got)
    for path in (mesh_path, picture_path):
        try:
            if path.is_dir():
                raise OutputError(
                    "the output is a folder", where=str(path), expected="a file", hint="choose another name"
                )
            if path.exists() and not overwrite:
                raise OutputError("the file exists", where=str(path), hint="choose another name, or --overwrite")
            folder = next(parent for parent in path.absolute().parents if parent.exists())
        except OSError as error:
            raise output_error(error, path) from error
        if not (folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)):
            reason = errno.EACCES if folder.is_dir() else errno.ENOTDIR
            raise output_error(OSError(reason, os.strerror(reason)), path)


def _radius_m(species: Species, height_m: float | None) -> float:
    """Community radius of a plant of that height: the allometry's inverse."""
    if height_m is None:
        return species.ecology.max_radius_m
    if not (math.isfinite(height_m) and 0.02 <= height_m <= TALLEST_M):
        raise RecipeError("no such plant", where="--height", expected=f"0.02 to {TALLEST_M:g} m", got=f"{height_m:g}")
    law = species.allometry.height_m
    return float((height_m / law.scale) ** (1 / law.exponent)) if law.exponent else species.ecology.max_radius_m


def _picture(exemplar: Exemplar, recipe: Recipe, seed: int, progress: Progress) -> NDArray[np.uint8]:
    spec = _studio(exemplar, recipe)
    frame = render_frame(spec, spec.cameras[0], recipe, seed, progress, Timings())
    return tone_map(frame.radiance.mean if frame.radiance.denoised is None else frame.radiance.denoised)


def _studio(exemplar: Exemplar, recipe: Recipe) -> SceneSpec:
    """The plant alone on flat ground, filling an upright picture."""
    low, high = exemplar.bounds_m()
    size = max(high[2], 1.25 * float((high - low)[:2].max()))
    distance, middle = 1.9 * size, 0.5 * float(high[2])
    position = (0.0, -distance, 0.55 * float(high[2]))
    width, height = _PICTURE_PX
    hfov = 2 * math.degrees(math.atan(0.58 * size / distance * width / height))
    camera = Camera("plant", position, look_at(position, (0.0, 0.0, middle)), _PICTURE_PX, hfov)
    transform = np.eye(4)[None, :3]
    terrain = build_terrain(flat((10.0, 10.0)), child_rng(0, "studio"))
    sun = recipe.sky.sun
    return SceneSpec(
        exemplars=(exemplar,),
        materials=materials_of(recipe.species),
        instances=Instances(np.zeros(1, np.uint32), transform, np.ones(1, np.uint32)),
        terrain=terrain,
        sky=Sky(sun.elevation_deg, sun.azimuth_deg, recipe.sky.turbidity, float(terrain.texture.mean())),
        clouds=None,
        cameras=(camera,),
    )


def _write(mesh_path: Path, mesh: bytes, picture_path: Path, picture: NDArray[np.uint8]) -> None:
    """Both files or none: they are written under hidden names and renamed when both are complete."""
    partials = {path: path.with_name(f".{path.stem}.partial{path.suffix}") for path in (mesh_path, picture_path)}
    made = [folder for folder in (mesh_path.parent, *mesh_path.parent.parents) if not folder.exists()]
    try:
        mesh_path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(partials[mesh_path], mesh)
        write_rgb(partials[picture_path], picture)
        for path, partial in partials.items():
            partial.replace(path)
    except BaseException as error:
        for partial in partials.values():
            partial.unlink(missing_ok=True)
        for folder in made:
            with suppress(OSError):
                folder.rmdir()
        if isinstance(error, OSError | OutputError):
            cause = error if isinstance(error, OSError) else error.__cause__
            raise output_error(cause if isinstance(cause, OSError) else OSError(str(error)), mesh_path) from error
        raise


def _described(exemplar: Exemplar, mesh_path: Path, picture_path: Path) -> SinglePlant:
    by_part: dict[str, int] = {}
    for organ in exemplar.organs:
        part = organ.part.name.lower()
        by_part[part] = by_part.get(part, 0) + organ.mesh.triangles
    return SinglePlant(
        species=exemplar.species,
        height_m=exemplar.height_m,
        crown_width_m=exemplar.crown_width_m,
        triangles=exemplar.triangles,
        by_part=by_part,
        leaf_area_m2=exemplar.leaf_area_m2,
        mesh_path=mesh_path,
        picture_path=picture_path,
    )
