"""Skeletal graphs as files.

==============  ====================================================================================================
suffix          content
==============  ====================================================================================================
.parquet .csv   one row a node: plant, module, node, parent, x_m, y_m, z_m, diameter_m, age, order, axis, is_main
.gltf .glb      a node and a mesh of lines a plant, y up; attributes _DIAMETER and _AGE of the vertices
.obj            a group a plant, a polyline an axis; z up, no diameters
.usda .usdc     linear BasisCurves a plant, a curve an axis, with widths and the primvar physiologicalAge; z up
==============  ====================================================================================================

All are in metres. The same graph gives the same bytes. `parent` counts the file's rows from 0; -1 is a plant's root.
"""

from __future__ import annotations

import base64
import io
import json
import struct
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.geometry import SkeletalGraph
from forestgen.core.errors import OutputError, writing
from forestgen.geometry.usd import new_stage

GRAPH_FORMATS = (".parquet", ".csv", ".gltf", ".glb", ".obj", ".usda", ".usdc")
_NAMES = ("plant", "module", "node", "parent", "x_m", "y_m", "z_m", "diameter_m", "age", "order", "axis", "is_main")
Columns = Mapping[str, Sequence[Any] | NDArray[Any]]


def write_graph(path: Path, graph: SkeletalGraph, *, foot_m: Any = None, columns: Columns | None = None) -> None:
    """Write a graph in the format that the path's suffix names; an `OutputError` if that is not possible.

    With `foot_m` (P, 3), of all plants of the population, positions are the world's; without, each plant's from its own
    foot. `columns` are name -> (P,) what else is known of each plant, such as plant_id and species: columns of tables,
    custom data of scenes.
    """
    suffix = path.suffix.lower()
    if suffix not in GRAPH_FORMATS:
        expected = f"a name that ends with {', '.join(GRAPH_FORMATS)}"
        raise OutputError("no format for skeletal graphs", where=str(path), expected=expected, got=suffix or "none")
    position = graph.position_m
    if foot_m is not None:
        position = (position + np.asarray(foot_m, dtype=np.float64)[graph.plant]).astype(np.float32)
    known = {name: np.asarray(values) for name, values in (columns or {}).items()}
    if suffix in (".parquet", ".csv"):
        content = _table_bytes(graph, position, known, suffix)
    elif suffix in (".gltf", ".glb"):
        content = _gltf(graph, position, known, binary=suffix == ".glb")
    elif suffix == ".obj":
        content = _obj(graph, position).encode()
    else:
        content = _usd(graph, position, known, suffix)
    with writing(path, "the graph cannot be written"):
        path.write_bytes(content)


def _table_bytes(
    graph: SkeletalGraph, position: NDArray[np.float32], known: Mapping[str, NDArray[Any]], suffix: str
) -> bytes:
    import pyarrow as pa
    import pyarrow.csv as pa_csv
    import pyarrow.parquet as pq

    of_nodes = {**vars(graph), **dict(zip(("x_m", "y_m", "z_m"), position.T, strict=True))}
    columns = {name: of_nodes[name] for name in _NAMES}
    columns |= {name: values[graph.plant] for name, values in known.items()}
    table = pa.table({name: pa.array(np.ascontiguousarray(values)) for name, values in columns.items()})
    sink = pa.BufferOutputStream()
    if suffix == ".parquet":
        pq.write_table(table, sink, compression="zstd")
    else:
        pa_csv.write_csv(table, sink)
    return bytes(sink.getvalue())


def _plants(graph: SkeletalGraph) -> list[tuple[int, int, int]]:
    """(row of the plant, its first node, the end) of each plant of the graph, in order."""
    first = np.flatnonzero(graph.parent < 0)
    ends = np.append(first, len(graph))[1:]
    return [(int(graph.plant[begin]), int(begin), int(end)) for begin, end in zip(first, ends, strict=True)]


def _known(known: Mapping[str, NDArray[Any]], plant: int) -> dict[str, Any]:
    return {"plant": plant, **{name: np.asarray(values[plant]).item() for name, values in known.items()}}


def _polylines(graph: SkeletalGraph, first: int, end: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Points of one plant's axes as rows of the graph, each axis from the node that bears it, and their numbers."""
    begins = np.flatnonzero(np.diff(graph.axis[first:end], prepend=-1)) + first
    counts = np.diff([*begins, end])
    rows = np.arange(first, end)
    borne = begins[graph.parent[begins] >= 0]
    points = np.insert(rows, borne - first, graph.parent[borne])
    counts = counts + (graph.parent[begins] >= 0)
    return points, counts


def _obj(graph: SkeletalGraph, position: NDArray[np.float32]) -> str:
    text = ["# forestgen: skeletal graph; metres, z up\n"]
    text.append(("v %.5f %.5f %.5f\n" * len(position)) % tuple(position.ravel().tolist()))
    for plant, first, end in _plants(graph):
        text.append(f"o plant_{plant}\n")
        points, counts = _polylines(graph, first, end)
        lines = np.split(points + 1, np.cumsum(counts)[:-1])
        text.extend(f"l {' '.join(map(str, line.tolist()))}\n" for line in lines if len(line) > 1)
    return "".join(text)


def _gltf(
    graph: SkeletalGraph, position: NDArray[np.float32], known: Mapping[str, NDArray[Any]], *, binary: bool
) -> bytes:
    data = io.BytesIO()
    views: list[dict[str, int]] = []
    accessors: list[dict[str, Any]] = []

    def accessor(values: NDArray[Any], kind: str, target: int, *, bounds: bool = False) -> int:
        views.append({"buffer": 0, "byteOffset": data.tell(), "byteLength": values.nbytes, "target": target})
        data.write(np.ascontiguousarray(values).tobytes())  # four-byte numbers: aligned as they come
        component = 5126 if values.dtype == np.float32 else 5125
        entry = {"bufferView": len(views) - 1, "componentType": component, "count": len(values), "type": kind}
        if bounds:
            entry |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        accessors.append(entry)
        return len(accessors) - 1

    x, y, z = position.T
    upright = np.stack([x, z, -y], axis=-1)  # the standard wants y up
    meshes: list[dict[str, Any]] = []
    nodes: list[dict[str, Any]] = []
    for plant, first, end in _plants(graph):
        child = np.flatnonzero(graph.parent[first:end] >= 0)
        node: dict[str, Any] = {"name": f"plant_{plant}", "extras": _known(known, plant)}
        if len(child):  # a plant of one node has no line
            lines = np.stack([graph.parent[first:end][child] - first, child], axis=-1).astype(np.uint32)
            attributes = {
                "POSITION": accessor(upright[first:end], "VEC3", 34962, bounds=True),
                "_DIAMETER": accessor(graph.diameter_m[first:end], "SCALAR", 34962),
                "_AGE": accessor(graph.age[first:end], "SCALAR", 34962),
            }
            indices = accessor(lines.ravel(), "SCALAR", 34963)
            primitive = {"attributes": attributes, "indices": indices, "mode": 1}
            meshes.append({"name": f"plant_{plant}", "primitives": [primitive]})
            node["mesh"] = len(meshes) - 1
        nodes.append(node)
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "forestgen"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))} if nodes else {}],
    }
    parts = {"nodes": nodes, "meshes": meshes, "accessors": accessors, "bufferViews": views}
    document |= {name: entries for name, entries in parts.items() if entries}  # the standard forbids empty lists
    buffer: dict[str, Any] = {"byteLength": data.tell()}
    if not binary:
        buffer["uri"] = "data:application/octet-stream;base64," + base64.b64encode(data.getvalue()).decode()
    if views:
        document["buffers"] = [buffer]
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    if not binary:
        return text
    text += b" " * (-len(text) % 4)
    tail = struct.pack("<I4s", data.tell(), b"BIN\0") + data.getvalue() if views else b""
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(tail), len(text), b"JSON") + text + tail


def _usd(graph: SkeletalGraph, position: NDArray[np.float32], known: Mapping[str, NDArray[Any]], suffix: str) -> bytes:
    from pxr import Sdf, UsdGeom, Vt

    layer, stage, _ = new_stage("/plants")
    for plant, first, end in _plants(graph):
        points, counts = _polylines(graph, first, end)
        curves = UsdGeom.BasisCurves.Define(stage, f"/plants/plant_{plant}")
        curves.GetPrim().SetCustomDataByKey("forestgen", _known(known, plant))
        if end - first < 2:
            continue
        if counts[0] < 2:  # the trunk's axis is the foot alone
            points, counts = points[1:], counts[1:]
        # A lateral is as thick at its foot as at its own first node.
        wide = graph.diameter_m[points].copy()
        foot = np.concatenate([[0], np.cumsum(counts)[:-1]])
        lateral = graph.axis[points[foot]] != graph.axis[points[foot + 1]]
        wide[foot[lateral]] = wide[foot[lateral] + 1]
        curves.CreateTypeAttr(UsdGeom.Tokens.linear)
        curves.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(position[points])))
        curves.CreateCurveVertexCountsAttr(Vt.IntArray.FromNumpy(counts.astype(np.int32)))
        curves.CreateWidthsAttr(Vt.FloatArray.FromNumpy(wide))
        curves.SetWidthsInterpolation(UsdGeom.Tokens.vertex)
        half = wide[:, None] / 2
        extent = np.stack([(position[points] - half).min(axis=0), (position[points] + half).max(axis=0)])
        curves.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(extent.astype(np.float32)))
        ages = UsdGeom.PrimvarsAPI(curves).CreatePrimvar(
            "physiologicalAge", Sdf.ValueTypeNames.FloatArray, UsdGeom.Tokens.vertex
        )
        ages.Set(Vt.FloatArray.FromNumpy(np.ascontiguousarray(graph.age[points])))
    with tempfile.TemporaryDirectory(prefix="forestgen-usd-") as folder:
        written = Path(folder) / f"graph{suffix}"
        layer.Export(str(written))
        return written.read_bytes()
