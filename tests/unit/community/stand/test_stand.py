"""The stand model: targets of foresters are met, and those that contradict each other are refused."""

from __future__ import annotations

import time
from dataclasses import fields

import numpy as np
import pytest
from scipy.spatial import cKDTree

from forestgen.community.models import stand
from forestgen.community.models.stand import StandParameters
from forestgen.community.population import Site
from forestgen.community.simulation import final_population
from forestgen.community.stand.build import StandBuilder, nearest_index
from forestgen.community.stand.targets import Dbh, Storey, dominant_height_at
from forestgen.core.errors import RecipeError
from forestgen.core.progress import Silent
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import check_plan
from support.error_messages import raises_error
from support.grown_stands import SIZE, brute_cover, grown

SPRUCE = {
    "storeys": [
        {
            "species": {"spruce": 0.8, "pine": 0.2},
            "stems_per_ha": 600,
            "basal_area_m2_per_ha": 42,
            "dominant_height_m": 26,
        },
        {"species": {"beech": 1}, "stems_per_ha": 500, "dominant_height_m": 7, "clark_evans": 0.8},
    ],
    "canopy_cover": 0.8,
    "leaf_area_index": 6,
    "gaps": {"share": 0.06, "diameter_m": 12},
}
BEECH = {
    "storeys": [
        {
            "species": {"beech": 0.6, "oak": 0.4},
            "stems_per_ha": 260,
            "basal_area_m2_per_ha": 30,
            "dominant_height_m": 28,
        }
    ],
    "canopy_cover": 0.9,
    "leaf_area_index": 5.5,
}
PINE = {
    "storeys": [
        {
            "species": {"pine": 1},
            "stems_per_ha": 700,
            "basal_area_m2_per_ha": 26,
            "age_yr": 80,
            "site_index_m": 24,
            "height_curve": "pine",
            "clark_evans": 1.25,
        }
    ],
    "canopy_cover": 0.5,
    "leaf_area_index": 2.5,
}
TYPES = {"spruce": SPRUCE, "beech": BEECH, "pine": PINE}


@pytest.mark.parametrize("name", TYPES)
def test_feasible_targets_are_met_within_5_percent(name, species):
    asked, ha = TYPES[name], SIZE[0] * SIZE[1] / 1e4
    top = asked["storeys"][0]
    for seed in range(10):
        found = grown(species, asked, seed)
        dbh_m, height_m = found.columns["dbh_m"], found.height_m
        trees = height_m > 9 if name == "spruce" else np.ones(len(found), dtype=bool)
        assert trees.sum() / ha == pytest.approx(top["stems_per_ha"], rel=0.05)
        area = np.pi / 4 * dbh_m**2
        assert area[trees].sum() / ha == pytest.approx(top["basal_area_m2_per_ha"], rel=0.05)
        assert brute_cover(found, SIZE) == pytest.approx(asked["canopy_cover"], rel=0.05)
        leaves = found.columns["leaf_area_m2"].sum() / (SIZE[0] * SIZE[1])
        assert leaves == pytest.approx(asked["leaf_area_index"], rel=0.05)
        thick = np.argsort(-dbh_m)[: round(100 * ha)]
        wanted = top.get("dominant_height_m") or dominant_height_at(80, 24, "pine")
        assert height_m[thick].mean() == pytest.approx(wanted, rel=1e-6)
        mix = np.bincount(found.species[trees], area[trees], len(species)) / area[trees].sum()
        for kind, share in top["species"].items():
            index = [one.name for one in species].index(kind)
            assert mix[index] == pytest.approx(share / sum(top["species"].values()), abs=0.05)


MIXTURES = {
    "beech with birch": {"beech": 0.6, "birch": 0.4},
    "spruce with birch": {"spruce": 0.8, "birch": 0.2},
    "pine with beech": {"pine": 0.5, "beech": 0.5},
    "four": {"spruce": 3, "oak": 2, "pine": 2, "beech": 1},
}


@pytest.mark.parametrize(
    ("stems_per_ha", "area_m2_per_ha", "top_m", "slenderest"),
    [(500, 30, 25, 110), (500, None, 25, 110), (2000, None, 9, 160)],
)
@pytest.mark.parametrize("name", MIXTURES)
def test_species_of_a_storey_are_equally_tall(name, stems_per_ha, area_m2_per_ha, top_m, slenderest, species):
    """Each species' thickest trees, as many per hectare as are its share of 100, are as tall as the storey's."""
    mixture, names = MIXTURES[name], [one.name for one in species]
    storey = {
        "stems_per_ha": stems_per_ha,
        "basal_area_m2_per_ha": area_m2_per_ha,
        "dominant_height_m": top_m,
    }
    found = grown(species, {"storeys": [{"species": mixture, **storey}]}, size_m=(100.0, 100.0))
    dbh_m, height_m = found.columns["dbh_m"], found.height_m
    thickest = np.argsort(-dbh_m)
    assert height_m[thickest[:100]].mean() == pytest.approx(top_m)
    for kind, share in mixture.items():
        own = thickest[found.species[thickest] == names.index(kind)]
        of_species_m = height_m[own[: round(100 * share / sum(mixture.values()))]].mean()
        assert of_species_m == pytest.approx(top_m, rel=0.1)
        assert 60 < np.median(height_m[own] / dbh_m[own]) < slenderest
        if top_m > 20:  # curves of small trees are not straight
            fit = np.polyfit(np.log(dbh_m[own]), np.log(height_m[own]), 1)
            assert 0.04 < np.std(np.log(height_m[own]) - np.polyval(fit, np.log(dbh_m[own]))) < 0.25


def test_a_species_stays_below_a_storey_that_is_taller_than_its_tallest_trees(species):
    storey = {"stems_per_ha": 250, "basal_area_m2_per_ha": 60, "dominant_height_m": 41}
    found = grown(species, {"storeys": [{"species": {"spruce": 0.8, "birch": 0.2}, **storey}]}, size_m=(100.0, 100.0))
    birch, tall = found.species == 2, np.argsort(-found.columns["dbh_m"])[:100]
    assert species[2].tree.tallest_m == 35
    assert found.height_m[tall].mean() == pytest.approx(41)
    assert 30 < found.height_m[tall[birch[tall]]].mean() < 35.5


def test_what_is_reported_is_what_stands(species):
    found = grown(species, SPRUCE)
    reached = found.state["reached"]
    assert reached["canopy_cover"] == pytest.approx(brute_cover(found, SIZE), abs=0.005)
    assert reached["storeys"][0]["basal_area_m2_per_ha"] == pytest.approx(42)
    assert reached["storeys"][1]["dominant_height_m"] == pytest.approx(7)
    assert found.state["targets"]["leaf_area_index"] == 6
    assert "storey 1: 600 stems/ha, basal area 42.0 m²/ha, dominant height 26.0 m" in found.notes[0]
    few = grown(species, {"storeys": [{"species": {"oak": 1}, "stems_per_ha": 9, "dbh": {"mean_cm": 30}}]})
    assert any("storey 1: stems_per_ha is 10, not 9" in note for note in few.notes)


def test_stems_are_apart_by_their_diameters(species):
    found = grown(species, SPRUCE)
    place, dbh_m = found.position_m[:, :2], found.columns["dbh_m"]
    pairs = cKDTree(place, boxsize=SIZE).query_pairs(3.0, output_type="ndarray")
    offset = np.abs(place[pairs[:, 0]] - place[pairs[:, 1]])
    offset = np.minimum(offset, np.array(SIZE) - offset)
    assert np.all(np.hypot(*offset.T) >= dbh_m[pairs].sum(axis=1) * (1 - 1e-12))
    radius = found.columns["crown_radius_m"]
    assert np.mean(np.hypot(*offset.T) < radius[pairs].sum(axis=1)) > 0.5  # crowns interlock


@pytest.mark.parametrize("index", [0.6, 0.8, 1.0, 1.2, 1.4])
def test_the_pattern_of_stems_is_the_one_asked_for(index, species):
    storey = {"species": {"pine": 1}, "stems_per_ha": 900, "dbh": {"mean_cm": 16}, "clark_evans": index}
    found = [grown(species, {"storeys": [storey]}, seed, (150.0, 150.0)) for seed in range(3)]
    reached = [nearest_index(one.position_m[:, :2], Site((150.0, 150.0)), periodic=True) for one in found]
    assert np.mean(reached) == pytest.approx(index, abs=0.05)


def test_crowded_trees_are_slender_with_high_crowns_and_those_at_gaps_stout(species):
    storey = {"species": {"spruce": 1}, "stems_per_ha": 900, "basal_area_m2_per_ha": 40, "dominant_height_m": 24}
    given = {"storeys": [storey], "gaps": {"share": 0.4, "diameter_m": 18}}
    slender, base = [], []
    for seed in range(4):
        found = grown(species, given, seed, (100.0, 100.0))
        dbh_m = found.columns["dbh_m"]
        near = cKDTree(found.position_m[:, :2], boxsize=(100.0, 100.0)).query_ball_point(
            found.position_m[:, :2], 8.0, return_length=True
        )
        fit = np.polyfit(np.log(dbh_m), np.log(found.height_m), 1)
        taller = np.log(found.height_m) - np.polyval(fit, np.log(dbh_m))
        low, high = np.quantile(near, [0.2, 0.8])
        slender.append(taller[near >= high].mean() - taller[near <= low].mean())
        ratio = found.columns["crown_base_m"] / found.height_m
        base.append(ratio[near >= high].mean() - ratio[near <= low].mean())
    assert min(slender) > 0.02
    assert np.mean(base) > 0.02


def test_no_stem_of_the_first_storey_stands_in_a_gap(species):
    storeys = [Storey(species={"spruce": 1}, stems_per_ha=700, dbh={"mean_cm": 22})]
    storeys.append(Storey(species={"beech": 1, "birch": 1}, share_of="stems", stems_per_ha=3000, dbh={"mean_cm": 3}))
    site = Site((80.0, 80.0))
    parameters = StandParameters(storeys=storeys, gaps={"share": 0.2, "diameter_m": 15})
    opened, gap = stand._density(parameters, site, np.random.default_rng(2))
    assert gap.mean() == pytest.approx(0.2, abs=0.01)
    trees = StandBuilder(storeys, site, species, np.random.default_rng(3), periodic=True).trees(opened, gap, None, None)
    col, row = (trees.position_m * np.array(gap.shape[::-1]) / 80.0).astype(int).T
    assert not gap[row, col][trees.storey == 0].any()
    names = np.array([one.name for one in species])[trees.species]
    in_gaps = {name: gap[row, col][names == name].mean() for name in ("beech", "birch")}
    assert in_gaps["birch"] > 1.15 * in_gaps["beech"]  # light demanding
    assert in_gaps["beech"] > 0.15


@pytest.mark.parametrize("law", ["weibull", "normal"])
@pytest.mark.parametrize("cv", [0.01, 0.1, 0.25, 0.5, 0.7])
def test_diameters_have_the_mean_and_spread_asked_for(law, cv):
    relative = Dbh(cv=cv, law=law).relative((np.arange(20_000) + 0.5) / 20_000)
    assert relative.mean() == pytest.approx(1.0, abs=1e-3)
    assert relative.std() == pytest.approx(cv, rel=5e-3)
    assert relative.min() > (0.0 if law == "weibull" else 0.2)


def test_without_diameters_they_are_those_of_the_dominant_height(species):
    for given in ({"stems_per_ha": 800}, {"basal_area_m2_per_ha": 30}):
        storey = {"species": {"spruce": 1}, "dominant_height_m": 22, **given}
        found = grown(species, {"storeys": [storey]}, size_m=(100.0, 100.0))
        dbh_m = np.sort(found.columns["dbh_m"])[::-1][:100]
        law = species[0].tree
        assert np.sort(found.height_m)[-100:].mean() == pytest.approx(22, rel=0.1)
        grown_as = {one: law.height_of(dbh_m, np.zeros((100, 4)), law.shift(one)).mean() for one in ("stand", "open")}
        assert grown_as["open"] < 22 < 1.02 * grown_as["stand"]
    free = grown(species, {"storeys": [{"species": {"pine": 1}, "stems_per_ha": 800, "dbh": {"mean_cm": 20}}]})
    assert free.columns["dbh_m"].mean() == pytest.approx(0.2)


def test_site_index_is_the_dominant_height_at_100_years():
    for curve in ("spruce", "pine"):
        assert dominant_height_at(100, 27, curve) == pytest.approx(27)
        heights = [dominant_height_at(age, 24, curve) for age in (20, 40, 60, 80, 100, 140)]
        assert np.all(np.diff(heights) > 0)
        assert heights[5] - heights[4] < heights[2] - heights[1]
    # Gustavsen 1980: light-demanding pine is earlier than spruce.
    assert dominant_height_at(40, 24, "pine") > dominant_height_at(40, 24, "spruce")


def test_a_map_says_where_trees_stand_and_the_ground_is_covered(species):
    storey = {"species": {"birch": 1}, "stems_per_ha": 500, "dbh": {"mean_cm": 15}}
    given = {"storeys": [storey], "map": [[1, 0]], "keep_out": [[1], [0]], "ground": {"bracken": {"cover": 0.3}}}
    given["map"] = {"rows": [[1, 0]], "smooth": False}
    given["keep_out"] = {"rows": [[1], [0]], "smooth": False}
    found = grown(species, given)
    fern = found.species == 5
    assert (~fern).sum() == round(500 * 0.3)
    assert found.position_m[~fern, 0].max() <= 30
    assert found.position_m[:, 1].max() <= 25
    assert np.isnan(found.columns["dbh_m"][fern]).all()
    assert -np.log1p(-0.3) * 3000 / 2 == pytest.approx(np.pi * np.sum(found.radius_m[fern] ** 2), rel=0.1)


def test_the_seed_decides(species):
    one, same, other = (grown(species, SPRUCE, seed) for seed in (4, 4, 5))
    for field in fields(one):
        if isinstance(value := getattr(one, field.name), np.ndarray):
            assert np.array_equal(value, getattr(same, field.name))
    assert all(np.array_equal(one.columns[k], same.columns[k], equal_nan=True) for k in one.columns)
    assert not np.array_equal(one.position_m, other.position_m)


STOREY = {"species": {"spruce": 1}, "stems_per_ha": 600, "basal_area_m2_per_ha": 40}
CONTRADICTIONS = {
    "stems, area and diameter": ({"storeys": [{**STOREY, "dbh": {"mean_cm": 20}}]}, "community.storeys.0"),
    "height and diameter": ({"storeys": [{**STOREY, "dominant_height_m": 8}]}, "community.storeys.0"),
    "cover of few small trees": (
        {"storeys": [{"species": {"spruce": 1}, "stems_per_ha": 50, "dominant_height_m": 10}], "canopy_cover": 0.95},
        "community.canopy_cover",
    ),
    "little cover of many trees": ({"storeys": [STOREY], "canopy_cover": 0.1}, "community.canopy_cover"),
    "leaves": ({"storeys": [STOREY], "leaf_area_index": 0.2}, "community.leaf_area_index"),
    "no room": (
        {
            "storeys": [{"species": {"oak": 1}, "stems_per_ha": 900, "dbh": {"mean_cm": 60}}],
            "keep_out": {"rows": [[0, 1, 1, 1, 1, 1, 1, 1]], "smooth": False},
        },
        "community.storeys.0",
    ),
    "no ground": ({"storeys": [STOREY], "keep_out": [[1]]}, "community.keep_out"),
    "gaps without room": ({"storeys": [STOREY], "gaps": {"share": 0.5, "diameter_m": 6}}, "community.gaps"),
    "taller than the species": (
        {"storeys": [{"species": {"birch": 1}, "stems_per_ha": 600, "dominant_height_m": 60}]},
        "community.storeys.0",
    ),
    "gaps wider than the site": ({"storeys": [STOREY], "gaps": {"share": 0.3, "diameter_m": 200}}, "community.gaps"),
    "gaps wider than their share": ({"storeys": [STOREY], "gaps": {"share": 0.01, "diameter_m": 30}}, "community.gaps"),
    "gaps too many to count": ({"storeys": [STOREY], "gaps": {"share": 0.3, "diameter_m": 0.01}}, "community.gaps"),
    "more stems than grass": (
        {"storeys": [{"species": {"pine": 1}, "basal_area_m2_per_ha": 300, "dbh": {"mean_cm": 0.5}}]},
        "community.storeys.0",
    ),
    "more stems, by the height": (
        {"storeys": [{"species": {"beech": 1}, "basal_area_m2_per_ha": 290, "dominant_height_m": 1.51}]},
        "community.storeys.0",
    ),
    "a wall of wood": (
        {"storeys": [{"species": {"pine": 1}, "stems_per_ha": 3000, "dbh": {"mean_cm": 200}}]},
        "community.storeys.0",
    ),
    "herbs without number": ({"ground": {"bracken": {"plants_per_ha": 1e8}}}, "community.ground.bracken.plants_per_ha"),
    "large herbs": (
        {"ground": {"bracken": {"plants_per_ha": 9, "radius_m": 30}}},
        "community.ground.bracken.radius_m",
    ),
    "storeys upside down": (
        {"storeys": [{**STOREY, "dominant_height_m": 25}, {**STOREY, "dominant_height_m": 30}]},
        "community.storeys.1",
    ),
    "a fern as a tree": (
        {"storeys": [{"species": {"bracken": 1}, "stems_per_ha": 9, "dbh": {"mean_cm": 9}}]},
        "community.storeys.0.species.bracken",
    ),
}


@pytest.mark.parametrize("name", CONTRADICTIONS)
def test_targets_that_contradict_each_other_are_refused_with_what_is_feasible(name, species):
    given, place = CONTRADICTIONS[name]
    with raises_error(RecipeError, place=place):
        grown(species, given)


def test_the_feasible_value_of_a_refusal_is_feasible(species):
    storey = {"species": {"spruce": 1}, "stems_per_ha": 600, "basal_area_m2_per_ha": 30}
    with pytest.raises(RecipeError) as caught:
        grown(species, {"storeys": [storey], "canopy_cover": 0.97})
    low, high = (float(one) for one in caught.value.expected.split(":")[0].split(" to "))
    for cover in (low + 0.01, high - 0.01):
        assert brute_cover(grown(species, {"storeys": [storey], "canopy_cover": cover}), SIZE) == pytest.approx(
            cover, rel=0.02
        )


INCOMPLETE = {
    "no number": {"species": {"spruce": 1}, "dominant_height_m": 20},
    "no size": {"species": {"spruce": 1}, "stems_per_ha": 500},
    "an index without age": {"species": {"spruce": 1}, "stems_per_ha": 500, "site_index_m": 24},
    "too young": {"species": {"spruce": 1}, "stems_per_ha": 500, "site_index_m": 24, "age_yr": 3},
    "just born": {"species": {"spruce": 1}, "stems_per_ha": 500, "site_index_m": 24, "age_yr": 1e-30},
    "two heights": {"species": {"oak": 1}, "stems_per_ha": 9, "site_index_m": 24, "age_yr": 9, "dominant_height_m": 9},
    "an unknown species": {"species": {"spurce": 1}, "stems_per_ha": 500, "dominant_height_m": 9},
}


@pytest.mark.parametrize("name", INCOMPLETE)
def test_an_incomplete_storey_is_refused_when_the_recipe_is_checked(name, examples, tmp_path):
    path = tmp_path / "recipe.yaml"
    whole = examples(stand)[1].split("community:")[0]
    path.write_text(f"{whole}community: {{model: stand, storeys: [{INCOMPLETE[name]}]}}\n")
    with raises_error(RecipeError):
        check_plan(load_recipe(path), simulate_only=True)


def test_a_map_of_zeros_is_one_error_and_surroundings_may_be_left_empty(examples, tmp_path):
    path = tmp_path / "recipe.yaml"
    text = examples(stand)[1].replace("terrain: rolling", "surroundings: ")
    path.write_text(text)
    assert check_plan(load_recipe(path), simulate_only=True).drawn.recipe.site.surroundings.kind == "open"
    path.write_text(f"{text}  map: [[0]]\n")
    with raises_error(RecipeError, place="community.map"):
        check_plan(load_recipe(path), simulate_only=True)


def test_a_cover_of_crowns_that_cover_nothing_is_refused(species):
    storey = {"species": {"pine": 1}, "stems_per_ha": 0.001, "dbh": {"mean_cm": 0.1}}
    with raises_error(RecipeError, place="community.canopy_cover"):
        grown(species, {"storeys": [storey], "canopy_cover": 0.5}, size_m=(5000.0, 5000.0))


def test_a_stand_with_more_leaves_than_any_forest_says_so(species):
    found = grown(
        species, {"storeys": [{**STOREY, "stems_per_ha": 60000, "basal_area_m2_per_ha": 80}]}, size_m=(20.0, 20.0)
    )
    assert found.state["reached"]["leaf_area_index"] > 18
    assert any("ask for a leaf_area_index" in note for note in found.notes)


@pytest.mark.parametrize("number", range(5))
def test_the_recipes_of_the_manual_page_make_a_stand_on_terrain(number, examples, tmp_path):
    path = tmp_path / "recipe.yaml"
    path.write_text(examples(stand)[number])
    plan = check_plan(load_recipe(path), simulate_only=True)
    found = plan.community.with_tree_sizes(final_population(plan.community, Silent()))
    stems = found.state["reached"]["storeys"][0]["stems_per_ha"]
    assert stems == pytest.approx((600, 900, 250, 250, 420)[number], rel=0.1)
    trees = found.columns["dbh_m"] > 0
    assert found.columns["leaf_area_m2"][trees].sum() / 2000 == pytest.approx(found.state["reached"]["leaf_area_index"])


@pytest.mark.slow
def test_a_square_kilometre_of_100_000_trees_takes_less_than_10_seconds(species):
    given = {
        "storeys": [{**STOREY, "stems_per_ha": 1000, "species": {"spruce": 0.8, "pine": 0.2}}],
        "canopy_cover": 0.75,
        "leaf_area_index": 6,
        "gaps": {"share": 0.06, "diameter_m": 14},
    }
    grown(species, given)  # compiled
    began = time.perf_counter()
    found = grown(species, given, size_m=(1000.0, 1000.0))
    assert len(found) == 100_000
    assert time.perf_counter() - began < 10


@pytest.mark.parametrize("side_m", [30, 300])  # tried when the recipe is checked; too large for that
def test_targets_that_contradict_each_other_are_refused_with_their_line(side_m, tmp_path):
    path = tmp_path / "recipe.yaml"
    storey = "{species: {spruce: 1}, stems_per_ha: 600, basal_area_m2_per_ha: 40}"
    path.write_text(
        f"forestgen: 1\nsite: {{size_m: [{side_m}, {side_m}]}}\nspecies: {{spruce: {{from: spruce}}}}\n"
        f"community:\n  model: stand\n  leaf_area_index: 0.1\n  storeys: [{storey}]\n"
    )
    with raises_error(RecipeError, place="community.leaf_area_index") as caught:
        final_population(check_plan(load_recipe(path), simulate_only=True).community, Silent())
    assert f"{path}:6: " in caught.value.where
