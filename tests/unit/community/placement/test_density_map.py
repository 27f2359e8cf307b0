"""A recipe's maps: what they hold, and what they are on any grid of cells."""

from __future__ import annotations

import copy
import hashlib
import pickle

import numpy as np
import OpenEXR
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from pydantic import BaseModel, TypeAdapter, ValidationError

from forestgen.community.placement import density_map
from forestgen.community.placement.densities import PlacementParameters, species_density
from forestgen.community.placement.density_map import DensityMap, check_maps, maps_in
from forestgen.community.population import Site
from forestgen.core.cache import BoundedCache
from forestgen.core.errors import RecipeError

read = TypeAdapter(DensityMap).validate_python
sides = st.integers(1, 23)
switches = st.booleans()


def random_rows(seed, rows, cols):
    """Values from 0 to 1, a third of them 0; at least one is not."""
    rng = np.random.default_rng(seed)
    values = rng.random((rows, cols)) * (rng.random((rows, cols)) > 0.3)
    values[rng.integers(rows), rng.integers(cols)] = 1.0
    return values


def fine_means(values, shape, parts):
    """Means of constant pixels in the cells, by cutting both into the same small squares: exact where all divides."""
    rows, cols = values.shape
    small = np.repeat(np.repeat(values, parts * shape[0], axis=0), parts * shape[1], axis=1)
    return small.reshape(shape[0], parts * rows, shape[1], parts * cols).mean(axis=(1, 3))


@given(st.integers(0, 99), sides, sides, sides, sides, switches)
@settings(max_examples=80, deadline=None)
def test_the_integral_is_the_maps_on_every_grid(seed, rows, cols, height, width, smooth):
    values = random_rows(seed, rows, cols)
    one = read({"rows": values.tolist(), "smooth": smooth})
    grid = one.on_grid((height, width))
    assert grid.shape == (height, width)
    assert grid.mean() == pytest.approx(values.mean(), rel=1e-12)
    assert grid.min() >= 0
    assert grid.max() <= values.max() + 1e-12


@given(st.integers(0, 99), st.integers(1, 7), st.integers(1, 7), st.integers(1, 7), st.integers(1, 7))
@settings(max_examples=40, deadline=None)
def test_plain_pixels_are_averaged_by_area(seed, rows, cols, height, width):
    values = random_rows(seed, rows, cols)
    one = read({"rows": values.tolist(), "smooth": False})
    expected = fine_means(values[::-1], (height, width), 1)
    assert one.on_grid((height, width)) == pytest.approx(expected, abs=1e-12)
    assert np.array_equal(one.any_above_zero((height, width)), expected > 0)


@given(st.integers(0, 99), sides, sides, sides, sides)
@settings(max_examples=60, deadline=None)
def test_a_mask_bars_every_cell_that_a_barred_pixel_touches(seed, rows, cols, height, width):
    """By the overlap of whole numbers: no rounding may let a plant onto barred ground, or bar a neighbour's cell."""
    values = random_rows(seed, rows, cols)
    y, x = (
        np.array([[a * n < (b + 1) * m and b * m < (a + 1) * n for b in range(n)] for a in range(m)], dtype=int)
        for n, m in ((rows, height), (cols, width))
    )
    expected = y @ (values[::-1] > 0) @ x.T > 0
    for smooth in (True, False):
        one = read({"rows": values.tolist(), "smooth": smooth, "scale": 1e-3})
        assert np.array_equal(one.any_above_zero((height, width)), expected)


def test_smooth_values_are_means_of_a_straight_line_between_middles():
    one = read([[2.0, 6.0, 4.0]])
    x = (np.arange(7 * 1000) + 0.5) / 7000 * 3
    line = np.interp(x, [0.5, 1.5, 2.5], [2.0, 6.0, 4.0])
    assert one.on_grid((1, 7))[0] == pytest.approx(line.reshape(7, 1000).mean(axis=1), abs=1e-5)
    plane = read([[0.0, 1.0], [2.0, 3.0]]).on_grid((64, 64))
    assert np.diff(plane, axis=0).max() <= 0  # north, where the first row lies, is less
    assert np.diff(plane, axis=1).min() >= 0
    assert plane[32, 32] == pytest.approx(1.5, abs=0.1)


def test_on_its_own_grid_a_map_is_itself():
    values = random_rows(3, 8, 5)
    for smooth in (True, False):
        one = read({"rows": values.tolist(), "smooth": smooth})
        assert np.array_equal(one.on_grid((8, 5)), values[::-1])
        assert np.array_equal(one.values(), values[::-1])


def test_many_rows_are_averaged_as_few_are():
    """Pictures are read a block of rows at a time."""
    values = random_rows(4, 1000, 6)
    whole = read({"rows": values.tolist()}).on_grid((25, 3))
    assert whole == pytest.approx(values[::-1].reshape(25, 40, 3, 2).mean(axis=(1, 3)), abs=1e-12)


def test_scale_and_invert():
    values = random_rows(5, 4, 4)
    rows = values.tolist()
    assert read({"rows": rows, "scale": 250}).values() == pytest.approx(250 * values[::-1])
    assert read({"rows": rows, "scale": 250, "invert": True}).values() == pytest.approx(250 * (1 - values[::-1]))
    assert read({"rows": [[1, 1]], "invert": True}).is_zero
    assert read({"rows": [[0, 0]]}).is_zero
    assert not read({"rows": [[0, 0]], "invert": True}).is_zero


@pytest.fixture
def picture(tmp_path):
    """A grey picture of 6 x 4 pixels: its path and its values, row 0 at the top."""
    stored = np.random.default_rng(1).integers(1, 256, (4, 6), dtype=np.uint8)
    Image.fromarray(stored).save(tmp_path / "meadow.png")
    return tmp_path / "meadow.png", stored / 255


def test_a_picture_lies_in_the_recipes_folder_and_its_first_row_in_the_north(picture):
    path, values = picture
    one = TypeAdapter(DensityMap).validate_python("meadow.png", context={"folder": path.parent})
    assert one.values() == pytest.approx(values[::-1])
    assert one.shape == (4, 6)
    assert read(str(path)).on_grid((2, 3)) == pytest.approx(fine_means(values[::-1], (2, 3), 1))


def test_floating_point_pictures_and_arrays_hold_plants_per_hectare(tmp_path):
    wanted = np.array([[0, 300.0], [1200, 40]], np.float32)
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, {"Y": wanted}).write(
        str(tmp_path / "a.exr")
    )
    Image.fromarray(wanted).save(tmp_path / "a.tif")
    np.save(tmp_path / "a.npy", wanted.astype(int))
    for name in ("a.exr", "a.tif", "a.npy"):
        assert np.array_equal(read(str(tmp_path / name)).values(), wanted[::-1])


def test_a_picture_is_read_once_for_all_its_maps(picture, monkeypatch):
    path, _ = picture
    reads, resamples = [], []
    read_raster, resample = density_map.read_raster, density_map.resample
    monkeypatch.setattr(density_map, "read_raster", lambda one: reads.append(one) or read_raster(one))
    monkeypatch.setattr(density_map, "resample", lambda *a, **k: resamples.append(a) or resample(*a, **k))
    written = {"file": str(path), "sha256": hashlib.sha256(path.read_bytes()).hexdigest(), "scale": 1.5}
    for name in ("_pictures", "_grids"):
        monkeypatch.setattr(density_map, name, BoundedCache(10_000, lambda one: 1))
    first, second = read(written), read(written)
    assert first == second
    assert len(reads) == 1
    grid = first.on_grid((9, 9))
    grid[:] = 7  # the caller's own
    assert second.on_grid((9, 9)).max() < 7
    assert len(resamples) == 1
    assert read({**written, "scale": 2}).on_grid((9, 9)) == pytest.approx(second.on_grid((9, 9)) * 2 / 1.5)


def test_a_map_goes_from_one_models_parameters_to_anothers(picture, monkeypatch):
    """Its folder is known only where the recipe is read, and it may have left the cache meanwhile."""
    path, values = picture
    one = TypeAdapter(DensityMap).validate_python(path.name, context={"folder": path.parent})
    monkeypatch.setattr(density_map, "_pictures", BoundedCache(0, lambda one: 1))
    for other in (Holder(keep_out=one).keep_out, copy.deepcopy(one), pickle.loads(pickle.dumps(one))):
        assert other == one
        assert other.values() == pytest.approx(values[::-1])


def test_a_file_of_other_content_is_refused(picture):
    path, _ = picture
    with pytest.raises(ValidationError, match="not the file that the recipe was made with"):
        read({"file": str(path), "sha256": hashlib.sha256(b"other").hexdigest()})


def test_what_is_dumped_does_not_tell_where_the_file_lies(picture):
    """A history's origin is that of all copies of its recipe."""
    path, _ = picture
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    dumped = read({"file": str(path), "sha256": sha256}).model_dump(mode="json")
    assert dumped["sha256"] == sha256
    assert "file" not in dumped


@pytest.mark.parametrize(("bad", "told"), [
    ([], "has no values"),
    ([[]], "has no values"),
    ([[1, 2], [1]], "rows differ in length"),
    ({}, "neither file nor rows"),
    ({"file": "a.png", "rows": [[1]]}, "both file and rows"),
    (7, "bad value"),
    ("none.png", "no such file"),
    ({"rows": [[2]], "invert": True}, "only values from 0 to 1"),
    ({"rows": [[1e12]], "scale": 2}, "too large"),
    ([[-1]], "greater than or equal to 0"),
    ([[float("nan")]], "finite"),
    ({"rows": [[1]], "scale": 0}, "greater than 0"),
])  # fmt: skip
def test_bad_maps(bad, told, tmp_path):
    with pytest.raises(ValidationError, match=told):
        TypeAdapter(DensityMap).validate_python(bad, context={"folder": tmp_path})


@pytest.mark.parametrize(("value", "told"), [(np.nan, "nan in row 3, column 2"), (np.inf, "inf"), (-2.0, "-2 in row")])
def test_bad_values_are_named_by_row_and_column(tmp_path, value, told):
    values = np.ones((4, 4), np.float32)
    values[2, 1] = value
    np.save(tmp_path / "a.npy", values)
    with pytest.raises(ValidationError) as caught:
        read(str(tmp_path / "a.npy"))
    assert told in caught.value.errors()[0]["ctx"]["got"]


class Holder(BaseModel):
    plants: dict[str, DensityMap] = {}
    several: tuple[DensityMap, ...] = ()
    keep_out: DensityMap | None = None


def problem(parameters, size_m):
    """What is said about the maps of a site, with its place; None if all is well."""
    try:
        check_maps(parameters, size_m, lambda *keys: ".".join(map(str, keys)))
    except RecipeError as error:
        return str(error)
    return None


def test_every_map_of_a_models_parameters_is_found():
    holder = Holder(plants={"a": [[1]], "b": [[2]]}, several=([[3]], [[4]]), keep_out=[[5]])
    found = {keys: one.rows for keys, one in maps_in(holder)}
    assert found == {
        ("plants", "a"): ((1,),), ("plants", "b"): ((2,),), ("several", 0): ((3,),), ("several", 1): ((4,),),
        ("keep_out",): ((5,),),
    }  # fmt: skip


@pytest.mark.parametrize(("size_m", "pixels", "good"), [
    ((120, 80), (768, 512), True), ((120, 80), (512, 512), False), ((120, 80), (512, 341), True),
    ((120, 80), (512, 342), True), ((120, 80), (512, 343), False), ((120, 80), (3, 2), True),
    ((100, 100), (1, 1), True), ((100, 33), (3, 1), True), ((100, 33), (1, 3), False), ((80, 120), (768, 512), False),
])  # fmt: skip
def test_pixels_must_be_square_on_the_site(tmp_path, size_m, pixels, good):
    np.save(tmp_path / "a.npy", np.ones(pixels[::-1], np.uint8))
    for written, fine in (
        ({"file": str(tmp_path / "a.npy")}, good),
        ({"file": str(tmp_path / "a.npy"), "fit": "stretch"}, True),
    ):
        assert (problem(Holder(plants={"a": written}), size_m) is None) == fine


def test_the_message_gives_a_shape_that_fits(tmp_path):
    np.save(tmp_path / "a.npy", np.ones((512, 512), np.uint8))
    told = problem(Holder(plants={"a": str(tmp_path / "a.npy")}), (120, 80))
    assert "3:2 such as 768 x 512 pixels, for a site of 120 x 80 m" in told
    assert "512 x 512 pixels" in told
    assert "fit: stretch" in told
    assert told.startswith("plants.a: ")
    odd = problem(Holder(plants={"a": str(tmp_path / "a.npy")}), (100.0, 314.15926))
    assert "512 x 1608 pixels, for a site" in odd
    assert ":1" not in odd


def test_rows_are_stretched_unless_they_are_told_not_to_be():
    assert problem(Holder(plants={"a": [[1, 2]]}), (50, 50)) is None
    assert "shape" in problem(Holder(plants={"a": {"rows": [[1, 2]], "fit": "exact"}}), (50, 50))


def test_a_density_of_nothing_is_a_mistake_and_a_mask_of_nothing_is_not():
    assert "0 everywhere" in problem(Holder(plants={"a": [[0, 0]]}), (50, 50))
    assert "invert: false" in problem(Holder(plants={"a": {"rows": [[1, 1]], "invert": True}}), (50, 50))
    assert problem(Holder(keep_out=[[0, 0]]), (50, 50)) is None


def test_no_plant_stands_on_a_cell_that_a_mask_touches():
    """A path of one pixel, on cells that it only grazes."""
    mask = np.zeros((10, 10))
    mask[:, 3] = 0.01
    parameters = PlacementParameters(plants={"a": {"count": 1}}, keep_out=mask.tolist())
    density = species_density(parameters, Site((40.0, 40.0)), "a", (4, 4))
    assert density.tolist() == [[1, 0, 1, 1]] * 4
