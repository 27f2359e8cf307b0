"""Geometry of the pixels' centres: depth, position and normals are of one surface, seen by the camera of camera.json.

Motion vectors say where that surface goes until the sequence's next frame. Ground, sky, and plants where no wind blows
move by the two cameras alone, to the pixel's fraction. How plants move in wind is not in the files; their vectors must
land on the same plant in the next frame, unless a nearer surface is there, or the plant within 1.5 pixels: the next
frame's pixel centre is not the landing point, and leaves are thin. So a few of the plants' pixels may fail. Where the
next frame sees plants smaller, its pixels' centres may miss the leaves, and nothing is checked.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.dataset.check.files import Finding, UnreadableError, finding
from forestgen.dataset.check.frame_data import CAMERA, EXR, FrameData, Wrong, frame_check
from forestgen.dataset.check.merged import UNKNOWN
from forestgen.scene.projection import pixel_centres

_RELATIVE = 1e-3  # of the distance: how far a reprojected point may lie from the stored one
_FLOAT32 = 2e-6  # relative rounding of stored world coordinates, with a margin
_UNIT = 1e-3
_MOTION_PX = 0.02
_OF_WAY = 1e-3  # of the way, for points that fly past the camera
_GRAZING = 1e-3  # depth by distance, below which a point may or may not count as behind the camera
_SMALLER = 1.25  # times smaller in the next frame, beyond which landings are not judged
_MOST_LOST = 0.1  # share of a plant's landings, of those that nothing hides
_FEWEST = 50  # landings in an image, to speak of a share
_U, _V = "forward.u", "forward.v"
_DEPTH = ("depth Z",)


@frame_check("depth", EXR, exr=_DEPTH)
def depth(frame: FrameData) -> Iterator[Wrong]:
    """Depths are positive, infinite in the sky; the distance along the ray is no shorter, or the same by its model."""
    z = frame.exr["depth"]["Z"].astype(np.float64)
    yield Wrong(~(z > 0), "the depth is not positive", "metres, inf for the sky", z)
    if frame.has_part("depth", "distance"):
        distance = frame.exr["depth"]["distance"].astype(np.float64)
        agree = (distance >= z * (1 - _FLOAT32)) & (np.isinf(distance) == np.isinf(z))
        yield Wrong(~agree, "the distance is shorter than the depth", z, distance)
        if frame.has(CAMERA) and frame.camera.projection.depth_is_distance:
            problem = "the depth is not the distance, as it is in a fisheye's image and in a panorama"
            yield Wrong(z != distance, problem, distance, z)


@frame_check("circle", EXR, files=(CAMERA,), exr=_DEPTH)
def circle(frame: FrameData) -> Iterator[Wrong]:
    """Outside of a fisheye's circle nothing is seen: no surface, and no plant in pixels that lie outside as a whole."""
    geometry = frame.camera.geometry
    beyond_px = geometry.beyond_rim_px(pixel_centres(frame.size_px))
    if beyond_px is None:
        return
    outside = ~geometry.sees(frame.size_px)
    z = frame.exr["depth"]["Z"]
    yield Wrong(outside & ~np.isinf(z), "a surface outside of the fisheye's circle", "depth inf", z)
    wholly = beyond_px > 0.75  # a pixel reaches 0.71 from its centre
    yield Wrong(wholly & (frame.instance != 0), "a plant outside of the fisheye's circle", "0", frame.instance)
    if frame.has_part("radiance", *"RGB"):
        light = np.stack([frame.exr["radiance"][name] for name in "RGB"], axis=-1)
        yield Wrong(wholly & (light != 0).any(axis=-1), "light outside of the fisheye's circle", "0", light)


@frame_check("sky", EXR, exr=_DEPTH)
def sky(frame: FrameData) -> Iterator[Wrong]:
    """Infinite depth, no position, no normal and no part go together."""
    is_sky = np.isinf(frame.exr["depth"]["Z"])
    if frame.has_part("identity", "centre.part"):
        part = frame.exr["identity"]["centre.part"]
        wrong = (part == int(Part.NOTHING)) != is_sky
        yield Wrong(wrong, "infinite depth and centre.part 0 do not go together", "", part)
    if frame.has_part("position", *"XYZ"):
        place = frame.vectors("position")
        wrong = np.where(is_sky, ~np.isnan(place).all(axis=-1), np.isnan(place).any(axis=-1))
        yield Wrong(wrong, "only the sky has no position", "NaN for the sky", place)
        yield Wrong(np.isinf(place).any(axis=-1), "an infinite position", "metres", place)
    for part_name in ("normal", "normal.shading"):
        if frame.has_part(part_name, *"XYZ"):
            normal = frame.vectors(part_name)
            wrong = (normal == 0).all(axis=-1) != is_sky
            yield Wrong(wrong, f"only the sky has no {part_name}", "0 for the sky", normal)


@frame_check("position", EXR, files=(CAMERA,), exr=("position X Y Z", *_DEPTH))
def position(frame: FrameData) -> Iterator[Wrong]:
    """Depth along the pixel's ray, by K and pose, ends at the stored position; so does the distance."""
    camera, solid = frame.camera, ~np.isinf(frame.exr["depth"]["Z"])
    z = np.where(solid, frame.exr["depth"]["Z"], np.nan).astype(np.float64)
    rays = camera.pixel_rays(frame.size_px)
    away = rays * z[..., None] + camera.starts(frame.size_px)
    stored = frame.vectors("position")
    expected = away + camera.position_m
    tolerance = _RELATIVE * _length(away) + _FLOAT32 * np.abs(expected).max(axis=-1)
    wrong = solid & ~(_length(stored - expected) <= tolerance)
    yield Wrong(wrong, "depth and camera do not lead to the position", expected, stored)
    if frame.has_part("depth", "distance"):
        distance = frame.exr["depth"]["distance"].astype(np.float64)
        straight = _length(stored - camera.position_m - camera.starts(frame.size_px))
        wrong = solid & ~(np.abs(distance - straight) <= tolerance)
        yield Wrong(wrong, "the distance is not |position - beginning of the ray|", straight, distance)
    if frame.has_part("position.camera", *"XYZ"):
        own = frame.vectors("position.camera")
        expected = (away - camera.row_shift_m) @ camera.axes
        wrong = solid & ~(_length(own - expected) <= _RELATIVE * _length(away))
        yield Wrong(wrong, "position.camera is not depth along the ray", expected, own)


@frame_check("normals", EXR, exr=("normal X Y Z", *_DEPTH))
def normals(frame: FrameData) -> Iterator[Wrong]:
    """Normals are unit vectors, towards the camera, and the same in the camera's axes."""
    solid = ~np.isinf(frame.exr["depth"]["Z"])
    geometric = frame.vectors("normal")
    for name in ("normal", "normal.shading"):
        if not frame.has_part(name, *"XYZ"):
            continue
        normal = frame.vectors(name)
        wrong = solid & ~(np.abs(_length(normal) - 1) <= _UNIT)
        yield Wrong(wrong, f"{name} is no unit vector", "length 1", _length(normal))
        wrong = solid & ~((normal * geometric).sum(axis=-1) >= -_UNIT)
        yield Wrong(wrong, f"{name} is on the surface's other side", geometric, normal)
        if frame.has_part(f"{name}.camera", *"XYZ") and frame.has(CAMERA):
            turned, stored = normal @ frame.camera.axes, frame.vectors(f"{name}.camera")
            wrong = solid & ~(_length(turned - stored) <= _UNIT)
            yield Wrong(wrong, f"{name}.camera is not {name} turned", turned, stored)
    if frame.has(CAMERA):
        towards = (geometric * frame.camera.pixel_rays(frame.size_px)).sum(axis=-1)
        yield Wrong(solid & ~(towards <= _UNIT), "the normal faces away from the camera", "towards it", geometric)


@frame_check("centre", EXR, exr=("identity centre.plant_id centre.part",))
def centre(frame: FrameData) -> Iterator[Wrong]:
    """The centre ray's plant is in plants.parquet, with its own exemplar and a plant's part."""
    channels = frame.exr["identity"]
    plant, part = channels["centre.plant_id"], channels["centre.part"]
    known = frame.plants["plant_id"]
    yield Wrong((plant != 0) & ~np.isin(plant, known), "centre.plant_id is not in plants.parquet", "a row of it", plant)
    own = np.isin(part, [int(one) for one in (Part.TRUNK, Part.BRANCH, Part.LEAF, Part.FLOWER, Part.FRUIT)])
    rarer = np.isin(part, [int(Part.DEAD_WOOD), int(Part.STRUCTURE)])
    yield Wrong(np.where(plant != 0, ~own & ~rarer, own), "centre.part does not suit centre.plant_id", "", part)
    if frame.has_part("identity", "centre.exemplar") and frame.known("exemplar"):
        exemplar = channels["centre.exemplar"].astype(np.int64)
        listed = np.zeros(plant.shape, dtype=np.int64)
        there = (plant != 0) & np.isin(plant, known)
        listed[there] = frame.plants["exemplar"][np.searchsorted(known, plant[there])].astype(np.int64) + 1
        wrong = (exemplar != listed) & (there | (plant == 0))
        yield Wrong(wrong, "centre.exemplar is not plants.parquet's + 1", listed, exemplar)


@frame_check("camera", CAMERA)
def camera(frame: FrameData) -> Iterator[Finding]:
    """camera.json is a camera of the image's size: a rotation, its own position, the header's matrices and model."""
    model = frame.camera
    if model.size_px != frame.size_px:
        yield finding("size_px is not the image's", frame.size_px, model.size_px)
    rotation = model.rotation
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6 or np.linalg.det(rotation) < 0:
        yield finding("camera_from_world is no rotation", "orthonormal, right-handed")
    at = -rotation.T @ model.camera_from_world[:3, 3]
    if np.abs(at - model.position_m).max() > 1e-6 * max(1.0, float(np.abs(at).max())):
        yield finding("position_m is not that of camera_from_world", at, model.position_m)
    focal, focal_of_angle = model.geometry.focal_px[0], model.geometry.focal_of_angle
    if focal_of_angle is not None and not abs(focal_of_angle - focal) <= 1e-6 * focal_of_angle:
        yield finding("the focal length of K is not that of hfov_deg", focal_of_angle, focal)
    header = frame.exr_camera
    for key in ("model", "K", "hfov_deg", "width_m", "lens", "camera_from_world", "position_m", "size_px"):
        if header is not None and key in header and model.values.get(key) != header[key]:
            yield finding(f"{key} differs from frame.exr's header", header[key], model.values.get(key))


@frame_check(
    "motion", EXR, files=(CAMERA,), exr=(f"motion {_U} {_V}", *_DEPTH),
    when=lambda frame: frame.next_name != UNKNOWN,
)  # fmt: skip
def motion(frame: FrameData) -> Iterator[Wrong]:
    """Vectors land where their surface is in the next frame; there are none in a sequence's last frame."""
    vector = np.stack([frame.exr["motion"][_U], frame.exr["motion"][_V]], axis=-1).astype(np.float64)
    unknown = np.asarray(np.isnan(vector).any(axis=-1))
    if frame.following is None:
        yield Wrong(~unknown, "a motion vector where no frame follows", "NaN", vector)
        return
    following = frame.following
    try:
        camera, known = following.camera, following.has_part("identity", "centre.plant_id")
    except UnreadableError:
        return  # the next frame's own checks say so
    way, depth, slant = _by_cameras(frame, camera.position_m, following)
    behind = depth <= 0
    moves = np.zeros(frame.instance.shape, dtype=bool)  # what may move by itself
    if float(frame.recipe["wind"].get("speed_m_per_s", 0.0)) != 0.0 and frame.has_part("identity", "centre.plant_id"):
        moves = frame.exr["identity"]["centre.plant_id"] != 0
    sure = (np.abs(depth) > _GRAZING * slant) & ~moves
    beyond_px = following.camera.geometry.beyond_rim_px(pixel_centres(frame.size_px) + way)
    if beyond_px is not None:  # where rounding decides on which side of a fisheye's circle a point lands
        sure &= ~(np.abs(beyond_px) < _MOTION_PX)
    yield Wrong(sure & (behind != unknown), "NaN is for points behind the next camera", "NaN there alone", vector)
    still = ~unknown & ~behind & sure
    off = np.sqrt(((vector - way) ** 2).sum(axis=-1))
    if following.camera.projection.wraps_x:
        turn = np.abs(np.abs(vector[..., 0] - way[..., 0]) - following.camera.size_px[0])
        off = np.minimum(off, np.hypot(turn, vector[..., 1] - way[..., 1]))  # half around: either way
    wrong = still & ~(off <= _MOTION_PX + _OF_WAY * np.sqrt((way**2).sum(axis=-1)))
    yield Wrong(wrong, "the motion is not that of the camera", way, vector)
    if known and following.has_part("depth", "Z"):
        here, there = frame.exr["depth"]["Z"].astype(np.float64), np.where(depth > 0, depth, np.inf)
        smaller = frame.camera.pixels_a_metre(here) > _SMALLER * following.camera.pixels_a_metre(there)
        yield from _landings(frame, following, vector, moves & ~unknown & ~smaller, depth)


def _by_cameras(
    frame: FrameData, next_position_m: NDArray[np.float64], following: FrameData
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """(H, W, 2) way in pixels of what stands still, (H, W) its depth in the next frame and its distance there."""
    z = frame.exr["depth"]["Z"].astype(np.float64)
    rays = frame.camera.pixel_rays(frame.size_px)
    solid = np.isfinite(z)
    shift = frame.camera.position_m - next_position_m + frame.camera.starts(frame.size_px)
    away = np.where(solid[..., None], rays * np.where(solid, z, 0.0)[..., None] + shift, rays)
    seen = following.camera.in_own_axes(away, solid)
    pixel, depth = following.camera.geometry.project(seen)
    if following.camera.projection.is_parallel:
        depth = np.where(solid, depth, -np.inf)  # parallel rays meet no direction
    depth = np.where(frame.camera.geometry.sees(frame.size_px), depth, -np.inf)
    way = pixel - pixel_centres(frame.size_px)
    if following.camera.projection.wraps_x:
        around = following.camera.size_px[0]
        way[..., 0] = (way[..., 0] + around / 2) % around - around / 2
    return way, depth, np.sqrt((seen**2).sum(axis=-1))


def _landings(
    frame: FrameData,
    following: FrameData,
    vector: NDArray[np.float64],
    moves: NDArray[np.bool_],
    depth: NDArray[np.float64],
) -> Iterator[Wrong]:
    """Plants in wind: few pixels may land off their plant where nothing nearer hides it."""
    height, width = following.instance.shape
    line, column = np.nonzero(moves)
    plant = frame.exr["identity"]["centre.plant_id"][line, column]
    x = np.floor(column + 0.5 + vector[line, column, 0])
    y = np.floor(line + 0.5 + vector[line, column, 1])
    inside = (x >= 1) & (x < width - 1) & (y >= 1) & (y < height - 1)
    line, column, plant = line[inside], column[inside], plant[inside]
    x, y = x[inside].astype(np.int64), y[inside].astype(np.int64)
    there, reach = following.exr["identity"]["centre.plant_id"], following.exr["depth"]["Z"]
    found = np.zeros(len(x), dtype=bool)
    for dx, dy in product((-1, 0, 1), repeat=2):
        found |= there[y + dy, x + dx] == plant
    hidden = reach[y, x] < depth[line, column]
    lost = ~found & ~hidden
    judged = int((~hidden).sum())
    if judged < _FEWEST or lost.sum() <= _MOST_LOST * judged:
        return
    wrong = np.zeros(frame.instance.shape, dtype=bool)
    wrong[line[lost], column[lost]] = True
    landing = np.full((*frame.instance.shape, 2), np.nan)
    landing[line, column] = np.stack([x, y], axis=-1)
    share = f"at most {_MOST_LOST:.0%} of {judged:,} landings elsewhere"
    problem = f"motion lands on another plant of {following.name}, at the pixel given"
    yield Wrong(wrong, problem, share, landing)


def _length(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.sqrt(np.einsum("hwk,hwk->hw", vectors, vectors)))
