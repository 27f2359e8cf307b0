"""Maps of density: a picture or an array over the site."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from forestgen.recipe.fields import Flag, NonNegative, Section


def _rows(value: Any) -> Any:
    return {"rows": value} if isinstance(value, list | tuple) else value


class MapSection(Section):
    """A map; its first row is the northern edge, as in a picture, and it covers the whole site."""

    rows: tuple[tuple[NonNegative, ...], ...] = Field(description="Its values, row by row from north to south.")
    fit: Literal["exact", "stretch"] = Field("exact", description="exact: its pixels must be square on the site.")
    smooth: Flag = Field(True, description="Whether values are interpolated between the middles of pixels.")

    def values(self) -> NDArray[np.float64]:
        """(rows, cols) float64, row 0 at y = 0."""
        return np.array(self.rows, dtype=np.float64)[::-1]

    def on_grid(self, shape: tuple[int, int]) -> NDArray[np.float64]:
        """(rows, cols) float64: the map on a grid of cells over the site, row 0 at y = 0."""
        values = self.values()
        rows = (np.arange(shape[0]) * values.shape[0]) // shape[0]
        cols = (np.arange(shape[1]) * values.shape[1]) // shape[1]
        return np.ascontiguousarray(values[np.ix_(rows, cols)])


DensityMap = Annotated[MapSection, BeforeValidator(_rows)]
