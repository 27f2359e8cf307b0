"""Weather and clouds as files: exact round trips, what other programs read, and files that are refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forestgen.atmosphere import grid as grid_module
from forestgen.atmosphere.grid import AirGrid, CloudGrid, PhaseFunction, Weather
from forestgen.atmosphere.weather_files import (
    read_droplet_radius_um,
    read_sky,
    write_clouds,
    write_weather,
)
from forestgen.core.errors import AssetError, OutputError, ResourceError
from forestgen.render.variant import SCALAR, using
from support.error_messages import raises_error


def snapshot(*, solid: bool = True, periodic: bool = False) -> Weather:
    rng = np.random.default_rng(7)
    grid = AirGrid((6, 5, 4), (20.0, 20.1, 31.7), (-3.0, 2.0, 0.1), periodic)
    z, y, x = grid.shape

    def some(*shape: int, scale: float = 1.0) -> np.ndarray:
        return (scale * rng.random(shape)).astype(np.float32)

    return Weather(
        grid=grid,
        time_s=1.0 / 3.0,
        east_m_per_s=some(z, y, x + 1, scale=-20.0),
        north_m_per_s=some(z, y + 1, x, scale=20.0),
        up_m_per_s=some(z + 1, y, x),
        potential_temperature_k=some(z, y, x) + np.float32(290.0),
        vapour=some(z, y, x, scale=0.01),
        cloud=some(z, y, x, scale=1e-3),
        rain=some(z, y, x, scale=1e-30),
        fallen_kg_per_m2=rng.random((y, x)),
        density_kg_per_m3=1.0 + rng.random(z),
        temperature_ratio=1.0 - 0.3 * rng.random(z),
        solid=rng.random((z, y, x)) > 0.7 if solid else None,
    )


def clouds() -> CloudGrid:
    field = np.random.default_rng(8).random((4, 5, 6)).astype(np.float32)
    return CloudGrid(field, (0.1, 1.0, 2.0), (30.0, 41.0, 55.5), 0.99, PhaseFunction(0.8, -0.3, 0.9))


def same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray):
        return bool(one.dtype == other.dtype and one.tobytes() == other.tobytes() and one.shape == other.shape)
    return bool(one == other)


@pytest.mark.parametrize("solid", [True, False])
@pytest.mark.parametrize("periodic", [True, False])
def test_a_snapshot_comes_back_to_the_last_bit(tmp_path: Path, solid: bool, periodic: bool) -> None:
    weather = snapshot(solid=solid, periodic=periodic)
    write_weather(tmp_path / "air.nc", weather)
    back = read_sky(tmp_path / "air.nc")
    for field in fields(Weather):
        assert same(getattr(weather, field.name), getattr(back, field.name)), field.name
    assert back.vapour.flags.writeable
    assert back.vapour.flags.c_contiguous


def test_the_droplets_radius_is_kept_beside_the_snapshot(tmp_path: Path) -> None:
    write_weather(tmp_path / "air.nc", snapshot())
    assert read_droplet_radius_um(tmp_path / "air.nc") is None
    write_weather(tmp_path / "air.nc", snapshot(), droplet_radius_um=1e2 / 3.0)
    assert read_droplet_radius_um(tmp_path / "air.nc") == 1e2 / 3.0
    write_weather(tmp_path / "air.nc", snapshot(), droplet_radius_um=-1.0)
    with raises_error(AssetError, place="air.nc"):
        read_droplet_radius_um(tmp_path / "air.nc")


def test_the_same_snapshot_makes_the_same_bytes_and_leaves_nothing_else(tmp_path: Path) -> None:
    for name in ("a.nc", "b.nc"):
        write_weather(tmp_path / name, snapshot())
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.nc", "b.nc"]


def test_an_extinction_field_comes_back_whole_from_netcdf(tmp_path: Path) -> None:
    grid = clouds()
    write_clouds(tmp_path / "sky.nc", grid)
    back = read_sky(tmp_path / "sky.nc")
    assert same(back.extinction_per_m, grid.extinction_per_m)
    assert replace(back, extinction_per_m=grid.extinction_per_m) == grid


@given(
    cells=st.tuples(*[st.integers(1, 5)] * 3),
    low=st.tuples(*[st.floats(-1e4, 1e4, width=32)] * 3),
    size=st.tuples(*[st.floats(1.0, 1e4, width=32)] * 3),
    seed=st.integers(0, 99),
)
@settings(max_examples=30)
def test_any_field_comes_back_from_a_volume(
    tmp_path_factory: pytest.TempPathFactory,
    cells: tuple[int, int, int],
    low: tuple[float, float, float],
    size: tuple[float, float, float],
    seed: int,
) -> None:
    path = tmp_path_factory.mktemp("volumes") / "sky.vol"
    high = tuple(float(np.float32(a + b)) for a, b in zip(low, size, strict=True))
    grid = CloudGrid(np.random.default_rng(seed).random(cells).astype(np.float32), low, (high[0], high[1], high[2]))
    write_clouds(path, grid)
    back = read_sky(path)
    assert same(back.extinction_per_m, grid.extinction_per_m)
    assert (back.low_m, back.high_m) == (grid.low_m, grid.high_m)
    assert (back.albedo, back.phase) == (CloudGrid.albedo, CloudGrid.phase)


def test_mitsuba_reads_our_volumes_and_we_read_its_own(tmp_path: Path) -> None:
    grid = clouds()
    write_clouds(tmp_path / "ours.vol", grid)
    with using(SCALAR) as mi:
        theirs = mi.VolumeGrid(str(tmp_path / "ours.vol"))
    np.testing.assert_array_equal(np.array(theirs).reshape(4, 5, 6), grid.extinction_per_m)
    assert list(theirs.size()) == [6, 5, 4]
    assert theirs.channel_count() == 1
    assert theirs.max() == grid.extinction_per_m.max()
    theirs.write(str(tmp_path / "theirs.vol"))
    # The header has no more than this; Mitsuba writes its own corners.
    assert (tmp_path / "theirs.vol").stat().st_size == 48 + 4 * 120
    back = read_sky(tmp_path / "theirs.vol")
    assert same(back.extinction_per_m, grid.extinction_per_m)


def test_mitsuba_finds_the_box_of_our_volumes(tmp_path: Path) -> None:
    write_clouds(tmp_path / "sky.vol", clouds())
    with using(SCALAR) as mi:
        volume = mi.load_dict({"type": "gridvolume", "filename": str(tmp_path / "sky.vol"), "use_grid_bbox": True})
        box = volume.bbox()
    np.testing.assert_allclose(np.array(box.min), [0.1, 1.0, 2.0], rtol=1e-6)
    np.testing.assert_allclose(np.array(box.max), [30.0, 41.0, 55.5], rtol=1e-6)


def test_other_programs_find_cf_names_units_and_places(tmp_path: Path) -> None:
    write_weather(tmp_path / "air.nc", snapshot())
    with h5netcdf.File(tmp_path / "air.nc") as file:
        assert file.attrs["Conventions"].startswith("CF-1.")
        theta, wind = file.variables["potential_temperature_k"], file.variables["east_m_per_s"]
        assert theta.dimensions == ("z", "y", "x")
        assert (theta.attrs["standard_name"], theta.attrs["units"]) == ("air_potential_temperature", "K")
        assert wind.dimensions == ("z", "y", "x_face")
        assert (wind.attrs["standard_name"], wind.attrs["units"]) == ("eastward_wind", "m s-1")
        np.testing.assert_allclose(file.variables["z"][...], 0.1 + 31.7 * (np.arange(4) + 0.5))
        np.testing.assert_allclose(file.variables["x_face"][...], -3.0 + 20.0 * np.arange(7))
        assert (file.variables["z"].attrs["positive"], file.variables["z"].attrs["axis"]) == ("up", "Z")
        for name, variable in file.variables.items():
            assert "units" in variable.attrs, name
            assert "standard_name" in variable.attrs or "long_name" in variable.attrs, name


def test_empty_sky_is_compressed(tmp_path: Path) -> None:
    field = np.zeros((32, 64, 64), np.float32)
    write_clouds(tmp_path / "sky.nc", CloudGrid(field, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)))
    assert (tmp_path / "sky.nc").stat().st_size < 0.1 * field.nbytes


def broken(path: Path) -> str:
    with pytest.raises(AssetError) as caught:
        read_sky(path)
    said = str(caught.value)
    assert said.startswith(f"{path}: the file cannot be used as weather: ")
    return said


def test_what_is_no_file_of_ours_is_refused(tmp_path: Path) -> None:
    assert "got       none" in broken(tmp_path / "none.nc")
    (tmp_path / "folder.nc").mkdir()
    assert "got       a folder" in broken(tmp_path / "folder.nc")
    said = broken(tmp_path / "sky.tif")
    assert "one that ends in .nc, .vol" in said
    assert "sky.tif" in said
    write_clouds(tmp_path / "sky.vdb", clouds())
    assert "one that ends in .nc, .vol\n  got       sky.vdb" in broken(tmp_path / "sky.vdb")
    (tmp_path / "old.nc").write_bytes(b"CDF\x01 and so on")
    assert "NetCDF of version 3" in broken(tmp_path / "old.nc")
    (tmp_path / "empty.nc").write_bytes(b"")
    assert "0 bytes" in broken(tmp_path / "empty.nc")
    (tmp_path / "text.nc").write_text("a letter")
    assert "begins with b'a letter'" in broken(tmp_path / "text.nc")
    with h5netcdf.File(tmp_path / "theirs.nc", "w") as file:
        file.dimensions["x"] = 3
    said = broken(tmp_path / "theirs.nc")
    assert "the attribute content" in said
    assert "'forestgen weather 1' or 'forestgen clouds 1'" in said


def test_damaged_files_are_refused_wherever_they_are_cut_or_changed(tmp_path: Path) -> None:
    """Not one byte can change unseen, and none can send HDF5 round in circles."""
    path = tmp_path / "air.nc"
    weather = snapshot()
    write_weather(path, weather)
    whole = path.read_bytes()
    for share in (0.05, 0.3, 0.6, 0.99):
        path.write_bytes(whole[: int(share * len(whole))])
        assert "damaged" in broken(path)
    rng = np.random.default_rng(4)
    for _ in range(40):
        changed = bytearray(whole)
        changed[int(rng.integers(8, len(whole) - 20))] ^= 1 << int(rng.integers(8))
        path.write_bytes(bytes(changed))
        assert "its checksum differs" in broken(path)


def _changed(path: Path, change: Callable[[Any], None]) -> str:
    """What is said of a snapshot after a change with h5py, which knows no rules of ours."""
    import h5py

    write_weather(path, snapshot())
    path.write_bytes(path.read_bytes()[:-20])  # without our seal, as another program would leave it
    with h5py.File(path, "r+") as file:
        change(file)
    return broken(path)


def _replaced(name: str, make: Callable[[np.ndarray], np.ndarray]) -> Callable[[Any], None]:
    def change(file: Any) -> None:
        values = file[name][...]
        del file[name]
        file.create_dataset(name, data=make(values))

    return change


def _put(name: str, value: float) -> Callable[[Any], None]:
    def change(file: Any) -> None:
        values = file[name][...]
        values.flat[7 % values.size] = value
        file[name][...] = values

    return change


def _grouped(file: Any) -> None:
    del file["rain"]
    file.create_group("rain")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda file: file.__delitem__("vapour"), ["the variable vapour", "it in the file", "none"]),
        (lambda file: file.__delitem__("time"), ["the variable time"]),
        (lambda file: file.attrs.__delitem__("low_m"), ["the attribute low_m"]),
        (lambda file: file.attrs.__delitem__("periodic"), ["the attribute periodic"]),
        (lambda file: file.attrs.__setitem__("periodic", "yes"), ["the attribute periodic", "one number", "yes"]),
        (lambda file: file.attrs.__setitem__("cell_m", [1.0, 2.0]), ["the attribute cell_m", "three numbers"]),
        (
            lambda file: file.attrs.__setitem__("cell_m", [1.0, -2.0, 3.0]),
            ["size of the cells", "three lengths above 0"],
        ),
        (lambda file: file.attrs.__setitem__("low_m", [1.0, np.nan, 3.0]), ["corner of the box"]),
        (_put("vapour", np.nan), ["vapour", "numbers everywhere", "nan at (0, 1, 1)"]),
        (_put("cloud", -0.01), ["cloud", "nothing below 0 kg/kg", "-0.01 kg/kg at (0, 1, 1)"]),
        (_put("rain", 3.0), ["rain", "at most 1 kg/kg", "3 kg/kg"]),
        (_put("up_m_per_s", np.inf), ["up_m_per_s", "inf at"]),
        (_put("up_m_per_s", -900.0), ["up_m_per_s", "nothing below -500 m/s", "-900 m/s"]),
        (_put("potential_temperature_k", 7.0), ["potential_temperature_k", "nothing below 50 K"]),
        (_put("density_kg_per_m3", 0.0), ["density_kg_per_m3", "0 kg/m3 at"]),
        (_put("temperature_ratio", np.nan), ["temperature_ratio", "nan"]),
        (_put("fallen_kg_per_m2", -1.0), ["fallen_kg_per_m2", "nothing below 0 kg/m2"]),
        (_replaced("cloud", lambda v: v.astype(np.float16)), ["cloud", "float32 numbers", "float16"]),
        (_replaced("rain", lambda v: v.astype(np.float64)), ["rain", "float32 numbers", "float64"]),
        (_replaced("cloud", lambda v: v[0]), ["cloud", "3 dimensions", "(5, 6)"]),
        (_replaced("cloud", lambda v: v.reshape(5, 4, 6)), ["cloud", "(4, 5, 6)", "(5, 4, 6)"]),
        (_grouped, ["the variable rain"]),
    ],
)
def test_a_bad_snapshot_is_refused(tmp_path: Path, change: Callable[[Any], None], words: list[str]) -> None:
    said = _changed(tmp_path / "air.nc", change)
    for word in words:
        assert word in said


def test_a_negative_time_is_refused(tmp_path: Path) -> None:
    with raises_error(OutputError, place="air.nc"):
        write_weather(tmp_path / "air.nc", replace(snapshot(), time_s=float("nan")))


def test_one_kind_of_file_is_not_taken_for_the_other(tmp_path: Path) -> None:
    write_weather(tmp_path / "air.nc", snapshot())
    write_clouds(tmp_path / "sky.nc", clouds())
    assert isinstance(read_sky(tmp_path / "air.nc"), Weather)
    assert isinstance(read_sky(tmp_path / "sky.nc"), CloudGrid)


def test_fields_larger_than_memory_are_refused_before_they_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_weather(tmp_path / "air.nc", snapshot())
    write_clouds(tmp_path / "sky.nc", clouds())
    write_clouds(tmp_path / "sky.vol", clouds())
    monkeypatch.setattr(grid_module, "free_bytes", lambda: 400)
    for name in ("air.nc", "sky.nc", "sky.vol"):
        with raises_error(ResourceError):
            read_sky(tmp_path / name)


@pytest.mark.parametrize(
    "grid",
    [
        replace(clouds(), extinction_per_m=clouds().extinction_per_m.astype(np.float16)),
        replace(clouds(), extinction_per_m=clouds().extinction_per_m.astype(float)),
        replace(clouds(), extinction_per_m=np.zeros((2, 2), np.float32)),
        replace(clouds(), extinction_per_m=np.zeros((2, 0, 2), np.float32)),
        replace(clouds(), extinction_per_m=np.full((2, 2, 2), np.nan, np.float32)),
        replace(clouds(), extinction_per_m=np.full((2, 2, 2), -1, np.float32)),
        replace(clouds(), high_m=(-1.0, 2.0, 3.0)),
        replace(clouds(), albedo=1.5),
        replace(clouds(), phase=PhaseFunction(1.0, 0.0, 0.5)),
        replace(clouds(), phase=PhaseFunction(0.5, 0.0, 1.5)),
    ],
)
@pytest.mark.parametrize("name", ["sky.nc", "sky.vol", "sky.vdb"])
def test_a_bad_field_is_not_written(tmp_path: Path, grid: CloudGrid, name: str) -> None:
    with raises_error(OutputError):
        write_clouds(tmp_path / name, grid)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "changes",
    [
        {"cloud": np.zeros((4, 5, 6), np.float16)},
        {"cloud": np.zeros((4, 5, 7), np.float32)},
        {"east_m_per_s": np.zeros((4, 5, 6), np.float32)},
        {"solid": np.zeros((4, 5, 6), np.int8)},
        {"vapour": np.full((4, 5, 6), np.nan, np.float32)},
        {"grid": AirGrid((0, 5, 4), (1.0, 1.0, 1.0))},
    ],
)
def test_a_bad_snapshot_is_not_written(tmp_path: Path, changes: dict[str, Any]) -> None:
    with raises_error(OutputError, place="air.nc"):
        write_weather(tmp_path / "air.nc", replace(snapshot(), **changes))
    assert not list(tmp_path.iterdir())


def test_rounding_below_zero_is_kept(tmp_path: Path) -> None:
    weather = snapshot()
    weather.cloud[1, 2, 3] = -1e-9
    write_weather(tmp_path / "air.nc", weather)
    assert read_sky(tmp_path / "air.nc").cloud[1, 2, 3] == np.float32(-1e-9)


def test_places_that_cannot_be_written_are_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with raises_error(OutputError, place="air.vol"):
        write_weather(tmp_path / "air.vol", snapshot())
    with raises_error(OutputError, place="sky.png"):
        write_clouds(tmp_path / "sky.png", clouds())
    for name in ("none/air.nc", "a\0b.nc"):
        with raises_error(OutputError):
            write_weather(tmp_path / name, snapshot())
    with raises_error(OutputError, place="sky.vol"):
        write_clouds(tmp_path / "none" / "sky.vol", clouds())


def test_a_write_that_fails_leaves_the_old_file_and_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "air.nc"
    write_weather(path, snapshot())
    before = path.read_bytes()

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("h5netcdf.File.create_variable", full)
    with raises_error(OutputError, place="air.nc"):
        write_weather(path, snapshot(solid=False))
    assert path.read_bytes() == before
    assert [one.name for one in tmp_path.iterdir()] == ["air.nc"]
