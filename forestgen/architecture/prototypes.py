"""Module prototypes: the branching patterns that branch modules repeat (Makowski 2023, section 2.5.2).

A prototype is a tree of nodes. Node 0 is its root, at the module's origin; every other node ends a branch segment. The
nodes without children are its terminals, where other modules may grow. Of several children of a node the first is the
continuation of the axis (main), the others are lateral. The files are ``scenes/modules/NAME.yaml``::

    description: main axis with a whorl of laterals, as in young firs
    apical_control: 0.83   # lambda, its place in the morphospace
    determinacy: 0.85      # D
    nodes:                 # node 0 is the root, at the origin; the first entry is node 1
      - {parent: 0, angle_deg: 2, azimuth_deg: 0, length: 0.6}
      - {parent: 1, angle_deg: 55, azimuth_deg: 137.5, length: 0.7, birth: 0.3, thickness: 0.8}

A node's segment leaves its parent in a `direction` [x, y, z] of the module's frame, whose z is the module's axis; or at
`angle_deg` from the segment that its parent ends, on the side `azimuth_deg`, which counts about that segment from the
frame's x axis turned by the least rotation that takes z to the segment. `length` is a factor on the plant type's
lengths, `birth` the share of the mature age at which the segment begins to grow: a grown segment is
``length * (1 - birth)`` long in these units.

Prototypes and plant types become padded arrays, for compiled loops over modules. Physiological ages are those of the
plant type, 0 to its mature age. What depends on a module's attitude to the vertical (Eq. 12) is not in the tables.

Makowski, M. (2023), chapter 2 (Synthetic Silviculture), sections 2.5.2 and 2.5.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from forestgen.core.errors import AssetError
from forestgen.recipe.assets import find_asset, list_assets
from forestgen.recipe.fields import Fraction, Number, Positive, Section, Text, Whole, violation
from forestgen.recipe.messages import Explainer
from forestgen.recipe.sources import read_yaml
from forestgen.recipe.species import PlantType

MOST_NODES = 32
_COLUMNS = ("mature_age", "length_per_age_m", "longest_segment_m", "tropism_strength", "tropism_decay", "opacity")


@dataclass(frozen=True)
class Prototype:
    """One prototype, with its place in the morphospace of apical control and determinacy."""

    name: str
    apical_control: float  # lambda, 0 to 1
    determinacy: float  # D, 0 to 1
    parent: NDArray[np.int16]  # (N,) -1 for node 0; parents precede children
    direction: NDArray[np.float32]  # (N, 3) unit vector of the segment that the node ends; module's frame, z its axis
    length: NDArray[np.float32]  # (N,) of that segment, as a factor on the plant type's lengths; 0 for node 0
    birth: NDArray[np.float32]  # (N,) a_n over the mature age, 0 to 1: the segment's; not below its parent's
    thickness: NDArray[np.float32]  # (N,) factor on the plant type's thickening, for terminals

    def __len__(self) -> int:
        return len(self.parent)

    @property
    def terminals(self) -> NDArray[np.int64]:
        """(K,) nodes without children."""
        return np.setdiff1d(np.arange(len(self.parent)), self.parent[1:])


_UnitFree = Annotated[Number, Field(ge=-1e3, le=1e3)]


class PrototypeNode(Section):
    """One node of a prototype's file, and the branch segment that it ends."""

    parent: Whole = Field(ge=0, le=MOST_NODES - 2, description="Number of the node it grows from; 0: root.")
    direction: tuple[_UnitFree, _UnitFree, _UnitFree] | None = Field(
        None, description="Of the segment, in the module's frame, of any length; in place of the angles."
    )
    angle_deg: Number | None = Field(None, ge=0, le=180, description="From the segment that the parent ends, degrees.")
    azimuth_deg: Number = Field(0.0, ge=-3600, le=3600, description="Side of that angle, degrees.")
    length: Positive = Field(ge=1e-3, le=20, description="Factor on the plant type's segment lengths.")
    birth: Number = Field(0.0, ge=0, le=0.95, description="Share of the mature age at which it begins to grow.")
    thickness: Positive = Field(1.0, ge=1e-3, le=20, description="Factor on the type's thickening, of a terminal node.")

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if (self.direction is None) == (self.angle_deg is None):
            got = "neither" if self.direction is None else "both"
            raise violation("direction, or angle_deg", problem="the direction is not given exactly once", got=got)
        if self.direction is not None and float(np.linalg.norm(self.direction)) <= 1e-6:
            raise violation("a vector of some length", got=str(list(self.direction)), at=("direction",))
        if self.direction is not None and "azimuth_deg" in self.model_fields_set:
            raise violation("no azimuth_deg beside direction", got=f"{self.azimuth_deg:g}", at=("azimuth_deg",))
        return self


class PrototypeFile(Section):
    """A prototype's file."""

    description: Text = Field("", max_length=1000, description="What branches it draws.")
    apical_control: Fraction = Field(description="Place in the morphospace [lambda].")
    determinacy: Fraction = Field(description="Place in the morphospace [D].")
    nodes: tuple[PrototypeNode, ...] = Field(
        min_length=1, max_length=MOST_NODES - 1, description="All but the root, parents first; see the page."
    )

    @model_validator(mode="after")
    def _is_a_tree(self) -> Self:
        births = [0.0]
        for number, node in enumerate(self.nodes, 1):
            if node.parent >= number:
                problem = f"node {number} grows from a node that stands after it, or from itself"
                expected, at = f"0 to {number - 1}: the first entry is node 1", ("nodes", number - 1, "parent")
                raise violation(expected, problem=problem, got=str(node.parent), at=at)
            if node.birth < births[node.parent]:
                problem = f"node {number} is born before the node it grows from"
                expected, at = f"at least its parent's: {births[node.parent]:g}", ("nodes", number - 1, "birth")
                raise violation(expected, problem=problem, got=f"{node.birth:g}", at=at)
            births.append(node.birth)
        return self

    def prototype(self, name: str) -> Prototype:
        """The arrays of the prototype."""
        directions = [np.array([0.0, 0.0, 1.0])]
        for node in self.nodes:
            directions.append(_direction(node, directions[node.parent]))
        numbers = [(0.0, 0.0, 1.0), *((node.length, node.birth, node.thickness) for node in self.nodes)]
        parent = np.array([-1, *(node.parent for node in self.nodes)], dtype=np.int16)
        columns = np.array(numbers, dtype=np.float32).T.copy()
        return Prototype(
            name, self.apical_control, self.determinacy, parent, np.array(directions, dtype=np.float32), *columns
        )


def _direction(node: PrototypeNode, along: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) unit vector of a node's segment; `along` is that of its parent's."""
    if node.direction is not None:
        vector = np.array(node.direction)
        return np.asarray(vector / np.linalg.norm(vector))
    angle, azimuth = np.radians([node.angle_deg or 0.0, node.azimuth_deg])
    x, y, z = np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)
    ax, ay, az = along
    if az < -1 + 1e-9:  # straight down: half a turn about x
        return np.array([x, -y, -z])
    # The least rotation that takes z to `along`, of axis (-ay, ax, 0).
    k = 1.0 / (1.0 + az)
    return np.array(
        [
            (1 - k * ax * ax) * x - k * ax * ay * y + ax * z,
            -k * ax * ay * x + (1 - k * ay * ay) * y + ay * z,
            -ax * x - ay * y + az * z,
        ]
    )


@cache
def load_prototypes() -> tuple[Prototype, ...]:
    """All prototypes, sorted by name, as module graphs count them."""
    return tuple(read_prototype(find_asset("modules", name)) for name in sorted(list_assets("modules")))


def read_prototype(path: Path) -> Prototype:
    """The prototype of a file; an `AssetError` if it holds none."""
    data, sources = read_yaml(path, error=AssetError)
    try:
        return PrototypeFile.model_validate(data).prototype(path.stem)
    except ValidationError as failure:
        found = Explainer(PrototypeFile, data, sources, (), {}).error(failure)
        raise AssetError(
            found.problem, where=found.where, expected=found.expected, got=found.got, hint=found.hint
        ) from failure


def choose_prototype(
    prototypes: Sequence[Prototype], apical_control: Any, determinacy: Any, *, allowed: NDArray[np.bool_] | None = None
) -> NDArray[np.uint8]:
    """Index of the prototype whose Voronoi region of the morphospace holds each point; the first of equals.

    The points are lambda and D', 0 to 1, of one shape (...); `allowed` (..., S) says which prototypes each may choose.
    """
    control, determinate = np.asarray(apical_control, np.float64), np.asarray(determinacy, np.float64)
    place = np.array([(one.apical_control, one.determinacy) for one in prototypes])
    distance = (control[..., None] - place[:, 0]) ** 2 + (determinate[..., None] - place[:, 1]) ** 2
    if allowed is not None:
        distance = np.where(allowed, distance, np.inf)
    return np.asarray(distance.argmin(axis=-1), dtype=np.uint8)


@dataclass(frozen=True)
class Tables:
    """T plant types in the species' order, S prototypes in the order of their names, N = MOST_NODES nodes a prototype.

    Padding: parent, first_child, next_sibling, terminal and terminal_index -1; the rest 0.
    """

    names: tuple[str, ...]  # of the prototypes
    nodes: NDArray[np.int16]  # (S,) number of nodes
    parent: NDArray[np.int16]  # (S, N) -1 for node 0
    direction: NDArray[np.float64]  # (S, N, 3) unit, module's frame
    length: NDArray[np.float64]  # (S, N) factor
    birth: NDArray[np.float64]  # (S, N) over the mature age
    thickness: NDArray[np.float64]  # (S, N) factor
    first_child: NDArray[np.int16]  # (S, N) the main child; -1: a terminal
    next_sibling: NDArray[np.int16]  # (S, N) the next lateral of the same parent; -1: none
    terminals: NDArray[np.int16]  # (S,) number of terminals, K
    terminal: NDArray[np.int16]  # (S, N) node numbers of the terminals, ascending
    terminal_index: NDArray[np.int16]  # (S, N) place of a node among the terminals; -1: none
    disused_node: NDArray[np.int16]  # (S,) last node of the main axis that is no terminal: there disused pipes begin
    mature_age: NDArray[np.float64]  # (T,) physiological
    length_per_age_m: NDArray[np.float64]  # (T,)
    longest_segment_m: NDArray[np.float64]  # (T,)
    tropism_strength: NDArray[np.float64]  # (T,) g_2
    tropism_decay: NDArray[np.float64]  # (T,) g_1
    thickening_m: NDArray[np.float64]  # (T,) `pipe_diameter_m`, of a grown terminal segment of thickness 1
    opacity: NDArray[np.float64]  # (T,)
    sphere_scale: float  # of the spheres' radii

    @cached_property
    def grown_spheres_m(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Centres (T, S, 3), module's frame, and radii (T, S) of grown modules without tropism, as geometry.spheres."""
        per_type = (self.mature_age, self.length_per_age_m, self.longest_segment_m)
        mature, per_age, longest = (one[:, None, None] for one in per_type)
        since = np.maximum(mature - self.birth * mature, 0.0)  # (T, S, N)
        metres = self.length * np.minimum(longest, per_age * since)
        place = np.zeros((*metres.shape, 3))
        every = np.arange(len(self.parent))
        for node in range(1, self.parent.shape[1]):
            bearer = np.maximum(self.parent[:, node], 0)
            place[:, :, node] = place[:, every, bearer] + metres[..., node, None] * self.direction[:, node]
        weight = metres.sum(axis=-1)
        centre = (place * metres[..., None]).sum(axis=-2) / np.where(weight > 0, weight, 1.0)[..., None]
        away = np.linalg.norm(centre, axis=-1)
        axis = centre / np.where(away > 0, away, 1.0)[..., None]
        reach = np.where(metres > 0, np.einsum("tsnc,tsc->tsn", place, axis), 0.0).max(axis=-1)
        return centre, 0.5 * reach * self.sphere_scale

    @property
    def most_terminals(self) -> int:
        """Of any of the prototypes."""
        return int(self.terminals.max())


def tables_of(prototypes: Sequence[Prototype], types: Sequence[PlantType], *, sphere_scale: float = 1.0) -> Tables:
    """Tables of prototypes, in the order of their names, and plant types, in the species' order.

    `sphere_scale` is a factor on the spheres' radii; at 1 the spheres of a chain of modules touch.
    """
    shape = len(prototypes), MOST_NODES
    links = ("parent", "first_child", "next_sibling", "terminal", "terminal_index")
    columns: dict[str, NDArray[Any]] = {name: np.full(shape, -1, dtype=np.int16) for name in links}
    columns |= {name: np.zeros(shape) for name in ("length", "birth", "thickness")}
    columns |= {"direction": np.zeros((*shape, 3)), "disused_node": np.zeros(len(prototypes), dtype=np.int16)}
    for index, prototype in enumerate(prototypes):
        count = len(prototype)
        for name in ("parent", "length", "birth", "thickness"):
            columns[name][index, :count] = getattr(prototype, name)
        unit = prototype.direction.astype(np.float64)
        columns["direction"][index, :count] = unit / np.linalg.norm(unit, axis=-1, keepdims=True)
        first_child, next_sibling = columns["first_child"][index], columns["next_sibling"][index]
        for node in range(count - 1, 0, -1):  # from the last, so that the first child ends at the front
            bearer = prototype.parent[node]
            next_sibling[node] = first_child[bearer]
            first_child[bearer] = node
        ends = prototype.terminals
        columns["terminal"][index, : len(ends)] = ends
        columns["terminal_index"][index, ends] = np.arange(len(ends))
        disused = columns["disused_node"]
        while first_child[first_child[disused[index]]] >= 0:
            disused[index] = first_child[disused[index]]
    columns["length"][:, 0] = 0.0
    columns |= {name: np.array([getattr(one, name) for one in types], dtype=np.float64) for name in _COLUMNS}
    return Tables(
        names=tuple(prototype.name for prototype in prototypes),
        sphere_scale=sphere_scale,
        nodes=np.array([len(prototype) for prototype in prototypes], dtype=np.int16),
        terminals=np.array([len(prototype.terminals) for prototype in prototypes], dtype=np.int16),
        thickening_m=np.array([pipe_diameter_m(one) for one in types], dtype=np.float64),
        **columns,
    )


def pipe_diameter_m(one: PlantType) -> float:
    """Of the pipes that a grown terminal segment adds to the wood below: n shoots of phi have sqrt(n) phi (Eq. 10)."""
    return float(one.thickening_cm / 100.0 * np.sqrt(one.shoots_per_terminal))
