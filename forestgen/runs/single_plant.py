"""Plants on their own: meshes, pictures, numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from forestgen.core.arguments import number_of, whole_of
from forestgen.core.errors import RecipeError
from forestgen.core.parts import Part
from forestgen.core.progress import Progress
from forestgen.dataset.files import FileSet, check_writable
from forestgen.dataset.tonemap import tone_map
from forestgen.geometry.export import Model, Piece, Surface, Value, exporter_of, mesh_suffixes, model_files, png
from forestgen.geometry.mesh import surface_area_m2
from forestgen.geometry.simplify import with_light_wood
from forestgen.plants.bark.texture import texture_images
from forestgen.plants.build import check_sways, size_m, sway
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.plants.growing import ExemplarRequest, grow_exemplar
from forestgen.plants.parameters import with_detail
from forestgen.plants.plan import PlantPlan, plan_plants
from forestgen.recipe.assets import SUFFIXES, find_asset
from forestgen.recipe.load import DrawnRecipe, load_recipe_data
from forestgen.recipe.species import TALLEST_M, Species
from forestgen.render.studio import EXPOSURE, PictureSettings, camera_of, photograph
from forestgen.scene.spec import Camera, Material
from forestgen.scene.surfaces import materials_of

PICTURE = ".png"
_MOST_FILES = 9999  # names have four digits
_MOST_SEEDS = 2**63  # mesh files hold them as signed integers
_SHORTEST_M = 0.02
_FEWEST_TRIANGLES = 100  # of wood
_TALLEST = 2.0  # of a mature plant's height


@dataclass(frozen=True)
class Order:
    """What to grow, and where it goes."""

    species: str  # a shipped name, or a file
    outputs: tuple[Path, ...]  # each file's suffix is its format
    height_m: float | None = None  # None: a mature plant's
    seed: int = 0
    count: int = 1  # more than one: of seeds seed, seed + 1, ..., files numbered from 0001
    frames: int | None = None  # so many poses of one plant in the wind, files numbered from 0001
    frames_per_s: float = 12.0
    detail: int | None = None  # of organs, 0 to 2; None: as the species' file says
    wood_triangles: int | None = None  # about so many in mesh files, with one baked texture; None: as grown
    picture: PictureSettings = field(default_factory=PictureSettings)
    overwrite: bool = False

    @property
    def name(self) -> str:
        """The species' name; a file's, with what a name may not hold replaced."""
        return name_of(self.species)

    def paths(self, number: int) -> list[Path]:
        """Files of one plant or frame; of several, the first tree.glb is tree-0001.glb."""
        if self.count == 1 and self.frames is None:
            return list(self.outputs)
        return [path.with_name(f"{path.stem}-{number:04d}{path.suffix}") for path in self.outputs]


@dataclass(frozen=True)
class SinglePlant:
    """What was made."""

    species: str
    seed: int
    height_m: float
    crown_width_m: float
    triangles: dict[str, int]  # by part
    leaf_area_m2: float  # one side
    leaf_area_index: float  # leaf area over the crown's projection, pi/4 width^2
    wood_kg: float  # dry
    leaf_kg: float  # dry
    files: dict[Path, int]  # size in bytes


def grow_plants(order: Order, progress: Progress) -> list[SinglePlant]:
    """Grow plants of a species and write what was ordered: all files, or none.

    Raises
    ------
    RecipeError, AssetError : unknown species, a height that is none, an unknown format, a view of nothing.
    OutputError : a file exists and may not be replaced, or cannot be written.
    """
    _check(order)
    plan = plan_of(order.species, order.seed, order.detail)
    if order.frames is not None:
        check_sways(order.name, plan.generators[order.name])
    species = plan.drawn.species[order.name]
    radius_m, made, camera = radius_of_m(species, order.height_m), [], None
    with FileSet(overwrite=order.overwrite) as files:
        for number, (seed, exemplar) in enumerate(_grown(order, plan, radius_m, progress), start=1):
            if camera is None or order.frames is None:  # frames are all seen from one place
                camera = camera_of(exemplar, order.picture)
            sizes = {}
            for path, content in _contents(order, number, plan, seed, exemplar, camera, progress):
                files.write(path, content)
                sizes[path] = len(content)
            made.append(described(exemplar, species, seed, sizes))
    return made


def _check(order: Order) -> None:
    """What can be known to be wrong before anything grows."""
    check_numbers(order)
    check_formats(order.outputs)
    for number in range(1, (order.frames or order.count) + 1):
        paths = order.paths(number)
        meshes = [path for path in paths if path.suffix.lower() != PICTURE]
        beside = [path.with_name(name) for path in meshes for name in exporter_of(path.name).companions(path.name)]
        check_writable([*paths, *beside], overwrite=order.overwrite)


def check_numbers(order: Order) -> None:
    """Raise `RecipeError` for numbers, a pace or a seed that are none."""
    for option, number in (("count", order.count), ("frames", order.frames)):
        if number is not None:
            whole_of(number, option, 1, _MOST_FILES)
    if order.frames is not None and order.count > 1:
        raise RecipeError("frames are of one plant", parameter="frames", expected="`count` or `frames`, not both")
    if not 0 < number_of(order.frames_per_s, "frames_per_s") <= 1000:
        got = f"{order.frames_per_s:g}"
        raise RecipeError("no such pace", parameter="frames_per_s", expected="above 0, at most 1000", got=got)
    if whole_of(order.seed, "seed", 0, _MOST_SEEDS) + order.count > _MOST_SEEDS:
        expected = f"less than {_MOST_SEEDS - order.count + 1}"
        raise RecipeError("no such seed", parameter="seed", expected=expected, got=str(order.seed))
    if order.detail is not None:
        whole_of(order.detail, "detail", 0, 2)
    if order.height_m is not None:
        number_of(order.height_m, "height_m")
    if order.wood_triangles is not None:
        whole_of(order.wood_triangles, "wood_triangles", _FEWEST_TRIANGLES, 10**9)


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


def name_of(species: str) -> str:
    """Name of a shipped species or of a species file: ``my oak.yaml`` is my-oak."""
    return re.sub(r"[^A-Za-z0-9_-]", "-", Path(species).stem).lstrip("-_")[:64] or "plant"


def default_outputs(species: str) -> tuple[Path, ...]:
    """outputs/SPECIES.glb and .png."""
    return tuple(Path("outputs") / f"{name_of(species)}{suffix}" for suffix in (".glb", PICTURE))


def drawn_of(species: str, seed: int) -> DrawnRecipe:
    """A recipe that has this species alone; the generator's own keys are not yet checked."""
    path = Path(species)
    is_file = path.suffix in SUFFIXES["species"]
    source = f"./{path.name}" if is_file else species  # a file of the user's own may lie anywhere
    if not is_file:
        find_asset("species", species, parameter="species")
    alone = {"species": {name_of(species): {"from": source}}, "community": {"model": "none"}}
    folder = path.parent if is_file else Path()
    return load_recipe_data({"forestgen": 1, "seed": seed, **alone}, "forestgen plant", folder).draw(0)


def plan_of(species: str, seed: int, detail: int | None = None) -> PlantPlan:
    """PlantPlan of `drawn_of`, its organs at a level of detail."""
    plan = plan_plants(drawn_of(species, seed))
    if detail is None:
        return plan
    finer = {name: with_detail(one, detail) for name, one in plan.generators.items()}
    return replace(plan, generators=finer)


def grow(plan: PlantPlan, name: str, radius_m: float, seed: int) -> Exemplar:
    """The plant of a species, a radius and a seed."""
    species, parameters = plan.drawn.species[name], plan.generators[name]
    return grow_exemplar(ExemplarRequest(name, species, parameters, radius_m, seed, ("exemplar", name)))


def _grown(order: Order, plan: PlantPlan, radius_m: float, progress: Progress) -> Iterator[tuple[int, Exemplar]]:
    """Seed and plant."""
    if order.frames is not None:
        with progress.stage("frames", order.frames) as advance:
            for exemplar in sway(plan, order.name, radius_m, order.seed, order.frames, order.frames_per_s):
                yield order.seed, exemplar
                advance(1)
        return
    with progress.stage("plants", order.count) as advance:
        for seed in range(order.seed, order.seed + order.count):
            yield seed, grow(plan, order.name, radius_m, seed)
            advance(1)


def radius_of_m(species: Species, height_m: float | None) -> float:
    """Community radius of a plant of that height: the allometry's inverse."""
    mature_m = species.ecology.max_radius_m
    if height_m is None:
        return mature_m
    tallest_m = min(_TALLEST * species.mature_height_m, TALLEST_M)  # a slip of the pen makes gigabytes of leaves
    if not (math.isfinite(height_m) and _SHORTEST_M <= height_m <= tallest_m):
        expected = f"{_SHORTEST_M:g} to {tallest_m:.3g} m; a mature plant has {species.mature_height_m:.3g} m"
        raise RecipeError("no such plant", parameter="height_m", expected=expected, got=f"{height_m:g}")
    law = species.allometry.height_m
    if law.exponent:
        return law.inverse(height_m)
    if not math.isclose(height_m, law.scale, rel_tol=0.01):
        raise RecipeError(
            "plants of this species are all of one height",
            parameter="height_m",
            expected=f"{law.scale:g} m",
            got=f"{height_m:g} m",
            hint="leave `height_m` out",
        )
    return mature_m


def mature_size_m(species: Species) -> tuple[float, float]:
    """Height and crown width of a mature plant by its allometry."""
    return size_m(species, species.ecology.max_radius_m)


def _contents(
    order: Order, number: int, plan: PlantPlan, seed: int, exemplar: Exemplar, camera: Camera, progress: Progress
) -> Iterator[tuple[Path, bytes]]:
    """One plant's files."""
    model = None
    for path in order.paths(number):
        if path.suffix.lower() == PICTURE:
            yield path, png(picture_of(plan, exemplar, camera, order.picture.samples, seed, progress))
            continue
        if model is None:
            model = mesh_model(plan, exemplar, seed, order.wood_triangles)
        for name, content in model_files(model, path.name).items():
            yield path.with_name(name), content


def picture_of(
    plan: PlantPlan, exemplar: Exemplar, camera: Camera, samples: int, seed: int, progress: Progress
) -> NDArray[np.uint8]:
    """(H, W, 3) sRGB picture of a plant in the studio."""
    materials = materials_of(plan.drawn.species, plan.drawn.recipe.plants.season)
    radiance = photograph(exemplar, materials, camera, plan.drawn.recipe, samples, seed, progress)
    return tone_map(radiance, EXPOSURE)


def mesh_model(plan: PlantPlan, exemplar: Exemplar, seed: int, wood_triangles: int | None = None) -> Model:
    """A plant for mesh files, its wood of about `wood_triangles` with one baked texture, or as grown."""
    materials = materials_of(plan.drawn.species, plan.drawn.recipe.plants.season)
    name = exemplar.species
    model = model_of(exemplar, plan.drawn.species[name], materials, seed)
    if wood_triangles is None:
        return model
    textures = {key: one.texture.colour for (owner, key), one in materials.items() if owner == name and one.texture}
    return replace(model, pieces=with_light_wood(model.pieces, textures, wood_triangles))


def model_of(exemplar: Exemplar, species: Species, materials: Mapping[tuple[str, str], Material], seed: int) -> Model:
    """A plant for mesh files."""
    pieces = []
    for organ in exemplar.organs:
        surface = _surface(organ, materials[exemplar.species, organ.material])
        area: dict[str, Value] = {"area_m2": surface_area_m2(organ.mesh)}
        pieces.append(Piece(f"{organ.part.name.lower()}-{organ.material}", organ.part, organ.mesh, surface, area))
    measures = asdict(described(exemplar, species, seed, {}))
    del measures["triangles"], measures["files"]
    properties = {"species": exemplar.species, "description": species.description, **measures}
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


def described(exemplar: Exemplar, species: Species, seed: int, files: dict[Path, int]) -> SinglePlant:
    """A plant's numbers."""
    triangles: dict[str, int] = {}
    for organ in exemplar.organs:
        part = organ.part.name.lower().replace("_", " ")
        triangles[part] = triangles.get(part, 0) + organ.mesh.triangles
    crown_m2 = math.pi / 4 * exemplar.crown_width_m**2
    return SinglePlant(
        species=exemplar.species,
        seed=seed,
        height_m=exemplar.height_m,
        crown_width_m=exemplar.crown_width_m,
        triangles=triangles,
        leaf_area_m2=exemplar.leaf_area_m2,
        leaf_area_index=exemplar.leaf_area_m2 / crown_m2 if crown_m2 else 0.0,
        wood_kg=species.tissue.wood_density_kg_per_m3 * exemplar.wood_volume_m3,
        leaf_kg=species.tissue.leaf_mass_per_area_kg_per_m2 * exemplar.leaf_area_m2,
        files=files,
    )
