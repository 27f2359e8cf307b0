"""OpenVDB files, read back by a plain reader of the format's description, node by node."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from forestgen.atmosphere.grid import CloudGrid
from forestgen.atmosphere.weather_files import write_clouds


class Reader:
    """A cursor over a file of format 224 with one float grid, deflated, all values stored."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, form: str) -> tuple[int, ...]:
        values = struct.unpack_from("<" + form, self.data, self.at)
        self.at += struct.calcsize("<" + form)
        return values

    def text(self) -> str:
        (length,) = self.take("I")
        return bytes(self.take(f"{length}B")).decode()

    def mask(self, bits: int) -> np.ndarray:
        raw = np.array(self.take(f"{bits // 8}B"), np.uint8)
        return np.unpackbits(raw, bitorder="little").astype(bool)

    def values(self, count: int) -> np.ndarray:
        assert self.take("B") == (6,)
        (size,) = self.take("q")
        raw = bytes(self.take(f"{abs(size)}B"))
        plain = zlib.decompress(raw) if size > 0 else raw
        assert len(plain) == 4 * count
        return np.frombuffer(plain, "<f4")

    def leaves(
        self, origin: tuple[int, int, int], log_sides: tuple[int, ...]
    ) -> list[tuple[tuple[int, ...], np.ndarray]]:
        """First voxel and mask of each leaf below a node, in the file's order."""
        side = 1 << log_sides[0]
        if len(log_sides) == 1:
            return [(origin, self.mask(side**3))]
        children, active = self.mask(side**3), self.mask(side**3)
        assert not active.any()
        assert not self.values(side**3).any()
        size = 1 << sum(log_sides[1:])
        out = []
        for place in np.flatnonzero(children):
            steps = np.unravel_index(int(place), (side, side, side))
            below = tuple(int(o + size * s) for o, s in zip(origin, steps, strict=True))
            out += self.leaves((below[0], below[1], below[2]), log_sides[1:])
        return out


def read(path: Path, shape: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray, dict[str, bytes]]:
    """The field (Z, Y, X), the map's rows, the metadata."""
    file = Reader(path.read_bytes())
    assert file.take("qI") == (0x56444220, 224)
    assert file.take("II?")[2]
    file.take("36B")
    assert file.take("II") == (0, 1)
    assert [file.text() for _ in range(3)] == ["density", "Tree_float_5_4_3", ""]
    begin, blocks, end = file.take("qqq")
    assert begin == file.at
    assert end == len(file.data)
    assert file.take("I") == (1,)
    metadata = {}
    for _ in range(file.take("I")[0]):
        name, _, (size,) = file.text(), file.text(), file.take("I")
        metadata[name] = bytes(file.take(f"{size}B"))
    metadata["map"] = file.text().encode()
    rows = np.array(file.take("18d")).reshape(6, 3)
    assert file.take("IfI") == (1, 0.0, 0)
    leaves = []
    for _ in range(file.take("I")[0]):
        x, y, z = file.take("3i")
        leaves += file.leaves((x, y, z), (5, 4, 3))
    assert file.at == blocks
    padded = np.zeros([8 * (n // 8 + 1) for n in reversed(shape)], np.float32)
    for (x, y, z), mask in leaves:
        np.testing.assert_array_equal(file.mask(512), mask)
        block = file.values(512)
        np.testing.assert_array_equal(block != 0.0, mask)
        padded[x : x + 8, y : y + 8, z : z + 8] = block.reshape(8, 8, 8)
    assert file.at == end
    return padded.transpose(2, 1, 0)[: shape[0], : shape[1], : shape[2]], rows, metadata


@pytest.mark.parametrize("shape", [(1, 1, 1), (21, 40, 150), (8, 16, 8), (3, 2, 4100)])
def test_a_field_comes_back(tmp_path: Path, shape: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(2)
    field = (rng.random(shape) * (rng.random(shape) > 0.7)).astype(np.float32)
    field[..., : shape[2] // 3] = 0.0
    field[-1, -1, -1] = 0.25
    high = (1.0 + 2.0 * shape[2], 2.0 + 2.0 * shape[1], 3.0 + 3.0 * shape[0])
    write_clouds(tmp_path / "sky.vdb", CloudGrid(field, (1.0, 2.0, 3.0), high))
    back, rows, metadata = read(tmp_path / "sky.vdb", shape)
    np.testing.assert_array_equal(back, field)
    np.testing.assert_allclose(rows[0], [2.0, 3.0, 4.5])  # the first cell's centre
    np.testing.assert_allclose(rows[1:3], [[2.0, 2.0, 3.0]] * 2)
    np.testing.assert_allclose(rows[3:], [1 / rows[1], rows[1] ** -2.0, 0.5 / rows[1]])
    assert metadata["class"] == b"fog volume"
    assert metadata["is_saved_as_half_float"] == b"\0"
    assert metadata["map"] == b"ScaleTranslateMap"


def test_cubes_have_the_uniform_map_and_the_same_bytes(tmp_path: Path) -> None:
    grid = CloudGrid(np.ones((4, 4, 4), np.float32), (0.0, 0.0, 0.0), (8.0, 8.0, 8.0))
    for name in ("a.vdb", "b.vdb"):
        write_clouds(tmp_path / name, grid)
    assert read(tmp_path / "a.vdb", (4, 4, 4))[2]["map"] == b"UniformScaleTranslateMap"
    assert (tmp_path / "a.vdb").read_bytes() == (tmp_path / "b.vdb").read_bytes()


def test_a_clear_sky_is_an_empty_tree(tmp_path: Path) -> None:
    grid = CloudGrid(np.zeros((4, 4, 4), np.float32), (0.0, 0.0, 0.0), (8.0, 8.0, 8.0))
    write_clouds(tmp_path / "sky.vdb", grid)
    assert not read(tmp_path / "sky.vdb", (4, 4, 4))[0].any()
    assert (tmp_path / "sky.vdb").stat().st_size < 1000
