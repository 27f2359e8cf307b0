"""All files of a frame, and those of a whole data set."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from forestgen.dataset import png
from forestgen.dataset.camera import write_camera
from forestgen.dataset.exr import write_exr
from forestgen.dataset.files import make_folder, write_bytes, write_json
from forestgen.dataset.formats.format import load_formats
from forestgen.dataset.legend import write_legend
from forestgen.dataset.raw import raw_image, write_raw
from forestgen.dataset.settings import DatasetSettings
from forestgen.dataset.tables import write_plants
from forestgen.dataset.tonemap import preview_of
from forestgen.labels.gap_fraction import gap_fraction_of, looks_up
from forestgen.labels.labelled import LabelledFrame

# Uncompressed, so never too few: 60 EXR channels of 4 bytes, three RGB pictures, a mask and a raw image a pixel.
_BYTES_PER_PIXEL = 60 * 4 + 3 * 3 + 1 + 3 * 2
_BYTES_PER_CHANNEL = 3 * 4 + 2  # of light, beyond the third: mean, variance, denoised copy, raw
_BYTES_PER_PLANT = 500  # a row of plants.parquet
_BYTES_PER_FRAME = 1 << 18  # headers, and what is small


def frame_folder_name(image: int, camera_name: str) -> str:
    """Folder of a frame, such as ``000000-camera0``."""
    return f"{image:06d}-{camera_name}"


def frame_bytes(size_px: tuple[int, int], plants: int, formats: Sequence[str] = (), channels: int = 3) -> int:
    """Disk space to set aside for one frame of so many channels of light: an upper estimate, in bytes."""
    light = max(0, channels - 3) * _BYTES_PER_CHANNEL
    pixel = _BYTES_PER_PIXEL + light + sum(one.bytes_per_pixel for one in load_formats(formats))
    plant = _BYTES_PER_PLANT + sum(one.bytes_per_plant for one in load_formats(formats))
    return size_px[0] * size_px[1] * pixel + plants * plant + _BYTES_PER_FRAME


def write_frame(
    folder: Path,
    labelled: LabelledFrame,
    recipe_yaml: str,
    attributes: Mapping[str, str],
    settings: DatasetSettings,
) -> None:
    """Write a frame's files, and its shards of the data set's formats.

    Parameters
    ----------
    folder : the frame's own folder, made if it is missing.
    recipe_yaml : the drawn recipe.
    attributes : name -> text for the EXR header, such as recipe_hash and seed; from image_seed, 0 if it is missing,
        comes the noise of a raw image.
    settings : of the data set.

    Raises
    ------
    OutputError
        When a file cannot be written or an id does not fit its format.
    """
    radiance, camera, pixels = labelled.frame.radiance, labelled.frame.camera, labelled.pixels
    made = preview_of(radiance, settings.view)
    make_folder(folder)
    png.write_instance(folder / "instance.png", pixels.instance)
    png.write_semantic(folder / "semantic.png", pixels.semantic, settings.class_names)
    png.write_rgb(folder / "preview.png", made.picture, made.texts)
    png.write_rgb(folder / "overlay.png", png.overlay(made.picture, pixels.instance))
    write_exr(folder / "frame.exr", labelled, {"view": settings.view, **attributes})
    if camera.exposure is not None:
        write_raw(folder, raw_image(radiance, camera, camera.exposure, int(attributes.get("image_seed", "0"))))
    write_plants(folder / "plants.parquet", labelled)
    write_camera(folder / "camera.json", camera)
    if looks_up(camera):
        write_json(folder / "canopy.json", gap_fraction_of(camera, labelled.frame.identity).as_dict())
    write_bytes(folder / "recipe.yaml", recipe_yaml.encode())
    for one in load_formats(settings.formats):
        one.write_frame(folder, labelled, settings)


def write_dataset(root: Path, folders: Iterable[Path | str], settings: DatasetSettings) -> None:
    """Write classes.json, and join the shards of all frames; `folders` are the frames' or their names, in any order."""
    known = list(folders)
    write_legend(root, settings, png.class_palette(len(settings.class_names)))
    for one in load_formats(settings.formats):
        one.merge(root, known, settings)
