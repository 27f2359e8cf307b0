"""The generators turtle and auxin_root, from a species' parameters to a mesh."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from forestgen.core.errors import LsystemError, RecipeError
from forestgen.plants.build import build_exemplar
from forestgen.plants.exemplar import Exemplar
from forestgen.plants.generators.turtle import GENERATOR, Parameters
from forestgen.plants.registry import GENERATORS
from forestgen.plants.skeleton import Skeleton
from forestgen.recipe.assets import find_asset, list_assets
from support.error_messages import raises_error

LEAF = {"form": "bud", "part": "leaf", "material": "leaf", "length_m": 0.1, "width_m": 0.02}


def parameters(text: str, name: str = "a.lsys", **others: Any) -> Parameters:
    data = {"program": {"name": name, "text": text}, "wood": {"material": "bark"}, "shapes": {"leaf": LEAF}}
    return Parameters.model_validate({**data, **others})


def skeleton(text: str, height_m: float = 1.0, seed: int = 0, **others: Any) -> Skeleton:
    return GENERATOR.grow(parameters(text, **others), height_m, 1.0, np.random.default_rng(seed))


def exemplar(plant: Any, height_m: float = 2.0, seed: int = 0) -> Exemplar:
    law = SimpleNamespace(scale=height_m, exponent=1.0)
    kind = SimpleNamespace(allometry=SimpleNamespace(height_m=law, width_m=law), materials={"bark": None, "leaf": None})
    return build_exemplar("it", kind, plant, 1.0, np.random.default_rng(seed))


def shipped(name: str) -> dict[str, str]:
    path = find_asset("lsystems", name)
    return {"name": path.name, "text": path.read_text(encoding="utf-8")}


PLANTS = ("fig_5_2", "weed", "koch", "quadratic_koch", "gosper", "sierpinski", "lily", "horneophyton", "palm")


@pytest.mark.parametrize("name", [name for name in PLANTS if name in list_assets("lsystems")])
def test_shipped_programs_become_plants(name):
    surfaces = dict.fromkeys("ABCDEKLMS", "leaf")
    drawn = "dragon" not in name and name not in ("gosper", "sierpinski")
    plant = Parameters.model_validate({
        "program": shipped(name), "wood": {"material": "bark"}, "steps": 3, "shapes": {"leaf": LEAF},
        "surfaces": surfaces,
    })  # fmt: skip
    if not drawn:
        with raises_error(RecipeError):
            exemplar(plant)
        return
    made = exemplar(plant)
    assert made.triangles > 20
    assert made.height_m == pytest.approx(2.0, rel=0.05)


@pytest.mark.parametrize("name", sorted({*list_assets("lsystems")} - {*PLANTS}))
def test_the_other_programs_say_why_not(name):
    plant = Parameters.model_validate({"program": shipped(name), "wood": {"material": "bark"}, "steps": 2})
    with raises_error(RecipeError, LsystemError):
        exemplar(plant)


def test_age_follows_the_height():
    text = "derivation length: 9\naxiom: A\nA --> FA"
    for height_m, segments in ((0.5, 2), (1.0, 3), (2.0, 5), (9.0, 5)):
        grown = skeleton(text, height_m, steps=[[0.0, 1.0], [2.0, 5.0]])
        assert len(grown.parent) == 1 + segments
        assert grown.position_m[:, 2].max() == pytest.approx(height_m)
    assert len(skeleton(text).parent) == 10


def test_values_and_sizes_reach_the_program():
    text = """
#define long 1
#define height_m 7
define: { array r = {1}; }
function bent: (0, 0) (1, 0)
axiom: F(long)F(height_m)F(r[1])+(func(bent, 0.5))F(2)
"""
    values = {"long": [[0.0, 1.0], [2.0, 3.0]], "r": [5.0, 4.0], "bent": [[0, 0], [1, 120]]}
    grown = skeleton(text, 2.0, steps=0, values=values, fit="none").position_m
    np.testing.assert_allclose(grown[:4, 2], [0.0, 3.0, 5.0, 9.0])
    np.testing.assert_allclose(grown[4, 2] - grown[3, 2], 1.0, atol=1e-6)


def test_organs_have_the_size_of_their_shape():
    """~K(s) is s times the shape, whatever a unit of the program is."""
    text = "scale: 0.01\nwidth: 1\naxiom: F(50)~K(2)F(50)~leaf"
    with raises_error(LsystemError):
        skeleton(text.replace("~leaf", "~Q"), steps=0, surfaces={"K": "leaf"})
    for fit in ("scale", "none", "stretch"):
        grown = skeleton("scale: 0.01\nwidth: 1\naxiom: F(50)~K(2)F(50)", 3.0, steps=0, surfaces={"K": "leaf"}, fit=fit)
        (organs,) = grown.organs
        np.testing.assert_allclose(np.linalg.norm(organs.frame[:, :, 1], axis=1), 2.0, rtol=1e-6)
        top = 1.0 if fit == "none" else 3.0
        assert grown.position_m[:, 2].max() == pytest.approx(top, rel=1e-6)
        np.testing.assert_allclose(organs.frame[0, :, 3], [0, 0, 0.5 * top], atol=1e-6)
    wide = skeleton("axiom: F(50)", 3.0, steps=0, fit="none", unit_m=0.1)
    assert wide.position_m[:, 2].max() == pytest.approx(5.0)


def test_the_seed_comes_from_the_stream():
    text = "derivation length: 6\naxiom: A\nA --> F[+(ran(90))F]/(ran(360))A"
    one, same, other = (skeleton(text, seed=seed).position_m for seed in (4, 4, 5))
    assert one.tobytes() == same.tobytes()
    assert one.tobytes() != other.tobytes()


@pytest.mark.parametrize("rule", ["F --> FF", "F --> [F]F[F]", "F --> F[+F]F[-F]F"])
def test_explosions_are_refused(rule):
    plant = parameters(f"axiom: F\n{rule}", steps=30)
    GENERATOR.grow(parameters("axiom: F", steps=0), 1.0, 1.0, np.random.default_rng(0))
    begin = time.process_time()
    with raises_error(RecipeError, place="plant.program a.lsys"):
        GENERATOR.grow(plant, 1.0, 1.0, np.random.default_rng(0))
    assert time.process_time() - begin < 10.0


@pytest.mark.parametrize(
    ("others", "message"),
    [
        ({"steps": None}, "no derivation length"),
        ({"steps": 1, "values": {"x": 1}}, "defines no x; there are: a, r"),
        ({"steps": 1, "values": {"a": "much"}}, "no number and no curve"),
        ({"steps": 1, "values": {"a": [1.0]}}, "no number and no curve"),
        ({"steps": 1, "values": {"r": 3}}, "must be a list of numbers"),
        ({"steps": 1, "surfaces": {"K": "petal"}}, "no shape 'petal'"),
        ({"steps": 1, "program": "weed"}, "only a recipe's"),
        ({"steps": [[0, 1]]}, "two"),
    ],
)
def test_bad_parameters_are_named(others, message):
    with pytest.raises(ValidationError, match=message):
        parameters("#define a 1\ndefine: { array r = {1}; }\naxiom: F(a)", **others)


def test_bad_programs_tell_their_line():
    with raises_error(LsystemError, place="a.lsys:3:11"):
        parameters("axiom: F\nF --> FF\nF --> F(((", steps=1)
    for steps in (-1, 20_000):
        with raises_error(RecipeError, place="plant.steps"):
            skeleton("axiom: F", steps=steps)


def test_polygons_are_fans():
    """Area, place and normals of the triangles are the polygon's, whatever the fit."""
    text = "axiom: F(2)[+(90){.f(1)-(90)f(1)-(90)f(1).}]"
    drawn = skeleton(text, 4.0, steps=0, polygons={"material": "leaf"})
    (organs,) = drawn.organs
    unit = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    corner = np.einsum("mij,vj->mvi", organs.frame[:, :, :3], unit) + organs.frame[:, None, :, 3]
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    scale = 4.0 / corner[:, :, 2].max()  # the top is the plant's or the polygon's
    assert area.sum() == pytest.approx((scale * drawn.position_m[1, 2] / 2.0) ** 2, rel=1e-5)
    linear = organs.frame[:, :, :3].astype(np.float64)
    normal = linear[:, :, 2] / np.cbrt(np.linalg.det(linear))[:, None]
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=1e-5)
    made = exemplar(parameters(text, steps=0, polygons={"material": "leaf"}), 4.0)
    assert made.height_m == pytest.approx(4.0, rel=0.02)
    assert made.leaf_area_m2 == pytest.approx((4.0 / 3.0) ** 2, rel=0.02)


def test_auxin_root_hangs_and_shoot_rises():
    generator = GENERATORS.load("auxin_root")
    hanging = {"wood": {"material": "bark"}, "tilt_deg": 180.0}  # straight up, and so it stays
    assert exemplar(generator.Parameters.model_validate(hanging)).height_m == pytest.approx(2.0, rel=0.05)
    for gravitropism, order in (("positive", 1), ("negative", 0)):
        plant = generator.Parameters.model_validate(
            {"wood": {"material": "bark", "flare": 0.0}, "gravitropism": gravitropism, "taper": [[0, 1], [1, 0.4]]}
        )
        made = exemplar(plant, 2.0)
        assert made.height_m == pytest.approx(2.0, rel=0.03)
        grown = generator.grow(plant, 2.0, 1.0, np.random.default_rng(1))
        axis = np.flatnonzero(grown.order == order)[-50:]
        way = np.diff(grown.position_m[axis, 2])
        assert np.all(way < 0.0) == (order == 1)
        assert grown.position_m[:, 2].min() > -1e-2
        length = np.linalg.norm(np.diff(grown.position_m[grown.order == order], axis=0), axis=1).sum()
        assert grown.radius_m.max() / length == pytest.approx(0.5 / 60.0, rel=0.02)
        again = generator.grow(plant, 2.0, 1.0, np.random.default_rng(1))
        assert again.position_m.tobytes() == grown.position_m.tobytes()
