"""What a kind of terrain is: a function of the ground's height, by the recipe's keys."""

from __future__ import annotations

from pathlib import Path
from typing import Generic, TypeVar

from forestgen.recipe.schema import Terrain
from forestgen.recipe.sources import Keys
from forestgen.scene.terrain import HeightField

KeysT = TypeVar("KeysT", bound=Terrain)


class TerrainShape(Generic[KeysT]):
    """A kind of terrain."""

    Parameters: type[KeysT]  # keys of `site.terrain`; equal keys are equal ground
    file_keys: Keys = ()  # below `site.terrain`, of what an `AssetError` is about

    def is_level(self, keys: KeysT) -> bool:
        """Whether the ground is z = 0 everywhere, so that a community need not ask for its height."""
        return False

    def height(self, keys: KeysT, size_m: tuple[float, float], image_seed: int, folder: Path) -> HeightField:
        """Height of the ground everywhere.

        Parameters
        ----------
        size_m : of the site.
        image_seed : root of the image's randomness.
        folder : of the recipe, that files are relative to.

        Raises
        ------
        AssetError : a file that cannot be read, or is not of this site; without its place.
        """
        raise NotImplementedError
