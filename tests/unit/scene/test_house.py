"""Houses: closed, within their box, and as large as they are told to be."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from forestgen.core.parts import Part
from forestgen.plants.exemplar import Exemplar
from forestgen.recipe.species import Building
from forestgen.scene.building import building_materials, exemplar_of

SIZES = [(12.0, 9.0, 8.0), (4.0, 6.0, 3.0), (0.5, 0.5, 0.5), (60.0, 20.0, 25.0)]


def house(size_m: tuple[float, float, float], **keys: object) -> Exemplar:
    return exemplar_of(Building.model_validate({"position_m": (0, 0), "size_m": size_m, **keys}), 1.0)


def corners(exemplar: Exemplar, *, without: str = "") -> np.ndarray:
    """(F, 3, 3)"""
    organs = [one for one in exemplar.organs if one.material != without]
    return np.concatenate([one.mesh.vertices_m[one.mesh.faces] for one in organs]).astype(np.float64)


@pytest.mark.parametrize("size_m", SIZES)
def test_all_but_the_chimney_is_in_the_box(size_m) -> None:
    one = house(size_m, chimney=False)
    low, high = one.bounds_m()
    np.testing.assert_allclose(high, [size_m[0] / 2, size_m[1] / 2, size_m[2]], rtol=1e-6)
    np.testing.assert_allclose(low, [-size_m[0] / 2, -size_m[1] / 2, -1.0], rtol=1e-6)
    assert one.height_m == size_m[2]
    assert all(organ.part == Part.STRUCTURE for organ in one.organs)
    assert one.leaf_area_m2 == one.wood_volume_m3 == 0


@pytest.mark.parametrize("size_m", SIZES)
def test_no_light_comes_in(size_m) -> None:
    """Whichever way one looks from inside, there is a surface, and it is seen from behind."""
    triangles = corners(house(size_m, chimney=False))
    rng = np.random.default_rng(4)
    ways = rng.normal(size=(300, 3))
    ways[:, 2] = np.abs(ways[:, 2])  # the floor is the ground
    eye = np.array([0.02, 0.03, 0.3]) * np.array(size_m)
    a, e1, e2 = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    for way in ways / np.linalg.norm(ways, axis=1, keepdims=True):
        p = np.cross(way, e2)
        det = np.einsum("fk,fk->f", e1, p)
        ok = np.abs(det) > 1e-12
        inverse = np.where(ok, 1 / np.where(ok, det, 1), 0)
        u = np.einsum("fk,fk->f", eye - a, p) * inverse
        q = np.cross(eye - a, e1)
        v, t = np.einsum("k,fk->f", way, q) * inverse, np.einsum("fk,fk->f", e2, q) * inverse
        hit = ok & (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (t > 1e-9)
        assert hit.any()
        first = np.flatnonzero(hit)[np.argmin(t[hit])]
        normal = np.cross(e1[first], e2[first])
        # The boards below the roof are met from below, walls and panes from behind.
        assert normal @ way > 0 or (normal[2] < 0 and way[2] > 0)


def test_windows_and_door_are_there_where_there_is_room() -> None:
    def area(exemplar: Exemplar, material: str) -> float:
        found = [one.mesh for one in exemplar.organs if one.material == material]
        if not found:
            return 0.0
        at = found[0].vertices_m[found[0].faces].astype(np.float64)
        return float(np.linalg.norm(np.cross(at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]), axis=1).sum() / 2)

    large, small = house((12.0, 9.0, 8.0)), house((1.5, 1.5, 1.5))
    panes = area(large, "glass") / (0.9 * 1.2)
    assert panes == pytest.approx(round(panes), abs=1e-4)
    assert panes >= 8
    assert area(large, "door") == pytest.approx(1.0 * 2.05, rel=1e-4)
    assert area(small, "glass") == area(small, "door") == 0
    # Walls and what stands in them make up the walls' planes.
    low, high = 8.0 - np.tan(np.radians(40)) * 4.1 - 0.16, 8.0 - 0.16
    planes = 2 * (11.2 + 8.2) * (low + 1.0) + 8.2 * (high - low)
    assert area(large, "wall") + area(large, "glass") + area(large, "door") == pytest.approx(planes, rel=1e-4)


def test_the_chimney_rises_above_the_ridge_and_leaves_the_height() -> None:
    one = house((12.0, 9.0, 8.0))
    assert one.bounds_m()[1, 2] > 8.3
    assert one.height_m == 8.0


def test_a_house_may_have_materials_of_its_own() -> None:
    red = {"wall": {"reflectance": [0.5, 0.1, 0.1]}}
    plain = Building.model_validate({"kind": "house", "position_m": (1, 2)})
    painted = Building.model_validate({"kind": "house", "position_m": (9, 2), "materials": red})
    materials = building_materials([plain, painted])
    for one in (plain, painted):
        assert {("house", organ.material) for organ in exemplar_of(one, 1.0).organs} <= set(materials)
    colours = {one.reflectance for (_, name), one in materials.items() if name.startswith("wall")}
    assert colours == {(0.62, 0.58, 0.50), (0.5, 0.1, 0.1)}
    with pytest.raises(ValidationError, match="a house has no such part"):
        Building.model_validate({"kind": "house", "position_m": (9, 2), "materials": {"moat": red["wall"]}})
