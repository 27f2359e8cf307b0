"""Materials from the recipe's spectra and colours, and what is said of those that know too little."""

import numpy as np
import pytest

from forestgen.core.spectrum import Band, Spectrum
from forestgen.recipe.load import load_recipe_data
from forestgen.recipe.phenology import TimeOfYear, leaf_state
from forestgen.scene.colour import RGB, Channels, colours_of_surface
from forestgen.scene.spec import Camera
from forestgen.scene.surfaces import infrared_notes, materials_of
from forestgen.scene.terrain import HeightField, build_terrain


def species(**materials):
    data = {
        "forestgen": 1,
        "species": {"birch": {"from": "birch", "materials": materials}, "spruce": "spruce"},
        "community": {"model": "placed"},
    }
    return load_recipe_data(data, "test").draw(0).species


def materials_in(kinds, season):
    time = TimeOfYear(season)
    return materials_of(kinds, {name: [leaf_state(one.phenology, time)] for name, one in kinds.items()})


def camera(*ends_nm: float) -> Camera:
    bands = tuple(Band("b", Spectrum(np.array([500.0, end]), np.ones(2))) for end in ends_nm)
    return Camera("c", (0, 0, 0), np.eye(3), (8, 8), 60.0, bands=bands)


def test_materials_have_the_colours_of_their_spectra():
    for material in materials_of(species()).values():
        r, t = colours_of_surface(material.reflectance_spectrum, material.transmittance_spectrum)
        assert (material.reflectance, material.transmittance) == (r, t)
        np.testing.assert_allclose(RGB.of_surface(material.reflectance, material.reflectance_spectrum), r)
        if material.texture is not None:
            np.testing.assert_allclose(material.texture.colour.mean(axis=(0, 1), dtype=float), r, rtol=1e-4)


def test_seasons_change_leaves_and_not_needles():
    summer, autumn = materials_in(species(), "summer"), materials_in(species(), "autumn")
    red_summer, red_autumn = (one["birch", "leaf"].reflectance[0] for one in (summer, autumn))
    assert red_autumn > 3 * red_summer
    assert autumn["spruce", "needle"].reflectance == summer["spruce", "needle"].reflectance
    own = materials_in(species(leaf={"season": "summer"}), "autumn")["birch", "leaf"]
    assert own.reflectance == summer["birch", "leaf"].reflectance


EVERGREEN = (
    "pine", "spruce", "hemlock", "sequoia", "cypress", "juniper", "palm", "fan_palm", "tree_fern", "eucalyptus",
    "meranti", "cecropia", "rosemary",
)  # fmt: skip
NOT_EVERGREEN = ("birch", "larch", "grass", "bracken")


@pytest.mark.parametrize("name", [*EVERGREEN, *NOT_EVERGREEN])
def test_evergreen_leaves_are_green_in_every_season(name):
    data = {"forestgen": 1, "species": {name: name}, "community": {"model": "placed"}}
    kinds = load_recipe_data(data, "test").draw(0).species
    key = next(one for one in ("needle", "leaf", "frond", "blade") if one in kinds[name].materials)
    red, green, _ = materials_in(kinds, "dry")[name, key].reflectance
    assert (green > 1.2 * red) == (name in EVERGREEN)
    if name in EVERGREEN:
        summer = materials_of(kinds)[name, key]
        for season in ("spring", "autumn", "winter", "dry"):
            one = materials_in(kinds, season)[name, key]
            assert one.reflectance_spectrum is summer.reflectance_spectrum
            assert one.transmittance_spectrum is summer.transmittance_spectrum


def test_an_evergreen_stays_green_with_a_spectrum_of_the_recipes():
    """A recipe's own spectrum replaces the species file's, with its season."""
    data = {
        "forestgen": 1,
        "species": {"pine": {"from": "pine", "materials": {"needle": {"spectrum": "leaves/spruce"}}}},
        "community": {"model": "placed"},
    }
    kinds = load_recipe_data(data, "test").draw(0).species
    assert materials_in(kinds, "dry")["pine", "needle"] == materials_of(kinds)["pine", "needle"]


def test_green_leaves_look_as_leaves_do():
    """Birch in Hyytiälä: 0.075 to 0.111 reflected from 520 to 560 nm, 0.050 at 665, 0.051 at 450 (Hovi et al. 2024)."""
    leaf = materials_of(species())["birch", "leaf"]
    for red, green, blue in (leaf.reflectance, leaf.transmittance):
        assert 0.075 < green < 0.13
        assert 1.2 < green / red < 1.8
        assert blue < 0.75 * red


def test_colours_and_short_tables_are_noted_where_bands_reach_past_them():
    short = {"name": "mine.csv", "text": "wavelength_nm,reflectance\n400,0.1\n750,0.3\n"}
    materials = materials_of(species(leaf={"reflectance": [0.1, 0.2, 0.1]}, twig={"spectrum": short}))
    assert infrared_notes(materials, [camera()]) == []
    assert infrared_notes(materials, [camera(700.0)]) == []
    colours, tables = infrared_notes(materials, [camera(), camera(650.0, 842.0)])
    assert "842 nm" in colours
    assert "birch.leaf" in colours
    assert "birch.twig (750 nm)" in tables
    assert infrared_notes(materials_of(species()), [camera(2300.0)]) == []


@pytest.mark.parametrize("ground", [pytest.param("litter", marks=pytest.mark.slow), "soil_wet", "snow"])
def test_the_ground_has_its_spectrum(ground):
    terrain = build_terrain(HeightField((10.0, 10.0)), np.random.default_rng(3), ground)
    np.testing.assert_allclose(terrain.mean_colour, colours_of_surface(terrain.spectrum, None)[0], rtol=1e-4)
    assert terrain.texture.max() <= 1
    assert terrain.texture.std() > 0.001
    np.testing.assert_allclose(terrain.far_reflectance, colours_of_surface(terrain.far_spectrum, None)[0])
    channels = Channels((480.0, 842.0, 1600.0))
    seen = channels.texture(terrain.texture[::4, ::4], terrain.texture[::4, ::4].mean(axis=(0, 1)), terrain.spectrum)
    np.testing.assert_allclose(seen.mean(axis=(0, 1)), terrain.spectrum.at([480, 842, 1600]), rtol=1e-3)
