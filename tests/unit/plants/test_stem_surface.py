"""Barks by height, covers by height and weather side, roots and sweep of stems."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.api.plant_requests import plan_of, request_of
from forestgen.core.errors import RecipeError
from forestgen.core.parts import Part
from forestgen.core.randomness import child_rng
from forestgen.core.spectrum import Spectrum
from forestgen.geometry.mesh import Floats, surface_area_m2
from forestgen.geometry.sweep import Polylines, sweep_tubes
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.plants.growing import grow_exemplar
from forestgen.plants.plan import plan_plants
from forestgen.plants.roots import HIGH, roots_of
from forestgen.plants.stem_bend import Bend
from forestgen.plants.stem_surface import COVERED, LEVELS, covered_name, surfaced
from forestgen.recipe.load import load_recipe_data
from forestgen.recipe.wood import BarkZone, Cover, Roots, Sweep, Wood
from forestgen.scene.spec import Instances
from forestgen.scene.surfaces import materials_of
from forestgen.scene.trunks import Trunks
from support.error_messages import raises_error

RADIUS_M, TOP_M = 0.2, 10.0


def stem() -> OrganMesh:
    points = np.stack([np.zeros(41), np.zeros(41), np.linspace(0.0, TOP_M, 41)], axis=1)
    lines = Polylines(points, np.full(41, RADIUS_M), np.array([0, 41]))
    return OrganMesh(Part.TRUNK, "bark", sweep_tubes(lines, np.array([24]), pointed=False)[0])


def pieces_of(wood: Wood, pixel_m: float = 0.0, which: int = 0) -> list[OrganMesh]:
    return surfaced(stem(), wood, RADIUS_M + 1e-3 * which, pixel_m, (1.0, 1.0))


def middles(pieces: list[OrganMesh]) -> tuple[Floats, Floats]:
    """(F, 3) middles of triangles and (F,) their areas."""
    corners = np.concatenate([one.mesh.vertices_m[one.mesh.faces] for one in pieces]).astype(np.float64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return corners.mean(axis=1), 0.5 * np.linalg.norm(cross, axis=1)


def covered(pieces: list[OrganMesh]) -> list[OrganMesh]:
    return [one for one in pieces if COVERED in one.material]


def test_a_bark_zone_begins_between_its_heights() -> None:
    pieces = pieces_of(Wood(bark_zones=(BarkZone(material="upper", above=(0.4, 0.6)),)))
    blends = [covered_name("bark", "upper", level) for level in range(len(LEVELS))]
    assert {one.material for one in pieces} == {"bark", *blends, "upper"}
    assert np.isclose(sum(surface_area_m2(one.mesh) for one in pieces), surface_area_m2(stem().mesh), rtol=1e-4)
    shares = dict(zip(blends, LEVELS, strict=True)) | {"upper": 1.0}
    upper_m2 = sum(
        share * surface_area_m2(one.mesh) for one in pieces for name, share in shares.items() if one.material == name
    )
    assert np.isclose(upper_m2 / (2.0 * np.pi * RADIUS_M * TOP_M), 0.5, atol=0.06)
    heights_m = [
        np.average(middles([one for one in pieces if one.material == name])[0][:, 2])
        for name in ("bark", *blends, "upper")
    ]
    assert np.all(np.diff(heights_m) > 0.0)  # ever more of it upwards
    place, _ = middles([one for one in pieces if one.material == "upper"])
    assert np.percentile(place[:, 2], 1) > 0.2 * TOP_M


def test_covers_grow_at_the_foot_and_on_the_weather_side() -> None:
    moss = Cover(material="moss", at_foot=0.8, fades_m=0.5)
    algae = Cover(material="algae", weather=0.8, weather_fades_m=5.0, weather_side_deg=315.0)
    stems = [covered(pieces_of(Wood(covers=(moss, algae)), which=which)) for which in range(8)]
    pieces = [one for stem in stems for one in stem]
    place, area = middles([one for one in pieces if "moss" in one.material])
    assert np.average(place[:, 2], weights=area) < 1.0
    expected_m2 = 2.0 * np.pi * RADIUS_M * moss.at_foot * moss.fades_m
    assert 0.6 < area.sum() / (8 * expected_m2) < 1.8
    own_m2 = [sum(surface_area_m2(one.mesh) for one in stem if "moss" in one.material) for stem in stems]
    assert max(own_m2) > 1.5 * min(own_m2)  # stems differ
    place, area = middles([one for one in pieces if "algae" in one.material])
    north_west = place[:, 1] - place[:, 0] > 0.0
    assert area[north_west].sum() > 0.9 * area.sum()


def test_far_stems_and_thin_ones_have_no_covers() -> None:
    wood = Wood(covers=(Cover(material="moss", at_foot=0.9),))
    assert not covered(pieces_of(wood, pixel_m=0.2))
    assert len(surfaced(stem(), wood, 0.02, 0.0, (1.0, 1.0))) == 1


def test_a_covered_bark_is_a_mixture_of_both() -> None:
    species = plan_of("beech", 1).drawn.species["beech"]
    found = materials_of({"beech": species})
    for level, share in enumerate(LEVELS):
        mixed = found["beech", covered_name("bark", "moss", level)]
        bark, moss = (found["beech", key].reflectance_spectrum for key in ("bark", "moss"))
        assert isinstance(bark, Spectrum)
        assert isinstance(moss, Spectrum)
        assert mixed.reflectance_spectrum is not None
        wave = np.array([450.0, 550.0, 800.0, 1600.0])
        wanted = (1.0 - share) * bark.at(wave) + share * moss.at(wave)
        assert np.allclose(mixed.reflectance_spectrum.at(wave), wanted)
        assert mixed.texture is not None
        assert np.allclose(mixed.texture.colour.mean(axis=(0, 1)), mixed.reflectance, rtol=1e-3)


def test_roots_run_out_and_dive() -> None:
    law = Roots(count=5, reach_m=1.0, rise=0.8)
    roots = roots_of(law, RADIUS_M)
    assert roots is not None
    mesh = roots.mesh(np.zeros(3), (1.0, 1.0))
    away = np.hypot(*mesh.vertices_m[:, :2].T)
    assert 2.0 * RADIUS_M < away.max() < RADIUS_M + law.reach_m * np.sqrt(2 * RADIUS_M / 0.3) + 0.1
    assert mesh.vertices_m[away > 0.98 * away.max(), 2].max() < 0.0
    assert mesh.vertices_m[away > 1.2 * RADIUS_M, 2].max() < HIGH * RADIUS_M
    assert roots_of(law, 0.02) is None


def grown(name: str, **changed: object) -> Exemplar:
    """A tree of 12 m with a part of its wood changed."""
    request = request_of(plan_of(name, 1), name, 12.0, 1)
    wood = request.parameters.wood
    years = wood.years.model_copy(update=changed)
    parameters = request.parameters.model_copy(update={"wood": wood.model_copy(update={"years": years})})
    return grow_exemplar(replace(request, parameters=parameters))


def test_walkers_step_over_roots() -> None:
    with_roots, without = grown("spruce"), grown("spruce", roots=None)
    place = np.concatenate([np.eye(3), np.zeros((3, 1))], axis=1)[None]
    one = Instances(np.zeros(1, np.uint32), place, np.ones(1, np.uint32))
    radius = [Trunks([exemplar], one).circles_m(1.8)[1][0] for exemplar in (with_roots, without)]
    assert with_roots.roots_m > 0.0
    assert radius[0] < 1.3 * radius[1]


def test_a_bend_keeps_heights_and_the_foot() -> None:
    bend = Bend.of(Sweep(foot_deg=10.0, bow=0.02), 20.0, child_rng(1, "bend"))
    points = np.stack([np.zeros(21), np.zeros(21), np.arange(21.0)], axis=1)
    bent = bend.points(points)
    assert np.array_equal(bent[:, 2], points[:, 2])
    assert np.array_equal(bent[0], points[0])
    assert 0.0 < np.hypot(*bent[:, :2].T).max() < 20.0 * (0.02 * 4.0) + 1.5


def test_leaders_nod_by_their_length_and_no_more_of_the_tree() -> None:
    points = np.stack([np.zeros(41), np.zeros(41), np.linspace(0.0, 20.0, 41)], axis=1)
    still = Bend.of(Sweep(), 20.0, child_rng(1, "bend")).points(points)
    for nod_m, length_m in ((1.5, 1.5), (5.0, 2.0)):  # a tenth of the height at most
        aside = np.hypot(*(Bend.of(Sweep(nod_m=nod_m), 20.0, child_rng(1, "bend")).points(points) - still)[:, :2].T)
        assert aside[-1] == pytest.approx(length_m)
        assert np.allclose(aside[points[:, 2] <= 20.0 - length_m], 0.0)
        assert (np.diff(aside, n=2) > -1e-9).all()


def test_a_material_that_is_not_there_is_refused() -> None:
    covers = {"covers": [{"material": "ivy", "at_foot": 0.5}]}
    recipe = {"forestgen": 1, "site": {"size_m": [9, 9]}, "species": {"spruce": {"wood": covers}}}
    with raises_error(RecipeError, place="species.spruce.wood"):
        load_recipe_data({**recipe, "community": {"model": "uniform"}}, "test")


def test_the_years_of_wood_are_no_key_of_recipes() -> None:
    wood = {"plant": {"wood": {"years": {"sweep": {"foot_deg": 2.0}}}}}
    recipe = {"forestgen": 1, "site": {"size_m": [9, 9]}, "species": {"spruce": wood}}
    drawn = load_recipe_data({**recipe, "community": {"model": "uniform"}}, "test").draw(0)
    with raises_error(RecipeError, place="species.spruce.plant.wood.years"):
        plan_plants(drawn)


def test_the_bark_of_plants_of_modules_has_covers_too() -> None:
    species = plan_of("spruce", 1).drawn.species["spruce"]
    assert species.modules_plant is not None
    other = species.modules_plant.model_copy(update={"wood": {"material": "twig"}})
    found = materials_of({"spruce": species.model_copy(update={"modules_plant": other})})
    assert {("spruce", covered_name(bark, "moss", 0)) for bark in ("bark", "twig")} <= found.keys()


def test_every_bark_of_a_stem_of_two_zones_is_a_material() -> None:
    zones = (
        BarkZone(material="upper_bark", above=(0.2, 0.5)),
        BarkZone(material="dead_branch", above=(0.4, 0.7)),
        BarkZone(material="upper_bark", below=(0.05, 0.1)),
    )
    species = plan_of("pine", 1).drawn.species["pine"]
    assert species.wood is not None
    own = species.model_copy(update={"wood": species.wood.model_copy(update={"bark_zones": zones})})
    found = {one.material for one in grown("pine", bark_zones=zones).organs if one.part == Part.TRUNK}
    assert covered_name("upper_bark", "dead_branch", 0) in found
    assert {("pine", material) for material in found} <= materials_of({"pine": own}).keys()


@pytest.mark.parametrize("name", ["pine", "birch"])
def test_the_zones_of_shipped_species_are_seen(name: str) -> None:
    found = {one.material for one in grown(name).organs if one.part == Part.TRUNK}
    assert "bark" in found
    assert any({"pine": "upper_bark", "birch": "foot_bark"}[name] in material for material in found)
