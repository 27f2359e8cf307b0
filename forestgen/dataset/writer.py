"""All files of a frame, and coco.json over all frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from forestgen.community.population import Population
from forestgen.dataset import png
from forestgen.dataset.coco import FrameRecord, coco_dataset, frame_annotations
from forestgen.dataset.exr import write_exr
from forestgen.dataset.files import output_error, write_bytes, write_json
from forestgen.dataset.tables import write_plants
from forestgen.dataset.tonemap import tone_map
from forestgen.labels.masks import ClassMap
from forestgen.labels.pixels import pixel_labels
from forestgen.labels.plants_table import visible_plants
from forestgen.render.frame import Frame

COCO_NAME = "coco.json"
# Uncompressed, so never too few: 35 EXR channels of 4 bytes, three RGB pictures and two masks a pixel.
_BYTES_PER_PIXEL = 35 * 4 + 3 * 3 + 4
_BYTES_PER_PLANT = 600  # a row of plants.parquet and an annotation of coco.json
_BYTES_PER_FRAME = 1 << 16


def frame_folder_name(image: int, camera_name: str) -> str:
    """Folder of a frame, such as ``000000-camera0``."""
    return f"{image:06d}-{camera_name}"


def frame_bytes(size_px: tuple[int, int], plants: int) -> int:
    """Disk space to set aside for one frame: an upper estimate, in bytes."""
    return size_px[0] * size_px[1] * _BYTES_PER_PIXEL + plants * _BYTES_PER_PLANT + _BYTES_PER_FRAME


def write_frame(
    folder: Path,
    frame: Frame,
    population: Population,
    species_names: Sequence[str],
    recipe_yaml: str,
    attributes: Mapping[str, str],
) -> FrameRecord:
    """Label a frame and write all of its files.

    Parameters
    ----------
    folder : the frame's own folder, made if it is missing.
    frame : what the camera saw of `population`.
    species_names : the recipe's species in order, which numbers classes and categories. The population's own list may
        be a part of it, in another order.
    recipe_yaml : the drawn recipe.
    attributes : name -> text for the EXR header, such as recipe_hash and seed.

    Raises
    ------
    OutputError
        When a file cannot be written or an id does not fit its format.
    RecipeError
        When there are more species than classes.
    ValueError
        When the image holds a plant that the population does not.
    """
    classes = ClassMap(tuple(species_names))
    species = classes.species_index(population.species_names)[population.species]
    identity = frame.identity
    labels = pixel_labels(identity.plant_id, identity.part, population.plant_id, species)
    visible = visible_plants(population.plant_id, identity.plant_id, labels.instance)
    light = frame.radiance.mean if frame.radiance.denoised is None else frame.radiance.denoised
    preview = tone_map(light)

    _make_folder(folder)
    png.write_instance(folder / "instance.png", labels.instance)
    png.write_semantic(folder / "semantic.png", labels.semantic, classes.names)
    png.write_rgb(folder / "preview.png", preview)
    png.write_rgb(folder / "overlay.png", png.overlay(preview, labels.instance))
    write_exr(folder / "frame.exr", frame, labels, attributes)
    write_plants(folder / "plants.parquet", population, visible)
    write_bytes(folder / "recipe.yaml", recipe_yaml.encode())
    return FrameRecord(
        folder_name=folder.name,
        size_px=frame.camera.size_px,
        species_names=classes.species_names,
        annotations=frame_annotations(labels.instance, visible, species),
    )


def write_dataset(root: Path, frames: Iterable[FrameRecord], species_names: Sequence[str]) -> None:
    """Write coco.json over all frames."""
    write_json(root / COCO_NAME, coco_dataset(frames, species_names))


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(error, folder) from error
