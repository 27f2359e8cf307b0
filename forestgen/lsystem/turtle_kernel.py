"""The turtle's walk through a word, compiled. `turtle` prepares the tables and reads what is left behind.

Few and plain arrays pass between the kernels: tuples of arrays would make them slow to compile and to call.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from forestgen.core.compiled import compiled

# What a module does: turns about U (H towards L), about L (U towards H) and about H (L towards U), half a turn, levels
NOTHING, TURN_U, TURN_L, TURN_H, AROUND, LEVEL = 0, 1, 2, 3, 4, 5
DRAW, DRAW_BARE, MOVE, MOVE_BARE = 6, 7, 8, 9  # F, G, f, g; the bare ones record no vertex
PUSH, POP, WIDTH, ELASTICITY, COLOUR, POLYGON, VERTEX, END_POLYGON, SURFACE = 10, 11, 12, 13, 14, 15, 16, 17, 18
CYLINDER, KNOT, END_CYLINDER, ASK_POSITION, ASK_HEADING, ASK_LEFT, ASK_UP = 19, 20, 21, 22, 23, 24, 25

# What may go wrong
OK, NEGATIVE_WIDTH, NO_SURFACE, NO_CYLINDER, BAD_STRIPS = 0, 1, 2, 3, 4

# The turtle's numbers `s`: vectors of three, then single ones
_P, HEADING, _L, _U, _KNOT_P, _KNOT_H = 0, 3, 6, 9, 12, 15
_H = HEADING
STATE_WIDTH, STATE_ELASTICITY, _KNOT_WIDTH = 18, 19, 20
STATE_SIZE: Final = 21
# Its marks `m`, which brackets restore: the axis is -1 where the next node begins one; moved is 1 after a move from the
# node, and 2 while the move's end begins a branch; the open segment is the node whose segment may still taper, or -1
_NODE, _AXIS, _MOVED, STATE_COLOUR, OPEN_SEGMENT, _IN_CYLINDER, _RESTORED = 0, 1, 2, 3, 4, 5, 6
# and its counters, which go on; _HERE is the index of the module
NODES, AXES, EVENTS, _DEPTH, _BRACES, _TURNS, _POLYGON, _BORNE, _HERE = 6, 7, 8, 9, 10, 11, 12, 13, 14
MARKS_SIZE: Final = 15
# The options `u`
STEP, ANGLE, TIP_WIDTH, INITIAL_WIDTH, INCREMENT, FACTOR, ELASTICITY_INCREMENT, SCALE = 0, 1, 2, 3, 4, 5, 6, 7
TAPERS, BENDS_MOVES, TROPISM = 8, 9, 10
OPTIONS_SIZE: Final = 13
# Columns of nodes: numbers (position in 0, 1, 2), then marks
START_RADIUS, RADIUS = 3, 4
NODE_NUMBERS: Final = 5
PARENT, ORDER, AXIS, NODE_COLOUR, IS_DRAWN, MODULE = 0, 1, 2, 3, 4, 5
NODE_MARKS: Final = 6
# Columns of events: what, module (of a vertex: its polygon's event), node, colour, index of the first parameter
EVENT_NUMBERS: Final = 12  # position, H, L, U; of a query its vector comes first
EVENT_MARKS: Final = 5

MOST_STRIPS: Final = 1000
DEFAULT_STRIPS: Final = 8
_TANGENT: Final = 1.2  # cpfg's length of a cylinder's tangents, in distances of its knots


@compiled
def _straighten(s: Any) -> None:
    """Undo what rounding did to the frame, U = H x L."""
    length = np.sqrt(s[_H] ** 2 + s[_H + 1] ** 2 + s[_H + 2] ** 2)
    along = 0.0
    for k in range(3):
        s[_H + k] /= length
        along += s[_H + k] * s[_L + k]
    for k in range(3):
        s[_L + k] -= along * s[_H + k]
    length = np.sqrt(s[_L] ** 2 + s[_L + 1] ** 2 + s[_L + 2] ** 2)
    for k in range(3):
        s[_L + k] /= length
    for k in range(3):
        one, two = (k + 1) % 3, (k + 2) % 3
        s[_U + k] = s[_H + one] * s[_L + two] - s[_H + two] * s[_L + one]


@compiled
def _turn(s: Any, m: Any, op: int, degrees: float) -> None:
    """A turn of one vector towards another; exact at multiples of 90 degrees."""
    if op == LEVEL:  # L = V x H / |V x H|, V up; ABOP p. 57
        if np.abs(s[_H]) + np.abs(s[_H + 1]) > 1e-9:
            s[_L], s[_L + 1], s[_L + 2] = -s[_H + 1], s[_H], 0.0
            m[_TURNS] = 63  # to be straightened below
    else:
        a, b = _H, _L
        if op == TURN_L:
            a, b = _U, _H
        elif op == TURN_H:
            a, b = _L, _U
        angle = 180.0 if op == AROUND else degrees % 360.0
        c, sine = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        if angle / 90.0 == np.floor(angle / 90.0):
            c, sine = np.floor(c + 0.5), np.floor(sine + 0.5)
        for k in range(3):
            first, second = s[a + k], s[b + k]
            s[a + k] = c * first + sine * second
            s[b + k] = c * second - sine * first
    m[_TURNS] += 1
    if m[_TURNS] % 64 == 0:
        _straighten(s)


@compiled
def _bend(s: Any, u: Any) -> None:
    """The tropism: a turn by e |H x T| radians about H x T."""
    x = s[_H + 1] * u[TROPISM + 2] - s[_H + 2] * u[TROPISM + 1]
    y = s[_H + 2] * u[TROPISM] - s[_H] * u[TROPISM + 2]
    z = s[_H] * u[TROPISM + 1] - s[_H + 1] * u[TROPISM]
    torque = np.sqrt(x * x + y * y + z * z)
    if torque < 1e-12:
        return
    x, y, z = x / torque, y / torque, z / torque
    angle = s[STATE_ELASTICITY] * torque
    c, sine = np.cos(angle), np.sin(angle)
    for v in range(_H, _U + 1, 3):
        a, b, d = s[v], s[v + 1], s[v + 2]
        along = (a * x + b * y + d * z) * (1.0 - c)
        s[v] = a * c + (y * d - z * b) * sine + x * along
        s[v + 1] = b * c + (z * a - x * d) * sine + y * along
        s[v + 2] = d * c + (x * b - y * a) * sine + z * along
    _straighten(s)


@compiled
def _node(s: Any, m: Any, nf: Any, ni: Any, start: float, end: float) -> None:
    """A node where the turtle stands, borne by the one before."""
    k, bearer = m[NODES], m[_NODE]
    ni[k, ORDER] = ni[bearer, ORDER]
    if m[_AXIS] < 0:
        m[_AXIS] = m[AXES]
        m[AXES] += 1
        if m[_MOVED] != 1:
            ni[k, ORDER] += 1
    for j in range(3):
        nf[k, j] = s[_P + j]
    nf[k, START_RADIUS] = 0.5 * start
    nf[k, RADIUS] = 0.5 * end
    ni[k, PARENT] = bearer
    ni[k, AXIS] = m[_AXIS]
    ni[k, NODE_COLOUR] = m[STATE_COLOUR]
    ni[k, IS_DRAWN] = m[_MOVED] == 0
    ni[k, MODULE] = m[_HERE]
    m[_NODE] = k
    m[NODES] += 1


@compiled
def _set_foot(s: Any, m: Any, nf: Any, ni: Any, width: float) -> None:
    """Where a segment begins: after a move, at a node of its own; the very first one, at the root."""
    if m[NODES] == 1:
        nf[0, START_RADIUS] = 0.5 * width
        nf[0, RADIUS] = 0.5 * width
        ni[0, NODE_COLOUR] = m[STATE_COLOUR]
        if m[_DEPTH] == 0 and m[_BORNE] == 0:
            for j in range(3):
                nf[0, j] = s[_P + j]
            m[_MOVED] = 0
    if m[_MOVED] != 0:
        m[_MOVED] = 2 if m[_AXIS] < 0 else 1
        m[_AXIS] = -1
        _node(s, m, nf, ni, width, width)
        m[_MOVED] = 0


@compiled
def _event(s: Any, m: Any, ef: Any, ei: Any, what: int) -> None:
    """Note a vector of the turtle, or, for a surface, its frame and position."""
    k = m[EVENTS]
    vector = _P + 3 * (what - ASK_POSITION) if what > ASK_POSITION else _P
    for j in range(12):
        ef[k, j] = s[(vector + j) % 12]
    ei[k, 0] = what
    ei[k, 1] = m[_POLYGON] if what == VERTEX else m[_HERE]
    ei[k, 2] = m[_NODE]
    ei[k, 3] = m[STATE_COLOUR]
    m[EVENTS] += 1
    if what <= SURFACE:
        m[_BORNE] += 1


@compiled
def _forward(s: Any, m: Any, u: Any, nf: Any, ni: Any, op: int, given: Any) -> int:
    """F, G, f and g, of `given` parameters; NaN: not given."""
    length = u[SCALE] * (u[STEP] if np.isnan(given[0]) else given[0])
    draws = m[_IN_CYLINDER] == 0 and ((op == DRAW and m[_BRACES] == 0) or op == DRAW_BARE)
    width = s[STATE_WIDTH]
    end = width
    if not np.isnan(u[TIP_WIDTH]):
        width = u[SCALE] * (u[INITIAL_WIDTH] if np.isnan(given[1]) else given[1])
        end = u[SCALE] * (u[TIP_WIDTH] if np.isnan(given[2]) else given[2])
        if width < 0.0 or end < 0.0:
            return NEGATIVE_WIDTH
    m[OPEN_SEGMENT] = -1
    if length != 0.0:
        if draws:
            _set_foot(s, m, nf, ni, width)
        for k in range(3):
            s[_P + k] += length * s[_H + k]
        if draws:
            _node(s, m, nf, ni, width, end)
            m[OPEN_SEGMENT] = m[_NODE]
        else:
            m[_MOVED] = 1
    if s[STATE_ELASTICITY] != 0.0 and (op <= DRAW_BARE or u[BENDS_MOVES] != 0.0):
        _bend(s, u)
    return OK


@compiled
def _set_width(s: Any, m: Any, u: Any, nf: Any, sign: float, value: float) -> int:
    if not np.isnan(value):
        s[STATE_WIDTH] = u[SCALE] * value
    elif np.isnan(u[FACTOR]):
        s[STATE_WIDTH] = max(s[STATE_WIDTH] + sign * u[INCREMENT] * u[SCALE], 0.0)
    elif sign < 0.0:
        s[STATE_WIDTH] *= u[FACTOR]
    else:
        s[STATE_WIDTH] /= u[FACTOR]
    if s[STATE_WIDTH] < 0.0:
        return NEGATIVE_WIDTH
    if u[TAPERS] != 0.0 and m[OPEN_SEGMENT] >= 0:
        nf[m[OPEN_SEGMENT], RADIUS] = 0.5 * s[STATE_WIDTH]
    return OK


@compiled
def _polygon(m: Any, ei: Any, open_polygons: Any, op: int) -> None:
    """{ and }; the next event is that of {."""
    if op == POLYGON:
        open_polygons[m[_BRACES]] = m[EVENTS]
        m[_BRACES] += 1
    else:
        m[_BRACES] -= 1
        ei[open_polygons[m[_BRACES]], 3] = m[STATE_COLOUR]
    if m[_BRACES] > 0:
        m[_POLYGON] = open_polygons[m[_BRACES] - 1]


@compiled
def _curve(s: Any, m: Any, nf: Any, ni: Any, strips: int) -> None:
    """A generalized cylinder from its last knot to the turtle: a Hermite cubic."""
    x, y, z = s[_P], s[_P + 1], s[_P + 2]
    distance = np.sqrt((x - s[_KNOT_P]) ** 2 + (y - s[_KNOT_P + 1]) ** 2 + (z - s[_KNOT_P + 2]) ** 2)
    thicker = s[STATE_WIDTH] - s[_KNOT_WIDTH]
    m[_MOVED] = 0
    for j in range(1, strips + 1 if distance > 0.0 else 1):
        t = j / strips
        leave = t * (1.0 - t) ** 2 * _TANGENT * distance
        arrive = t * t * (t - 1.0) * _TANGENT * distance
        share = t * t * (3.0 - 2.0 * t)
        s[_P], s[_P + 1], s[_P + 2] = x, y, z
        for k in range(3):
            chord = (1.0 - share) * s[_KNOT_P + k] + share * s[_P + k]
            s[_P + k] = chord + leave * s[_KNOT_H + k] + arrive * s[_H + k]
        start = s[_KNOT_WIDTH] + thicker * (j - 1) / strips
        _node(s, m, nf, ni, start, s[_KNOT_WIDTH] + thicker * t)
    s[_P], s[_P + 1], s[_P + 2] = x, y, z


@compiled
def _cylinder(s: Any, m: Any, nf: Any, ni: Any, op: int, value: float) -> int:
    if op == CYLINDER:
        _set_foot(s, m, nf, ni, s[STATE_WIDTH])
    else:
        strips = float(DEFAULT_STRIPS) if np.isnan(value) else np.floor(value)
        if m[_IN_CYLINDER] == 0:
            return NO_CYLINDER
        if strips < 1.0 or strips > MOST_STRIPS:
            return BAD_STRIPS
        _curve(s, m, nf, ni, int(strips))
    m[_IN_CYLINDER] = op != END_CYLINDER
    for k in range(3):
        s[_KNOT_P + k] = s[_P + k]
        s[_KNOT_H + k] = s[_H + k]
    s[_KNOT_WIDTH] = s[STATE_WIDTH]
    return OK


@compiled
def _branch(s: Any, m: Any, states: Any, marks: Any, op: int) -> None:
    m[OPEN_SEGMENT] = -1
    if op == PUSH:
        d = m[_DEPTH]
        for k in range(STATE_SIZE):
            states[d, k] = s[k]
        for k in range(_RESTORED):
            marks[d, k] = m[k]
        m[_DEPTH] += 1
        m[_AXIS] = -1
        m[_IN_CYLINDER] = 0
    else:
        m[_DEPTH] -= 1
        d = m[_DEPTH]
        for k in range(STATE_SIZE):
            s[k] = states[d, k]
        for k in range(_RESTORED):
            m[k] = marks[d, k]


@compiled
def walk(
    code: Any, parameter: Any, ops: Any, sign: Any, arity: Any, u: Any, s: Any, m: Any,
    nf: Any, ni: Any, ef: Any, ei: Any, states: Any, marks: Any, open_polygons: Any, given: Any,
) -> tuple[int, Any]:  # fmt: skip
    """Read a word; (what went wrong, index of that module).

    Parameters
    ----------
    ops, sign, arity : of each kind, what it does, the sense of its angle or increment, and its parameters' number.
    u, s, m : the options; the turtle's numbers and marks at the start (one node and axis, the root).
    nf, ni, ef, ei : space for numbers and marks of nodes and events.
    states, marks, open_polygons : space for as many as brackets and braces lie within one another.
    given : (3,) space.
    """
    i = at = np.int64(0)
    while i < len(code):
        kind = code[i]
        op, n = ops[kind], arity[kind]
        status, noted = OK, np.int64(NOTHING)
        m[_HERE] = i
        if op != NOTHING:
            for k in range(3):
                given[k] = parameter[at + k] if k < n else np.nan
            if op <= LEVEL:
                _turn(s, m, op, sign[kind] * (given[0] if n > 0 else u[ANGLE]))
            elif op <= MOVE_BARE:
                status = _forward(s, m, u, nf, ni, op, given)
                if m[_BRACES] > 0 and (op == DRAW or op == MOVE):  # noqa: SIM109 (compiled)
                    noted = np.int64(VERTEX)
            elif op <= POP:
                _branch(s, m, states, marks, op)
            elif op == WIDTH:
                status = _set_width(s, m, u, nf, sign[kind], given[0])
            elif op == ELASTICITY:
                s[STATE_ELASTICITY] = given[0] if n > 0 else s[STATE_ELASTICITY] + u[ELASTICITY_INCREMENT]
            elif op == COLOUR:
                m[STATE_COLOUR] = int(min(max(given[0], 0.0), 1e9)) if n > 0 else m[STATE_COLOUR] + int(sign[kind])
            elif op == VERTEX:
                if m[_BRACES] > 0:
                    noted = op
            elif op <= END_POLYGON:
                m[OPEN_SEGMENT] = -1
                _polygon(m, ei, open_polygons, op)
                if op == POLYGON:
                    noted = op
            elif op == SURFACE:
                at += n
                i += 1
                if i == len(code) or ops[code[i]] == PUSH or ops[code[i]] == POP:
                    return NO_SURFACE, i - 1
                m[OPEN_SEGMENT] = -1
                ei[m[EVENTS], 4] = at
                noted = op
                n = arity[code[i]]
            elif op <= END_CYLINDER:
                m[OPEN_SEGMENT] = -1
                status = _cylinder(s, m, nf, ni, op, given[0])
            else:
                noted = op
            if noted != NOTHING:
                _event(s, m, ef, ei, noted)
            if status != OK:
                return status, i
        at += n
        i += 1
    return OK, 0
