"""Plants in the wind: rigid turns about the stem's base, downwind, bounded, each plant's own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.core.parts import Part
from forestgen.plants.exemplar import Exemplar
from forestgen.scene.spec import Instances, SceneSpec
from forestgen.scene.wind import LARGEST_LEAN_RAD, Sway, natural_frequency_hz, posed, spec_at, sway_in
from support.scenes import plain_ground, scattered_scene, simple_tree


@pytest.fixture(scope="module")
def spec() -> SceneSpec:
    return scattered_scene(200, exemplars=4, leaves=20, terrain=plain_ground(-50, 150))


def sway(spec: SceneSpec, speed: float = 8.0, gustiness: float = 0.5, from_deg: float = 270.0, seed: int = 1) -> Sway:
    return sway_in(
        spec.instances, spec.exemplars, speed_m_per_s=speed, gustiness=gustiness, from_deg=from_deg, seed=seed
    )


def tops(spec: SceneSpec, instances: Instances) -> np.ndarray:
    """(N, 3) from the stem's base to the point that stands straight above it in still air."""
    height = np.array([one.height_m for one in spec.exemplars])[instances.exemplar]
    return np.asarray(instances.transform[:, :, 2] * height[:, None])


TIMES = (0.0, 0.3, 1.7, 42.0, 1e5)


@pytest.mark.parametrize("time_s", TIMES)
@pytest.mark.parametrize("from_deg", [270.0, 0.0, 33.0, -120.0])
def test_a_rigid_turn_about_the_base_downwind(spec: SceneSpec, time_s: float, from_deg: float) -> None:
    wind = sway(spec, from_deg=from_deg)
    now = posed(spec.instances, wind, time_s)
    before, after = spec.instances.transform, now.transform
    assert np.array_equal(before[:, :, 3], after[:, :, 3])
    turn = after[:, :, :3] @ np.linalg.inv(before[:, :, :3])
    assert np.allclose(turn @ turn.transpose(0, 2, 1), np.eye(3), atol=1e-12)
    assert np.allclose(np.linalg.det(turn), 1.0)
    axis = np.array([-wind.toward[1], wind.toward[0], 0.0])
    assert np.allclose(turn @ axis, axis, atol=1e-12)
    top = tops(spec, now)
    downwind = -np.array([np.sin(np.radians(from_deg)), np.cos(np.radians(from_deg))])
    lean = np.arctan2(top[:, :2] @ downwind, top[:, 2])
    assert np.allclose(lean, wind.lean_rad(time_s), atol=1e-12)
    assert np.allclose(top[:, :2] @ [-downwind[1], downwind[0]], 0.0, atol=1e-9)


def test_a_wind_from_the_west_blows_east(spec: SceneSpec) -> None:
    top = tops(spec, posed(spec.instances, sway(spec, gustiness=0.0), 3.0))
    assert np.all(top[:, 0] > 0)


@pytest.mark.parametrize("speed", [0.1, 2.0, 8.0, 40.0])
def test_bounded_and_never_against_the_wind(spec: SceneSpec, speed: float) -> None:
    wind = sway(spec, speed, gustiness=1.0)
    leans = np.array([wind.lean_rad(t) for t in np.random.default_rng(3).random(4000) * 1e6])
    assert leans.min() >= 0.0
    assert leans.max() <= LARGEST_LEAN_RAD
    assert np.all(np.abs(leans.mean(axis=0) - wind.mean_rad) <= 0.1 * wind.mean_rad)


def test_drag_grows_with_the_square_of_the_speed(spec: SceneSpec) -> None:
    slow, fast = sway(spec, 0.5).mean_rad, sway(spec, 1.0).mean_rad
    assert np.allclose(fast / slow, 4.0, rtol=0.01)
    speeds = [sway(spec, speed).mean_rad for speed in (1, 3, 6, 12, 24)]
    assert np.all(np.diff(speeds, axis=0) >= 0)


def test_gusts_are_a_share_of_the_lean(spec: SceneSpec) -> None:
    steady = sway(spec, gustiness=0.0)
    assert np.array_equal(steady.lean_rad(0.0), steady.lean_rad(7.7))
    times = np.linspace(0, 200, 4001)
    for gustiness in (0.2, 0.9):
        wind = sway(spec, gustiness=gustiness)
        away = np.array([wind.lean_rad(t) for t in times]) / wind.mean_rad - 1.0
        assert np.abs(away).max() <= gustiness + 1e-12
        assert np.all(np.abs(away).max(axis=0) > 0.9 * gustiness)


def test_a_plant_moves_by_itself_whatever_grows_beside_it(spec: SceneSpec) -> None:
    keep = np.arange(len(spec.instances)) % 3 == 1
    one = spec.instances
    fewer = replace(one, exemplar=one.exemplar[keep], transform=one.transform[keep], plant_id=one.plant_id[keep])
    whole = posed(one, sway(spec), 5.0).transform[keep]
    alone = posed(fewer, sway(replace(spec, instances=fewer)), 5.0).transform
    assert np.array_equal(whole, alone)
    assert not np.array_equal(whole, posed(one, sway(spec, seed=2), 5.0).transform[keep])
    phases = sway(spec).phase_rad
    assert len(np.unique(phases)) == phases.size
    assert np.allclose(np.sort(phases.ravel()), np.linspace(0, 2 * np.pi, phases.size), atol=0.5)


def test_still_air_is_the_same_object_at_any_time(spec: SceneSpec) -> None:
    assert spec_at(spec, None, 0.0) is spec
    assert spec_at(spec, None, 9.0) is spec
    calm = spec_at(spec, sway(spec, 0.0), 3.0).instances
    assert np.array_equal(calm.transform, spec.instances.transform)


def test_a_scene_in_the_wind_differs_in_its_transforms_alone(spec: SceneSpec) -> None:
    now = spec_at(spec, sway(spec), 1.0)
    assert now.exemplars is spec.exemplars
    assert now.terrain is spec.terrain
    assert now.instances.plant_id is spec.instances.plant_id
    assert not np.array_equal(now.instances.transform, spec.instances.transform)
    assert not np.array_equal(now.instances.transform, spec_at(spec, sway(spec), 1.1).instances.transform)


def plant(height_m: float, leaf_m2: float, wood_m3: float, part: Part = Part.TRUNK) -> Exemplar:
    one = simple_tree("kind", 4.0, 4, np.random.default_rng(0))
    organs = (replace(one.organs[0], part=part),)
    return replace(one, organs=organs, height_m=height_m, leaf_area_m2=leaf_m2, wood_volume_m3=wood_m3)


def upright(exemplar: Exemplar, scale: float = 1.0) -> Sway:
    transform = np.concatenate([np.eye(3) * scale, np.zeros((3, 1))], axis=1)[None]
    instances = Instances(np.zeros(1, np.uint32), transform, np.array([7], np.uint32))
    return sway_in(instances, [exemplar], speed_m_per_s=10.0, gustiness=0.5, from_deg=270.0, seed=0)


def test_the_frequency_is_the_published_one() -> None:
    """Moore and Maguire (2004): a tree of 20 m and 25 cm sways at about 0.3 Hz."""
    assert natural_frequency_hz(np.array(20.0), np.array(0.25)) == pytest.approx(0.0948 + 3.4317 * 25 / 400)
    wood = 0.5 * np.pi / 4 * 0.25**2 * 20
    (one,) = upright(plant(20.0, 120.0, wood)).frequency_hz
    assert one[0] == pytest.approx(0.309, rel=0.101)
    (half,) = upright(plant(20.0, 120.0, wood), scale=0.5).frequency_hz
    assert half[0] / one[0] == pytest.approx((0.0948 + 3.4317 * 12.5 / 100) / 0.3093, rel=1e-3)


@pytest.mark.parametrize(
    ("exemplar", "hertz", "degrees"),
    [
        (plant(17.4, 105.0, 0.358), (0.3, 0.45), (2.0, 5.0)),  # spruce
        (plant(16.9, 343.0, 2.0), (0.6, 0.9), (0.2, 1.0)),  # oak
        (plant(1.2, 0.33, 4e-5), (1.5, 3.5), (1.0, 12.5)),  # fireweed
        (plant(0.1, 0.004, 0.0), (2.5, 15.0), (0.1, 12.5)),  # daisy
        (plant(0.7, 0.0, 1.2e-4), (1.0, 5.0), (0.05, 12.5)),  # a bare stalk
    ],
)
def test_plants_move_as_plants_do(exemplar: Exemplar, hertz: tuple[float, float], degrees: tuple[float, float]) -> None:
    one = upright(exemplar)
    assert hertz[0] < one.frequency_hz[0, 0] < hertz[1]
    assert degrees[0] < np.degrees(one.mean_rad[0]) < degrees[1]


def test_dead_wood_lies_still() -> None:
    assert upright(plant(0.3, 0.0, 0.23, Part.DEAD_WOOD)).mean_rad[0] == 0.0
    assert upright(plant(6.0, 0.0, 0.3, Part.TRUNK)).mean_rad[0] > 0.0


def test_a_scene_without_plants_is_no_mistake(spec: SceneSpec) -> None:
    none = Instances(np.zeros(0, np.uint32), np.zeros((0, 3, 4)), np.zeros(0, np.uint32))
    empty = replace(spec, instances=none, exemplars=())
    assert len(spec_at(empty, sway(empty), 2.0).instances) == 0
