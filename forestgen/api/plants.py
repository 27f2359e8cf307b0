"""Single plants: `plant` grows one; the object has its mesh, measures and picture, and writes mesh files."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from forestgen.api.display import display_of
from forestgen.api.plant_requests import name_of, plan_of, request_of
from forestgen.core.arguments import PathLike, number_of, path_of, paths_of, whole_of
from forestgen.core.errors import RecipeError
from forestgen.core.frames import BREAST_HEIGHT_M
from forestgen.core.parts import Part
from forestgen.core.progress import Progress, Silent
from forestgen.dataset.files import FileSet, check_writable
from forestgen.dataset.tonemap import tone_map
from forestgen.geometry.export import Model, Piece, Surface, Value, exporter_of, mesh_suffixes, png
from forestgen.geometry.mesh import Mesh, surface_area_m2
from forestgen.geometry.simplify import with_light_wood
from forestgen.plants.bark.texture import texture_images
from forestgen.plants.build import check_sways, sway
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.plants.growing import ExemplarRequest, grow_exemplar
from forestgen.plants.plan import PlantPlan
from forestgen.recipe.species import Species
from forestgen.recipe.tree_sizes import Grown
from forestgen.render.studio import EXPOSURE, PictureSettings, camera_of, photograph
from forestgen.scene.plant_measures import leaf_base_m, stem_diameter_m
from forestgen.scene.spec import Camera, Material
from forestgen.scene.surfaces import materials_of

PICTURE = ".png"
_MOST_FILES = 9999  # names have four digits
_MOST_SEEDS = 2**63  # mesh files hold them as signed integers
_SHORTEST_M = 0.02
_FEWEST_TRIANGLES = 100  # of wood
_TALLEST = 2.0  # of a mature plant's height
_REPR_SAMPLES = 16


@dataclass(frozen=True)
class SinglePlant:
    """What was made."""

    species: str
    seed: int
    height_m: float
    crown_width_m: float
    dbh_m: float | None  # diameter at breast height; None: no trunk there
    crown_base_m: float | None  # below which few leaves are; None: no leaves
    triangles: dict[str, int]  # by part
    leaf_area_m2: float  # one side
    leaf_area_index: float  # leaf area over the crown's projection, pi/4 width^2
    wood_kg: float  # dry
    leaf_kg: float  # dry
    files: dict[Path, int] = field(default_factory=dict)  # size in bytes


def plant(
    species: PathLike,
    height_m: float | None = None,
    *,
    grown: Grown = "stand",
    seed: int = 0,
    detail: int | None = None,
) -> Plant:
    """Grow one plant.

    Parameters
    ----------
    species : a shipped species' name (see `forestgen.species`), or the path of a species file.
    height_m : by default that of a mature plant.
    grown : how a tree grew: in a closed "stand", without neighbours ("open"), or overgrown by others ("suppressed").
    seed : another seed is another plant; trees of one height differ in diameter, crown and leaves, as in a stand.
    detail : how finely leaves and flowers are drawn, 0 to 2; by default as the species' file says.

    Raises
    ------
    RecipeError, AssetError : there is no such species, or it has no plant of that height.
    """
    source = str(path_of(species, "species"))
    check_numbers(height_m=height_m, seed=seed, detail=detail)
    plan, name = plan_of(source, seed, detail), name_of(source)
    request = request_of(plan, name, height_m, seed, grown)
    return Plant(plan, grow_exemplar(request), request)


def grow_files(
    species: PathLike,
    out: Sequence[PathLike] | None = None,
    *,
    height_m: float | None = None,
    grown: Grown = "stand",
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
    settings = PictureSettings(size_px, samples, distance_m, look_at_m).check()
    source = str(path_of(species, "species"))
    outputs = paths_of(() if out is None else out, "out", output=True) or default_outputs(source)
    check_numbers(count, frames, frames_per_s, seed, detail, height_m, wood_triangles)
    check_formats(outputs)
    names = list(numbered(outputs, count if frames is None else frames, several=count > 1 or frames is not None))
    for paths in names:
        meshes = [path for path in paths if path.suffix.lower() != PICTURE]
        beside = [path.with_name(name) for path in meshes for name in exporter_of(path.name).companions(path.name)]
        check_writable([*paths, *beside], overwrite=overwrite)
    made: list[SinglePlant] = []
    plan, display, camera = plan_of(source, seed, detail), display_of(progress), None
    title = "plants" if frames is None else "frames"
    with display.running(), FileSet(overwrite=overwrite) as files, display.stage(title, len(names)) as advance:
        plants = _grown(plan, height_m, grown, range(seed, seed + count), frames, frames_per_s)
        for one, paths in zip(plants, names, strict=True):
            if camera is None or frames is None:  # frames are all seen from one place
                camera = camera_of(one._exemplar, settings)
            contents = dict(one._contents(paths, wood_triangles, camera, settings.samples, display))
            for path, content in contents.items():
                files.write(path, content)
            made.append(replace(one.measures, files={path: len(content) for path, content in contents.items()}))
            advance(1)
    return made


def numbered(outputs: Sequence[Path], count: int, *, several: bool) -> Iterator[list[Path]]:
    """Files of each plant or frame; where there are several, the first tree.glb is tree-0001.glb."""
    for number in range(1, count + 1):
        yield [path.with_name(f"{path.stem}-{number:04d}{path.suffix}") if several else path for path in outputs]


def _grown(
    plan: PlantPlan, height_m: float | None, grown: Grown, seeds: range, frames: int | None, frames_per_s: float
) -> Iterator[Plant]:
    """A plant of each seed, or poses of the first one."""
    (name,) = plan.drawn.species
    if frames is not None:
        check_sways(name, plan.generators[name])
    requests = [request_of(plan, name, height_m, seed, grown) for seed in seeds]
    if frames is None:
        yield from (Plant(plan, grow_exemplar(one), one) for one in requests)
        return
    for exemplar in _poses(plan, requests[0], frames, frames_per_s):
        yield Plant(plan, exemplar, requests[0])


def _poses(plan: PlantPlan, of: ExemplarRequest, frames: int, frames_per_s: float) -> Iterator[Exemplar]:
    return sway(plan, of.species_name, of.radius_m, of.seed, frames, frames_per_s, of.tree)


class Plant:
    """One plant: origin at the foot of the stem, z up, metres."""

    def __init__(self, plan: PlantPlan, exemplar: Exemplar, request: ExemplarRequest) -> None:
        self._plan, self._exemplar, self._request, self.seed = plan, exemplar, request, request.seed

    @property
    def species(self) -> str:
        return self._exemplar.species

    @cached_property
    def measures(self) -> SinglePlant:
        """Height, crown width, leaf area, dry masses, triangles by part."""
        return described(self._exemplar, self._plan.drawn.species[self.species], self.seed)

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
        return {piece.name: piece.mesh for piece in self._model().pieces}

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

    def export(self, path: PathLike, *, wood_triangles: int | None = None, overwrite: bool = False) -> Path:
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
        check_numbers(wood_triangles=wood_triangles)
        check_writable([target], overwrite=overwrite)
        camera, samples = camera_of(self._exemplar, PictureSettings()), PictureSettings.samples
        with FileSet(overwrite=overwrite) as written:
            for name, content in self._contents([target], wood_triangles, camera, samples, Silent()):
                written.write(name, content)
        return target

    def _contents(
        self, paths: Sequence[Path], wood_triangles: int | None, camera: Camera, samples: int, progress: Progress
    ) -> Iterator[tuple[Path, bytes]]:
        """Files of meshes and pictures, with those beside them."""
        model = None
        for path in paths:
            if path.suffix.lower() == PICTURE:
                yield path, png(self._photograph(camera, samples, progress))
                continue
            if model is None:
                model = self._model(wood_triangles)
            for name, content in exporter_of(path.name).files(model, path.name).items():
                yield path.with_name(name), content

    def picture(
        self,
        size_px: tuple[int, int] = (540, 720),
        *,
        samples: int = 32,
        distance_m: float | None = None,
        look_at_m: float | None = None,
        progress: bool | Progress | None = None,
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
        camera, display = camera_of(self._exemplar, settings), display_of(progress)
        with display.running():
            return self._photograph(camera, settings.samples, display)

    def sway(self, frames: int, frames_per_s: float = 12.0) -> list[Plant]:
        """The plant's poses in the wind; `RecipeError` unless its species' generator is strands."""
        check_numbers(frames=frames, frames_per_s=frames_per_s)
        check_sways(self.species, self._plan.generators[self.species])
        return [
            Plant(self._plan, one, self._request) for one in _poses(self._plan, self._request, frames, frames_per_s)
        ]

    def _model(self, wood_triangles: int | None = None) -> Model:
        """For mesh files, with wood of about `wood_triangles` and one baked texture, or as grown."""
        name, materials = self.species, self._materials
        model = model_of(self._exemplar, self._plan.drawn.species[name], materials, self.seed)
        if wood_triangles is None:
            return model
        textures = {key: one.texture.colour for (owner, key), one in materials.items() if owner == name and one.texture}
        return replace(model, pieces=with_light_wood(model.pieces, textures, wood_triangles))

    def _photograph(self, camera: Camera, samples: int, progress: Progress) -> NDArray[np.uint8]:
        """(H, W, 3) sRGB picture in the studio."""
        recipe = self._plan.drawn.recipe
        radiance = photograph(self._exemplar, self._materials, camera, recipe, samples, self.seed, progress)
        return tone_map(radiance, EXPOSURE)

    @property
    def _materials(self) -> dict[tuple[str, str], Material]:
        return materials_of(self._plan.drawn.species)

    def _repr_png_(self) -> bytes:
        return png(self.picture((360, 480), samples=_REPR_SAMPLES, progress=False))

    def __repr__(self) -> str:
        one = self.measures
        return (
            f"<Plant {one.species}: {one.height_m:.2f} m tall, crown {one.crown_width_m:.2f} m wide, "
            f"{sum(one.triangles.values()):,} triangles>"
        )


def check_numbers(
    count: int = 1,
    frames: int | None = None,
    frames_per_s: float = 12.0,
    seed: int = 0,
    detail: int | None = None,
    height_m: float | None = None,
    wood_triangles: int | None = None,
) -> None:
    """Raise `RecipeError` for numbers, a pace or a seed that are none."""
    whole_of(count, "count", 1, _MOST_FILES)
    if frames is not None:
        whole_of(frames, "frames", 1, _MOST_FILES)
        if count > 1:
            raise RecipeError("frames are of one plant", parameter="frames", expected="`count` or `frames`, not both")
    if not 0 < number_of(frames_per_s, "frames_per_s") <= 1000:
        got = f"{frames_per_s:g}"
        raise RecipeError("no such pace", parameter="frames_per_s", expected="above 0, at most 1000", got=got)
    if whole_of(seed, "seed", 0, _MOST_SEEDS) + count > _MOST_SEEDS:
        expected = f"less than {_MOST_SEEDS - count + 1}"
        raise RecipeError("no such seed", parameter="seed", expected=expected, got=str(seed))
    if detail is not None:
        whole_of(detail, "detail", 0, 2)
    if height_m is not None:
        number_of(height_m, "height_m")
    if wood_triangles is not None:
        whole_of(wood_triangles, "wood_triangles", _FEWEST_TRIANGLES, 10**9)


def check_formats(outputs: Sequence[Path]) -> None:
    """Raise `RecipeError` for files of an unknown kind, and for one that is named twice."""
    wanted = (*mesh_suffixes(), PICTURE)
    for path in outputs:
        if path.suffix.lower() not in wanted:
            expected = ", ".join(wanted[:-1]) + f" or {wanted[-1]}"
            raise RecipeError("unknown format", parameter="out", expected=expected, got=f"{str(path)!r:.200}")
    if len(set(outputs)) < len(outputs):
        twice = next(path for path in outputs if list(outputs).count(path) > 1)
        raise RecipeError("the same file twice", parameter="out", got=str(twice))


def default_outputs(species: str) -> tuple[Path, ...]:
    """outputs/SPECIES.glb and .png."""
    return tuple(Path("outputs") / f"{name_of(species)}{suffix}" for suffix in (".glb", PICTURE))


def model_of(exemplar: Exemplar, species: Species, materials: Mapping[tuple[str, str], Material], seed: int) -> Model:
    """A plant for mesh files."""
    pieces = []
    for organ in exemplar.organs:
        surface = _surface(organ, materials[exemplar.species, organ.material])
        area: dict[str, Value] = {"area_m2": surface_area_m2(organ.mesh)}
        pieces.append(Piece(f"{organ.part.name.lower()}-{organ.material}", organ.part, organ.mesh, surface, area))
    measures = asdict(described(exemplar, species, seed))
    del measures["triangles"], measures["files"]
    known = {name: value for name, value in measures.items() if value is not None}
    properties = {"species": exemplar.species, "description": species.description, **known}
    return Model(exemplar.species, pieces, properties)


def _surface(organ: OrganMesh, material: Material) -> Surface:
    """A material as mesh files know it; its texture needs a mesh with uv."""
    sheet = organ.part in (Part.LEAF, Part.FLOWER)
    look = (material.reflectance, material.transmittance, material.roughness, sheet)
    if material.texture is None:
        return Surface(organ.material, *look)
    if organ.mesh.uv is None:
        return Surface(f"{organ.material}-plain", *look)
    return Surface(organ.material, *look, *texture_images(material.texture))


def described(exemplar: Exemplar, species: Species, seed: int) -> SinglePlant:
    """A plant's numbers."""
    triangles: dict[str, int] = {}
    for organ in exemplar.organs:
        part = organ.part.name.lower().replace("_", " ")
        triangles[part] = triangles.get(part, 0) + organ.mesh.triangles
    crown_m2 = math.pi / 4 * exemplar.crown_width_m**2
    dbh_m, base_m = float(stem_diameter_m(exemplar, np.array([BREAST_HEIGHT_M]))[0]), leaf_base_m(exemplar)
    return SinglePlant(
        species=exemplar.species,
        seed=seed,
        height_m=exemplar.height_m,
        crown_width_m=exemplar.crown_width_m,
        dbh_m=None if math.isnan(dbh_m) else dbh_m,
        crown_base_m=None if math.isnan(base_m) else base_m,
        triangles=triangles,
        leaf_area_m2=exemplar.leaf_area_m2,
        leaf_area_index=exemplar.leaf_area_m2 / crown_m2 if crown_m2 else 0.0,
        wood_kg=species.tissue.wood_density_kg_per_m3 * exemplar.wood_volume_m3,
        leaf_kg=species.tissue.leaf_mass_per_area_kg_per_m2 * exemplar.leaf_area_m2,
    )
