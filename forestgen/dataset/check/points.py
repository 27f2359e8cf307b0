"""points.ply and points.laz: points of frame.exr's surfaces, with ids that plants.parquet holds."""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.check.files import Finding, finding, read_bytes, unreadable
from forestgen.dataset.check.frame_data import FrameData, frame_check
from forestgen.dataset.safe_path import SafePath

_PLY, _LAZ = "points.ply", "points.laz"
_TYPES = {"double": "<f8", "float": "<f4", "uchar": "u1", "ushort": "<u2", "uint": "<u4"}
_RELATIVE = 1e-5
_LAZ_M = 1e-3
_END = b"end_header\n"


@frame_check("points.ply", _PLY, files=(_PLY,))
def ply(frame: FrameData) -> Iterator[Finding]:
    """Each point is its pixel's: position, plant and part of the centre's ray."""
    found = read_ply(frame)
    known = frame.plants["plant_id"]
    plant = found["plant_id"]
    strange = (plant != 0) & ~np.isin(plant, known)
    if strange.any():
        yield from _first(found, strange, "the plant is not in plants.parquet", "a row of it", "none")
        return
    row, column = found["row"].astype(np.int64), found["column"].astype(np.int64)
    width, height = frame.size_px
    if len(found) and (row.max() >= height or column.max() >= width):
        at = int(np.argmax((row >= height) | (column >= width)))
        got = f"row {row[at]}, column {column[at]}"
        yield finding(f"point {at} is outside the image", f"{width} x {height}", got)
        return
    yield from _count(frame, row, column)
    for name, channel in (("plant_id", "centre.plant_id"), ("part", "centre.part")):
        if frame.has_part("identity", channel):
            truth = frame.exr["identity"][channel][row, column]
            problem = f"{name} is not frame.exr's {channel}"
            yield from _first(found, truth != found[name], problem, truth, found[name])
    place = np.stack([found[axis] for axis in "xyz"], axis=-1)
    if frame.has_part("position", *"XYZ"):
        truth = frame.vectors("position")[row, column]
        scale = np.maximum(np.abs(truth).max(axis=-1), 1.0)
        wrong = ~(np.abs(place - truth).max(axis=-1) <= _RELATIVE * scale) if len(found) else np.zeros(0, dtype=bool)
        yield from _first(found, wrong, "the point is not at frame.exr's position", truth, place)
    names = np.array(["", *frame.recipe["species"]], dtype=object)
    own = np.full(len(found), "", dtype=object)
    own[plant != 0] = frame.plants["species"][np.searchsorted(known, plant[plant != 0])]
    got = names[np.minimum(found["species"], len(names) - 1)]
    wrong = (got != own) | (found["species"] >= len(names))
    yield from _first(found, wrong, "the species is not the plant's", own, got)


@frame_check("points.laz", _LAZ, files=(_LAZ, _PLY))
def laz(frame: FrameData) -> Iterator[Finding]:
    """points.laz holds the points of points.ply, in their order."""
    import laspy

    content = read_bytes(frame.root, frame.file(_LAZ))
    try:
        with laspy.open(io.BytesIO(content)) as reader:
            if reader.header.point_count > frame.instance.size:  # before memory is taken for them
                raise ValueError(f"{reader.header.point_count:,} points of {frame.instance.size:,} pixels")
            cloud = reader.read()
        plant, place = np.asarray(cloud["plant_id"]), np.asarray(cloud.xyz)
    except Exception as error:  # its two backends raise their own kinds, and struct's and NumPy's
        raise unreadable(SafePath(frame.root, frame.file(_LAZ)), error) from error
    found = read_ply(frame)
    if len(plant) != len(found):
        yield finding("there are not as many points as in points.ply", len(found), len(plant))
        return
    truth = found["plant_id"]
    yield from _first(found, truth != plant, "plant_id is not points.ply's", truth, plant)
    there = np.stack([found[axis] for axis in "xyz"], axis=-1)
    wrong = ~(np.abs(there - place).max(axis=-1, initial=0.0) <= _LAZ_M)
    yield from _first(found, wrong, "the point is not points.ply's", there, place)


def read_ply(frame: FrameData) -> NDArray[Any]:
    """(P,) records of a binary PLY."""
    content = read_bytes(frame.root, frame.file(_PLY))
    end = content.find(_END)
    lines = content[: max(end, 0)].decode("ascii", errors="replace").splitlines()
    try:
        if end < 0 or lines[:2] != ["ply", "format binary_little_endian 1.0"]:
            raise ValueError("no binary PLY")
        count = next(int(line.split()[2]) for line in lines if line.startswith("element vertex"))
        words = [line.split() for line in lines if line.startswith("property ")]
        kind = np.dtype([(word[2], _TYPES[word[1]]) for word in words])
        body = content[end + len(_END) :]
        if len(body) != count * kind.itemsize:
            raise ValueError(f"{len(body)} bytes of points where {count * kind.itemsize} belong: cut short?")
        return np.frombuffer(body, dtype=kind, count=count)
    except (ValueError, KeyError, IndexError, StopIteration) as error:
        raise frame.refused(_PLY, "the file cannot be read", "binary PLY", error) from error


def _count(frame: FrameData, row: NDArray[np.int64], column: NDArray[np.int64]) -> Iterator[Finding]:
    """Every n-th pixel of every n-th row is a point, once, if it is not the sky."""
    if not frame.has_part("depth", "Z"):
        return
    stride = int(frame.recipe["dataset"].get("point_stride", 1))
    solid = ~np.isinf(frame.exr["depth"]["Z"])
    expected = np.zeros(solid.shape, dtype=np.int64)
    expected[::stride, ::stride] = solid[::stride, ::stride]
    got = np.zeros(solid.shape, dtype=np.int64)
    np.add.at(got, (row, column), 1)
    if (got != expected).any():
        y, x = np.argwhere(got != expected)[0].tolist()
        yield finding("the pixel has not its point", expected[y, x], got[y, x], pixel=(x, y))


def _first(found: NDArray[Any], wrong: Any, problem: str, truth: Any, got: Any) -> Iterator[Finding]:
    """Of each plant's wrong points the first one, with its values or the text of all."""
    wrong_rows = np.flatnonzero(wrong)
    _, first = np.unique(found["plant_id"][wrong_rows], return_index=True)
    for at in sorted(wrong_rows[first].tolist()):
        expected, stored = (one if isinstance(one, str) else one[at] for one in (truth, got))
        plant, pixel = int(found["plant_id"][at]) or None, (int(found["column"][at]), int(found["row"][at]))
        yield finding(f"point {at}: {problem}", expected, stored, plant, pixel=pixel)


FRAME_CHECKS = (ply, laz)
