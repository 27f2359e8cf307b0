"""Haze that is too thick is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.render.frame import Surface
from forestgen.render.rendering import haze_notes
from support.scenes import plain_ground, scattered_scene


def surface_at(distance_m: float) -> Surface:
    """Plants in one row of four, ground far behind them in the others."""
    distance = np.full((4, 5), 1e5, dtype=np.float32)
    distance[0] = distance_m
    plant = np.zeros((4, 5), dtype=np.uint32)
    plant[0] = 7
    none = np.zeros((4, 5, 3), dtype=np.float32)
    zeros = np.zeros((4, 5), dtype=np.uint32)
    part = np.zeros((4, 5), dtype=np.uint8)
    return Surface(plant, part, zeros, zeros, distance, distance, none, none, none, none, np.zeros((4, 5), dtype=bool))


@pytest.mark.parametrize(("visibility_m", "told"), [(None, False), (20_000.0, False), (4000.0, False), (3000.0, True)])
def test_only_thick_haze_before_plants_is_told(visibility_m: float | None, told: bool) -> None:
    """At 1000 m: optical depths of 0.2, 0.98 and 1.3."""
    spec = scattered_scene(3, exemplars=1, leaves=4, terrain=plain_ground(-50, 50))
    spec = replace(spec, sky=replace(spec.sky, visibility_m=visibility_m))
    notes = haze_notes(spec, surface_at(1000.0), "front")
    assert bool(notes) == told
    assert all(note.startswith("front: ") and "fog" in note for note in notes)
    assert not haze_notes(spec, replace(surface_at(1000.0), plant_id=np.zeros((4, 5), dtype=np.uint32)), "front")
