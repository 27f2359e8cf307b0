"""Single plants: `plant` grows one; the object has its mesh, measures and picture, and writes mesh files."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from forestgen.api.display import display_of
from forestgen.core.arguments import path_of, paths_of
from forestgen.core.progress import Progress
from forestgen.dataset.files import FileSet, check_writable
from forestgen.geometry.export import model_files, png
from forestgen.geometry.mesh import Mesh
from forestgen.plants.build import check_sways, sway
from forestgen.plants.exemplar import Exemplar
from forestgen.plants.plan import PlantPlan
from forestgen.render.studio import PictureSettings, camera_of
from forestgen.runs.single_plant import (
    PICTURE,
    Order,
    SinglePlant,
    check_formats,
    check_numbers,
    default_outputs,
    described,
    grow,
    grow_plants,
    mesh_model,
    name_of,
    picture_of,
    plan_of,
    radius_of_m,
)

_REPR_SAMPLES = 16


def plant(
    species: str | os.PathLike[str], height_m: float | None = None, *, seed: int = 0, detail: int | None = None
) -> Plant:
    """Grow one plant.

    Parameters
    ----------
    species : a shipped species' name (see `forestgen.species`), or the path of a species file.
    height_m : by default that of a mature plant.
    seed : another seed is another plant.
    detail : how finely leaves and flowers are drawn, 0 to 2; by default as the species' file says.

    Raises
    ------
    RecipeError, AssetError : there is no such species, or it has no plant of that height.
    """
    source = str(path_of(species, "species"))
    check_numbers(Order(source, (), height_m, seed, detail=detail))
    plan, name = plan_of(source, seed, detail), name_of(source)
    radius_m = radius_of_m(plan.drawn.species[name], height_m)
    return Plant(plan, grow(plan, name, radius_m, seed), seed)


def grow_files(
    species: str | os.PathLike[str],
    out: Sequence[str | os.PathLike[str]] | None = None,
    *,
    height_m: float | None = None,
    seed: int = 0,
    count: int = 1,
    frames: int | None = None,
    frames_per_s: float = 12.0,
    detail: int | None = None,
    wood_triangles: int | None = None,
    size_px: tuple[int, int] = (540, 720),
    samples: int = 32,
    distance_m: float | None = None,
    look_at_m: float | None = None,
    overwrite: bool = False,
    progress: bool | Progress | None = None,
) -> list[SinglePlant]:
    """Grow plants and write their files, all or none: what `plant`, `Plant.export` and `Plant.sway` do one by one.

    Parameters
    ----------
    out : meshes and pictures; of several plants tree.glb becomes tree-0001.glb, ... By default outputs/SPECIES.glb
        and .png.
    count : plants, of seeds from `seed` on.
    frames, frames_per_s : poses of one plant in the wind instead; see `Plant.sway`.
    size_px, samples, distance_m, look_at_m : of pictures, see `Plant.picture`.

    Raises
    ------
    RecipeError, AssetError, OutputError
    """
    source = str(path_of(species, "species"))
    outputs = tuple(paths_of(() if out is None else out, "out", output=True)) or default_outputs(source)
    order = Order(
        source,
        outputs,
        height_m,
        seed,
        count,
        frames,
        frames_per_s,
        detail,
        wood_triangles,
        PictureSettings(size_px, samples, distance_m, look_at_m).check(),
        overwrite,
    )
    display = display_of(progress)
    with display.running():
        return grow_plants(order, display)


class Plant:
    """One plant: origin at the foot of the stem, z up, metres."""

    def __init__(self, plan: PlantPlan, exemplar: Exemplar, seed: int) -> None:
        self._plan, self._exemplar, self.seed = plan, exemplar, seed

    @property
    def species(self) -> str:
        return self._exemplar.species

    @cached_property
    def measures(self) -> SinglePlant:
        """Height, crown width, leaf area, dry masses, triangles by part."""
        return described(self._exemplar, self._plan.drawn.species[self.species], self.seed, {})

    @property
    def height_m(self) -> float:
        return self.measures.height_m

    @property
    def crown_width_m(self) -> float:
        return self.measures.crown_width_m

    @property
    def leaf_area_m2(self) -> float:
        """One side of all blades."""
        return self.measures.leaf_area_m2

    @cached_property
    def meshes(self) -> Mapping[str, Mesh]:
        """Part and material, such as ``leaf-leaf`` -> its triangles: vertices_m, faces, normals, uv."""
        return {piece.name: piece.mesh for piece in mesh_model(self._plan, self._exemplar, self.seed).pieces}

    @property
    def vertices(self) -> NDArray[np.float32]:
        """(V, 3) metres, of all meshes one after another."""
        return np.concatenate([mesh.vertices_m for mesh in self.meshes.values()])

    @property
    def faces(self) -> NDArray[np.int64]:
        """(F, 3) indices into `vertices`."""
        first = np.cumsum([0, *(len(mesh.vertices_m) for mesh in self.meshes.values())])
        return np.concatenate(
            [mesh.faces.astype(np.int64) + start for mesh, start in zip(self.meshes.values(), first, strict=False)]
        )

    def export(
        self, path: str | os.PathLike[str], *, wood_triangles: int | None = None, overwrite: bool = False
    ) -> Path:
        """Write a mesh (.glb, .ply, .obj, .usd, .usda, .usdc, .usdz, or a registered format), or a picture (.png).

        Parameters
        ----------
        wood_triangles : wood of about so many with one baked texture, for real-time programs.
        overwrite : replace an existing file.

        Raises
        ------
        RecipeError : an unknown kind of file.
        OutputError : the file exists, or cannot be written.
        """
        target = path_of(path, "path", output=True)
        check_formats([target])
        check_numbers(Order(self.species, (target,), wood_triangles=wood_triangles))
        check_writable([target], overwrite=overwrite)
        if target.suffix.lower() == PICTURE:
            files = {target.name: png(self.picture())}
        else:
            files = model_files(mesh_model(self._plan, self._exemplar, self.seed, wood_triangles), target.name)
        with FileSet(overwrite=overwrite) as written:
            for name, content in files.items():
                written.write(target.with_name(name), content)
        return target

    def picture(
        self,
        size_px: tuple[int, int] = (540, 720),
        *,
        samples: int = 32,
        distance_m: float | None = None,
        look_at_m: float | None = None,
        progress: bool | Progress | None = False,
    ) -> NDArray[np.uint8]:
        """(H, W, 3) sRGB picture under a fixed sun and sky.

        Parameters
        ----------
        size_px : width, height.
        samples : light paths a pixel.
        distance_m : from the camera to the plant; by default as far as a normal lens asks for.
        look_at_m : look at this height through a normal lens, not at the whole plant.
        """
        settings = PictureSettings(size_px, samples, distance_m, look_at_m).check()
        display = display_of(progress)
        with display.running():
            return picture_of(
                self._plan, self._exemplar, camera_of(self._exemplar, settings), settings.samples, self.seed, display
            )

    def sway(self, frames: int, frames_per_s: float = 12.0) -> list[Plant]:
        """The plant's poses in the wind, of a species whose generator is strands.

        Raises
        ------
        RecipeError : plants of this species do not move.
        """
        check_numbers(Order(self.species, (), frames=frames, frames_per_s=frames_per_s))
        parameters = self._plan.generators[self.species]
        check_sways(self.species, parameters)
        posed = sway(self._plan, self.species, self._exemplar.radius_m, self.seed, frames, frames_per_s)
        return [Plant(self._plan, one, self.seed) for one in posed]

    def _repr_png_(self) -> bytes:
        return png(self.picture((360, 480), samples=_REPR_SAMPLES))

    def __repr__(self) -> str:
        one = self.measures
        return (
            f"<Plant {one.species}: {one.height_m:.2f} m tall, crown {one.crown_width_m:.2f} m wide, "
            f"{sum(one.triangles.values()):,} triangles>"
        )
