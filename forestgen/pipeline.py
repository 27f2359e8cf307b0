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
from typing import TYPE_CHECKING, Any

from forestgen.community.population import Population
from forestgen.community.simulation import counts_of, dead_plants, final_population, lifeless_note, snapshots
from forestgen.community.summary import SimulationSummary
from forestgen.core.progress import Progress, Timings
from forestgen.dataset.folder import OutputFolder
from forestgen.dataset.formats.format import check_ids
from forestgen.dataset.manifest import write_manifest
from forestgen.dataset.settings import DatasetSettings, class_map
from forestgen.dataset.writer import frame_folder_name, frame_row, write_frame, write_maps
from forestgen.instruments.stand_table import StandTable, stand_table
from forestgen.labels.channels.channel import ChannelView, add_channels
from forestgen.labels.labelled import LabelledFrame, label_frame, shown_rows
from forestgen.recipe.load import LoadedRecipe, dump_yaml
from forestgen.recipe.map_files import recipe_hash
from forestgen.render.cloud_shadow import cloud_transport_of
from forestgen.render.frame import Frame
from forestgen.render.identity import SceneTracer
from forestgen.render.rendering import haze_notes, noise_notes, render_frame
from forestgen.scene.build import BuiltScene, build_scene
from forestgen.scene.far_mesh import SPECIES as FAR_SPECIES
from forestgen.scene.ground_layers.layer import GROUND
from forestgen.scene.plan import Plan, check_memory, check_plan
from forestgen.scene.plant_measures import PlantMeter
from forestgen.scene.spec import Camera
from forestgen.scene.surroundings import most_copies

if TYPE_CHECKING:
    from forestgen.instruments.instrument import Instrument, KeysT, ReadingT


@dataclass(frozen=True)
class RenderedFrame:
    """A camera's view of an image, labelled, with what files say of it."""

    name: str  # of its folder, such as 000000-camera0
    labelled: LabelledFrame
    attributes: Mapping[str, str]  # of frame.exr's header
    row: Mapping[str, Any]  # of the index, see `forestgen.dataset.index`
    notes: tuple[str, ...]  # of this frame, for people
    stand: StandTable  # of the image


@dataclass(frozen=True)
class WrittenImage:
    """What `write_image` wrote, without its arrays."""

    folders: tuple[Path, ...]  # of the frames
    rows: tuple[dict[str, Any], ...]  # of the frames, for an index
    notes: tuple[str, ...]  # for people
    report: dict[str, Any]  # the image's row of the manifest


def assemble_image(
    plan: Plan, progress: Progress, timings: Timings, memory_budget_bytes: int | None = None
) -> BuiltScene:
    """Simulate a drawn recipe's community, grow its plants and assemble its scene.

    `memory_budget_bytes`: that the image may take; None: what is free now.

    Raises `ResourceError`: so many plants grew that the scene would need more memory than there is.
    Raises `RecipeError`: a camera stands in a trunk, or in clouds that are rendered from afar.
    """
    with timings("community"):
        population = plan.community.with_tree_sizes(final_population(plan.community, progress))
    site, plants = plan.drawn.recipe.site, len(population)
    if site.surroundings.kind != "open":
        plants += most_copies(population, site.size_m, flat=plan.community.site.height is None)
    check_memory(plan, plants=plants, memory_budget_bytes=memory_budget_bytes)
    scene = build_scene(plan, population, progress, timings)
    clouds, where = plan.drawn.recipe.render.clouds, plan.drawn.where("render", "clouds")
    cloud_transport_of(clouds, scene.spec, scene.spec.cameras, where=where)
    return scene


def measure(
    loaded: LoadedRecipe, instrument: Instrument[KeysT, ReadingT], keys: KeysT, progress: Progress, timings: Timings
) -> ReadingT:
    """Measure in the scene of a recipe's first image.

    Raises `RecipeError`, `ResourceError`.
    """
    plan = check_plan(loaded)
    instrument.check(plan, keys)
    return instrument.measure(assemble_image(plan, progress, timings), keys, progress, timings)


def image_frames(scene: BuiltScene, progress: Progress, timings: Timings) -> Iterator[RenderedFrame]:
    """Render and label the frames of all cameras, one at a time in memory."""
    return _ImageRenderer(scene, progress, timings).frames()


def write_image(
    scene: BuiltScene, settings: DatasetSettings, folder: Path, progress: Progress, timings: Timings
) -> WrittenImage:
    """Render an image and write its frames, each into a folder of its own, and ``maps/`` beside them."""
    return _ImageRenderer(scene, progress, timings).write(settings, folder)


@dataclass(frozen=True)
class _ImageRenderer:
    scene: BuiltScene
    progress: Progress
    timings: Timings

    def write(self, settings: DatasetSettings, folder: Path) -> WrittenImage:
        drawn = self.scene.drawn
        yaml = dump_yaml(replace(drawn, data=write_maps(folder, drawn.data, drawn.folder)))
        folders, rows, notes = [], [], list(self.scene.notes)
        seen: set[int] = set()  # plants in view of any camera
        stand: StandTable | None = None
        for frame in self.frames():
            folders.append(folder / frame.name)
            with self.timings("write"):
                write_frame(folders[-1], frame.labelled, yaml, frame.attributes, settings)
            visible = frame.labelled.views.visible
            seen.update(visible.plant_id[visible.has_box & ~frame.labelled.outside].tolist())
            rows.append(dict(frame.row))
            notes += frame.notes
            stand = frame.stand
            del frame  # before the next one is made
        return WrittenImage(tuple(folders), tuple(rows), tuple(notes), self._report(len(seen), stand))

    def frames(self) -> Iterator[RenderedFrame]:
        scene = self.scene
        for labelled, stand in self._labelled():
            name = frame_folder_name(scene.drawn.image_index, labelled.frame.camera.name)
            notes = tuple(self._notes(labelled, name))
            ground_m = scene.plan.views.ground_below(labelled.frame.camera)
            figures = stand.total.figures()
            row = frame_row(name, labelled, scene.drawn, scene.spec.sky, ground_m, figures, notes)
            attributes = {  # of the drawn recipe, so that an image drawn alone has the same bytes
                "recipe_hash": recipe_hash(scene.drawn.data),
                "seed": str(scene.drawn.recipe.seed),
                "image_seed": str(scene.drawn.image_seed),
                "samples": str(labelled.frame.radiance.samples),
            }
            yield RenderedFrame(name, labelled, attributes, row, notes, stand)
            del labelled  # before the next one is made

    def _labelled(self) -> Iterator[tuple[LabelledFrame, StandTable]]:
        """With the stand as the first camera finds it. What does not change between two cameras is set up once."""
        scene, timings, channels = self.scene, self.timings, self.scene.drawn.recipe.labels.channels
        classes = class_map(scene.drawn)
        plants = scene.labelled or scene.population
        with timings("measures"):
            meter = PlantMeter([one for one in scene.spec.exemplars if one.species not in (FAR_SPECIES, GROUND)])
        tracer: SceneTracer | None = None
        stand: StandTable | None = None
        for camera in scene.spec.cameras:
            spec = scene.at(camera.time_s)
            if tracer is None or tracer.spec is not spec:
                tracer = None  # one scene at a time in memory
                tracer = SceneTracer(spec, timings)
                with timings("measures"):
                    measures = meter.measure(spec.instances.at(slice(0, len(plants))))
            stand = stand or stand_table(scene, tracer, meter, timings)
            frame = self._rendered(tracer, camera)
            with timings("labels"):
                shown = shown_rows(frame, plants)
                labelled = label_frame(frame, plants.at(shown), classes, measures.at(shown), channels)
            del frame
            yield labelled, stand
            del labelled  # one frame at a time in memory

    def _rendered(self, tracer: SceneTracer, camera: Camera) -> Frame:
        """With what its label channels need of the scene."""
        drawn, progress, timings = self.scene.drawn, self.progress, self.timings
        check = partial(check_ids, drawn.recipe.dataset.formats, camera.name)
        key = recipe_hash(drawn.data)
        frame = render_frame(tracer, camera, drawn.recipe, drawn.image_seed, progress, timings, check=check, key=key)
        view = ChannelView(tracer, self.scene.next_view(camera), progress, timings)
        return add_channels(frame, drawn.recipe.labels.channels, view)

    def _report(self, visible_plants: int, stand: StandTable | None) -> dict[str, Any]:
        """The image's row in the manifest; `visible_plants` are in view of any of its cameras."""
        scene = self.scene
        return {
            "image": scene.drawn.image_index,
            "seed": scene.drawn.image_seed,
            "view": scene.drawn.recipe.dataset.view,  # of its previews
            "counts": counts_of(scene.population),
            "dead": dead_plants(scene.population),
            "visible_plants": visible_plants,
            "stand": None if stand is None else stand.as_dict(),
            "triangles": sum(exemplar.triangles for exemplar in scene.spec.exemplars),
            "size_errors": [asdict(error) for error in scene.size_errors],
        }

    def _notes(self, labelled: LabelledFrame, name: str) -> Iterator[str]:
        """What is unusual about a frame: nothing in view, noise above what was asked for, thick haze."""
        scene, population = self.scene, self.scene.population
        if not len(population):
            yield f"{name} shows bare ground: {lifeless_note(scene.plan.community, population)}"
        elif dead_plants(population) == len(population):
            yield f"{name} shows no living plant: all are dead"
        if len(population) and not labelled.views.visible.has_box.any():
            below = scene.plan.views.below_ground.get(labelled.frame.camera.name)
            yield f"{name}: the camera {f'stands below {below}' if below else 'sees no plant'}"
        yield from noise_notes(labelled.frame.radiance, name)
        yield from haze_notes(scene.spec, labelled.frame.surface, name)


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

    Raises `RecipeError`, `ResourceError`, `OutputError`.
    """
    from forestgen.community.history_files import check_graphs, check_map_steps, write_community, write_graphs
    from forestgen.community.resume import note_of_other_code, snapshot_to_resume

    plan = check_plan(loaded, simulate_only=True).community
    start = None if resume is None else snapshot_to_resume(plan, resume, from_step)
    check_graphs(plan, graphs)
    check_map_steps(plan, map_steps, first=0 if start is None else start.step)
    other_code = None if resume is None else note_of_other_code(resume)

    def finished(last: Population) -> SimulationSummary:
        write_graphs(plan, last, graphs)
        lifeless = lifeless_note(plan, plan.obstacles.left_out_of(last))
        notes = tuple(note for note in (other_code, *last.notes, lifeless) if note)
        return SimulationSummary(plan, plan.with_tree_sizes(last), notes, dict(timings.seconds), timings.total())

    if target is None:
        with timings("community"):
            (last,) = deque(snapshots(plan, progress, start), maxlen=1)
        return finished(last)
    with OutputFolder(target, overwrite=overwrite) as folder:
        with timings("community"):
            last = write_community(folder, plan, snapshots(plan, progress, start), map_steps)
        summary = finished(last)
        write_manifest(
            folder,
            recipe_hash=loaded.hash,
            root_seed=loaded.seed,
            image_seeds=[plan.drawn.image_seed],
            timings_s=summary.timings_s,
            extra={"notes": list(summary.notes), "total_s": summary.total_s},
        )
    return summary
