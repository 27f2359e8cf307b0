"""Rays straight down against every triangle of every instance, one by one."""

from __future__ import annotations

import numpy as np

from forestgen.core.progress import Timings
from forestgen.render.cover import plants_below
from forestgen.render.identity import SceneTracer
from support.scenes import plain_ground, scattered_scene


def met_by_hand(spec, point_m, low_m):
    """(R, N) whether a vertical line meets an instance above a height: the triangles' shadows on the ground."""
    met = np.zeros((len(point_m), len(spec.instances)), dtype=bool)
    for row, index in enumerate(spec.instances.exemplar):
        matrix = spec.instances.transform[row]
        corners = [organ.mesh.vertices_m.astype(float)[organ.mesh.faces] for organ in spec.exemplars[index].organs]
        a, b, c = np.moveaxis(np.concatenate(corners) @ matrix[:, :3].T + matrix[:, 3], 1, 0)
        u, v, w = b[:, :2] - a[:, :2], c[:, :2] - a[:, :2], point_m[:, None] - a[:, :2]
        area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            s = (w[..., 0] * v[:, 1] - w[..., 1] * v[:, 0]) / area
            t = (u[:, 0] * w[..., 1] - u[:, 1] * w[..., 0]) / area
        z = a[:, 2] + s * (b - a)[:, 2] + t * (c - a)[:, 2]
        met[:, row] = np.any((s >= 0) & (t >= 0) & (s + t <= 1) & (z > low_m), axis=1)
    return met


def test_rays_meet_whom_their_lines_cross():
    spec = scattered_scene(60, size_m=6.0, exemplars=4, leaves=700, terrain=plain_ground(-20, 32))
    point_m = np.random.default_rng(2).random((500, 2)) * 6.0
    start_m = np.column_stack([point_m, np.full(len(point_m), 30.0)])
    met = np.zeros((len(point_m), len(spec.instances)), dtype=bool)
    for rays, rows in plants_below(SceneTracer(spec, Timings()), start_m, np.full(len(point_m), 30.0 - 1.3)):
        met[rays, rows] = True
    by_hand = met_by_hand(spec, point_m, 1.3)
    assert by_hand.sum(axis=1).max() >= 4  # crowns lie one above the other
    assert np.count_nonzero(met != by_hand) <= 2  # grazed edges, in single precision
    assert by_hand.any(axis=1).mean() > 0.5


def test_short_rays_and_no_rays_meet_nobody():
    spec = scattered_scene(5, size_m=5.0, exemplars=2, leaves=20, terrain=plain_ground(-20, 32))
    tracer = SceneTracer(spec, Timings())
    assert not list(plants_below(tracer, np.zeros((0, 3)), np.zeros(0)))
    high = np.array([[*spec.instances.transform[0, :2, 3], 50.0]])
    assert not [row for _, rows in plants_below(tracer, high, np.array([5.0])) for row in rows]
