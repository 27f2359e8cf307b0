"""The ground of a recipe's site: one height function for the community and for the scene."""

from __future__ import annotations

from functools import lru_cache

from forestgen.community.model import Site
from forestgen.core.randomness import child_rng
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.schema import Terrain
from forestgen.scene.terrain import HeightField, flat, rolling


def height_field(drawn: DrawnRecipe) -> HeightField:
    """Height of the ground at any x and y; the same object whenever a recipe's image is asked for again."""
    site = drawn.recipe.site
    return _height_field(site.size_m, site.terrain, drawn.image_seed)


@lru_cache(maxsize=16)
def _height_field(size_m: tuple[float, float], terrain: Terrain, image_seed: int) -> HeightField:
    if terrain.kind == "flat":
        return flat(size_m)
    return rolling(size_m, terrain.amplitude_m, terrain.wavelength_m, child_rng(image_seed, "terrain", "height"))


def community_site(drawn: DrawnRecipe) -> Site:
    """The site as its community knows it. The height function is kept, so that sites of one image are equal."""
    site = drawn.recipe.site
    is_flat = site.terrain.kind == "flat" or site.terrain.amplitude_m == 0
    return Site(
        site.size_m,
        height=None if is_flat else height_field(drawn),
        altitude_m=site.altitude_m,
        latitude_deg=site.latitude_deg,
        wind_from_deg=site.wind_from_deg,
    )
