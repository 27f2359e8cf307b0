"""What a turtle starts with, and what its dialect makes of each symbol."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import LsystemError
from forestgen.lsystem import turtle_kernel as act

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
