"""The species that L-systems draw: lily, Horneophyton, palm, in the proportions that their sources give."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from forestgen.core.parts import Part
from forestgen.plants.build import build_exemplar
from forestgen.plants.exemplar import Exemplar
from forestgen.plants.generators.turtle import GENERATOR
from forestgen.plants.skeleton import Skeleton
from forestgen.recipe.load import load_recipe_data
from forestgen.scene.plan import make_plan

ADULT_M = {"lily": 0.95, "horneophyton": 0.18, "palm": 14.0}


@cache
def species(name: str) -> tuple[Any, Any]:
    recipe = {"forestgen": 1, "species": {name: {"from": name}}, "community": {"model": "multiset_lsystem"}}
    plan = make_plan(load_recipe_data(recipe, "test").draw(0))
    return plan.drawn.species[name], plan.plants.generators[name]


def grown(name: str, height_m: float, seed: int = 1) -> Skeleton:
    return GENERATOR.grow(species(name)[1], height_m, height_m, np.random.default_rng(seed))


def exemplar(name: str, height_m: float, seed: int = 1) -> Exemplar:
    kind, plant = species(name)
    law = kind.allometry.height_m
    radius_m = (height_m / law.scale) ** (1 / law.exponent)
    return build_exemplar(name, kind, plant, radius_m, np.random.default_rng(seed))


def organs(skeleton: Skeleton) -> dict[str, np.ndarray]:
    return {one.shape: one.frame for one in skeleton.organs}


@pytest.mark.parametrize("name", ADULT_M)
@pytest.mark.parametrize("share", [0.2, 1.0])
def test_plants_have_their_height(name, share):
    made = exemplar(name, share * ADULT_M[name])
    assert made.height_m == pytest.approx(share * ADULT_M[name], rel=0.03)
    assert made.triangles < 80_000
    assert all(np.isfinite(organ.mesh.vertices_m).all() for organ in made.organs)


@pytest.mark.parametrize("name", ADULT_M)
def test_mature_height_is_the_species(name):
    kind, plant = species(name)
    assert 0.8 * ADULT_M[name] < kind.mature_height_m < 1.5 * ADULT_M[name]
    assert plant.variation is not None
    assert kind.sources


def test_lily():
    """Flora of China: 45-90 cm, leaves 8-15 cm; its flowers look outwards, its leaves lie round the stem."""
    placed = organs(grown("lily", 0.95))
    assert len(placed["flower"]) == 3
    assert len(placed["bud"]) == 2
    assert 40 <= len(placed["leaf"]) <= 60
    lengths = 0.155 * np.linalg.norm(placed["leaf"][:, :, 1], axis=1)
    assert 0.08 < np.median(lengths) < 0.17
    facing = placed["flower"][:, 2, 1] / np.linalg.norm(placed["flower"][:, :, 1], axis=1)
    assert np.all(np.abs(facing) < 0.6)
    assert placed["flower"][:, 2, 3].min() > placed["leaf"][:, 2, 3].max() - 0.1
    azimuth = np.sort(np.arctan2(placed["leaf"][:, 1, 1], placed["leaf"][:, 0, 1]))
    assert np.diff(azimuth).max() < 1.0
    assert "flower" not in organs(grown("lily", 0.3))


def test_horneophyton():
    """Naked axes of some 2 mm that fork in two, over a corm of 6 mm, with sporangia at the ends and nowhere else."""
    skeleton = grown("horneophyton", 0.18)
    size = 0.18 / skeleton.position_m[:, 2].max()  # the program's own size; the fit makes it this
    assert 0.004 < 2 * size * skeleton.radius_m[skeleton.order == 0].max() < 0.008
    aerial = skeleton.radius_m[skeleton.order > 0]
    assert 0.0005 < 2 * size * np.median(aerial) < 0.003
    children = np.bincount(skeleton.parent[1:], minlength=len(skeleton.parent))
    assert children[skeleton.order > 0].max() == 2
    (placed,) = skeleton.organs
    assert placed.shape == "sporangium"
    assert np.all(children[placed.node] == 0)
    assert not any(organ.part == Part.LEAF for organ in exemplar("horneophyton", 0.18).organs)


def test_palm():
    """Chan and Elevitch 2006: 25-35 fronds, a stem of about 30 cm that is no thicker above, with a swollen foot."""
    skeleton = grown("palm", 14.0)
    placed = organs(skeleton)
    assert 22 <= sum(len(placed[name]) for name in ("young", "frond", "old", "dead")) <= 35
    stem = skeleton.order == 0
    height, diameter = skeleton.position_m[stem, 2], 2 * skeleton.radius_m[stem]
    size = 14.0 / (height.max() + 3.5)  # before the fit, which sees the fronds
    breast, middle, top = (np.interp(h / size, height, diameter) * size for h in (1.3, 5.0, 9.0))
    assert 0.18 < middle < 0.35
    assert top == pytest.approx(middle, rel=0.1)
    assert diameter[:6].max() * size > 1.4 * middle
    assert breast < 1.3 * middle
    nuts = placed["nut"][:, 2, 3]
    assert nuts.min() > 0.7 * height.max()


def test_palms_differ_and_repeat():
    one, same, other = (exemplar("palm", 9.0, seed) for seed in (1, 1, 2))
    meshes = [made.organs[0].mesh.vertices_m.tobytes() for made in (one, same, other)]
    assert meshes[0] == meshes[1] != meshes[2]
