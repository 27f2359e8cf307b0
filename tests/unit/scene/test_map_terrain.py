"""Heights from files: metres or grey levels, and holes refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, TiffImagePlugin
from pydantic import ValidationError

from forestgen.core.errors import AssetError
from forestgen.recipe.schema import Terrain
from forestgen.scene.terrains.mapped import HeightMap, read_heights
from support.error_messages import raises_error

HEIGHTS = np.array([[3.5, 4, 5], [1, 2, 2.5]], dtype=np.float32)


def tiff(path: Path, values: np.ndarray, nodata: str | None = None) -> Path:
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    if nodata is not None:
        tags[42113] = nodata
    Image.fromarray(values).save(path, tiffinfo=tags)
    return path


def test_floating_point_is_metres(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", HEIGHTS.astype(np.float64))
    for path in (tmp_path / "a.npy", tiff(tmp_path / "a.tif", HEIGHTS, "-3.4028234663852886e+38")):
        np.testing.assert_array_equal(read_heights(path), HEIGHTS)
        with raises_error(AssetError):
            read_heights(path, 0, 10)


def test_whole_metres_of_a_tiff_and_of_an_array(tmp_path: Path) -> None:
    whole = np.array([[-3, 0], [700, 32000]], dtype=np.int16)
    np.save(tmp_path / "a.npy", whole[:, :1])
    np.testing.assert_array_equal(read_heights(tmp_path / "a.npy"), whole[:, :1])
    levels = np.array([[3, 1200], [700, 65]], dtype=np.uint16)
    np.testing.assert_array_equal(read_heights(tiff(tmp_path / "a.tif", levels)), levels)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_grey_goes_from_lowest_to_highest(tmp_path: Path, kind: type) -> None:
    levels = np.array([[0, np.iinfo(kind).max], [np.iinfo(kind).max // 5, 0]], dtype=kind)
    Image.fromarray(levels).save(tmp_path / "a.png")
    np.testing.assert_allclose(read_heights(tmp_path / "a.png", -10, 40), [[-10, 40], [0, -10]], atol=1e-9)
    for given in ((None, None), (1, None), (None, 5)):
        with raises_error(AssetError):
            read_heights(tmp_path / "a.png", *given)


@pytest.mark.parametrize("mark", [np.nan, np.inf, -9999, -32768])
def test_holes_are_refused_with_how_many_and_where(tmp_path: Path, mark: float) -> None:
    holed = np.tile(HEIGHTS, (2, 2))
    holed[2, 4] = holed[3, 1] = mark
    np.save(tmp_path / "a.npy", holed)
    for path in (tmp_path / "a.npy", tiff(tmp_path / "a.tif", holed)):
        with raises_error(AssetError):
            read_heights(path)


def test_a_geotiffs_own_mark_is_a_hole(tmp_path: Path) -> None:
    marked = HEIGHTS.copy()
    marked[1, 0] = -3.4028234663852886e38
    for text in ("-3.4028234663852886e+38", "-3.40282347e+38\0"):
        with raises_error(AssetError):
            read_heights(tiff(tmp_path / "a.tif", marked, text))
    with raises_error(AssetError):
        read_heights(tiff(tmp_path / "b.tif", np.array([[7, 8], [9, 0]], dtype=np.uint16), "0"))


def test_a_transparent_pixel_is_a_hole(tmp_path: Path) -> None:
    values = np.full((2, 3, 2), 255, dtype=np.uint8)
    values[0, 2, 1] = 0
    Image.fromarray(values, mode="LA").save(tmp_path / "a.png")
    with raises_error(AssetError):
        read_heights(tmp_path / "a.png", 0, 5)


def test_what_are_no_heights(tmp_path: Path) -> None:
    Image.fromarray(np.zeros((3, 3, 3), dtype=np.uint8)).save(tmp_path / "colour.png")
    with raises_error(AssetError):
        read_heights(tmp_path / "colour.png", 0, 5)
    np.save(tmp_path / "far.npy", HEIGHTS * 1e5)
    with raises_error(AssetError):
        read_heights(tmp_path / "far.npy")
    np.save(tmp_path / "thin.npy", HEIGHTS[:1])
    with raises_error(AssetError):
        HeightMap(file="thin.npy").heights(tmp_path, None, None)
    np.save(tmp_path / "a.npy", HEIGHTS)
    with raises_error(AssetError):
        HeightMap(file="a.npy", sha256="0" * 64).heights(tmp_path, None, None)


@pytest.mark.parametrize(
    "section",
    [
        {"kind": "map"},
        {"kind": "flat", "map": "a.npy"},
        {"map": "a.npy"},
        {"kind": "rolling", "lowest_m": 3},
        {"kind": "map", "map": "a.png", "lowest_m": 5, "highest_m": 5},
        {"kind": "map", "map": {}},
        {"kind": "map", "map": [[1, 2], [3]]},
        {"kind": "map", "map": [[1, 2], [3, 1e9]]},
        {"kind": "map", "map": {"file": "a", "rows": [[1]]}},
    ],
)
def test_sections_that_say_no_terrain(section: dict) -> None:
    with pytest.raises(ValidationError):
        Terrain.model_validate(section)


def test_terrain_without_a_map_is_dumped_as_ever() -> None:
    assert Terrain.model_validate({}).model_dump() == {
        "kind": "flat",
        "amplitude_m": 0.8,
        "wavelength_m": 70.0,
        "hills_m": 22.0,
    }


@pytest.mark.parametrize("rows", [[], [[]], [[1.0]], [[1.0, 2.0]]])
def test_too_few_rows_are_refused(rows):
    with raises_error(AssetError):
        HeightMap(rows=rows).heights(None, None, None)
