"""A slow turtle in plain Python, written from the table of symbols, not from the kernel."""

from __future__ import annotations

import copy
import math
import re
from dataclasses import dataclass, field

import numpy as np

from forestgen.lsystem.multiset import RESERVED, Kind
from forestgen.lsystem.turtle import TurtleOptions, draw, query_values

UNIT = TurtleOptions(angle_deg=90.0)
_MODULE = re.compile(r"(@G[sce]|@v|[?][A-Z]|\S)(?:\(([^()]*)\))?")


def modules(text):
    """[(symbol, [parameters])] of a text such as F(2)[+F]."""
    return [(s, [float(p) for p in given.split(",")] if given else []) for s, given in _MODULE.findall(text)]


def encode(text):
    """code, parameter, kinds of a text."""
    found = modules(text)
    kinds = list(RESERVED)
    for symbol, given in found:
        if Kind(symbol, len(given)) not in kinds:
            kinds.append(Kind(symbol, len(given)))
    code = np.array([kinds.index(Kind(s, len(g))) for s, g in found], dtype=np.uint16)
    return code, np.array([p for _, given in found for p in given]), tuple(kinds)


def about(axis, degrees, vector):
    """Rodrigues' rotation, right-handed."""
    a = math.radians(degrees)
    turned = vector * math.cos(a) + np.cross(axis, vector) * math.sin(a)
    return turned + axis * np.dot(axis, vector) * (1.0 - math.cos(a))


#: symbol -> (name of the axis, sign), by the words of each dialect
TURNS = {
    "cpfg": {"+": "U+", "-": "U-", "&": "L+", "^": "L-", "\\": "H+", "/": "H-"},
    "abop": {"+": "U+", "-": "U-", "&": "L+", "^": "L-", "\\": "H-", "/": "H+"},
    "rhover": {"<": "U-", ">": "U+", "&": "H-", "@": "H+", "%": "L+", "#": "L-"},
}


@dataclass
class Turtle:
    width: float
    elasticity: float
    p: np.ndarray = field(default_factory=lambda: np.zeros(3))
    h: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    left: np.ndarray = field(default_factory=lambda: np.array([-1.0, 0.0, 0.0]))
    up: np.ndarray = field(default_factory=lambda: np.array([0.0, -1.0, 0.0]))

    def turn(self, axis, degrees):
        axis = {"H": self.h, "L": self.left, "U": self.up}.get(axis) if isinstance(axis, str) else axis
        self.h, self.left, self.up = (about(axis, degrees, v) for v in (self.h, self.left, self.up))


class Oracle:
    """Segments (start, end, start width, end width), queries and polygons of a text without surfaces."""

    def __init__(self, text, options):
        self.o = options
        self.segments, self.queries, self.polygons, self.open = [], [], [], []
        self.t = Turtle(options.width, options.elasticity)
        self.last = None  # segment whose end may still change
        stack = []
        for symbol, given in modules(text):
            if symbol == "[":
                stack.append(copy.deepcopy(self.t))
                self.last = None
            elif symbol == "]":
                self.t = stack.pop()
                self.last = None
            else:
                self.step(symbol, given)

    def step(self, symbol, given):
        o, t = self.o, self.t
        turn = TURNS[o.dialect].get(symbol)
        if turn:
            sign = 1.0 if turn[1] == "+" else -1.0
            t.turn(turn[0], sign * (given[0] if given else o.angle_deg))
        elif symbol == "|":
            t.turn("U", 180.0)
        elif symbol == "$" and o.dialect != "rhover":
            if np.hypot(t.h[0], t.h[1]) > 1e-9:
                t.left = np.cross([0.0, 0.0, 1.0], t.h)
                t.left /= np.linalg.norm(t.left)
                t.up = np.cross(t.h, t.left)
        elif symbol in "FfG":
            self.forward(symbol, given)
        elif symbol == "!" and o.dialect != "rhover":
            if given:
                t.width = given[0]
            elif o.width_factor is None:
                t.width = max(t.width - o.width_increment, 0.0)
            else:
                t.width *= o.width_factor
            if self.last is not None and o.dialect == "cpfg":
                self.last[3] = t.width
        elif symbol == "_":
            t.elasticity = given[0]
        elif symbol in "{}.":
            self.polygon(symbol)
        elif symbol[0] == "?":
            self.queries.append({"P": t.p, "H": t.h, "L": t.left, "U": t.up}[symbol[1]].copy())

    def polygon(self, symbol):
        self.last = self.last if symbol == "." else None
        if symbol == "{":
            self.open.append([])
            self.polygons.append(self.open[-1])
        elif symbol == "}":
            self.open.pop()
        elif self.open:
            self.open[-1].append(self.t.p.copy())

    def forward(self, symbol, given):
        o, t = self.o, self.t
        if symbol != "F" and o.dialect == "rhover":
            return
        start = t.p.copy()
        length = given[0] if given else o.step
        t.p = t.p + length * t.h
        widths = [t.width, t.width]
        if o.dialect == "rhover":
            widths = [(given[1:2] or [o.width])[0], (given[2:3] or [o.tip_width])[0]]
        self.last = None
        if (symbol == "G" or (symbol == "F" and not self.open)) and length:
            self.last = [start, t.p.copy(), *widths]
            self.segments.append(self.last)
        if t.elasticity and (symbol != "f" or o.dialect == "cpfg"):
            torque = np.cross(t.h, o.tropism)
            size = np.linalg.norm(torque)
            if size > 1e-12:
                t.turn(torque / size, math.degrees(t.elasticity * size))
        if self.open and symbol in "Ff":
            self.open[-1].append(t.p.copy())


def picture(text, options=UNIT, surfaces=None):
    return draw(*encode(text), options, surfaces)


def queries(text, options=UNIT):
    return query_values(*encode(text), options)[0]


def frame(text, options=UNIT):
    """H, L, U after a text."""
    return queries(text + "?H?L?U", options)


def segments(drawing):
    """(n, 8) start, end, start and end diameter, in the word's order."""
    drawn = np.flatnonzero(drawing.is_drawn)
    drawn = drawn[np.argsort(drawing.module[drawn], kind="stable")]
    start, end = drawing.position[drawing.parent[drawn]], drawing.position[drawn]
    return np.column_stack([start, end, 2 * drawing.start_radius[drawn], 2 * drawing.radius[drawn]])
