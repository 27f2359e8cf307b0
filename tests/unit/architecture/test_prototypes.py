"""Prototypes: shipped ones, users' files, mistakes in them, and regions of the morphospace."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from forestgen.architecture.prototypes import (
    MOST_NODES,
    Prototype,
    PrototypeFile,
    choose_prototype,
    load_prototypes,
    read_prototype,
)
from forestgen.core.errors import AssetError
from support.error_messages import raises_error

HEAD = "apical_control: 0.5\ndeterminacy: 0.5\n"
FORK = HEAD + (
    "nodes:\n"
    "  - {parent: 0, angle_deg: 0, length: 1}\n"
    "  - {parent: 1, angle_deg: 30, length: 0.5, birth: 0.2}\n"
    "  - {parent: 1, direction: [0, 3, 4], length: 0.5, birth: 0.25, thickness: 0.5}\n"
)


def test_nine_prototypes_cover_the_morphospace() -> None:
    prototypes = load_prototypes()
    assert len(prototypes) == 9
    assert [one.name for one in prototypes] == sorted(one.name for one in prototypes)
    side = np.linspace(0, 1, 201)
    region = choose_prototype(prototypes, *np.meshgrid(side, side))
    shares = np.bincount(region.ravel(), minlength=9) / region.size
    assert shares.min() > 0.01  # the unbranched column has the corner alone
    assert shares.max() < 0.25


def test_determinate_prototypes_are_monopodial_and_the_rest_sympodial() -> None:
    """Table 1's excurrent, decurrent and shrub types get what section 2.5 says of high and low D."""
    names = [one.name for one in load_prototypes()]
    places = {"column": (1.0, 1.0), "whorled": (0.84, 1.0), "multistem": (0.5, 0.1), "sympodial": (0.2, 0.2)}
    for name, place in places.items():
        assert names[int(choose_prototype(load_prototypes(), *place))] == name


@pytest.mark.parametrize("prototype", load_prototypes(), ids=lambda one: str(one.name))
def test_shipped_prototypes_are_trees_in_space(prototype) -> None:  # type: ignore[no-untyped-def]
    n = len(prototype)
    assert prototype.parent[0] == -1
    assert np.all(prototype.parent[1:] < np.arange(1, n))
    assert np.all(prototype.parent[1:] >= 0)
    assert np.all(prototype.birth[1:] >= prototype.birth[prototype.parent[1:]])
    assert np.allclose(np.linalg.norm(prototype.direction, axis=1), 1, atol=1e-6)
    assert 8 <= n <= 14
    if prototype.name == "column":
        assert len(prototype.terminals) == 1
        return
    assert 3 <= len(prototype.terminals) <= 8
    grown = prototype.length * (1 - prototype.birth)
    place = np.zeros((n, 3))
    for node in range(1, n):
        place[node] = place[prototype.parent[node]] + grown[node] * prototype.direction[node]
    extent = np.linalg.svd(place - place.mean(axis=0), compute_uv=False)
    assert extent[2] > 0.25 * extent[1]  # not planar
    for node in prototype.terminals:  # ends of branches keep clear of one another
        others = np.linalg.norm(place[prototype.terminals] - place[node], axis=1)
        assert np.partition(others, 1)[1] > 0.15


def test_laterals_spread_by_40_to_75_degrees() -> None:
    for prototype in load_prototypes():
        for node in range(1, len(prototype)):
            bearer = prototype.parent[node]
            children = np.flatnonzero(prototype.parent == bearer)
            if bearer > 0 and len(children) > 1 and node == children[-1]:
                widest = prototype.direction[children] @ prototype.direction[children].T
                assert 40 < np.degrees(np.arccos(widest.min())) < 140


def _parsed(folder: Path, text: str, name: str = "mine.yaml") -> Prototype:
    (folder / name).write_text(text)
    return read_prototype(folder / name)


def test_angles_and_directions_say_the_same(tmp_path: Path) -> None:
    fork = _parsed(tmp_path, FORK, "fork.yaml")
    assert fork.name == "fork"
    assert fork.terminals.tolist() == [2, 3]
    assert fork.direction[2] == pytest.approx([0.5, 0, np.sqrt(0.75)], abs=1e-6)
    assert fork.direction[3] == pytest.approx([0, 0.6, 0.8], abs=1e-6)
    assert fork.thickness.tolist() == [1, 1, 1, 0.5]


@given(
    st.lists(st.tuples(st.floats(0, 180), st.floats(-360, 360)), min_size=2, max_size=12),
)
def test_angles_are_those_between_segments(steps: list[tuple[float, float]]) -> None:
    nodes = [{"parent": k, "angle_deg": a, "azimuth_deg": z, "length": 1.0} for k, (a, z) in enumerate(steps)]
    chain = PrototypeFile.model_validate({"apical_control": 1.0, "determinacy": 1.0, "nodes": nodes}).prototype("chain")
    direction = chain.direction.astype(np.float64)
    assert np.allclose(np.linalg.norm(direction, axis=1), 1, atol=1e-6)
    cosine = np.einsum("nc,nc->n", direction[1:], direction[:-1])
    assert np.allclose(cosine, np.cos(np.radians([angle for angle, _ in steps])), atol=1e-5)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (FORK.replace("parent: 1, angle", "parent: 2, angle"), 5),
        (FORK.replace("birth: 0.25", "birth: 1"), 6),
        (FORK + "  - {parent: 3, angle_deg: 1, length: 1, birth: 0.1}\n", 7),
        (FORK.replace("length: 1}", "length: 0}"), 4),
        (FORK.replace("length: 1}", "length: .inf}"), 4),
        (FORK.replace("angle_deg: 0, ", ""), 4),
        (FORK.replace("angle_deg: 0, ", "angle_deg: 0, direction: [0, 0, 1], "), 4),
        (FORK.replace("[0, 3, 4]", "[0, 0, 0]"), 6),
        (HEAD + "nodes: []\n", 3),
        (FORK + "    thicknes: 1\n", None),
        (FORK.replace("thickness", "thicknes"), 6),
        (FORK.replace("apical_control: 0.5", "apical_control: 1.5"), 1),
        ("", None),
    ],
)
def test_mistakes_are_told_with_their_line(tmp_path: Path, text: str, line: int | None) -> None:
    with raises_error(AssetError) as caught:
        _parsed(tmp_path, text)
    assert line is None or f"mine.yaml:{line}" in str(caught.value)


def test_too_many_nodes_are_told(tmp_path: Path) -> None:
    nodes = "  - {parent: 0, angle_deg: 1, length: 1}\n" * MOST_NODES
    with raises_error(AssetError, place="nodes"):
        _parsed(tmp_path, HEAD + "nodes:\n" + nodes)


def test_regions_are_voronois() -> None:
    """Against the distances to all prototypes."""
    prototypes = load_prototypes()
    rng = np.random.default_rng(3)
    control, determinacy = rng.random((2, 5000))
    places = np.array([(one.apical_control, one.determinacy) for one in prototypes])
    distance = np.hypot(*(np.stack([control, determinacy], axis=-1)[:, None] - places).transpose(2, 0, 1))
    chosen = choose_prototype(prototypes, control, determinacy)
    assert chosen.dtype == np.uint8
    assert np.array_equal(chosen, distance.argmin(axis=1))
    assert np.array_equal(choose_prototype(prototypes, *places.T), np.arange(9))
    allowed = rng.random((5000, 9)) < 0.3
    allowed[np.arange(5000), rng.integers(9, size=5000)] = True
    chosen = choose_prototype(prototypes, control, determinacy, allowed=allowed)
    assert np.array_equal(chosen, np.where(allowed, distance, np.inf).argmin(axis=1))
