"""Terrain from a map of heights: GeoTIFF or TIFF, PNG, OpenEXR, NumPy's .npy, or rows in the recipe.

Floating point pictures and arrays hold metres. Grey levels hold none, and go from `lowest_m` (black) to `highest_m`
(white); those of a TIFF are metres where neither is given, as elevation models of whole metres have it. The first row
is the northern edge, the left column the western one, and the map covers the whole site. A hole, which is NaN, what a
GeoTIFF's own mark says, -9999 or -32768, or a transparent pixel, is refused: plants would have nothing to stand on.

Example
-------
    site: {terrain: {kind: map, map: hills.png, lowest_m: 0, highest_m: 40}}

Parameters: see below.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from forestgen.core.errors import AssetError
from forestgen.core.raster import kind_of, read_raster
from forestgen.recipe.fields import Number, Section, Text, spelled_out, violation
from forestgen.recipe.map_files import Sha256, known_file
from forestgen.scene.terrain import HeightField, TerrainShape, smooth_step
from forestgen.scene.terrains.rolling import RollingKeys

LOWEST_M, HIGHEST_M = -12_000.0, 9_000.0  # of what is believed
_HOLES = (-9999.0, -32768.0)  # marks of those who have no tag for it
_NODATA_TAG = 42113  # GDAL_NODATA, text
_PAD = 2  # cells around the map
_WITH_ALPHA = ("LA", "RGBA", "PA")
_COLOURED = ("P", "PA", "RGB", "RGBA", "RGBX")


class HeightMap(Section):
    """Heights over the site; the first row is the northern edge."""

    file: Text | None = Field(
        None, description="Path of a GeoTIFF, TIFF, PNG, OpenEXR or .npy file, relative to the recipe's folder."
    )
    sha256: Sha256 | None = Field(None, description="SHA-256 of the file; no file of other content is taken.")
    rows: tuple[tuple[Annotated[Number, Field(ge=LOWEST_M, le=HIGHEST_M)], ...], ...] | None = Field(
        None, description="Instead of a file: heights, metres, row by row from north to south."
    )

    @model_validator(mode="after")
    def _one_of_them(self) -> Self:
        if (self.file is None) == (self.rows is None):
            problem = "the map has neither file nor rows" if self.file is None else "the map has both file and rows"
            raise violation("one of them", problem=problem)
        for index, row in enumerate(self.rows or ()):
            if self.rows is not None and len(row) != len(self.rows[0]):
                expected, got = f"{len(self.rows[0])} values, as in the first row", f"{len(row)} in row {index + 1}"
                raise violation(expected, problem="the map's rows differ in length", got=got, at=("rows", index))
        return self

    def heights(self, folder: Path, lowest_m: float | None, highest_m: float | None) -> NDArray[np.float64]:
        """(rows, cols) metres, row 0 in the north.

        `folder`: that `file` is relative to. `lowest_m`, `highest_m`: heights of black and white, where the map is of
        grey levels. Raises `AssetError`: no such file, a broken one, holes, heights that earth does not have; it has no
        place.
        """
        if self.rows is not None:
            found = np.array(self.rows, dtype=np.float64).reshape(len(self.rows), -1 if self.rows else 0)
        else:
            assert self.file is not None
            found = read_heights(known_file(folder, self.file, self.sha256), lowest_m, highest_m)
        if min(found.shape, default=0) < 2:
            rows, cols = found.shape
            raise AssetError("too small a map of heights", expected="at least 2 x 2 values", got=f"{cols} x {rows}")
        return found


class MapKeys(RollingKeys):
    """Keys of `terrain: {kind: map}`."""

    map: HeightMap | None = Field(
        None,
        description="Heights over the site, from its north-western corner: a file's name, rows of metres, or a "
        "mapping. GeoTIFF, TIFF, OpenEXR and .npy hold metres, PNG grey levels.",
    )
    lowest_m: Number | None = Field(
        None, ge=LOWEST_M, le=HIGHEST_M, description="Height that black stands for in a map, metres."
    )
    highest_m: Number | None = Field(
        None, ge=LOWEST_M, le=HIGHEST_M, description="Height that white stands for in a map, metres."
    )
    fit: Literal["exact", "stretch"] | None = Field(
        None, description="exact: a map's cells must be square on the site. Default: exact for files."
    )

    @field_validator("map", mode="before")
    @classmethod
    def _file_or_rows_alone(cls, value: Any) -> Any:
        return {"rows": value} if isinstance(value, list | tuple) else spelled_out(value, "file")

    @model_validator(mode="after")
    def _has_a_map(self) -> Self:
        if self.map is None:
            raise violation("map, a file of heights", problem="terrain of a map without a map", got="none", at="kind")
        if self.lowest_m is not None and self.highest_m is not None and self.lowest_m >= self.highest_m:
            raise violation(f"above lowest_m = {self.lowest_m:g} m", got=f"{self.highest_m:g} m", at=("highest_m",))
        return self


class MapTerrain(TerrainShape[MapKeys]):
    """The ground of a map of heights."""

    Parameters = MapKeys
    file_keys = ("map",)

    def height(self, keys: MapKeys, size_m: tuple[float, float], image_seed: int, folder: Path) -> HeightField:
        assert keys.map is not None
        heights_m = keys.map.heights(folder, keys.lowest_m, keys.highest_m)
        if (keys.fit or ("exact" if keys.map.file else "stretch")) == "exact":
            (rows, cols), (width, depth) = heights_m.shape, size_m
            # Cells that are square on the site, but for rounding one side to whole cells.
            if abs(cols - rows * width / depth) >= 1 and abs(rows - cols * depth / width) >= 1:
                expected, got = f"as wide to high as the site's {width:g} x {depth:g} m", f"{cols} x {rows} cells"
                hint = "fit: stretch, or another site.size_m"
                raise AssetError("the map's shape is not the site's", expected=expected, got=got, hint=hint)
        return mapped(size_m, heights_m)


@dataclass(frozen=True, eq=False)
class MappedHeight(HeightField):
    """Height of the ground by a map.

    On the site it is a cubic convolution of the cells' values (Keys 1981): it goes through every one of them at the
    cell's middle, its slope has no jumps, and a plane stays a plane. Beyond, the edge's height goes on outward and
    over into the edge's mean within the site's longer side.
    """

    cells_m: NDArray[np.float64]  # (rows + 4, cols + 4) heights, row 0 in the south; two more cells on every side
    plain_m: float  # height far away

    def _height(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        width, depth = self.size_m
        rows, cols = (side - 2 * _PAD for side in self.cells_m.shape)
        col, along_x = _cell(np.clip(x_m, 0.0, width) / width * cols, cols)
        row, along_y = _cell(np.clip(y_m, 0.0, depth) / depth * rows, rows)
        z = np.zeros(x_m.shape)
        weights_x, weights_y = _weights(along_x), _weights(along_y)
        for j in range(4):
            line = np.zeros(x_m.shape)
            for i in range(4):
                line += weights_x[i] * self.cells_m[row + j, col + i]
            z += weights_y[j] * line
        away = self.distance_m(x_m, y_m)
        return np.asarray(z + (self.plain_m - z) * smooth_step(away / max(self.size_m)))


def mapped(size_m: tuple[float, float], heights_m: NDArray[np.float64]) -> MappedHeight:
    """The ground of (rows, cols) heights in metres, at least 2 each way, row 0 in the north, over the whole site."""
    padded = np.asarray(heights_m, dtype=np.float64)[::-1]
    for cells in (_PAD,) if min(padded.shape) > _PAD else (1,) * _PAD:  # two cells have no second neighbour to reflect
        padded = np.pad(padded, cells, mode="reflect", reflect_type="odd")
    field = MappedHeight(size_m, padded, 0.0)
    x, y = (np.linspace(0.0, side, 101) for side in size_m)
    edge = np.concatenate([field(x, 0 * x), field(x, 0 * x + size_m[1]), field(0 * y, y), field(0 * y + size_m[0], y)])
    return MappedHeight(size_m, padded, float(edge.mean()))


def _cell(at: NDArray[np.float64], cells: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """First of the four padded cells around a place given in cells from the edge, and the share of the way between."""
    middle = at - 0.5 + _PAD
    before = np.clip(np.floor(middle), 1, cells + 1)
    return before.astype(np.int64) - 1, middle - before


def _weights(t: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Of the four cells around a place, `t` of the way from the second to the third (Keys 1981, a = -1/2)."""
    return (
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    )


def read_heights(path: Path, lowest_m: float | None = None, highest_m: float | None = None) -> NDArray[np.float64]:
    """(rows, cols) metres of a file, row 0 at its top; see the module's page.

    Raises `AssetError`: see `HeightMap.heights`.
    """
    kind, name = kind_of(path), path.name
    picture = read_raster(path)
    holes, coloured = _holes(path, kind, picture.values)
    if coloured:
        raise AssetError("a picture in colour holds no heights", expected="grey levels, or metres", got=name)
    if holes.any():
        count = int(holes.sum())
        cells, which = ("1 cell", "") if count == 1 else (f"{count:,} cells of {holes.size:,}", "the first ")
        got = f"{name}: {cells} without a height, {which}{_first(holes)}"
        hint = "fill them, as `gdal_fillnodata.py` does"
        raise AssetError("the terrain has holes", expected="a height in every cell", got=got, hint=hint)
    values = picture.values.astype(np.float64)
    levels, given = picture.white != 1.0, lowest_m is not None or highest_m is not None
    if not levels and given:
        expected = "no lowest_m and no highest_m, which are for grey levels"
        got = f"{name} of {picture.values.dtype}"
        raise AssetError("these heights are metres as they are", expected=expected, got=got)
    if levels and lowest_m is not None and highest_m is not None:
        return np.asarray(lowest_m + (highest_m - lowest_m) * values / picture.white)
    if levels and (kind == "png" or given):
        expected = "lowest_m and highest_m, the heights of black and white, metres"
        hint = "terrain: {kind: map, map: ..., lowest_m: 0, highest_m: 40}"
        raise AssetError("grey levels are no heights yet", expected=expected, got=name, hint=hint)
    wrong = (values < LOWEST_M) | (values > HIGHEST_M)
    if wrong.any():
        more = f", and {int(wrong.sum()) - 1:,} more" if wrong.sum() > 1 else ""
        expected = f"values from {LOWEST_M:g} to {HIGHEST_M:g}"
        got = f"{name}: {values[wrong][0]:g} {_first(wrong)}{more}"
        raise AssetError("these are no heights in metres", expected=expected, got=got)
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


def _first(wrong: NDArray[np.bool_]) -> str:
    """Place of the first of some cells, for people."""
    row, col = np.argwhere(wrong)[0]
    return f"in row {row + 1}, column {col + 1}"


SHAPE = MapTerrain()
