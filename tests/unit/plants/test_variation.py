"""Variation by growth responses: the loop's recurrence and its limits, and what it keeps of the base."""

from __future__ import annotations

import numpy as np
import pytest
from plant_species import read
from pydantic import ValidationError

from forestgen.core.errors import RecipeError
from forestgen.plants.build import build_exemplar, size_m
from forestgen.plants.foliage import place
from forestgen.plants.registry import GENERATORS
from forestgen.plants.skeleton import OrganPlacements, Skeleton
from forestgen.plants.variation.model import Variation, varied_nodes, vary
from forestgen.recipe.load import load_recipe_data
from forestgen.scene.plan import make_plan
from support.error_messages import raises_error

NOISE = Variation(disturbance_deg=4, sensor_error_deg=3)
COLUMNS = ("parent", "position_m", "radius_m", "order", "axis")


def axes_from(*axes):
    """A skeleton of polylines: (bearing node, points) each; the first begins at its own first point."""
    parent, position, axis = [], [], []
    for number, (bearer, points) in enumerate(axes):
        start = len(parent)
        parent += [bearer, *range(start, start + len(points) - 1)]
        position += points
        axis += [number] * len(points)
    n = len(parent)
    return Skeleton(
        parent=np.array(parent, np.int32),
        position_m=np.array(position, np.float32),
        radius_m=np.linspace(0.02, 0.01, n, dtype=np.float32),
        order=np.array([0 if a == 0 else 1 for a in axis], np.uint8),
        axis=np.array(axis, np.int32),
    )


def stalk(length_m=1.0, nodes=2):
    return axes_from((-1, [[0, 0, z] for z in np.linspace(0, length_m, nodes)]))


def courses(skeleton, variation, rng):
    """(M, 3) places of the varied nodes, and what they are."""
    _, new = varied_nodes(skeleton, variation, rng)
    return new.point_m + new.shift_m, new


def angles(skeleton, variation, steps, seed=0):
    """(steps,) angle from the vertical towards +x of each growth step of a skeleton's first axis, radians."""
    points = courses(skeleton, variation, np.random.default_rng(seed))[0]
    way = np.diff(points, axis=0)
    arc = np.cumsum(np.linalg.norm(way, axis=1))
    middle = (np.arange(steps) + 0.5) * (arc[-1] / steps)
    piece = np.searchsorted(arc, middle)
    return np.arctan2(way[piece, 0], way[piece, 2])


def recurrence(steps, kappa, lag, begin, displacement):
    """E(n) = E(n-1) - kappa E(n-1-lag), with E = displacement at step `begin` and 0 before."""
    error = np.zeros(steps)
    for n in range(begin, steps):
        error[n] = (error[n - 1] if n > begin else displacement) - (kappa * error[n - 1 - lag] if n > lag else 0.0)
    return error


def grown(name, seed=1):
    """A small plant of a species of the library, with its organs, from the species' own generator."""
    recipe = {"forestgen": 1, "species": {name: {"from": name}}, "community": {"model": "placed"}}
    plan = make_plan(load_recipe_data(recipe, "test").draw(0))
    species, parameters = plan.drawn.species[name], plan.plants.generators[name]
    height_m, width_m = size_m(species, 0.4 * species.ecology.max_radius_m)
    rng = np.random.default_rng(seed)
    skeleton = GENERATORS.load(parameters.generator).grow(parameters, height_m, width_m, rng)
    rules = [rule for rule in parameters.foliage if rule.suits(height_m)]
    organs = (*skeleton.organs, *(place(rule, skeleton, height_m, rng) for rule in rules))
    return Skeleton(*(getattr(skeleton, name) for name in COLUMNS), organs=organs)


@pytest.fixture(scope="module")
def spruce():
    return grown("spruce")


def same(a, b):
    assert all(getattr(a, name).tobytes() == getattr(b, name).tobytes() for name in COLUMNS)
    for one, other in zip(a.organs, b.organs, strict=True):
        assert (one.shape, one.node.tobytes(), one.frame.tobytes()) == (
            other.shape,
            other.node.tobytes(),
            other.frame.tobytes(),
        )


# --- the loop ---


@pytest.mark.parametrize(("lag", "kappa"), [(0, 0.6), (1, 0.5), (3, 0.3), (8, 0.15), (20, 0.07)])
@pytest.mark.parametrize("nodes", [2, 7])
def test_a_displacement_decays_by_the_recurrence(lag, kappa, nodes):
    steps = 100
    variation = Variation(
        growth_steps=steps, lag=lag / steps, kappa=kappa, displacements=[{"at": 0.2, "turn_deg": 90, "plane": 90}]
    )
    expected = recurrence(steps, kappa, lag, 20, np.pi / 2)
    assert np.abs(angles(stalk(nodes=nodes), variation, steps) - expected).max() < 1e-6


def test_a_plant_turned_over_obeys_the_same_recurrence():
    displaced = {"at": 0.2, "turn_deg": 90, "plane": 90, "turns": "plant"}
    variation = Variation(growth_steps=100, lag=0.05, kappa=0.2, displacements=[displaced])
    expected = recurrence(100, 0.2, 5, 20, np.pi / 2)
    found = angles(stalk(), variation, 100)
    assert np.abs(found[20:] - expected[20:]).max() < 1e-6
    assert np.allclose(found[:20], np.pi / 2)


def test_an_error_beyond_the_half_turn_wraps():
    """Only a direction is sensed: 200 degrees one way are 160 degrees the other, and are corrected that way."""
    influence = {"turn_deg": [[0.0, 0.0], [0.099, 0.0], [0.1, 20000.0], [0.11, 20000.0], [0.111, 0.0]], "plane": 90}
    variation = Variation(growth_steps=100, lag=0.0, kappa=0.1, influences=[influence])
    found = np.degrees(angles(stalk(), variation, 100))
    assert found[10] == pytest.approx(-160)
    assert found[11] == pytest.approx(-144)


def is_bounded(lag, kappa):
    """Whether a displacement of a millionth of a degree stays as small over many lags."""
    steps = 400 * (lag + 1)
    displaced = {"at": 0.0, "turn_deg": 1e-6, "plane": 90}
    variation = Variation(growth_steps=steps, lag=lag / steps, kappa=kappa, displacements=[displaced])
    error = np.abs(angles(stalk(), variation, steps))
    return error.max() < 1e-3 and error[-steps // 4 :].max() <= error[: steps // 4].max()


@pytest.mark.parametrize("lag", [1, 2, 4, 7, 15])
def test_stability_ends_where_the_recurrence_says(lag):
    """z^(lag+1) - z^lag + kappa = 0 has a root on the unit circle at kappa = 2 sin(pi / (2 (2 lag + 1)))."""
    low, high = 0.0, 2.5
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_bounded(lag, middle) else (low, middle)
    assert 0.5 * (low + high) == pytest.approx(2 * np.sin(np.pi / (2 * (2 * lag + 1))), rel=0.01)


@pytest.mark.parametrize(
    "given",
    [
        {"lag": 0.1, "kappa": 0.125},
        {"lag": 0.1, "compensation_ratio": 0.8},
        {"kappa": 0.125, "compensation_ratio": 0.8},
    ],
)
def test_two_of_lag_kappa_and_ratio_set_the_third(given):
    displaced = {"at": 0.0, "turn_deg": 60, "plane": 90}
    found = angles(stalk(), Variation(growth_steps=100, displacements=[displaced], **given), 100)
    assert np.abs(found - recurrence(100, 0.125, 10, 0, np.pi / 3)).max() < 1e-6


def test_signals_arrive_sooner_where_they_travel_or_decay_faster():
    """Ageing by decay (1 + transmission) / 2 a step: twice the decay, or three times the speed, halves the lag."""
    displaced = {"at": 0.1, "turn_deg": 90, "plane": 90}
    common = {"growth_steps": 100, "displacements": [displaced], "kappa": 0.1}
    half = angles(stalk(), Variation(lag=0.1, **common), 100)
    assert np.allclose(angles(stalk(), Variation(lag=0.2, decay=2, **common), 100), half)
    assert np.allclose(angles(stalk(), Variation(lag=0.2, transmission=3, **common), 100), half)
    # Signals that age faster further up catch up with earlier ones, and act in the same step.
    caught = angles(stalk(), Variation(lag=0.2, decay=[[0.25, 1], [0.26, 8]], **common), 100)
    assert np.abs(np.diff(caught)).max() > 2.5 * 0.1 * np.pi / 2


def test_derivative_control_damps_and_integral_control_removes_a_steady_influence():
    displaced = {"at": 0.0, "turn_deg": 40, "plane": 90}
    common = {"growth_steps": 200, "lag": 0.01, "kappa": 0.45}
    swing = angles(stalk(), Variation(displacements=[displaced], **common), 200).min()
    damped = angles(stalk(), Variation(displacements=[displaced], derivative_gain=0.35, **common), 200).min()
    assert swing < 1.3 * damped < 0
    wind = {"turn_deg": 400, "plane": 90}
    common = {"growth_steps": 200, "lag": 0.01, "kappa": 0.2, "influences": [wind]}
    assert np.degrees(angles(stalk(), Variation(**common), 200)[-1]) == pytest.approx(400 / 200 / 0.2, rel=1e-3)
    assert abs(angles(stalk(), Variation(integral_gain=0.02, **common), 200)[-1]) < 1e-3


def test_target_and_disturbance_act_in_planes_of_their_own():
    """Fig. 8: the course follows the target in one plane and swings with the disturbance in the other."""
    bend = {"turn_deg": [[0, 0], [1, 40]], "plane": 90}
    wave = {"turn_deg": {"formula": "300 * sin(30 * x)"}, "plane": 0}
    variation = Variation(growth_steps=200, lag=0.0, kappa=0.5, target_bend=bend, influences=[wave])
    way = np.diff(courses(stalk(), variation, np.random.default_rng(0))[0], axis=0)
    along = np.degrees(np.arctan2(way[:, 0], way[:, 2]))
    across = np.degrees(np.arctan2(way[:, 1], way[:, 2]))
    assert np.abs(along - 40 * (np.arange(200) + 0.5) / 200).max() < 1.5
    assert np.count_nonzero(np.diff(np.sign(across))) >= 8


def test_a_pull_turns_branches_from_outward_to_upward():
    base = axes_from((-1, [[0, 0, z] for z in (0, 0.5, 1)]), (1, [[x, 0, 0.5] for x in (0.1, 0.5, 1)]))
    pull = {"weight": [[0, 0], [0.8, 1]], "orders": [1]}
    varied = vary(base, Variation(growth_steps=100, lag=0.02, target_pull=pull), np.random.default_rng(0))
    branch = varied.position_m[varied.order == 1]
    way = np.diff(branch, axis=0)
    assert abs(way[0, 2]) < 0.02 * np.linalg.norm(way[0])
    assert way[-1, 2] / np.linalg.norm(way[-1]) > 0.999
    assert np.all(varied.position_m[varied.order == 0, :2] == 0.0)
    light = {"weight": 1, "toward": [0, 3, 0], "orders": [1]}
    lit = vary(base, Variation(growth_steps=100, lag=0.02, target_pull=light), np.random.default_rng(0)).position_m
    assert np.allclose(lit[-1] - lit[-2], [0, np.linalg.norm(lit[-1] - lit[-2]), 0], atol=1e-3)


def autocorrelation(deviation, most):
    """(most + 1,) mean correlation of rows' values with those 0 ... `most` places on."""
    deviation = deviation - deviation.mean()
    power = np.mean(deviation**2)
    count = deviation.shape[1]
    return np.array([np.mean(deviation[:, : count - k] * deviation[:, k:]) for k in range(most + 1)]) / power


def test_deviations_are_correlated_along_the_axis():
    """Directions of varied axes are alike over many steps; independent angles of equal variance over none."""
    steps, lag, count = 100, 10, 400
    variation = Variation(growth_steps=steps, lag=lag / steps, compensation_ratio=1.1, disturbance_deg=2)
    deviation = np.stack([angles(stalk(), variation, steps, seed) for seed in range(count)])[:, steps // 4 :]
    independent = np.random.default_rng(1).normal(0, deviation.std(), deviation.shape)
    varied, random = autocorrelation(deviation, 30), autocorrelation(independent, 30)
    length = [int(np.argmax(rho < np.exp(-1))) for rho in (varied, random)]
    assert length[1] == 1
    assert length[0] >= 5
    assert varied[5] > 0.5
    assert abs(random[5]) < 0.05
    assert varied[1 : 4 * lag].min() < -0.1  # the overshoot of a lagging response


def test_random_influences_have_their_distributions():
    """Without correction, steps' turns are what was drawn: sizes by the distribution, sides alike."""
    base = axes_from(*[(-1 if k == 0 else 0, [[0, 0, 0], [0, 0, 1]] if k == 0 else [[0, 0, 1]]) for k in range(400)])
    for distribution, spread in (("gaussian", 1.0), ("uniform", 1 / np.sqrt(3))):
        variation = Variation(growth_steps=50, lag=1, kappa=1e-9, disturbance_deg=2, distribution=distribution)
        points = courses(base, variation, np.random.default_rng(4))[0][1:].reshape(400, 50, 3)
        way = np.diff(points, axis=1, prepend=0.0)
        way /= np.linalg.norm(way, axis=2, keepdims=True)
        turn = np.degrees(np.linalg.norm(np.cross(way[:, :-1], way[:, 1:]), axis=2))
        assert np.sqrt(np.mean(turn**2)) == pytest.approx(2 * spread, rel=0.02)
        assert np.abs(way.mean(axis=(0, 1))[:2]).max() < 0.02
        if distribution == "uniform":
            assert turn.max() <= 2.0 + 1e-6


# --- what is kept ---


def test_without_influences_the_skeleton_comes_back(spruce):
    for reference in ("global", "local"):
        same(vary(spruce, Variation(reference=reference), np.random.default_rng(0)), spruce)
    same(vary(spruce, NOISE.model_copy(update={"orders": (7,)}), np.random.default_rng(0)), spruce)


@pytest.mark.parametrize("name", ["spruce", "fireweed", "lily", "palm", "maple", "snag"])  # of every generator
@pytest.mark.parametrize("reference", ["global", "local"])
def test_a_varied_plant_keeps_lengths_and_contract(name, reference):
    base = grown(name)
    varied = vary(base, NOISE.model_copy(update={"reference": reference}), np.random.default_rng(5))
    assert len(varied.parent) > len(base.parent)
    axes = np.flatnonzero(np.diff(varied.axis, prepend=-1))
    assert np.array_equal(varied.axis[axes], base.axis[np.flatnonzero(np.diff(base.axis, prepend=-1))])
    inner = np.setdiff1d(np.arange(1, len(varied.parent)), axes)
    assert np.array_equal(varied.parent[inner], inner - 1)

    def lengths(skeleton):
        way = skeleton.position_m - skeleton.position_m[np.maximum(skeleton.parent, 0)]
        return np.bincount(skeleton.axis, np.linalg.norm(way.astype(np.float64), axis=1))

    assert np.allclose(lengths(varied), lengths(base), rtol=1e-4, atol=1e-6)
    assert varied.volume_m3() == pytest.approx(base.volume_m3(), rel=0.01)
    assert np.bincount(varied.order).astype(bool).tolist() == np.bincount(base.order).astype(bool).tolist()
    moved = np.abs(varied.position_m[-1] - base.position_m[-1]).max()
    assert moved > 0.005


def place_of(base, variation):
    """(N, 3) where the base's own nodes are."""
    points, new = courses(base, variation, np.random.default_rng(0))
    return points[new.new_of]


def test_an_axis_begins_where_its_bearer_went_and_then_corrects_what_it_feels():
    base = axes_from((-1, [[0, 0, z] for z in (0, 0.5, 1)]), (1, [[0.5, 0, 0.5], [1.5, 0, 0.5]]))
    turned = {"at": 0.0, "turn_deg": 40, "plane": 90}
    cosine, sine = np.cos(np.radians(40)), np.sin(np.radians(40))
    node = np.array([sine, 0, cosine]) / 2
    common = {"growth_steps": 60, "displacements": [turned]}
    stiff = place_of(base, Variation(reference="local", lag=1, kappa=1e-9, **common))
    assert np.allclose(stiff[:3], [[0, 0, 0], node, 2 * node], atol=1e-6)
    along = np.array([cosine, 0, -sine])
    assert np.allclose(stiff[3:] - node, [0.5 * along, 1.5 * along], atol=1e-6)
    # At the branch the stem has come back halfway to the vertical, and the branch begins turned as the stem is there.
    upright = {"lag": 0.0, "kappa": np.log(2) / 30, **common}
    rise = {}
    for reference in ("local", "global"):
        points, new = courses(base, Variation(reference=reference, **upright), np.random.default_rng(0))
        branch = np.diff(np.concatenate([points[new.new_of[[1]]], points[new.piece_of[3] :]]), axis=0)
        rise[reference] = np.degrees(np.arctan2(branch[:, 2], branch[:, 0]))[[0, -1]]
    assert rise["local"] == pytest.approx([-20, -20], abs=0.5)
    assert rise["global"] == pytest.approx([-20, -5], abs=0.6)


def test_kinks_of_the_base_stay():
    """The angle at a node of the base is what it was, within the turns of the steps around it."""
    base = axes_from((-1, [[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [1, 1, 2]]))
    varied = vary(base, Variation(growth_steps=400, lag=0.05, disturbance_deg=0.5), np.random.default_rng(2))
    way = np.diff(varied.position_m.astype(np.float64), axis=0)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    turn = np.degrees(np.arccos(np.clip(np.sum(way[:-1] * way[1:], axis=1), -1, 1)))
    sharp = np.sort(turn)[::-1]
    assert np.all(np.abs(sharp[:3] - 90) < 5)
    assert sharp[3] < 5
    assert np.degrees(np.arccos(way[:, 2].max())) < 10


def test_organs_stay_on_their_axis_and_keep_their_form(spruce):
    varied = vary(spruce, NOISE, np.random.default_rng(8))
    start = spruce.position_m[np.maximum(spruce.parent, 0)].astype(np.float64)
    new_start = varied.position_m[np.maximum(varied.parent, 0)].astype(np.float64)
    for before, after in zip(spruce.organs, varied.organs, strict=True):
        gram = [np.einsum("mij,mik->mjk", one.frame[:, :, :3], one.frame[:, :, :3]) for one in (before, after)]
        assert np.allclose(gram[0], gram[1], atol=1e-6)
        assert np.all(np.linalg.det(after.frame[:, :, :3].astype(np.float64)) > 0)
        assert np.array_equal(varied.axis[after.node], spruce.axis[before.node])

        def to_segment(skeleton, placement, begin):
            a, b = begin[placement.node], skeleton.position_m[placement.node].astype(np.float64)
            foot, way = placement.frame[:, :, 3].astype(np.float64), b - a
            length = np.maximum(np.linalg.norm(way, axis=1), 1e-12)
            along = np.sum((foot - a) * way, axis=1) / length
            out = foot - a - (along / length)[:, None] * way
            blade = np.sum(placement.frame[:, :, 1] * way, axis=1) / length
            return along - length, np.linalg.norm(out, axis=1), blade

        beyond, away, blade = to_segment(varied, after, new_start)
        _, away_before, blade_before = to_segment(spruce, before, start)
        assert np.allclose(away, away_before, atol=2e-5)
        assert np.allclose(blade, blade_before, atol=1e-3)
        assert beyond.max() < 1e-4


def test_the_same_stream_gives_the_same_plant_and_another_does_not(spruce):
    one = vary(spruce, NOISE, np.random.default_rng(3))
    same(vary(spruce, NOISE, np.random.default_rng(3)), one)
    other = vary(spruce, NOISE, np.random.default_rng(4))
    assert np.abs(other.position_m - one.position_m).max() > 0.01


def test_a_species_with_variation_is_built():
    species, parameters = read("poplar")
    varied = parameters.model_copy(update={"variation": NOISE})
    plants = [build_exemplar("poplar", species, one, 0.6, np.random.default_rng(2)) for one in (parameters, varied)]
    assert plants[1].height_m == pytest.approx(plants[0].height_m, rel=0.03)
    assert plants[1].triangles != plants[0].triangles


def test_degenerate_skeletons():
    point = axes_from((-1, [[0, 0, 0]]))
    same(vary(point, NOISE, np.random.default_rng(0)), point)
    knot = axes_from((-1, [[0, 0, 0], [0, 0, 0], [0, 0, 1], [0, 0, 1]]), (2, [[0, 0, 1], [0, 0, 1]]))
    placed = OrganPlacements("leaf", np.eye(3, 4, dtype=np.float32)[None].repeat(5, 0), np.arange(5, dtype=np.int32))
    knot = Skeleton(*(getattr(knot, name) for name in COLUMNS), organs=(placed,))
    varied = vary(knot, NOISE, np.random.default_rng(0))
    assert np.all(np.isfinite(varied.position_m))
    assert np.all(np.isfinite(varied.organs[0].frame))
    assert varied.organs[0].node.max() < len(varied.parent)


# --- bad input ---


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"lag": 0.1, "kappa": 1, "compensation_ratio": 1}, "give two of"),
        ({"lag": 0}, "without lag"),
        ({"kappa": 0}, "greater than 0"),
        ({"kappa": float("nan")}, "finite"),
        ({"lag": 1.5}, "less than or equal to 1"),
        ({"growth_steps": 10, "step_m": 0.1}, "not both"),
        ({"growth_steps": -3}, "must not be negative"),
        ({"disturbance_deg": [[0, 1]]}, "two"),
        ({"displacements": [{"at": 1.2, "turn_deg": 3}]}, "less than 1"),
        ({"displacements": [{"at": 0.1, "turn_deg": 3, "turns": "plant"}] * 2}, "turned over once"),
        ({"displacements": [{"at": 0.1, "turn_deg": 3, "plane": "left"}]}, "plane"),
        ({"target_pull": {"weight": 1, "toward": [0, 0, 0]}}, "some length"),
        ({"wobble": 1}, "Extra inputs"),
    ],
)
def test_bad_parameters_have_a_message(given, message):
    with pytest.raises(ValidationError, match=message):
        Variation(**given)


@pytest.mark.parametrize("given", [{"growth_steps": 1e9}, {"step_m": 1e-10}, {"growth_steps": {"formula": "1e12"}}])
def test_too_many_growth_steps_are_refused(given):
    with raises_error(RecipeError, place="plant"):
        vary(stalk(), Variation(disturbance_deg=1, **given), np.random.default_rng(0))
