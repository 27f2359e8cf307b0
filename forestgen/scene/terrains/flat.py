"""Flat ground: z = 0 everywhere."""

from __future__ import annotations

from pathlib import Path

from forestgen.scene.terrain import HeightField
from forestgen.scene.terrains.rolling import RollingKeys
from forestgen.scene.terrains.shape import TerrainShape


class FlatKeys(RollingKeys):
    """Keys of `terrain: {kind: flat}`: none of its own."""


class Flat(TerrainShape[FlatKeys]):
    """Flat ground."""

    Parameters = FlatKeys

    def is_level(self, keys: FlatKeys) -> bool:
        return True

    def height(self, keys: FlatKeys, size_m: tuple[float, float], image_seed: int, folder: Path) -> HeightField:
        return HeightField(size_m)


SHAPE = Flat()
