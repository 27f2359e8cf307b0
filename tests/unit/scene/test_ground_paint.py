"""Patches of the ground: as much of it as the recipe says, painted where things lie, right in every channel."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.ndimage import uniform_filter

from forestgen.core.progress import Silent, Timings
from forestgen.pipeline import assemble_image
from forestgen.recipe.load import load_recipe_data
from forestgen.recipe.spectra import load_spectra
from forestgen.scene.build import BuiltScene
from forestgen.scene.colour import Channels, colours_of_surface
from forestgen.scene.ground_cover import LaidGround, ground_cover, local_cover
from forestgen.scene.ground_paint import patches, relative_cover
from forestgen.scene.plan import check_plan
from forestgen.scene.surfaces import ground_texture
from forestgen.scene.terrain import TEXTURE_TILE_M

PATCHY = {"what": "twigs", "cover": 0.4, "patch_m": 2}
SAND = {"what": "bare_soil", "of": "sand", "cover": 0.3, "patch_m": 3}


def laid(*layers: dict[str, Any], **camera: Any) -> tuple[BuiltScene, LaidGround]:
    data = {
        "forestgen": 1,
        "species": {"grass": None},
        "site": {"size_m": [24, 24], "ground": {"kind": "soil_wet", "layers": list(layers)}},
        "community": {"model": "placed", "plants": [{"species": "grass", "position_m": [1, 1], "radius_m": 0.1}]},
        "cameras": [{"name": "a", "size_px": [64, 48], "position_m": [12, 12, 2], "look_at_m": [20, 12, 0], **camera}],
    }
    built = assemble_image(check_plan(load_recipe_data(data, "test")), Silent(), Timings())
    return built, ground_cover(built.plan, built.population, built.spec.cameras)


@pytest.mark.parametrize("cover", [0.05, 0.5, 0.9])
@pytest.mark.parametrize("patch_m", [0.5, 6.0])
def test_patches_hide_their_share_and_meet_at_the_textures_edges(cover: float, patch_m: float) -> None:
    share = patches(cover, patch_m, False, np.random.default_rng(3))
    assert share.mean() == pytest.approx(cover, abs=0.01)
    inside = np.abs(np.diff(share, axis=0)).mean()
    assert np.abs(share[0] - share[-1]).mean() < 2.0 * inside + 0.01
    assert share.std() > 0.3 * np.sqrt(cover * (1.0 - cover))


@pytest.mark.parametrize("has_things", [True, False], ids=["things", "bare soil"])
def test_patches_are_as_large_as_the_recipe_says(has_things: bool) -> None:
    """Their mean width along a line, seen so blurred that spots of bare soil and ragged edges vanish."""
    for patch_m in (1.0, 4.0):
        share = patches(0.5, patch_m, has_things, np.random.default_rng(4))
        inside = uniform_filter(share, round(0.3 * patch_m / TEXTURE_TILE_M * len(share)), mode="wrap") > 0.5
        edges = np.abs(np.diff(inside.astype(int), axis=1)).sum(axis=1)
        assert TEXTURE_TILE_M / edges.mean() == pytest.approx(patch_m, rel=0.25)


def test_things_lie_where_the_ground_is_painted_with_them() -> None:
    built, found = laid(PATCHY)
    [layer], share = found.layers, found.patches[0]
    row, column = np.indices((24, 24)).reshape(2, -1)
    side = len(share) // 24
    wanted = [
        share[r * side : (r + 1) * side, c * side : (c + 1) * side].mean() for r, c in zip(row, column, strict=True)
    ]
    middle = np.stack([column, row], axis=1) + 0.5
    cover = local_cover(layer, middle, 1)
    np.testing.assert_allclose(cover, np.minimum(wanted, 0.98), rtol=1e-4)
    np.testing.assert_array_equal(cover, local_cover(layer, middle + np.array([48.0, -24.0]), 1))
    assert built.spec.terrain.bare is not None


def test_bare_soil_hides_what_is_listed_before_it() -> None:
    sections = laid(PATCHY, SAND, {"what": "stones", "cover": 0.1})[0].plan.drawn.recipe.site.ground.layers
    square = np.zeros((1536, 1536), dtype=np.float32)
    square[:768] = 1.0
    before, sand, after = relative_cover(sections, {1: square})
    assert before is not None
    assert before[:12].max() == 0.0
    assert np.all(before[12:] == 1.0)
    assert sand is not None
    assert after is None


def test_bare_soil_leaves_large_patches_of_other_layers() -> None:
    [layer] = (one for one in laid({**PATCHY, "patch_m": 20}, SAND)[1].layers if one.things)
    middle = 100.0 * np.random.default_rng(1).random((4000, 2))
    assert layer.relative is not None
    assert local_cover(layer, middle, 1).std() > 2.0 * layer.cover * layer.relative.std()


def test_patches_have_their_own_spectrum_in_every_channel() -> None:
    """Texels of pure sand and of wet soil, and the mean; the camera is so far away that nothing is drawn."""
    above = {"position_m": [12, 12, 2000], "look_at_m": [12, 12.1, 0], "hfov_deg": 2}
    terrain = laid(SAND, **above)[0].spec.terrain
    channels = Channels((480.0, 842.0, 1600.0))
    texture = ground_texture(terrain, channels)
    assert terrain.bare is None
    assert terrain.mixture is not None
    share = terrain.mixture.parts[0].amount
    sand, soil = (load_spectra(f"ground/{name}")["reflectance"] for name in ("sand", "soil_wet"))
    for channel, wavelength_nm in enumerate((480.0, 842.0, 1600.0)):
        pure, none = texture[share > 0.95][:, channel], texture[share < 0.001][:, channel]
        assert pure.mean() == pytest.approx(share[share > 0.95].mean() * float(sand.at(wavelength_nm)), rel=0.02)
        assert none.mean() == pytest.approx(float(soil.at(wavelength_nm)), rel=0.03)
        assert texture[..., channel].mean() == pytest.approx(float(terrain.spectrum.at(wavelength_nm)), rel=1e-3)
    np.testing.assert_allclose(terrain.mean_colour, colours_of_surface(terrain.spectrum, None)[0], rtol=1e-3)
