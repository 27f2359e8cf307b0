"""Terrain from a map of heights: GeoTIFF or TIFF, PNG, OpenEXR, NumPy's .npy, or rows in the recipe.

Floating point pictures and arrays hold metres. Grey levels hold none, and go from `lowest_m` (black) to `highest_m`
(white); those of a TIFF are metres where neither is given, as elevation models of whole metres have it. The first row
is the northern edge, the left column the western one, and the map covers the whole site. A hole, which is NaN, what a
GeoTIFF's own mark says, -9999 or -32768, or a transparent pixel, is refused: plants would have nothing to stand on.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from forestgen.core.errors import AssetError
from forestgen.core.grey_picture import kind_of, read_grey
from forestgen.recipe.fields import Number, Section, Text, mistake
from forestgen.recipe.map_files import file_sha256
from forestgen.recipe.paths import inside

LOWEST_M, HIGHEST_M = -12_000.0, 9_000.0  # of what is believed
_HOLES = (-9999.0, -32768.0)  # marks of those who have no tag for it
_NODATA_TAG = 42113  # GDAL_NODATA, text
_WITH_ALPHA = ("LA", "RGBA", "PA")
_COLOURED = ("P", "PA", "RGB", "RGBA", "RGBX")


class HeightMap(Section):
    """Heights over the site; the first row is the northern edge."""

    file: Text | None = Field(
        None, description="Path of a GeoTIFF, TIFF, PNG, OpenEXR or .npy file, relative to the recipe's folder."
    )
    sha256: Annotated[Text, Field(pattern="^[0-9a-f]{64}$")] | None = Field(
        None, description="SHA-256 of the file; no file of other content is taken."
    )
    rows: tuple[tuple[Annotated[Number, Field(ge=LOWEST_M, le=HIGHEST_M)], ...], ...] | None = Field(
        None, description="Instead of a file: heights, metres, row by row from north to south."
    )

    @model_validator(mode="after")
    def _one_of_them(self) -> Self:
        if (self.file is None) == (self.rows is None):
            problem = "the map has neither file nor rows" if self.file is None else "the map has both file and rows"
            raise mistake("one of them", problem=problem)
        for index, row in enumerate(self.rows or ()):
            if self.rows is not None and len(row) != len(self.rows[0]):
                raise mistake(
                    f"{len(self.rows[0])} values, as in the first row",
                    problem="the map's rows differ in length",
                    got=f"{len(row)} in row {index + 1}",
                    at=("rows", index),
                )
        return self

    def heights(self, folder: Path, lowest_m: float | None, highest_m: float | None) -> NDArray[np.float64]:
        """(rows, cols) metres, row 0 in the north.

        Parameters
        ----------
        folder : that `file` is relative to.
        lowest_m, highest_m : heights of black and white, where the map is of grey levels.

        Raises
        ------
        AssetError : no such file, a broken one, holes, heights that earth does not have; it has no place.
        """
        if self.rows is not None:
            found = np.array(self.rows, dtype=np.float64).reshape(len(self.rows), -1 if self.rows else 0)
        else:
            assert self.file is not None
            path = inside(folder, self.file, sha256=self.sha256)
            if file_sha256(path, self.file) != (self.sha256 or file_sha256(path, self.file)):
                raise AssetError(
                    "this is not the file that the recipe was made with",
                    expected=f"a file whose SHA-256 is {str(self.sha256)[:16]}...",
                    got=str(path),
                )
            found = read_heights(path, lowest_m, highest_m)
        if min(found.shape, default=0) < 2:
            rows, cols = found.shape
            raise AssetError("too small a map of heights", expected="at least 2 x 2 values", got=f"{cols} x {rows}")
        return found


def read_heights(path: Path, lowest_m: float | None = None, highest_m: float | None = None) -> NDArray[np.float64]:
    """(rows, cols) metres of a file, row 0 at its top; see the module's page.

    Raises
    ------
    AssetError : see `HeightMap.heights`.
    """
    kind = kind_of(path)
    picture = read_grey(path)
    holes, coloured = _holes(path, kind, picture.values)
    if coloured:
        raise AssetError("a picture in colour holds no heights", expected="grey levels, or metres", got=path.name)
    if holes.any():
        raise AssetError(
            "the terrain has holes",
            expected="a height in every cell",
            got=f"{path.name}: {_how_many(holes)}",
            hint="fill them, as `gdal_fillnodata.py` does",
        )
    values = picture.values.astype(np.float64)
    levels = picture.white != 1.0
    span = lowest_m is not None and highest_m is not None
    if not levels and (lowest_m is not None or highest_m is not None):
        raise AssetError(
            "these heights are metres as they are",
            expected="no lowest_m and no highest_m, which are for grey levels",
            got=f"{path.name} of {picture.values.dtype}",
        )
    if levels and not span and (kind == "png" or lowest_m is not None or highest_m is not None):
        raise AssetError(
            "grey levels are no heights yet",
            expected="lowest_m and highest_m, the heights of black and white, metres",
            got=path.name,
            hint="terrain: {kind: map, map: ..., lowest_m: 0, highest_m: 40}",
        )
    if levels and lowest_m is not None and highest_m is not None:
        return np.asarray(lowest_m + (highest_m - lowest_m) * values / picture.white)
    wrong = (values < LOWEST_M) | (values > HIGHEST_M)
    if wrong.any():
        raise AssetError(
            "these are no heights in metres",
            expected=f"values from {LOWEST_M:g} to {HIGHEST_M:g}",
            got=f"{path.name}: {_first(values, wrong)}",
        )
    return values


def _holes(path: Path, kind: str, values: NDArray[Any]) -> tuple[NDArray[np.bool_], bool]:
    """(rows, cols) where there is no height; and whether the picture is in colour."""
    holes = ~np.isfinite(values)
    for mark in _HOLES if kind != "png" else ():
        holes |= values == mark
    if kind not in ("png", "tif"):
        return holes, False
    from PIL import Image

    with Image.open(path, formats=("PNG", "TIFF")) as image:
        if image.mode in _COLOURED:
            return holes, True
        if image.mode in _WITH_ALPHA:
            holes |= np.asarray(image.getchannel("A")) < 255
        own = _number(getattr(image, "tag_v2", {}).get(_NODATA_TAG))
    if own is not None:
        with np.errstate(over="ignore"):
            holes |= values == np.asarray(own).astype(values.dtype if values.dtype.kind == "f" else np.float64)
    return holes, False


def _number(text: Any) -> float | None:
    """What a tag says in words, or None."""
    try:
        return float(str(text).strip().strip("\0"))
    except ValueError:
        return None


def _how_many(holes: NDArray[np.bool_]) -> str:
    """Number and first place of holes, for people."""
    row, col = np.argwhere(holes)[0]
    count = int(holes.sum())
    cells = "1 cell" if count == 1 else f"{count:,} cells of {holes.size:,}"
    return f"{cells} without a height, {'' if count == 1 else 'the first '}in row {row + 1}, column {col + 1}"


def _first(values: NDArray[np.float64], wrong: NDArray[np.bool_]) -> str:
    row, col = np.argwhere(wrong)[0]
    more = f", and {int(wrong.sum()) - 1:,} more" if wrong.sum() > 1 else ""
    return f"{values[row, col]:g} in row {row + 1}, column {col + 1}{more}"
