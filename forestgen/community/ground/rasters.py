"""The five living conditions of a site on a grid: elevation, slope, moisture, wind and sun.

==========  ==========  =================================================================  =============
name        unit        meaning                                                            level ground
==========  ==========  =================================================================  =============
elevation   m           height above sea level: site.altitude_m and the ground's height    altitude_m
slope       degrees     of the steepest descent                                            0
moisture    0 to 1      topographic wetness, see `drainage`: 0 dry crest, 1 valley floor   0.5
wind        0 to 1      exposure, see `horizons`: 0 sheltered hollow, 1 crest              0.5
sun         0 and more  direct irradiation over the year, see `sunshine`                   1
==========  ==========  =================================================================  =============

The ground is defined everywhere, so what lies around the site counts: 200 m of it for water, 1000 m for views. It is
sampled at nodes that depend on the site alone: 480 across the site with the 200 m around it, or one every 4 m if that
is closer. A grid of any number of cells reads its values between the nodes, so that its own fineness matters little.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from forestgen.community.ground.drainage import moisture
from forestgen.community.ground.horizons import Views, exposure, views
from forestgen.community.ground.relief import Nodes, Relief, far_relief, near_relief
from forestgen.community.ground.sunshine import irradiation
from forestgen.community.model import GroundHeight, Site
from forestgen.core.cache import BoundedCache

Floats = NDArray[np.float64]

NAMES = ("elevation_m", "slope_deg", "moisture", "wind", "sun")


def ground_rasters(site: Site, shape: tuple[int, int], names: Sequence[str] = NAMES) -> dict[str, Floats]:
    """(rows, cols) of each living condition in the middles of a grid's cells over the site; row 0 at y = 0."""
    return {name: ground_raster(site, name, shape) for name in names}


def ground_raster(site: Site, name: str, shape: tuple[int, int], rows: slice = slice(None)) -> Floats:
    """(rows, cols) of one living condition, or of some rows of the grid alone."""
    if site.height is not None:
        return _ground(site, site.height).on_cells(name, shape, rows)
    level = {"elevation_m": site.altitude_m, "slope_deg": 0.0, "moisture": 0.5, "wind": 0.5, "sun": 1.0}[name]
    return np.full((len(range(shape[0])[rows]), shape[1]), level)


class _Ground:
    """What is known of one site's ground; each part is computed when it is first asked for."""

    def __init__(self, site: Site, height: GroundHeight) -> None:
        self.site, self.height = site, height

    def on_cells(self, name: str, shape: tuple[int, int], rows: slice) -> Floats:
        """(rows, cols) of one living condition on the cells of some rows of a grid."""
        nodes, values = self._wind if name == "wind" else (self._nodes, self._at_nodes(name))
        x, y = (
            np.linspace(0.0, side, n, endpoint=False) + side / (2 * n)
            for side, n in zip(self.site.size_m, shape[::-1], strict=True)
        )
        return nodes.between(values, x, y[rows])

    def _at_nodes(self, name: str) -> Floats:
        match name:
            case "elevation_m":
                return self._elevation_m
            case "slope_deg":
                return self._slope_deg
            case "moisture":
                return self._moisture
        return self._sun

    @cached_property
    def _near(self) -> Relief:
        return near_relief(self.height, self.site)

    @cached_property
    def _over(self) -> tuple[slice, slice]:
        return self._near.over(self.site)

    @cached_property
    def _nodes(self) -> Nodes:
        rows, cols = self._over
        return Nodes(self._near.nodes.x_m[cols], self._near.nodes.y_m[rows])

    @cached_property
    def _slopes(self) -> tuple[Floats, Floats]:
        along_x, along_y = self._near.slopes
        return np.ascontiguousarray(along_x[self._over]), np.ascontiguousarray(along_y[self._over])

    @cached_property
    def _views(self) -> Views:
        return views(self._near, far_relief(self.height, self.site), self.site)

    @cached_property
    def _elevation_m(self) -> Floats:
        return self.site.altitude_m + self._near.z_m[self._over]

    @cached_property
    def _slope_deg(self) -> Floats:
        return np.asarray(np.degrees(np.arctan(np.hypot(*self._slopes))))

    @cached_property
    def _moisture(self) -> Floats:
        return np.ascontiguousarray(moisture(self._near)[self._over])

    @cached_property
    def _wind(self) -> tuple[Nodes, Floats]:
        return self._views.nodes, exposure(self._views, self.site.wind_from_deg)

    @cached_property
    def _sun(self) -> Floats:
        return irradiation(*self._slopes, self._nodes, self._views, self.site.latitude_deg)


#: The grounds asked for last, each of which counts as one; they take some tens of megabytes each.
_grounds: BoundedCache[_Ground] = BoundedCache(4, lambda ground: 1)


def _ground(site: Site, height: GroundHeight) -> _Ground:
    """The ground of a site, the same object for the same site.

    Height functions are told apart by identity, as many cannot be compared; a ground that is kept keeps its function,
    so that no other can take its number.
    """
    key = (site.size_m, site.altitude_m, site.latitude_deg, site.wind_from_deg, id(height))
    return _grounds.get(key, lambda: _Ground(site, height))
