"""All files of a frame, its row of the index, the maps of its recipe; and the files of a whole data set.

What the columns of the row mean stands in `dataset.index`.
"""

from __future__ import annotations

import copy
import hashlib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import AssetError
from forestgen.core.parts import Part
from forestgen.core.raster import kind_of
from forestgen.dataset import png
from forestgen.dataset.camera import camera_model
from forestgen.dataset.exr import write_exr
from forestgen.dataset.files import make_folder, write_bytes, write_json
from forestgen.dataset.formats.format import finite, load_formats
from forestgen.dataset.settings import DRAW, DatasetSettings
from forestgen.dataset.tables import write_plants
from forestgen.dataset.tonemap import preview_of
from forestgen.labels.labelled import LabelledFrame
from forestgen.recipe.assets import MAPS, inside
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.map_files import map_files, recipe_hash
from forestgen.recipe.sources import dotted
from forestgen.render.frame import Radiance
from forestgen.scene.projection import projection_of
from forestgen.scene.spec import Camera, Sky

# Uncompressed, so never too few: 60 EXR channels of 4 bytes, three RGB pictures, a mask and a raw image a pixel.
_BYTES_PER_PIXEL = 60 * 4 + 3 * 3 + 1 + 3 * 2
_BYTES_PER_CHANNEL = 3 * 4 + 2  # of light, beyond the third: mean, variance, denoised copy, raw
_BYTES_PER_PLANT = 500  # a row of plants.parquet
_BYTES_PER_FRAME = 1 << 18  # headers, and what is small
_WEATHER = ("csv", "nc", "vol")  # maps that are known by their ending, not by what they begin with


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
    folder: Path, labelled: LabelledFrame, recipe_yaml: str, attributes: Mapping[str, str], settings: DatasetSettings
) -> None:
    """Write a frame's files and its shards of the data set's formats into its own folder, made if it is missing.

    `attributes`, name -> text, go into the EXR header, such as recipe_hash and seed; image_seed, 0 if it is missing,
    seeds the noise of a raw image. A file that cannot be written, or an id that does not fit, raises `OutputError`.
    """
    radiance, camera, pixels = labelled.frame.radiance, labelled.frame.camera, labelled.pixels
    made = preview_of(radiance, settings.view)
    make_folder(folder)
    png.write_instance(folder / "instance.png", pixels.instance)
    png.write_semantic(folder / "semantic.png", pixels.semantic, settings.class_names)
    png.write_png(folder / "preview.png", made.picture, made.texts)
    png.write_png(folder / "overlay.png", png.overlay(made.picture, pixels.instance))
    write_exr(folder / "frame.exr", labelled, {"view": settings.view, **attributes})
    if camera.exposure is not None:
        from forestgen.dataset.photo import with_photo
        from forestgen.dataset.raw import raw_image, write_raw

        raw = raw_image(radiance, camera, camera.exposure, int(attributes.get("image_seed", "0")))
        write_raw(folder, with_photo(folder, raw, camera.exposure))
    write_plants(folder / "plants.parquet", labelled)
    write_json(folder / "camera.json", camera_model(camera))
    if projection_of(camera).is_equidistant:
        from forestgen.labels.gap_fraction import gap_fraction_of, looks_up

        if looks_up(camera):
            write_json(folder / "canopy.json", gap_fraction_of(camera, labelled.frame.identity).as_dict())
    write_bytes(folder / "recipe.yaml", recipe_yaml.encode())
    for one in load_formats(settings.formats):
        one.write_frame(folder, labelled, settings)


def write_dataset(root: Path, folders: Iterable[Path | str], settings: DatasetSettings) -> None:
    """Write classes.json, and join the shards of all frames; `folders` are the frames' or their names, in any order."""
    known = list(folders)
    png.write_legend(root, settings)
    for one in load_formats(settings.formats):
        one.merge(root, known, settings)


def write_maps(root: Path, data: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Write each map of a drawn recipe, `data`, into ``maps/`` of a run's folder, once; paths are relative to `folder`.

    Returns `data` with paths as from a frame's folder, named by content: the same for every copy of the recipe. A file
    that has changed since the recipe was loaded raises `AssetError`, one that cannot be written `OutputError`.
    """
    stored = copy.deepcopy(data)
    for one in map_files(stored):
        one["file"] = f"../{MAPS}/{write_map(root, one, folder)}"
    return stored


def write_map(root: Path, one: Mapping[str, Any], folder: Path) -> str:
    """Write one map, a mapping of its file and SHA-256, into ``maps/`` of `root`; its name there. See `write_maps`."""
    sha256 = one["sha256"]
    source = inside(folder, one["file"], sha256=sha256)
    ending = source.suffix.lower().removeprefix(".")
    name = f"{sha256[:16]}.{ending if ending in _WEATHER else _kind_of(source, ending)}"
    target = root / MAPS / name
    if not target.exists():
        content = source.read_bytes()
        if hashlib.sha256(content).hexdigest() != sha256:
            raise AssetError("this map has changed since the recipe was loaded", where=str(source))
        make_folder(target.parent)
        write_bytes(target, content)
    return name


def _kind_of(source: Path, ending: str) -> str:
    """A picture's kind by its content, whatever its name; of files of other packages' parts the ending."""
    try:
        return kind_of(source)
    except AssetError:
        return ending if re.fullmatch("[a-z]{2,4}", ending) else "dat"


def frame_row(
    name: str,
    labelled: LabelledFrame,
    drawn: DrawnRecipe,
    sky: Sky,
    ground_m: float,
    stand: Mapping[str, float | None],
    notes: Sequence[str] = (),
) -> dict[str, Any]:
    """A frame's row of the index: plain values (numbers, texts, lists, dicts of them), the same in every run.

    `name` is the folder's, `ground_m` the height of the ground below the camera, world; `stand` has the figures of the
    image's stand, by their columns; `notes` are for people.
    """
    return {
        "frame": name,
        "folder": f"{drawn.split}/{name}",
        "split": drawn.split,
        "image": drawn.image_index,
        "image_seed": drawn.image_seed,
        "recipe_hash": recipe_hash(drawn.data),
        **_camera(labelled.frame.camera, ground_m),
        **_weather(drawn, sky),
        **_light(labelled.frame.radiance),
        **_view(labelled),
        **_plants(labelled),
        **stand,
        "notes": list(notes),
        **{DRAW + dotted(keys): value for keys, value in drawn.draws.items()},
    }


def _camera(camera: Camera, ground_m: float) -> dict[str, Any]:
    right, up, forward = (float(value) for value in camera.world_from_camera[:, 2])
    x_m, y_m, z_m = (float(value) for value in camera.position_m)
    width_px, height_px = camera.size_px
    return {
        "camera": camera.name,
        "sequence": camera.sequence,
        "time_s": float(camera.time_s),
        "width_px": int(width_px),
        "height_px": int(height_px),
        "camera_kind": camera.projection,
        "hfov_deg": projection_of(camera).file_keys(camera).get("hfov_deg"),
        "camera_x_m": x_m,
        "camera_y_m": y_m,
        "camera_z_m": z_m,
        "camera_height_m": z_m - ground_m,
        "camera_pitch_deg": math.degrees(math.asin(max(-1.0, min(1.0, forward)))),
        "camera_azimuth_deg": math.degrees(math.atan2(right, up)) % 360.0,
    }


def _weather(drawn: DrawnRecipe, sky: Sky) -> dict[str, Any]:
    recipe = drawn.recipe
    clouds = recipe.sky.clouds
    return {
        "sky_kind": sky.kind,
        "clouds": clouds.type,
        "cloud_cover": clouds.known_cover,
        "sun_elevation_deg": float(sky.sun_elevation_deg),
        "sun_azimuth_deg": float(sky.sun_azimuth_deg) % 360.0,
        "moon_elevation_deg": None if sky.moon is None else float(sky.moon.elevation_deg),
        "moon_azimuth_deg": None if sky.moon is None else float(sky.moon.azimuth_deg) % 360.0,
        "turbidity": float(sky.turbidity),
        "visibility_m": None if sky.visibility_m is None else float(sky.visibility_m),
        "season": recipe.time_of_year.name,
        "wind_m_per_s": float(recipe.wind.speed_m_per_s),
    }


def _light(radiance: Radiance) -> dict[str, Any]:
    return {
        "channels": list(radiance.channels),
        "samples": int(radiance.samples),
        "relative_error": finite(radiance.relative_error),
        "relative_error_p95": finite(radiance.relative_error_p95),
        "stopped_by": radiance.stopped_by,
    }


def _view(labelled: LabelledFrame) -> dict[str, Any]:
    """Sky, sun and depths, by the rays through the pixels' centres; classes and parts, by the masks."""
    surface, pixels, opacity = labelled.frame.surface, labelled.pixels, labelled.frame.cloud_opacity
    is_sky = surface.part == Part.NOTHING
    depth_m = surface.depth_m[np.isfinite(surface.depth_m)]
    return {
        "cloud_share": None if opacity is None else _mean(opacity[is_sky]),
        "sky_share": _mean(is_sky),
        "sunlit_share": _mean(surface.sun_visible[~is_sky]),
        "depth_min_m": float(depth_m.min()) if len(depth_m) else None,
        "depth_median_m": _median(depth_m),
        "depth_max_m": float(depth_m.max()) if len(depth_m) else None,
        "class_pixels": _by_name(pixels.semantic.ravel(), labelled.classes.names),
        "part_pixels": _by_name(pixels.part.ravel(), [part.name.lower() for part in Part]),
    }


def _plants(labelled: LabelledFrame) -> dict[str, Any]:
    visible = labelled.views.visible
    seen = visible.has_box
    won = visible.visible_pixels[seen]
    names = labelled.classes.species_names
    return {
        "plants": int((~labelled.outside).sum()),
        "plants_in_view": int(seen.sum()),
        "plants_truncated": int(visible.truncated[seen].sum()),
        "visible_fraction_median": _median(labelled.views.visible_fraction[seen]),
        "instance_pixels_median": _median(won),
        "instance_pixels_histogram": np.bincount(np.frexp(won.astype(np.float64))[1] - 1).tolist(),
        "category_instances": _by_name(labelled.category[seen], labelled.classes.instance_categories[0]),
        "species_instances": _by_name(labelled.species[seen], names),
        "species_pixels": _by_name(labelled.species[seen], names, won),
    }


def _by_name(
    number: NDArray[np.integer], names: Sequence[str], weight: NDArray[np.integer] | None = None
) -> dict[str, int]:
    """How often each number occurs, or the sum of its weights, by name; what does not occur is left out."""
    counts = np.bincount(number, weights=weight, minlength=len(names))
    return {str(names[index]): int(counts[index]) for index in np.flatnonzero(counts).tolist()}


def _mean(values: NDArray[Any]) -> float | None:
    return float(values.mean(dtype=np.float64)) if values.size else None


def _median(values: NDArray[Any]) -> float | None:
    """Without the values that are NaN."""
    known = values[~np.isnan(values)]
    return float(np.median(known)) if known.size else None
