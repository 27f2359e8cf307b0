"""The stages, one after another.

recipe -> community -> plants -> scene -> render -> labels -> dataset
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from forestgen.community.model import Site
from forestgen.community.population import Population, Status
from forestgen.community.statistics import count_by_species, stems_by_species
from forestgen.core.progress import Progress
from forestgen.core.timing import Timings
from forestgen.dataset.folder import OutputFolder
from forestgen.dataset.frame_row import frame_row
from forestgen.dataset.manifest import build_manifest, write_manifest
from forestgen.dataset.maps import write_maps
from forestgen.dataset.settings import DatasetSettings
from forestgen.dataset.writer import frame_bytes, frame_folder_name, write_dataset, write_frame
from forestgen.labels.labelled import LabelledFrame, label_frame
from forestgen.recipe.hashing import recipe_hash
from forestgen.recipe.load import LoadedRecipe, dump_yaml
from forestgen.render.frame import Frame
from forestgen.render.identity import SceneTracer
from forestgen.render.variant import mitsuba
from forestgen.scene.exemplars import SizeError
from forestgen.scene.plant_measures import PlantMeter
from forestgen.stages.community import final_population, snapshots
from forestgen.stages.data_set import check_one_data_set, class_map, data_set_of
from forestgen.stages.frames import haze_notes, noise_notes, render_frame
from forestgen.stages.plan import Plan, check_memory, check_plan, make_plan, views_below_ground, why_barren
from forestgen.stages.scene import BuiltScene, build_scene
from forestgen.stages.views import ground_below

_GUESSED_PLANTS = 5000  # a frame's rows at most, for the disk space to ask for
_MOST_CHANNELS = 13  # of a sensor, at a guess
_PIXELS_A_PLANT = 40  # and no more than one in so many


@dataclass(frozen=True)
class Stems:
    """How many plants of a species live, and how many of them a forester counts."""

    species: str
    plants: int  # that live
    stems: int  # of these, over `BREAST_HEIGHT_M`
    per_ha: float  # stems


@dataclass
class RunSummary:
    """What a run made, for people."""

    folder: Path
    frames: int = 0
    plants: int = 0
    standing_dead: int = 0  # of the plants
    visible_plants: int = 0  # in any frame of the last image
    relative_errors: list[float] = field(default_factory=list)  # of the frames' radiance, render/noise.py
    size_errors: list[SizeError] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
    stems: list[Stems] = field(default_factory=list)  # of a simulation's last step, by species
    images: list[dict[str, Any]] = field(default_factory=list)  # a report of each, for the manifest
    notes: list[str] = field(default_factory=list)
    rows: list[dict[str, Any]] = field(default_factory=list)  # of the frames, for an index: dataset/index.py
    timings_s: dict[str, float] = field(default_factory=dict)
    total_s: float = 0.0


def render(
    loaded: LoadedRecipe,
    target: Path,
    *,
    overwrite: bool = False,
    threads: int | None = None,
    progress: Progress,
    timings: Timings,
) -> RunSummary:
    """Make all images of a recipe and write them, with their labels, into the folder `target`.

    The folder appears when everything in it is complete, or not at all. `threads` limits the renderer's worker
    threads (None: all cores); no result depends on it.
    """
    plan = check_plan(loaded)
    with timings("load Mitsuba"):
        mitsuba(threads)
    summary = RunSummary(target)
    settings = data_set_of(plan.drawn)
    for drawn in loaded.probes():
        check_one_data_set(drawn, settings)
    frames: list[Path] = []
    seeds: list[int] = []
    with OutputFolder(target, overwrite=overwrite, required_bytes=_disk_bytes(loaded, plan)) as folder:
        with progress.stage("images", loaded.images) as advance:
            for index in range(loaded.images):
                plan = make_plan(loaded.draw(index))
                check_memory(plan)
                check_one_data_set(plan.drawn, settings)
                seeds.append(plan.drawn.image_seed)
                frames += render_image(plan, loaded.seed, settings, folder, summary, progress, timings)
                advance(1)
        with timings("write"):
            write_dataset(folder, frames, settings)
        summary.timings_s, summary.total_s = dict(timings.seconds), timings.total()
        write_manifest(folder, _manifest(folder, loaded, seeds, summary))
    return summary


def render_image(
    plan: Plan,
    root_seed: int,
    settings: DatasetSettings,
    folder: Path,
    summary: RunSummary,
    progress: Progress,
    timings: Timings,
    room_bytes: int | None = None,
) -> list[Path]:
    """One drawn recipe: its community, its scene, and a frame of each camera, each in a folder of its own.

    Parameters
    ----------
    root_seed : of the recipe that the image was drawn from, for the frames' headers.
    folder : that the frames' folders, and ``maps/`` beside them, are made in.
    summary : takes the image's counts, notes, report and rows.
    room_bytes : memory that the image may take; None: what is free now.

    Returns
    -------
    list : the frames' folders.
    """
    with timings("community"):
        population = final_population(plan, progress)
    check_memory(plan, plants=len(population), room_bytes=room_bytes)
    summary.notes += [f"image {plan.drawn.image_index}: {note}" for note in population.notes]
    built = build_scene(plan, population, progress, timings)
    summary.notes += [note for note in built.notes if note not in summary.notes]
    drawn = plan.drawn
    stored = replace(drawn, data=write_maps(folder, drawn.data, drawn.folder))
    yaml, folders = dump_yaml(stored), []
    seen: set[int] = set()  # plants in view of any camera
    for labelled in _shots(plan, built, progress, timings):
        folders.append(folder / frame_folder_name(drawn.image_index, labelled.frame.camera.name))
        with timings("write"):
            write_frame(folders[-1], labelled, yaml, _header(plan, root_seed, labelled.frame), settings)
        _account(summary, labelled, folders[-1].name, built, plan, seen)
        del labelled  # before the next one is made
    summary.images.append(_image_report(plan, built))
    return folders


def _shots(plan: Plan, built: BuiltScene, progress: Progress, timings: Timings) -> Iterator[LabelledFrame]:
    """The frames of all cameras; what does not change between two of them is set up once."""
    recipe, classes, key = plan.drawn.recipe, class_map(plan.drawn), recipe_hash(plan.drawn.data)
    with timings("measures"):
        meter = PlantMeter(built.spec.exemplars)
    tracer: SceneTracer | None = None
    for camera in built.spec.cameras:
        spec = built.at(camera.time_s)
        if tracer is None or tracer.spec is not spec:
            tracer = None  # one scene at a time in memory
            tracer = SceneTracer(spec, timings)
            with timings("measures"):
                measures = meter.measure(spec.instances)
        following = built.next_view(camera)
        frame = render_frame(tracer, camera, recipe, plan.drawn.image_seed, progress, timings, following, key)
        with timings("labels"):
            labelled = label_frame(frame, built.population, classes, measures, recipe.labels.channels)
        del frame
        yield labelled
        del labelled  # one frame at a time in memory


def _header(plan: Plan, root_seed: int, frame: Frame) -> dict[str, str]:
    """Attributes of frame.exr. They belong to the drawn recipe, so that an image drawn alone has the same bytes."""
    return {
        "recipe_hash": recipe_hash(plan.drawn.data),
        "seed": str(root_seed),
        "image_seed": str(plan.drawn.image_seed),
        "samples": str(frame.radiance.samples),
    }


def _image_report(plan: Plan, built: BuiltScene) -> dict[str, Any]:
    """An image's row in the manifest."""
    return {
        "image": plan.drawn.image_index,
        "seed": plan.drawn.image_seed,
        "view": plan.drawn.recipe.dataset.view,  # of its previews
        "counts": _counts(built.population),
        "triangles": sum(exemplar.triangles for exemplar in built.spec.exemplars),
        "size_errors": [asdict(error) for error in built.size_errors],
    }


def simulate(
    loaded: LoadedRecipe,
    target: Path,
    *,
    map_steps: Sequence[int] = (),
    resume: Path | None = None,
    from_step: int | None = None,
    graphs: Sequence[Path] = (),
    overwrite: bool = False,
    progress: Progress,
    timings: Timings,
) -> RunSummary:
    """Simulate the community of a recipe's first image: history, maps at some steps (by default the last), curves.

    `resume` is a history that the recipe made; the simulation goes on from its snapshot of `from_step`, by default its
    last. `graphs` are files that the branches of its last step's plants are written to.
    """
    from forestgen.stages.graphs import check_graphs, write_graphs
    from forestgen.stages.history import check_map_steps, write_community
    from forestgen.stages.module_checks import ground_plans
    from forestgen.stages.resume import note_of_other_code, snapshot_to_resume

    plan = check_plan(loaded, simulate_only=True)
    start = snapshot_to_resume(plan, resume, from_step) if resume is not None else None
    check_graphs(plan, graphs)
    check_map_steps(plan, map_steps, first=start.step if start is not None else 0)
    summary = RunSummary(target)
    other_code = note_of_other_code(resume) if resume is not None else None
    summary.notes += [other_code] if other_code else []
    with OutputFolder(target, overwrite=overwrite) as folder:
        with timings("community"):
            last = write_community(folder, plan, snapshots(plan, progress, start), map_steps)
        write_graphs(plan, last, graphs)
        plants = ground_plans(plan.model_parameters, plan.drawn.species).left_out_of(last)
        summary.plants, summary.counts, summary.standing_dead = len(plants), _counts(plants), _dead(plants)
        summary.stems = _stems(plants, plan.site)
        summary.notes += last.notes
        if not len(plants):
            summary.notes.append(_empty_site(plan))
        elif only_snags(plants):
            summary.notes.append(f"all plants at step {plan.steps} are standing dead trees: none lives")
        summary.timings_s, summary.total_s = dict(timings.seconds), timings.total()
        write_manifest(folder, _manifest(folder, loaded, [plan.drawn.image_seed], summary))
    return summary


def _disk_bytes(loaded: LoadedRecipe, plan: Plan) -> int:
    recipe = plan.drawn.recipe
    sizes = [
        camera.frames
        * frame_bytes(
            camera.size_px,
            min(_GUESSED_PLANTS, camera.size_px[0] * camera.size_px[1] // _PIXELS_A_PLANT),
            recipe.dataset.formats,
            _MOST_CHANNELS if camera.bands else 3,
        )
        for camera in recipe.cameras
    ]
    return loaded.images * sum(sizes)


def _counts(population: Population) -> dict[str, int]:
    return {name: int((population.species == index).sum()) for index, name in enumerate(population.species_names)}


def _stems(population: Population, site: Site) -> list[Stems]:
    alive, stems = count_by_species(population), stems_by_species(population)
    return [Stems(name, alive[name], number, number / site.area_m2 * 1e4) for name, number in stems.items()]


def _dead(population: Population) -> int:
    return int((population.status == Status.DEAD).sum())


def only_snags(population: Population) -> bool:
    """Whether all that a stand has left are standing dead trees."""
    return 0 < len(population) == _dead(population)


def _empty_site(plan: Plan) -> str:
    return why_barren(plan) or f"no plant lives on the site at step {plan.steps}"


def _account(
    summary: RunSummary, labelled: LabelledFrame, name: str, built: BuiltScene, plan: Plan, seen: set[int]
) -> None:
    summary.frames += 1
    population = built.population
    summary.plants, summary.counts, summary.standing_dead = len(population), _counts(population), _dead(population)
    known = len(summary.notes)
    visible = labelled.views.visible
    seen.update(visible.plant_id[visible.has_box].tolist())
    summary.visible_plants = len(seen)
    summary.relative_errors.append(labelled.frame.radiance.relative_error)
    summary.size_errors = built.size_errors
    if not len(built.population):
        summary.notes.append(f"{name} shows bare ground: {_empty_site(plan)}")
    elif only_snags(built.population):
        summary.notes.append(f"{name} shows no living plant: all are standing dead trees")
    if len(built.population) and not visible.has_box.any():
        below = labelled.frame.camera.name in views_below_ground(plan)
        summary.notes.append(f"{name}: the camera {'stands below the ground' if below else 'sees no plant'}")
    summary.notes += noise_notes(labelled.frame.radiance, name)
    summary.notes += haze_notes(built.spec, labelled.frame.surface, name)
    ground_m = ground_below(plan.drawn, labelled.frame.camera)
    notes = summary.notes[known:]
    summary.rows.append(frame_row(name, labelled, plan.drawn, built.spec.sky, ground_m, notes))


def _manifest(folder: Path, loaded: LoadedRecipe, seeds: list[int], summary: RunSummary) -> dict[str, Any]:
    extra = {
        "images": summary.images,
        "notes": summary.notes,
        "total_s": summary.total_s,
    }
    return build_manifest(
        folder,
        recipe_hash=loaded.hash,
        root_seed=loaded.seed,
        image_seeds=seeds,
        timings_s=summary.timings_s,
        extra=extra,
    )
