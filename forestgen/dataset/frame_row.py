"""A frame's row of the index, made while the frame is in memory; what the columns mean stands in `dataset.index`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.dataset.settings import DRAW
from forestgen.labels.labelled import LabelledFrame
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.map_files import recipe_hash
from forestgen.recipe.sources import dotted
from forestgen.render.frame import Radiance
from forestgen.scene.projection import projection_of
from forestgen.scene.spec import Camera, Sky


def frame_row(
    name: str,
    labelled: LabelledFrame,
    drawn: DrawnRecipe,
    sky: Sky,
    ground_m: float,
    notes: Sequence[str] = (),
) -> dict[str, Any]:
    """What the index tells of a frame: plain values (numbers, texts, lists, dicts of them), the same in every run.

    Parameters
    ----------
    name : of the frame's folder.
    labelled : the frame with its labels, while it is in memory.
    sky : of the scene.
    ground_m : height of the ground below the camera, world.
    notes : of the frame, for people.
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
        "turbidity": float(sky.turbidity),
        "visibility_m": None if sky.visibility_m is None else float(sky.visibility_m),
        "season": recipe.plants.season,
        "wind_m_per_s": float(recipe.wind.speed_m_per_s),
    }


def _light(radiance: Radiance) -> dict[str, Any]:
    return {
        "channels": list(radiance.channels),
        "samples": int(radiance.samples),
        "relative_error": _known(radiance.relative_error),
        "relative_error_p95": _known(radiance.relative_error_p95),
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
        "plants": len(labelled.population),
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


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _mean(values: NDArray[Any]) -> float | None:
    return float(values.mean(dtype=np.float64)) if values.size else None


def _median(values: NDArray[Any]) -> float | None:
    """Without the values that are NaN."""
    known = values[~np.isnan(values)]
    return float(np.median(known)) if known.size else None
