"""Spectra in recipes: named by materials, checked when the recipe is loaded, kept in drawn recipes."""

from pathlib import Path

import pytest

from forestgen.core.errors import AssetError, RecipeError
from forestgen.recipe.load import dump_yaml, load_recipe
from forestgen.scene.views import drawn_cameras
from support.error_messages import raises_error

TABLE = "wavelength_nm,reflectance,transmittance\n400,0.05,0.01\n670,0.04,0.01\n800,0.45,0.47\n"


def recipe(tmp_path: Path, species: str, more: str = "") -> Path:
    path = tmp_path / "stand.yaml"
    path.write_text(f"forestgen: 1\ncommunity: {{model: placed}}\n{more}\nspecies:\n  {species}\n")
    return path


def materials(path: Path, *overrides: str):
    drawn = load_recipe(path, overrides).draw(0)
    return next(iter(drawn.species.values())).materials


def test_a_shipped_species_names_its_spectrum(tmp_path):
    leaf = materials(recipe(tmp_path, "birch: birch"))["leaf"]
    assert (leaf.spectrum.name, leaf.spectrum.text, leaf.reflectance) == ("leaves/birch", None, None)


def test_a_table_beside_the_recipe_travels_with_the_drawn_recipe(tmp_path):
    (tmp_path / "mine.csv").write_text(TABLE)
    path = recipe(tmp_path, "birch: {from: birch, materials: {leaf: {spectrum: mine.csv}}}")
    loaded = load_recipe(path)
    stored = tmp_path / "elsewhere" / "drawn.yaml"
    stored.parent.mkdir()
    stored.write_text(dump_yaml(loaded.draw(0)))
    again = load_recipe(stored).draw(0)
    assert again.data == loaded.draw(0).data
    assert again.species["birch"].materials["leaf"].spectrum.text == TABLE
    before = loaded.hash
    (tmp_path / "mine.csv").write_text(TABLE.replace("0.47", "0.46"))
    assert load_recipe(path).hash != before


def test_a_species_files_table_lies_beside_that_file(tmp_path):
    folder = tmp_path / "species"
    folder.mkdir()
    (folder / "mine.csv").write_text(TABLE)
    shipped = Path(__file__).parents[3] / "scenes" / "species" / "grass.yaml"
    text = shipped.read_text().replace("spectrum: leaves/grass", "spectrum: mine.csv")
    (folder / "sedge.yaml").write_text(text)
    assert materials(recipe(tmp_path, "sedge: species/sedge.yaml"))["blade"].spectrum.text == TABLE


def test_a_colour_replaces_a_species_files_spectrum_and_a_spectrum_its_season(tmp_path):
    path = recipe(tmp_path, "palm: {from: palm, materials: {leaf: {reflectance: [0.1, 0.2, 0.1]}}}")
    leaf = materials(path)["leaf"]
    assert leaf.spectrum is None
    assert leaf.reflectance == (0.1, 0.2, 0.1)
    assert leaf.gloss == 0.03  # what has nothing to do with colour stays
    dry = materials(path, "species.palm.materials.dry_leaf.spectrum=bark/oak")["dry_leaf"]
    assert (dry.spectrum.name, dry.season) == ("bark/oak", None)
    replaced = materials(path, "species.palm.materials.dry_leaf={spectrum: null, reflectance: [0.3, 0.2, 0.1]}")
    assert (replaced["dry_leaf"].spectrum, replaced["dry_leaf"].season) == (None, None)
    died = materials(path, "species.palm.materials.dry_leaf.season=summer")["dry_leaf"]
    assert (died.spectrum.name, died.season) == ("leaves/palm", "summer")


def test_seasons_may_be_drawn(tmp_path):
    path = recipe(tmp_path, "birch: birch", "plants: {season: {choice: [spring, autumn]}}")
    assert {load_recipe(path).draw(image).recipe.plants.season for image in range(8)} == {"spring", "autumn"}


@pytest.mark.parametrize(
    "override",
    [
        "species.birch.materials.leaf.spectrum=leaves/brich",
        "species.birch.materials.leaf.spectrum=bad.csv",
        "species.birch.materials.leaf={spectrum: summer.csv, season: dry}",
        "plants.season=monsoon",
        "species.birch.materials.leaf.spectrum=null",
        "species.birch.materials.leaf={reflectance: [0, 0, 0], season: dry}",
        "species.birch.materials.leaf={spectrum: bark/oak, transmittance: [0.1, 0.1, 0.1]}",
        "species.birch.materials.leaf.gloss=0.2",
        "site.ground=lava",
    ],
)
def test_mistakes_are_told_when_the_recipe_is_loaded(tmp_path, override):
    (tmp_path / "bad.csv").write_text(TABLE.replace("0.45", "0.6"))
    (tmp_path / "summer.csv").write_text(TABLE.replace("tance", "tance_summer"))
    with raises_error(RecipeError, AssetError):
        load_recipe(recipe(tmp_path, "birch: birch"), [override])


def test_a_season_that_a_table_lacks_is_told_for_the_whole_recipe(tmp_path):
    (tmp_path / "summer.csv").write_text(TABLE.replace("tance", "tance_summer"))
    path = recipe(tmp_path, "birch: {from: birch, materials: {leaf: {spectrum: summer.csv}}}")
    load_recipe(path)
    with raises_error(AssetError, place="species.birch.materials.leaf.spectrum"):
        load_recipe(path, ["plants.season=autumn"])


def test_a_sensors_table_beside_the_recipe_travels_with_the_drawn_recipe(tmp_path):
    table = "wavelength_nm,red,nir\n600,0,0\n650,1,0\n700,0,0\n800,0,1\n900,0,0\n"
    (tmp_path / "mine.csv").write_text(table)
    path = recipe(tmp_path, "birch: birch", "cameras: [{bands: mine.csv}, {bands: sentinel2a}]")
    loaded = load_recipe(path)
    stored = tmp_path / "elsewhere" / "drawn.yaml"
    stored.parent.mkdir()
    stored.write_text(dump_yaml(loaded.draw(0)))
    again = load_recipe(stored).draw(0)
    assert again.data == loaded.draw(0).data
    own, shipped = (camera.bands for camera in again.recipe.cameras)
    assert (own.name, own.text, shipped.name, shipped.text) == ("mine.csv", table, "sentinel2a", None)
    assert [band.name for camera in drawn_cameras(again) for band in camera[0].bands][:3] == ["red", "nir", "B1"]
    before = loaded.hash
    (tmp_path / "mine.csv").write_text(table.replace("650,1", "650,0.9"))
    assert load_recipe(path).hash != before
    (tmp_path / "mine.csv").write_text(table.replace("650,1", "650e-9,1"))
    with raises_error(AssetError, place="cameras.0.bands)"):
        load_recipe(path)
