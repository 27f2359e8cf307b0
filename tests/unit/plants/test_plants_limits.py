"""Plants at the edge of what can be: organs of no size, wood too thin to show, sizes that no fit reaches."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from plant_species import SPECIES
from plant_species import read as read_silhouette
from pydantic import TypeAdapter, ValidationError
from ruamel.yaml import YAML

from forestgen.core.errors import RecipeError
from forestgen.core.parts import Part
from forestgen.core.randomness import child_rng
from forestgen.plants.build import build_exemplar, size_m
from forestgen.plants.exemplar import Exemplar
from forestgen.plants.generators.strands import Parameters as StrandParameters
from forestgen.plants.parameters import OrganShape
from forestgen.plants.registry import GENERATORS
from forestgen.plants.skeleton import most_triangles
from forestgen.recipe.curves import Curve
from support.error_messages import raises_error

ORGAN_SHAPE = TypeAdapter(OrganShape)


def read(name: str) -> tuple[Any, Any]:
    if name != "shrub":
        return read_silhouette(name)
    data = YAML(typ="safe").load((SPECIES / "shrub.yaml").read_text(encoding="utf-8"))
    allometry = {key: SimpleNamespace(**law) for key, law in data["allometry"].items()}
    species = SimpleNamespace(allometry=SimpleNamespace(**allometry), materials=data["materials"])
    return species, StrandParameters.model_validate(data["plant"])


def grown(name: str, radius_m: float, **changes: Any) -> Exemplar:
    species, parameters = read(name)
    return build_exemplar(name, species, parameters.model_copy(update=changes), radius_m, child_rng(3, name))


def constant(value: float) -> tuple[tuple[float, float], ...]:
    return ((0.0, value),)


def test_leaves_that_a_curve_shrinks_to_nothing_are_left_out() -> None:
    _, parameters = read("shrub")
    leaves = parameters.leaves.model_copy(update={"size_by_height": constant(0.0)})
    bare = grown("shrub", 1.0, leaves=leaves)
    assert bare.leaf_area_m2 == 0.0
    assert all(organ.part != Part.LEAF for organ in bare.organs)
    assert all(organ.mesh.normals is not None and np.isfinite(organ.mesh.normals).all() for organ in bare.organs)


def test_a_plant_without_anything_to_see_is_refused() -> None:
    _, parameters = read("stalk")
    trunk = parameters.trunk.model_copy(update={"diameter_ratio": constant(1e-12)})
    with raises_error(RecipeError, place="species stalk: plant"):
        grown("stalk", 0.5, trunk=trunk)


def test_a_bare_straight_stem_can_be_stretched() -> None:
    species, _ = read("stalk")
    stem = grown("stalk", 0.5, fit="stretch")
    assert stem.height_m == pytest.approx(size_m(species, 0.5)[0], rel=0.02)


@pytest.mark.parametrize("factor", [20.0, 1e30])
def test_wood_that_no_fit_brings_to_its_height_is_refused(factor: float) -> None:
    with raises_error(RecipeError, place="species shrub: plant"):
        grown("shrub", 1.0, scale_by_height=constant(factor))


def test_leaves_larger_than_the_plant_are_refused() -> None:
    _, parameters = read("fireweed")
    huge = tuple(rule.model_copy(update={"size": constant(1e9)}) for rule in parameters.foliage)
    with raises_error(RecipeError, place="species fireweed: plant"):
        grown("fireweed", 0.5, foliage=huge)


@pytest.mark.parametrize("number", [10**30, -(10**30), 10**400])
def test_a_long_whole_number_is_a_curve_or_a_message(number: int) -> None:
    curve: TypeAdapter[Any] = TypeAdapter(Curve)
    if abs(number) < 10**300:
        assert curve.validate_python(number) == ((0.0, float(number)),)
    else:
        with pytest.raises(ValidationError, match="finite"):
            curve.validate_python(number)


def test_a_stalk_is_none_or_long_enough_to_be_one() -> None:
    keys = {"form": "simple", "material": "leaf", "length_m": 0.05, "width_m": 0.03}
    for length_m in (0.0, 1e-4):
        points = ORGAN_SHAPE.validate_python({**keys, "stalk_m": length_m}).template()
        corner = points.vertices_m[points.faces].astype(np.float64)
        area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
        assert area.min() > 0.0
    with pytest.raises(ValidationError, match="0 for none"):
        ORGAN_SHAPE.validate_python({**keys, "stalk_m": 1e-12})


def test_the_estimate_of_triangles_holds_for_all_shipped_species() -> None:
    """Each grown to its full size (docs/species.json), with room for seeds that grow more branches."""
    measured = json.loads((SPECIES.parents[1] / "docs" / "species.json").read_text(encoding="utf-8"))
    assert len(measured) > 15
    for name, about in measured.items():
        data = YAML(typ="safe").load((SPECIES / f"{name}.yaml").read_text(encoding="utf-8"))
        laws = {key: SimpleNamespace(**law) for key, law in data["allometry"].items()}
        height_m, width_m = size_m(SimpleNamespace(allometry=SimpleNamespace(**laws)), data["ecology"]["max_radius_m"])  # type: ignore[arg-type]
        has_crown = GENERATORS.load(data["plant"]["generator"]).has_crown
        assert most_triangles(height_m, width_m if has_crown else 0.0) > 1.15 * about["triangles"], name
    assert most_triangles(1.54, 0.53) < 25_000  # fireweed: stands have thousands, and few other species
