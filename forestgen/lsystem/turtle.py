r"""The turtle: a word's modules, read from left to right, draw axes, surfaces and polygons.

The turtle has a position P and a right-handed frame of unit vectors H (heading), L (left) and U = H x L (up), so
L = U x H. It starts at the origin with H up (z), L = -x and U = -y: cpfg's picture, set upright on
the ground. A turn by a positive angle about an axis is right-handed: about U, H goes towards L; about L, U goes
towards H; about H, L goes towards U.

docs/lsystem.md has the modules of each dialect and the options in a program's header (`ACTIONS` and
`TURTLE_STATEMENTS`). All other symbols are read over. A parameter replaces the default: the angle,
the step, or the increment. What was decided:

- Roll: cpfg's program keeps the opposite of U, so that its ``\`` takes L towards U as H x L has it; ABOP's words
  ("roll left using R_H") and its matrices, read so that + turns left and & pitches down, take L away from U. Each
  dialect keeps its own. ?U gives U = H x L in all of them.
- Widths are diameters. In cpfg, a width that is set behind a segment, before the next one or a bracket, is the width
  of that segment's end; elsewhere a segment of F(l) is a cylinder. cpfg's ! stops at 0, while a negative parameter is
  an error.
- Tropism: after each F and G (in cpfg, after f and g, too) H, L, U turn by e |H x T| radians about H x T.
- A surface's frame has its y axis along H, z along U, x along -L, and is scaled by s (three parameters: x, y, z).
- Between { and }, F and f record a vertex where they end and draw nothing; G draws but records none; ``.`` records
  where the turtle stands, in brackets also. Polygons may lie in one another; those of fewer than three vertices are
  left out.
- Between @Gs and @Ge, F and f only move. @Gc(n) and @Ge(n) draw n segments (8 if not given) of the Hermite cubic
  from the knot before, with tangents along H, 1.2 times as long as the knots' distance; widths change linearly. A
  branch within needs an @Gs of its own.
- ``rhover``: the turtle's x, y, z axes are -L, H, U; "right" is the negative sense of a rotation. F's defaults are
  10, 2, 1; that of an angle is 45 degrees.

References
----------
Prusinkiewicz, P., Lindenmayer, A. (1990). The Algorithmic Beauty of Plants (ABOP). Sections 1.5, 1.10, 2.3, 5.
Mech, R., Prusinkiewicz, P. (1998). CPFG version 4.0 user's manual, appendix on interpreted symbols.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import LsystemError
from forestgen.lsystem import turtle_kernel as act
from forestgen.lsystem.multiset import Kind, Multiset

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

FARTHEST_M = 1e6

#: Statements of a program's header that set the turtle up: name -> how many numbers may follow.
TURTLE_STATEMENTS: dict[str, tuple[int, ...]] = {
    **dict.fromkeys(("angle", "step", "scale", "width", "width increment", "width factor", "tip width"), (1,)),
    "tropism": (3, 4), "elasticity": (1,), "elasticity increment": (1,), "heading": (3,), "colour": (1,),
}  # fmt: skip


@dataclass(frozen=True)
class TurtleOptions:
    """The turtle at the start. Lengths are in the program's units; `scale` turns them into metres."""

    dialect: str = "cpfg"
    angle_deg: float = 45.0  # of a turn without parameter
    step: float = 1.0  # of F, f, G and g without parameter
    scale: float = 1.0  # metres a unit; positions, widths and surfaces are multiplied by it
    width: float = 0.1  # diameter of the first segments
    width_increment: float = 0.0  # of ! and # without parameter
    width_factor: float | None = None  # of ! without parameter; takes the increment's place
    tip_width: float | None = None  # of each F without one (dialect rhover); None: segments are no cones
    tropism: tuple[float, float, float] = (0.0, 0.0, -1.0)  # T of alpha = e |H x T|, plant frame
    elasticity: float = 0.0  # e, in radians
    elasticity_increment: float = 0.0  # of _ without parameter
    heading: tuple[float, float, float] = (0.0, 0.0, 1.0)  # plant frame, z up
    colour: int = 0

    @property
    def frame(self) -> NDArray[np.float64]:
        """(3, 3) rows H, L, U at the start: for H up, L is -x and U is -y; else that frame is turned the short way."""
        h = np.array(self.heading) / np.linalg.norm(self.heading)
        if h[2] < -1.0 + 1e-6:  # nearly down, where the short way is any
            left = np.array([-1.0, 0.0, 0.0]) + h[0] * h
            left /= np.linalg.norm(left)
            return np.array([h, left, np.cross(h, left)])
        v = np.array([-h[1], h[0], 0.0])  # z x H
        skew = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
        turn = np.eye(3) + skew + skew @ skew / (1.0 + h[2])
        upright = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
        turned: NDArray[np.float64] = upright @ turn.T
        return turned

    def start(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """The turtle's numbers and marks at the root, as the kernel reads them."""
        state, marks = np.zeros(act.STATE_SIZE), np.zeros(act.MARKS_SIZE, np.int64)
        state[act.HEADING : act.HEADING + 9] = self.frame.reshape(-1)
        state[act.STATE_WIDTH], state[act.STATE_ELASTICITY] = self.scale * self.width, self.elasticity
        marks[act.NODES] = marks[act.AXES] = 1
        marks[act.STATE_COLOUR], marks[act.OPEN_SEGMENT] = self.colour, -1
        return state, marks

    def numbers(self) -> NDArray[np.float64]:
        """The options as the kernel reads them; NaN for None."""
        found = np.zeros(act.OPTIONS_SIZE)
        found[act.STEP], found[act.ANGLE], found[act.SCALE] = self.step, self.angle_deg, self.scale
        found[act.INITIAL_WIDTH], found[act.INCREMENT] = self.width, self.width_increment
        found[act.TIP_WIDTH] = np.nan if self.tip_width is None else self.tip_width
        found[act.FACTOR] = np.nan if self.width_factor is None else self.width_factor
        found[act.ELASTICITY_INCREMENT] = self.elasticity_increment
        found[act.TAPERS] = found[act.BENDS_MOVES] = self.dialect == "cpfg"
        found[act.TROPISM :] = self.tropism
        return found


_DEFAULTS = {
    "cpfg": TurtleOptions("cpfg"),
    "abop": TurtleOptions("abop", width_factor=math.sqrt(0.5)),
    "rhover": TurtleOptions("rhover", step=10.0, width=2.0, tip_width=1.0),
}
_FIELDS = {"angle": "angle_deg"} | {name: name.replace(" ", "_") for name in TURTLE_STATEMENTS if name != "angle"}


def options_from(turtle: Mapping[str, tuple[float, ...]], dialect: str, where: str | None = None) -> TurtleOptions:
    """The options that a program's header sets, over the dialect's defaults; `where` names the program in messages.

    Raises `LsystemError` for an unknown name, a wrong number of numbers, or an impossible value.
    """
    if dialect not in _DEFAULTS:
        raise LsystemError("an unknown dialect", where=where, expected=" or ".join(_DEFAULTS), got=dialect)
    changes: dict[str, object] = {}
    for name, numbers in turtle.items():
        _check(name, numbers, where)
        if name in ("tropism", "heading"):
            changes[name] = tuple(numbers[:3])
            if len(numbers) == 4:
                changes["elasticity"] = numbers[3]
        else:
            changes[_FIELDS[name]] = int(numbers[0]) if name == "colour" else float(numbers[0])
    if "width_increment" in changes:
        if "width_factor" in changes:
            expected = "width increment: or width factor:, not both"
            raise LsystemError("the width has both an increment and a factor", where=where, expected=expected)
        changes["width_factor"] = None
    return TurtleOptions(**{**vars(_DEFAULTS[dialect]), **changes})


def _check(name: str, numbers: tuple[float, ...], where: str | None) -> None:
    if name not in TURTLE_STATEMENTS:
        names = ", ".join(TURTLE_STATEMENTS)
        raise LsystemError("the turtle has no such option", where=where, expected=f"one of {names}", got=name)
    allowed = TURTLE_STATEMENTS[name]
    got = " ".join(f"{number:g}" for number in numbers) or "nothing"
    expected = None
    if len(numbers) not in allowed:
        expected = f"{' or '.join(map(str, allowed))} number{'s' if allowed != (1,) else ''}"
    elif not all(map(math.isfinite, numbers)):
        expected = "finite numbers"
    elif name in ("scale", "width factor") and numbers[0] <= 0.0:
        expected = "a number above 0"
    elif name in ("width", "tip width") and numbers[0] < 0.0:
        expected = "a number of 0 or more"
    elif name == "heading" and math.hypot(*numbers) < 1e-9:
        expected = "a vector that is not zero"
    elif name == "colour" and not (numbers[0].is_integer() and 0 <= numbers[0] <= 1e9):
        expected = "a whole number of 0 or more"
    if expected:
        raise LsystemError(f"{name}: has a value that cannot be", where=where, expected=expected, got=got)


_Actions = dict[str, tuple[int, float]]
_SHARED: _Actions = {
    "F": (act.DRAW, 0.0), "[": (act.PUSH, 0.0), "]": (act.POP, 0.0), "|": (act.AROUND, 0.0),
    "?P": (act.ASK_POSITION, 0.0), "?H": (act.ASK_HEADING, 0.0), "?L": (act.ASK_LEFT, 0.0), "?U": (act.ASK_UP, 0.0),
}  # fmt: skip
_BOTANY: _Actions = _SHARED | {
    "f": (act.MOVE, 0.0), "G": (act.DRAW_BARE, 0.0), "+": (act.TURN_U, 1.0), "-": (act.TURN_U, -1.0),
    "&": (act.TURN_L, 1.0), "^": (act.TURN_L, -1.0), "$": (act.LEVEL, 0.0), "!": (act.WIDTH, -1.0),
    "{": (act.POLYGON, 0.0), ".": (act.VERTEX, 0.0), "}": (act.END_POLYGON, 0.0), "~": (act.SURFACE, 0.0),
    "_": (act.ELASTICITY, 0.0),
}  # fmt: skip
_CPFG: _Actions = _BOTANY | {
    "\\": (act.TURN_H, 1.0), "/": (act.TURN_H, -1.0), "g": (act.MOVE_BARE, 0.0), "#": (act.WIDTH, 1.0),
    ";": (act.COLOUR, 1.0), ",": (act.COLOUR, -1.0), "@v": (act.LEVEL, 0.0), "@Gs": (act.CYLINDER, 0.0),
    "@Gc": (act.KNOT, 0.0), "@Ge": (act.END_CYLINDER, 0.0),
}  # fmt: skip
_RHOVER: _Actions = _SHARED | {
    "<": (act.TURN_U, -1.0), ">": (act.TURN_U, 1.0), "&": (act.TURN_H, -1.0), "@": (act.TURN_H, 1.0),
    "%": (act.TURN_L, 1.0), "#": (act.TURN_L, -1.0),
}  # fmt: skip
#: Dialect -> symbol -> what the turtle does, and the sign of its angle or increment in the right-handed frame.
ACTIONS: dict[str, _Actions] = {
    "cpfg": _CPFG,
    "abop": _BOTANY | {"\\": (act.TURN_H, -1.0), "/": (act.TURN_H, 1.0), "'": (act.COLOUR, 1.0)},
    "rhover": _RHOVER,
}


@dataclass(frozen=True)
class Surfaces:
    """S surfaces placed by ``~``."""

    symbol: NDArray[np.str_]  # (S,) name of the surface
    frame: Floats  # (S, 3, 4) surface -> plant frame: y along H, z along U, scaled, metres
    node: NDArray[np.int32]  # (S,) the node that bears it
    colour: NDArray[np.int32]  # (S,)
    module: Ints  # (S,) index of the ~ in the word


@dataclass(frozen=True)
class Polygons:
    """G filled polygons, their vertices end to end."""

    vertex: Floats  # (V, 3) metres, plant frame
    offset: Ints  # (G + 1,) polygon g has the vertices offset[g] to offset[g + 1]
    node: NDArray[np.int32]  # (G,) the node that bears it
    colour: NDArray[np.int32]  # (G,)
    module: Ints  # (G,) index of the { in the word


@dataclass(frozen=True)
class Drawing:
    """What a turtle drew. Node i ends the segment from parent[i] to i; node 0 is the root, where drawing begins.

    Axis after axis, base to tip: the nodes of an axis lie together, and parents precede children. An axis goes on
    through brackets; each pair of brackets with a segment in it is an axis of the next order. A move without drawing
    ends an axis: the next one begins with a node whose `is_drawn` is False.
    """

    parent: NDArray[np.int32]  # (N,) -1 for the root
    position: Floats  # (N, 3) metres, plant frame, z up
    start_radius: Floats  # (N,) metres, of the segment where it begins
    radius: Floats  # (N,) metres, of the segment where it ends
    order: NDArray[np.int32]  # (N,) 0 trunk, 1 its branches, ...
    axis: NDArray[np.int32]  # (N,) 0 ... A - 1, ascending
    colour: NDArray[np.int32]  # (N,)
    is_drawn: NDArray[np.bool_]  # (N,) False for the root, and behind a move
    module: Ints  # (N,) index in the word of the module that drew it, -1 for the root
    surfaces: Surfaces
    polygons: Polygons


def draw(
    code: NDArray[np.uint16],
    parameter: Floats,
    kinds: Sequence[Kind],
    options: TurtleOptions,
    surfaces: Collection[str] | None = None,
) -> Drawing:
    """The picture of one word: `code` (M,) indexes `kinds`, `parameter` (P,) has all modules' parameters in order.

    `surfaces` are names that may follow ~; None: all. Raises `LsystemError` for brackets that do not match, an unknown
    surface, a negative width, or a number that is not finite.
    """
    walk = _walk(code, parameter, kinds, options)
    placed = _surfaces(walk, parameter, options.scale, surfaces)
    nodes, marks = walk.nodes, walk.node_marks
    near = np.all(np.abs(nodes[:, :3]) < FARTHEST_M, axis=1)
    if not near.all():
        module = int(marks[np.argmin(near), act.MODULE])
        _fail("the turtle went too far", module, code, kinds, f"less than {FARTHEST_M:g} m")
    by_axis = np.argsort(marks[:, act.AXIS], kind="stable")  # a branch's axis has a larger number than its bearer's
    place = np.empty(len(nodes), dtype=np.int32)
    place[by_axis] = np.arange(len(nodes), dtype=np.int32)
    nodes, marks = nodes[by_axis], marks[by_axis]
    parent = place[marks[:, act.PARENT]]
    parent[0] = -1
    return Drawing(
        parent=parent,
        position=nodes[:, :3].copy(),
        start_radius=nodes[:, act.START_RADIUS].copy(),
        radius=nodes[:, act.RADIUS].copy(),
        order=marks[:, act.ORDER].astype(np.int32),
        axis=marks[:, act.AXIS].astype(np.int32),
        colour=marks[:, act.NODE_COLOUR].astype(np.int32),
        is_drawn=marks[:, act.IS_DRAWN] == 1,
        module=marks[:, act.MODULE].copy(),
        surfaces=Surfaces(placed.symbol, placed.frame, place[placed.node], placed.colour, placed.module),
        polygons=_polygons(walk, place),
    )


def draw_word(
    multiset: Multiset, word: int, options: TurtleOptions, surfaces: Collection[str] | None = None
) -> Drawing:
    """The picture of the word at an index; see `draw`."""
    first, last = int(multiset.word_start[word]), int(multiset.word_start[word + 1])
    arity = multiset.arity
    skipped = int(arity[multiset.code[:first]].sum())
    size = int(arity[multiset.code[first:last]].sum())
    parameter = multiset.parameter[skipped : skipped + size]
    return draw(multiset.code[first:last], parameter, multiset.kinds, options, surfaces)


def query_values(
    code: NDArray[np.uint16], parameter: Floats, kinds: Sequence[Kind], options: TurtleOptions
) -> tuple[Floats, Ints]:
    """Answers to ?P, ?H, ?L and ?U of a word, and the index of each query in it.

    The answers (Q, 3) are x, y, z in the plant frame, positions in metres; a query of two parameters takes two of them.
    """
    walk = _walk(code, parameter, kinds, options)
    asked = walk.event_marks[:, 0] >= act.ASK_POSITION
    return walk.events[asked, :3], walk.event_marks[asked, 1]


@dataclass(frozen=True)
class _Walk:
    """What the kernel leaves behind."""

    code: NDArray[np.uint16]
    kinds: Sequence[Kind]
    nodes: Floats  # (N, NODE_NUMBERS)
    node_marks: Ints  # (N, NODE_MARKS)
    events: Floats  # (E, EVENT_NUMBERS)
    event_marks: Ints  # (E, EVENT_MARKS)


def _walk(code: NDArray[np.uint16], parameter: Floats, kinds: Sequence[Kind], options: TurtleOptions) -> _Walk:
    code = np.require(code, np.uint16, ["C", "W"])  # one type for the kernel, which is compiled for each
    parameter = np.require(parameter, np.float64, ["C", "W"])
    actions = ACTIONS[options.dialect]
    found = [actions.get(kind.symbol, (act.NOTHING, 0.0)) for kind in kinds]
    ops, sign = np.array([op for op, _ in found]), np.array([sense for _, sense in found])
    arity = np.array([kind.arity for kind in kinds], dtype=np.int64)
    op = ops[code]
    infinite = np.flatnonzero(~np.isfinite(parameter))
    if len(infinite):
        module = int(np.searchsorted(_starts(code, arity), infinite[0], side="right")) - 1
        _fail("a parameter is not finite", module, code, kinds, "a finite number")
    splines = [i for i, kind in enumerate(kinds) if kind.symbol in ("{", "}") and kind.arity]
    strange = np.flatnonzero(np.isin(code, splines) & (op != act.NOTHING))
    if len(strange):
        expected = "{ and }, or @Gs, @Gc and @Ge"
        _fail("braces with parameters are not supported", int(strange[0]), code, kinds, expected)
    brackets = _deepest(op, act.PUSH, act.POP, code, kinds)
    braces = _deepest(op, act.POLYGON, act.END_POLYGON, code, kinds)
    nodes, events = _space(op, code, parameter, arity)
    node, marks_of_node = np.zeros((nodes, act.NODE_NUMBERS)), np.zeros((nodes, act.NODE_MARKS), np.int64)
    event, marks_of_event = np.zeros((events, act.EVENT_NUMBERS)), np.zeros((events, act.EVENT_MARKS), np.int64)
    marks_of_node[0, act.MODULE], marks_of_node[0, act.NODE_COLOUR] = -1, options.colour
    node[0, act.START_RADIUS :] = 0.5 * options.scale * options.width
    state, marks = options.start()
    states = np.empty((brackets, act.STATE_SIZE)), np.empty((brackets, act.MARKS_SIZE), np.int64)
    status, module = act.walk(
        code, parameter, ops, sign, arity, options.numbers(), state, marks,
        node, marks_of_node, event, marks_of_event, *states, np.zeros(braces, np.int64), np.empty(3),
    )  # fmt: skip
    if status != act.OK:
        problem, expected = _PROBLEMS[status]
        _fail(problem, int(module), code, kinds, expected)
    n, e = marks[act.NODES], marks[act.EVENTS]
    return _Walk(code, kinds, node[:n], marks_of_node[:n], event[:e], marks_of_event[:e])


_PROBLEMS = {
    act.NEGATIVE_WIDTH: ("a width is negative", "0 or more"),
    act.NO_SURFACE: ("~ is not followed by a surface", "~ and the surface's module, such as ~K(2)"),
    act.NO_CYLINDER: ("a knot outside a generalized cylinder", "@Gs before it, in the same brackets"),
    act.BAD_STRIPS: ("a generalized cylinder of an impossible number of segments", f"1 to {act.MOST_STRIPS}"),
}


def _space(op: Ints, code: NDArray[np.uint16], parameter: Floats, arity: Ints) -> tuple[int, int]:
    """Numbers of nodes and of events that are surely enough."""
    times = np.bincount(op, minlength=act.ASK_UP + 1)
    segments = int(times[act.DRAW] + times[act.DRAW_BARE])
    moves = int(times[act.MOVE] + times[act.MOVE_BARE] + times[act.POLYGON] + times[act.CYLINDER])
    knots = np.flatnonzero((op == act.KNOT) | (op == act.END_CYLINDER))
    given = arity[code[knots]] > 0
    strips = act.DEFAULT_STRIPS * int((~given).sum())
    if given.any():
        strips += int(np.clip(parameter[_starts(code, arity)[knots[given]]], 0, act.MOST_STRIPS).sum())
    nodes = 1 + segments + (segments if moves else 0) + int(times[act.CYLINDER]) + strips
    vertices = int(times[act.VERTEX] + times[act.DRAW] + times[act.MOVE]) if times[act.POLYGON] else 0
    return nodes, vertices + int(times[act.POLYGON] + times[act.SURFACE] + times[act.ASK_POSITION :].sum())


def _starts(code: NDArray[np.uint16], arity: Ints) -> Ints:
    """(M,) index of each module's first parameter."""
    sizes = arity[code]
    return np.asarray(np.cumsum(sizes) - sizes, dtype=np.int64)


def _surfaces(walk: _Walk, parameter: Floats, unit_m: float, known: Collection[str] | None) -> Surfaces:
    placed = walk.event_marks[:, 0] == act.SURFACE
    _, module, node, colour, at = walk.event_marks[placed].T
    kind = walk.code[module + 1]
    names = np.array([one.symbol for one in walk.kinds], dtype=np.str_)
    strange = np.zeros(len(kind), np.bool_) if known is None else ~np.isin(names[kind], list(known))
    if known is not None and strange.any():
        expected = f"one of {', '.join(sorted(known))}" if known else "no surface"
        _fail("an unknown surface", int(module[strange][0]) + 1, walk.code, walk.kinds, expected)
    arity = np.array([one.arity for one in walk.kinds], dtype=np.int64)[kind]
    scale = np.full((len(kind), 3), unit_m)
    for k in range(3):
        source = np.where(arity >= 3, at + k, at)[arity > 0]
        scale[arity > 0, k] *= parameter[source]
    position, h, left, up = np.moveaxis(walk.events[placed].reshape(-1, 4, 3), 1, 0)
    columns = [-left * scale[:, :1], h * scale[:, 1:2], up * scale[:, 2:], position]
    return Surfaces(
        names[kind], np.stack(columns, axis=2), node.astype(np.int32), colour.astype(np.int32), module.copy()
    )


def _polygons(walk: _Walk, place: NDArray[np.int32]) -> Polygons:
    what = walk.event_marks[:, 0]
    vertices = walk.event_marks[what == act.VERTEX]
    opened = np.flatnonzero(what == act.POLYGON)
    owner = np.searchsorted(opened, vertices[:, 1])
    sizes = np.bincount(owner, minlength=len(opened))
    kept = sizes >= 3
    _, module, node, colour, _ = walk.event_marks[opened[kept]].T
    vertex = walk.events[what == act.VERTEX, :3][np.argsort(owner, kind="stable")][np.repeat(kept, sizes)]
    offset = np.concatenate([[0], np.cumsum(sizes[kept])]).astype(np.int64)
    return Polygons(vertex, offset, place[node], colour.astype(np.int32), module.copy())


def _fail(problem: str, module: int, code: NDArray[np.uint16], kinds: Sequence[Kind], expected: str) -> NoReturn:
    symbol = kinds[code[module]].symbol if module >= 0 else "the start"
    raise LsystemError(f"{problem}: module {module} of the word", expected=expected, got=symbol)


def _deepest(op: Ints, opens: int, closes: int, code: NDArray[np.uint16], kinds: Sequence[Kind]) -> int:
    """How deep brackets lie within one another; raises `LsystemError` where they do not match."""
    where = np.flatnonzero((op == opens) | (op == closes))
    if not len(where):
        return 0
    depth = np.cumsum(np.where(op[where] == opens, 1, -1))
    if depth.min() < 0:
        _fail("nothing is open that this could close", int(where[np.argmax(depth < 0)]), code, kinds, "balanced pairs")
    if depth[-1] > 0:
        last = int(np.flatnonzero(depth < depth[-1])[-1]) + 1 if (depth < depth[-1]).any() else 0
        _fail("this is never closed", int(where[last]), code, kinds, "balanced pairs")
    return int(depth.max())
