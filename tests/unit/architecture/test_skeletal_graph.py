"""Skeletal graphs: connectivity over modules, axes, diameters, and files that give them back."""

from __future__ import annotations

import base64
import itertools
import json
import struct
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from module_graphs import plant_type, random_plants, shipped_tables, single

from forestgen.architecture.geometry import SkeletalGraph, node_diameters, node_positions, skeletal_graph
from forestgen.architecture.graph_files import write_graph
from forestgen.architecture.modules import Modules
from forestgen.core.errors import OutputError
from support.error_messages import raises_error

TYPES = (plant_type(), plant_type(tropism_strength=-0.5, thickening_cm=2.0))
TABLES = shipped_tables(*TYPES)
KINDS = np.array([0, 1, 1, 0, 1, 0])
FOOT = np.random.default_rng(9).uniform(0, 100, (6, 3))


@cache
def modules() -> Modules:
    return random_plants(TABLES, KINDS, 25, np.random.default_rng(8))


@pytest.fixture(scope="module")
def graph() -> SkeletalGraph:
    return skeletal_graph(TABLES, modules(), KINDS)


def of_plant(graph: SkeletalGraph, row: int) -> SkeletalGraph:
    """The part of one plant, with parents and axes counted from 0."""
    found = np.flatnonzero(graph.plant == row)
    first = int(found[0]) if len(found) else 0
    parts = {name: values[found] for name, values in vars(graph).items()}
    parts["parent"] = np.where(parts["parent"] < 0, -1, parts["parent"] - first)
    parts["axis"] = parts["axis"] - (parts["axis"][0] if len(found) else 0)
    return SkeletalGraph(**parts)


def test_every_segment_is_there_once(graph: SkeletalGraph) -> None:
    """Length of wood, plant by plant, against the modules' own."""
    nodes = node_positions(TABLES, modules(), KINDS)
    plant = np.repeat(modules().plant(), np.diff(nodes.start))
    has_parent = graph.parent >= 0
    ends = graph.position_m[has_parent], graph.position_m[graph.parent[has_parent]]
    length = np.linalg.norm(ends[0].astype(np.float64) - ends[1], axis=1)
    for row in range(6):
        assert length[graph.plant[has_parent] == row].sum() == pytest.approx(
            nodes.length_m[plant == row].sum(), rel=1e-5
        )
    assert np.all(length > 0)
    assert np.count_nonzero(nodes.length_m > 0) == np.count_nonzero(has_parent)


def test_graphs_are_trees_of_which_parents_come_first(graph: SkeletalGraph) -> None:
    roots = np.flatnonzero(graph.parent < 0)
    assert graph.plant[roots].tolist() == [0, 1, 2, 3, 4, 5]
    assert np.all(graph.parent < np.arange(len(graph)))
    child = graph.parent >= 0
    assert np.array_equal(graph.plant[child], graph.plant[graph.parent[child]])
    assert np.all(graph.position_m[roots] == 0)
    pairs = np.stack([graph.module, graph.node], axis=1)
    assert len(np.unique(pairs, axis=0)) == len(graph)


def test_modules_join_at_their_bearers_terminals(graph: SkeletalGraph) -> None:
    child = np.flatnonzero(graph.parent >= 0)
    crossing = child[graph.module[child] != graph.module[graph.parent[child]]]
    bearer = modules().parent_row()
    assert np.array_equal(graph.module[graph.parent[crossing]], bearer[graph.module[crossing]])
    assert np.array_equal(graph.node[graph.parent[crossing]], modules().node[graph.module[crossing]])
    joint = graph.position_m[graph.parent[crossing]]
    assert np.allclose(joint, modules().base_m[graph.module[crossing]], atol=1e-5)
    started = np.array([modules().age[row] > 0 for row in range(len(modules()))])
    assert set(graph.module[crossing]) == set(np.flatnonzero((bearer >= 0) & started))


def test_diameters_are_those_of_the_modules_nodes(graph: SkeletalGraph) -> None:
    diameter = node_diameters(TABLES, modules(), KINDS)
    start = np.concatenate([[0], np.cumsum(TABLES.nodes[modules().prototype])])
    assert np.array_equal(graph.diameter_m, diameter[start[graph.module] + graph.node])
    # No thinner than all that it bears together: what is more is wood of what was shed, or of a terminal's own.
    borne = np.bincount(graph.parent[graph.parent >= 0], graph.diameter_m[graph.parent >= 0] ** 2.0, len(graph))
    assert np.all(graph.diameter_m**2.0 >= borne * (1 - 1e-5))


def test_axes_run_through_modules(graph: SkeletalGraph) -> None:
    child = np.flatnonzero(graph.parent >= 0)
    parent = graph.parent[child]
    same = graph.axis[child] == graph.axis[parent]
    assert np.array_equal(same, graph.is_main[child])
    assert np.array_equal(graph.order[child], graph.order[parent] + ~same)
    assert not np.any(graph.is_main[graph.parent < 0])
    # The nodes of an axis are chained and lie together.
    assert np.all(np.diff(graph.axis) >= 0)
    together = np.flatnonzero(np.diff(graph.axis) == 0)
    assert np.array_equal(graph.parent[together + 1], together)
    # One child of each node goes on, where it has any.
    assert np.array_equal(np.unique(parent), np.sort(parent[same]))
    crossing = graph.module[child] != graph.module[parent]
    assert np.any(same & crossing)
    assert graph.order.max() >= 2


def test_ages_are_those_of_the_segments(graph: SkeletalGraph) -> None:
    born = TABLES.birth[modules().prototype[graph.module], graph.node]
    mature = np.array([one.mature_age for one in TYPES])[KINDS[graph.plant]]
    assert np.allclose(graph.age, modules().age[graph.module] - born * mature, atol=1e-6)


def test_chosen_plants_are_as_in_the_whole_graph(graph: SkeletalGraph) -> None:
    few = skeletal_graph(TABLES, modules(), KINDS, [4, 1])
    assert list(dict.fromkeys(few.plant.tolist())) == [4, 1]
    for row in (4, 1):
        one, other = of_plant(few, row), of_plant(graph, row)
        for name in one.__dataclass_fields__:
            assert np.array_equal(getattr(one, name), getattr(other, name)), name
    part = modules().of_plants(np.array([4, 1]))
    assert part.plants == 2
    assert np.array_equal(part.number, modules().number[modules().rows(np.array([4, 1]))])


def test_a_seedling_is_its_foot_alone() -> None:
    seedling = skeletal_graph(TABLES, single(TABLES, 2, 0.0), np.zeros(1, dtype=int))
    assert len(seedling) == 1
    assert len(of_plant(seedling, 7)) == 0


def read_graph(path: Path) -> SkeletalGraph:
    """The graph of a table."""
    import pyarrow.csv
    import pyarrow.parquet

    table = (pyarrow.parquet.read_table if path.suffix == ".parquet" else pyarrow.csv.read_csv)(path)
    names = [name for name in SkeletalGraph.__dataclass_fields__ if name != "position_m"]
    position = np.stack([table[name].to_numpy().astype(np.float32) for name in ("x_m", "y_m", "z_m")], axis=-1)
    return SkeletalGraph(position_m=position, **{name: table[name].to_numpy() for name in names})


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_tables_give_the_graph_back(graph: SkeletalGraph, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"graph.{suffix}"
    write_graph(path, graph, columns={"plant_id": np.arange(11, 17), "species": ["a", "b", "b", "a", "b", "a"]})
    again = read_graph(path)
    for name in graph.__dataclass_fields__:
        values = getattr(graph, name)
        assert np.array_equal(getattr(again, name).astype(values.dtype), values), name
    if suffix == "parquet":
        import pyarrow.parquet as pq

        table = pq.read_table(path).to_pydict()
        assert table["plant_id"] == (graph.plant + 11).tolist()
        assert set(table["species"]) == {"a", "b"}


def test_feet_put_plants_into_the_world(graph: SkeletalGraph, tmp_path: Path) -> None:
    write_graph(tmp_path / "graph.parquet", graph, foot_m=FOOT)
    again = read_graph(tmp_path / "graph.parquet")
    assert np.allclose(again.position_m, graph.position_m + FOOT[graph.plant], atol=1e-4)


def _gltf(path: Path) -> tuple[dict[str, Any], bytes]:
    content = path.read_bytes()
    if path.suffix == ".gltf":
        document = json.loads(content)
        return document, base64.b64decode(document["buffers"][0]["uri"].split(",")[1])
    magic, version, size, length, kind = struct.unpack("<4sIII4s", content[:20])
    assert (magic, version, size, kind) == (b"glTF", 2, len(content), b"JSON")
    return json.loads(content[20 : 20 + length]), content[28 + length :]


@pytest.mark.parametrize("suffix", ["gltf", "glb"])
def test_gltf_holds_every_segment_as_a_line(graph: SkeletalGraph, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"graph.{suffix}"
    write_graph(path, graph, columns={"plant_id": np.arange(11, 17)})
    document, data = _gltf(path)
    assert document["buffers"][0]["byteLength"] == len(data)
    assert [node["extras"]["plant_id"] for node in document["nodes"]] == [11, 12, 13, 14, 15, 16]

    def values(index: int) -> Any:
        entry = document["accessors"][index]
        view = document["bufferViews"][entry["bufferView"]]
        kind = np.float32 if entry["componentType"] == 5126 else np.uint32
        found = np.frombuffer(data, kind, view["byteLength"] // 4, view["byteOffset"])
        return found.reshape(-1, 3) if entry["type"] == "VEC3" else found

    for row in range(6):
        own = of_plant(graph, row)
        if len(own) == 1:
            continue
        primitive = document["meshes"][document["nodes"][row]["mesh"]]["primitives"][0]
        assert primitive["mode"] == 1
        x, y, z = values(primitive["attributes"]["POSITION"]).T
        assert np.array_equal(np.stack([x, -z, y], axis=-1), own.position_m)
        lines = values(primitive["indices"]).reshape(-1, 2)
        assert np.array_equal(lines, np.stack([own.parent, np.arange(len(own))], axis=-1)[own.parent >= 0])
        assert np.array_equal(values(primitive["attributes"]["_DIAMETER"]), own.diameter_m)


def test_obj_lines_are_the_segments(graph: SkeletalGraph, tmp_path: Path) -> None:
    write_graph(tmp_path / "graph.obj", graph)
    rows = [line.split() for line in (tmp_path / "graph.obj").read_text().splitlines()]
    lines = [[int(word) - 1 for word in row[1:]] for row in rows if row[0] == "l"]
    pairs = {(a, b) for line in lines for a, b in itertools.pairwise(line)}
    assert pairs == {(int(p), n) for n, p in enumerate(graph.parent) if p >= 0}


@pytest.mark.parametrize("suffix", ["usda", "usdc"])
def test_usd_curves_are_the_axes(graph: SkeletalGraph, tmp_path: Path, suffix: str) -> None:
    from pxr import Usd, UsdGeom

    path = tmp_path / f"graph.{suffix}"
    write_graph(path, graph, columns={"species": ["a", "b", "b", "a", "b", "a"]})
    stage = Usd.Stage.Open(str(path))
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    for row in range(6):
        own = of_plant(graph, row)
        curves = UsdGeom.BasisCurves(stage.GetPrimAtPath(f"/plants/plant_{row}"))
        assert curves.GetPrim().GetCustomDataByKey("forestgen")["species"] == "abbaba"[row]
        if len(own) == 1:
            continue
        points, counts = np.array(curves.GetPointsAttr().Get()), np.array(curves.GetCurveVertexCountsAttr().Get())
        assert len(points) - len(counts) == len(own) - 1  # segments
        starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
        inner = np.setdiff1d(np.arange(1, len(points)), starts)
        length = np.linalg.norm(points[inner] - points[inner - 1], axis=1).sum()
        child = own.parent >= 0
        expected = np.linalg.norm(own.position_m[child] - own.position_m[own.parent[child]], axis=1).sum()
        assert length == pytest.approx(expected, rel=1e-4)
        widths = np.array(curves.GetWidthsAttr().Get())
        assert set(widths[inner].tolist()) == set(own.diameter_m[child].tolist())


def test_bytes_repeat(graph: SkeletalGraph, tmp_path: Path) -> None:
    for suffix in ("parquet", "csv", "gltf", "glb", "obj", "usda", "usdc"):
        for name in ("a", "b"):
            write_graph(tmp_path / f"{name}.{suffix}", graph)
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes(), suffix


def test_what_cannot_be_written_is_told(graph: SkeletalGraph, tmp_path: Path) -> None:
    with raises_error(OutputError, place="graph.fbx"):
        write_graph(tmp_path / "graph.fbx", graph)
    for suffix in ("csv", "usda"):
        with raises_error(OutputError):
            write_graph(tmp_path / "none" / f"graph.{suffix}", graph)
