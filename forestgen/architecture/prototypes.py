"""Module prototypes as data: ``scenes/modules/NAME.yaml``, or files of the user's own.

    description: main axis with a whorl of laterals, as in young firs
    apical_control: 0.83   # lambda, its place in the morphospace of Makowski (2023), section 2.5.2
    determinacy: 0.85      # D
    nodes:                 # node 0 is the root, at the origin; the first entry is node 1
      - {parent: 0, angle_deg: 2, azimuth_deg: 0, length: 0.6}
      - {parent: 1, angle_deg: 55, azimuth_deg: 137.5, length: 0.7, birth: 0.3, thickness: 0.8}

Of several children of a node the first is the continuation of the axis. A node's segment leaves its parent in a
`direction` [x, y, z] of the module's frame, whose z is the module's axis; or at `angle_deg` from the segment that its
parent ends, on the side `azimuth_deg`. The azimuth counts about that segment, from the frame's x axis turned by the
least rotation that takes z to the segment. `length` is a factor on the plant type's lengths, `birth` the share of the
mature age at which the segment begins to grow: a grown segment is ``length * (1 - birth)`` long in these units.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from forestgen.architecture.prototype import MOST_NODES, Prototype
from forestgen.core.errors import AssetError
from forestgen.recipe.assets import find_asset, inside, list_assets
from forestgen.recipe.fields import Fraction, Number, Positive, Section, Text, Whole, mistake
from forestgen.recipe.messages import Explainer
from forestgen.recipe.sources import SourceMap, parse_yaml, read_yaml

MOST_PROTOTYPES = 64
MOST_BYTES = 100_000  # of a prototype's text
_UnitFree = Annotated[Number, Field(ge=-1e3, le=1e3)]


class PrototypeNode(Section):
    """One node of a prototype's file, and the branch segment that it ends."""

    parent: Annotated[Whole, Field(ge=0, le=MOST_NODES - 2, description="Number of the node it grows from; 0: root.")]
    direction: Annotated[
        tuple[_UnitFree, _UnitFree, _UnitFree] | None,
        Field(description="Of the segment, in the module's frame, of any length; in place of the angles."),
    ] = None
    angle_deg: Annotated[
        Number | None, Field(ge=0, le=180, description="From the segment that the parent ends, degrees.")
    ] = None
    azimuth_deg: Annotated[Number, Field(ge=-3600, le=3600, description="Side of that angle, degrees.")] = 0.0
    length: Annotated[Positive, Field(ge=1e-3, le=20, description="Factor on the plant type's segment lengths.")]
    birth: Annotated[
        Fraction, Field(le=0.95, description="Share of the mature age at which the segment begins to grow.")
    ] = 0.0
    thickness: Annotated[
        Positive, Field(ge=1e-3, le=20, description="Factor on the plant type's thickening, of a terminal node.")
    ] = 1.0

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if (self.direction is None) == (self.angle_deg is None):
            got = "neither" if self.direction is None else "both"
            raise mistake("direction, or angle_deg", problem="the segment's direction is not told once", got=got)
        if self.direction is not None and float(np.linalg.norm(self.direction)) <= 1e-6:
            raise mistake("a vector of some length", got=str(list(self.direction)), at=("direction",))
        if self.direction is not None and "azimuth_deg" in self.model_fields_set:
            raise mistake("no azimuth_deg beside direction", got=f"{self.azimuth_deg:g}", at=("azimuth_deg",))
        return self


class PrototypeFile(Section):
    """A prototype's file."""

    name: Annotated[Text | None, Field(min_length=1, max_length=64, description="null: as the file.")] = None
    description: Annotated[Text, Field(max_length=1000, description="What branches it draws.")] = ""
    apical_control: Annotated[Fraction, Field(description="Place in the morphospace [lambda].")]
    determinacy: Annotated[Fraction, Field(description="Place in the morphospace [D].")]
    nodes: Annotated[
        tuple[PrototypeNode, ...],
        Field(min_length=1, max_length=MOST_NODES - 1, description="All but the root, parents first; see the page."),
    ]

    @model_validator(mode="after")
    def _is_a_tree(self) -> Self:
        births = [0.0]
        for number, node in enumerate(self.nodes, 1):
            if node.parent >= number:
                raise mistake(
                    f"0 (the root) to {number - 1}: the first entry is node 1",
                    problem=f"node {number} grows from a node that stands after it, or from itself",
                    got=str(node.parent),
                    at=("nodes", number - 1, "parent"),
                )
            if node.birth < births[node.parent]:
                raise mistake(
                    f"at least its parent's: {births[node.parent]:g}",
                    problem=f"node {number} is born before the node it grows from",
                    got=f"{node.birth:g}",
                    at=("nodes", number - 1, "birth"),
                )
            births.append(node.birth)
        return self

    def prototype(self, name: str) -> Prototype:
        """The arrays; `name` stands where the file gives none."""
        directions = [np.array([0.0, 0.0, 1.0])]
        for node in self.nodes:
            directions.append(_direction(node, directions[node.parent]))
        numbers = [(0.0, 0.0, 1.0), *((node.length, node.birth, node.thickness) for node in self.nodes)]
        length, birth, thickness = np.array(numbers, dtype=np.float32).T
        return Prototype(
            self.name or name,
            self.apical_control,
            self.determinacy,
            np.array([-1, *(node.parent for node in self.nodes)], dtype=np.int16),
            np.array(directions, dtype=np.float32),
            length.copy(),
            birth.copy(),
            thickness.copy(),
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


def parse_prototype(name: str, text: str) -> Prototype:
    """The prototype of a file's text.

    Raises
    ------
    AssetError : the text is no prototype; with the line, what was expected and what was found.
    """
    data, sources = parse_yaml(text, name, error=AssetError)
    if not isinstance(data, dict):
        raise AssetError("not a mapping", where=name, expected="keys such as apical_control and nodes", got="no keys")
    return _checked(data, sources, Path(name).stem)


class PrototypeText(Section):
    """A prototype as recipes name it: a shipped one's name, or a file's path; drawn recipes hold a file's text too."""

    name: Annotated[Text, Field(min_length=1, max_length=1000, description="Such as whorled, or a path.")]
    text: Annotated[Text | None, Field(max_length=MOST_BYTES, description="Content of a file of your own.")] = None


def load_prototypes(
    names: Sequence[str | PrototypeText] | None = None, folder: Path | None = None
) -> tuple[Prototype, ...]:
    """The prototypes of the names, sorted by name.

    Parameters
    ----------
    names : of shipped prototypes, paths of files, or paths of folders with files (with a slash), relative to `folder`;
        or files' names with their texts. None: all shipped.
    folder : the recipe's folder; None: the working directory.

    Raises
    ------
    AssetError : no such file, a file that is no prototype, or two of one name.
    """
    if names is None:
        return _shipped()
    found: list[Prototype] = []
    for entry in names:
        if isinstance(entry, PrototypeText) and entry.text is not None:
            found.append(parse_prototype(entry.name, entry.text))
        else:
            found += [_read(path) for path in prototype_files(entry if isinstance(entry, str) else entry.name, folder)]
    return in_order(found)


def prototype_files(name: str, folder: Path | None = None) -> list[Path]:
    """The file of a prototype's name or path, or those of a folder's path, sorted."""
    own = Path(name) if folder is None else inside(folder, name)
    try:
        is_folder = ("/" in name or "\\" in name) and own.is_dir()
        listed = sorted(path for path in own.iterdir() if path.suffix in (".yaml", ".yml")) if is_folder else []
    except (OSError, ValueError) as cause:  # no name for a file, or a folder that may not be read
        raise AssetError("the folder cannot be read", where=str(own), got=str(cause)) from cause
    if is_folder and not listed:
        raise AssetError("a folder without prototypes", where=str(own), expected="files such as fork.yaml")
    return listed or [find_asset("modules", name, folder=folder)]


def in_order(prototypes: Sequence[Prototype]) -> tuple[Prototype, ...]:
    """Prototypes sorted by name, as module graphs count them; two of one name or place are an error."""
    found = tuple(sorted(prototypes, key=lambda prototype: prototype.name))
    if not 1 <= len(found) <= MOST_PROTOTYPES:
        raise AssetError("bad number of prototypes", expected=f"1 to {MOST_PROTOTYPES}", got=str(len(found)))
    for one, next_one in itertools.pairwise(found):
        if one.name == next_one.name:
            raise AssetError("two prototypes of one name", expected="names of their own", got=repr(one.name))
    places: dict[tuple[float, float], str] = {}
    for one in found:
        place = one.apical_control, one.determinacy
        if place in places:
            raise AssetError(
                "two prototypes at one place of the morphospace",
                expected="another apical_control or determinacy: a region belongs to one prototype",
                got=f"{places[place]!r} and {one.name!r} at {place[0]:g}, {place[1]:g}",
            )
        places[place] = one.name
    return found


@cache
def _shipped() -> tuple[Prototype, ...]:
    return in_order([_read(find_asset("modules", name)) for name in list_assets("modules")])


def _read(path: Path) -> Prototype:
    data, sources = read_yaml(path, error=AssetError)
    return _checked(data, sources, path.stem)


def _checked(data: dict[str, Any], sources: SourceMap, name: str) -> Prototype:
    try:
        return PrototypeFile.model_validate(data).prototype(name)
    except ValidationError as failure:
        found = Explainer(PrototypeFile, data, sources, (), {}).error(failure)
        raise AssetError(
            found.problem, where=found.where, expected=found.expected, got=found.got, hint=found.hint
        ) from failure


def choose_prototype(
    prototypes: Sequence[Prototype], apical_control: Any, determinacy: Any, *, allowed: NDArray[np.bool_] | None = None
) -> NDArray[np.uint8]:
    """Index of the prototype whose Voronoi region of the morphospace holds each point; the first of equals.

    Parameters
    ----------
    apical_control, determinacy : (...) lambda and D', 0 to 1; of one shape, or one number.
    allowed : (..., S) among which prototypes each may choose, at least one; None: all.
    """
    control, determinate = np.broadcast_arrays(
        np.asarray(apical_control, dtype=np.float64), np.asarray(determinacy, dtype=np.float64)
    )
    nearest = np.full(control.shape, np.inf)
    chosen = np.zeros(control.shape, dtype=np.uint8)
    for index, prototype in enumerate(prototypes):  # one pass a prototype: no (..., S) array
        distance = (control - prototype.apical_control) ** 2 + (determinate - prototype.determinacy) ** 2
        closer = distance < nearest
        if allowed is not None:
            closer &= allowed[..., index]
        chosen[closer] = index
        nearest = np.where(closer, distance, nearest)
    return chosen
