from __future__ import annotations

import time
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest
from scipy import ndimage

from forestgen.plants.bark.patterns import PATTERNS, Tile, upper_share
from forestgen.plants.bark.texture import SurfaceTexture, bark_texture, texture_images, with_bark_tiles, with_mean
from forestgen.plants.parameters import PlantParameters
from forestgen.recipe.species import Bark, BarkPattern

REFLECTANCE = (0.31, 0.24, 0.17)


def texture(pattern: str, name: str = "tree/bark", **keys) -> SurfaceTexture:
    bark_texture.cache_clear()
    return bark_texture(Bark(pattern=pattern, **{"tile_m": (0.3, 0.4), **keys}), REFLECTANCE, name)


def test_the_recipe_offers_every_pattern():
    assert set(get_args(BarkPattern)) == set(PATTERNS)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_mean_is_the_reflectance_and_values_are_in_range(pattern):
    made = texture(pattern, lichen=0.1, depth_m=0.007)
    assert made.colour.dtype == made.height_m.dtype == np.float32
    assert made.colour.shape == (272, 192, 3)
    assert made.height_m.shape == (272, 192)
    assert made.colour.min() >= 0
    assert made.colour.max() <= 1
    np.testing.assert_allclose(made.colour.mean(axis=(0, 1), dtype=np.float64), REFLECTANCE, rtol=1e-6)
    assert made.height_m.min() == 0
    np.testing.assert_allclose(made.height_m.max(), 0.007, rtol=1e-6)
    assert made.colour.std(axis=(0, 1)).min() > 0.01


@pytest.mark.parametrize("pattern", PATTERNS)
def test_tiles_join_without_a_seam(pattern):
    """Neighbours across the seam differ no more than the most different neighbouring rows (columns) inside."""
    made = texture(pattern, lichen=0.1)
    for field in (made.colour.mean(axis=2), made.height_m):
        for axis in (0, 1):
            step = np.abs(field - np.roll(field, 1, axis)).mean(axis=1 - axis)  # step[0] is the seam
            assert step[0] <= step[1:].max()


def test_a_material_has_one_texture_of_its_own():
    first, again, other = texture("furrowed"), texture("furrowed"), texture("furrowed", "tree/twig")
    assert np.array_equal(first.colour, again.colour)
    assert np.array_equal(first.height_m, again.height_m)
    assert not np.allclose(first.colour, other.colour, atol=0.05)
    bark = Bark(pattern="plated")
    assert bark_texture(bark, REFLECTANCE, "a") is bark_texture(bark, REFLECTANCE, "a")


@pytest.mark.parametrize("mean", [(0.0, 0.5, 1.0), (0.97, 0.99, 0.9), (1e-4, 1e-3, 1e-2)])
def test_any_mean_is_met_within_the_range(mean):
    colour = np.random.default_rng(0).random((64, 64, 3), dtype=np.float32) ** 3
    made = with_mean(colour, mean)
    np.testing.assert_allclose(made.mean(axis=(0, 1), dtype=np.float64), mean, rtol=1e-6)
    assert made.min() >= 0
    assert made.max() <= 1


@pytest.mark.parametrize("mean", [(0.2, 0.2, 0.2), (0.0, 0.0, 0.0)])
def test_black_colours_still_have_the_mean(mean):
    assert np.allclose(with_mean(np.zeros((8, 8, 3), np.float32), mean), mean)


def test_extreme_parameters_give_textures():
    for pattern in PATTERNS:
        for keys in (
            {"tile_m": (0.01, 0.01)},
            {"tile_m": (10.0, 0.05)},
            {"scale_m": 0.0005, "marks": 0.5, "lichen": 0.9},
            {"marks": 0.0, "depth_m": 0.0},
            {"tile_m": (0.1, 0.2), "scale_m": 0.05},
        ):
            made = texture(pattern, **keys)
            assert np.isfinite(made.colour).all()
            np.testing.assert_allclose(made.colour.mean(axis=(0, 1), dtype=np.float64), REFLECTANCE, rtol=1e-6)
            assert np.isfinite(made.normals()).all()


def test_cells_against_brute_force():
    """Cell, offset and distance to the edge of every texel, from all points of 5 x 5 tiles."""
    tile, scale = Tile(40, 48, (0.3, 0.5)), (0.06, 0.1)
    found = tile.cells(np.random.default_rng(5), scale)
    points = 0.5 + 0.85 * (np.random.default_rng(5).random((5, 5, 2)) - 0.5)
    place = points + np.stack(np.meshgrid(np.arange(5), np.arange(5)), axis=-1)
    u, v = ((x / s).astype(np.float64) for x, s in zip(tile.places_m(), scale, strict=True))
    shift = np.stack(np.meshgrid(*[5 * np.arange(-2, 3)] * 2), axis=-1).reshape(-1, 1, 2)
    everywhere = (place.reshape(1, -1, 2) + shift).reshape(-1, 2)
    texels = np.stack(np.broadcast_arrays(u, v), axis=-1).reshape(-1, 2)
    offset = texels[:, None] - everywhere
    nearest = np.argmin((offset**2).sum(axis=2), axis=1)
    assert np.array_equal(found.index.ravel(), nearest % 25)
    own = offset[np.arange(len(texels)), nearest]
    np.testing.assert_allclose(found.offset_u.ravel(), own[:, 0], atol=1e-5)
    np.testing.assert_allclose(found.offset_v.ravel(), own[:, 1], atol=1e-5)
    between = everywhere - everywhere[nearest][:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        side = ((0.5 * between - own[:, None]) * between).sum(axis=2) / np.linalg.norm(between / scale, axis=2)
    side[np.arange(len(texels)), nearest] = np.inf
    np.testing.assert_allclose(found.border_m.ravel(), side.min(axis=1), atol=1e-6)


def test_noise_is_periodic_and_as_coarse_as_asked():
    tile = Tile(256, 256, (1.0, 1.0))
    noise = tile.noise(np.random.default_rng(0), (0.25, 0.02))
    assert abs(float(noise.mean())) < 1e-4
    assert abs(float(noise.std()) - 1) < 1e-4
    across, along = (np.abs(noise - np.roll(noise, 1, axis)).mean() for axis in (1, 0))
    assert along > 4 * across


def test_a_share_is_met():
    field = np.random.default_rng(0).standard_normal((200, 200), dtype=np.float32)
    for share in (0.0, 0.03, 0.4, 1.0):
        assert abs(float(upper_share(field, share, 0.01).mean()) - share) < 0.01


def test_lichen_covers_its_share():
    bare, grown = texture("smooth", marks=0.0), texture("smooth", marks=0.0, lichen=0.2, lichen_colour=(0.0, 0.9, 0.0))
    green = grown.colour[..., 1] / grown.colour[..., 0]
    assert abs(float((green > 2 * np.median(bare.colour[..., 1] / bare.colour[..., 0])).mean()) - 0.2) < 0.04


def test_normals_are_the_slopes():
    u = (np.arange(128) + 0.5) / 128
    v = (np.arange(64) + 0.5)[:, None] / 64
    height = 0.001 * np.sin(2 * np.pi * u) + 0.002 * np.cos(2 * np.pi * v)
    made = SurfaceTexture(np.ones((64, 128, 3), np.float32), height.astype(np.float32), (0.4, 0.8)).normals()
    slope_u = 0.001 * 2 * np.pi / 0.4 * np.cos(2 * np.pi * u) + 0 * v
    slope_v = -0.002 * 2 * np.pi / 0.8 * np.sin(2 * np.pi * v) + 0 * u
    expected = np.stack([-slope_u, -slope_v, np.ones_like(slope_u)], axis=-1)
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    np.testing.assert_allclose(made, expected, atol=1e-4)


def test_slopes_stay_below_fifty_degrees():
    made = texture("furrowed", depth_m=0.1)
    assert np.degrees(np.arccos(made.normals()[..., 2].min())) < 50.5


def test_year_rings_run_round_the_middle():
    """East of the middle the colour changes more along u than along v; north of it, the other way round."""
    colour = texture("end_grain", tile_m=(0.4, 0.4), scale_m=0.012, marks=0.0).colour[..., 0]
    along_v, along_u = np.gradient(colour)
    count = len(colour)
    beside, far = slice(int(0.45 * count), int(0.55 * count)), slice(int(0.70 * count), int(0.95 * count))
    assert np.abs(along_u[beside, far]).mean() > 1.4 * np.abs(along_v[beside, far]).mean()
    assert np.abs(along_v[far, beside]).mean() > 1.4 * np.abs(along_u[far, beside]).mean()


def test_images_hold_the_texture():
    made = texture("papery")
    colour, normal = texture_images(made)
    assert colour.dtype == normal.dtype == np.uint8
    assert colour.shape == normal.shape == made.colour.shape
    encoded = colour / 255
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(linear, made.colour, atol=0.006)
    np.testing.assert_allclose(2 * (normal / 255) - 1, made.normals(), atol=0.005)


def test_meshes_count_in_the_tiles_of_their_materials():
    plant = PlantParameters.model_validate(
        {"generator": "any", "wood": {"material": "bark", "branch_material": "twig", "branch_tile_m": (0.3, 0.2)}}
    )
    materials = {
        "bark": SimpleNamespace(bark=Bark(pattern="scaly", tile_m=(0.4, 0.6))),
        "twig": SimpleNamespace(bark=None),
    }
    wood = with_bark_tiles(plant, materials).wood
    assert wood.bark_tile_m == (0.4, 0.6)
    assert wood.branch_tile_m == (0.3, 0.2)
    alone = plant.model_copy(update={"wood": plant.wood.model_copy(update={"branch_material": None})})
    assert with_bark_tiles(alone, materials).wood.branch_tile_m == (0.4, 0.6)
    assert with_bark_tiles(plant, {}) is plant


def test_plates_of_pine_are_long_and_uneven_and_none_is_a_small_loop():
    """Scots pine's are about 5 to 25 cm high and 3 to 9 cm wide (by eye, in photographs); sizes weighed by area."""
    made = PATTERNS["plated"].make(Tile(496, 480, (0.72, 0.75)), np.random.default_rng(1), 0.05, 0.5)
    texel_m = 0.0015
    is_plate = np.tile(made.height > 0.4, (2, 2))  # across the seams; midway from shallow furrows to plates
    labels, _ = ndimage.label(is_plate)
    plates = ndimage.find_objects(labels)
    area = np.bincount(labels.ravel())[1:]
    whole = [
        k
        for k, place in enumerate(plates)
        if all(one.start > 0 and one.stop < size for one, size in zip(place, is_plate.shape, strict=True))
    ]
    sizes_m = texel_m * np.array([[one.stop - one.start for one in plates[k]] for k in whole])
    area = area[whole] * texel_m**2
    for sizes, low_m, high_m in zip(sizes_m.T, (0.05, 0.03), (0.25, 0.08), strict=True):
        order = np.argsort(sizes)
        share = np.cumsum(area[order]) / area.sum()
        tenth, ninth = sizes[order][np.searchsorted(share, [0.1, 0.9])]
        assert low_m < tenth
        assert ninth < high_m
        assert ninth > 1.5 * tenth  # uneven
    assert area[area < 0.015**2].sum() < 0.015 * area.sum()
    assert 0.15 < 1.0 - is_plate.mean() < 0.35  # furrows


@pytest.mark.slow
@pytest.mark.parametrize("pattern", PATTERNS)
def test_the_largest_texture_takes_a_fraction_of_a_second(pattern):
    texture(pattern)  # kernels are compiled
    seconds = []
    for _ in range(5):
        start = time.process_time()
        texture(pattern, tile_m=(1.0, 1.0))
        seconds.append(time.process_time() - start)
    assert min(seconds) < 0.4  # processor time; 0.05 to 0.13 measured
