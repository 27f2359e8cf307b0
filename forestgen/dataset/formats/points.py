"""Point cloud of a frame: FRAME/points.ply and FRAME/points.laz, the surfaces that its pixels' centres see.

Every `dataset.point_stride`-th pixel of every such row is a point, from the image's upper left corner on; the sky is
none. Both files hold the same points in the same order, row by row of the image.

| points.ply         | points.laz       | what it is                                                          |
|--------------------|------------------|---------------------------------------------------------------------|
| x y z              | X Y Z            | world, metres: x east, y north, z up; double, and steps of 0.1 mm   |
| nx ny nz           |                  | geometric normal, world, unit, towards the camera; float            |
| red green blue     | red green blue   | of preview.png, 8 bits; LAZ has 16: 257 times that                  |
| plant_id           | plant_id         | uint32; 0: ground                                                   |
| part               | part             | uint8, number of the part: 1 ground, 2 trunk, ..., 4 leaf           |
| species            | species          | uint16, number of the species in the recipe, from 1; 0: no plant    |
| row column         |                  | uint16, the pixel                                                   |
|                    | classification   | ASPRS: below                                                        |
|                    | gps_time         | time_s of the camera                                                |

What is of a plant is that of the centre's ray, as `identity.centre` of frame.exr, not that of the instance mask.

**Classification** (LAS 1.4, table 17): 2 ground, litter and rock; 6 buildings; 9 water; plants by the height of the
point above its own plant's stem base: 3 low vegetation up to 0.3 m, 4 medium up to 2 m, 5 high above that. The
standard names no heights; these are the Australian ones (ICSM). They count from the stem base, not from the ground
straight below.

LAZ coordinates are 32-bit steps of 0.1 mm from whole metres near the cloud's lowest corner. A cloud that reaches
further than 214 km would overflow them: its steps are 10 times as large, as often as is needed. Neither file holds a
date. A frame of sky alone gives files of no points, which are valid.

References
----------
ASPRS, "LAS specification 1.4 - R15", 2019, table 17.
ICSM, "LiDAR acquisition specifications and tender template", 2010, table of classification levels.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.dataset.files import write_bytes
from forestgen.dataset.formats.format import DatasetFormat
from forestgen.dataset.settings import DatasetSettings
from forestgen.dataset.tonemap import preview_of
from forestgen.labels.labelled import LabelledFrame
from forestgen.labels.masks import rows_of
from forestgen.recipe.dataset import View

PLY_NAME, LAZ_NAME = "points.ply", "points.laz"
FINEST_STEP_M = 1e-4
LOW_M, MEDIUM_M = 0.3, 2.0  # up to which vegetation is low, and medium
UNCLASSIFIED, GROUND, LOW, MEDIUM, HIGH, BUILDING, WATER = 1, 2, 3, 4, 5, 6, 9  # ASPRS

_PLY_TYPES = {"<f8": "double", "<f4": "float", "u1": "uchar", "<u2": "ushort", "<u4": "uint"}
_FIELDS = [
    *((name, "<f8") for name in ("x", "y", "z")),
    *((name, "<f4") for name in ("nx", "ny", "nz")),
    *((name, "u1") for name in ("red", "green", "blue")),
    ("plant_id", "<u4"),
    ("part", "u1"),
    ("species", "<u2"),
    ("row", "<u2"),
    ("column", "<u2"),
]
_MOST_STEPS = 2**31 - 1
_DATE = slice(90, 94)  # day and year in the header of LAS 1.4, table 3


@dataclass(frozen=True)
class Points:
    """Points of one frame."""

    vertices: NDArray[Any]  # (P,) records of `_FIELDS`
    classification: NDArray[np.uint8]  # (P,) ASPRS
    time_s: float


class PointClouds(DatasetFormat):
    """The surfaces that pixels see as PLY and LAZ."""

    name = "points"
    check_module = "forestgen.dataset.check.points"
    bytes_per_pixel = 93

    def write_frame(self, folder: Path, labelled: LabelledFrame, settings: DatasetSettings) -> None:
        """Write a frame's points; a failure raises `OutputError`."""
        points = frame_points(labelled, settings.point_stride, settings.view)
        write_bytes(folder / PLY_NAME, ply_bytes(points))
        write_bytes(folder / LAZ_NAME, laz_bytes(points))


FORMAT = PointClouds()


def frame_points(labelled: LabelledFrame, stride: int, view: View = "filmic") -> Points:
    """The points that a frame's pixels see, each `stride`-th of each `stride`-th row; colours are the preview's."""
    frame, surface = labelled.frame, labelled.frame.surface
    seen = np.zeros(surface.part.shape, dtype=bool)
    seen[::stride, ::stride] = surface.part[::stride, ::stride] != Part.NOTHING
    kept = np.flatnonzero(seen)
    vertices = np.zeros(len(kept), dtype=_FIELDS)
    for names, values in (
        (("x", "y", "z"), surface.position_m),
        (("nx", "ny", "nz"), surface.normal),
        (("red", "green", "blue"), preview_of(frame.radiance, view).picture),
    ):
        for name, column in zip(names, values.reshape(-1, 3)[kept].T, strict=True):
            vertices[name] = column
    vertices["plant_id"], vertices["part"] = surface.plant_id.ravel()[kept], surface.part.ravel()[kept]
    vertices["row"], vertices["column"] = np.divmod(kept, frame.camera.size_px[0])
    is_plant = vertices["plant_id"] != 0
    row = rows_of(vertices["plant_id"][is_plant], labelled.population.plant_id)
    vertices["species"][is_plant] = labelled.species[row] + 1
    height = vertices["z"][is_plant] - labelled.measures.stem_base_m[row, 2]
    classification = np.where(vertices["part"] == Part.WATER, WATER, GROUND).astype(np.uint8)
    classification[is_plant] = np.select([height <= LOW_M, height <= MEDIUM_M], [LOW, MEDIUM], HIGH)
    classification[vertices["part"] == Part.STRUCTURE] = BUILDING
    classification[vertices["part"] == Part.SURROUNDINGS] = UNCLASSIFIED
    return Points(vertices, classification, frame.camera.time_s)


def ply_bytes(points: Points) -> bytes:
    """Binary PLY, little endian."""
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        "comment world frame, metres: x east, y north, z up",
        f"element vertex {len(points.vertices)}",
        *(f"property {_PLY_TYPES[kind]} {name}" for name, kind in _FIELDS),
        "end_header\n",
    ]
    return "\n".join(lines).encode() + points.vertices.tobytes()


def laz_bytes(points: Points) -> bytes:
    """LAZ 1.4, point format 7, with extra dimensions plant_id, part and species."""
    import laspy

    position_m = np.stack([points.vertices[axis] for axis in "xyz"], axis=1)
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.system_identifier, header.generating_software = "", "forestgen"
    header.offsets, step_m = _grid(position_m)
    header.scales = np.full(3, step_m)
    header.add_extra_dims(
        [
            laspy.ExtraBytesParams("plant_id", "uint32", "key of plants.parquet; 0: none"),
            laspy.ExtraBytesParams("part", "uint8", "1 ground, 2 trunk, ..., 4 leaf"),
            laspy.ExtraBytesParams("species", "uint16", "of the recipe, from 1; 0: none"),
        ]
    )
    cloud = laspy.LasData(header, laspy.ScaleAwarePointRecord.zeros(len(position_m), header=header))
    cloud.X, cloud.Y, cloud.Z = np.rint((position_m - header.offsets) / step_m).astype(np.int32).T
    for colour in ("red", "green", "blue"):
        cloud[colour] = points.vertices[colour].astype(np.uint16) * 257
    for name in ("plant_id", "part", "species"):
        cloud[name] = points.vertices[name]
    cloud.classification = points.classification
    cloud.gps_time = np.full(len(position_m), points.time_s)
    cloud.return_number = cloud.number_of_returns = np.ones(len(position_m), dtype=np.uint8)
    buffer = io.BytesIO()
    cloud.write(buffer, do_compress=True, laz_backend=laspy.LazBackend.Lazrs)
    content = bytearray(buffer.getvalue())
    content[_DATE] = bytes(4)  # laspy would write today's
    return bytes(content)


def _grid(position_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Offset (3,) in whole metres, and the step."""
    if len(position_m) == 0:
        return np.zeros(3), FINEST_STEP_M
    offset = np.floor(position_m.min(axis=0))
    step_m = FINEST_STEP_M
    while (position_m.max(axis=0) - offset).max() / step_m > _MOST_STEPS:
        step_m *= 10.0
    return offset, step_m
