"""The stages, one after another: recipe -> community -> plants -> scene -> render -> labels, in memory.

`image_frames` makes the frames of one image, `write_image` writes them into a folder, `simulate` stops after the
community. Runs of many images, which resume and verify them, are in `forestgen.runs`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from forestgen.community.model import Site
from forestgen.community.plan import CommunityPlan
from forestgen.community.population import Population, Status
from forestgen.community.simulation import final_population, snapshots
from forestgen.community.statistics import count_by_species, stems_by_species
from forestgen.community.summary import SimulationSummary, Stems
from forestgen.core.progress import Progress, Timings
from forestgen.dataset.data_set import class_map
from forestgen.dataset.folder import OutputFolder
from forestgen.dataset.formats.format import check_ids
from forestgen.dataset.frame_row import frame_row
from forestgen.dataset.manifest import build_manifest, write_manifest
from forestgen.dataset.maps import write_maps
from forestgen.dataset.settings import DatasetSettings
from forestgen.dataset.writer import frame_folder_name, write_frame
from forestgen.labels.channels.channel import ChannelView, add_channels
from forestgen.labels.labelled import LabelledFrame, label_frame
from forestgen.recipe.load import DrawnRecipe, LoadedRecipe, dump_yaml
from forestgen.recipe.map_files import recipe_hash
from forestgen.render.frame import Frame
from forestgen.render.identity import SceneTracer
from forestgen.render.rendering import haze_notes, noise_notes, render_frame
from forestgen.render.transport import cloud_transport_of
from forestgen.scene.build import BuiltScene, build_scene
from forestgen.scene.plan import Plan, check_memory
from forestgen.scene.planning import check_plan
from forestgen.scene.plant_measures import PlantMeter
from forestgen.scene.views import ground_below, views_below_ground


@dataclass(frozen=True)
class ImageScene:
    """One drawn recipe, simulated and assembled: all that its frames are rendered from."""

    plan: Plan
    root_seed: int  # of the recipe that the image was drawn from
    built: BuiltScene
    notes: tuple[str, ...]  # of the community and the scene, for people

    @property
    def drawn(self) -> DrawnRecipe:
        return self.plan.drawn


@dataclass(frozen=True)
class RenderedFrame:
    """A camera's view of an image, labelled, with what files say of it."""

    name: str  # of its folder, such as 000000-camera0
    labelled: LabelledFrame
    attributes: Mapping[str, str]  # of frame.exr's header
    row: Mapping[str, Any]  # of the index, see `forestgen.dataset.index`
    notes: tuple[str, ...]  # of this frame, for people


@dataclass(frozen=True)
class WrittenImage:
    """What `write_image` wrote, without its arrays."""

    folders: tuple[Path, ...]  # of the frames
    rows: tuple[dict[str, Any], ...]  # of the frames, for an index
    notes: tuple[str, ...]  # for people
    report: dict[str, Any]  # the image's row of the manifest


def assemble_image(
    plan: Plan, root_seed: int, progress: Progress, timings: Timings, memory_budget_bytes: int | None = None
) -> ImageScene:
    """Simulate a drawn recipe's community, grow its plants and assemble its scene.

    Parameters
    ----------
    root_seed : of the recipe that the image was drawn from, for the frames' headers.
    memory_budget_bytes : memory that the image may take; None: what is free now.

    Raises
    ------
    ResourceError : so many plants grew that the scene would need more memory than there is.
    RecipeError : a camera stands in a trunk.
    """
    with timings("community"):
        population = final_population(plan.community, progress)
    check_memory(plan, plants=len(population), memory_budget_bytes=memory_budget_bytes)
    built = build_scene(plan, population, progress, timings)
    clouds = plan.drawn.recipe.render.clouds
    cloud_transport_of(clouds, built.spec, built.spec.cameras, where=plan.drawn.where("render", "clouds"))
    notes = [f"image {plan.drawn.image_index}: {note}" for note in population.notes]
    notes += [note for note in built.notes if note not in notes]
    return ImageScene(plan, root_seed, built, tuple(notes))


def image_frames(image: ImageScene, progress: Progress, timings: Timings) -> Iterator[RenderedFrame]:
    """Render and label the frames of all cameras, one at a time in memory."""
    for labelled in _views(image, progress, timings):
        name = frame_folder_name(image.drawn.image_index, labelled.frame.camera.name)
        notes = tuple(_frame_notes(image, labelled, name))
        ground_m = ground_below(image.drawn, labelled.frame.camera)
        row = frame_row(name, labelled, image.drawn, image.built.spec.sky, ground_m, notes)
        yield RenderedFrame(name, labelled, _header(image, labelled.frame), row, notes)
        del labelled  # before the next one is made


def write_image(
    image: ImageScene, settings: DatasetSettings, folder: Path, progress: Progress, timings: Timings
) -> WrittenImage:
    """Render an image and write its frames, each into a folder of its own, and ``maps/`` beside them."""
    drawn = image.drawn
    stored = replace(drawn, data=write_maps(folder, drawn.data, drawn.folder))
    yaml, folders, rows, notes = dump_yaml(stored), [], [], list(image.notes)
    seen: set[int] = set()  # plants in view of any camera
    for frame in image_frames(image, progress, timings):
        folders.append(folder / frame.name)
        with timings("write"):
            write_frame(folders[-1], frame.labelled, yaml, frame.attributes, settings)
        visible = frame.labelled.views.visible
        seen.update(visible.plant_id[visible.has_box].tolist())
        rows.append(dict(frame.row))
        notes += frame.notes
        del frame  # before the next one is made
    return WrittenImage(tuple(folders), tuple(rows), tuple(notes), _image_report(image, len(seen)))


def _views(image: ImageScene, progress: Progress, timings: Timings) -> Iterator[LabelledFrame]:
    """The labelled frames; what does not change between two cameras is set up once."""
    drawn, built = image.drawn, image.built
    recipe, classes, key = drawn.recipe, class_map(drawn), recipe_hash(drawn.data)
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
        check = partial(check_ids, recipe.dataset.formats, camera.name)
        frame = render_frame(tracer, camera, recipe, drawn.image_seed, progress, timings, check=check, key=key)
        view = ChannelView(tracer, built.next_view(camera), progress, timings)
        frame = add_channels(frame, recipe.labels.channels, view)
        with timings("labels"):
            labelled = label_frame(frame, built.population, classes, measures, recipe.labels.channels)
        del frame
        yield labelled
        del labelled  # one frame at a time in memory


def _header(image: ImageScene, frame: Frame) -> dict[str, str]:
    """Attributes of frame.exr. They belong to the drawn recipe, so that an image drawn alone has the same bytes."""
    return {
        "recipe_hash": recipe_hash(image.drawn.data),
        "seed": str(image.root_seed),
        "image_seed": str(image.drawn.image_seed),
        "samples": str(frame.radiance.samples),
    }


def _image_report(image: ImageScene, visible_plants: int) -> dict[str, Any]:
    """An image's row in the manifest; `visible_plants` are in view of any of its cameras."""
    built = image.built
    return {
        "image": image.drawn.image_index,
        "seed": image.drawn.image_seed,
        "view": image.drawn.recipe.dataset.view,  # of its previews
        "counts": _counts(built.population),
        "standing_dead": _dead(built.population),
        "visible_plants": visible_plants,
        "triangles": sum(exemplar.triangles for exemplar in built.spec.exemplars),
        "size_errors": [asdict(error) for error in built.size_errors],
    }


def _frame_notes(image: ImageScene, labelled: LabelledFrame, name: str) -> Iterator[str]:
    """What is unusual about a frame: nothing in view, noise above what was asked for, thick haze."""
    population, plan = image.built.population, image.plan
    if not len(population):
        yield f"{name} shows bare ground: {_empty_site(plan.community)}"
    elif only_snags(population):
        yield f"{name} shows no living plant: all are standing dead trees"
    if len(population) and not labelled.views.visible.has_box.any():
        below = labelled.frame.camera.name in views_below_ground(plan.drawn)
        yield f"{name}: the camera {'stands below the ground' if below else 'sees no plant'}"
    yield from noise_notes(labelled.frame.radiance, name)
    yield from haze_notes(image.built.spec, labelled.frame.surface, name)


def simulate(
    loaded: LoadedRecipe,
    target: Path | None,
    *,
    map_steps: Sequence[int] = (),
    resume: Path | None = None,
    from_step: int | None = None,
    graphs: Sequence[Path] = (),
    overwrite: bool = False,
    progress: Progress,
    timings: Timings,
) -> SimulationSummary:
    """Simulate the community of a recipe's first image.

    Parameters
    ----------
    target : folder for its history, maps and curves; None: only `graphs` are written.
    map_steps : steps whose maps are drawn; by default the last.
    resume : a history that the recipe made; the simulation goes on from its snapshot of `from_step`, by default its
        last.
    graphs : files that the branches of the last step's plants are written to.

    Raises
    ------
    RecipeError, ResourceError, OutputError
    """
    from forestgen.community.history_files import check_graphs, check_map_steps, write_community, write_graphs
    from forestgen.community.resume import note_of_other_code, snapshot_to_resume

    plan = check_plan(loaded, simulate_only=True)
    start = snapshot_to_resume(plan.community, resume, from_step) if resume is not None else None
    check_graphs(plan.community, graphs)
    check_map_steps(plan.community, map_steps, first=start.step if start is not None else 0)
    other_code = note_of_other_code(resume) if resume is not None else None
    notes = [other_code] if other_code else []
    if target is None:
        with timings("community"):
            (last,) = deque(snapshots(plan.community, progress, start), maxlen=1)
        write_graphs(plan.community, last, graphs)
        return _simulation_summary(plan, last, notes, timings)
    with OutputFolder(target, overwrite=overwrite) as folder:
        with timings("community"):
            last = write_community(folder, plan.community, snapshots(plan.community, progress, start), map_steps)
        write_graphs(plan.community, last, graphs)
        summary = _simulation_summary(plan, last, notes, timings)
        write_manifest(folder, _manifest(folder, loaded, plan.drawn.image_seed, summary))
    return summary


def _simulation_summary(plan: Plan, last: Population, notes: Sequence[str], timings: Timings) -> SimulationSummary:
    plants = plan.community.obstacles.left_out_of(last)
    found = [*notes, *last.notes]
    if not len(plants):
        found.append(_empty_site(plan.community))
    elif only_snags(plants):
        found.append(f"all plants at step {plan.community.steps} are standing dead trees: none lives")
    return SimulationSummary(
        plan=plan,
        last=last,
        plants=len(plants),
        standing_dead=_dead(plants),
        counts=_counts(plants),
        stems=tuple(_stems(plants, plan.community.site)),
        notes=tuple(found),
        timings_s=dict(timings.seconds),
        total_s=timings.total(),
    )


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


def _empty_site(plan: CommunityPlan) -> str:
    return plan.empty_reason or f"no plant lives on the site at step {plan.steps}"


def _manifest(folder: Path, loaded: LoadedRecipe, image_seed: int, summary: SimulationSummary) -> dict[str, Any]:
    return build_manifest(
        folder,
        recipe_hash=loaded.hash,
        root_seed=loaded.seed,
        image_seeds=[image_seed],
        timings_s=summary.timings_s,
        extra={"notes": list(summary.notes), "total_s": summary.total_s},
    )
