"""Geometry of the pixels' centres: depth, position and normals tell one surface, seen by the camera of camera.json."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.dataset.check.finding import Finding, number
from forestgen.dataset.check.frame_data import CAMERA, EXR, FrameData
from forestgen.dataset.check.pixels import wrong_pixels
from forestgen.scene.projection import pixel_centres

_RELATIVE = 1e-3  # of the distance: how far a reprojected point may lie from the stored one
_FLOAT32 = 2e-6  # relative rounding of stored world coordinates, with a margin
_UNIT = 1e-3


def depth(frame: FrameData) -> Iterator[Finding]:
    """Depths are positive, infinite in the sky; the distance along the ray is no shorter, or the same by its model."""
    z = frame.exr["depth"]["Z"].astype(np.float64)
    yield from wrong_pixels(frame, EXR, ~(z > 0), "the depth is not positive", "metres, inf for the sky", z)
    if frame.has_part("depth", "distance"):
        distance = frame.exr["depth"]["distance"].astype(np.float64)
        agree = (distance >= z * (1 - _FLOAT32)) & (np.isinf(distance) == np.isinf(z))
        yield from wrong_pixels(frame, EXR, ~agree, "the distance is shorter than the depth", z, distance)
        if frame.has(CAMERA) and frame.camera.projection.depth_is_distance:
            problem = "the depth is not the distance, as it is in a fisheye's image and in a panorama"
            yield from wrong_pixels(frame, EXR, z != distance, problem, distance, z)


def circle(frame: FrameData) -> Iterator[Finding]:
    """Outside of a fisheye's circle nothing is seen: no surface, and no plant in pixels that lie outside as a whole."""
    geometry = frame.camera.geometry
    beyond_px = geometry.beyond_rim_px(pixel_centres(frame.size_px))
    if beyond_px is None:
        return
    outside = ~geometry.sees(frame.size_px)
    z = frame.exr["depth"]["Z"]
    wrong = outside & ~np.isinf(z)
    yield from wrong_pixels(frame, EXR, wrong, "a surface outside of the fisheye's circle", "depth inf", z)
    wholly = beyond_px > 0.75  # a pixel reaches 0.71 from its centre
    wrong = wholly & (frame.instance != 0)
    yield from wrong_pixels(frame, EXR, wrong, "a plant outside of the fisheye's circle", "0", frame.instance)
    if frame.has_part("radiance", *"RGB"):
        light = np.stack([frame.exr["radiance"][name] for name in "RGB"], axis=-1)
        wrong = wholly & (light != 0).any(axis=-1)
        yield from wrong_pixels(frame, EXR, wrong, "light outside of the fisheye's circle", "0", light)


def sky(frame: FrameData) -> Iterator[Finding]:
    """Infinite depth, no position, no normal and no part go together."""
    is_sky = np.isinf(frame.exr["depth"]["Z"])
    if frame.has_part("identity", "centre.part"):
        part = frame.exr["identity"]["centre.part"]
        wrong = (part == int(Part.NOTHING)) != is_sky
        yield from wrong_pixels(frame, EXR, wrong, "infinite depth and centre.part 0 do not go together", "", part)
    if frame.has_part("position", *"XYZ"):
        place = frame.vectors("position")
        wrong = np.where(is_sky, ~np.isnan(place).all(axis=-1), np.isnan(place).any(axis=-1))
        yield from wrong_pixels(frame, EXR, wrong, "only the sky has no position", "NaN for the sky", place)
        endless = np.asarray(np.isinf(place).any(axis=-1))
        yield from wrong_pixels(frame, EXR, endless, "an infinite position", "metres", place)
    for part_name in ("normal", "normal.shading"):
        if frame.has_part(part_name, *"XYZ"):
            normal = frame.vectors(part_name)
            wrong = np.asarray((normal == 0).all(axis=-1) != is_sky)
            yield from wrong_pixels(frame, EXR, wrong, f"only the sky has no {part_name}", "0 for the sky", normal)


def position(frame: FrameData) -> Iterator[Finding]:
    """Depth along the pixel's ray, by K and pose, ends at the stored position; so does the distance."""
    camera, solid = frame.camera, _solid(frame)
    z = np.where(solid, frame.exr["depth"]["Z"], np.nan).astype(np.float64)
    rays = camera.pixel_rays(frame.size_px)
    away = rays * z[..., None] + camera.starts(frame.size_px)
    stored = frame.vectors("position")
    expected = away + camera.position_m
    tolerance = _RELATIVE * _length(away) + _FLOAT32 * np.abs(expected).max(axis=-1)
    wrong = solid & ~(_length(stored - expected) <= tolerance)
    yield from wrong_pixels(frame, EXR, wrong, "depth and camera do not lead to the position", expected, stored)
    if frame.has_part("depth", "distance"):
        distance = frame.exr["depth"]["distance"].astype(np.float64)
        straight = _length(stored - camera.position_m - camera.starts(frame.size_px))
        wrong = solid & ~(np.abs(distance - straight) <= tolerance)
        problem = "the distance is not |position - beginning of the ray|"
        yield from wrong_pixels(frame, EXR, wrong, problem, straight, distance)
    if frame.has_part("position.camera", *"XYZ"):
        own = frame.vectors("position.camera")
        expected = away @ camera.rotation.T
        wrong = solid & ~(_length(own - expected) <= _RELATIVE * _length(away))
        yield from wrong_pixels(frame, EXR, wrong, "position.camera is not depth along the ray", expected, own)


def normals(frame: FrameData) -> Iterator[Finding]:
    """Normals are unit vectors, towards the camera, and the same in the camera's axes."""
    solid = _solid(frame)
    geometric = frame.vectors("normal")
    for name in ("normal", "normal.shading"):
        if not frame.has_part(name, *"XYZ"):
            continue
        normal = frame.vectors(name)
        wrong = solid & ~(np.abs(_length(normal) - 1) <= _UNIT)
        yield from wrong_pixels(frame, EXR, wrong, f"{name} is no unit vector", "length 1", _length(normal))
        wrong = solid & ~((normal * geometric).sum(axis=-1) >= -_UNIT)
        yield from wrong_pixels(frame, EXR, wrong, f"{name} is on the surface's other side", geometric, normal)
        if frame.has_part(f"{name}.camera", *"XYZ") and frame.has(CAMERA):
            turned, stored = normal @ frame.camera.rotation.T, frame.vectors(f"{name}.camera")
            wrong = solid & ~(_length(turned - stored) <= _UNIT)
            yield from wrong_pixels(frame, EXR, wrong, f"{name}.camera is not {name} turned", turned, stored)
    if frame.has(CAMERA):
        towards = (geometric * frame.camera.pixel_rays(frame.size_px)).sum(axis=-1)
        wrong = solid & ~(towards <= _UNIT)
        yield from wrong_pixels(frame, EXR, wrong, "the normal faces away from the camera", "towards it", geometric)


def centre(frame: FrameData) -> Iterator[Finding]:
    """The centre ray's plant is in plants.parquet, with its own exemplar and a plant's part."""
    channels = frame.exr["identity"]
    plant, part = channels["centre.plant_id"], channels["centre.part"]
    known = frame.plants["plant_id"]
    wrong = (plant != 0) & ~np.isin(plant, known)
    yield from wrong_pixels(frame, EXR, wrong, "centre.plant_id is not in plants.parquet", "a row of it", plant)
    own = np.isin(part, [int(one) for one in (Part.TRUNK, Part.BRANCH, Part.LEAF, Part.FLOWER, Part.FRUIT)])
    rarer = np.isin(part, [int(Part.DEAD_WOOD), int(Part.STRUCTURE)])
    wrong = np.where(plant != 0, ~own & ~rarer, own)
    yield from wrong_pixels(frame, EXR, wrong, "centre.part does not suit centre.plant_id", "", part)
    if frame.has_part("identity", "centre.exemplar") and frame.known("exemplar"):
        exemplar = channels["centre.exemplar"].astype(np.int64)
        listed = np.zeros(plant.shape, dtype=np.int64)
        there = (plant != 0) & np.isin(plant, known)
        listed[there] = frame.plants["exemplar"][np.searchsorted(known, plant[there])].astype(np.int64) + 1
        wrong = (exemplar != listed) & (there | (plant == 0))
        yield from wrong_pixels(frame, EXR, wrong, "centre.exemplar is not plants.parquet's + 1", listed, exemplar)


def camera(frame: FrameData) -> Iterator[Finding]:
    """camera.json is a camera of the image's size: a rotation, its own position, the header's matrices and model."""
    model = frame.camera
    if model.size_px != frame.size_px:
        yield frame.finding(CAMERA, "size_px is not the image's", expected=str(frame.size_px), got=str(model.size_px))
    rotation = model.rotation
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6 or np.linalg.det(rotation) < 0:
        yield frame.finding(CAMERA, "camera_from_world is no rotation", expected="orthonormal, right-handed")
    at = -rotation.T @ model.camera_from_world[:3, 3]
    if np.abs(at - model.position_m).max() > 1e-6 * max(1.0, float(np.abs(at).max())):
        yield frame.finding(
            CAMERA,
            "position_m is not that of camera_from_world",
            expected=" ".join(map(number, at)),
            got=" ".join(map(number, model.position_m)),
        )
    yield from _angle(frame)
    header = frame.exr_camera
    for key in ("model", "K", "hfov_deg", "width_m", "lens", "camera_from_world", "position_m", "size_px"):
        if header is not None and key in header and not _equal(model.values.get(key), header[key]):
            got = str(model.values.get(key))
            yield frame.finding(CAMERA, f"{key} differs from frame.exr's header", expected=str(header[key]), got=got)


def _angle(frame: FrameData) -> Iterator[Finding]:
    """hfov_deg is that of K."""
    geometry = frame.camera.geometry
    expected, got = geometry.focal_of_angle(), geometry.focal_px[0]
    if expected is not None and not abs(expected - got) <= 1e-6 * expected:
        problem = "the focal length of K is not that of hfov_deg"
        yield frame.finding(CAMERA, problem, expected=number(expected), got=number(got))


def _equal(one: Any, other: Any) -> bool:
    return bool(one == other) if isinstance(other, str | dict) else bool(np.array_equal(one, other))


def has_position(frame: FrameData) -> bool:
    return frame.has(CAMERA) and frame.has_part("position", *"XYZ") and frame.has_part("depth", "Z")


def has_normals(frame: FrameData) -> bool:
    return frame.has_part("normal", *"XYZ") and frame.has_part("depth", "Z")


def has_centre(frame: FrameData) -> bool:
    return frame.has_part("identity", "centre.plant_id", "centre.part")


def has_circle(frame: FrameData) -> bool:
    return frame.has(CAMERA) and frame.has_part("depth", "Z")


def has_depth(frame: FrameData) -> bool:
    return frame.has_part("depth", "Z")


def _solid(frame: FrameData) -> NDArray[np.bool_]:
    return np.asarray(~np.isinf(frame.exr["depth"]["Z"]))


def _length(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.sqrt(np.einsum("hwk,hwk->hw", vectors, vectors)))
