"""Leaves lean as measured ones do."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.api.plant_requests import plan_of, request_of
from forestgen.core.parts import Part
from forestgen.plants.growing import grow_exemplar

# Mean angle between blade and horizontal, of all measured leaves of a species: Chianucci et al. 2018 (Annals of Forest
# Science 75, 50; doi:10.17632/4rmc7r8zvy.2, as the R package LAD 0.1.0 has it). 101 to 1,685 leaves each.
MEASURED_DEG = {"beech": 18.1, "birch": 55.6, "maple": 33.8, "oak": 34.8, "poplar": 36.8}  # Populus tremula


@pytest.mark.parametrize("name", MEASURED_DEG)
def test_leaves_lean_as_measured(name: str) -> None:
    """Within 6 degrees, of the blades' triangles, whose fold and curl add some."""
    exemplar = grow_exemplar(request_of(plan_of(name, 0), name, 18.0, 1, "stand"))
    corners = np.concatenate(
        [one.mesh.vertices_m.astype(float)[one.mesh.faces] for one in exemplar.organs if one.part == Part.LEAF]
    )
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    angle = np.degrees(np.arccos(np.abs(normal[area > 0, 2]) / area[area > 0]))
    found = float(np.average(angle, weights=area[area > 0]))
    folded = 5.0 if name == "beech" else 0.0  # 10 degrees of fold and 18 of curl, where blades are nearly level
    assert found == pytest.approx(MEASURED_DEG[name] + folded, abs=6.0)
