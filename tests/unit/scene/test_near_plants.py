"""Which plants of a scene have leaves of true size."""

from __future__ import annotations

from copy import deepcopy
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest

from forestgen.api.plant_requests import plan_of, request_of
from forestgen.community.simulation import final_population
from forestgen.core.progress import Silent, Timings
from forestgen.plants.growing import grow_exemplar
from forestgen.plants.near_foliage import organ_sizes
from forestgen.recipe.load import load_recipe_data
from forestgen.scene import near_foliage
from forestgen.scene.build import BuiltScene, build_scene
from forestgen.scene.plan import make_plan
from forestgen.scene.triangles import LARGEST_ORGAN

TREES = "species, x_m, y_m, dbh_cm, height_m\n" + "".join(
    f"{name}, {x}, {y}, 7, 6\n" for name, x, y in (("oak", 5, 6), ("oak", 5, 60), ("spruce", 8, 6), ("spruce", 5, 1))
)
CAMERA = {"name": "near", "position_m": [5, 3.5, 3], "look_at_m": [5, 8, 3], "hfov_deg": 60, "obstructed": "note"}
RECIPE: dict[str, Any] = {
    "forestgen": 1,
    "seed": 1,
    "site": {"size_m": [10, 70]},
    "species": {"oak": None, "spruce": None},
    "community": {"model": "inventory", "table": TREES},
    "sky": {"clouds": "none"},
    "cameras": [{**CAMERA, "size_px": [160, 120]}],
}


@cache
def built(width: int = 160, *, near: bool = True, layers: bool = False) -> BuiltScene:
    recipe = deepcopy(RECIPE)
    recipe["cameras"][0]["size_px"] = [width, width * 3 // 4]
    recipe["plants"] = {"near_foliage": near}
    if layers:
        recipe["site"] |= {"ground": {"layers": [{"what": "stones", "cover": 0.05}]}, "surroundings": "repeat"}
    plan = make_plan(load_recipe_data(recipe, "near").draw(0))
    return build_scene(plan, final_population(plan.community, Silent()), Silent(), Timings())


def test_silhouettes_have_no_leaves_of_true_size() -> None:
    recipe = deepcopy(RECIPE) | {"plants": {"geometry": "silhouettes"}}
    plan = make_plan(load_recipe_data(recipe, "near").draw(0))
    scene = build_scene(plan, final_population(plan.community, Silent()), Silent(), Timings())
    assert scene.spec.exemplars
    assert not any(one.foliage for one in scene.spec.exemplars)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pine", "spruce", "birch", "larch", "oak", "beech"])
def test_organs_are_no_larger_than_the_estimate_has_them(name: str) -> None:
    plan = plan_of(name, 0)
    for height_m, grown in product((5.0, 9.0, 14.0), ("stand", "open")):
        made = grow_exemplar(request_of(plan, name, height_m, 1, grown))
        assert max(float(organ_sizes(one.frame).max(initial=0.0)) for one in made.foliage) <= LARGEST_ORGAN


def triangles(scene: BuiltScene) -> list[int]:
    """Of each of the four trees."""
    return [scene.spec.exemplars[k].triangles for k in scene.spec.instances.exemplar[:4].tolist()]


def test_near_trees_in_view_have_their_own_mesh_and_others_none() -> None:
    with_leaves, without = built(), built(near=False)
    near, far = triangles(with_leaves), triangles(without)
    assert near[0] > far[0]
    assert near[1] == far[1]  # far away
    assert near[3] == far[3]  # behind the camera
    ours, theirs = with_leaves.spec.instances, without.spec.instances
    np.testing.assert_array_equal(ours.plant_id, theirs.plant_id)
    np.testing.assert_array_equal(ours.transform, theirs.transform)
    for one, other in zip(ours.exemplar.tolist(), theirs.exemplar.tolist(), strict=True):
        assert with_leaves.spec.exemplars[one].species == without.spec.exemplars[other].species
        area = with_leaves.spec.exemplars[one].leaf_area_m2
        assert area == without.spec.exemplars[other].leaf_area_m2


def test_a_finer_image_has_finer_leaves() -> None:
    assert triangles(built(480))[0] > triangles(built(160))[0]


def test_the_same_scene_is_built_again() -> None:
    one = built()
    built.cache_clear()
    two = built()
    assert one is not two
    for first, second in zip(one.spec.exemplars, two.spec.exemplars, strict=True):
        for organ, other in zip(first.organs, second.organs, strict=True):
            np.testing.assert_array_equal(organ.mesh.vertices_m, other.mesh.vertices_m)


def test_what_stands_around_the_site_and_lies_on_the_ground_keeps_its_meshes() -> None:
    ours, theirs = built(layers=True).spec, built(near=False, layers=True).spec
    assert len(ours.exemplars) > len(theirs.exemplars)
    for row in np.flatnonzero(ours.instances.plant_id == 0).tolist():
        one = ours.exemplars[int(ours.instances.exemplar[row])]
        other = theirs.exemplars[int(theirs.instances.exemplar[row])]
        assert one.species == other.species
        assert one.species in ("oak", "spruce") or one.triangles == other.triangles


def test_triangles_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    def own(scene: BuiltScene) -> int:
        used = scene.spec.instances.exemplar[:4].tolist()
        return sum(scene.spec.exemplars[k].triangles for k in used if not scene.spec.exemplars[k].foliage)

    more = own(built(480))
    built.cache_clear()
    monkeypatch.setattr(near_foliage, "most_near_triangles", lambda cameras: int(0.7 * more))
    fewer = own(built(480))
    built.cache_clear()
    assert 0 < fewer <= 0.7 * more
