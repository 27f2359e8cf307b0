"""Amodal counts: which samples of the image hit a plant when it stands alone.

Each exemplar has a scene of its own, in which it stands unmoved, and each plant's rays are brought into the exemplar's
frame. So all plants of an exemplar are traced in one launch, and the number of scenes is that of exemplars. Rays run
only through the pixels that the plant's projected hull can touch: `outlines`.

A sample that hits a plant in the identity pass must hit it here. The rays of the two passes are equal to the last bit
because the frames change as Embree changes them for an instance: the inverse is the adjoint over the determinant in
single precision, each operation rounded; rays are then transformed with fused multiply-adds. Tests in tests/system
compare distances and barycentric coordinates bit by bit. OptiX does not tell how it transforms rays: on CUDA, samples
within rounding error of an edge may differ.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Hull, hull_of
from forestgen.plants.exemplar import Exemplar
from forestgen.render.build import load, to_mesh
from forestgen.render.frame import Amodal
from forestgen.render.identity.tracer import SceneTracer, pixel_rays, sample_offsets
from forestgen.render.variant import dr, mi, on_device, using
from forestgen.scene.motion import is_rolling, row_times_s, still_at
from forestgen.scene.projection import projection_of
from forestgen.scene.spec import Camera

Floats = NDArray[np.float64]
BEYOND = 16  # image sizes: as far as a box may reach
_POINTS_AT_ONCE = 1 << 19  # scratch memory stays near 30 MB
_RAYS_AT_ONCE = 1 << 21  # of a launch: about 100 bytes each
_PIXELS_AT_ONCE = 1 << 23  # of windows that wait to be cut to their hits: 2 bytes each
_BANDS = 10  # of rows, under a rolling shutter
_TRIANGLES_KEPT = 4_000_000  # in scenes that wait for the next camera: about 0.6 GB


@dataclass(frozen=True)
class Outlines:
    """One row an instance."""

    window_px: NDArray[np.int32]  # (N, 4) x, y, width, height: pixels of the image that it can touch; 0 where none
    full_box_px: NDArray[np.float64]  # (N, 4) left, top, right, bottom of its projection; NaN: nothing is in front


def outlines(hull: Hull, transform: NDArray[np.float64], camera: Camera) -> Outlines:
    """Project the hull of one exemplar for each of its instances, by their (N, 3, 4) transforms to the world."""
    box, reached = np.full((2, len(transform), 4), np.nan)
    anywhere = np.zeros(len(transform), dtype=np.bool_)
    boxes_of = _boxes_by_bands if is_rolling(camera) else _boxes
    step = max(1, _POINTS_AT_ONCE // max(1, len(hull.vertices_m)))
    for first in range(0, len(transform) if len(hull.vertices_m) else 0, step):
        rows = slice(first, first + step)
        box[rows], reached[rows], anywhere[rows] = boxes_of(hull, transform[rows], camera)
    # A leaf before the lens would reach to infinity, and leave nothing else of `truncation`.
    limit = BEYOND * np.tile(np.asarray(camera.size_px, dtype=np.float64), 2)
    return Outlines(_windows(reached, anywhere, camera.size_px), np.clip(box, -limit, limit))


def _boxes(hull: Hull, transform: Floats, camera: Camera) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """(N, 4) boxes; what they may touch; and (N,) which of them may be seen anywhere."""
    seen = _in_camera(hull.vertices_m, transform, camera)
    box, anywhere = projection_of(camera).hull_boxes(camera, seen, hull.edges)
    return box, box, anywhere


def _boxes_by_bands(hull: Hull, transform: Floats, camera: Camera) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """The same under a rolling shutter: what each band of rows holds of the box at its own time.

    A box may touch where it is at any time, and as far beyond as it moves from band to band.
    """
    edges = np.linspace(0.0, camera.size_px[1], _BANDS + 1)
    box, reached = np.full((2, len(transform), 4), np.nan)
    anywhere, before = np.zeros(len(transform), dtype=np.bool_), None
    edges[0], edges[-1] = -np.inf, np.inf
    for top, bottom, time in zip(edges, edges[1:], _band_times(camera), strict=False):
        at, _, all_over = _boxes(hull, transform, still_at(camera, time))
        anywhere |= all_over
        step = np.zeros_like(at) if before is None else np.nan_to_num(np.abs(at - before))
        if before is not None:
            anywhere |= np.isnan(at).any(axis=1) != np.isnan(before).any(axis=1)
        before = at
        low, high = np.fmin(reached[:, :2], (at - step)[:, :2]), np.fmax(reached[:, 2:], (at + step)[:, 2:])
        reached = np.concatenate([low, high], axis=1)
        cut = np.column_stack([at[:, 0], np.maximum(at[:, 1], top), at[:, 2], np.minimum(at[:, 3], bottom)])
        cut[~(cut[:, 3] >= cut[:, 1])] = np.nan
        box = np.concatenate([np.fmin(box[:, :2], cut[:, :2]), np.fmax(box[:, 2:], cut[:, 2:])], axis=1)
    return box, reached, anywhere


def _band_times(camera: Camera) -> Floats:
    return row_times_s(camera, (np.arange(_BANDS) + 0.5) * camera.size_px[1] / _BANDS)


def _in_camera(points_m: NDArray[np.float64], transform: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    """(N, V, 3) points of each instance along the camera's axes, metres."""
    axes = camera.world_from_camera
    linear = np.einsum("ji,njk->nik", axes, transform[:, :, :3])
    place = (transform[:, :, 3] - np.asarray(camera.position_m)) @ axes
    return np.asarray(points_m @ linear.transpose(0, 2, 1) + place[:, None, :])


def _windows(box: NDArray[np.float64], anywhere: NDArray[np.bool_], size_px: tuple[int, int]) -> NDArray[np.int32]:
    """Pixels that boxes touch, one more on each side since directions are rounded to single precision."""
    size = np.asarray(size_px, dtype=np.float64)
    inside = np.where(np.isnan(box), 0.0, box)
    low = np.clip(np.floor(inside[:, :2]) - 1, 0, size)
    high = np.clip(np.ceil(inside[:, 2:]) + 1, 0, size)
    low, high = np.where(anywhere[:, None], 0.0, low), np.where(anywhere[:, None], size, high)
    shown = (high > low).all(axis=1) & (anywhere | ~np.isnan(box[:, 0]))
    window = np.concatenate([low, high - low], axis=1)
    return np.where(shown[:, None], window, 0).astype(np.int32)


def alone_scene(exemplar: Exemplar) -> Any:
    """A scene of the current variant that holds one exemplar in its own frame.

    It is an instance that is not moved, which changes no bit: a group's tree is built three times as fast as a
    scene's, and it is the identity pass' own.
    """
    meshes = {f"organ-{k:02d}": to_mesh(organ.mesh, name=f"organ-{k}") for k, organ in enumerate(exemplar.organs)}
    instance = {"type": "instance", "exemplar": {"type": "ref", "id": "group"}}
    return load({"group": {"type": "shapegroup", **meshes}, "instance": instance})


# Of a tracer: hulls, and scenes that hold one exemplar each, kept for the next camera.
_kept: WeakKeyDictionary[SceneTracer, tuple[dict[int, Hull], dict[int, Any]]] = WeakKeyDictionary()


def _alone(tracer: SceneTracer, number: int) -> Any:
    """The scene of one exemplar."""
    exemplars, scenes = tracer.spec.exemplars, _kept[tracer][1]
    if number in scenes:
        return scenes[number]
    scene = alone_scene(exemplars[number])
    if sum(exemplars[one].triangles for one in (*scenes, number)) <= _TRIANGLES_KEPT:
        scenes[number] = scene
    return scene


def trace_amodal(
    tracer: SceneTracer,
    camera: Camera,
    plant_ids: NDArray[np.uint32],
    *,
    samples: int,
    timer: Callable[[str], Any],
    advance: Callable[[int], None],
) -> Amodal:
    """Count, pixel by pixel, the samples that hit each plant when nothing else is there.

    Time O(pixels of all windows x samples x log triangles). Memory: 2 bytes a pixel of the windows, cut to their hits,
    twice; some 250 MB for the rays and pixels in work; and the scenes of exemplars that were asked for, of
    4 million triangles at most. ValueError: the scene holds no such plant, or several instances of one; or no such
    number of samples.

    Parameters
    ----------
    plant_ids : (M,) uint32 in any order, those that the identity pass saw.
    samples : a pixel; a perfect square, at most 1024.
    timer, advance : book time under a name, and count plants that are done.
    """
    if not 0 < samples <= 1024:
        raise ValueError(f"samples must be 1 to 1024, got {samples}")
    ids = np.unique(np.asarray(plant_ids, dtype=np.uint32))
    rows = tracer.spec.instances.rows_of(ids)
    exemplar = tracer.spec.instances.exemplar[rows]
    hulls, _ = _kept.setdefault(tracer, ({}, {}))
    offsets = sample_offsets(samples)
    window, box = np.zeros((len(ids), 4), dtype=np.int32), np.full((len(ids), 4), np.nan)
    parts: list[tuple[NDArray[np.int64], NDArray[np.uint16]]] = []
    with using(tracer.variant):
        for number in np.unique(exemplar).tolist():
            members = np.flatnonzero(exemplar == number)
            with timer("amodal: outlines"):
                if number not in hulls:
                    hulls[number] = hull_of([organ.mesh for organ in tracer.spec.exemplars[number].organs])
                found = outlines(hulls[number], tracer.spec.instances.transform[rows[members]], camera)
            window[members], box[members] = found.window_px, found.full_box_px
            with timer("amodal: build"):
                scene = _alone(tracer, number)
            with timer("amodal: trace"):
                for chunk in _chunks(members, window):
                    counts = _trace(scene, tracer, camera, rows[chunk], window[chunk], offsets)
                    window[chunk], counts = _cut_to_hits(window[chunk], counts)
                    parts.append((chunk, counts))
                    advance(len(chunk))
        dr.flush_malloc_cache()
    first, hits = _in_order(window, parts)
    return Amodal(plant_id=ids, samples=samples, window_px=window, first=first, hits=hits, full_box_px=box)


def _chunks(members: NDArray[np.intp], window: NDArray[np.int32]) -> list[NDArray[np.intp]]:
    """Members, a few at a time: as many as have `_PIXELS_AT_ONCE` pixels, and at least one."""
    pixels = np.cumsum(window[members, 2].astype(np.int64) * window[members, 3])
    chunks, start, before = [], 0, 0
    while start < len(members):
        end = max(int(np.searchsorted(pixels, before + _PIXELS_AT_ONCE, "right")), start + 1)
        chunks.append(members[start:end])
        start, before = end, int(pixels[end - 1])
    return chunks


def _first(window: NDArray[np.int32]) -> NDArray[np.int64]:
    """(M + 1,) where each window's pixels begin."""
    return np.concatenate([[0], np.cumsum(window[:, 2].astype(np.int64) * window[:, 3])]).astype(np.int64)


def frames_of_plants(transform: NDArray[np.float64], origin_m: NDArray[np.float64]) -> NDArray[np.float32]:
    """(N, 12) plant's frame <- world shifted to `origin_m`: three columns of the linear part, then the shift.

    As Embree 3 inverts an instance's transform: adjoint over determinant in single precision, nothing fused.
    """
    matrix = transform.copy()
    matrix[:, :, 3] -= origin_m
    x, y, z, place = (list(matrix[:, :, k].T.astype(np.float32)) for k in range(4))
    rows = [_cross(y, z), _cross(z, x), _cross(x, y)]
    with np.errstate(all="ignore"):
        determinant = (x[0] * rows[0][0] + x[1] * rows[0][1]) + x[2] * rows[0][2]
        columns = [[rows[k][axis] / determinant for k in range(3)] for axis in range(3)]
        shift = [-(place[0] * columns[0][k] + (place[1] * columns[1][k] + place[2] * columns[2][k])) for k in range(3)]
    return np.stack([*columns[0], *columns[1], *columns[2], *shift], axis=1)


def _cross(a: list[NDArray[np.float32]], b: list[NDArray[np.float32]]) -> list[NDArray[np.float32]]:
    return [a[i] * b[j] - a[j] * b[i] for i, j in ((1, 2), (2, 0), (0, 1))]


def _trace(
    scene: Any,
    tracer: SceneTracer,
    camera: Camera,
    rows: NDArray[np.intp],
    window: NDArray[np.int32],
    offsets: NDArray[np.float64],
) -> NDArray[np.uint16]:
    """Counts of the windows of plants of one exemplar, one window after another."""
    samples = len(offsets)
    first = _first(window)
    counts = np.zeros(first[-1], dtype=np.uint16)
    frame = mi.Float(frames_of_plants(tracer.spec.instances.transform[rows], tracer.origin_m).ravel())
    step = max(1, _RAYS_AT_ONCE // samples)
    for start in range(0, len(counts), step):
        index = np.arange(start, min(start + step, len(counts)))
        plant = np.searchsorted(first, index, side="right") - 1
        left, top, width, _ = window[plant].T
        row, column = np.divmod(index - first[plant], width)
        pixels = (one.astype(np.uint32) for one in (plant, left + column, top + row))
        ray, active = alone_rays(tracer, camera, offsets, frame, *pixels)
        hit = scene.ray_intersect_preliminary(ray, coherent=True, active=active)
        counts[start : start + step] = np.array(
            dr.block_sum(dr.select(hit.is_valid() & active, mi.UInt32(1), 0), samples)
        )
    return counts


def alone_rays(
    tracer: SceneTracer,
    camera: Camera,
    offsets: NDArray[np.float64],
    frame: Any,
    plant: NDArray[np.uint32],
    column: NDArray[np.uint32],
    row: NDArray[np.uint32],
) -> tuple[Any, Any]:
    """The identity pass' rays through S positions of pixels, each in its plant's frame; and which of them there are.

    `frame` is a device array of `frames_of_plants`, `plant` (P,) its rows.
    """
    samples = len(offsets)
    index = dr.arange(mi.UInt32, len(plant) * samples)
    pixel = index // samples
    number = index - pixel * samples
    rays = pixel_rays(
        camera,
        dr.gather(mi.UInt32, on_device(mi.UInt32, column), pixel),
        dr.gather(mi.UInt32, on_device(mi.UInt32, row), pixel),
        dr.gather(mi.Float, on_device(mi.Float, offsets[:, 0]), number),
        dr.gather(mi.Float, on_device(mi.Float, offsets[:, 1]), number),
        number,
    )
    start, direction = tracer.start_of(camera, rays), rays.direction
    first = dr.gather(mi.UInt32, on_device(mi.UInt32, plant), pixel) * 12
    m = [dr.gather(mi.Float, frame, first + k) for k in range(12)]
    # As Embree does: fused, from the last coordinate on.
    origin = [dr.fma(start.x, m[k], dr.fma(start.y, m[3 + k], dr.fma(start.z, m[6 + k], m[9 + k]))) for k in range(3)]
    along = [dr.fma(direction.x, m[k], dr.fma(direction.y, m[3 + k], direction.z * m[6 + k])) for k in range(3)]
    active = mi.Bool(True) if rays.valid is None else rays.valid
    return mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*along)), active


def _cut_to_hits(window: NDArray[np.int32], counts: NDArray[np.uint16]) -> tuple[NDArray[np.int32], NDArray[np.uint16]]:
    """Windows without their empty borders, and the counts of what is left; 0 where nothing is hit."""
    tight, kept, start = np.zeros_like(window), [counts[:0]], 0
    for row, (left, top, width, height) in enumerate(window.tolist()):
        pixels = counts[start : start + width * height].reshape(height, width)
        start += width * height
        rows, columns = (np.flatnonzero(pixels.any(axis=axis)) for axis in (1, 0))
        if len(rows):
            part = pixels[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
            tight[row] = left + columns[0], top + rows[0], part.shape[1], part.shape[0]
            kept.append(part.ravel())
    return tight, np.concatenate(kept)


def _in_order(
    window: NDArray[np.int32], parts: list[tuple[NDArray[np.intp], NDArray[np.uint16]]]
) -> tuple[NDArray[np.int64], NDArray[np.uint16]]:
    """Counts of all plants in the windows' order, and where each plant's begin."""
    first = _first(window)
    hits = np.zeros(first[-1], dtype=np.uint16)
    while parts:
        members, counts = parts.pop()
        start = 0
        for member in members.tolist():
            size = first[member + 1] - first[member]
            hits[first[member] : first[member + 1]] = counts[start : start + size]
            start += size
    return first, hits
