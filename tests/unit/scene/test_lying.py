"""Trees that lie follow the ground, and their exemplars are those of their form and class."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from forestgen.core.dead_wood import DeadForm, DeadTree, are_lying, lying_volume_m3
from forestgen.core.parts import Part
from forestgen.core.progress import Silent, Timings
from forestgen.instruments.stand_table import StandKeys, StandMeter
from forestgen.pipeline import assemble_image
from forestgen.recipe.load import load_recipe_data
from forestgen.scene.build import BuiltScene
from forestgen.scene.lying import laid_along_y, on_the_ground
from forestgen.scene.plan import check_plan
from forestgen.scene.spec import Instances
from forestgen.scene.terrain import HeightField

LENGTH_M = 18.0


class Plane(HeightField):
    """Ground that rises everywhere alike."""

    rise: tuple[float, float]

    def __init__(self, east: float, north: float) -> None:
        super().__init__((40.0, 40.0))
        object.__setattr__(self, "rise", (east, north))

    def _height(self, x_m: Any, y_m: Any) -> Any:
        return self.rise[0] * x_m + self.rise[1] * y_m + 3.0


def lying_at(azimuth_deg: float) -> Instances:
    angle = -np.radians(azimuth_deg)
    cos, sin = np.cos(angle), np.sin(angle)
    transform = np.array([[[cos, -sin, 0, 5.0], [sin, cos, 0, 7.0], [0, 0, 1.0, 0.0]]] * 2)
    return Instances(np.zeros(2, dtype=np.uint32), transform, np.array([1, 2], dtype=np.uint32))


@pytest.mark.parametrize("rise", [(0.0, 0.0), (0.3, 0.0), (-0.2, 0.45), (0.0, -0.6)])
@pytest.mark.parametrize("azimuth_deg", [0.0, 70.0, 200.0])
def test_a_stem_on_a_slope_touches_it_all_along(rise: tuple[float, float], azimuth_deg: float) -> None:
    ground = Plane(*rise)
    placed = on_the_ground(lying_at(azimuth_deg), np.array([True, False]), np.full(2, LENGTH_M), ground)
    np.testing.assert_array_equal(placed.transform[1], lying_at(azimuth_deg).transform[1])
    linear, foot = placed.transform[0, :, :3], placed.transform[0, :, 3]
    np.testing.assert_allclose(linear.T @ linear, np.eye(3), atol=1e-12)
    assert np.linalg.det(linear) == pytest.approx(1.0)
    for across in (-0.5, 0.0, 0.5):  # the plane of the exemplar's ground is the slope
        points = foot + (linear @ np.array([[across, y, 0.0] for y in np.linspace(0, LENGTH_M, 9)]).T).T
        np.testing.assert_allclose(points[:, 2], ground(points[:, 0], points[:, 1]), atol=1e-9)
    towards = np.degrees(np.arctan2(linear[0, 1], linear[1, 1])) % 360.0
    assert towards == pytest.approx(azimuth_deg)


def test_lengths_scale_along_the_stem_and_diameters_across() -> None:
    one = lying_at(30.0).transform
    one[:, :, :2] *= 0.5
    one[:, :, 2] *= 2.0
    scales = np.linalg.norm(laid_along_y(one, np.array([True, False]))[:, :, :3], axis=1)
    np.testing.assert_allclose(scales, [[0.5, 2.0, 0.5], [0.5, 0.5, 2.0]])


RECIPE = {
    "forestgen": 1,
    "seed": 4,
    "site": {"size_m": [40, 40], "terrain": {"kind": "rolling", "amplitude_m": 1.0, "wavelength_m": 70}},
    "species": {"spruce": None, "birch": None},
    "community": {
        "model": "stand",
        "storeys": [
            {"species": {"spruce": 0.7, "birch": 0.3}, "stems_per_ha": 300, "dominant_height_m": 15},
        ],
        "dead_wood": {"standing_per_ha": 60, "lying_m3_per_ha": 30, "stumps_per_ha": 60},
    },
    "plants": {"exemplars_per_species": 4, "levels": True},
    "cameras": [{"position_m": [20, 20, 60], "look_at_m": [20, 20.1, 0], "size_px": [64, 64]}],
}


@cache
def built() -> BuiltScene:
    return assemble_image(check_plan(load_recipe_data(RECIPE, "test")), Silent(), Timings())


def test_the_stand_has_the_volume_that_was_asked_for_as_it_is_rendered() -> None:
    scene = built()
    table = StandMeter().measure(scene, StandKeys(), Silent(), Timings())
    assert table.lying_dead_m3_per_ha == pytest.approx(30.0, rel=0.05)
    assert table.standing_dead_per_ha == pytest.approx(62.5)  # 10 on 0.16 ha
    assert table.stumps_per_ha == pytest.approx(62.5)
    assert any("stumps/ha" in line for line in table.lines())
    population = scene.population
    columns = population.columns
    of = columns["dead_form"], columns["decay_class"], population.height_m, columns["dbh_m"]
    assert float(lying_volume_m3(*of).sum()) / 0.16 == pytest.approx(30.0, rel=1e-6)


def test_each_dead_plant_has_an_exemplar_of_its_form_without_a_leaf() -> None:
    scene = built()
    columns, instances = scene.population.columns, scene.spec.instances
    for row in np.flatnonzero(columns["dead_form"] > 0).tolist():
        exemplar = scene.spec.exemplars[instances.exemplar[row]]
        assert {organ.part for organ in exemplar.organs} == {Part.DEAD_WOOD}
        assert (exemplar.lying_m3 > 0.0) == DeadTree(DeadForm(int(columns["dead_form"][row])), 1).lies
    for row in np.flatnonzero(columns["dead_form"] == 0).tolist():
        assert Part.LEAF in {organ.part for organ in scene.spec.exemplars[instances.exemplar[row]].organs}


def test_plants_are_where_their_instances_are() -> None:
    scene = built()
    feet_m = scene.spec.instances.transform[: len(scene.population), :, 3]
    np.testing.assert_array_equal(scene.population.position_m, feet_m)


def test_lying_stems_touch_rolling_ground() -> None:
    scene = built()
    population, height = scene.population, scene.plan.views.height
    lying = np.flatnonzero(are_lying(population.columns["dead_form"]))
    assert len(lying) > 5
    for row in lying.tolist():
        transform = scene.spec.instances.transform[row]
        way = transform[:, 1] / np.linalg.norm(transform[:, 1])
        points = transform[:, 3] + np.linspace(0.0, population.height_m[row], 20)[:, None] * way
        gap_m = points[:, 2] - height(points[:, 0], points[:, 1])
        assert gap_m.max() < 0.12
        assert gap_m.min() > -0.3
