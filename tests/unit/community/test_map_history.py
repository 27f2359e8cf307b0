"""Maps of a history: written beside it, read back as they were, refused where they are another's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5netcdf
import h5py
import numpy as np
import pytest

from forestgen.community.history import open_history, write_history
from forestgen.community.history_tables import MAPS_NAME as NAME
from forestgen.community.population import Population
from forestgen.core.errors import AssetError, ResourceError
from support.error_messages import raises_error

SIZE_M = (40.0, 30.0)


def snapshot(step: int, *, maps: bool = True, shape: tuple[int, int] = (3, 5), seed: int = 0) -> Population:
    """A snapshot without plants, of random maps with numbers of every size."""
    rng = np.random.default_rng((seed, step))
    values = {
        "water_mm": rng.random(shape) ** -3,
        "warmth_c": rng.normal(size=shape),
        "leaves_g_per_m2": np.where(rng.random(shape) < 0.5, 0.0, 5e-324),
        "share": np.full(shape, 0.1) * 3,
    }
    nobody = np.zeros(0)
    return Population(
        time_yr=step / 12,
        species_names=("pine",),
        plant_id=np.zeros(0, np.uint32),
        species=np.zeros(0, np.uint16),
        position_m=np.zeros((0, 3)),
        radius_m=nobody,
        height_m=nobody,
        age_yr=nobody,
        status=np.zeros(0, np.uint8),
        step=step,
        maps=values if maps else {},
    )


SNAPSHOTS = [snapshot(step) for step in (3, 4, 5)]


def written(folder: Path, snapshots: list[Population] = SNAPSHOTS) -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / "history.parquet"
    write_history(path, snapshots, {"seed": 1}, size_m=SIZE_M)
    return path


def test_maps_come_back_to_the_bit(tmp_path: Path) -> None:
    history = open_history(written(tmp_path))
    assert list(history.maps) == list(SNAPSHOTS[0].maps)
    for before in SNAPSHOTS:
        found = history.whole(before.step).maps
        assert list(found) == list(before.maps)
        for name, values in before.maps.items():
            assert (found[name].dtype, found[name].shape) == (values.dtype, values.shape)
            assert found[name].tobytes() == values.tobytes()


def test_the_file_is_netcdf_that_tells_where_and_when(tmp_path: Path) -> None:
    """As xarray opens it: named dimensions with their coordinates, units, no fill where there are values."""
    written(tmp_path)
    with h5netcdf.File(tmp_path / NAME, "r") as file:
        assert {name: len(one) for name, one in file.dimensions.items()} == {"snapshot": 3, "y": 3, "x": 5}
        assert file.dimensions["snapshot"].isunlimited()
        assert file["x"][:].tolist() == [4.0, 12.0, 20.0, 28.0, 36.0]  # middles of cells, from the west
        assert file["y"][:].tolist() == [5.0, 15.0, 25.0]  # and from the south
        assert file["step"][:].tolist() == [3, 4, 5]
        assert file["time_yr"][:].tolist() == [3 / 12, 4 / 12, 5 / 12]
        units = {name: one.attrs["units"] for name, one in file.variables.items()}
        assert units == {
            "x": "m", "y": "m", "step": "1", "time_yr": "year",
            "water_mm": "mm", "warmth_c": "degree_Celsius", "leaves_g_per_m2": "g m-2", "share": "1",
        }  # fmt: skip
        for name in SNAPSHOTS[0].maps:
            assert file[name].dimensions == ("snapshot", "y", "x")
            assert file[name].dtype == np.float64
        assert file["water_mm"][1].tobytes() == SNAPSHOTS[1].maps["water_mm"].tobytes()


def test_the_same_snapshots_give_the_same_bytes(tmp_path: Path) -> None:
    written(tmp_path / "a")
    written(tmp_path / "b")
    for name in (NAME, "history.parquet"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_a_history_without_maps_has_no_such_file_and_takes_an_old_one_away(tmp_path: Path) -> None:
    written(tmp_path)
    assert (tmp_path / NAME).exists()
    history = open_history(written(tmp_path, [snapshot(step, maps=False) for step in (0, 1)]))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["history.parquet"]
    assert not history.maps
    assert history.whole(1).maps == {}


def test_a_simulation_that_fails_leaves_nothing_and_an_older_history_whole(tmp_path: Path) -> None:
    def failing():
        yield SNAPSHOTS[0]
        raise RuntimeError("stop")

    for before in ([], ["history.parquet", NAME]):
        if before:
            written(tmp_path)
        with pytest.raises(RuntimeError, match="stop"):
            write_history(tmp_path / "history.parquet", failing(), size_m=SIZE_M)
        assert sorted(path.name for path in tmp_path.iterdir()) == before
    assert open_history(tmp_path / "history.parquet").whole(5).maps["water_mm"].shape == (3, 5)


@pytest.mark.parametrize(
    "other",
    [replace(SNAPSHOTS[1], maps={}), replace(SNAPSHOTS[1], maps={"share": SNAPSHOTS[1].maps["share"]})],
    ids=["none", "fewer"],
)
def test_snapshots_of_other_maps_are_a_mistake_of_the_model(other: Population, tmp_path: Path) -> None:
    for snapshots in ([SNAPSHOTS[0], other], [other, SNAPSHOTS[0]]):
        with pytest.raises(ValueError, match="the same maps"):
            written(tmp_path, snapshots)
    assert list(tmp_path.iterdir()) == []


def test_maps_of_different_shapes_are_too(tmp_path: Path) -> None:
    uneven = replace(SNAPSHOTS[0], maps={"a": np.zeros((2, 3)), "b": np.zeros((3, 2))})
    with pytest.raises(ValueError, match="one shape"):
        written(tmp_path, [uneven])


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def stain(path: Path) -> None:
    """One byte of the maps' own, somewhere in the middle of a chunk."""
    with h5py.File(path, "r") as file:
        chunk = file["water_mm"].id.get_chunk_info(1)
    data = bytearray(path.read_bytes())
    data[chunk.byte_offset + chunk.size // 2] ^= 0x10
    path.write_bytes(bytes(data))


def swap(path: Path, **values: object) -> None:
    with h5py.File(path, "r+") as file:
        for name, value in values.items():
            del file[name]
            if value is not None:
                file[name] = value


BREAKS: dict[str, Callable[[Path], object]] = {
    "no such file": Path.unlink,
    "a folder": lambda path: (path.unlink(), path.mkdir()),
    "cut in half": cut,
    "empty": lambda path: path.write_bytes(b""),
    "a text": lambda path: path.write_text("maps"),
    "a bit has turned": stain,
    "a map is missing": lambda path: swap(path, water_mm=None),
    "no steps": lambda path: swap(path, step=None),
    "steps of another simulation": lambda path: swap(path, step=np.arange(3)),
    "a step twice": lambda path: swap(path, step=np.array([4, 4, 5])),
    "steps are a number": lambda path: swap(path, step=4),
    "fewer snapshots": lambda path: swap(path, water_mm=np.zeros((1, 3, 5))),
    "a map is a number": lambda path: swap(path, water_mm=1.0),
    "a map is text": lambda path: swap(path, water_mm=np.array([b"a", b"b", b"c"])),
    "a map has another shape": lambda path: swap(path, water_mm=np.zeros((3, 4, 4))),
    "a value is another": lambda path: swap(path, share=np.full((3, 3, 5), 0.3)),
}


@pytest.mark.parametrize("what", BREAKS)
def test_what_is_damaged_is_refused(what: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    history = open_history(written(tmp_path))
    BREAKS[what](tmp_path / NAME)
    with raises_error(AssetError, place="maps.nc") as caught:
        history.whole(4)
    assert caught.value.where == str(tmp_path / NAME)
    assert caught.value.got
    assert "\n" not in caught.value.got
    assert capfd.readouterr() == ("", "")


def test_maps_of_another_history_are_refused_though_all_looks_alike(tmp_path: Path) -> None:
    history = open_history(written(tmp_path / "a"))
    written(tmp_path / "b", [snapshot(step, seed=1) for step in (3, 4, 5)])
    (tmp_path / "a" / NAME).write_bytes((tmp_path / "b" / NAME).read_bytes())
    with raises_error(AssetError, place="maps.nc"):
        history.whole(4)


def test_a_small_file_that_tells_of_huge_maps_takes_no_memory(tmp_path: Path) -> None:
    history = open_history(written(tmp_path))
    with h5py.File(tmp_path / NAME, "r+") as file:
        del file["water_mm"]
        file.create_dataset("water_mm", shape=(3, 2_000_000, 2_000_000), chunks=(1, 10, 10), dtype="f8")
    assert (tmp_path / NAME).stat().st_size < 100_000
    with raises_error(ResourceError):
        history.whole(4)


def test_cells_are_a_metre_where_nobody_tells_the_site(tmp_path: Path) -> None:
    write_history(tmp_path / "history.parquet", SNAPSHOTS)
    with h5netcdf.File(tmp_path / NAME, "r") as file:
        assert file["x"][:].tolist() == [0.5, 1.5, 2.5, 3.5, 4.5]
