"""Motion vectors: where the surface at a pixel's centre goes until the sequence's next frame.

Ground, sky, and plants where no wind blows go by the two cameras alone, to the pixel's fraction. Plants in wind move in
ways that the files do not tell; their vectors must land on the same plant in the next frame, unless a nearer surface is
there, or the plant within 1.5 pixels: the next frame's pixel centre is not the landing point, and leaves are thin. So
among the plants' pixels few may fail, not all. Where the next frame sees them smaller, its pixels' centres may well
miss the leaves, and nothing is said.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.check.finding import Finding, UnreadableError
from forestgen.dataset.check.frame_data import CAMERA, EXR, FrameData
from forestgen.dataset.check.pixels import wrong_pixels
from forestgen.dataset.check.sequences import UNKNOWN
from forestgen.scene.projection import pixel_centres

_TOLERANCE_PX = 0.02
_RELATIVE = 1e-3  # of the way, for points that fly past the camera
_GRAZING = 1e-3  # depth by distance, below which a point may or may not count as behind the camera
_SMALLER = 1.25  # times smaller in the next frame, beyond which landings are not judged
_MOST_LOST = 0.1  # share of a plant's landings, of those that nothing hides
_FEWEST = 50  # landings in an image, to speak of a share
_U, _V = "forward.u", "forward.v"


def has_motion(frame: FrameData) -> bool:
    if frame.task.following == UNKNOWN:
        return False
    return frame.has_part("motion", _U, _V) and frame.has_part("depth", "Z") and frame.has(CAMERA)


def motion(frame: FrameData) -> Iterator[Finding]:
    """Vectors land where their surface is in the next frame; there are none in a sequence's last frame."""
    vector = np.stack([frame.exr["motion"][_U], frame.exr["motion"][_V]], axis=-1).astype(np.float64)
    unknown = np.asarray(np.isnan(vector).any(axis=-1))
    if frame.following is None:
        problem = "a motion vector where no frame follows"
        yield from wrong_pixels(frame, EXR, ~unknown, problem, "NaN", vector)
        return
    following = frame.following
    try:
        camera, known = following.camera, following.has_part("identity", "centre.plant_id")
    except UnreadableError:
        return  # the next frame's own checks say so
    way, depth, slant = _by_cameras(frame, camera.position_m, following)
    behind = depth <= 0
    moves = _in_wind(frame)
    sure = (np.abs(depth) > _GRAZING * slant) & ~moves & ~_at_circle(frame, following, way)
    yield from wrong_pixels(
        frame, EXR, sure & (behind != unknown), "NaN is for points behind the next camera", "NaN there alone", vector
    )
    still = ~unknown & ~behind & sure
    off = np.sqrt(((vector - way) ** 2).sum(axis=-1))
    if following.camera.projection.wraps_x:
        turn = np.abs(np.abs(vector[..., 0] - way[..., 0]) - following.camera.size_px[0])
        off = np.minimum(off, np.hypot(turn, vector[..., 1] - way[..., 1]))  # half around: either way
    wrong = still & ~(off <= _TOLERANCE_PX + _RELATIVE * np.sqrt((way**2).sum(axis=-1)))
    yield from wrong_pixels(frame, EXR, wrong, "the motion is not that of the camera", way, vector)
    if known and following.has_part("depth", "Z"):
        here, there = frame.exr["depth"]["Z"].astype(np.float64), np.where(depth > 0, depth, np.inf)
        smaller = frame.camera.pixels_a_metre(here) > _SMALLER * following.camera.pixels_a_metre(there)
        yield from _landings(frame, following, vector, moves & ~unknown & ~smaller, depth)


def _in_wind(frame: FrameData) -> NDArray[np.bool_]:
    """(H, W) whether the centre's surface may move by itself."""
    if float(frame.recipe["wind"].get("speed_m_per_s", 0.0)) == 0.0 or not frame.has_part(
        "identity", "centre.plant_id"
    ):
        return np.zeros(frame.instance.shape, dtype=bool)
    return np.asarray(frame.exr["identity"]["centre.plant_id"] != 0)


def _by_cameras(
    frame: FrameData, next_position_m: NDArray[np.float64], following: FrameData
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """(H, W, 2) way in pixels of what stands still, (H, W) its depth in the next frame and its distance there."""
    z = frame.exr["depth"]["Z"].astype(np.float64)
    rays = frame.camera.pixel_rays(frame.size_px)
    solid = np.isfinite(z)
    shift = frame.camera.position_m - next_position_m + frame.camera.starts(frame.size_px)
    away = np.where(solid[..., None], rays * np.where(solid, z, 0.0)[..., None] + shift, rays)
    seen = away @ following.camera.rotation.T
    pixel, depth = following.camera.geometry.project(seen)
    if following.camera.projection.is_parallel:
        depth = np.where(solid, depth, -np.inf)  # parallel rays meet no direction
    depth = np.where(frame.camera.geometry.sees(frame.size_px), depth, -np.inf)
    width, height = frame.size_px
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    way = pixel - np.stack([x, y], axis=-1)
    if following.camera.projection.wraps_x:
        around = following.camera.size_px[0]
        way[..., 0] = (way[..., 0] + around / 2) % around - around / 2
    return way, depth, np.sqrt((seen**2).sum(axis=-1))


def _at_circle(frame: FrameData, following: FrameData, way: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(H, W) whether a point lands so near to a fisheye's circle that rounding decides on which side."""
    beyond_px = following.camera.geometry.beyond_rim_px(pixel_centres(frame.size_px) + way)
    if beyond_px is None:
        return np.zeros(frame.instance.shape, dtype=bool)
    return np.asarray(np.abs(beyond_px) < _TOLERANCE_PX)


def _landings(
    frame: FrameData,
    following: FrameData,
    vector: NDArray[np.float64],
    moves: NDArray[np.bool_],
    depth: NDArray[np.float64],
) -> Iterator[Finding]:
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
    for dx in (-1, 0, 1):
        for dy in (-1, 0, 1):
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
    yield from wrong_pixels(frame, EXR, wrong, problem, share, landing)
