"""Sun and shade leaves, and plants that differ in chlorophyll: areas, order, energy, and what measured leaves do."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.geometry.mesh import surface_area_m2
from forestgen.plants.exemplar import Exemplar
from forestgen.recipe.load import load_recipe_data
from forestgen.recipe.phenology import LeafState, TimeOfYear
from forestgen.scene.leaf_variation import CLASSES, light_classes, single_leaves, varied_material, vary_leaves
from forestgen.scene.spec import Material
from forestgen.scene.surfaces import materials_of
from support.scenes import simple_tree

ONE = np.ones(1, dtype=np.int64)
VARIED = ("acacia", "beech", "birch", "eucalyptus", "larch", "pine", "rosemary", "spruce", "willow")


def materials(*names: str, season: str = "summer") -> dict[tuple[str, str], Material]:
    data = {"forestgen": 1, "species": {name: name for name in names}, "community": {"model": "placed"}}
    species = load_recipe_data(data, "test").draw(0).species
    return materials_of(species, {name: [LeafState.of_season(season)] for name in species})


def tree() -> Exemplar:
    return simple_tree("birch", 12.0, 3000, np.random.default_rng(4))


def greens(made: dict[tuple[str, str], Material], plants: NDArray[np.int64]) -> dict[int, float]:
    """By plant: reflectance at the red edge of exemplars' leaves in half shade."""
    found = vary_leaves([tree()] * len(plants), made, plants, seed=5)[1]
    return {int(one): found["birch", f"leaf (middle, {one})"].reflectance_spectrum.at(705) for one in plants}


def areas(exemplar: Exemplar) -> dict[str, float]:
    return {organ.material: surface_area_m2(organ.mesh) for organ in exemplar.organs if organ.part == Part.LEAF}


def test_a_crown_has_three_classes_of_equal_area_the_sun_above():
    leafy = [organ for organ in tree().organs if organ.part == Part.LEAF]
    (of_face,) = light_classes(leafy)
    mesh = leafy[0].mesh
    height_m = mesh.vertices_m[mesh.faces].mean(axis=1)[:, 2]
    sun, middle, shade = (height_m[of_face == index].mean() for index in range(3))
    assert sun > middle > shade
    shares = np.bincount(of_face, minlength=len(CLASSES)) / len(of_face)  # all leaves have one size
    np.testing.assert_allclose(shares, 1 / 3, atol=0.03)


def test_no_leaf_is_lost_and_each_class_has_a_material():
    made = materials("birch")
    made["birch", "bark"] = replace(made["birch", "bark"], texture=None)
    ((varied,), found) = vary_leaves([tree()], made, ONE, seed=1)
    assert sum(areas(varied).values()) == pytest.approx(sum(areas(tree()).values()), rel=1e-5)
    assert len(areas(varied)) == len(CLASSES)
    assert all(("birch", name) in found for name in areas(varied))
    assert [organ.part for organ in varied.organs if organ.part != Part.LEAF] == [
        organ.part for organ in tree().organs if organ.part != Part.LEAF
    ]


def test_plants_differ_in_their_stage_of_autumn_and_share_its_mean() -> None:
    """Leaves that turned stand together, of the area that their share is."""
    made, plants = materials("birch", season="autumn"), np.arange(1, 13)

    def shares(late: float) -> tuple[float, ...]:
        coloured = min(max(0.5 - 0.15 * late, 0.0), 1.0)
        return 0.0, 1.0 - coloured, 0.8 * coloured, 0.2 * coloured

    varied, found = vary_leaves([tree()] * 12, made, plants, seed=5, stages={"birch": shares})
    area = [Counter({key.rpartition(", ")[2][:-1]: 0.0 for key in areas(one)}) for one in varied]
    for count, one in zip(area, varied, strict=True):
        for key, value in areas(one).items():
            count[key.rpartition(", ")[2][:-1]] += value / sum(areas(one).values())
    turned = np.array([one["autumn"] + one["dry"] for one in area])
    assert len(np.unique(turned.round(3))) == 12
    assert turned.mean() == pytest.approx(0.5, abs=0.01)
    assert turned.std() == pytest.approx(0.15, rel=0.05)
    assert [one["dry"] / (one["autumn"] + one["dry"]) for one in area] == pytest.approx([0.2] * 12, abs=0.01)
    assert [kind.share for kind in found["birch", "leaf (middle, 1, autumn)"].seasons] == [0.0, 0.0, 1.0, 0.0]


def test_crowns_turn_from_the_outside_or_from_the_inside() -> None:
    made = materials("birch", season="autumn")
    stages = {"birch": lambda late: (0.0, 0.5, 0.5, 0.0)}
    turned_of_sun = []
    for inside in ((), ("birch",)):
        ((varied,), _) = vary_leaves([tree()], made, ONE, seed=1, stages=stages, inside_first=inside)
        found = areas(varied)
        turned_of_sun.append(found["leaf (sun, 1, autumn)"] / (found["leaf (shade, 1, autumn)"]))
    assert turned_of_sun[0] > 1.5
    assert turned_of_sun[1] < 1 / 1.5


def test_leaves_without_a_type_stay_as_they_are():
    exemplar, made = tree(), materials("birch")
    made["birch", "leaf"] = replace(made["birch", "leaf"], leaf_type=None)
    assert vary_leaves([exemplar], made, ONE, seed=1) == ((exemplar,), made)


@pytest.mark.parametrize("name", VARIED)
@pytest.mark.parametrize("season", ["summer", "autumn"])
def test_no_leaf_returns_more_light_than_arrives(name, season):
    key = next(one for one in materials(name) if one[1] in ("leaf", "needle"))
    base = materials(name, season=season)[key]
    for light in CLASSES:
        for deviation in (-2.0, 0.0, 2.0):
            one = varied_material(base, light, deviation)
            assert one.reflectance_spectrum is not None
            assert one.transmittance_spectrum is not None
            total = one.reflectance_spectrum.value + one.transmittance_spectrum.value
            assert total.max() <= 1.0
            assert min(one.reflectance_spectrum.value.min(), one.transmittance_spectrum.value.min()) >= 0.0


def test_plants_differ_in_chlorophyll_by_the_measured_share():
    """Reflectance at the red edge of many exemplars: that of the mean leaf on average, spread as chlorophyll."""
    made = materials("birch")
    base = made["birch", "leaf"]
    one = [varied_material(base, "middle", d).reflectance_spectrum.at(705) for d in (-1.0, 1.0)]
    for count in (2, 5, 60):
        middle = list(greens(made, np.arange(1, 1 + count)).values())
        assert np.mean(middle) == pytest.approx(base.reflectance_spectrum.at(705), rel=0.01)
        assert np.std(middle) == pytest.approx(0.5 * abs(one[1] - one[0]), rel=0.1)
    assert greens(made, ONE) == {1: base.reflectance_spectrum.at(705)}


def test_plants_keep_their_order_of_green_whatever_other_exemplars_there_are():
    """The order of plants stays where some are left out, and an exemplar of other detail is as green."""
    made = materials("birch")
    every, some = greens(made, np.arange(1, 21)), greens(made, np.array([17, 3, 3, 8, 11]))
    assert len(some) == 4
    assert sorted(some, key=lambda one: some[one]) == [
        one for one in sorted(every, key=lambda k: every[k]) if one in some
    ]
    assert greens(made, np.array([0, 0]))[0] == made["birch", "leaf"].reflectance_spectrum.at(705)


def at(material: Material, wavelength_nm: float) -> tuple[float, float]:
    return material.reflectance_spectrum.at(wavelength_nm), material.transmittance_spectrum.at(wavelength_nm)


@pytest.mark.parametrize("name", ["beech", "oak"])
def test_shade_leaves_let_more_light_through(name):
    """Thinner, with less chlorophyll and water: Poorter et al. 2009 (New Phytologist 182, 565-588), section IV."""
    base = materials(name)[name, "leaf"]
    sun, shade = (varied_material(base, light, 0.0) for light in ("sun", "shade"))
    assert at(shade, 550)[1] > 1.15 * at(sun, 550)[1]
    assert at(shade, 1610)[1] > 1.03 * at(sun, 1610)[1]
    assert at(shade, 850)[0] < at(sun, 850)[0]


def test_pale_plants_are_brighter_at_the_red_edge_alone():
    base = materials("birch")["birch", "leaf"]
    pale, dark = (varied_material(base, "middle", deviation) for deviation in (1.0, -1.0))
    assert sum(at(pale, 705)) > 1.05 * sum(at(dark, 705))
    assert sum(at(pale, 850)) == pytest.approx(sum(at(dark, 850)), rel=0.005)


@pytest.mark.parametrize(
    ("name", "season", "time"),
    [("birch", "summer", "summer"), ("birch", "autumn", "autumn"), ("spruce", "summer", "spring")],
)
def test_single_leaves_have_the_crowns_mean(name, season, time):
    made = materials(name, season=season)
    base = varied_material(next(one for one in made.values() if one.leaf_type is not None), "sun", 1.0)
    kinds = single_leaves(base, TimeOfYear(season=time), True)
    assert sum(kind.share for kind, _ in kinds) == pytest.approx(1.0)
    by_name = {kind.name: one for kind, one in kinds}
    assert kinds[-1][0].share > (0.35 if "pale" in by_name else 0.7)
    grid = base.reflectance_spectrum.wavelength_nm
    for side in ("reflectance_spectrum", "transmittance_spectrum"):
        mean = sum(kind.share * getattr(one, side).at(grid) for kind, one in kinds)
        np.testing.assert_allclose(mean, getattr(base, side).at(grid), atol=1e-3)
    if "pale" in by_name:
        pale, deep = (by_name[one].reflectance_spectrum.at(550) for one in ("pale", "deep"))
        assert 1.1 < pale / deep < 1.6
    if name == "spruce":
        assert by_name["new"].reflectance_spectrum.at(550) > 1.2 * by_name["summer"].reflectance_spectrum.at(550)


def test_needles_of_deciduous_trees_are_all_this_years():
    base = materials("larch")["larch", "needle"]
    names = [[kind.name for kind, _ in single_leaves(base, TimeOfYear(season="spring"), one)] for one in (False, True)]
    assert names[0] == [name for name in names[1] if name != "new"]
    assert "new" in names[1]
