"""A check of a frame, and one frame's files, each read once.

What cannot be read raises `UnreadableError`, which names the file and the reason.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.check.files import (
    MISUNDERSTOOD,
    Finding,
    UnreadableError,
    as_text,
    categories,
    finding,
    misunderstood,
    read_exr,
    read_json,
    read_picture,
    read_recipe,
    read_table,
)
from forestgen.dataset.safe_path import SafePath, load_json
from forestgen.recipe.registries import DEFAULT_PROJECTION
from forestgen.scene.motion import row_poses
from forestgen.scene.projection import FileGeometry, Projection, in_own_axes, load_projection, projection_of_model
from forestgen.scene.spec import Camera, CameraMotion

EXR, INSTANCE, SEMANTIC, PLANTS, CAMERA = "frame.exr", "instance.png", "semantic.png", "plants.parquet", "camera.json"
RECIPE = "recipe.yaml"
_IDENTITY_CHANNELS = ("plant_id", "part", "semantic")
_BOX = ("box_x", "box_y", "box_w", "box_h")
_PLANT_COLUMNS = ("plant_id", "species", "visible_pixels", "visible_area_px", *_BOX, "truncated")


@dataclass
class FrameData:
    """A frame's files as arrays, each read when it is first asked for; before, it can cross to another process."""

    root: Path
    name: str  # of the frame's folder
    listed: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # manifest's entries: path from root -> entry
    shared: Mapping[str, Any] = field(default_factory=dict)  # format -> what its merged files hold of this frame
    next_name: str | None = None  # folder of the sequence's next frame; None: there is none
    following: FrameData | None = field(default=None, repr=False)  # that frame

    def file(self, name: str) -> str:
        """A file of this frame, relative to the data set's folder."""
        return f"{self.name}/{name}"

    def has(self, name: str) -> bool:
        return SafePath(self.root, self.file(name)).is_file()

    def refused(self, name: str, problem: str, expected: object = "", got: object = "") -> UnreadableError:
        """The error of a file of this frame."""
        return UnreadableError(finding(problem, expected, got, file=self.file(name), image=self.name))

    @cached_property
    def _exr_read(self) -> tuple[dict[str, dict[str, NDArray[Any]]], dict[str, Any]] | UnreadableError:
        try:
            return read_exr(self.root, self.file(EXR))
        except UnreadableError as error:
            return error  # kept, since most checks ask for this file

    @property
    def _exr(self) -> tuple[dict[str, dict[str, NDArray[Any]]], dict[str, Any]]:
        if isinstance(self._exr_read, UnreadableError):
            raise self._exr_read
        return self._exr_read

    @property
    def exr_header(self) -> dict[str, Any]:
        """Attributes of frame.exr."""
        return self._exr[1]

    @property
    def exr_camera(self) -> dict[str, Any] | None:
        """The camera of frame.exr's header, if there is one."""
        try:
            camera = load_json(str(self.exr_header.get("forestgen/camera", "null")))
        except ValueError:
            return None
        return camera if isinstance(camera, dict) else None

    @cached_property
    def recipe(self) -> dict[str, Any]:
        """What the drawn recipe says of labels."""
        return read_recipe(self.root, self.file(RECIPE))

    @cached_property
    def categories(self) -> dict[int, str]:
        """plant_id -> category, by the recipe and plants.parquet; a species that no recipe has is left out."""
        _, of_species = categories(self.recipe)
        rows = zip(self.plants["plant_id"].tolist(), self.plants["species"].tolist(), strict=True)
        return {int(plant): of_species[species] for plant, species in rows if species in of_species}

    @cached_property
    def exr(self) -> dict[str, dict[str, NDArray[Any]]]:
        """Part -> channel -> (H, W), all of one size."""
        parts, _ = self._exr
        for channel in _IDENTITY_CHANNELS:
            if channel not in parts.get("identity", {}):
                raise self.refused(EXR, f"the part identity has no channel {channel}")
        shape = parts["identity"]["plant_id"].shape
        for part, channels in parts.items():
            for channel, values in channels.items():
                if values.shape != shape:
                    problem = f"the channel {part}.{channel} has another size than identity.plant_id"
                    raise self.refused(EXR, problem, _size(shape), _size(values.shape))
        return parts

    def has_part(self, part: str, *channels: str) -> bool:
        """Whether frame.exr holds these channels."""
        return all(channel in self.exr.get(part, {}) for channel in channels) and part in self.exr

    def vectors(self, part: str) -> NDArray[np.float64]:
        """(H, W, 3) of a part with channels X, Y and Z."""
        channels = self.exr[part]
        return np.stack([channels[axis] for axis in "XYZ"], axis=-1).astype(np.float64)

    @property
    def instance(self) -> NDArray[np.uint32]:
        """(H, W) frame.exr's plant_id, which all other files are held against."""
        return self.exr["identity"]["plant_id"]

    @property
    def part(self) -> NDArray[np.uint32]:
        return self.exr["identity"]["part"]

    @property
    def semantic(self) -> NDArray[np.uint32]:
        return self.exr["identity"]["semantic"]

    @property
    def size_px(self) -> tuple[int, int]:
        height, width = self.instance.shape
        return width, height

    @cached_property
    def extents(self) -> Extents:
        """Pixel count and box of each plant of the instance mask."""
        return extents_of(self.instance)

    @cached_property
    def ranks(self) -> tuple[NDArray[np.uint32], NDArray[np.float32]]:
        """(H, W, K) ids and coverages."""
        channels = self.exr["coverage"]
        count = sum(name.endswith(".id") for name in channels)
        ids = np.stack([channels[f"rank{rank}.id"] for rank in range(count)], axis=-1)
        share = np.stack([channels[f"rank{rank}.coverage"] for rank in range(count)], axis=-1)
        return ids, share

    @cached_property
    def plants(self) -> dict[str, NDArray[Any]]:
        """Columns of plants.parquet; null is NaN."""
        table = read_table(self.root, self.file(PLANTS))
        for column in _PLANT_COLUMNS:
            if column not in table:
                raise self.refused(PLANTS, f"the column {column} is missing")
        return table

    @cached_property
    def row_of(self) -> dict[int, int]:
        """plant_id -> row of plants.parquet."""
        return {int(plant): row for row, plant in enumerate(self.plants["plant_id"].tolist())}

    def known(self, column: str) -> bool:
        return column in self.plants

    @cached_property
    def camera(self) -> CameraFile:
        return camera_of(read_json(self.root, self.file(CAMERA)), self.file(CAMERA))

    def picture(self, name: str) -> NDArray[np.uint8]:
        """(H, W) or (H, W, 3) of a PNG, of the frame's size."""
        pixels = read_picture(self.root, self.file(name))
        if pixels.shape[:2] != self.instance.shape:
            raise self.refused(name, "the picture has another size", _size(self.instance.shape), _size(pixels.shape))
        return pixels


@dataclass(frozen=True)
class Extents:
    """What a mask of ids covers, ids rising, 0 left out."""

    plant_id: NDArray[np.uint32]  # (M,)
    pixels: NDArray[np.int64]  # (M,)
    box_px: NDArray[np.int64]  # (M, 4) x, y, width, height

    @cached_property
    def row_of(self) -> dict[int, int]:
        return {int(plant): row for row, plant in enumerate(self.plant_id.tolist())}


def extents_of(mask: NDArray[np.integer]) -> Extents:
    """Count pixels and find the boxes of (H, W) ids, pixel by pixel."""
    y, x = np.nonzero(mask)
    ids, index = np.unique(mask[y, x], return_inverse=True)
    low = np.full((2, len(ids)), max(mask.shape))
    high = np.full((2, len(ids)), -1)
    for axis, place in enumerate((x, y)):
        np.minimum.at(low[axis], index, place)
        np.maximum.at(high[axis], index, place)
    box = np.concatenate([low, high - low + 1]).T
    counts = np.bincount(index, minlength=len(ids))
    return Extents(ids.astype(np.uint32), counts.astype(np.int64), np.ascontiguousarray(box, dtype=np.int64))


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} x {shape[0]} pixels" if len(shape) > 1 else str(shape)


@dataclass(frozen=True)
class CameraFile:
    """camera.json, as far as checks use it."""

    geometry: FileGeometry
    camera_from_world: NDArray[np.float64]  # (4, 4)
    position_m: NDArray[np.float64]  # (3,) world
    values: Mapping[str, Any]  # all of it
    motion: CameraMotion | None = None

    @property
    def projection(self) -> Projection:
        return self.geometry.projection

    @property
    def size_px(self) -> tuple[int, int]:
        return self.geometry.size_px

    @property
    def rotation(self) -> NDArray[np.float64]:
        return self.camera_from_world[:3, :3]

    def pixel_rays(self, size_px: tuple[int, int]) -> NDArray[np.float64]:
        """(H, W, 3) world directions through the pixels' centres, of depth 1."""
        return np.asarray(self.geometry.rays(size_px) @ self.axes.swapaxes(-1, -2))

    def starts(self, size_px: tuple[int, int]) -> NDArray[np.float64]:
        """(H, W, 3) world, from the camera's place to where the pixels' rays begin."""
        return np.asarray(self.geometry.starts(size_px) @ self.axes.swapaxes(-1, -2) + self.row_shift_m)

    @property
    def axes(self) -> NDArray[np.float64]:
        """(3, 3), or (H, 3, 3) by the rows of a rolling shutter: columns are the camera's axes in the world."""
        return row_poses(self._posed)[1]

    @property
    def row_shift_m(self) -> NDArray[np.float64]:
        """(3,), or (H, 1, 3): places of the camera by row, less its own."""
        return row_poses(self._posed)[0]

    def in_own_axes(self, away_m: NDArray[np.float64], near: NDArray[np.bool_] | None = None) -> NDArray[np.float64]:
        """As `scene.projection.in_own_axes`."""
        return in_own_axes(self._posed, away_m, near)

    @property
    def _posed(self) -> Camera:
        return replace(self.geometry.camera, world_from_camera=self.rotation.T, motion=self.motion)

    def pixels_a_metre(self, depth_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """How large things appear at a depth."""
        away = np.ones_like(depth_m) if self.projection.is_parallel else depth_m
        return np.asarray(self.geometry.focal_px[0] / away)


def camera_of(values: Any, file: str) -> CameraFile:
    """Read camera.json's fields; what is missing or no matrix raises `UnreadableError`."""
    try:
        size = [int(side) for side in values["size_px"]]
        pose = _matrix(values["camera_from_world"], (4, 4))
        position = _matrix(values["position_m"], (3,))
        model = values.get("model", load_projection(DEFAULT_PROJECTION).model)
        projection = projection_of_model(str(model))
        if len(size) != 2 or min(size) < 1 or projection is None:
            raise ValueError("size_px is not a pair, or there is no projection of this model")
        geometry, motion = projection.read(values, (size[0], size[1])), _motion(values.get("motion"))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        expected = "size_px, camera_from_world (4 x 4), position_m, and what the model needs, finite numbers"
        got = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise UnreadableError(Finding(file, "the camera cannot be understood", expected, got)) from error
    return CameraFile(geometry, pose, position, values, motion)


def _motion(values: Any) -> CameraMotion | None:
    if values is None:
        return None
    x, y, z = _matrix(values["velocity_m_per_s"], (3,)).tolist()
    pitch, yaw, roll = np.radians(_matrix(values["rotation_deg_per_s"], (3,))).tolist()
    return CameraMotion((x, y, z), (pitch, yaw, roll), float(_matrix(values["readout_s"], ())))


def _matrix(values: Sequence[Any], shape: tuple[int, ...]) -> NDArray[np.float64]:
    matrix = np.asarray(values, dtype=np.float64)
    if matrix.shape != shape or not np.isfinite(matrix).all():
        raise ValueError(f"expected {shape} finite numbers")
    return matrix


class Wrong(NamedTuple):
    """Pixels of a frame or rows of its plants.parquet that are wrong: the values are reported where `at` is true."""

    at: Any  # bool: (H, W) pixels, or (N,) rows
    problem: str  # one sentence
    expected: NDArray[Any] | str = ""  # (H, W, ...) or (N, ...), or a text for all
    got: NDArray[Any] | str = ""
    file: str = ""  # of the frame's folder; "": the check's

    def findings(self, frame: FrameData) -> Iterator[Finding]:
        """One for each wrong row; of wrong pixels one for each plant of the mask, at the first of them."""
        file = frame.file(self.file) if self.file else ""
        if self.at.ndim == 1:
            for row in np.flatnonzero(self.at).tolist():
                plant = int(frame.plants["plant_id"][row])
                expected, got = self._values(row)
                yield finding(self.problem, expected, got, plant, file=file)
            return
        for x, y, count in first_of_each(self.at, frame.instance):
            more = f" ({count:,} such pixels)" if count > 1 else ""
            plant_id = int(frame.instance[y, x]) or None
            expected, got = self._values((y, x))
            yield finding(self.problem + more, expected, got, plant_id, pixel=(x, y), file=file)

    def _values(self, place: Any) -> Iterator[str]:
        """What was expected and found at an index of `at`."""
        return (one if isinstance(one, str) else as_text(one[place]) for one in (self.expected, self.got))


def first_of_each(wrong: NDArray[np.bool_], ids: NDArray[np.integer]) -> list[tuple[int, int, int]]:
    """x, y of the first true pixel of each id, and how many it has; row by row."""
    at = np.flatnonzero(wrong)
    _, first, counts = np.unique(ids.ravel()[at], return_index=True, return_counts=True)
    order = np.argsort(first)
    y, x = np.divmod(at[first[order]], wrong.shape[1])
    return list(zip(x.tolist(), y.tolist(), counts[order].tolist(), strict=True))


@dataclass(frozen=True)
class FrameCheck:
    """An invariant of one image."""

    name: str
    file: str  # that it is about, inside the frame's folder or, if `shared`, in the data set's
    applies: Callable[[FrameData], bool]  # whether the files that it reads are there
    find: Callable[[FrameData], Iterator[Finding | Wrong]]
    shared: bool = False

    def findings(self, frame: FrameData) -> Iterator[Finding]:
        """What is wrong with a frame."""
        several = (one.findings(frame) if isinstance(one, Wrong) else [one] for one in self.find(frame))
        file = self.file if self.shared else frame.file(self.file).rstrip("/")
        return completed(chain.from_iterable(several), self.name, file, frame.name)


def completed(found: Iterable[Finding], check: str, file: str, image: str = "") -> Iterator[Finding]:
    """A check's findings, with its name and file; content that cannot be understood is the last one."""
    try:
        for one in found:
            yield replace(one, check=check, file=one.file or file, image=one.image or image)
    except UnreadableError as error:
        yield replace(error.finding, check=check, image=error.finding.image or image)
    except MISUNDERSTOOD as error:
        yield replace(misunderstood(file, error, image), check=check)


def frame_check(
    name: str,
    file: str,
    *,
    files: Sequence[str] = (),
    exr: Sequence[str] = (),
    columns: Sequence[str] = (),
    share: str = "",
    when: Callable[[FrameData], bool] | None = None,
    shared: bool = False,
) -> Callable[[Callable[[FrameData], Iterator[Finding | Wrong]]], FrameCheck]:
    """Turn a function into a `FrameCheck` of frames that have all it needs.

    Parameters
    ----------
    files : of the frame's folder.
    exr : parts of frame.exr with their channels, such as "depth Z".
    columns : of plants.parquet.
    share : a format, whose merged files hold something of the frame.
    when : a further condition.
    """

    def applies(frame: FrameData) -> bool:
        return (
            (not share or share in frame.shared)
            and all(map(frame.has, files))
            and all(frame.has_part(*one.split()) for one in exr)
            and all(map(frame.known, columns))
            and (when is None or when(frame))
        )

    return lambda find: FrameCheck(name, file, applies, find, shared)
