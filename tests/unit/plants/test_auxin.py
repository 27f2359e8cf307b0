"""The auxin model: Barlow's flanks with their published angles, conservation, convergence, and how roots behave."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from forestgen.core.errors import RecipeError
from forestgen.plants.generators.auxin_root import AuxinModel, Root, Zone, simulate
from support.error_messages import raises_error


def grown(model: AuxinModel, hours: float, zones: tuple[Zone, ...] = (Zone(),)) -> Root:
    return simulate(model, 500.0, zones, hours)


def elongation_mm_per_h(zone: Zone) -> float:
    """alpha M: the integral of RELEL over a flank that is longer than the zone, from the tip on."""
    before_tip = 0.5 * (1.0 + math.erf(-zone.centre_mm / (math.sqrt(2.0) * zone.width_mm)))
    return zone.peak_per_h * zone.width_mm * math.sqrt(2.0 * math.pi) * (1.0 - before_tip)


def length_mm(root: Root) -> float:
    """Length along the centre line."""
    return float(root.side_mm.mean(axis=1).sum())


def barlow(upper: Zone, lower: Zone, time_h: float, diameter_mm: float = 1.0, steps: int = 1000) -> Root:
    """Two flanks with RELELs of their own and no auxin; side 0, which faces the ground, is the lower one."""
    model = AuxinModel(
        diameter_mm=diameter_mm, supply_per_h=0.0, young_mm=14.0, segment_mm=0.1, step_h=time_h / steps, on_flank=True
    )
    return grown(model, time_h, (lower, upper))


def tip_angle_deg(root: Root) -> np.ndarray:
    """(T + 1,) angle of the tip from the target, positive on the side it was tilted to."""
    model = root.model
    around = np.radians(model.azimuth_deg)
    sideways = root.tip @ np.array([np.cos(around), np.sin(around), 0.0])
    angle = np.degrees(np.arctan2(np.linalg.norm(np.cross(root.tip, model.target), axis=1), root.tip @ model.target))
    return np.where(sideways < 0.0, -angle, angle)


def bending_deg(root: Root) -> float:
    return float(root.model.tilt_deg - tip_angle_deg(root)[-1])


def turning_deg(root: Root) -> np.ndarray:
    """Turn of each segment towards the ground."""
    return np.degrees((root.side_mm[:, 1] - root.side_mm[:, 0]) / root.model.diameter_mm)


@pytest.mark.parametrize(("time", "angle_deg"), [(0.126, 18.1), (0.380, 54.5), (0.633, 90.8)])
def test_figure_3a(time, angle_deg):
    """One diameter, 1, gives all three of the paper's angles; of the Gaussian, only what lies before the tip counts."""
    upper, lower = Zone(2.0, 3.0, 1.0), Zone(1.0, 3.0, 1.0)
    alpha = elongation_mm_per_h(upper) - elongation_mm_per_h(lower)
    assert alpha == pytest.approx(np.sqrt(2 * np.pi) * 0.99865, rel=1e-5)
    assert np.degrees(alpha * time) == pytest.approx(angle_deg, abs=0.05)
    assert bending_deg(barlow(upper, lower, time)) == pytest.approx(angle_deg, abs=0.06)


@pytest.mark.parametrize("diameter_mm", [0.7, 1.0, 2.5])
@pytest.mark.parametrize("peak", [0.5, 1.3, 2.2])
def test_flanks_give_equation_1(diameter_mm, peak):
    """theta = (L_u - L_l) / d = alpha (M_u - M_l) t / d, with alpha = sigma sqrt(2 pi) far from the tip."""
    upper, lower, time = Zone(peak, 5.0, 0.8), Zone(1.0, 5.0, 0.8), 0.3
    root = barlow(upper, lower, time, diameter_mm, steps=2000)
    flank = root.side_mm.sum(axis=0)
    theta = np.degrees((flank[1] - flank[0]) / diameter_mm)
    assert bending_deg(root) == pytest.approx(theta, abs=1e-9)
    alpha = 0.8 * np.sqrt(2 * np.pi)
    assert theta == pytest.approx(np.degrees(alpha * (peak - 1.0) * time / diameter_mm), rel=2e-3, abs=1e-9)


def test_rate_of_bending_is_constant():
    angle = tip_angle_deg(barlow(Zone(2.0, 3.0, 1.0), Zone(1.0, 3.0, 1.0), 0.6))
    np.testing.assert_allclose(angle, np.linspace(angle[0], angle[-1], len(angle)), atol=0.1)


def test_figure_3b_is_kinked():
    """A flank that grows nearer to the tip turns there one way, the other one behind it the other way."""
    kinked = barlow(Zone(3.0, 3.0, 0.7), Zone(1.0, 5.0, 1.0), 0.4)
    turn = turning_deg(kinked)
    from_tip = length_mm(kinked) - np.cumsum(kinked.side_mm.mean(axis=1))
    assert turn[np.argmin(abs(from_tip - 3.0))] > 0.5
    assert turn[np.argmin(abs(from_tip - 6.0))] < -0.2
    plain = turning_deg(barlow(Zone(2.0, 3.0, 1.0), Zone(1.0, 3.0, 1.0), 0.4))
    assert plain[:-30].min() > -0.05


@pytest.mark.parametrize("sectors", [2, 7])
@pytest.mark.parametrize("decay_per_h", [0.0, 0.5])
def test_auxin_is_conserved(sectors, decay_per_h):
    root = grown(AuxinModel(sectors=sectors, decay_per_h=decay_per_h, tilt_deg=60.0), 6.0)
    assert root.supplied == pytest.approx(60.0)
    assert root.auxin.sum() + root.out + root.decayed == pytest.approx(root.supplied, rel=1e-12)
    assert (root.decayed == 0.0) == (decay_per_h == 0.0)
    assert root.auxin.min() >= 0.0


def test_resting_root_carries_the_flow():
    """Straight down, where the flow is steady: supply / v of auxin a millimetre, half on either side."""
    root = grown(AuxinModel(tilt_deg=0.0, supply_per_h=8.0, transport_mm_per_h=5.0), 20.0)
    np.testing.assert_allclose(tip_angle_deg(root), 0.0, atol=1e-9)
    np.testing.assert_allclose(root.auxin[-5:] / root.side_mm[-5:], 0.5 * 8.0 / 5.0, rtol=0.02)


def test_time_step_converges():
    """First order: the change of the angle halves with the step, and is below 1% at the default one."""
    angle = [bending_deg(grown(AuxinModel(step_h=step), 4.0)) for step in (0.04, 0.02, 0.01, 0.005)]
    change = np.abs(np.diff(angle))
    assert change[1] < 0.01 * angle[1]
    order = np.log2(change[:-1] / change[1:])
    np.testing.assert_allclose(order, 1.0, atol=0.25)


def test_segment_length_converges():
    angle = [bending_deg(grown(AuxinModel(segment_mm=s, step_h=0.01), 4.0)) for s in (0.5, 0.25, 0.125)]
    assert abs(angle[2] - angle[1]) < abs(angle[1] - angle[0]) < 0.02 * angle[0]


@pytest.mark.parametrize("tilt_deg", [20.0, 90.0, 150.0])
def test_bending_stops_where_the_tip_points_along_gravity(tilt_deg):
    root = simulate(AuxinModel(tilt_deg=tilt_deg), 60.0)
    assert abs(tip_angle_deg(root)[-1]) < 0.5
    assert root.auxin[-1, 0] == pytest.approx(root.auxin[-1, 1], rel=0.01)
    points = root.points_mm()
    assert np.ptp(points[-60:, 0]) < 0.02 * (points[-60, 2] - points[-1, 2])  # what grew last hangs straight


def test_delay_overshoots():
    """mu / v hours pass before the zone learns; supply / v, and so the inhibition, stays."""
    past = [
        tip_angle_deg(grown(AuxinModel(transport_mm_per_h=v, supply_per_h=v), 20.0)).min()
        for v in (40.0, 10.0, 5.0, 2.5)
    ]
    assert all(later < sooner - 0.5 for sooner, later in pairwise(past))
    assert past[-1] < -40.0


def test_inhibition_bends_more():
    bent = [bending_deg(grown(AuxinModel(inhibition_mm=i), 1.5)) for i in (0.0, 0.1, 0.3, 0.5, 0.8)]
    assert bent[0] == pytest.approx(0.0, abs=1e-9)
    assert all(more > less + 3.0 for less, more in pairwise(bent))


@pytest.mark.parametrize("sectors", [4, 5, 8, 16])
def test_space_agrees_with_the_plane(sectors):
    """Tilted in one plane, a root in space stays in it and bends as the plane's does."""
    flat = grown(AuxinModel(azimuth_deg=30.0), 8.0)
    solid = grown(AuxinModel(sectors=sectors, azimuth_deg=30.0), 8.0)
    np.testing.assert_allclose(tip_angle_deg(solid), tip_angle_deg(flat), atol=0.6)
    across = solid.points_mm() @ np.array([-0.5, np.sqrt(0.75), 0.0])
    np.testing.assert_allclose(across, 0.0, atol=1e-6)


def test_azimuth_turns_the_root():
    one, other = (grown(AuxinModel(sectors=6, azimuth_deg=a), 5.0).points_mm() for a in (0.0, 90.0))
    np.testing.assert_allclose(other[:, :2], one[:, 1::-1] * [-1.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(other[:, 2], one[:, 2], atol=1e-9)


def test_shoot_is_the_root_upside_down():
    root, shoot = (grown(AuxinModel(is_shoot=up), 5.0).points_mm() for up in (False, True))
    np.testing.assert_allclose(shoot, root * [1.0, 1.0, -1.0], atol=1e-9)


def test_centre_line_is_as_long_as_the_root():
    """Points are ends of arcs: the chords are a little shorter than the mean sides, and close in on them."""
    root = simulate(AuxinModel(sectors=5), 30.0)
    chords = np.linalg.norm(np.diff(root.points_mm(), axis=0), axis=1).sum()
    assert 0.999 * length_mm(root) < chords <= length_mm(root) * (1 + 1e-9)
    assert length_mm(root) == pytest.approx(30.0, abs=0.05)
    assert root.side_mm[:-1].mean(axis=1).max() <= 0.25 * 1.02


@pytest.mark.parametrize(
    ("change", "length_mm"),
    [
        ({"inhibition_mm": 100.0}, 60.0),  # never grows
        ({"segment_mm": 1e-4}, 60.0),
        ({"step_h": 1e-5}, 1000.0),
    ],
)
def test_hopeless_roots_are_refused(change, length_mm, monkeypatch):
    monkeypatch.setattr("forestgen.plants.generators.auxin_root.MOST_WORK", 1e7)
    with raises_error(RecipeError, place="plant"):
        simulate(AuxinModel(**change), length_mm)
