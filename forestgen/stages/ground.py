"""The ground of a recipe's site: one height function for the community and for the scene."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from forestgen.community.model import Site
from forestgen.core.errors import AssetError
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.registries import TERRAINS
from forestgen.recipe.terrain import Terrain
from forestgen.scene.terrain import HeightField


def height_field(drawn: DrawnRecipe) -> HeightField:
    """Height of the ground at any x and y; the same object whenever a recipe's image is asked for again.

    Raises
    ------
    RecipeError : a map of heights that cannot be read, has holes, or has not the site's shape; with its line.
    """
    site = drawn.recipe.site
    try:
        return _height_field(site.size_m, site.terrain, drawn.image_seed, drawn.folder)
    except AssetError as cause:
        where = drawn.where("site", "terrain", *TERRAINS.load(site.terrain.kind).file_keys)
        raise AssetError(cause.problem, where=where, expected=cause.expected, got=cause.got, hint=cause.hint) from cause


@lru_cache(maxsize=16)
def _height_field(size_m: tuple[float, float], terrain: Terrain, image_seed: int, folder: Path) -> HeightField:
    height: HeightField = TERRAINS.load(terrain.kind).height(terrain, size_m, image_seed, folder)
    return height


def community_site(drawn: DrawnRecipe) -> Site:
    """The site as its community knows it. The height function is kept, so that sites of one image are equal."""
    site = drawn.recipe.site
    terrain = site.terrain
    return Site(
        site.size_m,
        height=None if TERRAINS.load(terrain.kind).is_level(terrain) else height_field(drawn),
        altitude_m=site.altitude_m,
        latitude_deg=site.latitude_deg,
        wind_from_deg=site.wind_from_deg,
    )
