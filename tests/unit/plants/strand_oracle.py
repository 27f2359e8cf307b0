"""Algorithm 1 of Zamuda et al. (2007) once more: recursive, with 4x4 matrices, y up, as it stands on the page."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Matrix = NDArray[np.float64]

Polyline = list[tuple[float, float]]


@dataclass
class Model:
    """Parameters in the paper's symbols; each local one is its polyline over g and over w."""

    S: int
    l0: float
    k_d: float
    k_c: float
    alpha_p: float
    k_s: tuple[Polyline, Polyline]
    alpha: tuple[Polyline, Polyline]
    m: tuple[Polyline, Polyline]
    M: tuple[Polyline, Polyline]
    k_l: tuple[Polyline, Polyline]
    alpha_m: tuple[Polyline, Polyline]
    w: tuple[float, float, float] = (0.0, 1.0, 0.0)
    w_g: float = 0.0
    segments: list[tuple[int, int, int, float, Any, Any]] = field(default_factory=list)


def rotation(axis: Any, degrees: float) -> Matrix:
    """A rotation of 3-space as a 4x4 matrix."""
    out = np.eye(4)
    out[:3, :3] = Rotation.from_rotvec(math.radians(degrees) * np.asarray(axis, dtype=float)).as_matrix()
    return out


def translation(y: float) -> Matrix:
    out = np.eye(4)
    out[1, 3] = y
    return out


def local(pair: tuple[Polyline, Polyline], g: int, w: int) -> float:
    of_g, of_w = (np.interp(at, *np.array(line).T) for line, at in zip(pair, (g, w), strict=True))
    return float(of_g * of_w)


def branchsegment(t: Model, g: int, w: int, s0: int, big_l0: float, l0: float, m0: Matrix, calm0: Matrix) -> None:
    """Appends (g, w, S_0, d, foot, end) of this branch and of all that it bears, the minor ones first."""
    foot, end = (m0 @ [0, 0, 0, 1])[:3], (m0 @ [0, l0, 0, 1])[:3]
    t.segments.append((g, w, s0, t.k_d * math.sqrt(s0), foot, end))
    if s0 == 1:
        return
    k_s = max(min(local(t.k_s, g, w), 1.0), 0.5)
    s1 = math.ceil(round(1 + k_s * (s0 - 2), 9))
    s2 = s0 - s1
    most, least = local(t.M, g, w), local(t.m, g, w)
    alpha = min(local(t.alpha, g, w), 180.0)
    alpha_m = max(min(local(t.alpha_m, g, w), 180.0), -180.0)
    alpha1 = t.k_c * math.sqrt(s2 / s0) * alpha
    wind = math.radians(t.w_g) * s0 / t.S
    for strands, turn, order in ((s2, -(alpha - alpha1), g + 1), (s1, alpha1, g)):
        big_l = max(min(math.sqrt(strands / s0), most), least) * big_l0
        move, calm = m0 @ translation(l0), calm0.copy()
        down = np.linalg.inv(calm0[:3, :3]) @ [0, -1, 0]
        lever = np.cross([0, 1, 0], down)
        steps = []
        if np.linalg.norm(lever) > 1e-9:
            away = math.degrees(math.acos(max(-1.0, min(1.0, float(down[1])))))
            turned = max(min(alpha_m, away), away - 180.0)  # the generator's decision: no further than down, or up
            steps.append(rotation(lever / np.linalg.norm(lever), turned))
        steps += [rotation((0, 1, 0), t.alpha_p), rotation((0, 0, 1), turn)]
        for step in steps:
            move, calm = move @ step, calm @ step
        seen = np.linalg.inv(move[:3, :3]) @ t.w
        move = move @ rotation(seen, math.degrees(wind))
        branchsegment(t, order, w + 1, strands, big_l, local(t.k_l, g, w) * big_l, move, calm)


def tree(model: Model) -> list[tuple[int, int, int, float, Any, Any]]:
    branchsegment(model, 0, 0, model.S, 1.0, model.l0, np.eye(4), np.eye(4))
    return model.segments
