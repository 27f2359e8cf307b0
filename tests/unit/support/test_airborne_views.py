"""Views and tiles that airborne pictures are compared of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from forestgen.recipe.exposure import Jpeg
from support.airborne import LUMINANCE, Picture, encoded, sunlit
from support.airborne_views import PLACES, as_bright, as_coloured, tile_of


def test_without_tiles_it_is_said_how_to_get_them(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"deepforest==2\.1\.0"):
        tile_of(PLACES[0], tmp_path)


def test_the_road_of_a_tile_does_not_count(tmp_path: Path) -> None:
    place = next(place for place in PLACES if place.has_road)
    Image.fromarray(np.full((1035, 1249, 3), 128, dtype=np.uint8)).save(tmp_path / f"{place.tile}.png")
    tile = tile_of(place, tmp_path)
    assert tile.crowns is None
    assert not tile.counts[519, 370]  # amid the road
    assert tile.counts[519, [300, 440]].all()
    assert 0.04 < 1 - tile.counts.mean() < 0.09


def test_a_view_is_exposed_like_the_tile_and_clipped() -> None:
    rng = np.random.default_rng(4)
    light = np.exp(rng.normal(-2, 0.8, (100, 100, 1))) * np.ones(3)
    light[:40] *= 0.05
    tile, view = Picture(np.minimum(light, 1.0)), Picture(0.01 * light)
    found = as_bright(view, tile, Jpeg())
    medians = [np.median((one.rgb @ LUMINANCE)[sunlit(one)]) for one in (tile, found)]
    assert medians[1] == pytest.approx(medians[0], rel=0.05)
    assert found.rgb.max() <= 1.0
    assert len(np.unique(encoded(found.rgb))) <= 256


def test_a_view_takes_the_colours_of_the_tile() -> None:
    rng = np.random.default_rng(5)
    mixed = np.array([[1.0, 0.5, 0.2], [0.2, 1.0, 0.4], [0.1, 0.2, 1.0]])
    tile, view = (
        Picture(np.clip(0.3 + 0.03 * rng.standard_normal((80, 80, 3)) @ one, 0, 1)) for one in (mixed, mixed.T)
    )
    values = [encoded(one.rgb).reshape(-1, 3).astype(float) for one in (tile, as_coloured(view, tile))]
    assert values[1].mean(axis=0) == pytest.approx(values[0].mean(axis=0), abs=0.5)
    assert np.cov(values[1].T) == pytest.approx(np.cov(values[0].T), rel=0.05)
