"""Tree lists: what they say is what stands, and what no list says is refused with its line."""

from __future__ import annotations

import time

import numpy as np
import pytest

from forestgen.community.model import simulate
from forestgen.community.models import inventory
from forestgen.community.models.inventory import MODEL, InventoryParameters
from forestgen.community.population import Site, Status
from forestgen.community.simulation import final_population
from forestgen.community.stand.build import nearest_index
from forestgen.community.tree_columns import with_tree_sizes
from forestgen.core.errors import AssetError, RecipeError
from forestgen.core.progress import Silent
from forestgen.dataset.writer import write_maps
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import check_plan
from support.error_messages import raises_error

SITE = Site((50.0, 40.0))
LIST = """species,x_m,y_m,dbh_cm,height_m,crown_radius_m,crown_base_m,status,age_yr,azimuth_deg,plot
spruce,1,2,30,24,2.5,9,alive,80,15,A
beech,4.5,5,,20,,,dead,,,A

# the northern part
bracken,3,3,,0.5,,,,,,B
oak,50,40,40,,,,NA,NA,,B
"""


def placed(species, table, site=SITE, seed=3, **given):
    (population,) = simulate(MODEL, InventoryParameters(table=table, **given), site, species, seed, steps=0)
    return population


def test_what_the_list_says_is_what_stands(species):
    found = placed(species, LIST)
    names = [species[index].name for index in found.species]
    assert names == ["spruce", "beech", "bracken", "oak"]
    assert found.plant_id.tolist() == [1, 2, 3, 4]
    assert found.position_m.tolist() == [[1, 2, 0], [4.5, 5, 0], [3, 3, 0], [50, 40, 0]]
    assert found.height_m[:3].tolist() == [24, 20, 0.5]
    assert found.age_yr.tolist() == [80, 0, 0, 0]
    assert found.columns["azimuth_deg"][0] == 15
    assert (found.status == Status.DEAD).tolist() == [False, True, False, False]
    assert "without meaning here: plot" in found.notes[0]
    whole = with_tree_sizes(found, species, SITE, 3, periodic=False)
    row = {name: values[0] for name, values in whole.columns.items()}
    assert (row["dbh_m"], row["crown_radius_m"], row["crown_base_m"]) == (0.3, 2.5, 9)
    assert row["leaf_area_m2"] > 10
    assert whole.columns["leaf_area_m2"][1] == 0  # a dead tree
    assert whole.columns["dbh_m"][1] > 0.1
    assert np.isnan(whole.columns["dbh_m"][2])


def test_heights_follow_from_diameters_and_neighbours(species):
    rng = np.random.default_rng(1)
    line = "spruce,{:.2f},{:.2f},{:.1f}\n".format
    head = "species,x_m,y_m,dbh_cm\n"
    close = "".join(line(*(20 * rng.random(2)), 20 + 10 * rng.random()) for _ in range(120))
    far = "".join(line(10 * (i % 5) + 1, 10 * (i // 5) + 1, 20 + 0.5 * i) for i in range(20))
    dense = placed(species, head + close, periodic=False).height_m.mean()
    sparse = placed(species, head + far, periodic=False).height_m.mean()
    assert dense > 1.2 * sparse
    law = species[0].tree
    assert dense == pytest.approx(law.height_of(np.full(1, 0.25), np.zeros((1, 4)))[0], rel=0.15)


def test_a_dead_tree_grew_among_all_trees_and_a_living_one_is_free_of_the_dead(species):
    """Their heights follow from diameters: higher in a dense stand, whether it lives or is dead."""
    rng = np.random.default_rng(1)
    place_m = 20 * rng.random((120, 2))
    heights = {}
    for middle, others in (("alive", "alive"), ("dead", "dead"), ("alive", "dead"), ("dead", "alive"), ("dead", None)):
        rest = "" if others is None else "".join(f"spruce,{x:.2f},{y:.2f},25,{others}\n" for x, y in place_m)
        table = f"species,x_m,y_m,dbh_cm,status\nspruce,10,10,25,{middle}\n{rest}"
        heights[middle, others] = placed(species, table, periodic=False).height_m[0]
    assert heights["dead", "dead"] == heights["alive", "alive"] == heights["dead", "alive"]
    assert heights["alive", "dead"] == pytest.approx(heights["dead", None])
    assert heights["dead", None] < 0.9 * heights["dead", "dead"]


def test_a_few_thick_veterans_and_those_with_heights_stand(species):
    thick = "species,x_m,y_m,dbh_cm,height_m\n"
    assert len(placed(species, thick + "".join(f"oak,{k},2,220,\n" for k in range(1, 5)))) == 4
    assert len(placed(species, thick + "".join(f"oak,{k},2,220,28\n" for k in range(1, 9)))) == 8


@pytest.mark.parametrize("measured", [4, 40])
def test_heights_that_are_not_known_follow_those_that_are(measured, species):
    """Where five trees of a species or more are measured: here all are 0.7 times as tall above 1.3 m as usual."""
    rng, law = np.random.default_rng(2), species[0].tree
    dbh_cm = rng.uniform(15, 40, 80)
    usual_m = law.height_of(dbh_cm / 100, np.zeros((80, 4)))
    short = [f"{1.3 + 0.7 * (h - 1.3):.3f}" if k < measured else "" for k, h in enumerate(usual_m)]
    x, y = 2.0 + rng.random((2, 80)) * 36
    lines = [f"spruce,{a:.3f},{b:.3f},{d:.3f},{h}" for a, b, d, h in zip(x, y, dbh_cm, short, strict=True)]
    found = placed(species, "species,x_m,y_m,dbh_cm,height_m\n" + "\n".join(lines), SITE)
    free = placed(species, "species,x_m,y_m,dbh_cm\n" + "\n".join(one.rpartition(",")[0] for one in lines), SITE)
    ratio, usual = (np.mean((one.height_m[40:] - 1.3) / (usual_m[40:] - 1.3)) for one in (found, free))
    assert ratio == pytest.approx(0.7 if measured == 40 else usual, rel=0.05)


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        ("Baumart;X;Y;BHD;Höhe\nWeißtanne;1,5;2,25;30,5;\n", "cp1252"),
        ("Baumart;X;Y;BHD;Höhe\r\nWeißtanne;1,5;2,25;30,5;\r\n", "utf-8-sig"),
        ("Baumart\tX\tY\tBHD\tHöhe\nWeißtanne\t1.5\t2.25\t30.5\tNA", "utf-16"),
        ('"Baumart","X","Y","BHD","Höhe"\n"Weißtanne","1.5",2.25,30.5,""', "utf-8"),
    ],
)
def test_lists_as_spreadsheets_write_them(text, encoding, species, tmp_path):
    path = tmp_path / "list.csv"
    path.write_bytes(text.encode(encoding))
    columns = {"Baumart": "species", "X": "x_m", "Y": "y_m", "BHD": "dbh_cm", "Höhe": "height_m"}
    parameters = InventoryParameters(file=str(path), columns=columns, species_map={"Weißtanne": "spruce"})
    (found,) = simulate(MODEL, parameters, SITE, species, 3, steps=0)
    assert found.position_m.tolist() == [[1.5, 2.25, 0]]
    assert found.columns["dbh_m"].tolist() == [0.305]


def test_codes_of_species_and_a_map_s_coordinates(species):
    table = "species,x_m,y_m,dbh_m\n10,412301,5612802,0.3\n42,412310,5612803,0.2\n"
    found = placed(species, table, species_map={10: "spruce", 42: "oak"}, origin_m=(412300, 5612800))
    assert found.species.tolist() == [0, 3]
    assert found.position_m.tolist() == [[1, 2, 0], [10, 3, 0]]


def test_a_recipe_writes_codes_of_species_as_the_list_does(examples, tmp_path):
    path = tmp_path / "recipe.yaml"
    (tmp_path / "trees.csv").write_text("species,x_m,y_m,dbh_m\n010,1,2,0.3\n42,10,3,0.2\n1.5,4,3,0.2\n")
    head = examples(inventory)[0].split("community:")[0]
    path.write_text(
        f"{head}community: {{model: inventory, file: trees.csv, species_map: {{010: oak, 42: pine, 1.5: oak}}}}\n"
    )
    found = final_population(check_plan(load_recipe(path), simulate_only=True).community, Silent())
    assert [found.species_names[index] for index in found.species] == ["oak", "pine", "oak"]


def test_cells_in_quotes_have_separators_and_line_breaks(species):
    text = 'sep=;\n\n# plot 7, "north"\n"Art; deutsch";species;x_m;"Lage\n[m]";dbh_cm;note\n;;;;;\n'
    text += ';spruce;1;2;30;"a tree;\nwith ""two"" tops"\n;spruce;3;4;-30;a\u2028b\x0cc\n'
    with raises_error(RecipeError, place="line 9"):
        placed(species, text, columns={"Lage\n[m]": "y_m"})
    found = placed(species, text.replace("-30", "28"), columns={"Lage\n[m]": "y_m"})
    assert found.position_m[:, :2].tolist() == [[1, 2], [3, 4]]


@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r"])
def test_messages_name_the_line_whatever_ends_it(ending, species):
    text = ending.join(["# plot 7", "", "species,x_m,y_m,dbh_cm", "spruce,1,2,30", "", "spruce,1,2,0", ""])
    with pytest.raises(RecipeError) as caught:
        placed(species, text)
    assert caught.value.where == "community.table, line 6"
    with pytest.raises(RecipeError) as caught:
        placed(species, text.replace("y_m", "z_m"))
    assert caught.value.where == "community.table, line 3"


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be", "utf-32", "utf-32-be"])
def test_text_in_another_encoding_is_refused_as_such(encoding, species, tmp_path):
    path = tmp_path / "trees.csv"
    path.write_bytes(LIST.encode(encoding))
    with raises_error(RecipeError, place="trees.csv"):
        InventoryParameters(file=str(path)).trees()


def test_a_tall_tree_s_crown_may_begin_above_the_height_of_its_diameter(species):
    head = "species,x_m,y_m,dbh_cm,crown_base_m\n"
    usual = placed(species, head + "spruce,1,2,30,").height_m[0]
    found = placed(species, head + f"spruce,1,2,30,{1.2 * usual:.3f}")
    assert found.height_m[0] == pytest.approx(1.2 * usual / 0.95, rel=1e-3)


def test_each_tree_of_a_line_reaches_above_the_line_s_crown_base(species):
    line, site = "species,dbh_cm,crown_base_m,stems_per_ha\nspruce,20,{},300\n", Site((100.0, 100.0))
    usual = placed(species, line.format(""), site).height_m
    base_m = 1.2 * float(np.median(usual))
    assert (usual < base_m / 0.95 / 1.5).sum() > 10  # more than each of them may be raised
    found = placed(species, line.format(base_m), site)
    assert found.height_m == pytest.approx(np.maximum(usual, base_m / 0.95))
    with raises_error(RecipeError, place="community.table, line 2"):
        placed(species, line.format(round(1.3 * base_m)), site)  # above what a height is raised to


def test_stumps_are_short_and_crowns_of_herbs_mean_nothing(species):
    text = "species,x_m,y_m,dbh_cm,height_m,crown_radius_m,status\nspruce,1,2,60,3,,dead\nbracken,3,3,,0.5,0.3,\n"
    found = placed(species, text)
    assert found.columns["dbh_m"][0] == 0.6
    assert np.isnan([found.columns[name][1] for name in ("dbh_m", "crown_radius_m", "leaf_area_m2")]).all()
    assert "1 lines are left out: no trees, but bracken" in found.notes[-1]


UNUSED = {
    "plot_area_m2": ({"plot_area_m2": 500}, "species,x_m,y_m,height_m\nspruce,1,2,20"),
    "map": ({"map": [[1, 0]]}, "species,x_m,y_m,height_m\nspruce,1,2,20"),
    "clark_evans": ({"clark_evans": 1.3}, "species,x_m,y_m,height_m\nspruce,1,2,20"),
    "origin_m": ({"origin_m": (3, 4), "plot_area_m2": 500}, "species,height_m\nspruce,20"),
    "plot_area_m2 beside stems_per_ha": ({"plot_area_m2": 5}, "species,height_m,stems_per_ha\nspruce,20,100"),
}


@pytest.mark.parametrize("name", UNUSED)
def test_a_key_that_means_nothing_for_the_list_is_refused(name, species):
    given, table = UNUSED[name]
    with raises_error(RecipeError, place=f"community.{name.split()[0]}"):
        placed(species, table, **given)


def test_trees_of_plots_stand_for_those_of_the_site(species):
    site = Site((100.0, 100.0))
    table = "species,dbh_cm,height_m,count\nspruce,31.5,24,12\nbirch,18,,33.3\nbeech,,9,4\n"
    found = placed(species, table, site, plot_area_m2=500, clark_evans=1.2)
    assert np.bincount(found.species, minlength=6).tolist() == [240, 0, 666, 0, 80, 0]
    assert set(found.columns["dbh_m"][found.species == 0]) == {0.315}
    assert set(found.height_m[found.species == 4]) == {9}
    assert np.std(found.height_m[found.species == 2]) > 0.5  # numbers of their own
    assert nearest_index(found.position_m[:, :2], site, periodic=True) == pytest.approx(1.2, abs=0.05)
    per_ha = placed(species, "species,height_m,stems_per_ha\noak,12,130.4\noak,9,20.1\n", Site((50.0, 50.0)))
    assert len(per_ha) == 38
    assert placed(species, table, site, plot_area_m2=500).position_m.tolist() != found.position_m.tolist()


HEAD = "species,x_m,y_m,dbh_cm\n"
BAD = {
    "a negative diameter": HEAD + "spruce,1,2,30\nspruce,2,2,-3",
    "diameters of zero": HEAD + "spruce,1,2,0\nspruce,2,2,0",
    "not a number": HEAD + "spruce,1,2,NaN",
    "infinity": HEAD + "spruce,1,2,inf",
    "a word": HEAD + "spruce,1,two,30",
    "centimetres as metres": "species,x_m,y_m,dbh_m\nspruce,1,2,32",
    "an unknown species": HEAD + "spruce,1,2,30\nfir,1,3,30\nfir,1,4,30\nyew,2,2,3",
    "beyond the site": HEAD + "spruce,1,2,30\nspruce,51,2,30",
    "twice": HEAD + "spruce,1,2,30\noak,1,2,30\n\nspruce,1,2,31",
    "an empty file": "",
    "no trees": HEAD,
    "a slip of the pen": "species,x_m,y_m,dhb_cm,height_m\nspruce,1,2,30,20",
    "other columns": "Baumart;BHD\nFichte;30",
    "no y": "species,x_m,dbh_cm\nspruce,1,30",
    "a column twice": "species,x_m,y_m,dbh_cm,dbh_cm\nspruce,1,2,3,4",
    "two diameters": "species,x_m,y_m,dbh_cm,dbh_m\nspruce,1,2,3,0.03",
    "decimal commas between commas": HEAD + "spruce,1,2,30\nspruce,1,5,2,5,30,5",
    "no size": HEAD + "spruce,1,2,",
    "no place": HEAD + "spruce,,2,30",
    "neither places nor numbers": "species,dbh_cm\nspruce,30",
    "places and numbers": "species,x_m,y_m,dbh_cm,count\nspruce,1,2,30,2",
    "a thick seedling": "species,x_m,y_m,dbh_cm,height_m\nspruce,1,2,30,1.2",
    "a crown above the tree": "species,x_m,y_m,height_m,crown_base_m\nspruce,1,2,20,21",
    "a fern's diameter": HEAD + "bracken,1,2,3",
    "a tall fern": "species,x_m,y_m,height_m\nbracken,1,2,9",
    "no species": HEAD + ",1,2,30",
    "neither alive nor dead": "species,x_m,y_m,height_m,status\nspruce,1,2,20,healthy",
    "no text": "PK\x03\x04\0\0",
    "an unclosed quotation mark": HEAD + 'spruce,1,2,30\n"spruce,2,2,30\nspruce,3,2,30',
    "text beside a quotation mark": HEAD + 'spruce,1,2,30\n"spruce" tall,2,2,30',
    "a long cell": HEAD + f"spruce,1,2,{'9' * 140_000}",
    "no ground": ("species,dbh_cm,stems_per_ha\nspruce,30,500", {"keep_out": [[1]]}),
    "names of their own for places": "species,X,Y,dbh_cm\nspruce,1,2,30",
    "a line break in a name": HEAD + 'spruce,1,2,30\n"spr\nuce",2,2,30',
    "separated by blanks": "species x_m y_m dbh_cm\nspruce 1 2 30",
    "another case": HEAD + "Spruce,1,2,30\nSpruce,1,3,30\nBEECH,1,4,30",
    "thicker than tall": "species,x_m,y_m,dbh_cm,height_m\npine,5,5,300,5\noak,6,6,300,5",
    "a thick tree": HEAD + "birch,5,5,1500",
    "a thread": "species,x_m,y_m,dbh_cm,height_m\npine,5,5,2,30",
    "a wide crown": "species,x_m,y_m,height_m,crown_radius_m\npine,5,5,5,9",
    "a narrow crown": "species,x_m,y_m,height_m,crown_width_m\npine,5,5,30,1",
    "a crown above the height of the diameter": "species,x_m,y_m,dbh_cm,crown_base_m\npine,5,5,10,40",
    "millimetres": HEAD + "".join(f"spruce,{k},2,{120 + 30 * k}\n" for k in range(1, 8)),
    "a dash": HEAD + "spruce,1,2,-\nspruce,1,3,-",
    "a decimal comma in quotes": HEAD + 'spruce,1,2,"30,5"',
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_list_has_one_message_with_its_line(name, species):
    table, given = BAD[name] if isinstance(BAD[name], tuple) else (BAD[name], {})
    with raises_error(RecipeError) as caught:
        placed(species, table, **given)
    assert ("community.keep_out" if name == "no ground" else "community.table") in caught.value.where


def test_a_bad_file_is_refused_when_the_recipe_is_checked(examples, tmp_path):
    path = tmp_path / "recipe.yaml"
    head = examples(inventory)[0].split("community:")[0]
    (tmp_path / "trees.csv").write_text(BAD["an unknown species"])
    path.write_text(f"{head}community: {{model: inventory, file: trees.csv}}\n")
    with raises_error(RecipeError, place="trees.csv, line 3"):
        check_plan(load_recipe(path), simulate_only=True)
    path.write_text(f"{head}community: {{model: inventory, file: tree.csv}}\n")
    with raises_error(AssetError, place="community.file"):
        check_plan(load_recipe(path), simulate_only=True)
    path.write_text(f"{head}community: {{model: inventory, table: 'a', columns: {{BHD: diameter}}}}\n")
    with raises_error(RecipeError, place="community.columns"):
        check_plan(load_recipe(path), simulate_only=True)


def test_the_recipe_s_hash_has_the_list_and_a_stored_recipe_its_copy(examples, tmp_path):
    path, trees = tmp_path / "recipe.yaml", tmp_path / "trees.csv"
    path.write_text(
        f"{examples(inventory)[0].split('community:')[0]}community: {{model: inventory, file: trees.csv}}\n"
    )
    hashes = []
    for text in (HEAD + "spruce,1,2,30", HEAD + "spruce,1,2,31"):
        trees.write_text(text)
        loaded = load_recipe(path)
        hashes.append(loaded.hash)
    assert hashes[0] != hashes[1]
    plan = check_plan(loaded, simulate_only=True)
    stored = write_maps(tmp_path / "set", plan.drawn.data, plan.drawn.folder)
    name = stored["community"]["file"]["file"].removeprefix("../maps/")
    assert name.endswith(".csv")
    assert (tmp_path / "set" / "maps" / name).read_text() == text
    trees.write_text(HEAD + "spruce,1,2,99")
    assert final_population(plan.community, Silent()).columns["dbh_m"].tolist() == [0.31]


FILES = {
    "trees.csv": "species,x_m,y_m,dbh_cm\nPicea abies,412310,5612810,30\nFagus sylvatica,412320.5,5612820,25\n",
    "Probefläche 7.csv": "Baumart;X;Y;BHD;Höhe\nspruce;10,5;3;22,5;\noak;4;5;30;18,5\n",
}


@pytest.mark.parametrize("number", [0, 1, 2])
def test_the_recipes_of_the_manual_page_make_a_stand_on_terrain(number, examples, tmp_path):
    path = tmp_path / "recipe.yaml"
    path.write_text(examples(inventory)[number])
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    plan = check_plan(load_recipe(path), simulate_only=True)
    found = plan.community.with_tree_sizes(final_population(plan.community, Silent()))
    assert len(found) == (2, 76, 2)[number]
    for name in ("dbh_m", "crown_radius_m", "crown_base_m", "leaf_area_m2"):
        assert np.all(found.columns[name] > 0)


@pytest.mark.slow
def test_a_million_lines_take_seconds(species, tmp_path):
    rng, n = np.random.default_rng(1), 1_000_000
    x, y = 3000 * rng.random((2, n))
    path = tmp_path / "million.csv"
    lines = (f"spruce,{a:.3f},{b:.3f},{d:.1f}" for a, b, d in zip(x, y, rng.uniform(5, 40, n), strict=True))
    path.write_text("\n".join([HEAD.strip(), *lines]))
    site = Site((3000.0, 3000.0))
    placed(species, LIST)  # compiled
    began = time.perf_counter()
    (found,) = simulate(MODEL, InventoryParameters(file=str(path)), site, species, 3, steps=0)
    assert len(found) == n
    assert time.perf_counter() - began < 60
